"""Which recording each experiment is of, where one data set holds several."""

from slipangle.data.dataset import Dataset

RECORDING = "recording"  # channel that numbers the recording that a sample is of


def recordings(data: Dataset) -> tuple[int, ...]:
    """Number of the recording that each experiment is of."""
    if RECORDING not in data:
        return tuple(range(len(data.starts)))
    return tuple(int(data[RECORDING][row]) for row in data.starts)
