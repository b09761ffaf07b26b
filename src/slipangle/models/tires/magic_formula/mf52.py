"""What is particular to Magic Formula 5.0 to 5.2 and PAC2002. [1]_

The extension to inflation pressure is the one of PAC2002, with the coefficients of 6.1.

.. [1] H. B. Pacejka, Tyre and Vehicle Dynamics, 2nd ed., 2006, sec. 4.3.2 and appendix.
"""

from slipangle.models.tires.magic_formula.coefficients import MF52Coefficients
from slipangle.models.tires.magic_formula.mf61 import MF61, AligningLean, SideLean
from slipangle.models.tires.magic_formula.terms import Conventions, PureForce, Slip, is_zero
from slipangle.models.tires.magic_formula.turn_slip import Spin
from slipangle.ops import Scalar, atan, exp, fabs, sin


class MF52(MF61):
    """Version 5.2: every use of camber has a scaling of its own."""

    def longitudinal_lean(self, c: MF52Coefficients, s: Slip) -> tuple[Scalar, Scalar]:
        """gamma* times LGAX; lambda_mux*."""
        return s.gamma_star * c.LGAX, s.mu_x

    def side_lean(self, c: MF52Coefficients, s: Slip) -> SideLean:
        """gamma* times LGAY."""
        return SideLean(s.gamma_star * c.LGAY, c.LKYG, s.mu_y)

    def aligning_lean(self, c: MF52Coefficients, o: Conventions, s: Slip) -> AligningLean:
        """gamma* times LGAZ, but for the arm."""
        gamma, fz0 = s.gamma_star * c.LGAZ, c.LFZO * c.FNOMIN
        return AligningLean(gamma, gamma, gamma, arm=s.gamma_star, arm_load=fz0, tangents=True, turned=s.cosine)

    def cornering_stiffness(self, c: MF52Coefficients, load: Scalar, dpi: Scalar, gamma: Scalar) -> Scalar:
        """At gamma* times LGAY."""
        fz0 = c.LFZO * c.FNOMIN
        top = c.PKY2 * (1.0 + c.PPY2 * dpi) * fz0
        size = c.PKY1 * fz0 * (1.0 + c.PPY1 * dpi) * c.LKY
        return size * (1.0 - c.PKY3 * fabs(gamma)) * sin(2.0 * atan(load / top))

    def camber_stiffness(self, c: MF52Coefficients, s: Slip, K_y0: Scalar) -> Scalar:
        """Of both shifts together."""
        return (c.PHY3 * K_y0 + s.load * (c.PVY3 + c.PVY4 * s.dfz)) * c.LKYG

    def camber_shift(self, c: MF52Coefficients, s: Slip, gamma: Scalar, K: Scalar, S_vg: Scalar) -> Scalar:
        """A coefficient of its own."""
        return c.PHY3 * c.LKYG * gamma

    def upright(self, c: MF52Coefficients, o: Conventions, s: Slip, z: Spin | None, y: PureForce) -> PureForce:
        """The whole side force."""
        return y

    def rolling_radius(self, c: MF52Coefficients, load: Scalar, dpi: Scalar, speed: Scalar) -> Scalar:
        """Neither pressure nor speed counts in this version."""
        if is_zero(c.VERTICAL_STIFFNESS):
            return c.UNLOADED_RADIUS
        relative = load / c.FNOMIN
        deflection = c.FNOMIN / (c.VERTICAL_STIFFNESS * c.LCZ)
        return c.UNLOADED_RADIUS - deflection * (c.DREFF * atan(c.BREFF * relative) + c.FREFF * relative)

    def relaxation_lengths(
        self, c: MF52Coefficients, load: Scalar, dfz: Scalar, dpi: Scalar, gamma: Scalar
    ) -> tuple[Scalar, Scalar]:
        """From coefficients of their own."""
        R, fz0 = c.UNLOADED_RADIUS, c.LFZO * c.FNOMIN
        sigma_x = load * (c.PTX1 + c.PTX2 * dfz) * exp(-c.PTX3 * dfz) * (R / c.FNOMIN * c.LSGKP)
        if is_zero(c.PTY2):
            return sigma_x, 0.0 * load
        camber = 1.0 - c.PKY3 * fabs(gamma * c.LGAY)
        return sigma_x, c.PTY1 * sin(2.0 * atan(load / (c.PTY2 * fz0))) * camber * (R * c.LFZO * c.LSGAL)
