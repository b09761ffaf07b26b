"""Path followers: exact cases, the preview LQR against a batch optimum, and a dual-track car in its lane."""

import math
from dataclasses import replace

import numpy as np
import pytest

from slipangle.control.followers.feedforward import FeedforwardFeedback
from slipangle.control.followers.followers import PurePursuit, Stanley
from slipangle.control.followers.preview_lqr import PreviewLQR
from slipangle.control.speed.pedals import drive_force, moving_mass, pedal_driver
from slipangle.errors import ParameterError
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import BMW_320I, PASSENGER_TIRE, SOUSA_CAR_7, SOUSA_TABLE_7_2, VW_VANAGON
from slipangle.models.vehicles.driveline import Driveline, Engine
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.kinematic import Kinematic
from slipangle.models.vehicles.road import Road
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Values
from slipangle.paths.lane_change import double_lane_change
from slipangle.paths.path import Path
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import End

CAR = SOUSA_TABLE_7_2
FOLLOWERS = {
    "pure pursuit": PurePursuit(params=CAR),
    "Stanley": Stanley(params=CAR),
    "LQR": PreviewLQR(params=CAR),
    "feed-forward": FeedforwardFeedback(params=CAR),
}
EACH = pytest.mark.parametrize("follower", FOLLOWERS.values(), ids=FOLLOWERS.keys())


def circle(radius, v_x):
    angle = np.linspace(0, 1.9 * math.pi, 400)
    return Path.from_points(radius * np.sin(angle), radius * (1 - np.cos(angle))).with_speed(v_x)


def straight_path(v_x=15.0):
    return Path.from_points(np.linspace(0, 300, 40), np.zeros(40)).with_speed(v_x)


def state(follower, *, Y=0.0, psi=0.0, X=0.0, v_y=0.0, r=0.0):
    values = {"X": X, "Y": Y, "psi": psi, "v_y": v_y, "r": r}
    return np.array([values[n] for n in follower.model.states])


def angle(follower, path, x, **more):
    return float(follower.plan(x, path.ahead(0.0, follower.horizon, follower.dt), **more).command[0])


@EACH
def test_straight_on_the_path_and_towards_it_beside_it(follower):
    path = straight_path()
    assert angle(follower, path, state(follower)) == pytest.approx(0.0, abs=1e-9)
    left = angle(follower, path, state(follower, Y=0.5))
    assert left < -1e-3
    assert angle(follower, path, state(follower, Y=-0.5)) == pytest.approx(-left, rel=1e-9)
    turned = angle(follower, path, state(follower, psi=0.1))
    assert turned < -0.01
    around = angle(follower, path, state(follower, psi=0.1 + 2 * math.pi))
    assert around == pytest.approx(turned, rel=1e-6)


def test_pure_pursuit_on_its_circle_steers_as_the_geometry_says():
    """A rear axle on the circle: whatever the look-ahead, the angle is atan(wheelbase / radius)."""
    R = 40.0
    path = circle(R, 10.0)
    for gain in (0.3, 0.6, 0.9):
        follower = PurePursuit(params=CAR, gain=gain, horizon=60)
        x = np.array([CAR.l_r, 0.0, 0.0])  # the rear axle at the start of the circle
        assert angle(follower, path, x) == pytest.approx(math.atan(CAR.wheelbase / R), rel=2e-3)


def test_stanley_closes_the_distance_exponentially():
    """Front axle of a kinematic car: e' = -v sin(delta_e), so about exp(-gain t) once gain e << v."""
    follower = Stanley(params=CAR, gain=1.0, softening=1e-6, damping=0.0, dt=0.01)
    car = Kinematic(params=CAR, dt=0.01)
    path = straight_path(20.0)
    pose, seen = np.array([0.0, 1.0, 0.0]), []
    s = 0.0
    for _ in range(300):
        x = state(follower, X=pose[0], Y=pose[1], psi=pose[2])
        preview = path.ahead(s, follower.horizon, 0.01)
        u = follower.plan(x, preview).command[0]
        seen.append(pose[1] + CAR.l_f * math.sin(pose[2]))
        pose = car.step(pose, np.array([u, 20.0]))
        s = pose[0]
    decay = -np.diff(np.log(seen))[50:200] / 0.01
    assert decay == pytest.approx(np.ones(150), rel=0.02)


