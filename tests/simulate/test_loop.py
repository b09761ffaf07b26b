"""Closed loops: lane changes inside the lane, estimation, speed, failures, bookkeeping."""

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from slipangle.control.mpc import MPC
from slipangle.control.speed.driver import SpeedDriver
from slipangle.errors import ParameterError, SampleTimeError
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from slipangle.models.vehicles.parameters import BicycleParams
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Values, Weights
from slipangle.paths.lane_change import double_lane_change, obstacle_avoidance
from slipangle.paths.path import Path
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import End

CAR = SOUSA_TABLE_6_1
STIFFNESS = 2 * SOUSA_TABLE_6_2.lateral.slope * CAR.load_f
LINEAR = BicycleParams(
    mass=CAR.mass, inertia_z=CAR.inertia_z, wheelbase=CAR.wheelbase, l_f=CAR.l_f, C_f=STIFFNESS, C_r=STIFFNESS
)
BICYCLE = OnGround(Bicycle(params=LINEAR, dt=0.05))
PLANT = Plant(OnGround(Bicycle(params=LINEAR, dt=0.001, outputs=("r", "v_y"))))
SINGLE_TRACK = Plant(SingleTrack(params=CAR, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2, dt=0.001))
DRIVER = SpeedDriver.for_car(mass=CAR.mass, radius=CAR.radius, limits=(-6000.0, 3000.0), brake=Values(T_f=0.5, T_r=0.5))
STEER = MPC(
    BICYCLE,
    solver="ipopt",
    horizon=20,
    Q=Weights(e_y=10.0, e_psi=10.0),
    S=Weights(delta=100.0),
    limits=Limits(delta=0.35),
    rates=Limits(delta=0.8),
)
SHORT = double_lane_change(20.0, run_in=10.0, run_out=5.0)


def check_inputs(run, mpc):
    """Bounds and rates of every command."""
    delta = run.commands[:, 0]
    assert np.abs(delta).max() <= 0.35
    assert np.abs(np.diff(delta)).max() <= 0.8 * mpc.dt + 1e-12


def test_exact_model_tracks_iso_3888_1_inside_the_lane():
    run = closed_loop(PLANT, STEER, double_lane_change(20.0))
    assert run.end is End.FINISHED
    assert run.inside
    assert run.rmse("y") < 0.010  # m; 0.0074 when written
    assert run.max("y") < 0.030  # m; 0.022 when written
    assert run.rmse("psi") < 0.02
    assert run.statuses == {Status.SOLVED: len(run.plans)}
    check_inputs(run, STEER)


def test_single_track_with_magic_formula_tires_under_an_mpc_on_the_bicycle():
    run = closed_loop(SINGLE_TRACK, STEER, double_lane_change(20.0), driver=DRIVER)
    assert run.end is End.FINISHED
    assert run.inside
    assert run.rmse("y") < 0.015  # m; 0.0118 when written
    assert run.max("y") < 0.055  # m; 0.042 when written
    assert run.max("v_x") < 0.1
    assert np.abs(run["v_y"]).max() > 0.2  # the tires do slip
    assert run.fallbacks == 0
    check_inputs(run, STEER)


def test_noise_delay_and_lag_stay_inside_the_lane():
    plant = replace(
        SINGLE_TRACK,
        noise=Values(X=0.02, Y=0.02, psi=0.002, r=0.005, v_x=0.05),
        delay=Values(delta=0.02),
        lag=Values(delta=0.05),
        seed=5,
    )
    smooth = replace(STEER, S=Weights(delta=400.0))
    run = closed_loop(plant, smooth, SHORT, driver=DRIVER)
    assert run.inside
    assert run.rmse("y") < 0.10
    again = closed_loop(plant, smooth, SHORT, driver=DRIVER, duration=1.0)
    assert np.array_equal(run.states[: len(again.t)], again.states)  # seeded
    other = closed_loop(replace(plant, seed=6), smooth, SHORT, driver=DRIVER, duration=1.0)
    assert not np.array_equal(run.states[:50], other.states[:50])


