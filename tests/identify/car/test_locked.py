"""A car whose rear wheels turn as one, from a log of it, by equations of its own."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from benchmarks.foreign_cars import fleet

from slipangle.identify.car.corrections import LOCKED, corrections
from slipangle.identify.car.effects import told, turned_away
from slipangle.identify.car.identify_car import identify_car
from slipangle.identify.car.structures import STIFF, first_guess, fit
from slipangle.models.vehicles.driveline import Differential
from tests.identify.car.test_identify_car import DT, KNOWN, OUTPUTS, TRUE, drives

SOLID = TRUE | dict(locked_half_track=0.8)


def test_it_is_found_and_leaves_inertia_and_steering_as_they_are():
    """Taken for an open differential yaw inertia was a seventh, the gain a sixth too small, beside their intervals."""
    found = identify_car(drives(true=SOLID), **KNOWN)
    for name in ("C_f", "C_r", "inertia_z", "locked_half_track"):
        low, high = found.interval(name)
        assert low <= SOLID[name] <= high, name
    assert found.interval("locked_half_track")[0] > 0.5 * SOLID["locked_half_track"]  # told from none
    assert found.model.value("steering_gain") == pytest.approx(0.93, rel=0.05)
    (said,) = (s for s in found.sentences if s.startswith("the rear wheels resist the turn as if they turned as one"))
    across = 9e4 * 1.2**2 + 1.2e5 * 1.4**2
    assert float(said.split("by ")[1].split(" %")[0]) == pytest.approx(100 * 1.2e5 * 0.8**2 / across, rel=0.25)


@pytest.mark.slow
def test_a_sensor_away_from_the_centre_of_gravity_is_not_taken_for_it():
    """v_y measured ahead does the same to v_y and nothing to the yaw rate."""
    data = drives()
    ahead = data.with_channel("v_y", data["v_y"] + 0.5 * data["r"], "m/s")
    found = identify_car(ahead, **KNOWN)
    assert "locked_half_track" not in found.model.fit_info.names
    assert found.model.value("lever_v_y") == pytest.approx(0.5, abs=0.1)
    assert not any("as if they turned as one" in s for s in found.sentences)


@pytest.mark.parametrize(("half", "locked"), [(0.8, True), (0.0, False), (0.25, False)])
def test_only_what_a_locked_axle_would_do_is_told(half, locked):
    guess = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0).with_values(
        mu_f=0.9, mu_r=1.0, locked_half_track=0.4
    )
    at_once = dict(delay=0.0, lag=0.002, gain=1.0, offset=0.0)
    data = drives(true=TRUE | dict(locked_half_track=half), steering=at_once)
    final = fit(guess, (*STIFF, *LOCKED), data)
    assert final.values["locked_half_track"] == pytest.approx(half, abs=0.25)
    assert (told(final, LOCKED) > 1) == locked


def test_it_is_not_bought_by_a_gain_that_was_given_otherwise():
    """Both ask for more steering in any bend; one that brings the gain back to what was given is another matter."""

    def fitted(gain, *free):
        return SimpleNamespace(model=first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=gain), free=free)

    given = fitted(0.06)
    assert turned_away(given, fitted(0.061), fitted(0.07, *LOCKED))
    assert not turned_away(given, fitted(0.045), fitted(0.062, *LOCKED))
    assert not turned_away(given, fitted(0.061), fitted(0.07))
    assert not turned_away(given, fitted(0.061, *LOCKED), fitted(0.07, *LOCKED))


def test_it_is_tried_where_more_than_the_yaw_rate_is_measured():
    def free(data):
        return {name for correction in corrections(data, 2.6, None) for name in correction.free}

    assert "locked_half_track" in free(drives())
    assert "locked_half_track" not in free(drives(outputs=("r",)))


@pytest.mark.slow
@pytest.mark.parametrize("outputs", [("v_y", "r"), ("r", "a_y")])
def test_of_a_dual_track_with_a_solid_axle_too(outputs):
    """Whose tires combine slip in their own way and whose loads move; the truth is that of its open differential."""
    usual = fleet.make("Formula Student")
    p = usual.plant.model.params
    heavy = 10.0 * p.inertia_wheel_r  # so that a viscosity of 100 times the tires' own is still integrated
    solid = replace(p.driveline, rear=Differential(viscosity=600.0 * heavy))
    model = replace(usual.plant.model, params=replace(p, inertia_wheel_r=heavy, driveline=solid))
    car, truth = replace(usual, plant=replace(usual.plant, model=model)), usual.truth.values
    known = {n: getattr(usual.plant, n) for n in ("mass", "wheelbase", "l_f")}
    found = identify_car(car.train(0).select(outputs=outputs).hold_mean(), **known)
    for name in STIFF:
        low, high = found.interval(name)
        assert low <= truth[name] <= high, name
    assert found.model.value("steering_gain") == pytest.approx(truth["steering_gain"], rel=0.05)
    assert found.model.value("locked_half_track") == pytest.approx(p.track_r / 2, rel=0.25)
