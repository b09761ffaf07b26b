"""`MultiARXMPC`: one quadratic program from ARX models blended by speed (MARX-MPC)."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from slipangle.control.call import applied_before, both, doubt, given
from slipangle.control.controller import Ahead
from slipangle.control.fallback import RELAX
from slipangle.control.marx.blended import FASTEST, BlendedProblem
from slipangle.control.marx.problem import Numbers
from slipangle.optimal.arrays import DOUBLE
from slipangle.optimal.checks import ANY, counted, health_of, is_numbers
from slipangle.optimal.ocp import Reference
from slipangle.optimal.solution import NEW, Health, Plan, Status, finite, quick, shifted, within

SLOWEST = 1.0  # m/s, below which no steering angle is worth planning
FARTHEST = 1e3  # m, m/s or rad/s, an offset that no model error explains
STANDING = "the models do not describe standing or reversing, the wheels stay where they are"


@dataclass(frozen=True, kw_only=True, eq=False)
class MultiARXPlan(Plan):
    """`Plan` of a `MultiARXMPC`.

    Parameters
    ----------
    weights : array, shape (n_models,)
        Weight of each model at the speed now.
    outside : bool
        Whether the speed now lies outside the models' range, so that the nearest one is used alone.
    offset : array, shape (n_outputs,), or 0
        What is added to the models' outputs at every step, see `MultiARXMPC`.
    """

    weights: np.ndarray
    outside: bool = False
    offset: np.ndarray | float = 0.0

    @property
    def message(self) -> str:
        """One sentence on where the command comes from."""
        note = "; the speed is outside the models' range, the nearest model is used" if self.outside else ""
        return super().message + note


@dataclass(frozen=True, eq=False)
class MultiARXMPC(BlendedProblem):
    """Model predictive controller on ARX models blended by speed. [1]_ eqs. 7-2, 7-3

    Every model predicts from the measured past on its own; the predictions are summed with weights of the speed at
    each step of the preview, and one quadratic program decides the steering:
    ``J = sum_i |e_i|^2_Q + |u_i|^2_R + |u_i - u_{i-1}|^2_S + |e_N|^2_terminal`` with sums as in `OCP`.

    A model of ``Y`` ([1]_) tracks the path's Y and suits paths along the X axis. A model of ``v_y`` and ``r`` on the
    ground, ``OnGround(MultiARXModel(...))``, tracks ``e_y`` and ``e_psi`` of any path; its prediction is linear about
    the motion with the input held.

    Outside the models' range of speed the nearest model has all the weight and `MultiARXPlan.outside` says so. Slower
    than 1 m/s and in reverse, which the models do not describe, the wheels stay where they are: a fallback that does
    not ask for a stop. Other fallbacks are those of `MPC`.

    Parameters
    ----------
    model : MultiARXModel or OnGround of one
        Outputs ``("Y",)``, or on the ground ``("v_y", "r")`` in any order.
    horizon : int
        Steps N, all as long as the models'.
    Q : Weights
        On ``Y``, or on ``e_y`` and ``e_psi``.
    S, R : Weights
        On the change of the input and on the input; one of them must be positive.
    terminal : Weights, optional
        As Q, at the end; Q by default.
    limits, rates : Limits
        On the input, and on its change per second; always kept.
    knots : sequence of int, optional
        Steps at which the input is decided, the first 0; between them it runs straight, after the last it is held. A
        program of ``(0, 1, 2, 4, 8)`` has 5 decisions over any horizon. By default every step is decided.
    integral : float
        Share of each step's prediction error that is believed to last, 0 to 1: it is added up, and the sum added to the
        outputs of all models at every step. 0.2 takes away most of a steady offset within half a second. [-]
    fallback : int
        How many steps in a row a shifted plan may serve when the state or the reference is not finite.
    safe : Values
        Input of the safe stop law; by default zero.
    plausible : Limits
        As of `MPC`: ranges of states, X, Y, psi and v_x beyond which a value is taken for a fault.

    Raises
    ------
    ParameterError
        If a name is not known, the horizon is below 1, or the input has no weight.

    References
    ----------
    .. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023, ch. 7.
    """

    def plan(
        self, x: np.ndarray, /, reference: Ahead, previous: Plan | None = None, *, applied: np.ndarray | None = None
    ) -> MultiARXPlan:
        """See `Controller.plan`: the path ahead has columns X, Y, psi; the speed is exogenous."""
        return self.plan_with(None, x, reference, previous, applied)

    def plan_with(
        self,
        numbers: Numbers | None,
        x: np.ndarray,
        reference: Ahead,
        previous: Plan | None,
        applied: np.ndarray | None,
        memory: Any = None,
    ) -> MultiARXPlan:
        """`plan` with ``numbers`` for the model's coefficients, such as adapted ones; ``memory`` goes into the plan."""
        solver = self.solver
        begin = perf_counter()
        if type(reference) is Reference and not self.integral and not reference.varied and reference.scenarios is None:
            answer = self._again(numbers, x, reference, previous, applied, memory, begin)
            if answer is not None:
                return answer
        x, wanted = given(self, x, reference, previous)
        before = applied_before(previous, applied, self.controls, np.zeros(1), *self._range).item()
        v_x, path = wanted.exogenous, wanted.tracked
        speed = v_x.item(0)
        said = doubt(applied, self.controls)
        call = Call(x=x, speed=speed, previous=previous, before=before, begin=begin, memory=memory, doubt=said)
        wrong = self._judge.status(x, path, v_x)
        if wrong is not None:
            detail = self._judge.fault(x, path, v_x) if wrong is Status.IMPLAUSIBLE else ""
            return self._fallback(call, wrong, detail)
        if speed < SLOWEST:
            return self._fallback(call, Status.FAILED, STANDING, standing=True)
        offset = self._offset(x, previous) if self.integral and previous is not None else 0.0
        try:
            answer = solver.solve(x, path, v_x, before, numbers, offset)
        except Exception as error:
            return self._fallback(call, Status.FAILED, str(error).partition("\n")[0] or type(error).__name__)
        if answer.status is not Status.SOLVED or not finite(answer.u, answer.x):
            return self._fallback(call, Status.FAILED if answer.status is Status.SOLVED else answer.status)
        values = {
            "u": answer.u,
            "x": answer.x,
            "status": Status.SOLVED,
            "seconds": perf_counter() - begin,
            "cost": answer.cost,
            "iterations": answer.iterations,
            "controls": self.controls,
            "residual": answer.residual,
            "detail": said,
            "memory": memory,
            "times": self.times,
            "health": health_of(previous).after(False, False),
            "weights": answer.weights,
            "outside": self.blended.outside(speed),
            "offset": offset,
        }
        return quick(MultiARXPlan, values)

    def _again(
        self,
        numbers: Numbers | None,
        x: np.ndarray,
        reference: Reference,
        previous: Plan | None,
        applied: np.ndarray | None,
        memory: Any,
        begin: float,
    ) -> MultiARXPlan | None:
        """The usual call in as few steps as possible; None for others, which are looked at closely."""
        solver, before, health, speed = self.solver, 0.0, NEW, reference.exogenous
        if previous is not None:
            if not isinstance(previous, Plan):
                return None
            u, health = previous.u, previous.health
            if type(u) is not np.ndarray or u.shape != self._shape_u or u.dtype is not DOUBLE:
                return None
            if type(health) is not Health or previous.controls != self.controls:
                return None
            before = u.item(0)
        if applied is not None:
            if type(applied) is not np.ndarray or applied.shape != (1,) or applied.dtype is not DOUBLE:
                return None
            before = applied.item()
        if not abs(before) <= ANY:
            return None
        if type(speed) is not np.ndarray or speed.ndim != 2:
            return None
        v_x = speed if len(speed) == self.horizon else speed[: self.horizon]
        if not v_x.size or not (now := v_x.item(0)) >= SLOWEST:
            return None
        answer = solver.again(x, reference.tracked, v_x, before, numbers)
        if answer is None:
            return None
        answer["controls"], answer["times"], answer["memory"] = self.controls, self.times, memory
        answer["outside"] = self.blended.outside(now)
        answer["health"] = health.after(False, False)
        answer["seconds"] = perf_counter() - begin
        return quick(MultiARXPlan, answer)

    def _offset(self, x: np.ndarray, previous: Plan) -> np.ndarray | float:
        """Sum of the believed prediction errors, from a fresh plan one step ago; zero after anything else."""
        if not (isinstance(previous, MultiARXPlan) and previous.age == 0 and is_numbers(previous.x, self._shape_x)):
            return 0.0
        ny = len(self.blended.outputs)
        offset = previous.offset + self.integral * (x - previous.x[1])[:ny]
        return offset if is_numbers(offset, (ny,)) and (np.abs(offset) < FARTHEST).all() else 0.0

    def _fallback(self, call: Call, status: Status, detail: str = "", *, standing: bool = False) -> MultiARXPlan:
        """The previous plan shifted, or the safe stop law; standing, the wheels stay where they are."""
        previous, before = call.previous, call.before
        age = 1 if previous is None else counted(previous.age) + 1
        left = 0
        if previous is not None and previous.controls == self.controls and is_numbers(previous.u, self._shape_u):
            left = 0 if previous.stopping else min(self.fallback, self.horizon - 1)
        stopping = not standing and age > left
        low, high = self._range
        if standing:
            u = np.full((self.horizon, 1), before)
        elif stopping or previous is None:
            safe = min(max(self.safe.get(self.controls[0], 0.0), low), high)
            keep = np.exp(-self.dt / RELAX) ** np.arange(1, self.horizon + 1)[:, None]
            u = safe + keep * (before - safe)
        else:
            u = shifted(previous.u)
        problem = self.problem
        u = within(u, np.array([before]), problem.bounds[None], problem.steps[None])
        states = np.zeros(self._shape_x)
        if standing:
            states = np.tile(call.x, (self.horizon + 1, 1))
        elif previous is not None and is_numbers(previous.x, self._shape_x):
            states = shifted(previous.x)
        speed = call.speed if abs(call.speed) < FASTEST else self.blended.speeds[0]
        return MultiARXPlan(
            u=u,
            x=states,
            status=status,
            seconds=perf_counter() - call.begin,
            cost=float("nan"),
            iterations=0,
            controls=self.controls,
            age=age,
            stopping=stopping,
            detail=both(detail, call.doubt),
            memory=call.memory,
            times=self.times,
            health=health_of(previous).after(True, False),
            weights=np.array(self.blended.weights(speed), dtype=float),
            outside=self.blended.outside(call.speed),
        )


class Call(NamedTuple):
    """One call of `MultiARXMPC.plan`: what was given, checked, and when."""

    x: np.ndarray
    speed: float
    previous: Plan | None
    before: float
    begin: float
    memory: Any
    doubt: str = ""  # of the input applied, which cannot be true
