"""The same algorithm without a compiler: CasADi's virtual machine for the model, NumPy and DAQP for the rest."""

# Long: one algorithm on one work area, in the order of its steps as in solver.c.
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter
from typing import Any, NamedTuple, TypeGuard

import numpy as np

from slipangle.codegen.expression import only
from slipangle.errors import ParameterError
from slipangle.optimal.checks import led_nowhere, misses_after, stuck, written
from slipangle.optimal.engine import Engine, EngineOfThreads, Start
from slipangle.optimal.joined import Joined
from slipangle.optimal.ocp import OCP, Reference
from slipangle.optimal.realtime.curvature import unfit
from slipangle.optimal.realtime.interpreted_curvature import Bent, Curvature, Tries, held_rows
from slipangle.optimal.realtime.interpreted_model import bind, columns, dense, inputs_of, newton_columns, newton_node
from slipangle.optimal.realtime.interpreted_qp import LimitedStep, secant
from slipangle.optimal.realtime.interpreted_step import InputStep
from slipangle.optimal.realtime.interpreted_truth import Promise, blurred, moves_on, outgrown, reach_of, units
from slipangle.optimal.realtime.last_steps import DEARER, IDLE, PATIENCE, UNFOUND, Tail, better, kept, leaves, saved
from slipangle.optimal.realtime.parts import (
    Implicit,
    dynamics_function,
    implicit,
    input_scale,
    jump_function,
    limit_rows,
    repeated_steps,
    stage_function,
)
from slipangle.optimal.solution import (
    ANEW,
    FEASIBLE,
    MOST_ATTEMPTS,
    RETRIES,
    Plan,
    Solution,
    Status,
    between,
    finite,
    inputs_later,
    shifted,
    within,
)

PAIRS, CALM = 24, 2  # remembered steps; iterations without a short one before they count
FLAT = 1e-6  # largest change of an input in units of its range whose effect on the cost may be lost in rounding
_CUT = Status.ITERATION_LIMIT, Status.TIME_OUT, Status.STALLED  # of a solve that may have a plan without its optimum
BY_ROUNDING = 1e-12  # largest change of an input that may be rounding alone, where it stays at its bound
ROUNDED = 1e-8  # largest change of an input by a whole step, before one that rounding makes useless
PRICES = 1e4  # largest price of a hard limit that no step keeps, over the first
SETTLED = 1e-5  # largest change of an input in units of its range after which missed limits may get a higher price
STAYED = 10  # steps in a row, at the highest price, that bring limits no nearer, after which they have no answer here
STRAINED = 10  # multiplier of a hard limit over a price that was paid, beyond which steps pay that rather than keep it
GAIN = 0.25  # share of what a whole step promised that it must bring, where limits have a price, to be damped less
TELLING = 1e-5  # of the merit, that no last step promises
FEW_STEPS = 5  # whole ones, after which a plan may still be far from where they began
FAR = 0.05  # largest change of an input in units of its range; below, remembered steps are what helps
Truth = tuple[float, float, float]  # cost, largest violation and residual of a plan
UNKNOWN: Truth = float("nan"), np.inf, np.inf
CONTENT = 10  # iterations with a line search, of real-time ones, after which a plan will do that keeps all constraints
NO_NEARER = 8  # such in a row that bring constraints no nearer, after which they had better fall back
NO_NEARER_PAID = 5  # the same where no step keeps the limits
GENTLE = 0.1  # most that the first step of such a start changes an input; a whole one lets the next go twice as far ...
FREE = 4.0  # ... and from here on as far as it likes
MORE = 30  # most of them, where full steps were not enough


@dataclass(kw_only=True, eq=False)
class Memory:
    """Inputs, states after every step of the model and stage slopes of the integrator, for the next start.

    Stage slopes have a row more, for the step after the last. ``unfinished`` counts the solves in a row that have not
    got to their end from here.
    """

    x: np.ndarray
    k: np.ndarray
    owner: str
    u: np.ndarray
    unfinished: int = 0


@dataclass(eq=False, slots=True)
class Iterate:
    """How iterations ended, and what is known of the iterate."""

    status: Status
    iterations: int
    cost: float = float("nan")
    violation: float = np.inf
    residual: float = np.inf


@dataclass(eq=False)
class Linear:
    """Everything known at one iterate: next states, errors, limited values and their derivatives."""

    next: np.ndarray
    A: np.ndarray
    B: np.ndarray
    e: np.ndarray
    limited: np.ndarray
    Ex: np.ndarray
    Eu: np.ndarray
    Lx: np.ndarray
    Lu: np.ndarray

    @property
    def finite(self) -> bool:
        """Whether it can be used."""
        return bool(np.isfinite(self.next).all() and np.isfinite(self.A).all() and np.isfinite(self.e).all())


class Functions(NamedTuple):
    """A problem's model for CasADi's virtual machine, which all threads share; ``quick`` is that of `InputStep`."""

    parts: Implicit | None
    node: Any
    node_values: Any
    stage: Any
    stage_values: Any
    quick: tuple[Any, Any, Any, Any] | None

    @classmethod
    def of(cls, ocp: OCP) -> Functions:
        """Build them."""
        parts, steps, stages = implicit(ocp), int(ocp.nodes[-1]), ocp.horizon + 1
        one = newton_node(ocp, parts) if parts else dense(dynamics_function(ocp, repeated_steps(ocp)))
        stage = dense(stage_function(ocp))
        limited = len(ocp.limited) or len(ocp.rated) or ocp.jumps
        node, values = (
            newton_columns(ocp, parts, only(one, results), steps)
            for results in (([0, 1, 2, 3], [0, 3]) if parts else ([0, 1, 2], [0]))
        )
        quick = None if limited else InputStep.functions(ocp, parts, one, stage)
        return cls(parts, node, values, columns(stage, stages), columns(only(stage, [0, 1]), stages), quick)


def _leads_on(found: Solution) -> bool:
    """Whether a solve ended at a plan that keeps hard limits, finished or not."""
    return found.status.solved or (found.status in _CUT and found.violation <= FEASIBLE)


def _still(found: Solution, before: Solution) -> Solution:
    """What was found last, with what was said before."""
    memory: Any = found.memory
    return replace(found, status=before.status, detail=before.detail, memory=replace(memory, unfinished=0))


