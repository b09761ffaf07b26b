"""An input is freed of its noise and of its steps, and left alone where it has neither."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.data.quality.smooth import smoothed

DT = 0.02
t = np.arange(4000) * DT
SPEED = 18.0 + 4.0 * np.sin(0.8 * t) + 1.5 * np.sin(2.1 * t + 1.0)


def log(v_x):
    return Dataset.from_arrays({"delta": np.sin(t[: len(v_x)]), "v_x": v_x}, {"r": np.cos(t[: len(v_x)])}, DT)


def off(found, at=slice(25, -25)):
    """RMS error of a speed and of its rate."""
    error = (found["v_x"] - SPEED[: found.n_samples])[at]
    return np.sqrt(np.mean(error**2)), np.sqrt(np.mean(np.gradient(error, DT) ** 2))


@pytest.mark.parametrize("means", [False, True])
def test_noise_goes_and_the_rate_of_the_speed_comes_out(means):
    """The noise of means over two samples is not that of one sample alone, as leaving out one sample would take it."""
    logged = log(SPEED + 0.08 * np.random.default_rng(0).standard_normal(len(t)))
    logged = logged.hold_mean() if means else logged
    found = smoothed(logged, "v_x")
    (before, rough), (after, rate) = off(logged), off(found)
    assert after < 0.5 * before + 0.01
    assert rate < 0.25 * rough
    assert rate < 0.35  # of an acceleration of up to 6 m/s2


@pytest.mark.parametrize("noise", [0.0, 0.08])
def test_steps_of_1_km_h_become_lines(noise):
    logged = log(np.round((SPEED + noise * np.random.default_rng(1).standard_normal(len(t))) * 3.6) / 3.6)
    found = smoothed(logged, "v_x")
    (before, rough), (after, rate) = off(logged), off(found)
    assert after < 0.8 * before
    assert rate < 0.2 * rough
    assert np.abs(found["v_x"] - SPEED).max() < 1 / 3.6


def test_rare_steps_are_wider_apart_than_noise():
    noise = 0.004 * np.random.default_rng(4).standard_normal(len(t))
    speed = 3.0 + np.sin(0.3 * t) + 0.3 * np.sin(0.81 * t + 1.0)
    logged = log(np.round((speed + noise) * 3.6) / 3.6)
    rates = [np.std(np.gradient(v, DT)) for v in (logged["v_x"], smoothed(logged, "v_x")["v_x"])]
    assert rates[1] < 0.43 * rates[0]  # 0.36, and 0.49 of a window as for noise


@pytest.mark.parametrize("speed", [SPEED, np.full(len(t), 20.0), np.zeros(len(t)), SPEED[:300]])
def test_a_speed_without_noise_stays_as_it_is(speed):
    logged = log(speed)
    assert smoothed(logged, "v_x") is logged


def test_every_experiment_is_smoothed_for_itself_and_other_channels_stay():
    rng = np.random.default_rng(2)
    apart = [log(SPEED[:2000] + 0.08 * rng.standard_normal(2000)), log(SPEED[2000:] + 0.08 * rng.standard_normal(2000))]
    both = smoothed(join(*apart), "v_x")
    for part, one in zip(both.experiments, apart, strict=True):
        alone = smoothed(one, "v_x")
        assert np.std(part["v_x"] - alone["v_x"]) < 0.02
        np.testing.assert_array_equal(part["r"], one["r"])
        np.testing.assert_array_equal(part["delta"], one["delta"])


@pytest.mark.parametrize("n", [3, 7, 12, 30])
def test_a_log_too_short_for_a_window_stays_as_it_is(n):
    short = log(SPEED[:n] + 0.08 * np.random.default_rng(3).standard_normal(n))
    assert smoothed(short, "v_x") is short
