"""From time stamps to a uniform sample time: gaps, jitter, mixed rates, clocks that jump back; to another rate."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from slipangle.errors import NotFiniteError, SampleTimeError, SlipangleError, TimeError, TooShortError

JITTER, GAP = 0.2, 1.5  # variation of a step, as a share of it, that is put up with unasked; steps of a gap
_DAY, _NIGHT = 86400.0, 600.0  # s of a day, and between two rows at most where times of day begin anew at midnight
_LOST = 2.5  # steps of a gap in which more than one sample was lost
_MOST_LOST = 0.1  # share of steps up to which they are such and not another rate
_FEW = 2  # of five steps in a row: more of them are another rate
_COARSE = 0.1  # of a step: stamps rounded to more than that make uneven steps of even ones
_REPEATED = 0.05  # share of rows that repeat a stamp, from which stamps are too coarse for their rows
_SUSTAINED = 5  # this many steps in a row at another rate are another rate, not gaps


@dataclass(frozen=True, kw_only=True)
class TimeGrid:
    """Uniform instants found in time stamps: sample time [s], rows (start, stop) of each uninterrupted stretch.

    ``start_times`` are those of each stretch's first sample [s]; ``exact`` says whether the stamps lie on the grid (up
    to their own rounding; if not, `onto` interpolates), ``notes`` what was seen in them and done about it.
    """

    dt: float
    pieces: tuple[tuple[int, int], ...]
    start_times: tuple[float, ...]
    exact: bool
    notes: tuple[str, ...] = ()

    def onto(self, t: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]]:
        """Put the rows of ``table``, shape (n, n_channels), stamped ``t`` [s], on the grid.

        Returns
        -------
        values, starts
            The rows of all stretches one after another, shape (m, n_channels), and where each starts.
        """
        starts = [0, *np.cumsum([b - a for a, b in self.pieces[:-1]]).tolist()]
        if self.exact and all(b == a for (_, b), (a, _) in pairwise(self.pieces)):
            return table[self.pieces[0][0] : self.pieces[-1][1]], tuple(starts)
        rows, starts, count = [], [], 0
        for (a, b), t0 in zip(self.pieces, self.start_times, strict=True):
            part = table[a:b]
            if not self.exact:
                n = int((t[b - 1] - t0) / self.dt + 1e-6) + 1
                instants = t0 + self.dt * np.arange(n)
                part = np.column_stack([np.interp(instants, t[a:b], column) for column in part.T])
            rows.append(part)
            starts.append(count)
            count += len(part)
        return rows[0] if len(rows) == 1 else np.vstack(rows), tuple(starts)


def find_grid(
    t: np.ndarray,
    *,
    dt: float | None = None,
    jitter: float = JITTER,
    gap: float = GAP,
    shortest: int = 2,
    row_name: Callable[[int], str] = lambda row: f"sample {row}",
    what: str = "the log",
) -> TimeGrid:
    """Find the uniform grid behind time stamps.

    Parameters
    ----------
    t : array, shape (n,)
        Time stamps. [s]
    dt : float, optional
        Sample time; by default the usual step, rounded where the stamps allow it. Stamps too coarse to rise from row to
        row, as whole seconds at 10 Hz, need it. [s]
    jitter, gap : float
        Largest deviation of one step from ``dt``, as a share of it, that is put back on the grid by linear
        interpolation; a step above ``gap * dt`` ends one stretch and starts the next.
    shortest : int
        Stretches with fewer samples are dropped, and a note says so.
    row_name, what
        Turns a row number into words, such as ``line 12``; the name of the log. For messages.

    Raises
    ------
    NotFiniteError
        If a stamp is NaN or infinite.
    TimeError
        If stamps repeat or go back, if the sample time changes, or if the jitter is too large.
    SampleTimeError
        If ``dt`` is given and the stamps disagree.
    TooShortError
        If no stretch is long enough.

    >>> grid = find_grid(np.array([0.0, 0.1, 0.2, 0.5, 0.6, 0.7]))
    >>> round(grid.dt, 9), grid.pieces
    (0.1, ((0, 3), (3, 6)))
    """
    t = np.asarray(t, dtype=float)
    if len(t) < shortest or len(t) < 2:
        raise TooShortError(
            f"{what} has {len(t)} samples; expected at least {max(shortest, 2)}: record longer or choose another part"
        )
    coarse = _coarse(t, dt, what)
    if coarse is not None:
        return coarse
    steps = _rising_steps(t, row_name, what)
    usual, rounding = _usual(t, steps)
    given, dt = dt, usual if dt is None else dt
    if given is not None and abs(usual / given - 1) > 0.02:
        raise SampleTimeError(
            f"{what} is sampled every {usual:.6g} s, the setting dt says {given:g} s; expected the same: "
            "correct dt, or leave it out and resample after reading"
        )
    _one_rate(t, steps, dt, row_name, what)
    longest = gap * dt + rounding
    spans = _spans(steps, longest)
    pieces = tuple((a, b) for a, b in spans if b - a >= max(shortest, 1))
    if not pieces:
        most = max(b - a for a, b in spans)
        raise TooShortError(
            f"the longest of {len(spans)} uninterrupted stretches of {what} has {most} samples; "
            f"expected at least {shortest}: record without gaps or lower the limit"
        )
    if given is None:
        dt = _rounded(_slope(t, pieces, dt), t, pieces)
    notes = _gap_notes(t, spans, pieces, row_name)
    worst = _off_grid(t, pieces, dt)
    exact = worst <= max(0.02 * dt, 1.01 * (rounding or min(_decimal(t), _COARSE * dt)))
    if not exact:
        notes += _jitter_note(t, steps, dt, jitter, longest, row_name, what)
    elif rounding:
        notes += (
            f"time stamps are rounded to {rounding:.2g} s, steps of {steps.min():.2g} s and up: they lie on an even "
            f"clock of {dt:.4g} s, which is taken",
        )
    return TimeGrid(dt=dt, pieces=pieces, start_times=tuple(float(t[a]) for a, _ in pieces), exact=exact, notes=notes)


def even_clock(t: np.ndarray, first: float, step: float) -> tuple[float, float]:
    """First instant from ``first`` on, and sample time, of the grid that rising stamps lie on. [s]

    Of stamps that lie on none ``first`` itself, and the usual ``step`` at a round rate.

    >>> t = np.arange(4096) / 1024
    >>> begin, dt = even_clock(t, 0.0037, 1 / 1024)
    >>> 1024 * begin, 1 / dt
    (4.0, 1024.0)
    """
    try:
        own = find_grid(t)
    except SlipangleError:  # gaps everywhere, two rates
        own = None
    if own is None or not own.exact:
        return first, 1 / float(f"{1 / step:.3g}")
    at = float(t[np.searchsorted(t, first)])
    return at - own.dt * int((at - first) / own.dt + 1e-6), own.dt


def lost(t: np.ndarray) -> np.ndarray:
    """Rows after which a single sample is missing from stamps of one rate; none where they are too many for that. [s]

    >>> lost(np.array([0.0, 0.1, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3]))
    array([2])
    >>> lost(np.array([0.0, 0.1, 0.3, 0.4]))  # too few to tell what their rate is
    array([], dtype=int64)
    """
    steps = np.diff(t)
    if len(steps) < 5 or not np.isfinite(steps).all() or steps.min() <= 0:
        return np.zeros(0, dtype=int)
    dt, rounding = _usual(t, steps)
    if rounding:
        return np.zeros(0, dtype=int)
    long = steps > GAP * dt
    few = np.convolve(long, np.ones(5), "same")[1:-1] <= _FEW
    single = long[1:-1] & few & (steps[1:-1] < _LOST * dt)
    late = t[3:] - t[:-3] > 3.5 * dt  # not where the next step makes up for it
    rows = np.flatnonzero(single & late) + 1
    return rows if len(rows) <= _MOST_LOST * len(steps) else rows[:0]


def _coarse(t: np.ndarray, dt: float | None, what: str) -> TimeGrid | None:
    """The grid of even rows whose stamps are too coarse to rise from row to row; None of other stamps. [s]

    Raises TimeError without ``dt``, SampleTimeError if rows that far apart leave the stamps.
    """
    steps = np.diff(t)
    if not np.isfinite(t).all() or steps.min() < 0 or not steps.any() or np.mean(steps == 0) < _REPEATED:
        return None
    rises = np.flatnonzero(steps)
    unit, (first, last) = float(np.median(steps[rises])), (int(rises[0]), int(rises[-1]))
    mean = float((t[last] - t[first]) / (last - first) if last > first else np.mean(steps))
    seen = f"the stamps of {what} repeat in {np.sum(steps == 0)} of {len(steps)} rows and are {unit:.4g} s apart"
    if dt is None:
        raise TimeError(
            f"{seen}, too coarse for its rows; expected rising time: if the rows come evenly, give their sample time, "
            f"such as dt={mean:.3g}, else delete those that repeat"
        )
    astray = float(np.ptp(t - dt * np.arange(len(t))))
    if astray > unit + dt:
        raise SampleTimeError(
            f"{seen}, {mean:.6g} s from row to row on average; expected rows every {dt:g} s, as dt says, which strays "
            f"from the stamps by {astray:.3g} s: correct dt, or split the log where rows are missing"
        )
    note = f"time stamps are {unit:.4g} s apart and repeat: the rows are taken to come every {dt:g} s, as dt says"
    return TimeGrid(dt=dt, pieces=((0, len(t)),), start_times=(float(t[0]),), exact=True, notes=(note,))


def _rising_steps(t: np.ndarray, row_name: Callable[[int], str], what: str) -> np.ndarray:
    if not np.isfinite(t).all():
        row = int(np.flatnonzero(~np.isfinite(t))[0])
        raise NotFiniteError(
            f"the time of {what} is {t[row]} at {row_name(row)}; expected a number: delete or repair that row"
        )
    steps = np.diff(t)
    bad = np.flatnonzero(steps <= 0)
    if len(bad):
        row = int(bad[0]) + 1
        verb = "repeats" if t[row] == t[row - 1] else "goes back"
        raise TimeError(
            f"the time of {what} {verb} at {row_name(row)}: {t[row - 1]:.10g} s, then {t[row]:.10g} s"
            f"{f' ({len(bad)} such places)' if len(bad) > 1 else ''}; expected rising time: delete those rows, or read "
            "the parts before and after as two logs"
        )
    return steps


def _one_rate(t: np.ndarray, steps: np.ndarray, dt: float, row_name: Callable[[int], str], what: str) -> None:
    """Raise where the sample time changes for a while (not for single long steps, which are gaps)."""
    if len(steps) < _SUSTAINED:
        return
    odd = np.concatenate([[0], np.cumsum((steps > 1.3 * dt) | (steps < 0.7 * dt))])
    most = np.flatnonzero(odd[_SUSTAINED:] - odd[:-_SUSTAINED] > _SUSTAINED // 2)  # windows whose median can be odd
    windows = np.lib.stride_tricks.sliding_window_view(steps, _SUSTAINED)[most]
    local = np.median(windows, axis=1) if len(most) else np.empty(0)
    steady = np.abs(windows - local[:, None]).max(axis=1, initial=0.0) < 0.2 * local
    other = np.flatnonzero(steady & ((local > 1.3 * dt) | (local < 0.7 * dt)))
    if len(other):
        own, i = float(local[other[0]]), int(most[other[0]])
        place = i if i else int(np.flatnonzero(np.abs(steps / own - 1) > 0.2)[0])
        before, after = (dt, own) if i else (own, dt)
        raise TimeError(
            f"{what} changes its sample time at {row_name(place)} (t = {t[place]:.6g} s) from {before:.4g} to "
            f"{after:.4g} s; expected one sample time: read the parts on their own, resample() them alike and join() "
            "them"
        )


def _slope(t: np.ndarray, pieces: tuple[tuple[int, int], ...], dt: float) -> float:
    """Sample time from the longest stretch, by least squares."""
    a, b = max(pieces, key=lambda p: p[1] - p[0])
    if b - a < 3:
        return dt
    k = np.arange(b - a) - (b - a - 1) / 2
    return float(k @ (t[a:b] - t[a]) / (k @ k))


def _rounded(dt: float, t: np.ndarray, pieces: tuple[tuple[int, int], ...]) -> float:
    """A round sample time or rate if the stamps fit it as well."""
    own = _off_grid(t, pieces, dt)
    for digits in (2, 3, 4, 6):
        allowed = own + (0.1 if digits == 2 else 0.01) * dt
        nice = (float(f"{dt:.{digits - 1}e}"), 1 / float(f"{1 / dt:.{digits - 1}e}"))
        worst, best = min((_off_grid(t, pieces, n), n) for n in nice)
        if worst < allowed:
            return best
    return dt


def _off_grid(t: np.ndarray, pieces: tuple[tuple[int, int], ...], dt: float) -> float:
    """Largest distance of a stamp from its stretch's grid. [s]"""
    return max(float(np.abs(t[a:b] - t[a] - dt * np.arange(b - a)).max()) for a, b in pieces)


