"""Residual tests: their levels hold on white and coloured signals, and they find what is missing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ParameterError, TooShortError
from slipangle.identify.judge.initial import restarted
from slipangle.identify.judge.residuals import residual_tests, simultaneous_width
from slipangle.identify.judge.validate import validate
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.polynomial import OutputError
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.model import Trajectory


def judged(e, u, starts=(0,), lag=20, names=("u",)):
    """Residual tests of given errors."""
    n = len(e)
    run = Trajectory(
        t=np.arange(n) * 0.1,
        y=np.zeros((n, 1)),
        measured=e[:, None],
        predicted=np.ones(n, dtype=bool),
        outputs=("y",),
        starts=starts,
    )
    columns = dict(zip(names, np.atleast_2d(u), strict=True))
    data = replace(Dataset.from_arrays(columns, {"y": e}, 0.1), starts=starts, start_times=tuple(map(float, starts)))
    return residual_tests(run, run, data, "y", lag)


def test_levels_hold_on_white_residuals():
    rng = np.random.default_rng(0)
    found = [judged(rng.standard_normal(500), rng.standard_normal(500)) for _ in range(300)]
    outside = np.mean([np.abs(f.autocorrelation[1:]) > f.band for f in found])
    assert outside == pytest.approx(0.01, abs=0.005)
    p = np.array([f.white_p for f in found])
    assert np.mean(p < 0.05) == pytest.approx(0.05, abs=0.035)
    assert np.mean(p) == pytest.approx(0.5, abs=0.06)
    assert np.mean([left(f) for f in found]) == pytest.approx(0.01, abs=0.01)
    assert sum("still depends" in f.sentences[1] for f in found) == sum(left(f) for f in found)


def left(tests):
    """Whether any input's correlation leaves its band at a lag from 0 on."""
    past = np.abs(tests.cross[:, tests.cross.shape[1] // 2 :])
    return bool(np.any(past > tests.cross_band[:, None]))


def test_the_level_holds_over_all_inputs_together():
    rng = np.random.default_rng(8)
    found = [judged(rng.standard_normal(400), rng.standard_normal((4, 400)), names=tuple("abcd")) for _ in range(300)]
    assert np.mean([left(f) for f in found]) == pytest.approx(0.01, abs=0.01)


@pytest.mark.parametrize(("estimator", "sets"), [(ARX(na=2, nb=2), 60), (OutputError(nb=2, nf=2), 25)], ids=repr)
def test_a_true_model_is_not_said_to_lack_dynamics(estimator, sets):
    """A pointwise band says it of about a third of them."""
    rng, said, a = np.random.default_rng(9), 0, [1.0, -1.5, 0.7]
    for _ in range(sets):
        u, e = lfilter([1.0], [1.0, -0.5], rng.standard_normal(1500)), rng.standard_normal(1500)
        noise = e if isinstance(estimator, OutputError) else lfilter([1.0], a, e)
        data = Dataset.from_arrays({"u": u}, {"y": lfilter([0.0, 1.0, 0.5], a, u) + 0.3 * noise}, 0.1)
        train, test = data.split(0.7)
        said += "still depends" in validate(estimator.fit(train), test).residuals["y"].sentences[1]
    assert said <= 0.05 * sets


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_a_true_model_is_not_said_to_lack_dynamics_over_a_long_test(colour):
    """Without its estimates' own error it is said of two thirds of them."""
    rng, said, unsure = np.random.default_rng(19), 0, 0
    for _ in range(25):
        u = np.repeat(rng.standard_normal(1100), 3)
        noise = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], rng.standard_normal(3700))[400:]
        data = Dataset.from_arrays({"u": u}, {"y": lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u) + noise}, 0.1)
        train, test = data.rows(0, 300), data.rows(300, 3300)
        sentence = validate(OutputError(nb=2, nf=2).fit(train), test).residuals["y"].sentences[1]
        said += "still depends" in sentence
        unsure += "train on more of them" in sentence
    assert said <= 1
    assert unsure > 5


def test_a_test_part_of_a_few_samples_is_judged():
    rng = np.random.default_rng(20)
    u, y = rng.standard_normal((2, 60))
    data = Dataset.from_arrays({"u": u}, {"y": y}, 0.1)
    model = ARX(na=2, nb=2).fit(data.rows(0, 50))
    for n in (4, 5, 9):
        assert len(validate(model, data.rows(50, 50 + n)).residuals["y"].sentences) == 2


def test_width_is_exact_where_variables_are_independent_or_one():
    exact = norm.isf((1 - 0.99 ** (1 / 30)) / 2)
    assert simultaneous_width(30, 0.0, 0.01) == pytest.approx(exact, abs=0.01)
    rng = np.random.default_rng(10)
    walks = lfilter([np.sqrt(1 - 0.9**2)], [1.0, -0.9], rng.standard_normal((4000, 130)))[:, 100:]
    rate = np.mean(np.abs(walks).max(axis=1) > simultaneous_width(30, 0.9, 0.05))
    assert 0.03 < rate <= 0.06


def test_band_of_the_cross_correlation_allows_for_colour():
    """Free-run errors and steering are both slow; a band for white signals would cry wolf."""
    rng = np.random.default_rng(1)
    crossed, naive = [], []
    for _ in range(200):
        e, u = (lfilter([1.0], [1.0, -0.95], rng.standard_normal(2200))[200:] for _ in range(2))
        found = judged(e, u)
        crossed.append(left(found))
        naive.append(np.abs(found.cross[0]) > found.band)
    assert np.mean(crossed) < 0.03
    assert np.mean(naive) > 0.3


