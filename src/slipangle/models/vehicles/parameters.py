"""Parameter records that several vehicles share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Self

from slipangle.models.parameters import ParameterSet
from slipangle.ops import Scalar
from slipangle.units import SI

GRAVITY = 9.81  # m/s2, the value of the thesis' tables


@dataclass(frozen=True, kw_only=True)
class ChassisParams(ParameterSet):
    """Mass, geometry and steering: what every planar model needs."""

    mass: Annotated[float, SI("kg", "vehicle mass", 1.0, 1e5)]
    inertia_z: Annotated[float, SI("kg m2", "yaw moment of inertia", 1e-3, 1e6)]
    wheelbase: Annotated[float, SI("m", "wheelbase", 0.1, 20.0)]
    l_f: Annotated[float, SI("m", "centre of gravity to front axle", 0.01, 15.0)]
    steering_gain: Annotated[float, SI("-", "road-wheel angle per logged steering angle", -20.0, 20.0)] = 1.0
    steering_offset: Annotated[float, SI("rad", "logged steering angle when driving straight", -0.3, 0.3)] = 0.0
    bias_r: Annotated[float, SI("rad/s", "measured yaw rate when there is none", -0.1, 0.1)] = 0.0
    bias_v_y: Annotated[float, SI("m/s", "measured lateral velocity when there is none", -5.0, 5.0)] = 0.0
    bias_a_y: Annotated[float, SI("m/s2", "measured lateral acceleration when there is none", -5.0, 5.0)] = 0.0

    @property
    def l_r(self) -> Scalar:
        """Distance from the centre of gravity to the rear axle. [m]"""
        return self.wheelbase - self.l_f

    @property
    def bicycle(self) -> BicycleParams | None:
        """The parameters where they are those of a linear bicycle."""
        return None

    def road_wheel(self, delta: Scalar) -> Scalar:
        """Road-wheel angle from the logged steering angle. [rad]"""
        return self.steering_gain * (delta - self.steering_offset)


@dataclass(frozen=True, kw_only=True)
class BicycleParams(ChassisParams):
    """Linear bicycle: cornering stiffness is per axle."""

    C_f: Annotated[float, SI("N/rad", "front cornering stiffness, per axle", 1.0, 1e7)]
    C_r: Annotated[float, SI("N/rad", "rear cornering stiffness, per axle", 1.0, 1e7)]

    @property
    def bicycle(self) -> Self:
        """The parameters themselves."""
        return self


@dataclass(frozen=True, kw_only=True)
class SingleTrackParams(ChassisParams):
    """Single track with wheel spin: inertia of both wheels of an axle together."""

    inertia_wheel_f: Annotated[float, SI("kg m2", "spin inertia of the front axle", 1e-6, 1e3)]
    inertia_wheel_r: Annotated[float, SI("kg m2", "spin inertia of the rear axle", 1e-6, 1e3)]
    radius: Annotated[float, SI("m", "rolling radius", 0.01, 2.0)]

    @property
    def load_f(self) -> Scalar:
        """Static load on one front wheel. [N]"""
        return 0.5 * self.mass * GRAVITY * self.l_r / self.wheelbase

    @property
    def load_r(self) -> Scalar:
        """Static load on one rear wheel. [N]"""
        return 0.5 * self.mass * GRAVITY * self.l_f / self.wheelbase
