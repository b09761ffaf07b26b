"""Test data whose channels are not those of the training data: a sign that turned, another unit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import SimulationError
from slipangle.models.model import Model, Trajectory
from slipangle.units import to_si

_BAD, _GOOD, _BETTER = 0.7, 0.5, 0.5  # error as it is, at least; mended, at most; mended over as it is, at most [-]
_AS_GOOD = 1.05  # of the error of the best, up to which another one explains as much
_MISTAKEN = {"rad": "deg", "rad/s": "deg/s", "rad/s2": "deg/s2", "m/s": "km/h", "m/s2": "g"}  # for which unit


def misread(model: Model, data: Dataset, run: Trajectory | None) -> str:
    """Which one channel of the data, its sign turned or in another unit, would let the model follow them; else empty.

    Looked for where the free run ``run`` of an output is hardly better than a constant, or broke down (None). What
    mends it has to halve the error of all such outputs at least, to less than half of their standard deviation, and may
    make no other worse: chance, or another car, does not do that.
    """
    now = np.full(model.n_outputs, np.inf) if run is None else _errors(run)
    bad = now >= _BAD
    if not bad.any():
        return ""
    mended: list[tuple[float, str, Trajectory]] = []
    for name, factor, words in _mistakes(model, data):
        try:
            other = model._simulate(data.with_channel(name, factor * data[name], data.unit(name)))
        except SimulationError:
            continue
        then = _errors(other)
        if np.all(then[bad] <= np.minimum(_GOOD, _BETTER * now[bad])) and np.all(then <= _AS_GOOD * now):
            mended.append((float(np.mean(then)), words, other))
    if not mended:
        return ""
    best, _, other = min(mended, key=lambda tried: tried[0])
    alike = " or ".join(words for error, words, _ in mended if error <= _AS_GOOD * best)
    return (
        f"the free run fits {_fits(other)} with {alike}, in place of "
        f"{'none' if run is None else _fits(run)}; expected channels of '{data.name}' as those that the model was "
        "fitted to: check sign and unit"
    )


def _mistakes(model: Model, data: Dataset) -> Iterator[tuple[str, float, str]]:
    """Channel, factor that mends it, and in words."""
    for name in (*model.inputs, *model.outputs):
        yield name, -1.0, f"the sign of {name} turned"
        unit = data.unit(name)
        if unit in _MISTAKEN:
            other = _MISTAKEN[unit]
            size = float(to_si(1.0, other))
            yield name, size, f"{name} read in {other}"
            yield name, 1 / size, f"{name} read in {unit} where it was declared in {other}"


def _errors(run: Trajectory) -> np.ndarray:
    """RMSE of each output over its standard deviation, shape (n_outputs,)."""
    kept = run.predicted
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.maximum(np.std(run.measured[kept], axis=0), np.finfo(float).tiny)
        return np.sqrt(np.mean(run.error[kept] ** 2, axis=0)) / size


def _fits(run: Trajectory) -> str:
    each = zip(run.outputs, _errors(run), strict=True)
    return ", ".join(f"{name} to {max(100 * (1 - e), -9999.0):.0f} %" for name, e in each)
