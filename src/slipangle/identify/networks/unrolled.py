"""Free runs of physics with a network in JAX, and their exact derivative by every parameter.

The derivatives of all steps are evaluated side by side; what is left in sequence is a small linear recursion. That
is what makes Gauss-Newton on the whole free run cheap, where reverse mode over the long scan is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.models.black_box.networks import MLP, Activation, mlp_pass
from slipangle.models.vehicles.neural_bicycle import NeuralBicycle


@dataclass(frozen=True, eq=False)
class Unrolled:
    """Free runs of a `NeuralBicycle` over its free parameters, its network's weights, and offsets of the outputs.

    ``outputs(theta, x0, u)`` and ``derivatives(theta, x0, u)`` take many runs side by side: x0 (n_runs, 3), u
    (n_runs, n + 1, 3). Outputs are those from the second sample on, (n_runs, n, n_outputs), derivatives have the
    parameters behind.
    """

    model: NeuralBicycle  # structure, fixed parameters and integrator (Runge-Kutta 4)
    free: tuple[str, ...]
    scale: np.ndarray  # (n_free,), their units in the parameter vector
    size: np.ndarray  # (n_outputs,), units of the outputs' offsets

    outputs: Any = None
    derivatives: Any = None

    def __post_init__(self) -> None:
        for name in ("outputs", "derivatives"):  # of many runs side by side
            each = jax.vmap(getattr(self, f"_{name}"), (None, 0, 0))
            object.__setattr__(self, name, jax.jit(each))

    def _split(self, theta: Any) -> tuple[Any, Any, Any]:
        """Parameter set, network and offsets of a parameter vector."""
        n, ny = len(self.free), len(self.size)
        values = {name: theta[i] * self.scale[i] for i, name in enumerate(self.free)}
        params = replace(self.model.params, **values)
        net: Any = self.model.network
        weights, biases, skip = net.unravel(theta[n : len(theta) - ny])

        def correction(x: Any) -> Any:
            z = (x - net.input_scaling.offset) / net.input_scaling.factor
            z = mlp_pass(z, weights, biases, net.activation, skip)
            return z * net.output_scaling.factor + net.output_scaling.offset

        return params, correction, theta[len(theta) - ny :] * self.size

    def _step(self, theta: Any, x: Any, u: Any) -> Any:
        """One sample by Runge-Kutta 4, the stages in a loop so that the physics is compiled once."""
        params, correction, _ = self._split(theta)
        n, h = self.model.substeps, self.model.dt / self.model.substeps
        reach = jnp.tile(jnp.array([0.5, 0.5, 1.0, 0.0]), n)
        weight = jnp.tile(jnp.array([1.0, 2.0, 2.0, 1.0]) / 6, n)
        last = jnp.tile(jnp.array([0.0, 0.0, 0.0, 1.0]), n)

        def stage(carry: Any, how: Any) -> tuple[Any, None]:
            x, at, total = carry
            reach, weight, last = how
            slope = jnp.stack(self.model.rates(at, u, params, correction))
            total = total + h * weight * slope
            x = x + last * total
            return (x, x + h * reach * slope, (1 - last) * total), None

        x = jax.lax.scan(stage, (x, x, jnp.zeros_like(x)), (reach, weight, last))[0][0]
        most = jnp.array([self.model.most_v_y, self.model.most_r, jnp.inf])
        return jnp.clip(x, -most, most)

    def _output(self, theta: Any, x: Any, u: Any) -> Any:
        """Outputs as the sensors read them: v_y, r, a_y."""
        params, correction, offsets = self._split(theta)
        values = {"v_y": x[0], "r": x[1] + params.bias_r}
        if "a_y" in self.model.outputs:
            values["a_y"] = self.model.rates(x, u, params, correction)[0] + u[1] * x[1]
        return jnp.stack([values[name] for name in self.model.outputs]) + offsets

    def starts(self, theta: np.ndarray, heads: Sequence[Dataset], outputs: Sequence[str]) -> np.ndarray:
        """State at the last sample of each head, as the model with those outputs reads it, shape (n_heads, 3)."""
        model = self.unpack(theta, outputs)
        return np.stack([model.initial_state(head) for head in heads])

    def _run(self, theta: Any, x0: Any, u: Any) -> Any:
        def advance(x: Any, u: Any) -> tuple[Any, Any]:
            x = self._step(theta, x, u)
            return x, x

        return jnp.concatenate([x0[None], jax.lax.scan(advance, x0, u[:-1])[1]])

    def _outputs(self, theta: Any, x0: Any, u: Any) -> Any:
        x = self._run(theta, x0, u)
        return jax.vmap(self._output, (None, 0, 0))(theta, x[1:], u[1:])

    def _derivatives(self, theta: Any, x0: Any, u: Any) -> tuple[Any, Any]:
        """Outputs from the second sample on, (n, n_outputs), and their derivatives (n, n_outputs, n_theta)."""
        x = self._run(theta, x0, u)
        by_theta, by_x = jax.vmap(jax.jacrev(self._step, (0, 1)), (None, 0, 0))(theta, x[:-1], u[:-1])

        def advance(s: Any, step: Any) -> tuple[Any, Any]:
            s = step[0] @ s + step[1]
            return s, s

        s0 = jnp.zeros((x.shape[1], len(theta)))
        sensitivity = jax.lax.scan(advance, s0, (by_x, by_theta))[1]
        y = jax.vmap(self._output, (None, 0, 0))(theta, x[1:], u[1:])
        direct, through = jax.vmap(jax.jacrev(self._output, (0, 1)), (None, 0, 0))(theta, x[1:], u[1:])
        return y, direct + jnp.einsum("kab,kbt->kat", through, sensitivity)

    # ---- between the vector and the model ----------------------------------------------------------------------

    def pack(self, network: MLP) -> np.ndarray:
        """Parameter vector of the model's parameters and a network; offsets start at zero."""
        physics = np.array([float(getattr(self.model.params, n)) for n in self.free]) / self.scale
        return np.concatenate([physics, network.parameters, np.zeros(len(self.size))])

    def unpack(self, theta: np.ndarray, outputs: Sequence[str]) -> NeuralBicycle:
        """The model of a parameter vector."""
        n, ny = len(self.free), len(self.size)
        values = dict(zip(self.free, (float(v) for v in theta[:n] * self.scale), strict=True))
        net = self.model.network.with_parameters(theta[n : len(theta) - ny])
        return replace(
            self.model,
            params=self.model.params.with_values(**values),
            network=net,
            outputs=tuple(outputs),
            fit_info=None,
        )


