"""`Engine`: a solver built for one problem; `Backend`: the settings that build it.

A solver from outside is an `Engine` with a `solve`; everything else has a default that always works.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from slipangle.numerics.per_thread import OfThreads, of_thread
from slipangle.optimal.solution import Plan, Solution

if TYPE_CHECKING:
    from slipangle.optimal.ocp import OCP, Reference


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """What one solve starts from: state, last applied input, reference, and a guess of the answer.

    The guess has a row per stage, and one for the end in its states; ``decided`` is that of what is decided once, by
    name, for a solver that composes problems.
    """

    x: np.ndarray
    applied: np.ndarray
    reference: Reference
    guess_u: np.ndarray
    guess_x: np.ndarray
    memory: Any = None
    decided: Mapping[str, float] | None = None


class Followed(NamedTuple):
    """What a fallback follows: inputs and states planned ``later`` steps ago, or on the way to them the stop law."""

    u: Any
    x: Any
    later: int
    stopping: bool


class Engine:
    """A solver built for one problem. One must `solve`; None from the others leaves the work to the caller."""

    def solve(self, start: Start) -> Solution:
        """Solve from a state and a guess."""
        raise NotImplementedError

    def resume(
        self, x: np.ndarray, applied: np.ndarray, reference: Reference, previous: Plan | None
    ) -> Solution | None:
        """Solve from a state and the plan of the step before, which is shifted; without one, from nothing.

        None where the states of the plan count too: then `solve` is to begin with them.
        """
        return None

    def again(
        self, x: np.ndarray, reference: Reference, previous: Plan, applied: np.ndarray | None, seconds: float | None
    ) -> dict[str, Any] | None:
        """The usual solve, a step after this thread's last one, as a dictionary; None if anything is unusual.

        It looks by itself at what it is given, and ends within so much time [s]. After None nothing has been done.
        """
        return None

    def roll_out(
        self, x: np.ndarray, u: np.ndarray, reference: Reference, decided: Mapping[str, float]
    ) -> np.ndarray | None:
        """States that inputs lead to with what is decided once, where the solver composes the problem of that."""
        return None

    def prepare(self, applied: np.ndarray, reference: Reference, previous: Plan) -> None:
        """Do what can be done before the state is known, such as linearise; for a `resume` by the same thread."""
        return

    def allow(self, seconds: float) -> None:
        """Longest time from now to the end of this thread's next solve. [s]"""
        return

    def expect(self, lowest: np.ndarray, highest: np.ndarray) -> None:
        """Ranges of the state's entries, then of the reference's columns, beyond which a value is doubtful."""
        return

    def relax(self, safe: np.ndarray, left: np.ndarray) -> None:
        """The stop law: where inputs go, and how much is left of the way there at each stage, shape (horizon,)."""
        return

    def lost(self, x: Any, reference: Reference, u: Any, applied: Any) -> np.ndarray | None:
        """The input applied (by default ``u[0]``) where the state is no number in a call that is otherwise as usual.

        None for any other call; whether these are numbers is not looked at.
        """
        return None

    def rescue(
        self, x: np.ndarray | None, applied: np.ndarray, reference: Reference, followed: Followed
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Inputs of a fallback within limits and rates, and the states they lead to, from ``x`` on if that is known.

        None, and nothing done, if what was planned is not made of numbers, or the input applied cannot be true.
        """
        return None

    def follow(
        self, x: np.ndarray, applied: np.ndarray, reference: Reference, u: np.ndarray, guess: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Inputs within limits and rates, and the states from ``x`` on, near a guess of them; NaN without an answer."""
        return None


class EngineOfThreads(OfThreads, Engine):
    """An engine with a work area, an engine of its own, for each thread that calls."""

    solve, resume, prepare, allow, lost, rescue, follow = map(
        of_thread, ("solve", "resume", "prepare", "allow", "lost", "rescue", "follow")
    )

    def again(
        self, x: np.ndarray, reference: Reference, previous: Plan, applied: np.ndarray | None, seconds: float | None
    ) -> dict[str, Any] | None:
        """See `Engine`; in as few steps as possible."""
        return self._areas.mine.again(x, reference, previous, applied, seconds)

    def expect(self, lowest: np.ndarray, highest: np.ndarray) -> None:
        """See `Engine`; of all threads."""
        self._tell("expect", lowest, highest)

    def relax(self, safe: np.ndarray, left: np.ndarray) -> None:
        """See `Engine`; of all threads."""
        self._tell("relax", safe, left)


class Backend(Protocol):
    """Settings of a solver; `build` makes the engine for a problem."""

    def build(self, ocp: OCP, deadline: float | None) -> Engine:
        """Build once per problem; ``deadline`` bounds the time of one solve. [s]"""
        ...