def _usual(t: np.ndarray, steps: np.ndarray) -> tuple[float, float]:
    """The usual step, and what the stamps were rounded to if that is much of it, else 0. [s]

    Even steps are then of two sizes, neither of which is theirs: single precision has 0.0078 s at 70000 s.
    """
    dt, rounding = float(np.median(steps)), _single(t, steps)
    single = rounding > _COARSE * dt
    if not single:
        rounding = _decimal(t) if np.mean(steps > GAP * dt) > _MOST_LOST else 0.0
    if not rounding > _COARSE * dt:
        return dt, 0.0
    mean = float(np.mean(steps[np.abs(steps - dt) < 1.5 * rounding]))
    if not single:  # or samples were lost, here and there
        spans = tuple(_spans(steps, GAP * mean + rounding))
        if _off_grid(t, spans, _slope(t, spans, mean)) > 1.01 * rounding:
            return dt, 0.0
    return mean, rounding


def _spans(steps: np.ndarray, longest: float) -> list[tuple[int, int]]:
    """Rows (start, stop) between steps that are longer than this. [s]"""
    return list(pairwise([0, *(np.flatnonzero(steps > longest) + 1).tolist(), len(steps) + 1]))


def _single(t: np.ndarray, steps: np.ndarray) -> float:
    """What numbers of single precision are apart at the largest of the stamps, if they are such; else 0. [s]"""
    with np.errstate(over="ignore", invalid="ignore"):
        single = t.astype("f4")
        apart = float(np.spacing(np.abs(single).max()))
        return apart if steps.min() > 0.8 * apart and np.abs(t - single).max() <= 0.1 * apart else 0.0


