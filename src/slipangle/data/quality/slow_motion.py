"""The slow part of a car's motion, which tells its sensors' zeros: what is fast, stuck or spins is left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.quality.events import runs
from slipangle.data.quality.regression import by_blocks, coefficient, rate_of
from slipangle.data.quality.spins import spinning
from slipangle.data.quality.stuck import low_pass, stuck

SPEEDS = 0.2  # range of speeds over their mean, from which understeer and offsets show
_STRAIGHT = 0.2  # of the largest lateral acceleration, up to which a car goes nearly straight
_SHORT_DRIVE = 4.0  # s, up to which a drive tells nothing
_ANEW = 5  # times that an offset is told, each without the one before
_SEEN, _SURE = 0.01, 5.0  # rad/s and standard errors, from which r is said to have an offset


def zero_of_r(data: Dataset, *, wheelbase: float) -> float:
    """What r reads where the car goes straight; 0 where none shows, or speeds do not differ. [rad/s]

    ``data`` has delta [rad], v_x [m/s], r [rad/s], and delta_r [rad] of steered rear wheels; ``wheelbase`` is in m.
    """
    names = [n for n in ("delta", "v_x", "r", "delta_r") if n in data.names]
    parts, smooth, drives = smoothed(without(data, stuck(data), wheelbase), names)
    value, error = offset_of_r(smooth, drives) if parts else (0.0, np.inf)
    return value if abs(value) > max(_SEEN, _SURE * error) else 0.0


def without(data: Dataset, held: dict[str, list[tuple[int, int]]], wheelbase: float) -> list[Dataset]:
    """The experiments cut where a sensor is stuck, and where the car spins."""
    bad = spinning(data, wheelbase)
    for a, b in (rows for each in held.values() for rows in each):
        bad[a:b] = True
    return [data.rows(a, b) for a, b in runs(data, ~bad)]


def smoothed(parts: Sequence[Dataset], names: Sequence[str]) -> tuple[list[Dataset], dict[str, np.ndarray], np.ndarray]:
    """The drives that last long enough, their channels without what is fast, and the drive of each sample."""
    fast = [part for part in parts if part.n_samples * part.dt > _SHORT_DRIVE]
    smooth = {n: np.concatenate([low_pass(p[n], p.dt) for p in fast]) for n in names} if fast else {}
    return fast, smooth, np.repeat(np.arange(len(fast)), [part.n_samples for part in fast])


def offset_of_r(smooth: dict[str, np.ndarray], drives: np.ndarray) -> tuple[float, float]:
    """What delta, v_x and understeer do not explain of r, and its standard error; infinite at one speed. [rad/s]

    An offset of the steering counts for more the faster the car is, one of the sensor does not. Understeer grows with
    the square of the lateral acceleration, as that of tires near their limit does, and bends count for less than
    straights: a track that turns one way would else leave what bends do for an offset. How late the car is counts as in
    the steering's gain.
    """
    v, r, delta = smooth["v_x"], smooth["r"], over_the_rear(smooth)
    value, error = 0.0, np.inf
    if np.ptp(v) < SPEEDS * v.mean():  # at one speed, offsets of delta and r are one
        return value, error
    for _ in range(_ANEW):  # understeer is that of the motion, without the offset
        true = r - value
        table = np.column_stack(
            [v * delta, v * v * true, v, np.ones(len(v)), rate_of(r, drives), v * (v * true) ** 3, r]
        )
        value, error = coefficient(by_blocks(table * straightness(v * true)[:, None], drives), 3)
    return value, error


def straightness(across: np.ndarray) -> np.ndarray:
    """How far a sample counts where a straight tells, 1 to 0, by the lateral acceleration ``across``. (n,)"""
    return 1 / (1 + (across / (_STRAIGHT * max(float(np.quantile(np.abs(across), 0.99)), 1e-300))) ** 2)


def speeds_differ(v_x: np.ndarray, r: np.ndarray) -> bool:
    """Whether speeds differ where the car turns, as much as `SPEEDS` of them evenly, so that understeer shows.

    Of bends at one speed, understeer is as large a share of all steering as any gain; straights do not tell it. Samples
    count by the square of their lateral acceleration.
    """
    weight = (v_x * r) ** 2
    total = max(float(weight.sum()), 1e-300)
    mean = float(weight @ v_x) / total
    return bool(weight @ (v_x - mean) ** 2 > (SPEEDS * mean) ** 2 / 12 * total)


def over_the_rear(smooth: dict[str, np.ndarray]) -> np.ndarray:
    """What the rear wheels leave of the front's steering angle. [rad]"""
    return smooth["delta"] - smooth.get("delta_r", 0.0)
