"""Integration by CVODES, as the thesis does it in its plants and inside its predictions."""

from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from typing import Any, Generic, TypeVar

import casadi as ca
import numpy as np

from slipangle import Dataset, Model
from slipangle.models.ode import OdeModel
from slipangle.ops import Vector, is_symbolic

Car = TypeVar("Car", bound=OdeModel)


@dataclass(frozen=True)
class ByCvodes(Model, Generic[Car]):
    """A car integrated by CVODES over its sample time, to a relative and absolute tolerance, inputs held.

    The outputs are the states; the car's `derivative` counts.
    """

    car: Car
    _: KW_ONLY
    tolerance: float = 1e-8
    dt: float = field(init=False)
    states: tuple[str, ...] = field(init=False)
    inputs: tuple[str, ...] = field(init=False)
    outputs: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        car = self.car
        for name, value in {"dt": car.dt, "states": car.states, "inputs": car.inputs, "outputs": car.states}.items():
            object.__setattr__(self, name, value)

    @cached_property
    def integrator(self) -> ca.Function:
        """``(x0, p) -> xf`` over one sample, inputs held."""
        options = {"reltol": self.tolerance, "abstol": self.tolerance}
        return ca.integrator("cvodes", "cvodes", self._problem(), 0.0, self.dt, options)

    def _problem(self) -> dict[str, Any]:
        """The equations in scalar symbols or, where tables take no such, in matrix symbols."""
        kinds: tuple[Any, ...] = (ca.SX, ca.MX)
        for kind in kinds:
            x, u = kind.sym("x", self.n_states), kind.sym("u", len(self.inputs))
            try:
                return {"x": x, "p": u, "ode": self.car.derivative(x, u)}
            except RuntimeError:
                if kind is ca.MX:
                    raise
        raise AssertionError

    def initial_state(self, data: Dataset) -> np.ndarray:
        """As of the car."""
        return self.car.initial_state(data)

    def step(self, x: Vector, u: Vector) -> Vector:
        """State one sample later."""
        if is_symbolic(x, u):
            if isinstance(x, ca.SX) or isinstance(u, ca.SX):
                raise NotImplementedError("an integrator takes matrix symbols only")
            return self.integrator(x0=x, p=u)["xf"]
        return np.asarray(self.integrator(x0=x, p=u)["xf"]).ravel()

    def output(self, x: Vector, u: Vector) -> Vector:
        """The states."""
        return x
