"""Text tables (CSV, TSV, blank-separated) to `Dataset` and back."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Unpack

import numpy as np

from slipangle import units
from slipangle.data.dataset import Dataset
from slipangle.data.readers.column import Column
from slipangle.data.readers.columns import LogSettings, check_dt
from slipangle.data.readers.recording import Recording, build
from slipangle.data.readers.text_table import OURS, read_table
from slipangle.errors import UnitError, shown
from slipangle.files import write_atomic


def read_csv(
    path: str | Path,
    columns: Mapping[str, Column | str] | Sequence[str] | None = None,
    *,
    delimiter: str | None = None,
    skip_lines: int = 0,
    **settings: Unpack[LogSettings],
) -> Dataset:
    """Read a text table into a `Dataset`, converting units at the door.

    Separator (``,`` ``;`` tab or blanks), comment lines (``#``, ``%``), a heading in the last comment
    line, a line of units under the heading, decimal commas and the encoding are recognised; so are lines above the
    heading (MoTeC i2, AiM), headings with units and rates (RaceCapture), numbers in quotes, and dates and times of day.

    Parameters
    ----------
    path, delimiter, skip_lines
        The file; its separator, if it is not recognised; lines to leave out at the top.
    columns : mapping or sequence, optional
        Channel name to `Column` (or to the heading's name); a sequence takes columns under their own
        names; by default all columns are read.
    time : Column or str, optional
        The time column; by default one called t, time or timestamp.
    dt : float, optional
        Sample time, for files without time or with stamps too coarse to rise from row to row; beside time stamps it
        must agree with them. [s]
    inputs, outputs : sequence of str
        Channels that drive the system, and that are to be explained.
    nan : {"error", "gap", "merge"}
        Whether missing numbers are an error, cut the log into experiments, or belong to columns that come at rates of
        their own and are merged by time, as `slipangle.data.readers.Recording.resample` says. Headings that say their
        rates (RaceCapture) are merged in any case.
    filter : str, optional
        A condition on channels, columns and ``t`` in SI units, such as ``"v_x > 5 and t < 200"``: other rows are cut.
    jitter : float
        Largest variation of a time step, as a share of it (0.2 unless given), that is put back on the grid. Steps above
        1.5 sample times are gaps: they split the log into experiments. Where rows of a file leave out a single sample
        now and then, less than one in ten, it is filled in linearly, and a note says how many.
    shortest : int
        Experiments with fewer samples (2 unless given) are dropped, and a note says so.
    experiment : str, optional
        A column whose changes of value start a new experiment.
    name : str, optional
        What the data are; by default the file's name.

    Returns
    -------
    Dataset
        SI units; `Dataset.notes` says what was assumed, cut or interpolated.

    Raises
    ------
    MissingFileError
        If the file does not exist or cannot be read.
    FormatError
        If a cell is not a number (line and column are given) or a line has too few cells.
    MissingColumnError
        If a column is missing; the nearest names are given.
    UnitError
        If a unit is unknown, of another quantity than the channel's name demands, contradicted by the
        header, or missing where the numbers cannot be SI.
    NotFiniteError
        If numbers are missing and ``nan`` is "error".
    TimeError, SampleTimeError
        If time goes back, repeats or mixes sample times, or ``dt`` disagrees.
    TooShortError
        If there are too few samples.
    """
    check_dt(settings.get("dt"))
    table = read_table(path, delimiter=delimiter, skip_lines=skip_lines)
    notes = ("decimal commas are read as points",) if table.decimal_comma else ()
    recording = Recording(name=Path(path).stem, tables={"": table}, meta=table.meta)
    return build(recording, columns, notes=notes, **settings)


def open_csv(path: str | Path) -> Recording:
    """A text table as it was recorded; see `read_csv` for what is recognised and what is refused."""
    table = read_table(path)
    return Recording(name=Path(path).stem, tables={"": table}, meta=table.meta)


def write_csv(data: Dataset, path: str | Path) -> Path:
    """Write a data set so that `read_csv` gives it back bit for bit.

    The first line is a comment with sample time, inputs, outputs and notes; headings are
    ``name [unit]``; numbers have 17 digits. Several experiments get a column ``experiment``.

    Raises WriteError if the place cannot be written, where nothing is left half-written, and UnitError if a channel's
    unit is not one that can be read back.
    """
    meta = {
        "name": data.name,
        "dt": data.dt,
        "inputs": data.inputs,
        "outputs": data.outputs,
        "notes": data.notes,
        "experiment": "experiment" if len(data.starts) > 1 else None,
    }
    headings = ["t [s]"] + [f"{c.name} [{_writable(c.unit)}]" for c in data.channels]
    columns = [data.t, *data.values.T]
    if len(data.starts) > 1:
        headings.insert(1, "experiment [-]")
        columns.insert(1, np.repeat(np.arange(len(data.starts)), np.diff((*data.starts, data.n_samples))))
    quoted = [f'"{h}"' if "," in h else h for h in headings]
    rows = [",".join(f"{v:.17g}" for v in row) for row in zip(*(c.tolist() for c in columns), strict=True)]
    return write_atomic(path, "\n".join([OURS + json.dumps(meta), ",".join(quoted), *rows]) + "\n")


def _writable(unit: str) -> str:
    """A unit as it can be read back, one that is not known among them; raises UnitError if its letters cannot be."""
    if units.known(unit):
        return units.canonical(unit)
    if unit != unit.strip() or re.search(r'["\[\]\n\r]', unit):
        raise UnitError(f"the unit {shown(unit)} cannot stand in a heading; expected no brackets, quotes or line ends")
    return unit
