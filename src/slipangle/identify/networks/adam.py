"""Adam in JAX: whole epochs of batches in one compiled call, never reverse mode over a long scan."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from slipangle.identify.networks.problem import Precision, Stage, TrainingProblem

_CLIP = 1.0  # largest norm of a gradient through several steps


def precision(name: Precision) -> AbstractContextManager:
    """Context in which arrays are single or double; JAX's global setting stays as it is."""
    context = getattr(jax, "enable_x64", None)
    if context is None:  # before JAX 0.8
        from jax.experimental import enable_x64 as context  # type: ignore[attr-defined, no-redef]
    return context(name == "double")


def to_device(values: Any) -> Any:
    """Nest of NumPy arrays as JAX arrays in the precision of the context."""
    return jax.tree.map(jnp.asarray, values)


def to_numpy(values: Any) -> Any:
    """Nest of JAX arrays as NumPy arrays, in double precision."""
    return jax.tree.map(lambda a: np.asarray(a, dtype=float), values)


@partial(jax.jit, static_argnums=0)
def score(problem: TrainingProblem, params: Any, arrays: Any) -> jax.Array:
    """`Problem.score`, compiled."""
    return problem.score(params, arrays)


@partial(jax.jit, static_argnums=0)
def own(problem: TrainingProblem, params: Any, arrays: Any) -> jax.Array:
    """`Problem.own`, compiled."""
    return problem.own(params, arrays)


class AdamSteps:
    """Parameters on their way through one stage."""

    def __init__(
        self, problem: TrainingProblem, stage: Stage, params: Any, arrays: Any, rows: np.ndarray, *, seed: Any
    ) -> None:
        self.problem, self.stage, self.arrays = problem, stage, arrays
        self.rows = jnp.asarray(rows, dtype=jnp.int32)
        self.params = jax.tree.map(jnp.copy, params)  # the steps work in place
        windows = min(len(rows), max(stage.batch, -(-len(rows) // stage.horizon)))
        self.batch = min(stage.batch, windows)
        self.batches = -(-windows // self.batch)
        self.state = optimiser(stage, self.batches).init(self.params)
        self.key = jax.random.PRNGKey(np.random.default_rng(seed).integers(2**31))

    def advance(self, epochs: int) -> float:
        """Train for some epochs; the mean loss of the last one."""
        self.key, key = jax.random.split(self.key)
        fixed = self.problem, self.stage, self.batch, self.batches
        given = self.params, self.state, self.arrays, self.rows, key
        self.params, self.state, loss = _epochs(*fixed, epochs, *given)
        return float(loss)

    def snapshot(self) -> Any:
        """A copy of the parameters that later steps leave alone."""
        return jax.tree.map(jnp.copy, self.params)


def optimiser(stage: Stage, batches: int) -> optax.GradientTransformation:
    """Adam with cosine decay; gradients through several steps are clipped."""
    rate = optax.cosine_decay_schedule(stage.learning_rate, stage.epochs * batches, alpha=0.01)
    adam = optax.adamw(rate, weight_decay=stage.weight_decay) if stage.weight_decay else optax.adam(rate)
    return adam if stage.horizon == 1 else optax.chain(optax.clip_by_global_norm(_CLIP), adam)


@partial(jax.jit, static_argnums=(0, 1, 2, 3), donate_argnums=(5, 6))
def _epochs(
    problem: TrainingProblem,
    stage: Stage,
    batch: int,
    batches: int,
    epochs: Any,
    params: Any,
    state: Any,
    arrays: Any,
    rows: jax.Array,
    key: jax.Array,
) -> tuple[Any, Any, jax.Array]:
    rule = optimiser(stage, batches)

    def step(carry: Any, starts: jax.Array) -> tuple[Any, jax.Array]:
        params, state = carry
        loss, gradient = jax.value_and_grad(problem.loss)(params, arrays, starts, stage.horizon)
        update, state = rule.update(gradient, state, params)
        return (optax.apply_updates(params, update), state), loss

    def epoch(i: Any, carry: Any) -> Any:
        params, state, _ = carry
        shuffled = jax.random.permutation(jax.random.fold_in(key, i), rows)
        order = jnp.resize(shuffled, (batches, batch))  # the last batch is filled up from the start
        (params, state), losses = jax.lax.scan(step, (params, state), order)
        return params, state, losses.mean()

    zero = jnp.zeros((), jax.tree.leaves(params)[0].dtype)
    return jax.lax.fori_loop(0, epochs, epoch, (params, state, zero))
