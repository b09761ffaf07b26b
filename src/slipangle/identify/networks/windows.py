"""Scaled records and windows in them: what training shares, whatever the network."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import TooShortError
from slipangle.identify.networks.problem import Precision, Stage
from slipangle.identify.networks.training import Trained
from slipangle.models.black_box.networks import MLP, Scaling
from slipangle.models.model import FitInfo
from slipangle.models.provenance import provenance


class Segments(NamedTuple):
    """Experiments of the held-out part side by side, the shorter ones filled up."""

    u: np.ndarray  # (n_longest, n_inputs, n_segments)
    y: np.ndarray  # (n_longest, n_outputs, n_segments)
    weight: np.ndarray  # (n_longest, n_segments), 1 where there is a sample


class Arrays(NamedTuple):
    """Scaled training data one experiment after another, and the held-out part."""

    u: np.ndarray  # (n_samples, n_inputs)
    y: np.ndarray  # (n_samples, n_outputs)
    held: Segments


def scaled(data: Dataset, scaling_u: Scaling, scaling_y: Scaling, held: Dataset) -> Arrays:
    """Training data and held-out part in scaled coordinates."""
    return Arrays(
        u=scaling_u.apply(data.u.T).T,
        y=scaling_y.apply(data.y.T).T,
        held=segments(held, scaling_u, scaling_y),
    )


def cut(data: Dataset, holdout: float, memory: int) -> tuple[Dataset, Dataset]:
    """Training data without their last part, and that part; both the whole when ``holdout`` is 0.

    Raises
    ------
    TooShortError
        If the held-out part has no experiment longer than ``memory``.
    """
    inner, held = (data, data) if holdout == 0 else data.split(1 - holdout)
    if all(part.n_samples <= memory for part in held.experiments):
        raise TooShortError(
            f"the {held.n_samples} samples held out of '{data.name}' have no experiment longer than the {memory} "
            "samples that a free run starts from; expected more: hold out a larger share or record longer"
        )
    return inner, held


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
    """Weights and biases, layer by layer."""
    return tuple(zip(net.weights, net.biases, strict=True))


def training_info(
    trained: Trained,
    data: Dataset,
    stages: tuple[Stage, ...],
    holdout: float,
    precision: Precision,
    *,
    residual: np.ndarray,
) -> FitInfo:
    """How a network was trained; it has no covariance."""
    best = trained.best
    ahead = ", then ".join(f"{s.horizon}" for s in stages) + (" step" if stages[-1].horizon == 1 else " steps")
    where = f"the last {100 * holdout:g} % of the training data" if holdout else "the training data"
    return FitInfo(
        names=(),
        values=np.empty(0),
        covariance=np.empty((0, 0)),
        noise_std=np.std(residual, axis=0),
        n_samples=len(residual),
        method=(
            f"Adam on windows of {ahead} in {precision} precision; free run on {where} chose epoch "
            f"{best.epoch} of {best.epochs} and seed {best.seed} of {len(trained.trials)}"
        ),
        warnings=trained.warnings,
        **provenance(data),
        trials=trained.trials,
    )
