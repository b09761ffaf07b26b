"""Columns of a log file, whatever its format, become the channels of a `Dataset`: names, units, time, gaps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal, TypedDict

import numpy as np

from slipangle import units
from slipangle.data.channels import STANDARD
from slipangle.data.clock import JITTER, find_grid, lost, past_midnight
from slipangle.data.dataset import Channel, Dataset
from slipangle.data.expression import Expression
from slipangle.data.headings import continued, wrap_note
from slipangle.data.readers.column import Column
from slipangle.data.readers.derived import derive, keep
from slipangle.data.readers.tables import DATE, ArrayTable, ChannelTable, Header, find_column, prefetch
from slipangle.errors import (
    FormatError,
    MissingColumnError,
    NotFiniteError,
    ParameterError,
    SampleTimeError,
    SlipangleError,
    TimeError,
    TooShortError,
    UnitError,
    nearest,
)

__all__ = ["ArrayTable", "ChannelTable", "Column", "Header", "LogSettings", "as_columns", "assemble", "check_dt"]

_TIME_NAMES = ("t", "time", "timestamp", "timestamps", "zeit", "tempo", "tiempo", "temps", "stamp")
_STEPS = ("interval", "utc", "elapsed")  # these only with a unit of time: others call a step or a place so
_EPOCH = 1e7  # larger first stamps count from the log's start [s]
_SLOW, _SLOW_DRIVE = 2.0, 1.0  # steps from here on are said, where no unit is named, of any log and of a drive [s]
_TOO_SLOW, _HOURS = 5.0, 1e4  # and refused in a log of a drive, if they are whole numbers, and in any log [s]
_DAYS = ((5e5, 1e6), (2.5e4, 7.5e4))  # between which stamps count days: since the year 0, or since 1900
_DAY_STEP = 1e-4  # and rise by less
_TOO_FAST = 1e-5  # steps below are no seconds in a log of a drive [s]
_USUAL = {"rad": "deg", "rad/s": "deg/s", "m/s": "km/h", "m/s2": "g"}  # what is logged in place of SI units
_CHUNK = 1 << 16  # rows that are moved at once


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


def _column(table: ChannelTable, name: str, column: Column, assumed: list[str]) -> tuple[np.ndarray, str]:
    """Numbers of one column in SI, and their unit; names without any unit are added to ``assumed``."""
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
    guessed = unit is None
    if unit is None:
        unit = standard.unit if standard else "-"
        assumed.append(name)
    numbers = table.numbers(i)
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


def time_of(
    table: ChannelTable, time: Column | str | None, dt: float | None, names: Iterable[str], epoch: bool, said: list[str]
) -> tuple[np.ndarray | None, int | None]:
    """Time stamps [s] of channels of these names, and the position of their column; ``said`` gets what is assumed.

    ``epoch`` keeps stamps that count from 1970. Raises TimeError, UnitError or MissingColumnError as `assemble`.
    """
    column = Column(time) if isinstance(time, str) else time
    if column is None:
        matches = [i for i, h in enumerate(table.headers) if h.name.lower() in _TIME_NAMES]
        matches = matches or [i for i, h in enumerate(table.headers) if h.name.lower() in _STEPS and _counts_time(h)]
        dates = [i for i, h in enumerate(table.headers) if h.unit == DATE]
        matches = matches or (dates if len(dates) == 1 else [])
        if not matches and dt is None:
            known = ", ".join(repr(h.name) for h in table.headers[:12])
            raise TimeError(
                f"{table.name} has no time column that is known by its name and no sample time is given (columns: "
                f"{known}); expected a column such as 't' or 'time': name it with time=, or give dt="
            )
        if not matches:
            return None, None
        column = Column(matches[0])
    i = find_column(table, column.source, "t")
    header = table.headers[i]
    what = f"the time column '{header.name}' of {table.name}"
    unit = "s" if (dated := header.unit == DATE) else column.unit or header.unit or "s"
    t = column.converted(table.numbers(i), unit, "s", what)
    if not (column.unit or header.unit or dt):
        said += _plausible_seconds(t, header, what, driven=any(n in STANDARD and n != "t" for n in names))
    t = past_midnight(t, said) if dated else t
    if not epoch and len(t) and _EPOCH < t[0] < np.inf:
        said.append(f"time counts from {t[0]:.9g} s, the first stamp")
        t = t - t[0]
    return t, i


def in_days(t: np.ndarray, step: float) -> bool:
    """Whether stamps are dates in days, as MATLAB's datenum or a spreadsheet counts; ``step`` from row to row.

    >>> in_days(np.array([738000.5]), 1e-7), in_days(np.array([45385.25]), 2e-7), in_days(np.array([738.0]), 1e-3)
    (True, True, False)
    """
    return len(t) > 0 and any(low < t[0] < high for low, high in _DAYS) and 0 < step < _DAY_STEP


def _counts_time(header: Header) -> bool:
    unit = header.unit or ""
    return unit == DATE or (units.known(unit) and units.quantity(unit) == "time")


def _plausible_seconds(t: np.ndarray, header: Header, what: str, *, driven: bool) -> list[str]:
    """A note on slow stamps without a unit.

    Raises TimeError if they cannot be seconds: hours from sample to sample, or, in a log of a drive (``driven``), whole
    numbers that are too slow and stamps that are too fast.
    """
    steps = np.diff(t[np.isfinite(t)])
    step = float(np.median(steps)) if len(steps) else 0.0
    if in_days(t, step):
        raise TimeError(
            f"{what} names no unit, begins at {t[0]:.9g} and rises by {step:.3g} from row to row; expected seconds, "
            f"and these look like days: name the unit, in the header as '{header.name} [d]' or as "
            f"time=Column('{header.name}', 'd')"
        )
    if driven and 0 < step < _TOO_FAST:
        raise TimeError(
            f"{what} names no unit and rises by {step:.3g} from row to row; expected seconds, which these cannot be: "
            f"name the unit, days in the header as '{header.name} [d]' or as time=Column('{header.name}', 'd'), or "
            "write hours and minutes as seconds"
        )
    if not step >= (_SLOW_DRIVE if driven else _SLOW):
        return []
    whole = bool(np.all(steps == np.round(steps)))
    finer = next((u for u, most in (("ms", 1e4), ("us", 1e7)) if step < most), "ns")
    if step >= _HOURS or (driven and whole and step >= _TOO_SLOW):
        raise TimeError(
            f"{what} names no unit and rises by {step:.6g} from row to row; expected seconds, which these cannot be: "
            f"name the unit, in the header as '{header.name} [{finer}]' or as time=Column('{header.name}', '{finer}')"
        )
    return [
        f"{what} names no unit: its steps of {step:.6g} are taken as seconds; if they are not, name the unit as "
        f"time=Column('{header.name}', '{finer}')"
    ]


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
    clocks = [] if time is not None else [h.name for h in table.headers if h.name.lower() in (*_TIME_NAMES, *_STEPS)]
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
    assumed: list[str] = []
    names = columns if columns is not None else [h.name for h in table.headers]
    prefetch(table, _needed(table, columns, time, experiment, filter))
    t, time_column = time_of(table, time, dt, names, epoch, said)
    label = find_column(table, experiment, "experiment") if experiment is not None else None
    chosen = as_columns(table, columns, {i for i in (time_column, label) if i is not None})
    if not chosen:
        raise MissingColumnError(f"no column of {table.name} was chosen; expected at least one channel: name some")
    picked = {n: _column(table, n, c, assumed) for n, c in chosen.items() if not c.derive}
    picked = derive(table, chosen, picked, t)
    _require_picked(table, inputs, outputs, picked)
    if assumed:
        said.append(f"no unit named for {', '.join(assumed)}: taken as SI")
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
