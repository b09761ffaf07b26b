"""How a tire's grip changes with the temperature of its tread and with the distance it has rolled."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import plotly.graph_objects as go

from slipangle.data.tire_data import TireData
from slipangle.errors import ParameterError
from slipangle.models.tires.simple import Tire
from slipangle.report.style import axes, dots, line, new_figure, series_style
from slipangle.report.tire_fits import predicted

_LIMIT = 0.8  # of the largest friction: where the tire counts as at its limit
_LEAST, _BINS = 20, 15  # samples of a bin, bins
_LONGEST = 1.0  # s between samples that counts as rolled through

GripOver = Literal["temperature", "distance"]
_TITLES = {"temperature": "tread temperature [°C]", "distance": "distance rolled [km]"}


class Grip(NamedTuple):
    """Grip measured over that of the fitted tire [-] in bins: middle, median, quartiles and samples of each."""

    at: np.ndarray  # degC or km
    median: np.ndarray
    low: np.ndarray
    high: np.ndarray
    samples: np.ndarray


def grip(tire: Tire, data: TireData, over: GripOver) -> Grip:
    """Measured force over the fitted tire's, of samples near the limit of friction, over temperature or wear.

    Load, camber, pressure and slip are the tire's matter, so that what is left is the tread's. Wear is told by the
    distance rolled in the order of the runs.

    Raises ParameterError if the data lack the channels, or have too few samples near the limit.
    """
    if over == "temperature" and data.temperature is None:
        raise ParameterError(f"'{data.name}' holds no temperature; expected TSTC, TSTI or TSTO: leave the figure out")
    if over == "distance" and (data.time is None or data.speed is None):
        raise ParameterError(f"'{data.name}' holds no time and speed; expected both: leave the figure out")
    x = np.asarray(data.temperature) if over == "temperature" else distance(data) / 1e3
    fitted = predicted(tire, data)
    model = np.hypot(*(np.broadcast_to(np.asarray(f), data.load.shape) for f in (fitted.F_x, fitted.F_y)))
    friction = model / data.load
    near = friction > _LIMIT * float(np.quantile(friction, 0.98))
    if near.sum() < 3 * _LEAST:
        raise ParameterError(
            f"'{data.name}' holds {int(near.sum())} samples near the limit of friction; expected at least "
            f"{3 * _LEAST}: sweep slip further"
        )
    share, x = np.hypot(data.F_x, data.F_y)[near] / model[near], x[near]
    edges = np.unique(np.quantile(x, np.linspace(0, 1, _BINS + 1)))
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    parts = [np.flatnonzero(index == k) for k in range(max(len(edges) - 1, 1))]
    parts = [rows for rows in parts if len(rows) >= _LEAST]
    quartiles = np.array([np.quantile(share[rows], (0.25, 0.5, 0.75)) for rows in parts])
    at = np.array([float(np.median(x[rows])) for rows in parts])
    return Grip(at, quartiles[:, 1], quartiles[:, 0], quartiles[:, 2], np.array([len(rows) for rows in parts]))


def distance(data: TireData) -> np.ndarray:
    """Distance rolled up to each sample, through all runs in their order; time that was cut does not count. [m]"""
    steps = np.diff(np.asarray(data.time), prepend=np.asarray(data.time)[0])
    steps = np.where((steps > 0) & (steps < _LONGEST), steps, 0.0)
    return np.cumsum(steps * np.abs(np.asarray(data.speed)))


def grip_figure(tire: Tire, data: TireData, over: GripOver) -> go.Figure:
    """Grip relative to the fitted tire over temperature or distance rolled: medians and quartiles of bins."""
    found = grip(tire, data, over)
    colour, dash = series_style(0)
    figure = new_figure(360)
    faint, _ = series_style(1)
    line(figure, found.at, found.low, faint, 1, dash="dot", name="quartiles", hovertemplate="%{y:.3f}")
    line(figure, found.at, found.high, faint, 1, dash="dot", name="quartiles", showlegend=False)
    line(figure, found.at, found.median, colour, 2, dash=dash, name="median", hovertemplate="%{y:.3f}")
    dots(figure, found.at, found.median, colour, 5, hover="%{y:.3f}", name="median", showlegend=False)
    return axes(figure, _TITLES[over], "grip over that of the fit [-]", showlegend=True)
