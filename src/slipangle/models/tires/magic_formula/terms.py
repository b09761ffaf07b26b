"""What versions 5.2 and 6.x of the Magic Formula share: conventions, slip, curves, moments, friction ellipse.

Everything here is in the axes of the coefficients (usually ISO-W: a positive slip angle gives a negative side
force) and works on numbers, symbols and tracers. Equation numbers are those of [1]_ unless they say otherwise.

.. [1] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012.
"""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from slipangle.fields import Checked
from slipangle.models.tires.magic_formula.coefficients import MagicCoefficients
from slipangle.ops import Scalar, atan, clip, cos, fabs, is_symbolic, minimum, sin, sqrt, tan, where

_TINY = 1e-6  # N, keeps quotients of forces finite at zero load; changes them by less than 1e-15 elsewhere


@dataclass(frozen=True, kw_only=True)
class Conventions(Checked):
    """Choices on which codes of the Magic Formula differ; the defaults follow the book [1]_.

    Parameters
    ----------
    lateral_slip : {"tangent", "tangent_combined", "angle"}
        Slip in the side force and in all that builds on it, eq. 4.E3. ``"tangent"``: tan(alpha), as the book.
        ``"angle"``: alpha itself, as MF-Tyre 5.2. ``"tangent_combined"``: alpha itself in the pure side force
        (4.E20), tan(alpha) in the weighting functions and the moments.
    camber : {"sine", "angle"}
        gamma* = sin(gamma), as eq. 4.E4, or gamma itself.
    curvature_sign : {"shifted", "slip"}
        E_y (4.E24) switches with the sign of the shifted slip alpha_y, as the book, or of the slip angle.
    aligning : {"book", "paper"}
        Version 6 only. ``"paper"`` replaces 4.E40, 4.E43, 4.E76, 4.E77 and 4.E78 by eqs. A58, A60, A56, A55 and A54
        of [2]_: camber itself in the trail, F_z0 instead of F_z0' in the moment arm, tangents in the equivalent slip.
    overturning : {"book", "manual"}
        Load term of M_x, 4.E69: arctan^2(q_Sx6 F_z / F_z0), as the book, or arctan((q_Sx6 F_z / F_z0)^2) as MF-Tyre.
    rolling_resistance : {"book", "paper"}
        Factor in front of M_y: F_z R_0 (4.E70) or F_z0 R_0 ([2]_ eq. A48). They agree at nominal load; away from
        it only the second is sound with q_Sy7 near 1, which then is the exponent of load itself.
    digression : float
        A_mu of eq. 4.E8: how slowly the vertical shifts follow a friction scaling. 1 scales them like friction.
    limit_curvature : bool
        Keep every curvature factor E at or below 1, as the book demands.

    References
    ----------
    .. [1] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3.2.
    .. [2] I. J. M. Besselink, A. J. C. Schmeitz, H. B. Pacejka, An improved Magic Formula/Swift tyre model that can
       handle inflation pressure changes, Vehicle System Dynamics 48 (2010) S1.
    """

    lateral_slip: Literal["tangent", "tangent_combined", "angle"] = "tangent"
    camber: Literal["sine", "angle"] = "sine"
    curvature_sign: Literal["shifted", "slip"] = "shifted"
    aligning: Literal["book", "paper"] = "book"
    overturning: Literal["book", "manual"] = "book"
    rolling_resistance: Literal["book", "paper"] = "book"
    digression: float = 10.0
    limit_curvature: bool = True


MFEVAL = Conventions(
    lateral_slip="angle",
    camber="angle",
    aligning="paper",
    overturning="manual",
    rolling_resistance="paper",
    digression=1.0,
)
"""Choices of MFeval without its alpha*, useMode 111, which follow MF-Tyre."""
PRESETS = {"book": Conventions(), "mfeval": MFEVAL}


