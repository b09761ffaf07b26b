"""`RearSteered`, `TorqueVectored`: cars that turn by more than their front wheels, each with one input more."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any, ClassVar

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.models.ode import OdeModel
from slipangle.models.parameters import require_in_range
from slipangle.models.wrappers.ode_wrapper import OdeWrapper
from slipangle.ops import Scalar, Vector, stack
from slipangle.units import SI


@dataclass(frozen=True)
class RearSteered(OdeWrapper):
    """A car whose rear wheels are steered too.

    ``delta_r`` [rad], positive to the left, is an input after the car's own: the angle of the rear road wheels over the
    body, a channel of the log. Slip angles, and so the forces, are those of the same car with straight rear wheels that
    moves sideways by ``delta_r v_x`` less and whose front wheels are turned by ``delta_r`` less. What drives or brakes
    the car, see `LoadTransfer`, turns with the front wheels so, and not with the rear ones.

    Parameters
    ----------
    model : OdeModel
        The car, `Bicycle`, `SaturatingBicycle` or `RelaxingBicycle`; `TorqueVectored`, `Banked`, `Steered` and
        `Delayed` come around it.
    gain_delta_r : float
        True over given angle, such as of an actuator's travel. [-]

    Raises ParameterError if the model is no such car, or the gain out of range.
    """

    _: KW_ONLY
    gain_delta_r: float = 1.0

    added_inputs: ClassVar[tuple[str, ...]] = ("delta_r",)
    own: ClassVar[dict[str, str]] = {"gain_delta_r": "true over given angle of the rear wheels"}

    def __post_init__(self) -> None:
        if not isinstance(self.model, OdeModel) or not hasattr(self.model, "slip_speed"):
            raise ParameterError(
                f"the car with steered rear wheels is a {type(self.model).__name__}; expected a Bicycle, a "
                "SaturatingBicycle or a RelaxingBicycle: wrap that first, then the rest around it"
            )
        super().__post_init__()
        require_in_range("gain_delta_r", self.gain_delta_r, self.range_of("gain_delta_r"))

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Rates of the car's states."""
        return self.model.derivative(*self._straight(x, u))

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Those of the car."""
        return self.model.signals(*self._straight(x, u))

    def output(self, x: Vector, u: Vector) -> Vector:
        """Outputs of the car: states as they are, all else by its forces."""
        read, felt = self.model.output(*self.inside(x, u)), self.model.output(*self._straight(x, u))
        return stack([(read if name in self.states else felt)[i] for i, name in enumerate(self.outputs)])

    def initial_state(self, data: Dataset) -> np.ndarray:
        """That of the car, with the v_y of steady cornering on these rear wheels unless it was measured."""
        car: Any = self.model
        data = data.rows(0, 1)
        angle = self.gain_delta_r * data["delta_r"]
        away = angle * float(car.slip_speed(float(data["v_x"][0])))
        straight = data.with_channel("delta", data["delta"] - angle / self.params.steering_gain, "rad")
        if "v_y" in data:
            read = getattr(self.params, "gain_v_y", 1.0) * away
            straight = straight.with_channel("v_y", data["v_y"] - read, "m/s")
        x = np.array(super().initial_state(straight), dtype=float)
        x[self.states.index("v_y")] += away[0]
        return x

    def range_of(self, name: str) -> SI:
        """Below zero where the angle is given with the wrong sign."""
        return SI("-", self.own[name], -5.0, 5.0)

    def _straight(self, x: Vector, u: Vector) -> tuple[Vector, Vector]:
        """State and inputs of the car with straight rear wheels that has the same slip angles."""
        car: Any = self.model
        given, angle = u[: car.n_inputs], self.gain_delta_r * u[car.n_inputs]
        away = angle * car.slip_speed(u[car.inputs.index("v_x")])
        turn = angle / self.params.steering_gain
        state = [x[i] - away if name == "v_y" else x[i] for i, name in enumerate(car.states)]
        return stack(state), stack([given[i] - turn if n == "delta" else given[i] for i, n in enumerate(car.inputs)])


@dataclass(frozen=True)
class TorqueVectored(OdeWrapper):
    """A car that is turned by its drive or its brakes too.

    ``M_z`` [N m], positive to the left, is an input after the car's own: the yaw moment that longitudinal forces of
    left and right wheels make, such as half the track times the sum of the right wheels' torques minus the left ones'
    over the wheels' radius. The grip that these forces take from the tires is left out.

    Parameters
    ----------
    model : OdeModel
        The car, with a state ``r``; `Banked`, `Steered` and `Delayed` come around it.
    gain_M_z : float
        True over given moment: torques told by motors are a few percent off. [-]

    Raises ParameterError if the model is no such car, or the gain out of range.
    """

    _: KW_ONLY
    gain_M_z: float = 1.0

    added_inputs: ClassVar[tuple[str, ...]] = ("M_z",)
    own: ClassVar[dict[str, str]] = {"gain_M_z": "true over given yaw moment"}

    def __post_init__(self) -> None:
        known = isinstance(self.model, OdeModel) and "r" in self.model.states and "M_z" not in self.model.inputs
        if not known or not hasattr(self.model.params, "inertia_z"):
            raise ParameterError(
                f"the torque-vectored car is a {type(self.model).__name__}; expected one with a state 'r' and a "
                "parameter inertia_z, such as Bicycle: wrap it before Delayed or OnGround"
            )
        super().__post_init__()
        require_in_range("gain_M_z", self.gain_M_z, self.range_of("gain_M_z"))

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Rates of the car's states."""
        rates, at = self.model.derivative(*self.inside(x, u)), self.model.states.index("r")
        turn = self._turn(u[self.n_inputs - 1])
        return stack([rates[i] + turn if i == at else rates[i] for i in range(self.n_states)])

    def output(self, x: Vector, u: Vector) -> Vector:
        """Outputs of the car; an a_y sensor away from the centre of gravity feels the moment."""
        y, p = self.model.output(*self.inside(x, u)), self.params
        if "a_y" not in self.outputs or not hasattr(p, "lever_a_y"):
            return y
        felt = p.gain_a_y * p.lever_a_y * self._turn(u[self.n_inputs - 1])
        return stack([y[i] + felt if name == "a_y" else y[i] for i, name in enumerate(self.outputs)])

    def range_of(self, name: str) -> SI:
        """Below zero where the moment is given with the wrong sign."""
        return SI("-", self.own[name], -5.0, 5.0)

    def _turn(self, moment: Scalar) -> Scalar:
        """What a moment as given [N m] does to the rate of r. [rad/s2]"""
        return self.gain_M_z * moment / self.params.inertia_z
