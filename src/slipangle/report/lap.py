"""Figures of a fastest lap: its line on the track, its accelerations within the car's limits, its traces."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import plotly.graph_objects as go

from slipangle.data.dataset import Channel
from slipangle.numerics.critical import quantile
from slipangle.optimal.lap.driven import DrivenLap, LapDelta, Sector
from slipangle.optimal.lap.envelope import envelope
from slipangle.optimal.lap.lap import CALM, Lap
from slipangle.paths.path import Path
from slipangle.report import style
from slipangle.report.drawing import seen_from_above
from slipangle.report.drives import Signal, signals
from slipangle.report.maps import Body, track_map
from slipangle.report.page import Figure, Number, Page, Section, Verdict
from slipangle.report.playback import Beside, Playback
from slipangle.report.style import SLATE, compact, new_figure, series_style
from slipangle.report.tables import Heading, Row, Table
from slipangle.units import read_in, speed_said

BEATEN = 0.002  # part of its time by which a driven lap beats the fastest one, and not by what its places leave open
VAGUE = 0.01  # standard deviation of a lap time, in parts of it, from which it is no good answer
_FRAME, _DRAWN = 0.05, 2.0  # s between frames of a lap that plays, m between points of edges, of a usual car
_HALF = 2.2  # m, half of the length of a usual car
_COLOURS = {
    "v_x": ("speed", 1.0, "m/s"),
    "grip_f": ("grip used by the front axle", 100.0, "%"),
    "grip_r": ("grip used by the rear axle", 100.0, "%"),
}


def lap_map(lap: Lap, by: Literal["v_x", "grip_f", "grip_r"] = "v_x") -> go.Figure:
    """The line between the edges of the track, coloured by speed or by the grip that an axle uses."""
    label, kept, unit = _COLOURS[by]
    factor, unit = read_in(by, unit)
    drawn = track_map(lap.X, lap.Y, factor * kept * getattr(lap, by), channel=Channel(by, unit), label=label)
    draw_edges(drawn, lap.track)
    return drawn


def draw_edges(drawn: go.Figure, track: Path) -> None:
    """Thin lines along the edges of a track, where they are known."""
    for edge in track.boundaries():
        if np.isfinite(edge).all():
            rows = style.thin(edge[:, 0], 3000)
            style.line(drawn, style.compact(edge[rows, 0]), edge[rows, 1], SLATE, 1)


def lap_traces(lap: Lap) -> go.Figure:
    """Speed, steering, longitudinal force and grip over the arc length of the track."""
    (fast, speed), (turn, angle) = read_in("v_x", "m/s"), read_in("delta", "rad")
    rows = [
        Signal(channel=Channel("v_x", speed), values=fast * lap.v_x),
        Signal(channel=Channel("delta", angle), values=turn * lap.delta),
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
            name=f"limit at {speed_said(v)}",
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


def delta_figure(delta: LapDelta) -> go.Figure:
    """Speed, time behind and offset of a driven lap over the arc length of the track, beside the fastest lap's."""
    lap, driven = delta.lap, delta.driven
    v, n = (np.interp(delta.s, lap.s, values, period=lap.track.length) for values in (lap.v_x, lap.n))
    factor, unit = read_in("v_x", "m/s")
    rows = [
        Signal(channel=Channel("v_x", unit), values=factor * driven.v_x, reference=factor * v),
        Signal(channel=Channel("behind", "s"), values=delta.delta),
        Signal(channel=Channel("n", "m"), values=driven.n, reference=n),
    ]
    return signals(delta.s, rows).update_layout(xaxis={"title": {"text": "arc length s [m]"}})


def sector_table(delta: LapDelta) -> Table:
    """Where a driven lap loses time, in driving order."""
    titles = ("from", "m"), ("to", "m"), ("slowest at", "m"), ("lost", "s")
    rows = tuple(Row((s.begin, s.end, s.corner, s.lost)) for s in delta.sectors)
    return Table(
        title=f"Lap {delta.driven.number}: {delta.delta[-1]:+.3f} s",
        columns=tuple(Heading(*title) for title in titles),
        rows=rows,
        caption=f"A sector is a corner with half of the straights beside it. {_most_lost(delta)}",
    )


