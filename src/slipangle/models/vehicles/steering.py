"""`Steered`: a car whose road wheels follow the logged steering late: a first-order lag, no faster than a rate."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar, Self

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.models.ode import OdeModel
from slipangle.models.wrappers.ode_wrapper import OdeWrapper
from slipangle.ops import Scalar, Vector, concatenate, is_symbolic, is_traced, maximum, minimum, stack
from slipangle.units import SI


@dataclass(frozen=True)
class Steered(OdeWrapper):
    """A car between whose logged steering and road wheels stands an actuator.

    ``d delta_s / dt = (delta - delta_s) / steering_lag``, bounded by ``steering_rate``; ``delta_s`` drives the car in
    place of the logged ``delta``, so the car's own gain and offset apply to it. A pure delay comes on top as
    ``Delayed(Steered(car, ...), delays={"delta": ...})``. Fits vary ``steering_lag`` and ``steering_rate`` like any
    parameter of the car.

    Parameters
    ----------
    model : OdeModel
        The car, with an input ``delta`` and no steering lag of its own.
    steering_lag : float
        Time constant. [s]
    steering_rate : float
        Largest rate of ``delta_s``; infinite: none. [rad/s]

    Raises ParameterError if the model is no such car, or a number is out of range.

    Examples
    --------
    ``Steered(bicycle, steering_lag=0.05)``, then ``GreyBox(start=..., free=("C_f", "C_r", "steering_lag"))``.
    """

    _: KW_ONLY
    steering_lag: float
    steering_rate: float = math.inf

    added_states: ClassVar[tuple[str, ...]] = ("delta_s",)
    own: ClassVar[dict[str, str]] = {
        "steering_lag": "time constant from steering command to road wheel",
        "steering_rate": "largest rate of the steering, as logged",
    }

    def __post_init__(self) -> None:
        if not isinstance(self.model, OdeModel) or "delta" not in self.model.inputs:
            raise ParameterError(
                f"the steered model is a {type(self.model).__name__}; expected a car with an input 'delta', such as "
                "Bicycle: wrap it before Delayed or OnGround"
            )
        if "steering_lag" in self.model.parameter_names:
            raise ParameterError(
                f"{type(self.model).__name__} has a steering lag of its own; expected a car without: set its "
                "steering_lag"
            )
        super().__post_init__()
        for name in self.own:
            value, si = getattr(self, name), self.si(name)
            if not (is_symbolic(value) or is_traced(value)) and not si.lower * (1 - 1e-9) <= value <= si.upper:
                raise ParameterError(
                    f"{name} is {value:g} {si.unit}; expected {si.lower:g} to {si.upper:g} {si.unit}: below that the "
                    "integrator cannot follow, take more substeps or none of it"
                )

    def resampled(self, dt: float, *, substeps: int = 0, outputs: tuple[str, ...] = ()) -> Self:
        """The same at another sample time [s], in steps that follow the lag."""
        return super().resampled(dt, substeps=max(substeps, self.following(self.steering_lag, dt)), outputs=outputs)

    def inside(self, x: Vector, u: Vector) -> tuple[Vector, Vector]:
        """The car's state, and its inputs with the steering where it is, shapes (n_states,), (n_inputs,)."""
        at, n = self.inputs.index("delta"), self.model.n_states
        return x[:n], stack([x[n] if i == at else u[i] for i in range(self.n_inputs)])

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Rates of the car's states, then of ``delta_s`` [rad/s]."""
        rate: Scalar = (u[self.inputs.index("delta")] - x[self.model.n_states]) / self.steering_lag
        if is_symbolic(self.steering_rate) or is_traced(self.steering_rate) or math.isfinite(self.steering_rate):
            rate = maximum(minimum(rate, self.steering_rate), -self.steering_rate)
        return concatenate([self.model.derivative(*self.inside(x, u)), stack([rate])])

    def initial_state(self, data: Dataset) -> np.ndarray:
        """The car's state, the steering where it is commanded to be."""
        return np.append(super().initial_state(data), data["delta"][data.n_samples - 1])

    def range_of(self, name: str) -> SI:
        """The shortest lag is what the integrator can follow."""
        if name == "steering_rate":
            return SI("rad/s", self.own[name], 1e-4, math.inf)
        return SI("s", self.own[name], self.shortest_lag or 1e-4, 2.0)
