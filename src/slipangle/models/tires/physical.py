"""Tires from a picture of the contact patch: brush model and Dugoff's model, for comparison with fitted ones.

Both count slip against the speed of the tread, as the tread elements see it: ``sigma_x = kappa / (1 + kappa)`` and
``sigma_y = tan(alpha) / (1 + kappa)`` with ``kappa = (omega r - v_x) / |v_x|``.
"""

from dataclasses import dataclass, field
from typing import Annotated

from slipangle.models.model import FitInfo
from slipangle.models.parameters import ParameterSet
from slipangle.models.tires.simple import Tire, TireForces
from slipangle.ops import Scalar, maximum, minimum, sqrt, tan
from slipangle.units import SI

_LOCKED = 0.999  # slip ratio from which a wheel counts as locked
_TINY = 1e-6  # N, keeps directions defined at zero slip


def tread_slip(slip_ratio: Scalar, slip_angle: Scalar) -> tuple[Scalar, Scalar]:
    """Slip velocities over the speed of the tread, sigma_x and sigma_y, from slips as of `Tire.forces`."""
    rolling = 1.0 + maximum(minimum(slip_ratio, 0.0), -_LOCKED)
    return slip_ratio / rolling, tan(slip_angle) * (1.0 - maximum(slip_ratio, 0.0)) / rolling


@dataclass(frozen=True, kw_only=True)
class _ContactPatch(ParameterSet, Tire):
    """What both pictures have: stiffness in either direction, and friction."""

    C_alpha: Annotated[float, SI("N/rad", "cornering stiffness", 1.0, 5e6)]
    C_s: Annotated[float, SI("N", "longitudinal slip stiffness", 1.0, 5e6)]
    mu: Annotated[float, SI("-", "friction coefficient", 0.01, 5.0)] = 1.0
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    def _deflection(self, slip_ratio: Scalar, slip_angle: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Forces of a patch that sticks, along and across, and their size. [N]"""
        sigma_x, sigma_y = tread_slip(slip_ratio, slip_angle)
        x, y = self.C_s * sigma_x, self.C_alpha * sigma_y
        return x, y, sqrt(x * x + y * y + _TINY * _TINY)


@dataclass(frozen=True, kw_only=True)
class BrushTire(_ContactPatch):
    """Brush model with parabolic pressure: tread elements stick, then slide.

    With ``rho = |(C_s sigma_x, C_alpha sigma_y)| / (3 mu F_z)`` the force is ``mu F_z (3 rho - 3 rho^2 + rho^3)`` in
    the direction of that vector, and ``mu F_z`` once the whole patch slides (rho = 1). The lateral part acts behind
    the middle of the patch by ``a (1 - rho)^3 / (3 - 3 rho + rho^2)``.

    Source: H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 3.2, eqs. 3.19 to 3.42.
    """

    half_length: Annotated[float, SI("m", "half length a of the contact patch", 0.0, 1.0)] = 0.0

    def forces(
        self, slip_ratio: Scalar, slip_angle: Scalar, load: Scalar, *, camber: Scalar = 0.0, friction: Scalar = 1.0
    ) -> TireForces:
        """Forces and aligning moment; camber has no influence."""
        x, y, size = self._deflection(slip_ratio, slip_angle)
        grip = self.mu * friction * load
        rho = minimum(size / (3.0 * grip + _TINY), 1.0)
        share = grip * rho * (3.0 - (3.0 - rho) * rho) / size
        stick = 1.0 - rho
        trail = self.half_length * stick * stick * stick / (3.0 - (3.0 - rho) * rho)
        F_y = share * y
        return TireForces(share * x, F_y, M_z=-trail * F_y)


@dataclass(frozen=True, kw_only=True)
class DugoffTire(_ContactPatch):
    """Dugoff's model: uniform pressure, so that sliding starts as soon as half the grip is used.

    With ``lambda = mu F_z / (2 |(C_s sigma_x, C_alpha sigma_y)|)`` the force is that of a linear tire, times
    ``lambda (2 - lambda)`` where lambda is below 1. It approaches ``mu F_z`` and never decreases with slip.

    Source: H. Dugoff, P. S. Fancher, L. Segel, An analysis of tire traction properties and their influence on vehicle
    dynamic performance, SAE 700377, 1970; driving counted like braking, on the speed of the tread.
    """

    def forces(
        self, slip_ratio: Scalar, slip_angle: Scalar, load: Scalar, *, camber: Scalar = 0.0, friction: Scalar = 1.0
    ) -> TireForces:
        """Forces; camber has no influence, moments are not part of the model."""
        x, y, size = self._deflection(slip_ratio, slip_angle)
        lam = minimum(0.5 * self.mu * friction * load / size, 1.0)
        share = lam * (2.0 - lam)
        return TireForces(share * x, share * y)