def lost_most(delta: LapDelta, count: int) -> list[Sector]:
    """So many sectors that lose the most, which are fewer where the others lose nothing."""
    ordered = sorted(delta.sectors, key=lambda sector: -sector.lost)
    return [sector for sector in ordered[:count] if round(sector.lost, 2) > 0]


def _most_lost(delta: LapDelta) -> str:
    worst = lost_most(delta, 1)
    if not worst:
        return f"You lose nothing in any.{beaten(delta)}"
    return f"You lose {worst[0].lost:.2f} s at {worst[0].corner:.0f} m, the most of all.{beaten(delta)}"


def beaten(delta: LapDelta) -> str:
    """End of a sentence on a driven lap that is faster than the fastest one of its car; empty where it is not."""
    gained = -float(delta.delta[-1])
    if gained <= BEATEN * delta.lap.time:
        return ""
    return (
        f" The driven lap is {gained:.2f} s faster than the fastest lap of this car, which it cannot be: its grip or "
        "its power is set too low, or the log's clock is off."
    )


def lap_playback(lap: Lap, driven: DrivenLap | None = None) -> Playback:
    """The lap as it plays, from above; a driven lap beside it starts at the same time."""
    extent = float(max(np.ptp(lap.X), np.ptp(lap.Y)))
    size = float(lap.car.size)
    half = max(_HALF * size, 0.008 * extent)
    body = Body(front=half, rear=half, width=max(lap.car.width, 0.006 * extent))
    count = max(round(lap.track.length / (_DRAWN * min(size, 1.0))), 8)
    rows = np.linspace(0, len(lap.track.s) - 1, min(count, len(lap.track.s) - 1) + 1).round().astype(int)
    right, left = (edge[rows] for edge in lap.track.boundaries())
    t = np.arange(0.0, lap.time, _FRAME)
    psi = np.unwrap(lap.psi)
    turned = 2 * np.pi * round(float(psi[-1] - psi[0]) / (2 * np.pi))
    values = (lap.X, lap.Y, psi, lap.v_x, 100 * lap.grip_f, 100 * lap.grip_r)
    X, Y, psi, v, front, rear = (_at(t, lap, one, turned if one is psi else 0.0) for one in values)
    said = f"{lap.track.name} in {lap.time:.3f} s"
    words = [f"{speed_said(a)}, grip {b:.0f} % front, {c:.0f} % rear" for a, b, c in zip(v, front, rear, strict=True)]
    beside = None
    if driven is not None:
        rows = np.searchsorted(driven.t, np.arange(0.0, driven.time, _FRAME)).clip(0, len(driven.t) - 1)
        heading = np.unwrap(np.arctan2(np.gradient(driven.Y), np.gradient(driven.X)))[rows]
        place = {"X": driven.X[rows].tolist(), "Y": driven.Y[rows].tolist(), "psi": heading.tolist()}
        beside = Beside(label=f"lap {driven.number}", t=driven.t[rows].tolist(), **place)
    return Playback(
        title="The lap",
        svg=seen_from_above(X, Y, psi, body=body, outlines=0, label=said, moving=True, left=left, right=right),
        t=t.tolist(),
        X=X.tolist(),
        Y=Y.tolist(),
        psi=psi.tolist(),
        said=words,
        beside=beside,
        caption="The car is drawn larger than it is." + (" Beside it: the driven lap." if beside else ""),
    )


def _at(t: np.ndarray, lap: Lap, values: np.ndarray, turned: float) -> np.ndarray:
    """Values at instants of a lap, whose first point is after its start; a closed one ends where it begins."""
    first = values[-1] - turned if lap.track.closed else values[0]
    return np.interp(t, np.append(0.0, lap.t), np.append(first, values))


