"""Drive and brakes from a predictive controller: it wants the profile's speed, from a standstill and back to one."""

import runpy
from pathlib import Path

import numpy as np
import pytest

import slipangle as sa
from slipangle.models.custom import Ode
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
