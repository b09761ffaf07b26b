"""A steering whose ratio changes with its angle: said with its share, counted in the intervals."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.identify.car.corrections import LOCKED
from slipangle.identify.car.rack import changing, with_rack
from slipangle.identify.car.structures import STIFF
from tests.identify.car.test_identify_car import drives as of_car
from tests.identify.car.test_late import AT_ONCE, fitted

NODES = np.linspace(0.0, 0.12, 61)  # rad


def drives(share, largest=0.06):
    """As logged before a rack that turns the wheels so much more at ``largest`` than straight ahead, in the middle."""
    data = of_car((9, 13, 17, 21, 25, 29), steering=AT_ONCE)
    z = np.minimum(NODES / largest, 1.0)
    road = NODES * (1.0 + share * z * z * (3.0 - 2.0 * z))
    angle = data["delta"]
    return data.with_channel("delta", np.sign(angle) * np.interp(np.abs(angle), road, NODES), "rad")


@pytest.mark.parametrize("share", [0.15, -0.15])
def test_it_is_found_said_and_counted(share):
    data, known = drives(share), fitted(drives(0.0), "steering_gain").values
    final = fitted(data, "steering_gain")
    shares, straight = changing(final, data)
    assert shares[-1] == pytest.approx(share, abs=0.035)
    off, left = (max(abs(f.values[n] / known[n] - 1.0) for n in (*STIFF, "steering_gain")) for f in (final, straight))
    assert off > 0.07
    assert left < 0.4 * off
    others, (said,) = with_rack(final, [], [], data)
    assert others[0][1] == 1.0
    assert said.startswith(f"the steering turns the wheels {100 * np.abs(shares).max():.2g} %")
    assert (" % more at " if share > 0 else " % less at ") in said


def test_the_gain_straight_ahead_is_found_with_it_where_it_was_given():
    """What was given may be that of a mean angle."""
    data = drives(0.15)
    assert "steering_gain" in changing(fitted(data), data)[1].names


def test_a_rack_of_one_ratio_is_none():
    data = drives(0.0)
    assert changing(fitted(data), data) is None
    assert with_rack(fitted(data, "steering_gain"), [], [], data) == ([], [])


def test_where_the_rear_wheels_turn_as_one_a_rack_is_one_of_two_things_that_it_may_be(monkeypatch):
    data = drives(0.15)
    final = fitted(data, "steering_gain")
    found = changing(final, data)
    monkeypatch.setattr("slipangle.identify.car.rack.changing", lambda *_: found)
    _, (said,) = with_rack(replace(final, free=(*final.free, *LOCKED)), [], [], data)
    assert "as a rack whose ratio changes does, and as rear wheels that turn as one" in said
    assert "if it is the rack" in said
