"""Figures of a fastest lap: its line on the track, its accelerations within the car's limits, its traces."""

from __future__ import annotations

from typing import Literal

import numpy as np
import plotly.graph_objects as go

from slipangle.data.dataset import Channel
from slipangle.optimal.lap.envelope import envelope
from slipangle.optimal.lap.lap import Lap
from slipangle.report import style
from slipangle.report.drives import Signal, signals
from slipangle.report.maps import track_map
from slipangle.report.style import SLATE, compact, new_figure, series_style

_COLOURS = {
    "v_x": ("speed", 3.6, "km/h"),
    "grip_f": ("grip used by the front axle", 100.0, "%"),
    "grip_r": ("grip used by the rear axle", 100.0, "%"),
}


def lap_map(lap: Lap, by: Literal["v_x", "grip_f", "grip_r"] = "v_x") -> go.Figure:
    """The line between the edges of the track, coloured by speed or by the grip that an axle uses."""
    label, factor, unit = _COLOURS[by]
    drawn = track_map(lap.X, lap.Y, factor * getattr(lap, by), channel=Channel(by, unit), label=label)
    for edge in lap.track.boundaries():
        if np.isfinite(edge).all():
            rows = style.thin(edge[:, 0], 3000)
            style.line(drawn, style.compact(edge[rows, 0]), edge[rows, 1], SLATE, 1)
    return drawn


def lap_traces(lap: Lap) -> go.Figure:
    """Speed, steering, longitudinal force and grip over the arc length of the track."""
    rows = [
        Signal(channel=Channel("v_x", "km/h"), values=3.6 * lap.v_x),
        Signal(channel=Channel("delta", "deg"), values=np.degrees(lap.delta)),
        Signal(channel=Channel("F_x", "kN"), values=1e-3 * lap.F_x),
        Signal(channel=Channel("grip_f", "%"), values=100 * lap.grip_f),
        Signal(channel=Channel("grip_r", "%"), values=100 * lap.grip_r),
    ]
    return signals(lap.s, rows).update_layout(xaxis={"title": {"text": "arc length s [m]"}})


def gg_diagram(lap: Lap) -> go.Figure:
    """Accelerations of the lap beside the car's quasi-steady limits at three of its speeds."""
    drawn = new_figure(480, hovermode="closest")
    limits = envelope(lap.car, max(float(lap.v_x.max()), 5.0))
    low, high = np.percentile(lap.v_x, [5, 95])
    for k, v in enumerate((low, 0.5 * (low + high), high)):
        a_y = float(np.interp(v, limits.v, limits.a_y)) * limits.share
        edges = [np.array([np.interp(v, limits.v, c) for c in table.T]) for table in (limits.drive, -limits.brake)]
        right = np.concatenate([edges[0], edges[1][::-1]])
        across = np.concatenate([a_y, a_y[::-1]])
        colour, dash = series_style(k)
        drawn.add_scatter(
            x=compact(np.concatenate([across, -across[::-1]])),
            y=compact(np.concatenate([right, right[::-1]])),
            mode="lines",
            name=f"limit at {3.6 * v:.0f} km/h",
            line={"color": colour.light, "width": 1.5, "dash": dash},
            hovertemplate="%{x:.1f}, %{y:.1f} m/s²<extra></extra>",
        )
    drawn.add_scatter(
        x=compact(lap.a_y),
        y=compact(lap.a_x),
        mode="markers",
        name="the lap",
        marker={"size": 4, "color": SLATE.light},
        hovertemplate="%{x:.1f}, %{y:.1f} m/s²<extra></extra>",
    )
    return drawn.update_layout(
        xaxis={"title": {"text": "a_y to the left [m/s²]"}},
        yaxis={"title": {"text": "a_x forward [m/s²]"}, "scaleanchor": "x"},
    )