def unrolled_lags(network: MLP) -> UnrolledLags:
    """Free runs of all NARX networks with as many lags, layers and neurons, compiled once for them and each length."""
    return _unrolled_lags(tuple(w.shape for w in network.weights), network.activation, network.skip is not None)


@lru_cache(maxsize=16)
def _unrolled_lags(shapes: tuple[tuple[int, int], ...], activation: Activation, straight: bool) -> UnrolledLags:
    net = MLP(
        weights=tuple(map(np.zeros, shapes)),
        biases=tuple(np.zeros(rows) for rows, _ in shapes),
        activation=activation,
        skip=np.zeros((shapes[-1][0], shapes[0][1])) if straight else None,
    )
    return UnrolledLags(net)


@dataclass(frozen=True, eq=False)
class UnrolledLags:
    """Free run of a NARX network over its weights, in scaled coordinates."""

    network: MLP  # architecture; its numbers are not used
    run: Any = None
    derivatives: Any = None

    def __post_init__(self) -> None:
        for name in ("run", "derivatives"):
            object.__setattr__(self, name, jax.jit(getattr(self, f"_{name}")))

    def _next(self, theta: Any, past: Any, drive: Any) -> Any:
        weights, biases, skip = self.network.unravel(theta)
        return mlp_pass(jnp.concatenate([past, drive]), weights, biases, self.network.activation, skip)

    def _pasts(self, theta: Any, past: Any, drives: Any) -> tuple[Any, Any]:
        """Outputs of every step, (n, n_outputs), and the past outputs that each step saw."""

        def advance(past: Any, drive: Any) -> tuple[Any, Any]:
            y = self._next(theta, past, drive)
            return jnp.concatenate([y, past])[: len(past)], (y, past)

        return jax.lax.scan(advance, past, drives)[1]

    def _run(self, theta: Any, past: Any, drives: Any) -> Any:
        return self._pasts(theta, past, drives)[0]

    def _derivatives(self, theta: Any, past: Any, drives: Any) -> tuple[Any, Any]:
        """Outputs, (n, n_outputs), and their derivatives, (n, n_outputs, n_theta)."""
        y, pasts = self._pasts(theta, past, drives)
        by_theta, by_past = jax.vmap(jax.jacrev(self._next, (0, 1)), (None, 0, 0))(theta, pasts, drives)

        def advance(s: Any, step: Any) -> tuple[Any, Any]:
            new = step[0] @ s + step[1]
            return jnp.concatenate([new, s])[: len(s)], new

        s0 = jnp.zeros((len(past), len(theta)))
        return y, jax.lax.scan(advance, s0, (by_past, by_theta))[1]
