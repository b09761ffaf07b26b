"""`MPC`: an optimal control problem solved again at every step, and what to do when that fails."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import isnan
from time import perf_counter
from typing import Literal

import numpy as np

from slipangle.control.ipopt import Ipopt
from slipangle.control.ocp import OCP, Reference
from slipangle.control.plan import (
    Backend,
    Engine,
    Kept,
    Plan,
    Prepares,
    Resumes,
    Solution,
    Start,
    Status,
    finite,
    inputs_later,
    quick,
    states_later,
    within,
)
from slipangle.control.realtime import RealTime
from slipangle.control.terms import Values, require_names
from slipangle.control.threads import BUILDING
from slipangle.data.path import Preview
from slipangle.errors import ParameterError

FEASIBLE = 1e-6  # an unfinished answer with no larger constraint violation is still a plan
RELAX = 0.5  # s, time constant of the safe stop law


@dataclass(frozen=True, eq=False)
class MPC(OCP):
    """Model predictive controller: `OCP` with a solver, a deadline and a fallback.

    When a solve fails, runs out of time, or the state is not finite, the plan is the previous one shifted
    by a step, at most `fallback` times in a row; after that, or with no previous plan, the safe stop law:
    every input relaxes to its `safe` value within about half a second. Whatever its source, a command is
    finite and within limits and rates, and a failed solve leaves no trace in the next one's start.

    Parameters
    ----------
    solver : {"ipopt", "realtime"} or Backend
        The solver, or its settings, such as ``Ipopt(tolerance=1e-6)`` or ``RealTime(iterations=2)``.
    deadline : float, optional
        Longest wall time of one solve. [s]
    fallback : int
        How many steps in a row a shifted plan may serve; never more than the plan has left.
    safe : Values
        Inputs of the safe stop law, such as brake torque; by default zero, or the limit nearest to it.

    The others are those of `OCP`.
    """

    solver: Literal["ipopt", "realtime"] | Backend = "ipopt"
    deadline: float | None = None
    fallback: int = 5
    safe: Values = field(default_factory=Values)

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.solver, str) and self.solver not in ("ipopt", "realtime"):
            raise ParameterError(
                f'the solver is {self.solver!r}; expected "ipopt" or "realtime", or settings such as Ipopt()'
            )
        if self.deadline is not None and not self.deadline > 0:
            raise ParameterError(f"the deadline is {self.deadline} s; expected a positive time, or None")
        if self.fallback < 0:
            raise ParameterError(f"fallback is {self.fallback}; expected a number of steps of at least 0")
        require_names(self.safe, self.controls, "safe", "use a decided input")

    @cached_property
    def _engine(self) -> Engine:
        named: dict[str, Backend] = {"ipopt": Ipopt(), "realtime": RealTime()}
        backend = named[self.solver] if isinstance(self.solver, str) else self.solver
        with BUILDING:
            if "_engine" not in vars(self):
                vars(self)["_engine"] = backend.build(self, self.deadline)
            return vars(self)["_engine"]

    @cached_property
    def _resumes(self) -> Resumes | None:
        return self._engine if isinstance(self._engine, Resumes) else None

    @property
    def engine(self) -> Engine:
        """The solver built for this problem; that of `RealTime` has the `timing` of its last solve."""
        return self._engine

    def prepare(self, reference: Reference | Preview | None = None, previous: Plan | None = None) -> None:
        """Do now what the next `plan` can do without.

        Parameters
        ----------
        reference, previous : optional
            Of the next `plan`. A real-time solver then linearises around the plan before the state is known, so
            the next call of `plan` with the same two answers sooner; other solvers are only built, so that no
            plan counts that time as its own.
        """
        engine = self._engine
        if isinstance(engine, Prepares) and reference is not None and previous is not None:
            wanted = self.reference(reference) if isinstance(reference, Preview) else reference
            self.check_reference(wanted)
            if _is_finite(wanted) and previous.x.shape[0] > 1:
                engine.prepare(self._before(previous, None), self._unwound(wanted, previous.x[1]), previous)

    def plan(
        self,
        x: np.ndarray,
        reference: Reference | Preview,
        previous: Plan | None = None,
        *,
        applied: np.ndarray | None = None,
    ) -> Plan:
        """Plan from the state now.

        Parameters
        ----------
        x : array, shape (n_states,)
            State of the model now.
        reference : Reference or Preview
            What to do over the horizon; a look along a path is turned into one by `reference`.
        previous : Plan, optional
            The plan of the step before: warm start and fallback.
        applied : array, shape (n_controls,), optional
            Input applied over the step before; by default the previous plan's command, else zero.

        Returns
        -------
        Plan
            Never NaN, never outside limits and rates; `Plan.status` says how the solve ended.

        Raises
        ------
        ParameterError
            If an array has the wrong shape.
        """
        _ = self._engine
        begin = perf_counter()
        x = np.asarray(x, dtype=float).ravel()
        if len(x) != self.model.n_states:
            raise ParameterError(f"x has {len(x)} entries; expected {self.model.n_states}: {list(self.model.states)}")
        wanted = self.reference(reference) if isinstance(reference, Preview) else reference
        self.check_reference(wanted)
        before = self._before(previous, applied)
        if not (finite(x) and _is_finite(wanted)):
            return self._fallback(x, wanted, previous, before, Status.NOT_FINITE, 0, begin)
        try:
            solution = self._solve(x, self._unwound(wanted, x), previous, before)
        except RuntimeError as error:
            return self._fallback(x, wanted, previous, before, Status.FAILED, 0, begin, detail=str(error))
        status = solution.status
        begun = status.unfinished and solution.iterations > 0 and solution.violation <= FEASIBLE
        if not (status.solved or begun):
            return self._fallback(x, wanted, previous, before, status, solution.iterations, begin)
        if not finite(solution.u, solution.x):
            status = Status.NOT_FINITE if status.solved else status
            return self._fallback(x, wanted, previous, before, status, solution.iterations, begin)
        values = {
            "u": solution.u if solution.kept else within(solution.u, before, self.input_bounds, self.step_bounds),
            "x": solution.x,
            "status": status,
            "cost": solution.cost,
            "iterations": solution.iterations,
            "controls": self.controls,
            "residual": solution.residual,
            "memory": solution.memory,
            "times": self.times,
            "seconds": perf_counter() - begin,
        }
        return quick(Plan, values)

    # ---- the parts ---------------------------------------------------------------------------------------------

    @cached_property
    def _safe_input(self) -> np.ndarray:
        wanted = np.array([self.safe.get(n, 0.0) for n in self.controls])
        return np.clip(wanted, self.input_bounds[:, 0], self.input_bounds[:, 1])

    @cached_property
    def _rest(self) -> np.ndarray:
        return np.clip(np.zeros(len(self.controls)), self.input_bounds[:, 0], self.input_bounds[:, 1])

    def _before(self, previous: Plan | None, applied: np.ndarray | None) -> np.ndarray:
        """Input applied before, within bounds."""
        low, high = self._input_range
        given = self._rest if previous is None else previous.u[0]
        if applied is not None:
            asked = np.asarray(applied, dtype=float).ravel()
            given = asked if len(asked) != len(low) or finite(asked) else given
        if given.shape != low.shape:
            raise ParameterError(f"applied has {len(given)} entries; expected {len(low)}: {list(self.controls)}")
        return np.minimum(np.maximum(given, low), high)

    @cached_property
    def _input_range(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = self.input_bounds.T.copy()
        return low, high

    def _unwound(self, wanted: Reference, x: np.ndarray) -> Reference:
        """The reference with its heading on the turn nearest to the vehicle's."""
        if "psi" not in self.references or "psi" not in self.model.states:
            return wanted
        column = self.references.index("psi")
        turns = np.round((x[self.model.states.index("psi")] - wanted.tracked[0, column]) / (2 * np.pi))
        if turns == 0:
            return wanted
        tracked = np.array(wanted.tracked, dtype=float)
        tracked[:, column] += 2 * np.pi * turns
        return Reference(tracked=tracked, exogenous=wanted.exogenous, inputs=wanted.inputs, corridor=wanted.corridor)

    def _solve(self, x: np.ndarray, wanted: Reference, previous: Plan | None, before: np.ndarray) -> Solution:
        if self._resumes is not None:
            return self._resumes.resume(x, before, wanted, previous)
        engine, memory = self._engine, None
        if previous is None or previous.u.shape != (self.horizon, len(self.controls)):
            u = np.tile(before, (self.horizon, 1))
            states = self._roll_out(x, u, wanted)
        else:
            u = within(inputs_later(previous.u, self.lengths), before, self.input_bounds, self.step_bounds)
            states = states_later(previous.x, self.nodes)
            states[0] = x
            if self.horizon > 1:
                states[-1] = np.asarray(self.dynamics(previous.x[-1], u[-1], wanted.exogenous[-1])).ravel()
            else:
                states = self._roll_out(x, u, wanted)
            memory = previous.memory
        if not np.isfinite(states).all():
            states, memory = np.tile(x, (self.horizon + 1, 1)), None
        return engine.solve(Start(x=x, applied=before, reference=wanted, guess_u=u, guess_x=states, memory=memory))

    def _roll_out(self, x: np.ndarray, u: np.ndarray, wanted: Reference) -> np.ndarray:
        states = np.empty((self.horizon + 1, len(x)))
        states[0] = x
        for i in range(self.horizon):
            after = states[i]
            for _ in range(self.lengths[i]):
                after = np.asarray(self.dynamics(after, u[i], wanted.exogenous[i])).ravel()
            states[i + 1] = after
        return states

    def _fallback(
        self,
        x: np.ndarray,
        wanted: Reference,
        previous: Plan | None,
        before: np.ndarray,
        status: Status,
        iterations: int,
        begin: float,
        detail: str = "",
    ) -> Plan:
        """The last good plan shifted, or the safe stop law."""
        age = 1 if previous is None else previous.age + 1
        kept = self._kept(previous)
        left = 0 if kept is None else min(self.fallback, int(self.nodes[-1]) - 1)
        stopping = age > left
        if stopping or kept is None:
            keep = np.exp(-self.times[1:, None] / RELAX)
            u = self._safe_input + keep * (before - self._safe_input)
        else:
            u = inputs_later(kept.u, self.lengths, age - kept.age)
        u = within(u, before, self.input_bounds, self.step_bounds)
        shape = self.horizon + 1, len(x)
        if not stopping and kept is not None and kept.x.shape == shape:
            states = states_later(kept.x, self.nodes, age - kept.age)  # as was predicted; no time for more
        else:
            states = self._roll_out(x, u, wanted)
        if not np.isfinite(states).all():
            known = previous is not None and previous.x.shape == shape
            states = states_later(previous.x, self.nodes) if known and previous is not None else np.zeros(shape)
        return Plan(
            u=u,
            x=states,
            status=status,
            seconds=perf_counter() - begin,
            cost=float("nan"),
            iterations=iterations,
            controls=self.controls,
            age=age,
            stopping=stopping,
            detail=detail,
            memory=None if stopping else kept,
            times=self.times,
        )

    def _kept(self, previous: Plan | None) -> Kept | None:
        """The good plan behind the one before, if it is of this problem."""
        if previous is None or previous.stopping or previous.u.shape != (self.horizon, len(self.controls)):
            return None
        if previous.times is not None and not np.allclose(previous.times, self.times):
            return None
        if isinstance(previous.memory, Kept) and previous.memory.u.shape == previous.u.shape:
            return previous.memory
        return Kept(u=previous.u, x=previous.x, age=previous.age)


def _is_finite(reference: Reference) -> bool:
    """Whether nothing in a reference is NaN, and nothing but the corridor infinite."""
    inputs, corridor = reference.inputs, reference.corridor
    return (
        finite(reference.tracked, reference.exogenous)
        and (inputs is None or finite(inputs))
        and (corridor is None or not isnan(np.vdot(corridor, corridor)))
    )
