"""A steering whose zero moves in mid log: found, said with time and size, put back; none where it stays."""

import numpy as np
import pytest

from slipangle.data.dataset import join
from slipangle.identify.car.identify_car import identify_car
from slipangle.identify.car.moved_zero import moved_zero
from slipangle.identify.car.stretches import stretches
from slipangle.identify.car.structures import STIFF, first_guess, fit
from tests.identify.car.test_identify_car import KNOWN, STEERING, TRUE, log

JUMP = np.deg2rad(1.2)  # rad of delta


def one(after=None, seconds=72.0):
    """A recording whose zero is another from so many seconds on."""
    data = log(16.0, 3, seconds=seconds)
    moved = JUMP * (data.t >= (seconds if after is None else after))
    return data.with_channel("delta", data["delta"] + moved, "rad").hold_mean()


def several(jumps):
    """Nine short ones, with such offsets of their own, as shares of a jump."""
    parts = [log(8.0 + 2.0 * k, k, seconds=8.0) for k in range(len(jumps))]
    return join(
        *(p.with_channel("delta", p["delta"] + share * JUMP, "rad") for p, share in zip(parts, jumps, strict=True))
    ).hold_mean()


def found_in(data, own=()):
    """The jump, by a fit of the linear bicycle with all that is needed but it."""
    cut = stretches(data, KNOWN["wheelbase"]).all
    start = first_guess(**KNOWN, dt=data.dt, outputs=data.outputs, gain=STEERING["gain"])
    free = (*STIFF, "steering_gain", "delay_delta", *(() if own else ("steering_offset",)))
    return moved_zero(fit(start, free, cut, own=own), cut)


@pytest.mark.parametrize("own", [(), ("steering_offset",)])
def test_within_a_recording_it_is_found_to_a_second(own):
    found = found_in(one(after=31.0), own)
    assert found.t == pytest.approx(31.0, abs=1.0)
    assert found.by == pytest.approx(JUMP, rel=0.1)
    assert not found.first
    assert found.alone == bool(own)
    said = f"moves by {np.rad2deg(found.by):+.2g} deg of delta at t = {found.t:.3g} s, as of a column that slips"
    assert said in found.sentence


def test_what_was_logged_after_it_is_put_back():
    data, found = one(after=31.0), found_in(one(after=31.0))
    back = found.without(data)
    far = np.abs(data.t - 31.0) > 1.0
    assert back["delta"][far] == pytest.approx(one()["delta"][far], abs=0.1 * JUMP)


def test_between_recordings_it_is_that_of_all_that_follow():
    found = found_in(several([0, 0, 0, 0, 0, 1, 1, 1, 1]))
    assert (found.recording, found.first) == (5, True)
    assert found.by == pytest.approx(JUMP, rel=0.1)
    assert " from recording 6 on, as of a column" in found.sentence


@pytest.mark.parametrize("data", [one, lambda: several([0] * 9)], ids=["one", "several"])
def test_a_zero_that_stays_is_none(data):
    assert found_in(data()) is None


def test_what_one_stretch_says_is_none():
    assert found_in(several([0, 0, 0, 0, 0, 0, 0, 0, 1])) is None


def test_a_drift_is_no_jump():
    """A road's cross slope that comes and goes; less than a quarter of a degree."""
    data = one()
    swings = np.deg2rad(0.15) * np.sin(2 * np.pi * data.t / 50.0)
    assert found_in(data.with_channel("delta", data["delta"] + swings, "rad")) is None


def test_clocks_that_start_again_within_a_recording_tell_no_order():
    data = several([0, 0, 0, 0, 0, 1, 1, 1, 1])
    numbered = data.with_channel("recording", np.zeros(data.n_samples))
    assert found_in(numbered) is None


@pytest.mark.slow
def test_a_car_is_that_before_it():
    """Of a made van whose zero was taken to stay C_f was 0.42 of the truth, and no delay was found."""
    car = identify_car(several([0, 0, 0, 0, 0, 1, 1, 1, 1]), **KNOWN)
    (said,) = car.doubts
    assert said.startswith("the steering's zero moves by +1.2 deg of delta from recording 6 on")
    for name in STIFF:
        low, high = car.interval(name)
        assert low <= TRUE[name] <= high, name
    assert car.model.value("steering_gain") == pytest.approx(STEERING["gain"], rel=0.02)
    assert car.model.value("steering_offset") == pytest.approx(STEERING["offset"], abs=1e-3)
