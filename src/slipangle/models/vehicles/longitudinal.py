"""Speed from pedals: a straight law, and one with the limits of a real car.

.. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023.
"""

from dataclasses import dataclass
from typing import Annotated

from slipangle.data.dataset import Dataset
from slipangle.models.ode import OdeModel
from slipangle.models.parameters import ParameterSet
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.ops import Scalar, Vector, maximum, sqrt, stack, tanh
from slipangle.units import SI


@dataclass(frozen=True, kw_only=True)
class LongitudinalParams(ParameterSet):
    """Speed from pedals."""

    mass: Annotated[float, SI("kg", "vehicle mass", 1e-3, 1e5)]
    k_e: Annotated[float, SI("N", "force at full pedal", 0.0, 1e6)]
    k_d: Annotated[float, SI("N s/m", "linear drag", -1e4, 1e4)]
    k_r: Annotated[float, SI("-", "rolling resistance coefficient", -2.0, 2.0)]


def longitudinal(v_x: Scalar, pedal: Scalar, p: LongitudinalParams, v_low: float = 0.1) -> Scalar:
    """Acceleration from the pedals. [m/s2] [1]_ eq. 3-18.

    ``pedal`` is throttle minus brake, -1 to 1. Rolling resistance fades out below ``v_low`` so that the
    car can stand.
    """
    return (p.k_e * pedal - p.k_d * v_x) / p.mass - GRAVITY * p.k_r * tanh(v_x / v_low)


@dataclass(frozen=True, kw_only=True)
class Longitudinal(OdeModel):
    """Speed from pedals: state and output v_x [m/s]; input pedal, -1 to 1."""

    states = ("v_x",)
    inputs = ("pedal",)
    params: LongitudinalParams

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """See `longitudinal`."""
        return stack([longitudinal(x[0], u[0], self.params)])


@dataclass(frozen=True, kw_only=True)
class DrivelineParams(ParameterSet):
    """Forces along the car; everything beyond ``k_e`` and ``k_b`` may stay at zero or without effect."""

    mass: Annotated[float, SI("kg", "vehicle mass", 1e-3, 1e5)]
    k_e: Annotated[float, SI("N", "driving force at full throttle, low speed", 0.0, 1e6)]
    k_b: Annotated[float, SI("N/Pa", "braking force per brake pressure", 0.0, 1.0)]
    power: Annotated[float, SI("W", "engine power at full throttle", 1e-2, 1e7)] = 3e5
    drag: Annotated[float, SI("kg/m", "drag force per speed squared", 0.0, 10.0)] = 0.8
    k_d: Annotated[float, SI("N s/m", "drag force per speed", -1e3, 1e3)] = 0.0
    k_r: Annotated[float, SI("-", "rolling resistance coefficient", -0.5, 0.5)] = 0.015
    engine_brake: Annotated[float, SI("N s/m", "drag force per speed at closed throttle", 0.0, 1e3)] = 0.0
    grip: Annotated[float, SI("-", "largest braking force over weight", 0.05, 5.0)] = 2.0
    scrub: Annotated[float, SI("1/m", "deceleration per (road-wheel angle times speed)^2", -5.0, 20.0)] = 0.0
    lag: Annotated[float, SI("s", "time constant from pedals to force", 0.01, 3.0)] = 0.1
    grade: Annotated[float, SI("rad", "slope of the road, uphill positive", -0.3, 0.3)] = 0.0


def driveline(
    v_x: Scalar, throttle: Scalar, brake: Scalar, delta: Scalar, p: DrivelineParams, v_low: float = 1.0
) -> Scalar:
    """Acceleration from the pedals. [m/s2] Extends [1]_ eq. 3-18 by limits of engine and brakes, drag, slope.

    The throttle is 0 to 1, the brake a pressure [Pa]; full throttle gives the smaller of ``k_e`` and ``power / v_x``,
    smoothly. Tires at a slip angle pull the car back, so the road-wheel angle ``delta`` [rad] counts too. Below
    ``v_low`` [m/s] forces that oppose motion fade out.
    """
    v = maximum(v_x, v_low)
    full = p.k_e / sqrt(1.0 + (p.k_e * v / p.power) ** 2)
    most = p.grip * p.mass * GRAVITY
    braking = most * tanh(p.k_b * brake / most)
    closed = maximum(1.0 - throttle, 0.0)
    against = p.drag * v_x * v_x + p.k_d * v_x + p.engine_brake * closed * v_x + p.mass * p.scrub * (delta * v_x) ** 2
    rolling = p.k_r * p.mass * GRAVITY
    forward = tanh(v_x / v_low)
    return (full * throttle - (braking + against + rolling) * forward) / p.mass - GRAVITY * p.grade


@dataclass(frozen=True, kw_only=True)
class PedalCar(OdeModel):
    """Speed from pedals and steering: see `driveline`.

    States v_x [m/s], throttle and brake after the lag [-, Pa]; inputs throttle [0 to 1], brake [Pa], delta [rad];
    output v_x.
    """

    states = ("v_x", "throttle_lagged", "brake_lagged")
    inputs = ("throttle", "brake", "delta")
    params: DrivelineParams
    outputs: tuple[str, ...] = ("v_x",)

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """See `driveline`."""
        p = self.params
        return stack([driveline(x[0], x[1], x[2], u[2], p), (u[0] - x[1]) / p.lag, (u[1] - x[2]) / p.lag])

    def _start(self, name: str, data: Dataset) -> float:
        return float(data[name.removesuffix("_lagged")][0])  # pedals at their first reading
