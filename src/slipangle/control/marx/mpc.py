"""`MultiARXMPC`: one quadratic program from ARX models blended by speed (MARX-MPC)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from itertools import pairwise
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from slipangle.control.marx.solver import Continues, Numbers, Problem, Solver, build
from slipangle.errors import ParameterError
from slipangle.models.model import without_caches
from slipangle.models.wrappers.multi_arx import MultiARXModel
from slipangle.models.wrappers.on_ground import POSE, OnGround
from slipangle.numerics.per_thread import BUILDING
from slipangle.optimal.arrays import DOUBLE, applied_input, array, vector
from slipangle.optimal.checks import (
    ANY,
    Judge,
    counted,
    health_of,
    is_numbers,
    last_input,
    require_plan,
    require_reference,
)
from slipangle.optimal.ocp import Reference
from slipangle.optimal.solution import NEW, Health, Plan, Status, finite, quick, shifted, within
from slipangle.optimal.terms import Limits, Values, Weights, coerce, require_names
from slipangle.paths.path import Preview

RELAX = 0.5  # s, time constant of the safe stop law
SLOWEST, FASTEST = 1.0, 1e3  # m/s, below and above which no steering angle is worth planning
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
class MultiARXMPC:
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
        outputs of all models at every step. 0.2 takes away most of a steady offset within half a second.
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

    model: MultiARXModel | OnGround
    _: KW_ONLY
    horizon: int
    Q: Weights
    S: Weights = field(default_factory=Weights)
    R: Weights = field(default_factory=Weights)
    terminal: Weights | None = None
    limits: Limits = field(default_factory=Limits)
    rates: Limits = field(default_factory=Limits)
    knots: tuple[int, ...] | None = None
    integral: float = 0.0
    fallback: int = 5
    safe: Values = field(default_factory=Values)
    plausible: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        coerce(self, Weights, "Q", "S", "R", *(("terminal",) if self.terminal is not None else ()))
        coerce(self, Limits, "limits", "rates", "plausible")
        coerce(self, Values, "safe")
        if not (isinstance(self.horizon, int) and self.horizon >= 1):
            raise ParameterError(f"the horizon is {self.horizon!r}; expected a whole number of at least 1")
        if self.knots is not None:
            object.__setattr__(self, "knots", _checked_knots(self.knots, self.horizon))
        base = self.model.model if isinstance(self.model, OnGround) else self.model
        if not isinstance(base, MultiARXModel):
            raise ParameterError(
                f"the model is a {type(base).__name__}; expected a MultiARXModel, or OnGround of one: blend the ARX "
                "models first"
            )
        wanted = {"v_y", "r"} if isinstance(self.model, OnGround) else {"Y"}
        if set(base.outputs) != wanted:
            raise ParameterError(
                f"the models' outputs are {list(base.outputs)}; expected Y, or v_y and r on the ground: identify those"
            )
        for what, weights in (("Q", self.Q), ("terminal", self.terminal or {})):
            require_names(weights, self.tracked, what, "use a tracked quantity")
        for what, names in (("S", self.S), ("R", self.R), ("limits", self.limits), ("rates", self.rates)):
            require_names(names, self.controls, what, "use the models' input")
        require_names(self.safe, self.controls, "safe", "use the models' input")
        known = (*self.model.states, *POSE, *self.exogenous)
        require_names(self.plausible, known, "plausible", "use a state, X, Y, psi or v_x")
        if not (self.Q or self.terminal):
            raise ParameterError(f"nothing is tracked; expected weights on some of {list(self.tracked)}: set Q")
        name = self.controls[0]
        if not self.S.get(name, 0.0) + self.R.get(name, 0.0) > 0:
            raise ParameterError(
                f"the input '{name}' has no weight; expected a positive one, so that the plan is unique: set S"
            )
        lower, upper = self.rates.get(name, (0.0, 0.0))
        if not lower <= 0 <= upper:
            raise ParameterError(f"the rate limit of '{name}' is ({lower}, {upper}); expected one that contains 0")
        if not 0 <= self.integral <= 1:
            raise ParameterError(f"integral is {self.integral}; expected a share of 0 to 1")
        if self.fallback < 0:
            raise ParameterError(f"fallback is {self.fallback}; expected a number of steps of at least 0")

    def __getstate__(self) -> dict[str, Any]:
        """What a copy needs, in this process or another: its settings, nothing compiled."""
        return without_caches(self)

    # ---- what a controller has -----------------------------------------------------------------------------------

    @cached_property
    def blended(self) -> MultiARXModel:
        """The blended model, without the ground."""
        found = self.model.model if isinstance(self.model, OnGround) else self.model
        if not isinstance(found, MultiARXModel):
            raise ParameterError("the model is no MultiARXModel")
        return found

    @property
    def dt(self) -> float:
        """Step. [s]"""
        return self.model.dt

    @cached_property
    def times(self) -> np.ndarray:
        """Instants of the plan's states, shape (horizon + 1,). [s]"""
        return self.dt * np.arange(self.horizon + 1)

    @cached_property
    def controls(self) -> tuple[str, ...]:
        """The decided input."""
        return self.model.inputs[:1]

    @property
    def exogenous(self) -> tuple[str, ...]:
        """The speed."""
        return ("v_x",)

    @property
    def tracked(self) -> tuple[str, ...]:
        """What may have a weight in Q."""
        return ("e_y", "e_psi") if isinstance(self.model, OnGround) else ("Y",)

    @property
    def references(self) -> tuple[str, ...]:
        """Columns of ``Reference.tracked``."""
        return POSE

    def start(self, measured: Mapping[str, float]) -> np.ndarray:
        """State of the model for a vehicle that has been going straight on as it does now.

        Parameters
        ----------
        measured : mapping of str to float
            Measured channels, SI units.
        """
        base = self.blended
        known = {**measured, "v_y": measured.get("v_y", 0.0), "r": measured.get("r", 0.0)}
        rows = np.tile([known[n] for n in base.outputs], (base.na, 1))
        if base.outputs == ("Y",):
            across = known.get("v_x", 0.0) * np.sin(known.get("psi", 0.0)) + known["v_y"] * np.cos(known.get("psi", 0))
            rows[:, 0] -= across * self.dt * np.arange(base.na)
        past = np.full(base.reach - 1, measured.get(self.controls[0], 0.0))
        pose = [known[n] for n in POSE] if isinstance(self.model, OnGround) else []
        return np.concatenate([rows.ravel(), past, pose])

    def reference(self, preview: Preview, **exogenous: np.ndarray | float) -> Reference:
        """`Reference` from a look along a path: X, Y, psi and the speed.

        Raises
        ------
        ParameterError
            If the preview is not at `times`.
        """
        preview.require_times(self.times)
        require_names(exogenous, self.exogenous, "reference()", "only the speed is given from outside")
        speed = np.asarray(exogenous.get("v_x", preview.v_x[:-1]), dtype=float)
        return Reference(
            tracked=np.column_stack([preview.X, preview.Y, preview.psi]),
            exogenous=np.broadcast_to(speed, (self.horizon,))[:, None],
        )

    def prepare(self) -> None:
        """Compile now, so that no plan counts that time as its own."""
        _ = self.solver

    @cached_property
    def problem(self) -> Problem:
        """Sizes, weights and limits for the solver."""
        base, name = self.blended, self.controls[0]
        end = self.Q if self.terminal is None else self.terminal
        low, high = self.limits.get(name, (-np.inf, np.inf))
        slow, fast = self.rates.get(name, (-np.inf, np.inf))
        return Problem(
            horizon=self.horizon,
            knots=self.knots or tuple(range(self.horizon)),
            dt=self.dt,
            na=base.na,
            reach=base.reach,
            outputs=base.outputs,
            n_models=len(base.models),
            smooth=base.shape == "smooth",
            rated=name in self.rates,
            q=np.array([self.Q.get(n, 0.0) for n in self.tracked]),
            end=np.array([end.get(n, 0.0) for n in self.tracked]),
            r=self.R.get(name, 0.0),
            s=self.S.get(name, 0.0),
            bounds=np.array([low, high]),
            steps=np.array([slow, fast]) * self.dt,
        )

    @cached_property
    def solver(self) -> Solver:
        """The compiled solver or, without a compiler, NumPy and DAQP."""
        with BUILDING:
            if "solver" not in vars(self):
                solver = build(self.problem, self.numbers)
                if isinstance(solver, Continues):
                    solver.expect(*self._judge.ranges)
                vars(self)["solver"] = solver
            return vars(self)["solver"]

    @cached_property
    def numbers(self) -> Numbers:
        """Coefficients of the models and their speeds."""
        A, B, c = self.blended.coefficients
        return Numbers(speeds=np.array(self.blended.speeds, dtype=float), A=A, B=B, c=c)

    # ---- planning ------------------------------------------------------------------------------------------------

    def plan(
        self,
        x: np.ndarray,
        reference: Reference | Preview,
        previous: Plan | None = None,
        *,
        applied: np.ndarray | None = None,
    ) -> MultiARXPlan:
        """Plan from the state now.

        Parameters
        ----------
        x : array, shape (n_states,)
            State of the model now.
        reference : Reference or Preview
            Path ahead: columns X, Y, psi; the speed is exogenous.
        previous : Plan, optional
            The plan of the step before: last input, and fallback.
        applied : array, shape (1,), optional
            Input applied over the step before; by default the previous plan's command, else zero.

        Returns
        -------
        MultiARXPlan
            Never NaN, never outside limits and rates; `Plan.status` says how the solve ended.

        Raises
        ------
        ParameterError
            If an array has the wrong shape.
        """
        return self.plan_with(None, x, reference, previous, applied)

    def plan_with(
        self,
        numbers: Numbers | None,
        x: np.ndarray,
        reference: Reference | Preview,
        previous: Plan | None,
        applied: np.ndarray | None,
        memory: Any = None,
    ) -> MultiARXPlan:
        """`plan` with other coefficients than the model's, such as adapted ones; ``memory`` goes into the plan."""
        solver = self.solver
        begin = perf_counter()
        if type(reference) is Reference and not self.integral:
            found = self._again(numbers, x, reference, previous, applied, memory, begin)
            if found is not None:
                return found
        x = vector(x, self._states, "x")
        reference = self.check_reference(self.reference(reference) if isinstance(reference, Preview) else reference)
        require_plan(previous)
        before = self._before(previous, applied)
        v_x, path = reference.exogenous, reference.tracked
        speed = v_x.item(0)
        call = Call(x=x, speed=speed, previous=previous, before=before, begin=begin, memory=memory)
        wrong = self._judge.status(x, path, v_x)
        if wrong is not None:
            detail = self._judge.fault(x, path, v_x) if wrong is Status.IMPLAUSIBLE else ""
            return self._fallback(call, wrong, detail)
        if speed < SLOWEST:
            return self._fallback(call, Status.FAILED, STANDING, standing=True)
        offset = self._offset(x, previous) if self.integral and previous is not None else 0.0
        try:
            found = solver.solve(x, path, v_x, before, numbers, offset)
        except Exception as error:
            return self._fallback(call, Status.FAILED, str(error).partition("\n")[0] or type(error).__name__)
        if found.status is not Status.SOLVED or not finite(found.u, found.x):
            return self._fallback(call, Status.FAILED if found.status is Status.SOLVED else found.status)
        values = {
            "u": found.u,
            "x": found.x,
            "status": Status.SOLVED,
            "seconds": perf_counter() - begin,
            "cost": found.cost,
            "iterations": found.iterations,
            "controls": self.controls,
            "residual": found.residual,
            "memory": memory,
            "times": self.times,
            "health": health_of(previous).after(False, False),
            "weights": found.weights,
            "outside": not self._lowest <= speed <= self._highest,
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
        solver, before, health, speed = self._continues, 0.0, NEW, reference.exogenous
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
        if solver is None or type(speed) is not np.ndarray or speed.ndim != 2:
            return None
        v_x = speed if len(speed) == self.horizon else speed[: self.horizon]
        if not v_x.size or not (now := v_x.item(0)) >= SLOWEST:
            return None
        found = solver.again(x, reference.tracked, v_x, before, numbers)
        if found is None:
            return None
        found["controls"], found["times"], found["memory"] = self.controls, self.times, memory
        found["outside"] = not self._lowest <= now <= self._highest
        found["health"] = health.after(False, False)
        found["seconds"] = perf_counter() - begin
        return quick(MultiARXPlan, found)

    @cached_property
    def _continues(self) -> Continues | None:
        """The solver, where it judges by itself what the usual call is given."""
        return self.solver if isinstance(self.solver, Continues) else None

    @cached_property
    def _shape_u(self) -> tuple[int, int]:
        return self.horizon, 1

    def _offset(self, x: np.ndarray, previous: Plan) -> np.ndarray | float:
        """Sum of the believed prediction errors, from a fresh plan one step ago; zero after anything else."""
        if not (isinstance(previous, MultiARXPlan) and previous.age == 0 and is_numbers(previous.x, self._shape_x)):
            return 0.0
        ny = len(self.blended.outputs)
        offset = previous.offset + self.integral * (x - previous.x[1])[:ny]
        return offset if is_numbers(offset, (ny,)) and (np.abs(offset) < FARTHEST).all() else 0.0

    def _known(self, previous: Plan | None) -> bool:
        """Whether a plan's inputs are of this problem, and numbers."""
        return previous is not None and previous.controls == self.controls and is_numbers(previous.u, self._shape_u)

    @cached_property
    def _shape_x(self) -> tuple[int, int]:
        return self.horizon + 1, len(self._states)

    @cached_property
    def _states(self) -> tuple[str, ...]:
        return tuple(self.model.states)

    @cached_property
    def _judge(self) -> Judge:
        return Judge(self._states, POSE, self.exogenous, self.horizon, self.plausible)

    def is_plausible(self, x: np.ndarray, v_x: float) -> bool:
        """Whether a state and a speed [m/s] can be true."""
        return self._judge.states.holds(x) and abs(v_x) < FASTEST

    def check_reference(self, reference: Reference) -> Reference:
        """The reference as arrays of numbers in the shapes of this problem; the same one where it has them.

        Raises
        ------
        ParameterError
            With the array, its shape and the one expected.
        """
        require_reference(reference)
        tracked = array(reference.tracked, self._shape, POSE, "reference.tracked")
        speed = reference.exogenous  # perhaps with a row for the end, which counts nowhere here
        speed = speed[: self.horizon] if np.ndim(speed) == 2 and len(speed) == self.horizon + 1 else speed
        exogenous = array(speed, (self.horizon, 1), ("v_x",), "reference.exogenous")
        if tracked is reference.tracked and exogenous is reference.exogenous:
            return reference
        return Reference(tracked=tracked, exogenous=exogenous)

    @cached_property
    def _shape(self) -> tuple[int, int]:
        return self.horizon + 1, 3

    @cached_property
    def _lowest(self) -> float:
        return self.blended.speeds[0]

    @cached_property
    def _highest(self) -> float:
        return self.blended.speeds[-1]

    def _before(self, previous: Plan | None, applied: np.ndarray | None) -> float:
        """Input applied before, within bounds."""
        low, high = self._range
        last = last_input(previous, self.controls)
        given = 0.0 if last is None else last.item()
        if applied is not None:
            asked = applied_input(applied, self.controls).item()
            given = asked if abs(asked) <= ANY else given
        return min(max(given, low), high)

    @cached_property
    def _range(self) -> tuple[float, float]:
        low, high = self.problem.bounds
        return float(low), float(high)

    def _fallback(self, call: Call, status: Status, detail: str = "", *, standing: bool = False) -> MultiARXPlan:
        """The previous plan shifted, or the safe stop law; standing, the wheels stay where they are."""
        previous, before = call.previous, call.before
        age = 1 if previous is None else counted(previous.age) + 1
        known = self._known(previous)
        left = min(self.fallback, self.horizon - 1) if known and previous is not None and not previous.stopping else 0
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
        speed = call.speed if abs(call.speed) < FASTEST else self._lowest
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
            detail=detail,
            memory=call.memory,
            times=self.times,
            health=health_of(previous).after(True, False),
            weights=np.array(self.blended.weights(speed), dtype=float),
            outside=not self._lowest <= call.speed <= self._highest,
        )


class Call(NamedTuple):
    """One call of `MultiARXMPC.plan`: what was given, checked, and when."""

    x: np.ndarray
    speed: float
    previous: Plan | None
    before: float
    begin: float
    memory: Any


def _checked_knots(knots: Sequence[int], horizon: int) -> tuple[int, ...]:
    """Knots as whole numbers.

    Raises
    ------
    ParameterError
        If they do not begin with 0, do not grow, or reach beyond the horizon.
    """
    given = list(knots)
    whole = all(isinstance(k, int | np.integer) for k in given)
    if not (whole and given[:1] == [0] and all(a < b for a, b in pairwise(given)) and given[-1] < horizon):
        raise ParameterError(
            f"knots is {str(given)[:60]}; expected growing whole numbers from 0 to at most {horizon - 1}, the last step"
        )
    return tuple(int(k) for k in given)
