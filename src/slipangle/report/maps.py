"""Figures seen from above: the track coloured by error, the closed-loop path between lane boundaries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from slipangle.data.dataset import Channel
from slipangle.errors import ParameterError
from slipangle.report import style


@dataclass(frozen=True, kw_only=True)
class Body:
    """Outline of the vehicle seen from above: length ahead and behind of the centre of gravity, width. [m]"""

    front: float = 2.2
    rear: float = 2.2
    width: float = 1.8


def track_map(
    X: np.ndarray,
    Y: np.ndarray,
    value: np.ndarray,
    *,
    channel: Channel,
    label: str = "",
    signed: bool = False,
    starts: Sequence[int] = (0,),
    points: int = 4000,
) -> go.Figure:
    """The driven path seen from above, coloured by a value; axes of equal scale.

    Raises ParameterError if the lengths differ or no value is finite.

    Parameters
    ----------
    X, Y, value : array, shape (n,)
        Position in the ground frame [m], and what to colour by, in the channel's unit; NaN is a thin line only.
    label : str
        Title of the colour bar before the unit; by default the error's absolute value.
    signed : bool
        True colours by the value around zero, false by its absolute value.
    starts, points
        First row of each experiment; at most so many dots, of each stretch the one with the largest value.
    """
    X, Y, value = (np.asarray(a, dtype=float) for a in (X, Y, value))
    style.same_length("X", len(X), Y=Y, value=value)
    if not np.isfinite(value).any():
        raise ParameterError("no value is finite; expected an error per position: simulate the model first")
    shown = value if signed else np.abs(value)
    rows = style.largest(shown, points)
    rows = rows[np.isfinite(shown[rows])]
    reach = float(np.nanmax(np.abs(shown))) or 1.0
    if label:
        title = style.unit_title(label, channel.unit)
    else:
        title = style.axis_title(channel, prefix="error of " if signed else "absolute error of ")
    figure = style.new_figure(540, showlegend=False, hovermode="closest")
    x, y = style.with_gaps(X, Y, starts)
    thinned = np.unique(np.concatenate([style.thin(x, points), style.thin(y, points)]))
    style.line(figure, style.compact(x[thinned]), y[thinned], style.SLATE, 1)
    scale = {
        "colorscale": style.colourscale(style.SIGNED if signed else style.RISING),
        "cmin": -reach if signed else 0.0,
        "cmax": reach,
    }
    hover, scale["colorbar"] = "X %{x:.1f} m, Y %{y:.1f} m<br>%{marker.color:.3g}<extra></extra>", _bar(title)
    style.dots(figure, style.compact(X[rows]), Y[rows], style.compact(shown[rows]), 6, hover=hover, marker=scale)
    _start_arrow(figure, X, Y)
    _equal_axes(figure, float(np.ptp(X)), float(np.ptp(Y)), frame=130)
    # Plotly draws the title of an axis among its labels where a figure has a horizontal colour bar.
    below = {"xref": "paper", "yref": "paper", "x": 0.5, "y": 0.0, "yanchor": "top", "yshift": -24}
    figure.add_annotation(text="X [m]", showarrow=False, font={"size": 13}, **below)
    return figure.update_xaxes(title="")


def _bar(title: str) -> dict[str, object]:
    place = {"orientation": "h", "x": 0, "xanchor": "left", "y": 1.0, "yanchor": "bottom", "xpad": 0, "ypad": 4}
    text = {"title": {"text": title, "side": "top", "font": {"size": 13}}, "tickfont": {"size": 12}}
    return {**place, **text, "len": 0.75, "thickness": 12, "outlinewidth": 0}


def _start_arrow(figure: go.Figure, X: np.ndarray, Y: np.ndarray) -> None:
    away = np.hypot(X - X[0], Y - Y[0])
    size = max(np.ptp(X), np.ptp(Y))
    ahead = int(np.argmax(away > 0.02 * size)) if size > 0 else 0
    if ahead == 0:
        return
    dx, dy = (X[ahead] - X[0]) / away[ahead], (Y[ahead] - Y[0]) / away[ahead]
    tip = {"x": X[0] + 0.05 * size * dx, "y": Y[0] + 0.05 * size * dy, "arrowhead": 2, "arrowwidth": 2.4}
    tail = {"ax": X[0], "ay": Y[0], "axref": "x", "ayref": "y", "arrowcolor": style.INK.light}
    figure.add_annotation(text="", showarrow=True, **tip, **tail)
    figure.add_annotation(x=X[0], y=Y[0], text="start", showarrow=False, xshift=-24 * dy, yshift=24 * dx)


def _equal_axes(figure: go.Figure, width: float, height: float, frame: float) -> go.Figure:
    scale = style.EqualScale(ratio=1.05 * height / max(width, 1e-9), frame=frame)
    size = {"height": scale.height(), "meta": scale.meta}
    return style.axes(figure, "X [m]", "Y [m]", yaxis={"scaleanchor": "x"}, **size)


def path_map(
    X: np.ndarray,
    Y: np.ndarray,
    psi: np.ndarray,
    *,
    reference: np.ndarray | None = None,
    left: np.ndarray | None = None,
    right: np.ndarray | None = None,
    body: Body | None = None,
    outlines: int = 16,
    points: int = 4000,
) -> go.Figure:
    """Closed-loop path between the lane boundaries, with the vehicle's outline along it.

    ``X``, ``Y``, ``psi`` are the path of the centre of gravity and the heading in the ground frame, shape (n,)
    [m, m, rad]; ``reference``, ``left`` and ``right`` the path to follow and the lane boundaries, shape (m, 2), where
    NaN rows are gaps [m]. The outline of the ``body`` is drawn at evenly spaced places, as many as ``outlines``;
    ``points`` is about how many each line keeps.

    Notes
    -----
    A course more than six times as long as wide is drawn with Y stretched, which the axis title says.
    """
    X, Y, psi = (np.asarray(a, dtype=float) for a in (X, Y, psi))
    style.same_length("X", len(X), Y=Y, psi=psi)
    figure = style.new_figure(440, hovermode="closest")
    bounds = [np.asarray(b, dtype=float) for b in (left, right) if b is not None]
    for k, side in enumerate(bounds):
        shared = {"name": "lane boundary", "legendgroup": "lane", "showlegend": k == 0}
        style.line(figure, side[:, 0], side[:, 1], style.VERMILION, 2, **shared)
    if reference is not None:
        reference = np.asarray(reference, dtype=float)
        style.line(figure, reference[:, 0], reference[:, 1], style.SLATE, 2, dash="dash", name="reference")
    if body is not None:
        x, y = _outlines(X, Y, psi, body, outlines)
        style.line(
            figure, style.compact(x), y, style.BLUE, 1, fill="toself", fillcolor=style.BLUE.faded(0.12), name="vehicle"
        )
    rows = np.unique(np.concatenate([style.thin(X, points // 2), style.thin(Y, points // 2)]))
    hover = "X %{x:.1f} m, Y %{y:.2f} m<extra></extra>"
    style.line(figure, style.compact(X[rows]), Y[rows], style.INK, 2, name="centre of gravity", hovertemplate=hover)
    edge = np.vstack([np.column_stack([X, Y]), *bounds, *([] if reference is None else [reference])])
    span = np.nanmax(edge, axis=0) - np.nanmin(edge, axis=0)
    if span[0] > 6 * span[1]:
        reach = np.nanmax(edge, axis=0)[0] + 0.03 * span[0]
        across = {"range": [reach - 1.06 * span[0], reach]}
        return style.axes(figure, "X [m]", "Y [m]<br>(stretched)", xaxis=across)
    return _equal_axes(figure, float(span[0]), float(span[1]), frame=110)


def _outlines(X: np.ndarray, Y: np.ndarray, psi: np.ndarray, body: Body, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the rectangles one after another, NaN between them."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(X), np.diff(Y)))])
    rows = np.unique(np.searchsorted(s, np.linspace(0, s[-1], count)).clip(0, len(X) - 1))
    ahead = np.array([body.front, body.front, -body.rear, -body.rear, body.front, np.nan])
    side = 0.5 * body.width * np.array([1, -1, -1, 1, 1, np.nan])
    c, n = np.cos(psi[rows])[:, None], np.sin(psi[rows])[:, None]
    return (X[rows, None] + c * ahead - n * side).ravel(), (Y[rows, None] + n * ahead + c * side).ravel()
