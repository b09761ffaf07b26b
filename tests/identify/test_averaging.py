"""Averages over which coefficients are zero, beside integrals over a grid."""

import numpy as np
import pytest

from slipangle.identify.averaging import averaged

WIDTH = np.array([0.5, 2.0])


def by_quadrature(information, pull, none):
    """Spikes and slabs, mixtures of two normals, summed on a grid; each spike has the root of ``none``."""
    absent = none**0.5
    axes = [np.linspace(-25 * w, 25 * w, 801) for w in WIDTH]
    # both present share one scale: the joint prior is summed case by case
    totals = {}
    for a in (False, True):
        for b in (False, True):
            for scale in (1.0, 3.0) if a or b else (1.0,):
                grids = []
                for on, x, width in ((a, axes[0], WIDTH[0]), (b, axes[1], WIDTH[1])):
                    slab = np.exp(-0.5 * (x / (scale * width)) ** 2)
                    spike = (np.arange(len(x)) == len(x) // 2).astype(float)
                    grids.append(slab / slab.sum() if on else spike)
                before = np.prod([1 - absent if on else absent for on in (a, b)]) / (2 if a or b else 1)
                totals[a, b, scale] = before * np.outer(*grids)
    X, Y = np.meshgrid(*axes, indexing="ij")
    log = pull[0] * X + pull[1] * Y
    log -= 0.5 * (information[0, 0] * X**2 + 2 * information[0, 1] * X * Y + information[1, 1] * Y**2)
    posterior = {case: prior * np.exp(log) for case, prior in totals.items()}
    every = sum(posterior.values())
    both = posterior[True, True, 1.0] + posterior[True, True, 3.0]
    mean = np.array([(every * X).sum(), (every * Y).sum()]) / every.sum()
    away = [X - mean[0], Y - mean[1]]
    spread = np.array([[(both * p * q).sum() for q in away] for p in away]) / both.sum()
    return mean, spread, posterior[False, False, 1.0].sum() / every.sum()


@pytest.mark.parametrize("pull", [(0.3, -0.2), (4.0, 1.0), (6.0, -3.0)])
def test_average_is_the_integral_over_all_hypotheses(pull):
    information = np.array([[6.0, 1.5], [1.5, 2.0]])
    found = averaged(information, np.array(pull), WIDTH, ("gain", "lag"))
    mean, spread, nothing = by_quadrature(information, pull, 0.5)
    assert found.mean == pytest.approx(mean, rel=1e-6)
    assert found.covariance == pytest.approx(spread, rel=1e-6)
    assert found.nothing == pytest.approx(nothing, rel=1e-6)
    assert found.given_some * (1 - found.nothing) == pytest.approx(found.mean)


def test_coefficients_of_a_group_come_together():
    """One that nothing speaks for costs the other one some belief where they are zero together or not at all."""
    information, pull = np.diag([50.0, 50.0]), np.array([20.0, 0.0])
    width = np.ones(2)
    apart, together = (averaged(information, pull, width, groups) for groups in (("a", "b"), ("a", "a")))
    assert 0 < together.mean[0] < apart.mean[0] < 0.4  # what the data alone give
    assert together.mean[1] == apart.mean[1] == 0
    assert together.nothing > apart.nothing


def test_data_that_say_nothing_leave_what_was_known_before():
    found = averaged(np.zeros((2, 2)), np.zeros(2), WIDTH, ("a", "b"), none=0.3)
    assert found.nothing == pytest.approx(0.3)
    assert not found.mean.any()
    assert np.diag(found.covariance) == pytest.approx(5.0 * WIDTH**2)  # the mean of 1 and 9
