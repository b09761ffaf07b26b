"""`RacingCar`: the lap's car over time, with which a filter learns how much the road holds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from slipangle.models.ode import OdeModel
from slipangle.ops import Scalar, Vector, cos, maximum, sin, stack
from slipangle.optimal.lap.car import LapCar, held, rates
from slipangle.units import SI

SLOWEST = 3.0  # m/s, below which the equations of a car of usual size take this speed
STABLE = 2.4  # of an explicit step times the quickest rate; Runge and Kutta's of fourth order diverges from 2.79 on


def slowest(car: LapCar) -> Scalar:
    """Speed that a racer's equations take where the car is slower. [m/s]"""
    return SLOWEST * car.size**0.5


def steps_in(car: LapCar, dt: float) -> int:
    """How many explicit steps of a sample of ``dt`` [s] follow the car's lateral motion at its `slowest` speed. [-]

    That is the quicker the stiffer the axles and the lighter the car, and the slower it goes.
    """
    v, C_f, C_r = float(slowest(car)), car.C_f, car.C_r
    turn = (car.l_r * C_r - car.l_f * C_f) / v
    spin = (car.l_f**2 * C_f + car.l_r**2 * C_r) / v
    linear = [
        [-(C_f + C_r) / v / car.mass, turn / car.mass - v],
        [turn / car.inertia_z, -spin / car.inertia_z],
    ]
    quickest = float(np.abs(np.linalg.eigvals(linear)).max())
    return max(math.ceil(dt * quickest / STABLE), 1)


@dataclass(frozen=True, kw_only=True)
class OnRoad(LapCar):
    """The lap's car on a road whose friction differs from what was expected."""

    grip: Annotated[float, SI("-", "friction of the tires over that of the lap's car", 0.2, 2.0)] = 1.0

    @classmethod
    def of(cls, car: LapCar) -> OnRoad:
        """The car on the road it is known on."""
        return cls(**{name: getattr(car, name) for name in LapCar.metadata()})

    @property
    def here(self) -> OnRoad:
        """The car with its friction on this road."""
        return self.with_values(mu_f=self.grip * self.mu_f, mu_r=self.grip * self.mu_r)


@dataclass(frozen=True, kw_only=True)
class RacingCar(OdeModel):
    """The lap's car over time, its steering and longitudinal force given, and accelerations that they do not explain.

    States are X, Y, psi [m, m, rad], v_x, v_y [m/s], r [rad/s], ``d_v_x`` [m/s2] and ``d_r`` [rad/s2]; inputs the
    road-wheel angle and the force of the tires along the car [rad, N]; signals a_x and a_y as an accelerometer shows
    them. [m/s2]
    """

    states = ("X", "Y", "psi", "v_x", "v_y", "r", "d_v_x", "d_r")
    inputs = ("delta", "F_x")
    params: OnRoad
    outputs: tuple[str, ...] = ("X", "Y", "psi", "v_x", "r", "a_x", "a_y")

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Planar motion."""
        psi, v_y, r = x[2], x[4], x[5]
        v_x = maximum(x[3], slowest(self.params))
        car = self.params.here
        motion = rates(v_x, v_y, r, u[0], u[1], car, a_y=held(v_x, r, car))
        c, s = cos(psi), sin(psi)
        return stack(
            [
                v_x * c - v_y * s,
                v_x * s + v_y * c,
                r,
                motion.v_x + x[6],
                motion.v_y,
                motion.r + x[7],
                0.0 * r,
                0.0 * r,
            ]
        )

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Accelerations."""
        v_y, r = x[4], x[5]
        v_x = maximum(x[3], slowest(self.params))
        car = self.params.here
        motion = rates(v_x, v_y, r, u[0], u[1], car, a_y=held(v_x, r, car))
        return {"a_x": motion.v_x - v_y * r + x[6], "a_y": motion.v_y + v_x * r}
