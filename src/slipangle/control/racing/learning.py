"""`Learned`: what a racer knows of road and car from its laps so far, and the car that its next lap is planned for."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from slipangle.optimal.lap.car import LapCar

# Lengths and times are those of a car of usual size.
PLACE = 10.0  # m of track that share what full throttle gives
LEAST, MOST = 0.2, 2.0  # of what full throttle is believed to give
SETTLED = 0.3  # s of full throttle before its force is believed
GAIN = 0.1  # of new values of a place, each hundredth of a second
SUREST = 1e-4  # standard deviation that no grip is more sure than
MEMORY = 20.0  # s, of what is known of the grip while driving
BELIEVED = 5.0  # s of samples as sure as the believed grip, that this counts for


class Learned:
    """Grip as a mean over the lap, and by place what full throttle gives of what it is believed to, slopes and all.

    Parameters
    ----------
    length : float
        Of the track. [m]
    grip_std : float
        Of the friction over the believed one, before the first lap. [-]
    size : float
        Of the car, as of `LapCar`. [-]
    """

    def __init__(self, length: float, grip_std: float, size: float = 1.0) -> None:
        self.length, root = length, math.sqrt(size)
        self._settled, self._memory = SETTLED * root, MEMORY * root
        self.grip, self.grip_std = 1.0, grip_std
        count = max(1, round(length / (PLACE * size)))
        self._shares, self._seen, self._nearest = np.ones(count), np.zeros(count, dtype=bool), np.arange(count)
        self._pressed = 0.0
        self._known = BELIEVED * root / max(grip_std, SUREST) ** 2
        self._mean = 1.0
        self.begin_lap()

    def begin_lap(self) -> None:
        """Forget what only counts for one lap."""
        self._samples = 0
        self._weights = self._average = self._spread = 0.0  # sum of weights, weighted mean, weighted squares about it
        self._latest: tuple[float, float] | None = None

    def most(self, s: float | np.ndarray, believed: float | np.ndarray) -> np.ndarray:
        """Force at full throttle at places [m], as much of that ``believed`` [N] as was seen there or nearest. [N]"""
        return self._shares[self._nearest[self._place(s)]] * believed

    def here(self, grip: float) -> float:
        """Grip to plan with where the filter reads ``grip``: no more than it read where it was sure, near the limit.

        Far from it a filter takes for grip what its tires' curve lacks.
        """
        return min(grip, self._mean)

    def _place(self, s: float | np.ndarray) -> np.ndarray:
        count = len(self._shares)
        return (np.asarray(s) % self.length / self.length * count).astype(int) % count

    def see(self, s: float, share: float, throttle: float, grip: tuple[float, float], dt: float) -> None:
        """A sample: place [m], force over that of full throttle, throttle, grip and its deviation, sample time. [s]"""
        std = max(grip[1], SUREST)
        weight, off = 1.0 / (std * std), grip[0] - self._average
        self._latest, self._samples, self._weights = grip, self._samples + 1, self._weights + weight
        self._average += weight / self._weights * off
        self._spread += weight * off * (grip[0] - self._average)
        sure = dt * weight
        self._known = self._known * (1.0 - dt / self._memory) + sure
        self._mean += sure / self._known * (grip[0] - self._mean)
        self._pressed = self._pressed + dt if throttle > 0.99 else 0.0
        if self._pressed < self._settled:
            return
        at, share = int(self._place(s)), min(max(share, LEAST), MOST)
        if self._seen[at]:
            self._shares[at] += GAIN * (share - self._shares[at])
            return
        self._shares[at], self._seen[at] = share, True
        count, seen = len(self._shares), np.flatnonzero(self._seen)
        away = np.abs(np.arange(count)[:, None] - seen)
        self._nearest = seen[np.argmin(np.minimum(away, count - away), axis=1)]

    def end_lap(self) -> None:
        """Take the lap's mean grip, each sample by how sure it is; how far it wandered, at least the filter's own."""
        if self._samples:
            self.grip = self._average
            self.grip_std = max(math.sqrt(self._spread / self._weights), math.sqrt(self._samples / self._weights))

    @property
    def latest(self) -> tuple[float, float]:
        """Grip as the filter read it last, and its deviation; as of the lap before where nothing was read yet. [-]"""
        return self._latest or (self.grip, self.grip_std)

    @property
    def sure(self) -> float:
        """Grip less its deviation. [-]"""
        return self.grip - self.grip_std

    def car(self, car: LapCar, share: float) -> LapCar:
        """The car for the next lap: ``share`` of the grip that is sure."""
        grip = share * self.sure
        return replace(car, mu_f=grip * car.mu_f, mu_r=grip * car.mu_r)
