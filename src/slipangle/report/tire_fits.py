"""Figures of a fitted tire: how it follows its measurements, and what is left between them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import plotly.graph_objects as go

from slipangle.data.tire_data import TireData
from slipangle.errors import ModelWarning, ParameterError
from slipangle.models.tires.simple import Tire, TireForces
from slipangle.report import tire_figures
from slipangle.report.style import SLATE, axes, compact, dots, line, new_figure, series_style


def fit_figure(
    tire: Tire, data: TireData, quantity: tire_figures.Quantity, *, sweeps: int = 6, points: int = 4000
) -> go.Figure:
    """Measured samples and the fitted tire over slip, and what is left between them.

    F_x is drawn over slip ratio at small slip angles, the other quantities over slip angle at small slip ratios, for at
    most about so many loads as ``sweeps``, at the camber nearest to zero and one pressure, and so many ``points``.

    Raises ParameterError if the data hold no such quantity or no sweep of its slip.
    """
    tire_figures.require_quantity(quantity)
    if getattr(data, quantity) is None:
        raise ParameterError(f"'{data.name}' holds no {quantity}; expected a quantity that was measured")
    along = quantity == "F_x"
    still = np.abs(data.slip_angle) < math.radians(0.6) if along else np.abs(data.slip_ratio) < 0.01
    if not still.any() or np.ptp((data.slip_ratio if along else data.slip_angle)[still]) < 0.01:
        raise ParameterError(
            f"'{data.name}' holds no sweep of slip {'ratio' if along else 'angle'} alone; expected one to draw "
            f"{quantity}: join such a run"
        )
    part = data.rows(still).thinned(max(points * 4, 4000))
    figure = new_figure(560)
    for k, sweep in enumerate(_chosen(part, sweeps)):
        rows = part.rows(sweep.rows).thinned(max(points // sweeps, 50))
        slip = rows.slip_ratio if along else rows.slip_angle
        x = tire_figures.shown_slip(slip, along=along)
        colour, dash = series_style(k)
        at_samples = np.broadcast_to(getattr(predicted(tire, rows), quantity), slip.shape)
        name = tire_figures.force_text(sweep.load)
        faint: dict[str, Any] = {"hover": "%{y:.4g}", "legendgroup": name, "showlegend": False}
        faint["marker"] = {"opacity": 0.45}
        dots(figure, compact(x), getattr(rows, quantity), colour, name=f"measured, {name}", **faint)
        order = np.argsort(slip)
        level = np.linspace(slip.min(), slip.max(), tire_figures.POINTS)
        smooth = predicted(tire, _level(rows, level, along=along))
        fitted, shared = np.broadcast_to(getattr(smooth, quantity), level.shape), {"name": name, "legendgroup": name}
        at = compact(tire_figures.shown_slip(level, along=along))
        line(figure, at, fitted, colour, 2, dash=dash, hovertemplate="%{y:.4g}", **shared)
        left = (getattr(rows, quantity) - at_samples)[order]
        dots(figure, compact(x[order]), left, colour, yaxis="y2", name=f"residual, {name}", **faint)
    unit = tire_figures.QUANTITIES[quantity][1]
    return _two_panels(figure, tire_figures.quantity_title(quantity), f"residual<br>[{unit}]", along=along)


def curve_figure(
    slip: np.ndarray,
    friction: np.ndarray,
    curves: Mapping[str, Callable[[np.ndarray], np.ndarray]],
    *,
    along: bool,
    friction_title: str = "friction coefficient μ [-]",
) -> go.Figure:
    """Measured friction over slip, fitted curves, and what each of them leaves.

    ``slip`` is a slip ratio [-] where ``along``, else a slip angle [rad], drawn in degrees; ``friction`` is force over
    load [-], shape (n,) both; ``curves`` are functions of slip by name.
    """
    x = tire_figures.shown_slip(np.asarray(slip, dtype=float), along=along)
    figure = new_figure(520, hovermode="x unified")
    dots(figure, compact(x), friction, SLATE, hover="%{y:.4g}", name="data", marker={"opacity": 0.6})
    fine = np.linspace(np.min(slip), np.max(slip), 401)
    at = compact(tire_figures.shown_slip(fine, along=along))
    below: dict[str, Any] = {"hover": "%{y:.4g}", "yaxis": "y2", "showlegend": False}
    for k, (name, curve) in enumerate(curves.items()):
        colour, dash = series_style(k)
        shared = {"name": name, "legendgroup": name, "hovertemplate": "%{y:.4g}"}
        line(figure, at, curve(fine), colour, 1.8, dash=dash, **shared)
        left = friction - curve(np.asarray(slip, dtype=float))
        dots(figure, compact(x), left, colour, 3, name=f"residual of {name}", legendgroup=name, **below)
    return _two_panels(figure, friction_title, "residual [-]", along=along)


def _two_panels(figure: go.Figure, above: str, below: str, *, along: bool) -> go.Figure:
    lower = {"title": {"text": below}, "domain": [0.0, 0.28], "zeroline": True}
    shape: dict[str, Any] = {"xaxis": {"anchor": "y2"}, "yaxis": {"domain": [0.36, 1.0]}, "yaxis2": lower}
    return axes(figure, tire_figures.slip_title(along=along), above, showlegend=True, **shape)


def residual_histogram(tire: Tire, data: TireData, quantity: tire_figures.Quantity) -> go.Figure:
    """How the residuals of all samples are distributed."""
    tire_figures.require_quantity(quantity)
    if getattr(data, quantity) is None:
        raise ParameterError(f"'{data.name}' holds no {quantity}; expected a quantity that was measured")
    error = getattr(data, quantity) - np.broadcast_to(getattr(predicted(tire, data), quantity), data.load.shape)
    reach = 1.02 * float(np.quantile(np.abs(error), 0.998))
    count, edges = np.histogram(error, bins=61, range=(-reach, reach))
    colour, _ = series_style(0)
    figure = new_figure(300, bargap=0.05)
    figure.add_bar(x=(edges[1:] + edges[:-1]) / 2, y=count, marker={"color": colour.light}, name="samples")
    return axes(figure, f"residual of {tire_figures.quantity_title(quantity)}", "samples", showlegend=False)


def predicted(tire: Tire, data: TireData) -> TireForces:
    """Forces at the conditions of the data, pressure included where the tire knows it."""
    with warnings.catch_warnings(action="ignore", category=ModelWarning):
        return tire.unlimited().forces_at(
            data.slip_ratio, data.slip_angle, data.load, camber=data.gamma, pressure=data.pressure
        )


def _chosen(data: TireData, count: int) -> list[Any]:
    """Sweeps at the camber nearest to zero and at one pressure, spread over the loads."""
    sweeps = data.sweeps()
    if not sweeps:
        raise ParameterError(
            f"'{data.name}' holds no sweep of 20 samples at one load; expected one: widen the tolerance"
        )
    camber = min((s.camber for s in sweeps), key=abs)
    same = [s for s in sweeps if abs(s.camber - camber) < math.radians(0.7)]
    if same[0].pressure is not None:
        middle = float(np.median([s.pressure for s in same if s.pressure is not None]))
        pressure = min((s.pressure for s in same if s.pressure is not None), key=lambda p: abs(p - middle))
        same = [s for s in same if s.pressure is not None and abs(s.pressure - pressure) < 3e3]
    if len(same) <= count:
        return same
    return [same[round(k)] for k in np.linspace(0, len(same) - 1, count)]


def _level(rows: TireData, slip: np.ndarray, *, along: bool) -> TireData:
    """Means of a sweep's conditions, with the slip on a grid."""

    def constant(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else np.full(len(slip), float(values.mean()))

    still = 0.0 * slip
    return replace(
        rows.rows(np.zeros(len(slip), dtype=int)),
        slip_ratio=slip if along else still,
        slip_angle=still if along else slip,
        load=constant(rows.load),
        camber=constant(rows.gamma),
        pressure=constant(rows.pressure),
    )
