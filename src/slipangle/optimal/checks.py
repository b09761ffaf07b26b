"""What `plan` is given: wrong shapes and types raise at once, values are judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any, TypeGuard

import numpy as np

from slipangle.data.channels import STANDARD
from slipangle.errors import ParameterError
from slipangle.optimal.arrays import short
from slipangle.optimal.solution import FEASIBLE, NEW, Health, Plan, Status

MARGIN = 2.0  # a quantity may be this many times its largest plausible size before it is taken for a fault
LARGEST = {"m": 1e7, "rad": 1e5}  # of quantities that the table of channels gives no size: positions, headings
ANY = 1e12  # of a quantity that the table does not know
MOST = 2**62  # of a count
_NOWHERE = Status.NOT_FINITE, Status.FAILED
_STUCK = Status.STALLED, Status.INFEASIBLE, Status.FAILED
NUMBER = 1e150  # the square of anything larger is infinite


def is_number(value: object) -> TypeGuard[float]:
    """Whether it is a number of Python or NumPy, which True and False are not.

    >>> is_number(0.5), is_number(np.int64(2)), is_number(True), is_number("2")
    (True, True, False, False)
    """
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


class Plausible:
    """Ranges that values lie in unless a sensor, a clock or a unit is wrong.

    Those of standard channels are twice their largest plausible size, those of others 1e12 in their unit; lags and
    copies of a channel, such as ``r[k-1]``, have its range.

    Parameters
    ----------
    names : sequence of str
        Of the entries or columns.
    ranges : mapping of str to (float, float), optional
        Ranges that replace the usual ones.
    rows : int, optional
        Most of the arrays to be judged; by default they are vectors.

    Examples
    --------
    >>> Plausible(("v_y", "X")).fault(np.array([1e5, 0.0]))
    'v_y is 100000, outside -120 to 120'
    """

    def __init__(
        self, names: Sequence[str], ranges: Mapping[str, tuple[float, float]] | None = None, rows: int | None = None
    ) -> None:
        self._names = tuple(names)
        both = np.array([(ranges or {}).get(n) or _usual(n) for n in names], dtype=float).reshape(-1, 2)
        self._low, self._high = np.clip(both, -NUMBER, NUMBER).T
        least = np.minimum(-self._low, self._high)
        share = np.where(least >= 1, 1.0 / np.maximum(least, 1.0), np.nan)  # not a number: always looked at
        self._share = np.tile(share, (rows, 1)) if rows else share

    @property
    def ranges(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest of each entry or column."""
        return self._low, self._high

    @property
    def by_name(self) -> dict[str, tuple[float, float]]:
        """The same by name."""
        return dict(zip(self._names, zip(self._low.tolist(), self._high.tolist(), strict=True), strict=True))

    def holds(self, values: np.ndarray) -> bool:
        """Whether all are numbers within their ranges."""
        part = values * self._share[: len(values)]
        if np.vdot(part, part) <= 1.0:  # enough, and nearly always so
            return True
        return self._inside(values)

    def _inside(self, values: np.ndarray) -> bool:
        if not isfinite(np.vdot(values, values)):  # the usual fault, found without a look at each
            return False
        return bool(((values >= self._low) & (values <= self._high)).all())

    def fault(self, values: np.ndarray) -> str:
        """Which value is out of its range, empty if none is."""
        rows = np.atleast_2d(values)
        wrong = np.argwhere(~((rows >= self._low) & (rows <= self._high)))
        if not len(wrong):
            return ""
        i, j = wrong[0]
        return f"{self._names[j]} is {rows[i, j]:g}, outside {self._low[j]:g} to {self._high[j]:g}"


def _usual(name: str) -> tuple[float, float]:
    """Range of a channel, or of a lag or copy of one."""
    root = name.removeprefix("base ").split("[")[0].rstrip("'")
    known = STANDARD.get(root)
    if known is None:
        return -ANY, ANY
    size = known.largest if np.isfinite(known.largest) else LARGEST.get(known.unit, ANY / MARGIN)
    return -MARGIN * size, MARGIN * size


