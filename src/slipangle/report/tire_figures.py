"""Figures of a tire: forces over slip and load, combined slip, and how a fit follows its measurements."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import plotly.graph_objects as go

from slipangle.data.tire_data import TireData
from slipangle.errors import ModelWarning, ParameterError, nearest
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.models.tires.neural import NeuralTire
from slipangle.models.tires.simple import Tire, TireForces, practical_slip
from slipangle.report.style import SLATE, EqualScale, compact, escape, new_figure, series_style

__all__ = [
    "OperatingRange",
    "combined_slip",
    "curve_figure",
    "fit_figure",
    "predicted",
    "pure_slip",
    "residual_histogram",
]

Quantity = Literal["F_x", "F_y", "M_x", "M_z"]
QUANTITIES = {
    "F_x": ("longitudinal force F_x", "N"),
    "F_y": ("lateral force F_y", "N"),
    "M_x": ("overturning moment M_x", "N m"),
    "M_z": ("aligning moment M_z", "N m"),
}
_POINTS = 201


@dataclass(frozen=True, kw_only=True)
class OperatingRange:
    """Where a tire is drawn: largest slip ratio [-], largest slip angle [rad], loads [N]."""

    slip_ratio: float = 0.3
    slip_angle: float = math.radians(15.0)
    loads: tuple[float, ...] = (2000.0, 4000.0, 6000.0)

    @classmethod
    def of(cls, tire: Tire, *, loads: Sequence[float] = ()) -> OperatingRange:
        """What the tire's file or training data are valid for, at the given loads or at some inside that range."""
        default = cls()
        ratio, angle, chosen = default.slip_ratio, default.slip_angle, tuple(float(v) for v in loads)
        if isinstance(tire, MagicFormulaTire):
            limits = tire.limits
            ratio = min(ratio, *(abs(v) / (1 + abs(v)) for v in limits.slip_ratio))
            angle = min(angle, *(abs(v) for v in limits.slip_angle))
            nominal = float(tire.coefficients.FNOMIN)
            low, high = max(limits.load[0], 0.25 * nominal), min(limits.load[1], 2.0 * nominal)
            chosen = chosen or tuple(_round(v) for v in np.linspace(low, high, 4))
            chosen = tuple(min(max(v, limits.load[0]), limits.load[1]) for v in chosen)
        elif isinstance(tire, NeuralTire):
            ratio = min(abs(v) for v in tire.longitudinal.range)
            angle = min(abs(v) for v in tire.lateral.range)
            scaling = tire.lateral.network.input_scaling
            if not chosen and "load" in tire.lateral.inputs:
                k = tire.lateral.inputs.index("load")
                middle, half = float(scaling.offset[k]), abs(float(scaling.factor[k]))
                chosen = tuple(_round(v) for v in np.linspace(middle - 0.9 * half, middle + 0.9 * half, 4))
        return cls(slip_ratio=ratio, slip_angle=angle, loads=chosen or default.loads)


def pure_slip(
    tire: Tire,
    quantity: Quantity,
    *,
    over: Literal["slip_ratio", "slip_angle"] | None = None,
    loads: Sequence[float] = (),
    camber: float = 0.0,
) -> go.Figure:
    """A force or moment over slip in one direction, one line per load.

    Parameters
    ----------
    tire : Tire
        Any tire.
    quantity : {"F_x", "F_y", "M_x", "M_z"}
        What is drawn.
    over : {"slip_ratio", "slip_angle"}, optional
        The slip that moves, the other being zero; by default the one that the quantity goes with.
    loads : sequence of float
        Vertical loads; by default some inside the range of the tire. [N]
    camber : float
        Inclination. [rad]

    Raises
    ------
    ParameterError
        If there is no such quantity.
    """
    _known(quantity)
    along = (over or ("slip_ratio" if quantity == "F_x" else "slip_angle")) == "slip_ratio"
    where = OperatingRange.of(tire, loads=loads)
    figure = new_figure(420, hovermode="x unified")
    reach = where.slip_ratio if along else where.slip_angle
    slip = np.linspace(-reach, reach, _POINTS)
    for k, load in enumerate(where.loads):
        s, a = (slip, 0.0 * slip) if along else (0.0 * slip, slip)
        value = getattr(forces(tire, s, a, np.full(_POINTS, load), camber), quantity)
        colour, dash = series_style(k)
        figure.add_scatter(
            x=_shown(slip, along=along),
            y=compact(np.broadcast_to(value, slip.shape)),
            name=force_text(load),
            mode="lines",
            line={"color": colour.light, "width": 1.8, "dash": dash},
            hovertemplate="%{y:.4g}",
        )
    figure.update_layout(
        xaxis={"title": {"text": _slip_title(along=along)}},
        yaxis={"title": {"text": _title(quantity)}},
        showlegend=True,
    )
    return figure


