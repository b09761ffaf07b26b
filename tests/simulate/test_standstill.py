"""Drive and brakes from a predictive controller: it wants the profile's speed, from a standstill and back to one."""

import runpy
from pathlib import Path

import numpy as np
import pytest

import slipangle as sa
from slipangle.control.speed.pedals import pedal_driver
from slipangle.models.custom import Ode
from slipangle.models.vehicles.catalogue import PASSENGER_TIRE, SOUSA_CAR_7
from slipangle.optimal.solution import Status

EXAMPLE = Path(__file__).parents[2] / "examples" / "steering_and_pedals.py"


def test_the_speed_that_a_controller_decides_is_the_profiles():
    """A point with a thrust, from a standstill to 5 m/s and back; a controller that took its own speed would stay."""
    point = Ode(
        f=lambda x, u, _: [u[0], -5.0 * x[1], -5.0 * x[2]],
        params={},
        states=("v_x", "v_y", "r"),
        inputs=("push",),
        outputs=("v_x", "v_y", "r"),
        dt=0.1,
    )
    mpc = sa.MPC(sa.OnGround(point), horizon=10, Q={"v_x": 1.0}, S={"push": 0.01}, limits={"push": 2.0})
    path = sa.Path.from_points(np.linspace(0.0, 30.0, 61), np.zeros(61))
    left = np.maximum(path.length - 2.0 - path.s, 0.0)
    path = path.with_speed(np.minimum(5.0, np.minimum(np.sqrt(0.25 + 2.0 * path.s), np.sqrt(2.0 * left))))
    plant = sa.Plant(sa.OnGround(point.resampled(0.01)))
    run = sa.closed_loop(plant, mpc, path, x0=np.zeros(6), duration=25.0)
    assert run.v_x.max() == pytest.approx(5.0, abs=0.1)
    assert np.abs(run.v_x[-50:]).max() < 0.05
    assert run.s[-1] == pytest.approx(path.length - 2.0, abs=0.3)


@pytest.mark.slow
def test_steering_and_pedals_take_a_car_to_30_m_s_and_back():
    """The dual track, with wheel spin, gears, roll and relaxation that the controller's model does not know."""
    seen = runpy.run_path(str(EXAMPLE))
    run, mpc = seen["run"], seen["mpc"]
    assert run.v_x[0] == 0.0
    assert run.v_x.max() > 29.5
    assert np.abs(run.v_x[-100:]).max() < 0.05
    assert np.abs(run.e_y).max() < 0.05
    wanted = np.array([seen["path"].speed(s) for s in run.s])
    assert np.sqrt(np.mean((run.v_x - wanted) ** 2)) < 0.5
    assert {p.status for p in run.plans} <= {Status.SOLVED, Status.REAL_TIME}
    delta, throttle, brake = (run.inputs[:, run.input_names.index(n)] for n in mpc.controls)
    assert np.abs(delta).max() <= 0.4
    assert throttle.min() >= 0.0
    assert brake.min() >= 0.0
    assert max(throttle.max(), brake.max()) <= 1.0
    assert np.minimum(throttle, brake).max() < 0.05  # not both at once
    taken = [float(seen["grip"](p.x[0], p.u[0], None)) for p in run.plans]
    assert max(taken) < 0.81


@pytest.mark.slow
def test_a_driver_takes_a_car_to_30_m_s_and_back():
    """From raw measurements, the model a linear bicycle with the steering's delay and lag."""
    params = {n: getattr(SOUSA_CAR_7, n) for n in ("mass", "inertia_z", "wheelbase", "l_f")}
    bicycle = sa.Bicycle(params=sa.BicycleParams(**params, C_f=2e5, C_r=2e5), dt=0.02, outputs=("v_y", "r"))
    known = sa.Delayed(sa.Steered(bicycle, steering_lag=0.05), delays={"delta": 0.02}, longest=0.1)
    x = np.arange(0.0, 601.0, 2.0)
    y = np.where((x > 200) & (x < 400), 6.0 * (1 - np.cos(np.pi * (x - 200) / 100)), 0.0)
    path = sa.Path.from_points(x, y).with_speed_limits(v_max=30.0, a_y=5.0, a_x=2.5, a_brake=4.0)
    ends = np.sqrt(np.minimum(1.0 + 5.0 * path.s, 8.0 * np.maximum(path.length - 10.0 - path.s, 0.0)))
    path = path.with_speed(np.minimum(path.v_x, ends))
    model = sa.DualTrack(params=SOUSA_CAR_7, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001)
    plant = sa.Plant(model, delay=sa.Values(delta=0.02), lag=sa.Values(delta=0.05), seed=1)
    driver = sa.Driver(known, path, speed=pedal_driver(SOUSA_CAR_7), noise={"v_y": 0.05, "r": 0.002})
    raw = ("r", "v_x", "X", "Y", "psi")
    run = sa.drive(plant, driver, channels=raw, x0=model.straight(0.0), duration=48.0)
    assert run.v_x.max() > 29.5
    assert np.abs(run.v_x[-100:]).max() < 0.05
    assert np.abs(run.e_y).max() < 0.05
    wanted = np.array([path.speed(s) for s in run.s])
    assert np.sqrt(np.mean((run.v_x - wanted) ** 2)) < 0.5
