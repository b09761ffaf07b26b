"""Bicycle whose axles saturate and whose tires take a while to build up force: what a log needs at all speeds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.models.ode import OdeModel
from slipangle.models.vehicles.axle import lowest_speed, small_slip_angles
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams
from slipangle.ops import Scalar, Vector, atan, maximum, sin, sqrt, stack
from slipangle.units import SI

_QUICKEST = 0.005  # s, the shortest time in which a tire's force builds up
_LIGHTEST = 0.1  # of its load at rest, the least that lift leaves an axle
_NEW: Any = {"may be missing in a file": True}


@dataclass(frozen=True, kw_only=True)
class SaturatingBicycleParams(BicycleParams):
    """The linear bicycle's, per axle friction, relaxation length and downforce, where sensors are, the road's slope.

    Stiffness and largest force of an axle are in proportion to its load, and ``C_f``, ``C_r`` those at rest. Tires that
    gain less from load act as if there were less downforce: one that was fitted is what the tires make of it, down to a
    third of the air's. Below zero it is lift.
    """

    mu_f: Annotated[float, SI("-", "front peak friction", 0.05, 10.0)] = 1.0
    mu_r: Annotated[float, SI("-", "rear peak friction", 0.05, 10.0)] = 1.0
    shape: Annotated[float, SI("-", "Magic Formula shape factor C", 0.8, 2.0)] = 1.4
    relaxation_f: Annotated[float, SI("m", "front relaxation length", 0.0, 10.0)] = 0.0
    relaxation_r: Annotated[float, SI("m", "rear relaxation length", 0.0, 10.0)] = 0.0
    lever_v_y: Annotated[float, SI("m", "place where v_y is measured, ahead of the centre of gravity", -10.0, 10.0)] = (
        0.0
    )
    lever_a_y: Annotated[float, SI("m", "place where a_y is measured, ahead of the centre of gravity", -10.0, 10.0)] = (
        field(default=0.0, metadata=_NEW)
    )
    gain_a_y: Annotated[float, SI("-", "measured over true lateral acceleration, such as by body roll", 0.5, 2.0)] = (
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

    @property
    def static_loads(self) -> tuple[Scalar, Scalar]:
        """Loads of the front and the rear axle at rest. [N]"""
        weight = self.mass * GRAVITY / self.wheelbase
        return weight * self.l_r, weight * self.l_f

    def load_ratios(self, v_x: Scalar) -> tuple[Scalar, Scalar]:
        """Loads of the front and the rear axle at a speed ``v_x`` [m/s] over those at rest, at least a tenth. [-]"""
        front, rear = self.static_loads
        down_f, down_r = self.downforce_f * v_x * v_x, self.downforce_r * v_x * v_x
        return maximum(1.0 + down_f / front, _LIGHTEST), maximum(1.0 + down_r / rear, _LIGHTEST)

    def load_ratio(self, v_x: Scalar) -> Scalar:
        """Load of both axles at a speed ``v_x`` [m/s] over the weight. [-]"""
        front, rear = self.load_ratios(v_x)
        return (front * self.l_r + rear * self.l_f) / self.wheelbase

    def at_speed(self, v_x: float) -> Self:
        """A car without downforce that is this one at a speed ``v_x`` [m/s], by its stiffness and friction there."""
        front, rear = self.load_ratios(v_x)
        of = {"C_f": front, "C_r": rear, "mu_f": front, "mu_r": rear}
        values = {name: getattr(self, name) * ratio for name, ratio in of.items()}
        return replace(self, **values, downforce_f=0.0, downforce_r=0.0)


def saturated(alpha: Scalar, load: Scalar, C: Scalar, mu: Scalar, shape: Scalar) -> Scalar:
    """Lateral force of an axle: Magic Formula without curvature factor, slope C [N/rad], peak mu load. [N]

    H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3.1; alpha [rad] > 0 gives a force to the left.
    """
    peak = mu * load
    return peak * sin(shape * atan(C / (shape * peak) * alpha))


@dataclass(frozen=True, kw_only=True)
class SaturatingBicycle(OdeModel):
    """Bicycle with saturating axles.

    States v_y [m/s], r [rad/s]; inputs delta [rad], v_x [m/s]; outputs r by default, v_y and a_y [m/s2] on request. The
    relaxation lengths are without effect here, see `RelaxingBicycle`. Steering lag comes as ``Steered(car,
    steering_lag=...)``, delay as ``Delayed(...)``. A v_y that was not measured starts at that of steady cornering. A
    ``cross_slope`` is the same everywhere and comes on top of that of `Banked`, an input.
    """

    states = ("v_y", "r")
    inputs = ("delta", "v_x")
    max_step: ClassVar[float] = 0.005
    params: SaturatingBicycleParams
    outputs: tuple[str, ...] = ("r",)

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Rates of v_y [m/s2] and r [rad/s2]."""
        return stack(self._rates(x, u, self._slip(x, u)))

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Lateral acceleration of the centre of gravity."""
        F_yf, F_yr = self._forces(self._acting(x, u), u[1])
        return {"a_y": (F_yf + F_yr) / self.params.mass}

    def output(self, x: Vector, u: Vector) -> Vector:
        """The chosen outputs as their sensors read them."""
        y = super().output(x, u)
        return stack([y[i] + self._elsewhere(name, x, u) for i, name in enumerate(self.outputs)])

    def _elsewhere(self, name: str, x: Vector, u: Vector) -> Scalar:
        """What a sensor reads more than one without a bias at the centre of gravity."""
        p = self.params
        if name == "v_y":
            return p.lever_v_y * x[1]
        if name != "a_y":
            return 0.0
        F_yf, F_yr = self._forces(self._acting(x, u), u[1])
        r_dot = (p.l_f * F_yf - p.l_r * F_yr) / p.inertia_z
        return (p.gain_a_y - 1) * (F_yf + F_yr) / p.mass + p.gain_a_y * p.lever_a_y * r_dot

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """States that are outputs take their measured values at the centre of gravity, without biases."""
        x = super().correct(x, u, y)
        lever = self.params.lever_v_y if "v_y" in self.outputs else 0.0
        return stack([x[0] - lever * x[1], *(x[i] for i in range(1, self.n_states))])

    def initial_state(self, data: Dataset) -> np.ndarray:
        """State of the first sample, with the v_y of steady cornering unless it was measured."""
        p, r = self.params, self._start("r", data)
        v = self._speed(float(data["v_x"][0]))
        if "v_y" in data:
            return np.array([self._start("v_y", data) - p.lever_v_y * r, r], dtype=float)
        C_r = p.C_r * p.load_ratios(v)[1]
        return np.array([r * (p.l_r - p.mass * p.l_f * v * v / (p.wheelbase * C_r)), r], dtype=float)

    def _speed(self, v_x: Scalar) -> Scalar:
        return maximum(v_x, lowest_speed(self.params, self.params.C_f, self.params.C_r))

    def _slip(self, x: Vector, u: Vector) -> tuple[Scalar, Scalar]:
        """Slip angles of the motion."""
        return small_slip_angles(self._speed(u[1]), x[0], x[1], self.params.road_wheel(u[0]), self.params)

    def _acting(self, x: Vector, u: Vector) -> tuple[Scalar, Scalar]:
        """Slip angles that the forces follow."""
        return self._slip(x, u)

    def _forces(self, alpha: tuple[Scalar, Scalar], v_x: Scalar) -> tuple[Scalar, Scalar]:
        """Of the axles, which at any slip are in proportion to their loads."""
        p, (load_f, load_r), (front, rear) = self.params, self.params.static_loads, self.params.load_ratios(v_x)
        F_yf = front * saturated(alpha[0], load_f, p.C_f, p.mu_f, p.shape)
        return F_yf, rear * saturated(alpha[1], load_r, p.C_r, p.mu_r, p.shape)

    def _rates(self, x: Vector, u: Vector, alpha: tuple[Scalar, Scalar]) -> list[Scalar]:
        p, (F_yf, F_yr) = self.params, self._forces(alpha, u[1])
        across = (F_yf + F_yr) / p.mass - self._speed(u[1]) * x[1] - GRAVITY * sin(p.cross_slope)
        return [across, (p.l_f * F_yf - p.l_r * F_yr) / p.inertia_z]


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
        p, v, now = self.params, self._speed(u[1]), self._slip(x, u)
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
