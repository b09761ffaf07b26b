"""Figures and tables of linear analysis: Bode, Nyquist, responses over time, handling over speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from slipangle.models.analysis.handling import QUANTITIES, Handling
from slipangle.models.analysis.linearised import LinearisedModel
from slipangle.models.analysis.responses import FrequencyResponse, TimeResponse
from slipangle.numerics.critical import quantile
from slipangle.report.style import (
    INK,
    SLATE,
    Colour,
    axes,
    dots,
    escape,
    line,
    new_figure,
    pretty_unit,
    series_style,
    wrap,
)
from slipangle.report.tables import Heading, Row, Table, number, to_digit
from slipangle.units import read_in, shows_si, speed_said

_DEG = 180 / np.pi
_FACTOR = np.exp(quantile(0.95))  # from the line to the ends of the widest band
# Quantities as people read them: factor and unit.
_READ = {
    "rad/(m/s2)": (_DEG, "deg/(m/s2)"),
    "(rad/s)/rad": (1.0, "1/s"),
    "(m/s2)/rad": (1 / _DEG, "(m/s2)/deg"),
    "rad/rad": (1.0, "-"),
    "rad s": (_DEG, "deg s"),
    "rad/s": (1 / (2 * np.pi), "Hz"),
    "s": (1000.0, "ms"),
}


def _read(unit: str) -> tuple[float, str]:
    """Factor and unit in which people read a quantity."""
    return (1.0, unit) if shows_si() else _READ.get(unit, (1.0, unit))


def _look(place: int) -> tuple[Colour, str]:
    """Colour and dash of a model by its place among all of a page; before the first is what was measured."""
    return (INK, "solid") if place < 0 else series_style(place)


def _band(figure: go.Figure, x: np.ndarray, band: np.ndarray, index: int, axis: str = "y", **more: Any) -> None:
    """A band in the colour of the ``index``-th line; nothing where it is not known."""
    if not np.isfinite(band).all():
        return
    colour, _ = _look(index)
    there, back = np.concatenate([x, x[::-1]]), np.concatenate([band[:, 0], band[::-1, 1]])
    line(
        figure, there, back, colour, 0, fill="toself", fillcolor=colour.faded(0.2), showlegend=False, yaxis=axis, **more
    )


def bode(responses: Sequence[FrequencyResponse], places: Sequence[int] = ()) -> go.Figure:
    """Magnitude and phase over frequency with bands; coherence below where data gave one.

    ``places`` are those of the models in other figures, whose colours they keep, -1 is what was measured.
    Bands end at a factor of 7 and a phase of 180 degrees: what is less sure than that is not known.
    """
    figure = new_figure(560, hovermode="closest")
    seen = any(r.coherence is not None for r in responses)
    turn, angle = read_in("", "rad")
    for index, one in zip(places or range(len(responses)), responses, strict=True):
        colour, dash = _look(index)
        name = escape(one.name)
        own: dict[str, Any] = {"legendgroup": name, "name": name}
        gain, turned = one.magnitude[:, None], one.phase[:, None]
        with np.errstate(over="ignore"):
            shown = np.clip(one.magnitude_band(), gain / _FACTOR, gain * _FACTOR)
        _band(figure, one.frequency, shown, index, legendgroup=name)
        hover = "%{x:.3g} Hz: %{y:.4g}"
        line(figure, one.frequency, one.magnitude, colour, dash=dash, hovertemplate=hover, **own)
        below: dict[str, Any] = {"yaxis": "y2", "showlegend": False}
        _band(
            figure,
            one.frequency,
            turn * np.clip(one.phase_band(), turned - np.pi, turned + np.pi),
            index,
            "y2",
            legendgroup=name,
        )
        line(figure, one.frequency, turn * one.phase, colour, dash=dash, hovertemplate=hover, **own, **below)
        if one.coherence is not None:
            last: dict[str, Any] = {"yaxis": "y3", "showlegend": False}
            line(figure, one.frequency, one.coherence, colour, dash=dash, hovertemplate=hover, **own, **last)
    first = responses[0]
    heights = ([0.62, 1.0], [0.26, 0.56], [0.0, 0.2]) if seen else ([0.52, 1.0], [0.0, 0.44], None)
    title = f"gain {escape(first.input)} to {escape(first.output)}"
    above = {"type": "log", "domain": heights[0], "dtick": "D2"}
    phase = {
        "title": {"text": f"phase [{angle}]"},
        "domain": heights[1],
        "zeroline": True,
        "zerolinecolor": SLATE.light,
    }
    more: dict[str, Any] = {"yaxis2": phase}
    if heights[2]:
        more["yaxis3"] = {"title": {"text": "coherence"}, "domain": heights[2], "range": [0, 1.05]}
    across = {"type": "log", "dtick": "D2", "anchor": "y3" if heights[2] else "y2"}
    return axes(figure, "frequency [Hz]", f"{title}<br>[{pretty_unit(first.unit)}]", xaxis=across, yaxis=above, **more)


def nyquist(responses: Sequence[FrequencyResponse]) -> go.Figure:
    """The responses in the complex plane, axes of equal scale."""
    figure = new_figure(460, hovermode="closest")
    for index, one in enumerate(responses):
        colour, dash = series_style(index)
        text = [f"{f:.3g} Hz" for f in one.frequency]
        value: Any = one.value
        hover = "%{text}: %{x:.4g} + %{y:.4g} j"
        name = escape(one.name)
        line(figure, value.real, value.imag, colour, dash=dash, name=name, text=text, hovertemplate=hover)
    dots(figure, [0.0], [0.0], SLATE, 6, showlegend=False)
    unit = pretty_unit(responses[0].unit)
    upright = {"scaleanchor": "x", "zeroline": True, "zerolinecolor": SLATE.light}
    return axes(figure, f"real part [{unit}]", f"imaginary part [{unit}]", yaxis=upright)


def time_responses(responses: Sequence[TimeResponse]) -> go.Figure:
    """Responses over time with their bands, the steady state dotted."""
    figure = new_figure(380, hovermode="closest")
    for index, one in enumerate(responses):
        colour, dash = series_style(index)
        name = escape(one.name)
        _band(figure, one.t, one.band(), index, legendgroup=name)
        hover = "%{x:.3g} s: %{y:.4g}"
        line(figure, one.t, one.y, colour, dash=dash, name=name, legendgroup=name, hovertemplate=hover)
        if one.kind == "step" and np.isfinite(one.final):
            line(figure, one.t[[0, -1]], np.full(2, one.final), SLATE, 1, dash="dot", showlegend=False)
    first = responses[0]
    title = f"{first.kind} {escape(first.input)} to {escape(first.output)} [{pretty_unit(first.unit)}]"
    return axes(figure, "time t [s]", title)


def handling_curves(several: Sequence[Handling], names: Sequence[str] = (), places: Sequence[int] = ()) -> go.Figure:
    """Quantities over speed below each other, with bands; by default gradient, gain, frequency, damping, rise time.

    ``places`` are those of the models in other figures, whose colours they keep.
    """
    usual = ("understeer_gradient", "yaw_gain", "natural_frequency", "damping", "rise_time")
    chosen = [n for n in (names or usual) if any(np.isfinite(h.values[n]).any() for h in several)] or list(usual[:2])
    figure = new_figure(40 + 170 * len(chosen), hovermode="closest")
    rows = len(chosen)
    layout: dict[str, Any] = {}
    fast, speed = read_in("v_x", "m/s")
    for k, name in enumerate(chosen):
        what = QUANTITIES[name]
        factor, unit = _read(what.unit)
        axis = "y" if k == 0 else f"y{k + 1}"
        domain = [1 - (k + 1) / rows + (0.04 if k < rows - 1 else 0.0), 1 - k / rows - 0.02]
        title = {"text": f"{wrap(what.title, 18)}<br>[{pretty_unit(unit)}]", "font": {"size": 11}}
        layout["yaxis" + axis[1:]] = {"title": title, "domain": domain}
        for index, one in zip(places or range(len(several)), several, strict=True):
            colour, dash = _look(index)
            own: dict[str, Any] = {
                "name": escape(one.name),
                "legendgroup": one.name,
                "showlegend": k == 0 and len(several) > 1,
            }
            _band(figure, fast * one.v_x, factor * one.band(name), index, axis, legendgroup=one.name)
            hover = f"%{{x:.3g}} {speed}: %{{y:.4g}}"
            y = factor * one.values[name]
            line(figure, fast * one.v_x, y, colour, dash=dash, yaxis=axis, hovertemplate=hover, **own)
    layout["xaxis"] = {"title": {"text": f"speed [{speed}]"}, "anchor": "y" if rows == 1 else f"y{rows}"}
    return figure.update_layout(**layout)


def handling_table(handling: Handling, v_x: float | None = None) -> Table:
    """Quantities at the speed nearest to one [m/s], in the units that people read, and the standard of each."""
    middle = len(handling.v_x) // 2 if v_x is None else int(np.argmin(np.abs(handling.v_x - v_x)))
    rows = []
    for name, what in QUANTITIES.items():
        factor, unit = _read(what.unit)
        value, std = factor * handling.values[name][middle], factor * handling.stds[name][middle]
        rows.append(_row(what.title, value, std, unit, what.standard))
    for name in ("characteristic", "critical"):
        speed = getattr(handling, f"{name}_speed")
        if np.isfinite(speed.value) and not speed.value < quantile(0.95) * speed.std:  # else it may be of either kind
            factor, unit = read_in("v_x", "m/s")
            rows.append(_row(f"{name} speed", factor * speed.value, factor * speed.std, unit, "ISO 4138"))
    columns = Heading("quantity", words=True), Heading("value"), Heading("± 95 %"), Heading("unit", words=True)
    return Table(
        title=f"Handling of {handling.name} at {speed_said(handling.v_x[middle])}",
        columns=(*columns, Heading("defined in", words=True)),
        rows=tuple(rows),
        caption=f"{handling.uncertainty[:1].upper()}{handling.uncertainty[1:]}." if handling.uncertainty else "",
    )


def _row(title: str, value: float, std: float, unit: str, standard: str) -> Row:
    half = float(quantile(0.95) * std)
    shown = "–" if np.isnan(value) else to_digit(float(value), half)
    return Row((title, shown, number(half, 2) if np.isfinite(half) else "–", pretty_unit(unit), standard))


def modes_table(model: LinearisedModel) -> Table:
    """Poles with natural frequency and damping, how sure each is, and a mark for those that grow."""
    frequency_std, damping_std = model.pole_std()
    rows = []
    for k, pole in enumerate(model.poles):
        if pole.imag < 0:
            continue
        turns = f" ± {abs(pole.imag):.4g} j" if pole.imag else ""
        sure = [
            f" ± {quantile(0.95) * std:.2g}" if np.isfinite(std) else ""
            for std in (frequency_std[k] / (2 * np.pi), damping_std[k])
        ]
        size = model.natural_frequency[k] / (2 * np.pi)
        cells = f"{pole.real:.4g}{turns}", f"{size:.4g}{sure[0]}", f"{model.damping[k]:.4g}{sure[1]}"
        rows.append(Row(cells, tone="poor" if model.rates[k].real > 1e-9 else None))
    unit = "" if model.dt else "rad/s"
    place = "" if model.trim.v_x is None else f" at {speed_said(model.trim.v_x)}, {model.trim.a_y:.3g} m/s²"
    return Table(
        title=f"Poles of {model.name}{place}",
        columns=(Heading("pole", unit), Heading("natural frequency", "Hz"), Heading("damping ratio", "-")),
        rows=tuple(rows),
        caption=f"{model.uncertainty[:1].upper()}{model.uncertainty[1:]}." if model.uncertainty else "",
    )