def test_obstacle_avoidance_at_low_speed():
    run = closed_loop(SINGLE_TRACK, STEER, obstacle_avoidance(11.0), driver=DRIVER)
    assert run.inside
    assert run.end is End.FINISHED


def test_any_model_can_be_the_controllers():
    """An ARX model of v_y and r at one speed, here the bicycle's own difference equation."""
    bicycle = Bicycle(params=LINEAR, dt=0.05)
    still = np.array([0.0, 20.0])
    A = np.column_stack([bicycle.step(x, still) for x in np.eye(2)])
    B = bicycle.step(np.zeros(2), np.array([1.0, 20.0])).reshape(2, 1)
    arx = ARXModel(A=-A[None], B=B[None], dt=0.05, inputs=("delta",), outputs=("v_y", "r"))
    mpc = replace(STEER, model=OnGround(arx))
    assert mpc.exogenous == ("v_x",)
    run = closed_loop(SINGLE_TRACK, mpc, SHORT, driver=DRIVER)
    assert run.inside
    assert run.rmse("y") < 0.015  # m; 0.010 when written
    assert run.fallbacks == 0


def test_the_sign_of_the_error_is_positive_on_the_left():
    x0 = PLANT.straight(20.0, X=SHORT.X[0], Y=0.4)
    run = closed_loop(PLANT, STEER, SHORT, x0=x0, duration=0.5)
    assert run.e_y[0] == pytest.approx(0.4)
    assert run["delta"][3] < 0
    assert run.end is End.TIME
    assert run.t[-1] == pytest.approx(0.5)


def test_speed_follows_a_profile_on_a_closed_track():
    t = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    track = Path.from_points(24 * np.cos(t), 15 * np.sin(t), closed=True, right=3.0, left=3.0)
    path = track.with_speed_limits(v_max=12.0, a_y=4.0, a_x=2.0)
    run = closed_loop(SINGLE_TRACK, STEER, path, driver=DRIVER)
    assert run.end is End.FINISHED
    assert run.s[-1] == pytest.approx(path.length, abs=0.3)
    assert np.ptp(path.v_x) > 1.5
    assert run.rmse("v_x") < 0.15
    assert run.max("y") < 0.15
    assert run.inside
    at = path.at(path.length - 6.0)
    x0 = SINGLE_TRACK.straight(at.v_x[0], X=at.X[0], Y=at.Y[0], psi=at.psi[0])
    over = closed_loop(SINGLE_TRACK, STEER, path, driver=DRIVER, x0=x0, duration=2.0)
    assert over.end is End.TIME
    assert over.s[-1] > path.length + 5.0  # into the next lap, heading and arc length go on
    assert over.max("psi") < 0.2
    assert over.max("y") < 0.3


def test_mpc_may_decide_the_speed_too():
    """Steering and torque from one problem; the driver is left out."""

    single = SingleTrack(params=CAR, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2, dt=0.05, method="radau")
    mpc = MPC(
        single,
        solver="ipopt",
        horizon=4,
        Q=Weights(e_y=10.0, e_psi=10.0, v_x=0.5),
        R=Weights(T_f=1e-8),
        S=Weights(delta=100.0, T_f=1e-8),
        limits=Limits(delta=0.35, T_f=(-3000.0, 2000.0)),
    )
    assert mpc.controls == ("delta", "T_f")
    path = SHORT.with_speed(np.linspace(20.0, 18.0, len(SHORT.s)))
    run = closed_loop(SINGLE_TRACK, mpc, path, held=Values(T_r=0.0), duration=0.5)
    assert run.statuses == {Status.SOLVED: len(run.plans)}
    assert run.max("v_x") < 0.1
    assert (run["T_r"] == 0).all()
    assert np.abs(run["T_f"]).max() > 50


# ---- failures ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Faulty:
    """A controller whose state is NaN at some of its steps."""

    mpc: MPC
    lost: frozenset
    counter: itertools.count = field(default_factory=itertools.count)

    def __getattr__(self, name):
        return getattr(self.mpc, name)

    def plan(self, x, reference, previous=None, *, applied=None):
        known = next(self.counter) not in self.lost
        return self.mpc.plan(x if known else np.full_like(x, np.nan), reference, previous, applied=applied)


