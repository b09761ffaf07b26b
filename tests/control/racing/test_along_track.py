"""The equations of a racer against the lap's car in time and space, integrated by SciPy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import slipangle as sa
from slipangle.control.racing.actuators import Actuators
from slipangle.control.racing.along_track import AlongTrack, along_track
from slipangle.control.racing.on_road import OnRoad, RacingCar, slowest, steps_in
from slipangle.control.racing.planner import Planner
from slipangle.control.racing.sensing import Sensing
from slipangle.models.vehicles.catalogue import BMW_320I
from slipangle.optimal.lap.car import held, rates
from tests.optimal.lap.cars import RACER, ring

STAGE, BEND = 1.2, 0.02  # m, 1/m: stages of a circle to the left


def driven(car, start, turn, rise, length, *, lag, beyond, steering_lag=0.0):
    """The same drive over time in the plane: state of `AlongTrack` at the circle's arc length, and when it is there."""
    n, chi, *rest = start
    radius = 1.0 / BEND
    plane = [0.0, n, chi, *rest]

    def turning(d, late):
        return [(angle - d) / steering_lag for angle in late] or [turn]

    def motion(_, y):
        _, _, psi, vx, vy, yaw, d, force, asked, *late = y
        m = rates(vx, vy, yaw, d, force, car)
        c, s = np.cos(psi), np.sin(psi)
        place = [vx * c - vy * s, vx * s + vy * c, yaw]
        return [
            *place,
            m.v_x + beyond[0],
            m.v_y,
            m.r + beyond[1],
            *turning(d, late),
            (asked - force) / lag,
            rise,
            *([turn] * len(late)),
        ]

    def passed(_, y):
        return np.arctan2(y[0], radius - y[1]) * radius - length

    passed.terminal, passed.direction = True, 1.0
    found = solve_ivp(motion, (0.0, 2.0), plane, events=passed, rtol=1e-10, atol=1e-10)
    X, Y, psi, *rest = found.y_events[0][0]
    off = radius - np.hypot(X, radius - Y)
    return np.array([off, psi - length / radius, *rest]), found.t_events[0][0]


@pytest.mark.parametrize(("grip", "asked", "lag"), [(1.0, 2500.0, 0.2), (0.8, -2500.0, 0.1)])
def test_a_stage_is_the_car_on_its_way_along_the_track(grip, asked, lag):
    start = np.array([0.4, 0.02, 22.0, -0.3, 0.4, 0.05, 1500.0, asked])
    model = AlongTrack(params=RACER, drive_lag=lag, brake_lag=lag, dt=0.05, substeps=4)
    given = [0.3, -1000.0, BEND, STAGE, grip * RACER.mu_f, grip * RACER.mu_r, 0.4, -0.2]
    x = start
    for _ in range(5):
        x = np.asarray(model.step(x, np.array(given)), dtype=float)
    car = replace(RACER, mu_f=grip * RACER.mu_f, mu_r=grip * RACER.mu_r)
    other, _ = driven(car, start, 0.3, -1000.0, 5 * STAGE, lag=lag, beyond=(0.4, -0.2))
    assert x == pytest.approx(other, rel=2e-5, abs=2e-5)


def test_a_steering_that_is_late_follows_the_angle_that_is_asked_for():
    start = np.array([0.4, 0.02, 22.0, -0.3, 0.4, 0.05, 1500.0, 2500.0, 0.07])
    model = along_track(0.1, params=RACER, drive_lag=0.2, brake_lag=0.2, dt=0.05, substeps=4)
    given = np.array([0.3, -1000.0, BEND, STAGE, RACER.mu_f, RACER.mu_r, 0.4, -0.2])
    x = start
    for _ in range(5):
        x = np.asarray(model.step(x, given), dtype=float)
    other, _ = driven(RACER, start, 0.3, -1000.0, 5 * STAGE, lag=0.2, beyond=(0.4, -0.2), steering_lag=0.1)
    assert x == pytest.approx(other, rel=2e-5, abs=2e-5)
    assert along_track(0.02, params=RACER, dt=0.05).states == AlongTrack.states


def test_a_plan_begins_where_the_car_is_behind_what_is_on_its_way():
    pedals = replace(sa.Pedals.of(BMW_320I), lag=0.2, brake_lag=0.2)
    planner = Planner(RACER, ring(1.0 / BEND), pedals, dt=0.05, horizon=4, steering_lag=0.1)
    start = np.array([0.4, 0.02, 22.0, -0.3, 0.4, 0.05, 1500.0, 2500.0, 0.07])
    coming = np.tile([0.3, -1000.0], (12, 1))
    ahead, s = planner.ahead(start, 10.0, coming, 0.01, 0.8, {"d_v_x": 0.4, "d_r": -0.2})
    car = replace(RACER, mu_f=0.8 * RACER.mu_f, mu_r=0.8 * RACER.mu_r)
    other, t = driven(car, start, 0.3, -1000.0, s - 10.0, lag=0.2, beyond=(0.4, -0.2), steering_lag=0.1)
    assert t == pytest.approx(0.12, rel=1e-3)
    assert ahead == pytest.approx(other, rel=1e-3, abs=1e-4)
    assert planner.ahead(start, 10.0, coming[:0], 0.01, 0.8, {})[1] == 10.0