class MagicForces(NamedTuple):
    """Forces and moments with what they are made of.

    F_x, F_y [N], M_x, M_y, M_z [N m]; F_x0, F_y0 pure slip [N]; mu_x, mu_y peak friction [-]; K_x, K_y slip and
    cornering stiffness [N, N/rad]; G_x, G_y weighting factors [-]; trail [m]; M_zr residual moment [N m]; arm of F_x
    about the contact centre [m].
    """

    F_x: Scalar
    F_y: Scalar
    M_x: Scalar
    M_y: Scalar
    M_z: Scalar
    F_x0: Scalar
    F_y0: Scalar
    mu_x: Scalar
    mu_y: Scalar
    K_x: Scalar
    K_y: Scalar
    G_x: Scalar
    G_y: Scalar
    trail: Scalar
    M_zr: Scalar
    arm: Scalar


class Slip(NamedTuple):
    """Slip and operating conditions, prepared for the equations, in the axes of the coefficients."""

    kappa: Scalar
    alpha: Scalar  # as given [rad]
    tangent: Scalar  # tan(alpha) sgn(V_cx), or alpha by convention (4.E3)
    pure: Scalar  # the same, for the pure side force
    cosine: Scalar  # |cos(alpha')| (4.E6); its sign cancels against sgn(V_cx) in D_t and D_r
    direction: Scalar  # sgn(V_cx)
    gamma: Scalar
    gamma_star: Scalar  # 4.E4
    load: Scalar
    dfz: Scalar  # 4.E2a
    dpi: Scalar  # 4.E2b
    pressure_ratio: Scalar
    speed: Scalar  # V_cx [m/s]
    fade: Scalar | None  # 0 at standstill to 1 from VXLOW on, smoothly; None: 1
    mu_x: Scalar  # lambda_mux* (4.E7)
    mu_y: Scalar
    mu_x_shift: Scalar  # lambda_mux' (4.E8)
    mu_y_shift: Scalar
    turn: Scalar | None  # turn slip phi_t [1/m]; None: not considered


class PureForce(NamedTuple):
    """Force of one direction without slip in the other, and its factors."""

    F: Scalar
    mu: Scalar
    K: Scalar
    B: Scalar
    C: Scalar
    D: Scalar
    S_h: Scalar
    S_v: Scalar


def is_zero(value: Any) -> bool:
    """Whether a value is the plain number 0, so that its branch of the equations can be left out."""
    return not is_symbolic(value) and np.ndim(value) == 0 and isinstance(value, (int, float, np.number)) and value == 0


def ratio(a: Scalar, b: Scalar) -> Scalar:
    """Quotient a / b of forces, finite at b = 0 and smooth, whatever the sign of b."""
    return a * b / (b * b + _TINY * _TINY)


def curved(x: Scalar, E: Scalar) -> Scalar:
    """arctan{x - E (x - arctan x)}, the inside of the Magic Formula."""
    return atan(x - E * (x - atan(x)))


def cos_atan(x: Scalar) -> Scalar:
    """cos(arctan x)."""
    return 1.0 / sqrt(1.0 + x * x)


def limited(E: Scalar, o: Conventions) -> Scalar:
    """Curvature factor, at most 1."""
    return minimum(E, 1.0) if o.limit_curvature else E


