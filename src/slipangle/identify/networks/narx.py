"""NARX networks by Adam: one-step-ahead first, then several steps ahead, judged by free runs."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ModelWarning
from slipangle.fields import Checked, Count
from slipangle.identify.excitation import require_identifiable, require_independent
from slipangle.identify.linear.lags import same_for_all
from slipangle.identify.networks.problem import Precision, Stage
from slipangle.identify.networks.training import Holdout, Progress, require_jax, train
from slipangle.identify.networks.windows import cut, layers, scaled, training_info, window_starts
from slipangle.models.black_box.narx import NARXModel
from slipangle.models.black_box.networks import MLP, Activation, Scaling, mlp_pass

STAGES = (Stage(horizon=1, epochs=1000), Stage(horizon=20, epochs=2000))


@dataclass(frozen=True, kw_only=True)
class NARX(Checked):
    """NARX estimator with a multilayer perceptron. [1]_ sec. 4.2

    The last part of the training data is held out: its free-run error decides when to stop and which seed wins.
    Test data are never seen.

    Parameters
    ----------
    na, nb : int
        Past outputs and past inputs used, at least 1.
    nk : int
        Samples from input to output, at least 1.
    hidden : tuple of int
        Neurons of each hidden layer; empty for an affine model.
    activation : {"elu", "tanh", "sigmoid"}
        Of the hidden layers.
    stages : tuple of Stage
        How far ahead the loss looks and for how long; by default one step, then 20.
    holdout : float
        Share of the training data held out; 0 trains on all and judges on the same.
    seeds : tuple of int
        One training run each; ``fit_info.trials`` keeps every result.
    precision : {"single", "double"}
        Of the training. Single is faster and as good unless the free-run error falls below 1e-4 of the output.

    Raises
    ------
    ParameterError
        If a setting is out of range.

    References
    ----------
    .. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023.
    """

    na: Count
    nb: Count
    nk: Count = 1
    hidden: tuple[Count, ...] = (50, 50, 50)
    activation: Activation = "elu"
    stages: tuple[Stage, ...] = STAGES
    holdout: Holdout = 0.15
    seeds: tuple[int, ...] = (0,)
    precision: Precision = "single"

    def __post_init__(self) -> None:
        same_for_all(self, "nb", "nk")
        super().__post_init__()

    def fit(self, data: Dataset, *, progress: Progress | None = None) -> NARXModel:
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
        began = time.perf_counter()
        require_jax("fitting a NARX network")
        ny, nu = len(data.outputs), len(data.inputs)
        require_identifiable(data, self.na * ny + self.nb * nu)
        require_independent(data)
        inner, held = cut(data, self.holdout, self._memory)
        scaling_u, scaling_y = Scaling.standard(inner.u), Scaling.standard(inner.y)
        arrays = scaled(inner, scaling_u, scaling_y, held)
        sizes = (self.na * ny + self.nb * nu, *self.hidden, ny)
        trained = train(
            LagNetwork(na=self.na, nb=self.nb, nk=self.nk, activation=self.activation),
            lambda seed: layers(MLP.random(sizes, activation=self.activation, seed=seed)),
            arrays,
            lambda horizon: window_starts(inner, self._memory, horizon),
            stages=self.stages,
            seeds=self.seeds,
            precision=self.precision,
            progress=progress,
        )
        for note in trained.warnings:
            warnings.warn(note, ModelWarning, stacklevel=2)
        model = NARXModel(
            network=MLP(
                weights=tuple(w for w, _ in trained.params),
                biases=tuple(b for _, b in trained.params),
                activation=self.activation,
                input_scaling=_lagged(scaling_y, self.na, scaling_u, self.nb),
                output_scaling=scaling_y,
            ),
            na=self.na,
            nb=self.nb,
            nk=self.nk,
            dt=data.dt,
            inputs=data.inputs,
            outputs=data.outputs,
        )
        one = model.predict(data)
        info = training_info(
            trained, data, self.stages, self.holdout, self.precision, residual=one.error[one.predicted]
        )
        return replace(model, fit_info=replace(info, seconds=time.perf_counter() - began))

    @property
    def _memory(self) -> int:
        return max(self.na, self.nb + self.nk - 1)


def _lagged(scaling_y: Scaling, na: int, scaling_u: Scaling, nb: int) -> Scaling:
    """Scaling of the network's input: every lag of a channel alike."""
    return Scaling(
        offset=np.concatenate([np.tile(scaling_y.offset, na), np.tile(scaling_u.offset, nb)]),
        factor=np.concatenate([np.tile(scaling_y.factor, na), np.tile(scaling_u.factor, nb)]),
    )


@dataclass(frozen=True)
class LagNetwork:
    """Loss and free-run score of a network of lags, in scaled coordinates; a `Problem` of ``training``."""

    na: int
    nb: int
    nk: int
    activation: Activation

    def loss(self, params: Any, arrays: Any, starts: Any, horizon: int) -> Any:
        """Mean squared error over the windows and their steps."""
        import jax.numpy as jnp

        u, y = arrays.u, arrays.y
        past = jnp.concatenate([y[starts - i].T for i in range(1, self.na + 1)])

        def drives(step: Any) -> Any:
            return jnp.concatenate([u[starts + step - j].T for j in range(self.nk, self.nk + self.nb)])

        def error(predicted: Any, step: Any) -> Any:
            return jnp.mean((predicted - y[starts + step].T) ** 2)

        if horizon == 1:
            return error(self._next(params, past, drives(0)), 0)
        return jnp.mean(self._roll(params, past, drives, error, horizon))

    def score(self, params: Any, arrays: Any) -> Any:
        """Free-run RMSE over the held-out part; 1 is the standard deviation of the training outputs."""
        import jax.numpy as jnp

        u, y, weight = arrays.held
        m = max(self.na, self.nb + self.nk - 1)
        past = jnp.concatenate([y[m - i] for i in range(1, self.na + 1)])

        def drives(step: Any) -> Any:
            return jnp.concatenate([u[m + step - j] for j in range(self.nk, self.nk + self.nb)])

        def error(predicted: Any, step: Any) -> Any:
            return jnp.sum(weight[m + step] * jnp.mean((predicted - y[m + step]) ** 2, axis=0))

        total = jnp.sum(self._roll(params, past, drives, error, len(u) - m))
        return jnp.sqrt(total / jnp.sum(weight[m:]))

    def _next(self, params: Any, past: Any, drive: Any) -> Any:
        import jax.numpy as jnp

        weights, biases = zip(*params, strict=True)
        return mlp_pass(jnp.concatenate([past, drive]), weights, biases, self.activation)

    def _roll(self, params: Any, past: Any, drives: Any, error: Any, steps: int) -> Any:
        """``error`` of every step of a free run, one column per window."""
        import jax
        import jax.numpy as jnp

        def advance(past: Any, step: Any) -> tuple[Any, Any]:
            predicted = self._next(params, past, drives(step))
            return jnp.concatenate([predicted, past])[: len(past)], error(predicted, step)

        return jax.lax.scan(advance, past, jnp.arange(steps))[1]
