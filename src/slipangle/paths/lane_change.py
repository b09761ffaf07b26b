"""Paths of lane changes: ISO 3888-1, ISO 3888-2, any sequence."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import interpolate

from slipangle.errors import ParameterError
from slipangle.paths.path import SPACING, Path


class Lane(NamedTuple):
    """A stretch of lane between cones: where it begins and ends [m], its right and left edge [m]."""

    start: float
    stop: float
    right: float
    left: float

    @property
    def middle(self) -> float:
        """Lateral position of the lane's middle. [m]"""
        return 0.5 * (self.right + self.left)


def double_lane_change(
    v_x: float, *, width: float = 1.8, blend: float = 5.0, run_in: float = 30.0, run_out: float = 30.0
) -> Path:
    """Double lane change of ISO 3888-1, to the left and back.

    Sections of 15, 30, 25, 25, 30 m (125 m together); lanes 1.1 w + 0.25, 1.2 w + 0.25, 1.3 w + 0.25 m
    wide for a vehicle of width w; the right edge of the second lane lies 3.5 m left of that of the first,
    the third lane has the first one's right edge. ``X = 0`` at the first cones, ``Y = 0`` in the middle of
    the first lane. The centre line joins the middles of the lanes with quintic polynomials; the standard
    prescribes lanes only, no line.

    Raises ParameterError if a length is negative, the width not positive, or the blends of two changes meet.

    Source: ISO 3888-1:2018, Passenger cars, Test track for a severe lane-change manoeuvre, part 1.

    Parameters
    ----------
    v_x, width : float
        Speed and vehicle width. [m/s, m]
    blend : float
        How far each change of lane reaches into the lanes before and after it: 5 m lowers its curvature
        by 40 % and leaves the middle of the lane by 0.06 m at the last cones. [m]
    run_in, run_out : float
        Straight before the first and after the last cones. [m]

    >>> path = double_lane_change(20.0, width=1.8)
    >>> round(float(path.Y.max()), 3)
    3.59
    """
    widths = 1.1 * width + 0.25, 1.2 * width + 0.25, 1.3 * width + 0.25
    name, lengths = "ISO 3888-1 double lane change", (15.0, 30.0, 25.0, 25.0, 30.0)
    return _lanes(name, lengths, widths, 3.5, width, (blend, run_in, run_out)).with_speed(v_x)


def obstacle_avoidance(
    v_x: float, *, width: float = 1.8, blend: float = 3.0, run_in: float = 30.0, run_out: float = 30.0
) -> Path:
    """Obstacle avoidance of ISO 3888-2, to the left and back.

    Sections of 12, 13.5, 11, 12.5, 12 m (61 m together); lanes 1.1 w + 0.25, w + 1 and 1.3 w + 0.25 m (at
    least 3 m) wide; the second lane begins 1 m left of the first one's left edge; the third has the first
    one's right edge. ``blend``, ``run_in`` and ``run_out`` [m] as in `double_lane_change`.

    Source: ISO 3888-2:2011, Passenger cars, Test track for a severe lane-change manoeuvre, part 2.
    """
    widths = 1.1 * width + 0.25, width + 1.0, max(1.3 * width + 0.25, 3.0)
    name, lengths = "ISO 3888-2 obstacle avoidance", (12.0, 13.5, 11.0, 12.5, 12.0)
    return _lanes(name, lengths, widths, widths[0] + 1.0, width, (blend, run_in, run_out)).with_speed(v_x)