def lap_page(
    lap: Lap,
    title: str,
    command: str,
    delta: LapDelta | None = None,
    more: tuple[Section, ...] = (),
    std: float = math.nan,
    supposed: str = "",
) -> Page:
    """Lap time, the line by speed and by grip, the g-g diagram, traces, and what each parameter is worth.

    With a driven lap also where it loses time; ``more`` are sections behind, ``std`` is how uncertain the car makes the
    lap time, see `Lap.time_std` [s], and ``supposed`` what nobody said of the car, see `slipangle.optimal.lap.cars`.
    """
    factor, unit = read_in("v_x", "m/s")
    faster, said = "" if delta is None else beaten(delta), remarks(lap, std, supposed)
    verdict = Verdict(
        title="The fastest lap",
        sentence=f"The car laps “{lap.track.name}” in {lap.time:.3f} s. On the line of least curvature it would take "
        f"{lap.quasi_steady:.3f} s if turning in, and shifting its load, took no time.{said}{faster}",
        tone="poor" if faster else "fair" if std > VAGUE * lap.time else "good",
        numbers=(
            Number(label="lap time", value=lap.time, unit="s", digits=6),
            Number(label="highest speed", value=factor * max(float(lap.v_x.max()), lap.v_start), unit=unit, digits=4),
            Number(label="lowest speed", value=factor * min(float(lap.v_x.min()), lap.v_start), unit=unit, digits=4),
        ),
        command=command,
    )
    figures = (
        Figure(title="The line, by speed", figure=lap_map(lap), caption="Thin lines: the edges of the track."),
        Figure(title="Grip of the front axle", figure=lap_map(lap, "grip_f"), caption="Of its friction ellipse."),
        Figure(title="Grip of the rear axle", figure=lap_map(lap, "grip_r"), caption="Of its friction ellipse."),
        Figure(title="g-g diagram", figure=gg_diagram(lap), caption="Lines: quasi-steady limits at three speeds."),
        Figure(title="Traces", figure=lap_traces(lap), caption="Over the arc length of the track's line."),
    )
    playing = lap_playback(lap, None if delta is None else delta.driven)
    sections = [Section(title="Fastest lap", blocks=(verdict, playing, *figures, worth_table(lap)))]
    if delta is not None:
        caption = "Thin or dashed: the fastest lap. Behind: time since the start line, driven minus fastest."
        drawn = Figure(title="Driven and fastest", figure=delta_figure(delta), caption=caption)
        sections.append(Section(title="The driven lap", blocks=(sector_table(delta), drawn)))
    return Page(title=f"{title}: fastest lap", sections=(*sections, *more), command=command)


def open_said(lap: Lap, std: float) -> str:
    """A sentence on how far the log leaves the lap time open; none where nothing says it."""
    if math.isnan(std):
        return ""
    if math.isinf(std):
        return " The log leaves what the car can hold open, and with it this time."
    vague = ": drive nearer to the limit for a closer one" if std > VAGUE * lap.time else ""
    return f" By what the log leaves open of the car, the time is ±{quantile(0.95) * std:.2g} s (95 %){vague}."


def remarks(lap: Lap, std: float = math.nan, supposed: str = "") -> str:
    """Sentences on how far the log leaves the time open, what of the car nobody said, the start, and smoothness."""
    entered = "" if lap.track.closed else f" The track is open, and entered at {speed_said(lap.v_start)}."
    beside = f" {supposed[0].upper()}{supposed[1:]}." if supposed else ""
    return open_said(lap, std) + beside + entered + _calm_said(lap)


def _calm_said(lap: Lap) -> str:
    """A sentence on what smoothness costs, where that is much; else none."""
    if lap.calm <= CALM:
        return ""
    return (
        f" A calm drive, which smoothness asks for, costs {100 * lap.calm:.0f} % beside the time: with less of it, "
        "such as smoothness = 0.1, the lap is faster."
    )


def worth_table(lap: Lap) -> Table:
    """What each parameter is worth: the change of the lap time with one percent more of it, largest first."""
    rows = []
    for name in lap.sensitivities:
        value = getattr(lap.car, name)
        if value:
            meta = lap.car.si(name)
            rows.append((name, meta.doc, value, meta.unit, 10.0 * lap.worth(name, value)))
    rows.sort(key=lambda row: -abs(row[-1]))
    words = [Heading(title, words=True) for title in ("parameter", "meaning", "unit")]
    return Table(
        title="What one percent more is worth",
        columns=(*words[:2], Heading("value"), words[2], Heading("lap time", "ms")),
        rows=tuple(Row(row) for row in rows if abs(row[-1]) >= 0.1),
        caption="From the multipliers of the optimum, to first order; negative is faster.",
    )
