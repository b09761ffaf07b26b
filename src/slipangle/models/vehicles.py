"""Vehicle models: kinematic, bicycle, longitudinal, single track with wheel spin.

Each equation is a pure function of states, inputs, parameters and tires; the `Model` classes below them
discretise it and name its channels. Axes and signs: docs/nomenclature.md.
"""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import MissingColumnError, ParameterError, nearest
from slipangle.models.integrate import Method, Step, discretise
from slipangle.models.model import FitInfo, Model
from slipangle.models.parameters import ParameterSet
from slipangle.models.parametrised import Parametrised
from slipangle.models.tires import Tire, slip_ratio
from slipangle.ops import Scalar, Vector, atan2, cos, maximum, sin, speed_floor, stack, tan, tanh
from slipangle.units import SI

GRAVITY = 9.81  # m/s2, the value of the thesis' tables


@dataclass(frozen=True, kw_only=True)
class ChassisParams(ParameterSet):
    """Mass, geometry and steering: what every planar model needs."""

    mass: Annotated[float, SI("kg", "vehicle mass", 1.0, 1e5)]
    inertia_z: Annotated[float, SI("kg m2", "yaw moment of inertia", 1e-3, 1e6)]
    wheelbase: Annotated[float, SI("m", "wheelbase", 0.1, 20.0)]
    l_f: Annotated[float, SI("m", "centre of gravity to front axle", 0.01, 15.0)]
    steering_gain: Annotated[float, SI("-", "road-wheel angle per logged steering angle", 0.2, 5.0)] = 1.0
    steering_offset: Annotated[float, SI("rad", "logged steering angle when driving straight", -0.3, 0.3)] = 0.0

    @property
    def l_r(self) -> Scalar:
        """Distance from the centre of gravity to the rear axle. [m]"""
        return self.wheelbase - self.l_f

    def road_wheel(self, delta: Scalar) -> Scalar:
        """Road-wheel angle from the logged steering angle. [rad]"""
        return self.steering_gain * (delta - self.steering_offset)


@dataclass(frozen=True, kw_only=True)
class BicycleParams(ChassisParams):
    """Linear bicycle: cornering stiffness is per axle."""

    C_f: Annotated[float, SI("N/rad", "front cornering stiffness, per axle", 1.0, 1e7)]
    C_r: Annotated[float, SI("N/rad", "rear cornering stiffness, per axle", 1.0, 1e7)]


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


@dataclass(frozen=True, kw_only=True)
class LongitudinalParams(ParameterSet):
    """Speed from pedals."""

    mass: Annotated[float, SI("kg", "vehicle mass", 1.0, 1e5)]
    k_e: Annotated[float, SI("N", "force at full pedal", 0.0, 1e6)]
    k_d: Annotated[float, SI("N s/m", "linear drag", -1e4, 1e4)]
    k_r: Annotated[float, SI("-", "rolling resistance coefficient", -2.0, 2.0)]


# ---- the equations -------------------------------------------------------------------------------------------------


def kinematic(psi: Scalar, v_x: Scalar, delta: Scalar, p: ChassisParams) -> Vector:
    """Rates of X, Y, psi of the kinematic single track about the centre of gravity, no tire slip.

    Source: R. Rajamani, Vehicle Dynamics and Control, 2nd ed., 2012, eqs. 2.4 to 2.6. The speed ``v_x``
    is that along the vehicle's x axis.
    """
    slope = tan(delta) / p.wheelbase
    v_y = v_x * p.l_r * slope
    return stack([v_x * cos(psi) - v_y * sin(psi), v_x * sin(psi) + v_y * cos(psi), v_x * slope])


def bicycle(v_y: Scalar, r: Scalar, delta: Scalar, v_x: Scalar, p: BicycleParams, v_low: float = 1.0) -> Vector:
    """Rates of v_y [m/s2] and r [rad/s2] of the linear bicycle. [1]_ eqs. 3-19, 3-20, yaw damping corrected.

    ``delta`` is the road-wheel angle [rad], ``v_x`` the speed [m/s], which may vary. Below ``v_low`` the
    speed in the slip denominators stays at ``v_low``, so the model remains defined at standstill.

    References
    ----------
    .. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023; eq. 3-20 prints the yaw damping with C_r l_r^2
       subtracted and a spurious v_x.
    """
    v = maximum(v_x, v_low)
    alpha_f = delta - (v_y + p.l_f * r) / v
    alpha_r = -(v_y - p.l_r * r) / v
    F_yf, F_yr = p.C_f * alpha_f, p.C_r * alpha_r
    return stack([(F_yf + F_yr) / p.mass - v_x * r, (p.l_f * F_yf - p.l_r * F_yr) / p.inertia_z])