def test_what_is_asked_of_an_actuator_is_heard_after_its_delay():
    pedals = sa.Pedals.of(BMW_320I)
    acting = Actuators(RACER, pedals, delay=0.03, lag=0.1, sample=0.01)
    pressed = [acting.ask(0.5, 4000.0, 20.0, 3000.0, 3) for _ in range(20)]
    assert acting.asked == pytest.approx((0.1, 800.0))
    assert acting.heard == pytest.approx((0.1 - 3 * 0.005, 800.0 - 3 * 40.0))
    assert acting.coming == pytest.approx(np.tile([0.5, 4000.0], (3, 1)))
    assert pressed[0] == pressed[2] == pedals.pressed(0.0, 20.0, 3000.0, 3)
    assert pressed[3] == pedals.pressed(40.0, 20.0, 3000.0, 3)
    assert acting.steered == pytest.approx(0.085 - 0.1 * 0.5 * (1 - np.exp(-1.7)), abs=3e-3)  # a ramp behind a lag


@pytest.mark.parametrize(("asked", "lag"), [(2500.0, 0.2), (-2500.0, 0.1)])
def test_driving_and_braking_follow_by_lags_of_their_own(asked, lag):
    model = AlongTrack(params=RACER, drive_lag=0.2, brake_lag=0.1, dt=0.05)
    x, u = np.array([0.0, 0.0, 20.0, 0.0, 0.0, 0.0, 500.0, asked]), np.zeros(8)
    u[3:6] = 1.0, RACER.mu_f, RACER.mu_r  # a metre of a straight takes as long as a sample
    assert model.derivative(x, u)[6] == pytest.approx((asked - 500.0) / lag, rel=0.02)


def test_a_car_that_swings_lifts_no_wheel_that_its_tires_can_not_lift():
    weight = RACER.mass * 9.81
    most = (RACER.mu_f * RACER.l_r + RACER.mu_r * RACER.l_f) / RACER.wheelbase * 9.81
    still = replace(RACER, downforce_f=0.0, downforce_r=0.0)
    assert held(20.0, 0.3, still) == pytest.approx(6.0)
    assert held(20.0, 1.5, still) == pytest.approx(most)
    assert held(20.0, -1.5, still) == pytest.approx(-most)
    pressed = replace(still, downforce_f=0.25 * weight / 400.0, downforce_r=0.25 * weight / 400.0)
    mean = 0.5 * (RACER.mu_f + RACER.mu_r)
    assert held(20.0, 1.5, pressed) == pytest.approx(most + 0.5 * 9.81 * mean, rel=0.01)


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
    x[5] = 0.9  # beyond what the tires hold: no more load moves
    car = replace(RACER, mu_f=0.7 * RACER.mu_f, mu_r=0.7 * RACER.mu_r)
    most = float(held(25.0, 0.9, car))
    assert most < 0.5 * 25.0 * 0.9
    swinging = rates(25.0, -0.6, 0.9, 0.06, -3000.0, car, a_y=most)
    assert np.asarray(model.derivative(x, u), dtype=float)[5] == pytest.approx(swinging.r - 0.1)


def test_plans_and_filter_follow_a_light_stiff_car_at_its_slowest_speed():
    """As a finer integration has it; of two steps to a stage, it swings with a yaw rate seventeen times as large."""
    stiff = replace(RACER, C_f=3.0 * RACER.C_f, C_r=3.0 * RACER.C_r, inertia_z=0.6 * RACER.inertia_z)
    v, dt = 1.05 * float(slowest(stiff)), 0.05
    planner = Planner(stiff, ring(), sa.Pedals.of(BMW_320I), dt=dt, horizon=5)
    model = planner.mpc.model
    assert model.substeps == steps_in(stiff, dt) > 2
    x = np.array([0.0, 0.0, v, 0.02, 0.03, 0.005, 0.0, 0.0])
    u = np.array([0.0, 0.0, 0.0, v * dt, stiff.mu_f, stiff.mu_r, 0.0, 0.0])
    fine, now = replace(model, substeps=64), x
    for _ in range(10):
        x, now = model.step(x, u), fine.step(now, u)
    assert x[3:5] == pytest.approx(now[3:5], rel=0.05, abs=1e-4)
    filtered = Sensing(stiff, grip_std=0.05, noise={}, gate=None, patience=25, sample=dt).filter.model
    assert filtered.substeps == max(steps_in(stiff, dt), 5)


def test_how_many_steps_there_are_goes_with_stiffness_and_mass_not_with_size():
    usual = steps_in(RACER, 1.0)
    assert steps_in(replace(RACER, C_f=2 * RACER.C_f, C_r=2 * RACER.C_r), 1.0) == pytest.approx(2 * usual, abs=1)
    heavy = {n: 2 * getattr(RACER, n) for n in ("mass", "inertia_z")}
    assert steps_in(replace(RACER, **heavy), 1.0) == pytest.approx(0.5 * usual, abs=1)
    assert steps_in(RACER, 1e-3) == 1
    k = 0.25  # all lengths; masses by k^3, times by the root
    power = {"mass": 3, "C_f": 3, "C_r": 3, "inertia_z": 5, "wheelbase": 1, "l_f": 1}
    small = replace(RACER, **{n: getattr(RACER, n) * k**p for n, p in power.items()})
    assert steps_in(small, k**0.5) == pytest.approx(usual, abs=1)
