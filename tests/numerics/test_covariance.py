"""Intervals cover what they say, whatever the residuals: white, of unlike size, coloured."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.numerics.covariance import covariance, middle_of_sandwich

N, RUNS = 600, 200


def coloured(rng, pole, n=N):
    return lfilter([1.0], [1.0, -pole], rng.standard_normal(n + 100))[100:]


@pytest.mark.parametrize("pole", [0.0, pytest.param(0.5, marks=pytest.mark.slow), 0.9])
def test_intervals_cover_the_truth(pole):
    rng, inside, plain = np.random.default_rng(0), 0, 0
    for _ in range(RUNS):
        j = np.column_stack([coloured(rng, 0.9), np.ones(N)])
        e = coloured(rng, pole)
        estimate = np.linalg.lstsq(j, e, rcond=None)[0]
        error = e - j @ estimate
        spread, said = covariance(error, j, 1)
        inside += abs(estimate[0]) < 1.96 * np.sqrt(spread[0, 0])
        plain += abs(estimate[0]) < 1.96 * np.sqrt(np.linalg.inv(j.T @ j)[0, 0] * np.mean(error**2))
        assert ("coloured" in said) or pole < 0.5
    assert 0.86 <= inside / RUNS <= 0.99
    assert pole == 0.0 or plain < inside - 0.05 * RUNS


def test_no_lags_is_the_covariance_of_white():
    rng = np.random.default_rng(1)
    j, e = rng.standard_normal((400, 3)), rng.standard_normal(400) * np.linspace(0.1, 3, 400)
    middle, lags = middle_of_sandwich(e, j, 1)
    assert lags == 0
    assert middle == pytest.approx((j * e[:, None] ** 2).T @ j)


def test_lags_stay_below_a_quarter_of_the_samples():
    drift = np.linspace(-1, 1, 80)
    assert middle_of_sandwich(drift, np.ones((80, 1)), 1)[1] == 21
