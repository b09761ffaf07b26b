"""Tires: from slip and load to force. Linear and simple Magic Formula.

Slip ratio ``s`` is positive when driving, slip angle ``alpha`` is positive when it gives a force to the
left; both signs as in docs/nomenclature.md.

.. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023; B there is per percent or per degree in table 6.2.
.. [2] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.2.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Literal, NamedTuple, Self

from slipangle.data.readers.tir import TirFile
from slipangle.equal import Equal
from slipangle.errors import FormatError, ParameterError
from slipangle.fields import Checked
from slipangle.models.model import FitInfo
from slipangle.models.parameters import ParameterSet
from slipangle.ops import Scalar, atan, clip, is_symbolic, maximum, sin, smooth_abs, speed_floor, sqrt
from slipangle.shown import Brief
from slipangle.units import SI


class TireForces(NamedTuple):
    """Forces and moments on one tire (or on one axle, where the tire stands for an axle).

    F_x forward, F_y to the left, F_z up [N]; M_x overturning, M_y rolling resistance, M_z self-aligning
    moment about the upward axis [N m].
    """

    F_x: Scalar
    F_y: Scalar
    M_x: Scalar = 0.0
    M_y: Scalar = 0.0
    M_z: Scalar = 0.0


class KnownRange(NamedTuple):
    """What a tire's data or file cover: largest slip ratio [-] and angle [rad], usual loads and their limits [N]."""

    slip_ratio: float = 0.3
    slip_angle: float = math.radians(15.0)
    usual: tuple[float, float] | None = None
    limits: tuple[float, float] = (0.0, math.inf)


class Rolling(NamedTuple):
    """How a tire rolls at a load: rolling radius, relaxation lengths [m], rolling resistance over load [-].

    None is what the tire does not know.
    """

    radius: float | None = None
    relaxation_x: float | None = None
    relaxation_y: float | None = None
    rolling_resistance: float | None = None


class Tire(Brief, Equal, abc.ABC):
    """What a vehicle model needs of a tire: forces from slip and load, on numbers and on symbols.

    The rest has defaults that suit a tire that is alike on both sides and valid everywhere.
    """

    side: Literal["LEFT", "RIGHT", ""] = ""
    mirrored: bool | None = None
    source: TirFile | None = None
    fit_info: FitInfo | None = None
    conditions: ClassVar[tuple[str, ...]] = ()  # what `forces_at` counts besides slip, load and camber

    @abc.abstractmethod
    def forces(
        self, slip_ratio: Scalar, slip_angle: Scalar, load: Scalar, *, camber: Scalar = 0.0, friction: Scalar = 1.0
    ) -> TireForces:
        """Forces at the contact patch.

        Parameters
        ----------
        slip_ratio : scalar
            Longitudinal slip; s > 0 drives. [-]
        slip_angle : scalar
            Slip angle; alpha > 0 gives F_y > 0, to the left. [rad]
        load : scalar
            Vertical load, positive. [N]
        camber : scalar
            Inclination; positive leans the top to the right (rotation about +x). [rad]
        friction : scalar
            Road friction relative to the road of the tire test. [-]
        """

    def forces_at(
        self,
        slip_ratio: Scalar,
        slip_angle: Scalar,
        load: Scalar,
        *,
        camber: Scalar,
        pressure: Scalar | None,
        speed: Scalar | None = None,
    ) -> TireForces:
        """`forces` at an inflation pressure [Pa] and a forward speed [m/s], where ``conditions`` names them."""
        return self.forces(slip_ratio, slip_angle, load, camber=camber)

    def mounted(self, side: Literal["LEFT", "RIGHT"]) -> Self:
        """The tire on a side of the vehicle."""
        return self

    def unlimited(self) -> Self:
        """The tire without limits of its validity, for plants and figures, which go on whatever happens."""
        return self

    def rolling(self, load: float) -> Rolling:
        """How the tire rolls freely at a load [N], at its own pressure and reference speed."""
        return Rolling()

    def scaled(self, **factors: Scalar) -> Self:
        """The tire with scaling factors (LMUY, LKY ...) times ``factors`` [-]; raises ParameterError if it has none."""
        for name, value in factors.items():
            if is_symbolic(value) or value != 1:
                raise ParameterError(
                    f"a {type(self).__name__} has no scaling factor {name}; expected a Magic Formula tire of a .tir "
                    f"file: leave {name} at 1"
                )
        return self

    @property
    def peak_friction(self) -> tuple[Scalar, Scalar] | None:
        """Largest friction coefficients along and across; None where they depend on load or are not known. [-]"""
        return None

    @property
    def known_range(self) -> KnownRange:
        """Where the tire is worth drawing."""
        return KnownRange()

    def write_tir(self, path: str | Path, *, comments: Mapping[str, str] | None = None) -> Path:
        """Write the tire as a ``.tir`` file, with ``comments`` by key; raises FormatError if it has no place in one."""
        raise FormatError(f"a {type(self).__name__} has no place in a .tir file; expected .json as suffix")


def slip_ratio(v_x: Scalar, wheel_speed: Scalar, radius: Scalar, *, v_low: float = 0.5) -> Scalar:
    """Longitudinal slip of a wheel, positive when it drives. [1]_ eq. 3-13 with the sign corrected.

    ``s = (omega r - v_x) / max(|v_x|, |omega r|)``, with both magnitudes kept above ``v_low / 2``
    (see `slipangle.ops.speed_floor`) and the larger taken smoothly, so that slip stays defined and
    differentiable at standstill.

    From the longitudinal speed of the wheel centre [m/s], the spin of the wheel, positive forward [rad/s], and the
    rolling radius [m]; below ``v_low`` [m/s] slip is softened.

    >>> bool(slip_ratio(20.0, 22.0, 1.0) > 0)
    True
    """
    rolling = wheel_speed * radius
    a, b = speed_floor(v_x, v_low), speed_floor(rolling, v_low)
    larger = 0.5 * (a + b + smooth_abs(a - b, 1e-3 * v_low))
    return (rolling - v_x) / larger


