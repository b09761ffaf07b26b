"""Magic Formula tires: independent references, limit cases, symmetry, symbols."""

import csv
import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from slipangle.errors import ModelWarning, ParameterError
from slipangle.models.tires.magic_formula.coefficients import MF61Coefficients
from slipangle.models.tires.magic_formula.terms import PRESETS, Conventions
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.models.tires.magic_formula.validity import ValidRange
from tests.models.tires.example_tires import MF52, MF61, TIRES

EVERY = pytest.mark.parametrize("tire", TIRES.values(), ids=TIRES.keys())
OUTPUTS = ("F_x", "F_y", "M_x", "M_y", "M_z")


def samples(n=400, seed=0):
    rng = np.random.default_rng(seed)
    return dict(
        slip_ratio=rng.uniform(-0.5, 0.5, n),
        slip_angle=rng.uniform(-0.6, 0.6, n),
        load=rng.uniform(300.0, 9000.0, n),
        camber=rng.uniform(-0.1, 0.1, n),
    )


def same(a, b, rtol=1e-12, names=OUTPUTS):
    """Equal relative to the largest value of each output."""
    for name in names:
        x, y = np.asarray(getattr(a, name)), np.asarray(getattr(b, name))
        np.testing.assert_allclose(x, y, rtol=rtol, atol=rtol * max(1.0, np.max(np.abs(y))), err_msg=name)


# ---- independent implementations ----------------------------------------------------------------------------------


def columns(path):
    with path.open() as file:
        rows = list(csv.DictReader(file))
    return {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}


@pytest.fixture(scope="module")
def reference_61(real_data):
    d = columns(real_data("mf_reference/mf61_MagicFormula61_Parameters.csv"))
    tire = MagicFormulaTire.from_tir(
        real_data("tir/MagicFormula61_Parameters.tir"),
        conventions=Conventions(lateral_slip="tangent_combined", curvature_sign="slip"),
    )
    return tire, d


def run_61(tire, d):
    return tire.evaluate(d["SX"], d["SA"], d["FZ"], axes="ISO-W", camber=d["IA"], pressure=d["IP"], speed=d["VX"])


def test_mf61_pure_forces_match_the_reference(reference_61):
    tire, d = reference_61
    found = run_61(tire, d)
    straight, free = d["SA"] == 0, d["SX"] == 0
    assert straight.sum() >= 75
    assert free.sum() >= 75
    np.testing.assert_allclose(found.F_x[straight], d["FX"][straight], rtol=1e-9)
    np.testing.assert_allclose(found.F_y[free], d["FY"][free], rtol=1e-9)


@pytest.mark.parametrize(("name", "column"), [("F_x", "FX"), ("F_y", "FY"), ("M_x", "MX"), ("M_y", "MY")])
def test_mf61_combined_columns_match_the_reference(reference_61, name, column):
    tire, d = reference_61
    np.testing.assert_allclose(getattr(run_61(tire, d), name), d[column], rtol=1e-9)


def test_mf61_aligning_moment_differs_from_the_reference_by_two_named_equations(reference_61):
    """The reference takes S_Hf of 4.E38 without camber, and cos(alpha') in 4.E75 as well as in 4.E47."""
    tire, d = reference_61
    c, found = tire.coefficients, run_61(tire, d)
    upright = tire.evaluate(d["SX"], d["SA"], d["FZ"], axes="ISO-W", pressure=d["IP"])
    dfz = d["FZ"] / c.FNOMIN - 1.0
    alpha = np.tan(d["SA"])
    K = np.array(found.K_y)  # 4.E77, 4.E78 keep the stiffness with camber
    equivalent = (found.K_x / K * d["SX"]) ** 2

    def residual(stiffness, gamma, power):
        dpi = d["IP"] / c.NOMPRES - 1.0
        K_g = d["FZ"] * (c.PKY6 + c.PKY7 * dfz) * (1 + c.PPY5 * dpi)
        S_vg = d["FZ"] * (c.PVY3 + c.PVY4 * dfz) * gamma
        S_v = d["FZ"] * (c.PVY1 + c.PVY2 * dfz) + S_vg
        S_h = c.PHY1 + c.PHY2 * dfz + (K_g * gamma - S_vg) / stiffness
        mu = (c.PDY1 + c.PDY2 * dfz) * (1 + c.PPY3 * dpi + c.PPY4 * dpi**2) * (1 - c.PDY3 * gamma**2)
        B_r = c.QBZ9 + c.QBZ10 * stiffness / (mu * d["FZ"])
        alpha_r = alpha + S_h + S_v / stiffness
        g = np.sin(d["IA"])
        D_r = (c.QDZ6 + c.QDZ7 * dfz) + (
            (c.QDZ8 + c.QDZ9 * dfz) * (1 + c.PPZ2 * dpi) + (c.QDZ10 + c.QDZ11 * dfz) * np.abs(g)
        ) * g
        x = B_r * np.sqrt(alpha_r**2 + equivalent)
        return d["FZ"] * c.UNLOADED_RADIUS * D_r / np.sqrt(1 + x**2) * np.cos(d["SA"]) ** power

    book = residual(K, np.sin(d["IA"]), 1)
    np.testing.assert_allclose(book, found.M_zr, rtol=1e-9, atol=1e-9)  # ours is the book's
    explained = found.M_z - book + residual(np.array(upright.K_y), 0.0, 2)
    np.testing.assert_allclose(explained, d["MZ"], rtol=1e-6)
    assert np.max(np.abs(found.M_z - d["MZ"])) > 1.0  # so the two equations do matter