def _decimal(t: np.ndarray) -> float:
    """Last decimal place of the stamps; 0 where they have none. [s]"""
    noise = 2 * float(np.spacing(np.abs(t).max()))
    for decimals in range(1, 9):
        if 10.0**-decimals > 10 * noise and np.abs(t - np.round(t, decimals)).max() <= noise:
            return 10.0**-decimals
    return 0.0


def _gap_notes(
    t: np.ndarray, spans: list[tuple[int, int]], pieces: tuple[tuple[int, int], ...], row_name: Callable[[int], str]
) -> tuple[str, ...]:
    notes = []
    if len(spans) > 1:
        gaps = len(spans) - 1
        places = [f"{t[a] - t[a - 1]:.3g} s at {row_name(a)} (t = {t[a - 1]:.6g} s)" for a, _ in spans[1:6]]
        more = f" and {gaps - 5} more" if gaps > 5 else ""
        count = "1 gap splits" if gaps == 1 else f"{gaps} gaps split"
        notes.append(f"{count} the log: " + ", ".join(places) + more)
    dropped = [s for s in spans if s not in pieces]
    if dropped:
        lost = sum(b - a for a, b in dropped)
        notes.append(f"{len(dropped)} stretches too short to use were dropped, {lost} samples in all")
    return tuple(notes)