def combined_slip(tire: Tire, *, load: float | None = None, camber: float = 0.0) -> go.Figure:
    """Lateral over longitudinal force: lines of constant slip angle while the slip ratio runs, axes of equal scale.

    Parameters
    ----------
    tire : Tire
        Any tire; one without combined slip shows rectangles.
    load : float, optional
        Vertical load; by default the middle one of its range. [N]
    camber : float
        Inclination. [rad]
    """
    where = OperatingRange.of(tire, loads=() if load is None else (load,))
    weight = where.loads[len(where.loads) // 2]
    # sweep slowly around zero, where the force changes most
    ratio = where.slip_ratio * np.sign(np.linspace(-1, 1, 301)) * np.abs(np.linspace(-1, 1, 301)) ** 1.8
    share = np.array([0.1, 0.25, 0.5, 1.0])
    figure = new_figure(560)
    extent = []
    for k, part in enumerate(share):
        colour, dash = series_style(k)
        angle = part * where.slip_angle
        for side in (1.0, -1.0):
            f = forces(tire, ratio, np.full_like(ratio, side * angle), np.full_like(ratio, weight), camber)
            extent.append((np.abs(f.F_x).max(), np.abs(f.F_y).max()))
            figure.add_scatter(
                x=compact(np.broadcast_to(f.F_x, ratio.shape)),
                y=compact(np.broadcast_to(f.F_y, ratio.shape)),
                mode="lines",
                name=f"slip angle ±{math.degrees(angle):.2g}°",
                legendgroup=str(k),
                showlegend=side > 0,
                line={"color": colour.light, "width": 1.6, "dash": dash},
                customdata=ratio,
                hovertemplate="F<sub>x</sub> %{x:.4g} N, F<sub>y</sub> %{y:.4g} N, slip ratio %{customdata:.3f}",
            )
    reach_x, reach_y = (1.06 * float(max(column)) for column in zip(*extent, strict=True))
    frame = 120.0
    scale = EqualScale(ratio=reach_y / max(reach_x, 1e-9), frame=frame)
    figure.update_layout(
        height=scale.height(),
        meta=scale.meta,
        xaxis={"title": {"text": _title("F_x")}, "range": [-reach_x, reach_x], "zeroline": True, "constrain": "domain"},
        yaxis={
            "title": {"text": _title("F_y")},
            "range": [-reach_y, reach_y],
            "zeroline": True,
            "scaleanchor": "x",
            "scaleratio": 1,
            "constrain": "domain",
        },
        showlegend=True,
    )
    return figure


def fit_figure(tire: Tire, data: TireData, quantity: Quantity, *, sweeps: int = 6, points: int = 4000) -> go.Figure:
    """Measured samples and the fitted tire over slip, and what is left between them.

    Parameters
    ----------
    tire : Tire
        Fitted tire.
    data : TireData
        Measurements.
    quantity : {"F_x", "F_y", "M_x", "M_z"}
        What is drawn; F_x over slip ratio at small slip angles, the others over slip angle at small slip ratios.
    sweeps : int
        At most about so many loads are drawn, at the camber nearest to zero and one pressure.
    points : int
        At most about so many samples are drawn.

    Raises
    ------
    ParameterError
        If the data hold no such quantity or no sweep of its slip.
    """
    _known(quantity)
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
        x = _shown(slip, along=along)
        colour, dash = series_style(k)
        at_samples = np.broadcast_to(getattr(predicted(tire, rows), quantity), slip.shape)
        name = force_text(sweep.load)
        marker = {"color": colour.light, "size": 4, "opacity": 0.45}
        figure.add_scatter(
            x=compact(x),
            y=compact(getattr(rows, quantity)),
            mode="markers",
            name=f"measured, {name}",
            marker=marker,
            legendgroup=name,
            showlegend=False,
            hovertemplate="%{y:.4g}",
        )
        order = np.argsort(slip)
        level = np.linspace(slip.min(), slip.max(), _POINTS)
        smooth = predicted(tire, _level(rows, level, along=along))
        figure.add_scatter(
            x=compact(_shown(level, along=along)),
            y=compact(np.broadcast_to(getattr(smooth, quantity), level.shape)),
            mode="lines",
            name=name,
            line={"color": colour.light, "width": 2, "dash": dash},
            legendgroup=name,
            hovertemplate="%{y:.4g}",
        )
        figure.add_scatter(
            x=compact(x[order]),
            y=compact((getattr(rows, quantity) - at_samples)[order]),
            mode="markers",
            marker=marker,
            legendgroup=name,
            showlegend=False,
            yaxis="y2",
            name=f"residual, {name}",
            hovertemplate="%{y:.4g}",
        )
    unit = QUANTITIES[quantity][1]
    figure.update_layout(
        xaxis={"title": {"text": _slip_title(along=along)}, "anchor": "y2"},
        yaxis={"title": {"text": _title(quantity)}, "domain": [0.36, 1.0]},
        yaxis2={"title": {"text": f"residual<br>[{unit}]"}, "domain": [0.0, 0.28], "zeroline": True},
        showlegend=True,
    )
    return figure


def curve_figure(
    slip: np.ndarray,
    friction: np.ndarray,
    curves: Mapping[str, Callable[[np.ndarray], np.ndarray]],
    *,
    along: bool,
    friction_title: str = "friction coefficient μ [-]",
) -> go.Figure:
    """Measured friction over slip, fitted curves, and what each of them leaves.

    Parameters
    ----------
    slip : array, shape (n,)
        Slip ratio [-] or slip angle [rad].
    friction : array, shape (n,)
        Force over load. [-]
    curves : mapping of str to function of slip
        Fitted curves by name.
    along : bool
        Whether the slip is a slip ratio; a slip angle is drawn in degrees.
    friction_title : str
        Title of the ordinate.
    """
    x = _shown(np.asarray(slip, dtype=float), along=along)
    figure = new_figure(520, hovermode="x unified")
    figure.add_scatter(
        x=compact(x),
        y=compact(friction),
        mode="markers",
        name="data",
        marker={"color": SLATE.light, "size": 4, "opacity": 0.6},
        hovertemplate="%{y:.4g}",
    )
    fine = np.linspace(np.min(slip), np.max(slip), 401)
    for k, (name, curve) in enumerate(curves.items()):
        colour, dash = series_style(k)
        line = {"color": colour.light, "width": 1.8, "dash": dash}
        shared = {"legendgroup": name, "hovertemplate": "%{y:.4g}"}
        figure.add_scatter(
            x=compact(_shown(fine, along=along)), y=compact(curve(fine)), mode="lines", name=name, line=line, **shared
        )
        figure.add_scatter(
            x=compact(x),
            y=compact(friction - curve(np.asarray(slip, dtype=float))),
            mode="markers",
            name=f"residual of {name}",
            marker={"color": colour.light, "size": 3},
            yaxis="y2",
            showlegend=False,
            **shared,
        )
    figure.update_layout(
        xaxis={"title": {"text": _slip_title(along=along)}, "anchor": "y2"},
        yaxis={"title": {"text": friction_title}, "domain": [0.36, 1.0]},
        yaxis2={"title": {"text": "residual [-]"}, "domain": [0.0, 0.28], "zeroline": True},
        showlegend=True,
    )
    return figure


def residual_histogram(tire: Tire, data: TireData, quantity: Quantity) -> go.Figure:
    """How the residuals of all samples are distributed."""
    _known(quantity)
    if getattr(data, quantity) is None:
        raise ParameterError(f"'{data.name}' holds no {quantity}; expected a quantity that was measured")
    error = getattr(data, quantity) - np.broadcast_to(getattr(predicted(tire, data), quantity), data.load.shape)
    reach = 1.02 * float(np.quantile(np.abs(error), 0.998))
    count, edges = np.histogram(error, bins=61, range=(-reach, reach))
    colour, _ = series_style(0)
    figure = new_figure(300, bargap=0.05)
    figure.add_bar(x=(edges[1:] + edges[:-1]) / 2, y=count, marker={"color": colour.light}, name="samples")
    figure.update_layout(
        xaxis={"title": {"text": f"residual of {_title(quantity)}"}},
        yaxis={"title": {"text": "samples"}},
        showlegend=False,
    )
    return figure


def forces(tire: Tire, ratio: Any, angle: Any, load: Any, camber: float) -> TireForces:
    """Forces without complaint about limits."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)  # what is drawn lies inside the range wherever it is known
        loose = replace(tire, outside="extrapolate") if isinstance(tire, MagicFormulaTire) else tire
        return loose.forces(ratio, angle, load, camber=camber)


def predicted(tire: Tire, data: TireData) -> TireForces:
    """Forces at the conditions of the data, pressure included where the tire knows it."""
    if not isinstance(tire, MagicFormulaTire):
        return tire.forces(data.slip_ratio, data.slip_angle, data.load, camber=data.gamma)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        found = replace(tire, outside="extrapolate").evaluate(
            practical_slip(data.slip_ratio),
            -data.slip_angle,
            data.load,
            axes="ISO-W",
            camber=data.gamma,
            pressure=data.pressure,
        )
    return TireForces(*found[:5])


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


def _shown(slip: np.ndarray, *, along: bool) -> np.ndarray:
    return slip if along else np.rad2deg(slip)


def _slip_title(*, along: bool) -> str:
    return "slip ratio s [-]" if along else "slip angle α [deg]"


def _title(quantity: str) -> str:
    words, unit = QUANTITIES[quantity]
    name, _, index = words.rpartition(" ")[2].partition("_")
    return f"{words.rpartition(' ')[0]} {name}<sub>{index}</sub> [{escape(unit)}]"


def force_text(load: float) -> str:
    """A load in newtons or kilonewtons.

    >>> force_text(850.0), force_text(4200.0)
    ('850 N', '4.2 kN')
    """
    return f"{load / 1000:.3g} kN" if load >= 1000 else f"{load:.3g} N"


def _round(value: float) -> float:
    return float(f"{value:.2g}")


def _known(quantity: str) -> None:
    if quantity not in QUANTITIES:
        raise ParameterError(
            f"a tire has no quantity '{quantity}'; {nearest(quantity, QUANTITIES)}: use one of these names"
        )
