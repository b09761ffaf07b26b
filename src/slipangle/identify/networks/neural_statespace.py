"""Neural state space with an encoder, by Adam on windows of free runs; its innovation gain in a second pass."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ModelWarning
from slipangle.fields import Checked, Count, Whole
from slipangle.identify.excitation import require_identifiable, require_independent
from slipangle.identify.networks.problem import Precision, Stage
from slipangle.identify.networks.training import Holdout, Progress, require_jax, train
from slipangle.identify.networks.windows import cut, layers, scaled, training_info, window_starts
from slipangle.models.black_box.networks import MLP, Activation, Scaling, mlp_pass
from slipangle.models.black_box.neural_statespace import NeuralStateSpaceModel

STAGES = (Stage(horizon=10, epochs=1500), Stage(horizon=40, epochs=1500))
GAIN_STAGES = (Stage(horizon=40, epochs=300, learning_rate=1e-2),)


@dataclass(frozen=True, kw_only=True)
class NeuralStateSpace(Checked):
    """Estimator of a neural state space. [1]_

    The loss is the error of free runs over short windows, each started by the encoder. The last part of the training
    data is held out: its free-run error decides when to stop and which seed wins. Test data are never seen. With the
    networks fixed, the innovation gain then minimises the one-step-ahead error.

    Parameters
    ----------
    order : int
        States, at least 1.
    lags : int, optional
        Samples that the encoder reads; by default ``2 order + 1``, which suffices for almost every smooth system.
    hidden : tuple of int
        Neurons of each hidden layer of the transition and the encoder.
    emission_hidden : tuple of int
        The same for the output network; by default affine.
    activation : {"elu", "tanh", "sigmoid"}
        Of the hidden layers.
    feedthrough : bool
        Let the outputs depend on the inputs of the same sample.
    stages : tuple of Stage
        How far ahead the loss looks and for how long.
    gain_stages : tuple of Stage
        The same for the innovation gain; empty leaves it at zero.
    holdout : float
        Share of the training data held out; 0 trains on all and judges on the same.
    seeds : tuple of int
        One training run each; ``fit_info.trials`` keeps every result.
    precision : {"single", "double"}
        Of the training.

    Raises
    ------
    ParameterError
        If a setting is out of range.

    References
    ----------
    .. [1] G. Beintema, R. Toth, M. Schoukens, Nonlinear state-space identification using deep encoder networks,
       Proc. 3rd Conference on Learning for Dynamics and Control, 2021.
    """

    order: Count
    lags: Whole = 0
    hidden: tuple[Count, ...] = (32, 32)
    emission_hidden: tuple[Count, ...] = ()
    activation: Activation = "tanh"
    feedthrough: bool = False
    stages: tuple[Stage, ...] = STAGES
    gain_stages: tuple[Stage, ...] = GAIN_STAGES
    holdout: Holdout = 0.15
    seeds: tuple[int, ...] = (0,)
    precision: Precision = "single"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lags == 0:
            object.__setattr__(self, "lags", 2 * self.order + 1)

    def fit(self, data: Dataset, *, progress: Progress | None = None) -> NeuralStateSpaceModel:
        """Model of all outputs from all inputs of ``data``; windows never cross the border of an experiment.

        Parameters
        ----------
        data : Dataset
            Training data.
        progress : callable, optional
            Told the share done and what is being done.

        Raises
        ------
        ExcitationError
            If an input or output is constant.
        TooShortError
            If no experiment holds the lags and a window.

        Warns
        -----
        ModelWarning
            If a training run diverged or never improved; the best weights are kept.
        """
        require_jax("fitting a neural state space")
        began = time.perf_counter()
        ny, nu = len(data.outputs), len(data.inputs)
        require_identifiable(data, self.lags * ny + self.lags * nu)
        require_independent(data)
        inner, held = cut(data, self.holdout, self.lags)
        scaling_u, scaling_y = Scaling.standard(inner.u), Scaling.standard(inner.y)
        arrays = scaled(inner, scaling_u, scaling_y, held)
        problem = StateNetwork(lags=self.lags, activation=self.activation, feedthrough=self.feedthrough)

        def starts(horizon: int) -> np.ndarray:
            return window_starts(inner, self.lags, horizon)

        trained = train(
            problem,
            lambda seed: self._start(seed, ny, nu),
            arrays,
            starts,
            stages=self.stages,
            seeds=self.seeds,
            precision=self.precision,
            progress=progress,
        )
        for note in trained.warnings:
            warnings.warn(note, ModelWarning, stacklevel=2)
        gain = np.zeros((self.order, ny))
        if self.gain_stages:
            tuned = train(
                GainOfNetwork(states=problem),
                lambda seed: np.zeros((self.order, ny)),
                (arrays, trained.params),
                starts,
                stages=self.gain_stages,
                seeds=(trained.best.seed,),
                precision=self.precision,
            )
            gain = tuned.params / scaling_y.factor
        model = self._model(trained.params, gain, scaling_u, scaling_y, data)
        one = model.predict(data)
        info = training_info(
            trained, data, self.stages, self.holdout, self.precision, residual=one.error[one.predicted]
        )
        return replace(model, fit_info=replace(info, seconds=time.perf_counter() - began))

    def _start(self, seed: int, ny: int, nu: int) -> tuple:
        """Random weights; the transition starts small, so that the first free runs stay bounded."""
        n = self.order
        sizes = {
            "transition": (n + nu, *self.hidden, n),
            "emission": (n + nu if self.feedthrough else n, *self.emission_hidden, ny),
            "encoder": (self.lags * ny + (self.lags - 1) * nu, *self.hidden, n),
        }
        nets = [
            layers(MLP.random(s, activation=self.activation, seed=3 * seed + i)) for i, s in enumerate(sizes.values())
        ]
        *first, (w, b) = nets[0]
        return ((*first, (0.2 * w, b)), nets[1], nets[2])

    def _model(
        self, params: Any, gain: np.ndarray, scaling_u: Scaling, scaling_y: Scaling, data: Dataset
    ) -> NeuralStateSpaceModel:
        """The networks with their scaling."""
        none = Scaling.none(self.order)
        lagged_y, lagged_u = _repeat(scaling_y, self.lags), _repeat(scaling_u, self.lags - 1)
        ends = (
            (_beside(none, scaling_u), none),
            (_beside(none, scaling_u) if self.feedthrough else none, scaling_y),
            (_beside(lagged_y, lagged_u), none),
        )
        nets = [
            MLP(
                weights=tuple(w for w, _ in net),
                biases=tuple(b for _, b in net),
                activation=self.activation,
                input_scaling=first,
                output_scaling=last,
            )
            for net, (first, last) in zip(params, ends, strict=True)
        ]
        return NeuralStateSpaceModel(
            transition=nets[0],
            emission=nets[1],
            encoder=nets[2],
            lags=self.lags,
            feedthrough=self.feedthrough,
            gain=gain,
            dt=data.dt,
            inputs=data.inputs,
            outputs=data.outputs,
        )


def _repeat(scaling: Scaling, times: int) -> Scaling:
    return Scaling(offset=np.tile(scaling.offset, times), factor=np.tile(scaling.factor, times))


def _beside(a: Scaling, b: Scaling) -> Scaling:
    return Scaling(offset=np.concatenate([a.offset, b.offset]), factor=np.concatenate([a.factor, b.factor]))


# ---- the losses, in scaled coordinates -------------------------------------------------------------------------------


@dataclass(frozen=True)
class StateNetwork:
    """Loss and score of a neural state space; a `slipangle.identify.networks.problem.Problem`."""

    lags: int
    activation: Activation
    feedthrough: bool

    def loss(self, params: Any, arrays: Any, starts: Any, horizon: int) -> Any:
        """Mean squared error of free runs over the windows, each started by the encoder."""
        import jax.numpy as jnp

        u, y = arrays.u, arrays.y

        def error(x: Any, step: Any) -> Any:
            return jnp.mean((self.emit(params, x, u[starts + step].T) - y[starts + step].T) ** 2)

        x = self.encode(params, lambda i: y[starts - 1 - i].T, lambda i: u[starts - 1 - i].T)
        return jnp.mean(self._roll(params, x, lambda step: u[starts + step - 1].T, error, horizon))

    def score(self, params: Any, arrays: Any) -> Any:
        """Free-run RMSE over the held-out part; 1 is the standard deviation of the training outputs."""
        import jax.numpy as jnp

        u, y, weight = arrays.held
        m = self.lags

        def error(x: Any, step: Any) -> Any:
            e = self.emit(params, x, u[m + step]) - y[m + step]
            return jnp.sum(weight[m + step] * jnp.mean(e**2, axis=0))

        x = self.encode(params, lambda i: y[m - 1 - i], lambda i: u[m - 1 - i])
        total = jnp.sum(self._roll(params, x, lambda step: u[m + step - 1], error, len(u) - m))
        return jnp.sqrt(total / jnp.sum(weight[m:]))

    def encode(self, params: Any, past_y: Any, past_u: Any) -> Any:
        """State at the newest of the lagged samples, one column per window."""
        import jax.numpy as jnp

        past = [past_y(i) for i in range(self.lags)] + [past_u(i) for i in range(1, self.lags)]
        return self._net(params[2], jnp.concatenate(past))

    def emit(self, params: Any, x: Any, u: Any) -> Any:
        """Outputs of a state."""
        import jax.numpy as jnp

        return self._net(params[1], jnp.concatenate([x, u]) if self.feedthrough else x)

    def advance(self, params: Any, x: Any, u: Any) -> Any:
        """State one sample later."""
        import jax.numpy as jnp

        return x + self._net(params[0], jnp.concatenate([x, u]))

    def _net(self, net: Any, z: Any) -> Any:
        weights, biases = zip(*net, strict=True)
        return mlp_pass(z, weights, biases, self.activation)

    def _roll(self, params: Any, x: Any, drive: Any, error: Any, steps: int) -> Any:
        import jax
        import jax.numpy as jnp

        def advance(x: Any, step: Any) -> tuple[Any, Any]:
            x = self.advance(params, x, drive(step))
            return x, error(x, step)

        return jax.lax.scan(advance, x, jnp.arange(steps))[1]


@dataclass(frozen=True)
class GainOfNetwork:
    """Loss and score of the innovation gain of a trained state space: its one-step-ahead error."""

    states: StateNetwork

    def loss(self, params: Any, arrays: Any, starts: Any, horizon: int) -> Any:
        """Mean squared innovation over the windows, each started by the encoder."""
        import jax.numpy as jnp

        (data, net), gain = arrays, params
        u, y = data.u, data.y
        x = self.states.encode(net, lambda i: y[starts - 1 - i].T, lambda i: u[starts - 1 - i].T)
        e = self._innovations(gain, net, x, lambda k: u[starts + k].T, lambda k: y[starts + k].T, horizon)
        return jnp.mean(e**2)

    def score(self, params: Any, arrays: Any) -> Any:
        """One-step-ahead RMSE over the held-out part."""
        import jax.numpy as jnp

        (data, net), gain = arrays, params
        u, y, weight = data.held
        m = self.states.lags
        x = self.states.encode(net, lambda i: y[m - 1 - i], lambda i: u[m - 1 - i])
        e = self._innovations(gain, net, x, lambda k: u[m + k], lambda k: y[m + k], len(u) - m)
        return jnp.sqrt(jnp.sum(weight[m:] * jnp.mean(e**2, axis=1)) / jnp.sum(weight[m:]))

    def _innovations(self, gain: Any, net: Any, x: Any, u: Any, y: Any, steps: int) -> Any:
        """Shape (steps, n_outputs, n_windows)."""
        import jax
        import jax.numpy as jnp

        def advance(x: Any, k: Any) -> tuple[Any, Any]:
            x = self.states.advance(net, x, u(k - 1))
            e = y(k) - self.states.emit(net, x, u(k))
            return x + gain @ e, e

        return jax.lax.scan(advance, x, jnp.arange(steps))[1]
