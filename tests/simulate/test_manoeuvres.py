"""Manoeuvres: what they command, what a record holds, and the paths' shapes."""

import math

import numpy as np
import pytest

from slipangle.control.speed.pedals import pedal_driver
from slipangle.errors import NotFiniteError, ParameterError, SampleTimeError
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import PASSENGER_TIRE, SOUSA_CAR_7, SOUSA_TABLE_7_2
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Values
from slipangle.simulate import manoeuvres as m
from slipangle.simulate.plant import Plant
from slipangle.simulate.sensors import Sensor, Sensors

CAR = DualTrack(
    params=SOUSA_CAR_7,
    tire_f=PASSENGER_TIRE,
    tire_r=PASSENGER_TIRE,
    dt=0.001,
    outputs=("v_x", "v_y", "r", "X", "Y", "psi", "a_y"),
)
PLANT = Plant(CAR)
DRIVER = pedal_driver(SOUSA_CAR_7)
EACH = {
    "step": m.step_steer(20.0, 0.03),
    "sine": m.sine_steer(15.0, 0.05, 0.25, periods=1.0),
    "dwell": m.sine_with_dwell(22.0, 0.08),
    "ramp": m.ramp_steer(20.0, 0.01, duration=8.0, limit=0.05),
    "throttle off": m.steady_turn(20.0, 0.04),
    "braking": m.steady_turn(20.0, 0.04, brake=0.3),
}


@pytest.mark.parametrize("manoeuvre", EACH.values(), ids=EACH.keys())
def test_record_holds_what_was_commanded_and_measured(manoeuvre):
    data = m.record(PLANT, manoeuvre, DRIVER)
    assert data.inputs == ("delta", "throttle", "brake")
    assert data.outputs == CAR.outputs
    assert np.array_equal(data["delta"], manoeuvre.delta)
    assert np.isfinite(data.values).all()
    held = (manoeuvre.t > 0.5) & (manoeuvre.t < manoeuvre.release)
    assert np.abs(data["v_x"] - manoeuvre.v_x)[held].max() < 1.0
    released = manoeuvre.t >= manoeuvre.release
    assert np.abs(data["throttle"][released]).max(initial=0.0) == 0
    assert (data["brake"][released] == manoeuvre.brake).all()
    assert np.abs(data["r"]).max() > 0.05
    assert data["r"][np.argmax(np.abs(data["delta"]) > 1e-3) + 15] * data["delta"].max() > 0


def test_a_record_is_a_free_run_of_the_plant():
    """Logged inputs through the model give the logged outputs: inputs and samples belong together."""
    manoeuvre = m.step_steer(20.0, 0.03, duration=2.0)
    data = m.record(PLANT, manoeuvre, DRIVER)
    u = np.repeat(data.u, 10, axis=0)
    x = CAR.straight(20.0)
    for k in range(0, 2000, 10):
        assert x[2] == pytest.approx(data["r"][k // 10], abs=1e-9)
        for j in range(10):
            x = np.asarray(CAR.functions[0](x, u[k + j])).ravel()


def test_sensors_are_in_the_record():
    manoeuvre = m.sine_steer(15.0, 0.03, 0.5, periods=1.0)
    true = m.record(PLANT, manoeuvre, DRIVER)
    seen = m.record(Plant(CAR, sensors=Sensors(r=Sensor(bias=0.1), Y=Sensor(interval=0.1))), manoeuvre, DRIVER)
    assert seen["r"] == pytest.approx(true["r"] + 0.1, abs=1e-12)
    assert seen["Y"][10:20] == pytest.approx(np.full(10, true["Y"][10]))


def test_speed_as_an_input_needs_no_driver():
    bicycle = Plant(OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.001)))
    data = m.record(bicycle, m.step_steer(20.0, 0.02, duration=2.0), channels=("r", "Y"))
    assert data.inputs == ("delta", "v_x")
    assert (data["v_x"] == 20.0).all()
    assert data["Y"][-1] > 0.5


