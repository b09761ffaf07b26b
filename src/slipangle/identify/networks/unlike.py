"""Stretches of a log unlike its others: there a correction shows whether it holds where it was not fitted."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from slipangle.data.dataset import Dataset, join

_STRETCHES = 20  # that a log is cut into, about
_SHARE = 0.25  # of the samples that is held out


def split_unlike(data: Dataset, signals: np.ndarray, shortest: int) -> tuple[Dataset, Dataset]:
    """The stretches that are like each other, and those furthest from them, a quarter of the samples.

    Each stretch is described by mean and standard deviation of every signal, over how much these differ between the
    stretches; the furthest are those of the largest distance from the mean of all. Neighbours stay in one piece. Of
    data too short for two stretches, the last quarter is held out.

    Parameters
    ----------
    data : Dataset
        Stretches end where its experiments do.
    signals : array, shape (n_samples, n_signals)
        What tells manoeuvres apart, such as speed and lateral acceleration.
    shortest : int
        Fewest samples of a stretch; a shorter rest goes with the stretch before.
    """
    length = max(shortest, round(data.n_samples / _STRETCHES))
    spans: list[tuple[int, int]] = []
    for a, b in zip(data.starts, data.stops, strict=True):
        edges = [*range(a, b - length + 1, length), b] if b - a >= 2 * length else [a, b]
        spans += list(pairwise(edges))
    if len(spans) == 1:  # too short to tell manoeuvres apart
        return data.split(1 - _SHARE)
    features = np.array([np.concatenate([signals[a:b].mean(axis=0), signals[a:b].std(axis=0)]) for a, b in spans])
    size = np.maximum(features.std(axis=0), 1e-12 * np.abs(features).max(axis=0) + 1e-300)
    distance = np.linalg.norm((features - features.mean(axis=0)) / size, axis=1)
    order = np.argsort(-distance, kind="stable")
    lengths = np.array([b - a for a, b in spans])
    out = order[: max(1, int(np.searchsorted(np.cumsum(lengths[order]), _SHARE * data.n_samples, side="right")))]
    held = np.zeros(data.n_samples, dtype=bool)
    for i in out:
        held[slice(*spans[i])] = True
    return _pieces(data, ~held), _pieces(data, held)


def _pieces(data: Dataset, kept: np.ndarray) -> Dataset:
    """Runs of rows that are kept, each an experiment."""
    changes = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(int)))
    borders = sorted({*changes.tolist(), *(a for a in data.starts if kept[a])})
    parts = [data.rows(a, b) for a, b in pairwise(borders) if kept[a]]
    return join(*parts, name=data.name)
