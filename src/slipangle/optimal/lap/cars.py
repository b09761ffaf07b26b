"""A `LapCar` of any model of a car that knows its tires."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from functools import singledispatch
from typing import Any

import numpy as np

from slipangle.errors import ModelWarning, ParameterError
from slipangle.models.tires.simple import Tire
from slipangle.models.vehicles.car import DualTrackParams
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycleParams
from slipangle.models.vehicles.on_tires import axle_force, axle_stiffness, peak_friction, wheel_loads
from slipangle.models.vehicles.saturating_bicycle import SaturatingBicycleParams
from slipangle.optimal.lap.car import LapCar

_HIGH, _LOW = 1.3, 0.7  # loads over the static one, between which a tire's load sensitivity is taken
_SUPPOSED = {  # what a model of grip alone leaves out, and what is taken then
    "drag": "no drag (drag=0 kg/m)",
    "drive_rear": "driven rear wheels (drive_rear=1)",
    "transfer_f": "no load transfer across (transfer_f=0, transfer_r=0)",
    "transfer_x": "and along (transfer_x=0)",
}
_NOT_THERE = dict.fromkeys(("friction_load", "stiffness_load", "transfer_x", "transfer_f", "transfer_r", "drag"), 0.0)
AMPLE = 1e7  # W, more than the tires of any car hold
_ANGLES = np.radians(np.linspace(0.5, 14.0, 28))


def lap_car(car: Any, **values: float) -> LapCar:
    """What a lap needs of a car, from a model that knows its tires.

    Parameters
    ----------
    car : LapCar, NonlinearBicycle, SaturatingBicycle, RelaxingBicycle, DualTrack, their parameters, or a fit's result
        A nonlinear bicycle brings all but the power; a saturating one its axles, without load transfer; a dual track's
        tires become axles of the same stiffness, peak friction, shape and load sensitivity, which share force evenly as
        its brakes do, and its engine the largest power and force over all gears.
    **values : float
        Parameters of `LapCar` by their names, which the model does not know or which are to differ. Width and rates of
        steering and force that nobody says go with the wheelbase: a 1:10 car is 18 cm wide, none more than 1.8 m.

    Raises
    ------
    ParameterError
        If the model has no limits of grip, a value has no such name, or the power is not known.

    Warns
    -----
    ModelWarning
        With what was taken where neither the model nor ``values`` say drag, driven axle or load transfer.

    Examples
    --------
    >>> from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
    >>> from slipangle.models.vehicles.catalogue import BMW_320I, PASSENGER_TIRE
    >>> from slipangle.models.vehicles.dual_track.dual_track import DualTrack
    >>> bmw = lap_car(DualTrack(params=BMW_320I, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001))
    >>> round(bmw.power / 1000)
    90
    """
    made, supposed = car_and_supposed(car, values)
    if supposed:
        warnings.warn(supposed, ModelWarning, stacklevel=2)
    return made


def car_and_supposed(car: Any, values: Mapping[str, float]) -> tuple[LapCar, str]:
    """As `lap_car`, with its warning as a sentence; an empty one where the model and ``values`` say all."""
    made, known = _car_of(car, values)
    taken = [words for name, words in _SUPPOSED.items() if name not in known]
    if not taken:
        return made, ""
    return made, (
        f"the car's model does not say all that a lap hangs on: taken were {', '.join(taken)}; give what you know: "
        "sa.lap_car(model, drag=0.7, ...), or slipangle lap with --set drag=0.7"
    )


def grip_of(car: Any) -> LapCar:
    """What tires hold, as laps know it, whatever drives them: with ample power where the engine is not known."""
    return _car_of(car, {}, power=AMPLE)[0]


def _car_of(car: Any, values: Mapping[str, float], **otherwise: float) -> tuple[LapCar, set[str]]:
    """The car, what is ``otherwise`` in it where neither its model nor ``values`` say it, and what these do say."""
    for name in values:
        LapCar.si(name)
    model = car if hasattr(car, "params") else getattr(car, "model", car)
    record = getattr(model, "params", model)
    known = known_limits(model) or known_limits(record)
    if not known:
        raise ParameterError(
            f"a {type(model).__name__} does not say how much its tires can hold; expected a LapCar, NonlinearBicycle, "
            "SaturatingBicycle or DualTrack: identify one of these"
        )
    known = {**known, **values}
    if "power" not in {**known, **otherwise}:
        raise ParameterError(
            "the car's power is not known; expected it in W: sa.lap_car(model, power=2e5), or slipangle lap with "
            "--set power=2e5"
        )
    made = LapCar(**{**_NOT_THERE, **otherwise, **known})
    factors = {"width": min(made.size, 1.0), "delta_rate": made.size**-0.5, "force_rate": made.size**-0.5}
    return replace(made, **{n: factor * getattr(made, n) for n, factor in factors.items() if n not in known}), {*known}


@singledispatch
def known_limits(of: Any) -> dict[str, float]:
    """Values of `LapCar` that a model, or its parameters, know; none where nothing says what the tires can hold."""
    return {}


@known_limits.register
def _(of: NonlinearBicycleParams) -> dict[str, float]:
    return {name: getattr(of, name) for name in of.metadata()}


@known_limits.register
def _(of: SaturatingBicycleParams) -> dict[str, float]:
    of = of.unlocked()
    shared = {name: getattr(of, name) for name in LapCar.metadata() if name in of.metadata()}
    return shared


@known_limits.register
def _(of: DualTrack) -> dict[str, float]:
    return _of_dual_track(of.params, of.tire_f, of.tire_r)


def _of_dual_track(p: DualTrackParams, tire_f: Tire, tire_r: Tire) -> dict[str, float]:
    roll = p.roll_stiffness_f + p.roll_stiffness_r
    arm = p.height - (p.roll_centre_f * p.l_r + p.roll_centre_r * p.l_f) / p.wheelbase
    transfer = {}
    for axle, other in (("f", p.l_r), ("r", p.l_f)):
        stiffness, centre, track = (getattr(p, f"{k}_{axle}") for k in ("roll_stiffness", "roll_centre", "track"))
        transfer[f"transfer_{axle}"] = (arm * stiffness / roll + centre * other / p.wheelbase) / track
    power, force = _engine(p)
    air = 0.5 * p.air_density
    axles = [_axle(tire, load) for tire, load in zip((tire_f, tire_r), wheel_loads(p), strict=True)]
    shape = float(np.mean([a["shape"] for a in axles]))
    values: dict[str, float] = {f"{k}_{end}": a[k] for a, end in zip(axles, "fr", strict=True) for k in ("C", "mu")}
    return values | {
        **{k: getattr(p, k) for k in ("mass", "inertia_z", "wheelbase", "l_f", "rolling_resistance")},
        **transfer,
        **dict(shape=shape, transfer_x=p.height / p.wheelbase, power=power, drive_force=force, even=1.0),
        **{k: float(np.clip(np.mean([a[k] for a in axles]), 0.0, 1.0)) for k in ("friction_load", "stiffness_load")},
        **dict(drive_rear=1.0 - p.driveline.front_share, brake_rear=1.0 - p.brakes.bias),
        **dict(brake_force=p.brakes.torque / p.radius, drag=air * p.drag_area),
        **dict(downforce_f=air * p.downforce_f, downforce_r=air * p.downforce_r),
        **dict(width=max(p.track_f, p.track_r) + 0.2, delta_max=p.steering.limit),
    }


def _axle(tire: Tire, load: float) -> dict[str, float]:
    """Stiffness, peak friction, shape and load sensitivities of an axle of two tires."""
    C, mu = axle_stiffness(tire, load), peak_friction(tire, load)
    curve = np.array([float(axle_force(tire, a, load)) for a in _ANGLES])
    shapes = np.linspace(1.02, 1.9, 89)[:, None]
    fitted = 2 * mu * load * np.sin(shapes * np.arctan(C / (shapes * 2 * mu * load) * _ANGLES))
    shape = float(shapes[np.argmin(((fitted - curve) ** 2).sum(axis=1)), 0])
    friction = (peak_friction(tire, _LOW * load) - peak_friction(tire, _HIGH * load)) / (mu * (_HIGH - _LOW))
    rise = (axle_stiffness(tire, _HIGH * load) - axle_stiffness(tire, _LOW * load)) / (C * (_HIGH - _LOW))
    return {"C": float(C), "mu": mu, "shape": shape, "friction_load": friction, "stiffness_load": float(1.0 - rise)}


def _engine(p: DualTrackParams) -> tuple[float, float]:
    """Largest power at the wheels [W] and largest driving force [N] of an engine and its gears."""
    drive = p.driveline
    speeds = np.linspace(0.0, min(drive.engine.speeds[-1], drive.shift_up), 200)
    torque = np.array([float(drive.engine.torque(1.0, float(w))) for w in speeds])
    return float(np.max(torque * speeds)), float(torque.max() * drive.ratios[0] * drive.final / p.radius)