def test_the_two_open_choices_matter_and_the_book_is_the_default(reference_61):
    tire, d = reference_61
    book = replace(tire, conventions=Conventions())
    one = replace(tire, conventions=Conventions(lateral_slip="tangent_combined"))
    other = replace(tire, conventions=Conventions(curvature_sign="slip"))
    sweep = np.linspace(-0.3, 0.3, 2001)
    F_y = {
        name: t.evaluate(0.0, sweep, 6752.0, camber=0.1, axes="ISO-W").F_y
        for name, t in (("book", book), ("one", one), ("other", other))
    }
    assert 10 < np.max(np.abs(F_y["book"] - F_y["one"])) < 60
    assert 0.5 < np.max(np.abs(F_y["book"] - F_y["other"])) < 30
    assert np.max(np.abs(run_61(book, d).F_y - d["FY"])) > 10


@pytest.fixture(scope="module")
def reference_52(real_data):
    d = columns(real_data("mf_reference/opentire_pac2002_vw_microbus.csv"))
    return MagicFormulaTire.from_tir(real_data("tir/VW_microbus__json__mf_185_80R14.tir")), d


def test_pac2002_matches_the_reference(reference_52):
    """It is printed to ten digits, and M_y is positive there: its lateral axis points to the right."""
    tire, d = reference_52
    found = tire.evaluate(d["SR"], d["SA_rad"], d["FZ_N"], axes="ISO-W", camber=d["IA_rad"])
    np.testing.assert_allclose(found.F_y, d["FY_N"], rtol=1e-9, atol=5.1e-7)
    np.testing.assert_allclose(found.F_x, d["FX_N"], rtol=1e-9, atol=5.1e-7)
    np.testing.assert_allclose(found.M_x, d["MX_Nm"], atol=1e-12)
    np.testing.assert_allclose(-found.M_y, d["MY_Nm"], rtol=1e-12)


