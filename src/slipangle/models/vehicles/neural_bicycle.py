"""Physics with a network inside: on the bicycle's state derivative, or on its tire coefficients."""

from __future__ import annotations

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
    nonlinear_bicycle,
)
from slipangle.ops import Scalar, Vector, clip, concatenate, stack, tanh

LONG = 2000  # samples from which a free run is worth compiled code


def neural_bicycle(
    x: Vector, u: Vector, p: NonlinearBicycleParams, correction: Callable[[Vector], Vector]
) -> tuple[Scalar, Scalar, Scalar]:
    """Rates of v_y [m/s2], r [rad/s2] and delta_w [rad/s]: physics plus what the correction adds to the first two.

    Parameters
    ----------
    x : vector of 3
        v_y [m/s], r [rad/s], delta_w [rad].
    u : vector of 3
        delta [rad], v_x [m/s], v_x_dot [m/s2].
    p : NonlinearBicycleParams
        The car.
    correction : callable
        From the six numbers of x and u to rates of v_y and r.
    """
    v_y_dot, r_dot, F_yf = nonlinear_bicycle(x[0], x[1], x[2], u[1], u[2], p)
    more = correction(concatenate([x, u]))
    wanted = p.road_wheel(u[0]) - p.compliance * F_yf
    return v_y_dot + more[0], r_dot + more[1], (wanted - x[2]) / p.steering_lag


def tire_network_bicycle(
    x: Vector, u: Vector, p: NonlinearBicycleParams, correction: Callable[[Vector], Vector], reach: float
) -> tuple[Scalar, Scalar, Scalar]:
    """Rates as of `neural_bicycle`, from tire coefficients that the correction moves: ``C_f (1 + reach tanh z_1)``...

    ``z`` are the four numbers that the correction makes of x and u; so C_f, C_r, mu_f and mu_r stay within ``1 -
    reach`` to ``1 + reach`` times the parameters', whatever the network says. [1]_ bounds coefficients alike.

    References
    ----------
    .. [1] J. Chrosniak, J. Ning, M. Behl, Deep Dynamics: vehicle dynamics modeling with a physics-constrained neural
       network for autonomous racing, IEEE Robotics and Automation Letters 9, 2024.
    """
    z = correction(concatenate([x, u]))
    names = AxleCoefficients._fields
    tires = AxleCoefficients(*(getattr(p, name) * (1.0 + reach * tanh(z[i])) for i, name in enumerate(names)))
    v_y_dot, r_dot, F_yf = nonlinear_bicycle(x[0], x[1], x[2], u[1], u[2], p, tires=tires)
    wanted = p.road_wheel(u[0]) - p.compliance * F_yf
    return v_y_dot, r_dot, (wanted - x[2]) / p.steering_lag


@dataclass(frozen=True, kw_only=True)
class NeuralBicycle(NonlinearBicycle):
    """The bicycle at the limit plus a network on the derivatives of v_y and r, from all states and inputs.

    Channels as of `NonlinearBicycle`. The state is bounded, so no input makes the free run spin out of the numbers.

    Parameters
    ----------
    network : Network
        Six inputs (v_y, r, delta_w, delta, v_x, v_x_dot) to two outputs (m/s2, rad/s2), SI units.
    most_v_y, most_r : float
        Largest lateral velocity [m/s] and yaw rate [rad/s] that the state takes, either sign.
    """

    own_step: ClassVar[bool] = False  # its bounds are there for networks in training; a fit of parameters stays inside

    network: Network
    most_v_y: float = 15.0
    most_r: float = 2.0

    def __post_init__(self) -> None:
        sizes = self.network.n_inputs, self.network.n_outputs
        wanted, meaning = self.network_outputs()
        if sizes != (6, wanted):
            raise ParameterError(
                f"the network has {sizes[0]} inputs and {sizes[1]} outputs; expected 6 (v_y, r, delta_w, delta, v_x, "
                f"v_x_dot) and {wanted} ({meaning})"
            )
        if not (self.most_v_y > 0 and self.most_r > 0):
            raise ParameterError(f"the bounds are {self.most_v_y} m/s and {self.most_r} rad/s; expected positive ones")
        super().__post_init__()

    @classmethod
    def network_outputs(cls) -> tuple[int, str]:
        """How many outputs the network has, and what they are."""
        return 2, "rates of v_y and r"

    def rates(
        self, x: Vector, u: Vector, p: NonlinearBicycleParams, network: Callable[[Vector], Vector]
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Rates of the state with other parameters and another network; see `neural_bicycle`."""
        return neural_bicycle(x, u, p, network)

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
    saturate depends on what the car does.

    Parameters
    ----------
    reach : float
        How far a coefficient may move, as a share of its parameter; the network's four outputs, through tanh, say
        how much of it C_f, C_r, mu_f and mu_r take.
    """

    reach: float = 0.3

    def __post_init__(self) -> None:
        if not 0 < self.reach < 1:
            raise ParameterError(f"reach is {self.reach}; expected a share between 0 and 1, such as 0.3")
        super().__post_init__()

    @classmethod
    def network_outputs(cls) -> tuple[int, str]:
        """How many outputs the network has, and what they are."""
        return 4, "moves of C_f, C_r, mu_f and mu_r"

    def rates(
        self, x: Vector, u: Vector, p: NonlinearBicycleParams, network: Callable[[Vector], Vector]
    ) -> tuple[Scalar, Scalar, Scalar]:
        """See `tire_network_bicycle`."""
        return tire_network_bicycle(x, u, p, network, self.reach)