def prepare(
    c: MagicCoefficients,
    o: Conventions,
    *,
    kappa: Scalar,
    alpha: Scalar,
    load: Scalar,
    camber: Scalar,
    pressure: Scalar,
    speed: Scalar | None,
    turn_slip: Scalar | None,
    friction: Scalar,
) -> Slip:
    """Slip quantities of eqs. 4.E1 to 4.E8.

    ``speed=None`` means the reference speed of the tire; slip angles beyond 90 degrees or a negative speed mean
    that the wheel moves backwards. A negative load counts as none.
    """
    backward = fabs(alpha) > 0.5 * np.pi
    forward = 1.0 if speed is None else where(speed < 0.0, -1.0, 1.0)
    direction = where(backward, -1.0, forward)
    tangent = tan(alpha) * direction
    cosine = cos_atan(tangent)
    load = 0.5 * (load + fabs(load))
    v_x = c.LONGVL if speed is None else speed
    mu_x, mu_y = c.LMUX * friction, c.LMUY * friction
    if not is_zero(c.LMUV):
        decay = 1.0 + c.LMUV * fabs(v_x) / c.LONGVL * sqrt(kappa * kappa + tangent * tangent)
        mu_x, mu_y = mu_x / decay, mu_y / decay
    fade = None
    if not (speed is None or is_zero(c.VXLOW)):
        fade = 0.5 - 0.5 * cos(np.pi * minimum(fabs(speed) / c.VXLOW, 1.0))
    a = o.digression
    fz0 = c.LFZO * c.FNOMIN
    no_pressure = is_zero(c.NOMPRES)
    return Slip(
        kappa=kappa,
        alpha=alpha,
        tangent=alpha if o.lateral_slip == "angle" else tangent,
        pure=tangent if o.lateral_slip == "tangent" else alpha,
        cosine=cosine,
        direction=direction,
        gamma=camber,
        gamma_star=sin(camber) if o.camber == "sine" else camber,
        load=load,
        dfz=(load - fz0) / fz0,
        dpi=0.0 if no_pressure else (pressure - c.NOMPRES) / c.NOMPRES,
        pressure_ratio=1.0 if no_pressure else pressure / c.NOMPRES,
        speed=v_x,
        fade=fade,
        mu_x=mu_x,
        mu_y=mu_y,
        mu_x_shift=a * mu_x / (1.0 + (a - 1.0) * mu_x),
        mu_y_shift=a * mu_y / (1.0 + (a - 1.0) * mu_y),
        turn=turn_slip,
    )


def faded(value: Scalar, s: Slip) -> Scalar:
    """Offsets and moments vanish towards standstill; slip forces do not (their slip does)."""
    return value if s.fade is None else value * s.fade


def weight_longitudinal(c: MagicCoefficients, o: Conventions, s: Slip, slope: Scalar) -> Scalar:
    """G_xalpha, eqs. 4.E51 to 4.E57; ``slope`` is r_Bx1 with its camber term."""
    B = slope * c.LXAL * cos_atan(c.RBX2 * s.kappa)
    E = limited(c.REX1 + c.REX2 * s.dfz, o)
    return cos(c.RCX1 * curved(B * (s.tangent + c.RHX1), E)) / cos(c.RCX1 * curved(B * c.RHX1, E))


def weight_lateral(c: MagicCoefficients, o: Conventions, s: Slip, slope: Scalar) -> Scalar:
    """G_ykappa, eqs. 4.E59 to 4.E65; ``slope`` is r_By1 with its camber term."""
    B = slope * c.LYKA * cos_atan(c.RBY2 * (s.tangent - c.RBY3))
    E = limited(c.REY1 + c.REY2 * s.dfz, o)
    S_h = c.RHY1 + c.RHY2 * s.dfz
    return cos(c.RCY1 * curved(B * (s.kappa + S_h), E)) / cos(c.RCY1 * curved(B * S_h, E))


def induced_lateral(c: MagicCoefficients, s: Slip, gamma: Scalar, peak: Scalar) -> Scalar:
    """S_Vykappa, side force that slip ratio induces, eqs. 4.E66 and 4.E67; ``peak`` is mu_y F_z zeta_2."""
    D = peak * (c.RVY1 + c.RVY2 * s.dfz + c.RVY3 * gamma) * cos_atan(c.RVY4 * s.tangent)
    return faded(D * sin(c.RVY5 * atan(c.RVY6 * s.kappa)) * c.LVYKA, s)


