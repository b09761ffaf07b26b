"""Levels that a linear model without a constant has no place for."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import SlipangleError
from slipangle.models.black_box.statespace import StateSpaceModel

_SEEN = 10_000  # samples that are looked at, from the start
_LAGS = 10  # of the regression that tells at once where there is none
_SURE = 5.0  # standard deviations beyond which a level is none of chance
_SHARE = 0.1  # of an output's standard deviation, below which a level does little


def level_said(data: Dataset, fix: str) -> str:
    """A sentence about the levels that outputs keep where all inputs are zero, by a model that has them; else empty.

    A long ARX model with a constant is enough to see that there are none. Where noise on the output or missing lags
    bias its gain, inputs with a mean make a constant of that: so what it says counts only if a state space with free
    levels, fitted to its free run, says the same. ``fix`` is how the estimator takes levels in.
    """
    seen = data.rows(0, min(_SEEN, data.n_samples))
    if not data.inputs or not _suspected(seen):
        return ""
    StateSpace = import_module("slipangle.identify.linear.statespace").StateSpace  # which asks this file in turn
    try:
        model: Any = StateSpace(offsets="output", max_radius=1.0)._fit(seen)
    except SlipangleError:
        return ""
    level, std = _level(model)
    sizes = np.array([np.std(seen[n]) for n in seen.outputs])
    at = np.flatnonzero((np.abs(level) > _SURE * std) & (np.abs(level) > _SHARE * sizes))
    if not len(at):
        return ""
    told = ", ".join(f"{seen.outputs[i]} of {level[i]:.4g} ± {1.96 * std[i]:.2g}" for i in at)
    means = ", ".join(f"{n} {np.mean(seen[n]):.3g}" for n in (*(seen.outputs[i] for i in at), *seen.inputs))
    return (
        f"the data have a level that a model without a constant cannot hold: with all inputs zero {told} (95 %; the "
        f"means are {means}), so gains and poles may be off by more than their intervals; expected data about zero: "
        f"set {fix}, or subtract the means"
    )


def _suspected(data: Dataset) -> bool:
    """Whether a constant beside many lags is one that chance does not make."""
    ARX = import_module("slipangle.identify.linear.arx").ARX
    for lags in (_LAGS, 3, 1):
        try:
            info: Any = ARX(na=lags, nb=lags, nk=0, offset=True)._fit(data).fit_info
        except SlipangleError:
            continue
        each = len(info.names) // len(data.outputs)
        constants, variance = info.values[each - 1 :: each], np.diag(info.covariance)[each - 1 :: each]
        return bool(np.any(np.abs(constants) > _SURE * np.sqrt(variance)))
    return False


def _level(model: StateSpaceModel) -> tuple[np.ndarray, np.ndarray]:
    """Outputs at rest with all inputs zero and their standard deviations, shape (n_outputs,) each."""
    info: Any = model.fit_info
    values = np.array(info.values)
    steps = 1e-6 * np.maximum(np.abs(values), 1e-3)
    slopes = np.empty((model.n_outputs, len(values)))
    for j, step in enumerate(steps):
        ends = [_at_rest(model.with_estimates(values + sign * step * np.eye(len(values))[j])) for sign in (1, -1)]
        slopes[:, j] = (ends[0] - ends[1]) / (2 * step)
    variance = np.einsum("ij,jk,ik->i", slopes, info.covariance, slopes)
    std = np.sqrt(np.where(np.isfinite(variance), np.maximum(variance, 0.0), np.inf))
    return _at_rest(model), std


def _at_rest(model: Any) -> np.ndarray:
    state = np.linalg.lstsq(np.eye(model.order) - model.A, -model.B @ model.u_offset, rcond=None)[0]
    return model.y_offset + model.C @ state - model.D @ model.u_offset
