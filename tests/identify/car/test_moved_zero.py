"""A steering whose zero moves in mid log: found, said with time and size, put back; none where it stays."""

from functools import cache

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.identify.car.identify_car import identify_car
from slipangle.identify.car.moved_zero import moved_zero
from slipangle.identify.car.stretches import stretches
from slipangle.identify.car.structures import STIFF, first_guess, fit
from tests.identify.car.test_identify_car import KNOWN, STEERING, TRUE, logs

JUMP = np.deg2rad(1.2)  # rad of delta


@cache
def still(seconds):
    """A recording whose zero stays: drives of two stretches of the fit, one behind the other."""
    parts = logs([16.0] * round(seconds / 8.0), range(round(seconds / 8.0)), seconds=8.0)
    inputs, outputs = (
        {n: np.concatenate([part[n] for part in parts]) for n in names} for names in (parts[0].inputs, parts[0].outputs)
    )
    return Dataset.from_arrays(inputs, outputs, parts[0].dt)


@cache
def short(count):
    """Recordings whose zeros stay."""
    return logs([8.0 + 2.0 * k for k in range(count)], range(count), seconds=8.0)


def one(after=None, seconds=72.0):
    """A recording whose zero is another from so many seconds on."""
    data = still(seconds)
    moved = JUMP * (data.t >= (seconds if after is None else after))
    return data.with_channel("delta", data["delta"] + moved, "rad").hold_mean()


def several(jumps):
    """Nine short ones, with such offsets of their own, as shares of a jump."""
    parts = zip(short(len(jumps)), jumps, strict=True)
    return join(*(p.with_channel("delta", p["delta"] + share * JUMP, "rad") for p, share in parts)).hold_mean()


def found_in(data, own=()):
    """The jump, by a fit of the linear bicycle with all that is needed but it."""
    cut = stretches(data, KNOWN["wheelbase"]).all
    start = first_guess(**KNOWN, dt=data.dt, outputs=data.outputs, gain=STEERING["gain"])
    free = (*STIFF, "steering_gain", "delay_delta", *(() if own else ("steering_offset",)))
    return moved_zero(fit(start, free, cut, own=own), cut)


@cache
def found_within(own=()):
    return found_in(one(after=31.0), own)


@pytest.mark.parametrize("own", [(), ("steering_offset",)])
def test_within_a_recording_it_is_found_to_a_second(own):
    found = found_within(own)
    assert found.t == pytest.approx(31.0, abs=1.0)
    assert found.by == pytest.approx(JUMP, rel=0.1)
    assert not found.first
    assert found.alone == bool(own)
    said = f"moves by {np.rad2deg(found.by):+.2g} deg of delta at t = {found.t:.3g} s, as of a column that slips"
    assert said in found.sentence


def test_what_was_logged_after_it_is_put_back():
    data, found = one(after=31.0), found_within()
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
