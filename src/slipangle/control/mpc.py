"""`MPC`: an optimal control problem solved again at every step, and what to do when that fails."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import isnan, nan
from time import perf_counter
from typing import Any, Literal, NamedTuple

import numpy as np

from slipangle.errors import ParameterError
from slipangle.numerics.per_thread import BUILDING
from slipangle.optimal.arrays import applied_input, vector
from slipangle.optimal.checks import MOST, Judge, believable, counted, health_of, is_numbers, last_input, require_plan
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.ocp import OCP, Reference
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.solution import (
    Backend,
    Bounds,
    Continues,
    Engine,
    Follows,
    Health,
    Kept,
    Plan,
    Prepares,
    Rescues,
    Resumes,
    Solution,
    Start,
    Status,
    finite,
    inputs_later,
    quick,
    shifted,
    states_later,
    within,
)
from slipangle.optimal.terms import Limits, Values, coerce, require_names
from slipangle.paths.path import Preview

FEASIBLE = 1e-6  # an unfinished answer with no larger constraint violation is still a plan
RELAX = 0.5  # s, time constant of the safe stop law


@dataclass(frozen=True, eq=False)
class MPC(OCP):
    """Model predictive controller: `OCP` with a solver, a deadline and a fallback.

    When a solve fails, runs out of time, or the state is no number or far outside what it can be, the plan is the
    previous one shifted by a step, at most `fallback` times in a row; after that, or with no previous plan, the safe
    stop law: every input relaxes to its `safe` value within about half a second. Whatever its source, a command is
    finite and within limits and rates, and a failed solve leaves no trace in the next one's start. `Plan.health` counts
    what went wrong.

    Parameters
    ----------
    solver : {"ipopt", "realtime"} or Backend
        The solver, or its settings, such as ``Ipopt(tolerance=1e-6)`` or ``RealTime(iterations=2)``.
    deadline : float, optional
        Longest wall time of one call of `plan`; the solver ends early enough for a fallback. [s]
    fallback : int
        How many steps in a row a shifted plan may serve; never more than the plan has left.
    safe : Values
        Inputs of the safe stop law, such as brake torque; by default zero, or the limit nearest to it.
    plausible : Limits
        Ranges of states, references and exogenous inputs beyond which a value is taken for a fault; by default twice
        the largest size of the standard channel of that name, 1e7 m for positions, 1e12 for names of your own.

    The others are those of `OCP`.
    """

    solver: Literal["ipopt", "realtime"] | Backend = "ipopt"
    deadline: float | None = None
    fallback: int = 5
    safe: Values = field(default_factory=Values)
    plausible: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        coerce(self, Values, "safe")
        coerce(self, Limits, "plausible")
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
        known = (*self.model.states, *self.references, *self.exogenous)
        require_names(self.plausible, known, "plausible", "use a state, a tracked quantity or an exogenous input")

    @cached_property
    def _engine(self) -> Engine:
        named: dict[str, Backend] = {"ipopt": Ipopt(), "realtime": RealTime()}
        backend = named[self.solver] if isinstance(self.solver, str) else self.solver
        with BUILDING:
            if "_engine" not in vars(self):
                engine = backend.build(self, self.deadline)
                if isinstance(engine, Continues):
                    engine.expect(*self._judge.ranges)
                if isinstance(engine, Rescues):
                    engine.relax(self._safe_input, self._relaxing.ravel())
                vars(self)["_engine"] = engine
                _ = self._resumes, self._continues, self._rescues, self._follows, self._bounds  # looked at by no plan
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
            wanted = self.check_reference(wanted)
            require_plan(previous)
            known = self._known(previous)
            if known is not None and is_numbers(known.x, self._shape_x) and _others_finite(wanted):
                expected = known.x[1]
                if self._judge.status(expected, wanted.tracked, wanted.exogenous) is None:
                    engine.prepare(self._before(known, None), self._unwound(wanted, expected), known)

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
            Never NaN, never outside limits and rates, whatever the values; `Plan.status` says how the solve ended.

        Raises
        ------
        ParameterError
            If an argument has the wrong type, or an array the wrong shape.
        """
        _ = self._engine
        begin = perf_counter()
        if type(previous) is Plan and type(reference) is Reference:
            found = self._again(x, reference, previous, applied, begin)
            if found is None:
                found = self._lost(x, reference, previous, applied, begin)
            if found is not None:
                return found
        x = vector(x, self._states, "x")
        wanted = self.check_reference(self.reference(reference) if isinstance(reference, Preview) else reference)
        require_plan(previous)
        before = self._before(previous, applied)
        wrong = self._judge.status(x, wanted.tracked, wanted.exogenous)
        if wrong is None and not _others_finite(wanted):
            wrong = Status.NOT_FINITE
        call = Call(x, wanted, previous, before, begin, wrong is None)
        if wrong is not None:
            detail = self._judge.fault(x, wanted.tracked, wanted.exogenous) if wrong is Status.IMPLAUSIBLE else ""
            return self._fallback(call, wrong, detail=detail)
        if self._bounds is not None:
            self._bounds.allow(self._left(begin) - self._pace[0])
        try:
            solution = self._solve(x, self._unwound(wanted, x), self._known(previous), before)
        except Exception as error:  # a solver from outside may stop with any
            return self._fallback(call, Status.FAILED, detail=str(error).partition("\n")[0] or type(error).__name__)
        return self._ended(call, solution)

    # ---- the parts ---------------------------------------------------------------------------------------------

    def _again(
        self, x: np.ndarray, reference: Reference, previous: Plan, applied: np.ndarray | None, begin: float
    ) -> Plan | None:
        """The usual call, from the plan that the engine still holds, in as few steps as possible; None for others."""
        health, engine = previous.health, self._continues
        if engine is None or type(health) is not Health:
            return None
        left = None if self._bounds is None else self._left(begin) - self._pace[0]
        found = engine.again(x, reference, previous, applied, left)
        if found is None:
            return None
        if not found["status"].solved:
            call = Call(x=x, wanted=reference, previous=previous, before=self._before(previous, applied), begin=begin)
            return self._ended(call, Solution(**found))
        del found["kept"]
        found["controls"], found["times"] = self.controls, self._times
        found["seconds"] = seconds = perf_counter() - begin
        found["health"] = health.after(False, self.deadline is not None and seconds > self.deadline)
        return quick(Plan, found)

    def _ended(self, call: Call, solution: Solution) -> Plan:
        """The plan of a solution, or a fallback where it is none."""
        previous, before, status = call.previous, call.before, solution.status
        begun = status.unfinished and solution.iterations > 0 and solution.violation <= FEASIBLE
        if not (status.solved or begun):
            left = solution.memory if status.resumes else None
            return self._fallback(call, status, solution.iterations, unfinished=left)
        if not finite(solution.u, solution.x):
            return self._fallback(call, Status.NOT_FINITE if status.solved else status, solution.iterations)
        seconds = perf_counter() - call.begin
        values = {
            "u": solution.u if solution.kept else within(solution.u, before, self.input_bounds, self.step_bounds),
            "x": solution.x,
            "status": status,
            "cost": solution.cost,
            "iterations": solution.iterations,
            "controls": self.controls,
            "residual": solution.residual,
            "violation": solution.violation,
            "memory": solution.memory,
            "times": self.times,
            "health": health_of(previous).after(False, self._late(seconds)),
            "seconds": seconds,
        }
        return quick(Plan, values)

    @cached_property
    def _safe_input(self) -> np.ndarray:
        wanted = np.array([self.safe.get(n, 0.0) for n in self.controls])
        return np.clip(wanted, self.input_bounds[:, 0], self.input_bounds[:, 1])

    @cached_property
    def _rest(self) -> np.ndarray:
        return np.clip(np.zeros(len(self.controls)), self.input_bounds[:, 0], self.input_bounds[:, 1])

    @cached_property
    def _states(self) -> tuple[str, ...]:
        return tuple(self.model.states)

    @cached_property
    def _judge(self) -> Judge:
        return Judge(self._states, self.references, self.exogenous, self.horizon, self.plausible)

    @cached_property
    def _continues(self) -> Continues | None:
        """The engine, where it judges by itself what the usual call is given."""
        return self._engine if isinstance(self._engine, Continues) else None

    @cached_property
    def _bounds(self) -> Bounds | None:
        """The engine, where there is a deadline that it can be told of."""
        return self._engine if self.deadline is not None and isinstance(self._engine, Bounds) else None

    @cached_property
    def _rescues(self) -> Rescues | None:
        """The engine, where it does fallbacks by itself."""
        return self._engine if isinstance(self._engine, Rescues) else None

    @cached_property
    def _follows(self) -> Follows | None:
        return self._engine if isinstance(self._engine, Follows) else None

    @cached_property
    def _pace(self) -> list[float]:
        """What a fallback needs after a solve: a mean of those seen. [s]"""
        return [min(5e-5, 0.5 * (self.deadline or 0.0))]

    def _left(self, begin: float) -> float:
        """Time left of a call. [s]"""
        return np.inf if self.deadline is None else self.deadline - (perf_counter() - begin)

    def _late(self, seconds: float) -> bool:
        return self.deadline is not None and seconds > self.deadline

    def _known(self, previous: Plan | None) -> Plan | None:
        """The plan before, if its inputs are of this problem and numbers."""
        if previous is None or previous.controls != self.controls or not is_numbers(previous.u, self._shape_u):
            return None
        return previous

    @cached_property
    def _longest(self) -> int:
        """How many shifted plans in a row there can be."""
        return min(self.fallback, int(self.nodes[-1]) - 1)

    @cached_property
    def _shape_u(self) -> tuple[int, int]:
        return self.horizon, len(self.controls)

    @cached_property
    def _shape_x(self) -> tuple[int, int]:
        return self.horizon + 1, len(self._states)

    def _before(self, previous: Plan | None, applied: np.ndarray | None) -> np.ndarray:
        """Input applied before, within bounds."""
        low, high = self._input_range
        last = last_input(previous, self.controls)
        given = self._rest if last is None else last
        if applied is not None:
            asked = applied_input(applied, self.controls)
            given = asked if believable(asked) else given
        return np.minimum(np.maximum(given, low), high)

    @cached_property
    def _input_range(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = self.input_bounds.T.copy()
        return low, high

    def _unwound(self, wanted: Reference, x: np.ndarray) -> Reference:
        """The reference with its heading on the turn nearest to the vehicle's."""
        if self.headings is None:
            return wanted
        here, column = self.headings
        turns = np.round((x[here] - wanted.tracked[0, column]) / (2 * np.pi))
        if turns == 0:
            return wanted
        tracked = np.array(wanted.tracked, dtype=float)
        tracked[:, column] += 2 * np.pi * turns
        return Reference(tracked=tracked, exogenous=wanted.exogenous, inputs=wanted.inputs, corridor=wanted.corridor)

    def _solve(self, x: np.ndarray, wanted: Reference, previous: Plan | None, before: np.ndarray) -> Solution:
        if self._resumes is not None:
            return self._resumes.resume(x, before, wanted, previous)
        engine, memory = self._engine, None
        if previous is None:
            u = np.tile(before, (self.horizon, 1))
            states = self._roll_out(x, u, wanted)
        else:
            u = within(inputs_later(previous.u, self.lengths), before, self.input_bounds, self.step_bounds)
            known = is_numbers(previous.x, self._shape_x)
            if self.horizon > 1 and known:
                states = states_later(previous.x, self.nodes)
                states[0] = x
                states[-1] = np.asarray(
                    self.dynamics(previous.x[-1], u[-1], wanted.exogenous[self.horizon - 1])
                ).ravel()
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

    def _lost(
        self, x: np.ndarray, reference: Reference, previous: Plan, applied: np.ndarray | None, begin: float
    ) -> Plan | None:
        """The usual fallback, for a state that is no number, in as few steps as possible; None for other calls."""
        engine, u, health, age = self._rescues, previous.u, previous.health, previous.age
        if engine is None or type(health) is not Health or type(age) is not int or not 0 <= age < MOST:
            return None
        before = engine.lost(x, reference, u, applied)
        if before is None or previous.controls != self.controls:
            return None
        if self._bounds is not None:
            self._bounds.allow(self._left(begin))
        source = self._source(previous)
        found = self._rescued(previous, None, before, reference, source)
        return None if found is None else self._fallen(begin, health, found, Status.NOT_FINITE, source)

    def _fallback(
        self, call: Call, status: Status, iterations: int = 0, detail: str = "", unfinished: Any = None
    ) -> Plan:
        """The last good plan shifted, or the safe stop law."""
        begun, previous = perf_counter(), call.previous
        source = self._source(previous)
        known = call.x if call.sound or self._judge.states.holds(call.x) else None
        if self._bounds is not None:
            self._bounds.allow(self._left(call.begin))
        found = self._rescued(previous, known, call.before, call.wanted, source) or self._predict(call, known, source)
        if self.deadline is not None:
            needed = min(perf_counter() - begun, 2.0 * self._pace[0])  # not what another program took away
            self._pace[0] = min(0.8 * self._pace[0] + 0.2 * needed, 0.5 * self.deadline)
        return self._fallen(call.begin, health_of(previous), found, status, source, iterations, detail, unfinished)

    def _source(self, previous: Plan | None) -> Source:
        """Which fallback in a row this is, and what it follows; None for the stop law."""
        age = 1 if previous is None else counted(previous.age) + 1
        kept = self._kept(previous, age) if age <= self._longest else None
        return age, kept

    def _fallen(
        self,
        begin: float,
        health: Health,
        found: tuple[np.ndarray, np.ndarray],
        status: Status,
        source: Source,
        iterations: int = 0,
        detail: str = "",
        unfinished: Any = None,
    ) -> Plan:
        """The plan of a fallback."""
        age, kept = source
        seconds = perf_counter() - begin
        values = {
            "u": found[0],
            "x": found[1],
            "status": status,
            "seconds": seconds,
            "cost": nan,
            "iterations": iterations,
            "controls": self.controls,
            "age": age,
            "stopping": kept is None,
            "detail": detail,
            "memory": kept,
            "unfinished": unfinished,
            "times": self._times,
            "health": health.after(True, self.deadline is not None and seconds > self.deadline),
        }
        return quick(Plan, values)

    @cached_property
    def _relaxing(self) -> np.ndarray:
        return np.exp(-self.times[1:, None] / RELAX)

    def _rescued(
        self, previous: Plan | None, x: np.ndarray | None, before: np.ndarray, wanted: Reference, source: Source
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Inputs of a fallback and where they lead, all by the engine, where that can and the plan before is whole."""
        engine, (age, kept) = self._rescues, source
        if engine is None:
            return None
        if previous is None:
            return None if x is None else engine.rescue(x, before, wanted, *self._nothing(x), 0, True)
        if kept is None:
            return engine.rescue(x, before, wanted, previous.u, previous.x, 1, True)
        return engine.rescue(x, before, wanted, kept.u, kept.x, age - kept.age, False)

    def _nothing(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inputs and states of a vehicle that stays as it is."""
        return np.zeros(self._shape_u), np.broadcast_to(x, self._shape_x)

    def _predict(self, call: Call, x: np.ndarray | None, source: Source) -> tuple[np.ndarray, np.ndarray]:
        """Inputs of a fallback within limits and rates, and where they lead: from the state if that is known."""
        age, kept = source
        if kept is None:
            u = self._safe_input + self._relaxing * (call.before - self._safe_input)
        else:
            later = age - kept.age
            u = shifted(kept.u, later) if self.steps is None else inputs_later(kept.u, self.lengths, later)
        guess, last = None, None if call.previous is None else call.previous.x
        if kept is not None and is_numbers(kept.x, self._shape_x):
            guess = states_later(kept.x, self.nodes, age - kept.age)
        elif is_numbers(last, self._shape_x):
            guess = states_later(last, self.nodes)
        if x is None and (guess is None or kept is not None):  # what was predicted is all there is
            u = within(u, call.before, self.input_bounds, self.step_bounds)
            return u, np.zeros(self._shape_x) if guess is None else guess
        state: np.ndarray = guess[0] if x is None and guess is not None else call.x
        guess = np.tile(state, (self.horizon + 1, 1)) if guess is None else guess
        if self._follows is not None:
            u, states = self._follows.follow(state, call.before, call.wanted, u, guess)
        else:
            u = within(u, call.before, self.input_bounds, self.step_bounds)
            states = self._roll_out(state, u, call.wanted)
        return u, states if finite(states) else guess

    def _kept(self, previous: Plan | None, age: int) -> Kept | None:
        """The good plan behind the one before, if it is of this problem."""
        if previous is None or previous.stopping:
            return None
        kept = previous.memory
        if not isinstance(kept, Kept):
            kept = quick(Kept, {"u": previous.u, "x": previous.x, "age": counted(previous.age)})
        if previous.controls != self.controls or not 0 <= kept.age < age:
            return None
        if not is_numbers(kept.u, self._shape_u):
            return None
        times = previous.times
        same = times is None or times is self.times or is_numbers(times, self.times.shape)
        if same and times is not None and times is not self.times:
            same = bool((times == self.times).all()) or np.allclose(times, self.times)
        return kept if same else None


Source = tuple[int, Kept | None]  # of a fallback: which one in a row, and the plan it follows; None: the stop law


class Call(NamedTuple):
    """One call of `MPC.plan`: what was given, checked, and when."""

    x: np.ndarray
    wanted: Reference
    previous: Plan | None
    before: np.ndarray
    begin: float
    sound: bool = True  # nothing in x or the reference is a fault


def _others_finite(reference: Reference) -> bool:
    """Whether wanted inputs are numbers and the corridor nowhere NaN."""
    inputs, corridor = reference.inputs, reference.corridor
    return (inputs is None or finite(inputs)) and (corridor is None or not isnan(np.vdot(corridor, corridor)))
