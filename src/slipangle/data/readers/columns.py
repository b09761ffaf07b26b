"""Columns of a log file, whatever its format, become the channels of a `Dataset`: names, units, time, gaps."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal, TypedDict

import numpy as np

from slipangle import units
from slipangle.data.channels import STANDARD
from slipangle.data.clock import JITTER, find_grid, lost
from slipangle.data.dataset import Channel, Dataset
from slipangle.data.expression import Expression
from slipangle.data.headings import continued, wrap_note
from slipangle.data.readers.column import Column
from slipangle.data.readers.derived import derive, keep
from slipangle.data.readers.stamps import STEPS, is_time, time_of
from slipangle.data.readers.tables import ArrayTable, ChannelTable, Header, find_column, prefetch
from slipangle.errors import (
    FormatError,
    MissingColumnError,
    NotFiniteError,
    ParameterError,
    SampleTimeError,
    SlipangleError,
    TooShortError,
    UnitError,
    nearest,
    shown,
)

__all__ = ["ArrayTable", "ChannelTable", "Column", "Header", "LogSettings", "as_columns", "assemble", "check_dt"]

_USUAL = {"rad": "deg", "rad/s": "deg/s", "m/s": "km/h", "m/s2": "g"}  # what is logged in place of SI units
_CHUNK = 1 << 16  # rows that are moved at once
Told = defaultdict[str, list[str]]  # notes on units, and the channels they are of


class LogSettings(TypedDict, total=False):
    """What every reader takes beside path and columns; `slipangle.data.readers.csv.read_csv` says what each does."""

    time: Column | str | None
    dt: float | None
    inputs: Sequence[str]
    outputs: Sequence[str]
    nan: Literal["error", "gap", "merge"]
    filter: str | None
    jitter: float
    shortest: int
    experiment: str | None
    name: str | None


def _column(table: ChannelTable, name: str, column: Column, told: Told) -> tuple[np.ndarray, str]:
    """Numbers of one column in SI, and their unit; where nobody names one that is known, ``told`` gets what is taken.

    Raises UnitError if the unit of a standard channel is not known, or settings and heading name two.
    """
    i = find_column(table, column.source, name)
    header, standard = table.headers[i], STANDARD.get(name)
    what = f"column '{header.name}' of {table.name} (channel '{name}')"
    unit = column.unit if column.unit is not None else header.unit
    if (
        column.unit is not None
        and header.unit is not None
        and not column.override
        and units.known(header.unit)
        and units.canonical(column.unit) != units.canonical(header.unit)
    ):
        raise UnitError(
            f"{what} is in {header.unit!r} by its header and in {column.unit!r} by the settings; expected one unit: "
            "correct the wrong one, or set override (True, in a job true) if it is the header"
        )
    if unit is None and standard:
        unit = column.ending(header.name, units.quantity(standard.unit))
        told["units that headings end with: {}"] += [f"{name} in {unit} ('{header.name}')"] if unit else []
    guessed = unit is None
    if unit is None:
        unit = standard.unit if standard else "-"
        told["no unit named for {}: taken as SI"].append(name)
    numbers = table.numbers(i)
    if not units.known(unit) and standard is None and column.unit is None:
        told["units that are not known, numbers as they are: {}"].append(f"{name} in {shown(unit)}")
        return column.converted(numbers, "-", None, what), unit
    if not units.known(unit):
        raise UnitError(
            f"{what} is in {shown(unit)}, which is no unit that is known; {nearest(unit, units.names())}: correct it, "
            f"or convert, such as Column('{header.name}', '{standard.unit if standard else '-'}', scale=0.001)"
        )
    values = column.converted(numbers, unit, standard.unit if standard else None, what)
    largest = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
    if guessed and standard and largest > standard.largest:
        usual = _USUAL.get(standard.unit, "deg")
        raise UnitError(
            f"{what} names no unit and reaches {largest:.4g}; expected at most {standard.largest:.4g} "
            f"{standard.unit}: name the unit, in the header as '{header.name} [{usual}]' or as "
            f"Column('{header.name}', '{usual}')"
        )
    return values, units.si_unit(unit)


def as_columns(
    table: ChannelTable, columns: Mapping[str, Column | str] | Sequence[str] | None, exclude: set[int]
) -> dict[str, Column]:
    """Channel names and where they come from; by default every column under its own name."""
    if columns is None:
        kept = [(i, h.name) for i, h in enumerate(table.headers) if i not in exclude]
        for i, n in kept:
            if sum(n == other for _, other in kept) > 1:
                raise FormatError(
                    f"{table.name} has several columns named '{n}'; expected each name once: rename one, or choose "
                    f"columns by position, such as Column({i})"
                )
        return {n: Column(i) for i, n in kept}
    if isinstance(columns, Mapping):
        return {n: Column(c) if isinstance(c, str) else c for n, c in columns.items()}
    if isinstance(columns, str):
        columns = (columns,)
    return {n: Column(n) for n in columns}


def _cut_missing(
    table: ChannelTable, names: Sequence[str], values: np.ndarray, t: np.ndarray, nan: Literal["error", "gap"]
) -> tuple[np.ndarray, str]:
    """Rows that are complete (bool), and a note; raise if rows are not and must be."""
    missing = ~np.isfinite(values)
    whole = np.asarray(~missing.any(axis=1))
    if whole.all():
        return whole, ""
    column = int(np.argmax(missing.sum(axis=0)))
    flags = missing[:, column].astype(int)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags, [0]])))
    runs = edges.reshape(-1, 2)
    a, b = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    seen = (
        f"channel '{names[column]}' of {table.name} has {flags.sum()} missing samples (NaN, infinite or empty) in "
        f"{len(runs)} run{'s' if len(runs) > 1 else ''}, the longest {b - a} samples from {table.row_name(int(a))} to "
        f"{table.row_name(int(b - 1))} (t = {t[a]:.6g} to {t[b - 1]:.6g} s)"
    )
    if nan == "error":
        raise NotFiniteError(
            f"{seen}; expected numbers throughout: repair the log, split it there with "
            "nan='gap', or, if columns come at rates of their own, merge them with nan='merge'"
        )
    return whole, f"{seen}: {int((~whole).sum())} rows cut, each run a gap"


def _needed(
    table: ChannelTable,
    columns: Mapping[str, Column | str] | Sequence[str] | None,
    time: Column | str | None,
    experiment: str | None,
    condition: str | None,
) -> set[int]:
    """Positions of the columns that will be asked for, as far as they are there."""
    if columns is None:
        return set(range(len(table.headers)))
    given = columns.values() if isinstance(columns, Mapping) else (columns,) if isinstance(columns, str) else columns
    chosen = [c if isinstance(c, Column) else Column(c) for c in given]
    chosen += [time if isinstance(time, Column) else Column(time)] if time is not None else []
    texts = [*(c.derive for c in chosen if c.derive), *([condition] if condition else [])]
    named = [n for text in texts for n in Expression(text).names]
    sources = [*(c.source for c in chosen if not c.derive), *named, *([experiment] if experiment is not None else [])]
    clocks = [] if time is not None else [h.name for h in table.headers if is_time(h.name) or h.name.lower() in STEPS]
    found = set()
    for source in (*sources, *clocks):
        try:
            found.add(find_column(table, source, ""))
        except SlipangleError:
            continue  # it is a channel, or is asked for again and then told
    return found


def _closed_up(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """These rows, rising, moved to the front where they are: of a long log there is no room for a copy."""
    for a in range(0, len(rows), _CHUNK):
        part = rows[a : a + _CHUNK]
        values[a : a + len(part)] = values[part]
    return values[: len(rows)]


def _on_grids(
    table: ChannelTable,
    stamps: np.ndarray,
    values: np.ndarray,
    channels: Sequence[Channel],
    rows: Sequence[int],
    borders: Sequence[int],
    dt: float | None,
    jitter: float,
    shortest: int,
) -> dict[str, Any]:
    """Values, starts, start times and sample time of a data set, and notes, from rows cut into experiments.

    ``rows`` are those of the table that stamps and values are of, ``borders`` where each experiment begins and ends.
    """
    tables, starts, times, notes, count, filled = [], [], [], [], 0, 0
    names, unit_of, wrapped = [c.name for c in channels], [c.unit for c in channels], list[str]()
    for a, b in pairwise(borders):
        own, part, of = stamps[a:b], values[a:b], np.asarray(rows[a:b])
        gone = lost(own)
        gone = gone[of[gone + 1] == of[gone] + 1]  # in the file, and not cut on request
        if len(gone):
            part, found = continued(part, names, unit_of)
            wrapped += found
            own = np.insert(own, gone + 1, (own[gone] + own[gone + 1]) / 2)
            part = np.insert(part, gone + 1, (part[gone] + part[gone + 1]) / 2, axis=0)
            of, filled = np.insert(of, gone + 1, of[gone]), filled + len(gone)
        if len(own) == 1 and dt is not None and shortest <= 1:
            piece, begins, clock = part, (0,), (float(own[0]),)
        else:
            how = {"jitter": jitter, "shortest": shortest, "what": table.name}
            grid = find_grid(own, dt=dt, row_name=lambda k, of=of: table.row_name(int(of[k])), **how)
            dt = dt or grid.dt
            if not grid.exact:
                part, found = continued(part, names, unit_of)
                wrapped += found
            piece, begins = grid.onto(own, part)
            clock = grid.start_times
            notes += grid.notes
        tables.append(piece)
        starts += [count + s for s in begins]
        times += clock
        count += len(piece)
    if dt is None or count < max(shortest, 1):
        raise TooShortError(f"{table.name} holds {count} samples; expected at least {shortest}: record longer")
    if filled:
        notes.append(f"{filled} single sample{'s that were' if filled > 1 else ' that was'} lost: filled in linearly")
    if wrapped:  # then in every experiment alike
        tables = [continued(piece, names, unit_of)[0] for piece in tables]
    joined = tables[0] if len(tables) == 1 else np.vstack(tables)
    joined.setflags(write=False)  # it is nobody else's: a data set need not copy it
    return {"values": joined, "starts": starts, "start_times": times, "dt": dt, "notes": [*notes, *wrap_note(wrapped)]}


def assemble(
    table: ChannelTable,
    columns: Mapping[str, Column | str] | Sequence[str] | None = None,
    *,
    time: Column | str | None = None,
    dt: float | None = None,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    nan: Literal["error", "gap"] = "error",
    filter: str | None = None,
    jitter: float = JITTER,
    shortest: int = 2,
    experiment: str | None = None,
    epoch: bool = False,
    name: str,
    notes: Sequence[str] = (),
) -> Dataset:
    """Build the data set: units to SI, time to a uniform grid, gaps to experiments.

    Parameters are those of `slipangle.data.readers.csv.read_csv`, but for ``nan="merge"``; ``epoch`` keeps time stamps
    that count from 1970 as they are.

    Raises SlipangleError, one of its kinds per kind of bad input; see `read_csv`.
    """
    if nan not in ("error", "gap"):
        raise ParameterError(f"nan is {nan!r}; expected 'error' or 'gap': choose one")
    said: list[str] = list(notes)
    told: Told = defaultdict(list)
    names = columns if columns is not None else [h.name for h in table.headers]
    prefetch(table, _needed(table, columns, time, experiment, filter))
    t, time_column = time_of(table, time, dt, names, epoch, said)
    label = find_column(table, experiment, "experiment") if experiment is not None else None
    chosen = as_columns(table, columns, {i for i in (time_column, label) if i is not None})
    if not chosen:
        raise MissingColumnError(f"no column of {table.name} was chosen; expected at least one channel: name some")
    picked = {n: _column(table, n, c, told) for n, c in chosen.items() if not c.derive}
    picked = derive(table, chosen, picked, t)
    _require_picked(table, inputs, outputs, picked)
    notes_on_units = [note.format(", ".join(found)) for note, found in told.items() if found]
    said += [note for note in notes_on_units if note not in said]  # a file that was written has them
    stamps = t if t is not None else (dt or 1.0) * np.arange(len(next(iter(picked.values()))[0]))
    kept, note = keep(table, filter, picked, stamps) if filter else (None, "")
    channels = tuple(Channel(n, unit) for n, (_, unit) in picked.items())
    values = np.empty((len(stamps), len(channels)))
    for k, channel in enumerate(channels):
        values[:, k] = picked.pop(channel.name)[0]  # of a long log no column is held twice
    said += [note] if note else []
    seen = values if kept is None else np.where(kept[:, None], values, 0.0)
    whole, note = _cut_missing(table, [c.name for c in channels], seen, stamps, nan)
    whole = whole if kept is None else whole & kept
    said += [note] if note else []
    rows: Any = range(len(whole))
    if not whole.all():
        rows = np.flatnonzero(whole)
        stamps, values = stamps[rows], _closed_up(values, rows)
    borders = [0, len(rows)]
    if label is not None:
        borders = [0, *(np.flatnonzero(np.diff(table.numbers(label)[whole]) != 0) + 1).tolist(), len(rows)]
    uniform = _on_grids(table, stamps, values, channels, rows, borders, dt, jitter if t is not None else 0.0, shortest)
    return Dataset(
        channels=channels,
        inputs=tuple((inputs,) if isinstance(inputs, str) else inputs),
        outputs=tuple((outputs,) if isinstance(outputs, str) else outputs),
        name=name,
        notes=(*said, *uniform.pop("notes")),
        **uniform,
    )


def _require_picked(
    table: ChannelTable, inputs: Sequence[str], outputs: Sequence[str], picked: Mapping[str, Any]
) -> None:
    """Raise a MissingColumnError unless inputs and outputs are among the channels read."""
    for kind, wanted in (("input", inputs), ("output", outputs)):
        for n in (wanted,) if isinstance(wanted, str) else wanted:
            if n not in picked:
                raise MissingColumnError(
                    f"the {kind} '{n}' is not among the channels read from {table.name}; {nearest(n, picked)}: use one "
                    "of these, or add it to columns"
                )


def check_dt(dt: float | None) -> None:
    """Raise a SampleTimeError unless ``dt`` is None or positive."""
    if dt is not None and not (np.isfinite(dt) and dt > 0):
        raise SampleTimeError(f"the sample time dt is {dt} s; expected a positive number, such as 0.01: correct it")
