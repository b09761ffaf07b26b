"""What every vehicle on two axles shares: how its axles move, the slip angles, and where its forces push it.

.. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023.
"""

from typing import Any

from slipangle.models.vehicles.parameters import ChassisParams
from slipangle.ops import Scalar, atan, atan2, cos, maximum, sin, speed_floor


def axle_velocities(v_y: Scalar, r: Scalar, p: ChassisParams) -> tuple[Scalar, Scalar]:
    """Lateral velocities of the front and the rear axle. [m/s] [1]_ eqs. 3-11, 3-12"""
    return v_y + p.l_f * r, v_y - p.l_r * r


def slip_angles(v_x: Scalar, v_y: Scalar, r: Scalar, delta: Scalar, p: ChassisParams) -> tuple[Scalar, Scalar]:
    """Slip angles of the front and the rear axle at any speed, softened below `crawl`. [rad]

    They use atan2 of the axle's velocity and reduce to eqs. 3-11, 3-12 of [1]_ at small angles; alpha > 0 gives a
    force to the left. A wheel at rest that is turned feels no slip.
    """
    v_yf, v_yr = axle_velocities(v_y, r, p)
    v = speed_floor(v_x, crawl(p))
    return delta * v_x / v - atan2(v_yf, v), -atan2(v_yr, v)


def small_slip_angles(v: Scalar, v_y: Scalar, r: Scalar, delta: Scalar, p: ChassisParams) -> tuple[Scalar, Scalar]:
    """Slip angles of the front and the rear axle where they are small, at a speed ``v`` above zero. [rad]"""
    v_yf, v_yr = axle_velocities(v_y, r, p)
    return delta - v_yf / v, -v_yr / v


def turned_slip_angles(v: Scalar, v_y: Scalar, r: Scalar, delta: Scalar, p: ChassisParams) -> tuple[Scalar, Scalar]:
    """The same where the front wheels may be turned far, as in a parking lot; the rear's stays small. [rad]"""
    v_yf, v_yr = axle_velocities(v_y, r, p)
    return delta - atan(v_yf / v), -v_yr / v


def crawl(p: ChassisParams) -> float:
    """Speed below which slip is softened, in proportion to the car: 0.2 wheelbases a second. [m/s]"""
    return 0.2 * p.wheelbase


def lowest_speed(p: ChassisParams, C_f: Scalar, C_r: Scalar, *, locked: Scalar = 0.0) -> Scalar:
    """Speed below which small slip angles keep it as their denominator, in proportion to the car. [m/s]

    0.4 wheelbases a second, or more where explicit steps of up to 10 ms could not follow: where tires of the stiffness
    ``C_f``, ``C_r`` [N/rad], and an axle whose wheels turn as one, with a damping of ``locked`` [N m2/rad], are too
    quick, the sum of the lateral modes' rates beyond 400 /s.
    """
    turn = C_f * p.l_f * p.l_f + C_r * p.l_r * p.l_r + locked
    rates = (C_f + C_r) / p.mass + turn / p.inertia_z  # times speed
    return maximum(0.4 * p.wheelbase, rates / 400.0)


def slip_speed(v_x: Scalar, p: Any) -> Scalar:
    """Speed that small slip angles of a car with ``C_f`` and ``C_r`` are told over, see `lowest_speed`. [m/s]"""
    return maximum(v_x, lowest_speed(p, p.C_f, p.C_r))


def steered(F_x: Scalar, F_y: Scalar, delta: Scalar) -> tuple[Scalar, Scalar]:
    """Forces along and across the vehicle of a wheel that is turned by ``delta``. [N]"""
    return F_x * cos(delta) - F_y * sin(delta), F_x * sin(delta) + F_y * cos(delta)


def ground_velocity(v_x: Scalar, v_y: Scalar, psi: Scalar) -> tuple[Scalar, Scalar]:
    """Rates of X and Y [m/s] of a vehicle that moves at v_x, v_y in its own axes."""
    return v_x * cos(psi) - v_y * sin(psi), v_x * sin(psi) + v_y * cos(psi)
