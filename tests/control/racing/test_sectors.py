"""Corners that a racer takes a little faster or slower than planned, by trial from lap to lap."""

import numpy as np
import pytest

from slipangle.control.racing.sectors import KEPT, STEP, Sectors
from tests.control.racing.test_racer import first_lap

MARGIN, MOST = 0.2, 0.02


def driven(sectors, times, room, turn):
    """A lap through every sector in given times, with the same room beside the car."""
    ends = np.concatenate([[0.0], sectors.ends]) + turn * sectors.length
    t = np.concatenate([[0.0], np.cumsum(times)]) + 100.0 * turn
    for s in np.arange(ends[0] - 0.5, ends[-1] + 0.9, 1.0):
        slope = (t[1] - t[0]) / (ends[1] - ends[0])
        sectors.see(s, float(np.interp(s, ends, t)) + min(s - ends[0], 0.0) * slope, room)


@pytest.fixture
def sectors():
    made = Sectors(first_lap(), MARGIN)
    assert len(made.ends) > 1
    return made


def after(sectors, laps):
    """Speeds of the sectors after laps of a time for all and a room."""
    for turn, (time, room) in enumerate(laps):
        sectors.begin_lap()
        sectors._last, sectors._begun = None, np.nan
        driven(sectors, np.full(len(sectors.ends), time), room, 10 * turn)
        sectors.times[np.isnan(sectors.times)] = time
        sectors.end_lap(MOST)
    return sectors.faster


def test_a_lap_that_knows_nothing_is_driven_as_planned(sectors):
    assert sectors.speed(np.linspace(0.0, sectors.length, 50)) == pytest.approx(1.0)


def test_times_of_sectors_are_those_between_their_ends(sectors):
    times = 3.0 + np.arange(len(sectors.ends))
    driven(sectors, times, 1.0, 0)
    assert sectors.times[1:] == pytest.approx(times[1:], abs=0.05)  # the speed changes within a metre of an end
    driven(sectors, times, 1.0, 1)
    assert sectors.times[0] > 3.0  # from the end of the lap before


def test_what_is_quicker_is_kept_and_tried_further(sectors):
    assert after(sectors, [(5.0, 1.0)]) == pytest.approx(STEP)
    assert after(sectors, [(4.9, 1.0)]) == pytest.approx(2 * STEP)


def test_what_is_slower_is_undone(sectors):
    assert after(sectors, [(5.0, 1.0), (4.9, 1.0), (5.1, 1.0)]) == pytest.approx(1.5 * STEP)
    assert after(sectors, [(5.1, 1.0)] * 9) == pytest.approx(STEP)  # what was quickest, and no more trials


def test_no_sector_is_tried_without_end(sectors):
    assert after(sectors, [(5.0 - 0.1 * k, 1.0) for k in range(20)]).max() == pytest.approx(MOST)


def test_where_less_grip_is_sure_than_was_planned_with_it_becomes_slower_at_once(sectors):
    driven(sectors, np.full(len(sectors.ends), 5.0), 1.0, 0)
    driven(sectors, np.full(len(sectors.ends), 5.0), 1.0, 1)
    sectors.end_lap(-0.01)
    assert sectors.faster == pytest.approx(-0.01)


def test_near_an_edge_it_becomes_slower_and_keeps_away(sectors):
    assert after(sectors, [(5.0, 0.6 * MARGIN)]) == pytest.approx(0.0)  # no faster
    assert after(sectors, [(4.9, 0.05)]) == pytest.approx(-STEP)
    assert sectors.narrower == pytest.approx(KEPT * MARGIN - 0.05)
    assert sectors.spare(0.5 * sectors.ends[0]) == pytest.approx(KEPT * MARGIN - 0.05)


def test_a_sector_that_was_not_driven_learns_nothing(sectors):
    sectors.end_lap(MOST)
    assert np.all(sectors.faster == 0.0)
