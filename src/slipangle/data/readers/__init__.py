"""One file per log format; each reader returns a `Dataset`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from slipangle.data.dataset import Dataset
from slipangle.data.readers.columns import Column
from slipangle.data.readers.csv import read_csv, write_csv
from slipangle.errors import FormatError

READERS: Mapping[str, Callable[..., Dataset]] = MappingProxyType(
    {".csv": read_csv, ".txt": read_csv, ".dat": read_csv, ".tsv": read_csv}
)
"""Which reader reads which file name suffix."""

__all__ = ["READERS", "Column", "read", "read_csv", "write_csv"]


def read(path: str | Path, *args: Any, **kwargs: Any) -> Dataset:
    """Read a log with the reader that its file name's suffix names.

    Parameters
    ----------
    path : str or Path
        The file.
    *args, **kwargs
        Passed to the reader; see `read_csv`.

    Raises
    ------
    FormatError
        If no reader knows the suffix; the known ones are listed.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in READERS:
        raise FormatError(
            f"no reader knows the suffix '{suffix}' of '{path}'; expected one of {', '.join(READERS)}: export the log "
            "as CSV"
        )
    return READERS[suffix](path, *args, **kwargs)
