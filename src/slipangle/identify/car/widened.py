"""95 % limits of a car's parameters, with what no fit shows: what a single track leaves out, and the hold of inputs."""

from __future__ import annotations

import numpy as np

from slipangle.data.dataset import HELD, MEANS
from slipangle.identify.car.effects import extrapolated
from slipangle.identify.car.sensors import of_either_scale
from slipangle.identify.car.structures import STIFF, Fitted, Others
from slipangle.identify.car.uncertainty import hull

# What roll, camber and load transfer, which a single track lacks, move a value by; from the yaw rate alone, where only
# transients tell how stiff and how heavy a car is, by more; the gain by what small angles and driven wheels leave out.
_FLOOR, _FLOOR_ALONE, _FLOOR_GAIN = 0.05, 0.2, 0.01
_FLOOR_FAR, _FLOOR_GAIN_FAR, _FAR = 0.2, 0.04, 0.35  # the same where wheels are turned so far [rad] and farther
SMALL = 0.15  # rad of the road wheels, up to which their tangent is their angle to a hundredth
_HELD, _INTERPOLATED = 1 / 12, 4 / 27  # squared lag of a hold, and of the worst delay, over the squared sample time
_TOLD, _FINE = 0.05, 0.02  # share of the yaw inertia that a hold takes, from which a word is said, and that is none


def limits_of(final: Fitted, others: Others, turned: float) -> tuple[np.ndarray, np.ndarray, str]:
    """Covariance, 95 % limits no narrower than what a single track leaves out, and how they were found.

    Where v_y tells, what it leaves out has nothing to do with the noise and with the structures as good: their squares
    add. Wheels that are ``turned`` farther [rad] scrub more, as each would have to turn by an angle
    of its own.
    """
    spread, limits, how = hull(final.names, final, others)
    scrub = 0.0 if final.model.ode.small_angles else float(np.clip((turned - SMALL) / (_FAR - SMALL), 0.0, 1.0))
    beside = _FLOOR if "v_y" in final.model.outputs else 0.0
    stiff = scrub * (_FLOOR_FAR - _FLOOR) if beside else _FLOOR_ALONE
    floors: dict[str, tuple[float, float]] = dict.fromkeys((*STIFF, "gain_M_z"), (beside, stiff))
    floors["steering_gain"] = 0.0, _FLOOR_GAIN + scrub * (_FLOOR_GAIN_FAR - _FLOOR_GAIN)
    at_rest = extrapolated(final)
    for i, name in enumerate(final.names):
        value, (squared, more) = final.values[name], floors.get(name, (0.0, 0.0))
        reach = np.hypot(limits[i] - value, squared * abs(value)) + (more + at_rest.get(name, 0.0)) * abs(value)
        limits[i] = value + np.array([-1.0, 1.0]) * reach
    _hold(final, limits)
    of_either_scale(final, limits)
    return spread, np.clip(limits.T, *final.problem.ranges).T, how


def _hold(final: Fitted, limits: np.ndarray) -> None:
    """Widen the limits, shape (n_names, 2), of steering lag and delay by what the hold between samples may have taken.

    An angle that is `_smoothed` looks like less lag and more delay: to second order in frequency amplitudes fall as
    behind a lag. So far may the lag be larger, and the delay smaller, than they were found.
    """
    if "steering_lag" not in final.names:
        return
    lag, found = final.names.index("steering_lag"), final.values["steering_lag"]
    smoothed = final.model.dt**2 * _smoothed(final)
    limits[lag, 1] = np.sqrt(limits[lag, 1] ** 2 + smoothed)
    early = np.sqrt(found**2 + smoothed) - found
    for i, name in enumerate(final.problem.base_names):
        limits[i, 0] -= early if name == "delay_delta" else 0.0


def _smoothed(final: Fitted) -> float:
    """The squared lag that looks like what a model takes from a moving steering angle, over the squared sample time.

    A hold takes as much as a lag of a 12th of it; `Dataset.hold_mean` makes up for that. A delay of a part f of the
    first sample is interpolated without the sample ahead, f (1 - f)^2, a longer one as it moves.
    """
    f = min(final.values.get("delay_delta", 0.0) / final.model.dt, 1.0)
    return f * (1.0 - f) ** 2 + (0.0 if {MEANS, HELD} & {*final.problem.data.notes} else _HELD)


def yaw_time(final: Fitted) -> float:
    """Time constant of the yaw rate against its damping by the tires, at the middle of the speeds driven. [s]"""
    p, v_x = final.model.ode.params, float(np.median(final.problem.data["v_x"]))
    return final.values["inertia_z"] * v_x / (p.C_f * p.l_f**2 + p.C_r * p.l_r**2)


def too_coarse(final: Fitted) -> list[str]:
    """Samples too far apart for the yaw inertia, and how close they had to be.

    Of a motion as quick as the yaw rate follows, with the `yaw_time`, half of what is `_smoothed` is missing, and the
    sixth order of `Dataset.hold_mean`: what lag and relaxation do not make up for of that, the inertia does.
    """
    follows, dt, notes = yaw_time(final), final.model.dt, final.problem.data.notes
    quick, means = dt / follows, MEANS in notes
    if HELD in notes or _smoothed(final) * quick**2 / 2 + (quick**6 / 140 if means else 0.0) < _TOLD:
        return []
    worst = _INTERPOLATED + (0.0 if means else _HELD)
    return [
        f"samples are {dt:.3g} s apart, and the yaw rate follows within {follows:.2g} s: inertia_z looks like lags of "
        "steering and tires, and may be off by more than its interval; give the log at "
        f"{np.ceil(np.sqrt(worst / (2 * _FINE)) / follows):.0f} Hz or more, where it was recorded so, or log faster"
    ]
