"""`Observed`: the state of a controller's model, as an estimator knows it in the loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from slipangle.errors import ParameterError, nearest
from slipangle.estimate.measurements import plain_name
from slipangle.models.model import Model


class Observed:
    """An estimator at work for a controller.

    Parameters
    ----------
    estimator : EKF
        Has every state of the controller's model, and X and Y.
    model : Model
        The controller's.
    channels : sequence of str
        What can be measured: of the estimator's outputs at least one.

    Raises
    ------
    ParameterError
        If a state is missing, lags of different sample times would be taken for each other, or nothing is measured.
    """

    def __init__(self, estimator: Any, model: Model, channels: Sequence[str]) -> None:
        own = estimator.model
        known = (*own.states, *own.inputs)
        for name in (*model.states, "X", "Y"):
            if name not in known:
                raise ParameterError(
                    f"the estimator does not know '{name}'; {nearest(name, known)}: estimate with the controller's "
                    "model, on the ground"
                )
        lags = [name for name in model.states if plain_name(name) != name and name.endswith((")", "]"))]
        if lags and abs(own.dt - model.dt) > 1e-9:
            raise ParameterError(
                f"'{lags[0]}' is {own.dt:g} s ago in the estimator and {model.dt:g} s in the controller; expected one "
                "sample time: estimate with the controller's model"
            )
        if not set(own.outputs) & set(channels):
            raise ParameterError(
                f"none of the estimator's outputs {list(own.outputs)} is measured; expected at least one: use channels "
                "of the plant"
            )
        self._estimator = estimator
        self._places = [known.index(name) for name in model.states]
        self._position = known.index("X"), known.index("Y")
        self._tracker: Any = None
        self._all = np.zeros(len(known))

    def begin(self, measured: Mapping[str, float]) -> np.ndarray:
        """Start where channels by name say the car is; the state of the controller's model."""
        self._tracker = self._estimator.begin(measured)
        return self._told()

    def take(self, measured: Mapping[str, float]) -> np.ndarray:
        """Take in channels by name, inputs among them; the state of the controller's model now."""
        self._tracker.take(measured)
        return self._told()

    def hold(self, inputs: Mapping[str, float]) -> None:
        """Inputs by name that act from now on."""
        self._tracker.hold(inputs)

    def _told(self) -> np.ndarray:
        state = self._tracker.state
        self._all[: len(state)], self._all[len(state) :] = state, self._tracker.inputs
        return self._all[self._places]

    @property
    def pose(self) -> dict[str, float]:
        """X and Y now. [m]"""
        return {name: float(self._all[i]) for name, i in zip("XY", self._position, strict=True)}

    @property
    def tracker(self) -> Any:
        """The estimator at work, with its covariance and innovations."""
        return self._tracker