def ellipse(s: Slip, x: PureForce, y: PureForce) -> tuple[Scalar, Scalar]:
    """G_x and G_y: shares of the pure forces that are left on the friction ellipse, without combined-slip data.

    With t = |sin(alpha_c) / kappa_c|, slips counted from where the force vanishes, and mu the friction used:
    G_x = 1 / sqrt(1 + (t mu_x / mu_y,max)^2) and G_y = 1 / sqrt(1 + (mu_y / (t mu_x,max))^2).
    """
    kappa = s.kappa + x.S_h + ratio(x.S_v, x.K)
    alpha = s.cosine * (s.tangent + y.S_h + ratio(y.S_v, y.K))
    F_x, F_y = x.F - x.S_v, y.F - y.S_v
    # near zero slip the force over slip tends to the stiffness
    over_kappa = (F_x * F_x + (1e-9 * x.K) ** 2) / (kappa * kappa + 1e-18)
    over_alpha = (F_y * F_y + (1e-9 * y.K) ** 2) / (alpha * alpha + 1e-18)
    d_x, d_y = x.D * x.D + _TINY * _TINY, y.D * y.D + _TINY * _TINY
    return 1.0 / sqrt(1.0 + alpha * alpha * over_kappa / d_y), 1.0 / sqrt(1.0 + kappa * kappa * over_alpha / d_x)


def equivalent(angle: Scalar, kappa_squared: Scalar, *, tangents: bool) -> Scalar:
    """Slip angle that stands for combined slip in the moments, eqs. 4.E77, 4.E78, or A54, A55 with tangents."""
    if tangents:
        inside = tan(clip(angle, -1.57, 1.57))  # a slip angle near or beyond 90 degrees stays there
        size = atan(sqrt(inside * inside + kappa_squared))
    else:
        size = sqrt(angle * angle + kappa_squared)
    return where(angle < 0.0, -size, size)


def overturning(c: MagicCoefficients, o: Conventions, s: Slip, F_y: Scalar) -> Scalar:
    """M_x, eq. 4.E69, with the terms that 6.2 adds, which are zero in files of the others."""
    gamma = s.gamma
    inner = (c.QSX1 * c.LVMX) + c.QSX3 / c.FNOMIN * F_y - (c.QSX2 * (1.0 + c.PPMX1 * s.dpi)) * gamma
    if not is_zero(c.QSX4):
        f = c.QSX6 / c.FNOMIN * s.load
        load_term = atan(f * f) if o.overturning == "manual" else atan(f) * atan(f)
        angle = c.QSX7 * gamma + c.QSX8 * atan(c.QSX9 / c.FNOMIN * F_y)
        inner = inner + c.QSX4 * cos(c.QSX5 * load_term) * sin(angle)
    if not is_zero(c.QSX10):
        inner = inner + c.QSX10 * atan(c.QSX11 / c.FNOMIN * s.load) * gamma
    M_x = (c.UNLOADED_RADIUS * c.LMX) * s.load * inner
    if is_zero(c.QSX12) and is_zero(c.QSX13) and is_zero(c.QSX14):
        return M_x
    size = fabs(gamma)
    return M_x + (c.UNLOADED_RADIUS * c.LMX) * (F_y * (c.QSX13 + c.QSX14 * size) - c.QSX12 * s.load * gamma * size)


def rolling_resistance(c: MagicCoefficients, o: Conventions, s: Slip, F_x: Scalar) -> Scalar:
    """M_y about the axis to the left, against forward rolling: minus eq. 4.E70, or A48 of the paper."""
    relative, v = s.load / c.FNOMIN, fabs(s.speed) / c.LONGVL
    inner = c.QSY1 + c.QSY2 / c.FNOMIN * F_x + c.QSY3 * v + c.QSY4 * v**4
    if not (is_zero(c.QSY5) and is_zero(c.QSY6)):
        inner = inner + (c.QSY5 + c.QSY6 * relative) * s.gamma * s.gamma
    size = inner * (c.UNLOADED_RADIUS * c.LMY)
    if o.rolling_resistance == "book":
        size = size * s.load
        size = size if is_zero(c.QSY7) else size * relative**c.QSY7
    else:
        size = size * (c.FNOMIN * relative**c.QSY7)
    if not is_zero(c.QSY8):
        size = size * s.pressure_ratio**c.QSY8
    return faded(-size * s.direction, s)
