"""Whether delta stops at an end of its sensor's range while the car goes on turning in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from slipangle.data.dataset import Dataset, join
from slipangle.data.quality.events import runs
from slipangle.data.quality.lateness import steering_lag
from slipangle.data.quality.stuck import low_pass
from slipangle.units import read_in

_BODY = 1.0  # Hz, below which a car about follows its steering
_MEAN = 0.1  # s, over which noise is taken out of an angle that rests
_TOP = 0.999  # quantile of the angles to a side that is the end of their range
_NOISE, _LEAST = 3.0, 2e-3  # of the noise, and share of that end, within which an angle rests there
_RESTS, _VISITS = 0.3, 3  # s that it does so, and how often
_BEFORE, _AFTER = 0.3, 1.0  # s around that, which what is cut off changes too
_DRIVES = 0.3  # of the higher speeds, from which a car is looked at
_ENOUGH = 10.0  # s of driving elsewhere, from which it tells how the car answers
_SOON, _AT_ONCE = 0.15, 0.75  # share of a rest after which it asks for that share of the more if steered so
_BEYOND, _SURE = 0.08, 3.0  # share of the end by which the car asks for more, and the scatter of that elsewhere


def clipped(fast: Sequence[Dataset], wheelbase: float) -> list[str]:
    """A sentence on a delta that is cut off, of drives with delta [rad], v_x [m/s], r [rad/s]; ``wheelbase`` in m.

    Where it rests at its largest value, time and again, the car turns as if it were larger by far.
    """
    data, said = join(*fast), []
    ends = {side: _rests(data, side) for side in (1.0, -1.0)}
    if all(len(rests) < _VISITS for _, rests in ends.values()):
        return []
    drives, elsewhere = _drives(data), _drives(data)
    for a, b in (rest for _, rests in ends.values() for rest in rests):
        elsewhere[max(a - round(_BEFORE / data.dt), 0) : b + round(_AFTER / data.dt)] = False
    if elsewhere.sum() * data.dt < _ENOUGH:
        return []
    delta, asked = _asked(fast, wheelbase, elsewhere)
    scatter = float(np.std((asked - delta)[elsewhere]))
    factor, unit = read_in("delta", data.unit("delta"))
    for side, (end, rests) in ends.items():
        whole = [side * asked[a:b] for a, b in rests if drives[a:b].all()]
        if len(whole) < _VISITS:
            continue
        most = float(np.median([each.max() for each in whole]))
        soon = [each[[round(_SOON * len(each)), -round(_SOON * len(each)) - 1]].max() for each in whole]
        first = float(np.median(soon))
        more = most - end
        if more < max(_BEYOND * end, _SURE * scatter) or first - end > _AT_ONCE * more:
            continue
        reads, turns = (f"{factor * side * angle:.3g} {unit}" for angle in (end, most))
        said.append(
            f"delta goes no further than {reads}, where r asks for {turns} and more, {len(whole)} times: its sensor is "
            "cut off there; log a wider range, or leave that out"
        )
    return said


def _rests(data: Dataset, side: float) -> tuple[float, list[tuple[int, int]]]:
    """The largest angle to a side [rad], and rows (start, stop) over which it rests there."""
    bends = np.concatenate([np.diff(part["delta"], 2) for part in data.experiments]) / np.sqrt(6)  # of noise alone
    width = max(round(_MEAN / data.dt), 1)
    angle = side * np.concatenate([uniform_filter1d(part["delta"], width) for part in data.experiments])
    end = float(np.quantile(angle, _TOP))
    within = max(_NOISE * float(np.median(np.abs(bends))), _LEAST * end)
    rests = [(a, b) for a, b in runs(data, angle > end - within) if (b - a) * data.dt > _RESTS]
    return end, rests if end > 0 else []


def _drives(data: Dataset) -> np.ndarray:
    return data["v_x"] > _DRIVES * np.quantile(data["v_x"], 0.9)


def _asked(fast: Sequence[Dataset], wheelbase: float, elsewhere: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The slow part of delta, and what r of so much later asks for, as it does ``elsewhere``. [rad]"""
    lag, columns = steering_lag(fast, wheelbase), list[np.ndarray]()
    for part in fast:
        delta, v, r = (low_pass(part[name], part.dt, _BODY) for name in ("delta", "v_x", "r"))
        t = np.arange(part.n_samples) * part.dt
        r = np.interp(t + lag, t, r)
        columns.append(np.column_stack([wheelbase * r / np.maximum(v, 0.1), v * r, np.ones(len(v)), delta]))
    table = np.concatenate(columns)
    told = np.linalg.lstsq(table[elsewhere, :3], table[elsewhere, 3], rcond=None)[0]
    return table[:, 3], table[:, :3] @ told