class Judge:
    """Says whether state and reference of a controller can be true.

    Parameters
    ----------
    states, references, exogenous : sequence of str
        Names of the state's entries and of the reference's columns.
    horizon : int
        Stages.
    ranges : mapping of str to (float, float), optional
        Ranges that replace the usual ones, see `Plausible`.
    """

    def __init__(
        self,
        states: Sequence[str],
        references: Sequence[str],
        exogenous: Sequence[str],
        horizon: int,
        ranges: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        self.states = Plausible(states, ranges)
        self.tracked = Plausible(references, ranges, horizon + 1)
        self.exogenous = Plausible(exogenous, ranges, horizon + 1)  # the end may be left out

    @property
    def ranges(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest of the state's entries, then of the reference's columns."""
        low, high = zip(*(part.ranges for part in (self.states, self.tracked, self.exogenous)), strict=True)
        return np.concatenate(low), np.concatenate(high)

    def status(self, x: np.ndarray, tracked: np.ndarray, exogenous: np.ndarray) -> Status | None:
        """None where all is plausible, else NOT_FINITE or IMPLAUSIBLE."""
        if self.states.holds(x) and self.tracked.holds(tracked) and self.exogenous.holds(exogenous):
            return None
        for a in (x, tracked, exogenous):
            if not (isfinite(np.vdot(a, a)) and (np.abs(a) <= NUMBER).all()):
                return Status.NOT_FINITE
        return Status.IMPLAUSIBLE

    def fault(self, x: np.ndarray, tracked: np.ndarray, exogenous: np.ndarray) -> str:
        """Which value is out of its range."""
        if state := self.states.fault(x):
            return f"of the state, {state}"
        return f"of the reference, {self.tracked.fault(tracked) or self.exogenous.fault(exogenous)}"


def require_plan(previous: Any) -> None:
    """Raise unless this is a plan, or None.

    Raises
    ------
    ParameterError
        With what it is.
    """
    if previous is not None and not isinstance(previous, Plan):
        raise ParameterError(f"previous is {short(previous)}; expected the Plan of the step before, or None")


def last_input(previous: Plan | None, controls: tuple[str, ...]) -> np.ndarray | None:
    """The first input of a plan, if it has these inputs and they are numbers."""
    if previous is None or previous.controls != controls:
        return None
    u = previous.u
    if not (isinstance(u, np.ndarray) and u.ndim == 2 and len(u) and u.shape[1] == len(controls)):
        return None
    return u[0] if u.dtype.kind in "fiu" and believable(u[0]) else None


def believable(u: np.ndarray) -> bool:
    """Whether inputs can have been applied: numbers of a size that any unit allows."""
    return bool(np.vdot(u, u) <= ANY * ANY)


def is_numbers(given: Any, shape: tuple[int, ...]) -> TypeGuard[np.ndarray]:
    """Whether this is an array of that shape, and all finite."""
    if not (isinstance(given, np.ndarray) and given.shape == shape and given.dtype.kind in "fiu"):
        return False
    return isfinite(np.vdot(given, given))


def health_of(previous: Plan | None) -> Health:
    """Counters up to a plan, whatever a plan from outside says."""
    return previous.health if previous is not None and isinstance(previous.health, Health) else NEW


def led_nowhere(status: Status, violation: float) -> bool:
    """Whether a solve that ended so, with such a violation, had better begin anew, not from a plan before."""
    return status in _NOWHERE or (status is Status.STALLED and not violation <= FEASIBLE)


def stuck(previous: Plan) -> bool:
    """Whether the next solve had better begin from nothing than from a plan: every other fallback in a row.

    A solve that was not to be had from the plan before, shifted, may be had from nothing, or from another state.
    """
    age = counted(previous.age)
    return isinstance(previous.status, Status) and previous.status in _STUCK and age > 0 and age % 2 == 0


def misses_after(previous: Plan | None) -> int:
    """How many fallbacks in a row came before one by missed hard limits: the next solve looks in fewer places.

    The first of a row does not count, as it may be of real-time iterations, which look for a plan where they are.
    """
    if previous is None or previous.status is not Status.INFEASIBLE:
        return 0
    return max(counted(previous.age) - 1, 0)


def written(previous: Plan, states: tuple[int, ...]) -> bool:
    """Whether the states of a plan of somebody else, of that shape, are to be begun with: not those of a fallback."""
    return counted(previous.age) == 0 and is_numbers(previous.x, states)


def counted(age: object) -> int:
    """A count, whatever a plan from outside says."""
    return age if isinstance(age, int) and 0 <= age < MOST else 0
