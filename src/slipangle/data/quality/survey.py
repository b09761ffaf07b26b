"""What is in a log before it is read: channels, rates, units, ranges, gaps, and which of them a car's model asks for.

Guesses are guesses: `Guess.why` says what each rests on, and `slipangle.data.quality.plausible` judges them afterwards.
"""

from __future__ import annotations

import re
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slipangle import units
from slipangle.data.channels import STANDARD
from slipangle.data.clock import GAP, JITTER
from slipangle.data.quality.plausible import REAR
from slipangle.data.quality.vocabulary import QUANTITY, WORDS
from slipangle.data.readers.column import Column
from slipangle.data.readers.recording import Recording
from slipangle.data.readers.stamps import in_days
from slipangle.data.readers.tables import DATE, ChannelTable
from slipangle.errors import SlipangleError

_GAP = 2.5  # usual steps without a sample
_HAND_WHEEL = 0.75  # rad that no road wheel of a car on a track reaches
_BY_HAND = re.compile("(?<!road)wheel|swa|lenkrad|stwhl|strwhl")  # names of the hand wheel, plain
_TURNS = 10.0  # rad that it may turn and more degrees than it hardly does
_RATIO = 15.0  # of a steering whose hand wheel is logged, if nobody says
_SPARSE = 0.2  # share of empty cells from which a column has a rate of its own
_AGAINST = -0.5  # correlation of delta v_x and r below which one has the wrong sign
_TURNING = ("delta", "v_x", "r", "a_y")
_CLOCK = ("t", "time", "timestamp", "timestamps", "stamp", "zeit", "tempo", "tiempo", "temps", "interval", "utc")
_COMMANDS = ("cmd", "command", "setpoint", "target", "desired")  # what was asked for, not what was measured
_EARTH = ("gps", "gnss", "fix", "enu", "ned", "utm")  # whose x and y are not those of the car


@dataclass(frozen=True, kw_only=True)
class Seen:
    """One channel of a log: its clock, size and what stands out; numbers in the log's ``unit``, times in s."""

    name: str
    unit: str | None
    samples: int
    rate: float
    low: float
    high: float
    gaps: int
    longest: float
    remarks: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Guess:
    """A channel of a model and the column that seems to be it, with what was guessed about the column."""

    channel: str
    column: Column
    why: tuple[str, ...]

    @property
    def line(self) -> str:
        """The entry of a job's ``[data.columns]``."""
        parts = [f"column = {quoted(str(self.column.source))}"]
        parts += [f'unit = "{self.column.unit}"'] if self.column.unit else []
        parts += [
            f"{key} = {getattr(self.column, key):g}" for key in ("sign", "ratio") if getattr(self.column, key) != 1
        ]
        return f"{self.channel} = {{ {', '.join(parts)} }}"


@dataclass(frozen=True, kw_only=True)
class Survey:
    """What was found in a log; ``settings`` are entries of a job's ``[data]`` that the log needs, with the reason."""

    channels: tuple[Seen, ...]
    guesses: tuple[Guess, ...]
    time: Column | None
    settings: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]

    def columns(self) -> dict[str, Column]:
        """Channels as readers take them."""
        return {g.channel: g.column for g in self.guesses}

    @property
    def sentences(self) -> tuple[str, ...]:
        """A line for every channel, then what to write into a job."""
        wide = min(max((len(c.name) for c in self.channels), default=0), 40)
        said = [
            f"{c.name:{wide}}  {c.rate:8.4g} Hz  {c.low:11.4g} to {c.high:<11.4g} {c.unit or 'no unit':10}"
            + (f"  {c.gaps} gaps, the longest {c.longest:.3g} s" if c.gaps else "")
            + (f"  {'; '.join(c.remarks)}" if c.remarks else "")
            for c in self.channels
        ]
        said += list(self.notes)
        if self.settings or self.guesses:
            said += ["", "what a job would say of it (guesses, with the reason):"]
            said += [f"  {line:58} # {why}" for line, why in self.settings]
            said += [f"  {g.line:58} # {'; '.join(g.why)}" for g in self.guesses]
        return tuple(said)


