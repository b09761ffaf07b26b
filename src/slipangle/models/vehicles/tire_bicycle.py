"""The bicycle on tires as their files have them, whose scaling factors a fit may vary."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

from slipangle.models.ode import OdeModel
from slipangle.models.tires.simple import Tire
from slipangle.models.vehicles.axle import lowest_speed, small_slip_angles
from slipangle.models.vehicles.on_tires import axle_force, axle_stiffness, bicycle_on, wheel_loads
from slipangle.models.vehicles.parameters import BicycleParams, ChassisParams
from slipangle.ops import Scalar, Vector, maximum, stack
from slipangle.units import SI

FACTORS = ("LMUY", "LKY", "LCY", "LEY", "LHY", "LVY")


@dataclass(frozen=True, kw_only=True)
class TireBicycleParams(ChassisParams):
    """Chassis, load transfer, and the scaling factors of the tires on top of those in their files."""

    transfer_f: Annotated[float, SI("-", "front lateral load transfer, height over track times share", 0.0, 1.0)] = 0.0
    transfer_r: Annotated[float, SI("-", "rear lateral load transfer, height over track times share", 0.0, 1.0)] = 0.0
    LMUY_f: Annotated[float, SI("-", "scaling of the front tires' peak friction of F_y", 0.05, 5.0)] = 1.0
    LMUY_r: Annotated[float, SI("-", "scaling of the rear tires' peak friction of F_y", 0.05, 5.0)] = 1.0
    LKY_f: Annotated[float, SI("-", "scaling of the front tires' cornering stiffness", 0.05, 5.0)] = 1.0
    LKY_r: Annotated[float, SI("-", "scaling of the rear tires' cornering stiffness", 0.05, 5.0)] = 1.0
    LCY_f: Annotated[float, SI("-", "scaling of the front tires' shape factor of F_y", 0.5, 2.0)] = 1.0
    LCY_r: Annotated[float, SI("-", "scaling of the rear tires' shape factor of F_y", 0.5, 2.0)] = 1.0
    LEY_f: Annotated[float, SI("-", "scaling of the front tires' curvature of F_y", 0.0, 10.0)] = 1.0
    LEY_r: Annotated[float, SI("-", "scaling of the rear tires' curvature of F_y", 0.0, 10.0)] = 1.0
    LHY_f: Annotated[float, SI("-", "scaling of the front tires' horizontal shift of F_y", 0.0, 10.0)] = 1.0
    LHY_r: Annotated[float, SI("-", "scaling of the rear tires' horizontal shift of F_y", 0.0, 10.0)] = 1.0
    LVY_f: Annotated[float, SI("-", "scaling of the front tires' vertical shift of F_y", 0.0, 10.0)] = 1.0
    LVY_r: Annotated[float, SI("-", "scaling of the rear tires' vertical shift of F_y", 0.0, 10.0)] = 1.0


@dataclass(frozen=True, kw_only=True)
class TireBicycle(OdeModel):
    """Bicycle whose axles have the side force of two tires each, at their loads, from the tires' own equations.

    States v_y [m/s], r [rad/s]; inputs delta [rad], v_x [m/s]; outputs r by default, v_y and a_y [m/s2] on request.
    Lateral acceleration moves load from the inner to the outer wheel. The parameters LMUY_f to LVY_r multiply the
    scaling factors of the tires' files and are free for `GreyBox` as any others; `scaled_tires` are the tires with
    them, to be written or driven. Raises ParameterError if a tire has no scaling factors and one is not 1.

    Parameters
    ----------
    tire_f, tire_r : Tire
        One of the two front and rear tires, used beyond the limits of their files too.
    """

    states = ("v_y", "r")
    inputs = ("delta", "v_x")
    several_minima = True
    params: TireBicycleParams
    tire_f: Tire
    tire_r: Tire
    outputs: tuple[str, ...] = ("r",)

    @property
    def scaled_tires(self) -> tuple[Tire, Tire]:
        """Front and rear tire with the scaling factors of the parameters."""
        p = self.params
        pairs = ((self.tire_f, "f"), (self.tire_r, "r"))
        front, rear = (t.scaled(**{n: getattr(p, f"{n}_{axle}") for n in FACTORS}) for t, axle in pairs)
        return front, rear

    @property
    def bicycle(self) -> BicycleParams:
        """The linear bicycle of the same chassis and tires at small slip."""
        return bicycle_on(self.params, *self.scaled_tires)

    @cached_property
    def _stiffness(self) -> tuple[Scalar, Scalar]:
        """Of the axles on unscaled tires, for the speed at which slip angles stop growing. [N/rad]"""
        load_f, load_r = wheel_loads(self.params)
        return axle_stiffness(self.tire_f, load_f), axle_stiffness(self.tire_r, load_r)

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Rates of v_y [m/s2] and r [rad/s2]."""
        p, v_x = self.params, u[1]
        tire_f, tire_r = self.scaled_tires
        v = maximum(v_x, lowest_speed(p, *self._stiffness))
        alpha_f, alpha_r = small_slip_angles(v, x[0], x[1], p.road_wheel(u[0]), p)
        load_f, load_r = wheel_loads(p)
        across = p.mass * v_x * x[1]
        F_yf = axle_force(tire_f, alpha_f, load_f, _moved(p.transfer_f, across))
        F_yr = axle_force(tire_r, alpha_r, load_r, _moved(p.transfer_r, across))
        return stack([(F_yf + F_yr) / p.mass - v_x * x[1], (p.l_f * F_yf - p.l_r * F_yr) / p.inertia_z])

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Lateral acceleration of the centre of gravity."""
        return {"a_y": self.derivative(x, u)[0] + u[1] * x[1]}


def _moved(share: Scalar, across: Scalar) -> Scalar:
    """Load that leaves the inner wheel; the number zero where none does, so that the tire's load is one. [N]"""
    return 0.0 if isinstance(share, float) and share == 0.0 else share * across
