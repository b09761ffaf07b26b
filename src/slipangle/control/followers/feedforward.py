"""Feed-forward by the understeer gradient, feedback of the distance that a look ahead sees."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from slipangle.control.followers.followers import PathFollower, pose_of, posed_bicycle
from slipangle.fields import NotNegative, Positive
from slipangle.models.model import Model
from slipangle.models.vehicles.parameters import BicycleParams

SLOWEST = 1.0  # m/s, speed below which the gains stay
LONGEST = 0.5  # s, by which the car itself is late at most
SHORTEST = 0.1  # of the wheelbase: the length that a steering angle turns over, in the feedback, at least


@dataclass(frozen=True, kw_only=True)
class FeedforwardFeedback(PathFollower):
    """Steer for the curvature ahead by the identified understeer gradient, and towards the path. [1]_

    ``delta = (wheelbase + K v^2) curvature - k (e_y + x (e_psi + beta))`` with the understeer gradient K, the side slip
    ``beta`` of the steady bend and a look ahead of ``x``. The curvature of the first term is that ``lead`` later, when
    the steering acts, and as much later again as the car takes to answer, see `response`. The gains are scheduled over
    speed: with ``G = v^2 / (wheelbase + K v^2)``, by which a steering angle accelerates the car sideways,
    ``k = bandwidth^2 / G`` and ``x = 2 damping v / bandwidth + lead v`` give the distance this natural frequency and
    damping, as far as the car follows its steering at once.

    Parameters
    ----------
    params : BicycleParams
        Car with cornering stiffness per axle; one with downforce ``at_speed``, that at which it is driven.
    lead : float
        Delay and lag of the steering together. [s]
    bandwidth : float
        Natural frequency of the distance. [rad/s]
    damping : float
        Its damping ratio. [-]

    The others are those of `PathFollower`.

    References
    ----------
    .. [1] N. R. Kapania, J. C. Gerdes, Design of a feedback-feedforward steering controller for accurate path tracking
       and stability at the limits of handling, Vehicle System Dynamics 53(12), 2015.
    """

    params: BicycleParams  # type: ignore[override]  # the narrower set
    lead: NotNegative = 0.0
    bandwidth: Positive = 1.5
    damping: Positive = 1.0

    @cached_property
    def model(self) -> Model:  # type: ignore[override]  # made once
        """The bicycle on the ground."""
        return posed_bicycle(self.params, self.dt)

    @property
    def understeer_gradient(self) -> float:
        """Steering angle more than the wheelbase asks for, per lateral acceleration and curvature's radius. [s2/m]"""
        p = self.params
        return p.mass * (p.l_r / p.C_f - p.l_f / p.C_r) / p.wheelbase

    def response(self, v_x: float) -> float:
        """By how much the lateral acceleration follows the steering late in slow manoeuvres at a speed [m/s]. [s]

        The group delay of the linear bicycle at frequency zero, ``2 damping / frequency - l_r / v`` with its yaw
        frequency and damping; not below zero, where it answers before, and at most 0.5 s, also where it has no steady
        answer.
        """
        p, v = self.params, max(v_x, SLOWEST)
        sum_ = (p.C_f + p.C_r) / p.mass + (p.C_f * p.l_f**2 + p.C_r * p.l_r**2) / p.inertia_z
        stiffness = p.C_f * p.C_r * p.wheelbase**2 / (p.mass * p.inertia_z * v**2)
        stiffness += (p.C_r * p.l_r - p.C_f * p.l_f) / p.inertia_z
        if not stiffness > 0:
            return LONGEST
        return min(max(sum_ / v / stiffness - p.l_r / v, 0.0), LONGEST)

    def law(self, x: np.ndarray, ahead: np.ndarray, v_x: float, last: float) -> float:
        """See the class."""
        p, v = self.params, max(v_x, SLOWEST)
        curvature = float(np.interp(self.lead + self.response(v), self.times, ahead[:, 3]))
        length = p.wheelbase + self.understeer_gradient * v**2
        x0, y0, angle = pose_of(ahead, 0)
        e_y = -(x[2] - x0) * math.sin(angle) + (x[3] - y0) * math.cos(angle)
        beta = (p.l_r - p.mass * p.l_f * v**2 / (p.wheelbase * p.C_r)) * float(ahead[0, 3])
        course = math.remainder(x[4] - angle, 2 * math.pi) + beta
        gain = self.bandwidth**2 * max(length, SHORTEST * p.wheelbase) / v**2
        far = 2.0 * self.damping * v / self.bandwidth + self.lead * v
        return length * curvature - gain * (e_y + far * course)
