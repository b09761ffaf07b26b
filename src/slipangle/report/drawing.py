"""Drawings as plain SVG, which need no script: the closed loop seen from above at true scale."""

from __future__ import annotations

import html

import numpy as np

from slipangle.errors import ParameterError
from slipangle.report.maps import Body
from slipangle.report.style import same_length, thin

_MARGIN = 1.0  # m around what is drawn


def seen_from_above(
    X: np.ndarray,
    Y: np.ndarray,
    psi: np.ndarray,
    *,
    reference: np.ndarray | None = None,
    left: np.ndarray | None = None,
    right: np.ndarray | None = None,
    body: Body | None = None,
    outlines: int = 14,
    label: str = "The driven path seen from above",
    moving: bool = False,
) -> str:
    """The path, the lanes and the car at even distances, one scale for both axes, as SVG; colours are the page's.

    ``X``, ``Y``, ``psi`` have shape (n,) [m, m, rad]; ``reference``, ``left`` and ``right`` shape (m, 2) [m], where NaN
    rows are gaps. ``label`` is what screen readers say. With ``moving`` there is a car and a predicted path that the
    page's script moves, see `slipangle.report.playback.Playback`.

    Raises ParameterError if the lengths differ or nothing is finite.
    """
    X, Y, psi = (np.asarray(a, dtype=float) for a in (X, Y, psi))
    same_length("X", len(X), Y=Y, psi=psi)
    body = Body() if body is None else body
    lines = [(kind, np.asarray(p, dtype=float)) for kind, p in (("lane", left), ("lane", right), ("line", reference))
             if p is not None]  # fmt: skip
    way = np.column_stack([X, Y])
    everything = np.vstack([way, *(p for _, p in lines)])
    if not np.isfinite(way).all() or not len(way):
        raise ParameterError("the path holds no samples or some that are not finite; expected a drive of numbers")
    cars = _cars(way, psi, body, outlines)
    reach = np.vstack([everything - body.width / 2, everything + body.width / 2, *cars])
    low, high = np.nanmin(reach, axis=0) - _MARGIN, np.nanmax(reach, axis=0) + _MARGIN
    rows = np.unique(np.concatenate([thin(X, 600), thin(Y, 600)]))
    drawn = [f'<path class="{kind}" d="{_path(p, low, high)}"/>' for kind, p in lines]
    drawn += [f'<path class="car" d="{_path(o, low, high)}Z"/>' for o in cars]
    drawn.append(f'<path class="way" d="{_path(way[rows], low, high)}"/>')
    if moving:
        outline = np.array([[body.front, 1.0], [body.front, -1.0], [-body.rear, -1.0], [-body.rear, 1.0]])
        outline = outline * [1.0, body.width / 2]
        drawn.insert(len(lines), '<path class="beside"/>')
        drawn.append('<path class="horizon"/>')
        drawn.append(f'<path class="other" d="{_path(outline, np.zeros(2), np.zeros(2))}Z"/>')
        drawn.append(f'<path class="now" d="{_path(outline, np.zeros(2), np.zeros(2))}Z"/>')
    size = high - low
    origin = f' data-x="{low[0]:.3f}" data-y="{high[1]:.3f}"' if moving else ""
    return (
        f'<svg class="drawing" role="img" aria-label="{html.escape(label)}" '
        f'{origin.strip()}{" " if origin else ""}viewBox="0 0 {size[0]:.2f} {size[1]:.2f}">{"".join(drawn)}</svg>'
    )


def _path(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> str:
    """Points as SVG's path, Y upwards; NaN lifts the pen."""
    parts, pen = [], "M"
    for x, y in points:
        if not (np.isfinite(x) and np.isfinite(y)):
            pen = "M"
            continue
        parts.append(f"{pen}{x - low[0]:.2f} {high[1] - y:.2f}")
        pen = "L"
    return "".join(parts)


def _cars(way: np.ndarray, psi: np.ndarray, body: Body, count: int) -> list[np.ndarray]:
    """Corners of the car at even distances along the way, shape (4, 2) each."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    rows = np.unique(np.searchsorted(s, np.linspace(0, s[-1], count)).clip(0, len(way) - 1))
    corners = np.array([[body.front, 1.0], [body.front, -1.0], [-body.rear, -1.0], [-body.rear, 1.0]])
    corners = corners * [1.0, body.width / 2]
    found = []
    for k in rows:
        c, n = np.cos(psi[k]), np.sin(psi[k])
        found.append(way[k] + corners @ np.array([[c, n], [-n, c]]))
    return found
