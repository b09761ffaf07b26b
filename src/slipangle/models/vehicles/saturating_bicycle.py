"""Bicycle whose axles saturate and whose tires take a while to build up force: what a log needs at all speeds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.models.ode import OdeModel
from slipangle.models.vehicles.axle import lowest_speed, small_slip_angles, turned_slip_angles
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams
from slipangle.ops import Scalar, Vector, atan, clip, cos, fabs, is_symbolic, is_traced, maximum, sin, sqrt, stack
from slipangle.units import SI

_QUICKEST = 0.005  # s, the shortest time in which a tire's force builds up
_LIGHTEST = 0.1  # of its load at rest, the least that lift leaves an axle
_NO_SLIP = 1e-6  # rad, that keeps a quotient of force and slip from being none of both
_NEW: Any = {"may be missing in a file": True}


@dataclass(frozen=True, kw_only=True)
class SaturatingBicycleParams(BicycleParams):
    """The linear bicycle's, per axle friction, relaxation and downforce, a locked axle, places of sensors, the slope.

    Stiffness and largest force of an axle are in proportion to its load, and ``C_f``, ``C_r`` those at rest. Tires that
    gain less from load act as if there were less downforce: one that was fitted is what the tires make of it, down to a
    third of the air's. Below zero it is lift.

    ``load_shift`` is what braking moves from the rear to the front, ``along_f`` what drives or slows the car at its
    front wheels, where these are turned to; `LoadTransfer` finds both from the speed.

    ``brush`` gives the tires the curve of a brush in place of the Magic Formula's: its slope falls from the very start,
    with the slip, theirs with its square. Where forces are largest is told by the Magic Formula.

    Rear wheels that turn as one, by a solid axle or a locked differential, slip along in a bend and resist the turn:
    ``locked_half_track`` is half their track times the root of longitudinal over lateral stiffness, in between where
    the differential locks in part. Wheels in front that do the same are in it. Zero is an open differential.
    """

    mu_f: Annotated[float, SI("-", "front peak friction", 0.05, 10.0)] = 1.0
    mu_r: Annotated[float, SI("-", "rear peak friction", 0.05, 10.0)] = 1.0
    shape: Annotated[float, SI("-", "Magic Formula shape factor C", 0.8, 2.0)] = 1.4
    relaxation_f: Annotated[float, SI("m", "front relaxation length", 0.0, 10.0)] = 0.0
    relaxation_r: Annotated[float, SI("m", "rear relaxation length", 0.0, 10.0)] = 0.0
    lever_v_y: Annotated[float, SI("m", "place where v_y is measured, ahead of the centre of gravity", -10.0, 10.0)] = (
        0.0
    )
    gain_v_y: Annotated[float, SI("-", "measured over true lateral velocity", 0.2, 5.0)] = field(
        default=1.0, metadata=_NEW
    )
    turn_v_y: Annotated[float, SI("rad", "angle of the v_y sensor, to the right of straight ahead", -0.5, 0.5)] = field(
        default=0.0, metadata=_NEW
    )
    lever_a_y: Annotated[float, SI("m", "place where a_y is measured, ahead of the centre of gravity", -10.0, 10.0)] = (
        field(default=0.0, metadata=_NEW)
    )
    gain_a_y: Annotated[float, SI("-", "measured over true lateral acceleration, such as by body roll", 0.5, 2.0)] = (
        field(default=1.0, metadata=_NEW)
    )
    gain_v_x: Annotated[float, SI("-", "true over logged speed, such as of wheels of another radius", 0.5, 2.0)] = (
        field(default=1.0, metadata=_NEW)
    )
    cross_slope: Annotated[float, SI("rad", "cross slope of the road, positive: left edge higher", -0.3, 0.3)] = field(
        default=0.0, metadata=_NEW
    )
    downforce_f: Annotated[float, SI("kg/m", "front downforce per speed squared", -5.0, 50.0)] = field(
        default=0.0, metadata=_NEW
    )
    downforce_r: Annotated[float, SI("kg/m", "rear downforce per speed squared", -5.0, 50.0)] = field(
        default=0.0, metadata=_NEW
    )
    locked_half_track: Annotated[float, SI("m", "half the rear track if its wheels turn as one", 0.0, 5.0)] = field(
        default=0.0, metadata=_NEW
    )
    load_shift: Annotated[float, SI("-", "share of the weight moved to the front, as by braking", -0.5, 0.5)] = field(
        default=0.0, metadata=_NEW
    )

    along_f: Annotated[
        float, SI("-", "force along the front wheels over the weight, positive forwards", -10.0, 10.0)
    ] = field(default=0.0, metadata=_NEW)
    brush: Annotated[
        float, SI("-", "share of a brush model's curve in the tires', the rest Magic Formula", 0.0, 1.0)
    ] = field(default=0.0, metadata=_NEW)

    @property
    def static_loads(self) -> tuple[Scalar, Scalar]:
        """Loads of the front and the rear axle at rest. [N]"""
        weight = self.mass * GRAVITY / self.wheelbase
        return weight * self.l_r, weight * self.l_f

    def load_ratios(self, v_x: Scalar) -> tuple[Scalar, Scalar]:
        """Loads of the front and the rear axle at a speed ``v_x`` [m/s] over those at rest, at least a tenth. [-]"""
        (front, rear), moved = self.static_loads, self.load_shift * self.mass * GRAVITY
        more_f, more_r = self.downforce_f * v_x * v_x + moved, self.downforce_r * v_x * v_x - moved
        return maximum(1.0 + more_f / front, _LIGHTEST), maximum(1.0 + more_r / rear, _LIGHTEST)

    def load_ratio(self, v_x: Scalar) -> Scalar:
        """Load of both axles at a speed ``v_x`` [m/s] over the weight. [-]"""
        front, rear = self.load_ratios(v_x)
        return (front * self.l_r + rear * self.l_f) / self.wheelbase

    @property
    def locked_damping(self) -> Scalar:
        """Moment of a locked axle against the turn, over yaw rate and times speed, at small slip. [N m2/rad]"""
        return self.C_r * self.locked_half_track * self.locked_half_track

    @property
    def locked_share(self) -> Scalar:
        """Yaw damping of a locked axle over that of the tires' slip angles. [-]"""
        across = self.C_f * self.l_f * self.l_f + self.C_r * self.l_r * self.l_r
        return self.locked_damping / across

    def at_speed(self, v_x: float) -> Self:
        """A car without downforce and locked axle that is this one at a speed ``v_x`` [m/s], see `unlocked`."""
        front, rear = self.load_ratios(v_x)
        of = {"C_f": front, "C_r": rear, "mu_f": front, "mu_r": rear}
        values = {name: getattr(self, name) * ratio for name, ratio in of.items()}
        return replace(self, **values, downforce_f=0.0, downforce_r=0.0).unlocked()

    def unlocked(self) -> Self:
        """A car without locked axle that turns like this one in steady bends, at each speed, where tires are linear.

        A locked axle asks for more steering by a share that hangs on no speed, as do a smaller gain and stiffer tires.
        """
        more = 1.0 + (self.locked_half_track / self.wheelbase) ** 2 * (1.0 + self.C_r / self.C_f)
        as_much = {"C_f": self.C_f * more, "C_r": self.C_r * more, "steering_gain": self.steering_gain / more}
        return replace(self, **as_much, locked_half_track=0.0) if self.locked_half_track else self