def test_pac2002_aligning_moment_differs_from_the_reference_by_one_named_equation(reference_52):
    """The reference multiplies trail and residual moment with cos(tan alpha) where the equations say cos(alpha)."""
    tire, d = reference_52
    found = tire.evaluate(d["SR"], d["SA_rad"], d["FZ_N"], axes="ISO-W", camber=d["IA_rad"])
    cosine = np.cos(np.tan(d["SA_rad"])) / np.cos(d["SA_rad"])
    explained = found.arm * found.F_x + cosine * (found.M_zr - found.trail * found.G_y * found.F_y0)
    np.testing.assert_allclose(explained, d["MZ_Nm"], rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(found.M_z, d["MZ_Nm"], rtol=1e-3, atol=0.05)


# ---- symbols and derivatives --------------------------------------------------------------------------------------

VARIANTS = {
    "book": {},
    "paper": {"conventions": Conventions(aligning="paper", overturning="manual", rolling_resistance="paper")},
    "angle": {"conventions": Conventions(lateral_slip="angle", camber="angle", curvature_sign="slip")},
    "ellipse": {"combined": "ellipse"},
    "none": {"combined": "none"},
    "mirrored": {"mirrored": True},
}
CONDITIONS = {
    "plain": {},
    "pressure": {"pressure": 180e3, "friction": 0.7},
    "slow": {"speed": 0.4},
    "turning": {"turn_slip": 0.08, "speed": 5.0},
}


@EVERY
@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("condition", CONDITIONS)
def test_symbols_equal_numbers(tire, variant, condition):
    tire = replace(tire, **VARIANTS[variant])
    d, extra = samples(), CONDITIONS[condition]
    x = [ca.SX.sym(name) for name in d]
    symbolic = tire.evaluate(*x[:3], camber=x[3], axes="SAE", **extra)
    function = ca.Function("forces", x, list(symbolic[:5])).map(len(d["load"]))
    found = np.vstack([np.asarray(v) for v in function(*d.values())])
    numeric = tire.evaluate(d["slip_ratio"], d["slip_angle"], d["load"], camber=d["camber"], axes="SAE", **extra)
    for row, name in zip(found, OUTPUTS, strict=True):
        value = getattr(numeric, name)
        assert np.isfinite(value).all()
        np.testing.assert_allclose(row, value, rtol=1e-12, atol=1e-12 * np.max(np.abs(value)), err_msg=name)


@EVERY
@pytest.mark.parametrize("condition", CONDITIONS)
def test_derivatives_match_finite_differences(tire, condition):
    d, extra = samples(60, seed=1), CONDITIONS[condition]
    x = ca.SX.sym("x", 4)
    forces = ca.vertcat(*tire.evaluate(x[0], x[1], x[2], camber=x[3], axes="ISO-W", **extra)[:5])
    value = ca.Function("f", [x], [forces])
    jacobian = ca.Function("j", [x], [ca.jacobian(forces, x)])
    points = np.column_stack(list(d.values()))
    for point in points:
        exact = np.asarray(jacobian(point))
        for i, h in enumerate((1e-6, 1e-6, 1e-2, 1e-6)):
            step = np.zeros(4)
            step[i] = h
            slope = (np.asarray(value(point + step)) - np.asarray(value(point - step))).ravel() / (2 * h)
            scale = np.abs(exact[:, i]) + np.array([1.0, 1.0, 0.1, 0.1, 0.1]) * (1e-3 if i == 2 else 100.0)
            np.testing.assert_array_less(np.abs(slope - exact[:, i]) / scale, 2e-5)


@EVERY
def test_derivatives_with_respect_to_coefficients(tire):
    names = ["PDY1", "PKY1", "PKY2", "PCY1", "PEY1", "PHY1", "PVY1", "RBY1", "QBZ1", "QDZ1", "PDX1", "PKX1", "PPX3"]
    start = np.array([getattr(tire.coefficients, n) for n in names])
    p = ca.SX.sym("p", len(names))
    symbolic = tire.with_coefficients(**{n: p[i] for i, n in enumerate(names)})
    d = samples(5, seed=2)
    for k in range(5):
        args = [float(d[n][k]) for n in ("slip_ratio", "slip_angle", "load")]
        forces = ca.vertcat(*symbolic.forces(*args, camber=float(d["camber"][k])))
        exact = np.asarray(ca.Function("j", [p], [ca.jacobian(forces, p)])(start))
        for i, name in enumerate(names):
            h = 1e-6 * max(1.0, abs(start[i]))
            high, low = (
                np.array(tire.with_coefficients(**{name: start[i] + s * h}).forces(*args, camber=float(d["camber"][k])))
                for s in (1, -1)
            )
            slope = (high - low) / (2 * h)
            np.testing.assert_allclose(exact[:, i], slope, rtol=1e-5, atol=1e-4 * (1 + np.max(np.abs(slope))))


def test_tracers_equal_numbers():
    jax = pytest.importorskip("jax", reason="jax is not installed")
    from slipangle.identify.networks.adam import precision

    with precision("double"):
        d = samples(50)
        found = jax.jit(lambda s, a, f, g: MF61.forces(s, a, f, camber=g))(*(jax.numpy.asarray(v) for v in d.values()))
        same(found, MF61.forces(d["slip_ratio"], d["slip_angle"], d["load"], camber=d["camber"]), rtol=1e-11)


# ---- limit cases --------------------------------------------------------------------------------------------------


@EVERY
def test_combined_slip_with_zero_other_slip_is_pure_slip(tire):
    d = samples()
    pure = replace(tire, combined="none")
    zero = 0.0
    a = tire.forces(d["slip_ratio"], zero, d["load"], camber=d["camber"])
    b = pure.forces(d["slip_ratio"], zero, d["load"], camber=d["camber"])
    np.testing.assert_allclose(a.F_x, b.F_x, rtol=1e-13)
    a = tire.evaluate(zero, d["slip_angle"], d["load"], camber=d["camber"], axes="ISO-W")
    b = pure.evaluate(zero, d["slip_angle"], d["load"], camber=d["camber"], axes="ISO-W")
    same(a, b, names=("F_y", "M_x", "trail", "M_zr"))
    # the offset of F_x at zero slip ratio fades with slip angle, and its moment with it
    np.testing.assert_allclose(a.M_z - a.arm * a.F_x, b.M_z - b.arm * b.F_x, rtol=1e-11, atol=1e-10)


@EVERY
@pytest.mark.parametrize("combined", ["weighting", "ellipse", "none"])
@pytest.mark.parametrize("extra", [{}, {"turn_slip": 0.1}, {"speed": 0.0}], ids=["plain", "turning", "standing"])
def test_no_load_no_force(tire, combined, extra):
    tire = replace(tire, combined=combined)
    slip = np.linspace(-1.0, 1.0, 21)
    found = tire.evaluate(slip, slip[::-1], 0.0, camber=0.05, axes="ISO-W", **extra)
    for name in OUTPUTS:
        np.testing.assert_allclose(getattr(found, name), 0.0, atol=1e-12)
    almost = tire.evaluate(slip, slip[::-1], 1e-3, camber=0.05, axes="ISO-W", **extra)
    assert np.max(np.abs(almost.F_y)) < 3e-3


@EVERY
def test_forces_point_where_slip_pushes(tire):
    assert tire.forces(0.05, 0.0, 4000.0).F_x > 1000  # drives
    assert tire.forces(-0.05, 0.0, 4000.0).F_x < -1000
    turned = tire.forces(0.0, 0.05, 4000.0)
    assert turned.F_y > 1000  # to the left
    assert turned.M_z < -10  # turns the wheel back: to the right
    assert turned.M_y < 0  # against rolling
    assert tire.forces(0.0, 0.0, 4000.0, camber=0.1).F_y < -100  # top to the right pushes to the right


@EVERY
def test_stiffness_is_the_slope_at_the_origin(tire):
    tire = tire.symmetric().with_coefficients(PHX1=0.0, PHX2=0.0, PVX1=0.0, PVX2=0.0, PEX4=0.0)
    h = 1e-6
    for load in (1000.0, 4000.0, 7000.0):
        at = tire.evaluate(0.0, 0.0, load, axes="ISO-W")
        F_x = [tire.evaluate(s, 0.0, load, axes="ISO-W").F_x for s in (-h, h)]
        F_y = [tire.evaluate(0.0, s, load, axes="ISO-W").F_y for s in (-h, h)]
        assert (F_x[1] - F_x[0]) / (2 * h) == pytest.approx(at.K_x, rel=1e-6)
        assert (F_y[1] - F_y[0]) / (2 * h) == pytest.approx(at.K_y, rel=1e-6)
        assert at.K_y < 0 < at.K_x


@EVERY
def test_friction_limits_the_resultant(tire):
    d = samples(4000, seed=5)
    tire = tire.symmetric()
    for friction in (1.0, 0.5):
        found = tire.evaluate(
            d["slip_ratio"], d["slip_angle"], d["load"], camber=d["camber"], axes="ISO-W", friction=friction
        )
        size = np.hypot(found.F_x / (found.mu_x * d["load"]), found.F_y / (found.mu_y * d["load"]))
        assert np.max(size) < 1.35  # the weighting functions bound it, not exactly
        ellipse = replace(tire, combined="ellipse").with_coefficients(PVX1=0.0, PVX2=0.0, PVY3=0.0, PVY4=0.0)
        found = ellipse.evaluate(d["slip_ratio"], d["slip_angle"], d["load"], axes="ISO-W", friction=friction)
        size = np.hypot(found.F_x / (found.mu_x * d["load"]), found.F_y / (found.mu_y * d["load"]))
        assert np.max(size) <= 1.0 + 1e-9


@EVERY
def test_the_ellipse_leaves_pure_slip_alone(tire):
    tire = replace(tire.symmetric(), combined="ellipse").with_coefficients(PHX1=0.0, PHX2=0.0, PVX1=0.0, PVX2=0.0)
    slip = np.linspace(-0.3, 0.3, 31)
    only_x, only_y = tire.forces(slip, 0.0, 4000.0), tire.forces(0.0, slip, 4000.0)
    none = replace(tire, combined="none")
    np.testing.assert_allclose(only_x.F_x, none.forces(slip, 0.0, 4000.0).F_x, rtol=1e-9)
    np.testing.assert_allclose(only_y.F_y, none.forces(0.0, slip, 4000.0).F_y, rtol=1e-9)


@EVERY
def test_backwards_and_standing(tire):
    forward = tire.evaluate(0.0, 0.1, 4000.0, axes="ISO-W", speed=10.0)
    backward = tire.evaluate(0.0, math.pi - 0.1, 4000.0, axes="ISO-W")
    assert forward.M_y < 0 < backward.M_y  # rolling resistance turns round
    assert backward.F_y == pytest.approx(forward.F_y, rel=1e-9)  # the same slip velocity to the side
    still = tire.evaluate(0.0, 0.0, 4000.0, camber=0.05, axes="ISO-W", speed=0.0)
    assert still.M_y == 0.0
    assert abs(still.F_x) < 1e-9  # offsets are gone
    speeds = np.linspace(-3.0, 3.0, 2001)
    found = tire.evaluate(0.1, 0.0, 4000.0, camber=0.02, axes="ISO-W", speed=speeds)
    for name in OUTPUTS:
        value = getattr(found, name)
        assert np.max(np.abs(np.diff(value))) < 0.02 * np.ptp(value) + 1e-9, name
    same(tire.evaluate(0.1, 0.05, 4000.0, axes="ISO-W", speed=tire.coefficients.LONGVL),
         tire.evaluate(0.1, 0.05, 4000.0, axes="ISO-W"))  # fmt: skip


@EVERY
def test_nothing_jumps_at_ninety_degrees(tire):
    angles = np.deg2rad(np.linspace(60.0, 120.0, 6001))
    found = tire.evaluate(0.0, angles, 4000.0, axes="ISO-W")
    for name in ("F_x", "F_y", "M_x", "M_z"):
        value = getattr(found, name)
        assert np.isfinite(value).all()
        assert np.max(np.abs(np.diff(value))) < 0.01 * max(np.max(np.abs(value)), 100.0), name


# ---- symmetry and axes --------------------------------------------------------------------------------------------


@EVERY
@pytest.mark.parametrize("variant", ["book", "paper", "ellipse"])
def test_a_symmetric_tire_is_its_own_mirror_image(tire, variant):
    tire = replace(tire, **VARIANTS[variant]).symmetric()
    d = samples()
    a = tire.forces(d["slip_ratio"], d["slip_angle"], d["load"], camber=d["camber"])
    b = tire.forces(d["slip_ratio"], -d["slip_angle"], d["load"], camber=-d["camber"])
    same(a, b._replace(F_y=-b.F_y, M_x=-b.M_x, M_z=-b.M_z))
    assert abs(tire.forces(0.0, 0.0, 4000.0).F_y) < 1e-9


@EVERY
@pytest.mark.parametrize("turn", [None, 0.05])
def test_the_tire_on_the_other_side_is_the_mirror_image(tire, turn):
    left, right = tire.mounted("LEFT"), tire.mounted("RIGHT")
    assert not left.mirrored
    assert right.mirrored
    d = samples()
    args = d["slip_ratio"], d["slip_angle"], d["load"]
    a = left.evaluate(*args, camber=d["camber"], axes="ISO-W", turn_slip=turn)
    other = None if turn is None else -turn
    b = right.evaluate(args[0], -args[1], args[2], camber=-d["camber"], axes="ISO-W", turn_slip=other)
    same(a, b._replace(F_y=-b.F_y, M_x=-b.M_x, M_z=-b.M_z))
    assert abs(left.forces(0.0, 0.0, 4000.0).F_y) > 10  # the example has ply steer and conicity
    same(right.mounted("LEFT").forces(*args), left.forces(*args))


@EVERY
def test_axis_systems_differ_by_signs(tire):
    d = samples()
    s, a, f, g = d.values()
    iso = tire.evaluate(s, a, f, camber=g, axes="ISO-W")
    sae = tire.evaluate(s, -a, f, camber=g, axes="SAE")
    adapted = tire.evaluate(s, a, f, camber=g, axes="adapted SAE")
    own = tire.forces(s / (1 + np.maximum(s, 0)), -a, f, camber=g)  # driving counts against the wheel's speed
    flipped = iso._replace(F_y=-iso.F_y, M_y=-iso.M_y, M_z=-iso.M_z)
    same(sae, flipped)
    same(adapted, flipped)
    same(own, iso)
    # slope signs of the standards
    assert tire.evaluate(0.0, 0.05, 4000.0, axes="ISO-W").F_y < 0
    assert tire.evaluate(0.0, 0.05, 4000.0, axes="SAE").F_y < 0
    assert tire.evaluate(0.0, 0.05, 4000.0, axes="adapted SAE").F_y > 0


@pytest.mark.parametrize("axes", ["ISO-W", "SAE", "adapted SAE"])
def test_coefficients_in_other_axes_describe_the_same_tire(axes):
    """Side force and slip angle of adapted SAE give the book's positive cornering stiffness."""
    tire = replace(MF61.symmetric(), combined="none")
    slip, side = {"ISO-W": (1, 1), "SAE": (-1, -1), "adapted SAE": (1, -1)}[axes]
    c = tire.coefficients
    odd_in_slope = {n: getattr(c, n) * slip * side for n in ("PKY1", "QBZ10")}
    with_force = {n: getattr(c, n) * side for n in ("PKY6", "PKY7", "PVY3", "PVY4", "QDZ8", "QDZ9", "QDZ10", "QDZ11")}
    with_force |= {n: getattr(c, n) * side for n in ("QSX3", "QSX9", "QSX13", "QSX14", "SSZ3", "SSZ4")}
    with_slip = {n: getattr(c, n) * slip for n in ("QHZ3", "QHZ4", "PEY4", "QEZ5")}
    other = replace(tire.with_coefficients(**odd_in_slope, **with_force, **with_slip), axes=axes)
    d = samples()
    args = d["slip_ratio"], d["slip_angle"], d["load"]
    same(other.forces(*args, camber=d["camber"]), tire.forces(*args, camber=d["camber"]), rtol=1e-11)


# ---- pressure, turn slip, lengths ---------------------------------------------------------------------------------


@EVERY
def test_pressure_acts_only_where_its_coefficients_say(tire):
    nominal = tire.evaluate(0.05, 0.05, 4000.0, axes="ISO-W", pressure=tire.coefficients.NOMPRES)
    high = tire.evaluate(0.05, 0.05, 4000.0, axes="ISO-W", pressure=1.2 * tire.coefficients.NOMPRES)
    assert high.mu_x / nominal.mu_x == pytest.approx(1 - 0.05 * 0.2 - 0.1 * 0.04, rel=1e-12)
    assert high.K_x / nominal.K_x == pytest.approx(1 - 0.4 * 0.2 + 0.3 * 0.04, rel=1e-12)
    default = tire.evaluate(0.05, 0.05, 4000.0, axes="ISO-W")
    same(default, tire.evaluate(0.05, 0.05, 4000.0, axes="ISO-W", pressure=tire.coefficients.INFLPRES))


@EVERY
def test_turn_slip_vanishes_without_spin(tire):
    d = samples()
    args = d["slip_ratio"], d["slip_angle"], d["load"]
    same(
        tire.evaluate(*args, axes="ISO-W", turn_slip=0.0),
        tire.evaluate(*args, axes="ISO-W"),
        rtol=1e-6,
    )


@EVERY
def test_turn_slip_reduces_grip_and_turns_the_wheel_back(tire):
    tire = tire.symmetric()
    straight = tire.evaluate(0.0, 0.0, 4000.0, axes="ISO-W", turn_slip=0.0)
    left = tire.evaluate(0.0, 0.0, 4000.0, axes="ISO-W", turn_slip=0.1)
    assert abs(straight.F_y) < 1e-6
    assert abs(straight.M_z) < 1e-6
    assert left.F_y < -10  # pushed out of the turn
    assert left.M_z < -5  # against the turn
    peak = [float(tire.evaluate(0.3, 0.0, 4000.0, axes="ISO-W", turn_slip=t).F_x) for t in (0.0, 1.0, 3.0)]
    assert peak[0] > peak[1] > peak[2] > 0


def test_small_camber_acts_alike_through_spin_and_directly():
    """With zeta_0 = 0 camber reaches the side force through spin; the slopes agree up to R_0 / R_e."""
    tire = MF61.symmetric().with_coefficients(PHYP4=0.0, PDYP4=0.0)
    h, load = 1e-4, 4200.0
    direct = tire.evaluate(0.0, 0.0, load, camber=h, axes="ISO-W").F_y / h
    spin = tire.evaluate(0.0, 0.0, load, camber=h, axes="ISO-W", turn_slip=0.0).F_y / h
    c = tire.coefficients
    assert spin / direct == pytest.approx(c.UNLOADED_RADIUS / tire.rolling_radius(load, speed=c.LONGVL), rel=0.02)


def test_turn_slip_needs_its_coefficients():
    bare = MF61.with_coefficients(PHYP1=0.0, QDRP1=0.0)
    with pytest.raises(ParameterError, match=r"turn slip needs PHYP1, QDRP1, .*TURNSLIP_COEFFICIENTS"):
        bare.evaluate(0.0, 0.1, 4000.0, axes="ISO-W", turn_slip=0.1)


def test_relaxation_lengths():
    lengths = MF61.relaxation_lengths(np.array([2000.0, 4200.0]))
    at = MF61.evaluate(0.0, 0.0, 4200.0, axes="ISO-W")
    dpi = 230 / 220 - 1
    assert lengths.longitudinal[1] == pytest.approx(at.K_x / (3.6e5 * (1 + 0.2 * dpi)), rel=1e-12)
    assert lengths.lateral[1] == pytest.approx(-at.K_y / (1.6e5 * (1 + 0.5 * dpi)), rel=1e-12)
    assert lengths.lateral[0] < lengths.lateral[1]
    c = MF52.coefficients
    lengths = MF52.relaxation_lengths(1.9 * 4200.0)
    assert lengths.lateral == pytest.approx(2.0 * c.UNLOADED_RADIUS, rel=1e-12)  # the largest one
    assert MF52.relaxation_lengths(4200.0).longitudinal == pytest.approx(2.0 * c.UNLOADED_RADIUS, rel=1e-12)
    with pytest.raises(ParameterError, match="LATERAL_STIFFNESS"):
        MF61.with_coefficients(LATERAL_STIFFNESS=0.0).relaxation_lengths(4000.0)


@EVERY
def test_rolling_radius_lies_between_loaded_and_unloaded(tire):
    c = tire.coefficients
    loads = np.linspace(0.0, 8000.0, 9)
    radius = tire.rolling_radius(loads)
    assert radius[0] == pytest.approx(c.UNLOADED_RADIUS, rel=2e-3)
    assert (np.diff(radius) < 0).all()
    assert (radius >= c.UNLOADED_RADIUS - loads / c.VERTICAL_STIFFNESS - 2e-3).all()


# ---- ranges, shapes, bad input ------------------------------------------------------------------------------------

LIMITS = ValidRange(load=(200.0, 9000.0), slip_ratio=(-0.5, 0.4), slip_angle=(-0.2, 0.3), camber=(-0.1, 0.1),
                pressure=(180e3, 300e3))  # fmt: skip


@EVERY
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"load": 150.0}, r"load is 150 N; expected 200 to 9000 N \(FZMIN, FZMAX\): stay inside, or ask"),
        ({"load": np.array([4000.0, 9100.0])}, "load is 9100 N"),
        ({"load": np.nan}, "load is nan N"),
        ({"slip_ratio": 0.45}, "slip ratio kappa is 0.45; expected -0.5 to 0.4 .KPUMIN"),
        ({"slip_angle": 0.25}, "slip_angle is 0.25 rad; expected -0.2 to 0.3 rad"),
        ({"camber": -0.2}, "camber is -0.2 rad"),
        ({"pressure": 100e3}, "pressure is 100000 Pa"),
    ],
)
def test_outside_the_range_is_an_error_or_flagged(tire, change, message):
    tire = replace(tire, limits=LIMITS)
    inputs = {"slip_ratio": 0.05, "slip_angle": -0.05, "load": 4000.0, "camber": 0.02, "pressure": 220e3} | change
    axes = "SAE" if "slip_angle" not in change else "ISO-W"
    if "slip_angle" in change:
        tire.evaluate(axes="ISO-W", **inputs)  # inside: the range is not symmetric
        tire, inputs["slip_angle"] = replace(tire, mirrored=True), -0.25  # the mirror image of the same state
        tire = replace(tire, limits=replace(LIMITS, slip_angle=(-0.3, 0.2)))
        message = r"slip_angle is 0.25 rad; expected -0.3 to 0.2 rad"
    with pytest.raises(ParameterError, match=message):
        tire.evaluate(axes=axes, **inputs)
    with pytest.warns(ModelWarning, match="the tire is extrapolated: " + message.split(";")[0].split(r"\(")[0]):
        replace(tire, outside="extrapolate").evaluate(axes=axes, **inputs)


