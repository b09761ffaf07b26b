"""Figures and tables of a race: the line driven over the optimal one, its laps and corners, moments off the track."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from slipangle.data.dataset import Channel
from slipangle.optimal.lap.driven import DrivenLap, LapDelta
from slipangle.optimal.lap.lap import Lap
from slipangle.report.lap import draw_edges
from slipangle.report.maps import track_map
from slipangle.report.style import BLUE, SLATE, VERMILION, axes, compact, dots, line, new_figure, thin
from slipangle.report.tables import Heading, Row, Table
from slipangle.simulate.race import Race
from slipangle.units import read_in


def race_map(race: Race, driven: DrivenLap | None, fastest: Lap) -> go.Figure:
    """A driven lap coloured by speed over the fastest lap's line, and where the car was off the track on any lap.

    Without a lap it is the drive.
    """
    factor, unit = read_in("v_x", "m/s")
    run = race.run
    X, Y, v_x = (run["X"], run["Y"], run.v_x) if driven is None else (driven.X, driven.Y, driven.v_x)
    drawn = track_map(X, Y, factor * v_x, channel=Channel("v_x", unit), label="speed")
    draw_edges(drawn, fastest.track)
    rows = thin(fastest.X, 3000)
    line(drawn, compact(fastest.X[rows]), fastest.Y[rows], SLATE, 1.6, dash="dash")
    off = race.off_track
    if off:
        at = [int(np.argmin(np.abs(run.t - 0.5 * (one.begin + one.end)))) for one in off]
        said = [f"off the track by {one.depth:.2f} m at {one.begin:.1f} s" for one in off]
        how = {"symbol": "x", "line": {"width": 2}}
        dots(drawn, run["X"][at], run["Y"][at], VERMILION, 11, marker=how, hover="%{text}<extra></extra>")
        drawn.data[-1].update(text=said)
    return drawn


def lap_times(times: list[float], fastest: float) -> go.Figure:
    """Time of each lap [s] beside that of the fastest lap. [s]"""
    figure, number = new_figure(320, hovermode="closest"), np.arange(1, len(times) + 1)
    hover = "lap %{x}: %{y:.2f} s<extra></extra>"
    line(figure, number, np.array(times), BLUE, 2, name="driven", hovertemplate=hover)
    dots(figure, number, np.array(times), BLUE, 8, hover=hover, showlegend=False)
    ends = [0.5, len(times) + 0.5]
    line(figure, ends, [fastest] * 2, SLATE, 2, dash="dash", name="optimum", hovertemplate=f"{fastest:.2f} s")
    return axes(figure, "lap [-]", "time [s]", xaxis={"dtick": max(1, round(len(times) / 10)), "range": ends})


def laps_table(race: Race, fastest: float) -> Table:
    """The laps of a race: times, room to the edges and what was learned of the friction."""
    room, rows = race.room, []
    for lap, (grip, std) in zip(race.laps, race.learned, strict=True):
        here = race.rows(lap)
        off = float(np.sum(room[here] < 0.0)) * float(race.run.t[1] - race.run.t[0])
        over = 100.0 * (lap.time / fastest - 1.0)
        cells = (lap.number, lap.time, over, float(room[here].min()), off, float(grip), float(std))
        rows.append(Row(cells, "poor" if off else None))
    columns = ("lap", ""), ("time", "s"), ("over optimum", "%"), ("room", "m"), ("off track", "s")
    columns = (*columns, ("friction", "-"), ("deviation", "-"))
    digits = {"time": 5, "over optimum": 3, "room": 2, "deviation": 2}
    return Table(
        title="Laps",
        columns=tuple(Heading(name, unit, digits.get(name, 4)) for name, unit in columns),
        rows=tuple(rows),
        caption="Room: the least from the car's side to an edge, below zero beyond it. Friction, and its deviation: "
        "over the one believed at first, as the racer takes it after the lap.",
    )


def corners(race: Race, delta: LapDelta) -> list[dict[str, float]]:
    """Every corner of a lap: its place [m], time lost there [s], least room on any lap [m], friction read in the lap.

    Each sample of the friction counts by how sure it is.
    """
    run, here = race.run, race.rows(delta.driven)
    s, room = run.s % run.path.length, race.room[race.judged]
    found = []
    for one in delta.sectors:
        inside = (s >= one.begin) & (s < one.end)
        rows = np.flatnonzero(inside[here]) + here.start
        sure = 1.0 / np.maximum(race.grip_std[rows], 1e-4) ** 2
        grip = float(np.average(race.grip[rows], weights=sure)) if len(rows) else float("nan")
        least = float(room[inside[race.judged]].min(initial=np.inf))
        found.append({"corner": one.corner, "lost": one.lost, "room": least, "grip": grip})
    return found


def corners_table(race: Race, delta: LapDelta) -> Table:
    """The corners of the best lap."""
    rows = tuple(Row(tuple(one.values()), "poor" if one["room"] < 0 else None) for one in corners(race, delta))
    titles = ("slowest at", "m", 4), ("lost", "s", 2), ("least room", "m", 2), ("friction read", "-", 4)
    return Table(
        title=f"Corners of lap {delta.driven.number}",
        columns=tuple(Heading(*title) for title in titles),
        rows=rows,
        caption="Lost: against the optimum. Least room: on any lap. Friction: over the one believed at first, as the "
        "filter read it on this lap; each sample counts by how sure it is.",
    )


def off_track_table(race: Race) -> Table:
    """The moments off the track."""
    titles = ("from", "s", 4), ("to", "s", 4), ("at", "m", 4), ("beyond the edge by", "m", 2)
    rows = tuple(Row((one.begin, one.end, one.s, one.depth), "poor") for one in race.off_track)
    return Table(
        title="Off the track",
        columns=tuple(Heading(*title) for title in titles),
        rows=rows,
        caption="From, to: time of the drive. At: arc length of the track's line where the car was furthest out.",
    )
