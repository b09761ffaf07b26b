"""A gearbox that shifts by itself, against the dual track's own."""

import numpy as np
import pytest

from slipangle.control.racing.gearbox import SURE, Gearbox
from slipangle.errors import ParameterError
from slipangle.models.vehicles.catalogue import BMW_320I

BOX = Gearbox(up=(15.0, 28.0), down=(11.0, 18.0))


def test_gears_follow_the_driveline_s_own_rule():
    line, box = BMW_320I.driveline, Gearbox.of(BMW_320I)
    v_x = 25.0 + 17.0 * np.sin(np.linspace(0.0, 2 * np.pi, 400, endpoint=False))
    gear, expected = 1.0, np.zeros(400)
    for k in range(800):
        for _ in range(5):  # samples of the plant while the car is there
            gear = float(line.next_gear(gear, v_x[k % 400] / BMW_320I.radius * line.ratio(gear)))
        expected[k % 400] = gear
    assert np.array_equal(box.gears(v_x), expected)
    assert len(np.unique(expected)) > 2


def test_gears_ahead_begin_with_the_one_that_is_in():
    v_x = np.array([20.0, 20.0, 14.0, 10.0, 20.0, 29.0])
    assert BOX.along(v_x, 2).tolist() == [2, 2, 2, 1, 2, 3]
    assert BOX.along(v_x, 3).tolist() == [3, 3, 2, 1, 2, 3]


def test_a_bend_a_little_too_fast_for_the_lower_gear_is_slowed_down():
    for slowest, limited in ((18.5, True), (17.5, True), (20.0, False), (16.0, False)):
        most = BOX.slow_enough(np.concatenate([np.linspace(35.0, slowest, 20), np.linspace(slowest, 35.0, 20)[1:]]))
        assert np.isfinite(most).sum() == limited
        assert not limited or most[19] == pytest.approx(SURE * 18.0)


def test_a_bend_that_is_reached_in_the_lower_gear_is_not_slowed_down():
    v_x = np.concatenate([np.linspace(35.0, 12.0, 20), np.linspace(12.0, 25.0, 10), np.linspace(25.0, 18.5, 10)])
    v_x = np.concatenate([v_x, np.linspace(18.5, 35.0, 10)[1:]])
    assert BOX.gears(v_x)[39] == 2  # first below 28 m/s, since it came from 12 m/s
    assert not np.isfinite(BOX.slow_enough(v_x)[39])


def test_a_gearbox_that_would_hunt_is_refused():
    with pytest.raises(ParameterError, match="shifts down at the lower speed"):
        Gearbox(up=(15.0,), down=(15.0,))
