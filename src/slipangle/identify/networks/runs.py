"""Free runs side by side, from states that may be thrown off: what a fit of many short runs works on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slipangle.data.dataset import Dataset


class PaddedRuns(NamedTuple):
    """Free runs, the shorter ones filled up with their last input."""

    heads: tuple[Dataset, ...]  # the samples that each starts from
    away: np.ndarray  # (n_runs, n_states), what its start is thrown off by
    u: np.ndarray  # (n_runs, n + 1, n_inputs), from the start on
    y: np.ndarray  # (n_runs, n, n_outputs), measured, from the sample after
    weight: np.ndarray  # (n_runs, n, n_outputs), 0 where a sample does not count

    @property
    def n_counting(self) -> int:
        """Samples that count."""
        return int(np.count_nonzero(self.weight[:, :, 0]))


def side_by_side(
    data: Dataset, memory: int, weights: np.ndarray, *, lead: int = 0, away: np.ndarray | float = 0.0
) -> PaddedRuns:
    """One run over each experiment; its first ``lead`` samples, after which it must be on its way, do not count.

    Experiments are longer than ``memory + lead``; ``weights``, shape (n_outputs,), none 0, are those of the outputs'
    errors. With ``lead`` above 0 starts are thrown off by up to ``away``, shape (n_states,), drawn evenly (seed 0).
    """
    parts = data.experiments
    n = max(part.n_samples for part in parts) - memory
    shape = len(parts), n, len(weights)
    u, y, weight = np.empty((len(parts), n + 1, len(data.inputs))), np.zeros(shape), np.zeros(shape)
    for i, part in enumerate(parts):
        k = part.n_samples - memory
        u[i, : k + 1], u[i, k + 1 :] = part.u[memory - 1 :], part.u[-1]
        y[i, :k], weight[i, lead:k] = part.y[memory:], weights
    drawn = np.random.default_rng(0).uniform(-1.0, 1.0, (len(parts), np.size(away)))
    return PaddedRuns(tuple(part.head(memory) for part in parts), drawn * away if lead else 0.0 * drawn, u, y, weight)
