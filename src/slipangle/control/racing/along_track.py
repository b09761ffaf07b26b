"""`AlongTrack`: a lap's car over the arc length of a track, what a plan at the limit is made with."""

from __future__ import annotations

from dataclasses import dataclass

from slipangle.models.ode import OdeModel
from slipangle.ops import Scalar, Vector, cos, maximum, sin, stack
from slipangle.optimal.lap.car import LapCar, rates

SLOWEST = 3.0  # m/s, below which the equations take this speed


@dataclass(frozen=True, kw_only=True)
class AlongTrack(OdeModel):
    """The lap's car, a stage of ``stage`` metres in every sample. [1]_ sec. 3

    States are offset and heading against the track's line [m, rad], v_x, v_y [m/s], r [rad/s], road-wheel angle [rad]
    and longitudinal force [N]; inputs the rates of the last two [rad/s, N/s], and what the road and the car are like
    there: curvature of the track's line [1/m], length of the stage [m] and peak friction of both axles. [-]

    .. [1] R. Verschueren et al., Time-optimal race car driving using an online exact Hessian based nonlinear MPC
       algorithm, European Control Conference, 2016.
    """

    states = ("n", "chi", "v_x", "v_y", "r", "delta", "F_x")
    inputs = ("delta_rate", "F_rate", "curvature", "stage", "mu_f", "mu_r")
    params: LapCar

    @staticmethod
    def on(car: LapCar, u: Vector) -> LapCar:
        """The car with the friction of a stage."""
        return car.with_values(mu_f=u[4], mu_r=u[5])

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Change over a sample, in which the car goes on by ``stage``, over the sample time."""
        n, chi, v_y, r, delta, F = x[0], x[1], x[3], x[4], x[5], x[6]
        v_x = maximum(x[2], SLOWEST)
        motion = rates(v_x, v_y, r, delta, F, self.on(self.params, u))
        pace = self.pace(n, chi, v_x, v_y, u[2])
        each = u[3] / self.dt
        over_time = (
            v_x * sin(chi) + v_y * cos(chi),
            r - u[2] / pace,
            motion.v_x,
            motion.v_y,
            motion.r,
            u[0],
            u[1],
        )
        return stack([each * pace * rate for rate in over_time])

    @staticmethod
    def pace(n: Scalar, chi: Scalar, v_x: Scalar, v_y: Scalar, curvature: Scalar) -> Scalar:
        """Time per metre of the track's line. [s/m]"""
        return (1.0 - n * curvature) / maximum(v_x * cos(chi) - v_y * sin(chi), SLOWEST)