class WorkArea(Engine):
    """One thread's memory of `InterpretedEngine`.

    States inside have a row per node, one after every step of the model; `OCP.nodes` are those of the stages.
    """

    def __init__(self, ocp: OCP, functions: Functions, settings: Any, deadline: float | None) -> None:
        self.ocp, self._settings = ocp, settings
        self._limit = self._allowed = np.inf if deadline is None else deadline
        n, _, nu = self._sizes = ocp.horizon, ocp.model.n_states, len(ocp.controls)
        self._parts, node, node_values, stage, stage_values, quick = functions
        self._nk = 3 * len(self._parts.core) if self._parts else 0
        self._steps = steps = int(ocp.nodes[-1])
        self._nodes, self._held = (ocp.nodes, ocp.stage_of) if steps > n else (slice(None), slice(None))
        self._node_in, self._stage_in = inputs_of(node, steps), inputs_of(stage, n + 1)
        self._node, self._node_values = (bind(f, steps, self._node_in) for f in (node, node_values))
        self._stage, self._stage_values = (bind(f, n + 1, self._stage_in) for f in (stage, stage_values))
        self._scale = input_scale(ocp)
        rows = limit_rows(ocp)
        self._limit_at = np.array([i for i, _ in rows], dtype=int), np.array([j for _, j in rows], dtype=int)
        self._qp = LimitedStep(ocp)
        self._plain, self._square, self._soft = self._qp.plain, self._qp.square, self._qp.soft
        change = np.eye(n * nu) - np.eye(n * nu, k=-nu)
        self._change, self._varied = change * np.tile(self._scale, n), False
        self._weigh(ocp.stage_weights)
        self._k = np.zeros((steps, self._nk))
        self._misses = 0  # fallbacks in a row before the last one, which was by missed limits
        self._shortened = False  # whether a step of a solve to convergence was
        self._most = settings.max_iterations  # iterations of this solve
        ends = settings.iterations == 0 and settings.hessian == "auto"
        self._hands_over = ends and not unfit(ocp)  # whether the exact Hessian's steps may be the last
        self._exact, self._left = False, (np.zeros(0), np.zeros(0))  # now; and the multipliers that the last step left
        self._jumps: Any = dense(jump_function(ocp)) if ocp.jumps else None
        self._quick = None if quick is None else InputStep(ocp, *quick)

    def _weigh(self, weights: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
        """Count errors, inputs and their changes so."""
        self._weight_rows, self._r, self._s = weights
        own = np.tile(self._scale, len(self._r)) ** 2 * self._r.ravel()
        self._quadratic = self._change.T @ (self._s.reshape(-1, 1) * self._change) + np.diag(own)

    # ---- starts ------------------------------------------------------------------------------------------------

    @np.errstate(all="ignore")  # what is no number is looked for and said
    def solve(self, start: Start) -> Solution:
        """Solve from a state and a guess, to convergence."""
        self._k[:] = 0.0
        self._begin(start.x, start.applied, start.reference)
        self._misses = 0
        return self._run_given(start.guess_u, between(start.guess_x, self.ocp.nodes), given=True)

    @np.errstate(all="ignore")  # what is no number is looked for and said
    def resume(
        self, x: np.ndarray, applied: np.ndarray, reference: Reference, previous: Plan | None
    ) -> Solution | None:
        """See `Engine`."""
        ocp, (n, nx, nu) = self.ocp, self._sizes
        memory = previous.start if previous is not None else None
        self._begin(x, applied, reference)
        self._misses = misses_after(previous)
        if self._ours(memory):
            if memory.unfinished and memory.unfinished % RETRIES == 0 and not isinstance(ocp, Joined):
                return self._begin_aside(memory)
            if self._quick and self._settings.iterations and not (memory.unfinished or self._varied):
                return self._resume_quickly(self._quick, memory)
            u, states, self._k[:] = memory.u, memory.x.copy(), memory.k[:-1]
            if self._jumps is not None:
                u, states, self._k[:] = u[ocp.later_u], states[ocp.later_x], memory.k[ocp.later_x[:-1]]
            elif not memory.unfinished or moves_on(x, states):
                u, states, self._k[:] = inputs_later(u, ocp.lengths), shifted(states), memory.k[1:]
                if n > 1:  # the last state is a guess; the solver closes the gap
                    states[-1] = 2 * states[-2] - states[-3]
            states[0] = x
            u = within(u, applied, ocp.input_bounds, ocp.step_bounds)
            if self._settings.iterations and not memory.unfinished:
                return self._iterate(np.array(u), states)
            return self._run_given(np.array(u), states, memory.unfinished)
        known = previous is not None and previous.u.shape == (n, nu) and not stuck(previous)
        if known and previous is not None and written(previous, (n + 1, nx)):
            return None
        if not (known and previous is not None):
            return self._from_nothing()
        u = within(inputs_later(previous.u, ocp.lengths), applied, ocp.input_bounds, ocp.step_bounds)
        self._k[:] = 0.0
        return self._run_given(np.array(u), self._roll_out(x, u, reference))

    def _from_nothing(self, unfinished: int = 0) -> Solution:
        """To convergence from the inputs held, or brought to zero, whichever promises less."""
        ocp, (n, _, nu) = self.ocp, self._sizes
        guesses = [np.tile(self._applied, (n, 1)), np.zeros((n, nu))]
        guesses = [within(u, self._applied, ocp.input_bounds, ocp.step_bounds) for u in guesses]
        self._k[:] = 0.0
        rolled = [self._roll_out(self._x0, u, self._reference) for u in guesses]
        promised = [self._promise(u, s) for u, s in zip(guesses, rolled, strict=True)]
        best = int(np.argmin(promised)) if np.isfinite(promised).any() else 0
        return self._run(np.array(guesses[best]), rolled[best], unfinished)

    def _begin_aside(self, memory: Memory) -> Solution:
        """From nothing, with what an unfinished solve left put aside, to which the next one comes back."""
        found = self._from_nothing(memory.unfinished)
        if _leads_on(found):
            return found
        left = Memory(x=memory.x, k=memory.k, owner=memory.owner, u=memory.u, unfinished=found.memory.unfinished)
        u = np.array(memory.u)
        return replace(found, u=u, x=memory.x[self._nodes], memory=left, violation=np.inf, residual=np.inf)

    def allow(self, seconds: float) -> None:
        """Longest time of the next solve. [s]"""
        self._allowed = max(seconds, 0.0)

    @np.errstate(all="ignore")  # what is no number is looked for and said
    def follow(
        self, x: np.ndarray, applied: np.ndarray, reference: Reference, u: np.ndarray, guess: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Inputs within limits and rates, and where they lead, by two Newton steps on all steps side by side."""
        self._begin(x, applied, reference)
        u = within(u, applied, self.ocp.input_bounds, self.ocp.step_bounds)
        self._k[:] = 0.0
        states = between(guess, self.ocp.nodes)
        for _ in range(2):
            self._set(u, states)
            later, by = self._newton(*self._node)[:2]
            if not finite(later, by):
                return u, np.full(guess.shape, np.nan)
            moved, dx = later - states[1:], x - states[0]
            for here, A in zip(moved, by.reshape(self._steps, len(x), len(x)), strict=True):
                here += np.dot(dx, A)
                dx = here
            states[0] = x
            states[1:] += moved
        return u, states[self._nodes]

    def _roll_out(self, x: np.ndarray, u: np.ndarray, reference: Reference) -> np.ndarray:
        states = np.empty((self._steps + 1, len(x)))
        states[0] = x
        for m, i in enumerate(self.ocp.stage_of):
            states[m + 1] = np.asarray(self.ocp.dynamics(states[m], u[i], reference.exogenous[i])).ravel()
        return states

    def _promise(self, u: np.ndarray, states: np.ndarray) -> float:
        """Half the cost of inputs and the states they lead to, limits apart."""
        m = self._linearise(u, states, exact=False)
        self._k[:] = 0.0
        return self._half_cost(m.e, u) if np.isfinite(m.e).all() else np.inf

    def _ours(self, memory: Any) -> TypeGuard[Memory]:
        """Whether a memory is of this problem and says something."""
        if not (isinstance(memory, Memory) and memory.owner == self.ocp.identity):
            return False
        steps, (_, nx, _) = self._steps, self._sizes
        known = memory.x.shape == (steps + 1, nx) and memory.k.shape == (steps + 1, self._nk)
        return known and memory.unfinished <= MOST_ATTEMPTS and finite(memory.u, memory.x, memory.k)

    def _resume_quickly(self, step: InputStep, memory: Memory) -> Solution:
        step.load(self._x0, self._applied, self._reference, memory)
        status, count = step.run(self._settings.iterations, self._until)
        n = len(step.u) - 2
        self._k[:] = step.before
        if status not in (Status.REAL_TIME, Status.TIME_OUT) or not count:
            return self._stopped(step.u[1:-1].copy(), step.x[1:].copy(), Iterate(status, count))
        u, x, good = step.u[:n].copy(), step.x[:-1].copy(), step.truth[2] <= self._settings.accept
        solution = self._finish(u, x, status, count, step.truth, step.k.copy() if good else None)
        if good:
            step.holds(solution.memory)
        return solution

    def _run(self, u: np.ndarray, states: np.ndarray, unfinished: int = 0) -> Solution:
        """To convergence; where these steps do not end, by the exact Hessian, as in engine.py."""
        most = self._settings.max_iterations
        self._most = most - (saved(most) if self._hands_over else 0)
        found = self._searched(u, states, unfinished)
        left = most - found.iterations
        if not (self._hands_over and found.status in UNFOUND and left > 0):
            return found
        self._most = most
        if self._curvature is None:
            return self._alone(found, unfinished)
        begun, first = found.iterations, (found.status, found.cost, found.violation)
        whole, memory = kept(found.status, found.violation), found.memory
        self._exact = True
        if whole and isinstance(memory, Memory):
            ended = self._converge(memory.u, memory.x, left, before=begun, handed=True)
            last = self._ended(*ended, unfinished)
        else:
            self._k[:] = 0.0
            u = within(u, self._applied, self.ocp.input_bounds, self.ocp.step_bounds)
            last = self._searched(u, self._roll_out(self._x0, u, self._reference), unfinished, before=begun)
        self._exact = False
        if better(first, (last.status, last.cost, last.violation)):
            return last
        status = leaves(found.status, last.status, found=whole)
        memory = replace(memory, unfinished=unfinished + 1 if status.resumes else 0)
        return replace(found, status=status, iterations=last.iterations, memory=memory)

    def _alone(self, found: Solution, unfinished: int) -> Solution:
        """On by the same steps, as the problem has no exact Hessian."""
        self._hands_over, memory, left = False, found.memory, self._most - found.iterations
        if not found.status.unfinished:
            return found
        return self._ended(*self._converge(memory.u, memory.x, left, before=found.iterations), unfinished)

    @cached_property
    def _curvature(self) -> Curvature | None:
        try:
            return Curvature(self.ocp)
        except ParameterError:
            return None

    def _searched(self, u: np.ndarray, states: np.ndarray, unfinished: int, before: int = 0) -> Solution:
        """To convergence from there or, where limits are missed, from elsewhere."""
        found = self._ended(*self._converge(u, states, self._most - before, before=before), unfinished)
        found = self._elsewhere(found, unfinished) if found.status is Status.INFEASIBLE else found
        found = self._gently(found, u, unfinished) if found.status is Status.INFEASIBLE else found
        return self._halfway(found, unfinished)

    def _run_given(self, u: np.ndarray, states: np.ndarray, unfinished: int = 0, *, given: bool = False) -> Solution:
        """To convergence from inputs that are a plan of their own, or somebody's (`given`).

        What many steps, or one that was cut short, lead to may be a local optimum, dearer than they are with the states
        that they lead to. Then it begins anew from those, and stays there if that is the better one.
        """
        begun = within(u, self._applied, self.ocp.input_bounds, self.ocp.step_bounds)
        self._shortened = given
        found = self._run(u, states, unfinished)
        far = self._shortened or found.iterations > FEW_STEPS
        left = self._most - found.iterations
        if found.status is not Status.SOLVED or not far or left < 1:
            return found
        rolled = self._roll_out(self._x0, begun, self._reference)
        self._k[:] = 0.0
        none = np.zeros_like(rolled)
        _, half, violation = self._merit(self._linearise(begun, rolled, exact=True), begun, rolled, none, 0.0)
        if not (violation <= FEASIBLE and 2 * half < found.cost - DEARER * abs(found.cost)):
            return found
        cheaper = self._solution(*self._converge(begun, rolled, left, before=found.iterations), unfinished)
        better = cheaper.status is Status.SOLVED and cheaper.cost < found.cost
        return cheaper if better else replace(found, iterations=cheaper.iterations)

    def _ended(self, u: np.ndarray, x: np.ndarray, iterate: Iterate, unfinished: int = 0) -> Solution:
        """The solution; what led nowhere begins anew: the inputs held, and states that need not follow from them.

        They stay, or, where that leads nowhere either, are as wanted.
        """
        found = self._solution(u, x, iterate, unfinished)
        for begin in (self._staying, self._as_wanted):
            if not led_nowhere(found.status, found.violation) or found.iterations >= self._most:
                break
            held = np.tile(self._applied, (len(u), 1))
            found = self._from(held, found.iterations, unfinished, begin)
        return found

    def _from(self, u: np.ndarray, before: int, unfinished: int, begin: Callable[[np.ndarray], np.ndarray]) -> Solution:
        """Iterate from other inputs and the states that begin there, after so many iterations."""
        u = within(u, self._applied, self.ocp.input_bounds, self.ocp.step_bounds)
        self._k[:] = 0.0
        x = begin(u)
        found = self._converge(u, x, self._most - before, before=before)
        return replace(self._solution(*found, unfinished), detail=ANEW)

    def _has_turn(self, start: int) -> bool:
        """Whether a start that limits are looked for from, the first being that of input 0, is tried.

        All of them are, but where limits were out of reach just before too they take turns.
        """
        return self._misses % RETRIES == 0 or (self._misses - 1) % (len(self.ocp.controls) + 3) == start

    def _halfway(self, before: Solution, unfinished: int) -> Solution:
        """Where a solve led nowhere, or limits are missed, two last starts: inputs in the middle of their ranges."""
        middle, found = self.ocp.input_bounds.mean(axis=1), before
        u = np.tile(np.where(np.isfinite(middle), middle, self._applied), (len(before.u), 1))
        for start, begin in enumerate((self._heading, self._staying), len(middle) + 1):
            lost = found.status is Status.INFEASIBLE or led_nowhere(found.status, found.violation)
            if not lost or found.iterations >= self._most:
                break
            if found.status is Status.INFEASIBLE and not self._has_turn(start):
                continue
            found = self._from(u, found.iterations, unfinished, begin)
        if before.status is not Status.INFEASIBLE or _leads_on(found):
            return found
        return _still(found, before)

    def _gently(self, missed: Solution, begun: np.ndarray, unfinished: int) -> Solution:
        """Limits that are missed are looked for from where the solve began, by steps that change inputs little.

        Whole steps of a car that slides from a start where it rolls lead to where no step keeps it on the road.
        """
        last = len(self.ocp.controls)
        if self._soft.all() or not self._has_turn(last) or missed.iterations >= self._most:
            return missed
        self._qp.reach = GENTLE
        found = self._from(begun, missed.iterations, unfinished, self._following)
        self._qp.reach = np.inf
        return found if _leads_on(found) else _still(found, missed)

    def _elsewhere(self, missed: Solution, unfinished: int) -> Solution:
        """Hard limits that are missed by least where a solve ended may be kept elsewhere.

        It begins anew from the inputs there, those of one control after the other mirrored about the middle of range,
        or a quarter of that off it where they are all there, as of a car that heads straight for an obstacle. Where
        that leads to a plan that keeps them, finished or not, they are not out of reach.
        """
        both, found = self.ocp.input_bounds.sum(axis=1), missed
        for j in range(len(both) if len(self._plain) else 0):
            if found.iterations >= self._most:
                break
            if not self._has_turn(j):
                continue
            u = missed.u.copy()
            u[:, j] = (both[j] if np.isfinite(both[j]) else 0.0) - u[:, j]
            same = bool(np.abs(u[:, j] - missed.u[:, j]).max() <= SETTLED * self._scale[j])
            u[:, j] += 0.5 * self._scale[j] * same
            found = self._from(u, found.iterations, unfinished, self._following if same else self._staying)
            if _leads_on(found):
                return found
        return _still(found, missed)

    def _following(self, u: np.ndarray) -> np.ndarray:
        """States that inputs lead to."""
        return self._roll_out(self._x0, u, self._reference)

    def _as_wanted(self, u: np.ndarray) -> np.ndarray:
        """States that are where tracked ones are wanted from the first step on, which are sure to be numbers."""
        states = self._staying(u)
        m = self._linearise(u, states, exact=False)
        self._k[:] = 0.0
        at = [0, *self.ocp.nodes[1:].tolist()]
        for i in range(1, len(u) + 1):
            for rows, inputs, e, weight in zip(m.Ex[i], m.Eu[i], m.e[i], self._weight_rows[i], strict=True):
                alone = np.flatnonzero(rows)
                if weight > 0 and len(alone) == 1 and not inputs.any():
                    states[at[i - 1] + 1 : at[i] + 1, alone] -= e / rows[alone]
        return states

    def _staying(self, u: np.ndarray) -> np.ndarray:
        """States that stay where the vehicle is now, but for jumps."""
        jump: Any = self.ocp.jump
        states = np.tile(self._x0, (self._steps + 1, 1)).astype(float)
        for m in self.ocp.jumps:
            states[m + 1 :] = np.asarray(jump(states[m], u[m], self._reference.exogenous[m])).ravel()
        return states

    def _heading(self, u: np.ndarray) -> np.ndarray:
        """States that go straight from there to where hard limits want them in the end."""
        states = self._staying(u)
        m, by, last = self._linearise(u, states, exact=False), np.zeros(states.shape[1]), len(u)
        self._k[:] = 0.0
        for stage, which, (low, high), soft in zip(*self._limit_at, self._bounds, self._soft, strict=True):
            rows, value = m.Lx[last, which], m.limited[last, which]
            at, way = np.flatnonzero(rows), max(low - value, 0.0) - max(value - high, 0.0)
            alone = len(at) == 1 and not m.Lu[last, which].any() and np.isfinite(way)
            if stage == last and not soft and alone:
                by[at] = way / rows[at]
        return states + np.linspace(0.0, 1.0, len(states))[:, None] * by

    def _finish(
        self, u: np.ndarray, x: np.ndarray, status: Status, count: int, truth: Truth, k: np.ndarray | None = None
    ) -> Solution:
        """Full steps that did not end at an acceptable plan are followed by some with a line search."""
        iterate = Iterate(Status.REAL_TIME, count, *truth)
        if iterate.residual <= self._settings.accept:
            return self._solution(u, x, iterate, k=k)
        if status is Status.TIME_OUT or perf_counter() > self._until:
            return self._solution(u, x, replace(iterate, status=Status.TIME_OUT))
        return self._ended(*self._converge(u, x, min(MORE, self._settings.max_iterations), loose=True, before=count))

    def _stopped(self, u: np.ndarray, x: np.ndarray, iterate: Iterate) -> Solution:
        """The same where limits allow no full step, as after a jump: those that follow may miss them on their way."""
        if iterate.status is not Status.INFEASIBLE:
            return self._ended(u, x, iterate)
        most, count = min(MORE, self._settings.max_iterations), iterate.iterations
        found = self._solution(*self._converge(u, x, most, loose=True, before=count))
        return found if _leads_on(found) else _still(found, self._solution(u, x, iterate))

    def _true(self, u: np.ndarray, x: np.ndarray, promise: Promise | None) -> Truth:
        """`_judge` of a full step, by the values there; unknown before the first."""
        if promise is None:
            return UNKNOWN
        self._set(u, x)
        if self._parts:  # once more, as the slopes at hand belong to the iterate before
            self._newton(*self._node_values)
        later = self._newton(*self._node_values)[0]
        self._jump(later)
        stage, (e, limited) = self._stage_values
        stage()
        return self._judge(later, e, limited, u, x, promise)

    def _solution(
        self, u: np.ndarray, x: np.ndarray, iterate: Iterate, unfinished: int = 0, k: np.ndarray | None = None
    ) -> Solution:
        if k is None:
            k = np.vstack([self._k, self._k[-1:]])
            u = within(u, self._applied, self.ocp.input_bounds, self.ocp.step_bounds)
        attempts = unfinished + 1 if iterate.status.resumes else 0
        return Solution(
            u=u,
            x=x[self._nodes],
            status=iterate.status,
            cost=iterate.cost,
            iterations=iterate.iterations,
            violation=iterate.violation,
            residual=iterate.residual,
            memory=Memory(x=x, k=k, owner=self.ocp.identity, u=u, unfinished=attempts),
            kept=True,
        )

    def _begin(self, x: np.ndarray, applied: np.ndarray, reference: Reference) -> None:
        self._until, self._allowed = perf_counter() + self._allowed, self._limit
        self._x0, self._applied, self._reference = x, applied, reference
        self._qp.reach, self._exact = np.inf, False  # a start may have ended in an error
        self._bounds = self.ocp.state_bounds(reference)[self._limit_at] if len(self.ocp.limited) else np.empty((0, 2))
        if self._varied or reference.varied:
            self._varied = reference.varied
            self._weigh(self.ocp.weights_for(reference))
        wanted = np.zeros(self._s.shape) if reference.inputs is None else reference.inputs
        self._wanted = np.asarray(wanted, dtype=float)

    # ---- the parts ---------------------------------------------------------------------------------------------

    def _linearise(self, u: np.ndarray, x: np.ndarray, *, exact: bool) -> Linear:
        n, nx, nu = self._sizes
        self._set(u, x)
        later, a, b = self._newton(*self._node)[:3]
        missing, rounds = self._missing() if exact and self._parts else np.empty(0, dtype=int), 1
        while missing.size and rounds < 25:
            self._newton(*self._node)
            missing, rounds = self._missing(), rounds + 1
        self._retry(missing)
        self._jump(later, a, b)
        stage, out = self._stage
        stage()
        ne, nl = out[0].shape[1], out[1].shape[1]
        return Linear(
            next=later.copy(),
            A=a.reshape(-1, nx, nx).transpose(0, 2, 1).copy(),
            B=b.reshape(-1, nu, nx).transpose(0, 2, 1) * self._scale,
            e=out[0].copy(),
            limited=out[1].copy(),
            Ex=out[2].reshape(n + 1, nx, ne).transpose(0, 2, 1).copy(),
            Eu=out[3].reshape(n + 1, nu, ne).transpose(0, 2, 1) * self._scale,
            Lx=out[4].reshape(n + 1, nx, nl).transpose(0, 2, 1).copy(),
            Lu=out[5].reshape(n + 1, nu, nl).transpose(0, 2, 1) * self._scale,
        )

    def _set(self, u: np.ndarray, x: np.ndarray) -> None:
        """States and inputs that the model and the stages are given next."""
        n, w = len(u), self._reference.exogenous
        given = self._node_in
        given[0][:], given[1][:], given[2][:] = x[:-1], u[self._held], w[:n][self._held]
        given = self._stage_in
        given[0][:], given[3][:] = x[self._nodes], self._reference.tracked
        given[1][:-1], given[1][-1] = u, u[-1]
        given[2][:-1], given[2][-1] = w[:n], w[-1]

    def _jump(self, later: np.ndarray, by_x: np.ndarray | None = None, by_u: np.ndarray | None = None) -> None:
        """What follows stages that take no time, and its derivatives, in the rows of these."""
        for i in self.ocp.jumps:
            given = (self._node_in[j][i] for j in range(3))
            results = (np.asarray(r.full()).ravel("F") for r in self._jumps.call([*given]))
            for rows, values in zip((later, by_x, by_u), results, strict=True):
                if rows is not None:
                    rows[i] = values

    def _newton(self, node: Callable[[], None], out: list[np.ndarray]) -> list[np.ndarray]:
        """The model at all nodes; of an implicit one, a Newton step on from the slopes at hand, which it brings on."""
        if self._parts:
            self._node_in[3][:] = self._k
        node()
        if self._parts:
            self._k[:] = out[-1]
        return out

    def _missing(self) -> np.ndarray:
        """Steps of the model whose stages the last Newton step still moved."""
        change = np.abs(self._k - self._node_in[3]).max(axis=1) * self.ocp.dt
        return np.flatnonzero(~(change <= 10 * self._settings.newton))

    def _retry(self, steps: np.ndarray) -> None:
        """Take the steps whose stages were not found as the model itself does, which then makes them shorter."""
        for j in steps:
            results = self._model(*(rows[j] for rows in self._node_in[:3]))
            for rows, values in zip(self._node[1], results, strict=False):
                rows[j] = values.full().ravel("F")
        self._k[steps] = 0.0

    @cached_property
    def _model(self) -> Any:
        return dense(dynamics_function(self.ocp, repeated_steps(self.ocp)))

    def _condense(self, m: Linear, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, Any]:
        """Hessian, gradient, and rows of the errors and of the limited quantities by the scaled inputs."""
        n, nx, nu = self._sizes
        size = n * nu
        G = np.zeros((self._steps + 1, nx, size + 1))  # last column: the state without a step in the inputs
        G[0, :, -1] = self._x0 - x[0]
        defect = m.next - x[1:]
        for j, i in enumerate(self.ocp.stage_of.tolist()):
            step = G[j + 1]
            np.matmul(m.A[j], G[j], out=step)
            step[:, i * nu : (i + 1) * nu] += m.B[j]
            step[:, -1] += defect[j]
        E = m.Ex @ G[self._nodes]
        L = m.Lx @ G[self._nodes]
        for rows, inputs in ((E, m.Eu), (L, m.Lu)):
            if inputs.any():
                for i in np.flatnonzero(inputs.any(axis=(1, 2))):
                    at = min(i, n - 1) * nu
                    rows[i, :, at : at + nu] += inputs[i]
        E[:, :, -1] += m.e
        L[:, :, -1] += m.limited
        flat = E.reshape(-1, size + 1)
        weighted = flat * self._weight_rows.reshape(-1, 1)
        both = flat[:, :-1].T @ weighted
        pull = self._s * (u - np.vstack([self._applied, u[:-1]]))
        pull[:-1] -= pull[1:]
        gradient = both[:, -1] + ((self._r * (u - self._wanted) + pull) * self._scale).ravel()
        return both[:, :-1] + self._quadratic, gradient, G, L[self._limit_at]

    def _iterate(self, u: np.ndarray, x: np.ndarray) -> Solution:
        """A fixed number of full steps."""
        promise, took, count, left = None, 0.0, 0, (np.empty((0, 0)), np.empty(0))
        for count in range(1, self._settings.iterations + 1):
            begin = perf_counter()
            if begin + took > self._until:
                return self._finish(u, x, Status.TIME_OUT, count - 1, self._true(u, x, promise))
            m = self._linearise(u, x, exact=False)
            if not m.finite:
                return self._ended(u, x, Iterate(Status.NOT_FINITE, count - 1))
            H, g, G, L = self._condense(m, x, u)
            status, step, multipliers = self._qp.solve(H, g, L, u, self._applied, self._bounds)
            if status is not Status.SOLVED:
                return self._stopped(u, x, Iterate(status, count - 1))
            du, dx, _, promise = self._expand(m, x, G, L, step, multipliers)
            u, x, left = u + du, x + dx, (H, step)
            took = perf_counter() - begin
        status = Status.TIME_OUT if perf_counter() > self._until else Status.REAL_TIME
        truth = self._true(u, x, promise)
        if promise is not None and blurred(left[0], np.diag(self._quadratic), left[1], 0.5 * (truth[0] + promise.bend)):
            truth = (*truth[:2], np.inf)
        return self._finish(u, x, status, count, truth)

    def _expand(
        self, m: Linear, x: np.ndarray, G: np.ndarray, L: np.ndarray, step: np.ndarray, multipliers: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, Promise]:
        """Step in inputs and states, errors after it, and what the linear model makes of it."""
        n, _, nu = self._sizes
        du, dx = step.reshape(n, nu) * self._scale, G[:, :, :-1] @ step + G[:, :, -1]
        at = np.vstack([step.reshape(n, nu), step.reshape(n, nu)[-1:]])
        de = (m.Ex @ dx[self._nodes][:, :, None] + m.Eu @ at[:, :, None])[:, :, 0]
        change = np.diff(du, axis=0, prepend=0 * du[:1])
        bend = (self._weight_rows * de * de).sum() + (self._r * du * du).sum() + (self._s * change * change).sum()
        promise = Promise(
            errors=np.sqrt(self._weight_rows) * (m.e + de),
            limited=L[:, :-1] @ step + L[:, -1],
            multipliers=multipliers,
            pi=self._adjoint(m, m.e + de, multipliers),
            bend=float(bend),
            reach=reach_of(step, x + dx, dx),
        )
        return du, dx, m.e + de, promise

    def _judge(
        self, later: np.ndarray, e: np.ndarray, values: np.ndarray, u: np.ndarray, x: np.ndarray, promise: Promise
    ) -> Truth:
        """Cost, largest violation and residual at an iterate after a full step."""
        limited, defects = values[self._limit_at], later - x[1:]
        excess = self._excess(limited)
        cost = 2 * (self._half_cost(e, u) + self._paid(excess))
        miss = excess[~self._soft]
        of_limits = units(values)[self._limit_at[1]][~self._soft]
        off = max(float((np.abs(defects) / units(x)).max()), float((miss / of_limits).max(initial=0.0)))
        violation = max(float(np.abs(defects).max()), float(miss.max(initial=0.0)))
        residual = max(off, promise.left(np.sqrt(self._weight_rows) * e, limited, defects))
        return (cost, violation, residual) if np.isfinite(cost + residual) else (cost, np.inf, np.inf)

    def _half_cost(self, e: np.ndarray, u: np.ndarray) -> float:
        change = u - np.vstack([self._applied, u[:-1]])
        inputs = (self._r * (u - self._wanted) ** 2).sum() + (self._s * change * change).sum()
        return 0.5 * float((self._weight_rows * e * e).sum() + inputs)

    def _excess(self, limited: np.ndarray) -> np.ndarray:
        return np.maximum(np.maximum(limited - self._bounds[:, 1], self._bounds[:, 0] - limited), 0.0)

    def _paid(self, excess: np.ndarray) -> float:
        soft = self._soft
        return float((self._plain[soft] * excess[soft] + 0.5 * self._square[soft] * excess[soft] ** 2).sum())

    def _converge(
        self, u: np.ndarray, x: np.ndarray, most: int, *, loose: bool = False, before: int = 0, handed: bool = False
    ) -> tuple[np.ndarray, np.ndarray, Iterate]:
        """Steps with a line search on an exact penalty function, corrected along remembered steps.

        If ``loose``, until the iterate can be accepted. An unfinished iterate is left where it is. Where others went
        on to here (``handed``), their multipliers are known.
        """
        # Long: the loop of solver.c, in the same order.
        n = self._sizes[0]
        penalty, hard_penalty, past = np.zeros_like(x), 0.0, [np.inf] * 3
        pairs: list[tuple[np.ndarray, np.ndarray]] = []
        old: tuple[np.ndarray, np.ndarray] | None = None
        damp, calm, idle, least_step = 0.0, 0, 0, np.inf
        circling, lowest = 0, np.inf  # small steps in a row that lower the merit no more, and that before such steps
        priced, neared = 0, 0  # iterations when that price was set, and when the violation was nearest to none
        soft, nearest = False, np.inf  # soft: hard limits have their price even where a step keeps them
        price, dearest, missed = 0.0, 0.0, 0.0  # missed: of limits by the step, at that price
        settled, stays = False, 0  # at a lower price, just before; steps in a row that leave the excess at the highest
        whole = np.inf  # size of the last step, if near and taken so
        tail, tries, known = Tail(), Tries(), handed
        pi, multipliers = self._left if handed else (np.zeros_like(x), np.zeros(len(self._plain)))
        iterate, took = Iterate(Status.ITERATION_LIMIT, before), 0.0
        accept, tolerance = self._settings.accept, self._settings.tolerance
        m = self._linearise(u, x, exact=True)
        if not m.finite:
            return u, x, replace(iterate, status=Status.NOT_FINITE)
        for count in range(1, most + 1):
            begin = perf_counter()
            if begin + took > self._until:
                return u, x, replace(iterate, status=Status.TIME_OUT)
            H, g, G, L = self._condense(m, x, u)
            slope = g + multipliers @ L[:, :-1]
            if old is not None and calm >= CALM:
                moved = (u.ravel() - old[0]) / np.tile(self._scale, n)
                if np.abs(moved).max() > BY_ROUNDING:  # else states moved alone, which is no curvature
                    pairs = [*pairs, (moved, slope - old[1])][-PAIRS:]
            bent = self._bent(m, u, x, G, (pi, multipliers) if known else None) if self._exact else None
            plain = H, g
            if bent is not None:
                tries.wanted |= handed and count == 1 and bent.negative
                more = bent.added(everything=False)
                H, g = H + more[0], g + more[1]
            for step, change in pairs:
                H = secant(H, step, change)
            H[np.diag_indices_from(H)] *= 1 + damp
            given = (H, g, L, u, self._applied, self._bounds)
            first = 10 * (1 + float(np.abs(g).max()))  # price: more than any input gains by missing limits here
            if soft:
                self._qp.price(price)
            newton = None
            if bent is not None and tries.wanted and damp == 0.0:
                tries.tried, newton = True, self._newton_step(bent, plain, L, u, slope, multipliers)
                tries.good = newton is not None
            done, step, multipliers = newton or self._qp.solve(*given)
            part = 1.0
            if done is not Status.SOLVED and len(self._plain):  # here: limits at a price may lead elsewhere
                if price == 0.0:
                    price, dearest, priced = first, PRICES * first, count - 1
                for part in (1.0, 0.1, 0.01):
                    self._qp.price(part * price)
                    done, step, multipliers = self._qp.solve(*given)
                    if done is Status.SOLVED:
                        break
            if done is not Status.SOLVED:
                self._qp.price(0.0)
                dear = settled and price >= dearest and missed > 1e-6  # a price so high that numbers fail
                return u, x, replace(iterate, status=Status.INFEASIBLE if dear else done)
            old = (u.ravel().copy(), g + multipliers @ L[:, :-1])
            du, dx, e_after, promise = self._expand(m, x, G, L, step, multipliers)
            pi, known = promise.pi, True
            self._left = pi, multipliers
            least = 1.5 * np.abs(pi)
            missed = self._qp.missed(promise.limited, self._bounds) if price else 0.0
            paid = missed > 1e-8  # for limits that the step misses: no plan yet, however small what is left
            all_of_it = part == 1.0 and self._qp.reach == np.inf  # that inputs can do
            doubtful = paid and all_of_it and (settled or price >= dearest)
            left = doubtful and self._qp.stays(m.limited[self._limit_at], promise.limited, self._bounds)
            stays = stays + 1 if left else 0
            if stays >= (1 if settled else STAYED):  # nothing brings the limits nearer
                self._qp.price(0.0)
                return u, x, replace(iterate, status=Status.INFEASIBLE)
            settled = False
            kept = 0.0 if float(np.abs(step).max()) <= SETTLED else 0.8  # early, wild steps are slowly forgotten
            penalty = np.fmax(least, kept * penalty + (1.0 - kept) * least)  # and at once at the end
            if (~self._soft).any():
                strain = float(np.abs(multipliers[~self._soft]).max())
                hard_penalty = max(hard_penalty, 1.5 * strain)
                if price and not soft and count >= PATIENCE // 2 and strain > STRAINED * price:  # only just kept
                    soft, priced = True, count

            here, _, violation = self._merit(m, u, x, penalty, hard_penalty)
            after = self._half_cost(e_after, u + du) + self._paid(self._excess(promise.limited))
            predicted, size, t = max(here - after, 0.0), float(np.abs(step).max()), 1.0
            near = violation <= 1e-6 and damp <= 1e-8
            flat = near and size <= FLAT and predicted <= 1e-12 * abs(here)
            idle += flat and size > 0.9 * least_step
            least_step = min(least_step, size) if flat else least_step
            may_rise = missed > 1e-6 and price < dearest  # of the price: the last digits are not worth their steps
            small, lower = near and size <= FLAT and not paid, here < lowest - 1e-12 * abs(here)
            circling = circling + 1 if small and not lower else 0  # as where a limit that hardly counts comes and goes
            back = circling >= IDLE and here > lowest + 1e-12 * abs(here)  # to the lowest
            still = predicted <= TELLING * here
            slow = tail.lingers(size, tolerance, count, still=still and violation <= FEASIBLE and not paid)
            idle = IDLE if back or circling >= 2 * IDLE else idle
            lowest = min(here, lowest) if small else np.inf
            last = near and (size <= (SETTLED if may_rise else tolerance) or idle >= IDLE)
            hazy = last and blurred(H, np.diag(self._quadratic), step, self._half_cost(m.e, u))
            hazy = hazy or (last and outgrown(m.A, self.ocp.jumps))
            past[count % 3] = here
            allowed = max(p for p in past if p < np.inf)
            k = self._k.copy()
            while True:
                trial_u, trial_x = u + t * du, x + t * dx
                m = self._linearise(trial_u, trial_x, exact=True)
                there, half, violation = self._merit(m, trial_u, trial_x, penalty, hard_penalty)
                late = perf_counter() > self._until
                lower = there <= allowed - 1e-4 * t * predicted + 1e-13 * abs(here)
                if lower or last or late or (flat and there < np.inf) or t < 1e-6:
                    break
                t *= 0.5
                self._shortened = True
                self._k[:] = k
            self._qp.price(0.0)
            if not np.isfinite(there):
                return u, x, replace(iterate, status=Status.NOT_FINITE)
            if (
                near and t < 1e-6 and whole <= ROUNDED and not (paid or outgrown(m.A, self.ocp.jumps))
            ):  # back to its begin
                self._k[:] = k
                m = self._linearise(u, x, exact=True)
                _, half, violation = self._merit(m, u, x, penalty, hard_penalty)
                return u, x, Iterate(Status.SOLVED, before + count, 2 * half, violation, whole)
            u, x, took = trial_u, trial_x, perf_counter() - begin
            residual = size if last else self._judge(m.next, m.e, m.limited, u, x, promise)[2] if t == 1.0 else np.inf
            if price:
                violation = max(violation, self._qp.missed(m.limited[self._limit_at], self._bounds))
            iterate = Iterate(Status.ITERATION_LIMIT, before + count, 2 * half, violation, residual)
            if paid and (last or t < 1e-6):  # as near as this price brings it
                if price >= dearest:
                    return u, x, replace(iterate, status=Status.INFEASIBLE)
                price, priced, idle, least_step, settled = 100 * price, count, 0, np.inf, last
                continue
            if last or t < 1e-6:
                return u, x, replace(iterate, status=Status.SOLVED if last and not hazy else Status.STALLED)
            rough = loose or late or (count == most and self._settings.iterations > 0)  # 0: to the optimum, as asked
            hazy = loose and blurred(H, np.diag(self._quadratic), step, half + 0.5 * promise.bend)
            if residual <= accept and not (paid or hazy) and rough and (loose or not outgrown(m.A, self.ocp.jumps)):
                return u, x, replace(iterate, status=Status.REAL_TIME)
            if late:
                return u, x, replace(iterate, status=Status.TIME_OUT)
            if paid and price < dearest and count - priced >= PATIENCE:  # it wanders at this price
                price, priced = 100 * price, count
            if violation < 0.9 * nearest:
                nearest, neared = violation, count
            if loose and nearest > FEASIBLE and count - neared >= (NO_NEARER_PAID if paid else NO_NEARER):
                return u, x, replace(iterate, status=Status.INFEASIBLE) if paid else iterate
            if loose and count >= CONTENT and violation <= FEASIBLE and not paid:
                return u, x, iterate
            lost = not paid and nearest > FEASIBLE and count - neared >= 2 * PATIENCE
            if (slow or lost) and self._hands_over and not (self._exact or loose):
                return u, x, iterate
            if len(self._plain) and not soft and nearest > 1e-6 and count - neared >= PATIENCE:  # or about kept ones
                price, dearest = (price, dearest) if price else (first, PRICES * first)
                soft, priced = True, count
            calm += 1
            tries.choose(whole=t == 1.0, negative=bent is not None and bent.negative)
            if t == 1.0:
                self._qp.reach = 2 * self._qp.reach if 2 * self._qp.reach < FREE else np.inf
            whole = size if near and t == 1.0 else np.inf
            if t == 1.0 and (not soft or here - there >= GAIN * predicted):
                damp = 0.2 * damp if damp > 1e-4 else 0.0
            elif t <= 0.25 and size > FAR:  # where the model of the step does not hold, nor remembered steps
                damp, calm, pairs = max(4 * damp, 1e-3), 0, []
        if stays and nearest > FEASIBLE:  # which nothing is where limits were kept on the way
            iterate = replace(iterate, status=Status.INFEASIBLE)
        return u, x, iterate

    def _bent(
        self, m: Linear, u: np.ndarray, x: np.ndarray, G: np.ndarray, known: tuple[np.ndarray, np.ndarray] | None
    ) -> Bent:
        """Second derivatives with these multipliers; before there are some, with prices of limits that are exceeded."""
        assert self._curvature is not None  # noqa: S101
        of_l, limited, bounds = np.zeros_like(m.limited), m.limited[self._limit_at], self._bounds
        if known is None:
            over, under = limited - bounds[:, 1], bounds[:, 0] - limited
            beyond = np.where(self._soft & (over >= 0), 1.0, 0.0) - np.where(self._soft & (under >= 0), 1.0, 0.0)
            plain = np.where(self._soft, self._plain, 0.0)
            known = np.zeros_like(x), beyond * (plain + self._square * np.maximum(over, under).clip(0.0))
        of_l[self._limit_at] = known[1]
        w = self._reference.exogenous
        given = (x, u, w, self._reference.tracked)
        M = self._curvature.at(given, known[0], of_l, self._weight_rows * m.e)
        return self._curvature.bent(M, G)

    def _newton_step(
        self,
        bent: Bent,
        plain: tuple[np.ndarray, np.ndarray],
        L: np.ndarray,
        u: np.ndarray,
        slope: np.ndarray,
        multipliers: np.ndarray,
    ) -> tuple[Status, np.ndarray, np.ndarray] | None:
        """The step by all curvature, where that is positive along what is held; None where it is not."""
        H, g = (one + more for one, more in zip(plain, bent.added(everything=True), strict=True))
        low, high = ((np.tile(b, len(u)) - u.ravel()) / np.tile(self._scale, len(u)) for b in self.ocp.input_bounds.T)
        some = (multipliers != 0) & ~(self._soft & (np.abs(multipliers) >= self._plain))
        at = np.where(multipliers > 0, self._bounds[:, 1], self._bounds[:, 0])[some] - L[some, -1]
        rows = held_rows(low, high, slope, L[some, :-1], at)
        lent = rows.lend(H, g)
        if lent is None:
            return None
        found = self._qp.solve(*lent, L, u, self._applied, self._bounds)
        return found if found[0] is Status.SOLVED and rows.kept_by(found[1]) else None

    def _merit(
        self, m: Linear, u: np.ndarray, x: np.ndarray, penalty: np.ndarray, hard_penalty: float
    ) -> tuple[float, float, float]:
        """Exact penalty function, half the cost, and the largest violation."""
        if not m.finite:
            return np.inf, np.inf, np.inf
        defect = np.vstack([x[0] - self._x0, m.next - x[1:]])
        excess = self._excess(m.limited[self._limit_at])
        half = self._half_cost(m.e, u) + self._paid(excess)
        miss = excess[~self._soft]
        total = half + float((penalty * np.abs(defect)).sum()) + hard_penalty * float(miss.sum())
        return total, half, max(float(np.abs(defect).max()), float(miss.max(initial=0.0)))

    def _adjoint(self, m: Linear, e: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Multipliers of the dynamics."""
        forced = np.zeros((self._steps + 1, self._sizes[1]))
        forced[self._nodes] = ((self._weight_rows * e)[:, None, :] @ m.Ex)[:, 0]
        np.add.at(forced, self.ocp.nodes[self._limit_at[0]], multipliers[:, None] * m.Lx[self._limit_at])
        for j in reversed(range(self._steps)):
            forced[j] += m.A[j].T @ forced[j + 1]
        return forced


class InterpretedEngine(EngineOfThreads):
    """Engine of `RealTime` on a computer without a C compiler, a work area for each thread."""

    def __init__(self, ocp: OCP, settings: Any, deadline: float | None, functions: Functions | None = None) -> None:
        shared = functions or Functions.of(ocp)
        super().__init__(lambda: WorkArea(ocp, shared, settings, deadline))
