"""The multi-body car of commonroad-vehicle-models as an `OdeModel`: its own code, traced once with symbols.

Its differential equations are plain Python on floats. Here they are called with symbols, so that 20 s take a fraction
of a second. Comparisons in them ask for a standing car or wheels that spin backwards: on these drives never.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from types import FunctionType, SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from slipangle.models.ode import OdeModel
from slipangle.ops import Scalar, Vector, stack

STATES = (
    *("X", "Y", "delta_w", "v_x", "psi", "r", "phi", "phi_rate", "theta", "theta_rate", "v_y"),
    *(f"other_{k}" for k in range(11, 23)),
    *("omega_fl", "omega_fr", "omega_rl", "omega_rr", "shift_f", "shift_r"),
)
_AT = {name: i for i, name in enumerate(STATES)}


def installed() -> bool:
    """Whether the package is there."""
    return find_spec("vehiclemodels") is not None


class _Forward:
    """A symbol of a car that drives forward: nothing of it is below zero, or above a limit."""

    def __init__(self, value: Any) -> None:
        self.value = value.value if isinstance(value, _Forward) else value

    def __lt__(self, other: Any) -> bool:
        return False

    __gt__ = __lt__

    def __neg__(self) -> _Forward:
        return _Forward(-self.value)


def _operator(name: str) -> None:
    act = getattr(operator, name)
    setattr(_Forward, f"__{name}__", lambda a, b: _Forward(act(a.value, _Forward(b).value)))
    setattr(_Forward, f"__r{name}__", lambda a, b: _Forward(act(_Forward(b).value, a.value)))


for _name in ("add", "sub", "mul", "truediv", "pow"):
    _operator(_name)


def _symbolic(function: Any) -> Any:
    """The same for what `_Forward` holds."""
    return lambda x: _Forward(function(ca.SX(_Forward(x).value)))


_MATH = SimpleNamespace(**{n: _symbolic(getattr(ca, n)) for n in ("sin", "cos", "tan", "atan", "sqrt", "fabs")})


def _elsewhere(function: Any, **names: Any) -> FunctionType:
    """A function whose module has other things under some names."""
    return FunctionType(function.__code__, {**function.__globals__, "math": _MATH, **names})


@cache
def parameters(vehicle: int) -> Any:
    """Parameters of vehicle 1, 2 or 3, without side force at no slip angle.

    The tires' offsets by the sign of camber make the side force jump where a wheel's camber passes zero, so that the
    car has no cornering stiffness; that by slip ratio pulls it to one side.
    """
    import vehiclemodels.vehicle_parameters as known

    p = _plain(known.setup_vehicle_parameters(vehicle_id=vehicle))
    vars(p.tire).update(dict.fromkeys(("p_hy1", "p_hy3", "p_vy1", "p_vy3", "r_vy1", "r_vy3"), 0.0))
    return p


def _plain(node: Any) -> Any:
    names = vars(node) if not hasattr(node, "items") else dict(node.items())
    return SimpleNamespace(
        **{k: _plain(v) if hasattr(v, "items") or hasattr(v, "__dict__") else v for k, v in names.items()}
    )


@dataclass(frozen=True, kw_only=True)
class MultiBody(OdeModel):
    """Vehicle 1, 2 or 3 (``params``); inputs are the road-wheel angle [rad] and the wanted acceleration [m/s2].

    Outputs on request, besides the states: a_y [m/s2], of the body.
    """

    states = STATES
    inputs = ("delta", "wanted_a_x")
    max_step = 0.001
    params: int

    @property
    def car(self) -> Any:
        """Its parameters, as the package names them."""
        return parameters(self.params)

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """The package's, with the wheels turned to ``delta`` and its own split of drive and brake torque."""
        from vehiclemodels import vehicle_dynamics_mb as theirs

        p, tire = self.car, theirs.tireModel
        curves = {n: _elsewhere(f, sign=_symbolic(ca.sign)) for n, f in vars(tire).items() if n.startswith("formula")}
        dynamics = _elsewhere(
            theirs.vehicle_dynamics_mb,
            abs=lambda v: v,
            tireModel=SimpleNamespace(**curves),
            steering_constraints=lambda angle, rate, limits: rate,
            acceleration_constraints=lambda speed, wanted, limits: wanted,
        )
        state = [_Forward(x[i]) for i in range(self.n_states)]
        state[_AT["delta_w"]] = _Forward(u[0])
        rates: list[Any] = [k.value if isinstance(k, _Forward) else k for k in dynamics(state, [0.0, _Forward(0.0)], p)]
        drive = u[1] * p.m * p.R_w / p.I_y_w * 0.5
        front = ca.if_else(u[1] > 0, p.T_se, p.T_sb)
        for name in STATES[23:27]:
            rates[_AT[name]] += drive * (front if name in ("omega_fl", "omega_fr") else 1 - front)
        return stack(rates)

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """See the class."""
        if isinstance(x, np.ndarray):
            return {"a_y": 0.0}  # asked for its name only
        return {"a_y": self.derivative(x, u)[_AT["v_y"]] + x[_AT["v_x"]] * x[_AT["r"]]}

    def straight(self, v_x: float, *, X: float = 0.0, Y: float = 0.0, psi: float = 0.0) -> np.ndarray:
        """The package's own state of straight driving."""
        from vehiclemodels.init_mb import init_mb

        return np.array(init_mb([X, Y, 0.0, v_x, psi, 0.0, 0.0], self.car))