def _jitter_note(
    t: np.ndarray,
    steps: np.ndarray,
    dt: float,
    jitter: float,
    longest: float,
    row_name: Callable[[int], str],
    what: str,
) -> tuple[str, ...]:
    inside = np.where(steps > longest, dt, steps)
    deviation = np.abs(inside - dt) / dt
    row = int(np.argmax(deviation))
    if deviation[row] > jitter:
        raise TimeError(
            f"{what} mixes sample times: the step after {row_name(row)} (t = {t[row]:.6g} s) is {steps[row]:.4g} s, "
            f"the others {dt:.4g} s; expected steps within {100 * jitter:g} % of each other: allow more with "
            "jitter=, such as jitter=0.5, or repair the clock"
        )
    return (
        f"time steps vary by up to {100 * deviation[row]:.2g} % of {dt:.6g} s: interpolated linearly onto a "
        "uniform grid",
    )


def at_rate(x: np.ndarray, dt: float, new: float, corner: float | None) -> np.ndarray:
    """An uninterrupted record, shape (n, n_channels), at a new sample time, after a zero-phase low-pass. [s, s, Hz]"""
    if corner is not None:
        sos = scipy.signal.butter(4, corner, fs=1 / dt, output="sos")
        x = scipy.signal.sosfiltfilt(sos, x, axis=0, padlen=min(27, len(x) - 1))
    position = np.arange(int((len(x) - 1) * dt / new + 1e-9) + 1) * new / dt
    row = np.rint(position).astype(int)
    if np.abs(position - row).max(initial=0.0) < 1e-6:
        return x[np.minimum(row, len(x) - 1)]
    order = 3 if corner is not None and len(x) > 3 else 1
    return scipy.interpolate.make_interp_spline(np.arange(len(x)), x, k=order, axis=0)(position)


def past_midnight(t: np.ndarray, said: list[str]) -> np.ndarray:
    """Times of day [s] that go on over midnight where all that goes back is by nearly a day; ``said`` gets a note.

    >>> past_midnight(np.array([86399.5, 86399.9, 0.3]), []).tolist()
    [86399.5, 86399.9, 86400.3]
    """
    known = np.flatnonzero(np.isfinite(t))
    steps = np.diff(t[known])
    back = steps < 0
    if not back.any() or t[known].max() >= _DAY or np.any(steps[back] + _DAY > _NIGHT):
        return t
    said.append("the times of day pass midnight and go on from there")
    later = np.array(t)
    later[known[1:]] += _DAY * np.cumsum(back)
    return later
