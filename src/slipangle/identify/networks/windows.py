"""Scaled records and windows in them: what training shares, whatever the network."""

from __future__ import annotations

import abc
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.models.black_box.networks import MLP, Activation, Scaling, mlp_pass

LENGTH = 1000  # samples of a stretch of training data that free runs are judged on, at most


class Segments(NamedTuple):
    """Experiments side by side, the shorter ones filled up."""

    u: np.ndarray  # (n_longest, n_inputs, n_segments)
    y: np.ndarray  # (n_longest, n_outputs, n_segments)
    weight: np.ndarray  # (n_longest, n_segments), 1 where there is a sample


class Arrays(NamedTuple):
    """Scaled training data, one experiment after another and as stretches side by side, and the held-out part."""

    u: np.ndarray  # (n_samples, n_inputs)
    y: np.ndarray  # (n_samples, n_outputs)
    own: Segments
    held: Segments


def scaled(data: Dataset, scaling_u: Scaling, scaling_y: Scaling, held: Dataset) -> Arrays:
    """Training data and held-out part in scaled coordinates."""
    return Arrays(
        u=scaling_u.apply(data.u.T).T,
        y=scaling_y.apply(data.y.T).T,
        own=segments(stretches(data), scaling_u, scaling_y),
        held=segments(held, scaling_u, scaling_y),
    )


def stretches(data: Dataset) -> Dataset:
    """The data with experiments of more than `LENGTH` samples cut into equal parts that are not longer."""
    parts = []
    for part in data.experiments:
        edges = np.linspace(0, part.n_samples, -(-part.n_samples // LENGTH) + 1).astype(int)
        parts += [part.rows(a, b) for a, b in pairwise(edges.tolist())]
    return join(*parts, name=data.name)


def window_starts(data: Dataset, memory: int, horizon: int) -> np.ndarray:
    """Rows of the first predicted sample of every window of ``horizon`` steps inside one experiment."""
    return np.concatenate(
        [np.arange(a + memory, b - horizon + 1) for a, b in zip(data.starts, data.stops, strict=True)]
    ).astype(int)


def segments(data: Dataset, scaling_u: Scaling, scaling_y: Scaling) -> Segments:
    """Experiments side by side, scaled."""
    parts = data.experiments
    longest = max(part.n_samples for part in parts)

    def filled(rows: np.ndarray) -> np.ndarray:
        return np.pad(rows, ((0, longest - len(rows)), (0, 0)), mode="edge")

    return Segments(
        u=np.stack([filled(scaling_u.apply(part.u.T).T) for part in parts], axis=2),
        y=np.stack([filled(scaling_y.apply(part.y.T).T) for part in parts], axis=2),
        weight=np.stack([np.arange(longest) < part.n_samples for part in parts], axis=1).astype(float),
    )


def layers(net: MLP) -> tuple:
    """Weights and biases, layer by layer; then its linear path alone, if it has one."""
    own = tuple(zip(net.weights, net.biases, strict=True))
    return own if net.skip is None else (*own, (net.skip,))


def _apart(params: Any) -> tuple[Any, Any, Any]:
    """Weights, biases and linear path (or None) of `layers`."""
    straight = len(params[-1]) == 1
    weights, biases = zip(*(params[:-1] if straight else params), strict=True)
    return weights, biases, params[-1][0] if straight else None


def forward(params: Any, z: Any, activation: Activation) -> Any:
    """Output of the perceptron of `layers`, in scaled coordinates."""
    weights, biases, skip = _apart(params)
    return mlp_pass(z, weights, biases, activation, skip)


def network(params: Any, activation: Activation, input_scaling: Scaling, output_scaling: Scaling) -> MLP:
    """The perceptron of trained `layers`."""
    weights, biases, skip = _apart(params)
    return MLP(
        weights=weights,
        biases=biases,
        skip=skip,
        activation=activation,
        input_scaling=input_scaling,
        output_scaling=output_scaling,
    )


def from_linear(net: MLP, slope: np.ndarray, constant: np.ndarray) -> MLP:
    """The network with a linear path beside its hidden layers, such that it starts as that affine map.

    The last layer is zero but for the constant; the hidden ones stay random, so training can wake them. Without hidden
    layers the network is that map itself.
    """
    if not net.hidden:
        return replace(net, weights=(slope,), biases=(constant,))
    last = (np.zeros_like(net.weights[-1]), constant)
    return replace(net, weights=(*net.weights[:-1], last[0]), biases=(*net.biases[:-1], last[1]), skip=slope)


def in_units(data: Dataset, scaling_u: Scaling, scaling_y: Scaling) -> Dataset:
    """The data in scaled coordinates."""
    rows = (data.inputs, scaling_u.apply(data.u.T)), (data.outputs, scaling_y.apply(data.y.T))
    for names, values in rows:
        for name, value in zip(names, values, strict=True):
            data = data.with_channel(name, value)
    return data


def beside(*parts: Scaling) -> Scaling:
    """Scaling of vectors one after the other."""
    return Scaling(
        offset=np.concatenate([part.offset for part in parts]), factor=np.concatenate([part.factor for part in parts])
    )


class Recurrence(abc.ABC):
    """Loss and score of what runs freely from a few past samples, in scaled coordinates; a `Problem`.

    ``u(k)`` and ``y(k)`` give inputs and outputs ``k`` samples after the first predicted one, one column per window.
    """

    memory: int  # samples before the first predicted one

    @abc.abstractmethod
    def start(self, params: Any, u: Any, y: Any) -> Any:
        """State before the first prediction."""

    @abc.abstractmethod
    def advance(self, params: Any, x: Any, u: Any, y: Any, k: Any) -> tuple[Any, Any]:
        """State after predicting sample ``k``, and the outputs' errors there."""

    def loss(self, params: Any, arrays: Any, starts: Any, horizon: int) -> Any:
        """Mean squared error over the windows and their steps."""
        import jax.numpy as jnp

        def at(rows: Any) -> Any:
            return lambda k: rows[starts + k].T

        return jnp.mean(self._roll(params, at(arrays.u), at(arrays.y), lambda e, k: jnp.mean(e**2), horizon))

    def score(self, params: Any, arrays: Any) -> Any:
        """RMSE over the held-out part; 1 is the standard deviation of the training outputs."""
        return self._free_run(params, arrays.held)

    def own(self, params: Any, arrays: Any) -> Any:
        """The same over the training data."""
        return self._free_run(params, arrays.own)

    def _free_run(self, params: Any, data: Segments) -> Any:
        import jax.numpy as jnp

        u, y, weight = data
        m = self.memory

        def weighed(e: Any, k: Any) -> Any:
            return jnp.sum(jnp.where(weight[m + k] > 0, jnp.mean(e**2, axis=0), 0.0))  # fillings may overflow

        total = jnp.sum(self._roll(params, lambda k: u[m + k], lambda k: y[m + k], weighed, len(u) - m))
        return jnp.sqrt(total / jnp.sum(weight[m:]))

    def _roll(self, params: Any, u: Any, y: Any, measure: Any, steps: int) -> Any:
        """``measure`` of every step's errors."""
        import jax
        import jax.numpy as jnp

        def advance(x: Any, k: Any) -> tuple[Any, Any]:
            x, error = self.advance(params, x, u, y, k)
            return x, measure(error, k)

        x = self.start(params, u, y)
        return advance(x, 0)[1] if steps == 1 else jax.lax.scan(advance, x, jnp.arange(steps))[1]
