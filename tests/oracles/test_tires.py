"""Tires against `tests.oracles.tires` and `tests.oracles.magic_formula`."""

import casadi as ca
import numpy as np
import pytest

from slipangle.models.black_box.networks import MLP, RBF, Scaling
from slipangle.models.tires.neural import NeuralCurve, NeuralTire
from slipangle.models.tires.physical import BrushTire, DugoffTire, tread_slip
from slipangle.models.tires.simple import LinearTire, MagicCurve, SimpleMagicFormula, practical_slip, slip_ratio
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_2, SOUSA_TABLE_6_8
from tests.models.tires.example_tires import MF52, MF61, ONLY_52, ONLY_61, SHARED
from tests.oracles import magic_formula, tires
from tests.oracles.compare import agree, uniform

SLIPS = ((-0.9, 0.9), (-0.6, 0.6), (500.0, 9000.0), (0.2, 1.3))  # slip ratio, slip angle, load, friction


def x_and_y(tire):
    def forces(s, a, load, friction):
        found = tire.forces(s, a, load, friction=friction)
        return [found.F_x, found.F_y]

    return forces


def plain(curve):
    return {name: getattr(curve, name) for name in ("B", "C", "D", "E", "S_h", "S_v")}


def test_slip_ratio_forward_reverse_and_at_standstill():
    points = uniform(0, 400, (-3.0, 40.0), (-20.0, 160.0), (0.2, 0.45))
    agree(lambda *z: [slip_ratio(*z)], lambda *z: [tires.soft_slip(*z)], points)
    fast = uniform(1, 400, (5.0, 40.0), (20.0, 160.0), (0.2, 0.45))
    agree(lambda *z: [slip_ratio(*z)], lambda *z: [tires.sharp_slip(*z)], fast, tol=2e-4)  # rounded where they meet


def test_slip_of_rigs_and_of_the_tread():
    v, rolling = uniform(2, 200, (1.0, 40.0), (1.0, 40.0)).T
    s, alpha = tires.sharp_slip(v, rolling, 1.0), 0.2
    np.testing.assert_allclose(practical_slip(s), (rolling - v) / v, rtol=1e-12)
    sigma_x, sigma_y = tread_slip(s, alpha)
    np.testing.assert_allclose(sigma_x, (rolling - v) / rolling, rtol=1e-11)
    np.testing.assert_allclose(sigma_y, v * np.tan(alpha) / rolling, rtol=1e-12)
    agree(tread_slip, tires.tread_slip, uniform(3, 200, (-0.99, 0.99), (-0.8, 0.8)))


def test_linear():
    tire = LinearTire(C_alpha=61e3, C_s=97e3)
    agree(x_and_y(tire), lambda s, a, load, friction: [97e3 * s, 61e3 * a], uniform(4, 50, *SLIPS))


@pytest.mark.parametrize("tire", [SOUSA_TABLE_6_2, SOUSA_TABLE_6_8], ids=["6.2", "6.8"])
def test_simple_magic_formula_reads_each_direction_from_its_own_curve(tire):
    x, y = plain(tire.longitudinal), plain(tire.lateral)

    def forces(s, a, load, friction):
        return [friction * load * tires.magic(s, **x), friction * load * tires.magic(a, **y)]

    agree(x_and_y(tire), forces, uniform(5, 300, *SLIPS))


def test_shifts_of_the_magic_formula():
    """At zero shifted slip the force is the vertical shift, with the slope B C D."""
    curve = MagicCurve(B=11.0, C=1.6, D=1.1, E=-0.7, S_h=0.02, S_v=-0.05)
    assert curve(-0.02) == pytest.approx(-0.05, abs=1e-14)
    assert (curve(-0.02 + 1e-6) - curve(-0.02 - 1e-6)) / 2e-6 == pytest.approx(11.0 * 1.6 * 1.1, rel=1e-6)
    agree(lambda x: [curve(x)], lambda x: [tires.magic(x, **plain(curve))], uniform(6, 200, (-1.0, 1.0)))