def longitudinal(v_x: Scalar, pedal: Scalar, p: LongitudinalParams, v_low: float = 0.1) -> Scalar:
    """Acceleration from the pedals. [m/s2] [1]_ eq. 3-18.

    ``pedal`` is throttle minus brake, -1 to 1. Rolling resistance fades out below ``v_low`` so that the
    car can stand.

    References
    ----------
    .. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023.
    """
    return (p.k_e * pedal - p.k_d * v_x) / p.mass - GRAVITY * p.k_r * tanh(v_x / v_low)


def single_track(x: Vector, u: Vector, p: SingleTrackParams, tire_f: Tire, tire_r: Tire, v_low: float = 0.5) -> Vector:
    """State rates of the single track with wheel spin. [1]_ eqs. 3-1 to 3-8, slip sign corrected.

    Parameters
    ----------
    x : vector of 8
        v_x, v_y [m/s], r [rad/s], omega_f, omega_r [rad/s], X, Y [m], psi [rad].
    u : vector of 3
        Road-wheel angle [rad], drive torque on the front and on the rear axle [N m].
    p : SingleTrackParams
        The car.
    tire_f, tire_r : Tire
        One front and one rear tire; an axle has two.
    v_low : float
        Speed below which slip is softened. [m/s]

    Notes
    -----
    Slip angles use atan2 of the axle's velocity, and the front slip ratio the speed along the wheel's
    own plane; both reduce to eqs. 3-11 to 3-13 at small angles.

    References
    ----------
    .. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023.
    """
    v_x, v_y, r, omega_f, omega_r, psi = x[0], x[1], x[2], x[3], x[4], x[7]
    delta, T_f, T_r = u[0], u[1], u[2]
    v_yf, v_yr = v_y + p.l_f * r, v_y - p.l_r * r
    v = speed_floor(v_x, v_low)
    alpha_f = delta * v_x / v - atan2(v_yf, v)
    alpha_r = -atan2(v_yr, v)
    v_wheel = v_x * cos(delta) + v_yf * sin(delta)
    front = tire_f.forces(slip_ratio(v_wheel, omega_f, p.radius, v_low=v_low), alpha_f, p.load_f)
    rear = tire_r.forces(slip_ratio(v_x, omega_r, p.radius, v_low=v_low), alpha_r, p.load_r)
    F_xf, F_yf, F_xr, F_yr = 2 * front.F_x, 2 * front.F_y, 2 * rear.F_x, 2 * rear.F_y
    along = F_xf * cos(delta) - F_yf * sin(delta)
    across = F_xf * sin(delta) + F_yf * cos(delta)
    return stack(
        [
            (along + F_xr) / p.mass + v_y * r,
            (across + F_yr) / p.mass - v_x * r,
            (p.l_f * across - p.l_r * F_yr) / p.inertia_z,
            (T_f - F_xf * p.radius) / p.inertia_wheel_f,
            (T_r - F_xr * p.radius) / p.inertia_wheel_r,
            v_x * cos(psi) - v_y * sin(psi),
            v_x * sin(psi) + v_y * cos(psi),
            r,
        ]
    )


# ---- the models ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class OdeModel(Parametrised, Model):
    """A `Model` from a state derivative; subclasses name states and inputs and supply `derivative`.

    Parameters
    ----------
    params : ParameterSet
        The car.
    dt : float
        Sample time. [s]
    outputs : tuple of str
        Which states (or other signals of `signals`) are the outputs.
    method, substeps
        Integrator, see `slipangle.models.integrate`; by default enough explicit steps to keep each at or
        below `max_step`, or one step of Radau IIA.
    """

    max_step: ClassVar[float] = 0.01
    several_minima: ClassVar[bool] = False  # of its free-run error over its parameters; a fit then tries many starts

    params: Any
    dt: float
    outputs: tuple[str, ...] = ()
    method: Method = "rk4"
    substeps: int = 0
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.dt > 0:
            raise ParameterError(f"the sample time is {self.dt} s; expected a positive number")
        object.__setattr__(self, "outputs", tuple(self.outputs) or self.states)
        if self.substeps == 0:
            explicit = max(1, math.ceil(self.dt / self.max_step - 1e-9))
            object.__setattr__(self, "substeps", 1 if self.method == "radau" else explicit)
        zeros = np.zeros(self.n_states), np.zeros(self.n_inputs)
        known = {*self.states, *self.signals(*zeros)}
        for name in self.outputs:
            if name not in known:
                raise ParameterError(
                    f"{type(self).__name__} has no output '{name}'; {nearest(name, known)}: use one of these names"
                )

    @abc.abstractmethod
    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Time derivative of the state."""

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Signals besides the states that can be outputs, by name."""
        return {}

    @cached_property
    def _step(self) -> Step:
        return discretise(
            self.derivative,
            self.dt,
            n_states=self.n_states,
            n_inputs=self.n_inputs,
            method=self.method,
            substeps=self.substeps,
        )

    def step(self, x: Vector, u: Vector) -> Vector:
        """State one sample later, inputs held."""
        return self._step(x, u)

    def output(self, x: Vector, u: Vector) -> Vector:
        """The chosen outputs."""
        values = {name: x[i] for i, name in enumerate(self.states)}
        if not set(self.outputs) <= values.keys():
            values |= self.signals(x, u)
        return stack([values[name] for name in self.outputs])

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """States that are outputs take their measured values."""
        measured = {name: y[i] for i, name in enumerate(self.outputs)}
        return stack([measured.get(name, x[i]) for i, name in enumerate(self.states)])

    def initial_state(self, data: Dataset) -> np.ndarray:
        """First sample of the channels that are states; states that were not measured start at zero."""
        return np.array([self._start(name, data) for name in self.states])

    def _start(self, name: str, data: Dataset) -> float:
        return float(data[name][0]) if name in data else 0.0


