"""Neural tires: numbers equal symbols and batches, held outside their range, shared on the ellipse."""

import casadi as ca
import numpy as np
import pytest

from slipangle.errors import ParameterError
from slipangle.models.black_box.networks import MLP, RBF, Scaling
from slipangle.models.tires.neural import NeuralCurve, NeuralTire
from tests.models.all_models import neural_tire

PLAIN = neural_tire()
ELLIPSE = neural_tire(combined="ellipse")


def with_inputs(*inputs):
    n = len(inputs)
    net = MLP.random(
        (n, 4, 1),
        activation="tanh",
        seed=n,
        input_scaling=Scaling.between([-0.3, 1e3, -0.1][:n], [0.3, 6e3, 0.1][:n]),
    )
    return NeuralCurve(network=net, inputs=inputs)


LOADED = NeuralTire(longitudinal=with_inputs("slip", "load"), lateral=with_inputs("slip", "load", "camber"))
RADIAL = NeuralTire(
    longitudinal=NeuralCurve(
        network=RBF(centres=[[-0.2], [0.2]], widths=[0.1, 0.1], weights=[[1.0, -1.0]], input_scaling=Scaling.none(1))
    ),
    lateral=with_inputs("slip"),
)
SIGMOID = NeuralCurve(
    network=MLP.random(
        (2, 3, 2, 1),
        activation="sigmoid",
        seed=3,
        input_scaling=Scaling.between([-0.2, 1e3], [0.3, 6e3]),
        output_scaling=Scaling.between([-1.5], [1.1]),
    ),
    inputs=("slip", "load"),
)
DEEP = NeuralTire(longitudinal=SIGMOID, lateral=SIGMOID)
EVERY = pytest.mark.parametrize(
    "tire", [PLAIN, ELLIPSE, LOADED, RADIAL, DEEP], ids=["plain", "ellipse", "load, camber", "radial", "sigmoid"]
)


@EVERY
@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_symbols_equal_numbers_and_batches(tire, kind):
    rng = np.random.default_rng(0)
    at = rng.uniform([-0.4, -0.4, 500, -0.15], [0.4, 0.4, 7e3, 0.15], (40, 4))
    batch = tire.forces(at[:, 0], at[:, 1], at[:, 2], camber=at[:, 3], friction=0.7)
    x = kind.sym("x", 4)
    f = tire.forces(x[0], x[1], x[2], camber=x[3], friction=0.7)
    function = ca.Function("f", [x], [ca.vertcat(f.F_x, f.F_y)])
    for k, row in enumerate(at):
        single = tire.forces(*row[:3], camber=row[3], friction=0.7)
        expected = (batch.F_x[k], batch.F_y[k])
        assert (float(single.F_x), float(single.F_y)) == pytest.approx(expected, rel=1e-12, abs=1e-9)
        assert np.asarray(function(row)).ravel() == pytest.approx(expected, rel=1e-12, abs=1e-9)


@EVERY
def test_jacobian_is_finite_and_right(tire):
    x = ca.SX.sym("x", 3)
    f = tire.forces(x[0], x[1], x[2])
    y = ca.vertcat(f.F_x, f.F_y)
    jacobian = ca.Function("j", [x], [ca.jacobian(y, x)])
    value = ca.Function("y", [x], [y])
    for at in ([0.05, 0.1, 3e3], [-0.1, 0.02, 2e3]):
        exact = np.asarray(jacobian(at))
        for k, h in enumerate((1e-6, 1e-6, 1e-2)):
            step = np.eye(3)[k] * h
            difference = (np.asarray(value(at + step)) - np.asarray(value(at - step))).ravel() / (2 * h)
            assert exact[:, k] == pytest.approx(difference, rel=1e-4, abs=1e-2)
    assert np.isfinite(np.asarray(jacobian([0.0, 0.0, 3e3]))).all()


def test_force_is_friction_times_load():
    slip = np.linspace(-0.5, 0.5, 11)
    assert PLAIN.forces(slip, 0.0, 4e3).F_x == pytest.approx(4e3 * PLAIN.longitudinal(slip))
    assert PLAIN.forces(0.0, slip, 4e3, friction=0.5).F_y == pytest.approx(2e3 * PLAIN.lateral(slip))
    assert PLAIN.longitudinal(slip) == pytest.approx(np.tanh(20 * slip), abs=1e-12)


def test_held_or_extrapolated_outside_the_training_range():
    net = MLP(weights=[[[1.0]]], biases=[[0.0]], input_scaling=Scaling.between([-0.2], [0.2]))
    held, free = NeuralCurve(network=net), NeuralCurve(network=net, outside="extrapolate")
    assert held.range == pytest.approx((-0.2, 0.2))
    slip = np.array([-0.5, -0.2, 0.1, 0.4])
    assert held(slip) == pytest.approx([-1, -1, 0.5, 1])
    assert free(slip) == pytest.approx([-2.5, -1, 0.5, 2])


def test_ellipse_bounds_the_resultant_and_keeps_pure_slip():
    slip = np.linspace(-0.6, 0.6, 61)
    pure = ELLIPSE.forces(slip, 0.0, 1.0)
    assert pure.F_x == pytest.approx(PLAIN.longitudinal(slip), abs=1e-6)
    assert np.abs(pure.F_y).max() < 1e-6
    s, a = np.meshgrid(slip, np.linspace(-0.8, 0.8, 41))
    both = ELLIPSE.forces(s, a, 1.0)
    assert ((both.F_x / 1.0) ** 2 + (both.F_y / 0.9) ** 2).max() <= 1 + 1e-9
    free = PLAIN.forces(s, a, 1.0)
    assert ((free.F_x / 1.0) ** 2 + (free.F_y / 0.9) ** 2).max() > 1.9


def test_load_changes_friction_where_it_is_an_input():
    light, heavy = (LOADED.forces(0.1, 0.1, load) for load in (1.5e3, 5e3))
    assert light.F_x / 1.5e3 != pytest.approx(heavy.F_x / 5e3, rel=1e-3)
    assert PLAIN.forces(0.1, 0.1, 1.5e3).F_x / 1.5e3 == pytest.approx(PLAIN.forces(0.1, 0.1, 5e3).F_x / 5e3)


def test_jax_tracers():
    jax = pytest.importorskip("jax")
    found = jax.jit(lambda s, a, f: ELLIPSE.forces(s, a, f)[:2])(0.05, 0.1, 3e3)
    expected = ELLIPSE.forces(0.05, 0.1, 3e3)
    assert [float(v) for v in found] == pytest.approx([float(expected.F_x), float(expected.F_y)], rel=1e-4)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: NeuralCurve(network=MLP.random((2, 2, 1))), "2 inputs and 1 outputs; expected 1 inputs"),
        (lambda: NeuralCurve(network=MLP.random((1, 2, 2))), "1 inputs and 2 outputs"),
        (
            lambda: NeuralCurve(network=MLP.random((1, 1)), inputs=("speed",)),
            "'speed'.*there are 'camber', 'load', 'slip'",
        ),
        (lambda: NeuralCurve(network=MLP.random((2, 1)), inputs=("load", "slip")), "expected 'slip' first"),
        (lambda: NeuralCurve(network=MLP.random((1, 1)), outside="clip"), "there are 'extrapolate', 'hold'"),
        (lambda: neural_tire(combined="circle"), "combined is 'circle'"),
    ],
)
def test_mistakes(make, message):
    with pytest.raises(ParameterError, match=message):
        make()
