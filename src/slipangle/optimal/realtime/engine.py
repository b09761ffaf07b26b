"""The compiled solver of one problem, called with as little in between as possible."""

# Long: one work area: every method reads and writes the same memory of the C code.
from __future__ import annotations

import ctypes
import itertools
from dataclasses import dataclass
from math import isfinite
from time import perf_counter
from typing import Any, TypeGuard

import numpy as np

from slipangle.codegen.struct import Struct
from slipangle.optimal.arrays import DOUBLE
from slipangle.optimal.checks import misses_after, stuck, written
from slipangle.optimal.engine import Engine, EngineOfThreads, Followed, Start
from slipangle.optimal.joined import Joined
from slipangle.optimal.ocp import OCP, Reference
from slipangle.optimal.realtime.curvature import in_the_way
from slipangle.optimal.realtime.last_steps import UNFOUND, LastSteps, better, hand_over, kept, leaves, saved
from slipangle.optimal.realtime.parts import implicit, limit_rows, slack_of_rows
from slipangle.optimal.realtime.program import COUNTS, FIELDS
from slipangle.optimal.solution import (
    ANEW,
    CURVED,
    MOST_ATTEMPTS,
    RETRIES,
    Plan,
    Solution,
    Status,
    between,
    finite,
    inputs_later,
    quick,
)

OUTCOMES = [
    Status[name] for name in "SOLVED REAL_TIME ITERATION_LIMIT STALLED TIME_OUT INFEASIBLE NOT_FINITE FAILED".split()
]
RESUMED = {i for i, status in enumerate(OUTCOMES) if status.resumes}
ENDED = {OUTCOMES.index(status) for status in UNFOUND}
DOUBTFUL = len(OUTCOMES)
CONTINUE, FROM_NOTHING, GIVEN, GIVEN_INPUTS, RESUME, RETRY, HANDED_OVER = range(7)


