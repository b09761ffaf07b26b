"""Networks: against the equations, on symbols and batches, and what bad shapes say."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from slipangle.errors import NotFiniteError, ParameterError
from slipangle.models.black_box.networks import MLP, RBF, Scaling, activate, radial

KERNELS = ("gaussian", "cubic", "thin plate", "multiquadric")
ACTIVATIONS = ("sigmoid", "tanh", "elu")


def rbf(kernel, n_in=2, n_out=2, n=3, seed=1):
    rng = np.random.default_rng(seed)
    return RBF(
        centres=rng.uniform(-1, 1, (n, n_in)),
        widths=rng.uniform(0.2, 2, n),
        weights=rng.normal(size=(n_out, n)),
        kernel=kernel,
        input_scaling=Scaling.between([-3.0] * n_in, [5.0] * n_in),
        output_scaling=Scaling(offset=[1.0] * n_out, factor=[7.0] * n_out),
    )


def mlp(activation, sizes=(2, 3, 4, 2), seed=2):
    net = MLP.random(
        sizes,
        activation=activation,
        seed=seed,
        input_scaling=Scaling.between([-3.0] * sizes[0], [5.0] * sizes[0]),
        output_scaling=Scaling(offset=[1.0] * sizes[-1], factor=[7.0] * sizes[-1]),
    )
    return net.with_parameters(np.random.default_rng(seed).normal(size=net.n_parameters))


NETWORKS = {**{k: rbf(k) for k in KERNELS}, **{a: mlp(a) for a in ACTIVATIONS}, "linear": mlp("tanh", (2, 1))}
NETWORKS["linear path"] = replace(mlp("elu"), skip=[[0.5, -2.0], [1.5, 0.25]])
EVERY = pytest.mark.parametrize("net", NETWORKS.values(), ids=NETWORKS.keys())


def by_hand_rbf(net, x):
    """Eq. 4-15 neuron by neuron."""
    z = (x - 1.0) / 4.0
    out = np.zeros(net.n_outputs)
    for c, s, w in zip(net.centres, net.widths, net.weights.T, strict=True):
        d = np.linalg.norm(z - c)
        phi = {
            "gaussian": np.exp(-(d**2) / s**2),
            "cubic": d**3,
            "thin plate": d**2 / s * np.log(d / s),
            "multiquadric": np.sqrt(d**2 + s**2),
        }[net.kernel]
        out += w * phi
    return 1.0 + 7.0 * out


@pytest.mark.parametrize("kernel", KERNELS)
def test_rbf_is_equation_4_15(kernel):
    net = rbf(kernel)
    for x in np.random.default_rng(0).uniform(-3, 5, (20, 2)):
        assert net(x) == pytest.approx(by_hand_rbf(net, x), rel=1e-12)


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_mlp_is_equation_4_20(activation):
    net = mlp(activation)
    functions = {
        "sigmoid": lambda z: 1 / (1 + np.exp(-z)),
        "tanh": np.tanh,
        "elu": lambda z: np.where(z > 0, z, np.expm1(z)),
    }
    for x in np.random.default_rng(0).uniform(-3, 5, (20, 2)):
        h = (x - 1.0) / 4.0
        for w, b in zip(net.weights[:-1], net.biases[:-1], strict=True):
            h = functions[activation](w @ h + b)
        assert net(x) == pytest.approx(1.0 + 7.0 * (net.weights[-1] @ h + net.biases[-1]), rel=1e-12)


def test_a_linear_path_leads_past_the_layers():
    net = NETWORKS["linear path"]
    x = np.random.default_rng(0).uniform(-3, 5, (2, 20))
    past = 7.0 * np.array(net.skip) @ ((x - 1.0) / 4.0)
    assert net(x) == pytest.approx(replace(net, skip=None)(x) + past, rel=1e-13)
    assert net.straight @ (x - 1.0) == pytest.approx(past, rel=1e-12)
    assert net.n_parameters == replace(net, skip=None).n_parameters + 4
    assert np.array_equal(net.with_parameters(net.parameters).skip, net.skip)
    with pytest.raises(ParameterError, match=r"the skip weights have shape \(1, 2\); expected \(2, 2\)"):
        replace(net, skip=[[1.0, 2.0]])


@EVERY
def test_symbols_equal_numbers_and_batches(net):
    x = np.random.default_rng(5).uniform(-3, 5, (2, 30))
    batch = net(x)
    assert batch.shape == (net.n_outputs, 30)
    for kind in (ca.SX, ca.MX):
        s = kind.sym("x", 2)
        function = ca.Function("f", [s], [net(s)])
        for j in range(30):
            assert np.asarray(function(x[:, j])).ravel() == pytest.approx(batch[:, j], rel=1e-12, abs=1e-12)
    assert net(x[:, 3]) == pytest.approx(batch[:, 3], rel=1e-13)
    assert net(x.reshape(2, 5, 6)) == pytest.approx(batch.reshape(-1, 5, 6), rel=1e-13)


@EVERY
def test_derivatives_are_finite_at_a_centre(net):
    x = ca.SX.sym("x", 2)
    jacobian = ca.Function("j", [x], [ca.jacobian(net(x), x)])
    at = net.input_scaling.undo(net.centres[0]) if isinstance(net, RBF) else np.array([1.0, 1.0])
    exact = np.asarray(jacobian(at))
    assert np.isfinite(exact).all()
    h = 1e-5
    for j in range(2):
        step = np.eye(2)[j] * h
        difference = (net(at + step) - net(at - step)) / (2 * h)
        assert exact[:, j] == pytest.approx(difference, rel=1e-5, abs=1e-5)


@EVERY
def test_parameters_round_trip_and_can_be_symbols(net):
    same = net.with_parameters(net.parameters)
    x = np.array([0.3, -2.0])
    assert np.array_equal(same(x), net(x))
    theta = ca.SX.sym("theta", net.n_parameters)
    function = ca.Function("f", [theta], [net.with_parameters(theta)(ca.DM(x))])
    assert np.asarray(function(net.parameters)).ravel() == pytest.approx(net(x), rel=1e-12)


def test_large_arguments_do_not_overflow():
    for activation in ACTIVATIONS:
        assert np.isfinite(activate(np.array([-1e4, 1e4]), activation)).all()
    assert radial(0.0, 1.0, "thin plate") == 0.0
    assert float(activate(np.array(-800.0), "sigmoid")) == pytest.approx(0.0, abs=1e-15)


def test_jax_tracers():
    jax = pytest.importorskip("jax")
    for net in NETWORKS.values():
        x = np.array([0.3, -2.0])
        assert np.asarray(jax.jit(net)(x)) == pytest.approx(net(x), rel=1e-4)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: MLP(weights=[np.ones((2, 1)), np.ones((1, 3))], biases=[np.ones(2), np.ones(1)]),
            r"layer 1.*\(1, 2\)",
        ),
        (lambda: MLP(weights=[np.ones((2, 1))], biases=[]), "1 weight matrices and 0"),
        (lambda: MLP.random((1, 2, 1), activation="sigmoit"), "'sigmoid'"),
        (lambda: MLP.random((3,)), "layer sizes"),
        (lambda: RBF(centres=[[0.0]], widths=[1.0, 2.0], weights=[[1.0]]), "1 centres, 2 widths"),
        (lambda: RBF(centres=[[0.0]], widths=[-1.0], weights=[[1.0]]), "positive widths"),
        (lambda: RBF(centres=[[0.0]], widths=[1.0], weights=[[1.0]], kernel="cubik"), "'cubic'"),
        (lambda: RBF(centres=[0.0], widths=[1.0], weights=[[1.0]]), "1 dimensions; expected 2"),
        (lambda: Scaling(offset=[0.0], factor=[0.0]), "factor 0 is 0"),
        (lambda: Scaling(offset=[0.0], factor=[1.0, 2.0]), "1 offsets and 2 factors"),
        (lambda: rbf("cubic")(np.zeros((3, 4))), "3 inputs .* expected 2"),
        (lambda: rbf("cubic").with_parameters(np.zeros(4)), "4 parameters; expected 15"),
        (lambda: MLP.random((1, 2, 1), input_scaling=Scaling.none(2)), "input_scaling has 2 channels; expected 1"),
    ],
)
def test_bad_shapes_say_what_was_expected(make, message):
    with pytest.raises(ParameterError, match=message):
        make()


def test_weights_must_be_finite_and_stay_as_given():
    with pytest.raises(NotFiniteError, match="diverged"):
        MLP(weights=[[[np.nan]]], biases=[[0.0]])
    w = np.ones((1, 1))
    net = MLP(weights=[w], biases=[np.zeros(1)])
    w[0, 0] = 5.0
    assert net.weights[0][0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        net.weights[0][0, 0] = 2.0