def test_lifting_off_in_a_turn_slows_the_car_and_keeps_it_on_the_road():
    data = m.record(PLANT, m.steady_turn(20.0, 0.05), DRIVER)
    k = round(5.0 / 0.01)
    assert data["v_x"][-1] < data["v_x"][k] - 1.0
    assert np.abs(data["v_y"]).max() < 3.0


def test_three_segments_are_as_described():
    path = m.three_segments()
    first, second, third = path.X < 330, (path.X > 390) & (path.X < 630), path.X > 690
    assert np.abs(path.Y[first]).max() > 2 * np.abs(path.Y[second]).max()
    assert np.median(path.v_x[first]) < np.median(path.v_x[third]) < np.median(path.v_x[second])
    a_y = np.abs(path.curvature) * path.v_x**2
    assert a_y[first].max() < 0.35 * 9.81
    assert a_y[second].max() < 0.55 * 9.81
    assert a_y[third].max() > 1.5 * 9.81  # faster than any car follows
    assert path.Y[-1] == pytest.approx(0.0, abs=1e-6)


def test_slalom_passes_cones_on_alternate_sides():
    path = m.slalom(12.0, spacing=20.0, cones=6, run=25.0)
    cones = 25.0 + 20.0 * np.arange(1, 7)
    middle = np.interp(cones - 10.0, path.X, path.Y)
    assert (np.sign(middle) == [1, -1, 1, -1, 1, -1]).all()
    assert np.abs(path.curvature).max() < 0.08


def test_a_lap_on_a_track_file(tmp_path):
    angle = np.linspace(0, 2 * math.pi, 80, endpoint=False)
    rows = np.column_stack([80 * np.cos(angle), 50 * np.sin(angle), np.full(80, 4.0), np.full(80, 5.0)])
    file = tmp_path / "oval.csv"
    np.savetxt(file, rows, delimiter=",", header="x,y,right,left")
    path = m.lap(file, v_max=30.0, a_y=6.0, a_x=3.0)
    assert path.closed
    assert (path.v_x**2 * np.abs(path.curvature)).max() <= 6.0 * (1 + 1e-6)
    assert path.right is not None


def test_a_lap_on_a_public_track(real_data):
    file = real_data("tracks/tum/Norisring.csv")
    path = m.lap(file, v_max=40.0, a_y=7.0, a_x=3.0, a_brake=6.0, smoothing=0.1)
    assert path.closed
    assert path.length > 500


def test_bad_input_says_what_to_do():
    with pytest.raises(NotFiniteError, match="delta"):
        m.Manoeuvre(delta=np.array([0.0, np.nan]), v_x=np.zeros(2))
    with pytest.raises(ParameterError, match=r"brake is 2\.0; expected a number from 0 to 1"):
        m.Manoeuvre(delta=np.zeros(5), v_x=np.zeros(5), brake=2.0)
    with pytest.raises(ParameterError, match="nobody sets"):
        m.record(PLANT, EACH["step"])
    with pytest.raises(ParameterError, match="held"):
        m.record(PLANT, EACH["step"], DRIVER, held=Values(gas=1.0))
    with pytest.raises(SampleTimeError, match="multiple"):
        m.record(PLANT, m.step_steer(20.0, 0.1, dt=0.0155), DRIVER)
    with pytest.raises(ParameterError, match="nearest"):
        m.record(PLANT, EACH["step"], DRIVER, channels=("ay",))
    with pytest.raises(ParameterError, match="frequency"):
        m.sine_steer(10.0, 0.1, 0.0)
    with pytest.raises(ParameterError, match="duration"):
        m.step_steer(10.0, 0.1, duration=0.0)
    with pytest.raises(ParameterError, match="cones"):
        m.slalom(10.0, cones=1)
    with pytest.raises(ParameterError, match="positive"):
        m.three_segments(jump=0.0)
