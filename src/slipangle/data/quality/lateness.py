"""Whether delta is logged later than the car turns, and v_x later than the car gathers speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.quality.regression import about_means, by_blocks, coefficient, explained
from slipangle.data.quality.slow_motion import speeds_differ
from slipangle.data.quality.stuck import low_pass

_EDGE = 0.9  # s at either end of a drive, where a filter or a shifted channel has nothing to go by
_FAR, _STEP, _SAME = 0.8, 0.2, 2e-3  # s: farthest shift, farthest at once, and change at which a search is at its end
_SEARCHES = 8
_DRIVES = 0.3  # of the higher speeds, from which a car is looked at
_FIRST, _FIRST_AT_REST = (0.03, 3.0), (0.05, 4.0)  # s, and standard errors more, by which r is before delta
_BEHIND = 0.1, 3.0  # s, and standard errors more, by which v_x is behind what accelerations say of it
_TOLD = 0.06  # s, error up to which accelerations tell, as speed has to change for it, and in bends for a_y over r
_TIED = 0.7  # share of the changes of speed that a_x explains, from which they belong together


@dataclass(frozen=True)
class Lag:
    """How long one channel comes after another, and the error of that [s]; what is explained by it [-]."""

    seconds: float
    error: float = np.inf
    tied: float = 0.0

    def beyond(self, least: float, errors: float) -> bool:
        """Whether it is longer than so many seconds and standard errors together."""
        return self.seconds > least + errors * self.error


class _Drives:
    """The slow part of drives, where the car is driven fast enough and no end is near."""

    def __init__(self, fast: Sequence[Dataset]) -> None:
        names = [n for n in ("delta", "delta_r", "v_x", "v_y", "r", "a_x", "a_y") if n in fast[0]]
        self.dt, edge = fast[0].dt, round(_EDGE / fast[0].dt)
        self._slow = [{n: low_pass(part[n], part.dt) for n in names} for part in fast]
        least = _DRIVES * float(np.quantile(np.concatenate([slow["v_x"] for slow in self._slow]), 0.9))
        self._kept = [slow["v_x"] > least for slow in self._slow]
        for kept in self._kept:
            kept[:edge] = kept[max(len(kept) - edge, 0) :] = False
        self.numbers = np.repeat(np.arange(len(fast)), [int(kept.sum()) for kept in self._kept])

    def __contains__(self, name: str) -> bool:
        return name in self._slow[0]

    def of(self, name: str, later: float = 0.0) -> np.ndarray:
        """A channel as it was so many seconds before. (n,)"""
        return self._joined(self._shifted(name, later))

    def rate(self, name: str, later: float = 0.0) -> np.ndarray:
        """Its change per second. (n,)"""
        return self._joined([np.gradient(x, self.dt) for x in self._shifted(name, later)])

    def _shifted(self, name: str, later: float) -> list[np.ndarray]:
        times = [np.arange(len(slow[name])) * self.dt for slow in self._slow]
        return [np.interp(t - later, t, slow[name]) for t, slow in zip(times, self._slow, strict=True)]

    def _joined(self, parts: list[np.ndarray]) -> np.ndarray:
        return np.concatenate([x[kept] for x, kept in zip(parts, self._kept, strict=True)])


def late(fast: Sequence[Dataset], wheelbase: float) -> list[str]:
    """Sentences on a delta, or a v_x, that is logged late, of drives; ``wheelbase`` in m.

    They have delta [rad], v_x [m/s], r [rad/s], and delta_r [rad], v_y [m/s], a_x, a_y [m/s2] where measured.
    """
    drives = _Drives(fast)
    if not len(drives.numbers):
        return []
    return [*_of_the_steering(drives, wheelbase), *_of_the_speed(drives)]


def steering_lag(fast: Sequence[Dataset], wheelbase: float) -> float:
    """How long the yaw rate comes after the steering, negative if before; of drives as in `late`. [s]"""
    drives = _Drives(fast)
    return -_turns_first(drives, wheelbase, drives.of("r")).seconds if len(drives.numbers) else 0.0


def _of_the_steering(drives: _Drives, wheelbase: float) -> list[str]:
    """A car cannot turn before it is steered: what it does so is logged earlier than its steering is."""
    early = _turns_first(drives, wheelbase, drives.of("r"))
    told = [early] if early.beyond(*_FIRST) else []
    at_rest = _turns_first(drives, wheelbase, drives.of("r"), by_speed=True)
    told += [at_rest] if at_rest.beyond(*_FIRST_AT_REST) else []
    if not told:
        return []
    said = f"r comes {max(one.seconds for one in told):.2g} s before the steering that makes it"
    odd, fix = "delta is logged late", "by that and by what steering and tires take; shift it, or take another sensor"
    if "a_y" in drives:
        across = _turns_first(drives, wheelbase, drives.of("a_y") / drives.of("v_x"))
        if Lag(-across.seconds, across.error).beyond(*_FIRST):
            return [f"{said}, and a_y after it: r is logged early, as by a clock of its own; shift it"]
        said += ", and so does a_y" if across.beyond(*_FIRST) else ""
        odd += "" if across.beyond(*_FIRST) else ", or r early"
    return [f"{said}: {odd}, {fix}"]


def _turns_first(drives: _Drives, wheelbase: float, r: np.ndarray, *, by_speed: bool = False) -> Lag:
    """How long a yaw rate comes before delta, as r wheelbase = gain v_x delta - K v_x^2 r wheelbase has it.

    With ``by_speed`` the lag of tires, in proportion to speed, is told from it, as far as speeds tell.
    """
    v, differ = drives.of("v_x"), speeds_differ(drives.of("v_x"), r)
    if by_speed and not differ:
        return Lag(0.0)

    def table(lag: float) -> np.ndarray:
        delta, rate = (
            told("delta", lag) - (told("delta_r", lag) if "delta_r" in drives else 0.0)
            for told in (drives.of, drives.rate)
        )
        columns = [-v * rate, v * delta, v]
        columns += [v * v * r * wheelbase] if differ else []
        columns += [-v * v * rate] if by_speed else []
        return np.column_stack([*columns, r * wheelbase])

    lag = _sought(table, drives.numbers)
    return Lag(-lag.seconds, lag.error, lag.tied)


def _of_the_speed(drives: _Drives) -> list[str]:
    """What the car feels tells how its speed changes: along, as its rate, or across, over its yaw rate."""
    said = "it is logged late, as by GPS or a filter; shift it, or take another sensor"
    if "a_x" in drives:
        along = _sought(partial(_along, drives), drives.numbers)
        if along.tied > _TIED and along.error < _TOLD and along.beyond(*_BEHIND):
            return [f"v_x comes {along.seconds:.2g} s behind what a_x makes of it: {said}"]
    if "a_y" in drives:
        across = _sought(partial(_across, drives), drives.numbers)
        if across.error < _TOLD and across.beyond(*_BEHIND):
            return [f"v_x comes {across.seconds:.2g} s behind a_y over r: {said}"]
    return []


def _along(drives: _Drives, lag: float) -> np.ndarray:
    """The rate of v_x = a_x + v_y r, so much later, with scale and offset."""
    turning = (drives.of("v_y", lag) * drives.of("r", lag)) if "v_y" in drives else 0.0
    felt = drives.of("a_x", lag) + turning
    jerk = (drives.of("a_x", lag - drives.dt) - drives.of("a_x", lag + drives.dt)) / (2 * drives.dt)
    table = np.column_stack([-jerk, felt, drives.rate("v_x")])
    return np.column_stack([about_means(column, drives.numbers) for column in table.T])


def _across(drives: _Drives, lag: float) -> np.ndarray:
    """a_y = v_x r, of a speed that comes so much later, and what v_y, levers and an offset of r add."""
    v, v_dot, r, r_dot = drives.of("v_x", -lag), drives.rate("v_x", -lag), drives.of("r"), drives.rate("r")
    more = drives.rate("v_y") if "v_y" in drives else v * v * r_dot
    table = np.column_stack([r * v_dot, v * r, r_dot, v * r_dot, more, v, drives.of("a_y")])
    return np.column_stack([about_means(column, drives.numbers) for column in table.T])


def _sought(table: Callable[[float], np.ndarray], drives: np.ndarray) -> Lag:
    """The lag at which the first column is worth nothing: what a second more changes, over the second one's factor."""
    lag = 0.0
    for _ in range(_SEARCHES):
        squares = by_blocks(table(lag), drives)
        (more, error), (gain, _) = (coefficient(squares, k) for k in range(2))
        if not gain > 0:
            break
        step = float(np.clip(more / gain, -_STEP, _STEP))
        lag = float(np.clip(lag + step, -_FAR, _FAR))
        if abs(step) < _SAME:
            return Lag(lag, error / gain, explained(squares))
    return Lag(lag)
