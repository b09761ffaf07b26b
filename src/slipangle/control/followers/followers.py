"""Path followers to compare with: pure pursuit and Stanley. All steer; a driver holds the speed.

Each is a controller for `slipangle.simulate.loop.closed_loop`, and a function of state and preview alone.
"""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter
from typing import Any

import numpy as np

from slipangle.control.call import applied_before, both, doubt, given
from slipangle.control.controller import Ahead, SteeringController
from slipangle.fields import Checked, Count, Positive
from slipangle.models.model import Model
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.kinematic import Kinematic
from slipangle.models.vehicles.parameters import BicycleParams, ChassisParams
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.checks import NUMBER, counted, health_of
from slipangle.optimal.ocp import Reference
from slipangle.optimal.solution import Plan, Status, within


class SteeringLaw(SteeringController):
    """One steering angle at a time, within limit [rad] and rate [rad/s]."""

    limit: Any
    rate: Any

    @abc.abstractmethod
    def _angle(self, x: np.ndarray, wanted: Reference, before: float) -> float:
        """Steering command, the one before given. [rad]"""

    def plan(
        self, x: np.ndarray, /, reference: Ahead, previous: Plan | None = None, *, applied: np.ndarray | None = None
    ) -> Plan:
        """See `Controller.plan`: the angle now, held over the horizon, and the one before if the state cannot be."""
        begin = perf_counter()
        x, wanted = given(self, x, reference, previous)
        before = applied_before(previous, applied, self.controls, np.zeros(1), -self.limit, self.limit)
        judge = self._judge
        wrong = judge.status(x, wanted.tracked, wanted.exogenous)
        angle = float(before[0])
        if wrong is None:
            try:
                angle = self._angle(x, wanted, angle)
            except (ArithmeticError, ValueError):  # a law that has no answer
                angle = math.nan
            if not math.isfinite(angle):
                angle, wrong = float(before[0]), Status.FAILED
        bounds, steps = np.array([[-self.limit, self.limit]]), np.array([[-self.rate, self.rate]]) * self.dt
        u = within(np.full((self.horizon, 1), angle), before, bounds, steps)
        return Plan(
            u=u,
            x=np.tile(np.where(np.abs(x) < NUMBER, x, 0.0), (self.horizon + 1, 1)),
            status=wrong or Status.SOLVED,
            seconds=perf_counter() - begin,
            cost=math.nan,
            iterations=0,
            controls=self.controls,
            age=0 if wrong is None else (1 if previous is None else counted(previous.age) + 1),
            detail=both(
                judge.fault(x, wanted.tracked, wanted.exogenous) if wrong is Status.IMPLAUSIBLE else "",
                doubt(applied, self.controls, -self.limit, self.limit),
            ),
            times=self.times,
            health=health_of(previous).after(wrong is not None, False),
        )


@dataclass(frozen=True, kw_only=True)
class PathFollower(Checked, SteeringLaw):
    """A steering law; subclasses say from what model's state and how.

    Parameters
    ----------
    params : ChassisParams
        Geometry of the car, its steering gain and offset.
    dt : float
        Time between commands. [s]
    horizon : int
        How many steps it looks ahead.
    limit : float
        Largest steering angle. [rad]
    rate : float
        Largest steering rate. [rad/s]

    Raises
    ------
    ParameterError
        If a number is not positive.
    """

    controls = ("delta",)
    columns = references = ("X", "Y", "psi", "curvature", "v_x")

    params: ChassisParams
    dt: Positive = 0.05
    horizon: Count = 20
    limit: Positive = 0.5
    rate: Positive = math.inf

    @abc.abstractmethod
    def law(self, x: np.ndarray, ahead: np.ndarray, v_x: float, last: float) -> float:
        """Road-wheel angle. [rad]

        Parameters
        ----------
        x : array, shape (n_states,)
            State of the model.
        ahead : array, shape (horizon + 1, 5)
            The path: X, Y, psi, curvature, v_x now and at each step.
        v_x : float
            Speed. [m/s]
        last : float
            Road-wheel angle applied before. [rad]
        """

    def _angle(self, x: np.ndarray, wanted: Reference, before: float) -> float:
        last = float(self.params.road_wheel(before))
        road = self.law(x, wanted.tracked, float(wanted.exogenous[0, 0]), last)
        return float(road / self.params.steering_gain + self.params.steering_offset)


def pose_of(ahead: np.ndarray, k: int) -> tuple[float, float, float]:
    """X, Y, psi of a row."""
    return float(ahead[k, 0]), float(ahead[k, 1]), float(ahead[k, 2])


