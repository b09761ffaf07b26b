"""Settings of an export, checked before anything is recorded or written."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError, shown
from slipangle.export.drives import Drive


def is_count(value: object) -> bool:
    """Whether a value is a whole number, of Python or NumPy; True and False are none."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def place(path: Any, what: str) -> Path:
    """Where to write.

    Raises ParameterError unless that is a path, or text that is one.
    """
    if not isinstance(path, str | os.PathLike):
        raise ParameterError(f"the {what} is {shown(path)}; expected where to write: give it as text, or as a Path")
    return Path(path)


def require_drive(drive: Any) -> None:
    """Raise ParameterError unless a drive is a recorded one, data, or a number of steps."""
    if isinstance(drive, Drive | Dataset) or (is_count(drive) and drive >= 1):
        return
    raise ParameterError(
        f"the drive is {shown(drive)}; expected one that was recorded, a Dataset, or a whole number of steps of at "
        "least 1: a Recorder has its own in drive"
    )


def require_budget(states: Any) -> None:
    """Raise ParameterError unless it is a number of states, or 0 for no budget."""
    if not (is_count(states) and states >= 0):
        raise ParameterError(
            f"the budget is {shown(states)}; expected a whole number of states, or 0 for none: try budget=10_000"
        )