@pytest.mark.parametrize("v_x", [5.0, 20.0])
def test_preview_lqr_is_the_batch_optimum(v_x):
    """First move of a long unconstrained least-squares problem with the same curvatures ahead."""
    follower = PreviewLQR(params=CAR, speeds=(v_x, v_x + 1.0), horizon=15)
    rng = np.random.default_rng(1)
    curvature = np.concatenate([0.01 * rng.standard_normal(16), np.zeros(234)])
    A, B, E = follower.errors(v_x)
    steps = 2000
    h = follower.dt / steps  # an integration of its own: small Euler steps of the held inputs
    F, G, D = np.eye(4), np.zeros((4, 1)), np.zeros((4, 1))
    for _ in range(steps):
        F, G, D = F + h * A @ F, G + h * (A @ G + B), D + h * (A @ D + E * v_x)
    e0, last = np.array([0.3, -0.1, 0.05, 0.02]), 0.01
    n = len(curvature)
    rows, right = [], []
    response, free = np.zeros((4, n)), e0.copy()
    for k in range(n):
        response = F @ response
        response[:, k] += G[:, 0]
        free = F @ free + D[:, 0] * curvature[k]
        for i, w in ((0, follower.weight_y), (2, follower.weight_psi)):
            rows.append(math.sqrt(w) * response[i])
            right.append(-math.sqrt(w) * free[i])
    change = math.sqrt(follower.weight_change) * (np.eye(n) - np.eye(n, k=-1))
    rows += list(change)
    right += [math.sqrt(follower.weight_change) * last] + [0.0] * (n - 1)
    M = np.array(rows)
    best = np.linalg.solve(M.T @ M, M.T @ np.array(right))[0]
    ahead = np.zeros((16, 5))
    ahead[:, 3] = curvature[:16]
    e_psi = e0[2]
    x = np.array([e0[1] - v_x * e_psi, e0[3] + v_x * curvature[0], 0.0, e0[0], e_psi])
    assert follower.law(x, ahead, v_x, last) == pytest.approx(best, rel=2e-3)


@EACH
def test_limits_rates_and_missing_measurements(follower):
    tight = replace(follower, limit=0.1, rate=0.5)
    path = straight_path()
    x = state(tight, Y=5.0, psi=0.5)
    plan = tight.plan(x, path.ahead(0.0, tight.horizon, tight.dt), applied=np.array([0.02]))
    assert plan.command[0] == pytest.approx(0.02 - 0.5 * tight.dt)
    plan = tight.plan(x, path.ahead(0.0, tight.horizon, tight.dt), applied=np.array([-0.1]))
    assert plan.command[0] == pytest.approx(-0.1)
    lost = tight.plan(x * np.nan, path.ahead(0.0, tight.horizon, tight.dt), plan)
    assert lost.status is Status.NOT_FINITE
    assert lost.command[0] == plan.command[0]
    assert lost.age == 1


@EACH
def test_an_angle_applied_that_cannot_be_is_said_and_does_without(follower):
    ahead = straight_path().ahead(0.0, follower.horizon, follower.dt)
    x = state(follower, Y=0.5)
    plan, usual = (follower.plan(x, ahead, applied=applied) for applied in (np.array([np.inf]), None))
    assert plan.u == pytest.approx(usual.u)
    assert plan.detail.startswith("applied is inf for 'delta', which no input can be")
    assert usual.detail == ""


@EACH
def test_steering_gain_and_offset_are_undone(follower):
    params = CAR.with_values(steering_gain=0.5, steering_offset=0.02)
    odd = replace(follower, params=params)
    path = circle(60.0, 12.0)
    plain = angle(follower, path, state(follower, Y=0.1))
    command = angle(odd, path, state(odd, Y=0.1), applied=np.array([0.02]))  # the wheels were straight
    assert params.road_wheel(command) == pytest.approx(plain, rel=1e-9)


