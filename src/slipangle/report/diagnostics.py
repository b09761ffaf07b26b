"""Figures that ask whether to trust a model: residual correlations and parameter intervals."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go

from slipangle.data.dataset import Channel
from slipangle.errors import ParameterError
from slipangle.identify.judge.compare import HorizonErrors
from slipangle.models.model import FitInfo
from slipangle.report.style import (
    INK,
    SLATE,
    VERMILION,
    axes,
    axis_title,
    dots,
    escape,
    line,
    new_figure,
    pretty_unit,
    same_length,
    series_style,
    wrap,
)
from slipangle.report.tables import lost, to_digit
from slipangle.units import read_in


def correlogram(
    lags: np.ndarray,
    values: np.ndarray,
    *,
    band: float,
    label: str,
    dt: float | None = None,
    index: int = 0,
    level: float = 0.99,
) -> go.Figure:
    """Correlation over lag with the confidence band; lags outside it are marked in another colour and shape.

    ``lags`` are in samples, shape (n_lags,); for residuals against an input, positive ones are inputs in the past.
    ``values``, -1 to 1, stay within ``band`` for white residuals, at the ``level`` of its label. ``label`` says what is
    correlated; with a sample time ``dt`` [s] the abscissa is in seconds. ``index`` is the model's colour, as in the
    other figures.

    Raises ParameterError if the lengths differ.
    """
    lags, values = np.asarray(lags, dtype=float), np.asarray(values, dtype=float)
    same_length("lags", len(lags), values=values)
    x = lags if dt is None else lags * dt
    colour, _ = series_style(index)
    outside = (np.abs(values) > band) & ~((lags == 0) & (values > 0.999))
    size = 6 if len(lags) <= 50 else 4
    figure = new_figure(300, hovermode="closest")
    figure.add_hrect(y0=-band, y1=band, fillcolor=SLATE.faded(0.22), line_width=0, layer="below")
    gap = np.full(len(x), np.nan)
    stems = np.column_stack([x, x, gap]).ravel(), np.column_stack([0 * x, values, gap]).ravel()
    line(figure, stems[0], stems[1], colour, 1.2, showlegend=False)
    hover = "lag %{x:.4g}: %{y:.3f}<extra></extra>"
    for mask, name, shade, larger, symbol in (
        (~outside, f"inside the {100 * level:g} % band", colour, 0, "circle"),
        (outside, "outside", VERMILION if index != 1 else INK, 1, "diamond"),
    ):
        if mask.any():
            marker = {"symbol": symbol}
            dots(figure, x[mask], values[mask], shade, size + larger, hover=hover, name=name, marker=marker)
    top = max(1.15 * float(np.nanmax(values, initial=0.0)), 1.8 * band)
    bottom = min(1.15 * float(np.nanmin(values, initial=0.0)), -1.8 * band)
    upright = {"range": [max(bottom, -1.1), min(top, 1.1)], "zeroline": True, "zerolinecolor": SLATE.light}
    return axes(figure, f"lag [{'samples' if dt is None else 's'}]", f"{wrap(label, 24)} [-]", yaxis=upright)


def horizon_curves(curves: Mapping[str, HorizonErrors], channel: Channel) -> go.Figure:
    """RMSE over how far each model looks ahead, its free run as a dashed line.

    Raises ParameterError if there is no curve.

    Parameters
    ----------
    curves : mapping of str to HorizonErrors
        By model, from `slipangle.identify.judge.compare.horizon_errors`.
    channel : Channel
        Which output, and its unit.
    """
    if not curves:
        raise ParameterError("there is no curve to draw; got an empty mapping, expected at least one model: add one")
    figure = new_figure(360, hovermode="x unified")
    shown = sorted({float(f"{k * curve.dt:.3g}") for curve in curves.values() for k in curve.horizons})
    for i, (name, curve) in enumerate(curves.items()):
        column = curve.outputs.index(channel.name)
        colour, _ = series_style(i)
        seconds = curve.horizons * curve.dt
        line(figure, seconds, curve.rmse[:, column], colour, 2, name=escape(name), legendgroup=name, hovertemplate=None)
        figure.data[-1].update(mode="lines+markers")
        level = np.full(2, curve.free_run[column])
        line(figure, seconds[[0, -1]], level, colour, 1, dash="dash", legendgroup=name, showlegend=False)
    ticks = {"type": "log", "tickvals": shown, "ticktext": [*map("{:g}".format, shown)]}
    y = axis_title(channel, lines=2, prefix="RMSE of ")
    return axes(figure, "looking ahead [s]", y, xaxis=ticks, yaxis={"rangemode": "tozero"})


def forest(
    fit: FitInfo, *, references: Mapping[str, float] | None = None, level: float = 0.95, cap: float = 100.0
) -> go.Figure:
    """Confidence interval of each parameter, relative to its estimate.

    Parameters
    ----------
    fit : FitInfo
        Estimates and covariance.
    references : mapping, optional
        True or published values, drawn as diamonds on the same scale.
    level : float
        Confidence level.
    cap : float
        Intervals wider than this end in arrows that state the width. [%]
    """
    known = {k: v for k, v in (references or {}).items() if k in fit.names}
    interval, value = fit.interval(level), np.asarray(fit.values, dtype=float)
    scale = np.where(value != 0, np.abs(value), np.nan)
    none = [lost(v, float(np.ptp(ends)) / 2) for v, ends in zip(value, interval, strict=True)]  # of these no share is
    apart = np.where(np.isfinite(interval), interval - value[:, None], [-np.inf, np.inf])
    shares = 100 * apart / scale[:, None]
    ends = np.where(np.array(none)[:, None], np.where(apart == 0, 0.0, np.copysign(np.inf, apart)), shares)
    half = np.abs(ends).max(axis=1)  # of those below and above the estimate
    spot = {k: 100 * (v - value[fit.names.index(k)]) / scale[fit.names.index(k)] for k, v in known.items()}
    shown = [h for h in (*half, *np.abs(list(spot.values()))) if np.isfinite(h) and h <= cap]
    reach = 1.15 * max([*shown, 1.0]) if np.all(half <= cap) else 1.15 * cap
    units = fit.units or ("-",) * len(fit.names)
    read = [read_in(n, u) for n, u in zip(fit.names, units, strict=True)]
    figure = new_figure(110 + 38 * len(fit.names), hovermode="closest")
    rows = np.arange(len(fit.names))[::-1].astype(float)
    wide = ~(half <= cap)
    for k, row in enumerate(rows):
        span = np.clip(ends[k], -reach, reach)
        colour = VERMILION if wide[k] else INK
        line(figure, span, [row, row], colour, 2)
        if wide[k]:
            width = _between(interval[k], *read[k]) if none[k] else _width(*ends[k])
            beyond = np.abs(span) >= reach
            arrows = {"symbol": np.array(["triangle-left", "triangle-right"])[beyond].tolist()}
            dots(figure, span[beyond], np.full(beyond.sum(), row), colour, 10, marker=arrows)
            where = {"x": reach, "y": row, "xanchor": "right", "yshift": 13}
            figure.add_annotation(text=width, showarrow=False, font={"color": colour.light}, **where)
    figure.update_traces(showlegend=False)
    said = [f"{f * v:.5g} {escape(pretty_unit(u))}" for v, (f, u) in zip(value, read, strict=True)]
    name, hover = f"estimate, {100 * level:g} % interval", "%{customdata}<extra></extra>"
    colours = [(VERMILION if w else INK).light for w in wide]
    dots(figure, np.zeros(len(rows)), rows, colours, 9, hover=hover, name=name, customdata=said)
    if spot:
        x, y = np.clip(list(spot.values()), -reach, reach), [rows[fit.names.index(k)] for k in spot]
        factors = [read[fit.names.index(k)][0] for k in known]
        said = [f"{f * v:.5g}" for f, v in zip(factors, known.values(), strict=True)]
        open_ones = {"symbol": "diamond-open", "line": {"width": 2}}
        more = {"name": "reference", "customdata": said, "marker": open_ones}
        dots(figure, x, y, series_style(0)[0], 11, hover="reference %{customdata}<extra></extra>", **more)
    ticks = {"tickvals": rows, "ticktext": [escape(n) for n in fit.names], "range": [-0.7, len(rows) - 0.3]}
    return axes(
        figure,
        "difference from the estimate [%]",
        "",
        xaxis={"range": [-1.06 * reach, 1.06 * reach], "zeroline": True, "zerolinecolor": SLATE.light},
        yaxis={**ticks, "showline": False, "ticks": "", "fixedrange": True},
    )


def _between(ends: np.ndarray, factor: float, unit: str) -> str:
    """An interval around nothing in words, in the unit that people read."""
    low, high = (to_digit(factor * float(end), factor * float(np.ptp(ends)) / 2) for end in ends)
    return f"{low} to {high} {escape(pretty_unit(unit))}".removesuffix(" -")


def _width(below: float, above: float) -> str:
    """An interval beside its estimate in words, both ends in percent."""
    if not np.isfinite([below, above]).all():
        return "unbounded"
    return f"±{above:.0f} %" if abs(above + below) < 0.01 * above else f"{below:+.0f} to {above:+.0f} %"
