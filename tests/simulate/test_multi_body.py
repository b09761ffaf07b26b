"""Closed loops on an independent multi-body car: in the lane, and as on our own plant of the same car."""

import pytest

from slipangle.control.followers.followers import PurePursuit, Stanley
from slipangle.control.followers.preview_lqr import PreviewLQR
from slipangle.control.speed.pedals import pedal_driver
from slipangle.models.vehicles.catalogue import BMW_320I, PASSENGER_TIRE
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams
from slipangle.paths.lane_change import double_lane_change
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import End

pytest.importorskip("vehiclemodels", reason="commonroad-vehicle-models is not installed")
from tests.simulate.multi_body import DRIVER, WIDTH, MultiBody

P = BMW_320I
BICYCLE = BicycleParams(
    mass=P.mass,
    inertia_z=P.inertia_z,
    wheelbase=P.wheelbase,
    l_f=P.l_f,
    C_f=21.92 * P.mass * GRAVITY * P.l_r / P.wheelbase,  # the tire's stiffness over load
    C_r=21.92 * P.mass * GRAVITY * P.l_f / P.wheelbase,
)
OURS = Plant(DualTrack(params=P, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001))
FOLLOWERS = {
    "pure pursuit": PurePursuit(params=BICYCLE),
    "pure pursuit, near point": PurePursuit(params=BICYCLE, gain=0.22, shortest=5.0),
    "Stanley": Stanley(params=BICYCLE),
    "LQR": PreviewLQR(params=BICYCLE),
}
slow = pytest.mark.slow


@pytest.mark.parametrize(
    ("name", "v_x"),
    [
        ("LQR", 20.0),
        pytest.param("LQR", 15.0, marks=slow),
        pytest.param("LQR", 25.0, marks=slow),
        pytest.param("Stanley", 15.0, marks=slow),
        pytest.param("Stanley", 20.0, marks=slow),
        pytest.param("Stanley", 25.0, marks=slow),
        pytest.param("pure pursuit", 15.0, marks=slow),
        pytest.param("pure pursuit", 20.0, marks=slow),
        pytest.param("pure pursuit, near point", 25.0, marks=slow),
    ],
)
def test_lane_change_of_iso_3888_1_in_the_lane(name, v_x):
    # aiming at a point ahead cuts corners: at 25 m/s it needs the roundest path that the lanes allow
    path = double_lane_change(v_x, width=WIDTH, blend=12.0 if "near" in name else 10.0)
    theirs = closed_loop(Plant(MultiBody()), FOLLOWERS[name], path, driver=DRIVER, width=WIDTH)
    ours = closed_loop(OURS, FOLLOWERS[name], path, driver=pedal_driver(P), width=WIDTH)
    for run in (theirs, ours):
        assert run.end is End.FINISHED
        assert run.inside
        assert run.max("v_x") < 0.8
    assert ours.rmse("y") == pytest.approx(theirs.rmse("y"), abs=0.02)
    assert ours.max("y") == pytest.approx(theirs.max("y"), abs=0.04)
