"""Black-box models against the difference equations of `tests.oracles.black_box`."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.black_box.narx import NARXModel
from slipangle.models.black_box.networks import MLP
from slipangle.models.black_box.polynomial import PolynomialModel
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.wrappers.hybrid import OffsetModel
from slipangle.models.wrappers.multi_arx import speed_weights
from slipangle.reproduce.plants.narendra import respond
from tests.oracles import black_box
from tests.oracles.compare import agree, uniform

INPUTS, OUTPUTS = ("delta", "v_x"), ("v_y", "r")


def signals(n=60, nu=2, ny=2, seed=0):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n, nu)), rng.standard_normal((n, ny))


def record(u, y, outputs=OUTPUTS):
    return Dataset.from_arrays(
        {n: u[:, i] for i, n in enumerate(INPUTS)}, {n: y[:, i] for i, n in enumerate(outputs)}, 0.05
    )


def predicted(model, u, y):
    """One step ahead from the state zero, sample by sample."""
    x, found = np.zeros(model.n_states), []
    for u_k, y_k in zip(u, y, strict=True):
        found.append(np.asarray(model.output(x, u_k)).ravel())
        x = model.step(model.correct(x, u_k, y_k), u_k)
    return np.array(found)


@pytest.mark.parametrize("nk", [0, 1, 3])
def test_arx(nk):
    rng = np.random.default_rng(1)
    A, B, c = 0.2 * rng.standard_normal((3, 2, 2)), rng.standard_normal((2, 2, 2)), [0.3, -0.2]
    model = ARXModel(A=A, B=B, c=c, nk=nk, dt=0.05, inputs=INPUTS, outputs=OUTPUTS)
    u, y = signals()
    start = max(3, nk + 1) + (nk == 0)
    run = model.simulate(record(u, y))
    assert model.memory == start
    np.testing.assert_allclose(run.y, black_box.arx(A, B, c, nk, u, y[:start]), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("nk", [1, 2])
def test_narx(nk):
    rng = np.random.default_rng(2)
    weights = [0.3 * rng.standard_normal((6, 10)), rng.standard_normal((2, 6))]
    biases = [rng.standard_normal(6), [0.1, -0.2]]
    network = MLP(weights=weights, biases=biases, activation="tanh")
    model = NARXModel(network=network, na=2, nb=3, nk=nk, dt=0.05, inputs=INPUTS, outputs=OUTPUTS)
    u, y = signals()
    run = model.simulate(record(u, y))
    wanted = black_box.narx(weights, biases, "tanh", 2, 3, nk, u, y[: nk + 2])
    np.testing.assert_allclose(run.y, wanted, rtol=1e-9, atol=1e-10)


POLYNOMIALS = {
    "ARMAX": dict(A=[-1.2, 0.5], B=[[0.4, 0.1], [0.3]], C=[-0.5, 0.2], D=[], F=[[], []], nk=(1, 2)),
    "Box-Jenkins": dict(A=[], B=[[0.5, 0.2], [0.1]], C=[0.4], D=[-0.8, 0.1], F=[[-0.9], [-1.2, 0.5]], nk=(1, 3)),
    "output error, direct": dict(A=[], B=[[0.5, 0.2], [0.1, 0.3]], C=[], D=[], F=[[-0.9], [0.2]], nk=(0, 1)),
    "all of it": dict(A=[-0.6], B=[[0.5], [0.1]], C=[0.3, 0.1], D=[0.2], F=[[-0.5], [0.4, 0.1]], nk=(2, 1)),
}


@pytest.mark.parametrize("parts", POLYNOMIALS.values(), ids=POLYNOMIALS.keys())
def test_polynomial_models(parts):
    offsets = dict(u_offset=[0.2, -0.1], y_offset=0.7)
    model = PolynomialModel(**parts, **offsets, dt=0.05, inputs=INPUTS, outputs=("r",))
    u, y = signals(ny=1)
    free, ahead = black_box.polynomial(**parts, u=u, y=y[:, 0], **offsets)
    np.testing.assert_allclose(predicted(model, u, y)[:, 0], ahead, rtol=1e-9, atol=1e-11)
    x, run = np.zeros(model.n_states), []
    for row in u:
        run.append(float(np.asarray(model.output(x, row)).ravel()[0]))
        x = model.step(x, row)
    np.testing.assert_allclose(run, free, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("singular", [False, True], ids=["regular", "singular"])
def test_state_space_in_innovation_form(singular):
    rng = np.random.default_rng(3)
    A = 0.4 * rng.standard_normal((3, 3))
    if singular:  # a state that is a pure delay
        A[2] = [1.0, 0.0, 0.0]
        A[:, 2] = 0.0
    parts = dict(A=A, B=rng.standard_normal((3, 2)), C=rng.standard_normal((2, 3)), D=rng.standard_normal((2, 2)))
    parts |= dict(K=0.2 * rng.standard_normal((3, 2)), u_offset=[0.3, -1.0], y_offset=[2.0, 0.1])
    model = StateSpaceModel(**parts, dt=0.05, inputs=INPUTS, outputs=OUTPUTS)
    u, y = signals()
    np.testing.assert_allclose(
        predicted(model, u, y), black_box.innovation_form(u=u, y=y, **parts), rtol=1e-8, atol=1e-9
    )
    predictor, z = model.predictor, np.hstack([u - parts["u_offset"], y - parts["y_offset"]])
    direct = predictor.respond(np.zeros(3), z)[0] + parts["y_offset"]
    np.testing.assert_allclose(direct, black_box.innovation_form(u=u, y=y, **parts), rtol=1e-8, atol=1e-9)


def test_offsets_of_sensors():
    """The model sees u - u_0; its output is read as y + y_0."""
    plain = ARXModel(A=[-0.5], B=[1.0], dt=0.05, inputs=("delta",), outputs=("r",))
    model = OffsetModel(model=plain, inputs_at_zero={"delta": 0.1}, outputs_at_zero={"r": -0.3})
    rng = np.random.default_rng(4)
    u, y = rng.standard_normal((30, 1)), rng.standard_normal((30, 1))
    data = Dataset.from_arrays({"delta": u[:, 0]}, {"r": y[:, 0]}, 0.05)
    wanted = black_box.arx([[[-0.5]]], [[[1.0]]], [0.0], 1, u - 0.1, y[:1] + 0.3) - 0.3
    np.testing.assert_allclose(model.simulate(data).y, wanted, rtol=1e-10, atol=1e-12)


def test_gains_and_lags_of_sensors():
    """The model sees the solution of lag z' = gain (u - u_0) - z between parabolas, from rest at its first sample."""
    plain = ARXModel(A=[-0.5], B=[1.0], dt=0.05, inputs=("delta",), outputs=("r",))
    model = OffsetModel(model=plain, inputs_at_zero={"delta": 0.1}, gains={"delta": 1.2}, lags={"delta": 0.08})
    u, y = np.random.default_rng(4).standard_normal((2, 30, 1))
    z = black_box.first_order_lag(1.2 * (u[:, 0] - 0.1), 0.08, 0.05)[:, None]
    data = Dataset.from_arrays({"delta": u[:, 0]}, {"r": y[:, 0]}, 0.05)
    wanted = black_box.arx([[[-0.5]]], [[[1.0]]], [0.0], 1, z, y[:1])
    np.testing.assert_allclose(model.simulate(data).y, wanted, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(model.behind(data)["delta"], z[:, 0], rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("shape", ["triangular", "smooth"])
def test_weights_of_models_over_speed(shape):
    speeds = (8.0, 14.0, 20.0, 30.0)
    agree(
        lambda v: speed_weights(v, speeds, shape),
        lambda v: black_box.speed_weights(v, speeds, smooth=shape == "smooth"),
        uniform(5, 200, (0, 40)),
    )


def test_the_system_of_narendra_and_parthasarathy():
    u = np.random.default_rng(6).uniform(-1, 1, 300)
    np.testing.assert_allclose(respond(u), black_box.narendra(u), rtol=1e-12, atol=1e-14)
