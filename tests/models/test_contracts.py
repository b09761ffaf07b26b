"""What holds for every Model: symbols equal numbers, derivatives are right, free runs see no measured output."""

from dataclasses import FrozenInstanceError, replace

import casadi as ca
import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.errors import MissingColumnError, ParameterError, SampleTimeError, SimulationError, TooShortError
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.black_box.narx import NARXModel
from slipangle.models.black_box.networks import MLP
from slipangle.models.fast import FastPaths, roll_out
from slipangle.models.wrappers.multi_arx import ParallelARX
from tests.models.all_models import ALL_MODELS, SIZE, typical

EVERY = pytest.mark.parametrize("model", ALL_MODELS.values(), ids=ALL_MODELS.keys())


def record(model, n=120, seed=3):
    """A data set with the model's channels: smooth random inputs, arbitrary outputs."""
    rng = np.random.default_rng(seed)
    smooth = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 9

    def channel(name):
        noise = np.convolve(rng.standard_normal(n + 4), smooth, "valid")
        size = SIZE.get(name, 1.0)
        return size * (1 + 0.1 * noise) if name in ("v_x", "omega_f", "omega_r") else size * 0.2 * noise

    outputs = {name: channel(name) for name in model.outputs if name not in model.inputs}
    extra = {n: channel(n) for n in model.states if n in SIZE and n not in outputs and n not in model.inputs}
    return Dataset.from_arrays({n: channel(n) for n in model.inputs}, outputs, model.dt, extra=extra)


@EVERY
@pytest.mark.parametrize("seed", range(5))
def test_symbolic_step_equals_numeric_step(model, seed):
    x, u = typical(model, seed)
    y = model.output(x, u)
    step, output, correct = model.functions
    for symbolic, numeric in (
        (step(x, u), model.step(x, u)),
        (output(x, u), y),
        (correct(x, u, y + 0.1), model.correct(x, u, y + 0.1)),
    ):
        assert np.asarray(symbolic).ravel() == pytest.approx(numeric, rel=1e-12, abs=1e-12)


@EVERY
def test_batch_equals_single(model):
    pairs = [typical(model, seed) for seed in range(4)]
    x, u = (np.stack(z, axis=1) for z in zip(*pairs, strict=True))
    batch_x, batch_y = model.step(x, u), model.output(x, u)
    for j, (xj, uj) in enumerate(pairs):
        assert batch_x[:, j] == pytest.approx(model.step(xj, uj), rel=1e-12, abs=1e-12)
        assert batch_y[:, j] == pytest.approx(model.output(xj, uj), rel=1e-12, abs=1e-12)


@EVERY
@pytest.mark.parametrize("which", [0, 1], ids=["step", "output"])
def test_jacobians_match_finite_differences(model, which):
    function = model.functions[which]
    x, u = ca.MX.sym("x", model.n_states), ca.MX.sym("u", model.n_inputs)
    z = ca.vertcat(x, u)
    derivative = ca.Function("d", [x, u], [ca.jacobian(function(x, u), z)])
    at_x, at_u = typical(model, 11)
    at = np.concatenate([at_x, at_u])
    exact = np.asarray(derivative(at_x, at_u))
    for i in range(len(at)):
        h = 1e-6 * max(1.0, abs(at[i]))
        plus, minus = at.copy(), at.copy()
        plus[i] += h
        minus[i] -= h
        split = model.n_states
        difference = (
            np.asarray(function(plus[:split], plus[split:])) - np.asarray(function(minus[:split], minus[split:]))
        ) / (2 * h)
        assert exact[:, i] == pytest.approx(difference[:, 0], rel=2e-5, abs=2e-6 * max(1.0, np.abs(exact).max()))


@EVERY
def test_free_run_is_repeated_step(model):
    data = record(model)
    run = model.simulate(data)
    m = model.memory
    x = model.initial_state(data.head(m))
    u = data.select(inputs=model.inputs).u
    for k in range(m, data.n_samples):
        x = model.step(x, u[k - 1])
        assert run.y[k] == pytest.approx(model.output(x, u[k]), rel=1e-9, abs=1e-9)
    assert run.predicted.sum() == data.n_samples - m


@EVERY
def test_fast_paths_give_what_the_defaults_give(model):
    """A model may override how it is run, never what comes out."""
    pairs = [typical(model, seed) for seed in range(4)]
    x, u = (np.stack(z) for z in zip(*pairs, strict=True))
    y = np.stack([np.asarray(model.output(a, b)).ravel() for a, b in pairs]) * 1.01
    close = {"rel": 1e-9, "abs": 1e-9}
    assert model.advance(x, u) == pytest.approx(FastPaths.advance(model, x, u), **close)
    assert model.outputs_at(x, u) == pytest.approx(FastPaths.outputs_at(model, x, u), **close)
    assert model.track(x[0], u, y) == pytest.approx(FastPaths.track(model, x[0], u, y), **close)
    out = np.empty((3, model.n_outputs))
    free = model.free_run(x[0], u, out)
    assert free == pytest.approx(FastPaths.free_run(model, x[0], u), **close)
    if model.steps is not None:
        assert model.steps.run(x[0], u[:3])[1:] == pytest.approx(roll_out(model.functions[0], x[0], u[:3])[1:], **close)


