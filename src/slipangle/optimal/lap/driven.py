"""Driven laps: a log cut at the start line, projected on the track, and held against a fastest lap."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.data.race import with_position
from slipangle.errors import MissingColumnError, ParameterError, TooShortError, shown
from slipangle.optimal.lap.lap import Lap, require_lap_of
from slipangle.paths.path import Path
from slipangle.shown import Shown

_ELSEWHERE = 0.2  # of the places of a log so far off, from which on they are taken to be of another frame
_FAR = 30.0  # m from the track's line, where a log is one of another place
_WIDE, _WIDE_SHARE = 10.0, 0.03  # m, and of a lap, that no car is beside a line without edges as a whole
_RISE = 3.0  # m/s, by which the speed of a car of usual size rises before and after a place that ends a sector
_STEP, _PLACES = 1.0, 400  # m, between the places of a driven lap, and how many there are at least
# Of a speed by places: its noise [-]; time [s], and share of the track, that it is told in.
_ROUGH, _APART, _LOCAL = 0.04, 0.5, 0.06
_EARTH = {"latitude": r"(gps[ _.]?)?lat(itude)?", "longitude": r"(gps[ _.]?)?(lon(g(itude)?)?|lng)"}


@dataclass(frozen=True, kw_only=True, eq=False)
class DrivenLap(Shown):
    """A lap of a log on a track; arrays have shape (n,), one value a metre, or 401 where that is more.

    Parameters
    ----------
    number : int
        Which lap of the log, from 1.
    time, begin : float
        Of the lap, and when it began in the log. [s]
    s, t, n : array
        Arc length of the track's line, time since the start line, offset to the left. [m, s, m]
    v_x : array
        Speed as logged, or where no speed is that of the position, smoothed by as much as it is noisy. [m/s]
    X, Y : array
        Place. [m]
    track : Path
        What was driven on.
    """

    number: int
    time: float
    begin: float
    s: np.ndarray
    t: np.ndarray
    n: np.ndarray
    v_x: np.ndarray
    X: np.ndarray
    Y: np.ndarray
    track: Path

    def _words(self) -> str:
        return f"lap {self.number} of {self.track.name}, {self.time:.3f} s"


@dataclass(frozen=True, kw_only=True)
class Sector:
    """A corner with half of the straights beside it; one that the start line cuts is two sectors.

    Parameters
    ----------
    begin, end, corner : float
        Arc length of the track's line where it begins and ends, and where the fastest lap is slowest. [m]
    lost : float
        Time by which the driven lap is slower here. [s]
    """

    begin: float
    end: float
    corner: float
    lost: float


@dataclass(frozen=True, kw_only=True, eq=False)
class LapDelta(Shown):
    """A driven lap against the fastest one.

    Parameters
    ----------
    lap, driven
        What is compared.
    s, delta : array, shape (n,)
        Arc length of the track's line [m], and by how much the driven lap is behind there. [s]
    sectors : tuple of Sector
        In driving order; what they lose adds up to the whole difference.
    """

    lap: Lap
    driven: DrivenLap
    s: np.ndarray
    delta: np.ndarray
    sectors: tuple[Sector, ...]

    def _words(self) -> str:
        worst = max(self.sectors, key=lambda sector: sector.lost)
        return f"{self.delta[-1]:+.3f} s, most at {worst.corner:.0f} m: {worst.lost:+.3f} s"


def driven_laps(data: Dataset, track: Path, *, origin: tuple[float, float] | None = None) -> tuple[DrivenLap, ...]:
    """The complete laps of a log, cut where the track's line begins, in driving order.

    Parameters
    ----------
    data : Dataset
        With the place as X and Y [m] in the track's frame, or as latitude and longitude [rad], also called lat and lon,
        then in degrees where they have no unit; ``v_x`` [m/s] where it is known.
    track : Path
        Closed; edges say whether laps lie on it.
    origin : (float, float), optional
        Latitude and longitude where the track's X and Y are zero [rad]: places are then those of the log's latitude and
        longitude. By default the track's own `Path.origin`; where it has none, latitude and longitude count from the
        log's first sample, which must then be where the track's frame begins, on the track.

    Raises
    ------
    MissingColumnError
        If the log has no place.
    ParameterError
        If the track is open, the log is further than 30 m from it everywhere, its laps lie beside it as a whole, or
        nothing says where the track's frame lies.
    TooShortError
        If there is no complete lap.
    """
    require_dataset(data, "driven_laps() is given a")
    if not isinstance(track, Path):
        raise ParameterError(f"the track is {shown(track)}; expected a Path: sa.Path.from_file(...)")
    if not track.closed:
        raise ParameterError(f"'{track.name}' is open; expected a closed track to cut laps of")
    data, how = _placed(data, track, origin)
    found, nearest = cut_laps(data, track)
    if nearest > _FAR:
        raise ParameterError(
            f"'{data.name}' comes no nearer than {nearest:.0f} m to '{track.name}', {how}; expected places in the "
            "track's own frame: convert them, or give origin=(lat, lon) [rad] where its X and Y are zero"
        )
    if not found:
        raise TooShortError(
            f"'{data.name}' holds no complete lap of '{track.name}', {how}; expected one: {_instead(data, track)}"
        )
    _refuse_beside(found, data.name, track, how)
    return found


def cut_laps(data: Dataset, track: Path) -> tuple[tuple[DrivenLap, ...], float]:
    """Complete laps of a log whose X and Y [m] are known to be of the track's frame, none or more, in driving order.

    And how near to the track's line it comes. [m]
    """
    found: list[DrivenLap] = []
    nearest = np.inf
    for part, start in zip(data.experiments, data.start_times, strict=True):
        feet = np.asarray(track.project_all(part["X"], part["Y"]))
        nearest = min(nearest, float(np.abs(feet[:, 1]).min()))
        found += _laps_of(part, feet, track, float(start), len(found))
    return tuple(found), nearest


def _placed(data: Dataset, track: Path, origin: tuple[float, float] | None) -> tuple[Dataset, str]:
    """The log with X and Y in the track's frame [m], and in words from where they count; raises as `driven_laps`."""
    data = _on_earth(data)
    angles = "latitude" in data and "longitude" in data
    if origin is not None and not (np.shape(origin) == (2,) and np.isfinite(origin).all()):
        raise ParameterError(f"origin is {origin!r}; expected latitude and longitude of the track's frame [rad]")
    if origin is not None and not angles:
        raise MissingColumnError(
            f"'{data.name}' has no latitude and longitude to count from origin; expected both, or no origin: name its "
            "columns"
        )
    zero = track.origin if origin is None else origin
    if angles and zero is not None:
        return with_position(data, origin=zero), "its places counted from the track's origin"
    if "X" in data and "Y" in data and not (angles and data["X"][0] == data["Y"][0] == 0.0):
        return data, "its places taken from X and Y"
    if not angles:
        raise MissingColumnError(
            f"'{data.name}' has neither X and Y nor latitude and longitude; expected the place of the car: name "
            "its columns"
        )
    s, n, _ = track.project_all(np.zeros(1), np.zeros(1))[0]
    beside, room = _beside(track, s, n)
    if (beside > room).any():
        raise ParameterError(
            f"'{data.name}' has latitude and longitude, and '{track.name}' does not say where its X and Y are zero "
            f"({abs(n):.0f} m beside its line); expected that place: give origin=(lat, lon) [rad], in a job origin of "
            "[lap] [deg]"
        )
    return with_position(data), "its places counted from its own first sample"


