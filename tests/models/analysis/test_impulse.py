"""Regularised impulse responses: against the Gaussian posterior written out, against truth, and by coverage."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

import slipangle as sa
from slipangle.errors import ExcitationError, ParameterError, TooShortError
from slipangle.models.analysis.impulse import _Evidence

DT, N = 0.05, 50
TRUE = lfilter([0.0, 0.4, 0.1], [1.0, -1.4, 0.6], np.eye(1, N)[0])


def log(seed, samples=400, noise=0.3):
    rng = np.random.default_rng(seed)
    u = lfilter([1.0], [1.0, -0.7], rng.standard_normal(samples))
    y = lfilter([0.0, 0.4, 0.1], [1.0, -1.4, 0.6], u) + noise * rng.standard_normal(samples)
    return sa.Dataset.from_arrays({"delta": u}, {"r": y}, DT, units={"delta": "rad", "r": "rad/s"})


@pytest.mark.parametrize("kernel", ["TC", "DC"])
def test_the_evidence_is_the_likelihood_of_the_data(kernel):
    rng = np.random.default_rng(1)
    rows, seen = rng.standard_normal((30, 6)), rng.standard_normal(30)
    problem = _Evidence(rows, seen, kernel)
    shared = [0.8] if kernel == "TC" else [0.8, 0.6]
    differences = []
    for ratio in (0.1, 2.0):
        theta = np.array([*shared, np.log(ratio)])
        shape = np.eye(30) + ratio * rows @ problem.prior(theta[:-1]) @ rows.T
        noise = seen @ np.linalg.solve(shape, seen) / 30  # the one of the largest likelihood
        exact = -2 * multivariate_normal(np.zeros(30), noise * shape).logpdf(seen)
        differences.append(problem(theta) - exact)
    assert differences[0] == pytest.approx(differences[1], abs=1e-5)  # a constant apart


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["TC", "DC"])
def test_it_comes_closer_than_least_squares_and_its_bands_cover(kernel):
    inside, errors, plain = [], [], []
    for seed in range(12):
        data = log(seed)
        found = sa.impulse_response(data, duration=(N - 1) * DT, kernel=kernel)
        g = DT * found.y
        inside.append(np.abs(found.y - TRUE / DT) <= 1.96 * found.std)
        errors.append(np.sum((g - TRUE) ** 2))
        u, y = data["delta"] - data["delta"].mean(), data["r"] - data["r"].mean()
        rows = np.lib.stride_tricks.sliding_window_view(u, N)[:, ::-1]
        plain.append(np.sum((np.linalg.lstsq(rows, y[N - 1 :], rcond=None)[0] - TRUE) ** 2))
    assert np.mean(errors) < 0.35 * np.mean(plain)
    assert 0.85 <= np.mean(inside) <= 1.0


def test_without_noise_it_is_the_response():
    found = sa.impulse_response(log(3, noise=0.0), duration=(N - 1) * DT)
    assert DT * found.y == pytest.approx(TRUE, abs=0.01)
    assert found.unit == "((rad/s)/rad)/s"
    assert found.kind == "impulse"


def test_bad_input_is_said():
    data = log(0)
    with pytest.raises(TooShortError, match="shorten the duration"):
        sa.impulse_response(data, duration=15.0)
    with pytest.raises(ParameterError, match="resample the log"):
        sa.impulse_response(data, duration=50.0)
    with pytest.raises(ParameterError, match="'TC' or 'DC'"):
        sa.impulse_response(data, kernel="SS")
    with pytest.raises(ExcitationError, match="does not move"):
        sa.impulse_response(data.with_channel("delta", np.ones(400), "rad"))
