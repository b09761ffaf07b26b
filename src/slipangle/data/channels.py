"""The names that channels have everywhere in the toolbox, with unit, meaning and plausible size."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True)
class Quantity:
    """Unit, meaning and largest plausible magnitude (all SI) of a channel name."""

    unit: str
    doc: str
    largest: float = math.inf


STANDARD: Mapping[str, Quantity] = MappingProxyType(
    {
        "t": Quantity("s", "time"),
        "delta": Quantity("rad", "steering angle of the front road wheels, positive to the left", 1.6),
        "delta_r": Quantity("rad", "steering angle of the rear road wheels, positive to the left", 1.6),
        "delta_sw": Quantity("rad", "steering-wheel angle, positive to the left", 30.0),
        "v_x": Quantity("m/s", "longitudinal velocity of the centre of gravity", 150.0),
        "v_y": Quantity("m/s", "lateral velocity of the centre of gravity, positive to the left", 60.0),
        "r": Quantity("rad/s", "yaw rate, positive to the left", 10.0),
        "r_dot": Quantity("rad/s2", "yaw acceleration", 100.0),
        "beta": Quantity("rad", "side slip angle, positive when the car moves to its left", math.pi),
        "a_x": Quantity("m/s2", "longitudinal acceleration", 100.0),
        "a_y": Quantity("m/s2", "lateral acceleration, positive to the left", 100.0),
        "omega_f": Quantity("rad/s", "spin of the front wheels", 1000.0),
        "omega_r": Quantity("rad/s", "spin of the rear wheels", 1000.0),
        "X": Quantity("m", "ground-frame position along X"),
        "Y": Quantity("m", "ground-frame position along Y"),
        "psi": Quantity("rad", "heading from X to the vehicle's x, counter-clockwise"),
        "T_f": Quantity("N m", "drive torque on the front axle"),
        "T_r": Quantity("N m", "drive torque on the rear axle"),
        "M_z": Quantity("N m", "yaw moment by drive and brakes, positive to the left"),
        "pedal": Quantity("-", "throttle minus brake, -1 to 1", 1.001),
        "throttle": Quantity("-", "throttle, 0 to 1", 1.001),
        "brake": Quantity("Pa", "brake pressure, commanded or measured", 1e8),
    }
)
"""Standard channel names; other names are free but have no default unit."""


def _of_wheels(name: str, unit: str, doc: str) -> dict[str, Quantity]:
    wheels = {"fl": "front left", "fr": "front right", "rl": "rear left", "rr": "rear right"}
    return {f"{name}_{w}": Quantity(unit, f"{doc} of the {which} wheel") for w, which in wheels.items()}


INNER: Mapping[str, Quantity] = MappingProxyType(
    {
        "v_x_dot": Quantity("m/s2", "derivative of v_x"),
        "delta_w": Quantity("rad", "road-wheel angle after the steering's lag, positive to the left"),
        "delta_c": Quantity("rad", "road-wheel angle that compliance adds, positive to the left"),
        "delta_s": Quantity("rad", "logged steering angle after the steering's lag, before its gain and offset"),
        "v_x_s": Quantity("m/s", "logged speed behind the lag of the wheel loads"),
        "alpha_f": Quantity("rad", "slip angle that the front axle feels, positive gives a force to the left"),
        "alpha_r": Quantity("rad", "slip angle that the rear axle feels, positive gives a force to the left"),
        "bank": Quantity("rad", "cross slope of the road, positive with the left edge higher"),
        "grade": Quantity("rad", "slope of the road, positive uphill"),
        "curvature": Quantity("1/m", "curvature of the path, positive in a bend to the left"),
        "phi_rate": Quantity("rad/s", "roll rate of the body, positive right side down"),
        "theta_rate": Quantity("rad/s", "pitch rate of the body, positive nose down"),
        "a_x_lag": Quantity("m/s2", "longitudinal acceleration by the tires, lagging as the wheel loads do"),
        "a_y_lag": Quantity("m/s2", "lateral acceleration by the tires, lagging as the wheel loads do"),
        "T_e": Quantity("N m", "engine torque"),
        "T_bf": Quantity("N m", "brake torque on the front axle, of both wheels"),
        "T_br": Quantity("N m", "brake torque on the rear axle, of both wheels"),
        **_of_wheels("omega", "rad/s", "spin, positive when rolling forward,"),
        **_of_wheels("slip", "-", "slip ratio, positive drives,"),
        **_of_wheels("side", "-", "sine of the slip angle, positive gives a force to the left,"),
        **_of_wheels("alpha", "rad", "slip angle, positive gives a force to the left,"),
        **_of_wheels("F_x", "N", "force in the wheel's plane, positive drives,"),
        **_of_wheels("F_y", "N", "force across the wheel's plane, positive to the left,"),
        **_of_wheels("F_z", "N", "load, positive,"),
    }
)
"""What is inside of models of vehicles, which no log is read for; docs/nomenclature.md has them all."""
