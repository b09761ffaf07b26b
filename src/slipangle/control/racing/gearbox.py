"""`Gearbox`: a gearbox that shifts by itself, and how slow a lap lets it shift down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from slipangle.errors import ParameterError
from slipangle.models.vehicles.car import DualTrackParams

NEAR, BELOW = 1.06, 0.95  # of the speed of a shift: slowest points up to there are slowed down, or were so before
SURE = 0.975  # of the speed of a shift, that a car which wanders about its lap surely reaches


@dataclass(frozen=True, kw_only=True)
class Gearbox:
    """Speeds at which a gearbox shifts, one at a time, whatever the driver does.

    Parameters
    ----------
    up : tuple of float
        Above which it leaves the first gear, the second and so on, upwards. [m/s]
    down : tuple of float
        Below which it leaves the second gear, the third and so on, downwards; each below that of shifting up. [m/s]

    Raises
    ------
    ParameterError
        If a gear would be left both ways.
    """

    up: tuple[float, ...]
    down: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.up) != len(self.down) or any(not 0.0 < d < u for u, d in zip(self.up, self.down, strict=True)):
            raise ParameterError(
                f"the gearbox shifts up at {self.up} m/s and down at {self.down} m/s; expected as many of both, and "
                "that it shifts down at the lower speed"
            )

    @classmethod
    def of(cls, car: DualTrackParams) -> Self:
        """Of a dual track with rolling wheels."""
        line = car.driveline
        per_speed = np.array(line.ratios) * line.final / car.radius
        return cls(
            up=tuple((line.shift_up / per_speed[:-1]).tolist()), down=tuple((line.shift_down / per_speed[1:]).tolist())
        )

    def gears(self, v_x: np.ndarray) -> np.ndarray:
        """Gear at every point of a closed lap of speeds [m/s], shape (n,), 1 being the first."""
        return self.along(v_x, int(self.along(v_x, 1)[-1]))

    def along(self, v_x: np.ndarray, gear: int) -> np.ndarray:
        """Gear at every one of speeds [m/s] that follow each other, shape (n,), from a gear before the first on."""
        found = np.zeros(len(v_x), dtype=int)
        for k, v in enumerate(v_x):
            while gear <= len(self.up) and v > self.up[gear - 1]:
                gear += 1
            while gear > 1 and v < self.down[gear - 2]:
                gear -= 1
            found[k] = gear
        return found

    def slow_enough(self, v_x: np.ndarray) -> np.ndarray:
        """Largest speed at every point of a closed lap of speeds [m/s], shape (n,), infinite at most of them.

        A bend whose slowest point is a few percent faster than the gearbox needs for shifting down would be left in
        too high a gear, and the straight behind it with less force, which costs more than those percent do.
        """
        most, gears = np.full(len(v_x), np.inf), self.gears(v_x)
        slowest = np.flatnonzero((v_x < np.roll(v_x, 1)) & (v_x <= np.roll(v_x, -1)))
        for at in slowest:
            for gear, shift in enumerate(self.down, start=2):
                if BELOW * shift < v_x[at] < NEAR * shift and _before(v_x, gears, int(at), NEAR * shift) >= gear:
                    most[at] = SURE * shift
        return most


def _before(v_x: np.ndarray, gears: np.ndarray, at: int, speed: float) -> int:
    """Gear at the last point before one that was faster than a speed; none where there is no such point."""
    back = np.roll(np.arange(len(v_x)), -at)[::-1]
    faster = back[v_x[back] > speed]
    return int(gears[faster[0]]) if len(faster) else 0