@EACH
@pytest.mark.parametrize("v_x", [pytest.param(15.0, marks=pytest.mark.slow), 18.0])
def test_lane_change_in_the_lane(follower, v_x):
    """Dual-track car, ISO 3888-1."""
    car = DualTrack(params=SOUSA_CAR_7, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001)
    run = closed_loop(Plant(car), follower, double_lane_change(v_x), driver=pedal_driver(SOUSA_CAR_7))
    assert run.end is End.FINISHED
    assert run.inside
    assert run.max("y") < 0.35
    assert run.max("v_x") < 0.5


@EACH
@pytest.mark.parametrize(
    "trouble",
    [
        pytest.param({"mass": 1600.0}, id="-20 %", marks=pytest.mark.slow),
        pytest.param({"mass": 2400.0}, id="+20 %", marks=pytest.mark.slow),
        pytest.param({"slippery": True}, id="friction"),
        pytest.param({"delay": 0.1}, id="delay", marks=pytest.mark.slow),
    ],
)
def test_trouble_ends_in_a_defined_way(follower, trouble):
    """Another mass, friction that halves in mid-manoeuvre, steering two steps late: finite, and the lane is kept."""
    params = SOUSA_CAR_7.with_values(mass=trouble.get("mass", 2000.0))
    road = Road(distance=(70.0, 70.1), left=(1.0, 0.5), right=(1.0, 0.5)) if "slippery" in trouble else Road()
    car = DualTrack(params=params, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001, road=road)
    plant = Plant(car, delay=Values(delta=trouble.get("delay", 0.0)))
    run = closed_loop(plant, follower, double_lane_change(14.0), driver=pedal_driver(SOUSA_CAR_7))
    assert run.end is End.FINISHED
    assert np.isfinite(run.states).all()
    assert run.max("y") < 0.5


