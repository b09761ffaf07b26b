"""What the cars drive: steering over time at held speeds, gentle to train, others and harder to test.

Frequencies scale with the inverse root of the wheelbase, as those of like cars of different size do; amplitudes are
set so that a linear bicycle with the car's stiffness reaches a share of its largest lateral acceleration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import signal

H = 0.001  # s, step of the plants and of the steering signals
SECONDS = 20.0
ROAD_CAR = 2.7  # m, wheelbase for which the frequencies are written
STEEPEST = 0.18  # rad, largest road-wheel angle
Shape = Callable[[np.random.Generator, np.ndarray, float], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Drive:
    """One experiment: road-wheel angle that the driver wants at each millisecond [rad], speed that he holds [m/s]."""

    name: str
    wanted: np.ndarray
    v_x: float


def _multisine(rng: np.random.Generator, t: np.ndarray, pace: float) -> np.ndarray:
    """Thirty sines of random phase, 0.1 to 2.2 Hz."""
    f = pace * np.geomspace(0.1, 2.2, 30)
    return np.sum(np.sin(2 * np.pi * (f[:, None] * t + rng.random((30, 1)))) / np.sqrt(f / f[0])[:, None], axis=0)


def _sweep(rng: np.random.Generator, t: np.ndarray, pace: float) -> np.ndarray:
    """A sine from 0.15 to 2.5 Hz."""
    return rng.choice([-1.0, 1.0]) * signal.chirp(t, 0.15 * pace, t[-1], 2.5 * pace, "logarithmic", phi=-90)


def _steps(rng: np.random.Generator, t: np.ndarray, pace: float) -> np.ndarray:
    """Levels held for a second or two, and lane changes between them."""
    out, at, side = np.zeros_like(t), 0.8 / pace, 1.0
    while at < t[-1]:
        rise, hold = 0.3 / pace, rng.uniform(1.0, 2.2) / pace
        if rng.random() < 0.35:  # lane change: one sine
            length = rng.uniform(1.5, 2.5) / pace
            inside = (t >= at) & (t < at + length)
            out[inside] += side * np.sin(2 * np.pi * (t[inside] - at) / length)
            hold = length
        else:
            level = side * rng.uniform(0.5, 1.0)
            out += level * (np.clip((t - at) / rise, 0, 1) - np.clip((t - at - hold) / rise, 0, 1))
        at, side = at + hold + 0.9 / pace, -side
    return out


def _random(rng: np.random.Generator, t: np.ndarray, pace: float) -> np.ndarray:
    """Noise below 0.9 Hz whose size swells and fades."""
    low = signal.butter(3, 0.9 * pace, fs=1 / H, output="sos")
    noise = signal.sosfilt(low, rng.standard_normal(len(t) + 5000))[5000:]
    return noise * (1 + 0.6 * np.sin(2 * np.pi * t / 9 + rng.uniform(0, 6)))


def _double_lane_change(rng: np.random.Generator, t: np.ndarray, pace: float) -> np.ndarray:
    """Two to the left and back, of different pace, with a pause in the other lane."""
    out = np.zeros_like(t)
    lengths = np.geomspace(2.6, 1.3, 3) / pace * rng.uniform(0.9, 1.1)
    at = 1.0 / pace
    while at < t[-1]:
        for length in lengths:
            for side in (1.0, -1.0):
                inside = (t >= at) & (t < at + length)
                out[inside] += side * np.sin(2 * np.pi * (t[inside] - at) / length)
                at += length + 0.6 / pace
            at += 1.0 / pace
    return out


TRAIN: tuple[tuple[str, Shape], ...] = (("multisine", _multisine), ("sweep", _sweep), ("steps", _steps))
TRAIN_SPEEDS, TRAIN_SHARES = (0.0, 0.33, 0.67, 1.0), (0.28, 0.32, 0.36, 0.40)
TEST: tuple[tuple[str, Shape, float, float], ...] = (
    ("random", _random, 0.22, 0.45),
    ("random", _random, 0.80, 0.50),
    ("double lane change", _double_lane_change, 0.45, 0.50),
    ("double lane change", _double_lane_change, 0.92, 0.55),
)


def planned(
    rng: np.random.Generator,
    *,
    wheelbase: float,
    speeds: tuple[float, float],
    most: float,
    lateral: Callable[[np.ndarray, float], np.ndarray],
) -> tuple[list[Drive], list[Drive]]:
    """Training and test drives of a car.

    ``speeds`` are its lowest and highest [m/s], ``most`` is its largest lateral acceleration [m/s2], and ``lateral``
    gives that of a linear bicycle from the steering at each millisecond and the speed.
    """
    pace = float(np.clip((wheelbase / ROAD_CAR) ** -0.5, 0.7, 2.5))
    t = H * np.arange(round(SECONDS / H) + 1)
    fade = np.clip((t - 0.3 / pace) * pace / 0.5, 0, 1)

    def drive(name: str, shape: Shape, place: float, share: float) -> Drive:
        v_x = speeds[0] + place * (speeds[1] - speeds[0])
        steering = fade * shape(rng, t, pace)
        size = min(share * most / np.abs(lateral(steering, v_x)).max(), STEEPEST / np.abs(steering).max())
        return Drive(name=f"{name} at {v_x:.3g} m/s", wanted=size * steering, v_x=v_x)

    pairs = zip(TRAIN_SPEEDS, TRAIN_SHARES, strict=True)
    train = [drive(name, shape, place, share) for place, share in pairs for name, shape in TRAIN]
    return train, [drive(*test) for test in TEST]
