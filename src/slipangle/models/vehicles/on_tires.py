"""A car on given tires: what their files know of it, its axles' curves, and a dual track around a bicycle."""

from __future__ import annotations

from collections.abc import Mapping
from math import radians
from typing import Literal, TypeVar

import numpy as np

from slipangle.errors import ParameterError
from slipangle.models.tires.simple import Tire
from slipangle.models.vehicles.car import DualTrackParams
from slipangle.models.vehicles.driveline import Brakes, Driveline, Engine
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams, ChassisParams
from slipangle.ops import Scalar

P = TypeVar("P", bound=ChassisParams)
_SMALL = 1e-3  # rad, slip angle of a cornering stiffness
_GEOMETRY = ("mass", "inertia_z", "wheelbase", "l_f", "steering_gain", "steering_offset")


def mounted(tire: Tire, side: Literal["LEFT", "RIGHT"]) -> Tire:
    """A tire on a side of the car, to be used whatever its slip and load; as it is where it describes no side."""
    return (tire.mounted(side) if tire.side else tire).unlimited()


def wheel_loads(p: ChassisParams) -> tuple[Scalar, Scalar]:
    """Static load on one front and one rear wheel. [N]"""
    return 0.5 * p.mass * GRAVITY * p.l_r / p.wheelbase, 0.5 * p.mass * GRAVITY * p.l_f / p.wheelbase


def axle_force(tire: Tire, alpha: Scalar, load: Scalar, transfer: Scalar = 0.0) -> Scalar:
    """Side force of an axle of two tires at a slip angle [rad] and a load on each wheel [N], from their own curves.

    ``transfer`` [N] goes from the left to the right wheel. [N]
    """
    left, right = mounted(tire, "LEFT"), mounted(tire, "RIGHT")
    if not tire.side and isinstance(transfer, float) and transfer == 0.0:
        return 2.0 * left.forces(0.0, alpha, load).F_y
    return left.forces(0.0, alpha, load - transfer).F_y + right.forces(0.0, alpha, load + transfer).F_y


def axle_stiffness(tire: Tire, load: Scalar) -> Scalar:
    """Cornering stiffness of an axle of two tires at a load on each wheel. [N/rad]"""
    return (axle_force(tire, _SMALL, load) - axle_force(tire, -_SMALL, load)) / (2 * _SMALL)


def bicycle_on(chassis: ChassisParams, tire_f: Tire, tire_r: Tire | None = None) -> BicycleParams:
    """The linear bicycle of a chassis on tires: cornering stiffness of the axles at their static loads.

    >>> from slipangle.models.vehicles.catalogue import PASSENGER_TIRE, SOUSA_TABLE_7_2
    >>> round(bicycle_on(SOUSA_TABLE_7_2, PASSENGER_TIRE).C_f, -3)
    214000.0
    """
    loads = wheel_loads(chassis)
    C = [float(axle_stiffness(t, load)) for t, load in zip((tire_f, tire_r or tire_f), loads, strict=True)]
    if min(C) <= 0:
        raise ParameterError(
            f"the axles' cornering stiffness is {C[0]:.4g} and {C[1]:.4g} N/rad at their loads; expected both "
            "positive: check that the tires suit the car's mass"
        )
    return BicycleParams(**{n: getattr(chassis, n) for n in _GEOMETRY}, C_f=C[0], C_r=C[1])


def peak_friction(tire: Tire, load: float) -> float:
    """Largest side force of a tire over its load, up to 30 degrees of slip angle. [-]"""
    angles = np.linspace(0.01, radians(30.0), 200)
    return float(np.max(np.abs(np.asarray(tire.unlimited().forces(0.0, angles, load).F_y))) / load)


def peak_friction_along(tire: Tire, load: float) -> float:
    """Largest braking force of a tire over its load, up to a slip of 0.4. [-]"""
    slips = np.linspace(-0.4, -0.01, 100)
    return float(np.max(-np.asarray(tire.unlimited().forces(slips, 0.0, load).F_x))) / load


def with_tires(params: P, tire_f: Tire, tire_r: Tire | None = None) -> P:
    """Parameters with the rolling radius, relaxation lengths and rolling resistance of tires at their static loads.

    The mean of both axles; what the tires do not know, or the car has no parameter for, stays. Relaxation lengths are
    the tires' slip stiffness over that of their carcass.
    """
    rolling = [t.rolling(load) for t, load in zip((tire_f, tire_r or tire_f), wheel_loads(params), strict=True)]
    known = params.metadata()
    values: dict[str, float] = {}
    for name in ("radius", "relaxation_x", "relaxation_y", "rolling_resistance"):
        both = [getattr(r, name) for r in rolling]
        if name in known and None not in both:
            values[name] = sum(both) / 2
    return params.with_values(**values)


def dual_track_on(
    chassis: ChassisParams, tire_f: Tire, tire_r: Tire | None = None, *, car: Mapping[str, float] | None = None
) -> DualTrackParams:
    """A dual track of a bicycle's mass and geometry on tires, with what nobody knows in proportion to its size.

    Centre of gravity at a fifth, tracks 0.55 of the wheelbase, 3 degrees of roll per g with the front axle taking 55 %,
    relaxation lengths of 0.19 wheelbases across and half of that along, driven at up to 4 m/s2 by the front wheels and
    braked at up to 1 g; ``car`` gives other values by the names of
    `DualTrackParams`. Raises ParameterError if one has no such name or leaves its range.
    """
    p = {n: getattr(chassis, n) for n in _GEOMETRY}
    mass, wheelbase, weight = p["mass"], p["wheelbase"], p["mass"] * GRAVITY
    height, track = 0.2 * wheelbase, 0.55 * wheelbase
    radius = tire_f.rolling(wheel_loads(chassis)[0]).radius or 0.12 * wheelbase
    inertia_x, inertia_y = 0.12 * mass * track**2, 0.2 * mass * wheelbase**2
    roll = max(weight * height / radians(3.0), 25.0)  # the least that the record takes, for models of a few kg
    pitch = max(weight * height / radians(1.5), 10.0)
    wheel = 0.02 * mass * radius**2
    values = p | {
        "height": height,
        **dict.fromkeys(("track_f", "track_r"), track),
        "radius": radius,
        **dict.fromkeys(("inertia_wheel_f", "inertia_wheel_r"), wheel),
        **{"relaxation_x": 0.095 * wheelbase, "relaxation_y": 0.19 * wheelbase},
        **{"inertia_x": inertia_x, "inertia_y": inertia_y},
        **{"roll_stiffness_f": 0.55 * roll, "roll_stiffness_r": 0.45 * roll},
        **dict.fromkeys(("roll_damping_f", "roll_damping_r"), 0.5 * (roll * inertia_x) ** 0.5),
        **{"pitch_stiffness": pitch, "pitch_damping": (pitch * inertia_y) ** 0.5},
    }
    drive = Driveline(
        engine=Engine(speeds=(0.0, 1e4), torques=(4.0 * mass * radius,) * 2), final=1.0, shift_up=5000.0, shift_down=0.0
    )
    made = DualTrackParams(**values, brakes=Brakes(torque=weight * radius), driveline=drive)
    return with_tires(made, tire_f, tire_r).with_values(**(car or {}))
