"""Whether an effect that was fitted to a log is one, or stands in for something else."""

from __future__ import annotations

import numpy as np

from slipangle.identify.car.corrections import DOWNFORCE, FAST, LOCKED, SLOW
from slipangle.identify.car.structures import Fitted
from slipangle.identify.car.uncertainty import covariance

_LEAST = 0.1  # of an axle's load at rest, the least that downforce adds in fast driving
_RESISTS = 0.1  # of the tires' yaw damping, the least that a locked axle adds
_SURE = 1.96  # standard deviations from none
_ANY = 2.0  # of what needs no other proof than that it helps


def told(fitted: Fitted, names: tuple[str, ...]) -> float:
    """How far the effect of the parameters ``names`` is beyond what stands in for something else, 1 where it just is.

    Downforce adds a tenth to an axle's load in fast driving, as wings do, a locked axle a tenth to the yaw damping, and
    stretches of unlike speed and size agree that there is some. Lift of that size has no car that is driven so fast: it
    is what roads and drivers do with speed.
    """
    if names == DOWNFORCE:
        size = (_ratios(fitted, FAST) - 1.0) / _LEAST
    elif names == LOCKED:
        size = np.array([fitted.model.ode.params.locked_share / _RESISTS])
    else:
        return _ANY
    at = [fitted.names.index(name) for name in names]
    std = np.sqrt(np.maximum(np.diag(covariance(fitted)[0])[at], 0.0))
    sure = np.abs([fitted.values[name] for name in names]) / np.maximum(std, 1e-300)
    return float(np.max(np.minimum(size, sure / _SURE)))


def extrapolated(fitted: Fitted) -> dict[str, float]:
    """By how much stiffness and friction at rest may be off, as shares of them: by what they gain until slow driving.

    No log shows a car at rest; from there to its slow driving a model in proportion to load is a guess.
    """
    if not {*DOWNFORCE} <= {*fitted.free}:
        return {}
    front, rear = np.abs(_ratios(fitted, SLOW) - 1.0)
    return {"C_f": front, "mu_f": front, "C_r": rear, "mu_r": rear}


def _ratios(fitted: Fitted, share: float) -> np.ndarray:
    """Loads of both axles over those at rest, at a quantile of the speeds that were driven."""
    v_x = float(np.quantile(fitted.problem.data["v_x"], share))
    return np.array(fitted.model.ode.params.load_ratios(v_x), dtype=float)
