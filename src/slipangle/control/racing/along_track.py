"""`AlongTrack`: a lap's car over the arc length of a track, what a plan at the limit is made with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from slipangle.control.racing.on_road import slowest
from slipangle.models.ode import OdeModel
from slipangle.ops import Scalar, Vector, cos, maximum, sin, sqrt, stack
from slipangle.optimal.lap.car import LapCar, held, rates

ASKED = 8  # state of the angle that is asked for
LEAST = 0.02  # s, a lag of a car of usual size at least
NEAR_NONE = 0.02  # of the weight, force in which one lag goes over into the other


@dataclass(frozen=True, kw_only=True)
class AlongTrack(OdeModel):
    """The lap's car, a stage of ``stage`` metres in every sample. [1]_ sec. 3

    States are offset and heading against the track's line [m, rad], v_x, v_y [m/s], r [rad/s], road-wheel angle
    [rad], longitudinal force and the force that is asked for [N], which the former follows late; inputs the rates of
    the angle and of what is asked for [rad/s, N/s], and what the road and the car are like there: curvature of the
    track's line [1/m], length of the stage [m], peak friction of both axles [-], and rates of v_x and r that the
    equations leave out. [m/s2, rad/s2]

    Parameters
    ----------
    params : LapCar
        The car; the friction is given by the inputs.
    drive_lag, brake_lag : float
        Time constants of driving and of braking forces. [s]

    .. [1] R. Verschueren et al., Time-optimal race car driving using an online exact Hessian based nonlinear MPC
       algorithm, European Control Conference, 2016.
    """

    states = ("n", "chi", "v_x", "v_y", "r", "delta", "F_x", "F_asked")
    inputs = ("delta_rate", "F_rate", "curvature", "stage", "mu_f", "mu_r", "d_v_x", "d_r")
    params: LapCar
    drive_lag: float = 0.0
    brake_lag: float = 0.0

    @staticmethod
    def on(car: LapCar, u: Vector) -> LapCar:
        """The car with the friction of a stage."""
        return car.with_values(mu_f=u[4], mu_r=u[5])

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Change over a sample, in which the car goes on by ``stage``, over the sample time."""
        n, chi, v_y, r, delta, F, asked = x[0], x[1], x[3], x[4], x[5], x[6], x[7]
        v_x, car = maximum(x[2], slowest(self.params)), self.on(self.params, u)
        motion = rates(v_x, v_y, r, delta, F, car, a_y=held(v_x, r, car))
        pace = self.pace(n, chi, v_x, v_y, u[2])
        each = u[3] / self.dt
        turning, *asked_for = self._steering(x, u)
        over_time = (
            v_x * sin(chi) + v_y * cos(chi),
            r - u[2] / pace,
            motion.v_x + u[6],
            motion.v_y,
            motion.r + u[7],
            turning,
            (asked - F) / self._lag(asked),
            u[1],
            *asked_for,
        )
        return stack([each * pace * rate for rate in over_time])

    def _steering(self, x: Vector, u: Vector) -> tuple[Scalar, ...]:
        """Rate of the road-wheel angle, and of the angle that is asked for where that is another. [rad/s]"""
        return (u[0],)

    def _lag(self, asked: Scalar) -> Scalar:
        """Time constant of the force, between those of braking and driving near none. [s]"""
        least = LEAST * self.params.size**0.5
        drive, brake = max(self.drive_lag, least), max(self.brake_lag, least)
        width = NEAR_NONE * self.params.weight
        return brake + 0.5 * (drive - brake) * (1.0 + asked / sqrt(asked * asked + width * width))

    def pace(self, n: Scalar, chi: Scalar, v_x: Scalar, v_y: Scalar, curvature: Scalar) -> Scalar:
        """Time per metre of the track's line. [s/m]"""
        return (1.0 - n * curvature) / maximum(v_x * cos(chi) - v_y * sin(chi), slowest(self.params))


@dataclass(frozen=True, kw_only=True)
class LateAlongTrack(AlongTrack):
    """The same with a steering that answers late: one state more, the angle that is asked for. [rad]

    Parameters
    ----------
    steering_lag : float
        Time constant of the steering. [s]
    """

    states = (*AlongTrack.states, "delta_asked")
    steering_lag: float

    def _steering(self, x: Vector, u: Vector) -> tuple[Scalar, ...]:
        return (x[ASKED] - x[5]) / self.steering_lag, u[0]


def along_track(steering_lag: float, *, params: LapCar, **settings: Any) -> AlongTrack:
    """A car's equations for a steering that follows with a lag [s], which counts if it is longer than `LEAST`."""
    if steering_lag > LEAST * params.size**0.5:
        return LateAlongTrack(steering_lag=steering_lag, params=params, **settings)
    return AlongTrack(params=params, **settings)