def _on_earth(data: Dataset) -> Dataset:
    """The log with its latitude and longitude [rad] under these names; without a unit others are in degrees."""
    for name, words in _EARTH.items():
        found = [channel for channel in data.channels if re.fullmatch(words, channel.name, re.IGNORECASE)]
        if name not in data and len(found) == 1:
            given = data[found[0].name]
            data = data.with_channel(name, given if found[0].unit == "rad" else np.radians(given), "rad")
    return data


def _beside(track: Path, s: Any, n: Any) -> tuple[Any, Any]:
    """How far places are from the track's line, and how far its edge is there, or where none is what no car is. [m]"""
    s, n = np.atleast_1d(s), np.atleast_1d(n)
    lane = track.at(s)
    edge = np.where(n > 0, lane.left, lane.right)
    return np.abs(n), np.where(np.isfinite(edge), edge, min(_WIDE, _WIDE_SHARE * track.length))


def _refuse_beside(found: tuple[DrivenLap, ...], name: str, track: Path, how: str) -> None:
    """Raise ParameterError if more than half of the way of the laps lies beyond the track's edges."""
    s, n = np.concatenate([lap.s for lap in found]), np.concatenate([lap.n for lap in found])
    far, room = _beside(track, s, n)
    if np.median(far - room) > 0:
        raise ParameterError(
            f"the laps of '{name}' lie {np.median(far):.1f} m beside the line of '{track.name}' in the median, beyond "
            f"its edges, {how}; expected places in the track's own frame: convert them, or give origin=(lat, lon) "
            "[rad] where its X and Y are zero"
        )


def _instead(data: Dataset, track: Path) -> str:
    """What to do about a log without a complete lap: most of it may be driven backwards, or lie beside the track."""
    feet = [np.asarray(track.project_all(part["X"], part["Y"])) for part in data.experiments]
    places = [np.unwrap(each[:, 0], period=track.length) for each in feet]
    if sum(float(place[-1] - place[0]) for place in places) < -track.length:
        return "it is driven against the direction of the track: turn the order of the track's points round"
    far = float(np.mean(np.abs(np.concatenate(feet)[:, 1]) > _FAR))
    if far > _ELSEWHERE:
        return f"{far:.0%} of its places are more than {_FAR:g} m from the line: convert them to the track's own frame"
    return "take a longer record"


