"""Pure longitudinal force, one for versions 5.2 and 6.x of the Magic Formula.

References
----------
.. [1] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3.2, eqs. 4.E9 to 4.E18.
"""

from __future__ import annotations

from slipangle.models.tires.magic_formula.coefficients import MagicCoefficients
from slipangle.models.tires.magic_formula.terms import (
    Conventions,
    LongitudinalForce,
    Slip,
    curved,
    faded,
    is_zero,
    limited,
    ratio,
)
from slipangle.models.tires.magic_formula.turn_slip import Spin
from slipangle.ops import Scalar, exp, sign, sin


def pure_longitudinal(
    c: MagicCoefficients, o: Conventions, s: Slip, z: Spin | None, *, gamma: Scalar, mu_shift: Scalar
) -> LongitudinalForce:
    """F_x0 and its factors. [1]_ eqs. 4.E9 to 4.E18

    ``gamma`` [rad] is camber as the version counts it: the angle in 6.1, gamma* times LGAX in 5.2; ``mu_shift`` the
    friction scaling of the vertical shift: lambda_mux' in 6.1, lambda_mux* in 5.2; ``z`` spin, where turn slip counts.
    """
    C = c.PCX1 * c.LCX  # 4.E11
    pressure = 1.0 + (c.PPX3 + c.PPX4 * s.dpi) * s.dpi
    mu = (c.PDX1 + c.PDX2 * s.dfz) * (pressure * (1.0 - c.PDX3 * gamma * gamma) * s.mu_x)  # 4.E13
    D = mu * s.load if z is None else mu * s.load * z.zeta_1  # 4.E12
    K = longitudinal_stiffness(c, s.load, s.dfz, s.dpi)
    S_h = faded((c.PHX1 + c.PHX2 * s.dfz) * c.LHX, s)  # 4.E17
    S_v = faded(s.load * (c.PVX1 + c.PVX2 * s.dfz) * (c.LVX * mu_shift), s)  # 4.E18
    S_v = S_v if z is None else S_v * z.zeta_1
    kappa = s.kappa + S_h  # 4.E10
    E = (c.PEX1 + (c.PEX2 + c.PEX3 * s.dfz) * s.dfz) * c.LEX
    E = limited(E if is_zero(c.PEX4) else E * (1.0 - c.PEX4 * sign(kappa)), o)  # 4.E14
    B = ratio(K, C * D)  # 4.E16
    return LongitudinalForce(D * sin(C * curved(B * kappa, E)) + S_v, mu, K, D, S_h, S_v)  # 4.E9


def longitudinal_stiffness(c: MagicCoefficients, load: Scalar, dfz: Scalar, dpi: Scalar) -> Scalar:
    """K_xkappa, eq. 4.E15. [N]"""
    pressure = (1.0 + (c.PPX1 + c.PPX2 * dpi) * dpi) * c.LKX
    return load * (c.PKX1 + c.PKX2 * dfz) * exp(c.PKX3 * dfz) * pressure
