"""Sensors of another scale, turned, or of another quantity: told apart, corrected in the fit, said."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slipangle.identify.car.climb import linear_bicycle
from slipangle.identify.car.corrections import LEVER, LOCKED, SCALE, SPEED, Correction
from slipangle.identify.car.effects import outdone, told
from slipangle.identify.car.identify_car import identify_car
from slipangle.identify.car.sensors import of_either_scale, scales, sensors
from slipangle.identify.car.side_slip import side_slip
from slipangle.identify.car.stretches import stretches
from slipangle.identify.car.structures import STIFF, corrected, first_guess, fit
from tests.identify.car.test_identify_car import DT, KNOWN, OUTPUTS, STEERING, TRUE, drives

AT_ONCE = dict(delay=0.0, lag=0.002, gain=1.0, offset=0.0)
GUESS = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0)
PLACE, SIZE = Correction("its place is free", LEVER), Correction("its scale is free", SCALE)


def read(data, name, of):
    """A log with a channel as another sensor reads it."""
    return data.with_channel(name, of(data), data.unit(name))


FAULTS = {
    "v_y larger": (LEVER, lambda d: read(d, "v_y", lambda d: 1.2 * d["v_y"])),
    "r larger": (LEVER, lambda d: read(d, "r", lambda d: 1.1 * d["r"])),
    "v_x larger": (SCALE, lambda d: read(d, "v_x", lambda d: 1.1 * d["v_x"])),
    "v_y ahead": (SCALE, lambda d: read(d, "v_y", lambda d: d["v_y"] + 0.5 * d["r"])),
}


def test_a_v_y_that_is_too_large_and_turned_leaves_stiffness_as_it_is():
    """A fifth too large it moved stiffness by a fifth, three degrees by two fifths, beside narrow intervals."""
    data = read(drives(), "v_y", lambda d: 1.2 * d["v_y"] + 0.05 * d["v_x"])
    found = identify_car(data, **KNOWN)
    for name in STIFF:
        low, high = found.interval(name)
        assert low <= TRUE[name] <= high, name
        assert found.model.value(name) == pytest.approx(TRUE[name], rel=0.06)
    assert found.model.value("gain_v_y") == pytest.approx(1.2, abs=0.03)
    assert found.model.value("turn_v_y") == pytest.approx(0.05, abs=0.002)
    assert any("its sensor is turned by 2.9 deg, corrected in the fit" in s for s in found.doubts)
    assert any(s.startswith("v_y reads 1.") and "hold for either; see whether r" in s for s in found.sentences)
    assert not any("offset of" in s or "turned as one" in s or "v_x is logged" in s for s in found.sentences)


def test_a_yaw_rate_that_is_too_large_is_that_and_the_true_gain_is_in_its_interval():
    data = read(drives(outputs=("v_y", "r", "a_y")), "r", lambda d: 1.15 * d["r"]).select(
        inputs=("delta", "v_x", "a_y"), outputs=OUTPUTS
    )
    found = identify_car(data, **KNOWN)
    truth = TRUE | {"steering_gain": STEERING["gain"]}
    for name in (*STIFF, "steering_gain"):
        low, high = found.interval(name)
        assert low <= truth[name] <= high, name
    (said,) = (s for s in found.sentences if s.startswith("v_y reads 0."))
    assert said.endswith(" times v_x r in bends, says that it is r")


@pytest.fixture(scope="module")
def begun():
    """Of each fault, the log, and the car fitted without a sensor of another place or scale."""
    start = GUESS.with_values(mu_f=0.9, mu_r=1.0)
    logs = {name: change(drives(steering=AT_ONCE)) for name, (_, change) in FAULTS.items()}
    return {name: (data, fit(start, (*STIFF, "steering_gain"), data)) for name, data in logs.items()}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_what_explains_most_by_itself(begun, name):
    """Place and scale of v_y, and a scale of v_x, each take a part of what another does."""
    data, before = begun[name]
    by = {LEVER: PLACE, SCALE: SIZE}
    wrong = by[FAULTS[name][0]]
    assert outdone(before, corrected(before, wrong, data), wrong, data)
    right = next(c for c in by.values() if c is not wrong)
    after = corrected(before, right, data)
    assert outdone(before, after, right, data) == (name == "v_x larger")
    assert not outdone(before, after, Correction("another", SPEED), data)
    if name == "r larger":  # motion that is larger as a whole is that of larger steering
        assert after.values["gain_v_y"] == pytest.approx(1 / 1.1, abs=0.01)
        for n in STIFF:
            assert after.values[n] == pytest.approx(TRUE[n], rel=0.03)


def test_rear_wheels_that_turn_as_one_are_no_scale():
    data = drives(true=TRUE | dict(locked_half_track=0.8), steering=AT_ONCE)
    before = fit(GUESS.with_values(mu_f=0.9, mu_r=1.0), (*STIFF, "steering_gain"), data)
    solid = Correction("solid", LOCKED, ({LOCKED[0]: 0.5},), instead={LEVER[0]: 0.0, SCALE[0]: 1.0})
    assert not outdone(before, corrected(before, solid, data), solid, data)
    scaled = corrected(before, SIZE, data)
    alone = corrected(scaled, solid, data)
    assert SCALE[0] not in alone.free  # which had stood in for it
    assert alone.model.value(SCALE[0]) == 1.0
    assert alone.values[LOCKED[0]] == pytest.approx(0.8, abs=0.1)


def test_beside_a_scale_a_place_counts_from_a_twentieth_of_the_wheelbase(begun):
    """Both together take what a model lacks."""
    data, before = begun["v_y larger"]
    both = corrected(corrected(before, SIZE, data), PLACE, data)
    assert told(both, LEVER) < 1.0
    assert told(corrected(before, PLACE, data), LEVER) > 1.0
    moved = read(data, "v_y", lambda d: d["v_y"] + 0.6 * d["r"])
    assert told(corrected(corrected(before, SIZE, moved), PLACE, moved), LEVER) >= 1.0


@pytest.mark.parametrize("speeds", [(9, 13, 17, 21, 25, 29), (17, 17, 17)])
def test_a_side_slip_angle_is_told_at_any_speeds_and_a_speed_is_none(speeds):
    data = drives(speeds)
    angle = read(data, "v_y", lambda d: np.arctan(d["v_y"] / d["v_x"]))
    small = read(data, "v_y", lambda d: 0.3 * d["v_y"])  # as small as an angle

    def said(data):
        return side_slip(partial(linear_bicycle, GUESS, (), {}), stretches(data, KNOWN["wheelbase"]))

    (sentence,) = said(angle)
    assert sentence.startswith("v_y is a side slip angle: read as v_x times its tangent the log leaves ")
    assert said(data) == ()
    assert len(set(speeds)) == 1 or said(small) == ()  # at one speed it is any number of times a speed


def named(**values: float) -> Any:
    """What a fit found, of a car that drives between 10 and ``fast`` m/s."""
    fast = values.pop("fast", 30.0)
    problem = SimpleNamespace(base_names=tuple(values), data={"v_x": np.linspace(10.0, fast, 50)})
    return SimpleNamespace(names=tuple(values), values=values, problem=problem)


def test_a_turned_sensor_is_said_where_it_is_turned_and_at_one_speed_may_have_an_offset():
    sure = np.array([[1e-8]])
    (said,) = sensors(named(turn_v_y=-0.03), sure)
    assert said.startswith("v_y is -0.03 of v_x on a straight: its sensor is turned by -1.7 deg, corrected")
    assert "or has an offset" in sensors(named(turn_v_y=-0.03, fast=11.0), sure)[0]
    assert sensors(named(turn_v_y=0.008), sure) == sensors(named(turn_v_y=0.03), np.array([[1e-4]])) == []


@pytest.mark.parametrize(("gain", "a_y", "which"), [(1.2, 1.05, "v_y"), (0.88, 0.94, "r"), (1.2, 1.3, "r")])
def test_a_y_says_which_of_two_scales_is_off(gain, a_y, which):
    data = drives(outputs=("v_y", "r", "a_y"))
    bent = read(data, "a_y", lambda d: a_y * d["v_x"] * d["r"])
    limits = np.array([[gain - 0.01, gain + 0.01]])
    (said,) = scales(named(gain_v_y=gain), limits, bent)
    assert said.endswith(f"a_y, {a_y:.3g} times v_x r in bends, says that it is {which}")
    (silent,) = scales(named(gain_v_y=gain), limits, drives())
    assert silent.endswith("see whether r adds up over a full circle")


def test_what_hangs_on_which_of_them_it_is_has_limits_of_both():
    final = named(gain_v_y=0.8, steering_gain=1.0, C_f=1.0)
    limits = np.array([[0.79, 0.81], [0.9, 1.1], [0.9, 1.1]])
    of_either_scale(final, limits)
    assert limits == pytest.approx(np.array([[0.79, 0.81], [0.72, 1.1], [0.9, 1.1]]))


@pytest.mark.parametrize(("gain", "said"), [(1.08, False), (1.18, False), (0.9, True), (1.3, True)])
def test_an_accelerometer_of_another_scale_is_said_where_roll_does_not_explain_it(gain, said):
    found = scales(named(gain_a_y=gain), np.array([[gain - 0.01, gain + 0.01]]), drives())
    assert len(found) == said
    assert all("as body roll adds to it" in s for s in found)


def test_a_clean_log_says_nothing_of_scales():
    data = drives(steering=AT_ONCE)
    before = fit(GUESS.with_values(mu_f=0.9, mu_r=1.0), (*STIFF, "steering_gain"), data)
    assert told(corrected(before, SIZE, data), SCALE) < 1.0
    assert scales(replace(before), np.zeros((4, 2)), data) == []
