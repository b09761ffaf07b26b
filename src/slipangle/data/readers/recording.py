"""`Recording`: a log as it was recorded, each channel at its own rate, until it is put on one clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from slipangle.data.clock import even_clock
from slipangle.data.dataset import Dataset
from slipangle.data.expression import Expression
from slipangle.data.headings import TURN, is_heading, unwrapped, wrap_note, wraps
from slipangle.data.readers.column import Column
from slipangle.data.readers.columns import assemble
from slipangle.data.readers.stamps import time_of
from slipangle.data.readers.tables import ArrayTable, ChannelTable, Header
from slipangle.errors import (
    MissingColumnError,
    NotFiniteError,
    ParameterError,
    TimeError,
    TooShortError,
    nearest,
    shown,
)
from slipangle.shown import Shown

GAP = 2.5  # own sample times without a sample end a stretch
_SHORT = 0.5  # s that may be left out at an end without a word
_MOST = 100_000_000  # samples of a merged channel


@dataclass(frozen=True, kw_only=True)
class Signal:
    """One channel as it was recorded: stamps [s] and numbers in ``unit`` (None if the file says none), shape (n,)."""

    name: str
    unit: str | None
    t: np.ndarray
    values: np.ndarray

    @property
    def dt(self) -> float:
        """The usual time from sample to sample; 0 for a single one. [s]"""
        steps = np.diff(self.t)
        return float(np.median(steps)) if len(steps) else 0.0


@dataclass(frozen=True, kw_only=True)
class Recording(Shown):
    """Channels at their own rates: a table for each clock, by topic; a log with one clock has one table.

    Parameters
    ----------
    name : str
        What was recorded.
    tables : mapping
        By topic, such as ``/imu``, or ``""`` where there is one clock.
    notes : sequence of str
        What was assumed while reading.
    meta : mapping
        What a writer of the toolbox noted in the file: name, dt, inputs, outputs, notes, experiment.

    Raises MissingColumnError if no channel could be read.
    """

    name: str
    tables: Mapping[str, ChannelTable]
    notes: tuple[str, ...] = field(default=())
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.tables:
            raise MissingColumnError(f"'{self.name}' holds no channel of numbers; expected some: record or export them")

    def _words(self) -> str:
        clocks = f" on {len(self.tables)} clocks" if len(self.tables) > 1 else ""
        names = self.names
        return f"{len(names)} channels{clocks} of {self.name}: {', '.join(names[:6])}{', ...' * (len(names) > 6)}"

    @property
    def names(self) -> tuple[str, ...]:
        """Every column: its name alone where it is the only one of that name, else after topic and dot."""
        count: dict[str, int] = {}
        for table in self.tables.values():
            for h in table.headers:
                count[h.name] = count.get(h.name, 0) + 1
        return tuple(
            h.name if count[h.name] == 1 or not topic else f"{topic}.{h.name}"
            for topic, table in self.tables.items()
            for h in table.headers
        )

    def find(self, source: str | int, channel: str = "") -> tuple[str, int]:
        """Topic and position of a column by its name, ``source``, with topic and unit or without.

        Raises MissingColumnError with the nearest names if there is none, ParameterError if several have that name.
        """
        if isinstance(source, int):
            raise ParameterError(
                f"channel '{channel}' is column {source}, but '{self.name}' has several tables; name it"
            )
        found = [
            (topic, i)
            for topic, table in self.tables.items()
            for i, h in enumerate(table.headers)
            if source in (h.text, h.name, f"{topic}.{h.name}")
        ]
        exact = [(topic, i) for topic, i in found if source == f"{topic}.{self.tables[topic].headers[i].name}"]
        found = exact or found
        if not found:
            raise MissingColumnError(
                f"'{self.name}' has no column '{source}'{f' for channel {channel!r}' if channel else ''}; "
                f"{nearest(source, self.names)}: correct the name"
            )
        if len(found) > 1:
            places = [f"{t}.{self.tables[t].headers[i].name}" if t else f"column {i}" for t, i in found[:4]]
            raise ParameterError(
                f"'{self.name}' has {len(found)} columns named '{source}'; expected one: choose among "
                f"{', '.join(places)}"
            )
        return found[0]

    def signal(self, name: str, *, time: Column | str | None = None) -> Signal:
        """One channel at its own rate, where it has numbers; ``time`` names its clock as `slipangle.read` does.

        Raises MissingColumnError, FormatError or TimeError if it is not there or has no numbers or no clock.
        """
        topic, i = self.find(name)
        table = self.tables[topic]
        t, _ = time_of(table, _own(table, time), None, (), True, [])
        values = table.numbers(i)
        known = np.isfinite(values)
        if t is None:
            raise TimeError(f"{table.name} has no time; expected a column of time stamps")
        return Signal(name=name, unit=table.headers[i].unit, t=t[known], values=values[known])

    def resample(self, dt: float | None = None, columns: Any = None, **settings: Any) -> Dataset:
        """All channels, or some, on one clock: a `Dataset` at sample time ``dt`` [s], by default the fastest one's.

        ``columns`` maps channels to columns, as in `slipangle.read`. Slower channels are interpolated linearly, and
        where one has no sample for 2.5 of its own sample times there is
        a gap; to a longer ``dt`` all go through a zero-phase low-pass, as `Dataset.resample` says. Columns and settings
        are those of `slipangle.read`.

        Raises SlipangleError, one of its kinds per kind of bad input; see `slipangle.data.readers.csv.read_csv`.
        """
        return build(self, columns, dt=dt, **({"nan": "merge"} | settings))


def as_recording(opened: ChannelTable | Recording, name: str) -> Recording:
    """What a reader gave, as a recording."""
    return opened if isinstance(opened, Recording) else Recording(name=name, tables={"": opened})


def _own(table: ChannelTable, time: Column | str | None) -> Column | str | None:
    """The time column that was named, if this table has it; else the one known by its name."""
    source = time.source if isinstance(time, Column) else time
    here = isinstance(source, int) or any(source in (h.text, h.name) for h in table.headers)
    return time if source is None or len(table.headers) == 0 or here else None


def build(
    recording: Recording,
    columns: Mapping[str, Column | str] | Sequence[str] | None = None,
    *,
    name: str | None = None,
    nan: str = "error",
    dt: float | None = None,
    time: Column | str | None = None,
    notes: Sequence[str] = (),
    **settings: Any,
) -> Dataset:
    """A `Dataset` from a recording; one clock as `assemble` does it, several merged by time.

    Raises SlipangleError, one of its kinds per kind of bad input; see `slipangle.data.readers.csv.read_csv`.
    """
    if nan not in ("error", "gap", "merge"):
        raise ParameterError(f"nan is {nan!r}; expected 'error', 'gap' or 'merge': choose one")
    notes = (*recording.meta.get("notes", ()), *notes)
    if recording.meta:
        settings = _noted(recording.meta, columns, settings)
        dt, name = dt or recording.meta.get("dt"), name or recording.meta.get("name")
    label, said = name or recording.name, (*recording.notes, *notes)
    alone = None if nan == "merge" else _only_table(recording, columns, settings.get("filter"))
    if alone is not None:
        table, own = alone
        clock = _own(table, time)
        rated = len(recording.tables) > 1 and time_of(table, clock, 1.0, (), True, [])[0] is not None
        how: dict[str, Any] = {"time": clock, "nan": nan, "name": label, "notes": said, **settings}
        return _at(assemble(table, own, **how), dt) if rated else assemble(table, own, dt=dt, **how)
    if settings.pop("experiment", None) is not None:
        raise ParameterError(f"'{label}' is merged by time, and experiment= is for logs with one clock; leave it out")
    if isinstance(columns, str):
        columns = (columns,)
    wanted = (
        {n: Column(c) if isinstance(c, str) else c for n, c in columns.items()}
        if isinstance(columns, Mapping)
        else {n: Column(n) for n in (columns if columns is not None else _countable(recording, time))}
    )
    table, sources, more = _merged(recording, wanted, time, settings.get("filter"))
    moved = {n: c if c.derive else replace(c, source=sources[n]) for n, c in wanted.items()}
    data = assemble(table, moved, time=Column(0, "s"), nan="gap", name=label, notes=(*said, *more), **settings)
    return _at(data, dt)


def _at(data: Dataset, dt: float | None) -> Dataset:
    """The same at this sample time, if one is asked for. [s]"""
    return data if dt is None or np.isclose(data.dt, dt, rtol=1e-9) else data.resample(dt)


def _noted(meta: Mapping[str, Any], columns: Any, settings: dict[str, Any]) -> dict[str, Any]:
    """Settings, completed by what a writer noted."""
    known: dict[str, Any] = {
        key: [n for n in meta.get(key, ()) if columns is None or n in columns] for key in ("inputs", "outputs")
    }
    known["experiment"] = meta.get("experiment")
    return settings | {key: settings.get(key) or value for key, value in known.items()} | {"shortest": 1, "epoch": True}


def _only_table(
    recording: Recording, columns: Any, condition: str | None
) -> tuple[ChannelTable, Mapping[str, Column | str] | Sequence[str] | None] | None:
    """The one table that holds all that is asked for, and the columns as they are called there; else nothing."""
    tables = list(recording.tables.values())
    if len(tables) == 1:
        return None if any(h.rate for h in tables[0].headers) else (tables[0], columns)
    if columns is None:
        return None
    if not isinstance(columns, Mapping):
        columns = dict.fromkeys((columns,) if isinstance(columns, str) else columns)
        columns = {n: Column(n) for n in columns}
    wanted = {n: Column(c) if isinstance(c, str) else c for n, c in columns.items()}
    if condition or any(c.derive for c in wanted.values()):
        return None
    places = {n: recording.find(c.source, n) for n, c in wanted.items()}
    topics = {topic for topic, _ in places.values()}
    if len(topics) != 1:
        return None
    return recording.tables[topics.pop()], {n: replace(c, source=places[n][1]) for n, c in wanted.items()}


def _countable(recording: Recording, time: Column | str | None) -> list[str]:
    """Every channel that is not a clock."""
    names = iter(recording.names)
    kept = []
    for table in recording.tables.values():
        _, clock = time_of(table, _own(table, time), 1.0, (), True, [])
        kept += [n for n, i in zip(names, range(len(table.headers)), strict=False) if i != clock]
    return kept


def _merged(
    recording: Recording, wanted: Mapping[str, Column], time: Column | str | None, condition: str | None
) -> tuple[ArrayTable, dict[str, int], list[str]]:
    """The columns that are asked for on one clock, NaN where one has a gap; where each channel stands; notes."""
    places = {n: recording.find(c.source, n) for n, c in wanted.items() if not c.derive}
    texts = [*(c.derive for c in wanted.values() if c.derive), *([condition] if condition else [])]
    beside = [n for text in texts for n in Expression(text).names if n not in wanted and n != "t"]
    named = {n: recording.find(n, n) for n in beside}  # columns of the expressions alone
    if not places and not named:
        raise MissingColumnError(f"no column of '{recording.name}' was chosen; expected at least one: name some")
    for topic, i in places.values():
        named.setdefault(_full(recording, topic, i), (topic, i))
    clocks, said = _clocks(recording, [topic for topic, _ in named.values()], time)
    series = {key: _series(recording, place, clocks[place[0]]) for key, place in named.items()}
    said += [*_filled(recording, named, clocks), *_unwrap(series, named, places, wanted)]
    first = max((s.t[0], k) for k, s in series.items())
    last = min((s.t[-1], k) for k, s in series.items())
    step = min(s.dt for s in series.values())
    if not last[0] - first[0] > step:
        raise TimeError(
            f"in '{recording.name}' {shown(series[last[1]].name)} ends at {last[0]:.9g} s and "
            f"{shown(series[first[1]].name)} begins at {first[0]:.9g} s; expected channels of one drive on one clock: "
            "check the time columns and their units"
        )
    fastest = next(s for s in series.values() if s.dt <= 1.001 * step)
    begin, step = even_clock(fastest.t, first[0], step)
    if (last[0] - first[0]) / step * len(series) > _MOST:
        raise TooShortError(
            f"'{recording.name}' spans {last[0] - first[0]:.3g} s at {1 / step:.3g} Hz, more than {_MOST:.0e} numbers; "
            "expected a drive: check the unit of its time, or choose fewer channels"
        )
    origin = begin if abs(begin) > 1e7 else 0.0  # seconds since 1970, or of a long uptime
    grid = begin + step * np.arange(int((last[0] - begin) / step + 1e-6) + 1)
    values = np.column_stack([grid - origin, *(_onto(grid, s) for s in series.values())])
    slow = [f"{k} at {1 / s.dt:.3g}" for k, s in series.items() if s.dt > 1.05 * step]
    if slow:
        said.append(f"merged by time at {1 / step:.4g} Hz, linearly in between: {', '.join(slow[:8])} Hz")
    said += _shortened(series, origin)
    if origin:
        said.append(f"time counts from {origin:.9g} s, the first stamp")
    headers = (Header(text="t", name="t", unit="s"), *(Header(text=k, name=k, unit=s.unit) for k, s in series.items()))
    at = {place: i + 1 for i, place in enumerate(named.values())}
    table = ArrayTable(name=f"'{recording.name}'", headers=headers, values=values)
    return table, {n: at[place] for n, place in places.items()}, said


def _shortened(series: Mapping[str, Signal], origin: float) -> list[str]:
    """Notes where the channel that begins last, or ends first, leaves out a part of another."""
    said = []
    for place, sign, to, verb in ((0, -1, "from", "begins"), (-1, 1, "up to", "ends")):
        edge = {name: sign * float(s.t[place]) for name, s in series.items()}
        own, other = min(edge, key=edge.__getitem__), max(edge, key=edge.__getitem__)
        if edge[other] - edge[own] > max(_SHORT, GAP * series[own].dt):
            at, there = (sign * edge[n] - origin for n in (own, other))
            said.append(f"merged {to} {at:.6g} s, where {own} {verb}: {other} {verb} at {there:.6g} s")
    return said


def _filled(recording: Recording, named: Mapping[str, tuple[str, int]], clocks: Mapping[str, np.ndarray]) -> list[str]:
    """A note on single cells without a number, of columns that have one in nearly every row; `_onto` fills them in."""
    found: dict[str, int] = {}
    for key, (topic, i) in named.items():
        rows = np.flatnonzero(np.isfinite(recording.tables[topic].numbers(i)) & np.isfinite(clocks[topic]))
        apart = np.diff(rows)
        if np.any(apart > 1) and np.median(apart) == 1:
            found[key] = int(np.sum(apart == 2))
    told = [f"{count} of {key}" for key, count in found.items() if count]
    return [f"single cells without a number, filled in linearly: {', '.join(told[:8])}"] if told else []


def _unwrap(
    series: dict[str, Signal],
    named: Mapping[str, tuple[str, int]],
    places: Mapping[str, tuple[str, int]],
    wanted: Mapping[str, Column],
) -> tuple[str, ...]:
    """Headings among the columns without leaps of a full turn, in their own numbers; a note where there were some."""
    wrapped = []
    for key, place in named.items():
        s, users = series[key], [n for n, other in places.items() if other == place]
        column = wanted[users[0]] if users else Column(key)
        unit = column.unit if column.unit is not None else s.unit
        if not any(is_heading(n, unit) for n in users or (s.name,)):
            continue
        ends = column.converted(np.array([0.0, 1.0]), unit or "rad", None, key)
        turn = TURN / abs(float(ends[1] - ends[0]))
        if len(wraps(s.values, turn)):
            series[key] = replace(s, values=unwrapped(s.values, turn))
            wrapped.append(users[0] if users else key)
    return wrap_note(wrapped)


def _full(recording: Recording, topic: str, i: int) -> str:
    name = recording.tables[topic].headers[i].name
    return f"{topic}.{name}" if topic else name


def _clocks(
    recording: Recording, topics: Sequence[str], time: Column | str | None
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Time stamps of each table that is needed. [s]"""
    clocks, said = {}, list[str]()
    for topic in dict.fromkeys(topics):
        table = recording.tables[topic]
        t, _ = time_of(table, _own(table, time), None, ("v_x",), True, said)
        if t is None:
            raise TimeError(f"{table.name} has no time; expected a column of time stamps")
        clocks[topic] = t
    return clocks, said