def saturated(alpha: Scalar, load: Scalar, C: Scalar, mu: Scalar, shape: Scalar, brush: Scalar = 0.0) -> Scalar:
    """Lateral force of an axle: slope C [N/rad], peak mu load; alpha [rad] > 0 gives a force to the left. [N]

    Magic Formula without curvature factor, and a share ``brush`` of the brush model with parabolic pressure: H. B.
    Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, secs. 4.3.1 and 3.2.1.
    """
    peak = mu * load
    magic = peak * sin(shape * atan(C / (shape * peak) * alpha))
    if not (is_symbolic(brush) or is_traced(brush)) and brush == 0:
        return magic
    sliding = clip(C / (3.0 * peak) * alpha, -1.0, 1.0)  # share of the contact patch, with the sign of alpha
    return magic + brush * (peak * sliding * (3.0 - (3.0 - fabs(sliding)) * fabs(sliding)) - magic)


@dataclass(frozen=True, kw_only=True)
class SaturatingBicycle(OdeModel):
    """Bicycle with saturating axles.

    States v_y [m/s], r [rad/s]; inputs delta [rad], v_x [m/s]; outputs r by default, v_y and a_y [m/s2] on request. The
    relaxation lengths are without effect here, see `RelaxingBicycle`. Steering lag comes as ``Steered(car,
    steering_lag=...)``, delay as ``Delayed(...)``. A v_y that was not measured starts at that of steady cornering. A
    ``cross_slope`` is the same everywhere and comes on top of that of `Banked`, an input.

    Steering angles are small (``small_angles``) where 0.15 rad is much; else the front wheels' slip angle and the part
    of their force that acts across the car are those of any angle, as in hairpins and parking lots.
    """

    states = ("v_y", "r")
    inputs = ("delta", "v_x")
    max_step: ClassVar[float] = 0.005
    params: SaturatingBicycleParams
    outputs: tuple[str, ...] = ("r",)
    small_angles: bool = field(default=True, metadata=_NEW)

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Rates of v_y [m/s2] and r [rad/s2]."""
        return stack(self._rates(x, u, self._slip(x, u)))

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Lateral acceleration of the centre of gravity."""
        F_yf, F_yr, _ = self._forces(x, u, self._acting(x, u))
        return {"a_y": (F_yf + F_yr) / self.params.mass}

    def output(self, x: Vector, u: Vector) -> Vector:
        """The chosen outputs as their sensors read them."""
        y = super().output(x, u)
        return stack([y[i] + self._elsewhere(name, x, u) for i, name in enumerate(self.outputs)])

    def _elsewhere(self, name: str, x: Vector, u: Vector) -> Scalar:
        """What a sensor reads more than one without a bias at the centre of gravity."""
        p = self.params
        if name == "v_y":
            return (p.gain_v_y - 1) * x[0] + p.gain_v_y * p.lever_v_y * x[1] + p.turn_v_y * p.gain_v_x * u[1]
        if name != "a_y":
            return 0.0
        F_yf, F_yr, M_z = self._forces(x, u, self._acting(x, u))
        r_dot = (p.l_f * F_yf - p.l_r * F_yr + M_z) / p.inertia_z
        return (p.gain_a_y - 1) * (F_yf + F_yr) / p.mass + p.gain_a_y * p.lever_a_y * r_dot

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """States that are outputs take their true values at the centre of gravity."""
        x = super().correct(x, u, y)
        v_y = self._true_v_y(x[0], x[1], u[1]) if "v_y" in self.outputs else x[0]
        return stack([v_y, *(x[i] for i in range(1, self.n_states))])

    def _true_v_y(self, read: Scalar, r: Scalar, v_x: Scalar) -> Scalar:
        """At the centre of gravity, of what the sensor reads without its bias. [m/s]"""
        p = self.params
        return (read - p.turn_v_y * p.gain_v_x * v_x) / p.gain_v_y - p.lever_v_y * r

    def initial_state(self, data: Dataset) -> np.ndarray:
        """State of the first sample, with the v_y of steady cornering unless it was measured."""
        p, r = self.params, self._start("r", data)
        v = self.slip_speed(float(data["v_x"][0]))
        if "v_y" in data:
            return np.array([self._true_v_y(self._start("v_y", data), r, float(data["v_x"][0])), r], dtype=float)
        C_r = p.C_r * p.load_ratios(v)[1]
        arm = p.l_r + p.locked_half_track**2 / p.wheelbase - p.mass * p.l_f * v * v / (p.wheelbase * C_r)
        return np.array([r * arm, r], dtype=float)

    def slip_speed(self, v_x: Scalar) -> Scalar:
        """Speed that slip angles are told over, at one as logged. [m/s]"""
        p = self.params
        return maximum(p.gain_v_x * v_x, lowest_speed(p, p.C_f, p.C_r, locked=p.locked_damping))

    def _slip(self, x: Vector, u: Vector) -> tuple[Scalar, Scalar]:
        """Slip angles of the motion."""
        angles = small_slip_angles if self.small_angles else turned_slip_angles
        return angles(self.slip_speed(u[1]), x[0], x[1], self.params.road_wheel(u[0]), self.params)

    def _acting(self, x: Vector, u: Vector) -> tuple[Scalar, Scalar]:
        """Slip angles that the forces follow."""
        return self._slip(x, u)

    def _forces(self, x: Vector, u: Vector, alpha: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar, Scalar]:
        """Across the axles [N], at any slip in proportion to their loads, and a locked axle's moment [N m].

        Slip along and across share one curve, as of a tire that is alike both ways: H. B. Pacejka, Tire and Vehicle
        Dynamics, 3rd ed., 2012, sec. 3.2.3.
        """
        p, (load_f, load_r) = self.params, self.params.static_loads
        front, rear = p.load_ratios(p.gain_v_x * u[1])
        F_yf, F_xf = front * saturated(alpha[0], load_f, p.C_f, p.mu_f, p.shape, p.brush), p.along_f * p.mass * GRAVITY
        turned = p.road_wheel(u[0])
        F_yf = F_yf + F_xf * turned if self.small_angles else F_yf * cos(turned) + F_xf * sin(turned)
        b: Any = p.locked_half_track
        if not (is_symbolic(b) or is_traced(b)) and b == 0:
            return F_yf, rear * saturated(alpha[1], load_r, p.C_r, p.mu_r, p.shape, p.brush), 0.0
        kappa = b * x[1] / self.slip_speed(u[1])  # of the outer wheel, and as much the other way of the inner
        slip = sqrt(alpha[1] * alpha[1] + kappa * kappa + _NO_SLIP * _NO_SLIP)
        per_slip = rear * saturated(slip, load_r, p.C_r, p.mu_r, p.shape, p.brush) / slip
        return F_yf, per_slip * alpha[1], -b * per_slip * kappa

    def _rates(self, x: Vector, u: Vector, alpha: tuple[Scalar, Scalar]) -> list[Scalar]:
        p, (F_yf, F_yr, M_z) = self.params, self._forces(x, u, alpha)
        across = (F_yf + F_yr) / p.mass - self.slip_speed(u[1]) * x[1] - GRAVITY * sin(p.cross_slope)
        return [across, (p.l_f * F_yf - p.l_r * F_yr + M_z) / p.inertia_z]


