"""Predictive controllers in trouble on our plant, and in the lane on an independent multi-body car."""

import numpy as np
import pytest

from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.speed.pedals import pedal_driver
from slipangle.models.vehicles.catalogue import BMW_320I, PASSENGER_TIRE, SOUSA_CAR_7
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.road import Road
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Values
from slipangle.paths.lane_change import double_lane_change
from slipangle.paths.path import Path
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import End
from tests.simulate.controllers import LIMIT, controller

pytestmark = pytest.mark.skipif(compiler() is None, reason=sentence())
slow = pytest.mark.slow
NAMES = ("MARX", "adaptive", "LMPC", "NMPC", "switched")
SPEEDS = (10.0, 15.0, 20.0)
TROUBLE = {
    "friction drops to 0.5": {"mu": 0.5},
    "20 % lighter": {"mass": 0.8},
    "20 % heavier": {"mass": 1.2},
    "steering two steps late": {"delay": 0.1},
}


def plant(params=SOUSA_CAR_7, *, mu=1.0, mass=1.0, delay=0.0):
    road = Road(distance=(70.0, 70.1), left=(1.0, mu), right=(1.0, mu))
    car = DualTrack(
        params=params.with_values(mass=mass * params.mass),
        tire_f=PASSENGER_TIRE,
        tire_r=PASSENGER_TIRE,
        dt=0.001,
        road=road,
    )
    return Plant(car, delay=Values(delta=delay))


def check(run):
    """Nothing is NaN and every command keeps limit and rate."""
    assert np.isfinite(run.states).all()
    assert np.isfinite(run.commands).all()
    assert np.abs(run.commands).max() <= LIMIT + 1e-12
    assert np.abs(np.diff(run.commands, axis=0)).max() <= 1.0 * 0.05 + 1e-9


@pytest.mark.parametrize("name", [pytest.param(n, marks=[slow] * (n != "MARX")) for n in NAMES])
@pytest.mark.parametrize("trouble", [pytest.param(t, marks=[slow] * (t != "friction drops to 0.5")) for t in TROUBLE])
def test_trouble_in_a_lane_change_ends_well(name, trouble):
    mpc = controller(name, SOUSA_CAR_7, SPEEDS)
    path = double_lane_change(14.0, blend=10.0)
    run = closed_loop(plant(**TROUBLE[trouble]), mpc, path, driver=pedal_driver(SOUSA_CAR_7))
    check(run)
    assert run.end is End.FINISHED
    assert run.max("y") < 0.5


@pytest.mark.parametrize("name", [pytest.param(n, marks=[slow] * (n != "MARX")) for n in NAMES])
@pytest.mark.parametrize("v_x", [5.0, 24.0])
def test_speeds_outside_the_models(name, v_x):
    """Nearest model, a flag in every plan, and the lane change is still driven."""
    mpc = controller(name, SOUSA_CAR_7, SPEEDS)
    path = double_lane_change(v_x, blend=10.0)
    run = closed_loop(plant(), mpc, path, driver=pedal_driver(SOUSA_CAR_7))
    check(run)
    assert run.end is End.FINISHED
    assert run.max("y") < 0.6
    if name in ("MARX", "adaptive"):
        assert all(p.outside for p in run.plans)


@pytest.mark.parametrize("name", [pytest.param(n, marks=[slow] * (n != "MARX")) for n in NAMES])
@pytest.mark.parametrize("v_x", [0.0, -3.0])
def test_standing_and_reversing_are_defined(name, v_x):
    mpc = controller(name, SOUSA_CAR_7, SPEEDS)
    path = Path.from_points(np.linspace(0, 60, 30), np.zeros(30)).with_speed(0.0)
    car = plant()
    x0 = car.straight(v_x, X=20.0, Y=0.3)
    run = closed_loop(car, mpc, path, driver=pedal_driver(SOUSA_CAR_7), x0=x0, duration=2.0)
    check(run)
    assert np.abs(run.e_y).max() < 1.0
    if name == "MARX":
        assert all(p.status is Status.FAILED and "standing" in p.message for p in run.plans)
        assert np.ptp(run.commands) == 0.0


@pytest.mark.parametrize("v_x", [15.0, 20.0, 25.0])
@pytest.mark.parametrize("name", ["MARX", "LMPC", "NMPC", "switched"])
@slow
def test_lane_change_of_iso_3888_1_in_the_lane_of_a_multi_body_car(name, v_x):
    pytest.importorskip("vehiclemodels", reason="commonroad-vehicle-models is not installed")
    from tests.simulate.multi_body import DRIVER, WIDTH, MultiBody

    mpc = controller(name, BMW_320I, (15.0, 20.0, 25.0), 0.4)
    path = double_lane_change(v_x, width=WIDTH, blend=7.0)  # its own margin is 0.095 m
    run = closed_loop(Plant(MultiBody()), mpc, path, driver=DRIVER, width=WIDTH)
    assert run.end is End.FINISHED
    assert run.inside
    assert np.isfinite(run.commands).all()
    assert margin(run, WIDTH) > 0.05


def margin(run, width):
    """Least distance of the car's side from the lane's edge where it is marked. [m]"""
    lane = run.path.at(run.s)
    return float(min((lane.left - run.e_y).min(), (lane.right + run.e_y).min()) - 0.5 * width)
