"""Critical values: those of a mean are in the literature; sums of squares are those of the kernel."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ParameterError
from slipangle.models.analysis.responses import Estimate
from slipangle.models.analysis.spectral_bands import gain_limits
from slipangle.numerics.covariance import covariance, long_run
from slipangle.numerics.critical import NORMAL, critical_values, drawn, quantile, spectral_factor, squared_sums


@pytest.mark.parametrize("lags", [0, 3, 39, 40, 60])
def test_squared_sums_are_the_diagonal_of_the_long_run_covariance(lags):
    scores = np.random.default_rng(0).standard_normal((40, 3))
    assert squared_sums(scores, lags) == pytest.approx(np.diag(long_run(scores, lags)), rel=1e-12)


@pytest.mark.parametrize("share", [0.1, 0.2])
def test_of_a_mean_of_white_noise_they_are_those_of_kiefer_and_vogelsang(share):
    """Their cubic for the kernel of Bartlett at 97.5 %, with n lags of a share of the samples."""
    n = 400
    ones, unit = np.ones((n, 1, 1)), np.eye(1)
    lags = int(share * n) - 1
    found = critical_values([ones], np.zeros((0, 1, 1)), unit, unit / n, np.array([1 / n]), lags)
    known = 1.9600 + 2.9694 * share + 0.4160 * share**2 - 0.5324 * share**3
    assert found[0] == pytest.approx(known, rel=0.06)


def test_noise_has_the_autoregressions_variance_and_correlation():
    coefficients, driving = np.array([[[0.5, 0.2], [0.0, 0.8]]]), np.array([[1.0, 0.3], [0.3, 2.0]])
    noise = drawn(np.random.default_rng(1), spectral_factor(coefficients, driving, 1 << 18))
    gamma, step = np.zeros((2, 2)), driving
    for _ in range(200):
        gamma, step = gamma + step, coefficients[0] @ step @ coefficients[0].T
    assert noise.T @ noise / len(noise) == pytest.approx(gamma, abs=0.1)
    assert noise[1:].T @ noise[:-1] / len(noise) == pytest.approx(coefficients[0] @ gamma, abs=0.1)


def test_a_parameter_that_moves_nothing_keeps_the_normal_value():
    j = np.column_stack([np.ones(60), np.zeros(60)])[:, None]
    found = critical_values([j], np.array([[[0.8]]]), np.eye(1), np.diag([1 / 60, 0.0]), np.array([0.3, 0.0]), 10)
    assert found[0] > 2.2
    assert found[1] == NORMAL


def test_the_same_record_in_experiments_gives_about_the_same():
    """No product of neighbours reaches over the border of two experiments."""
    rng = np.random.default_rng(2)
    e = np.zeros(4000)
    for k in range(1, 4000):
        e[k] = 0.9 * e[k - 1] + rng.standard_normal()
    j = np.column_stack([np.ones(4000), np.sin(0.05 * np.arange(4000))])
    whole, cut = (np.sqrt(np.diag(covariance(e, j, 1, lengths=n)[0])) for n in ((4000,), (1000,) * 4))
    assert cut == pytest.approx(whole, rel=0.15)


def test_the_factor_of_white_noise_is_the_symmetric_root():
    """Not one by eigenvectors, whose signs are those of the processor's LAPACK."""
    driving = np.array([[1.0, 0.3], [0.3, 2.0]])
    root = spectral_factor(np.zeros((0, 2, 2)), driving, 4)[0].real
    assert root == pytest.approx(root.T, abs=1e-15)
    assert root @ root == pytest.approx(driving, rel=1e-12)


@pytest.mark.parametrize("level", [95, 1.0, 0.0, -0.5, float("nan")])
def test_a_level_is_a_share(level):
    values = np.array([1.0, 2.0])
    info = sa.FitInfo(names=("a", "b"), values=values, covariance=np.diag([0.01, 0.04]), noise_std=values, n_samples=9)
    for asked in (info.interval, Estimate(1.0, 0.1).interval, quantile, lambda p: gain_limits(values, 8.0, p)):
        with pytest.raises(ParameterError, match=r"confidence level is .*; expected a share .*: 95 % is 0.95"):
            asked(level)
    assert info.interval(0.99)[:, 1] - values == pytest.approx(2.5758293 * np.array([0.1, 0.2]))