def test_short_losses_are_bridged_and_counted():
    lost = frozenset({20, 21, 60, 61, 62, 63})
    run = closed_loop(PLANT, Faulty(STEER, lost), SHORT)
    assert run.end is End.FINISHED
    assert run.fallbacks == len(lost)
    assert run.statuses == {Status.SOLVED: len(run.plans) - len(lost), Status.NOT_FINITE: len(lost)}
    assert not any(p.stopping for p in run.plans)
    assert run.inside
    check_inputs(run, STEER)


@pytest.mark.parametrize("plant", [PLANT, SINGLE_TRACK], ids=["speed is an input", "speed is a state"])
def test_a_long_loss_stops_the_car(plant):
    run = closed_loop(
        plant,
        Faulty(STEER, frozenset(range(10, 10_000))),
        SHORT,
        driver=DRIVER if plant is SINGLE_TRACK else None,
        duration=8.0,
    )
    assert run.plans[-1].stopping
    assert np.isfinite(run.states).all()
    assert abs(run.v_x[-1]) < 0.1
    assert run.commands[-1] == pytest.approx([0.0], abs=1e-3)
    check_inputs(run, STEER)


def test_lost_measurements_are_bridged_by_the_model():
    class Drops(Plant):
        def start(self, x, inputs):
            simulation = super().start(x, inputs)
            clean, counter = simulation.measure, itertools.count()

            def measure():
                seen = clean()
                return seen | {"Y": np.nan, "X": np.nan} if next(counter) % 3 == 1 else seen

            simulation.measure = measure
            return simulation

    run = closed_loop(Drops(PLANT.model), STEER, SHORT)
    assert run.end is End.FINISHED
    assert run.fallbacks == 0
    assert run.inside


def test_leaving_the_path_ends_the_drive():
    still = replace(STEER, limits=Limits(delta=1e-6))
    t = np.linspace(0, np.pi, 20)
    bend = Path.from_points(40 * np.sin(t), 40 - 40 * np.cos(t)).with_speed(15.0)
    run = closed_loop(PLANT, still, bend)
    assert run.end is End.LEFT_PATH
    assert np.isinf(bend.at(0.0).left).all()
    assert not run.inside
    assert not run.finished
    assert "outside its lanes" in repr(run)
    assert run.max("y") > 20.0


def rough_drive(seed):
    """A car that differs from the controller's by up to 20 %, on a slippery road, with bad sensors."""
    rng = np.random.default_rng(seed)
    car = CAR.with_values(
        **{n: getattr(CAR, n) * rng.uniform(0.8, 1.2) for n in ("mass", "inertia_z", "l_f", "radius")}
    )
    grip = rng.uniform(0.3, 1.0)
    lateral = SOUSA_TABLE_6_2.lateral
    tire = replace(SOUSA_TABLE_6_2, lateral=lateral.with_values(D=lateral.D * grip))
    plant = Plant(
        SingleTrack(params=car, tire_f=tire, tire_r=tire, dt=0.001),
        noise=Values(X=0.05, Y=0.05, psi=0.01, r=0.02, v_x=0.2),
        delay=Values(delta=0.05),
        lag=Values(delta=rng.uniform(0.0, 0.1)),
        seed=seed,
    )
    lost = frozenset(rng.integers(0, 120, 15).tolist())
    return closed_loop(plant, Faulty(STEER, lost), SHORT, driver=DRIVER, duration=8.0), lost


def check_rough_drive(seed):
    run, lost = rough_drive(seed)
    assert np.isfinite(run.states).all()
    assert np.isfinite(run.commands).all()
    check_inputs(run, STEER)
    assert run.fallbacks >= sum(k in lost for k in range(len(run.plans)))
    assert sum(run.statuses.values()) == len(run.plans)


@pytest.mark.parametrize("seed", range(3))
def test_wrong_models_noise_and_losses_break_no_limit(seed):
    check_rough_drive(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3, 60))
def test_wrong_models_noise_and_losses_break_no_limit_many(seed):
    check_rough_drive(seed)


# ---- bookkeeping ---------------------------------------------------------------------------------------------------


