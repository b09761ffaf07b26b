"""The g-g-v diagram of a car: how hard it can drive, brake and corner in steady state at every speed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.optimal.lap.car import LapCar, forces

_ANGLES = np.linspace(0.01, 0.45, 45)  # rad, slip angles among which the largest lateral force is sought
_SLOW = 3.0  # m/s, of a car of usual size
_GRIP = 0.98  # share of the longitudinal limit that is used
_HALVINGS = 30


@dataclass(frozen=True, kw_only=True, eq=False)
class Envelope:
    """Largest quasi-steady accelerations of a car, see `envelope`.

    Parameters
    ----------
    v : array, shape (n,)
        Speeds. [m/s]
    a_y : array, shape (n,)
        Largest lateral acceleration at constant speed. [m/s2]
    share : array, shape (m,)
        Lateral acceleration over the largest one, 0 to 1.
    drive, brake : array, shape (n, m)
        Largest forward acceleration, negative where the car cannot keep its speed, and deceleration, positive. [m/s2]
    """

    v: np.ndarray
    a_y: np.ndarray
    share: np.ndarray
    drive: np.ndarray
    brake: np.ndarray

    def cornering_speed(self, curvature: np.ndarray) -> np.ndarray:
        """Largest speed at which each curvature [1/m] can be driven, at most the last of `v`. [m/s]"""
        root = np.maximum.accumulate(
            self.v / np.sqrt(np.maximum(self.a_y, 1e-9))
        )  # of the radius, which the speed is in proportion to
        return np.interp(1.0 / np.sqrt(np.maximum(np.abs(curvature), 1e-12)), root, self.v)


def envelope(car: LapCar, v_max: float, *, speeds: int = 24, shares: int = 15) -> Envelope:
    """Quasi-steady limits from the car's own tires, loads, air, engine and brakes, up to a speed. [m/s]

    The axles balance the car's yaw, each as far as its friction ellipse goes, and along the car to 98 % of it, where
    what is left across has a slope; the drag of slip angles is left out.
    """
    v = np.linspace(min(_SLOW * car.size**0.5, 0.2 * v_max), v_max, speeds)[:, None]
    rest = np.asarray(car.resistance(v))
    most = _largest(lambda a_y: _holds(car, v, a_y, rest), np.zeros_like(v), np.full_like(v, 8.0 * GRAVITY))
    share = np.sin(np.linspace(0.0, 0.5 * np.pi, shares))[None, :]
    a_y = 0.999 * most * share
    floor, top = np.zeros_like(a_y), np.full_like(a_y, 8.0 * GRAVITY * car.mass)
    engine = np.minimum(car.drive_force, car.power / v)
    push = _largest(lambda F: (engine >= F) & _holds(car, v, a_y, F), floor, top)
    pull = _largest(lambda F: (car.brake_force >= F) & _holds(car, v, a_y, -F), floor, top)
    drive, brake = (push - rest) / car.mass, (pull + rest) / car.mass
    return Envelope(v=v[:, 0], a_y=most[:, 0], share=share[0], drive=drive, brake=brake)


def _largest(holds: Callable[[np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Largest value at which a condition holds that is true at ``low`` and false above some value."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        good = holds(middle)
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    return low


def _holds(car: LapCar, v: np.ndarray, a_y: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Whether both axles can hold a lateral acceleration at a longitudinal force."""
    v, a_y, F = (k[..., None] for k in np.broadcast_arrays(v, a_y, F))
    found = forces(_ANGLES, _ANGLES, F, a_y, v, car)
    good = np.ones(a_y.shape[:-1], dtype=bool)
    for one, arm in ((found.front, car.l_r), (found.rear, car.l_f)):
        best = np.max(one.F_y, axis=-1)
        good &= (best >= car.mass * a_y[..., 0] * arm / car.wheelbase) & (np.abs(one.use[..., 0]) <= _GRIP)
    return good