@pytest.mark.parametrize("tire", [SOUSA_TABLE_6_2, SOUSA_TABLE_6_8], ids=["6.2", "6.8"])
def test_friction_ellipse_scales_each_direction_by_its_own_curve(tire):
    shared = SimpleMagicFormula(longitudinal=tire.longitudinal, lateral=tire.lateral, combined="ellipse")

    def forces(s, a, load, friction):
        mu = tires.similarity(s, a, plain(tire.longitudinal), plain(tire.lateral))
        return [friction * load * m for m in mu]

    agree(x_and_y(shared), forces, uniform(7, 300, *SLIPS))
    assert shared.forces(0.0, 0.0, 4000.0)[:2] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_the_ellipse_leaves_pure_slip_as_it_is():
    tire = SimpleMagicFormula(
        longitudinal=SOUSA_TABLE_6_2.longitudinal, lateral=SOUSA_TABLE_6_2.lateral, combined="ellipse"
    )
    slip = np.array([-0.8, -0.1, -0.01, 0.01, 0.05, 0.3])
    for mine, pure in ((tire, SOUSA_TABLE_6_2),):
        np.testing.assert_allclose(mine.forces(slip, 0.0, 6131.0).F_x, pure.forces(slip, 0.0, 6131.0).F_x, rtol=1e-10)
        np.testing.assert_allclose(mine.forces(0.0, slip, 6131.0).F_y, pure.forces(0.0, slip, 6131.0).F_y, rtol=1e-10)


@pytest.mark.parametrize("C_s", [60e3, 110e3])
def test_brush_is_the_sum_of_its_bristles(C_s):
    car = dict(C_alpha=60e3, C_s=C_s, mu=0.9, half_length=0.06)
    tire = BrushTire(**car)
    points = uniform(8, 60, (-0.4, 0.4), (-0.35, 0.35), (1000.0, 8000.0))
    wanted = np.array([tires.brush(s, a, load, **car) for s, a, load in points])
    found = np.array([[f.F_x, f.F_y, f.M_z] for f in (tire.forces(*point) for point in points)])
    assert np.abs((found - wanted) / np.abs(wanted).max(axis=0)).max() < 1e-6
    slick = BrushTire(**(car | {"mu": 0.9 * 0.4}))
    assert tire.forces(0.05, 0.1, 4000.0, friction=0.4) == slick.forces(0.05, 0.1, 4000.0)


def test_dugoff():
    car = dict(C_alpha=60e3, C_s=90e3, mu=0.9)

    def forces(s, a, load, friction):
        return tires.dugoff(s, a, load, **(car | {"mu": 0.9 * friction}))

    agree(x_and_y(DugoffTire(**car)), forces, uniform(9, 300, (-0.7, 0.7), (-0.6, 0.6), *SLIPS[2:]), tol=1e-9)


# ---- Magic Formula of tire files ------------------------------------------------------------------------------------

MANY = uniform(10, 400, (-0.6, 0.6), (-0.5, 0.5), (600.0, 9000.0), (-0.12, 0.12), (180e3, 280e3))


def test_magic_formula_6_1():
    def ours(kappa, alpha, load, camber, pressure):
        f = MF61.evaluate(kappa, alpha, load, axes="ISO-W", camber=camber, pressure=pressure)
        return [f.F_x, f.F_y, f.M_x, f.M_z]

    agree(ours, lambda *z: magic_formula.mf61(SHARED | ONLY_61, *z), MANY, tol=1e-9)


def test_magic_formula_5_2():
    def ours(kappa, alpha, load, camber):
        f = MF52.evaluate(kappa, alpha, load, axes="ISO-W", camber=camber, pressure=SHARED["NOMPRES"])
        return [f.F_x, f.F_y]

    agree(ours, lambda *z: magic_formula.mf52(SHARED | ONLY_52, *z), MANY[:, :4], tol=1e-9)


@pytest.mark.parametrize(
    ("axes", "slip", "side", "up"),
    [("ISO-W", 1, 1, 1), ("SAE", -1, -1, -1), ("adapted SAE", 1, -1, -1)],
)
def test_axis_systems(axes, slip, side, up):
    """TYDEX W has y to the left and z up; SAE has y to the right and z down, so F_y, M_y and M_z turn round.

    The slip angle is the angle to the velocity about z: SAE turns it round, adapted SAE turns it back.
    """
    kappa, alpha, load, camber, pressure = MANY.T
    F_x, F_y, M_x, M_z = magic_formula.mf61(SHARED | ONLY_61, kappa, alpha, load, camber, pressure)
    found = MF61.evaluate(kappa, slip * alpha, load, axes=axes, camber=camber, pressure=pressure)
    for mine, wanted in ((found.F_x, F_x), (found.F_y, side * F_y), (found.M_x, M_x), (found.M_z, up * M_z)):
        np.testing.assert_allclose(mine, wanted, atol=1e-9 * np.abs(wanted).max())