def _laps_of(part: Dataset, feet: np.ndarray, track: Path, start: float, before: int) -> list[DrivenLap]:
    """The complete laps of one experiment, from its places beside the track; ``before`` were found already."""
    X, Y, t = part["X"], part["Y"], part.dt * np.arange(part.n_samples)
    v_x = part["v_x"] if "v_x" in part else _speed(np.column_stack([X, Y]), part.dt, _LOCAL * track.length)
    beside = np.abs(feet[:, 1]) <= _FAR
    if not beside.any():
        return []
    place = np.where(beside, np.unwrap(feet[:, 0], period=track.length), np.nan)
    columns = np.column_stack([feet[:, 1], v_x, X, Y])
    found = []
    for k in range(int(np.nanmin(place) // track.length), int(np.nanmax(place) // track.length)):
        lap = _cut(place, t, columns, k * track.length, (k + 1) * track.length)
        if lap is not None:
            s, times, rest = lap
            made = {"time": float(times[-1] - times[0]), "begin": start + float(times[0]), "t": times - times[0]}
            named = dict(zip(("n", "v_x", "X", "Y"), rest.T, strict=True))
            found.append(DrivenLap(number=before + len(found) + 1, s=s, **made, **named, track=track))
    return found


def _speed(places: np.ndarray, dt: float, longest: float) -> np.ndarray:
    """Speed of places [m], shape (n, 2), by local parabolas [1]_ over as many samples as their noise asks for. [m/s]

    White noise is what fifth differences hold, 252 times its variance; the speed of a parabola through n samples takes
    12 / n^3 of that. Its way is no longer than ``longest``. [m]

    .. [1] A. Savitzky, M. J. E. Golay, Smoothing and differentiation of data by simplified least squares procedures,
       Analytical Chemistry 36, 1964.
    """
    count, apart = 0, max(round(_APART / dt), 1)
    if len(places) > max(apart, 5):
        noise = np.sqrt(np.mean(np.diff(places, 5, axis=0) ** 2) / 252)
        way = float(np.median(np.hypot(*(places[apart:] - places[:-apart]).T))) / apart  # in a sample
        wanted = np.cbrt(12.0 * (noise / (_ROUGH * max(way, 1e-9))) ** 2)
        count = min(math.ceil(min(wanted, longest / max(way, 1e-9))), len(places)) // 2 * 2 - 1
    if count < 5:
        return np.hypot(*np.gradient(places, dt, axis=0).T)
    return np.hypot(*scipy.signal.savgol_filter(places, count, 2, deriv=1, delta=dt, axis=0).T)


def _cut(
    place: np.ndarray, t: np.ndarray, columns: np.ndarray, begin: float, end: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Arc lengths from zero, times and columns of one lap; None where the log is not beside the track all the way."""
    with np.errstate(invalid="ignore"):
        first, last = int(np.argmax(place >= begin)), int(np.argmax(place >= end))
    if first == 0 or last <= first:
        return None
    rows = slice(first - 1, last + 1)
    here = place[rows]
    if np.isnan(here).any() or here[0] >= begin:
        return None
    forward = np.maximum.accumulate(here)
    keep = np.concatenate([[True], np.diff(forward) > 0])
    at = np.linspace(begin, end, max(round((end - begin) / _STEP), _PLACES) + 1)
    times = np.interp(at, forward[keep], t[rows][keep])
    rest = np.column_stack([np.interp(at, forward[keep], column) for column in columns[rows][keep].T])
    return at - begin, times, rest


def lap_delta(lap: Lap, driven: DrivenLap) -> LapDelta:
    """A driven lap against a fastest lap of the same track; raises ParameterError if the tracks differ."""
    require_lap_of(driven.track, lap, "the fastest lap")
    fastest = np.interp(driven.s, np.append(0.0, lap.s), np.append(0.0, lap.t))
    delta = driven.t - fastest
    v = np.interp(driven.s, lap.s, lap.v_x, period=lap.track.length)
    ends = between_corners(v, _RISE * lap.car.size**0.5)
    places = np.concatenate([[0], ends, [len(v) - 1]])
    sectors = []
    for a, b in pairwise(places):
        slowest, lost = a + int(np.argmin(v[a : b + 1])), float(delta[b] - delta[a])
        begin, end, corner = (float(driven.s[row]) for row in (a, b, slowest))
        sectors.append(Sector(begin=begin, end=end, corner=corner, lost=lost))
    return LapDelta(lap=lap, driven=driven, s=driven.s, delta=delta, sectors=tuple(sectors))


def between_corners(v: np.ndarray, rise: float) -> np.ndarray:
    """Rows of the fastest places between two corners, by a rise of the speed before and after each.

    ``v`` are the speeds of a closed lap at even places, the first again at the end, shape (n,); ``rise`` is in m/s.
    """
    count = len(v) - 1
    around = np.concatenate([v[:-1], v[:-1], v[:-1]])
    peaks, _ = scipy.signal.find_peaks(around, prominence=rise)
    inside = peaks[(peaks >= count) & (peaks < 2 * count)] - count
    return inside[(inside > 0) & (inside < count)]
