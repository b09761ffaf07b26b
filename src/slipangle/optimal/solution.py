"""`Plan`: what a controller wants to do, and `Status`: how its solver ended."""

# Long: the words in which controllers and solvers talk, each only a few lines.
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from math import isfinite
from typing import Any, NamedTuple, TypeVar

import numpy as np

from slipangle.shown import Shown

P = TypeVar("P")


class Status(Enum):
    """Outcome of one solve, with a sentence."""

    SOLVED = "optimal within tolerance"
    ACCEPTABLE = "optimal within the solver's wider, acceptable tolerance"
    REAL_TIME = "real-time iterations: not converged, but the residuals are small"
    ITERATION_LIMIT = "the iteration limit was reached before the optimum: allow more iterations or a shorter horizon"
    STALLED = "no further progress was possible before the optimum: rescale the weights or loosen the tolerance"
    TIME_OUT = "the deadline passed before the optimum: allow more time, a shorter horizon or a faster solver"
    INFEASIBLE = "no input was found that keeps all hard limits from here: give the limits of states a slack weight"
    IMPLAUSIBLE = "the state or the reference lies far outside what it can be: check the measurements and their units"
    NOT_FINITE = "the state, the reference or the model's prediction is NaN or infinite: check the measurements"
    FAILED = "the solver stopped without an answer: check the scale of weights and limits"

    @property
    def solved(self) -> bool:
        """Whether the answer is an optimum, or a real-time iteration towards it."""
        return self in _ANSWERS

    @property
    def unfinished(self) -> bool:
        """Whether the answer, though no optimum yet, may be a plan if it keeps every constraint."""
        return self in _UNFINISHED

    @property
    def resumes(self) -> bool:
        """Whether the next solve had better go on from where this one was when it ran out of iterations or time."""
        return self in _RESUMED


FEASIBLE = 1e-6  # an unfinished answer with no larger violation of a constraint is still a plan
ANEW = "begun anew, as where it began led nowhere"  # of a plan that did not start from the one before
CURVED = "its steps take squares of errors for curvature: RealTime(iterations=0, hessian='exact') knows all of it"
MOST_ATTEMPTS = 50  # solves in a row that go on from an unfinished one; then another start is better
RETRIES = 5  # of these, every so many begin from nothing, as limits that were in the way may be gone
_ANSWERS = Status.SOLVED, Status.ACCEPTABLE, Status.REAL_TIME
_UNFINISHED = Status.ITERATION_LIMIT, Status.STALLED, Status.TIME_OUT
_RESUMED = Status.ITERATION_LIMIT, Status.TIME_OUT


class Health(NamedTuple):
    """How a controller has fared since its first plan, in plain numbers; it travels in the plans.

    Attributes
    ----------
    plans : int
        Asked for so far.
    fallbacks, fallbacks_in_a_row : int
        How many of them were no solution, and how many of those since the last solution.
    overruns, overruns_in_a_row : int
        How many took longer than the deadline, the whole call counted, and how many of those up to now.
    begun_anew : int
        How many began anew, because what was planned before led nowhere.
    """

    plans: int = 0
    fallbacks: int = 0
    fallbacks_in_a_row: int = 0
    overruns: int = 0
    overruns_in_a_row: int = 0
    begun_anew: int = 0

    def after(self, fallback: bool, late: bool, anew: bool = False) -> Health:
        """One plan later: whether it was a ``fallback``, came ``late``, and whether its solve began ``anew``."""
        a, b, c, d, e, f = self
        later = (a + 1, b + fallback, c + 1 if fallback else 0, d + late, e + 1 if late else 0, f + anew)
        return tuple.__new__(Health, later)  # half the time of its constructor


NEW = Health()


