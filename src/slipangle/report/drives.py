"""Figures over time: recorded signals, inputs with their limits, solver time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from slipangle.data.dataset import Channel
from slipangle.errors import ParameterError
from slipangle.report.style import (
    BLUE,
    GROUND,
    INK,
    SLATE,
    VERMILION,
    axes,
    axis_title,
    dots,
    line,
    new_figure,
    on_one_axis,
    same_length,
    thin,
    with_gaps,
    wrap,
)

_TIME = "time per step [ms]"


@dataclass(frozen=True, kw_only=True)
class Signal:
    """One channel over time, shape (n,), what it should have been, and its limits, all in the channel's unit.

    ``held`` is true for a signal that is constant between samples, such as a controller's output.
    """

    channel: Channel
    values: np.ndarray
    reference: np.ndarray | None = None
    lower: float | None = None
    upper: float | None = None
    held: bool = False


@dataclass(frozen=True, kw_only=True)
class Span:
    """A stretch of time with a name, such as the training data. [s]"""

    start: float
    end: float
    label: str


def signals(
    t: np.ndarray,
    rows: Sequence[Signal],
    *,
    spans: Sequence[Span] = (),
    starts: Sequence[int] = (0,),
    points: int = 4000,
) -> go.Figure:
    """Signals in panels above each other on one time axis, with their limits.

    ``t`` is the time of the samples, shape (n,) [s]; ``spans`` are shaded and named; for ``starts`` and ``points`` see
    `slipangle.report.plots.measured_vs_simulated`.

    Raises ParameterError if there is no signal or a length differs from that of ``t``.
    """
    if not rows:
        raise ParameterError("there is no signal to draw; got an empty sequence, expected at least one Signal: add one")
    t, title = on_one_axis(t, starts)
    n = len(rows)
    figure = new_figure(90 + 150 * n, hovermode="x unified", showlegend=any(s.reference is not None for s in rows))
    gap = 0.22 / (n + 1)
    height = (1 - gap * (n - 1)) / n
    for k, signal in enumerate(rows):
        same_length("t", len(t), **{signal.channel.name: signal.values})
        axis = "y" if k == 0 else f"y{k + 1}"
        top = 1 - k * (height + gap)
        _panel(figure, t, signal, axis, starts, points, first=all(s.reference is None for s in rows[:k]))
        panel = {"title": {"text": axis_title(signal.channel, lines=2)}, "domain": [max(top - height, 0.0), top]}
        figure.update_layout({axis.replace("y", "yaxis"): panel})
    last = "y" if n == 1 else f"y{n}"
    figure.update_layout(xaxis={"title": {"text": title}, "anchor": last, "hoverformat": ".2f"})
    for k, span in enumerate(spans):
        shade = {"fillcolor": SLATE.faded((0.05, 0.18)[k % 2]), "line": {"width": 0}, "layer": "below"}
        figure.add_shape(type="rect", x0=span.start, x1=span.end, y0=0, y1=1, xref="x", yref="paper", **shade)
        where = {"x": (span.start + span.end) / 2, "y": 1, "xref": "x", "yref": "paper", "yanchor": "bottom"}
        figure.add_annotation(text=wrap(span.label, 60), showarrow=False, font={"color": SLATE.light}, **where)
    if spans:
        figure.update_layout(margin={"t": 32}, legend={"y": 1.06})
    return figure


def _panel(
    figure: go.Figure, t: np.ndarray, signal: Signal, axis: str, starts: Sequence[int], points: int, *, first: bool
) -> None:
    x, y = with_gaps(t, np.asarray(signal.values, dtype=float), starts)
    rows = thin(y, points)
    if signal.reference is not None:
        same_length("t", len(t), reference=signal.reference)
        v = with_gaps(t, np.asarray(signal.reference, dtype=float), starts)[1]
        keep = thin(v, points)
        shared = {"name": "reference", "legendgroup": "reference", "showlegend": first, "hovertemplate": "%{y:.4g}"}
        line(figure, x[keep], v[keep], SLATE, 2, dash="dash", yaxis=axis, **shared)
    name = wrap(signal.channel.name, 60)
    line(figure, x[rows], y[rows], BLUE, 1.4, name=name, showlegend=False, yaxis=axis, hovertemplate="%{y:.4g}")
    if signal.held:
        figure.data[-1].update(line_shape="hv")
    for limit in (signal.lower, signal.upper):
        if limit is not None and np.isfinite(limit):
            ends = {"x0": 0, "x1": 1, "y0": limit, "y1": limit, "xref": "x domain", "yref": axis}
            figure.add_shape(type="line", line={"color": VERMILION.light, "width": 1.4, "dash": "dash"}, **ends)
            side = "top" if limit == signal.upper else "bottom"
            where = {"x": 1, "y": limit, "xref": "x domain", "yref": axis, "xanchor": "right", "yanchor": side}
            font = {"color": VERMILION.light, "size": 12}
            figure.add_annotation(text=f"limit {limit:.4g}", showarrow=False, font=font, **where)
    finite = [v for v in (signal.lower, signal.upper) if v is not None and np.isfinite(v)]
    if finite:
        low, high = min(np.nanmin(y), *finite), max(np.nanmax(y), *finite)
        pad = 0.08 * (high - low) or 1.0
        figure.update_layout({axis.replace("y", "yaxis"): {"range": [low - pad, high + pad]}})


def solver_time(
    seconds: np.ndarray, *, deadline: float, failed: np.ndarray | None = None, points: int = 4000
) -> go.Figure:
    """Time per control step [s], shape (n_steps,), with the deadline [s] and the steps that did not solve.

    ``points`` is about how many points the line keeps.
    """
    ms = 1e3 * np.asarray(seconds, dtype=float)
    rows = thin(ms, points)
    figure = new_figure(340, hovermode="closest")
    line(figure, rows, ms[rows], BLUE, 1.2, name="solver", hovertemplate="step %{x}: %{y:.3g} ms<extra></extra>")
    if failed is not None:
        same_length("seconds", len(ms), failed=failed)
        bad = np.flatnonzero(failed)
        if len(bad):
            hover, cross = "step %{x}: %{y:.3g} ms, not solved<extra></extra>", {"symbol": "x"}
            name = f"not solved ({len(bad)})"
            dots(figure, bad, ms[bad], VERMILION, 9, hover=hover, name=name, marker=cross)
    limit = 1e3 * deadline
    line(figure, [0, max(len(ms) - 1, 1)], [limit] * 2, VERMILION, dash="dash", name=f"deadline {limit:g} ms")
    return axes(figure, "control step [-]", _TIME, yaxis=_decades(ms, 1e3 * deadline))


def solver_histogram(seconds: np.ndarray, *, deadline: float, bins: int = 40) -> go.Figure:
    """Distribution of the time per control step [s], shape (n_steps,), in ``bins`` bars, with the deadline [s]."""
    ms = 1e3 * np.asarray(seconds, dtype=float)
    ms = ms[np.isfinite(ms) & (ms > 0)]
    if len(ms) == 0:
        raise ParameterError("there is no solver time above zero; expected one per control step: run the loop first")
    low, high = np.log10(ms.min()), np.log10(ms.max())
    edges = np.logspace(low - 0.02, high + 0.02, bins + 1)
    counts, _ = np.histogram(ms, edges)
    figure = new_figure(340, hovermode="closest", showlegend=False, bargap=0)
    figure.add_bar(
        x=np.sqrt(edges[:-1] * edges[1:]),
        y=counts,
        width=np.diff(edges),
        marker={"color": BLUE.faded(0.55), "line": {"color": GROUND.light, "width": 1}},
        hovertemplate="%{x:.3g} ms: %{y} steps<extra></extra>",
    )
    median, slowest = np.median(ms), np.percentile(ms, 99)
    for value, text, colour in (
        (median, f"median {median:.3g} ms", INK),
        (slowest, f"99 % {slowest:.3g} ms", INK),
        (1e3 * deadline, f"deadline {1e3 * deadline:g} ms", VERMILION),
    ):
        dash, said = "dash" if colour is VERMILION else "dot", text + "<extra></extra>"
        line(figure, [value] * 2, [0, 1.08 * counts.max()], colour, dash=dash, name=text, hovertemplate=said)
    figure.data[0].update(showlegend=False)
    across, upright = _decades(ms, 1e3 * deadline), {"rangemode": "tozero"}
    return axes(figure, _TIME, "steps [-]", xaxis=across, yaxis=upright, showlegend=True)


def _decades(ms: np.ndarray, deadline: float) -> dict[str, object]:
    """A logarithmic axis over data and deadline with ticks at 1, 2, 5 of each decade, in plain numbers."""
    positive = ms[np.isfinite(ms) & (ms > 0)]
    low, high = min([*positive, deadline]), max([*positive, deadline])
    ticks = [m * 10.0**p for p in range(-5, 7) for m in (1, 2, 5) if 0.5 * low <= m * 10.0**p <= 2 * high]
    if len(ticks) > 9:
        ticks = [v for v in ticks if f"{v:e}".startswith("1")]
    return {
        "type": "log",
        "range": [float(np.log10(low)) - 0.15, float(np.log10(high)) + 0.15],
        "tickvals": ticks,
        "ticktext": [f"{v:g}" for v in ticks],
    }
