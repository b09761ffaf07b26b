"""Reference paths over arc length: from points, from track files, with a speed profile.

A `Path` is a centre line sampled evenly over its arc length ``s``, with heading, curvature and, where
known, a speed profile and the distance from the centre line to the lane's two edges. Lane changes are made
in `slipangle.paths.lane_change`.
"""

# Long: every way to make a path, and every way to look along it, on one record.
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path as FilePath
from typing import Any, Self

import numpy as np

from slipangle.errors import NotFiniteError, ParameterError, TooShortError
from slipangle.paths.centreline import edge_between, hermite, limit_rise, points_of_line, read_track, sample_spline
from slipangle.paths.commonroad import is_commonroad, read_lane
from slipangle.paths.line import Line
from slipangle.paths.preview import Preview, Projection, strides_between
from slipangle.shown import Shown

SPACING = 0.25  # m, between the samples of a centre line
_EDGE_STEP = 2.0  # m, between the points of an edge from which the line between two is found
_FIELDS = ("s", "X", "Y", "psi", "curvature", "v_x", "right", "left")


@dataclass(frozen=True, kw_only=True, eq=False)
class Path(Shown):
    """Centre line over arc length ``s``, evenly spaced from zero [m]; all arrays have shape (n,).

    Raises ParameterError if lengths differ or the arc length is not evenly spaced from zero, TooShortError if there
    are fewer than 2 samples, and NotFiniteError if a value is NaN, or infinite where it must not be.

    Parameters
    ----------
    X, Y, psi, curvature
        Pose [m, m, rad] and curvature [1/m], positive to the left.
    v_x, right, left : optional
        Speed profile [m/s]; distance from the centre line to the lane's edges, infinite where nothing marks them [m].
    closed, name
        Whether the last sample is the first one again; for reports.
    origin : (float, float), optional
        Latitude and longitude where X (east) and Y (north) are zero. [rad]
    """

    s: np.ndarray
    closed: bool = False
    name: str = "path"
    X: np.ndarray
    Y: np.ndarray
    psi: np.ndarray
    curvature: np.ndarray
    v_x: np.ndarray | None = None
    right: np.ndarray | None = None
    left: np.ndarray | None = None
    origin: tuple[float, float] | None = None

    def _words(self) -> str:
        return f"{self.name}, {self.length:.5g} m{', closed' if self.closed else ''}"

    def __post_init__(self) -> None:
        n = len(self.s)
        if n < 2:
            raise TooShortError(f"'{self.name}' has {n} samples; expected at least 2: use Path.from_points")
        for key in _FIELDS:
            given = getattr(self, key)
            if given is None:
                continue
            values = np.array(given, dtype=float)
            if values.shape != (n,):
                raise ParameterError(f"'{self.name}'.{key} has shape {values.shape}; expected ({n},), as s has")
            edge = key in ("right", "left")
            if np.isnan(values).any() or (not edge and np.isinf(values).any()):
                raise NotFiniteError(f"'{self.name}'.{key} holds NaN or infinite values; expected finite numbers")
            if key == "v_x" and (values < 0).any():
                raise ParameterError(f"the speed profile of '{self.name}' falls below zero; expected speeds in m/s")
            values.setflags(write=False)
            object.__setattr__(self, key, values)
        where = self.origin
        if where is not None and not (np.shape(where) == (2,) and np.abs(where[0]) <= np.pi / 2):
            raise ParameterError(f"'{self.name}'.origin is {where!r}; expected latitude and longitude in rad, or none")
        step = np.diff(self.s)
        if self.s[0] != 0 or not np.allclose(step, step[0], rtol=1e-6, atol=0) or step[0] <= 0:
            raise ParameterError(f"'{self.name}'.s must rise evenly from zero: use Path.from_points to sample a line")

    # ---- making paths ------------------------------------------------------------------------------------------

    @classmethod
    def from_points(
        cls,
        X: np.ndarray,
        Y: np.ndarray,
        *,
        closed: bool = False,
        smoothing: float = 0.0,
        right: np.ndarray | float | None = None,
        left: np.ndarray | float | None = None,
        spacing: float = SPACING,
        name: str = "path",
    ) -> Self:
        """Smooth line through points: a quintic spline, so the curvature is smooth too.

        Raises TooShortError if there are fewer than four different points, NotFiniteError if a coordinate is NaN or
        infinite, and ParameterError if the line is too long or too far away to be in metres, or no smooth line goes
        through the points.

        Parameters
        ----------
        X, Y : array, shape (n,)
            The points, in driving order; ``closed`` joins the last to the first (which need not be repeated). [m]
        smoothing : float
            Standard deviation of the points about the true line, along x and along y; 0 goes through every point. How
            much is smoothed out is found from the points, see `slipangle.paths.smooth`. [m]
        right, left : array, shape (n,), or float, optional
            Distance to the lane's edges at each point. [m]
        spacing : float
            Arc length between samples of the result, about. [m]
        """
        x, y, edges = points_of_line(X, Y, {"right": right, "left": left}, closed=closed, name=name)
        if not (0 <= smoothing < math.inf and 0 < spacing < math.inf):
            raise ParameterError(
                f"smoothing is {smoothing} m and spacing {spacing} m; expected at least 0 m and more than 0 m"
            )
        curve, at_points = sample_spline(x, y, closed=closed, smoothing=smoothing, spacing=spacing)
        lane = {side: np.interp(curve["s"], at_points, e) for side, e in edges.items()}
        line: Any = curve
        return cls(**line, right=lane.get("right"), left=lane.get("left"), closed=closed, name=name)

    @classmethod
    def from_edges(
        cls, right: np.ndarray, left: np.ndarray, *, closed: bool = False, smoothing: float = 0.05, name: str = "path"
    ) -> Self:
        """Track between two measured edges: the line halfway from each point of the right edge to the left one.

        The widths are the shortest distances from that line to the edges. Raises as `from_points`.

        Parameters
        ----------
        right, left : array, shape (n, 2), (m, 2)
            Points of the edges, in driving order; their numbers may differ. [m]
        smoothing : float
            Standard deviation of the halfway points about the true line. [m]
        """
        edges = [cls.from_points(*np.asarray(e, dtype=float).T, closed=closed, name=name) for e in (right, left)]
        count = max(round(edges[0].length / _EDGE_STEP), 8)
        begun = edges[0].at(np.linspace(0.0, edges[0].length, count + (not closed), endpoint=not closed))
        foot = edges[1].at(edges[1].project_all(begun.X, begun.Y)[:, 0])
        X, Y = 0.5 * (begun.X + foot.X), 0.5 * (begun.Y + foot.Y)
        line = cls.from_points(X, Y, closed=closed, smoothing=smoothing, name=name)
        wide = [np.abs(edge.project_all(line.X, line.Y)[:, 1]) for edge in edges]
        return replace(line, right=wide[0], left=wide[1])

    @classmethod
    def from_file(
        cls,
        file: str | FilePath,
        *,
        closed: bool | None = None,
        smoothing: float = 0.0,
        spacing: float = SPACING,
        lanelets: Sequence[int] = (),
    ) -> Self:
        """Track of a file, known by its content: a CommonRoad scenario, or text as of `from_csv` (TUM's race tracks).

        Of a scenario the lane that ``lanelets`` name, see `slipangle.paths.commonroad.read_lane`.

        Raises MissingFileError, FormatError or ParameterError as these two.
        """
        try:
            with FilePath(file).open("rb") as opened:
                scenario = is_commonroad(opened.read(4096))
        except OSError:
            scenario = False  # said below
        if not scenario:
            if lanelets:
                raise ParameterError(
                    f"lanelets are those of a CommonRoad scenario, and '{file}' is none: leave them out"
                )
            return cls.from_csv(file, closed=closed, smoothing=smoothing, spacing=spacing)
        lane = read_lane(file, lanelets)
        whole = lane.closed if closed is None else closed
        how: Any = {"closed": whole, "smoothing": smoothing, "spacing": spacing, "name": FilePath(file).stem}
        return cls.from_points(lane.X, lane.Y, right=lane.half, left=lane.half, **how)

    @classmethod
    def from_csv(
        cls, file: str | FilePath, *, closed: bool | None = None, smoothing: float = 0.0, spacing: float = SPACING
    ) -> Self:
        """Track from a text file with columns x, y and, if known, width to the right and to the left. [m]

        Lines that start with ``#`` are comments; headings, in one or above the numbers, say whether the left width
        comes first, units other than metres, such as ``x_cm``, and places by ``lat, lon``, whose path has an `origin`.
        Whether the track is closed is seen from the distance between its ends unless said.

        Raises MissingFileError if there is no such file and FormatError if a line does not hold two or four numbers.
        """
        table, origin = read_track(file)
        if closed is None:
            with np.errstate(over="ignore", invalid="ignore"):  # what is that far away is refused below
                gaps = np.hypot(*np.diff(table[:, :2], axis=0).T)
                closed = bool(np.hypot(*(table[-1, :2] - table[0, :2])) < 3 * np.median(gaps))
        widths = {"right": table[:, 2], "left": table[:, 3]} if table.shape[1] == 4 else {}
        X, Y, stem = table[:, 0], table[:, 1], FilePath(file).stem
        line = cls.from_points(X, Y, closed=closed, smoothing=smoothing, spacing=spacing, name=stem, **widths)
        return line if origin is None else replace(line, origin=origin)

    def with_speed(self, v_x: float | np.ndarray) -> Self:
        """The path at a constant speed or with the given profile, shape (n,). [m/s]

        Raises ParameterError if the profile has another length than `s`.
        """
        v = np.asarray(v_x, dtype=float)
        if v.shape not in ((), (1,), self.s.shape):
            raise ParameterError(
                f"the speed profile has shape {v.shape}; expected {self.s.shape}, a speed at each place of s: or give "
                "one for all"
            )
        return replace(self, v_x=np.broadcast_to(v, self.s.shape))

    def with_speed_limits(self, *, v_max: float, a_y: float, a_x: float, a_brake: float | None = None) -> Self:
        """The path with the fastest speed profile that keeps to acceleration limits, all positive. [m/s, m/s2]

        Curvature bounds the speed by ``a_y``; what the curve leaves of the friction ellipse is there for
        speeding up (``a_x``) and slowing down (``a_brake``, by default ``a_x``); no speed is above ``v_max``. Raises
        ParameterError if one is not positive.
        """
        brake = a_x if a_brake is None else a_brake
        for key, value in {"v_max": v_max, "a_y": a_y, "a_x": a_x, "a_brake": brake}.items():
            if not value > 0:
                raise ParameterError(f"{key} is {value}; expected a positive number")
        k = np.abs(self.curvature)
        v = np.minimum(v_max, np.sqrt(a_y / np.maximum(k, 1e-12)))
        passes = 2 if self.closed else 1  # the second lap starts from the speed at which the first one ends
        v = limit_rise(v, k, self.spacing, a_y, a_x, passes, closed=self.closed)
        v = limit_rise(v[::-1], k[::-1], self.spacing, a_y, brake, passes, closed=self.closed)[::-1]
        return replace(self, v_x=v)

    def __getstate__(self) -> dict[str, Any]:
        """What a copy needs, in this process or another: nothing compiled."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @cached_property
    def line(self) -> Line | None:
        """The samples in compiled C; None without a compiler: then NumPy does the same, slower."""
        if self.spacing * 1e9 < self.length or not np.isfinite(self.psi).all():
            return None
        free = np.full_like(self.s, np.inf)
        speed = np.full_like(self.s, np.nan) if self.v_x is None else self.v_x
        lane = (free if edge is None else edge for edge in (self.right, self.left))
        columns = (self.X, self.Y, self.psi, self.curvature, speed, *lane)
        return Line.of(columns, closed=self.closed, spacing=self.spacing, length=self.length)

    # ---- looking -----------------------------------------------------------------------------------------------

    @property
    def length(self) -> float:
        """Arc length of the path, of one lap if closed. [m]"""
        return float(self.s[-1])

    @property
    def spacing(self) -> float:
        """Arc length between samples. [m]"""
        return float(self.s[1])

    @property
    def start(self) -> tuple[float, float, float]:
        """X [m], Y [m], psi [rad] where the path begins."""
        return float(self.X[0]), float(self.Y[0]), float(self.psi[0])

    def at(self, s: np.ndarray | float) -> Preview:
        """The path at arc lengths ``s``, shape (n,); an open path goes straight on beyond its ends."""
        s = np.atleast_1d(np.asarray(s, dtype=float))
        if self.line is not None and s.ndim == 1:
            return Preview.of(s, self.line.at(s))
        turns = np.floor(s / self.length) if self.closed else np.zeros_like(s)
        inside = s - turns * self.length if self.closed else np.clip(s, 0.0, self.length)
        beyond = np.zeros_like(s) if self.closed else s - inside
        h = self.spacing
        i = np.minimum((inside / h).astype(int), len(self.s) - 2)
        t = inside / h - i
        psi = hermite(self.psi, self.curvature, i, t, h) + turns * (self.psi[-1] - self.psi[0])
        x = hermite(self.X, np.cos(self.psi), i, t, h) + beyond * np.cos(psi)
        y = hermite(self.Y, np.sin(self.psi), i, t, h) + beyond * np.sin(psi)
        k = np.where(beyond == 0, (1 - t) * self.curvature[i] + t * self.curvature[i + 1], 0.0)
        v = np.full_like(s, np.nan) if self.v_x is None else (1 - t) * self.v_x[i] + t * self.v_x[i + 1]
        lane = {"right": edge_between(self.right, i, t), "left": edge_between(self.left, i, t)}
        return Preview(s=s, X=x, Y=y, psi=psi, curvature=k, v_x=v, **lane)

    def ahead(
        self, s: float, steps: int | Sequence[float] | np.ndarray, dt: float = math.nan, *, v_x: float | None = None
    ) -> Preview:
        """The path at some instants, such as a controller's `times`, or now, now + dt, ..., now + steps dt.

        Raises ParameterError if there is no speed profile and no speed is given, or the instants do not rise from 0.

        Parameters
        ----------
        s : float
            Arc length now. [m]
        steps : int or array, shape (n,)
            How many steps to look ahead, which gives ``steps + 1`` rows; or the instants themselves, rising from 0. [s]
        dt : float
            Time between instants, with a number of steps. [s]
        v_x : float, optional
            Measured speed now: the preview starts at it and keeps its distance to the profile. By default
            the profile itself. [m/s]
        """
        if isinstance(steps, int | np.integer) and dt > 0:
            times, strides = dt * np.arange(steps + 1), [(1, dt)] * int(steps)
        else:
            times = np.asarray(steps, dtype=float)
            strides = strides_between(times.tobytes())
        if self.v_x is None and v_x is None:
            raise ParameterError(
                f"'{self.name}' has no speed profile; expected one to look ahead in time: use path.with_speed(20.0), "
                "or give the measured v_x"
            )
        if self.line is not None:
            constant = self.v_x is None
            off = v_x if constant or v_x is None else v_x - self.speed(s)
            rows = self.line.ahead(s, strides, 0.0 if off is None else off, constant=constant)
            return Preview.of(rows[0], rows[1:], times)
        places, speeds = np.empty(len(times)), np.empty(len(times))
        offset = 0.0 if v_x is None or self.v_x is None else v_x - self.speed(s)

        def speed(place: float) -> float:
            return max(self.speed(place) + offset, 0.0) if self.v_x is not None or v_x is None else v_x

        for k, (count, h) in enumerate(strides):
            places[k], speeds[k] = s, speed(s)
            for _ in range(count):
                s += h * speed(s + 0.5 * h * speed(s))
        places[-1], speeds[-1] = s, speed(s)
        return replace(self.at(places), v_x=speeds, t=times)

    def speed(self, s: float) -> float:
        """Speed of the profile at one arc length [m/s]; NaN without a profile."""
        if self.v_x is None:
            return math.nan
        profile, length, spacing = self._profile
        place = s % length if self.closed else min(max(s, 0.0), length)
        position = place / spacing
        i = min(int(position), len(profile) - 2)
        return profile[i] + (position - i) * (profile[i + 1] - profile[i])

    @cached_property
    def _profile(self) -> tuple[list[float], float, float]:
        """Speeds [m/s], length and spacing [m] as plain numbers, which are quick to take one of."""
        return [] if self.v_x is None else self.v_x.tolist(), self.length, self.spacing

    def project(self, X: float, Y: float, near_s: float | None = None, *, window: float = 15.0) -> Projection:
        """Foot of a point [m] on the path.

        ``near_s`` is where the foot was a moment ago: the search stays within ``window`` of it, so a path that crosses
        itself is followed in order and laps add up. By default the nearest of all. [m]

        Raises NotFiniteError if the point is not finite.
        """
        if not (math.isfinite(X) and math.isfinite(Y)):
            raise NotFiniteError(f"the point to project is ({X}, {Y}); expected finite coordinates")
        found = None if self.line is None else self.line.foot(X, Y, near_s, window)
        if found is not None:
            return Projection(*found)
        h, n = self.spacing, len(self.s)
        if near_s is None:
            s = h * int(np.argmin((self.X - X) ** 2 + (self.Y - Y) ** 2))
        else:
            rows = np.arange(math.floor((near_s - window) / h), math.ceil((near_s + window) / h) + 1)
            if not self.closed:
                rows = np.clip(rows, 0, n - 1)
            index = rows % (n - 1) if self.closed else rows
            s = h * float(rows[np.argmin((self.X[index] - X) ** 2 + (self.Y[index] - Y) ** 2)])
        for _ in range(8):
            p = self.at(s)
            dx, dy, psi = X - p.X[0], Y - p.Y[0], float(p.psi[0])
            along = dx * math.cos(psi) + dy * math.sin(psi)
            e_y = dy * math.cos(psi) - dx * math.sin(psi)
            move = along / max(1.0 - p.curvature[0] * e_y, 0.3)
            s += min(max(move, -2 * h), 2 * h) if self.closed or 0 < s < self.length else move
            if abs(move) < 1e-10:
                break
        p = self.at(s)
        psi = float(p.psi[0])
        return Projection(s, float((Y - p.Y[0]) * math.cos(psi) - (X - p.X[0]) * math.sin(psi)), psi)

    def project_all(self, X: np.ndarray, Y: np.ndarray, near_s: float | None = None) -> np.ndarray:
        """`project` of consecutive points of a drive, shape (n, 3): s [m], e_y [m], psi [rad]."""
        X, Y = np.asarray(X, float), np.asarray(Y, float)
        good = np.isfinite(X).all() and np.isfinite(Y).all() and X.shape == Y.shape == (len(X),)
        if self.line is not None and good and (near_s is None or abs(near_s) < 1e9):
            return self.line.feet(X, Y, near_s, 15.0)
        out = np.empty((len(X), 3))
        for k, (x, y) in enumerate(zip(X, Y, strict=True)):
            out[k] = foot = self.project(float(x), float(y), near_s)
            near_s = foot.s
        return out

    def inside(
        self,
        X: np.ndarray,
        Y: np.ndarray,
        width: float,
        *,
        psi: np.ndarray | None = None,
        front: float = 0.0,
        rear: float = 0.0,
    ) -> np.ndarray:
        """Which of consecutive poses, shape (n,), keep the vehicle between the edges of the lane, if they are marked.

        With the heading ``psi`` [rad] all four corners are checked, ``front`` and ``rear`` being their distance from
        the centre of gravity, without it the width at the centre. [m]
        """
        x, y = np.atleast_1d(np.asarray(X, float)), np.atleast_1d(np.asarray(Y, float))
        if psi is None:
            return self._between(x, y, 0.5 * width, 0.5 * width)
        c, d = np.cos(np.asarray(psi, float)), np.sin(np.asarray(psi, float))
        good = np.ones(len(x), dtype=bool)
        for a in (front, -rear):
            for b in (0.5 * width, -0.5 * width):
                good &= self._between(x + a * c - b * d, y + a * d + b * c, 0.0, 0.0)
        return good

    def _between(self, x: np.ndarray, y: np.ndarray, to_right: float, to_left: float) -> np.ndarray:
        feet = self.project_all(x, y)
        lane = self.at(feet[:, 0])
        return (feet[:, 1] + to_left <= lane.left) & (feet[:, 1] - to_right >= -lane.right)

    def boundaries(self) -> tuple[np.ndarray, np.ndarray]:
        """Right and left edge of the lane, shape (n, 2) each [m]; NaN where nothing marks them."""
        sides = []
        for edge, sign in ((self.right, -1.0), (self.left, 1.0)):
            d = np.full_like(self.s, np.inf) if edge is None else edge
            d = np.where(np.isfinite(d), sign * d, np.nan)
            sides.append(np.column_stack([self.X - d * np.sin(self.psi), self.Y + d * np.cos(self.psi)]))
        return sides[0], sides[1]
