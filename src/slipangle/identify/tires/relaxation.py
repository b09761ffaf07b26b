"""Relaxation length of a tire from transient rig data: how far it rolls before its side force follows the slip."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from slipangle.data.tire_data import TireData
from slipangle.errors import ExcitationError, MissingColumnError, ModelWarning, SlipangleError
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.models.tires.simple import Tire

_RANGE = (0.005, 5.0)  # m
_GAP = 5.0  # times the usual distance between samples, from which the tire starts anew
_ROLLING = 0.02  # slip ratio that counts as free rolling
_WORTH = 0.995  # of the residual without relaxation: a length that leaves more is none


class Relaxation(NamedTuple):
    """Lateral relaxation length with its 95 % interval [m], and the side force's RMSE with and without it [N]."""

    length: float
    interval: tuple[float, float]
    rmse: float
    rmse_without: float
    load: float  # mean load of the samples [N]


def lateral_relaxation(tire: Tire, data: TireData) -> Relaxation:
    """The length over which the slip that the tire feels lags behind the rig's, by least squares of F_y.

    ``sigma d(tan alpha')/ds + tan alpha' = tan alpha`` over the distance rolled ``s``; the tire gives the side force at
    alpha'. Rows must be in the order of time; a gap starts anew. The interval allows for residuals that are alike from
    sample to sample.

    Raises MissingColumnError without time and speed, ExcitationError if the slip angle moves too slowly for a length to
    show.

    Source: H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, eq. 7.7.
    """
    if data.time is None or data.speed is None:
        raise MissingColumnError(
            f"'{data.name}' has no {'time' if data.time is None else 'speed'}; expected both, since a relaxation "
            "length shows over the distance rolled: keep the channels ET and V"
        )
    rows = np.flatnonzero(np.abs(data.slip_ratio) < _ROLLING)
    part = data.rows(rows)
    steps = np.diff(np.asarray(part.time), prepend=np.nan) * np.abs(np.asarray(part.speed))
    usual = float(np.median(steps[1:][steps[1:] > 0])) if (steps[1:] > 0).any() else 0.0
    if len(rows) < 100 or usual <= 0:
        raise ExcitationError(f"'{data.name}' has {len(rows)} freely rolling samples in order of time; expected 100")
    starts = ~((steps > 0) & (steps < _GAP * usual))
    tangent = np.tan(part.slip_angle)

    def residual(sigma: float) -> np.ndarray:
        felt = _lagged(tangent, steps, starts, sigma)
        with warnings.catch_warnings(action="ignore", category=ModelWarning):
            force = tire.unlimited().forces_at(
                part.slip_ratio, np.arctan(felt), part.load, camber=part.gamma, pressure=part.pressure
            )
        return part.F_y - np.asarray(force.F_y)

    def cost(log_sigma: float) -> float:
        error = residual(float(np.exp(log_sigma)))
        return float(error @ error)

    grid = np.linspace(np.log(_RANGE[0]), np.log(_RANGE[1]), 15)
    k = int(np.argmin([cost(v) for v in grid]))
    around = (grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)])
    best = float(minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": 1e-5}).x)
    sigma, error, without = float(np.exp(best)), residual(float(np.exp(best))), residual(1e-9)
    if error @ error > _WORTH**2 * (without @ without):
        raise ExcitationError(
            f"a relaxation length explains less than half a percent of what F_y of '{data.name}' leaves; expected slip "
            "angles that move within the length: take a run with steps or faster sweeps"
        )
    slope = (residual(sigma * 1.01) - residual(sigma / 1.01)) / (sigma * (1.01 - 1 / 1.01))
    middle = error * slope
    lags = [float(middle[j:] @ middle[: len(middle) - j]) for j in range(min(50, len(middle) // 4))]
    weight = 1.0 - np.arange(len(lags)) / len(lags)
    variance = max(lags[0] + 2 * float(weight[1:] @ np.array(lags[1:])), 0.1 * lags[0]) / float(slope @ slope) ** 2
    half = 1.96 * float(np.sqrt(variance))
    rms = [float(np.sqrt(np.mean(e**2))) for e in (error, without)]
    return Relaxation(sigma, (sigma - half, sigma + half), rms[0], rms[1], float(part.load.mean()))


def with_relaxation(tire: MagicFormulaTire, data: TireData) -> tuple[MagicFormulaTire, tuple[str, ...]]:
    """The tire with the lateral carcass stiffness that its relaxation length means, and what was found, in words.

    A tire that has one keeps it; data that show none change nothing, and that is said.
    """
    if tire.coefficients.LATERAL_STIFFNESS:
        return tire, ()
    try:
        found = lateral_relaxation(tire, data)
    except SlipangleError as error:
        return tire, (f"no relaxation length: {error}",)
    K_y = abs(float(np.asarray(tire.unlimited().evaluate(0.0, 0.0, found.load, axes="ISO-W").K_y)))
    text = (
        f"relaxation length {found.length:.3g} m (95 % interval {found.interval[0]:.3g} to {found.interval[1]:.3g}) at "
        f"{found.load:.4g} N: LATERAL_STIFFNESS {K_y / found.length:.4g} N/m; F_y is left {found.rmse:.4g} N instead "
        f"of {found.rmse_without:.4g} N"
    )
    return tire.with_coefficients(LATERAL_STIFFNESS=K_y / found.length), (text,)


def _lagged(values: np.ndarray, steps: np.ndarray, starts: np.ndarray, sigma: float) -> np.ndarray:
    """First-order lag over distance, the input held linear between samples; anew where ``starts``."""
    out = np.empty(len(values))
    x = np.where(starts, 1.0, np.nan_to_num(steps) / sigma)
    keep = np.exp(-x)
    ramp = np.where(x > 1e-9, -np.expm1(-x) / np.maximum(x, 1e-300), 1.0)
    for k in range(len(values)):
        if starts[k]:
            out[k] = values[k]
        else:  # exact for a straight line between the samples
            out[k] = keep[k] * out[k - 1] + (ramp[k] - keep[k]) * values[k - 1] + (1.0 - ramp[k]) * values[k]
    return out
