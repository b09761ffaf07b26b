"""State spaces are fitted to signals of size one, so that nothing hangs on the units of the channels."""

from __future__ import annotations

import abc
from dataclasses import replace
from typing import Any, NamedTuple, Self, final

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.identify.excitation import CHUNK, is_constant
from slipangle.identify.linear.colour import shared_colour_said
from slipangle.identify.linear.estimator import LinearEstimator
from slipangle.identify.stability import held
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.provenance import provenance

_MORE = 'give a larger order, or focus="simulation"'
_ONE = 1e-9  # from one, within which a size is that of a channel which has been scaled


class Scales(NamedTuple):
    """Data whose inputs and outputs have standard deviations of one, and what they were divided by."""

    given: Dataset
    data: Dataset
    u: np.ndarray  # (n_inputs,), in the inputs' units
    y: np.ndarray  # (n_outputs,), in the outputs' units

    @classmethod
    def of(cls, data: Dataset) -> Self:
        """Of each channel on its own; one that is constant stays as it is."""
        u, y = sizes(data)
        size = np.ones(len(data.names))
        size[[data.index(c) for c in (*data.inputs, *data.outputs)]] = np.concatenate([u, y])
        if np.all(size == 1):
            return cls(data, data, u, y)
        values = data.values / size
        values.setflags(write=False)
        return cls(data, replace(data, values=values), u, y)

    def there(self, model: StateSpaceModel) -> StateSpaceModel:
        """The model of the given data as one of the scaled."""
        return self._changed(model, 1 / self.u, 1 / self.y)

    def back(self, model: StateSpaceModel) -> StateSpaceModel:
        """The model of the scaled data as one of the given, with its estimates and their covariance."""
        if self.data is self.given:
            return model
        found, info = self._changed(model, self.u, self.y), model.fit_info
        if info is None:
            return found
        by = np.array([self._factor(name) for name in info.names])
        told: dict[str, Any] = {
            "values": info.values * by,
            "covariance": info.covariance * np.outer(by, by),
            "noise_std": info.noise_std * self.y,
            **provenance(self.given),
        }
        return replace(found, fit_info=replace(info, **told))

    @staticmethod
    def _changed(model: StateSpaceModel, u: np.ndarray, y: np.ndarray) -> StateSpaceModel:
        wide = y[:, None]
        parts = {"B": model.B / u, "C": wide * model.C, "D": wide * model.D / u, "K": model.K / y}
        return replace(model, **parts, u_offset=u * model.u_offset, y_offset=y * model.y_offset)

    def _factor(self, name: str) -> float:
        """What an estimate of the scaled data is multiplied by, named such as ``B[0,1]`` or ``y_offset[r]``."""
        what, _, place = name[:-1].partition("[")
        at = [int(k) if k.isdigit() else self.given.outputs.index(k) for k in place.split(",")]
        rows = {"C": self.y, "D": self.y, "y_offset": self.y, "u_offset": self.u}.get(what)
        columns = {"B": self.u, "D": self.u, "K": self.y}.get(what)
        return float((1.0 if rows is None else rows[at[0]]) / (1.0 if columns is None else columns[at[1]]))


class ScaledEstimator(LinearEstimator[StateSpaceModel]):
    """Fits a state space to scaled signals and gives it back in the units of the data."""

    def _remarks(self, model: StateSpaceModel, data: Dataset) -> tuple[str, ...]:
        coloured = shared_colour_said(model, data, _MORE) if getattr(self, "focus", "") == "prediction" else ()
        said = held(model.poles, getattr(self, "max_radius", None))  # who sets one means it
        return (*coloured, said) if said else coloured

    @final
    def _fit(self, data: Dataset) -> StateSpaceModel:
        scales = Scales.of(data)
        return scales.back(self._within(scales)._scaled_fit(scales.data))

    def _within(self, scales: Scales) -> Self:
        """The same settings, with what has a unit in those sizes."""
        return self

    @abc.abstractmethod
    def _scaled_fit(self, data: Dataset) -> StateSpaceModel:
        """`_fit` to signals of size one."""


def sizes(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of inputs and outputs; 1 for a channel that is constant, or all but scaled already."""
    return np.array([_size(data[c]) for c in data.inputs]), np.array([_size(data[c]) for c in data.outputs])


def _size(x: np.ndarray) -> float:
    if is_constant(x):
        return 1.0
    mean = float(np.mean(x))
    power = sum(float(np.sum((x[a : a + CHUNK] - mean) ** 2)) for a in range(0, len(x), CHUNK))  # no copy of the whole
    std = float(np.sqrt(power / len(x)))
    return std if 0 < std < np.inf and abs(std - 1) > _ONE else 1.0


def weighed(weights: Any, scales: Scales) -> Any:
    """Typical errors of the outputs in those sizes; words stay."""
    return weights if isinstance(weights, str) else tuple(float(w) for w in np.array(weights) / scales.y)
