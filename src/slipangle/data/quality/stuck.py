"""Sensors that stay at one value while the car is driven."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy

from slipangle.data.dataset import Dataset
from slipangle.data.quality.inspect import resting

_SLOW = 0.7  # Hz, below which a car nearly follows its steering
_STUCK = 1.0  # s
_DEAD = 10.0  # s at the end of a drive, for which a speed is not the same by chance
_COARSE = 1.5  # steps of a resolution, fewer than which are one
_BODY = 2.0  # Hz, below which a car still answers its steering
_SELDOM = 0.3  # share of the samples of a steering that are those before, up to which one at rest for long is odd
_LONG, _CREEPS = 2.0, 0.1  # s at rest from which it is, and speed over the largest from which the car drives then
_TURNS, _NOISE = 0.5, 4.0  # swing of r / v_x then, over its standard deviation and in addition its noise
_LEAP = 3.0  # usual steps of a speed, with more of which it goes on after it was stuck


def stuck(data: Dataset) -> dict[str, list[tuple[int, int]]]:
    """Rows (start, stop) over which a sensor stays at one value while the car is steered, by channel."""
    found, steers, fastest = {}, 0.2 * np.std(data["delta"]), 0.3 * np.max(data["v_x"])
    experiments = set(zip(data.starts, data.stops, strict=True))
    swings = 1.5 * np.std(data["r"] / np.maximum(data["v_x"], fastest))
    odd = _swings_anew(data)
    held = [(a, b) for a, b in resting(data, "delta") if _swings(data, a, b, fastest) > swings > 0 or odd(a, b)]
    found |= {"delta": held} if held else {}
    for name in ("r", "v_y", "a_y", "v_x"):
        if name not in data or np.ptp(data[name]) == 0:
            continue
        leap, driven = _leap(data[name], name), experiments if name == "v_x" else set()  # at one speed
        rows = [
            (a, b)
            for a, b in resting(data, name)
            if (b - a - 1) * data.dt > _STUCK
            and (a, b) not in driven
            and _leaps(data, name, a, b, leap)
            and np.ptp(data["delta"][a:b]) > steers
            and np.max(data["v_x"][a:b]) > fastest
        ]
        found |= {name: rows} if rows else {}
    return found


def _leap(x: np.ndarray, name: str) -> float:
    """How far a sensor goes on at least after it was stuck, as the steps of its resolution are passed without; 0: any.

    Of a speed, which moves slowly, it is more than usual; of another channel, more than the one step of a coarse one.
    """
    steps = np.abs(np.diff(x))
    steps = steps[steps > 0]
    usual, finest = float(np.median(steps)), float(np.quantile(steps, 0.01))
    if name == "v_x":
        return _LEAP * usual
    return _COARSE * finest if usual < _COARSE * finest else 0.0


def _leaps(data: Dataset, name: str, a: int, b: int, leap: float) -> bool:
    """Whether a channel goes on, after rows at one value, with more than a step of its resolution, or never does."""
    if b in data.stops:
        return leap == 0.0 or (b - a) * data.dt > _DEAD
    return float(np.abs(data[name][b] - data[name][b - 1])) > leap


def _swings(data: Dataset, a: int, b: int, slowest: float) -> float:
    """By how much r / v_x moves while the steering stays, once it has been answered; fast noise left out. [1/m]"""
    a += round(_STUCK / data.dt)
    if (b - a) * data.dt < _STUCK or np.min(data["v_x"][a:b]) < slowest:
        return 0.0
    return float(np.ptp(low_pass(data["r"][a:b] / data["v_x"][a:b], data.dt)))


def _swings_anew(data: Dataset) -> Callable[[int, int], bool]:
    """Whether r / v_x swings from side to side in rows over which a steering rests that hardly ever does.

    At a steering that is held r / v_x changes with understeer, as speed does, but not its sign. One that comes in steps
    rests on any straight.
    """
    same = np.concatenate([np.diff(part["delta"]) == 0 for part in data.experiments])
    least, rows = _CREEPS * float(np.max(data["v_x"])), max(round(_STUCK / data.dt), 1)
    drives = data["v_x"] > least
    if np.mean(same) > _SELDOM or not least > 0:
        return lambda a, b: False
    turn = data["r"] / np.maximum(data["v_x"], least)
    noise = float(np.median(np.abs(np.diff(turn)[drives[1:]]))) if drives[1:].any() else 0.0
    usual = _TURNS * float(np.std(turn[drives])) + _NOISE * noise

    def swings(a: int, b: int) -> bool:
        if (b - a) * data.dt < _LONG or not drives[a:b].all():
            return False
        inside = low_pass(turn[a + rows : b], data.dt, _BODY)
        return float(np.ptp(inside)) > usual > 0 and float(min(inside.max(), -inside.min())) > 0.2 * usual

    return swings


def low_pass(x: np.ndarray, dt: float, below: float = _SLOW) -> np.ndarray:
    """What is slow enough for a car to nearly follow its steering, or slower than so many Hz."""
    return scipy.signal.sosfiltfilt(scipy.signal.butter(2, min(2 * dt * below, 0.9), output="sos"), x)
