"""Turn slip of the Magic Formula: the factors zeta_0 to zeta_8 that path curvature and spin bring in. [1]_

Spin ``phi`` and turn slip ``phi_t`` are positive to the left (curvature of the wheel's path) in ISO axes.

.. [1] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3.3, eqs. 4.75 to 4.106.
"""

from typing import NamedTuple

import numpy as np

from slipangle.models.tires.magic_formula.coefficients import MagicCoefficients
from slipangle.models.tires.magic_formula.terms import Slip, cos_atan, curved, ratio
from slipangle.ops import Scalar, atan, clip, fabs, sin, sqrt


class Spin(NamedTuple):
    """Spin times unloaded radius, and the factors that depend on spin alone."""

    R_phi: Scalar  # R_0 phi [-]
    R_turn: Scalar  # R_0 phi_t [-]
    reduction: Scalar  # epsilon_gamma (4.90)
    zeta_1: Scalar  # 4.105, peak of F_x
    zeta_2: Scalar  # 4.77, peak of F_y
    zeta_3: Scalar  # 4.79, cornering stiffness
    zeta_5: Scalar  # 4.91, trail
    zeta_6: Scalar  # 4.102, slope of the residual moment


def spin(c: MagicCoefficients, s: Slip, turn: Scalar, rolling_radius: Scalar) -> Spin:
    """Spin and its factors, eqs. 4.75 to 4.79, 4.90, 4.91, 4.102, 4.105, 4.106.

    Spin is ``phi = phi_t + (1 - epsilon_gamma) sin(gamma) Omega / V_c``: turning to the left and a top leaning to
    the right twist the contact patch alike.
    """
    R = c.UNLOADED_RADIUS
    reduction = c.PECP1 * (1.0 + c.PECP2 * s.dfz)
    R_turn = R * turn
    R_phi = R_turn + (1.0 - reduction) * sin(s.gamma) * (1.0 + s.kappa) * s.cosine * R / rolling_radius
    size = fabs(R_phi)
    B_x = c.PDXP1 * (1.0 + c.PDXP2 * s.dfz) * cos_atan(c.PDXP3 * s.kappa)
    B_y = c.PDYP1 * (1.0 + c.PDYP2 * s.dfz) * cos_atan(c.PDYP3 * s.tangent)
    return Spin(
        R_phi=R_phi,
        R_turn=R_turn,
        reduction=reduction,
        zeta_1=cos_atan(B_x * R_phi),
        zeta_2=cos_atan(B_y * (size + c.PDYP4 * sqrt(size + 1e-12))),
        zeta_3=cos_atan(c.PKYP1 * R_phi * R_phi),
        zeta_5=cos_atan(c.QDTP1 * R_phi),
        zeta_6=cos_atan(c.QBRP1 * R_phi),
    )


def lateral_shift(c: MagicCoefficients, s: Slip, z: Spin, *, camber_stiffness: Scalar, K_y0: Scalar) -> Scalar:
    """S_Hyphi, shift of the side force curve by spin, eqs. 4.80, 4.85 to 4.89.

    ``camber_stiffness`` is K_ygamma0, ``K_y0`` the cornering stiffness without camber.
    """
    D = c.PHYP2 + c.PHYP3 * s.dfz
    x = ratio(camber_stiffness / (1.0 - z.reduction), K_y0) / (c.PHYP1 * D) * z.R_phi
    return D * sin(c.PHYP1 * curved(x, c.PHYP4))


def turning_moment(
    c: MagicCoefficients, s: Slip, z: Spin, *, mu_y: Scalar, G_y: Scalar, camber_moment: Scalar
) -> tuple[Scalar, Scalar]:
    """D_rphi and zeta_7: moment that spin raises, and its fading with side slip, eqs. 4.92 to 4.99, 4.103, 4.104.

    ``camber_moment`` is K_zgammar0, moment over camber.
    """
    M_inf = c.QCRP1 * fabs(mu_y) * c.UNLOADED_RADIUS * s.load * sqrt(s.load / (c.LFZO * c.FNOMIN)) * c.LMP
    D = M_inf / sin(0.5 * np.pi * c.QDRP1)
    x = ratio(camber_moment / (c.QDRP1 * (1.0 - z.reduction)), D) * z.R_phi
    D_r = D * sin(c.QDRP1 * atan(x))
    M_90 = M_inf * (2.0 / np.pi) * atan(c.QCRP2 * fabs(z.R_turn)) * G_y
    share = clip(M_90 / (fabs(D_r) + 1e-6), 0.0, 1.0 - 1e-9)
    # arccos from the arctangent that every kind of argument has
    zeta_7 = (2.0 / np.pi) * atan(sqrt(1.0 - share * share) / (share + 1e-15))
    return D_r, zeta_7
