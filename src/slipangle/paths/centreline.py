"""Numerics of centre lines: splines over arc length, interpolation between samples, speed under limits."""

import math
import re
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from scipy import interpolate

from slipangle.data.numerals import decoded, is_number, to_number
from slipangle.errors import FormatError, NotFiniteError, ParameterError, TooShortError, shown
from slipangle.files import read_bytes
from slipangle.paths.smooth import smooth_line
from slipangle.paths.track_columns import chosen, in_metres, said_of_columns

MOST_POINTS = 100_000  # of a track's line
_FARTHEST = 1e8  # m, of a coordinate; maps of the whole Earth stay within a tenth of it
_MOST_SAMPLES = 1_000_000  # of a path, 250 km at the usual spacing


def sample_spline(
    x: np.ndarray, y: np.ndarray, *, closed: bool, smoothing: float, spacing: float
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Samples of a spline evenly over arc length, and the arc length at the given points.

    Raises ParameterError if there would be too many samples, or no smooth line goes through the points.
    """
    chord = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    _refuse_long(chord[-1], spacing)
    derivative, chord = _curve(x, y, chord, closed=closed, smoothing=smoothing)
    fine = np.linspace(0.0, chord[-1], max(int(chord[-1] / (0.2 * spacing)), 50 * len(x)) + 1)
    middle = 0.5 * (fine[1:] + fine[:-1])
    speed, speed_mid = (np.hypot(*derivative(u, 1)) for u in (fine, middle))
    pieces = np.diff(fine) * (speed[:-1] + 4 * speed_mid + speed[1:]) / 6
    arc = np.concatenate([[0.0], np.cumsum(pieces)])
    if not (np.isfinite(arc[-1]) and (np.diff(arc) > 0).all() and (speed > 0).all()):
        raise ParameterError(
            "no smooth line goes through the points: it stands still or turns back on itself; expected points in "
            "driving order, each some distance from the next: thin them out, or smooth them"
        )
    _refuse_long(arc[-1], spacing)
    s = np.linspace(0.0, arc[-1], max(round(arc[-1] / spacing), 4) + 1)
    u = np.asarray(interpolate.CubicHermiteSpline(arc, fine, 1 / speed)(s))
    u[0], u[-1] = 0.0, chord[-1]
    px, py = derivative(u, 0)
    dx, dy = derivative(u, 1)
    ddx, ddy = derivative(u, 2)
    samples = {
        "s": s,
        "X": px,
        "Y": py,
        "psi": np.unwrap(np.arctan2(dy, dx)),
        "curvature": (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3,
    }
    return samples, np.interp(chord, fine, arc)


def _curve(
    x: np.ndarray, y: np.ndarray, chord: np.ndarray, *, closed: bool, smoothing: float
) -> tuple[Callable[[np.ndarray, int], np.ndarray], np.ndarray]:
    """Derivatives of some order of a curve, shape (2, n), at values of its parameter; and that of the points."""
    degree: Literal[3, 5] = 5 if len(x) > 5 else 3
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            if smoothing > 0:
                line, u = smooth_line(np.column_stack([x, y]), smoothing, closed=closed)
                return lambda at, order: line(at, nu=order).T, u
            knots, _ = interpolate.splprep([x, y], u=chord, k=degree, s=0.0, per=int(closed), quiet=1)
        except (RuntimeWarning, RuntimeError, ValueError, TypeError, OverflowError):
            raise ParameterError(
                f"no smooth line with a smoothing of {smoothing:g} m was found through {len(x)} points; expected "
                "points in driving order and a smoothing as large as their error: correct them or try another smoothing"
            ) from None
    return lambda at, order: np.asarray(interpolate.splev(at, knots, der=order), dtype=float), chord


def _refuse_long(length: float, spacing: float) -> None:
    if not length / spacing <= _MOST_SAMPLES:
        raise ParameterError(
            f"the line is {length:.3g} m long, {length / spacing:.3g} samples {spacing:g} m apart; expected at most "
            f"{_MOST_SAMPLES}: check the points' unit, metres, and their outliers, or choose a wider spacing"
        )


def hermite(values: np.ndarray, slopes: np.ndarray, i: np.ndarray, t: np.ndarray, h: float) -> np.ndarray:
    """Cubic through values and slopes, at the fraction ``t`` of the interval from sample ``i`` on, length ``h``."""
    a, b, da, db = values[i], values[i + 1], h * slopes[i], h * slopes[i + 1]
    return a + t * (da + t * (3 * (b - a) - 2 * da - db + t * (2 * (a - b) + da + db)))


def edge_between(values: np.ndarray | None, i: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Distance to an edge between samples; beside the end of a marked stretch, the marked one."""
    if values is None:
        return np.full(len(i), np.inf)
    a, b = values[i], values[i + 1]
    both = np.isfinite(a) & np.isfinite(b)
    return np.where(both, (1 - t) * np.where(both, a, 0.0) + t * np.where(both, b, 0.0), np.minimum(a, b))


def limit_rise(
    v: np.ndarray, k: np.ndarray, h: float, a_y: float, a_x: float, passes: int, *, closed: bool
) -> np.ndarray:
    """Speed that rises no faster than the friction ellipse allows."""
    v = v.copy()
    for _ in range(passes):
        if closed:
            v[0] = min(v[0], v[-1])
        for i in range(len(v) - 1):
            used = min(v[i] * v[i] * k[i] / a_y, 1.0)
            free = a_x * math.sqrt(1.0 - used * used)
            v[i + 1] = min(v[i + 1], math.sqrt(v[i] * v[i] + 2 * h * free))
    return v


def read_track(file: str | Path) -> tuple[np.ndarray, tuple[float, float] | None]:
    """Numbers of a track file, shape (n, 2) or (n, 4): x, y and, if there, width to the right and left. [m]

    Where a line heads the columns, they go by their names, in any order, and others are left out (`chosen`), which need
    not be numbers. Between semicolons commas are decimal ones.

    And latitude and longitude of its origin [rad], where its headings say that it has such, see `in_metres`.

    Raises MissingFileError if there is no such file, FormatError if a line does not hold two or four numbers, as many
    as the first, and NotFiniteError if a point has a coordinate that is NaN or infinite.
    """
    source = Path(file)
    raw = read_bytes(source, "the track", "a CSV file: check the path")
    text = decoded(raw, source, "lines of numbers: export the track as CSV")
    rows: list[list[float]] = []
    swapped, columns, kept = False, [], []  # kept: places of a row that must be numbers, x and y first
    for number, line in enumerate(text.splitlines(), start=1):
        content = line.split("#")[0].strip()
        if not rows:
            swapped, said = swapped or _left_first(line), said_of_columns(line)
            columns = said if said and not (line.lstrip().startswith("#") and chosen(said) is None) else columns
            content = "" if said or re.fullmatch(r"[^\d]*[a-z]{2}[^\d]*", content, re.I) else content  # headings
        if not content:
            continue
        try:
            cells = _cells(content)
            kept = kept or (chosen(columns) if len(columns) == len(cells) else None) or list(range(len(cells)))
            row = [to_number(c) if j in kept or is_number(c) else math.nan for j, c in enumerate(cells)]
        except ValueError:
            raise FormatError(
                f"line {number} of '{source.name}' is {shown(content)}; expected numbers x, y, width right, width left"
            ) from None
        if not all(math.isfinite(row[j]) for j in kept[:2] if j < len(row)):
            raise NotFiniteError(f"line {number} of '{source.name}' is {shown(content)}; expected a finite x and y")
        columns = columns if rows or len(columns) == len(row) else []
        if (len(row) not in (2, 4) and not columns) or len(row) != len(rows[0] if rows else row):
            raise FormatError(
                f"line {number} of '{source.name}' has {len(row)} numbers; expected x, y or x, y, width right, "
                "width left on every line"
            )
        rows.append(row)
        if len(rows) > MOST_POINTS:
            raise FormatError(f"'{source.name}' has more than {MOST_POINTS} points; expected at most that: thin it out")
    table = np.array(rows)
    if len(table) < 4:
        raise TooShortError(f"'{source.name}' has {len(table)} points; expected at least 4")
    table, origin = in_metres(table, columns, source.name)
    if (table[:, 2:] < 0).any():
        raise FormatError(
            f"'{source.name}' has a width of {table[:, 2:].min():g} m; expected distances to the right and left edge "
            "from 0 on"
        )
    return (table[:, [0, 1, 3, 2]] if swapped and not columns and table.shape[1] == 4 else table), origin


def _cells(line: str) -> list[str]:
    """What stands between separators; where these are semicolons, commas are decimal ones."""
    return (line.replace(",", ".").replace(";", " ") if ";" in line else line.replace(",", " ")).split()


def _left_first(line: str) -> bool:
    """Whether headings name the width to the left before that to the right."""
    left, right = line.lower().find("left"), line.lower().find("right")
    return 0 <= left < right


def points_of_line(
    X: np.ndarray, Y: np.ndarray, sides: Mapping[str, np.ndarray | float | None], *, closed: bool, name: str
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Points without repeated ones, the first again at the end if closed, and the distances to the edges there. [m]

    Raises TooShortError, NotFiniteError or ParameterError; see `slipangle.paths.path.Path.from_points`.
    """
    x, y = np.asarray(X, dtype=float).ravel(), np.asarray(Y, dtype=float).ravel()
    if x.shape != y.shape:
        raise ParameterError(f"X has {len(x)} points and Y has {len(y)}; expected as many of one as of the other")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise NotFiniteError(f"the points of '{name}' hold NaN or infinite coordinates; expected finite numbers")
    farthest = max(np.abs(x).max(initial=0.0), np.abs(y).max(initial=0.0))
    if farthest > _FARTHEST:
        raise ParameterError(
            f"a point of '{name}' has a coordinate of {farthest:.3g} m; expected at most {_FARTHEST:.0e} m: check "
            "the points' unit and their outliers"
        )
    keep = np.ones(len(x), dtype=bool)
    keep[1:] = np.hypot(np.diff(x), np.diff(y)) > 1e-9
    if closed and len(x) > 1 and math.hypot(x[-1] - x[0], y[-1] - y[0]) <= 1e-9:
        keep[-1] = False
    edges = {
        side: np.broadcast_to(np.asarray(e, dtype=float), x.shape)[keep] for side, e in sides.items() if e is not None
    }
    x, y = x[keep], y[keep]
    if len(x) < 4:
        raise TooShortError(f"'{name}' has {len(x)} different points; expected at least 4: add points")
    if closed:
        x, y = np.append(x, x[0]), np.append(y, y[0])
        edges = {side: np.append(e, e[0]) for side, e in edges.items()}
    return x, y, edges
