"""What an optimal control problem needs to be solved at every step: its engine, and a plan for when that fails."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import nan
from time import perf_counter
from typing import Annotated, Any, Literal, NamedTuple, Unpack

import numpy as np

from slipangle.control.call import applied_before, both
from slipangle.control.controller import Led
from slipangle.errors import ParameterError, shown
from slipangle.fields import Checked, Whole, Within
from slipangle.models.model import Model
from slipangle.numerics.per_thread import built
from slipangle.optimal.checks import MOST, counted, health_of, is_numbers
from slipangle.optimal.engine import Backend, Engine, Followed
from slipangle.optimal.named import backend_of, require_solver
from slipangle.optimal.ocp import OCP, ProblemSettings, Reference
from slipangle.optimal.solution import (
    ANEW,
    Health,
    Kept,
    Plan,
    Status,
    finite,
    inputs_later,
    quick,
    shifted,
    states_later,
    within,
)
from slipangle.optimal.terms import Limits, Values, coerce, require_names

RELAX = 0.5  # s, time constant of the safe stop law
Source = tuple[int, Kept | None]  # of a fallback: which one in a row, and the plan it follows; None: the stop law


class Call(NamedTuple):
    """One call of `MPC.plan`: what was given, checked, and when."""

    x: np.ndarray
    wanted: Reference
    previous: Plan | None
    before: np.ndarray
    begin: float
    sound: bool = True  # nothing in x or the reference is a fault
    doubt: str = ""  # of the input applied, which cannot be true


@dataclass(frozen=True, eq=False, init=False)
class Fallbacks(Checked, Led):
    """A problem, its engine, and plans that need no solve: the one before shifted, or the safe stop law; see `MPC`."""

    _explained_by = (OCP,)
    ocp: OCP
    solver: Literal["realtime", "ipopt"] | Backend
    deadline: Annotated[float, Within(0, unit="s", open="low")] | None
    fallback: Whole
    safe: Values
    plausible: Limits

    def __init__(
        self,
        model: Model | None = None,
        *,
        ocp: OCP | None = None,
        solver: Literal["realtime", "ipopt"] | Backend = "realtime",
        deadline: float | None = None,
        fallback: int = 5,
        safe: Values | Mapping[str, float] | None = None,
        plausible: Limits | Mapping[str, Any] | None = None,
        **problem: Unpack[ProblemSettings],
    ) -> None:
        posed: dict[str, Any] = {**problem} if model is None else {"model": model, **problem}
        require_names(problem, ProblemSettings.__annotations__, f"{type(self).__name__}(...)", "use a setting of OCP")
        if ocp is None:
            ocp = OCP(**posed)
        elif not isinstance(ocp, OCP):
            raise ParameterError(
                f"ocp is {shown(ocp)}; expected an OCP: say MPC(model, horizon=..., Q=...) without one"
            )
        elif posed:
            ocp = replace(ocp, **posed)
        safe = Values() if safe is None else safe
        plausible = Limits() if plausible is None else plausible
        settings = {"ocp": ocp, "solver": solver, "deadline": deadline, "fallback": fallback}
        for name, value in {**settings, "safe": safe, "plausible": plausible}.items():
            object.__setattr__(self, name, value)
        coerce(self, Values, "safe")
        coerce(self, Limits, "plausible")
        require_solver(solver)
        self.__post_init__()
        require_names(self.safe, ocp.controls, "safe", "use a decided input")
        for name, value in self.safe.items():
            low, high = ocp.input_bounds[ocp.controls.index(name)]
            if not low <= value <= high:
                raise ParameterError(
                    f"safe is {value:g} for '{name}', whose limits are {low:g} and {high:g}; expected one within them"
                )
        known = (*ocp.model.states, *ocp.references, *ocp.exogenous)
        require_names(self.plausible, known, "plausible", "use a state, a tracked quantity or an exogenous input")

    def _entries(self) -> Iterator[tuple[str, Any, Any]]:
        yield from self.ocp._entries()
        yield from (entry for entry in super()._entries() if entry[0] != "ocp")

    @property
    def leader(self) -> OCP:
        """The problem, whose names and times are the controller's."""
        return self.ocp

    @property
    def model(self) -> Model:
        """What predicts."""
        return self.ocp.model

    @built
    def _engine(self) -> Engine:
        backend = backend_of(self.solver)
        if self.ocp.composed and not getattr(backend, "composes", False):
            raise ParameterError(
                f"{shown(backend)} cannot know the problem's scenarios, free parameters or Huber costs; expected a "
                "problem without, or a solver that says that it `composes` them, such as RealTime()"
            )
        engine = backend.build(self.ocp, self.deadline)
        engine.expect(*self._judge.ranges)
        engine.relax(self._safe_input, self._relaxing.ravel())
        return engine

    @property
    def engine(self) -> Engine:
        """The solver built for this problem; that of `RealTime` has the `timing` of its last solve."""
        return self._engine

    # ---- sizes, ranges, and what the engine can do -------------------------------------------------------------

    @cached_property
    def _safe_input(self) -> np.ndarray:
        wanted = np.array([self.safe.get(n, 0.0) for n in self.controls])
        return np.clip(wanted, self.ocp.input_bounds[:, 0], self.ocp.input_bounds[:, 1])

    @cached_property
    def _rest(self) -> np.ndarray:
        return np.clip(np.zeros(len(self.controls)), self.ocp.input_bounds[:, 0], self.ocp.input_bounds[:, 1])

    @cached_property
    def _pace(self) -> list[float]:
        """What a fallback needs after a solve: a mean of those seen. [s]"""
        return [min(5e-5, 0.5 * (self.deadline or 0.0))]

    def _left(self, begin: float) -> float:
        """Time left of a call. [s]"""
        return np.inf if self.deadline is None else self.deadline - (perf_counter() - begin)

    @cached_property
    def _longest(self) -> int:
        """How many shifted plans in a row there can be."""
        return min(self.fallback, int(self.ocp.nodes[-1]) - 1)

    def _before(self, previous: Plan | None, applied: np.ndarray | None) -> np.ndarray:
        """Input applied before, within bounds."""
        return applied_before(previous, applied, self.controls, self._rest, *self._input_range)

    @cached_property
    def _input_range(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = self.ocp.input_bounds.T.copy()
        return low, high

    def _known(self, previous: Plan | None) -> Plan | None:
        """The plan before, if its inputs are of this problem and numbers."""
        if previous is None or previous.controls != self.controls or not is_numbers(previous.u, self._shape_u):
            return None
        return previous

    def _roll_out(self, x: np.ndarray, u: np.ndarray, wanted: Reference) -> np.ndarray:
        states = np.empty((self.horizon + 1, len(x)))
        states[0] = x
        for i in range(self.horizon):
            after = states[i]
            for _ in range(self.ocp.lengths[i]):
                after = np.asarray(self.ocp.dynamics(after, u[i], wanted.exogenous[i])).ravel()
            states[i + 1] = after
        return states

    # ---- fallbacks ---------------------------------------------------------------------------------------------

    def _lost(
        self, x: np.ndarray, reference: Reference, previous: Plan, applied: np.ndarray | None, begin: float
    ) -> Plan | None:
        """The usual fallback, for a state that is no number, in as few steps as possible; None for other calls."""
        engine, u, health, age = self._engine, previous.u, previous.health, previous.age
        if type(health) is not Health or type(age) is not int or not 0 <= age < MOST:
            return None
        before = engine.lost(x, reference, u, applied)
        if before is None or previous.controls != self.controls:
            return None
        if self.deadline is not None:
            engine.allow(self._left(begin))
        source = self._source(previous)
        way = self._rescued(previous, None, before, reference, source)
        return None if way is None else self._fallen(begin, health, way, Status.NOT_FINITE, source)

    def _fallback(
        self, call: Call, status: Status, iterations: int = 0, detail: str = "", unfinished: Any = None
    ) -> Plan:
        """The last good plan shifted, or the safe stop law."""
        begun, previous = perf_counter(), call.previous
        source = self._source(previous)
        known = call.x if call.sound or self._judge.states.holds(call.x) else None
        if self.deadline is not None:
            self._engine.allow(self._left(call.begin))
        way = self._rescued(previous, known, call.before, call.wanted, source) or self._predict(call, known, source)
        if self.deadline is not None:
            needed = min(perf_counter() - begun, 2.0 * self._pace[0])  # not what another program took away
            self._pace[0] = min(0.8 * self._pace[0] + 0.2 * needed, 0.5 * self.deadline)
        said = both(detail, call.doubt)
        return self._fallen(call.begin, health_of(previous), way, status, source, iterations, said, unfinished)

    def _source(self, previous: Plan | None) -> Source:
        """Which fallback in a row this is, and what it follows; None for the stop law."""
        age = 1 if previous is None else counted(previous.age) + 1
        kept = self._kept(previous, age) if age <= self._longest else None
        return age, kept

    def _fallen(
        self,
        begin: float,
        health: Health,
        way: tuple[np.ndarray, np.ndarray],
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
            "u": way[0],
            "x": way[1],
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
            "times": self.times,
            "health": health.after(
                True, self.deadline is not None and seconds > self.deadline, detail.startswith(ANEW)
            ),
        }
        return quick(Plan, values)

    @cached_property
    def _relaxing(self) -> np.ndarray:
        return np.exp(-self.times[1:, None] / RELAX)

    def _rescued(
        self, previous: Plan | None, x: np.ndarray | None, before: np.ndarray, wanted: Reference, source: Source
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Inputs of a fallback and where they lead, all by the engine, where that can and the plan before is whole."""
        age, kept = source
        if previous is None:
            if x is None:
                return None
            followed = Followed(np.zeros(self._shape_u), np.broadcast_to(x, self._shape_x), 0, True)  # it stays
        elif kept is None:
            followed = Followed(previous.u, previous.x, 1, True)
        else:
            followed = Followed(kept.u, kept.x, age - kept.age, False)
        return self._engine.rescue(x, before, wanted, followed)

    def _predict(self, call: Call, x: np.ndarray | None, source: Source) -> tuple[np.ndarray, np.ndarray]:
        """Inputs of a fallback within limits and rates, and where they lead: from the state if that is known."""
        age, kept = source
        if kept is None:
            u = self._safe_input + self._relaxing * (call.before - self._safe_input)
        else:
            later = age - kept.age
            u = shifted(kept.u, later) if self.ocp.steps is None else inputs_later(kept.u, self.ocp.lengths, later)
        guess, last = None, None if call.previous is None else call.previous.x
        if kept is not None and is_numbers(kept.x, self._shape_x):
            guess = states_later(kept.x, self.ocp.nodes, age - kept.age)
        elif is_numbers(last, self._shape_x):
            guess = states_later(last, self.ocp.nodes)
        if x is None and (guess is None or kept is not None):  # what was predicted is all there is
            u = within(u, call.before, self.ocp.input_bounds, self.ocp.step_bounds)
            return u, np.zeros(self._shape_x) if guess is None else guess
        state: np.ndarray = guess[0] if x is None and guess is not None else call.x
        guess = np.tile(state, (self.horizon + 1, 1)) if guess is None else guess
        followed = self._engine.follow(state, call.before, call.wanted, u, guess)
        if followed is None:
            u = within(u, call.before, self.ocp.input_bounds, self.ocp.step_bounds)
            followed = u, self._roll_out(state, u, call.wanted)
        u, states = followed
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
