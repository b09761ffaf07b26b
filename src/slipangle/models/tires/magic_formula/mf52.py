"""Magic Formula 5.0 to 5.2 and PAC2002: forces and moments from slip, in the axes of the coefficients.

[1]_ gives the equations; the extension to inflation pressure is the one of PAC2002, with the coefficients of 6.1.

References
----------
.. [1] H. B. Pacejka, Tyre and Vehicle Dynamics, 2nd ed., 2006, sec. 4.3.2 and appendix.
"""

from __future__ import annotations

import numpy as np

from slipangle.models.tires.magic_formula.coefficients import MF52Coefficients
from slipangle.models.tires.magic_formula.longitudinal import pure_longitudinal
from slipangle.models.tires.magic_formula.terms import (
    Conventions,
    Lateral,
    MagicForces,
    Slip,
    cos_atan,
    curved,
    ellipse,
    equivalent,
    faded,
    induced_lateral,
    is_zero,
    limited,
    overturning,
    ratio,
    together,
    weight_lateral,
    weight_longitudinal,
)
from slipangle.models.tires.magic_formula.turn_slip import Spin, lateral_shift, spin, turning_moment
from slipangle.ops import Scalar, atan, cos, exp, fabs, sign, sin


def forces(c: MF52Coefficients, o: Conventions, s: Slip, *, combined: str = "weighting") -> MagicForces:
    """Forces and moments of version 5.2; parameters as in `slipangle.models.tires.magic_formula.mf61.forces`."""
    z = None if s.turn is None else spin(c, s, s.turn, rolling_radius(c, s.load, s.dpi, s.speed))
    x = pure_longitudinal(c, o, s, z, gamma=s.gamma_star * c.LGAX, mu_shift=s.mu_x)
    y = pure_lateral(c, o, s, z)
    G_x, G_y, S_vyk = 1.0, 1.0, 0.0
    if combined == "weighting":
        G_x = weight_longitudinal(c, o, s, c.RBX1)
        G_y = weight_lateral(c, o, s, c.RBY1)
        S_vyk = induced_lateral(c, s, s.gamma_star, y.mu * s.load if z is None else y.mu * s.load * z.zeta_2)
    elif combined == "ellipse":
        G_x, G_y = ellipse(s, x, y)
    slip_force = G_y * y.F
    F_y = slip_force + S_vyk
    moments = _moments(c, o, s, z, lateral=y, K_x=x.K, F_y=F_y, G_y=G_y)
    M_x = overturning(c, o, s, F_y)
    return together(c, o, s, x, y, moments, G_x=G_x, G_y=G_y, F_y=F_y, trailing=slip_force, M_x=M_x)


def cornering_stiffness(c: MF52Coefficients, load: Scalar, dpi: Scalar, gamma: Scalar) -> Scalar:
    """Cornering stiffness K_y without turn slip, at gamma* times LGAY; negative in ISO-W axes. [N/rad]"""
    fz0 = c.LFZO * c.FNOMIN
    top = c.PKY2 * (1.0 + c.PPY2 * dpi) * fz0
    size = c.PKY1 * fz0 * (1.0 + c.PPY1 * dpi) * c.LKY
    return size * (1.0 - c.PKY3 * fabs(gamma)) * sin(2.0 * atan(load / top))


def pure_lateral(c: MF52Coefficients, o: Conventions, s: Slip, z: Spin | None) -> Lateral:
    """F_y0 and its factors."""
    C = c.PCY1 * c.LCY
    gamma = s.gamma_star * c.LGAY
    pressure = 1.0 + (c.PPY3 + c.PPY4 * s.dpi) * s.dpi
    mu = (c.PDY1 + c.PDY2 * s.dfz) * (pressure * (1.0 - c.PDY3 * gamma * gamma) * s.mu_y)
    D = mu * s.load if z is None else mu * s.load * z.zeta_2
    K = cornering_stiffness(c, s.load, s.dpi, gamma)
    K = K if z is None else K * z.zeta_3
    S_h = (c.PHY1 + c.PHY2 * s.dfz) * c.LHY
    S_v = s.load * (c.PVY1 + c.PVY2 * s.dfz) * (c.LVY * s.mu_y)
    S_vg = s.load * (c.PVY3 + c.PVY4 * s.dfz) * (c.LKYG * s.mu_y) * gamma
    if z is None:
        S_h = S_h + c.PHY3 * c.LKYG * gamma
    else:
        K_y0 = cornering_stiffness(c, s.load, s.dpi, 0.0) * z.zeta_3
        K_g = (c.PHY3 * K_y0 + s.load * (c.PVY3 + c.PVY4 * s.dfz)) * c.LKYG
        S_vg, S_v = S_vg * z.zeta_2, S_v * z.zeta_2
        S_h = S_h + lateral_shift(c, s, z, camber_stiffness=K_g, K_y0=K_y0) - ratio(S_vg, K)
    S_h, S_v = faded(S_h, s), faded(S_v + S_vg, s)
    alpha = s.pure + S_h
    sgn = sign(alpha if o.curvature_sign == "shifted" else s.alpha)
    E = limited((c.PEY1 + c.PEY2 * s.dfz) * c.LEY * (1.0 - (c.PEY3 + c.PEY4 * gamma) * sgn), o)
    B = ratio(K, C * D)
    return Lateral(D * sin(C * curved(B * alpha, E)) + S_v, mu, K, B, C, D, S_h, S_v)


