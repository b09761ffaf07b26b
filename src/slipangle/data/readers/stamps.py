"""The time column of a log: which one it is, and what its numbers count."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from slipangle import units
from slipangle.data.channels import STANDARD
from slipangle.data.clock import GAP, past_midnight
from slipangle.data.readers.column import Column
from slipangle.data.readers.tables import DATE, ChannelTable, Header, find_column
from slipangle.errors import TimeError

TIME_NAMES = ("t", "time", "timestamp", "timestamps", "zeit", "tempo", "tiempo", "temps", "stamp")
STEPS = ("interval", "utc", "elapsed")  # these only with a unit of time: others call a step or a place so
_EPOCH = 1e7  # larger first stamps count from the log's start [s]
_SLOW, _SLOW_DRIVE = 2.0, 1.0  # steps from here on are said, where no unit is named, of any log and of a drive [s]
_TOO_SLOW, _HOURS = 5.0, 1e4  # and refused in a log of a drive, if they are whole numbers, and in any log [s]
_DAYS = ((5e5, 1e6), (2.5e4, 7.5e4))  # between which stamps count days: since the year 0, or since 1900
_DAY_STEP = 1e-4  # and rise by less
_FEWEST = 3  # stamps from which hours, minutes and seconds in one number are told
_TOO_FAST = 1e-5  # steps below are no seconds in a log of a drive [s]


def time_of(
    table: ChannelTable, time: Column | str | None, dt: float | None, names: Iterable[str], epoch: bool, said: list[str]
) -> tuple[np.ndarray | None, int | None]:
    """Time stamps [s] of channels of these names, and the position of their column; ``said`` gets what is assumed.

    ``epoch`` keeps stamps that count from 1970. Raises TimeError, UnitError or MissingColumnError as `assemble`.
    """
    column = Column(time) if isinstance(time, str) else time
    if column is None:
        matches = [i for i, h in enumerate(table.headers) if h.name.lower() in TIME_NAMES]
        matches = matches or [i for i, h in enumerate(table.headers) if is_time(h.name)]
        matches = matches or [i for i, h in enumerate(table.headers) if h.name.lower() in STEPS and _counts_time(h)]
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
    named = column.unit or header.unit or column.ending(header.name, "time")
    unit = "s" if (dated := header.unit == DATE) else named or "s"
    t = column.converted(table.numbers(i), unit, "s", what)
    digits = None if named else of_digits(t)
    if digits is not None:
        first = t[np.isfinite(t)][0]
        said.append(f"{what} is read as hours, minutes and seconds in one number: {first:.2f} is {_as_clock(first)}")
        t = digits
    elif not (named or dt):
        said += _plausible_seconds(t, header, what, driven=any(n in STANDARD and n != "t" for n in names))
    t = past_midnight(t, said) if dated or digits is not None else t
    if not epoch and len(t) and _EPOCH < t[0] < np.inf:
        said.append(f"time counts from {t[0]:.9g} s, the first stamp")
        t = t - t[0]
    return t, i


def is_time(name: str) -> bool:
    """Whether a column is known as time by its name, which may end with the unit.

    >>> is_time("Time"), is_time("timestamp_us"), is_time("lap_time_ms"), is_time("tms")
    (True, True, False, False)
    """
    return name.lower() in TIME_NAMES or units.ending(name, "time")[0].lower() in TIME_NAMES


def of_digits(t: np.ndarray) -> np.ndarray | None:
    """Seconds of the day of numbers hhmmss.ss, as receivers of satellites write it; None of stamps that are no such.

    They leap by 40 from minute to minute, where the time that they say goes on evenly.

    >>> of_digits(np.array([105959.8, 105959.9, 110000.0, 110000.1])).round(2).tolist()
    [39599.8, 39599.9, 39600.0, 39600.1]
    >>> of_digits(np.array([58.0, 59.0, 60.0, 61.0])) is of_digits(np.array([58.0, 59.0])) is None
    True
    """
    known = np.isfinite(t)
    hours, minutes, seconds = _parted(t)
    if known.sum() < _FEWEST or not (
        t[known].min() >= 0 and hours[known].max() < 24 and minutes[known].max() < 60 and seconds[known].max() <= 60
    ):
        return None
    clock = seconds_of(t)
    own, leaps = np.diff(clock[known]), np.diff(t[known] - clock[known]) > 39
    return clock if np.any(leaps & (own > 0) & (own < GAP * np.median(own))) else None


def seconds_of(digits: np.ndarray) -> np.ndarray:
    """Seconds of the day of numbers hhmmss.ss. [s]

    >>> seconds_of(np.array([105959.5, 12.0])).tolist()
    [39599.5, 12.0]
    """
    hours, minutes, seconds = _parted(digits)
    return 3600 * hours + 60 * minutes + seconds


def _parted(digits: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    hours, rest = np.divmod(np.where(np.isfinite(digits), digits, np.nan), 1e4)
    return hours, *np.divmod(rest, 100.0)


def _as_clock(digits: float) -> str:
    text = f"{digits:09.2f}"
    return f"{text[:2]}:{text[2:4]}:{text[4:]}"


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