@dataclass(frozen=True, kw_only=True)
class Bicycle(OdeModel):
    """Linear bicycle driven by the logged steering angle and the measured speed.

    States v_y [m/s], r [rad/s]; inputs delta [rad], v_x [m/s]; outputs r by default, v_y and a_y [m/s2]
    on request.
    """

    states = ("v_y", "r")
    inputs = ("delta", "v_x")
    params: BicycleParams
    outputs: tuple[str, ...] = ("r",)

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """See `bicycle`."""
        return bicycle(x[0], x[1], self.params.road_wheel(u[0]), u[1], self.params)

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Lateral acceleration of the centre of gravity."""
        return {"a_y": self.derivative(x, u)[0] + u[1] * x[1]}


@dataclass(frozen=True, kw_only=True)
class Kinematic(OdeModel):
    """Kinematic single track: states X, Y [m], psi [rad]; inputs delta [rad], v_x [m/s]."""

    states = ("X", "Y", "psi")
    inputs = ("delta", "v_x")
    params: ChassisParams

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """See `kinematic`."""
        return kinematic(x[2], u[1], self.params.road_wheel(u[0]), self.params)

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Yaw rate."""
        return {"r": self.derivative(x, u)[2]}


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
class SingleTrack(OdeModel):
    """Single track with wheel spin on any tires.

    States v_x, v_y [m/s], r, omega_f, omega_r [rad/s], X, Y [m], psi [rad]; inputs delta [rad], T_f, T_r
    [N m] per axle. The wheels are stiff (about 1500 1/s at 20 m/s on the thesis' tires, growing as 1/v_x):
    use ``method="radau"`` above a millisecond, with about one substep per 25 ms where wheels lock or spin.
    """

    states = ("v_x", "v_y", "r", "omega_f", "omega_r", "X", "Y", "psi")
    inputs = ("delta", "T_f", "T_r")
    max_step = 0.001
    params: SingleTrackParams
    tire_f: Tire
    tire_r: Tire

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """See `single_track`."""
        steered = stack([self.params.road_wheel(u[0]), u[1], u[2]])
        return single_track(x, steered, self.params, self.tire_f, self.tire_r)

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Accelerations of the centre of gravity, slip angles of the axles."""
        p, rate, v = self.params, self.derivative(x, u), speed_floor(x[0], 0.5)
        return {
            "a_x": rate[0] - x[1] * x[2],
            "a_y": rate[1] + x[0] * x[2],
            "alpha_f": p.road_wheel(u[0]) * x[0] / v - atan2(x[1] + p.l_f * x[2], v),
            "alpha_r": -atan2(x[1] - p.l_r * x[2], v),
        }

    def straight(self, v_x: float, *, X: float = 0.0, Y: float = 0.0, psi: float = 0.0) -> np.ndarray:
        """State of straight driving at speed ``v_x`` [m/s] with rolling wheels."""
        omega = v_x / self.params.radius
        return np.array([v_x, 0.0, 0.0, omega, omega, X, Y, psi])

    def _start(self, name: str, data: Dataset) -> float:
        if name in data:
            return float(data[name][0])
        if name == "v_x":
            raise MissingColumnError(
                f"'{data.name}' has no channel 'v_x', which the single track starts from; {nearest(name, data.names)}: "
                "add the speed"
            )
        if name in ("omega_f", "omega_r"):
            return float(data["v_x"][0]) / self.params.radius
        return 0.0