@dataclass(eq=False)
class Memory:
    """What the next start needs: all that a solve found, the integrator's stage slopes and the working rows too.

    ``owner`` is the `OCP.identity` of the problem, ``area`` the work area that still holds all this if its ``serial``
    is the same. ``unfinished`` counts the solves in a row that have not got to their end from here.
    """

    serial: int
    owner: str
    found: np.ndarray
    area: int = -1
    unfinished: int = 0

    def __getstate__(self) -> dict[str, Any]:
        """Of a copy, which no work area holds."""
        return {**vars(self), "area": -1}


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Time spent inside the compiled code by the last solve, by the monotonic clock. [s]"""

    total: float
    prepare: float
    feedback: float


def _block(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """The doubles of a work area from those of one array to those of another."""
    start = first.ctypes.data
    size = (last.ctypes.data - start) // 8 + last.size
    block: Any = (ctypes.c_double * size).from_address(start)
    return np.frombuffer(block)


_areas = itertools.count()  # no number is given twice, so that none is ever taken for another


class WorkArea(Engine):
    """One thread's memory of the compiled solver; see `CompiledEngine`."""

    def __init__(
        self, ocp: OCP, library: ctypes.CDLL, settings: Any, deadline: float | None, last: LastSteps | None = None
    ) -> None:
        # Long: every array of the C code is named and shaped once.
        self.ocp = ocp
        self._library = library
        self._call, self._call_again, self._call_fallback = library.rt_solve, library.rt_again, library.rt_fallback
        n, nx, nu = ocp.horizon, ocp.model.n_states, len(ocp.controls)
        parts, steps, limits = implicit(ocp), int(ocp.nodes[-1]), len(limit_rows(ocp))
        shapes: dict[str, tuple[int, ...]] = {
            "x0": (nx,),
            "applied": (nu,),
            "w": (n + 1, len(ocp.exogenous)),
            "p": (n + 1, len(ocp.references)),
            "r": (n, nu),
            "corridor": (n + 1, 2),
            "bounds": (n + 1, len(ocp.limited), 2),
            "q": (n + 1, len(ocp.tracked)),
            "wr": (n, nu),
            "ws": (n, nu),
            "lowest": (nx + len(ocp.references) + len(ocp.exogenous),),
            "highest": (nx + len(ocp.references) + len(ocp.exogenous),),
            "safe": (nu,),
            "relaxing": (n,),
            "way_u": (n, nu),
            "way_x": (n + 1, nx),
            "begun_u": (n, nu),
            "pi": (steps + 1, nx),
            "qp.lambda": (n * nu + int(np.isfinite(ocp.step_bounds).any(axis=2).sum()) + limits,),
            "plain": (limits,),
            "square": (limits,),
            "u": (n, nu),
            "x": (steps + 1, nx),
            "k": (steps + 1, 3 * len(parts.core) if parts else 0),
        }
        self._struct = Struct(library, "rt", (*FIELDS, *COUNTS), shapes, COUNTS)
        self._pointer, self._view = self._struct.pointer, self._struct.fields
        library.rt_begin(self._pointer)
        view = self._view
        self._x0, self._applied, self._w, self._p, self._r = (view[n] for n in ("x0", "applied", "w", "p", "r"))
        self._u, self._x, self._corridor = (view[n] for n in ("u", "x", "corridor"))
        self._iterations, self._anew, self._fresh = view["iterations"], view["anew"], view["fresh"]
        self._misses = view["misses"]
        self._way_u, self._way_x = view["way_u"], view["way_x"]
        self._way = _block(self._way_u, self._way_x)
        self._found = _block(view["u"], view["residual"])  # all of it starts a later solve
        at = (view["cost"].ctypes.data - view["u"].ctypes.data) // 8
        self._result = slice(at, at + 3)  # cost, violation, residual
        self._numbers = self._found[self._result]
        self._controls, self._parts_of_one = ocp.controls, isinstance(ocp, Joined)  # which begins from a guess
        self._shape_x0, self._shape_p, self._shape_w = self._x0.shape, self._p.shape, self._w.shape
        self._lanes, self._edges, self._owner = ocp.corridor is not None, self._corridor.shape, ocp.identity
        self._shape_u, self._shape_x = self._u.shape, self._x.shape
        self._head, self._rest, self._shape_way = slice(self._u.size), slice(self._u.size, None), self._way_x.shape
        view["q"][:], view["wr"][:], view["ws"][:] = ocp.stage_weights
        view["plain"][:], view["square"][:] = slack_of_rows(ocp)
        for name in ("tolerance", "newton", "accept", "max_iterations"):
            view[name][0] = getattr(settings, name)
        view["fixed"][0] = settings.iterations
        self._settings, self._last = settings, last
        view["hands_over"][0] = last is not None
        view["max_iterations"][0] -= 0 if last is None else saved(settings.max_iterations)
        self._limit = np.inf if deadline is None else deadline
        self._time = view["time_limit"]
        self._time[0] = self._limit
        if ocp.limited:
            view["bounds"][:] = ocp.limits_at_nodes  # a corridor narrows them in C
        self._varied = self._drawn = self._timed = False  # whether weights, inputs and time are other than usual
        self._given: np.ndarray | None = None  # the inputs of the last answer
        self._nodes = ocp.nodes if steps > n else None  # of the states, those at which stages begin and end
        self._most = int(ocp.nodes[-1])
        self._serial, self._area = 0, next(_areas)
        self._until: float | None = None
        self._ready: Memory | None = None

    def solve(self, start: Start) -> Solution:
        """Solve from a state and a guess; see `slipangle.optimal.solution.Start`."""
        self._ready = None
        self._set(start.x, start.applied, start.reference)
        self._u[:], self._x[:] = start.guess_u, between(start.guess_x, self.ocp.nodes)
        self._fresh[0], self._misses[0] = GIVEN, 0
        return self._run()

    def resume(
        self, x: np.ndarray, applied: np.ndarray, reference: Reference, previous: Plan | None
    ) -> Solution | None:
        """See `Engine`."""
        memory = previous.start if previous is not None else None
        ready, self._ready = self._ready, None
        if ready is not None and ready is memory and self._same(applied, reference):
            self._x0[:] = x
            return self._run(self._library.rt_feedback)
        self._set(x, applied, reference)
        self._misses[0] = misses_after(previous)
        if self._ours(memory):
            self._recall(memory)
            self._fresh[0] = self._goes_on(memory.unfinished)
            return self._run(attempts=memory.unfinished)
        elif previous is not None and previous.u.shape == self._u.shape and not stuck(previous):
            if written(previous, (len(self._u) + 1, len(self._x0))):
                return None
            self._u[:] = inputs_later(previous.u, self.ocp.lengths)
            self._fresh[0] = GIVEN_INPUTS
        else:
            self._fresh[0] = FROM_NOTHING
        return self._run()

    def expect(self, lowest: np.ndarray, highest: np.ndarray) -> None:
        """Ranges of states, then of the reference's columns; see `Engine`."""
        self._view["lowest"][:], self._view["highest"][:] = lowest, highest

    def again(
        self, x: np.ndarray, reference: Reference, previous: Plan, applied: np.ndarray | None, seconds: float | None
    ) -> dict[str, Any] | None:
        """Solve from the plan that this area still holds, if all that is given is as usual; else do nothing."""
        left, u, p, w = previous.unfinished, previous.u, reference.tracked, reference.exogenous
        memory = previous.memory if left is None else left
        if type(memory) is not Memory or memory.serial != self._serial or memory.area != self._area:
            return None
        attempts = memory.unfinished
        if type(u) is not np.ndarray or u.shape != self._shape_u or attempts > MOST_ATTEMPTS:
            return None
        if left is None and (attempts or u is not self._given):
            return None
        given = u[0] if applied is None else applied
        if not (previous.controls is self._controls and self._usual(x, reference, given)):
            return None
        if self._lanes:
            self._corridor[...] = reference.corridor
        self._x0[...], self._p[...], self._w[...], self._applied[...] = x, p, w, given
        if self._drawn:
            self._r.fill(0.0)
            self._drawn = False
        self._fresh[0], self._misses[0] = self._goes_on(attempts), 0
        if self._timed or seconds is not None:
            self._time[0] = self._limit if seconds is None else max(seconds, 0.0)
            self._timed = seconds is not None
        outcome = self._call_again(self._pointer)
        return None if outcome == DOUBTFUL else self._answer(outcome, attempts)

    def _goes_on(self, attempts: int) -> int:
        """How a solve begins after so many in a row that did not get to their end."""
        if attempts:
            return RESUME if attempts % RETRIES or self._parts_of_one else RETRY
        return CONTINUE

    def allow(self, seconds: float) -> None:
        """Longest time from now to the end of the next solve. [s]"""
        self._until = perf_counter() + seconds

    def _usual(self, x: Any, reference: Reference, given: Any) -> bool:
        """Whether all this is in the arrays that it nearly always is in."""
        p, w, edges = reference.tracked, reference.exogenous, reference.corridor
        if self._lanes and not (type(edges) is np.ndarray and edges.dtype is DOUBLE and edges.shape == self._edges):
            return False
        if self._varied or reference.inputs is not None or reference.varied:
            return False
        return (
            type(x) is type(p) is type(w) is type(given) is np.ndarray
            and x.dtype is p.dtype is w.dtype is given.dtype is DOUBLE
            and p.shape == self._shape_p
            and w.shape == self._shape_w
            and x.shape == self._shape_x0
            and given.shape == self._applied.shape
        )

    def lost(self, x: Any, reference: Reference, u: Any, applied: Any) -> np.ndarray | None:
        """The input applied, where the state is no number in a call that is otherwise as usual."""
        if type(u) is not np.ndarray or u.shape != self._shape_u:
            return None
        given = u[0] if applied is None else applied
        return given if self._usual(x, reference, given) and not isfinite(np.vdot(x, x)) else None

    def relax(self, safe: np.ndarray, left: np.ndarray) -> None:
        """Where the stop law goes, and how much is left of the way there at each stage."""
        self._view["safe"][:], self._view["relaxing"][:] = safe, left

    def rescue(
        self, x: np.ndarray | None, applied: np.ndarray, reference: Reference, followed: Followed
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """See `Engine`."""
        u, states, later, stopping = followed
        if not (type(u) is type(states) is np.ndarray and u.dtype is states.dtype is DOUBLE):
            return None
        if u.shape != self._shape_u or states.shape != self._shape_way:
            return None
        self._ready = None
        self._applied[...], self._way_u[...], self._way_x[...] = applied, u, states
        if x is not None or stopping:
            w = reference.exogenous
            self._w[: len(w)], self._w[-1] = w, w[-1]
        if x is not None:
            self._x0[...] = x
        self._hurry()
        good = self._call_fallback(self._pointer, later if later < self._most else self._most, stopping, x is not None)
        if not good:
            return None
        way = self._way.copy()
        return way[self._head].reshape(self._shape_u), way[self._rest].reshape(self._shape_way)

    def follow(
        self, x: np.ndarray, applied: np.ndarray, reference: Reference, u: np.ndarray, guess: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Inputs within limits and rates, and where they lead; near the guess where the model has no answer."""
        planned = Followed(np.array(u, dtype=float), np.array(guess, dtype=float), 0, False)
        way = self.rescue(x, applied, reference, planned)
        return (u, np.full_like(guess, np.nan)) if way is None else way

    def prepare(self, applied: np.ndarray, reference: Reference, previous: Plan) -> None:
        """Linearise and condense around a plan, shifted, before the state is known.

        A following `resume` from the same plan and reference then only solves the quadratic program.
        """
        memory = previous.memory
        if not self._ours(memory) or memory.unfinished or self._settings.iterations != 1 or reference.varied:
            return
        self._set(previous.x[1], applied, reference)
        self._recall(memory)
        if OUTCOMES[self._library.rt_prepare(self._pointer)] is Status.SOLVED:
            self._ready = memory
        self._serial += 1

    def _ours(self, memory: Any) -> TypeGuard[Memory]:
        """Whether a memory is of this problem and says something."""
        if not (isinstance(memory, Memory) and memory.owner == self.ocp.identity):
            return False
        known = memory.found.shape == self._found.shape and memory.unfinished <= MOST_ATTEMPTS
        return known and finite(memory.found[: self._result.start])

    def _recall(self, memory: Memory) -> None:
        if memory.area != self._area or memory.serial != self._serial:
            self._found[:] = memory.found

    def _same(self, applied: np.ndarray, reference: Reference) -> bool:
        inputs = 0.0 if reference.inputs is None else reference.inputs
        return bool(
            not reference.varied
            and (self._p == reference.tracked).all()
            and (self._w[:-1] == reference.exogenous[: len(self._r)]).all()
            and (self._w[-1] == reference.exogenous[-1]).all()
            and (self._applied == applied).all()
            and (self._r == inputs).all()
            and (not self._lanes or (self._corridor == reference.corridor).all())
        )

    @property
    def timing(self) -> Timing:
        """Time of the last solve inside the compiled code."""
        view = self._view
        return Timing(
            total=float(view["seconds"][0]),
            prepare=float(view["seconds_prepare"][0]),
            feedback=float(view["seconds_feedback"][0]),
        )

    @property
    def counts(self) -> dict[str, int]:
        """Iterations of the last solve and of its quadratic programs, and whether the last of those went by stages."""
        return {name: int(self._view[name][0]) for name in ("iterations", "qp_iterations", "by_stages")}

    def _set(self, x: np.ndarray, applied: np.ndarray, reference: Reference) -> None:
        self._x0[:] = x
        self._applied[:] = applied
        w = reference.exogenous  # with or without a row for the end
        self._w[:-1], self._w[-1] = w[: len(self._r)], w[-1]
        self._p[:] = reference.tracked
        self._drawn = reference.inputs is not None
        self._r[:] = 0.0 if reference.inputs is None else reference.inputs
        if self._lanes:
            self._corridor[:] = reference.corridor
        if self._varied or reference.varied:
            view, self._varied = self._view, reference.varied
            view["q"][:], view["wr"][:], view["ws"][:] = self.ocp.weights_for(reference)
            if self.ocp.limited:
                view["bounds"][:] = self.ocp.state_bounds(reference)

    def _hurry(self) -> None:
        """Give the next call into C what is left of the time allowed."""
        self._time[0] = self._limit if self._until is None else max(self._until - perf_counter(), 0.0)
        self._timed, self._until = self._until is not None, None

    def _run(self, call: Any = None, attempts: int = 0) -> Solution:
        self._hurry()
        return Solution(**self._answer((call or self._call)(self._pointer), attempts), kept=True)

    def _answer(self, outcome: int, attempts: int) -> dict[str, Any]:
        """A `Solution`, but that its inputs are kept within limits, as a dictionary."""
        if self._last is not None and outcome in ENDED:
            outcome = self._end(outcome)
        self._serial = serial = self._serial + 1
        status, resumes = OUTCOMES[outcome], outcome in RESUMED
        self._given = u = self._u.copy()
        cost, violation, residual = self._numbers.tolist()
        memory = {"serial": serial, "owner": self._owner, "found": self._found.copy(), "area": self._area}
        memory["unfinished"] = attempts + 1 if resumes else 0
        return {
            "u": u,
            "x": self._x.copy() if self._nodes is None else self._x[self._nodes],
            "status": status,
            "cost": cost,
            "iterations": self._iterations.item(),
            "violation": violation,
            "residual": residual,
            "memory": quick(Memory, memory),
            "detail": self._said(outcome) if outcome > 1 or self._anew.item() else "",
        }

    def _said(self, outcome: int) -> str:
        """That it began anew, and what may find the plan to convergence that these steps did not."""
        curved = self._settings.iterations == 0 and self._settings.hessian == "gauss-newton" and outcome in ENDED
        curved = curved and not in_the_way(self.ocp)
        return "; ".join(words for words, said in ((ANEW, self._anew.item()), (CURVED, curved)) if said)

    def _end(self, outcome: int) -> int:
        """Go on by the exact Hessian, and take what that leads to where it is better."""
        left = self._settings.max_iterations - self._iterations.item()
        if left < 1:
            return outcome
        engine: Any = None if self._last is None else self._last.engine
        if engine is None:
            return self._end_alone(outcome)
        other: WorkArea = engine.area
        mine, theirs, first = self._view, other._view, OUTCOMES[outcome]
        hand_over(mine, theirs, self.ocp, other.ocp)
        other._fresh[0] = HANDED_OVER
        whole = kept(first, float(self._numbers[1]))
        if not whole:  # from where that led nowhere, but from where it began
            theirs["u"][...], other._fresh[0] = mine["begun_u"], GIVEN_INPUTS
        theirs["max_iterations"][0], theirs["misses"][0] = left, mine["misses"][0]
        theirs["time_limit"][0] = max(self._time.item() - mine["seconds"].item(), 0.0)
        ended = other._call(other._pointer)
        for name in ("iterations", "qp_iterations", "seconds", "seconds_feedback"):
            mine[name] += theirs[name]
        here, there = (
            (status, float(area._numbers[0]), float(area._numbers[1]))
            for status, area in ((first, self), (OUTCOMES[ended], other))
        )
        if better(here, there):
            self._found[:] = other._found
            self._anew |= other._anew
            return ended
        return OUTCOMES.index(leaves(first, OUTCOMES[ended], found=whole))

    def _end_alone(self, outcome: int) -> int:
        """Go on by the same steps, as the problem has no exact Hessian."""
        self._last, self._view["hands_over"][0] = None, False
        done, most = self._iterations.item(), self._settings.max_iterations
        if OUTCOMES[outcome].unfinished:
            self._view["max_iterations"][0], self._fresh[0] = most - done, GIVEN
            self._time[0] = max(self._time.item() - self._view["seconds"].item(), 0.0)
            outcome = self._call(self._pointer)
            self._iterations += done
        self._view["max_iterations"][0] = most
        return outcome


class CompiledEngine(EngineOfThreads):
    """Engine on a loaded library, a work area for each thread; see `slipangle.optimal.realtime.program.source`."""

    def __init__(
        self, ocp: OCP, library: ctypes.CDLL, settings: Any, deadline: float | None, last: LastSteps | None = None
    ) -> None:
        super().__init__(lambda: WorkArea(ocp, library, settings, deadline, last))

    @property
    def area(self) -> WorkArea:
        """That of the thread that asks."""
        return self._areas.mine

    @property
    def timing(self) -> Timing:
        """Time of this thread's last solve inside the compiled code."""
        return self._areas.mine.timing

    @property
    def counts(self) -> dict[str, int]:
        """Iterations of this thread's last solve and of its quadratic programs; 1 `by_stages` if the last went so."""
        return self._areas.mine.counts