def quoted(text: str) -> str:
    """Text as TOML writes it."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def survey(log: Recording) -> Survey:
    """Look at every channel of a log at its own rate; nothing is changed.

    Raises SlipangleError if no clock of the log can be read.
    """
    time, settings, notes = _clock(log)
    channels, values, asked, clock = [], {}, set(), None
    for name in log.names:
        topic, i = log.find(name)
        header = log.tables[topic].headers[i]
        if header.unit == DATE or (time is not None and header.name == time.source) or _plain(header.name) in _CLOCK:
            continue
        try:
            signal = log.signal(name, time=time)
        except SlipangleError as error:
            notes.append(f"{name} cannot be read: {str(error).split(';')[0]}")
            continue
        if len(signal.values) < 2:
            notes.append(f"{name} is empty")
            continue
        clock = signal.t if clock is None else clock
        seen = _seen(name, signal.unit, signal.t, signal.values)
        channels.append(seen)
        values[name] = signal.values
        asked |= {name} if any(word in _plain(f"{topic} {name}") for word in _COMMANDS) else set()
        sparse = 1 - len(signal.values) / len(log.tables[topic].numbers(i))
        if sparse > _SPARSE and not any(line.startswith("nan") for line, _ in settings) and not header.rate:
            why = f"{100 * sparse:.0f} % of the cells of {name} are empty: it comes at a rate of its own"
            settings.append(('nan = "merge"', why))
    if clock is not None and not any(line.startswith("nan") for line, _ in settings):
        settings += _uneven(clock)
    guesses = tuple(g for channel in WORDS if (g := _guess(channel, channels, values, asked)) is not None)
    guesses = _signed(log, guesses, time, settings)
    return Survey(channels=tuple(channels), guesses=guesses, time=time, settings=tuple(settings), notes=tuple(notes))


def _seen(name: str, unit: str | None, t: np.ndarray, x: np.ndarray) -> Seen:
    steps = np.diff(t)
    usual = float(np.median(steps))
    gaps = steps[steps > _GAP * usual]
    remarks = []
    if np.ptp(x) == 0:
        remarks.append("constant")
    elif len(x) > 50 and np.mean(np.diff(x) == 0) > 0.5 and len(np.unique(x)) > 8:
        remarks.append(f"{100 * np.mean(np.diff(x) == 0):.0f} % of the samples repeat the one before")
    if unit and not units.known(unit):
        remarks.append(f"the unit {unit!r} is not known")
    if np.any(steps <= 0):
        remarks.append("its time repeats or goes back")
    return Seen(
        name=name,
        unit=unit,
        samples=len(x),
        rate=1 / usual if usual > 0 else 0.0,
        low=float(x.min()) + 0.0,
        high=float(x.max()) + 0.0,
        gaps=len(gaps),
        longest=float(gaps.max(initial=0.0)),
        remarks=tuple(remarks),
    )


# ---- time ----------------------------------------------------------------------------------------------------------


def _clock(log: Recording) -> tuple[Column | None, list[tuple[str, str]], list[str]]:
    """The time column where it must be named or given a unit, the job's entry for it, and notes."""
    for table in log.tables.values():
        names = [_plain(h.name) for h in table.headers]
        known = [i for i, n in enumerate(names) if n in _CLOCK] or [
            i for i, h in enumerate(table.headers) if h.unit == DATE
        ]
        place = known[0] if known else _rising(table)
        if place is None:
            continue
        header = table.headers[place]
        stamps = table.numbers(place) if header.unit != DATE else np.zeros(0)
        steps = np.diff(stamps[np.isfinite(stamps)])
        step = float(np.median(steps)) if len(steps) else 0.0
        _, ends = units.ending(header.name, "time")
        unit = None if header.unit else ends or next((u for u, most in _COUNTS if step < most), "ns")
        unit = "d" if not (header.unit or ends) and in_days(stamps, step) else unit
        if known and unit in (None, "s"):
            return None, [], []
        why = f"its name says {ends}" if ends else f"its steps of {step:.4g} look like {_SPOKEN[unit or 's']}"
        why = why if unit else "it rises from row to row"
        column = Column(header.name, unit)
        entry = f"time = {{ column = {quoted(header.name)}{f', unit = {quoted(unit)}' if unit else ''} }}"
        return column, [(entry, why)], []
    return None, [], ["no column looks like time: give the sample time in s, as dt = 0.01"]


def _uneven(t: np.ndarray) -> list[tuple[str, str]]:
    """The job's entry for a clock whose steps vary by more than readers put up with unasked."""
    steps = np.diff(t)
    usual = float(np.median(steps)) if len(steps) else 0.0
    if not usual > 0 or steps.min() <= 0:
        return []
    varies = float(np.abs(steps[steps < GAP * usual] / usual - 1).max(initial=0.0))
    if varies <= JITTER:
        return []
    why = f"its steps vary by up to {100 * varies:.0f} % of {usual:.3g} s"
    return [(f"jitter = {min(np.ceil(10 * varies + 0.5) / 10, 1.0):g}", why)]


_COUNTS = (("s", 2.0), ("ms", 1e3), ("us", 1e6))  # steps below which stamps count so
_SPOKEN = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds", "d": "days"}


def _rising(table: ChannelTable) -> int | None:
    """The first column that rises evenly."""
    for i in range(len(table.headers)):
        try:
            x = table.numbers(i)
        except SlipangleError:
            continue
        steps = np.diff(x)
        if len(steps) > 2 and np.all(steps > 0) and np.median(np.abs(steps / np.median(steps) - 1)) < 0.2:
            return i
    return None


