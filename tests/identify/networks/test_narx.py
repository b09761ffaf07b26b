"""NARX training: learns what it should, the same from the same seed, never from held-out or test data."""

import re
import subprocess
import sys
import warnings

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ExcitationError, ModelWarning, ParameterError, TooShortError
from slipangle.identify.judge.validate import validate
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.orders import choose
from slipangle.identify.networks import adam, narx, windows
from slipangle.identify.networks.estimator import Settled
from slipangle.identify.networks.narx import NARX
from slipangle.identify.networks.narx_free_run import FreeRunNARX, _Polish
from slipangle.identify.networks.problem import Stage
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.black_box.networks import MLP, Scaling
from slipangle.reproduce.plants import narendra

QUICK = (Stage(epochs=40, batch=50),)
SMALL = {"na": 3, "nb": 2, "hidden": (8,), "stages": QUICK}


def parameters(model):
    return model.network.parameters


def mimo(n=400, seed=0, noise=0.0):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, (n // 4, 2)), 4, axis=0)
    y = np.zeros((n, 2))
    for k in range(3, n):
        y[k, 0] = 0.6 * y[k - 1, 0] - 0.2 * y[k - 2, 1] + 0.5 * u[k - 3, 0] + 0.1 * np.sin(3 * u[k - 2, 1])
        y[k, 1] = 0.3 * y[k - 1, 0] + 0.5 * y[k - 1, 1] + 0.4 * u[k - 2, 1]
    y = 5.0 + 20.0 * y + noise * rng.standard_normal((n, 2))
    return Dataset.from_arrays(
        {"delta": u[:, 0], "v_x": 100 + 30 * u[:, 1]}, {"r": y[:, 0], "a_y": y[:, 1]}, 0.05, name=f"mimo {seed}"
    )


def test_learns_the_narendra_system_far_beyond_a_linear_model():
    train, test = narendra.estimation(seed=1), narendra.validation()
    model = NARX(na=3, nb=2, hidden=(30,), stages=(Stage(epochs=400, learning_rate=5e-3),)).fit(train)
    linear = ARX(na=3, nb=2).fit(train)
    here, there = (validate(m, test).free_run_scores["y"].rmse for m in (model, linear))
    assert here < 0.045
    assert here < 0.5 * there


def test_several_inputs_and_outputs_with_delay_and_offsets():
    model = NARX(na=2, nb=2, nk=2, hidden=(30,), stages=(Stage(epochs=1500, learning_rate=5e-3, batch=50),)).fit(mimo())
    scores = validate(model, mimo(seed=1)).free_run_scores
    assert scores["r"].fit > 90
    assert scores["a_y"].fit > 90


def test_one_step_stage_of_an_affine_network_reaches_least_squares():
    """Without hidden layers the loss has one minimum, known from ARX."""
    train = mimo(noise=0.5)
    arx = ARX(na=2, nb=2, nk=2, offset=True).fit(train).predict(train)
    best = np.mean((arx.error[arx.predicted] / train.y.std(axis=0)) ** 2)
    problem = narx.LagNetwork(na=2, nb=2, nk=2, activation="elu")
    stage = Stage(epochs=9000, learning_rate=3e-2, batch=400)
    from slipangle.identify.networks import adam

    with adam.precision("double"):
        start = adam.to_device(windows.layers(MLP.random((8, 2), seed=0)))
        arrays = adam.to_device(scaled(train))
        steps = adam.AdamSteps(problem, stage, start, arrays, windows.window_starts(train, 3, 1), seed=0)
        losses = [steps.advance(3000) for _ in range(3)]
    assert losses[0] >= losses[-1] >= best * (1 - 1e-9)
    assert losses[-1] == pytest.approx(best, rel=1e-4)


def scaled(data):
    return windows.scaled(data, Scaling.standard(data.u), Scaling.standard(data.y), data)


# ---- the linear start ------------------------------------------------------------------------------------------------


def tanks(n=600, seed=0):
    """Level of the lower of two tanks, the upper one over the lower [V]; the voltage of its pump moves slowly."""
    rng = np.random.default_rng(seed)
    u = np.clip(4 + 2 * np.convolve(rng.standard_normal(n + 29), np.hanning(30) / 3.4, "valid"), 0, 10)
    upper, lower, y = 4.0, 4.0, np.zeros(n)
    for k in range(n):
        y[k] = lower
        for _ in range(8):
            upper, lower = (
                max(upper + 0.5 * (0.05 * u[k] - 0.1 * np.sqrt(upper)), 0.0),
                max(lower + 0.5 * 0.1 * (np.sqrt(upper) - np.sqrt(lower)), 0.0),
            )
    return Dataset.from_arrays({"u": u}, {"y": y + 0.02 * rng.standard_normal(n)}, 4.0, name=f"tanks {seed}")


def held_out_error(model, data):
    """Of a free run over the last 15 %, in standard deviations of what comes before."""
    inner, held = data.split(0.85)
    run = model.simulate(held)
    return float(np.sqrt(np.mean((run.error[run.predicted] / inner.y.std(axis=0)) ** 2)))


def test_training_starts_as_the_linear_model_of_the_same_lags_and_never_ends_below_it():
    data = mimo(noise=2.0)
    model = NARX(na=2, nb=2, nk=2, hidden=(8, 8), stages=(Stage(horizon=10, epochs=60),)).fit(data)
    linear = ARX(na=2, nb=2, nk=2, offset=True).fit(data.split(0.85)[0])
    curve = model.fit_info.trials[0].curve
    assert curve[0, 1] == pytest.approx(held_out_error(linear, data), rel=1e-4)
    assert held_out_error(model, data) == pytest.approx(curve[:, 1].min(), rel=1e-3)
    assert curve[:, 1].min() < curve[0, 1]


def test_where_no_network_is_better_the_model_is_the_linear_one_and_says_so():
    data = mimo(noise=2.0)
    useless = (Stage(horizon=1, epochs=20, learning_rate=1e30),)
    with pytest.warns(ModelWarning, match="no network beat the linear model .* so the model is that linear one"):
        model = NARX(na=2, nb=2, hidden=(8,), stages=useless, precision="double").fit(data)
    linear = ARX(na=2, nb=2, offset=True).fit(data.split(0.85)[0])
    assert model.simulate(data).y == pytest.approx(linear.simulate(data).y, rel=1e-9)
    assert model.fit_info.warnings[0].endswith("is that linear one")


@pytest.mark.parametrize("hidden", [(8,), ()])
def test_the_start_is_the_arx_model_itself(hidden):
    data, settings = mimo(), NARX(na=2, nb=1, nk=3, hidden=hidden)
    su, sy = Scaling.standard(data.u), Scaling.standard(data.y)
    units = windows.in_units(data, su, sy)
    start = settings._initial(0, 2, 2, settings._linear(units, units))
    channels = {"dt": data.dt, "inputs": data.inputs, "outputs": data.outputs}
    model = settings._model(start, su, sy, None, channels)
    linear = ARX(na=2, nb=1, nk=3, offset=True).fit(data)
    assert model.simulate(data).y == pytest.approx(linear.simulate(data).y, rel=1e-6)


def test_where_noise_biases_arx_the_start_is_the_output_error_model():
    rng = np.random.default_rng(3)
    u, y = rng.standard_normal(900), np.zeros(900)
    for k in range(3, 900):
        y[k] = 1.6 * y[k - 1] - 0.8 * y[k - 2] + 0.4 * u[k - 2] - 0.1 * u[k - 3]
    y += 0.5 * rng.standard_normal(900)
    data = Dataset.from_arrays({"u": u}, {"y": y}, 0.1, name="noisy")
    inner, held = data.split(0.8)
    settings = NARX(na=2, nb=2, nk=2)
    slope, constant = settings._linear(inner, held)
    assert slope == pytest.approx(np.array([[1.6, -0.8, 0.4, -0.1]]), abs=0.03)
    assert constant == pytest.approx(0.0, abs=0.05)
    arx = ARX(na=2, nb=2, nk=2, offset=True).fit(inner)
    assert abs(arx.A[0, 0, 0] + 1.6) > 0.1
    assert narx.free_run_error(ARXModel(**{**vars(arx), "A": [-9.0], "B": [1.0]}), held) > 1e10


def test_a_trial_whose_free_run_grows_beyond_all_bounds_costs_no_finite_sum_and_no_warning():
    u = np.random.default_rng(0).standard_normal(300)
    data = Dataset.from_arrays({"u": u}, {"y": lfilter([0.0, 0.5], [1.0, -0.8], u)}, 0.1)
    start, su, sy = NARX(na=1, nb=1, hidden=(2,)), Scaling.standard(data.u), Scaling.standard(data.y)
    units = windows.in_units(data, su, sy)
    channels = {"dt": data.dt, "inputs": data.inputs, "outputs": data.outputs}
    model = start._model(start._initial(0, 1, 1, start._linear(units, units)), su, sy, None, channels)
    with adam.precision("double"):
        polish = _Polish(FreeRunNARX(start=start), model, data, None)
        assert np.isfinite(polish.cost(polish.net.parameters))
        assert not np.isfinite(polish.cost(100.0 * polish.net.parameters))


def test_without_a_usable_linear_model_training_starts_at_random_and_says_why():
    data = mimo(300)
    grows = data.with_channel("r", np.exp(0.05 * np.arange(300)) + data["r"])
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        model = NARX(na=2, nb=2, hidden=(8,), stages=QUICK).fit(grows)
    assert "starts from random weights, as there is no linear model" in str(said[0].message)
    assert "unstable" in str(said[0].message)
    assert model.network.skip is None


def test_steps_on_the_whole_free_run_keep_the_best_of_the_held_out_part():
    data = tanks()
    start = NARX(na=2, nb=2, hidden=(5,), activation="tanh", stages=(Stage(horizon=10, epochs=30),))
    model = FreeRunNARX(start=start, max_iterations=15).fit(data)
    trial = model.fit_info.trials[0]
    assert trial.score == trial.curve[:, 1].min() < trial.curve[0, 1]
    assert held_out_error(model, data) == pytest.approx(trial.score, rel=1e-6)
    inner = data.split(0.85)[0]
    assert held_out_error(model, data) < held_out_error(ARX(na=2, nb=2, offset=True).fit(inner), data)


# ---- orders that are not given -----------------------------------------------------------------------------------


def test_open_orders_are_those_of_the_arx_model_that_runs_freely_best():
    data = tanks()
    model = NARX(hidden=(6,), stages=QUICK, linear_start=False).fit(data)
    best = choose(data.split(0.85)[0], na="chosen", nb="chosen", nk="chosen", offset=True)
    assert (model.na, model.nb, model.nk) == (best.ranked[0][0].na, *best.ranked[0][0].nb, *best.ranked[0][0].nk)
    assert model.fit_info.candidates == best.candidates
    assert re.match(r"na = \d+, nb = \d+, nk = \d+, chosen of \d+ by free run", model.fit_info.method)


def test_open_orders_are_the_same_for_every_input_and_given_ones_stay():
    data = mimo(noise=1.0)
    assert NARX() == NARX(na="chosen", nb="chosen", nk="chosen")
    assert NARX(na=2, nb=2).nk == 1
    settled, chosen = NARX(na=2).settled(data)
    assert settled.na == 2
    assert {settled.nb, settled.nk} <= set(range(1, 11))
    assert len(chosen.candidates) > 10
    assert NARX(na=2, nb=2).settled(data) == (NARX(na=2, nb=2), Settled())
    inner = data.split(0.85)[0]
    spoilt = data.with_channel("r", np.where(np.arange(400) < inner.n_samples, data["r"], 1e3))
    assert NARX(na=2).settled(spoilt)[0] == settled


def test_same_seed_same_weights_other_seed_other_weights():
    data = narendra.estimation(300)
    fits = [NARX(**SMALL, seeds=(s,)).fit(data) for s in (0, 0, 1)]
    assert np.array_equal(parameters(fits[0]), parameters(fits[1]))
    assert not np.array_equal(parameters(fits[0]), parameters(fits[2]))


def test_every_seed_is_kept_and_the_best_wins():
    data = narendra.estimation(300)
    model = NARX(**SMALL, seeds=(0, 1, 2)).fit(data)
    trials = model.fit_info.trials
    assert [t.seed for t in trials] == [0, 1, 2]
    best = min(trials, key=lambda t: t.score)
    alone = NARX(**SMALL, seeds=(best.seed,)).fit(data)
    assert np.array_equal(parameters(model), parameters(alone))
    assert f"seed {best.seed} of 3" in model.fit_info.method


@pytest.mark.parametrize("precision", [pytest.param("single", marks=pytest.mark.slow), "double"])
def test_score_is_the_free_run_error_of_the_held_out_part(precision):
    data = mimo()
    model = NARX(na=2, nb=1, nk=3, hidden=(10,), stages=QUICK, precision=precision).fit(data)
    inner, held = data.split(0.85)
    run = model.simulate(held)
    error = run.error[run.predicted] / inner.y.std(axis=0)
    assert model.fit_info.trials[0].score == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-4)


