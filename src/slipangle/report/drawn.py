"""What results draw of themselves by ``.plot()``: `figure`, one per kind of result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import singledispatch
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from slipangle.control.phases import PhasedPlan
from slipangle.data.dataset import Channel, Dataset
from slipangle.data.quality.events import Event, Jump, Spike
from slipangle.data.quality.inspect import DataReport, Seen, Stretch
from slipangle.data.readers.recording import GAP, Recording
from slipangle.errors import ParameterError, nearest
from slipangle.identify.car.identify_car import IdentifiedCar
from slipangle.identify.judge.compare import Comparison, CrossValidation
from slipangle.identify.judge.validate import Validation
from slipangle.identify.linear.statespace import OrderChoice
from slipangle.identify.physics.advise import Advice
from slipangle.identify.search.search import SearchResult
from slipangle.models.model import FitInfo, Trajectory
from slipangle.optimal.lap.driven import DrivenLap, LapDelta
from slipangle.optimal.lap.lap import Lap
from slipangle.optimal.solution import Plan
from slipangle.paths.path import Path
from slipangle.report.diagnostics import forest
from slipangle.report.drives import Signal, signals
from slipangle.report.lap import delta_figure, lap_map
from slipangle.report.maps import Body, path_map
from slipangle.report.plots import trajectories
from slipangle.report.robust import breaking_map
from slipangle.report.search import parallel_coordinates
from slipangle.report.shown import UNITS, spans
from slipangle.report.style import BLUE, escape, new_figure, template, thin, unit_title, with_gaps
from slipangle.simulate.run import Run
from slipangle.simulate.trials import Trials
from slipangle.units import read_in


def _one_of(names: Sequence[str], known: Sequence[str], what: str) -> None:
    """Raise a ParameterError if a name is not known."""
    for name in names:
        if name not in known:
            raise ParameterError(f"there is no {what} '{name}'; {nearest(name, known)}")


@singledispatch
def figure(result: Any, names: Sequence[str]) -> go.Figure:
    """The figure of a result."""
    raise ParameterError(f"a {type(result).__name__} has no figure; expected a result of the toolbox")


def _signal(name: str, unit: str, values: np.ndarray) -> Signal:
    factor, shown = read_in(name, unit)
    return Signal(channel=Channel(name, shown), values=factor * values)


@figure.register
def _(result: Dataset, names: Sequence[str]) -> go.Figure:
    _one_of(names, result.names, "channel")
    chosen = names or (*result.inputs, *result.outputs) or result.names
    rows = [_signal(n, result.unit(n), result[n]) for n in chosen]
    return signals(result.t, rows, starts=result.starts)


@figure.register
def _(result: FitInfo, names: Sequence[str]) -> go.Figure:
    _one_of(names, (), "channel of a fit: leave names out,")
    return forest(result)


def _runs(runs: dict[str, Trajectory], outputs: Sequence[str], names: Sequence[str]) -> go.Figure:
    """Free runs beside the measured output, the first one unless another is named."""
    if len(names) > 1:
        raise ParameterError(f"{len(names)} outputs for one figure; expected one of {', '.join(outputs)}")
    _one_of(names, outputs, "output")
    name = (*names, *outputs)[0]
    factor, unit = read_in(name, next(iter(runs.values())).unit(name) if runs else "-")
    scaled = {
        label: Trajectory(**{**vars(t), "y": factor * t.y, "measured": factor * t.measured})
        for label, t in runs.items()
    }
    return trajectories(scaled, Channel(name, unit))


@figure.register
def _(result: Trajectory, names: Sequence[str]) -> go.Figure:
    return _runs({result.kind: result}, result.outputs, names)


@figure.register
def _(result: Validation, names: Sequence[str]) -> go.Figure:
    return _runs({result.name: result.free_run}, result.free_run.outputs, names)


@figure.register
def _(result: Comparison, names: Sequence[str]) -> go.Figure:
    return _runs(result.trajectories, result.outputs, names)


@figure.register
def _(result: IdentifiedCar, names: Sequence[str]) -> go.Figure:
    return figure(result.model.fit_info, names)


@figure.register
def _(result: Run, names: Sequence[str]) -> go.Figure:
    if names:
        return signals(result.t, [_signal(n, UNITS.get(n, "-"), result[n]) for n in names])
    right, left = result.path.boundaries()
    line = np.column_stack([result.path.X, result.path.Y])
    body = Body(width=result.width or 1.8)
    return path_map(result["X"], result["Y"], result["psi"], reference=line, left=left, right=right, body=body)


@figure.register
def _(result: Lap, names: Sequence[str]) -> go.Figure:
    units = {"v_x": "m/s", "v_y": "m/s", "r": "rad/s", "delta": "rad", "F_x": "N", "a_x": "m/s2", "a_y": "m/s2"}
    units |= {"n": "m", "chi": "rad", "grip_f": "-", "grip_r": "-"}
    _one_of(names, tuple(units), "channel of a lap")
    if not names:
        return lap_map(result)
    drawn = signals(result.s, [_signal(n, units[n], getattr(result, n)) for n in names])
    return drawn.update_layout(xaxis={"title": {"text": "arc length s [m]"}})


@figure.register
def _(result: DrivenLap, names: Sequence[str]) -> go.Figure:
    units = {"v_x": "m/s", "n": "m"}
    _one_of(names, tuple(units), "channel of a driven lap")
    drawn = signals(result.s, [_signal(n, units[n], getattr(result, n)) for n in names or tuple(units)])
    return drawn.update_layout(xaxis={"title": {"text": "arc length s [m]"}})


@figure.register
def _(result: LapDelta, names: Sequence[str]) -> go.Figure:
    _one_of(names, (), "channel of a lap's delta")
    return delta_figure(result)


@figure.register
def _(result: Path, names: Sequence[str]) -> go.Figure:
    known = ("curvature", "psi", *(("v_x",) if result.v_x is not None else ()))
    _one_of(names, known, "channel of a path")
    if names:
        units = {"curvature": "1/m", "psi": "rad", "v_x": "m/s"}
        drawn = signals(result.s, [_signal(n, units[n], getattr(result, n)) for n in names])
        return drawn.update_layout(xaxis={"title": {"text": "arc length s [m]"}})
    right, left = result.boundaries()
    return path_map(result.X, result.Y, result.psi, left=left, right=right)


@figure.register
def _(result: Plan, names: Sequence[str]) -> go.Figure:
    _one_of(names, result.controls, "decided input")
    times = np.arange(len(result.u) + 1.0) if result.times is None else result.times
    rows = []
    for name in names or result.controls:
        u = result.u[:, result.controls.index(name)]
        rows.append(replace(_signal(name, UNITS.get(name, "-"), np.append(u, u[-1])), held=True))
    drawn = signals(times, rows)
    return drawn if result.times is not None else drawn.update_layout(xaxis={"title": {"text": "stage"}})


@figure.register
def _(result: CrossValidation, names: Sequence[str]) -> go.Figure:
    outputs = tuple(result.folds[0].model.outputs)
    _one_of(names, outputs, "output")
    folds = [f"fold {k}: without {spans(fold)}" for k, fold in enumerate(result.folds, 1)]
    drawn = new_figure(360, barmode="group")
    for name in names or outputs:
        drawn.add_bar(x=folds, y=result.fit(name), name=escape(name))
    return drawn.update_layout(yaxis_title="fit of the free run [%]")


@figure.register
def _(result: OrderChoice, names: Sequence[str]) -> go.Figure:
    _one_of(names, (), "channel of a choice of orders")
    drawn = new_figure(320, showlegend=False)
    errors = np.where(np.isfinite(result.errors), result.errors, np.nan)
    drawn.add_scatter(x=list(result.orders), y=errors, mode="lines+markers", name="error")
    drawn.add_vline(x=result.order, line_dash="dash")
    return drawn.update_layout(
        xaxis_title="order", yaxis_title="error on held-out data [-]", xaxis_dtick=1, yaxis_type="log"
    )


@figure.register
def _(result: Advice, names: Sequence[str]) -> go.Figure:
    return figure(result.data, names)


@figure.register
def _(result: DataReport, names: Sequence[str]) -> go.Figure:
    known = tuple(dict.fromkeys(f.channel for f in result.findings if isinstance(f, Seen | Event)))
    _one_of(names, known, "channel with findings")
    drawn = new_figure(320, showlegend=True)
    for label, kind in (("spike", Spike), ("jump", Jump), ("standing still", Stretch)):
        found = [f for f in result.findings if isinstance(f, kind) and f.channel in (names or known)]
        if found:
            told = [f.sentence for f in found]
            drawn.add_scatter(
                x=[f.t for f in found],
                y=[escape(f.channel) for f in found],
                mode="markers",
                name=label,
                hovertext=[escape(sentence) for sentence in told],
            )
    if not drawn.data:
        nothing = {
            "text": "no spikes, jumps or standstills",
            "xref": "x domain",
            "yref": "y domain",
            "x": 0.5,
            "y": 0.5,
        }
        drawn.add_annotation(**nothing, showarrow=False)
        drawn.update_yaxes(showticklabels=False)
    return drawn.update_layout(xaxis_title="time [s]", xaxis_range=[0.0, result.duration])


@figure.register
def _(result: PhasedPlan, names: Sequence[str]) -> go.Figure:
    known = tuple(dict.fromkeys(name for phase in result.phases for name in phase.controls))
    _one_of(names, known, "decided input")
    chosen = names or known
    drawn = _panels(chosen)
    for row, name in enumerate(chosen, 1):
        factor, unit = read_in(name, UNITS.get(name, "-"))
        for phase in result.phases:
            if name in phase.controls:
                u = factor * phase.u[:, phase.controls.index(name)]
                style = {"mode": "lines", "line": {"shape": "hv", "color": BLUE.light}, "name": escape(name)}
                drawn.add_scatter(x=phase.times, y=np.append(u, u[-1]), row=row, col=1, **style)
        drawn.update_yaxes(title_text=unit_title(name, unit), row=row, col=1)
    return drawn


def _panels(names: Sequence[str]) -> go.Figure:
    """Empty panels above each other on one time axis."""
    drawn = make_subplots(rows=len(names), cols=1, shared_xaxes=True, vertical_spacing=0.12 / len(names))
    drawn.update_layout(template=template(), height=120 * len(names) + 60, showlegend=False)
    return drawn.update_xaxes(title_text="time [s]", row=len(names), col=1)


@figure.register
def _(result: Recording, names: Sequence[str]) -> go.Figure:
    _one_of(names, result.names, "channel")
    chosen = names or result.names[:6]
    drawn = _panels(chosen)
    for row, name in enumerate(chosen, 1):
        one = result.signal(name)
        t, values = with_gaps(one.t, one.values, (np.flatnonzero(np.diff(one.t) > GAP * one.dt) + 1).tolist())
        kept = thin(values, 4000)
        drawn.add_scatter(x=t[kept], y=values[kept], mode="lines", name=escape(name), row=row, col=1)
        drawn.update_yaxes(title_text=unit_title(name, one.unit or "-"), row=row, col=1)
    if len(chosen) < len(names or result.names):
        left = f"time [s]; {len(chosen)} of {len(result.names)} channels, others by their names"
        drawn.update_xaxes(title_text=left, row=len(chosen), col=1)
    return drawn


@figure.register
def _(result: SearchResult, names: Sequence[str]) -> go.Figure:
    _one_of(names, (), "channel of a search")
    return parallel_coordinates(result)


@figure.register
def _(result: Trials, names: Sequence[str]) -> go.Figure:
    _one_of(names, (), "channel of many cars")
    return breaking_map(result)
