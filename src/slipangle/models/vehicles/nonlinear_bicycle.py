"""The bicycle at the limit: Magic Formula axles with load transfer, combined slip and steering lag."""

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.models.ode import OdeModel
from slipangle.models.tires.magic_formula.terms import curved
from slipangle.models.vehicles.axle import slip_speed, small_slip_angles
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams, ChassisParams
from slipangle.ops import Scalar, Vector, sin, sqrt, stack
from slipangle.units import SI


@dataclass(frozen=True, kw_only=True)
class NonlinearBicycleParams(ChassisParams):
    """The linear bicycle's parameters and what matters when tires saturate; per axle unless said otherwise."""

    C_f: Annotated[float, SI("N/rad", "front cornering stiffness at static load, per axle", 1e-3, 1e7)]
    C_r: Annotated[float, SI("N/rad", "rear cornering stiffness at static load, per axle", 1e-3, 1e7)]
    mu_f: Annotated[float, SI("-", "front peak friction at static load", 0.1, 4.0)] = 1.1
    mu_r: Annotated[float, SI("-", "rear peak friction at static load", 0.1, 4.0)] = 1.2
    shape: Annotated[float, SI("-", "Magic Formula shape factor C", 0.8, 2.0)] = 1.3
    E_f: Annotated[float, SI("-", "front Magic Formula curvature factor", -10.0, 1.0)] = 0.0
    E_r: Annotated[float, SI("-", "rear Magic Formula curvature factor", -10.0, 1.0)] = 0.0
    friction_load: Annotated[float, SI("-", "loss of friction per relative rise of load", -1.0, 2.0)] = 0.2
    stiffness_load: Annotated[float, SI("-", "loss of stiffness per relative rise of load", 0.0, 2.0)] = 0.2
    transfer_x: Annotated[float, SI("-", "longitudinal load transfer, height over wheelbase", 0.0, 1.0)] = 0.2
    transfer_f: Annotated[float, SI("-", "front lateral load transfer, height over track times share", 0.0, 1.0)] = 0.15
    transfer_r: Annotated[float, SI("-", "rear lateral load transfer, height over track times share", 0.0, 1.0)] = 0.15
    drive_rear: Annotated[float, SI("-", "rear share of the driving force", 0.0, 1.0)] = 1.0
    brake_rear: Annotated[float, SI("-", "rear share of the braking force", 0.0, 1.0)] = 0.4
    drag: Annotated[float, SI("kg/m", "drag force per speed squared", 0.0, 10.0)] = 0.4
    steering_lag: Annotated[float, SI("s", "time constant from logged steering to road wheel", 0.002, 1.0)] = 0.03
    compliance: Annotated[float, SI("rad/N", "steering angle lost per front lateral force", -1e-4, 1e-4)] = 0.0

    @property
    def bicycle(self) -> BicycleParams:
        """The linear bicycle of the same chassis at small slip, its front axle softer by what the steering gives."""
        shared = {name: getattr(self, name) for name in ChassisParams.metadata()}
        C_f: Any = self.C_f / (1.0 + self.compliance * self.C_f)
        return BicycleParams(**shared, C_f=C_f, C_r=self.C_r)


# Widths of smooth corners, over a wheel's static load (that of drive and brake over the weight), and the least peak.
_SMOOTH, _ELLIPSE, _LEAST, _COAST = 0.004, 0.04, 4e-4, 0.01


def _positive(x: Scalar, width: float) -> Scalar:
    """``max(x, 0)`` with a smooth corner of the given width."""
    return 0.5 * (x + sqrt(x * x + width * width))


def axle_force(
    alpha: Scalar,
    load: Scalar,
    static: Scalar,
    transfer: Scalar,
    F_x: Scalar,
    C: Scalar,
    mu: Scalar,
    E: Scalar,
    p: NonlinearBicycleParams,
) -> Scalar:
    """Lateral force of an axle of two tires, the outer one loaded by ``transfer`` [N], F_x shared. [N]

    ``static`` [N] is the axle's load at rest, on whose scale corners are smooth.

    Each tire: Magic Formula (H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3.1) whose
    friction and stiffness fall with load, on the friction ellipse left by its longitudinal force.
    """
    total, half = 0.0, 0.5 * static
    for side in (1.0, -1.0):
        wheel = _positive(0.5 * load + side * transfer, _SMOOTH * half)
        rise = wheel / half - 1.0
        peak = _positive(mu * wheel * (1.0 - p.friction_load * rise), _SMOOTH * half)
        lateral = sqrt(_positive(peak * peak - (0.5 * F_x) ** 2, (_ELLIPSE * half) ** 2) + (_LEAST * half) ** 2)
        stiffness = 0.5 * C * (1.0 + rise * (1.0 - p.stiffness_load))
        z = stiffness / (p.shape * peak) * alpha
        total = total + lateral * sin(p.shape * curved(z, E))
    return total


class AxleCoefficients(NamedTuple):
    """Cornering stiffness [N/rad] and peak friction [-] at static load, front and rear."""

    C_f: Scalar
    C_r: Scalar
    mu_f: Scalar
    mu_r: Scalar


