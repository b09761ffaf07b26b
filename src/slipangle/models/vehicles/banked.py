"""`Banked`: a car on a road with cross slope, an input."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from slipangle.errors import ParameterError
from slipangle.models.ode import OdeModel
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.models.wrappers.ode_wrapper import OdeWrapper
from slipangle.ops import Vector, sin, stack


@dataclass(frozen=True)
class Banked(OdeWrapper):
    """A car that a cross slope pulls sideways: ``v_y`` changes by ``-g sin(bank)`` more.

    ``bank`` [rad], positive with the left edge higher, is an input after the car's own: a channel of the log, or zero.
    The a_y of the car stays that of its tires over its mass, which is what an accelerometer reads. Inside `Steered`
    and `Delayed`: ``Delayed(Steered(Banked(car), ...), ...)``.

    Parameters
    ----------
    model : OdeModel
        The car, with a state ``v_y``.

    Raises ParameterError if the model is no such car.
    """

    added_inputs: ClassVar[tuple[str, ...]] = ("bank",)

    def __post_init__(self) -> None:
        if not isinstance(self.model, OdeModel) or "v_y" not in self.model.states or "bank" in self.model.inputs:
            raise ParameterError(
                f"the banked model is a {type(self.model).__name__}; expected a car with a state 'v_y' on a level "
                "road, such as Bicycle"
            )
        super().__post_init__()

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Rates of the car's states."""
        rates, at = self.model.derivative(*self.inside(x, u)), self.model.states.index("v_y")
        pull = GRAVITY * sin(u[self.n_inputs - 1])
        return stack([rates[i] - pull if i == at else rates[i] for i in range(self.n_states)])
