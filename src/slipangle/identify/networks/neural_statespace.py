"""Neural state space with an encoder, by Adam on windows of free runs; its innovation gain in a second pass."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import IdentifiabilityWarning, ModelWarning
from slipangle.fields import Count, Whole
from slipangle.identify.linear.orders import Chosen
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.lure.starts import unit_states
from slipangle.identify.networks.estimator import Again, NetworkEstimator, Settled
from slipangle.identify.networks.problem import Stage
from slipangle.identify.networks.windows import Recurrence, beside, forward, from_linear, layers, network
from slipangle.models.black_box.networks import MLP, Activation, Scaling
from slipangle.models.black_box.neural_statespace import NeuralStateSpaceModel
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.model import derived

ORDERS = tuple(range(1, 9))
STAGES = (Stage(horizon=10, epochs=1500), Stage(horizon=40, epochs=1500))
Affine = tuple[np.ndarray, np.ndarray]  # slope and constant
GAIN_STAGES = (Stage(horizon=40, epochs=300, learning_rate=1e-2),)


@dataclass(frozen=True, kw_only=True)
class NeuralStateSpace(NetworkEstimator[NeuralStateSpaceModel]):
    """Estimator of a neural state space.

    The loss is the error of free runs over short windows, each started by the encoder. With the networks fixed, the
    innovation gain then minimises the one-step-ahead error.

    Parameters
    ----------
    order : int or "chosen"
        States, at least 1; if not given, those of the linear state space whose free run over a stretch held out of
        what is not held out here is best, see `slipangle.identify.linear.statespace.StateSpace.choose_order`.
    lags : int, optional
        Samples that the encoder reads; by default ``2 order + 1``, which suffices for almost every smooth system.
    emission_hidden : tuple of int
        Neurons of each hidden layer of the output network, by default affine; ``hidden`` has those of the transition
        and the encoder.
    feedthrough : bool
        Let the outputs depend on the inputs of the same sample.
    gain_stages : tuple of Stage
        Training of the innovation gain; empty leaves it at zero.
    hidden, activation, stages, holdout, seeds, linear_start, precision
        See `NetworkEstimator`.

    Source: G. Beintema, R. Toth, M. Schoukens, Nonlinear state-space identification using deep encoder networks, Proc.
    3rd Conference on Learning for Dynamics and Control, 2021.
    """

    order: Count | Chosen = "chosen"
    lags: Whole = 0
    hidden: tuple[Count, ...] = (32, 32)
    emission_hidden: tuple[Count, ...] = ()
    activation: Activation = "tanh"
    feedthrough: bool = False
    stages: tuple[Stage, ...] = STAGES
    gain_stages: tuple[Stage, ...] = GAIN_STAGES

    _what = "a neural state space"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lags == 0 and self.order != "chosen":
            object.__setattr__(self, "lags", 2 * self.order + 1)

    _memory = derived(lambda self: self.lags)

    def settled(self, data: Dataset) -> tuple[Self, Settled]:
        """These settings with the order a number, and how it was chosen."""
        if self.order != "chosen":
            return self, Settled()
        inner = data if self.holdout == 0 else data.split(1 - self.holdout)[0]
        with warnings.catch_warnings():
            for kind in (ModelWarning, IdentifiabilityWarning):  # of models that only tell orders apart
                warnings.simplefilter("ignore", kind)
            choice = replace(self._start, order=ORDERS).choose_order(inner)
        said = f"{choice.said}, as a linear state space"
        return replace(self, order=choice.order), Settled(said, choice.candidates)

    @property
    def _start(self) -> StateSpace:
        """Estimator of the linear model to start from."""
        order: Any = 1 if self.order == "chosen" else self.order
        return StateSpace(order=order, focus="simulation", offsets="output", direct=self.feedthrough, max_radius=1.0)

    @property
    def _n(self) -> int:
        """The order, once it is a number."""
        n: Any = self.order
        return n

    def _n_seen(self, ny: int, nu: int) -> int:
        return self.lags * (ny + nu)

    def _problem(self) -> StateNetwork:
        return StateNetwork(lags=self.lags, activation=self.activation, feedthrough=self.feedthrough)

    def _linear(self, data: Dataset, held: Dataset, *known: Any) -> tuple[Affine, Affine, Affine]:
        """Change of the state, outputs and state from past samples of the linear model of this order.

        Its states have unit covariance over the data.
        """
        model, _ = unit_states(self._start.fit(data), data)
        emission = np.hstack([model.C, model.D]) if self.feedthrough else model.C
        change = np.hstack([model.A - np.eye(self._n), model.B])
        return (change, np.zeros(self._n)), (emission, model.y_offset), self._observer(model)

    def _observer(self, model: StateSpaceModel) -> Affine:
        """State from the samples that the encoder reads, by least squares over them."""
        n, nu, ny = self._n, len(model.inputs), len(model.outputs)
        from_start, from_u = np.eye(n), np.zeros((n, self.lags - 1, nu))  # the state, as time goes on
        seen, pushed = [], []
        for i in range(self.lags):
            seen.append(model.C @ from_start)
            pushed.append(np.tensordot(model.C, from_u, 1))
            if i < self.lags - 1:
                pushed[-1][:, i] += model.D
                from_start, from_u = model.A @ from_start, np.tensordot(model.A, from_u, 1)
                from_u[:, i] += model.B
        known = self.lags - self.feedthrough  # the newest output also has what the newest input, unseen, makes of it
        back = from_start @ np.linalg.pinv(np.concatenate(seen[:known]), rcond=1e-10) if known else np.zeros((n, 0))
        of_y = np.hstack([back, np.zeros((n, (self.lags - known) * ny))]).reshape(n, self.lags, ny)
        of_u = from_u - np.tensordot(back, np.concatenate(pushed[:known]), 1) if known else from_u
        slope = np.hstack([of_y[:, ::-1].reshape(n, -1), of_u[:, ::-1].reshape(n, -1)])
        return slope, -of_y.sum(axis=1) @ model.y_offset

    def _initial(self, seed: int, ny: int, nu: int, linear: Any) -> tuple:
        """Random weights; the transition starts small, so that the first free runs stay bounded."""
        n = self._n
        transition = (n + nu, *self.hidden, n)
        emission = (n + nu if self.feedthrough else n, *self.emission_hidden, ny)
        encoder = (self.lags * ny + (self.lags - 1) * nu, *self.hidden, n)
        nets = [
            MLP.random(sizes, activation=self.activation, seed=3 * seed + i)
            for i, sizes in enumerate((transition, emission, encoder))
        ]
        if linear:
            return tuple(layers(from_linear(net, *part)) for net, part in zip(nets, linear, strict=True))
        (*rest, (w, b)), second, third = (layers(net) for net in nets)
        return (*rest, (0.2 * w, b)), second, third

    def _model(
        self, params: Any, scaling_u: Scaling, scaling_y: Scaling, again: Again, channels: Any
    ) -> NeuralStateSpaceModel:
        """The networks with their scaling, and the gain."""
        none = Scaling.none(self._n)
        driven, past = beside(none, scaling_u), beside(*[scaling_y] * self.lags, *[scaling_u] * (self.lags - 1))
        ends = (driven, none), (driven if self.feedthrough else none, scaling_y), (past, none)
        nets = [network(net, self.activation, *scalings) for net, scalings in zip(params, ends, strict=True)]
        gain = np.zeros((self._n, len(scaling_y.factor)))
        if self.gain_stages:
            gain = again(GainOfNetwork(states=self._problem()), gain, self.gain_stages) / scaling_y.factor
        parts = dict(zip(("transition", "emission", "encoder"), nets, strict=True))
        return NeuralStateSpaceModel(**parts, lags=self.lags, feedthrough=self.feedthrough, gain=gain, **channels)


# ---- the losses, in scaled coordinates -------------------------------------------------------------------------------


@dataclass(frozen=True)
class StateNetwork(Recurrence):
    """Loss and free-run score of a neural state space, each window started by the encoder."""

    lags: int
    activation: Activation
    feedthrough: bool

    memory = derived(lambda self: self.lags)

    def start(self, params: Any, u: Any, y: Any) -> Any:
        """State at the newest of the lagged samples."""
        import jax.numpy as jnp

        past = [y(-1 - i) for i in range(self.lags)] + [u(-1 - i) for i in range(1, self.lags)]
        return self._net(params[2], jnp.concatenate(past))

    def advance(self, params: Any, x: Any, u: Any, y: Any, k: Any) -> tuple[Any, Any]:
        """State one sample later, and the errors of its outputs."""
        import jax.numpy as jnp

        x = x + self._net(params[0], jnp.concatenate([x, u(k - 1)]))
        return x, self._net(params[1], jnp.concatenate([x, u(k)]) if self.feedthrough else x) - y(k)

    def _net(self, net: Any, z: Any) -> Any:
        return forward(net, z, self.activation)


@dataclass(frozen=True)
class GainOfNetwork(Recurrence):
    """Loss and score of the innovation gain of a trained state space: its one-step-ahead error."""

    states: StateNetwork

    memory = derived(lambda self: self.states.lags)

    def start(self, params: Any, u: Any, y: Any) -> Any:
        """What the encoder says."""
        return self.states.start(params[1], u, y)

    def advance(self, params: Any, x: Any, u: Any, y: Any, k: Any) -> tuple[Any, Any]:
        """State corrected by the gain times the innovation, and that with its sign turned."""
        gain, net = params
        x, error = self.states.advance(net, x, u, y, k)
        return x - gain @ error, error

    def loss(self, params: Any, arrays: Any, starts: Any, horizon: int) -> Any:
        """Mean squared innovation; ``arrays`` are the data and the trained networks."""
        return super().loss((params, arrays[1]), arrays[0], starts, horizon)

    def score(self, params: Any, arrays: Any) -> Any:
        """One-step-ahead RMSE over the held-out part."""
        return super().score((params, arrays[1]), arrays[0])
