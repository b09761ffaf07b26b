"""Intervals of output-error and state-space models hold the truth, whatever the colour of the residuals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ParameterError
from slipangle.identify.linear.polynomial import OutputError
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.linear.subspace import Subspace
from slipangle.numerics.covariance import autoregression, middle_of_autoregression

A, B = np.array([1.0, -1.5, 0.7]), np.array([0.0, 1.0, 0.5])
COEFFICIENTS = np.array([1.0, 0.5, -1.5, 0.7])


def record(rng, pole, n=1000):
    u, e = rng.standard_normal((2, n + 200))
    y = lfilter(B, A, u)
    noise = 0.2 * np.std(y) * np.sqrt(1 - pole**2) * lfilter([1.0], [1.0, -pole], e)
    return Dataset.from_arrays({"u": u[200:]}, {"y": (y + noise)[200:]}, 1.0)


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_output_error(pole):
    rng = np.random.default_rng(0)
    found = [OutputError(nb=2, nf=2).fit(record(rng, pole)).fit_info for _ in range(40)]
    inside = [np.abs(f.values - COEFFICIENTS) < 1.96 * f.std for f in found]
    assert np.mean(inside) >= 0.9
    assert np.mean(inside, axis=0).min() >= 0.85
    assert ("autoregression" in found[0].method) == (pole > 0)


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_free_run_of_a_state_space(pole):
    rng = np.random.default_rng(1)
    modes = [StateSpace(order=2, focus="simulation").fit(record(rng, pole)).modes() for _ in range(40)]
    p = np.roots(A)[0]
    truth = {"modulus[0]": abs(p), "angle[0]": abs(np.angle(p)), "gain[y,u]": B.sum() / A.sum()}
    for name, value in truth.items():
        at = modes[0].names.index(name)
        assert np.mean([abs(m.values[at] - value) < 1.96 * m.std[at] for m in modes]) >= 0.87, name


def test_a_record_cut_into_experiments_gives_about_the_same_interval():
    """Cut in four, with an initial state each, a record of coloured noise gives about the same interval."""
    rng = np.random.default_rng(2)
    data = record(rng, 0.9, 4000)
    cut = join(*(data.rows(a, a + 1000) for a in range(0, 4000, 1000)))
    whole, parts = (OutputError(nb=2, nf=2).fit(d).fit_info.std for d in (data, cut))
    assert parts == pytest.approx(whole, rel=0.15)


def test_gradient_of_an_autoregression_is_the_sum_over_all_pairs():
    rng = np.random.default_rng(3)
    first, second = np.array([[0.5, 0.2], [-0.3, 0.6]]), np.array([[0.1, 0.0], [0.1, -0.2]])
    driving, n = np.array([[1.0, 0.4], [0.4, 0.5]]), 60
    psi = [np.eye(2), first]
    for _ in range(400):
        psi.append(first @ psi[-1] + second @ psi[-2])
    gamma = [sum(a @ driving @ b.T for a, b in zip(psi[lag:], psi, strict=False)) for lag in range(n)]
    jacobian = rng.standard_normal((n, 2, 3))
    pairs = toeplitz(np.arange(n))
    expected = sum(
        jacobian[i].T @ (gamma[pairs[i, k]] if i >= k else gamma[pairs[i, k]].T) @ jacobian[k]
        for i in range(n)
        for k in range(n)
    )
    found = middle_of_autoregression(jacobian, np.array([first, second]), driving)
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


def test_autoregression_is_found():
    rng = np.random.default_rng(4)
    first = np.array([[0.7, 0.2], [0.0, 0.4]])
    e = np.zeros((6000, 2))
    for k in range(1, len(e)):
        e[k] = first @ e[k - 1] + rng.standard_normal(2) * [1.0, 0.5]
    found, driving = autoregression([e[:2500], e[2500:]])
    assert len(found) == 1
    assert found[0] == pytest.approx(first, abs=0.05)
    assert driving == pytest.approx(np.diag([1.0, 0.25]), abs=0.05)
    orders = [len(autoregression([rng.standard_normal((500, 1))])[0]) for _ in range(100)]
    assert np.mean(np.array(orders) > 0) <= 0.05


def test_modes_are_carried_over_as_finite_differences_say():
    rng = np.random.default_rng(5)
    u = rng.standard_normal((1500, 2))
    first, second = lfilter(B, A, u[:, 0]), lfilter([0.0, 0.4], [1.0, -0.6], u[:, 1])
    y = np.column_stack([first + second, second]) + 0.1 * rng.standard_normal((1500, 2))
    data = Dataset.from_arrays({"u": u[:, 0], "w": u[:, 1]}, {"y": y[:, 0], "z": y[:, 1]}, 1.0)
    model = StateSpace(order=3, focus="simulation").fit(data)
    modes, info, step = model.modes(), model.fit_info, 1e-6
    slope = np.zeros((len(modes.names), len(info.names)))
    for k, name in enumerate(info.names):
        i, j = map(int, name[2:-1].split(","))
        both = []
        for sign in (1, -1):
            entry = np.array(getattr(model, name[0]))
            entry[i, j] += sign * step
            both.append(replace(model, **{name[0]: entry}).modes().values)
        slope[:, k] = (both[0] - both[1]) / (2 * step)
    expected = np.sqrt(np.diag(slope @ info.covariance @ slope.T))
    assert modes.std == pytest.approx(expected, rel=1e-4, abs=1e-9)
    with pytest.raises(ParameterError, match="how uncertain A is"):
        Subspace(order=2).fit(data).modes()
