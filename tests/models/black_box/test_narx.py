"""NARX: the state holds the right lags, compiled C equals the equations, a network of identity weights is an ARX."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.data.dataset import Dataset
from slipangle.errors import ModelWarning, ParameterError, SimulationError
from slipangle.models.black_box import model as black_box
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.black_box.narx import NARXModel
from slipangle.models.black_box.networks import MLP, RBF, Scaling
from slipangle.models.model import Model

SHAPES = [  # na, nb, nk, outputs, inputs, hidden
    (3, 2, 1, 1, 1, (50, 50, 50)),
    (1, 1, 1, 1, 1, (7,)),
    (1, 1, 1, 2, 1, ()),
    (2, 3, 4, 2, 3, (17, 70)),
    (2, 1, 2, 5, 1, (8,)),
    (4, 5, 1, 1, 2, (120,)),
]


def make(na, nb, nk, ny, nu, hidden, activation="elu", seed=0, straight=False):
    rng = np.random.default_rng(seed)
    n_in = na * ny + nb * nu
    net = MLP.random(
        (n_in, *hidden, ny),
        activation=activation,
        seed=seed,
        input_scaling=Scaling(offset=rng.normal(size=n_in), factor=1.5 + rng.random(n_in)),
        output_scaling=Scaling(offset=rng.normal(size=ny), factor=0.3 + 0.2 * rng.random(ny)),
    )
    if not hidden:
        net = replace(net, weights=tuple(0.2 * w for w in net.weights))
    if straight:
        net = replace(net, skip=0.1 * rng.normal(size=(ny, n_in)))
    return NARXModel(
        network=net,
        na=na,
        nb=nb,
        nk=nk,
        dt=0.1,
        inputs=tuple(f"u{i}" for i in range(nu)),
        outputs=tuple(f"y{i}" for i in range(ny)),
    )


def noise(model, n=200, seed=1):
    rng = np.random.default_rng(seed)
    return Dataset.from_arrays(
        {k: rng.normal(size=n) for k in model.inputs}, {k: rng.normal(size=n) for k in model.outputs}, model.dt
    )


@pytest.mark.parametrize("activation", ["elu", "tanh", "sigmoid"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("straight", [False, True], ids=["layers", "and a linear path"])
def test_free_run_is_the_difference_equation(shape, activation, straight):
    """Written out here once more with plain indices, independent of the state and of the C code."""
    model = make(*shape, activation=activation, straight=straight)
    na, nb, nk = shape[:3]
    data = noise(model)
    u, y = data.u, data.y.copy()
    for k in range(model.memory, len(y)):
        lags = [y[k - i] for i in range(1, na + 1)] + [u[k - j] for j in range(nk, nk + nb)]
        y[k] = model.network(np.concatenate(lags))
    assert model.simulate(data).y == pytest.approx(y, rel=1e-9, abs=1e-9)


@pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
@pytest.mark.parametrize("activation", ["elu", "tanh", "sigmoid"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_compiled_equals_interpreted(shape, activation):
    model = make(*shape, activation=activation)
    data = noise(model, n=60)
    x0, u = model.initial_state(data.head(model.memory)), data.u[model.memory - 1 :]
    assert model._compiled[0] is not None
    assert model.free_run(x0, u) == pytest.approx(Model.free_run(model, x0, u), rel=1e-12, abs=1e-13)


@pytest.mark.parametrize("activation", ["elu", "tanh", "sigmoid"])
def test_compiled_activations_over_their_whole_range(activation):
    """One neuron with weight 1, driven far into saturation on both sides."""
    net = MLP(weights=[[[0.0, 1.0]], [[1.0]]], biases=[[0.0], [0.0]], activation=activation)
    model = NARXModel(network=net, na=1, nb=1, dt=1.0, inputs=("u",), outputs=("y",))
    size = np.concatenate([[0.0], np.logspace(-12, 3, 200)])
    u = np.concatenate([-size, size])
    data = Dataset.from_arrays({"u": u}, {"y": np.zeros(len(u))}, 1.0)
    expected = net(np.vstack([np.zeros(len(u)), u]))[0]
    assert model.simulate(data).y[1:, 0] == pytest.approx(expected[:-1], rel=1e-15, abs=4e-16)


def test_linear_network_is_an_arx_model():
    rng = np.random.default_rng(0)
    A, B, c = 0.2 * rng.normal(size=(3, 2, 2)), rng.normal(size=(2, 2, 1)), rng.normal(size=2)
    names = {"dt": 0.1, "inputs": ("delta",), "outputs": ("v_y", "r")}
    linear = ARXModel(A=A, B=B, c=c, nk=2, **names)
    net = MLP(weights=[np.hstack([*(-A), *B])], biases=[c])
    model = NARXModel(network=net, na=3, nb=2, nk=2, **names)
    data = noise(model)
    assert model.states == linear.states
    assert model.simulate(data).y == pytest.approx(linear.simulate(data).y, rel=1e-9, abs=1e-9)
    assert model.predict(data, 3).y == pytest.approx(linear.predict(data, 3).y, rel=1e-9, abs=1e-9)


def test_radial_network_runs_without_c():
    rng = np.random.default_rng(0)
    net = RBF(
        centres=rng.normal(size=(6, 3)), widths=np.full(6, 2.0), weights=rng.normal(size=(1, 6)), kernel="gaussian"
    )
    model = NARXModel(network=net, na=2, nb=1, dt=0.1, inputs=("u",), outputs=("y",))
    data = noise(model)
    y = data.y.copy()
    for k in range(2, len(y)):
        y[k] = net(np.concatenate([y[k - 1], y[k - 2], data.u[k - 1]]))
    assert model.simulate(data).y == pytest.approx(y, rel=1e-9, abs=1e-9)
    with pytest.raises(ParameterError, match="RBF"):
        model.source()


def test_without_a_compiler_the_same_numbers_and_a_word_on_long_runs(monkeypatch):
    model = make(*SHAPES[0])
    data = noise(model)
    fast = model.simulate(data).y
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    plain = make(*SHAPES[0])
    assert plain._compiled[0] is None
    assert plain.simulate(data).y == pytest.approx(fast, rel=1e-9, abs=1e-9)
    monkeypatch.setattr(black_box, "_LONG", 100)
    with pytest.warns(ModelWarning, match="no C compiler was found.*ziglang"):
        plain.simulate(data)


@pytest.mark.parametrize("gain", [30.0, np.inf])
def test_divergence_is_not_swallowed_by_the_activation(gain):
    net = MLP(weights=[[[min(gain, 1e200), 1.0]], [[30.0]]], biases=[[0.0], [0.0]], activation="elu")
    model = NARXModel(network=net, na=1, nb=1, dt=0.1, inputs=("u",), outputs=("y",))
    data = Dataset.from_arrays({"u": np.ones(400)}, {"y": np.ones(400)}, 0.1)
    with pytest.raises(SimulationError, match="sample"):
        model.simulate(data)


@pytest.mark.parametrize("name", ["na", "nb", "nk"])
def test_orders_below_one(name):
    model = make(*SHAPES[1])
    with pytest.raises(ParameterError, match=f"{name} is 0"):
        replace(model, **{name: 0})


def test_network_that_does_not_fit_the_lags():
    with pytest.raises(ParameterError, match="expected 4 and 1 for 3 lags of 1 outputs and 1 lags of 1 inputs"):
        replace(make(*SHAPES[1]), na=3)


@pytest.mark.parametrize("steps", [1, 2, 7])
@pytest.mark.parametrize("shape", SHAPES[1:4], ids=str)
def test_prediction_in_blocks_equals_restarted_free_runs(shape, steps, monkeypatch):
    """k steps ahead of the measured output at every sample: start a free run there."""
    model = make(*shape)
    data = noise(model, n=60)
    monkeypatch.setattr(black_box, "_BLOCK", 16)
    predicted = model.predict(data, steps)
    m = model.memory
    for k in range(m + steps - 1, 60):
        window = data.rows(k - steps + 1 - m, k + 1)
        assert predicted.y[k] == pytest.approx(model.simulate(window).y[-1], rel=1e-9, abs=1e-9)
    assert predicted.predicted.sum() == 60 - m - steps + 1
    short = model.predict(data.head(m + 1))
    assert short.predicted.sum() == 1
