"""A track as the program sees it: intervals over arc length with two collocation points each, curvature and edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slipangle.errors import ParameterError
from slipangle.paths.path import Path

INNERMOST = 0.9  # of the radius of the track's line, beyond which arc lengths across it meet
_WIDEST = 0.25  # of its length: a closed track as wide as this has hardly a middle; in cm all are wider
_BESIDE = 0.1  # of its width, by which a track's line may lie beside it: one farther off is one of signed widths
_UNSEEN = 0.03  # of the track's mean width, up to which an edge may come in between two points


@dataclass(frozen=True, kw_only=True, eq=False)
class Course:
    """Points of the program, two to an interval, at a third and at the end; arrays have shape (n,).

    Parameters
    ----------
    ends : array, shape (n / 2 + 1,)
        Where intervals begin and end. [m]
    s, X, Y, psi, curvature
        Points of the track's line; its curvature is the mean around each. [m, m, m, rad, 1/m]
    low, high
        Bounds of the offset of the car's centre, positive to the left. [m]
    closed : bool
        Whether the last point is where the first interval begins.
    """

    ends: np.ndarray
    s: np.ndarray
    X: np.ndarray
    Y: np.ndarray
    psi: np.ndarray
    curvature: np.ndarray
    low: np.ndarray
    high: np.ndarray
    closed: bool

    @property
    def step(self) -> np.ndarray:
        """From each point to the next; of a closed course the last one to the first. [m]"""
        step = np.diff(self.s)
        return np.append(step, self.ends[-1] - self.s[-1] + self.s[0]) if self.closed else step


def course(track: Path, ends: np.ndarray, *, room: float, tolerance: float | None) -> Course:
    """The points of a track; raises ParameterError where the car does not fit between its edges.

    Parameters
    ----------
    ends : array, shape (n / 2 + 1,)
        Where intervals begin and end, from zero to the track's length. [m]
    room : float
        Between the car's centre and an edge, at least. [m]
    tolerance : float, optional
        Largest distance from the track's line, instead of its edges. [m]
    """
    h = np.diff(ends)
    s = np.ravel(np.column_stack([ends[:-1] + h / 3, ends[1:]]))
    at = track.at(s)
    if tolerance is not None:
        high, low = np.full_like(s, tolerance), np.full_like(s, -tolerance)
    else:
        high, low = at.left - room, room - at.right
    if track.left is None or track.right is None or not np.isfinite(low + high).all():
        if tolerance is None:
            raise ParameterError(
                f"'{track.name}' has no edges everywhere; expected widths to the right and left to find a line "
                'between: read a track with widths, or drive its own line with line="given"'
            )
    if tolerance is None:
        width = float(np.mean(at.left + at.right))
        _require_distances(track, width)
        fine, enough = track.at(track.s), _UNSEEN * width
        high, low = (
            side * _kept_between(track, s, side * own, side * edge - room, enough)
            for side, own, edge in ((1.0, high, fine.left), (-1.0, low, -fine.right))
        )
    window = np.repeat(h / 2, 2)
    ahead, back = track.at(s + 0.5 * window).psi, track.at(s - 0.5 * window).psi
    curvature = _turned(ahead - back) / window
    bend = np.maximum(np.abs(curvature), 1e-9)
    high = np.where(curvature > 0, np.minimum(high, INNERMOST / bend), high)
    low = np.where(curvature < 0, np.maximum(low, -INNERMOST / bend), low)
    narrow = int(np.argmin(high - low))
    if not high[narrow] - low[narrow] > 0:
        raise ParameterError(
            f"'{track.name}' is {high[narrow] - low[narrow] + 2 * room:.3g} m wide {s[narrow]:.0f} m after its start, "
            f"the car needs {2 * room:.3g} m; expected a wider track: check the widths, the car's width and the margin"
        )
    return Course(
        ends=ends, s=s, X=at.X, Y=at.Y, psi=at.psi, curvature=curvature, low=low, high=high, closed=track.closed
    )


def _require_distances(track: Path, width: float) -> None:
    """Raise if a track is ``width`` [m] wide as no track of its length is, but one in another unit or sign."""
    for side, distances in (("right", track.right), ("left", track.left)):
        found = float(np.median(np.asarray(distances)))
        if found < -_BESIDE * abs(width):
            raise ParameterError(
                f"'{track.name}' has its {side} edge at {found:.3g} m; expected distances from its line, positive to "
                f"either side: give {side}=-{side}"
            )
    most = _WIDEST * track.length if track.closed else track.length
    if width > most:
        raise ParameterError(
            f"'{track.name}' is {width:.0f} m wide and {track.length:.0f} m long; expected widths in m, below "
            f"{most:.3g} m: check the unit: 500 cm are 5 m"
        )


def _kept_between(track: Path, s: np.ndarray, room: np.ndarray, edge: np.ndarray, enough: float) -> np.ndarray:
    """Room to a side at the points; where the edge at the track's samples comes in between two, the least there.

    So it does in a gate and where a width leaps. What is no more than ``enough`` counts as nothing.
    """
    missed = np.interp(track.s, s, room, period=track.length if track.closed else None) - edge
    worst, least = np.zeros(len(s) + 1), np.full(len(s) + 1, np.inf)  # before each point, and after the last one
    between = np.searchsorted(s, track.s)
    np.maximum.at(worst, between, missed)
    np.minimum.at(least, between, edge)
    if track.closed:
        worst[[0, -1]], least[[0, -1]] = worst[[0, -1]].max(), least[[0, -1]].min()
    least[worst <= enough] = np.inf
    return np.minimum(room, np.minimum(least[:-1], least[1:]))


def _turned(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def spread(s: np.ndarray, v: np.ndarray, length: float, intervals: int, even: float = 0.5) -> np.ndarray:
    """Ends of intervals that are short where the car is slow: between even in time and, by a share, in length. [m]"""
    grid = np.append(s, length) if s[0] == 0 else np.concatenate([[0.0], s])
    pace = np.interp(0.5 * (grid[1:] + grid[:-1]), s, 1.0 / v, period=length)
    density = (1 - even) * pace / np.average(pace, weights=np.diff(grid)) + even
    total = np.concatenate([[0.0], np.cumsum(density * np.diff(grid))])
    ends = np.interp(np.linspace(0.0, total[-1], intervals + 1), total, grid)
    ends[0], ends[-1] = 0.0, length
    return ends
