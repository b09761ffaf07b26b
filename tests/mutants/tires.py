"""Mistakes in tires and in networks."""

from tests.mutants.listed import mistakes

ORACLE = "oracles/test_tires.py"

MUTANTS = [
    *mistakes(
        "models/tires/simple.py",
        ORACLE,
        [
            (
                "ellipse: side force on the longitudinal curve's scale",
                "k_y(rho * (k_y.D / k_y.slope))",
                "k_y(rho * (k_x.D / k_x.slope))",
            ),
            ("ellipse: direction of F_x", "* a / rho", "* b / rho"),
            (
                "slip ratio: sign of eq. 3-13 as printed",
                "return (rolling - v_x) / larger",
                "return (v_x - rolling) / larger",
            ),
            ("slip ratio: over the smaller speed", "0.5 * (a + b + smooth_abs", "0.5 * (a + b - smooth_abs"),
            ("Magic Formula: E without B", "(self.E / self.B) * atan", "self.E * atan"),
            ("Magic Formula: sign of the shift", "x = slip + self.S_h", "x = slip - self.S_h"),
            (
                "Magic Formula: side force from the longitudinal curve",
                "self.longitudinal(slip_ratio), self.lateral(slip_angle)",
                "self.longitudinal(slip_ratio), self.longitudinal(slip_angle)",
            ),
            (
                "slip of tire files: driving counts as braking",
                "1.0 - clip(slip_ratio, 0.0",
                "1.0 + clip(slip_ratio, 0.0",
            ),
            (
                "linear tire: stiffnesses swapped",
                "(self.C_s * slip_ratio, self.C_alpha",
                "(self.C_alpha * slip_ratio, self.C_alpha",
            ),
        ],
    ),
    *mistakes(
        "models/tires/physical.py",
        ORACLE,
        [
            ("brush: cubic term", "grip * rho * (3.0 - (3.0 - rho) * rho)", "grip * rho * (3.0 - (2.0 - rho) * rho)"),
            ("brush: trail ahead of the middle", "M_z=-trail * F_y", "M_z=trail * F_y"),
            ("Dugoff: twice the grip", "0.5 * self.mu * friction", "self.mu * friction"),
            (
                "tread slip: driving does not count sideways",
                "tan(slip_angle) * (1.0 - maximum(slip_ratio, 0.0))",
                "tan(slip_angle)",
            ),
        ],
    ),
    *mistakes(
        "models/black_box/networks.py",
        ORACLE,
        [
            ("Gaussian: width not squared", "exp(-square / (width * width))", "exp(-square / width)"),
            ("ELU: a step at zero", "exp(minimum(z, 0.0)) - 1", "exp(minimum(z, 0.0))"),
            (
                "scaling: offset taken off twice",
                "z * _column(self.factor, z) + _column(self.offset, z)",
                "z * _column(self.factor, z) - _column(self.offset, z)",
            ),
        ],
    ),
    *mistakes(
        "models/tires/neural.py",
        ORACLE,
        [("neural tire: sigmoid folded with the wrong sign", "b + offset * w.sum", "b - offset * w.sum")],
    ),
    *mistakes(
        "models/tires/magic_formula/terms.py",
        ORACLE,
        [
            ("6.1: sign of RBY3", "(s.tangent - c.RBY3)", "(s.tangent + c.RBY3)"),
            ("6.1: load over the load itself", "dfz=(load - fz0) / fz0", "dfz=(load - fz0) / load"),
            ("6.1: combined slip without its norm", "/ cos(c.RCX1 * curved(B * c.RHX1, E))", "/ 1.0"),
            ("6.1: overturning by side force", "c.QSX3 / c.FNOMIN * F_y -", "-c.QSX3 / c.FNOMIN * F_y -"),
        ],
    ),
    *mistakes(
        "models/tires/magic_formula/mf61.py",
        ORACLE,
        [
            ("6.1: trail ahead of the wheel", "M_zr - t * trailing", "M_zr + t * trailing"),
            ("6.1: exponent of slip stiffness", "exp(c.PKX3 * dfz)", "exp(-c.PKX3 * dfz)"),
            ("6.1: shift by camber", "K) * gamma - S_vg, K)", "K) * gamma + S_vg, K)"),
            ("curvature's sign by camber", "(c.PEY3 + c.PEY4 * gamma)", "(c.PEY3 - c.PEY4 * gamma)"),
            (
                "6.1: peak grows with camber",
                "(1.0 - c.PDY3 * gamma * gamma) * s.mu_y",
                "(1.0 + c.PDY3 * gamma * gamma) * s.mu_y",
            ),
        ],
    ),
    *mistakes(
        "models/tires/magic_formula/mf52.py",
        ORACLE,
        [
            ("5.2: half the angle in the stiffness", "sin(2.0 * atan(load / top))", "sin(atan(load / top))"),
        ],
    ),
    *mistakes(
        "models/tires/magic_formula/axes.py",
        ORACLE,
        [
            ("axes: slip angle of SAE", '"SAE": (-1.0, -1.0)', '"SAE": (1.0, -1.0)'),
            ("axes: sign of our slip angle", '"slipangle": (-1.0, 1.0)', '"slipangle": (1.0, 1.0)'),
        ],
    ),
    *mistakes(
        "models/tires/magic_formula/tire.py",
        ORACLE,
        [
            (
                "mirrored tire: camber not turned",
                'inputs["camber"] = -inputs["camber"]',
                'inputs["camber"] = inputs["camber"]',
            ),
        ],
    ),
]
