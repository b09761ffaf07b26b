"""One file per log format; each reader returns a `Dataset`."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from slipangle.data.dataset import Dataset
from slipangle.data.readers.columns import ArrayTable, ChannelTable, Column, Header
from slipangle.data.readers.csv import open_csv, read_csv, write_csv
from slipangle.data.readers.recording import Recording, Signal, build
from slipangle.data.readers.registry import READERS, Reader, reader, require_log
from slipangle.data.readers.tables import LazyTable
from slipangle.errors import FormatError, MissingFileError, ParameterError

__all__ = ["READERS", "ArrayTable", "ChannelTable", "Column", "Header", "LazyTable", "Reader", "Recording", "Signal"]
__all__ += ["open_log", "read", "read_csv", "reader", "write_csv"]

_HEAD = 4096  # bytes from a file's beginning by which its format is known

READERS.register("text table")(Reader(read=read_csv, open=open_csv, suffixes=(".csv", ".txt", ".dat", ".tsv")))
for _format in ("arrow", "matlab", "mdf", "motec_ld", "ros", "positions", "vbo"):  # each registers itself
    import_module(f"slipangle.data.readers.{_format}")


def read(path: str | Path, *args: Any, beside: Sequence[str | Path] = (), **kwargs: Any) -> Dataset:
    """Read a log with the reader that recognises its content, else with the one of its file name's suffix.

    Channels at different rates are put on one clock as `Recording.resample` says. Values are converted to SI units.

    Parameters
    ----------
    path : str or Path
        The log.
    *args, **kwargs
        For the reader, see `slipangle.data.readers.csv.read_csv`: ``columns`` first, a mapping of channel to `Column`
        or heading, then by name ``time``, ``dt`` [s], ``inputs``, ``outputs``, ``nan``, ``filter`` and others.
    beside : sequence of str or Path
        Other files of the same drive and clock, with more channels.

    Returns
    -------
    Dataset
        Shape (n_samples, n_channels); `Dataset.notes` says what was assumed, cut or interpolated.

    Raises MissingFileError if the file cannot be read, and FormatError if no reader knows the file, or several
    recognise it, which are listed.
    """
    if beside:
        return build(open_log(path, *beside), *args, **kwargs)
    return READERS[_format_of(Path(path))].read(path, *args, **kwargs)


def open_log(path: str | Path, *beside: str | Path) -> Recording:
    """A log as it was recorded, each channel at its own rate; see `Recording`.

    Files ``beside`` the first are of the same drive and clock; each file's columns then stand after its name and dot.

    Raises MissingFileError or FormatError as `read`, ParameterError if two files have one name.
    """
    logs = []
    for file in (Path(path), *map(Path, beside)):
        name = _format_of(file)
        opened = READERS[name].open
        if opened is None:
            raise FormatError(f"the reader '{name}' of '{file}' reads whole data sets; expected one that opens logs")
        logs.append((file.stem, opened(file)))
    if len(logs) == 1:
        return logs[0][1]
    if len({stem for stem, _ in logs}) < len(logs):
        raise ParameterError(f"two files beside '{path}' have one name; expected each another name: rename one")
    tables = {f"{stem}.{topic}" if topic else stem: table for stem, log in logs for topic, table in log.tables.items()}
    return Recording(name=logs[0][1].name, tables=tables, notes=tuple(n for _, log in logs for n in log.notes))


def _format_of(file: Path) -> str:
    """The name of the reader that knows a file."""
    if file.is_dir():
        known = [name for name, r in READERS.items() if r.folders and (file / "metadata.yaml").is_file()]
    else:
        try:
            with file.open("rb") as opened:
                head = opened.read(_HEAD)
        except FileNotFoundError:
            require_log(file)
            raise
        except OSError as error:
            raise MissingFileError(
                f"the log '{file}' cannot be read ({error.strerror or error}); expected a file: check the path"
            ) from None
        known = [name for name, r in READERS.items() if r.recognises is not None and r.recognises(head)]
        suffix = file.suffix.lower()
        known = known or [name for name, r in READERS.items() if suffix in r.suffixes]
    if not known:
        require_log(file)
        suffixes = sorted({s for r in READERS.values() for s in r.suffixes})
        raise FormatError(
            f"no reader knows the content or the suffix '{file.suffix.lower()}' of '{file}'; expected one of "
            f"{', '.join(suffixes)}: export the log as CSV"
        )
    if len(known) > 1:
        raise FormatError(f"'{file}' is known to the readers {', '.join(known)}; expected one: call that one itself")
    return known[0]
