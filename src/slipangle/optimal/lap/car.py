"""`LapCar`: what a lap needs to know of a car, and its forces at the limit, written once.

.. [1] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

from slipangle.models.tires.magic_formula.terms import curved
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycleParams
from slipangle.models.vehicles.parameters import GRAVITY, ChassisParams
from slipangle.ops import Scalar, atan, clip, cos, maximum, sin, sqrt
from slipangle.units import SI

_CORNER, _PEAK, _LATERAL, _COAST = 0.004, 0.004, 0.02, 0.03
USUAL = 2.5789128  # m, wheelbase of the car that what lap and racer count in m, s and m/s is for, a BMW 320i
_UNUSED = ("steering_gain", "steering_offset", "bias_r", "bias_v_y", "bias_a_y", "steering_lag", "compliance")


def size_of(p: ChassisParams) -> Scalar:
    """Wheelbase over that of a usual car: defaults in m go with it, those in s and m/s with its root. [-]"""
    return p.wheelbase / USUAL


@dataclass(frozen=True, kw_only=True)
class LapCar(NonlinearBicycleParams):
    """The nonlinear bicycle's parameters, and the engine, brakes, air and driver that bound a lap.

    The two tires of an axle share its longitudinal force by their grip, as behind a locked differential and with
    anti-lock brakes, or with ``even=1`` evenly, as behind an open one and with plain brakes: then the less loaded one
    bounds the force. Each is on its own load from load transfer and downforce. `slipangle.optimal.lap.cars.lap_car`
    makes one of any model of a car.
    """

    power: Annotated[float, SI("W", "largest driving power at the wheels", 0.01, 1e7)]
    drive_force: Annotated[float, SI("N", "largest driving force", 0.001, 1e6)] = 1e6
    brake_force: Annotated[float, SI("N", "largest braking force", 0.001, 1e6)] = 1e6
    rolling_resistance: Annotated[float, SI("-", "rolling resistance over load", 0.0, 0.5)] = 0.0
    downforce_f: Annotated[float, SI("kg/m", "front downforce per speed squared", -5.0, 50.0)] = 0.0
    downforce_r: Annotated[float, SI("kg/m", "rear downforce per speed squared", -5.0, 50.0)] = 0.0
    mu_x: Annotated[float, SI("-", "peak friction along over that across the tire", 0.3, 3.0)] = 1.0
    width: Annotated[float, SI("m", "width of the car", 0.0, 5.0)] = 1.8
    delta_max: Annotated[float, SI("rad", "largest road-wheel angle", 0.01, 1.5)] = 0.5
    delta_rate: Annotated[float, SI("rad/s", "largest rate of the road-wheel angle", 0.01, 100.0)] = 1.0
    even: Annotated[
        float, SI("-", "share of an axle's force that its tires get evenly, not by their grip", 0.0, 1.0)
    ] = 0.0
    force_rate: Annotated[float, SI("1/s", "largest rate of the longitudinal force over weight", 0.1, 1000.0)] = 8.0

    @property
    def weight(self) -> Scalar:
        """Mass times gravity. [N]"""
        return self.mass * GRAVITY

    @property
    def size(self) -> Scalar:
        """As `size_of` has it. [-]"""
        return size_of(self)

    def resistance(self, v: Scalar) -> Scalar:
        """Force that the air and the road take at a speed ``v`` [m/s]. [N]"""
        down = self.downforce_f * v * v + self.downforce_r * v * v
        return self.drag * v * v + self.rolling_resistance * (self.weight + down)

    @classmethod
    def felt(cls) -> tuple[str, ...]:
        """Names of the parameters that a lap depends on."""
        return tuple(name for name in cls.metadata() if name not in _UNUSED)


class Axle(NamedTuple):
    """Of an axle: lateral force [N], longitudinal force over its limit [-], largest lateral force at this load [N].

    ``ellipse`` is the share of its friction ellipse that the tire uses which uses more of its own. [-]
    """

    F_y: Scalar
    use: Scalar
    peak: Scalar
    ellipse: Scalar


class Forces(NamedTuple):
    """Longitudinal force of the axles [N], the axles, and what the air and the road take. [N]"""

    F_xf: Scalar
    F_xr: Scalar
    front: Axle
    rear: Axle
    resistance: Scalar


def _positive(x: Scalar, width: Scalar) -> Scalar:
    return 0.5 * (x + sqrt(x * x + width * width))


def axle(
    alpha: Scalar,
    load: Scalar,
    transfer: Scalar,
    static: Scalar,
    F_x: Scalar,
    C: Scalar,
    mu: Scalar,
    E: Scalar,
    p: LapCar,
) -> Axle:
    """Force of two tires at a slip angle [rad], ``transfer`` [N] more and less than half of the axle's load. [1]_

    Friction and stiffness of each fall with its load; the axle's longitudinal force ``F_x`` [N] leaves what is left of
    the friction ellipse. ``static`` is the load at rest [N], at which ``C`` [N/rad] and ``mu`` hold.
    """
    half = 0.5 * static
    peaks, sides = [], []
    for side in (1.0, -1.0):
        wheel = _positive(0.5 * load + side * transfer, _CORNER * half)
        rise = wheel / half - 1.0
        peak = _positive(mu * wheel * (1.0 - p.friction_load * rise), _PEAK * half)
        stiffness = 0.5 * C * (1.0 + rise * (1.0 - p.stiffness_load))
        peaks.append(peak)
        sides.append(peak * sin(p.shape * curved(stiffness / (p.shape * peak) * alpha, E)))
    grip, apart = peaks[0] + peaks[1], peaks[0] - peaks[1]
    by_grip, least = (1.0 - p.even) / grip, grip - sqrt(apart * apart + (_PEAK * half) ** 2)
    F_y, ellipse = 0.0, 0.0
    for peak, lateral in zip(peaks, sides, strict=True):
        use = F_x / p.mu_x * (by_grip + 0.5 * p.even / peak)
        across = lateral * sqrt(_positive(1.0 - use * use, _LATERAL))
        F_y = F_y + across
        ellipse = maximum(ellipse, use * use + across * across / (peak * peak))
    return Axle(F_y, F_x / p.mu_x * (by_grip + p.even / least), grip, sqrt(ellipse))


def forces(
    alpha_f: Scalar, alpha_r: Scalar, F: Scalar, a_y: Scalar, v: Scalar, p: LapCar, balance: Scalar | None = None
) -> Forces:
    """Forces of both axles at their slip angles [rad], driven (or braked, below zero) by ``F`` [N] at a speed [m/s].

    ``a_y`` [m/s2] moves load across, ``F`` moves it along the car. ``balance`` is the rear share of braking instead of
    the parameters'.
    """
    static_f, static_r = p.weight * p.l_r / p.wheelbase, p.weight * p.l_f / p.wheelbase
    down_f, down_r = p.downforce_f * v * v, p.downforce_r * v * v
    drive = _positive(F, _COAST * p.weight)
    brake = F - drive
    F_xr = p.drive_rear * drive + (p.brake_rear if balance is None else balance) * brake
    F_xf = F - F_xr
    across, along = p.mass * a_y, p.transfer_x * F
    front = axle(alpha_f, static_f + down_f - along, across * p.transfer_f, static_f, F_xf, p.C_f, p.mu_f, p.E_f, p)
    rear = axle(alpha_r, static_r + down_r + along, across * p.transfer_r, static_r, F_xr, p.C_r, p.mu_r, p.E_r, p)
    return Forces(F_xf, F_xr, front, rear, p.resistance(v))


class Rates(NamedTuple):
    """Rates of v_x, v_y [m/s2] and r [rad/s2], and the forces that make them."""

    v_x: Scalar
    v_y: Scalar
    r: Scalar
    forces: Forces


def rates(
    v_x: Scalar, v_y: Scalar, r: Scalar, delta: Scalar, F: Scalar, p: LapCar, *, a_y: Scalar | None = None
) -> Rates:
    """Planar motion at a road-wheel angle ``delta`` [rad] and a longitudinal force ``F`` [N]; ``v_x`` [m/s] above zero.

    Loads follow the quasi-steady accelerations ``F / mass`` and ``a_y`` [m/s2], by default ``v_x r``.
    """
    alpha_f, alpha_r = slip(v_x, v_y, r, delta, p)
    acting = forces(alpha_f, alpha_r, F, v_x * r if a_y is None else a_y, v_x, p)
    c, s = cos(delta), sin(delta)
    along = acting.F_xf * c - acting.front.F_y * s + acting.F_xr - acting.resistance
    front = acting.F_xf * s + acting.front.F_y * c
    return Rates(
        along / p.mass + v_y * r,
        (front + acting.rear.F_y) / p.mass - v_x * r,
        (p.l_f * front - p.l_r * acting.rear.F_y) / p.inertia_z,
        acting,
    )


def held(v_x: Scalar, r: Scalar, p: LapCar) -> Scalar:
    """Lateral acceleration ``v_x r``, no more than the tires hold, which a car that swings goes beyond. [m/s2]"""
    load_f = p.weight * p.l_r / p.wheelbase + p.downforce_f * v_x * v_x
    load_r = p.weight * p.l_f / p.wheelbase + p.downforce_r * v_x * v_x
    most = (p.mu_f * load_f + p.mu_r * load_r) / p.mass
    return clip(v_x * r, -most, most)


def slip(v_x: Scalar, v_y: Scalar, r: Scalar, delta: Scalar, p: LapCar) -> tuple[Scalar, Scalar]:
    """Slip angles of the axles, without the guard against standstill, which a lap never reaches. [rad]"""
    return delta - atan((v_y + p.l_f * r) / v_x), -atan((v_y - p.l_r * r) / v_x)
