"""A yaw rate that was not zeroed, alone: its offset is told from straight driving before anything is fitted to it.

Without that the linear bicycle explains it with tires of a thousandth of any car's stiffness, and never comes back.
"""

from functools import cache

import numpy as np
import pytest
from benchmarks.foreign_cars import fleet, judge

from slipangle.data.quality.plausible import doubts
from slipangle.data.quality.slow_motion import zero_of_r
from slipangle.identify.car.corrections import corrections
from slipangle.identify.car.identify_car import WholeCar
from slipangle.identify.car.stretches import stretches
from slipangle.identify.car.structures import corrected

CAR, OUTPUTS = "van", ("r",)


@cache
def sound():
    """Twelve drives of a made van, its yaw rate alone, with noise."""
    return judge.seen_of(fleet.make(CAR).train(3), OUTPUTS).hold_mean()


def log(offset):
    """The same with an offset of the yaw rate."""
    data = sound()
    return data.with_channel("r", data["r"] + offset, "rad/s")


@pytest.mark.parametrize("offset", [-0.06, 0.02, 0.0])
def test_it_is_told(offset):
    assert zero_of_r(log(offset), wheelbase=judge.known_of(fleet.make(CAR)).wheelbase) == pytest.approx(
        offset, abs=2e-3
    )


def test_at_one_speed_nothing_tells_it():
    data = log(0.06)
    steady = data.with_channel("v_x", np.full(len(data), 15.0), "m/s")
    assert zero_of_r(steady, wheelbase=3.0) == 0.0


def test_one_beyond_what_a_fit_may_correct_begins_at_the_bound_and_is_named():
    """Such a start was no parameter of any car."""
    known = judge.known_of(fleet.make(CAR))
    car = WholeCar(mass=known.mass, wheelbase=known.wheelbase, l_f=known.l_f)
    data = log(0.2)
    _, elsewhere = car._begin(data, data, stretches(data, known.wheelbase))
    assert elsewhere["bias_r"] == 0.1
    assert any(
        "0.2 rad/s on a straight: its sensor has an offset" in s for s in doubts(data, wheelbase=known.wheelbase)
    )


def test_the_fit_begins_with_it_and_finds_tires_of_a_car():
    known, data = judge.known_of(fleet.make(CAR)), log(0.06)
    car = WholeCar(mass=known.mass, wheelbase=known.wheelbase, l_f=known.l_f)
    whole = stretches(data.select(outputs=OUTPUTS), known.wheelbase)
    linear, elsewhere = car._begin(data, data, whole)
    first = corrections(whole.train, known.wheelbase, None, elsewhere)[0]
    assert first.free == ("bias_r",)
    found = corrected(linear(whole.train), first, whole.train)
    assert found.values["bias_r"] == pytest.approx(0.06, abs=2e-3)
    truth = fleet.make(CAR).truth.values
    assert 0.3 * truth["C_f"] < found.values["C_f"] < 1.5 * truth["C_f"]  # its steering is still taken to be in time
