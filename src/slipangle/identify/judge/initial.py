"""Free runs under both protocols: from the first samples alone, or from the initial state that fits the record best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ParameterError, TooShortError, require_known
from slipangle.models.model import Model, Trajectory
from slipangle.numerics.least_squares import LEAST, LevenbergMarquardt, triangle

Start = Literal["first samples", "least squares"]
LONGEST = 2000  # samples that the initial state is fitted to; later ones hardly depend on it


def free_run(model: Model, data: Dataset, *, start: Start | int = "first samples") -> Trajectory:
    """Free run of every experiment.

    Raises ParameterError if ``start`` is something else, TooShortError if an experiment is not longer than it, and
    SimulationError if the state leaves the finite numbers.

    Parameters
    ----------
    start : {"first samples", "least squares"} or int
        ``"first samples"``: the state that the model reads from its first `memory` samples; no later measured output
        is used. ``"least squares"``: the state that makes the free run fit the measured outputs best; it looks at
        outputs that are then predicted, so it flatters models that forget slowly. A number: the state that fits so many
        first samples best, for protocols that give these; they are not predicted, and later ones not looked at.
    """
    if isinstance(start, int):
        return _from_first(model, data, start)
    require_known(start, get_args(Start), "start")
    if start == "first samples":
        return model.simulate(data)
    model.check(data)
    chosen = data.select(inputs=model.inputs, outputs=model.outputs)
    states = [initial_state(model, part) for part in chosen.experiments]
    return replace(model.simulate(data, start=states), kind="free run, least-squares start")


def _from_first(model: Model, data: Dataset, count: int) -> Trajectory:
    """Free run from the state that fits the first samples of every experiment best."""
    if count <= model.memory:
        raise ParameterError(
            f"start is {count} samples and the model reads {model.memory} to begin with; expected more than those"
        )
    model.check(data)
    chosen = data.select(inputs=model.inputs, outputs=model.outputs)
    short = min(chosen.experiments, key=lambda part: part.n_samples)
    if short.n_samples <= count:
        raise TooShortError(
            f"an experiment of '{data.name}' has {short.n_samples} samples and the start takes {count} of them; "
            "expected more than those: start from fewer, or leave that experiment out"
        )
    states = [initial_state(model, part.head(count)) for part in chosen.experiments]
    run = model.simulate(data, start=states)
    late = np.concatenate([np.arange(part.n_samples) >= count for part in chosen.experiments])
    return replace(run, predicted=run.predicted & late, kind=f"free run, start from {count} samples")


def restarted(data: Dataset, seconds: float, memory: int) -> Dataset:
    """The data cut into experiments that a free run starts anew in.

    Each predicts ``seconds`` (the last of a record what is left) from the ``memory`` samples before. So runs of it
    predict the same samples as one run over all the data, and what a single long run hides or shows is seen beside it.

    Lengths are in seconds [s]; experiments not longer than ``memory`` samples are left out.

    Raises ParameterError if ``seconds`` is shorter than one sample, and TooShortError if no experiment is longer than
    ``memory``.
    """
    n = round(seconds / data.dt)
    if n < 1:
        raise ParameterError(
            f"restarts every {seconds:g} s, a sample lasts {data.dt:g} s; expected at least one sample"
        )
    parts = [
        part.rows(a - memory, min(a + n, part.n_samples))
        for part in data.experiments
        for a in range(memory, part.n_samples, n)
    ]
    if not parts:
        raise TooShortError(
            f"no experiment of '{data.name}' is longer than the {memory} samples a free run starts from; record longer"
        )
    return join(*parts, name=data.name)


def initial_state(model: Model, data: Dataset, *, max_iterations: int = 30) -> np.ndarray:
    """State at sample ``memory - 1`` with the smallest squared free-run error, shape (n_states,).

    Levenberg-Marquardt from what `Model.initial_state` says, each output divided by its standard deviation, over the
    first 2000 samples. For a linear model this is least squares; states that the outputs do not show stay where they
    were.

    Raises SimulationError if the free run from the model's own initial state is not finite.
    """
    m = model.memory
    part = data.select(inputs=model.inputs, outputs=model.outputs).rows(0, min(m + LONGEST, data.n_samples))
    model.simulate(part)  # raises where there is nothing to improve
    spread = part.y.std(axis=0)
    spread[spread == 0] = 1.0

    def residual(x: np.ndarray) -> np.ndarray:
        y = model.free_run(x, part.u[m - 1 :])
        return ((y - part.y[m:]) / spread).ravel()

    def cost(x: np.ndarray) -> float:
        with np.errstate(over="ignore", invalid="ignore"):
            return float(np.sum(residual(x) ** 2))

    search = LevenbergMarquardt(
        cost=cost,
        linearise=lambda x: (*triangle(_jacobian(residual, x), residual(x)), None),
        move=lambda x, _, eta: x + eta,
        damping=LEAST,  # most models are linear, or nearly so, in their initial state
    )
    start = np.asarray(model.initial_state(part.head(m)), dtype=float)
    return search.minimise(start, max_iterations=max_iterations, tolerance=1e-9).point


def _jacobian(residual: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """Central differences; a free run costs far less than symbolic sensitivities."""
    columns = []
    for i in range(len(x)):
        h = np.zeros(len(x))
        h[i] = 1e-5 * (1 + abs(x[i]))
        columns.append((residual(x + h) - residual(x - h)) / (2 * h[i]))
    return np.column_stack(columns)