def test_the_run_holds_what_happened():
    seen = []
    run = closed_loop(PLANT, STEER, SHORT, progress=seen.append)
    n = len(run.t)
    assert run.states.shape == (n, 5)
    assert run.inputs.shape == (n, 2)
    assert run.reference.shape == (n, 4)
    assert np.diff(run.t) == pytest.approx(0.01)
    assert run.t_plan == pytest.approx(0.05 * np.arange(len(run.plans)))
    assert run.seconds.shape == run.t_plan.shape
    assert (run.seconds > 0).all()
    assert run.commands.shape == (len(run.plans), 1)
    assert all(p.memory is None for p in run.plans)
    k = 100
    foot = SHORT.project(run["X"][k], run["Y"][k])
    assert (run.e_y[k], run.s[k]) == pytest.approx((foot.e_y, foot.s))
    assert run.e_psi[k] == pytest.approx(run["psi"][k] - foot.psi)
    # a command acts from its plan on, for one step of the controller
    held = run["delta"][1:].reshape(-1)[: 5 * (n // 5 - 1)].reshape(-1, 5)
    assert held == pytest.approx(np.repeat(run.commands[: len(held)], 5, axis=1))
    assert run.rmse() == pytest.approx(np.sqrt(np.mean(run.e_y**2)))
    assert len(seen) == len(run.plans)
    assert seen == sorted(seen)
    assert 0 <= seen[0] <= seen[-1] <= 1
    assert run["e_v"] == pytest.approx(0.0)
    with pytest.raises(ParameterError, match="'delta'"):
        run["Delta"]
    with pytest.raises(ParameterError, match="tracking error"):
        run.rmse("z")


def test_width_decides_whether_it_was_inside():
    run = closed_loop(PLANT, STEER, SHORT)
    assert run.inside
    assert not replace(run, width=2.4).inside
    far, near = np.full(len(run.path.s), 50.0), np.full(len(run.path.s), 2.0)
    for left, right, reach in ((near, far, run.e_y.max()), (far, near, -run.e_y.min())):  # one edge alone decides
        beside = replace(run, path=replace(run.path, left=left, right=right))
        assert replace(beside, width=2 * (2.0 - reach) - 0.01).inside
        assert not replace(beside, width=2 * (2.0 - reach) + 0.01).inside


def test_without_lanes_half_a_metre_is_what_counts():
    run = closed_loop(PLANT, STEER, SHORT)
    assert run.marked
    assert run.kept
    assert not replace(run, width=2.4).kept
    assert not replace(run, end=End.TIME).kept
    bare = replace(run, path=replace(run.path, left=None, right=None))
    assert not bare.marked
    assert "no lanes are marked" in repr(bare)
    assert "none are marked" in bare._repr_html_()
    for beside, kept in ((0.49, True), (0.51, False)):
        assert replace(bare, e_y=np.full_like(run.e_y, -beside)).kept is kept


@pytest.mark.parametrize(
    ("make", "error", "what"),
    [
        (lambda: closed_loop(SINGLE_TRACK, STEER, SHORT), ParameterError, "T_f"),
        (lambda: closed_loop(Plant(Bicycle(params=LINEAR, dt=0.001)), STEER, SHORT), ParameterError, "OnGround"),
        (lambda: closed_loop(PLANT, STEER, replace(SHORT, v_x=None)), ParameterError, "with_speed"),
        (lambda: closed_loop(PLANT, STEER, SHORT, duration=0.0), ParameterError, "duration"),
        (lambda: closed_loop(PLANT, STEER, SHORT, held=Values(T_f=1.0)), ParameterError, "held"),
        (lambda: closed_loop(PLANT, STEER, SHORT, driver=DRIVER), ParameterError, "driver"),
        (lambda: closed_loop(PLANT, STEER, SHORT, sample=0.02), SampleTimeError, "whole multiple"),
        (lambda: closed_loop(PLANT, STEER, SHORT, sample=0.0007), SampleTimeError, "whole multiple"),
    ],
)
def test_missing_links_are_named(make, error, what):
    with pytest.raises(error, match=what):
        make()
