"""Where a car spins: no model of small slip angles follows it, and a second of it outweighs minutes of driving."""

from __future__ import annotations

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.quality.events import runs

_SIDEWAYS = 0.7  # v_y over v_x, of a car that faces elsewhere than it goes
_TURNED = 1.2  # tangent of a steering angle that turns a car so, further than road wheels do
_SLOWEST = 1.0  # wheelbases a second, below which a car parks
_LASTS = 0.1  # s, at least; what is shorter are outliers
_BEFORE, _AFTER = 2.0, 1.0  # s, in which a car breaks away and is caught
_RARE, _MOST = 0.1, 0.5  # shares of the driving up to which it spins, and is cut; more is a channel in another unit


def spinning(data: Dataset, wheelbase: float) -> np.ndarray:
    """Samples around spins, shape (n_samples,), True from where the car breaks away until it is caught.

    It spins where v_y is 0.7 of v_x and more, or ``r wheelbase / v_x`` 1.2 and more. ``data`` has v_x [m/s], r [rad/s],
    and v_y [m/s] where measured; ``wheelbase`` is in m. None is where there would be much of it: a channel is in
    another unit then.
    """
    forward, slowest = np.maximum(np.abs(data["v_x"]), _SLOWEST * wheelbase), _SLOWEST * wheelbase
    spins = np.abs(data["r"]) * wheelbase > _TURNED * forward
    if "v_y" in data:
        spins |= np.abs(data["v_y"]) > np.maximum(_SIDEWAYS * np.abs(data["v_x"]), slowest)
    around = np.zeros(data.n_samples, dtype=bool)
    before, after = round(_BEFORE / data.dt), round(_AFTER / data.dt)
    for a, b in runs(data, spins):
        if (b - a) * data.dt >= _LASTS:
            first, last = max(s for s in data.starts if s <= a), min(s for s in data.stops if s >= b)
            around[max(a - before, first) : min(b + after, last)] = True
    moving = int(np.sum(np.abs(data["v_x"]) > slowest))
    return around if spins.sum() <= _RARE * moving and around.sum() <= _MOST * moving else np.zeros_like(around)
