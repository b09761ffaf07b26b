"""Lines through noisy points against the line that they were made of."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ParameterError


def winding(seed, length=900.0):
    """A closed line of random bends."""
    rng, a = np.random.default_rng(seed), np.linspace(0, 2 * np.pi, 1000)[:-1]
    r = 1 + sum(0.16 / k**0.7 * rng.normal() * np.cos(k * a + rng.uniform(0, 2 * np.pi)) for k in range(2, 7))
    size = length / np.hypot(np.diff(r * np.cos(a)), np.diff(r * np.sin(a))).sum()
    return sa.Path.from_points(size * r * np.cos(a), size * r * np.sin(a), closed=True)


def measured(true, noise, step, seed, **how):
    at, rng = true.at(np.arange(0.0, true.length - step / 2, step)), np.random.default_rng(seed)
    X, Y = (c + noise * rng.normal(size=len(c)) for c in (at.X, at.Y))
    return sa.Path.from_points(X, Y, closed=true.closed, **how)


@pytest.mark.parametrize(("noise", "step"), [(0.5, 1.5), (1.0, 1.5), (2.0, 1.5), (0.5, 0.3), (0.2, 1.0), (0.5, 5.0)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_line_and_its_curvature_are_those_under_the_noise(seed, noise, step):
    """A spline that is cut to what is off at the points is up to 5 m off at a noise of 2 m, and bends to and fro."""
    true = winding(seed)
    found = measured(true, noise, step, seed, smoothing=noise)
    feet = true.project_all(found.X, found.Y)
    assert np.sqrt(np.mean(feet[:, 1] ** 2)) < 0.3 * noise * max(step / 1.5, 1.0) ** 0.5
    assert found.length == pytest.approx(true.length, rel=0.01)
    bend = true.at(feet[:, 0]).curvature
    assert np.sqrt(np.mean((found.curvature - bend) ** 2)) < 0.35 * np.sqrt(np.mean(bend**2))


@pytest.mark.parametrize("said", [0.01, 0.15, 1.0])
def test_a_deviation_said_wrongly_does_little(said):
    true = winding(1)
    found = measured(true, 0.5, 1.5, 1, smoothing=said)
    assert np.sqrt(np.mean(true.project_all(found.X, found.Y)[:, 1] ** 2)) < 0.2


def test_a_clean_line_stays_what_it_is():
    true = winding(2)
    found = measured(true, 0.0, 3.0, 0, smoothing=0.05)
    assert np.abs(true.project_all(found.X, found.Y)[:, 1]).max() < 0.1


def test_a_noisy_straight_becomes_straight():
    X, rng = np.linspace(0.0, 1000.0, 400), np.random.default_rng(0)
    line = sa.Path.from_points(X, 0.2 * rng.normal(size=400), smoothing=0.2, right=3.0, left=np.linspace(3.0, 4.0, 400))
    assert np.abs(line.Y).max() < 0.1
    assert np.abs(line.curvature).max() < 1e-4
    assert line.length == pytest.approx(1000.0, abs=0.5)
    assert line.at(500.0).left[0] == pytest.approx(3.5, abs=0.01)


def test_far_from_the_origin_the_line_is_the_same():
    true = winding(3)
    near = measured(true, 0.3, 2.0, 0, smoothing=0.3)
    at, rng = true.at(np.arange(0.0, true.length - 1.0, 2.0)), np.random.default_rng(0)
    X, Y = (c + 0.3 * rng.normal(size=len(c)) for c in (at.X, at.Y))
    far = sa.Path.from_points(X + 6e5, Y + 5e6, closed=True, smoothing=0.3)
    np.testing.assert_allclose(far.X[::50] - 6e5, near.X[::50], atol=1e-3)


def test_a_smoothing_that_leaves_nothing_of_the_line_is_named():
    a = np.linspace(0, 2 * np.pi, 30)[:-1]
    with pytest.raises(ParameterError, match=r"no smooth line with a smoothing of 100 m .* a smoothing as large as"):
        sa.Path.from_points(30 * np.cos(a), 30 * np.sin(a), closed=True, smoothing=100.0)