def test_experiments_are_not_correlated_with_each_other():
    """Correlations by hand, over pairs inside an experiment only."""
    rng = np.random.default_rng(2)
    e, u = lfilter([1.0], [1.0, -0.9], rng.standard_normal((2, 90)))
    starts = (0, 30, 70)
    found = judged(e, u, starts, lag=6)
    groups = np.searchsorted(starts, np.arange(90), side="right")
    e0, u0 = e - e.mean(), u - u.mean()
    for lag in range(-6, 7):
        k = np.arange(max(0, -lag), min(90, 90 - lag))
        k = k[groups[k + lag] == groups[k]]
        expected = np.sum(e0[k + lag] * u0[k]) / np.sqrt(np.sum(e0**2) * np.sum(u0**2))
        assert found.cross[0][lag + 6] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("gain", [0.0, 0.5])
def test_an_error_that_moves_as_a_slalom_does_is_not_called_independent_of_it(gain):
    """Two sines of steering in the error are hardly chance, but this test lets them pass for it."""
    t = 0.04 * np.arange(900)
    u = 1.5 * np.sin(2 * np.pi * 0.3 * t) + np.sin(2 * np.pi * 0.9 * t + 1)
    e = gain * u + 0.3 * np.random.default_rng(0).standard_normal(900)
    found = judged(e, u, lag=40)
    seen = np.abs(found.cross[0][40:]).max()
    if gain:
        assert 0.8 < seen < found.cross_band[0]
        assert f"these data do not tell (correlation +{seen:.2f} at 0.00 s)" in found.sentences[1]
    else:
        assert found.sentences[1] == "the free-run error does not depend on u"


def test_a_missing_delay_is_found_and_placed():
    rng = np.random.default_rng(3)
    n = 3000
    u, y = rng.standard_normal(n), np.zeros(n)
    for k in range(5, n):
        y[k] = 0.5 * y[k - 1] + u[k - 1] + 0.3 * u[k - 5] + 0.05 * rng.standard_normal()
    data = Dataset.from_arrays({"u": u}, {"y": y}, 0.1)
    train, test = data.split(0.5)
    short, right = validate(ARX(na=1, nb=1).fit(train), test), validate(ARX(na=1, nb=5).fit(train), test)
    assert "still depends on u" in short.residuals["y"].sentences[1]
    assert "at 0.50 s" in short.residuals["y"].sentences[1]
    assert "does not depend on u" in right.residuals["y"].sentences[1]
    assert right.residuals["y"].white_p > 0.001
    assert right.one_step_scores["y"].rmse == pytest.approx(0.05, rel=0.1)
    assert right.free_run_scores["y"].fit < right.one_step_scores["y"].fit + 5


def test_a_coloured_residual_is_called_so():
    e = lfilter([1.0], [1.0, -0.4], np.random.default_rng(6).standard_normal(500))
    found = judged(e, np.random.default_rng(7).standard_normal(500))
    assert found.white_p < 1e-6
    assert "is not white" in found.sentences[0]
    assert found.autocorrelation[:3] == pytest.approx([1.0, 0.4, 0.16], abs=0.12)


def test_an_input_that_stands_still_says_nothing():
    rng = np.random.default_rng(4)
    found = judged(rng.standard_normal(200), np.vstack([np.full(200, 3.0), rng.standard_normal(200)]), names=("v", "u"))
    assert not found.cross[0].any()
    assert found.cross[1].any()


def test_training_data_are_refused_unless_asked_for():
    rng = np.random.default_rng(5)
    data = Dataset.from_arrays({"u": rng.standard_normal(200)}, {"y": rng.standard_normal(200)}, 0.1)
    model = ARX(na=1, nb=1).fit(data.head(150))
    with pytest.raises(ParameterError, match="used to fit the model"):
        validate(model, data.rows(100, 200))
    assert validate(model, data.rows(100, 200), on_training_data=True).name == "ARXModel"
    assert validate(model, data.rows(150, 200), name="mine").name == "mine"
    assert isinstance(model, ARXModel)


@pytest.mark.parametrize("memory", [1, 7])
def test_restarts_predict_every_sample_once(memory):
    """Each starts from the samples before; a rest goes on its own, a stub that no run can start in goes."""
    whole = Dataset.from_arrays({"u": np.arange(505.0)}, {"y": np.arange(505.0)}, 0.05)
    stub = whole.rows(0, memory)
    cut = restarted(join(whole, stub), 5.0, memory)
    predicted = np.concatenate([part["y"][memory:] for part in cut.experiments])
    assert np.array_equal(predicted, whole["y"][memory:])
    assert [part.n_samples for part in cut.experiments[:-1]] == [100 + memory] * (len(cut.starts) - 1)
    with pytest.raises(TooShortError, match="starts from"):
        restarted(stub, 5.0, memory)
    with pytest.raises(ParameterError, match="at least one sample"):
        restarted(whole, 0.01, memory)


@pytest.mark.parametrize("steps", [0, 2.5, True, "two"])
def test_predictions_go_a_whole_number_of_samples_ahead(steps):
    model = ARXModel(A=[-0.5], B=[0.5], nk=1, dt=0.1, inputs=("u",), outputs=("x",))
    data = Dataset.from_arrays({"u": np.ones(9)}, {"x": np.ones(9)}, 0.1)
    with pytest.raises(ParameterError, match=rf"steps is {steps!r}; expected a whole number of at least 1: 1 is one"):
        model.predict(data, steps)
    assert model.predict(data, np.int64(2)).kind == "2-step-ahead"
