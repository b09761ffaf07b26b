"""The nonlinear bicycle reduces to the linear one at small angles and saturates as friction says."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.models.vehicles.bicycle import bicycle
from slipangle.models.vehicles.nonlinear_bicycle import (
    NonlinearBicycle,
    NonlinearBicycleParams,
    axle_force,
    nonlinear_bicycle,
    with_speed_derivative,
)
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams

CAR = {"mass": 982.0, "inertia_z": 900.0, "wheelbase": 2.4, "l_f": 1.3, "C_f": 6e4, "C_r": 9e4}
PARAMS = NonlinearBicycleParams(**CAR)


@pytest.mark.parametrize("v", [10.0, 30.0, 60.0])
def test_small_angles_are_the_linear_bicycle(v):
    linear = bicycle(1e-4, 1e-5, 2e-4, v, BicycleParams(**CAR))
    coasting = -PARAMS.drag * v * v / PARAMS.mass  # no force along the tires
    level = PARAMS.with_values(transfer_x=0.0)
    v_y_dot, r_dot, _ = nonlinear_bicycle(1e-4, 1e-5, 2e-4, v, coasting, level)
    assert [v_y_dot, r_dot] == pytest.approx(list(linear), rel=2e-3)


@pytest.mark.parametrize("F_x", [0.0, 3000.0, 6000.0])
def test_force_stays_on_the_friction_ellipse(F_x):
    load, mu = 5000.0, 1.2
    p = PARAMS.with_values(friction_load=0.0)
    peak = max(axle_force(a, load, load, 0.0, F_x, 9e4, mu, 0.0, p) for a in np.linspace(0, 0.6, 400))
    allowed = np.sqrt(max((mu * load) ** 2 - F_x**2, 0.0))
    assert peak <= allowed + 0.03 * mu * load
    assert peak >= 0.97 * allowed


def test_load_transfer_costs_grip():
    forces = [axle_force(0.3, 5000.0, 5000.0, t, 0.0, 9e4, 1.2, 0.0, PARAMS) for t in (0.0, 1000.0, 2000.0)]
    assert forces[0] > forces[1] > forces[2] > 0.8 * forces[0]


def test_lifting_off_loads_the_front():
    _, r_braking, _ = nonlinear_bicycle(0.0, 0.1, 0.05, 30.0, -5.0, PARAMS.with_values(brake_rear=0.5))
    _, r_coasting, _ = nonlinear_bicycle(0.0, 0.1, 0.05, 30.0, 0.0, PARAMS)
    assert r_braking > r_coasting


def test_left_and_right_are_mirrored():
    left = nonlinear_bicycle(0.4, 0.3, 0.05, 30.0, -3.0, PARAMS)
    right = nonlinear_bicycle(-0.4, -0.3, -0.05, 30.0, -3.0, PARAMS)
    assert left == pytest.approx([-f for f in right], rel=1e-12)


def test_standstill_is_defined():
    model = NonlinearBicycle(params=PARAMS, dt=0.05)
    x = np.zeros(3)
    for v in (0.0, -3.0, 80.0):
        for _ in range(100):
            x = model.step(x, np.array([0.2, v, 0.0]))
        assert np.isfinite(x).all()
    assert GRAVITY == 9.81


def test_the_derivative_of_a_piece_of_one_sample_is_nothing():
    ramp = Dataset.from_arrays({"v_x": 20 + 0.3 * np.arange(9)}, {"r": np.zeros(9)}, 0.1)
    pieces = join(ramp, ramp.rows(4, 5), ramp.rows(0, 2))
    np.testing.assert_allclose(with_speed_derivative(pieces)["v_x_dot"], [*[3.0] * 9, 0.0, 3.0, 3.0])


@pytest.mark.parametrize("compliance", [0.0, 4e-6])
def test_its_linear_bicycle_turns_as_it_does_at_small_angles(compliance):
    """Steady state at 20 m/s with a little steering; the front axle is as soft as the steering that gives makes it."""
    params = PARAMS.with_values(compliance=compliance, transfer_x=0.0, steering_gain=0.5, steering_offset=0.01)
    v, delta, x = 20.0, 0.0104, np.zeros(3)
    model = NonlinearBicycle(params=params, dt=0.02, substeps=2)
    for _ in range(400):
        x = model.step(x, np.array([delta, v, -params.drag * v * v / params.mass]))
    p = params.bicycle
    understeer = p.mass / p.wheelbase * (p.l_r / p.C_f - p.l_f / p.C_r)
    assert x[1] == pytest.approx(v * 0.5 * (delta - 0.01) / (p.wheelbase + understeer * v**2), rel=2e-3)
