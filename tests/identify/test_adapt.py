"""A model and another session: what its sensors read differently comes back; nothing that is not there is believed."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset
from slipangle.errors import (
    MissingColumnError,
    ModelWarning,
    ParameterError,
    SampleTimeError,
    SimulationError,
    TooShortError,
)
from slipangle.identify.adapt import Adapt, scaled
from slipangle.identify.judge.intervals import calibrate
from slipangle.identify.judge.validate import score, validate
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.storage import load, save
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM
from slipangle.models.wrappers.ensemble import EnsembleModel
from slipangle.models.wrappers.hybrid import OffsetModel, lag_weights

DT = 0.05
CAR = Bicycle(params=FERRARI_250LM, dt=DT)
TRUTH = {"offset_delta": 0.015, "gain_delta": 0.08, "lag_delta": 0.06, "bias_r": 0.004}


def drive(n=1600, seed=0, size=0.05):
    """Smooth random steering and speed, the car's yaw rate."""
    rng = np.random.default_rng(seed)
    kernel = np.hanning(25) / np.hanning(25).sum()
    delta = size * 3 * np.convolve(rng.standard_normal(n + 24), kernel, "valid")
    v_x = np.clip(22 + 4 * np.convolve(rng.standard_normal(n + 24), kernel, "valid").cumsum() * DT, 14, 30)
    data = Dataset.from_arrays({"delta": delta, "v_x": v_x}, {"r": np.zeros(n)}, DT, name=f"session {seed}")
    return data.with_channel("r", CAR.simulate(data).channel("r"), "rad/s")


def with_noise(data, size, seed=1):
    noise = size * np.random.default_rng(seed).standard_normal(data.n_samples)
    return data.with_channel("r", data["r"] + noise, "rad/s")


def changed(data):
    """What sensors with `TRUTH` read on the same drive."""
    sensors = OffsetModel(
        model=CAR,
        inputs_at_zero={"delta": TRUTH["offset_delta"]},
        gains={"delta": 1 + TRUTH["gain_delta"]},
        lags={"delta": TRUTH["lag_delta"]},
        outputs_at_zero={"r": TRUTH["bias_r"]},
    )
    return data.with_channel("r", sensors.simulate(data).channel("r"), "rad/s")


def values(adapted):
    return dict(zip(adapted.fit_info.names, adapted.fit_info.values, strict=True))


@pytest.fixture(scope="module")
def other():
    return with_noise(changed(drive(seed=2)), 0.01)


@pytest.fixture(scope="module")
def adapted(other):
    return Adapt().fit(CAR, other)


def test_offset_gain_lag_and_bias_come_back_with_their_doubt(adapted, other):
    found, info = values(adapted), adapted.fit_info
    assert info.warnings == ()
    for name, (low, high) in zip(info.names, info.interval(0.99), strict=True):
        assert low < TRUTH[name] < high, name
    assert found["gain_delta"] == pytest.approx(0.08, abs=0.02)
    assert adapted.gains["delta"] == 1 + found["gain_delta"]
    rest = other.rows(600, other.n_samples)
    before, after = (score(m.simulate(rest), "r").rmse for m in (CAR, adapted))
    least = np.std(rest["r"] - changed(drive(seed=2))["r"][600:])  # the noise
    assert after < 1.05 * least < 0.3 * before


def test_intervals_hold_the_sensors_of_a_car_whose_tires_and_load_changed_too():
    """Gain and lag of the steering on cars up to 15 % stiffer and softer per axle, up to 12 % heavier."""
    inside = {"another": [], "the same": []}
    for seed in range(12):
        rng = np.random.default_rng([11, seed])
        C_f, C_r, mass, inertia = 1 + rng.uniform(-0.15, 0.15, 4) * [1, 1, 0.5, 0.5] + np.array([0, 0, 0.05, 0.05])
        given = {"C_f": C_f, "C_r": C_r, "mass": mass, "inertia_z": inertia}
        other = replace(CAR, params=CAR.params.with_values(**{n: k * getattr(CAR.params, n) for n, k in given.items()}))
        truth = {"gain_delta": 0.05 * rng.standard_normal(), "lag_delta": 0.04 * abs(rng.standard_normal())}
        sensors = OffsetModel(model=other, gains={"delta": 1 + truth["gain_delta"]}, lags={"delta": truth["lag_delta"]})
        data = drive(620, seed=60 + seed)
        data = with_noise(data.with_channel("r", sensors.simulate(data).channel("r"), "rad/s"), 0.004, seed)
        for name, settings in (("another", Adapt()), ("the same", Adapt(car=()))):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ModelWarning)
                info = settings.fit(CAR, data).fit_info
            ends = dict(zip(info.names, info.interval(0.95), strict=True))
            inside[name] += [low <= truth[n] <= high for n, (low, high) in ends.items() if n in truth]
    assert np.mean(inside["another"]) >= 0.9
    assert np.mean(inside["the same"]) < 0.5  # what a user says who knows that it is


