"""Which recording each experiment is of, where one data set holds several."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from slipangle.data.dataset import Dataset, join

RECORDING = "recording"  # channel that numbers the recording that a sample is of


def recordings(data: Dataset) -> tuple[int, ...]:
    """Number of the recording that each experiment is of."""
    if RECORDING not in data:
        return tuple(range(len(data.starts)))
    return tuple(int(data[RECORDING][row]) for row in data.starts)


def by_recording(data: Dataset) -> dict[int, Dataset]:
    """The experiments of each recording, by its number."""
    parts: dict[int, list[Dataset]] = {}
    for k, part in zip(recordings(data), data.experiments, strict=True):
        parts.setdefault(k, []).append(part)
    return {k: join(*some) if len(some) > 1 else some[0] for k, some in parts.items()}


def repeated(parts: Mapping[int, Dataset], names: Sequence[str]) -> list[tuple[int, int]]:
    """Records, each with an earlier one that has the same samples of the channels ``names``, and no constant."""
    seen: dict[bytes, int] = {}
    pairs = []
    lengths = Counter(part.n_samples for part in parts.values())
    for k, part in parts.items():
        if lengths[part.n_samples] == 1:
            continue
        table = part.columns(tuple(names))
        if not np.ptp(table, axis=0).any():
            continue
        first = seen.setdefault(table.tobytes(), k)
        pairs += [(first, k)] if first != k else []
    return pairs
