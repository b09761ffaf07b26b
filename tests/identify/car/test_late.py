"""Channels that are logged late, as v_y from GPS beside a gyro: said with its time, counted in the intervals."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slipangle.data.dataset import join
from slipangle.identify.car import left_over
from slipangle.identify.car.corrections import SPEED
from slipangle.identify.car.late import beside, late, with_lateness
from slipangle.identify.car.sentences import speed
from slipangle.identify.car.structures import STIFF, first_guess, fit
from tests.identify.car.test_identify_car import DT, KNOWN, OUTPUTS, TRUE
from tests.identify.car.test_identify_car import drives as of_car

AT_ONCE = dict(delay=0.0, lag=0.002, gain=1.0, offset=0.0)


def drives(outputs=OUTPUTS, **behind):
    """Six drives at speeds of their own, channels ``behind`` by so many seconds."""
    parts = of_car((9, 13, 17, 21, 25, 29), steering=AT_ONCE, outputs=outputs).experiments
    for name, seconds in behind.items():
        n = round(seconds / DT)
        parts = [p.with_channel(name, np.append(np.full(n, p[name][0]), p[name][:-n]), p.unit(name)) for p in parts]
    return join(*parts)


def fitted(data, *more):
    guess = first_guess(**KNOWN, dt=DT, outputs=data.outputs, gain=1.0).with_values(mu_f=0.9, mu_r=1.0)
    return fit(guess, (*STIFF, *more), data)


def test_it_is_found_said_and_counted():
    seconds = 0.2
    data = drives(v_y=seconds)
    final = fitted(data)
    found, on_time = late(final, data)
    assert found == pytest.approx(seconds, abs=0.01)
    for name in STIFF:
        assert on_time.values[name] == pytest.approx(TRUE[name], rel=0.05), name
    others, (said,) = with_lateness(final, [(SimpleNamespace(free=SPEED), 1.0)], data)
    assert [set(other.free) for other, _ in others] == [{*STIFF}]  # the speed's scale explains a part of it only
    assert said.startswith(f"v_y comes {seconds:.2g} s behind r, as the motion of the car tells")


@pytest.mark.parametrize("seconds", [0.1, 0.2])
def test_a_lateral_acceleration_that_is_late_is_too(seconds):
    data = drives(("r", "a_y"), a_y=seconds)
    final = fitted(data)
    found, on_time = late(final, data, "a_y")
    assert found == pytest.approx(seconds, abs=0.02)
    assert (on_time.sigma < 0.8 * final.sigma).any()
    _, (said,) = with_lateness(final, [], data)
    assert said.startswith("a_y comes 0.")


def test_what_the_first_of_its_searches_finds_a_half_of_is_found(monkeypatch):
    """Lag and place of a sensor that were fitted hide as much, until they are fitted again without."""
    data, whole = drives(v_y=0.08), left_over.left_over
    final = fitted(data)
    assert late(final, data)[0] == pytest.approx(0.08, abs=0.01)
    monkeypatch.setattr(left_over, "left_over", lambda *of: (0.6 * whole(*of)[0], whole(*of)[1]))
    assert late(final, data)[0] == pytest.approx(0.08, abs=0.01)


def test_a_lateral_acceleration_on_time_is_not_said_to_be_late():
    data = drives(("r", "a_y"))
    assert with_lateness(fitted(data), [], data) == ([], [])


def test_a_yaw_rate_that_is_late_is_told_from_it():
    data = drives(r=0.1, delta=0.1)
    _, (said,) = with_lateness(fitted(data), [], data)
    seconds = float(said.removeprefix("r comes ").split(" s behind v_y")[0])
    assert seconds == pytest.approx(0.1, abs=0.01)


def test_sensors_on_time_are_not_said_to_be_late_nor_a_speed_that_explains_no_more_to_be_wrong():
    data = drives()
    final, other = fitted(data), fitted(data, *SPEED)
    assert late(final, data) is None
    assert speed(final, [(replace(other, sigma=0.999 * final.sigma), 1.0)]) == []
    assert len(speed(final, [(replace(other, sigma=0.9 * final.sigma), 1.0)])) == 1


def test_a_steering_that_is_logged_late_is_said_and_counted():
    """The car answers before delta moves; from v_y and r alone its inertia came out at a half."""
    seconds = 0.1
    data = drives(delta=seconds)
    final = fitted(data)
    found, on_time = late(final, data, "delta")
    assert found == pytest.approx(seconds, abs=0.01)
    assert on_time.values["inertia_z"] == pytest.approx(TRUE["inertia_z"], rel=0.05)
    assert not final.values["inertia_z"] == pytest.approx(TRUE["inertia_z"], rel=0.3)
    others, (said,) = with_lateness(final, [], data)
    assert [share for _, share in others] == [1.0]
    assert float(said.removeprefix("delta comes ").split(" s behind r")[0]) == pytest.approx(seconds, abs=0.01)


@pytest.mark.parametrize("behind", [{}, {"r": 0.1, "v_y": 0.1}])
def test_a_steering_that_acts_at_once_or_late_is_not_said_to_be_logged_late(behind):
    data = drives(**behind)
    assert late(fitted(data), data, "delta") is None
    assert with_lateness(fitted(data, "delay_delta"), [], data) == ([], [])


def test_a_doubt_about_the_log_gives_way_to_what_a_fit_says_of_the_same_channel():
    early = "r comes 0.2 s before the steering that makes it: delta is logged late, by that and by what"
    slow, other = "v_x comes 0.3 s behind what a_x makes of it: it is logged late", "a_y is 0.1 of v_x r"
    fitted = "delta comes 0.3 s behind r, as the motion of the car tells"
    assert beside([fitted], (early, slow, other)) == (slow, other)
    assert beside(["v_x comes 0.3 s behind r, as"], (early, slow, other)) == (early, other)
    assert beside([], (early, slow, other)) == (early, slow, other)