def _moments(
    c: MF52Coefficients,
    o: Conventions,
    s: Slip,
    z: Spin | None,
    *,
    lateral: Lateral,
    K_x: Scalar,
    F_y: Scalar,
    G_y: Scalar,
) -> tuple[Scalar, Scalar, Scalar]:
    """Pneumatic trail, residual moment and moment arm of F_x."""
    gamma, R = s.gamma_star * c.LGAZ, c.UNLOADED_RADIUS
    fz0 = c.LFZO * c.FNOMIN
    grip = c.LKY / s.mu_y
    kappa2 = ratio(K_x, lateral.K) * s.kappa
    kappa2 = kappa2 * kappa2

    alpha_t = s.tangent + (c.QHZ1 + c.QHZ2 * s.dfz) + (c.QHZ3 + c.QHZ4 * s.dfz) * gamma
    B_t = (c.QBZ1 + (c.QBZ2 + c.QBZ3 * s.dfz) * s.dfz) * grip * (1.0 + c.QBZ4 * gamma + c.QBZ5 * fabs(gamma))
    E_t = c.QEZ1 + (c.QEZ2 + c.QEZ3 * s.dfz) * s.dfz
    E_t = limited(E_t * (1.0 + (c.QEZ4 + c.QEZ5 * gamma) * (2.0 / np.pi) * atan(B_t * c.QCZ1 * alpha_t)), o)
    D_t = (c.QDZ1 + c.QDZ2 * s.dfz) * ((1.0 - c.PPZ1 * s.dpi) * c.LTR * R / fz0) * s.load
    D_t = D_t * (1.0 + c.QDZ3 * gamma + c.QDZ4 * gamma * gamma)
    D_t = D_t if z is None else D_t * z.zeta_5
    t = faded(D_t * cos(c.QCZ1 * curved(B_t * equivalent(alpha_t, kappa2, tangents=True), E_t)) * s.cosine, s)

    alpha_r = s.tangent + lateral.S_h + ratio(lateral.S_v, lateral.K)
    B_r = c.QBZ9 * grip + c.QBZ10 * lateral.B * lateral.C
    B_r = B_r if z is None else B_r * z.zeta_6
    x = B_r * equivalent(alpha_r, kappa2, tangents=True)
    offset = (c.QDZ6 + c.QDZ7 * s.dfz) * c.LRES
    camber = c.QDZ8 + c.QDZ9 * s.dfz
    scale = R * s.load * s.mu_y
    if z is None:
        D_r = scale * (offset + camber * ((1.0 + c.PPZ2 * s.dpi) * gamma))
        M_zr = faded(D_r * cos_atan(x) * s.cosine, s)
    else:
        D_phi, zeta_7 = turning_moment(c, s, z, mu_y=lateral.mu, G_y=G_y, camber_moment=s.load * R * camber)
        M_zr = (faded(scale * offset * z.zeta_2, s) + D_phi) * cos(zeta_7 * atan(x)) * s.cosine
    arm = (R * c.LS) * ((c.SSZ1 + c.SSZ2 / fz0 * F_y) + (c.SSZ3 + c.SSZ4 * s.dfz) * s.gamma_star)
    return t, M_zr, arm


def rolling_radius(c: MF52Coefficients, load: Scalar, dpi: Scalar, speed: Scalar) -> Scalar:
    """Effective rolling radius R_e; neither pressure nor speed counts in this version. [m]"""
    if is_zero(c.VERTICAL_STIFFNESS):
        return c.UNLOADED_RADIUS
    relative = load / c.FNOMIN
    deflection = c.FNOMIN / (c.VERTICAL_STIFFNESS * c.LCZ)
    return c.UNLOADED_RADIUS - deflection * (c.DREFF * atan(c.BREFF * relative) + c.FREFF * relative)


def relaxation_lengths(
    c: MF52Coefficients, load: Scalar, dfz: Scalar, dpi: Scalar, gamma: Scalar
) -> tuple[Scalar, Scalar]:
    """Longitudinal and lateral relaxation length. [m]"""
    R, fz0 = c.UNLOADED_RADIUS, c.LFZO * c.FNOMIN
    sigma_x = load * (c.PTX1 + c.PTX2 * dfz) * exp(-c.PTX3 * dfz) * (R / c.FNOMIN * c.LSGKP)
    if is_zero(c.PTY2):
        return sigma_x, 0.0 * load
    camber = 1.0 - c.PKY3 * fabs(gamma * c.LGAY)
    return sigma_x, c.PTY1 * sin(2.0 * atan(load / (c.PTY2 * fz0))) * camber * (R * c.LFZO * c.LSGAL)