def nonlinear_bicycle(
    v_y: Scalar,
    r: Scalar,
    delta: Scalar,
    v_x: Scalar,
    v_x_dot: Scalar,
    p: NonlinearBicycleParams,
    tires: AxleCoefficients | None = None,
) -> tuple[Scalar, Scalar, Scalar]:
    """Rates of v_y [m/s2] and r [rad/s2], and the front lateral force [N].

    Loads follow ``v_x_dot`` and the centripetal acceleration ``v_x r``; the longitudinal force is
    ``mass v_x_dot + drag v_x^2``, driven and braked by the given rear shares. Below `lowest_speed` slip
    angles are those there. ``tires`` replaces the parameters' coefficients.
    """
    t = p if tires is None else tires
    v = slip_speed(v_x, p)
    alpha_f, alpha_r = small_slip_angles(v, v_y, r, delta, p)
    static_f, static_r = p.mass * GRAVITY * p.l_r / p.wheelbase, p.mass * GRAVITY * p.l_f / p.wheelbase
    forward = p.mass * v_x_dot * p.transfer_x
    across = p.mass * v * r
    F_x = p.mass * v_x_dot + p.drag * v * v
    drive = _positive(F_x, _COAST * (static_f + static_r))
    brake = F_x - drive
    F_xr = p.drive_rear * drive + p.brake_rear * brake
    F_yf = axle_force(alpha_f, static_f - forward, static_f, across * p.transfer_f, F_x - F_xr, t.C_f, t.mu_f, p.E_f, p)
    F_yr = axle_force(alpha_r, static_r + forward, static_r, across * p.transfer_r, F_xr, t.C_r, t.mu_r, p.E_r, p)
    return (F_yf + F_yr) / p.mass - v * r, (p.l_f * F_yf - p.l_r * F_yr) / p.inertia_z, F_yf


def state_rates(
    x: Vector, u: Vector, p: NonlinearBicycleParams, tires: AxleCoefficients | None = None
) -> tuple[Scalar, Scalar, Scalar]:
    """Rates of v_y [m/s2], r [rad/s2] and delta_w [rad/s] from the state v_y, r, delta_w and delta, v_x, v_x_dot."""
    v_y_dot, r_dot, F_yf = nonlinear_bicycle(x[0], x[1], x[2], u[1], u[2], p, tires=tires)
    wanted = p.road_wheel(u[0]) - p.compliance * F_yf
    return v_y_dot, r_dot, (wanted - x[2]) / p.steering_lag


@dataclass(frozen=True, kw_only=True)
class NonlinearBicycle(OdeModel):
    """Bicycle with Magic Formula axles, load transfer, combined slip, steering lag and compliance.

    States v_y [m/s], r [rad/s], delta_w [rad] (road wheel after the lag); inputs delta [rad], v_x [m/s] and its
    derivative v_x_dot [m/s2]; outputs r by default, v_y and a_y [m/s2] on request.
    Raises ParameterError if the memory is below 1.

    Parameters
    ----------
    memory : int
        Samples that a free run starts from. With 1 the state is that of the first sample, v_y zero unless it is a
        channel of the data; more let a v_y that nobody measured settle while the yaw rate is held to the measured one.
    """

    states = ("v_y", "r", "delta_w")
    inputs = ("delta", "v_x", "v_x_dot")
    several_minima = True
    params: NonlinearBicycleParams
    outputs: tuple[str, ...] = ("r",)
    memory: int = 1

    def __post_init__(self) -> None:
        if self.memory < 1:
            raise ParameterError(f"memory is {self.memory}; expected a number of samples of at least 1")
        super().__post_init__()

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """See `nonlinear_bicycle`."""
        return stack(state_rates(x, u, self.params))

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Lateral acceleration of the centre of gravity."""
        return {"a_y": self.derivative(x, u)[0] + u[1] * x[1]}

    def initial_state(self, data: Dataset) -> np.ndarray:
        """State of the first sample run up to the last, outputs corrected at each on the way."""
        chosen = data.select(inputs=self.inputs, outputs=self.outputs)
        x = super().initial_state(chosen)
        for k in range(1, self.memory):
            x = np.asarray(self.correct(self.step(x, chosen.u[k - 1]), chosen.u[k], chosen.y[k]))
        return x

    def _start(self, name: str, data: Dataset) -> float:
        if name == "delta_w":
            return float(self.params.road_wheel(data["delta"][0]))
        return super()._start(name, data)


def with_speed_derivative(data: Dataset) -> Dataset:
    """The data with the channel v_x_dot, central differences of v_x inside each experiment, zero if alone. [m/s2]"""
    speeds = [part["v_x"] for part in data.experiments]
    parts = [np.gradient(v_x, data.dt) if len(v_x) > 1 else np.zeros(len(v_x)) for v_x in speeds]
    return data.with_channel("v_x_dot", np.concatenate(parts), "m/s2")