def practical_slip(slip_ratio: Scalar) -> Scalar:
    """Slip of tire files and rigs, kappa = (omega r - v_x) / |v_x|, from slip ratio s. [-]

    The two agree when braking; when driving, where s counts against ``omega r``, ``kappa = s / (1 - s)``, up to 999
    for a wheel that spins on the spot.

    >>> float(practical_slip(0.2)), float(practical_slip(-0.2))
    (0.25, -0.2)
    """
    return slip_ratio / (1.0 - clip(slip_ratio, 0.0, 0.999))


def slip_from_practical(kappa: Scalar) -> Scalar:
    """Slip ratio s of a practical slip, `practical_slip` turned round: kappa / (1 + kappa) when driving. [-]

    >>> float(slip_from_practical(0.25)), float(slip_from_practical(-0.2))
    (0.2, -0.2)
    """
    return kappa / (1.0 + maximum(kappa, 0.0))


@dataclass(frozen=True, kw_only=True)
class LinearTire(ParameterSet, Tire):
    """Forces proportional to slip, whatever the load. [1]_ eqs. 3-9, 3-10."""

    C_alpha: Annotated[float, SI("N/rad", "cornering stiffness", 0.0, 5e6)]
    C_s: Annotated[float, SI("N", "longitudinal slip stiffness", 0.0, 5e6)] = 0.0
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    def forces(
        self, slip_ratio: Scalar, slip_angle: Scalar, load: Scalar, *, camber: Scalar = 0.0, friction: Scalar = 1.0
    ) -> TireForces:
        """Linear forces; load, camber and friction have no influence."""
        return TireForces(self.C_s * slip_ratio, self.C_alpha * slip_angle)


@dataclass(frozen=True, kw_only=True)
class MagicCurve(ParameterSet):
    """One curve of the simple Magic Formula, friction coefficient over slip. [1]_ eqs. 3-16, 3-17.

    ``mu = D sin(C atan(B phi)) + S_v`` with ``phi = (1 - E)(x + S_h) + (E / B) atan(B (x + S_h))``.
    """

    slip_alone: ClassVar[bool] = True  # and not load or camber

    B: Annotated[float, SI("-", "stiffness factor, per unit slip or per rad", -100.0, 100.0)]
    C: Annotated[float, SI("-", "shape factor", -12.0, 12.0)]
    D: Annotated[float, SI("-", "peak friction coefficient", -12.0, 12.0)]
    E: Annotated[float, SI("-", "curvature factor", -50.0, 12.0)] = 0.0
    S_h: Annotated[float, SI("-", "horizontal shift, slip or rad", -1.0, 1.0)] = 0.0
    S_v: Annotated[float, SI("-", "vertical shift, friction coefficient", -1.0, 1.0)] = 0.0
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    def __call__(self, slip: Scalar) -> Scalar:
        """Friction coefficient at a slip ratio [-] or slip angle [rad]."""
        x = slip + self.S_h
        phi = (1 - self.E) * x + (self.E / self.B) * atan(self.B * x)
        return self.D * sin(self.C * atan(self.B * phi)) + self.S_v

    def tire(self, lateral: MagicCurve, combined: Literal["none", "ellipse"]) -> SimpleMagicFormula:
        """Tire of this curve along and another, ``lateral``, across; ``combined`` as of `SimpleMagicFormula`."""
        return SimpleMagicFormula(longitudinal=self, lateral=lateral, combined=combined)

    @property
    def slope(self) -> float:
        """Slope at the origin of the unshifted curve, B C D. [per rad or per unit of slip]"""
        return self.B * self.C * self.D


@dataclass(frozen=True, kw_only=True)
class SimpleMagicFormula(Checked, Tire):
    """Magic Formula with constant coefficients; forces are proportional to load.

    Parameters
    ----------
    longitudinal, lateral : MagicCurve
        Friction coefficient over slip ratio and over slip angle.
    combined : {"none", "ellipse"}
        ``"none"``: the directions do not see each other, as in [1]_. ``"ellipse"``: pure-slip forces are
        evaluated at the common normalised slip and shared along its direction, so their resultant stays on
        the friction ellipse ([2]_, similarity method).
    """

    longitudinal: MagicCurve
    lateral: MagicCurve
    combined: Literal["none", "ellipse"] = "none"

    @property
    def peak_friction(self) -> tuple[Scalar, Scalar]:
        """See `Tire.peak_friction`."""
        return self.longitudinal.D, self.lateral.D

    def forces(
        self, slip_ratio: Scalar, slip_angle: Scalar, load: Scalar, *, camber: Scalar = 0.0, friction: Scalar = 1.0
    ) -> TireForces:
        """Friction coefficients times load; camber has no influence."""
        if self.combined == "none":
            mu_x, mu_y = self.longitudinal(slip_ratio), self.lateral(slip_angle)
            return TireForces(friction * load * mu_x, friction * load * mu_y)
        k_x, k_y = self.longitudinal, self.lateral
        a = slip_ratio * (k_x.slope / k_x.D)
        b = slip_angle * (k_y.slope / k_y.D)
        rho = sqrt(a * a + b * b + 1e-16)
        mu_x = k_x(rho * (k_x.D / k_x.slope)) * a / rho
        mu_y = k_y(rho * (k_y.D / k_y.slope)) * b / rho
        return TireForces(friction * load * mu_x, friction * load * mu_y)
