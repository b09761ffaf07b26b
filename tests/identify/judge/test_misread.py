"""A test log whose channels are not those of the training log: which one, by the run that it would make good."""

import warnings
from dataclasses import dataclass

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ModelWarning, SimulationError
from slipangle.models.model import Model

DT = 0.05


def motion(seed, *, gain=1.0, n=1200):
    """v_y and r that follow the steering by two first-order lags, with a little noise."""
    rng = np.random.default_rng(seed)
    delta = 0.03 * np.repeat(rng.standard_normal(n // 10), 10)
    y = np.zeros((n, 2))
    for k in range(n - 1):
        y[k + 1] = [0.8 * y[k, 0] + gain * 0.4 * delta[k], 0.7 * y[k, 1] + gain * 1.5 * delta[k] + 0.1 * y[k, 0]]
    y = y + rng.standard_normal(y.shape) * [0.002, 0.005]
    return sa.Dataset.from_arrays({"delta": delta}, {"v_y": y[:, 0], "r": y[:, 1]}, DT, name=f"log {seed}")


@pytest.fixture(scope="module")
def model():
    return sa.ARX(na=2, nb=2, nk=1).fit(motion(0))


def judged(model, data):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return sa.validate(model, data)


DEG = np.degrees(1.0)


@pytest.mark.parametrize(
    ("channel", "factor", "words"),
    [
        ("r", -1.0, "the sign of r turned"),
        ("delta", -1.0, "the sign of delta turned"),
        ("v_y", -1.0, "the sign of v_y turned"),
        ("delta", DEG, "delta read in deg"),
        ("r", DEG, "r read in deg/s"),
        ("delta", 1 / DEG, "delta read in rad where it was declared in deg"),
        ("v_y", 3.6, "v_y read in km/h"),
    ],
)
@pytest.mark.parametrize("seed", [1, 2])
def test_one_channel_that_changed_is_named(model, channel, factor, words, seed):
    clean = motion(seed)
    data = clean.with_channel(channel, factor * clean[channel], clean.unit(channel))
    with pytest.warns(ModelWarning, match=f"with {words}, in place of"):
        verdict = sa.validate(model, data)
    assert " or " not in verdict.misread
    fit = judged(model, clean).free_run_scores["r"].fit
    assert f"r to {fit:.0f} % with {words}" in verdict.misread
    assert all(verdict.misread == tests.sentences[0] for tests in verdict.residuals.values())


@pytest.mark.parametrize("seed", range(3, 9))
def test_sound_logs_and_cars_that_changed_have_no_word(model, seed):
    for gain in (1.0, 0.4, 2.0):
        assert judged(model, motion(seed, gain=gain)).misread == ""


def test_of_one_output_both_signs_explain_it():
    model = sa.ARX(na=2, nb=2).fit(motion(0).select(outputs=("r",)))
    data = motion(1).select(outputs=("r",))
    with pytest.warns(ModelWarning, match="the sign of delta turned or the sign of r turned"):
        sa.validate(model, data.with_channel("r", -data["r"], "rad/s"))


def test_noise_that_nothing_mends_has_no_word(model):
    rng = np.random.default_rng(5)
    data = motion(1)
    assert judged(model, data.with_channel("r", rng.standard_normal(data.n_samples), "rad/s")).misread == ""


@dataclass(frozen=True)
class Cubic(Model):
    """A yaw rate that runs away from where it is large."""

    dt = DT
    inputs, outputs, states = ("delta",), ("r",), ("r",)

    def initial_state(self, data):
        return data["r"][:1]

    def step(self, x, u):
        return 0.5 * x + u + 0.5 * x**3

    def output(self, x, u):
        return x


def test_a_run_that_breaks_down_says_what_would_mend_it():
    rng = np.random.default_rng(0)
    delta, r = 0.1 * np.clip(rng.standard_normal(400), -2, 2), np.zeros(400)
    for k in range(399):
        r[k + 1] = 0.5 * r[k] + delta[k] + 0.5 * r[k] ** 3
    data = sa.Dataset.from_arrays({"delta": delta}, {"r": r}, DT, name="bends")
    assert judged(Cubic(), data).misread == ""
    wrong = data.with_channel("delta", DEG * delta, "rad")
    said = r"leaves the finite numbers .*; the free run fits r to 100 % with delta read in deg, in place of none"
    with np.errstate(all="ignore"), pytest.raises(SimulationError, match=said):
        sa.validate(Cubic(), wrong)