def test_parameters_are_scaled_wherever_the_physics_stands():
    other = replace(CAR, params=CAR.params.with_values(C_f=1.1 * CAR.params.C_f), fit_info=None)
    assert scaled(CAR, "C_f", 1.1) == other
    assert scaled(OffsetModel(model=CAR, gains={"delta": 1.1}), "C_f", 1.1).model == other
    assert scaled(EnsembleModel(members=(CAR, CAR)), "C_f", 1.1).members == (other, other)
    assert scaled(CAR, "mu_f", 1.1) is None
    black = ARXModel(A=[-0.9], B=[0.2], dt=DT, inputs=("delta",), outputs=("r",))
    assert scaled(black, "C_f", 1.1) is None


def test_what_comes_after_the_first_seconds_is_not_looked_at(adapted, other):
    late = other.with_channel("r", np.where(np.arange(other.n_samples) < 600, other["r"], 9.0))
    assert values(Adapt().fit(CAR, late)) == values(adapted)
    with pytest.raises(ParameterError, match="were used to fit the model"):
        validate(adapted, other)


@pytest.mark.parametrize("seed", range(5))
def test_where_nothing_changed_the_model_comes_back_and_says_so(seed):
    same = with_noise(drive(seed=10 + seed), 0.02, seed)
    with pytest.warns(ModelWarning, match="^the model is left as it is: ") as told:
        adapted = Adapt().fit(CAR, same)
    assert np.array_equal(adapted.simulate(same).y, CAR.simulate(same).y)
    assert adapted.fit_info.warnings == (str(told[0].message),)
    assert len(told) == 1


def drifting(data, seed, size=0.03, seconds=1.5):
    """A disturbance of the yaw rate as a model that is not quite right leaves it: normal, coloured."""
    rng = np.random.default_rng([7, seed])
    keep = np.exp(-DT / seconds)
    white = np.sqrt(1 - keep**2) * size * rng.standard_normal(data.n_samples)
    return data.with_channel("r", data["r"] + lfilter([1], [1, -keep], white), "rad/s")


