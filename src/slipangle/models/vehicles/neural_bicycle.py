"""Physics with a network inside: on the bicycle's state derivative, or on its tire coefficients."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from slipangle.errors import ParameterError
from slipangle.models.black_box.networks import Network
from slipangle.models.fast import evaluate
from slipangle.models.vehicles import neural_bicycle_code
from slipangle.models.vehicles.nonlinear_bicycle import (
    AxleCoefficients,
    NonlinearBicycle,
    NonlinearBicycleParams,
    state_rates,
)
from slipangle.ops import Scalar, Vector, clip, concatenate, stack, tanh

LONG = 2000  # samples from which a free run is worth compiled code
Rates = tuple[Scalar, Scalar, Scalar]  # of v_y [m/s2], r [rad/s2], delta_w [rad/s]
Correction = Callable[[Vector], Vector]  # of the six numbers of x and u


@dataclass(frozen=True, kw_only=True)
class NeuralBicycle(NonlinearBicycle):
    """The bicycle at the limit plus a network on the derivatives of v_y and r, from all states and inputs.

    Channels as of `NonlinearBicycle`. The state is bounded, so no input makes the free run spin out of the numbers.
    Raises ParameterError if the network has other inputs or outputs, or a bound is not positive.

    Parameters
    ----------
    network : Network
        Six inputs (v_y, r, delta_w, delta, v_x, v_x_dot) to two outputs (m/s2, rad/s2), SI units.
    most_v_y, most_r : float
        Largest lateral velocity [m/s] and yaw rate [rad/s] that the state takes, either sign.
    """

    network_outputs: ClassVar[tuple[int, str]] = 2, "rates of v_y and r"  # how many, and what they are
    own_step: ClassVar[bool] = False  # its bounds are there for networks in training; a fit of parameters stays inside

    network: Network
    most_v_y: float = 15.0
    most_r: float = 2.0

    def __post_init__(self) -> None:
        sizes = self.network.n_inputs, self.network.n_outputs
        wanted, meaning = self.network_outputs
        if sizes != (6, wanted):
            raise ParameterError(
                f"the network has {sizes[0]} inputs and {sizes[1]} outputs; expected 6 (v_y, r, delta_w, delta, v_x, "
                f"v_x_dot) and {wanted} ({meaning})"
            )
        if not (self.most_v_y > 0 and self.most_r > 0):
            raise ParameterError(f"the bounds are {self.most_v_y} m/s and {self.most_r} rad/s; expected positive ones")
        super().__post_init__()

    def rates(self, x: Vector, u: Vector, p: NonlinearBicycleParams, network: Correction) -> Rates:
        """Rates of the state with other parameters ``p`` and another network, which adds to those of v_y and r."""
        (v_y_dot, r_dot, turning), more = state_rates(x, u, p), network(concatenate([x, u]))
        return v_y_dot + more[0], r_dot + more[1], turning

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """See `rates`."""
        return stack(self.rates(x, u, self.params, self.network))

    def step(self, x: Vector, u: Vector) -> Vector:
        """State one sample later, within its bounds."""
        nxt = super().step(x, u)
        return stack([clip(nxt[0], -self.most_v_y, self.most_v_y), clip(nxt[1], -self.most_r, self.most_r), nxt[2]])

    def free_run(self, x0: np.ndarray, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Long runs in compiled code."""
        if len(u) >= LONG:
            states = neural_bicycle_code.run(self, x0, u[:-1])
            if states is not None:
                return evaluate(self.functions[1], states, u[1:])
        return super().free_run(x0, u, out)


@dataclass(frozen=True, kw_only=True)
class TireNetworkBicycle(NeuralBicycle):
    """The bicycle at the limit with tire coefficients from a network, each within bounds.

    Physics stays physics: forces saturate and loads shift as ever, and only how stiff the axles are and where they
    saturate depends on what the car does. The source bounds coefficients alike.

    Parameters
    ----------
    reach : float
        How far a coefficient may move, as a share of its parameter; the network's four outputs, through tanh, say
        how much of it C_f, C_r, mu_f and mu_r take.

    Source: J. Chrosniak, J. Ning, M. Behl, Deep Dynamics: vehicle dynamics modeling with a physics-constrained neural
    network for autonomous racing, IEEE Robotics and Automation Letters 9, 2024.
    """

    network_outputs = 4, "moves of C_f, C_r, mu_f and mu_r"
    reach: float = 0.3

    def __post_init__(self) -> None:
        if not 0 < self.reach < 1:
            raise ParameterError(f"reach is {self.reach}; expected a share between 0 and 1, such as 0.3")
        super().__post_init__()

    def rates(self, x: Vector, u: Vector, p: NonlinearBicycleParams, network: Correction) -> Rates:
        """Rates from tire coefficients that the network moves: ``C_f (1 + reach tanh z_1)`` and so on."""
        z, names = network(concatenate([x, u])), AxleCoefficients._fields
        moved = (getattr(p, name) * (1.0 + self.reach * tanh(z[i])) for i, name in enumerate(names))
        return state_rates(x, u, p, AxleCoefficients(*moved))