def test_a_tire_of_a_vehicle_counts_slip_as_the_vehicle_does():
    """Positive slip angle gives a force to the left, and s counts against the wheel when it drives."""
    s, alpha, load, camber, _ = MANY.T
    kappa = np.where(s > 0, s / (1 - s), s)
    wanted = magic_formula.mf61(SHARED | ONLY_61, kappa, -alpha, load, camber, SHARED["INFLPRES"])
    f = MF61.forces(s, alpha, load, camber=camber)
    for mine, oracle in zip((f.F_x, f.F_y, f.M_x, f.M_z), wanted, strict=True):
        np.testing.assert_allclose(mine, oracle, atol=1e-9 * np.abs(oracle).max())


def test_the_tire_of_the_other_side_is_its_mirror_image():
    s, alpha, load, camber, _ = MANY.T
    one, other = (
        MF61.forces(s, alpha, load, camber=camber),
        MF61.mounted("RIGHT").forces(s, -alpha, load, camber=-camber),
    )
    for name, sign in (("F_x", 1), ("F_y", -1), ("M_x", -1), ("M_z", -1)):
        np.testing.assert_allclose(getattr(other, name), sign * getattr(one, name), rtol=1e-12)


# ---- networks -------------------------------------------------------------------------------------------------------

IN = Scaling(offset=[0.1, 3000.0, 0.0], factor=[0.5, 2500.0, -0.2])
OUT = Scaling(offset=[0.3, -1.0], factor=[0.7, 2.0])


def rows(network, oracle):
    """Numbers, one sample at a time, and symbols against the oracle on scaled values."""
    points = uniform(11, 40, (-0.4, 0.6), (500.0, 5500.0), (-0.2, 0.2))
    x = ca.SX.sym("x", 3)
    symbolic = ca.Function("f", [x], [network(x)])
    for point in points:
        wanted = np.array(oracle((point - IN.offset) / IN.factor)) * OUT.factor + OUT.offset
        np.testing.assert_allclose(network(point), wanted, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(np.asarray(symbolic(point)).ravel(), wanted, rtol=1e-11, atol=1e-12)
    batch = network(points.T)
    np.testing.assert_allclose(batch[:, 7], network(points[7]), rtol=1e-13)


@pytest.mark.parametrize("activation", ["sigmoid", "tanh", "elu"])
def test_perceptron(activation):
    rng = np.random.default_rng(12)
    shapes = ((4, 3), (5, 4), (2, 5))
    weights, biases = [rng.standard_normal(s) for s in shapes], [rng.standard_normal(s[0]) for s in shapes]
    network = MLP(weights=weights, biases=biases, activation=activation, input_scaling=IN, output_scaling=OUT)
    rows(network, lambda z: tires.perceptron(z, weights, biases, activation))


@pytest.mark.parametrize("kernel", ["gaussian", "cubic", "thin plate", "multiquadric"])
def test_radial_basis_functions(kernel):
    rng = np.random.default_rng(13)
    parts = dict(
        centres=rng.standard_normal((6, 3)), widths=rng.uniform(0.5, 2, 6), weights=rng.standard_normal((2, 6))
    )
    network = RBF(**parts, kernel=kernel, input_scaling=IN, output_scaling=OUT)
    rows(network, lambda z: tires.radial_basis(z, **parts, kernel=kernel))


@pytest.mark.parametrize("activation", ["sigmoid", "tanh", "elu"])
def test_neural_tire_is_its_networks_and_holds_beyond_its_data(activation):
    rng = np.random.default_rng(14)
    curves, nets = {}, {}
    for name, reach in (("longitudinal", 0.4), ("lateral", 0.3)):
        weights, biases = [rng.standard_normal((5, 1)), rng.standard_normal((1, 5))], [rng.standard_normal(5), [0.1]]
        nets[name] = (reach, weights, biases)
        scaling = Scaling.between([-reach], [reach])
        network = MLP(weights=weights, biases=biases, activation=activation, input_scaling=scaling)
        curves[name] = NeuralCurve(network=network)

    def mu(name, slip):
        reach, weights, biases = nets[name]
        return np.array([tires.perceptron([z], weights, biases, activation)[0] for z in np.clip(slip / reach, -1, 1)])

    def forces(s, a, load, friction):
        return [friction * load * mu("longitudinal", s), friction * load * mu("lateral", a)]

    agree(x_and_y(NeuralTire(**curves)), forces, uniform(15, 200, *SLIPS))
