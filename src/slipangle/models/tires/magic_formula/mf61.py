"""Magic Formula 6.1 and 6.2: forces and moments from slip, in the axes of the coefficients; 5.2 differs as `mf52` says.

Equation numbers are those of [1]_; where [2]_ or the MF-Tyre manual differ, `Conventions` chooses.

.. [1] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3.2, eqs. 4.E1 to 4.E78.
.. [2] I. J. M. Besselink, A. J. C. Schmeitz, H. B. Pacejka, An improved Magic Formula/Swift tyre model that can
   handle inflation pressure changes, Vehicle System Dynamics 48 (2010) S1.
"""

from typing import Any, NamedTuple

import numpy as np

from slipangle.errors import ParameterError
from slipangle.models.tires.magic_formula.terms import (
    Conventions,
    MagicForces,
    PureForce,
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
    rolling_resistance,
    weight_lateral,
    weight_longitudinal,
)
from slipangle.models.tires.magic_formula.turn_slip import Spin, lateral_shift, spin, turning_moment
from slipangle.ops import Scalar, atan, cos, exp, fabs, sign, sin


class SideLean(NamedTuple):
    """Camber in the side force [rad], its scaling, and the friction that scales the vertical shift [-]."""

    gamma: Scalar
    scale: Scalar
    mu_shift: Scalar


class AligningLean(NamedTuple):
    """Camber in the aligning moment: of shifts and residual moment, of the trail, of its peak, of the arm of F_x [rad].

    The arm of the side force counts per ``arm_load`` [N]; ``tangents`` is the convention of equivalent slip, and
    ``turned`` multiplies the moment that spin raises.
    """

    gamma: Scalar
    trail: Scalar
    peak: Scalar
    arm: Scalar
    arm_load: Scalar
    tangents: bool
    turned: Scalar


class RelaxationLengths(NamedTuple):
    """Distance that the slip forces lag behind slip [m]: longitudinal and lateral."""

    longitudinal: Scalar
    lateral: Scalar


