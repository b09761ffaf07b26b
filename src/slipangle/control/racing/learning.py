"""`Learned`: what a racer knows of road and car from its laps so far, and the car that its next lap is planned for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slipangle.control.racing.pedals import Pedals
from slipangle.optimal.lap.car import LapCar

PLACE = 10.0  # m of track that share what full throttle gives
SETTLED = 0.3  # s of full throttle before its force is believed
GAIN = 0.1  # of new values of a place, each hundredth of a second


class Learned:
    """Grip as a mean over the lap, and the force of full throttle by place, so that gears and slopes are in it.

    Parameters
    ----------
    pedals : Pedals
        What is believed where nothing was seen yet.
    length : float
        Of the track. [m]
    grip_std : float
        Of the friction over the believed one, before the first lap. [-]
    """

    def __init__(self, pedals: Pedals, length: float, grip_std: float) -> None:
        self.pedals, self.length = pedals, length
        self.grip, self.grip_std = 1.0, grip_std
        self._places = np.full(max(1, round(length / PLACE)), np.nan)
        self._pressed = 0.0
        self.begin_lap()

    def begin_lap(self) -> None:
        """Forget what only counts for one lap."""
        self._grips: list[tuple[float, float]] = []

    def most(self, s: float | np.ndarray, v_x: float | np.ndarray) -> np.ndarray:
        """Force at full throttle at places [m] and speeds [m/s]: as seen there, or as believed. [N]"""
        seen = self._places[self._place(s)]
        return np.where(np.isfinite(seen), seen, self.pedals.most(v_x))

    def _place(self, s: float | np.ndarray) -> np.ndarray:
        count = len(self._places)
        return (np.asarray(s) % self.length / self.length * count).astype(int) % count

    def see(self, s: float, force: float, throttle: float, grip: tuple[float, float], dt: float) -> None:
        """A sample of the drive: place [m], force [N], throttle, grip and its deviation, sample time. [s]"""
        self._grips.append(grip)
        self._pressed = self._pressed + dt if throttle > 0.99 else 0.0
        if self._pressed < SETTLED:
            return
        at = int(self._place(s))
        known = self._places[at]
        self._places[at] = force if np.isnan(known) else known + GAIN * (force - known)

    def end_lap(self) -> None:
        """Take the mean grip of the lap; its deviation is that of the filter or of the laps' own wandering."""
        if self._grips:
            grips = np.array(self._grips)
            self.grip = float(grips[:, 0].mean())
            self.grip_std = float(np.sqrt(np.mean(grips[:, 1] ** 2)))

    def car(self, car: LapCar, share: float) -> LapCar:
        """The car for the next lap: ``share`` of the grip that is sure."""
        grip = share * (self.grip - self.grip_std)
        return replace(car, mu_f=grip * car.mu_f, mu_r=grip * car.mu_r)
