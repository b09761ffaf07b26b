"""What is said of a log's sensors: their zeros, how they are turned, their scales; and of a steering that is late."""

from __future__ import annotations

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.quality.plausible import TURNED, a_y_of_turning
from slipangle.identify.car.corrections import FAST, SCALE, SLOW, fastest_steering
from slipangle.identify.car.structures import Fitted

_STAIRS = 0.6  # of the angle by which a steering at its largest rate is behind, that delta moves in one sample at most
_OFFSET = 0.2  # of a sensor, over the standard deviation of its channel, from which it is told
_TURNED = 0.01  # rad, by which a v_y sensor is turned at least: banked roads and side wind make half of it
_LATE = 0.25  # s, of delay and lag together, that no steering has
_SURE = 4.0  # standard deviations
_ONE_SPEED = 1.2  # fast over slow driving, up to which a turned sensor is one with an offset
_ROLLING = 0.98, 1.15  # a_y over v_x r of sound sensors: body roll adds to it
_FELT = 0.93, 1.2  # the same as a fit finds it, that needs no word


def sensors(final: Fitted, spread: np.ndarray) -> list[str]:
    """Sensors whose zero is far off or that are turned, and a steering that is late, or slower than it is logged."""
    said = []
    for i, (name, base) in enumerate(zip(final.names, final.problem.base_names, strict=True)):
        value, sd = final.values[name], float(np.sqrt(spread[i, i]))
        if name.startswith("bias_"):
            channel = base.removeprefix("bias_")
            size = float(np.std(final.problem.data[channel]))
            if abs(value) > max(_OFFSET * size, _SURE * sd):
                unit, where = final.model.si(base).unit, name.removeprefix(base)
                where = f" in recording {where[1:-1]}" if where else ""
                said.append(
                    f"{channel} has an offset of {value:.3g} {unit}{where}, corrected in the fit: zero the sensor"
                )
        if name == "turn_v_y" and abs(value) > max(_TURNED, _SURE * sd):
            slow, fast = np.quantile(final.problem.data["v_x"], (SLOW, FAST))
            offset = ", or has an offset" if fast < _ONE_SPEED * slow else ""
            said.append(
                f"v_y is {value:.2g} of v_x on a straight: {TURNED} {np.rad2deg(value):.2g} deg{offset}, corrected in "
                "the fit: turn it, or subtract that"
            )
    late = final.values.get("delay_delta", 0.0) + final.values.get("steering_lag", 0.0)
    if late > _LATE:
        said.append(f"the car answers its steering {late:.2f} s late: delta or the outputs may come delayed in the log")
    return [*said, *_too_seldom(final)]


def _too_seldom(final: Fitted) -> list[str]:
    """A steering at its largest rate that is logged at too few moments."""
    if "steering_rate" not in final.values:
        return []
    most = final.model.dt * fastest_steering(final.problem.data, 0.95)
    if most <= _STAIRS * final.values["steering_rate"] * final.values["steering_lag"]:
        return []
    return [
        f"delta moves by {most:.2g} rad between two samples, and the steering reaches its largest rate within "
        f"one: what it does in between decides where the wheels are; log at more than {1 / final.model.dt:.3g} "
        "Hz; until then no interval holds"
    ]


def scales(final: Fitted, limits: np.ndarray, data: Dataset) -> list[str]:
    """A scale of v_y, or r, or a_y that is off, with ``limits`` of shape (n_names, 2) and the log as it was given."""
    if "gain_a_y" in final.names and not _FELT[0] < final.values["gain_a_y"] < _FELT[1]:
        low, high = limits[final.names.index("gain_a_y")]
        return [
            f"a_y reads {final.values['gain_a_y']:.3g} ({low:.3g} to {high:.3g}) times what v_x r asks for, corrected "
            f"in the fit; expected 1 to {_ROLLING[1]:g}, as body roll adds to it: the scale of a_y is off, or that of "
            "r or v_x"
        ]
    if SCALE[0] not in final.names:
        return []
    gain, (low, high) = final.values[SCALE[0]], limits[final.names.index(SCALE[0])]
    return [
        f"v_y reads {gain:.3g} ({low:.3g} to {high:.3g}) times what the motion across asks for, corrected in the fit: "
        f"its scale or unit is off, or r reads {1 / gain:.3g} times what it is (a gyro's scale), and steering gain and "
        f"friction are {gain:.3g} times as large; C_f, C_r and inertia_z hold for either{_which(gain, data)}"
    ]


def _which(gain: float, data: Dataset) -> str:
    """Which of both it is, as a_y tells where it was logged, or how to find out."""
    found = a_y_of_turning(data)
    as_logged, otherwise = (_ROLLING[0] < x < _ROLLING[1] for x in (found, found / gain))
    if as_logged == otherwise:
        return "; see whether r adds up over a full circle"
    return f"; a_y, {found:.3g} times v_x r in bends, says that it is {'v_y' if as_logged else 'r'}"


def of_either_scale(final: Fitted, limits: np.ndarray) -> None:
    """Widen the limits, shape (n_names, 2), of what hangs on whether the scale of v_y or that of r is off."""
    gain = final.values.get(SCALE[0], 1.0)
    for i, name in enumerate(final.problem.base_names):
        if name in ("steering_gain", "mu_f", "mu_r"):
            both = np.concatenate([limits[i], gain * limits[i]])
            limits[i] = both.min(), both.max()
