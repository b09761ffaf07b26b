"""Levenberg-Marquardt beside closed forms and SciPy's trust-region method."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize

from slipangle.numerics.least_squares import LevenbergMarquardt, cholesky, least_squares, triangle

X = np.linspace(0, 3, 40)
TRUE = np.array([2.0, 0.8, 0.3])
Y = TRUE[0] * np.exp(-TRUE[1] * X) + TRUE[2] + 0.05 * np.random.default_rng(0).standard_normal(40)


def errors(p):
    return (p[0] * np.exp(-p[1] * X) + p[2] - Y) / 0.05


def jacobian(p):
    decay = np.exp(-p[1] * X)
    return np.column_stack([decay, -p[0] * X * decay, np.ones_like(X)]) / 0.05


@pytest.mark.parametrize("steady", [False, True])
def test_rosenbrock_from_far_away(steady):
    def e(p):
        return np.array([10 * (p[1] - p[0] ** 2), 1 - p[0]])

    search = LevenbergMarquardt(
        cost=lambda p: float(e(p) @ e(p)),
        linearise=lambda p: (*triangle(np.array([[-20 * p[0], 10.0], [-1.0, 0.0]]), e(p)), None),
        move=lambda p, _, eta: p + eta,
        steady=steady,
    )
    result = search.minimise(np.array([-1.2, 1.0]), max_iterations=100)
    assert result.converged
    assert result.point == pytest.approx([1, 1], abs=1e-8)


@pytest.mark.parametrize("seed", range(8))
def test_linear_problem_with_bounds_is_that_of_scipy(seed):
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(30, 6)), rng.normal(size=30)
    lower, upper = -0.1 * rng.uniform(0, 1, 6), 0.1 * rng.uniform(0, 1, 6)
    expected = optimize.lsq_linear(A, b, (lower, upper), method="bvls")
    got = least_squares(
        np.zeros(6), errors=lambda z: A @ z - b, jacobian=lambda z: A, bounds=(lower, upper), tolerance=1e-14
    )
    assert got.converged
    assert np.all((got.point >= lower) & (got.point <= upper))
    assert got.point == pytest.approx(expected.x, abs=1e-6)


@pytest.mark.parametrize("loss", ["squares", "huber", "cauchy"])
def test_robust_losses_are_those_of_scipy(loss):
    outliers = np.zeros(40)
    outliers[[3, 17, 30]] = 40.0, -25.0, 60.0
    known = "linear" if loss == "squares" else loss
    expected = optimize.least_squares(
        lambda p: errors(p) + outliers, [1.0, 1.0, 0.0], jac=jacobian, loss=known, xtol=1e-12, ftol=1e-14, gtol=1e-12
    )
    got = least_squares(
        np.array([1.0, 1.0, 0.0]), errors=lambda p: errors(p) + outliers, jacobian=jacobian, loss=loss, tolerance=1e-14
    )
    assert got.cost == pytest.approx(2 * expected.cost, rel=1e-9)
    assert got.point == pytest.approx(expected.x, abs=1e-4)
    bias = np.abs(got.point - TRUE).max()
    assert (bias < 0.1) == (loss != "squares")


def test_prior_gives_the_posterior_mean_of_a_linear_problem():
    rng = np.random.default_rng(3)
    A, b, mean, std = rng.normal(size=(20, 3)), rng.normal(size=20), np.array([1.0, -2.0, 0.5]), np.array([0.1, 1, 1e9])
    precision = np.diag(std**-2.0)
    expected = np.linalg.solve(A.T @ A + precision, A.T @ b + precision @ mean)
    got = least_squares(np.zeros(3), errors=lambda z: A @ z - b, jacobian=lambda z: A, prior=(mean, std))
    assert got.point == pytest.approx(expected, abs=1e-6)


def test_prior_of_infinite_width_is_none():
    wide = np.zeros(3), np.full(3, np.inf)
    plain = least_squares(np.ones(3), errors=errors, jacobian=jacobian)
    assert least_squares(np.ones(3), errors=errors, jacobian=jacobian, prior=wide).point == pytest.approx(plain.point)


def test_both_factors_hold_the_gauss_newton_matrix_and_the_gradient():
    j, e = jacobian(TRUE + 0.1), errors(TRUE + 0.1)
    for r, right in (triangle(j, e), cholesky(j.T @ j, j.T @ e)):
        assert r.T @ r == pytest.approx(j.T @ j, rel=1e-9)
        assert r.T @ right == pytest.approx(-j.T @ e, rel=1e-9)


def test_directions_that_the_errors_do_not_show_stay():
    A = np.array([[1.0, 1.0], [2.0, 2.0]])
    got = least_squares(np.array([3.0, 1.0]), errors=lambda z: A @ z - [1.0, 2.0], jacobian=lambda z: A)
    assert got.point[0] - got.point[1] == pytest.approx(2.0)
    assert got.point.sum() == pytest.approx(1.0)


def test_a_point_where_the_errors_do_not_exist_is_refused():
    def log_errors(p):
        with np.errstate(invalid="ignore"):
            return np.log(p) - np.array([0.0])

    got = least_squares(np.array([20.0]), errors=log_errors, jacobian=lambda p: np.array([[1 / p[0]]]))
    assert got.point == pytest.approx([1.0])


def test_the_limit_on_steps_is_said():
    assert not least_squares(np.array([1.0, 1.0, 0.0]), errors=errors, jacobian=jacobian, max_iterations=1).converged
