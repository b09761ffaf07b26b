"""Inverted pendulum on a cart."""

from dataclasses import dataclass
from typing import Annotated

from slipangle.models.ode import OdeModel
from slipangle.models.parameters import ParameterSet
from slipangle.models.storage import RECORDS
from slipangle.ops import Vector, cos, sin, stack
from slipangle.units import SI


@RECORDS.register("PendulumParams")
@dataclass(frozen=True, kw_only=True)
class PendulumParams(ParameterSet):
    """Cart and pendulum; the defaults are those of the balance system of the source.

    Its equations are those of the thesis, letter by letter, and its numbers are M = 10 kg, m = 80 kg, J = 100 kg m2,
    l = 1 m, c = 0.1 N s/m, gamma = 0.01 N m s, g = 9.8 m/s2, with the state feedback K = [-15.3 1730 -50 443] on
    [p theta p' theta']. Public solutions to its exercises use the same set and gain, and the gain stabilises this
    model, which a test checks.

    Source: K. J. Astrom, R. M. Murray, Feedback Systems, Princeton University Press, 2008, balance system.
    """

    mass_cart: Annotated[float, SI("kg", "mass of the base", 1e-3, 1e5)] = 10.0
    mass: Annotated[float, SI("kg", "mass of the pendulum", 1e-3, 1e5)] = 80.0
    inertia: Annotated[float, SI("kg m2", "inertia of the pendulum about its centre of gravity", 0.0, 1e6)] = 100.0
    length: Annotated[float, SI("m", "pivot to centre of gravity of the pendulum", 1e-3, 1e2)] = 1.0
    friction: Annotated[float, SI("N s/m", "viscous friction of the base", 0.0, 1e5)] = 0.1
    friction_pivot: Annotated[float, SI("N m s", "viscous friction of the pivot", 0.0, 1e5)] = 0.01
    gravity: Annotated[float, SI("m/s2", "acceleration due to gravity", 0.1, 100.0)] = 9.8


def pendulum(x: Vector, F: Vector, p: PendulumParams) -> Vector:
    """State rates of cart and pendulum.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eqs. A-6, A-7, solved for the accelerations.

    Parameters
    ----------
    x : vector of 4
        Position [m], angle from upright, positive towards +p [rad], and their rates [m/s, rad/s].
    F : scalar
        Horizontal force on the base. [N]
    p : PendulumParams
        The parameters.
    """
    theta, v, omega = x[1], x[2], x[3]
    ml = p.mass * p.length
    total, inertia, coupling = p.mass_cart + p.mass, p.inertia + ml * p.length, ml * cos(theta)
    push = F - p.friction * v - ml * sin(theta) * omega * omega
    turn = ml * p.gravity * sin(theta) - p.friction_pivot * omega
    determinant = total * inertia - coupling * coupling
    return stack(
        [v, omega, (inertia * push + coupling * turn) / determinant, (coupling * push + total * turn) / determinant]
    )


@RECORDS.register("Pendulum")
@dataclass(frozen=True, kw_only=True)
class Pendulum(OdeModel):
    """Inverted pendulum on a cart: states p [m], theta [rad], v [m/s], omega [rad/s]; input F [N].

    ``theta`` is 0 upright and pi hanging; ``v`` and ``omega`` are the rates of ``p`` and ``theta``.
    """

    states = ("p", "theta", "v", "omega")
    inputs = ("F",)
    max_step = 0.02
    params: PendulumParams = PendulumParams()

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """See `pendulum`."""
        return pendulum(x, u[0], self.params)
