"""Driving a car's plant: steering that arrives late and filtered, a speed held by pedals, every drive side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from benchmarks.foreign_cars.manoeuvres import Drive, H
from scipy import signal

from slipangle.models.fast import evaluate
from slipangle.models.ode import OdeModel
from slipangle.models.vehicles.parameters import GRAVITY

TICK = 10  # steps of the plant between two looks of the speed controller, and between two logged samples
Matrices = tuple[np.ndarray, ...]
LOGGED = ("v_x", "v_y", "r", "a_y")  # outputs of every plant


@dataclass(frozen=True, kw_only=True)
class Steering:
    """What lies between the logged command and the road wheels.

    The road-wheel angle is ``gain (logged - offset)``, `delay` later and through a first-order `lag` [s]; the raw log
    holds ``ratio`` times the logged angle, as of a hand wheel.
    """

    delay: float
    lag: float
    gain: float
    offset: float
    ratio: float

    def road_wheel(self, wanted: np.ndarray) -> np.ndarray:
        """Angle at the wheels for one wanted at each millisecond, both shape (n,), at the middle of each."""
        t = H * np.arange(len(wanted))
        late = np.interp(t - self.delay + 0.5 * H, t, wanted)
        if self.lag < 1e-6:
            return late
        a = math.exp(-H / self.lag)  # exact for what is straight between samples
        rest = (1 - a) * self.lag / H
        return np.asarray(signal.lfilter([1 - rest, rest - a], [1, -a], late))

    def logged(self, wanted: np.ndarray) -> np.ndarray:
        """What a logger writes while the driver wants some angle."""
        return wanted / self.gain + self.offset


@dataclass(frozen=True, kw_only=True, eq=False)
class PlantCar:
    """A plant and how to drive it: its inputs for a road-wheel angle and a wanted acceleration [m/s2]."""

    model: OdeModel
    inputs: Callable[[np.ndarray, np.ndarray], np.ndarray]  # of columns of angles and accelerations
    mass: float
    wheelbase: float
    l_f: float
    inertia_z: float
    speeds: tuple[float, float]  # lowest and highest driven [m/s]
    most: float  # largest lateral acceleration [m/s2]
    C_f: float  # of the tires at static load, both of an axle [N/rad]
    C_r: float

    @property
    def l_r(self) -> float:
        """Centre of gravity to rear axle. [m]"""
        return self.wheelbase - self.l_f

    @property
    def pace(self) -> float:
        """How much quicker than a road car it is by its size. [-]"""
        return math.sqrt(2.7 / self.wheelbase)

    def linear(self, v_x: float) -> Matrices:
        """Linear bicycle from road-wheel angle to a_y, with the stiffness of the tires: A, B, C, D."""
        m, J, f, r, C_f, C_r = self.mass, self.inertia_z, self.l_f, self.l_r, self.C_f, self.C_r
        A = [
            [-(C_f + C_r) / (m * v_x), -(C_f * f - C_r * r) / (m * v_x) - v_x],
            [-(C_f * f - C_r * r) / (J * v_x), -(C_f * f * f + C_r * r * r) / (J * v_x)],
        ]
        rows = A, [[C_f / m], [C_f * f / J]], [[A[0][0], A[0][1] + v_x]], [[C_f / m]]
        return tuple(np.array(row) for row in rows)


def _advance(model: Any) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """States of several cars, shape (n_cars, n_states), after inputs of shape (TICK, n_cars, n_inputs)."""
    kernel = model.steps
    if kernel is not None:
        return lambda x, u: kernel.run_many(x, u, last_only=True)
    ticks = model.functions[0].mapaccum("tick", TICK)
    many: dict[int, ca.Function] = {}

    def run(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        n = len(x)
        one = many.setdefault(n, ticks.map(n))
        states = np.asarray(one(x.T, u.transpose(1, 0, 2).reshape(n * TICK, -1).T))
        return states[:, TICK - 1 :: TICK].T

    return run


def driven(car: PlantCar, angles: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Logged channels without noise, shape (n_samples, n_drives, 4), each 10 ms.

    ``angles`` are those of the road wheels at each millisecond, shape (n, n_drives) [rad], ``speeds`` what a PI
    controller holds, shape (n_drives,) [m/s].
    """
    model, advance = car.model, _advance(car.model)
    x = np.array([model.straight(v) for v in speeds])
    at = model.states.index("v_x")
    kp, ki = 1.2 * car.pace, 0.4 * car.pace**2
    ticks, total = len(angles) // TICK, np.zeros(len(speeds))
    states, used = np.empty((ticks, *x.shape)), np.empty((ticks, len(speeds), model.n_inputs))
    for k in range(ticks):
        error = speeds - x[:, at]
        total += ki * TICK * H * error
        rows = angles[k * TICK : (k + 1) * TICK]
        u = car.inputs(rows, np.broadcast_to(np.clip(kp * error + total, -3.0, 3.0), rows.shape))
        states[k], used[k] = x, u[0]
        x = advance(x, u)
    if not np.isfinite(states).all():
        raise ValueError("the plant leaves the finite numbers; expected a stable car: check its parameters")
    flat = evaluate(model.functions[1], states.reshape(-1, model.n_states), used.reshape(-1, model.n_inputs))
    return flat.reshape(ticks, len(speeds), len(LOGGED))


def driven_with(car: PlantCar, steering: Steering, drives: Sequence[Drive]) -> np.ndarray:
    """`driven` for what a driver wants, through his steering."""
    angles = np.column_stack([steering.road_wheel(drive.wanted) for drive in drives])
    return driven(car, angles, np.array([drive.v_x for drive in drives]))


def stiffness(car: PlantCar, places: Sequence[float] = (0.25, 0.8)) -> np.ndarray:
    """Front and rear cornering stiffness by the plant's own linearisation, a row for each speed. [N/rad]

    From the difference of two steady turns, a little to the left and a little to the right: axle forces from the
    balance of a bicycle, slip angles from the motion.
    """
    low, high = car.speeds
    speeds = np.repeat([low + place * (high - low) for place in places], 2)
    gains = [(D - C @ np.linalg.solve(A, B)).item() for A, B, C, D in map(car.linear, speeds)]
    size = 0.02 * car.most / np.array(gains) * np.tile([1.0, -1.0], len(places))
    seconds = 12.0 / min(car.pace, 1.5)
    angles = np.broadcast_to(size, (round(seconds / H / TICK) * TICK, len(size)))
    v_x, v_y, r, _ = driven(car, angles, speeds)[-50:].mean(axis=0).T
    forces = car.mass * v_x * r / car.wheelbase
    quantities = np.stack([forces * car.l_r, forces * car.l_f, size - (v_y + car.l_f * r) / v_x])
    quantities = np.vstack([quantities, -(v_y - car.l_r * r)[None] / v_x])
    F_f, F_r, alpha_f, alpha_r = quantities[:, ::2] - quantities[:, 1::2]
    return np.column_stack([F_f / alpha_f, F_r / alpha_r])


def top_speed_stable(car: PlantCar) -> bool:
    """Whether the linear bicycle is stable at the highest speed."""
    return bool((np.linalg.eigvals(car.linear(car.speeds[1])[0]).real < 0).all())


def static_loads(mass: float, wheelbase: float, l_f: float) -> tuple[float, float]:
    """Load on one front and one rear wheel. [N]"""
    each = 0.5 * mass * GRAVITY / wheelbase
    return each * (wheelbase - l_f), each * l_f