class MF61:
    """Version 6, and what 5.2 shares with it; ``c`` are the coefficients, ``o`` the conventions, ``s`` the slip."""

    def longitudinal_lean(self, c: Any, s: Slip) -> tuple[Scalar, Scalar]:
        """Camber in the longitudinal force [rad], and the friction that scales its vertical shift [-]."""
        return s.gamma, s.mu_x_shift

    def side_lean(self, c: Any, s: Slip) -> SideLean:
        """Camber in the side force."""
        return SideLean(s.gamma_star, c.LKYC, s.mu_y_shift)

    def aligning_lean(self, c: Any, o: Conventions, s: Slip) -> AligningLean:
        """Camber in the aligning moment."""
        paper = o.aligning == "paper"
        lean = s.gamma if paper else s.gamma_star
        return AligningLean(
            gamma=s.gamma_star,
            trail=lean,
            peak=lean if paper else fabs(s.gamma_star),
            arm=lean,
            arm_load=c.FNOMIN if paper else c.LFZO * c.FNOMIN,
            tangents=paper,
            turned=1.0,
        )

    def longitudinal_stiffness(self, c: Any, load: Scalar, dfz: Scalar, dpi: Scalar) -> Scalar:
        """K_xkappa, eq. 4.E15. [N]"""
        pressure = (1.0 + (c.PPX1 + c.PPX2 * dpi) * dpi) * c.LKX
        return load * (c.PKX1 + c.PKX2 * dfz) * exp(c.PKX3 * dfz) * pressure

    def cornering_stiffness(self, c: Any, load: Scalar, dpi: Scalar, gamma: Scalar) -> Scalar:
        """K_yalpha, eq. 4.E25, without turn slip; negative in ISO-W axes. [N/rad]"""
        fz0 = c.LFZO * c.FNOMIN
        top = c.PKY2 * (1.0 + c.PPY2 * dpi) * fz0
        camber = 1.0 * c.LKY
        if not is_zero(gamma):
            top = (c.PKY2 + c.PKY5 * gamma * gamma) * ((1.0 + c.PPY2 * dpi) * fz0)
            camber = (1.0 - c.PKY3 * fabs(gamma)) * c.LKY
        return (c.PKY1 * fz0 * (1.0 + c.PPY1 * dpi)) * camber * sin(c.PKY4 * atan(load / top))

    def camber_stiffness(self, c: Any, s: Slip, K_y0: Scalar) -> Scalar:
        """Side force over camber, eq. 4.E30. [N/rad]"""
        return s.load * (c.PKY6 + c.PKY7 * s.dfz) * ((1.0 + c.PPY5 * s.dpi) * c.LKYC)

    def camber_shift(self, c: Any, s: Slip, gamma: Scalar, K: Scalar, S_vg: Scalar) -> Scalar:
        """What camber adds to the horizontal shift, eq. 4.E27. [rad]"""
        return ratio(self.camber_stiffness(c, s, K) * gamma - S_vg, K)

    def upright(self, c: Any, o: Conventions, s: Slip, z: Spin | None, y: PureForce) -> PureForce:
        """Side force on which the trail acts: that without camber and spin, 4.E32 and 4.E74."""
        if is_zero(s.gamma) and z is None:
            return y
        return self.pure_lateral(c, o, s, None, self.side_lean(c, s)._replace(gamma=0.0))

    def rolling_radius(self, c: Any, load: Scalar, dpi: Scalar, speed: Scalar) -> Scalar:
        """Effective rolling radius R_e, [2]_ eqs. 1 and 7, with the wheel turning at speed / R_0. [m]"""
        v = speed / c.LONGVL
        free = c.UNLOADED_RADIUS * (c.Q_RE0 + c.Q_V1 * v * v)
        if is_zero(c.VERTICAL_STIFFNESS):
            return free
        relative = load / c.FNOMIN
        deflection = c.FNOMIN / (c.VERTICAL_STIFFNESS * (1.0 + c.PFZ1 * dpi))
        return free - deflection * (c.DREFF * atan(c.BREFF * relative) + c.FREFF * relative)

    def relaxation_lengths(
        self, c: Any, load: Scalar, dfz: Scalar, dpi: Scalar, gamma: Scalar
    ) -> tuple[Scalar, Scalar]:
        """Longitudinal and lateral relaxation length: slip stiffness over that of the carcass, [2]_ eqs. 17-19. [m]"""
        for name in ("LONGITUDINAL_STIFFNESS", "LATERAL_STIFFNESS"):
            if is_zero(getattr(c, name)):
                raise ParameterError(
                    f"the tire has no {name}, which relaxation lengths of version 6 need; expected a carcass stiffness "
                    f"in N/m: add it with with_coefficients({name}=...)"
                )
        c_x = c.LONGITUDINAL_STIFFNESS * (1.0 + (c.PCFX1 + c.PCFX2 * dfz) * dfz) * (1.0 + c.PCFX3 * dpi)
        c_y = c.LATERAL_STIFFNESS * (1.0 + (c.PCFY1 + c.PCFY2 * dfz) * dfz) * (1.0 + c.PCFY3 * dpi)
        K_x, K_y = self.longitudinal_stiffness(c, load, dfz, dpi), self.cornering_stiffness(c, load, dpi, gamma)
        return fabs(K_x) / c_x, fabs(K_y) / c_y

    def forces(self, c: Any, o: Conventions, s: Slip, *, combined: str = "weighting") -> MagicForces:
        """Forces and moments; ``combined`` is "weighting", "ellipse" or "none"."""
        z = None if s.turn is None else spin(c, s, s.turn, self.rolling_radius(c, s.load, s.dpi, s.speed))
        x, y = self.pure_longitudinal(c, o, s, z), self.pure_lateral(c, o, s, z, self.side_lean(c, s))
        upright = self.upright(c, o, s, z, y)

        G_x, G_y, G_y_upright, S_vyk = 1.0, 1.0, 1.0, 0.0
        if combined == "weighting":
            g2 = s.gamma_star * s.gamma_star
            G_x = weight_longitudinal(c, o, s, c.RBX1 + c.RBX3 * g2)
            if not is_zero(s.kappa):  # at no slip ratio G_y is 1 and induces nothing
                G_y = weight_lateral(c, o, s, c.RBY1 + c.RBY4 * g2)
                plain = is_zero(s.gamma) or is_zero(c.RBY4)
                G_y_upright = G_y if plain else weight_lateral(c, o, s, c.RBY1)
                S_vyk = induced_lateral(c, s, s.gamma_star, y.mu * s.load if z is None else y.mu * s.load * z.zeta_2)
        elif combined == "ellipse":
            G_x, G_y = ellipse(s, x, y)
            G_y_upright = G_y
        F_x, F_y = G_x * x.F, G_y * y.F + S_vyk  # 4.E50, 4.E58
        t, M_zr, arm = self._moments(c, o, s, z, x, y, F_y, G_y)
        trailing = G_y_upright * upright.F  # side force that acts behind the centre
        M_z = arm * F_x + M_zr - t * trailing  # 4.E71 to 4.E74
        M_x, M_y = overturning(c, o, s, F_y), rolling_resistance(c, o, s, F_x)
        return MagicForces(F_x, F_y, M_x, M_y, M_z, x.F, y.F, x.mu, y.mu, x.K, y.K, G_x, G_y, t, M_zr, arm)

    def pure_longitudinal(self, c: Any, o: Conventions, s: Slip, z: Spin | None) -> PureForce:
        """F_x0 and its factors, eqs. 4.E9 to 4.E18."""
        gamma, mu_shift = self.longitudinal_lean(c, s)
        C = c.PCX1 * c.LCX  # 4.E11
        pressure = 1.0 + (c.PPX3 + c.PPX4 * s.dpi) * s.dpi
        mu = (c.PDX1 + c.PDX2 * s.dfz) * (pressure * (1.0 - c.PDX3 * gamma * gamma) * s.mu_x)  # 4.E13
        D = mu * s.load if z is None else mu * s.load * z.zeta_1  # 4.E12
        K = self.longitudinal_stiffness(c, s.load, s.dfz, s.dpi)
        S_h = faded((c.PHX1 + c.PHX2 * s.dfz) * c.LHX, s)  # 4.E17
        S_v = faded(s.load * (c.PVX1 + c.PVX2 * s.dfz) * (c.LVX * mu_shift), s)  # 4.E18
        S_v = S_v if z is None else S_v * z.zeta_1
        kappa = s.kappa + S_h  # 4.E10
        E = (c.PEX1 + (c.PEX2 + c.PEX3 * s.dfz) * s.dfz) * c.LEX
        E = limited(E if is_zero(c.PEX4) else E * (1.0 - c.PEX4 * sign(kappa)), o)  # 4.E14
        B = ratio(K, C * D)  # 4.E16
        return PureForce(D * sin(C * curved(B * kappa, E)) + S_v, mu, K, B, C, D, S_h, S_v)  # 4.E9

    def pure_lateral(self, c: Any, o: Conventions, s: Slip, z: Spin | None, lean: SideLean) -> PureForce:
        """F_y0 and its factors, eqs. 4.E19 to 4.E30."""
        gamma = lean.gamma
        C = c.PCY1 * c.LCY  # 4.E21
        pressure = 1.0 + (c.PPY3 + c.PPY4 * s.dpi) * s.dpi
        mu = (c.PDY1 + c.PDY2 * s.dfz) * (pressure * (1.0 - c.PDY3 * gamma * gamma) * s.mu_y)  # 4.E23
        D = mu * s.load if z is None else mu * s.load * z.zeta_2  # 4.E22
        K = self.cornering_stiffness(c, s.load, s.dpi, gamma)
        K = K if z is None else K * z.zeta_3
        S_h = (c.PHY1 + c.PHY2 * s.dfz) * c.LHY  # 4.E27
        S_v = s.load * (c.PVY1 + c.PVY2 * s.dfz) * (c.LVY * lean.mu_shift)  # 4.E29
        S_v = S_v if z is None else S_v * z.zeta_2
        if not is_zero(gamma) or z is not None:
            S_vg = s.load * (c.PVY3 + c.PVY4 * s.dfz) * (lean.scale * lean.mu_shift) * gamma  # 4.E28
            if z is None:
                S_h = S_h + self.camber_shift(c, s, gamma, K, S_vg)
            else:  # zeta_0 = 0, zeta_4 - 1 = S_Hyphi - S_Vygamma / K' (4.84)
                S_vg = S_vg * z.zeta_2
                K_y0 = self.cornering_stiffness(c, s.load, s.dpi, 0.0) * z.zeta_3
                K_g = self.camber_stiffness(c, s, K_y0)
                S_h = S_h + lateral_shift(c, s, z, camber_stiffness=K_g, K_y0=K_y0) - ratio(S_vg, K)
            S_v = S_v + S_vg
        S_h, S_v = faded(S_h, s), faded(S_v, s)
        alpha = s.pure + S_h  # 4.E20
        sgn = sign(alpha if o.curvature_sign == "shifted" else s.alpha)
        asymmetry = 1.0 - c.PEY3 * sgn
        if not is_zero(gamma):
            asymmetry = 1.0 + c.PEY5 * gamma * gamma - (c.PEY3 + c.PEY4 * gamma) * sgn
        E = limited((c.PEY1 + c.PEY2 * s.dfz) * c.LEY * asymmetry, o)  # 4.E24
        B = ratio(K, C * D)  # 4.E26
        return PureForce(D * sin(C * curved(B * alpha, E)) + S_v, mu, K, B, C, D, S_h, S_v)  # 4.E19

    def _moments(
        self, c: Any, o: Conventions, s: Slip, z: Spin | None, x: PureForce, y: PureForce, F_y: Scalar, G_y: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Pneumatic trail, residual moment and moment arm of F_x, eqs. 4.E33 to 4.E47 and 4.E73 to 4.E78."""
        k, R = self.aligning_lean(c, o, s), c.UNLOADED_RADIUS
        grip = ratio(c.LKY, s.mu_y)  # finite on ice without any friction
        kappa2 = ratio(x.K, y.K) * s.kappa
        kappa2 = kappa2 * kappa2

        alpha_t = s.tangent + (c.QHZ1 + c.QHZ2 * s.dfz) + (c.QHZ3 + c.QHZ4 * s.dfz) * k.gamma  # 4.E34, 4.E35
        B_t = (c.QBZ1 + (c.QBZ2 + c.QBZ3 * s.dfz) * s.dfz) * grip  # 4.E40, q_Bz4 of A58
        D_t = (c.QDZ1 + c.QDZ2 * s.dfz) * ((1.0 - c.PPZ1 * s.dpi) * c.LTR * R / (c.LFZO * c.FNOMIN)) * s.load  # 4.E42
        if not is_zero(k.trail):
            B_t = B_t * (1.0 + c.QBZ4 * k.trail + c.QBZ5 * fabs(k.trail))
            D_t = D_t * (1.0 + c.QDZ3 * k.peak + c.QDZ4 * k.trail * k.trail)  # 4.E43
        E_t = c.QEZ1 + (c.QEZ2 + c.QEZ3 * s.dfz) * s.dfz
        E_t = E_t * (1.0 + (c.QEZ4 + c.QEZ5 * k.gamma) * (2.0 / np.pi) * atan(B_t * c.QCZ1 * alpha_t))
        E_t = limited(E_t, o)  # 4.E44
        D_t = D_t if z is None else D_t * z.zeta_5
        inside = B_t * equivalent(alpha_t, kappa2, tangents=k.tangents)
        t = faded(D_t * cos(c.QCZ1 * curved(inside, E_t)) * s.cosine, s)  # 4.E73

        alpha_r = s.tangent + y.S_h + ratio(y.S_v, y.K)  # 4.E37, 4.E38
        B_r = c.QBZ9 * grip + c.QBZ10 * y.B * y.C  # 4.E45
        B_r = B_r if z is None else B_r * z.zeta_6
        inside = B_r * equivalent(alpha_r, kappa2, tangents=k.tangents)
        offset = (c.QDZ6 + c.QDZ7 * s.dfz) * c.LRES
        straight, bent = c.QDZ8 + c.QDZ9 * s.dfz, (c.QDZ10 + c.QDZ11 * s.dfz) * fabs(k.gamma)
        scale = R * s.load * s.mu_y * s.cosine
        if z is None:
            D_r = scale * (offset + (straight * (1.0 + c.PPZ2 * s.dpi) + bent) * (k.gamma * c.LKZC))  # 4.E47
            M_zr = faded(D_r * cos_atan(inside), s)  # 4.E75, C_r = 1
        else:  # zeta_0 = 0: camber acts through spin, 4.99
            of_camber = s.load * R * (straight + bent) * c.LKZC
            D_phi, zeta_7 = turning_moment(c, s, z, mu_y=y.mu, G_y=G_y, camber_moment=of_camber)
            M_zr = (faded(scale * offset * z.zeta_2, s) + D_phi * k.turned) * cos(zeta_7 * atan(inside))
        arm = (R * c.LS) * ((c.SSZ1 + c.SSZ2 / k.arm_load * F_y) + (c.SSZ3 + c.SSZ4 * s.dfz) * k.arm)  # 4.E76
        return t, M_zr, arm
