"""Stretches of a log unlike its others: there a correction shows whether it holds where it was not fitted."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from slipangle.data.dataset import Dataset, join

_STRETCHES = 20  # that a log is cut into, about
_SHARE = 0.25  # of the samples that is held out


def split_unlike(data: Dataset, signals: np.ndarray, shortest: int) -> tuple[Dataset, Dataset]:
    """The data without one kind of manoeuvre, and that kind: a quarter of the samples, as near as stretches allow.

    Each stretch is described by the RMS of every signal, over how much these differ between the stretches. What is held
    out are those, of all that are nearest to one stretch, whose mean is furthest from the mean of the others: one odd
    stretch makes no kind. Neighbours in time stay in one piece. Of data too short for two stretches, the last quarter
    is held out.

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
    features = np.array([np.sqrt(np.mean(signals[a:b] ** 2, axis=0)) for a, b in spans])
    features = features / np.maximum(features.std(axis=0), 1e-9 * features.max(axis=0) + 1e-300)
    lengths = np.array([b - a for a, b in spans])
    furthest, out = -1.0, np.zeros(len(spans), dtype=bool)
    for centre in features:
        order = np.argsort(np.linalg.norm(features - centre, axis=1), kind="stable")
        count = 1 + int(np.argmin(np.abs(np.cumsum(lengths[order]) - _SHARE * data.n_samples)))
        kind = np.isin(np.arange(len(spans)), order[: min(count, len(spans) - 1)])
        apart = float(np.linalg.norm(features[kind].mean(axis=0) - features[~kind].mean(axis=0)))
        if apart > furthest * (1 + 1e-9):  # else the last bit of a sum would choose
            furthest, out = apart, kind
    held = np.repeat(out, lengths)
    return _pieces(data, ~held), _pieces(data, held)


def _pieces(data: Dataset, kept: np.ndarray) -> Dataset:
    """Runs of rows that are kept, each an experiment."""
    changes = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(int)))
    borders = sorted({*changes.tolist(), *(a for a in data.starts if kept[a])})
    parts = [data.rows(a, b) for a, b in pairwise(borders) if kept[a]]
    return join(*parts, name=data.name)
