"""The equations of a racer against the lap's car in time and space, integrated by SciPy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from slipangle.control.racing.along_track import AlongTrack
from slipangle.control.racing.on_road import OnRoad, RacingCar
from slipangle.optimal.lap.car import rates
from tests.optimal.lap.cars import RACER

STAGE, BEND = 1.2, 0.02  # m, 1/m: stages of a circle to the left


def driven(car, start, turn, rise, length):
    """The same drive over time in the plane: state of `AlongTrack` where the circle's arc length is reached."""
    n, chi, v_x, v_y, r, delta, F = start
    radius = 1.0 / BEND
    begin = [n, chi, v_x, v_y, r, delta, F]  # X, Y, psi first
    plane = [0.0, n, chi, *begin[2:]]

    def motion(_, y):
        _, _, psi, vx, vy, yaw, d, force = y
        m = rates(vx, vy, yaw, d, force, car)
        c, s = np.cos(psi), np.sin(psi)
        return [vx * c - vy * s, vx * s + vy * c, yaw, m.v_x, m.v_y, m.r, turn, rise]

    def passed(_, y):
        return np.arctan2(y[0], radius - y[1]) * radius - length

    passed.terminal, passed.direction = True, 1.0
    found = solve_ivp(motion, (0.0, 2.0), plane, events=passed, rtol=1e-10, atol=1e-10)
    X, Y, psi, *rest = found.y_events[0][0]
    off = radius - np.hypot(X, radius - Y)
    return np.array([off, psi - length / radius, *rest])


@pytest.mark.parametrize("grip", [1.0, 0.8])
def test_a_stage_is_the_car_on_its_way_along_the_track(grip):
    start = np.array([0.4, 0.02, 22.0, -0.3, 0.4, 0.05, 1500.0])
    model = AlongTrack(params=RACER, dt=0.05, substeps=4)
    given = [0.3, -4000.0, BEND, STAGE, grip * RACER.mu_f, grip * RACER.mu_r]
    x = start
    for _ in range(5):
        x = np.asarray(model.step(x, np.array(given)), dtype=float)
    car = replace(RACER, mu_f=grip * RACER.mu_f, mu_r=grip * RACER.mu_r)
    other = driven(car, start, 0.3, -4000.0, 5 * STAGE)
    assert x == pytest.approx(other, rel=2e-5, abs=2e-5)


def test_the_filter_s_car_is_the_lap_s_car_on_a_road_of_another_friction():
    model = RacingCar(params=replace(OnRoad.of(RACER), grip=0.7), dt=0.01)
    x, u = np.array([3.0, 4.0, 0.6, 25.0, -0.6, 0.3, 0.2, -0.1]), np.array([0.06, -3000.0])
    now = np.asarray(model.derivative(x, u), dtype=float)
    motion = rates(25.0, -0.6, 0.3, 0.06, -3000.0, replace(RACER, mu_f=0.7 * RACER.mu_f, mu_r=0.7 * RACER.mu_r))
    course = 0.6 + np.arctan2(-0.6, 25.0)
    speed = np.hypot(25.0, 0.6)
    assert now[:3] == pytest.approx([speed * np.cos(course), speed * np.sin(course), 0.3])
    assert now[3:6] == pytest.approx([motion.v_x + 0.2, motion.v_y, motion.r - 0.1])
    seen = model.signals(x, u)
    assert seen["a_x"] == pytest.approx(now[3] + 0.6 * 0.3)
    assert seen["a_y"] == pytest.approx(now[4] + 25.0 * 0.3)
