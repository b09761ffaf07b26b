"""Figures and tables of steady cornering and of the phase plane: how a car goes over its limit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from slipangle.models.analysis.diagram import HandlingDiagram
from slipangle.models.analysis.phase_plane import PhasePlane
from slipangle.report.style import GREEN, SLATE, VERMILION, axes, dots, escape, line, new_figure, series_style
from slipangle.report.tables import Heading, Row, Table

_DEG = 180 / np.pi
_MARKS = {"stable": (GREEN, "circle"), "saddle": (VERMILION, "x"), "unstable": (VERMILION, "circle-open")}


# ---- handling diagram ----------------------------------------------------------------------------------------------


def diagram_figure(several: Sequence[HandlingDiagram]) -> go.Figure:
    """Understeer angle over lateral acceleration, with bands; the unstable part dotted, the limit dashed."""
    figure = new_figure(420, hovermode="closest")
    for index, one in enumerate(several):
        colour, _ = series_style(index)
        name = escape(f"{one.name}, {3.6 * one.v_x:.3g} km/h")
        band = _DEG * one.band()
        if np.isfinite(band).all():
            there = np.concatenate([one.a_y, one.a_y[::-1]])
            edge = np.concatenate([band[:, 0], band[::-1, 1]])
            line(figure, there, edge, colour, 0, fill="toself", fillcolor=colour.faded(0.2), showlegend=False)
        y, hover = _DEG * one.understeer_angle, "%{x:.3g} m/s²: %{y:.3g}°"
        for good, dash in ((one.stable, "solid"), (~one.stable, "dot")):
            shown = np.where(good | _beside(good), y, np.nan)
            line(
                figure,
                one.a_y,
                shown,
                colour,
                2,
                dash=dash,
                name=name,
                legendgroup=name,
                showlegend=dash == "solid",
                hovertemplate=hover,
            )
        if one.limit:
            figure.add_vline(x=one.a_y_max, line={"color": colour.light, "width": 1, "dash": "dash"})
    return axes(figure, "lateral acceleration a_y [m/s²]", "understeer angle [deg]")


def _beside(good: np.ndarray) -> np.ndarray:
    """Rows next to one that is true, so that two lines meet."""
    return np.concatenate([[False], good[:-1]]) | np.concatenate([good[1:], [False]])


def diagram_table(one: HandlingDiagram) -> Table:
    """Steering, its excess and side slip at a few lateral accelerations."""
    rows = []
    for k in np.unique(np.linspace(0, len(one.a_y) - 1, 7).round().astype(int)):
        numbers = (one.delta, one.understeer_angle, one.understeer_gradient, one.beta)
        shown = tuple("–" if np.isnan(v[k]) else float(_DEG * v[k]) for v in numbers)
        rows.append(Row((float(one.a_y[k]), *shown, "yes" if one.stable[k] else "no")))
    heads = (
        Heading("lateral acceleration", "m/s2"),
        Heading("road-wheel angle", "deg"),
        Heading("understeer angle", "deg"),
    )
    more = Heading("gradient", "deg/(m/s2)"), Heading("side slip angle", "deg"), Heading("stable", words=True)
    said = f"The limit is {one.a_y_max:.3g} m/s², by {one.limit}." if one.limit else "No limit in this range."
    title = f"Handling diagram of {one.name} at {3.6 * one.v_x:.3g} km/h"
    return Table(title=title, columns=(*heads, *more), rows=tuple(rows), caption=said)


# ---- phase plane ---------------------------------------------------------------------------------------------------


def plane_figure(plane: PhasePlane) -> go.Figure:
    """Trajectories and equilibria over the region from which the car settles."""
    figure = new_figure(520, hovermode="closest")
    figure.add_heatmap(
        x=plane.v_y,
        y=_DEG * plane.r,
        z=plane.settles.astype(float),
        zmin=0,
        zmax=1,
        colorscale=[
            [0, VERMILION.faded(0.16)],
            [0.5, VERMILION.faded(0.16)],
            [0.5, GREEN.faded(0.16)],
            [1, GREEN.faded(0.16)],
        ],
        showscale=False,
        hoverinfo="skip",
    )
    gap = np.full((len(plane.tracks), 1, 2), np.nan)
    joined = np.concatenate([plane.tracks, gap], axis=1).reshape(-1, 2)
    line(figure, joined[:, 0], _DEG * joined[:, 1], SLATE, 1, name="trajectories")
    dots(figure, plane.tracks[:, 0, 0], _DEG * plane.tracks[:, 0, 1], SLATE, 4, name="starts")
    for kind, (colour, symbol) in _MARKS.items():
        found = [e for e in plane.equilibria if e.kind == kind]
        if found:
            x, y = [e.v_y for e in found], [_DEG * e.r for e in found]
            hover = f"{kind}: %{{x:.3g}} m/s, %{{y:.3g}} deg/s"
            dots(
                figure,
                x,
                np.array(y),
                colour,
                12,
                hover=hover,
                name=kind,
                marker={"symbol": symbol, "line": {"width": 2, "color": colour.light}},
            )
    ends = {"range": [float(plane.v_y[0]), float(plane.v_y[-1])]}
    tall = {"range": [float(_DEG * plane.r[0]), float(_DEG * plane.r[-1])]}
    return axes(figure, "lateral velocity v_y [m/s]", "yaw rate r [deg/s]", xaxis=ends, yaxis=tall)


def plane_table(plane: PhasePlane) -> Table:
    """Equilibria of a phase plane."""
    rows = tuple(Row((e.kind, e.v_y, _DEG * e.r, _DEG * float(np.arctan2(e.v_y, plane.v_x)))) for e in plane.equilibria)
    columns = (
        Heading("equilibrium", words=True),
        Heading("v_y", "m/s"),
        Heading("r", "deg/s"),
        Heading("side slip", "deg"),
    )
    place = f"{3.6 * plane.v_x:.3g} km/h, steering {_DEG * plane.delta:.3g}°"
    said = f"From {100 * plane.share:.0f} % of the plane the car settles within {plane.duration:.3g} s."
    return Table(title=f"Phase plane of {plane.name} at {place}", columns=columns, rows=rows, caption=said)