def _series(recording: Recording, place: tuple[str, int], t: np.ndarray) -> Signal:
    """One column where it has numbers, in rising time."""
    table = recording.tables[place[0]]
    header, values = table.headers[place[1]], table.numbers(place[1])
    known = np.flatnonzero(np.isfinite(values) & np.isfinite(t))
    if len(known) < 2:
        raise NotFiniteError(
            f"column '{header.name}' of {table.name} holds {len(known)} numbers; expected at least 2: leave it out"
        )
    stamps, values = t[known], values[known]
    again = np.flatnonzero(np.diff(stamps) <= 0)
    if len(again):
        same = (np.diff(stamps) == 0) & (np.diff(values) == 0)
        if not same[again].all():
            row = int(again[~same[again]][0]) + 1
            verb = "repeats" if stamps[row] == stamps[row - 1] else "goes back"
            raise TimeError(
                f"the time of column '{header.name}' of {table.name} {verb} at {table.row_name(int(known[row]))}: "
                f"{stamps[row - 1]:.10g} s, then {stamps[row]:.10g} s; expected rising time: sort or delete those rows"
            )
        once = np.concatenate([[True], np.diff(stamps) > 0])
        stamps, values = stamps[once], values[once]
    return Signal(name=header.name, unit=header.unit, t=stamps, values=values)


def _onto(grid: np.ndarray, s: Signal) -> np.ndarray:
    """A channel at the instants of a grid, NaN between samples that are further apart than a gap."""
    x = np.interp(grid, s.t, s.values)
    right = np.clip(np.searchsorted(s.t, grid), 1, len(s.t) - 1)
    apart = s.t[right] - s.t[right - 1] > GAP * s.dt
    x[apart & (np.abs(grid - s.t[right]) > 1e-9) & (np.abs(grid - s.t[right - 1]) > 1e-9)] = np.nan
    return x
