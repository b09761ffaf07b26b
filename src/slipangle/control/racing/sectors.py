"""`Sectors`: how much faster than planned a racer takes each corner, and how far it keeps from the edges there."""

from __future__ import annotations

import numpy as np

from slipangle.optimal.lap.driven import between_corners
from slipangle.optimal.lap.lap import Lap

# Lengths, times and speeds are those of a car of usual size.
RISE = 1.0  # m/s, by which the speed rises between two corners
BLEND = 20.0  # m, before and after the end of a sector, over which speeds change
STEP, LEAST, SLOWER = 0.006, 0.0015, 0.03  # of speed: of a first trial, below which nothing is tried, at most less
BETTER = 0.004  # s, by which a sector has to be quicker to be so beyond chance
ENOUGH, KEPT = 0.7, 0.5  # of the margin: room below which a sector is tried no faster, and becomes slower and narrower
NARROWER = 0.3  # m, at most


class Sectors:
    """Speeds over those of a lap, corner by corner, learned by trial from lap to lap.

    A sector is a corner with half of the straights beside it. After every lap each is tried a little faster; where
    that took longer, it goes back to what was quickest and tries less next time, and where the car came too near to an
    edge, it becomes slower and keeps further away. Speeds of a bend go with the root of the grip that is asked for, so
    one percent of speed is two of grip, and no lap has to be planned anew.

    Parameters
    ----------
    lap : Lap
        Closed.
    margin : float
        That the lap keeps between the car's side and the edges. [m]
    """

    def __init__(self, lap: Lap, margin: float) -> None:
        self.length, self.margin, size = lap.track.length, margin, float(lap.car.size)
        self._narrower, self._better = NARROWER * size, BETTER * size**0.5
        places = np.linspace(0.0, self.length, max(round(self.length / size), 2) + 1)
        inner = places[between_corners(np.interp(places, lap.s, lap.v_x, period=self.length), RISE * size**0.5)]
        self.ends = np.append(inner, self.length)
        half = np.minimum(BLEND * size, 0.4 * np.diff(self.ends, prepend=0.0))
        begin = np.concatenate([[0.0], self.ends[:-1]])
        self._places = np.column_stack([begin + half, self.ends - half]).ravel()
        count = len(self.ends)
        self.faster, self.narrower = np.zeros(count), np.zeros(count)  # of speed [-], of the track on each side [m]
        self._best, self._step = np.zeros(count), np.full(count, STEP)
        self._quickest = np.full(count, np.inf)
        self._last: tuple[float, float] | None = None
        self._begun = np.nan
        self.begin_lap()

    def begin_lap(self) -> None:
        """Forget what only counts for one lap."""
        self.times, self.room = np.full(len(self.ends), np.nan), np.full(len(self.ends), np.inf)

    def speed(self, s: float | np.ndarray) -> np.ndarray:
        """Speed over that of the lap at arc lengths. [m]"""
        return 1.0 + self._along(self.faster, s)

    def spare(self, s: float | np.ndarray) -> np.ndarray:
        """Room to keep beside the margin at arc lengths. [m]"""
        return self._along(self.narrower, s)

    def _along(self, values: np.ndarray, s: float | np.ndarray) -> np.ndarray:
        """Values of the sectors, which blend into each other."""
        return np.asarray(np.interp(s, self._places, np.repeat(values, 2), period=self.length))

    def see(self, s: float, t: float, room: float) -> None:
        """A sample of the drive: arc length, going on over the start line [m], time [s], room beside the car. [m]"""
        at = self.sector(s)
        self.room[at] = min(self.room[at], room)
        last, self._last = self._last, (s, t)
        if last is None or s <= last[0]:
            self._last = last or self._last
            return
        turn = np.floor(last[0] / self.length)
        for k, end in enumerate((self.ends + turn * self.length).tolist()):
            if last[0] < end <= s:
                passed = last[1] + (t - last[1]) * (end - last[0]) / (s - last[0])
                self.times[k] = passed - self._begun
                self._begun = passed

    def sector(self, s: float) -> int:
        """Which sector an arc length is in. [m]"""
        return min(int(np.searchsorted(self.ends, s % self.length, side="right")), len(self.ends) - 1)

    def end_lap(self, most: float) -> None:
        """Judge every sector that was driven through, and say how fast the next lap takes it: at most so much. [-]"""
        for k in np.flatnonzero(np.isfinite(self.times)):
            short = KEPT * self.margin - self.room[k]
            if short > 0.0:
                self.narrower[k] = min(self.narrower[k] + short, self._narrower)
                self._step[k] *= 0.5
                self._best[k] = self.faster[k] = max(min(self._best[k], self.faster[k]) - STEP, -SLOWER)
                self._quickest[k] = np.inf
                continue
            if self.times[k] < self._quickest[k] - self._better:
                self._quickest[k], self._best[k] = self.times[k], self.faster[k]
            else:
                self._step[k] *= 0.5
            tried = self._step[k] if self._step[k] >= LEAST and self.room[k] > ENOUGH * self.margin else 0.0
            self.faster[k] = max(min(self._best[k] + tried, most), -SLOWER)
        self.begin_lap()