@EVERY
def test_free_run_never_sees_measured_outputs(model):
    data = record(model)
    garbage = data
    rng = np.random.default_rng(0)
    for name in (n for n in data.names if n not in model.inputs):
        values = data[name].copy()
        values[model.memory :] = 1e3 * rng.standard_normal(data.n_samples - model.memory)
        garbage = garbage.with_channel(name, values)
    assert np.array_equal(model.simulate(data).y, model.simulate(garbage).y)


@EVERY
def test_prediction_of_own_output_is_exact(model):
    """On data the model made itself, k steps ahead equals the measured output, from the first sample on.

    Models side by side (eq. 7-3) all take the same measured output, so that holds where one of them has all the weight.
    """
    data = record(model)
    if isinstance(model, ParallelARX):
        data = data.with_channel("v_x", np.full(data.n_samples, model.speeds[1]))
    run = model.simulate(data)
    own = data
    for name in model.outputs:
        if name not in model.inputs:
            own = own.with_channel(name, run.channel(name))
    for steps in (1, 4):
        predicted = model.predict(own, steps)
        assert predicted.predicted.sum() == data.n_samples - model.memory - steps + 1
        assert predicted.error == pytest.approx(0.0, abs=1e-7 * max(1.0, np.abs(run.y).max()))


@EVERY
def test_experiments_are_simulated_apart(model):
    data = record(model)
    two = replace(data, starts=(0, 60), start_times=(0.0, 100.0))
    run = model.simulate(two)
    parts = [model.simulate(part).y for part in two.experiments]
    assert np.array_equal(run.y, np.vstack(parts))


@EVERY
def test_models_are_frozen(model):
    with pytest.raises(FrozenInstanceError):
        model.dt = 1.0


def test_wrong_sample_time_names_both_and_the_fix():
    model = ALL_MODELS["bicycle"]
    data = replace(record(model), dt=0.01)
    with pytest.raises(SampleTimeError, match=r"0\.01 s.*0\.05 s.*resample\(0\.05\)"):
        model.simulate(data)


def test_missing_channel_offers_the_nearest():
    model = ALL_MODELS["bicycle"]
    data = record(model)
    renamed = replace(
        data,
        channels=tuple(replace(c, name=c.name.replace("delta", "Delta")) for c in data.channels),
        inputs=("Delta", "v_x"),
    )
    with pytest.raises(MissingColumnError, match=r"'delta'.*'Delta'"):
        model.simulate(renamed)


def test_too_short_for_the_lags():
    model = ALL_MODELS["ARX, MIMO, delay, constant"]
    with pytest.raises(TooShortError, match="3 samples"):
        model.simulate(record(model).head(3))


def test_starts_and_steps_that_do_not_fit_are_said():
    model = ARXModel(A=np.array([[[0.5]]]), B=np.array([[[1.0]]]), dt=0.1, inputs=("u",), outputs=("y",))
    data = Dataset.from_arrays({"u": np.zeros(9)}, {"y": np.zeros(9)}, 0.1)
    for start in ([1.0], [np.zeros(3)]):
        with pytest.raises(ParameterError, match=rf"start state of experiment 0 .*expected \({model.n_states},\)"):
            model.simulate(data, start=start)
    with pytest.raises(TooShortError, match="has 9 samples, 50-step-ahead prediction begins at sample 50"):
        model.predict(data, 50)
    assert model.predict(data, 8).predicted.sum() == 1


def test_unstable_free_run_says_where():
    model = ARXModel(A=[-30.0], B=[1.0], dt=0.1, inputs=("delta",), outputs=("r",))
    data = record(model, n=400)
    with pytest.raises(SimulationError, match=r"of 'r' leaves.*sample \d+ \(t = .*pole of modulus 30, so it grows"):
        model.simulate(data)
    two = replace(data, starts=(0, 10), start_times=(0.0, 100.0))
    with pytest.raises(SimulationError, match=r"sample \d+ of the experiment from t = 100 s \(t = 1\d\d"):
        model.simulate(two)


def test_a_nonlinear_free_run_that_diverges_says_so():
    network = MLP(weights=([[3.0, 0.1]], [[1e200]]), biases=([1.0], [0.0]), activation="elu")
    model = NARXModel(network=network, na=1, nb=1, dt=0.1, inputs=("delta",), outputs=("r",))
    with pytest.raises(SimulationError, match=r"'r' leaves.*nonlinear feedback grows"):
        model.simulate(record(model, n=400))
