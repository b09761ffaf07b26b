"""Electro-mechanical positioning system: a carriage on a ball screw with friction."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from slipangle.equal import Equal
from slipangle.errors import ParameterError
from slipangle.models.ode import OdeModel
from slipangle.models.parameters import ParameterSet
from slipangle.models.storage import RECORDS
from slipangle.ops import Scalar, Vector, stack, tanh
from slipangle.units import SI


@RECORDS.register("EmpsParams")
@dataclass(frozen=True, kw_only=True)
class EmpsParams(ParameterSet):
    """Inertia and friction, all seen at the carriage."""

    mass: Annotated[float, SI("kg", "moving mass with the drive's inertia", 1.0, 1e4)]
    viscous: Annotated[float, SI("N s/m", "viscous friction", -1e4, 1e4)]
    coulomb: Annotated[float, SI("N", "Coulomb friction", -1e3, 1e3)]
    offset: Annotated[float, SI("N", "force at rest", -1e3, 1e3)] = 0.0
    v_slip: Annotated[float, SI("m/s", "speed at which Coulomb friction is three quarters built up", 1e-6, 1.0)] = 1e-3


@RECORDS.register("FrictionCurve")
@dataclass(frozen=True, kw_only=True)
class FrictionCurve(Equal):
    """Friction beside Coulomb's and the viscous one: smooth steps over the speed, ``sum w_i tanh((v - v_i) / width)``.

    ``centres`` say where the steps are, shape (n,), ``width`` how wide each is [m/s], ``weights`` half their heights,
    shape (n,) [N].
    """

    centres: np.ndarray
    width: float
    weights: np.ndarray

    def __post_init__(self) -> None:
        for name in ("centres", "weights"):
            value = np.array(getattr(self, name), dtype=float).ravel()
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if len(self.centres) != len(self.weights) or not self.width > 0:
            raise ParameterError(
                f"{len(self.centres)} centres, {len(self.weights)} weights, width {self.width}; expected as many "
                "weights as centres and a positive width"
            )

    def force(self, v: Scalar) -> Scalar:
        """Friction force against the motion at speed ``v``. [N]"""
        return smooth_steps(v, self.centres, self.width, self.weights)


def smooth_steps(v: Scalar, centres: np.ndarray, width: float, weights: Vector) -> Scalar:
    """Sum of ``weights[i] tanh((v - centres[i]) / width)``."""
    total = 0.0 * v
    for i, centre in enumerate(centres):
        total = total + weights[i] * tanh((v - centre) / width)
    return total


def carriage(v: Scalar, force: Scalar, p: EmpsParams, learned: Scalar = 0.0) -> Vector:
    """Rates of position [m/s] and speed [m/s2]; ``learned`` is friction beside that of ``p``. [N]

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eq. A-4.
    """
    friction = p.viscous * v + p.coulomb * tanh(v / p.v_slip) + p.offset + learned
    return stack([v, (force - friction) / p.mass])


@RECORDS.register("Emps")
@dataclass(frozen=True, kw_only=True)
class Emps(OdeModel):
    """``mass dv/dt = force - viscous v - coulomb sign(v) - offset``, ``dq/dt = v``.

    The sign is smoothed over `EmpsParams.v_slip`. A free run starts from the first samples of the channels ``q`` and
    ``v``, at rest where there is no ``v``.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eq. A-4; A. Janot, M. Gautier, M. Brunot, Workshop on Nonlinear
    System Identification Benchmarks, 2019: data set and reference model.

    Parameters
    ----------
    params : EmpsParams
        Inertia and friction.
    friction : FrictionCurve, optional
        Learned friction on top.
    """

    states = ("q", "v")
    inputs = ("force",)
    max_step: ClassVar[float] = 1e-3

    params: EmpsParams
    friction: FrictionCurve | None = None

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """See `carriage`."""
        learned = 0.0 if self.friction is None else self.friction.force(x[1])
        return carriage(x[1], u[0], self.params, learned)
