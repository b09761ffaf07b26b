"""Which recording each experiment is of, where one data set holds several."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from slipangle.data.dataset import Dataset

RECORDING = "recording"  # channel that numbers the recording that a sample is of


def recordings(data: Dataset) -> tuple[int, ...]:
    """Number of the recording that each experiment is of."""
    if RECORDING not in data:
        return tuple(range(len(data.starts)))
    return tuple(int(data[RECORDING][row]) for row in data.starts)


def repeated(parts: Sequence[Dataset], names: Sequence[str]) -> list[tuple[int, int]]:
    """Pairs of records whose samples of the channels ``names`` are the same ones, and no constant."""
    tables = [part.columns(tuple(names)) for part in parts]
    pairs = combinations(range(len(parts)), 2)
    return [(i, j) for i, j in pairs if np.array_equal(tables[i], tables[j]) and np.ptp(tables[i], axis=0).any()]