def lane_changes(
    v_x: float,
    *,
    offsets: Sequence[float] = (3.5, 0.0, -3.5, 0.0),
    change: float = 40.0,
    hold: float = 30.0,
    lane: float = 3.5,
) -> Path:
    """A sequence of lane changes: straight for ``hold``, then to each of the lateral ``offsets`` (from 0) in turn. [m]

    Each takes ``change`` along the path; the lane is ``lane`` wide about the centre line; the speed is ``v_x`` [m/s].
    Raises ParameterError if a length is not positive.
    """
    for key, value in {"change": change, "hold": hold, "lane": lane}.items():
        if not value > 0:
            raise ParameterError(f"{key} is {value} m; expected a positive length")
    starts = hold + (change + hold) * np.arange(len(offsets))
    moves = [(a, a + change, y) for a, y in zip(starts, offsets, strict=True)]
    path, _ = _quintic_line(0.0, hold + (change + hold) * len(offsets), 0.0, moves, "lane changes")
    half = np.full_like(path.s, 0.5 * lane)
    return replace(path, right=half, left=half).with_speed(v_x)


def _lanes(
    name: str, lengths: Sequence[float], widths: Sequence[float], shift: float, width: float, ends: tuple[float, ...]
) -> Path:
    """Three lanes and the centre line through them; ``ends`` are blend, run-in and run-out. [m]"""
    blend, run_in, run_out = ends
    if not width > 0 or min(blend, run_in, run_out) < 0 or 2 * blend > min(lengths[2], lengths[0] + run_in):
        raise ParameterError(
            f"width is {width} m, blend {blend} m, run_in {run_in} m, run_out {run_out} m; expected a positive width, "
            f"no negative length and a blend of at most {0.5 * min(lengths[2], lengths[0] + run_in):g} m"
        )
    x = np.concatenate([[0.0], np.cumsum(lengths)])
    base = -0.5 * widths[0]
    places = zip((0, 2, 4), (0.0, shift, 0.0), widths, strict=True)
    lanes = [Lane(x[i], x[i + 1], base + up, base + up + w) for i, up, w in places]
    moves = [(a.stop - blend, b.start + blend, b.middle) for a, b in pairwise(lanes)]
    path, along = _quintic_line(-run_in, x[-1] + run_out, 0.0, moves, name)
    right, left = np.full_like(along, np.inf), np.full_like(along, np.inf)
    for lane in lanes:
        here = (along >= lane.start - 1e-9) & (along <= lane.stop + 1e-9)
        tilt = np.cos(path.psi[here])
        right[here] = (path.Y[here] - lane.right) / tilt
        left[here] = (lane.left - path.Y[here]) / tilt
    return replace(path, right=right, left=left)


def _quintic_line(
    start: float, stop: float, y0: float, moves: Sequence[tuple[float, float, float]], name: str
) -> tuple[Path, np.ndarray]:
    """Line y(x) that holds and moves by quintic polynomials; also x at its samples."""

    def shape(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        y, slope, bend = np.full_like(x, y0), np.zeros_like(x), np.zeros_like(x)
        last = y0
        for a, b, target in moves:
            t, span, rise = np.clip((x - a) / (b - a), 0.0, 1.0), b - a, target - last
            y += rise * t**3 * (10 - 15 * t + 6 * t**2)
            slope += rise / span * 30 * t**2 * (1 - t) ** 2
            bend += rise / span**2 * 60 * t * (1 - t) * (1 - 2 * t)
            last = target
        return y, slope, bend

    fine = np.linspace(start, stop, max(int((stop - start) / 0.02), 2) + 1)
    middle = 0.5 * (fine[1:] + fine[:-1])
    speed, speed_mid = np.hypot(1, shape(fine)[1]), np.hypot(1, shape(middle)[1])
    pieces = np.diff(fine) * (speed[:-1] + 4 * speed_mid + speed[1:]) / 6
    arc = np.concatenate([[0.0], np.cumsum(pieces)])
    s = np.linspace(0.0, arc[-1], max(round(arc[-1] / SPACING), 4) + 1)
    x = np.asarray(interpolate.CubicHermiteSpline(arc, fine, 1 / speed)(s))
    y, slope, bend = shape(x)
    path = Path(s=s, X=x, Y=y, psi=np.arctan(slope), curvature=bend / (1 + slope**2) ** 1.5, name=name)
    return path, x
