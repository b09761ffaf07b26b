"""`Disturbed`: a model pushed by something that it does not know, which lasts: wind, a bank, a wrong stiffness."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError, nearest
from slipangle.models.model import Model, derived, taken
from slipangle.models.wrappers.wrapper import Wrapper
from slipangle.ops import Vector, concatenate, stack


@dataclass(frozen=True)
class Disturbed(Wrapper):
    """A model whose states are pushed by unknown rates that stay as they are until an estimator says otherwise.

    For each name in ``on`` there is one more state, such as ``d_r`` [unit of r per second], by which that state changes
    more. A controller on this model, with an estimator that finds these, has no steady error however the plant differs
    from the model, as long as there are as many of them as outputs are measured on a straight line [1]_. Put
    `OnGround` around it, not into it.

    Parameters
    ----------
    model : Model
        What is pushed; not on the ground.
    on : tuple of str
        States: of an ODE by their names; ``"r"`` of a model with lags is its newest ``r[k]``, of a hybrid the base
        model's.

    Raises
    ------
    ParameterError
        If a state is not known or named twice, or the model is on the ground already.

    References
    ----------
    .. [1] G. Pannocchia, J. B. Rawlings, Disturbance models for offset-free model-predictive control, AIChE Journal
       49(2), 2003, 426-437.
    """

    model: Model
    _: KW_ONLY
    on: tuple[str, ...] = ("v_y", "r")

    fit_info = taken("model.fit_info")
    states = derived(lambda self: (*self.model.states, *(f"d_{name}" for name in self.on)))

    def __post_init__(self) -> None:
        object.__setattr__(self, "on", tuple(self.on))
        if self.model.off_ground is not self.model:
            raise ParameterError("the model is on the ground already; expected OnGround(Disturbed(model))")
        if not self.on or len(set(self.on)) < len(self.on):
            raise ParameterError(f"on is {self.on}; expected one or more states, each once")
        for name in self.on:
            self._place(name)

    def _place(self, name: str) -> int:
        states = self.model.states
        for known in (name, f"{name}[k]", f"base {name}", f"base {name}[k]"):
            if known in states:
                return states.index(known)
        raise ParameterError(f"the model has no state '{name}'; {nearest(name, states)}: use one of these in on")

    def initial_state(self, data: Dataset) -> np.ndarray:
        """The model's, undisturbed."""
        return np.append(np.asarray(self.model.initial_state(data), dtype=float), np.zeros(len(self.on)))

    def step(self, x: Vector, u: Vector) -> Vector:
        """The model's, pushed; the disturbances stay."""
        n = self.model.n_states
        later, places = self.model.step(x[:n], u), [self._place(name) for name in self.on]
        pushed = [later[i] + self.dt * x[n + places.index(i)] if i in places else later[i] for i in range(n)]
        return concatenate([stack(pushed), 1.0 * x[n:]])

    def output(self, x: Vector, u: Vector) -> Vector:
        """The model's."""
        return self.model.output(x[: self.model.n_states], u)

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """The model's; a single measurement says nothing of a disturbance."""
        n = self.model.n_states
        return concatenate([self.model.correct(x[:n], u, y), 1.0 * x[n:]])
