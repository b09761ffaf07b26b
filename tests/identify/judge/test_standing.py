"""Verdicts stand between simple models fitted with them and the noise; on made data both are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ParameterError
from slipangle.identify.judge.baselines import baselines
from slipangle.identify.judge.noise import noise_floor, uncertainty
from slipangle.identify.judge.standing import _better
from slipangle.identify.judge.validate import validate
from slipangle.identify.linear.arx import ARX
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM

SWINGING = ([0.0, 0.2, 0.1], [1.0, -1.5, 0.7])  # two lightly damped poles: no first-order lag does that


def made(noise, *, seed=0, n=2000, system=SWINGING, colour=0.0, dt=0.05):
    """An output of unit standard deviation and noise of the given one, AR(1) with the given colour."""
    rng = np.random.default_rng(seed)
    u = lfilter([1.0], [1.0, -0.7], rng.standard_normal(n))
    y = lfilter(*system, u)
    v = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], rng.standard_normal(n))
    return Dataset.from_arrays({"u": u}, {"y": y / y.std() + noise * v}, dt, name=f"made {seed}")


def true_model(data, system=SWINGING):
    y = lfilter(*system, data["u"])
    b, a = (np.asarray(c) for c in system)
    return ARXModel(
        A=a[1:, None, None],
        B=b[1:, None, None] / y.std(),
        c=np.zeros(1),
        nk=1,
        dt=data.dt,
        inputs=data.inputs,
        outputs=data.outputs,
    )


@pytest.mark.parametrize("noise", [0.1, 0.5, 1.5])
@pytest.mark.parametrize("n", [400, 4000])
def test_the_floor_is_the_noise(n, noise):
    found = [noise_floor(made(noise, seed=s, n=n), "y") / noise for s in range(12)]
    assert np.mean(found) == pytest.approx(1.0, abs=0.15 if n == 400 else 0.05)
    assert np.std(found) < (0.12 if n == 400 else 0.04)


def test_slow_disturbances_are_not_taken_for_noise():
    """The floor of coloured noise is below its standard deviation, never above."""
    found = [noise_floor(made(0.3, seed=s, colour=0.9), "y") for s in range(8)]
    assert max(found) < 0.3
    assert min(found) > 0.3 * np.sqrt(1 - 0.9**2) / 1.9 * 0.8  # of the flat part: the spectrum's least


def test_what_an_anti_alias_filter_took_out_is_no_noise():
    fine = made(0.5, n=20000, dt=0.01, system=([0.0, 0.02], [1.0, -0.98]))
    clean = made(0.0, n=20000, dt=0.01, system=([0.0, 0.02], [1.0, -0.98]))
    noisy, quiet = fine.resample(0.05), clean.resample(0.05)
    left = float(np.std(noisy["y"] - quiet["y"]))
    assert left < 0.3
    assert noise_floor(noisy, "y") == pytest.approx(left, rel=0.1)


def test_too_few_samples_tell_no_floor():
    assert np.isnan(noise_floor(made(0.5, n=20), "y"))


@pytest.mark.parametrize("seed", range(5))
def test_a_true_model_on_noisy_data_is_good_though_its_fit_is_low(seed):
    data = made(0.8, seed=seed)
    train, test = data.split(0.6)
    found = validate(true_model(data), test, train=train).standing["y"]
    assert found.score.fit < 50
    assert found.word == "good", found.sentence
    assert found.highest == pytest.approx(found.score.fit, abs=200 * uncertainty(test.n_samples))
    assert "where its noise leaves at most" in found.sentence


@pytest.mark.parametrize("seed", range(5))
def test_a_model_that_a_simple_one_equals_is_never_good(seed):
    """A first-order system without noise: the lag is all of it, and the model's fit far above 75 %."""
    system = ([0.0, 0.2], [1.0, -0.8])
    data = made(0.01, seed=seed, system=system)
    train, test = data.split(0.6)
    model = true_model(data, system)
    dull = replace(model, B=0.9 * model.B)
    for judged in (model, dull):
        found = validate(judged, test, train=train).standing["y"]
        assert found.score.fit > 75
        assert found.best == "linear with lag"
        assert found.word != "good"


