"""Figures and tables of steady cornering and of the phase plane: how a car goes over its limit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from slipangle.models.analysis.diagram import HandlingDiagram
from slipangle.models.analysis.phase_plane import PhasePlane
from slipangle.report.style import GREEN, SLATE, VERMILION, axes, dots, escape, line, new_figure, series_style
from slipangle.report.tables import Heading, Row, Table
from slipangle.units import angle_said, read_in, speed_said

_MARKS = {"stable": (GREEN, "circle"), "saddle": (VERMILION, "x"), "unstable": (VERMILION, "circle-open")}


# ---- handling diagram ----------------------------------------------------------------------------------------------


def diagram_figure(several: Sequence[HandlingDiagram]) -> go.Figure:
    """Understeer angle over lateral acceleration, with bands; the unstable part dotted, the limit dashed."""
    turn, angle = read_in("", "rad")
    figure = new_figure(420, hovermode="closest")
    for index, one in enumerate(several):
        colour, _ = series_style(index)
        name = escape(f"{one.name}, {speed_said(one.v_x)}")
        band = turn * one.band()
        if np.isfinite(band).all():
            there = np.concatenate([one.a_y, one.a_y[::-1]])
            edge = np.concatenate([band[:, 0], band[::-1, 1]])
            line(figure, there, edge, colour, 0, fill="toself", fillcolor=colour.faded(0.2), showlegend=False)
        y, hover = turn * one.understeer_angle, f"%{{x:.3g}} m/s²: %{{y:.3g}} {angle}"
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
    return axes(figure, "lateral acceleration a_y [m/s²]", f"understeer angle [{angle}]")


def _beside(good: np.ndarray) -> np.ndarray:
    """Rows next to one that is true, so that two lines meet."""
    return np.concatenate([[False], good[:-1]]) | np.concatenate([good[1:], [False]])


def diagram_table(one: HandlingDiagram) -> Table:
    """Steering, its excess and side slip at a few lateral accelerations."""
    turn, angle = read_in("", "rad")
    rows = []
    for k in np.unique(np.linspace(0, len(one.a_y) - 1, 7).round().astype(int)):
        numbers = (one.delta, one.understeer_angle, one.understeer_gradient, one.beta)
        shown = tuple("–" if np.isnan(v[k]) else float(turn * v[k]) for v in numbers)
        rows.append(Row((float(one.a_y[k]), *shown, "yes" if one.stable[k] else "no")))
    heads = (
        Heading("lateral acceleration", "m/s2"),
        Heading("road-wheel angle", angle),
        Heading("understeer angle", angle),
    )
    more = Heading("gradient", f"{angle}/(m/s2)"), Heading("side slip angle", angle), Heading("stable", words=True)
    said = f"The limit is {one.a_y_max:.3g} m/s², by {one.limit}." if one.limit else "No limit in this range."
    title = f"Handling diagram of {one.name} at {speed_said(one.v_x)}"
    return Table(title=title, columns=(*heads, *more), rows=tuple(rows), caption=said)


# ---- phase plane ---------------------------------------------------------------------------------------------------


def plane_figure(plane: PhasePlane) -> go.Figure:
    """Trajectories and equilibria over the region from which the car settles."""
    turn, angle = read_in("", "rad")
    figure = new_figure(520, hovermode="closest")
    figure.add_heatmap(
        x=plane.v_y,
        y=turn * plane.r,
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
    line(figure, joined[:, 0], turn * joined[:, 1], SLATE, 1, name="trajectories")
    dots(figure, plane.tracks[:, 0, 0], turn * plane.tracks[:, 0, 1], SLATE, 4, name="starts")
    for kind, (colour, symbol) in _MARKS.items():
        found = [e for e in plane.equilibria if e.kind == kind]
        if found:
            x, y = [e.v_y for e in found], [turn * e.r for e in found]
            hover = f"{kind}: %{{x:.3g}} m/s, %{{y:.3g}} {angle}/s"
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
    tall = {"range": [float(turn * plane.r[0]), float(turn * plane.r[-1])]}
    return axes(figure, "lateral velocity v_y [m/s]", f"yaw rate r [{angle}/s]", xaxis=ends, yaxis=tall)


def plane_table(plane: PhasePlane) -> Table:
    """Equilibria of a phase plane."""
    turn, angle = read_in("", "rad")
    rows = tuple(Row((e.kind, e.v_y, turn * e.r, turn * float(np.arctan2(e.v_y, plane.v_x)))) for e in plane.equilibria)
    columns = (
        Heading("equilibrium", words=True),
        Heading("v_y", "m/s"),
        Heading("r", f"{angle}/s"),
        Heading("side slip", angle),
    )
    place = f"{speed_said(plane.v_x)}, steering {angle_said(plane.delta)}"
    said = f"From {100 * plane.share:.0f} % of the plane the car settles within {plane.duration:.3g} s."
    return Table(title=f"Phase plane of {plane.name} at {place}", columns=columns, rows=rows, caption=said)