def test_unchanged_sensors_behind_coloured_errors_are_seldom_adapted_to_and_changed_ones_are():
    """Half a minute each; the model's error is a tenth of the yaw rate's size and lasts for 1.5 s."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        adopted, gained = [], []
        for seed in range(15):
            same = drive(800, seed=20 + seed)
            adopted.append(not Adapt().fit(CAR, drifting(same, seed)).fit_info.warnings)
            other = drifting(changed(same), seed)
            rest = other.rows(600, 800)
            before, after = (score(m.simulate(rest), "r").fit for m in (CAR, Adapt().fit(CAR, other)))
            gained.append(after - before)
    assert sum(adopted) <= 2
    assert sum(g < -0.1 for g in gained) <= 1
    assert np.mean(gained) > 5.0


@pytest.mark.parametrize("gain", [1.1, 1.3])
def test_what_explains_every_block_is_adopted_however_unlike_their_steering(gain):
    adopted = 0
    for seed in range(6):
        calm = drive(seed=seed)
        harder = np.repeat([0.2, 1.0, 0.1, 2.0, 0.5, 0.1, 1.5, 0.3], calm.n_samples // 8)
        driven = calm.with_channel("delta", harder * calm["delta"], "rad")
        driven = driven.with_channel("r", CAR.simulate(driven).channel("r"), "rad/s")
        log = with_noise(driven.with_channel("delta", driven["delta"] / gain, "rad"), 0.004, seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModelWarning)
            found = Adapt().fit(CAR, log)
        adopted += not found.fit_info.warnings
        assert values(found)["gain_delta"] == pytest.approx(gain - 1, abs=0.03)
    assert adopted == 6


def test_what_lowers_the_error_elsewhere_too_little_is_not_believed(other):
    with pytest.warns(ModelWarning, match="on 8 blocks of 'session 2' .* a fall by 99.99 %"):
        adapted = Adapt(worth=0.9999).fit(CAR, other)
    assert not any(adapted.inputs_at_zero.values())
    assert adapted.gains == {"delta": 1.0}


def test_what_bends_to_one_side_say_of_the_other_has_to_hold_there():
    """A car that turns in more sharply to the left, which no sensor does: blocks cannot tell, halves can."""
    data = drive(800, seed=30)
    lopsided = with_noise(data.with_channel("r", data["r"] * np.where(data["r"] > 0, 1.3, 1.0), "rad/s"), 0.01)
    with pytest.warns(
        ModelWarning, match="where delta of 'session 30' is above its median changed .* where it is below"
    ):
        adapted = Adapt().fit(CAR, lopsided)
    assert adapted.gains == {"delta": 1.0}
    even = with_noise(data.with_channel("r", 1.15 * data["r"], "rad/s"), 0.01)
    assert Adapt().fit(CAR, even).gains["delta"] > 1.1


def test_what_is_small_beside_the_errors_over_the_training_data_is_no_offset():
    """Half a minute that scatters little around a steady error, of a model that errs five times as much elsewhere."""
    train = drifting(drive(3000, seed=40), 0, size=0.05)
    steady = with_noise(drive(800, seed=41), 0.003)
    steady = steady.with_channel("r", steady["r"] + 0.02, "rad/s")
    assert Adapt(bias_prior=0.2).fit(CAR, steady).outputs_at_zero["r"] > 0.01
    with pytest.warns(ModelWarning, match="if its errors are as large and last as long as over what it was fitted to"):
        adapted = Adapt(bias_prior=0.2).fit(CAR, steady, train)
    assert np.array_equal(adapted.simulate(steady).y, CAR.simulate(steady).y)
    assert adapted.spread(steady)[10:].min() > 0


@pytest.mark.parametrize(("name", "value"), [("offset_delta", np.radians(2)), ("gain_delta", 0.2), ("lag_delta", 0.1)])
def test_what_is_large_beside_them_is_still_found(name, value):
    train, same = drifting(drive(3000, seed=42), 1, size=0.01), drive(800, seed=43)
    sensors = OffsetModel(
        model=CAR,
        inputs_at_zero={"delta": value * (name == "offset_delta")},
        gains={"delta": 1 + value * (name == "gain_delta")},
        lags={"delta": value * (name == "lag_delta")},
    )
    other = drifting(same.with_channel("r", sensors.simulate(same).channel("r"), "rad/s"), 2, size=0.01)
    adapted = Adapt().fit(CAR, other, train)
    assert adapted.fit_info.warnings == ()
    assert values(adapted)[name] == pytest.approx(value, rel=0.25)


def test_training_data_of_another_sample_time_are_refused(other):
    with pytest.raises(SampleTimeError):
        Adapt().fit(CAR, other, drive().resample(0.1))


def test_a_poor_session_pulls_nowhere():
    """Ten seconds nearly straight ahead, noise as large as the yaw rate: the prior's widths bound what is believed."""
    poor = with_noise(drive(400, seed=3, size=0.004), 0.02)
    settings = Adapt(seconds=10.0, folds=0)
    found = values(settings.fit(CAR, poor))
    width = 0.2 * np.std(poor["delta"][:200])
    assert abs(found["gain_delta"]) < 0.05
    assert abs(found["offset_delta"]) < width
    assert abs(found["lag_delta"]) < 0.02


def test_intervals_widen_by_what_is_not_known_of_the_session(adapted, other):
    rest = other.rows(600, other.n_samples)
    spread = adapted.spread(rest)[10:]
    assert spread.min() > 0
    far = replace(adapted, scatter=4 * adapted.scatter).spread(rest)[10:]
    assert far == pytest.approx(2 * spread, rel=0.1)
    assert not replace(adapted, scatter=None).spread(rest).any()
    calibration = calibrate([(CAR, with_noise(drive(seed=5), 0.01))])
    widths = [
        np.ptp([i.lower, i.upper], axis=0)[20:, 0] for i in (calibration.interval(m, rest) for m in (CAR, adapted))
    ]
    assert np.mean(widths[1]) > 1.005 * np.mean(widths[0])
    both = EnsembleModel(members=(CAR, Bicycle(params=FERRARI_250LM.with_values(C_f=5e4), dt=DT)))
    wrapped = replace(adapted, model=both)
    assert np.all(wrapped.spread(rest)[10:] > both.spread(adapted.behind(rest))[10:])