# ---- which channel is which ----------------------------------------------------------------------------------------


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _guess(channel: str, seen: Sequence[Seen], values: dict[str, np.ndarray], asked: Container[str]) -> Guess | None:
    """The column that is called most like a channel and whose unit does not contradict it, commands last."""
    wanted, never = WORDS[channel]
    ranked = [(word, one) for late in (False, True) for word in wanted for one in seen if (one.name in asked) == late]
    for word, one in ranked:
        bare, ends = units.ending(one.name, QUANTITY[channel])
        name, last = _plain(bare), _plain(re.split(r"[./]", bare)[-1])
        called = word in (name, last) or (len(word) == 2 and name.endswith(word))
        fits = called if len(word) <= 2 else word in f"{name}$"
        if not fits or any(w in f"{name}$" for w in never if w not in word) or "constant" in one.remarks:
            continue
        if word.endswith(("velocityx", "velocityy", "linearx", "lineary")) and any(w in name for w in _EARTH):
            continue
        known = one.unit is not None and units.known(one.unit)
        if known and units.quantity(str(one.unit)) != QUANTITY[channel]:
            continue
        guess = _with_unit(channel, one, known, ends, float(np.quantile(np.abs(values[one.name]), 0.999)))
        late = ("what was asked for, no measurement: take a measured one if there is",) if one.name in asked else ()
        return replace(guess, why=(*guess.why, *late))
    return None


def _with_unit(channel: str, one: Seen, known: bool, ends: str | None, size: float) -> Guess:
    """The guess with the unit that its name ends with, or that its size asks for, where the log says none."""
    why = [f"by its name, from {one.low:.3g} to {one.high:.3g} {one.unit or ''}".rstrip()]
    unit = None
    if not known:
        unit = {
            "delta": "deg" if size > (_TURNS if _BY_HAND.search(_plain(one.name)) else 1.6) else "rad",
            "delta_r": "deg" if size > REAR else "rad",
            "M_z": "N m",
            "r": "deg/s" if size > 3 else "rad/s",
            "v_x": "km/h" if size > 60 else "m/s",
            "v_y": "km/h" if size > 60 else "m/s",
            "a_y": "g" if size < 3 else "m/s2",
        }[channel]
        like = f"a size of {size:.3g} looks like {unit}"
        if not ends:
            why.append(f"the log says no unit; {like}")
        else:
            large = units.to_si(size, ends) > units.to_si(size, unit)  # as that unit has it
            why.append(f"its name says {ends}" + (f", though {like}: check it" if large else ""))
            unit = ends
    ratio = 1.0
    angle = float(units.to_si(size, unit or str(one.unit)))
    if channel == "delta" and angle > _HAND_WHEEL:
        ratio = _RATIO
        why.append(f"{np.degrees(angle):.0f} deg is a hand wheel: put your steering ratio for {ratio:g}")
    return Guess(channel=channel, column=Column(one.name, unit, ratio=ratio), why=tuple(why))


def _signed(
    log: Recording, guesses: tuple[Guess, ...], time: Column | None, settings: Sequence[tuple[str, str]]
) -> tuple[Guess, ...]:
    """The same with the sign turned of what says that the car turns the other way."""
    columns = {g.channel: g.column for g in guesses}
    if not {"delta", "v_x", "r"} <= columns.keys():
        return guesses
    try:
        nan = "merge" if any(line.startswith("nan") for line, _ in settings) else "gap"
        data = log.resample(None, {n: columns[n] for n in columns if n in _TURNING}, time=time, nan=nan, jitter=1.0)
    except SlipangleError:
        return guesses
    signals = {"delta": data["delta"] * data["v_x"], "r": data["r"]}
    signals |= {"a_y": data["a_y"] / np.maximum(data["v_x"], 1.0)} if "a_y" in columns else {}
    wrong = _odd(signals)
    return tuple(
        replace(g, column=replace(g.column, sign=-1), why=(*g.why, wrong[g.channel])) if g.channel in wrong else g
        for g in guesses
    )


def _odd(signals: dict[str, np.ndarray]) -> dict[str, str]:
    """Channels that move against the others of a turning car, with the reason: against r, unless r is alone."""
    moving = {n: x for n, x in signals.items() if np.ptp(x) > 0}
    if "r" not in moving:
        return {}
    agree = {n: float(np.corrcoef(x, moving["r"])[0, 1]) for n, x in moving.items() if n != "r"}
    against = {n: f"r moves against it (agreement {c:.2f}): left is positive for both" for n, c in agree.items()}
    odd = {n: why for n, why in against.items() if agree[n] <= _AGAINST}
    if len(odd) == len(agree) > 1:
        return {"r": f"it moves against {' and '.join(agree)}: left is positive for all"}
    return odd


KNOWN = tuple(n for n in WORDS if n in STANDARD)
"""Channels that are looked for."""