def test_a_model_that_a_simple_one_beats_by_far_is_poor():
    data = made(0.01, system=([0.0, 0.2], [1.0, -0.8]))
    train, test = data.split(0.6)
    model = true_model(data, ([0.0, 0.2], [1.0, -0.8]))
    found = validate(replace(model, B=0.8 * model.B), test, train=train).standing["y"]
    assert found.score.fit > 75
    assert found.word == "poor"
    assert "times that of the simple model" in found.sentence


@pytest.mark.parametrize(("error", "word"), [(0.03, "fair"), (0.12, "fair"), (0.35, "poor")])
def test_a_model_that_a_simple_one_beats_says_so(error, word):
    """The simple model is the truth, and errs by the noise alone; the other errs by a bit of its output more."""
    noise = 0.1
    data = made(noise, n=6000, system=([0.0, 0.2], [1.0, -0.8]))
    train, test = data.split(0.6)
    model = true_model(data, ([0.0, 0.2], [1.0, -0.8]))
    share = np.sqrt((1 + error) ** 2 - 1) * noise  # so that the whole error is so much larger
    found = validate(replace(model, B=(1 - share) * model.B), test, train=train).standing["y"]
    assert found.worse
    assert not found.better
    assert found.word == word, found.sentence
    assert "not better than" not in found.sentence
    said = "the simple model is better, with 0." if word == "fair" else "times that of the simple model, which is"
    assert said in found.sentence


def test_half_a_model_is_poor_and_says_what_it_explains():
    data = made(0.1)
    train, test = data.split(0.6)
    model = true_model(data)
    found = validate(replace(model, B=0.3 * model.B), test, train=train).standing["y"]
    assert found.word == "poor"
    assert "of what noise allows" in found.sentence


def test_a_fitted_black_box_is_judged_alike():
    train, test = made(0.05, seed=1).split(0.6)
    found = validate(ARX(na=2, nb=2).fit(train), test, train=train).standing["y"]
    assert found.word == "good"
    assert found.share > 0.5
    assert set(found.baselines) == {"mean", "static", "linear with lag"}


def test_without_training_data_there_is_no_standing():
    _, test = made(0.05).split(0.6)
    assert validate(true_model(test), test).standing == {}


def test_simple_models_may_not_see_the_test_data():
    data = made(0.05)
    with pytest.raises(ParameterError, match="of the training data are in the test data"):
        validate(true_model(data), data, train=data.rows(0, 500))


# ---- cars ----------------------------------------------------------------------------------------------------------


def driven(n=1500, dt=0.05, lag=0.0, seed=0):
    """A car in steady state at every instant, behind a lag; r, v_y and a_y by its own gradients."""
    rng = np.random.default_rng(seed)
    delta = lfilter([0.02], [1, -0.95], rng.standard_normal(n)) + 0.01
    v_x = 20 + 8 * np.sin(2 * np.pi * np.arange(n) / n * 3)
    K, wheelbase = 2e-3, 2.6
    turn = v_x * (0.9 * delta - 0.004) / (1 + K * v_x**2)
    r, v_y = turn / wheelbase, turn * (0.5 - 2.5e-3 * v_x**2)
    if lag:
        keep = np.exp(-dt / lag)
        r, v_y = (lfilter([0.0, 1 - keep], [1.0, -keep], z, zi=[z[0]])[0] for z in (r, v_y))
    return Dataset.from_arrays({"delta": delta, "v_x": v_x}, {"r": r, "v_y": v_y, "a_y": v_x * r}, dt)


def fits(train, test, output):
    spread = test[output].std()
    return {
        b.name: 100 * (1 - np.sqrt(np.mean((b.simulate(test) - test[output]) ** 2)) / spread)
        for b in baselines(train, output)
    }


@pytest.mark.parametrize("output", ["r", "v_y", "a_y"])
def test_steady_states_of_a_car_are_found(output):
    found = fits(*driven().split(0.6), output)
    assert list(found) == ["mean", "kinematic", "quasi-steady", "linear with lag"]
    assert found["quasi-steady"] > 95
    assert found["kinematic"] < found["quasi-steady"]


