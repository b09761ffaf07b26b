"""One file per log format; each reader returns a `Dataset`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slipangle.data.dataset import Dataset
from slipangle.data.readers.columns import ArrayTable, ChannelTable, Column, Header, assemble
from slipangle.data.readers.csv import read_csv, write_csv
from slipangle.errors import FormatError, MissingFileError
from slipangle.registry import Registry

__all__ = ["READERS", "ArrayTable", "ChannelTable", "Column", "Header", "Reader", "reader"]
__all__ += ["read", "read_csv", "write_csv"]

_HEAD = 4096  # bytes from a file's beginning by which its format is known


@dataclass(frozen=True, kw_only=True)
class Reader:
    """How logs of one format are read, and how they are known.

    ``read`` makes a `Dataset` from a path and what `read_csv` takes beside it; ``recognises`` says whether the first
    4096 bytes of a file are of this format, which file names with one of the ``suffixes`` are unless another does.
    """

    read: Callable[..., Dataset]
    recognises: Callable[[bytes], bool] | None = None
    suffixes: tuple[str, ...] = ()


READERS: Registry[Reader] = Registry("reader", "slipangle.readers")
"""Formats that `read` knows, by name."""

READERS.register("text table")(Reader(read=read_csv, suffixes=(".csv", ".txt", ".dat", ".tsv")))


def reader(
    name: str, *, recognises: Callable[[bytes], bool] | None = None, suffixes: tuple[str, ...] = ()
) -> Callable[[Callable[[Path], ChannelTable]], Callable[[Path], ChannelTable]]:
    """A decorator that adds a format to `READERS`: above a function from a path to the file's columns.

    Units, time stamps, gaps and missing numbers are then settled as for any log; see `Reader` for the settings.

    Raises ParameterError if another reader has this name.
    """

    def add(columns_of: Callable[[Path], ChannelTable]) -> Callable[[Path], ChannelTable]:
        def read(path: str | Path, columns: Any = None, **settings: Any) -> Dataset:
            settings.setdefault("name", Path(path).stem)
            return assemble(columns_of(Path(path)), columns, **settings)

        READERS.register(name)(Reader(read=read, recognises=recognises, suffixes=suffixes))
        return columns_of

    return add


def read(path: str | Path, *args: Any, **kwargs: Any) -> Dataset:
    """Read a log with the reader that recognises its content, else with the one of its file name's suffix.

    What follows the path is passed to the reader; see `read_csv`.

    Raises MissingFileError if the file cannot be read, and FormatError if no reader knows the file, or several
    recognise it, which are listed.
    """
    file = Path(path)
    known = [name for name, r in READERS.items() if r.recognises is not None]
    if known:
        try:
            with file.open("rb") as opened:
                head = opened.read(_HEAD)
        except OSError as error:
            raise MissingFileError(
                f"the log '{file}' cannot be read ({error.strerror or error}); expected a file: check the path"
            ) from None
        known = [name for name in known if READERS[name].recognises(head)]  # type: ignore[misc]
    suffix = file.suffix.lower()
    known = known or [name for name, r in READERS.items() if suffix in r.suffixes]
    if not known:
        suffixes = sorted({s for r in READERS.values() for s in r.suffixes})
        raise FormatError(
            f"no reader knows the content or the suffix '{suffix}' of '{path}'; expected one of {', '.join(suffixes)}: "
            "export the log as CSV"
        )
    if len(known) > 1:
        raise FormatError(f"'{path}' is known to the readers {', '.join(known)}; expected one: call that one itself")
    return READERS[known[0]].read(path, *args, **kwargs)
