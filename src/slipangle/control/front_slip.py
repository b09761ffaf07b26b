"""`FrontSlip`, `RearSlip`: an axle's slip angle, as a term of an optimal control problem, and where its force peaks.

`grip_left` says what drive and brake may take of the largest force while an axle needs it to the side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
from scipy import optimize

from slipangle.models.model import Model
from slipangle.models.ode import Parametrised
from slipangle.models.tires.magic_formula.terms import curved
from slipangle.models.vehicles.axle import slip_speed, small_slip_angles, turned_slip_angles
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.models.wrappers.wrapper import Wrapper
from slipangle.ops import Scalar, Vector, fabs, maximum, minimum, sin, sqrt, where

# States of steering with a lag, the last of them first; whether gain and offset are to come.
_STEERING = {"delta_w": False, "delta_s": True, "delta_lagged": True}


@dataclass(frozen=True)
class FrontSlip:
    """Slip angle of the front axle [rad] from a model's state and inputs.

    Parameters
    ----------
    places : tuple of int
        Of v_y and r in the state.
    speed : int
        Place of v_x in the inputs.
    steering : int
        Place of the road wheels' angle in the state, or, below zero, -1 minus that in the inputs.
    geared : bool
        Whether gain and offset stand between that angle and the road wheels.
    params : ParameterSet
        Geometry, steering gain and offset, cornering stiffness.
    peak : float
        Slip angle at which the axle's force is largest. [rad]
    rear : int
        Place of the steered rear wheels' angle in the inputs; below zero: they are straight.
    gain : float
        True over given angle of these. [-]
    small_angles : bool
        Whether steering angles are small.
    """

    places: tuple[int, int]
    speed: int
    steering: int
    geared: bool
    params: Any
    peak: float
    rear: int
    gain: float
    small_angles: bool = True

    axle: ClassVar[str] = "f"

    def __call__(self, x: Vector, u: Vector, _: Any) -> Scalar:
        """The slip angle of the motion, without relaxation."""
        p = self.params
        angle = u[-1 - self.steering] if self.steering < 0 else x[self.steering]
        v = slip_speed(u[self.speed], p)
        angles = small_slip_angles if self.small_angles else turned_slip_angles
        return angles(v, x[self.places[0]], x[self.places[1]], p.road_wheel(angle) if self.geared else angle, p)[0]

    def grip_left(self, x: Vector, u: Vector) -> Scalar:
        """Share of the axle's largest force that the friction ellipse leaves along it: 0 from the peak on. [-]"""
        p, slip = self.params, fabs(self(x, u, None))
        stiffness = getattr(p, f"C_{self.axle}") / (p.shape * _most(p, self.axle))
        side = sin(p.shape * curved(stiffness * slip, getattr(p, f"E_{self.axle}", 0.0)))
        return where(slip < self.peak, sqrt(maximum(1.0 - side * side, 0.0)), 0.0)


class RearSlip(FrontSlip):
    """Slip angle of the rear axle, likewise."""

    axle: ClassVar[str] = "r"

    def __call__(self, x: Vector, u: Vector, _: Any) -> Scalar:
        """The slip angle of the motion, without relaxation."""
        p = self.params
        v = slip_speed(u[self.speed], p)
        angle = small_slip_angles(v, x[self.places[0]], x[self.places[1]], 0.0, p)[1]
        return angle if self.rear < 0 else angle + self.gain * u[self.rear]


def front_slip(model: Model, control: str = "delta") -> FrontSlip | None:
    """The front slip of a model whose front axle's force has a peak; None for others, such as linear ones."""
    return _slip(FrontSlip, model, control)


def rear_slip(model: Model, control: str = "delta") -> FrontSlip | None:
    """The rear slip of a model whose rear axle's force has a peak; None for others."""
    return _slip(RearSlip, model, control)


def grip_left(model: Model, control: str = "delta") -> ca.Function | None:
    """``(x, u) ->`` the least of both axles' `FrontSlip.grip_left`; None where no axle's force has a peak."""
    slips = [slip for slip in (front_slip(model, control), rear_slip(model, control)) if slip is not None]
    if not slips:
        return None
    x, u = ca.SX.sym("x", model.n_states), ca.SX.sym("u", model.n_inputs)
    least = slips[0].grip_left(x, u)
    for slip in slips[1:]:
        least = minimum(least, slip.grip_left(x, u))
    return ca.Function("grip_left", [x, u], [least])


def _slip(kind: type[FrontSlip], model: Model, control: str) -> FrontSlip | None:
    inner = model
    while isinstance(inner, Wrapper) and not isinstance(inner, Parametrised):
        inner = inner.model
    if not isinstance(inner, Parametrised):
        return None
    params: Any = inner.params
    peak = _peak(params, kind.axle)
    if peak is None or not {"v_y", "r"} <= set(model.states) or not {control, "v_x"} <= set(model.inputs):
        return None
    late = [name for name in _STEERING if name in model.states]
    return kind(
        places=(model.states.index("v_y"), model.states.index("r")),
        speed=model.inputs.index("v_x"),
        steering=model.states.index(late[0]) if late else -1 - model.inputs.index(control),
        geared=_STEERING[late[0]] if late else True,
        params=params,
        peak=peak,
        rear=model.inputs.index("delta_r") if "delta_r" in model.inputs else -1,
        gain=inner.value("gain_delta_r") if "gain_delta_r" in inner.parameter_names else 1.0,
        small_angles=getattr(inner.ode, "small_angles", True),
    )


def _peak(p: Any, axle: str) -> float | None:
    """Where the Magic Formula of an axle at rest, "f" or "r", is largest: ``shape curved(z) = pi / 2``. [rad]"""
    if not all(hasattr(p, name) for name in ("C_f", "C_r", f"mu_{axle}", "shape", "mass", "l_r", "wheelbase")):
        return None
    E, most = getattr(p, f"E_{axle}", 0.0), 1e3

    def beyond(z: float) -> float:
        return p.shape * float(curved(z, E)) - 0.5 * math.pi

    if not beyond(most) > 0:
        return None
    return optimize.brentq(beyond, 0.0, most) * p.shape * _most(p, axle) / getattr(p, f"C_{axle}")


def _most(p: Any, axle: str) -> float:
    """Largest force of an axle at rest. [N]"""
    load = p.mass * GRAVITY * (p.l_r if axle == "f" else p.l_f) / p.wheelbase
    return getattr(p, f"mu_{axle}") * load