@EACH
def test_a_circle_is_followed_closely(follower):
    car = OnGround(Bicycle(params=CAR, dt=0.001, outputs=("v_y", "r")))
    run = closed_loop(Plant(car), follower, circle(60.0, 12.0), duration=15.0)
    assert np.abs(run.e_y[len(run.t) // 2 :]).max() < 0.35


def test_bad_input_says_what_to_do():
    with pytest.raises(ParameterError, match="horizon is 0; expected a whole number"):
        Stanley(params=CAR, horizon=0)
    with pytest.raises(ParameterError, match="rising"):
        PreviewLQR(params=CAR, speeds=(5.0, 4.0))
    with pytest.raises(ParameterError, match=r"weight_change is 0\.0; expected a positive number"):
        PreviewLQR(params=CAR, weight_change=0.0)
    with pytest.raises(ParameterError, match="horizon \\+ 1"):
        FOLLOWERS["LQR"].reference(straight_path().ahead(0.0, 3, 0.05))


# ---- the driver of throttle and brake --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "params",
    [
        pytest.param(SOUSA_CAR_7, id="Sousa"),
        pytest.param(BMW_320I, id="BMW", marks=pytest.mark.slow),
        pytest.param(VW_VANAGON, id="Vanagon", marks=pytest.mark.slow),
    ],
)
def test_pedal_driver_reaches_speeds_without_much_overshoot(params):
    car = Plant(DualTrack(params=params, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001))
    path = Path.from_points(np.linspace(0, 400, 60), np.zeros(60))
    speeds = np.interp(path.s, [0, 40, 140, 190, 260, 400], [10, 10, 20, 20, 10, 10])
    run = closed_loop(car, Stanley(params=params), path.with_speed(speeds), driver=pedal_driver(params))
    assert run.end is End.FINISHED
    assert np.abs(run.e_v[run.t > 2.0]).max() < 1.5
    assert np.abs(run.e_v[-200:]).max() < 0.2
    throttle, brake = run["throttle"], run["brake"]
    assert (throttle.min(), brake.min()) >= (0.0, 0.0)
    assert max(throttle.max(), brake.max()) <= 1.0 + 1e-12
    assert (throttle * brake).max() < 1e-12


def test_drive_force_and_mass_follow_the_gears():
    line = SOUSA_CAR_7.driveline
    low = drive_force(SOUSA_CAR_7, 5.0)
    ratio = line.ratios[0] * line.final
    assert low == pytest.approx(line.engine.torque(1.0, 5.0 / 0.33 * ratio) * ratio / 0.33)
    assert drive_force(SOUSA_CAR_7, 30.0) < low
    assert moving_mass(SOUSA_CAR_7, 5.0) > moving_mass(SOUSA_CAR_7, 30.0) > SOUSA_CAR_7.mass
    with pytest.raises(ParameterError, match="engine"):
        pedal_driver(replace(SOUSA_CAR_7, driveline=Driveline(engine=Engine(torques=(0.0,) * 5))))


@pytest.mark.parametrize("v_x", [8.0, 20.0, 35.0])
def test_the_response_is_the_lateral_accelerations_delay(v_x):
    """Phase of the linear bicycle from steering to lateral acceleration in a slow sine, over its frequency."""
    law, slow = FeedforwardFeedback(params=CAR), 1e-3  # rad/s
    model = Bicycle(params=CAR, dt=0.01, outputs=("a_y",))
    rate = np.column_stack([model.derivative(e, np.array([0.0, v_x])) for e in np.eye(2)])
    push = model.derivative(np.zeros(2), np.array([1.0, v_x]))
    x = np.linalg.solve(1j * slow * np.eye(2) - rate, push)
    a_y = 1j * slow * x[0] + v_x * x[1]
    assert law.response(v_x) == pytest.approx(max(-np.angle(a_y) / slow, 0.0), rel=1e-4)


def test_a_car_without_a_steady_answer_has_a_bounded_response():
    tail_happy = CAR.with_values(C_f=2.0 * CAR.C_f, C_r=0.5 * CAR.C_r)
    law = FeedforwardFeedback(params=tail_happy)
    assert law.response(60.0) == 0.5
    assert 0.0 <= law.response(0.0) <= 0.5


def test_the_feedforward_is_that_of_a_steady_bend():
    """On the linear bicycle, whose understeer gradient it knows, a circle is driven without error."""
    law = FeedforwardFeedback(params=CAR)
    plant = Plant(OnGround(Bicycle(params=CAR, dt=0.001, outputs=("v_y", "r"))))
    run = closed_loop(plant, law, circle(150.0, 20.0), duration=12.0)
    assert np.abs(run.e_y[run.t > 9.0]).max() < 2e-3
    gradient = CAR.mass * ((CAR.wheelbase - CAR.l_f) / CAR.C_f - CAR.l_f / CAR.C_r) / CAR.wheelbase
    assert law.understeer_gradient == pytest.approx(gradient)
    steady = run.inputs[-1, 0]
    assert steady == pytest.approx((CAR.wheelbase + gradient * 20.0**2) / 150.0, rel=2e-3)


@pytest.mark.parametrize("v_x", [10.0, 30.0])
def test_the_feedback_has_its_bandwidth_at_every_speed(v_x):
    """Critically damped: beside a straight path the distance is (1 + w t) exp(-w t), the tires' lag apart."""
    law = FeedforwardFeedback(params=CAR, bandwidth=1.0, dt=0.01)
    plant = Plant(OnGround(Bicycle(params=CAR, dt=0.001, outputs=("v_y", "r"))))
    run = closed_loop(plant, law, straight_path(v_x), x0=plant.straight(v_x, Y=0.2), duration=8.0)
    expected = 0.2 * (1 + run.t) * np.exp(-run.t)
    assert np.abs(run.e_y - expected).max() < 0.02
    assert run.e_y.min() > -0.01


def test_the_lead_makes_up_for_late_steering():
    path = double_lane_change(20.0, blend=10.0)
    late = Plant(
        OnGround(Bicycle(params=CAR, dt=0.001, outputs=("v_y", "r"))),
        delay=Values(delta=0.05),
        lag=Values(delta=0.1),
    )
    plain, ahead = (closed_loop(late, FeedforwardFeedback(params=CAR, dt=0.02, lead=t), path) for t in (0.0, 0.15))
    assert ahead.rmse("y") < 0.6 * plain.rmse("y")
