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