def test_a_model_left_as_it_is_keeps_the_doubt_about_it():
    same = with_noise(drive(seed=10), 0.02, 0)
    with pytest.warns(ModelWarning):
        adapted = Adapt().fit(CAR, same)
    assert np.all(adapted.spread(same)[10:] > 0)


def test_behind_its_sensors_a_model_runs_as_on_corrected_data(adapted, other):
    """Sample by sample as the wrapper, and all at once on corrected channels; from several samples too."""
    for model in (adapted, replace(adapted, lags={"delta": -DT / 3})):
        rest = other.rows(700, 1000)
        inner = model.model.simulate(model.behind(rest)).y[1:] + model.outputs_at_zero["r"]
        assert model.simulate(rest).y[1:] == pytest.approx(inner, abs=1e-9)
    x = adapted.initial_state(other.head(1))
    assert x[-1] == pytest.approx(adapted.behind(other)["delta"][0])


def test_files_written_before_gains_and_lags_are_read(adapted, tmp_path):
    assert load(save(adapted, tmp_path / "new.json")) == adapted
    plain = OffsetModel(model=CAR, inputs_at_zero={"delta": 0.01})
    text = save(plain, tmp_path / "old.json").read_text()
    content = json.loads(text)
    for name in ("gains", "lags", "scatter"):
        del content["record"]["fields"][name]
    (tmp_path / "old.json").write_text(json.dumps(content))
    assert load(tmp_path / "old.json") == plain


@pytest.mark.parametrize(
    ("settings", "error", "said"),
    [
        ({"folds": 1}, ParameterError, "folds is 1; expected 0, or at least 2"),
        ({"gain_prior": 0.0}, ParameterError, "gain_prior is 0"),
        ({"seconds": 1000.0}, TooShortError, "read from 1000 s"),
        ({"lags": ("Delta",)}, MissingColumnError, "'Delta'"),
        ({"outputs": ("v_y",)}, MissingColumnError, "'v_y'"),
    ],
)
def test_wrong_settings_get_a_sentence(settings, error, said, other):
    with pytest.raises(error, match=said), warnings.catch_warnings():
        Adapt(**settings).fit(CAR, other)


def test_a_model_that_runs_away_in_the_session_gets_a_sentence(other):
    """An oversteering car above its critical speed, whose run corrections of sensors cannot bring back."""
    loose = Bicycle(params=replace(FERRARI_250LM, C_r=0.35 * FERRARI_250LM.C_r), dt=DT)
    sentence = r"first 30 s of 'session 2' goes astray: r is off by .*; expected a run"
    with pytest.warns(ModelWarning, match="goes astray"), pytest.raises(SimulationError, match=sentence):
        Adapt().fit(loose, other)


def test_a_lead_is_at_most_a_third_of_a_sample():
    with pytest.raises(ParameterError, match=r"lag of 'delta' is -0\.03 s; expected at least -0\.0167 s"):
        OffsetModel(model=CAR, lags={"delta": -0.03})


@pytest.mark.parametrize("wrong", [[0.1, 0.2], "0.1", float("nan"), None])
@pytest.mark.parametrize("kind", ["inputs_at_zero", "gains", "lags"])
def test_a_correction_that_is_no_number_gets_a_sentence(kind, wrong):
    with pytest.raises(ParameterError, match=r"the correction of 'delta' is .*; expected a finite number"):
        OffsetModel(model=CAR, **{kind: {"delta": wrong}})


def lagging(lag, seed, dt, seconds=60.0):
    """A drive whose steering, sines up to 1.2 Hz, acts through a first-order lag; simulated at 2.5 ms."""
    rng, fine = np.random.default_rng(seed), 0.0025
    omega, phase, size = 2 * np.pi * rng.uniform(0.2, 1.2, 6), rng.uniform(0, 6, 6), rng.uniform(0.005, 0.02, 6)
    t = np.arange(round(seconds / fine))[:, None] * fine
    delta = np.sum(size * np.sin(omega * t + phase), axis=1)
    late = np.sum(size * np.sin(omega * t + phase - np.arctan(omega * lag)) / np.hypot(1, omega * lag), axis=1)
    v_x = 18 + 5 * np.sin(2 * np.pi * t[:, 0] / 40)
    true = Dataset.from_arrays({"delta": late, "v_x": v_x}, {"r": np.zeros(len(t))}, fine).hold_mean()
    r, every = CAR.resampled(fine).simulate(true).channel("r"), round(dt / fine)
    sensed = {"delta": delta[: len(r)], "v_x": v_x[: len(r)]}
    r = r + 0.002 * rng.standard_normal(len(r))
    seen = {name: values[::every] for name, values in (sensed | {"r": r}).items()}
    outputs = {"r": seen.pop("r")}
    return Dataset.from_arrays(seen, outputs, dt, name=f"lag {lag:g} s").hold_mean()