@dataclass(frozen=True, kw_only=True)
class RelaxingBicycle(SaturatingBicycle):
    """`SaturatingBicycle` whose slip angles build up over a relaxation length.

    ``d alpha' / dt = (alpha - alpha') / tau``, ``tau`` from ``relaxation / v_x`` (H. B. Pacejka, Tire and Vehicle
    Dynamics, 3rd ed., 2012, sec. 7.2) and no less than 5 ms. States besides v_y and r: the slip angles alpha_f, alpha_r
    [rad] that act.
    """

    states = ("v_y", "r", "alpha_f", "alpha_r")
    max_step: ClassVar[float] = 0.0025

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Rates of v_y [m/s2], r [rad/s2] and the two slip angles [rad/s]."""
        p, v, now = self.params, self.slip_speed(u[1]), self._slip(x, u)
        tau = [sqrt((length / v) ** 2 + _QUICKEST**2) for length in (p.relaxation_f, p.relaxation_r)]
        late = [(now[i] - x[2 + i]) / tau[i] for i in range(2)]
        return stack([*self._rates(x, u, self._acting(x, u)), *late])

    def initial_state(self, data: Dataset) -> np.ndarray:
        """That of the saturating bicycle, with the slip angles settled."""
        x = super().initial_state(data)
        u = [float(data[name][0]) for name in self.inputs]
        return np.array([*x, *self._slip(x, u)], dtype=float)

    def _acting(self, x: Vector, u: Vector) -> tuple[Scalar, Scalar]:
        return x[2], x[3]
