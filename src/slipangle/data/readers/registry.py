"""Formats that logs come in; a reader adds itself here, one of another package too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slipangle.data.dataset import Dataset
from slipangle.data.readers.recording import Recording, as_recording, build
from slipangle.data.readers.tables import ChannelTable
from slipangle.errors import MissingFileError, nearest
from slipangle.registry import Registry

Opened = ChannelTable | Recording


@dataclass(frozen=True, kw_only=True)
class Reader:
    """How logs of one format are read, and how they are known.

    ``read`` makes a `Dataset` from a path and what `read_csv` takes beside it, ``open`` a `Recording` from the path;
    ``recognises`` says whether the first 4096 bytes of a file are of this format, which file names with one of the
    ``suffixes`` are unless another does. ``folders`` says whether a folder may be such a log.
    """

    read: Callable[..., Dataset]
    open: Callable[[Path], Recording] | None = None
    recognises: Callable[[bytes], bool] | None = None
    suffixes: tuple[str, ...] = ()
    folders: bool = False


READERS: Registry[Reader] = Registry("reader", "slipangle.readers")
"""Formats that `slipangle.read` knows, by name."""


def reader(
    name: str,
    *,
    recognises: Callable[[bytes], bool] | None = None,
    suffixes: tuple[str, ...] = (),
    folders: bool = False,
) -> Callable[[Callable[[Path], Opened]], Callable[[Path], Opened]]:
    """A decorator that adds a format to `READERS`: above a function from a path to the file's columns.

    It gives a `ChannelTable`, or a `Recording` where channels have clocks of their own. Units, time stamps, gaps and
    missing numbers are then settled as for any log; see `Reader` for the settings.

    Raises ParameterError if another reader has this name.
    """

    def add(columns_of: Callable[[Path], Opened]) -> Callable[[Path], Opened]:
        def opened(path: Path) -> Recording:
            return as_recording(columns_of(path), path.stem)

        def read(path: str | Path, columns: Any = None, **settings: Any) -> Dataset:
            return build(opened(Path(path)), columns, **settings)

        READERS.register(name)(
            Reader(read=read, open=opened, recognises=recognises, suffixes=suffixes, folders=folders)
        )
        return columns_of

    return add


def require_log(path: Path) -> None:
    """Raise a MissingFileError with the nearest names unless there is a file."""
    if path.is_file():
        return
    kind = "is a folder" if path.is_dir() else "does not exist"
    folder = path.parent
    others = [p.name for p in folder.iterdir() if p.is_file()] if folder.is_dir() else []
    near = f"in '{folder}' {nearest(path.name, others)}" if folder.is_dir() else f"there is no folder '{folder}'"
    raise MissingFileError(f"the log '{path}' {kind}; expected a file, {near}: correct the path")
