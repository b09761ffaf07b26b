"""The last steps of plans to convergence: by the exact Hessian, where Gauss-Newton steps do not end.

Those see the curvature of squares of errors alone. Where more of it counts they come near an optimum and contract
slowly there, or not at all, though the optimum that they lead to is often the better one. So they go as far as they
contract, and Newton's method goes on from there. Its code is compiled when a plan first needs it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from slipangle.numerics.per_thread import built
from slipangle.optimal.joined import ZERO
from slipangle.optimal.ocp import OCP
from slipangle.optimal.solution import FEASIBLE, Status

SAME = "x0 applied p r corridor bounds wr ws plain square u x pi qp.lambda".split()  # of both solvers' memory
# As in work.c.
DEARER = 1e-6  # of its cost, by which a plan is dearer than what it began with
IDLE = 10  # such steps that are no smaller than the smallest before end the iterations
PATIENCE = 40  # iterations at one price, or no nearer to limits without one, after which they get a higher one
UNFOUND = Status.ITERATION_LIMIT, Status.STALLED, Status.INFEASIBLE, Status.FAILED  # after which others may find it


@dataclass(eq=False)
class Tail:
    """Steps that promise nothing that tells, one after the other; as in solver.c."""

    steps: int = 0
    least: float = math.inf
    before: float = math.inf

    def lingers(self, size: float, tolerance: float, count: int, *, still: bool) -> bool:
        """Whether, at the pace at which they contract, more are to come than there were, and than patience has."""
        self.steps = self.steps + 1 if still else 0
        if self.steps <= 1:
            self.least = self.before = size
        self.least = min(size, self.least)
        if self.steps % IDLE != 1 or self.steps == 1 or self.least <= 0:
            return False
        pace, self.before = math.log(self.least / self.before) / IDLE, self.least
        return math.log(tolerance / self.least) < pace * max(count, PATIENCE)


class LastSteps:
    """The solver with the exact Hessian of one problem, for all threads; made once, when it is first asked for.

    Parameters
    ----------
    make : callable
        Makes it; None where there is none.
    """

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make = make

    @built
    def engine(self) -> Any:
        """The solver, or None."""
        return self._make()


def saved(most: int) -> int:
    """Of all iterations, those that Gauss-Newton steps leave to the last ones: a quarter."""
    return most // 4


def hand_over(mine: dict[str, np.ndarray], theirs: dict[str, np.ndarray], ocp: OCP, exact: OCP) -> None:
    """All that one solver was given, and where it came to, into the memory of the one with the exact Hessian."""
    for name in SAME:
        theirs[name][...] = mine[name]
    theirs["q"][:, : len(ocp.tracked)] = mine["q"]
    theirs["w"][...] = 0.0
    at = [i for i, name in enumerate(exact.exogenous) if name != ZERO]
    theirs["w"][:, at] = mine["w"]


def kept(status: Status, violation: float) -> bool:
    """Whether a solve that was cut short left a plan that keeps all constraints."""
    return status.unfinished and violation <= FEASIBLE


def better(first: tuple[Status, float, float], last: tuple[Status, float, float]) -> bool:
    """Whether the last steps led to something better than what they began from: statuses, costs and violations."""
    (_, cost, _), (status, other, _) = first, last
    found = status is Status.SOLVED or kept(status, last[2])
    if not kept(first[0], first[2]):
        return found
    return found and other <= cost + (DEARER * abs(cost) if status is Status.SOLVED else 0.0)


def leaves(first: Status, last: Status, *, found: bool) -> Status:
    """What is left to say where the last steps led to nothing better; ``found`` whether there is a plan at all."""
    if last is Status.TIME_OUT or (found and last in (Status.ITERATION_LIMIT, Status.STALLED)):
        return last
    if found:
        return Status.STALLED
    return Status.INFEASIBLE if Status.INFEASIBLE in (first, last) else first