@dataclass(frozen=True, kw_only=True)
class PurePursuit(PathFollower):
    """Steer onto the circle through the rear axle, tangent to the car, and a point ahead on the path. [1]_

    ``delta = atan(2 wheelbase sin(eta) / distance)``, eta the bearing of the point from the rear axle.

    Parameters
    ----------
    gain : float
        Look-ahead distance over speed. [s]
    shortest : float
        Least look-ahead distance. [m]

    The others are those of `PathFollower`; the horizon must reach as far as the look-ahead distance, or its end counts.

    References
    ----------
    .. [1] R. C. Coulter, Implementation of the pure pursuit path tracking algorithm, CMU-RI-TR-92-01, 1992.
    """

    gain: float = 0.5
    shortest: float = 4.0

    @cached_property
    def model(self) -> Model:  # type: ignore[override]  # made once
        """Kinematic: only the pose counts."""
        return Kinematic(params=self.params, dt=self.dt)

    def law(self, x: np.ndarray, ahead: np.ndarray, v_x: float, last: float) -> float:
        """See the class."""
        X, Y, psi = x[0] - self.params.l_r * math.cos(x[2]), x[1] - self.params.l_r * math.sin(x[2]), x[2]
        wanted = max(self.gain * abs(v_x), self.shortest)
        distance = np.hypot(ahead[:, 0] - X, ahead[:, 1] - Y)
        far = np.flatnonzero(distance >= wanted)
        k = int(far[0]) if len(far) else len(distance) - 1
        x1, y1, d1 = ahead[k, 0], ahead[k, 1], distance[k]
        if len(far) and k > 0 and d1 > distance[k - 1]:  # between two rows
            t = (wanted - distance[k - 1]) / (d1 - distance[k - 1])
            x1, y1 = ahead[k - 1, :2] + t * (ahead[k, :2] - ahead[k - 1, :2])
            d1 = wanted
        eta = math.remainder(math.atan2(y1 - Y, x1 - X) - psi, 2 * math.pi)
        return math.atan2(2 * self.params.wheelbase * math.sin(eta), max(float(d1), 0.1))


@dataclass(frozen=True, kw_only=True)
class Stanley(PathFollower):
    """Steer along the path and towards it, seen from the front axle. [1]_

    ``delta = e_psi + atan(gain e / (softening + v)) + damping (r_path - r)``, with the heading error counted
    to the path at the front axle.

    Parameters
    ----------
    gain : float
        How fast the distance decays. [1/s]
    softening : float
        Speed that keeps the gain finite at standstill. [m/s]
    damping : float
        Steering angle per yaw rate beyond the path's. [s]

    The others are those of `PathFollower`.

    References
    ----------
    .. [1] G. M. Hoffmann, C. J. Tomlin, M. Montemerlo, S. Thrun, Autonomous automobile trajectory tracking for
       off-road driving, American Control Conference, 2007.
    """

    gain: float = 2.5
    softening: float = 1.0
    damping: float = 0.2

    @cached_property
    def model(self) -> Model:  # type: ignore[override]  # made once
        """A car with a yaw rate and a pose."""
        return posed_bicycle(self.params, self.dt)

    def law(self, x: np.ndarray, ahead: np.ndarray, v_x: float, last: float) -> float:
        """See the class."""
        r, X, Y, psi = x[1], x[2], x[3], x[4]
        front = X + self.params.l_f * math.cos(psi), Y + self.params.l_f * math.sin(psi)
        k = int(np.argmin(np.hypot(ahead[:, 0] - front[0], ahead[:, 1] - front[1])))
        x0, y0, angle = pose_of(ahead, k)
        along = (front[0] - x0) * math.cos(angle) + (front[1] - y0) * math.sin(angle)
        curvature = float(ahead[k, 3])
        heading = angle + curvature * along
        e = -(front[0] - x0) * math.sin(angle) + (front[1] - y0) * math.cos(angle) - 0.5 * curvature * along**2
        e_psi = math.remainder(heading - psi, 2 * math.pi)
        pull = math.atan2(-self.gain * e, self.softening + abs(v_x))
        return e_psi + pull + self.damping * (curvature * v_x - r)


def posed_bicycle(p: ChassisParams, dt: float) -> Model:
    """Linear bicycle on the ground; a typical stiffness where the parameters have none, since all is measured."""
    chassis = {name: getattr(p, name) for name in ChassisParams.metadata()}
    stiff = 40.0 * p.mass  # N/rad
    params = p.bicycle or BicycleParams(C_f=stiff, C_r=stiff, **chassis)
    return OnGround(Bicycle(params=params, dt=dt, outputs=("v_y", "r")))