class Branch(NamedTuple):
    """What a plan does in one scenario: its inputs, the states that they lead to, and how probable it is."""

    u: np.ndarray
    x: np.ndarray
    probability: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan(Shown):
    """Inputs and predicted states over the horizon.

    Parameters
    ----------
    u : array, shape (horizon, n_controls)
        Decided inputs, row i held from ``times[i]`` to ``times[i + 1]``; the first is to be applied now. Always finite
        and within limits and rates.
    x : array, shape (horizon + 1, n_states)
        Predicted states at `times`; zeros where the state is unknown and never was.
    status : Status
        How the solver ended.
    seconds : float
        Wall time of the whole call. [s]
    cost : float
        Value of the cost, in the units of its weights; NaN for a fallback.
    iterations : int
        Of the solver.
    controls : tuple of str
        Names of the columns of u.
    age : int
        0 if u is this call's solution; k if it is a fallback, the k-th in a row.
    stopping : bool
        Whether u is the safe stop law, because no recent plan is left; the speed should go to zero.
    detail : str
        What a solver that stopped said, or that it began anew because the plan before led nowhere; and that the input
        applied before cannot be true.
    residual : float
        Of the optimality conditions at the end of the solve, as far as the solver knows it. [-] After real-time
        iterations
        the largest of: what is violated; what the quadratic program left; and about how much the curvature of the
        problem along the last step makes the next one change inputs (relative to half their range) and states. States
        and limited quantities count relative to 1 + their mean change per step. Of a converged plan, the last
        relative change of an input.
    violation : float
        Largest excess over any constraint at this plan: defects of the model from step to step, limits of states. [SI]
    memory : object
        What the solver needs for its next start; of a fallback, what the next fallback needs.
    unfinished : object
        Where a solve was that ran out of iterations or time, if the command is not from it; the next goes on there.
    times : array, shape (horizon + 1,), optional
        From now on, beginning with 0; equal steps where there is none. [s]
    health : Health
        How often there was no solution, or a late one, up to this plan.
    branches : tuple of Branch
        Of a problem with scenarios, inputs and states in each, in their order; u and x are those of the most probable.
        Empty otherwise, and of a fallback.
    decided : mapping of str to float
        Of a problem with free parameters or a free duration, what was decided for them, SI units; else None.
    """

    u: np.ndarray
    x: np.ndarray
    status: Status
    seconds: float
    cost: float
    iterations: int
    controls: tuple[str, ...]
    age: int = 0
    stopping: bool = False
    detail: str = ""
    residual: float = float("nan")
    violation: float = float("nan")
    memory: Any = field(default=None, compare=False)
    unfinished: Any = field(default=None, compare=False)
    times: np.ndarray | None = None
    health: Health = NEW
    branches: tuple[Branch, ...] = ()
    decided: Mapping[str, float] | None = None

    def _words(self) -> str:
        now = ", ".join(f"{n} = {v:.4g}" for n, v in zip(self.controls, self.command, strict=True))
        old = f", {self.age} steps old" if self.age else ""
        return f"{now} now{old}, {len(self.u)} stages; {self.status.name} in {1e3 * self.seconds:.3g} ms"

    @property
    def command(self) -> np.ndarray:
        """Inputs to apply now, shape (n_controls,)."""
        return self.u[0]

    @property
    def start(self) -> Any:
        """Of what the solver left, that from which its next solve starts."""
        return self.memory if self.unfinished is None else self.unfinished

    @property
    def message(self) -> str:
        """One sentence on where the command comes from."""
        if self.age == 0:
            return f"{self.status.value} ({self.detail})" if self.detail else self.status.value
        source = "the safe stop law" if self.stopping else "the last good plan, shifted"
        said = f" ({self.detail})" if self.detail else ""
        return f"{self.status.value}{said}; the command is {source} (fallback {self.age} in a row)"


@dataclass(frozen=True, kw_only=True, eq=False)
class Kept:
    """The plan that a fallback follows: its inputs and states, and what age it had."""

    u: np.ndarray
    x: np.ndarray
    age: int


@dataclass(kw_only=True, eq=False)
class Solution:
    """What a solver returns.

    ``violation`` is the largest excess over any constraint, ``residual`` of optimality; ``kept`` says that u is within
    limits and rates to the last bit; ``detail`` what there is to say about it.
    """

    u: np.ndarray
    x: np.ndarray
    status: Status
    cost: float
    iterations: int
    violation: float
    residual: float = float("nan")
    memory: Any = None
    kept: bool = False
    branches: tuple[Branch, ...] = ()
    decided: Mapping[str, float] | None = None
    detail: str = ""

    def as_start(self, controls: tuple[str, ...]) -> Plan:
        """The plan from which the next solve of the same, longer problem starts."""
        said = {n: getattr(self, n) for n in ("u", "x", "status", "cost", "iterations", "memory")}
        return Plan(seconds=0.0, controls=controls, **said)


def quick(kind: type[P], values: dict[str, Any]) -> P:
    """A dataclass without its constructor, which takes microseconds; what is not given has its default.

    The dictionary becomes its own.
    """
    made = object.__new__(kind)
    object.__setattr__(made, "__dict__", values)
    return made


