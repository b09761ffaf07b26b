"""Whether an effect that was fitted to a log is one, or stands in for something else."""

from __future__ import annotations

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.identify.car.corrections import DOWNFORCE, FAST, LOCKED, SLOW, SPEED, Correction
from slipangle.identify.car.structures import AS_GOOD, ELSEWHERE, Fitted, change, corrected, errors, fit
from slipangle.identify.car.uncertainty import covariance

_LEAST = 0.1  # of an axle's load at rest, the least that downforce adds in fast driving
_RESISTS = 0.1  # of the tires' yaw damping, the least that a locked axle adds
_SCALE = 0.03  # of the speed, the least by which it is said to be wrong
_NONE = 1.5  # of `AS_GOOD`, from which a structure is not believed at all; of `ELSEWHERE`, up to which a lever is one
# Standard deviations from none at which an effect just is one, and at which it counts whole; of a speed's scale they
# are more, as cars that roll much asked for one by up to 3.7.
_SURE, _SURE_SPEED = (1.96, 3.92), (4.0, 6.0)
_ANY = 2.0  # of what needs no other proof than that it helps


def told(fitted: Fitted, names: tuple[str, ...]) -> float:
    """How far the effect of the parameters ``names`` is beyond what stands in for something else, 1 where it just is.

    Downforce adds a tenth to an axle's load in fast driving, as wings do, a locked axle a tenth to the yaw damping, and
    stretches of unlike speed and size agree that there is some. A speed is wrong by a few percent or more. Lift of that
    size has no car that is driven so fast: it is what roads and drivers do with speed.
    """
    if names == DOWNFORCE:
        size = (_ratios(fitted, FAST) - 1.0) / _LEAST
    elif names == LOCKED:
        size = np.array([fitted.model.ode.params.locked_share / _RESISTS])
    elif names == SPEED:
        size = np.abs([fitted.values[name] - 1.0 for name in names]) / _SCALE
    else:
        return _ANY
    none, (just, whole) = (1.0, _SURE_SPEED) if names == SPEED else (0.0, _SURE)
    at = [fitted.names.index(name) for name in names]
    std = np.sqrt(np.maximum(np.diag(covariance(fitted)[0])[at], 0.0))
    away = np.abs([fitted.values[name] - none for name in names]) / np.maximum(std, 1e-300)
    return float(np.max(np.minimum(size, 1.0 + (away - just) / (whole - just))))


def extrapolated(fitted: Fitted) -> dict[str, float]:
    """By how much stiffness and friction at rest may be off, as shares of them: by what they gain until slow driving.

    No log shows a car at rest; from there to its slow driving a model in proportion to load is a guess.
    """
    if not {*DOWNFORCE} <= {*fitted.free}:
        return {}
    front, rear = np.abs(_ratios(fitted, SLOW) - 1.0)
    return {"C_f": front, "mu_f": front, "C_r": rear, "mu_r": rear}


def others_as_good(final: Fitted, dropped: list[Correction], data: Dataset) -> list[tuple[Fitted, float]]:
    """Structures that explain the data about as well as the chosen one, and how far each counts, 0 to 1.

    With a correction more, such as tires of another shape; with a centre of gravity elsewhere too, which is hard to
    tell from another place of the v_y sensor, if the data want it. Nothing counts all at once, so that no rounding
    decides an interval.
    """
    at, known = errors(final, data), {"before": final, "own": final.own}
    trials = list[tuple[Fitted, float]]()
    for correction in (c for c in dropped if not c.own):
        other = corrected(final, correction, data)
        trials.append((other, told(other, correction.free) - 1.0))
    if {"v_y", "a_y"} & {*final.model.outputs}:
        free = dict.fromkeys((*final.free, "steering_gain", *SPEED))  # speed and gain may be wrong by the same share
        scaled = fit(final.model, tuple(n for n in free if n not in final.own), data, **known)
        trials.append((scaled, told(scaled, SPEED) - 1.0))
    if "lever_v_y" in final.free:
        moved = fit(final.model, (*final.free, "l_f"), data, **known)
        away = abs(moved.values["l_f"] - final.model.value("l_f")) / (ELSEWHERE * final.model.value("wheelbase"))
        trials.append((moved, away - _NONE))
    counted = []
    for other, share in trials:
        worse = change(at, errors(other, data))[0] / AS_GOOD
        counted.append((other, float(min(share, _NONE - worse, 1.0))))
    return [(other, share) for other, share in counted if share > 0]


def _ratios(fitted: Fitted, share: float) -> np.ndarray:
    """Loads of both axles over those at rest, at a quantile of the speeds that were driven."""
    v_x = float(np.quantile(fitted.problem.data["v_x"], share))
    return np.array(fitted.model.ode.params.load_ratios(v_x), dtype=float)
