"""Channels under each other's name: the yaw rate and v_y, the yaw rate and a_y, the yaw rate and the steering."""

from __future__ import annotations

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.quality.regression import lag_of, slope_of

TIED = 0.7  # agreement of a_y with v_x r, from which it is one of turning
FELT = 0.6, 1.7  # a_y over v_x r, between which no unit of v_x, r or a_y is wrong
_TURNING = 0.9  # agreement of r and a_y under the other's name, from which they are swapped
_CLOSER = 0.5  # 1 less an agreement swapped back, over that as logged, up to which the former is far better
_AHEAD = 0.02  # s, or a sample, by which a yaw rate that is a steering comes before a steering that is a yaw rate
_TOGETHER = 0.8  # their agreement at that lag
_LESS = 0.05  # by which that may be less than the agreement as logged
_ORDINARY = 0.45, 2.2  # gain of a steering logged as road-wheel angle, as it looks with understeer in it


def with_a_y(smooth: dict[str, np.ndarray], units: tuple[tuple[float, float], ...]) -> bool:
    """Whether r is v_x times a_y, as a_y should be of r, and a_y is nothing that a wrong unit makes of v_x r.

    At one speed either is in proportion to the other; then a share of v_x r that is none of those of wrong ``units``,
    from and to [-], tells. ``smooth`` has the slow part of the channels.
    """
    if "a_y" not in smooth:
        return False
    v, r, a_y = (smooth[n] for n in ("v_x", "r", "a_y"))
    (now, agree), (back, agree_back) = slope_of(v * r, a_y), slope_of(v * a_y, r)
    if not (FELT[0] < back < FELT[1] and agree_back > _TURNING) or (FELT[0] < now < FELT[1] and agree > TIED):
        return False
    return 1 - agree_back < _CLOSER * (1 - agree) or not any(low < now < high for low, high in units)


def with_steering(fast: list[Dataset], now: tuple[float, float], back: tuple[float, float]) -> bool:
    """Whether r comes before delta, and follows as wheelbase and speed have it only with both under the other's name.

    ``now`` and ``back`` are gain and agreement of the steering as logged and swapped back, see `kinematic_gain`. What
    is late, or of another unit, is behind its steering still.
    """
    (gain, agree), (gain_back, agree_back) = now, back
    if not _ORDINARY[0] < gain_back < _ORDINARY[1] or agree_back < agree - _LESS:
        return False
    if _ORDINARY[0] < gain < _ORDINARY[1] and 1 - agree_back > _CLOSER * (1 - agree):
        return False
    behind, tied = lag_of([(part["delta"], part["r"]) for part in fast], fast[0].dt)
    return behind <= -max(_AHEAD, fast[0].dt) and tied > _TOGETHER