@EVERY
def test_limits_count_in_the_axes_of_the_coefficients(tire):
    tire = replace(tire, limits=LIMITS)
    tire.evaluate(0.0, 0.25, 4000.0, axes="ISO-W")
    tire.forces(0.0, -0.25, 4000.0)
    with pytest.raises(ParameterError, match="slip_angle"):
        tire.forces(0.0, 0.25, 4000.0)


def test_symbols_pass_unchecked():
    tire = replace(MF61, limits=LIMITS)
    load = ca.SX.sym("load")
    f = ca.Function("f", [load], [tire.forces(0.0, 0.1, load).F_y])
    assert float(f(20000.0)) != 0.0


@EVERY
def test_batches_equal_single_evaluations_whatever_their_shape(tire):
    n = 9001
    d = samples(n)
    whole = tire.forces(d["slip_ratio"], d["slip_angle"], d["load"], camber=d["camber"])
    for k in (0, 4095, 4096, n - 1):
        one = tire.forces(*(d[name][k] for name in ("slip_ratio", "slip_angle", "load")), camber=d["camber"][k])
        for name in OUTPUTS:
            assert getattr(one, name) == pytest.approx(getattr(whole, name)[k], rel=1e-12)
    square = tire.forces(d["slip_ratio"][:9000].reshape(90, 100), 0.1, d["load"][:100])
    assert np.shape(square.F_x) == (90, 100)
    tall = tire.forces(d["slip_ratio"][:9000].reshape(90, 100), d["slip_angle"][:9000].reshape(90, 100), 4000.0)
    assert tall.M_z.shape == (90, 100)
    listed = tire.forces([0.0, 0.1], [0.1, 0.0], 4000)
    assert listed.F_x.shape == (2,)