@pytest.mark.parametrize("output", ["r", "v_y"])
def test_a_lag_is_found(output):
    train, test = driven(lag=0.3).split(0.6)
    found = fits(train, test, output)
    assert found["linear with lag"] > 90 > found["quasi-steady"]
    slow = baselines(train, output)[-1]
    assert slow.lag == pytest.approx(0.3, rel=0.25)


def test_a_simple_model_with_a_state_may_start_from_the_measured_output():
    data = driven(lag=0.3)
    both = join(data.rows(0, 600), data.rows(900, 1500))
    slow, quick = baselines(both, "r")[-1], baselines(both, "r")[1]
    moved = slow.simulate(both, both["r"])
    assert moved[[0, 600]] == pytest.approx(both["r"][[0, 600]], rel=1e-12)
    assert np.mean((moved - both["r"]) ** 2) < np.mean((slow.simulate(both) - both["r"]) ** 2)
    np.testing.assert_array_equal(quick.simulate(both, both["r"]), quick.simulate(both))


def test_simple_models_start_every_experiment_anew():
    data = driven(lag=0.3)
    both = join(data.rows(0, 600), data.rows(900, 1500))
    model = baselines(both, "r")[-1]
    alone = np.concatenate([model.simulate(part) for part in both.experiments])
    np.testing.assert_allclose(model.simulate(both), alone, rtol=1e-12, atol=1e-15)


def test_a_true_bicycle_beats_all_of_them():
    data = driven()
    car = Bicycle(params=FERRARI_250LM, dt=data.dt, outputs=("r",))
    rng = np.random.default_rng(3)
    noisy = data.with_channel("r", car.simulate(data).y[:, 0] + 0.02 * rng.standard_normal(data.n_samples), "rad/s")
    train, test = noisy.select(outputs=["r"]).split(0.6)
    found = validate(car, test, train=train).standing["r"]
    assert found.word == "good", found.sentence
    assert found.noise == pytest.approx(0.02, rel=0.1)


def test_a_model_behind_a_simple_one_by_chance_perhaps_says_by_how_much():
    """Not beyond chance, but by how much it is behind is said."""
    data = made(0.1, n=6000, system=([0.0, 0.2], [1.0, -0.8]))
    train, test = data.split(0.6)
    model = true_model(data, ([0.0, 0.2], [1.0, -0.8]))
    found = validate(model, test, train=train).standing["y"]
    error = 1 - found.score.fit / 100
    simple = replace(found.baselines[found.best], fit=100 * (1 - error / 1.4))
    behind = replace(found, better=False, worse=False, word="fair", baselines={found.best: simple})
    assert behind.reason == "its error is 1.4 times that of the simple model, which may be chance"


@pytest.mark.filterwarnings("ignore:the model is unstable")
@pytest.mark.parametrize(("n", "pole"), [(1000, 1.02), (400, 1.05), (400, 1.02), (400, 0.98)])
def test_a_record_that_grows_is_not_decided_by_its_end(n, pole):
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal(n), np.zeros(n)
    for k in range(1, n):
        y[k] = pole * y[k - 1] + u[k - 1]
    data = Dataset.from_arrays({"u": u}, {"y": y + 0.05 * rng.standard_normal(n)}, 0.1)
    train, test = data.split(0.7)
    stands = validate(ARX(na=1, nb=1, nk=1).fit(train), test, train=train).standing["y"]
    assert stands.score.fit > 90
    assert stands.better
    assert stands.word == "good"


def test_a_rival_that_fails_in_one_stretch_is_beaten_in_all():
    """Ten of ten stretches are better; that one of them is much better is no doubt about it."""
    model, rival = np.ones(2000), 1.3 * np.ones(2000)
    rival[200:400] = 6.0
    assert _better(model, rival)
    assert not _better(rival, model)
    rival[400:] = 0.9  # better in one of ten, by far
    assert not _better(model, rival)


@pytest.mark.parametrize("growth", [0.0, 0.01, 0.05])
def test_chance_decides_as_seldom_where_errors_grow(growth):
    """Errors of one law: one of the two is called better at most as often as the level says, within chance."""
    rng, size, n = np.random.default_rng(3), np.exp(growth * np.arange(200)), 1000
    found = [_better(size * rng.standard_normal(200), size * rng.standard_normal(200)) for _ in range(n)]
    assert np.mean(found) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / n)