@pytest.mark.parametrize("dt", [0.02, 0.05])
def test_a_lag_brings_no_gain(dt):
    """The mean of the response to a held input costs 1 % of gain at 0.05 s, a backward difference up to 8 %.

    The lag is found to a fiftieth of itself or of a sample.
    """
    start = CAR.resampled(dt)
    model = GreyBox(start=start, free=("C_f", "C_r", "inertia_z")).fit(lagging(0.0, 1, dt))
    for lag in (0.03, 0.1):
        info = Adapt(seconds=50.0).fit(model, lagging(lag, 7, dt)).fit_info
        found, std = (dict(zip(info.names, v, strict=True)) for v in (info.values, info.std))
        assert abs(found["gain_delta"]) < max(0.003, 1.96 * std["gain_delta"])
        assert abs(found["gain_delta"]) < 0.005
        assert found["lag_delta"] == pytest.approx(lag, abs=0.02 * max(lag, dt))


def test_weights_of_a_lag_are_smooth_where_there_is_none():
    """Of any lag they pass a constant, delay a line by the lag, and change at no lag without a step or a kink."""
    for lag in (-0.33, -1e-3, 1e-9, 1e-3, 0.4, 3.0, 1e3):
        a, b, c, left = lag_weights(lag)
        assert a + b + c == pytest.approx(1 - left, rel=1e-9, abs=1e-12)
        assert -b - 2 * c - left * (1 + lag) == pytest.approx(-lag, rel=1e-9, abs=1e-12)
    size = 1e-4
    up, here, down = (np.array(lag_weights(lag)) for lag in (size, 0.0, -size))
    assert (up - here) / size == pytest.approx((here - down) / size, abs=10 * size)


@pytest.mark.parametrize("lag", [-0.015, 0.0, 0.002, 0.08])
def test_a_lag_is_the_same_by_steps_and_for_a_whole_log(lag):
    data = changed(drive(200, seed=3)).rows(20, 200)
    model = OffsetModel(model=CAR, gains={"delta": 1.1}, lags={"delta": lag}, inputs_at_zero={"delta": 0.01})
    expected = CAR.simulate(model.behind(data)).y
    x, seen = model.initial_state(data.head(model.memory)), []
    for u in data.select(inputs=model.inputs).u:
        seen.append(model.output(x, u))
        x = model.step(x, u)
    assert np.array(seen)[1:] == pytest.approx(expected[1:], abs=1e-9)
    assert model.simulate(data).y == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("seed", [2, 4])
@pytest.mark.parametrize(
    ("channel", "factor", "words"),
    [
        ("delta", -1.0, "the sign of delta turned or the sign of r turned"),
        ("delta", np.degrees(1.0), "delta read in deg"),
        ("v_x", 3.6, "v_x read in km/h"),
    ],
)
def test_a_channel_that_reads_otherwise_than_in_training_is_named_and_not_adapted_to(channel, factor, words, seed):
    """The prior lets a gain fall far enough to pass every test: a turned steering had the gain 0.13."""
    session = with_noise(drive(seed=seed), 0.002)
    session = session.with_channel(channel, factor * session[channel], session.unit(channel))
    with pytest.warns(ModelWarning, match=f"the model is left as it is: the free run fits r to .* with {words}"):
        adapted = Adapt().fit(CAR, session)
    assert adapted.gains == {"delta": 1.0}
    assert adapted.outputs_at_zero == {"r": 0.0}


def test_where_the_run_goes_astray_by_it_that_is_said():
    session = with_noise(drive(seed=3), 0.002)
    session = session.with_channel("v_x", 3.6 * session["v_x"], "m/s")
    with pytest.raises(SimulationError, match=r"goes astray: .*; the free run fits r to .* with v_x read in km/h"):
        Adapt().fit(CAR, session)