def test_wrong_names_are_refused():
    with pytest.raises(ParameterError, match="axes is 'ISO'; nearest are"):
        MF61.evaluate(0.0, 0.1, 4000.0, axes="ISO")
    with pytest.raises(ParameterError, match="axes is 'slipangle'"):
        MF61.evaluate(0.0, 0.1, 4000.0, axes="slipangle")
    with pytest.raises(ParameterError, match="combined is 'elipse'; nearest are 'ellipse'"):
        replace(MF61, combined="elipse")
    with pytest.raises(ParameterError, match="side is 'left'"):
        MF61.mounted("left")
    with pytest.raises(ParameterError, match="TYRESIDE"):
        replace(MF61, side="").mounted("LEFT")
    with pytest.raises(ParameterError, match="no parameter 'PDY7'; nearest are"):
        MF61.with_coefficients(PDY7=1.0)


# ---- choices of other codes ------------------------------------------------------------------------------------------


def test_mfeval_takes_slip_angle_and_camber_themselves():
    """Equations 4.E19 to 4.E30 written out for MFeval's useMode 111: no alpha*, A_mu = 1; M_y by A48 of the paper."""
    c = MF61Coefficients(
        FNOMIN=4000, UNLOADED_RADIUS=0.31, PCX1=1.6, PDX1=1.2, PKX1=22, PCY1=1.3, PDY1=1.1, PDY3=2.0, PKY1=-20,
        PKY2=2.0, PEY1=-1.0, PEY3=0.3, PEY4=-2.0, PHY1=0.003, PVY1=0.02, PVY3=-0.3, PKY6=-0.8, LMUY=0.7,
        QSY1=0.01, QSY7=0.9,
    )  # fmt: skip
    tire = MagicFormulaTire(coefficients=c, conventions=PRESETS["mfeval"])
    alpha, gamma, load = np.linspace(-0.4, 0.4, 41), 0.08, 5000.0
    K = -20 * 4000 * np.sin(2 * np.arctan(5000 / (2.0 * 4000)))
    S_vg = load * -0.3 * gamma * 0.7
    S_h = 0.003 + (load * -0.8 * gamma - S_vg) / K
    S_v = load * 0.02 * 0.7 + S_vg
    x = alpha + S_h
    D = 1.1 * (1 - 2.0 * gamma**2) * 0.7 * load
    E = np.minimum(-1.0 * (1 - (0.3 - 2.0 * gamma) * np.sign(x)), 1.0)
    B = K / (1.3 * D)
    expected = D * np.sin(1.3 * np.arctan(B * x - E * (B * x - np.arctan(B * x)))) + S_v
    found = tire.evaluate(0.0, alpha, load, axes="ISO-W", camber=gamma)
    np.testing.assert_allclose(found.F_y, expected, rtol=1e-9)
    np.testing.assert_allclose(found.M_y, -4000 * 0.31 * 0.01 * 1.25**0.9, rtol=1e-12)
    book = replace(tire, conventions=Conventions()).evaluate(0.0, alpha, load, axes="ISO-W", camber=gamma)
    assert np.max(np.abs(book.F_y - expected)) > 20


def test_speed_reaches_the_forces():
    tire = MagicFormulaTire(
        coefficients=replace(MF61.coefficients, QSY1=0.01, QSY2=0.0, QSY3=0.01, QSY4=0.0, LONGVL=20.0)
    )
    slow, fast = (tire.forces(0.0, 0.0, 4000.0, speed=v).M_y for v in (20.0, 40.0))
    assert fast / slow == pytest.approx(0.03 / 0.02)
    assert tire.forces_at(0.0, 0.0, 4000.0, camber=0.0, pressure=None, speed=40.0).M_y == fast


@EVERY
def test_a_road_without_friction_holds_nothing(tire):
    on_ice = tire.evaluate(**samples(), axes="ISO-W", friction=0.0)
    nearly = tire.evaluate(**samples(), axes="ISO-W", friction=1e-9)
    for name in OUTPUTS:
        assert np.isfinite(getattr(on_ice, name)).all()
        np.testing.assert_allclose(getattr(on_ice, name), getattr(nearly, name), atol=1e-3)


def test_a_nominal_load_of_nothing_is_out_of_range():
    with pytest.raises(ParameterError, match=r"LFZO .*expected 0\.01 to 100"):
        replace(MF61.coefficients, LFZO=0.0)
