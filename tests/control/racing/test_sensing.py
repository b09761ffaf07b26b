"""What a racer believes of its sensors: glitches in every channel, at any time, and a sensor that really changed."""

from functools import cache

import numpy as np
import pytest

from slipangle.control.racing.sensing import NOISE, Sensing
from tests.control.racing.test_racer import believed

GLITCHES = {"X": 8.0, "Y": -1e3, "psi": 0.2, "v_x": 1e6, "r": 0.5, "a_x": -15.0, "a_y": 1e3}
WHEELS = {"delta": 0.02, "F_x": 500.0}


@cache
def bend():
    """Sensors of a car in a bend, with noise, shape (300, 7): its filter's own car, from where that is settled."""
    sensing, rng = sensed(), np.random.default_rng(3)
    model = sensing.filter.model
    x, u, rows = np.array([0.0, 0.0, 0.3, 15.0, 0.0, 0.0, 0.0, 0.0]), np.array(list(WHEELS.values())), []
    for _ in range(400):
        x = np.asarray(model.step(x, u))
        rows.append(np.asarray(model.output(x, u)) + rng.standard_normal(7) * list(NOISE.values()))
    return np.array(rows[100:])


def sensed(**settings):
    given = {"grip_std": 0.03, "noise": {}, "gate": 6.0, "patience": 25, "sample": 0.01, **settings}
    return Sensing(believed(), **given)


def states(rows, sensing):
    """Estimates over rows of sensors; NaN where there is none."""
    found = []
    for k, row in enumerate(rows):
        known = sensing.take(dict(zip(NOISE, row.tolist(), strict=True)), WHEELS, 0.01 * k)
        found.append(sensing.known.state if known else np.full(8, np.nan))
    return np.array(found)


@pytest.mark.parametrize("length", [1, 5])
@pytest.mark.parametrize("name", NOISE)
def test_a_glitch_is_not_believed(name, length):
    """It leaves the state as if the channel had not been measured, and is counted; the others are not."""
    i, rows = list(NOISE).index(name), bend().copy()
    rows[100 : 100 + length, i] += GLITCHES[name]
    missing = rows.copy()
    missing[100 : 100 + length, i] = np.nan
    sensing, spared = sensed(), sensed()
    assert np.array_equal(states(rows, sensing)[1:], states(missing, spared)[1:])
    assert sensing.outliers == {**dict.fromkeys(NOISE, 0), name: length}
    assert spared.outliers == dict.fromkeys(NOISE, 0)
    assert sensing.restarts == 0


def test_glitches_at_random_are_not_believed():
    rng, rows = np.random.default_rng(5), bend().copy()
    wrong = rng.uniform(size=rows.shape) < 0.01
    wrong[:2] = False
    rows += wrong * rng.choice([-1, 1], rows.shape) * list(GLITCHES.values())
    sensing = sensed()
    assert np.array_equal(states(rows, sensing)[1:], states(np.where(wrong, np.nan, rows), sensed())[1:])
    assert list(sensing.outliers.values()) == wrong.sum(axis=0).tolist()
    assert wrong.sum(axis=0).min() > 0


def test_a_broken_sensor_is_never_believed():
    """Speeds that no car has, or that jump about, for as long as they come."""
    for values in (np.full(200, 1e6), 40.0 * (-1.0) ** np.arange(200)):
        rows, missing = bend().copy(), bend().copy()
        rows[100:, 3] = values
        missing[100:, 3] = np.nan
        sensing = sensed()
        assert np.array_equal(states(rows, sensing)[1:], states(missing, sensed())[1:])
        assert sensing.outliers["v_x"] == 200
        assert sensing.age(3.0)["v_x"] == pytest.approx(2.01)
        assert sensing.age(3.0)["X"] == pytest.approx(0.01)


def test_what_is_missing_is_no_outlier():
    rows = bend().copy()
    rows[50:60, 2:5] = np.nan
    sensing = sensed()
    assert np.isfinite(states(rows, sensing)[1:]).all()
    assert not any(sensing.outliers.values())


def test_a_sensor_that_really_changed_is_believed_after_a_while():
    rows = bend().copy()
    rows[100:, 0] += 3.0
    sensing = sensed()
    found, before = states(rows, sensing), states(bend(), sensed())
    assert np.array_equal(found[1:100], before[1:100])
    assert np.abs(found[124] - before[124])[0] < 0.1
    assert (found[-1] - before[-1])[0] == pytest.approx(3.0, abs=0.1)
    assert sensing.restarts == 0


@pytest.mark.parametrize("name", ["X", "Y", "psi", "v_x", "r"])
def test_the_drive_does_not_begin_with_a_glitch(name):
    """In the first sample, or in the second one: it begins when two agree."""
    i = list(NOISE).index(name)
    for at in (0, 1):
        rows = bend().copy()
        rows[at, i] += 0.3 * min(GLITCHES[name], 100.0)
        sensing = sensed()
        found = states(rows, sensing)
        known = np.isfinite(found[:, 0])
        assert known.tolist() == [False] * (at + 2) + [True] * (len(rows) - at - 2)
        assert sensing.restarts == at + 1
        assert (np.abs(found - states(bend(), sensed()))[10:, :4] < [0.2, 0.2, 0.02, 0.2]).all()


def test_an_estimate_that_is_no_car_is_dropped():
    """A filter without a gate takes a position that jumps by kilometres for kilometres a second."""
    rows = bend().copy()
    rows[100, 0] += 1e6
    sensing = sensed(gate=None)
    found = states(rows, sensing)
    assert sensing.restarts > 0
    assert np.nanmax(np.abs(found[:, 4])) < 120.0