def test_score_with_held_out_experiments_of_different_length():
    """The last 15 % begin inside one experiment and hold a shorter and a longer one."""
    data = join(mimo(400, 0), mimo(40, 1), mimo(60, 2), mimo(20, 3))
    model = NARX(na=2, nb=1, nk=3, hidden=(10,), stages=QUICK, holdout=0.2).fit(data)
    inner, held = data.split(0.8)
    assert len(held.experiments) == 3
    run = model.simulate(held)
    error = run.error[run.predicted] / inner.y.std(axis=0)
    assert model.fit_info.trials[0].score == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-4)


def test_held_out_part_never_reaches_a_gradient():
    """Garbage at the end of the record may change which epoch is kept, never what an epoch learns."""
    data = narendra.estimation(300)
    y = data["y"].copy()
    y[255:] = np.random.default_rng(0).normal(size=45)
    spoilt = data.with_channel("y", y)
    one_check = (Stage(epochs=1, batch=50),)
    settings = SMALL | {"stages": one_check}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)  # garbage may leave the random start unbeaten
        fits = [NARX(**settings).fit(d) for d in (data, spoilt)]
    if all(f.fit_info.trials[0].epoch for f in fits):
        assert np.array_equal(*(parameters(f) for f in fits))
    rows = windows.window_starts(data.split(0.85)[0], 3, 20)
    assert rows.max() + 20 <= 255


