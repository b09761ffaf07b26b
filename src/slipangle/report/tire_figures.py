"""Figures of a tire: forces over slip and load, combined slip."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import plotly.graph_objects as go

from slipangle.errors import ModelWarning, ParameterError, nearest
from slipangle.models.tires.simple import Tire, TireForces
from slipangle.report.style import EqualScale, axes, compact, escape, line, new_figure, series_style

Quantity = Literal["F_x", "F_y", "M_x", "M_z"]
QUANTITIES = {
    "F_x": ("longitudinal force F_x", "N"),
    "F_y": ("lateral force F_y", "N"),
    "M_x": ("overturning moment M_x", "N m"),
    "M_z": ("aligning moment M_z", "N m"),
}
POINTS = 201


@dataclass(frozen=True, kw_only=True)
class OperatingRange:
    """Where a tire is drawn: largest slip ratio [-], largest slip angle [rad], loads [N]."""

    slip_ratio: float = 0.3
    slip_angle: float = math.radians(15.0)
    loads: tuple[float, ...] = (2000.0, 4000.0, 6000.0)

    @classmethod
    def of(cls, tire: Tire, *, loads: Sequence[float] = ()) -> OperatingRange:
        """What the tire's file or training data are valid for, at the given loads or at some inside that range."""
        known, chosen = tire.known_range, tuple(float(v) for v in loads)
        if not chosen and known.usual is not None:
            chosen = tuple(_round(v) for v in np.linspace(*known.usual, 4))
        chosen = tuple(min(max(v, known.limits[0]), known.limits[1]) for v in chosen or cls().loads)
        return cls(slip_ratio=known.slip_ratio, slip_angle=known.slip_angle, loads=chosen)


def pure_slip(
    tire: Tire,
    quantity: Quantity,
    *,
    over: Literal["slip_ratio", "slip_angle"] | None = None,
    loads: Sequence[float] = (),
    camber: float = 0.0,
) -> go.Figure:
    """A force or moment over slip in one direction, one line per load.

    ``over`` is the slip that moves, the other being zero, by default the one that the quantity goes with; loads [N] are
    by default some inside the range of the tire; ``camber`` is in rad.

    Raises ParameterError if there is no such quantity.
    """
    require_quantity(quantity)
    along = (over or ("slip_ratio" if quantity == "F_x" else "slip_angle")) == "slip_ratio"
    where = OperatingRange.of(tire, loads=loads)
    figure = new_figure(420, hovermode="x unified")
    reach = where.slip_ratio if along else where.slip_angle
    slip = np.linspace(-reach, reach, POINTS)
    for k, load in enumerate(where.loads):
        s, a = (slip, 0.0 * slip) if along else (0.0 * slip, slip)
        value = getattr(forces(tire, s, a, np.full(POINTS, load), camber), quantity)
        colour, dash = series_style(k)
        x, y = shown_slip(slip, along=along), np.broadcast_to(value, slip.shape)
        line(figure, x, y, colour, 1.8, dash=dash, name=force_text(load), hovertemplate="%{y:.4g}")
    return axes(figure, slip_title(along=along), quantity_title(quantity), showlegend=True)


def combined_slip(tire: Tire, *, load: float | None = None, camber: float = 0.0) -> go.Figure:
    """Lateral over longitudinal force: lines of constant slip angle while the slip ratio runs, axes of equal scale.

    A tire without combined slip shows rectangles. The load [N] is by default the middle one of its range; ``camber`` is
    in rad.
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
            x, y = (np.broadcast_to(force, ratio.shape) for force in (f.F_x, f.F_y))
            shared = {"name": f"slip angle ±{math.degrees(angle):.2g}°", "legendgroup": str(k), "showlegend": side > 0}
            hover = "F<sub>x</sub> %{x:.4g} N, F<sub>y</sub> %{y:.4g} N, slip ratio %{customdata:.3f}"
            line(figure, compact(x), y, colour, dash=dash, customdata=ratio, hovertemplate=hover, **shared)
    reach_x, reach_y = (1.06 * float(max(column)) for column in zip(*extent, strict=True))
    scale = EqualScale(ratio=reach_y / max(reach_x, 1e-9), frame=120.0)
    shared = {"zeroline": True, "constrain": "domain"}
    x, y = {"range": [-reach_x, reach_x], **shared}, {"range": [-reach_y, reach_y], "scaleanchor": "x", **shared}
    size = {"height": scale.height(), "meta": scale.meta, "showlegend": True}
    return axes(figure, quantity_title("F_x"), quantity_title("F_y"), xaxis=x, yaxis=y, **size)


def forces(tire: Tire, ratio: Any, angle: Any, load: Any, camber: float) -> TireForces:
    """Forces without complaint about limits."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)  # what is drawn lies inside the range wherever it is known
        return tire.unlimited().forces(ratio, angle, load, camber=camber)


def shown_slip(slip: np.ndarray, *, along: bool) -> np.ndarray:
    """Slip ratio as it is, slip angle in degrees."""
    return slip if along else np.rad2deg(slip)


def slip_title(*, along: bool) -> str:
    """Title of an axis of slip ratio or slip angle."""
    return "slip ratio s [-]" if along else "slip angle α [deg]"


def quantity_title(quantity: str) -> str:
    """Title of an axis of a force or moment."""
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


def require_quantity(quantity: str) -> None:
    """Raise a ParameterError unless a tire has such a force or moment."""
    if quantity not in QUANTITIES:
        raise ParameterError(
            f"a tire has no quantity '{quantity}'; {nearest(quantity, QUANTITIES)}: use one of these names"
        )
