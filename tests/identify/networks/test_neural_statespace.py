"""Neural state space: finds a hidden state, its loss is its free run, its gain helps one step ahead."""

import warnings
from dataclasses import replace

import jax
import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ExcitationError, ModelWarning, ParameterError
from slipangle.identify.judge.validate import validate
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.networks import adam, windows
from slipangle.identify.networks.neural_statespace import GainOfNetwork, NeuralStateSpace, StateNetwork
from slipangle.identify.networks.problem import Stage
from slipangle.models.black_box.networks import Scaling
from slipangle.models.black_box.neural_statespace import NeuralStateSpaceModel

QUICK = (Stage(horizon=5, epochs=20, batch=20),)
SMALL = {"order": 2, "hidden": (6,), "stages": QUICK, "gain_stages": QUICK}


def duffing(n=1200, seed=0, noise=0.01):
    """Position of a mass on a hardening spring, in centimetres; the velocity is not measured."""
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.uniform(-1, 1, -(-n // 5)), 5)[:n]
    q, v, out = 0.0, 0.0, np.zeros(n)
    for k in range(n):
        out[k] = q
        for _ in range(10):
            q, v = q + 0.01 * v, v + 0.01 * (3 * force[k] - 1.5 * v - q - 2 * q**3)
    return Dataset.from_arrays(
        {"F": 100 + 50 * force}, {"q": 3 + 0.01 * (out + noise * rng.standard_normal(n))}, 0.1, name=f"spring {seed}"
    )


def quick(data, **more):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)  # so short a training may not improve at all
        return NeuralStateSpace(**SMALL | more).fit(data)


@pytest.fixture(scope="module")
def spring():
    return NeuralStateSpace(order=2, hidden=(16,), stages=(Stage(horizon=20, epochs=400, learning_rate=5e-3),)).fit(
        duffing(800)
    )


@pytest.fixture(scope="module")
def without_gain():
    return quick(duffing(200), gain_stages=())


def test_finds_the_hidden_state_of_a_nonlinear_spring(spring):
    verdict = validate(spring, duffing(seed=1))
    assert verdict.free_run_scores["q"].fit > 85
    linear = ARX(na=2, nb=2, offset=True).fit(duffing(noise=0.0))
    other = validate(linear, duffing(seed=1)).free_run_scores["q"].rmse
    assert verdict.free_run_scores["q"].rmse < 0.8 * other


def test_the_gain_helps_one_step_ahead(spring):
    verdict, without = (validate(m, duffing(seed=1)) for m in (spring, replace(spring, gain=None)))
    assert verdict.free_run_scores == without.free_run_scores
    assert verdict.one_step_scores["q"].rmse < 0.8 * without.one_step_scores["q"].rmse


def test_loss_score_and_gain_are_those_of_the_finished_model():
    """Free runs and one-step-ahead predictions of the returned model, window by window, in double precision."""
    data = duffing(90).with_channel("G", np.random.default_rng(0).normal(size=90)).select(inputs=["F", "G"])
    model = quick(data, lags=3, feedthrough=True, holdout=0.0, precision="double", emission_hidden=(4,))
    problem = StateNetwork(lags=3, activation="tanh", feedthrough=True)
    su, sy = Scaling.standard(data.u), Scaling.standard(data.y)
    params = tuple(windows.layers(net) for net in (model.transition, model.emission, model.encoder))
    rows = windows.window_starts(data, 3, 6)[::11]
    with adam.precision("double"):
        arrays = adam.to_device(windows.scaled(data, su, sy, data))
        gain = np.asarray(model.gain) * sy.factor
        tuned = GainOfNetwork(states=problem)
        loss, innovations = (jax.jit(p.loss, static_argnums=3) for p in (problem, tuned))
        found = [
            float(loss(params, arrays, rows, 6)),
            float(adam.score(problem, params, arrays)),
            float(innovations(gain, (arrays, params), rows, 6)),
            float(adam.score(tuned, gain, (arrays, params))),
        ]

    def errors(run):
        return run.error[run.predicted] / sy.factor

    pieces = [data.rows(k - 3, k + 6) for k in rows]
    expected = [
        np.mean([errors(model.simulate(p)) ** 2 for p in pieces]),
        np.sqrt(np.mean(errors(model.simulate(data)) ** 2)),
        np.mean([errors(model.predict(p)) ** 2 for p in pieces]),
        np.sqrt(np.mean(errors(model.predict(data)) ** 2)),
    ]
    assert found == pytest.approx(expected, rel=1e-9)
    assert model.fit_info.trials[0].score == pytest.approx(found[1], rel=1e-9)


@pytest.mark.slow  # the engine's part is tested with NARX
def test_same_seed_same_weights_and_experiments_stay_apart():
    data = join(duffing(100, seed=0), duffing(60, seed=1), duffing(80, seed=2))
    fits = [quick(data, seeds=(s,), holdout=0.3, gain_stages=()) for s in (0, 0, 1)]
    assert np.array_equal(fits[0].transition.parameters, fits[1].transition.parameters)
    assert not np.array_equal(fits[0].transition.parameters, fits[2].transition.parameters)


@pytest.mark.parametrize("feedthrough", [False, True])
@pytest.mark.parametrize("emission_hidden", [(), (4,)])
def test_training_starts_as_the_linear_state_space_of_the_same_order(feedthrough, emission_hidden):
    data = duffing(500, noise=0.002)
    settings = NeuralStateSpace(
        order=2, hidden=(6,), feedthrough=feedthrough, emission_hidden=emission_hidden, gain_stages=()
    )
    su, sy = Scaling.standard(data.u), Scaling.standard(data.y)
    units = windows.in_units(data, su, sy)
    start = settings._initial(0, 1, 1, settings._linear(units, units))
    channels = {"dt": data.dt, "inputs": data.inputs, "outputs": data.outputs}
    model = settings._model(start, su, sy, None, channels)
    linear = StateSpace(order=2, focus="simulation", offsets="output", direct=feedthrough)
    linear = linear.fit(units)
    linear = replace(linear, memory=5)  # samples that both start from
    ours, theirs = model.simulate(data).y, sy.undo(linear.simulate(units).y.T).T
    compared = slice(60 if feedthrough else 5, None)  # the encoder does not see the newest input
    assert ours[compared] == pytest.approx(theirs[compared], abs=1e-3 * np.std(data.y))
    assert np.std(ours - data.y) < 0.5 * np.std(data.y)


def test_an_open_order_is_that_of_the_linear_state_space():
    data = duffing(500)
    settled, chosen = NeuralStateSpace().settled(data)
    linear = StateSpace(order=tuple(range(1, 9)), focus="simulation", offsets="output", max_radius=1.0)
    choice = linear.choose_order(data.split(0.85)[0])
    assert settled == NeuralStateSpace(order=choice.order)
    assert settled.lags == 2 * choice.order + 1
    assert chosen.candidates == choice.candidates
    assert len(choice.refined) <= 5


def test_no_gain_on_request(without_gain):
    model = without_gain
    assert not model.gain.any()
    data = duffing(60, seed=3)
    assert model.predict(data, 1).y == pytest.approx(model.simulate(data).y, rel=1e-12)


@pytest.mark.slow  # the engine's part is tested with NARX
def test_diverging_training_keeps_the_best_and_says_so():
    stages = (*QUICK, Stage(horizon=5, epochs=200, learning_rate=1e30))
    with pytest.warns(ModelWarning, match="diverged"):
        model = NeuralStateSpace(**SMALL | {"stages": stages, "gain_stages": ()}).fit(duffing(200))
    assert np.isfinite(model.simulate(duffing(100, seed=4)).y).all()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"order": 0}, "order is 0"),
        ({"lags": -1}, "lags is -1"),
        ({"hidden": (0,)}, r"hidden is \(0,\)"),
        ({"activation": "relu"}, "'relu'"),
        ({"holdout": 0.7}, "holdout is 0.7"),
    ],
)
def test_bad_settings(settings, said):
    with pytest.raises(ParameterError, match=said):
        NeuralStateSpace(**SMALL | settings)


def test_constant_input():
    with pytest.raises(ExcitationError, match="'F'"):
        quick(duffing(200).with_channel("F", np.ones(200)))


def test_networks_that_do_not_fit_together(without_gain):
    model = without_gain
    assert isinstance(model, NeuralStateSpaceModel)
    with pytest.raises(ParameterError, match=r"encoder network has 9 inputs .* expected 7 and 2"):
        replace(model, lags=4)
    with pytest.raises(ParameterError, match="emission network"):
        replace(model, feedthrough=True)
    with pytest.raises(ParameterError, match=r"gain has shape \(1, 1\)"):
        replace(model, gain=[[1.0]])