def finite(*arrays: np.ndarray) -> bool:
    """Whether no entry is NaN, infinite, or beyond 1e150."""
    for a in arrays:  # an expression with a generator takes twice as long
        if not isfinite(np.vdot(a, a)):
            return False
    return True


def shifted(rows: np.ndarray, steps: int = 1) -> np.ndarray:
    """Rows moved up by some steps, the last one repeated.

    >>> shifted(np.array([[1.0], [2.0], [3.0]])).ravel()
    array([2., 3., 3.])
    """
    out = np.empty_like(rows)
    left = max(len(rows) - steps, 0)
    out[:left], out[left:] = rows[steps:], rows[-1]
    return out


def inputs_later(u: np.ndarray, lengths: np.ndarray, steps: int = 1) -> np.ndarray:
    """Inputs as planned some steps ago, for the stages from now on: the mean over each, the last input going on.

    Parameters
    ----------
    u : array, shape (horizon, n_controls)
        Inputs, held over stages.
    lengths : array of int, shape (horizon,)
        Of the stages, in steps.
    steps : int
        That have passed.

    Examples
    --------
    >>> inputs_later(np.array([[1.0], [2.0], [4.0]]), np.array([1, 1, 2])).ravel()
    array([2., 4., 4.])
    >>> inputs_later(np.array([[1.0], [2.0], [4.0], [8.0]]), np.array([1, 1, 2, 4])).ravel()
    array([2., 4., 6., 8.])
    """
    if len(lengths) == lengths.sum():
        return shifted(u, steps)
    held = shifted(np.repeat(u, lengths, axis=0), steps)
    first = np.cumsum(lengths) - lengths
    return np.add.reduceat(held, first, axis=0) / lengths[:, None]


def states_later(x: np.ndarray, nodes: np.ndarray, steps: int = 1) -> np.ndarray:
    """States as predicted some steps ago, at the nodes from now on: linear in between, the last one repeated.

    Parameters
    ----------
    x : array, shape (horizon + 1, n_states)
        States.
    nodes : array of int, shape (horizon + 1,)
        Where they are, in steps from then.
    steps : int
        That have passed.
    """
    if nodes[-1] == len(nodes) - 1:
        return shifted(x, steps)
    return shifted(between(x, nodes), steps)[nodes]


def between(x: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """States at every step from those at the nodes, shape (nodes[-1] + 1, n_states): linear in between.

    >>> between(np.array([[0.0], [1.0], [5.0]]), np.array([0, 1, 3])).ravel()
    array([0., 1., 3., 5.])
    """
    if nodes[-1] == len(nodes) - 1:
        return np.array(x, dtype=float)
    steps = np.arange(nodes[-1] + 1)
    before = np.minimum(np.searchsorted(nodes, steps, side="right") - 1, len(nodes) - 2)
    share = ((steps - nodes[before]) / (nodes[before + 1] - nodes[before]))[:, None]
    return (1 - share) * x[before] + share * x[before + 1]


def within(u: np.ndarray, applied: np.ndarray, bounds: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Inputs clipped to bounds and to the allowed change per step, from the applied one on.

    Parameters
    ----------
    u : array, shape (horizon, n_controls)
        Inputs.
    applied : array, shape (n_controls,)
        The input applied before.
    bounds : array, shape (n_controls, 2)
        Of the inputs.
    steps : array, shape (n_controls, 2) or (horizon, n_controls, 2)
        Of their change from row to row.
    """
    slow, fast = steps[..., 0], steps[..., 1]
    change = np.array(u)
    change[0] -= applied
    change[1:] -= u[:-1]
    if ((u >= bounds[:, 0]) & (u <= bounds[:, 1]) & (change >= slow) & (change <= fast)).all():
        return u
    out = np.empty_like(u)
    slow, fast = np.broadcast_to(slow, u.shape), np.broadcast_to(fast, u.shape)
    last = np.clip(applied, bounds[:, 0], bounds[:, 1])
    for i in range(len(u)):
        moved = np.clip(u[i], last + slow[i], last + fast[i])
        out[i] = last = np.clip(moved, bounds[:, 0], bounds[:, 1])
    return out


def count(plans: Sequence[Plan]) -> dict[Status, int]:
    """How often each status occurs."""
    return {s: n for s in Status if (n := sum(p.status is s for p in plans))}
