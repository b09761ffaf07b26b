"""The car on its pedals: top speed, limits of engine and brakes, slope, and the special case of the thesis."""

import numpy as np
import pytest

from slipangle.models.vehicles.longitudinal import (
    DrivelineParams,
    LongitudinalParams,
    PedalCar,
    driveline,
    longitudinal,
)
from slipangle.models.vehicles.parameters import GRAVITY

CAR = {"mass": 800.0, "k_e": 8000.0, "k_b": 2e-3}


@pytest.mark.parametrize("throttle", [0.3, 0.7, 1.0])
def test_top_speed_is_where_power_meets_drag(throttle):
    p = DrivelineParams(**{**CAR, "k_e": 1e5}, power=2e5, drag=1.0, k_r=0.0)
    v = (throttle * 2e5 / 1.0) ** (1 / 3)
    assert driveline(v, throttle, 0.0, 0.0, p) == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("v_x", [5.0, 15.0, 30.0])
@pytest.mark.parametrize("pedal", [0.0, 0.4, 1.0])
def test_without_limits_it_is_the_model_of_the_thesis(v_x, pedal):
    p = DrivelineParams(**CAR, power=1e7, drag=0.0, k_d=50.0, k_r=0.02)
    thesis = LongitudinalParams(mass=800.0, k_e=8000.0, k_d=50.0, k_r=0.02)
    assert driveline(v_x, pedal, 0.0, 0.0, p) == pytest.approx(longitudinal(v_x, pedal, thesis), abs=0.01)


def test_brakes_saturate_at_grip():
    p = DrivelineParams(**CAR, drag=0.0, k_r=0.0, grip=1.2)
    forces = [driveline(20.0, 0.0, b, 0.0, p) for b in (1e6, 4e6, 1e8)]
    assert forces[0] == pytest.approx(-2.5, rel=0.02)
    assert forces[0] > forces[1] > forces[2] >= -1.2 * GRAVITY - 1e-9
    assert forces[2] == pytest.approx(-1.2 * GRAVITY, rel=1e-6)


def test_slope_and_cornering_slow_the_car():
    level = DrivelineParams(**CAR)
    hill = DrivelineParams(**CAR, grade=0.05)
    corner = DrivelineParams(**CAR, scrub=1.0)
    base = driveline(20.0, 0.5, 0.0, 0.1, level)
    assert base - driveline(20.0, 0.5, 0.0, 0.1, hill) == pytest.approx(GRAVITY * 0.05)
    assert base - driveline(20.0, 0.5, 0.0, 0.1, corner) == pytest.approx(4.0)


def test_braking_stops_the_car_and_holds_it():
    model = PedalCar(params=DrivelineParams(**CAR), dt=0.05)
    x = np.array([10.0, 0.0, 0.0])
    for _ in range(400):
        x = model.step(x, np.array([0.0, 3e6, 0.0]))
    assert abs(x[0]) < 0.05