def test_windows_stay_inside_their_experiment():
    data = join(narendra.estimation(30, seed=0), narendra.estimation(12, seed=1), narendra.estimation(20, seed=2))
    rows = windows.window_starts(data, 3, 10)
    assert rows.tolist() == [*range(3, 21), *range(45, 53)]


@pytest.mark.slow
def test_experiments_of_few_samples_are_enough():
    data = join(narendra.estimation(30, seed=0), narendra.estimation(12, seed=1), narendra.estimation(20, seed=2))
    model = NARX(**SMALL, holdout=0.3).fit(data)
    assert model.simulate(data).predicted.sum() == 62 - 9


def briefly_trained(data, horizon):
    """In double precision."""
    stage = Stage(horizon=horizon, epochs=1, learning_rate=1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        return NARX(na=2, nb=2, nk=2, hidden=(6,), stages=(stage,), holdout=0.0, precision="double").fit(data)


@pytest.mark.parametrize("horizon", [pytest.param(1, marks=pytest.mark.slow), 7])
def test_loss_is_the_error_of_restarted_free_runs(horizon):
    """The loss over windows equals free runs of the finished model from each start, in double precision."""
    data = mimo(60)
    model = briefly_trained(data, horizon)
    rows = windows.window_starts(data, 3, horizon)[::4]
    errors = []
    for k in rows:
        run = model.simulate(data.rows(k - 3, k + horizon))
        errors.append(run.error[run.predicted] / data.y.std(axis=0))
    from slipangle.identify.networks import adam

    problem = narx.LagNetwork(na=2, nb=2, nk=2, activation="elu")
    with adam.precision("double"):
        loss = problem.loss(windows.layers(model.network), adam.to_device(scaled(data)), rows, horizon)
    assert float(loss) == pytest.approx(np.mean(np.square(errors)), rel=1e-10)


def test_diverging_training_keeps_the_best_and_says_so():
    data = narendra.estimation(300)
    stages = (Stage(epochs=40, batch=50), Stage(epochs=200, learning_rate=1e30))
    with pytest.warns(ModelWarning, match=r"seed 0: training diverged before epoch \d+ .* of epoch \d+ are kept"):
        model = NARX(**SMALL | {"stages": stages}).fit(data)
    kept = NARX(**SMALL).fit(data)
    assert np.array_equal(parameters(model), parameters(kept))
    assert "diverged" in model.fit_info.warnings[0]
    assert model.fit_info.trials[0].curve[-1, 1] == np.inf


def test_training_stops_early_when_nothing_improves():
    data = mimo(200, noise=20.0)
    stage = Stage(epochs=4000, patience=100, learning_rate=1e-2)
    model = NARX(na=2, nb=2, hidden=(20,), stages=(stage,), linear_start=False).fit(data)
    trial = model.fit_info.trials[0]
    assert trial.epochs < 4000
    assert trial.epochs == trial.epoch + 100
    assert trial.score == pytest.approx(trial.curve[:, 1].min())


def test_jax_settings_stay_and_weights_are_numpy():
    import jax

    before = jax.numpy.zeros(1).dtype
    model = briefly_trained(mimo(60), 7)
    assert jax.numpy.zeros(1).dtype == before
    assert all(type(a) is np.ndarray and a.dtype == float for a in (*model.network.weights, *model.network.biases))


def test_importing_the_estimator_does_not_import_jax():
    code = "import sys, slipangle.identify.networks.narx; raise SystemExit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_progress_rises_to_one():
    told = []
    NARX(**SMALL, seeds=(0, 1)).fit(narendra.estimation(300), progress=lambda share, what: told.append((share, what)))
    shares = [s for s, _ in told]
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)
    assert "seed 2 of 2" in told[-1][1]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"na": 0}, "na is 0"),
        ({"nb": "auto"}, "nb is 'auto'"),
        ({"hidden": (5, 0)}, "hidden is"),
        ({"activation": "relu"}, "'relu'.*elu"),
        ({"holdout": 0.9}, "holdout is 0.9"),
        ({"seeds": ()}, "0 seeds"),
        ({"stages": ()}, "0 stages"),
        ({"precision": "half"}, "'half'"),
    ],
)
def test_bad_settings(settings, said):
    with pytest.raises(ParameterError, match=said):
        NARX(**SMALL | settings).fit(narendra.estimation(200))


@pytest.mark.parametrize("settings", [{"horizon": 0}, {"epochs": 0}, {"learning_rate": 0.0}, {"weight_decay": -1.0}])
def test_bad_stage(settings):
    with pytest.raises(ParameterError, match=next(iter(settings))):
        Stage(**settings)


def test_constant_input_and_short_records():
    data = narendra.estimation(200)
    with pytest.raises(ExcitationError, match="'u'"):
        NARX(**SMALL).fit(data.with_channel("u", np.ones(200)))
    with pytest.raises(TooShortError, match="held out"):
        NARX(**SMALL).fit(data.rows(0, 16))
    with pytest.raises(TooShortError, match="window of 500"):
        NARX(**SMALL | {"stages": (Stage(horizon=500),)}).fit(data)
