"""`Lagging`: a model whose input answers late by a time that nobody told."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import Annotated

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError, nearest
from slipangle.fields import Within
from slipangle.models.model import Model, derived, taken
from slipangle.models.wrappers.wrapper import Wrapper
from slipangle.ops import Scalar, Vector, concatenate, exp, sqrt, stack


@dataclass(frozen=True)
class Lagging(Wrapper):
    """A model behind one more first-order lag, whose time constant is a state that an estimator finds.

    Besides the model's states there are ``delta_lagged``, the input behind the lag, and ``lag_delta`` [s] for an input
    ``delta``. The time constant is the smooth positive part of ``lag_delta``, ``(l + sqrt(l^2 + 4 e^2)) / 2`` with
    e = ``least``; without news of it ``lag_delta`` fades to zero. A steering that answers 40 ms later than was
    identified shows in the yaw rate of the first bend: the filter's model is then that late too, and so is the plan
    of a controller on it. The model sees the mean of the lagged input over each step, so that with no lag it is itself.

    Put `Disturbed` and `OnGround` around it, not into it.

    Parameters
    ----------
    model : Model
        What answers late; not on the ground.
    control : str
        Input behind the lag.
    least : float
        Time constant where nothing is known. [s]
    fading : float
        Time constant with which what was found is forgotten. [s]

    Raises
    ------
    ParameterError
        If the model has no such input or is on the ground already, or a time is not positive.
    """

    model: Model
    _: KW_ONLY
    control: str = "delta"
    least: Annotated[float, Within(0, unit="s", open="both")] = 0.002
    fading: Annotated[float, Within(0, unit="s", open="both")] = 20.0

    fit_info = taken("model.fit_info")
    states = derived(lambda self: (*self.model.states, f"{self.control}_lagged", f"lag_{self.control}"))

    def __post_init__(self) -> None:
        if self.model.off_ground is not self.model:
            raise ParameterError("the model is on the ground already; expected OnGround(Lagging(model))")
        if self.control not in self.model.inputs:
            raise ParameterError(f"the model has no input '{self.control}'; {nearest(self.control, self.model.inputs)}")
        for name in ("least", "fading"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ParameterError(f"{name} is {getattr(self, name)} s; expected a positive time")

    def lag(self, x: Vector) -> Scalar:
        """Time constant of the lag in a state, shape (n_states,). [s]"""
        found = x[self.model.n_states + 1]
        return 0.5 * (found + sqrt(found * found + 4.0 * self.least**2))

    def initial_state(self, data: Dataset) -> np.ndarray:
        """The model's, with the input as it is first and nothing known of the lag."""
        first = data.columns((self.control,))[0, 0] if len(data) else 0.0
        return np.append(np.asarray(self.model.initial_state(data), dtype=float), [first, 0.0])

    def _behind(self, x: Vector, u: Vector) -> tuple[Vector, Scalar]:
        """Inputs as the model sees them over a step, and the lagged one at its end."""
        place, before, lag = self.inputs.index(self.control), x[self.model.n_states], self.lag(x)
        left = exp(-self.dt / lag)
        mean = u[place] + (before - u[place]) * (1.0 - left) * lag / self.dt
        seen = [mean if i == place else u[i] for i in range(self.n_inputs)]
        return stack(seen), u[place] + (before - u[place]) * left

    def step(self, x: Vector, u: Vector) -> Vector:
        """The model's by the lagged input."""
        n = self.model.n_states
        seen, later = self._behind(x, u)
        return concatenate([self.model.step(x[:n], seen), stack([later, math.exp(-self.dt / self.fading) * x[n + 1]])])

    def output(self, x: Vector, u: Vector) -> Vector:
        """The model's by the lagged input."""
        return self.model.output(x[: self.model.n_states], self._behind(x, u)[0])

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """The model's; a single measurement says nothing of a lag."""
        n = self.model.n_states
        return concatenate([self.model.correct(x[:n], self._behind(x, u)[0], y), 1.0 * x[n:]])
