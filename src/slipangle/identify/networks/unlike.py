"""Stretches of a log unlike its others: there a correction shows whether it holds where it was not fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from slipangle.data.dataset import Dataset, join

_STRETCHES = 20  # that a log is cut into, about
_SHARE = 0.25  # of the samples that is held out


@dataclass(frozen=True, kw_only=True)
class Proof:
    """RMSE over each unseen part of a log, without and with what was learned; the unlike manoeuvres first."""

    before: np.ndarray  # (n_parts,)
    after: np.ndarray  # (n_parts,)

    def doubt(self, worth: float) -> str:
        """What speaks against it; empty if no part is worse and all together are better by the share ``worth``."""
        least = np.maximum(self.before, np.finfo(float).tiny)
        with np.errstate(invalid="ignore"):  # of runs that left the finite numbers
            unlike, every = self.after[0] / least[0] - 1, np.linalg.norm(self.after) / np.linalg.norm(least) - 1
        if np.all(self.after < self.before) and every <= -worth:
            return ""
        return (
            f"on manoeuvres unlike those it was trained on it changed the RMSE by "
            f"{100 * unlike:+.1f} %, on all unseen parts by {100 * every:+.1f} %; expected at "
            f"least {-100 * worth:.0f} % and none worse"
        )


def proved(
    data: Dataset,
    signals: np.ndarray,
    shortest: int,
    folds: int,
    errors: Callable[[Dataset, Dataset], tuple[np.ndarray, np.ndarray]],
) -> Proof:
    """The proof over manoeuvres unlike the others, then over stretches of the second half, each after all before it.

    ``errors(seen, unseen)`` learns from one part and gives the errors over the other without and with what it learned,
    shape (n, n_outputs), over the size of the outputs; the rest is as of `split_unlike`.
    """
    rows = np.round(np.linspace(0.5, 1.0, folds) * data.n_samples).astype(int)
    parts = [split_unlike(data, signals, shortest)]
    parts += [(data.rows(0, a), data.rows(a, b)) for a, b in pairwise(rows.tolist())]
    rms = [[float(np.sqrt(np.mean(e**2))) for e in errors(*part)] for part in parts]
    before, after = np.array(rms).T
    return Proof(before=before, after=after)


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
