"""A racer in the loop with a dual track on a small circuit, whose road holds less than it believes."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.commands import UNSURE
from slipangle.control.racing.gearbox import Gearbox
from slipangle.control.racing.learning import Learned
from slipangle.control.racing.planner import Planner
from slipangle.control.racing.racer import STOP
from slipangle.control.racing.sensing import NOISE
from slipangle.errors import ParameterError
from slipangle.models.vehicles.catalogue import BMW_320I, PASSENGER_TIRE
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.road import Road
from slipangle.simulate.drive import drive
from tests.optimal.lap.cars import circuit, ring, straight

pytestmark = pytest.mark.skipif(compiler() is None, reason=sentence())
SEEN = ("X", "Y", "psi", "v_x", "r", "a_x", "a_y")
OUTPUTS = ("v_x", "v_y", "r", "X", "Y", "psi", "a_x", "a_y")
PEDALS = sa.Pedals.of(BMW_320I)
FRICTION, MARGIN = 0.95, 0.4
EXPLAINED = {"d_v_x": 0.0, "d_r": 0.0}


def car_on(friction):
    road = Road(friction=(friction,) * 4)
    return DualTrack(
        params=BMW_320I, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001, outputs=OUTPUTS, road=road
    )


@cache
def believed():
    """The car as its model says, with a drive as its gears give it in the mean, and a little less grip: see limits."""
    car = sa.lap_car(car_on(1.0), power=7e4, drive_force=3200.0)
    return replace(car, C_f=0.88 * car.C_f, mu_f=0.96 * car.mu_f, mu_r=0.98 * car.mu_r)


@cache
def first_lap():
    car = believed()
    sure = replace(car, mu_f=0.86 * car.mu_f, mu_r=0.86 * car.mu_r, mu_x=0.95)
    return sa.fastest_lap(sure, circuit(), points=80, margin=MARGIN, smoothness=1.0)


def raced(racer, laps, friction=FRICTION, seed=1, lag=0.0, delay=0.0):
    noise = sa.Values(**{name: NOISE[name] for name in SEEN})
    late = {"lag": sa.Values(delta=lag), "delay": sa.Values(delta=delay)}
    plant = sa.Plant(car_on(friction), noise=noise, seed=seed, **late)
    lap = racer.lap
    X, Y, psi, v = (column[-2] for column in (lap.X, lap.Y, lap.psi, lap.v_x))
    x0 = plant.straight(v, X=X, Y=Y, psi=psi)
    run = drive(plant, racer, duration=laps * lap.time, channels=SEEN, x0=x0, width=racer.car.width)
    if laps < 1.0:
        return run, []
    places = np.column_stack([run["X"], run["Y"], run["v_x"]])
    channels = [sa.Channel("X", "m"), sa.Channel("Y", "m"), sa.Channel("v_x", "m/s")]
    log = sa.Dataset(values=places, channels=channels, dt=0.01)
    return run, [driven.time for driven in sa.driven_laps(log, racer.track)]


@cache
def two_laps():
    racer = sa.Racer(believed(), circuit(), PEDALS, lap=first_lap(), margin=MARGIN)
    run, times = raced(racer, 2.3)
    return racer, run, times


def test_it_drives_near_the_optimum_and_stays_on_the_track():
    racer, run, times = two_laps()
    car = believed()
    known = replace(car, mu_f=FRICTION * car.mu_f, mu_r=FRICTION * car.mu_r)
    fastest = sa.fastest_lap(known, circuit(), points=80).time
    assert run.inside
    assert run.fallbacks < 0.01 * len(run.plans)
    assert len(times) == 2
    assert max(times) < 1.07 * fastest  # 3 % of it are the margin of 0.4 m and the first lap's careful grip
    assert racer.lap.time < 1.04 * fastest


@pytest.mark.slow
def test_nearer_to_the_limit_it_does_not_swing_off_the_track():
    """By 1.5 m in its second lap, if plans hold what the filter finds unexplained: the lag of tires and brakes."""
    racer = sa.Racer(believed(), circuit(), PEDALS, lap=first_lap(), share=0.96, margin=MARGIN)
    run, times = raced(racer, 2.2)
    assert run.inside
    assert len(times) == 2


def test_a_lap_that_leaves_nothing_to_correct_with_is_warned_of():
    sure = replace(believed(), mu_f=0.85 * believed().mu_f, mu_r=0.85 * believed().mu_r)
    shaken = sa.fastest_lap(sure, circuit(), points=80, margin=MARGIN, smoothness=0.1)
    with pytest.warns(UserWarning, match="smoothness of 0.1 and leaves nothing to correct with; expected 1"):
        sa.Racer(believed(), circuit(), PEDALS, lap=shaken, margin=MARGIN)


@pytest.mark.slow
def test_a_steering_that_is_late_costs_no_time_where_it_is_known():
    racer = sa.Racer(believed(), circuit(), PEDALS, lap=first_lap(), margin=MARGIN, steering_lag=0.15)
    run, times = raced(racer, 1.2, lag=0.15)
    _, clean, clean_times = two_laps()
    assert run.inside
    assert times[0] == pytest.approx(clean_times[0], abs=0.06)  # 0.27 s longer where it is not known
    assert np.abs(run.e_y - clean.e_y[: len(run.e_y)]).max() < 0.5
    assert not any(racer.sensing.outliers.values())


def test_a_steering_with_a_dead_time_costs_no_time_where_it_is_known():
    how = {"margin": MARGIN, "steering_delay": 0.08, "steering_lag": 0.06}
    racer = sa.Racer(believed(), circuit(), PEDALS, lap=first_lap(), **how)
    run, times = raced(racer, 1.2, delay=0.08, lag=0.06)
    _, clean, clean_times = two_laps()
    assert run.inside
    assert times[0] == pytest.approx(clean_times[0], abs=0.06)  # 0.18 s longer where all of it counts as lag
    assert np.abs(run.e_y - clean.e_y[: len(run.e_y)]).max() < 0.5  # else 1.9 m
    assert not any(racer.sensing.outliers.values())


def test_laps_are_planned_faster_as_it_learns():
    racer, _, times = two_laps()
    assert racer.learned.grip == pytest.approx(FRICTION, abs=0.06)
    assert racer.lap.time < racer.first.time
    assert min(times[1:]) < times[0]
    assert racer.learned.grip_std < 0.02


def test_it_learns_how_much_the_road_holds():
    slippery = sa.Racer(believed(), circuit(), PEDALS, lap=first_lap(), margin=MARGIN, between=False)
    raced(slippery, 0.6, friction=0.88)
    slippery.learned.end_lap()
    grippy = sa.Racer(believed(), circuit(), PEDALS, lap=first_lap(), margin=MARGIN, between=False)
    raced(grippy, 0.6, friction=1.0)
    grippy.learned.end_lap()
    assert grippy.learned.grip - slippery.learned.grip > 0.06
    assert slippery.learned.grip < 0.97 < grippy.learned.grip


def test_what_full_throttle_gives_is_learned_by_place():
    learned = Learned(500.0, 0.05)
    assert learned.most(230.0, 3000.0) == 3000.0
    for _ in range(100):
        learned.see(203.0, 0.6, 1.0, (0.95, 0.01), 0.01)
    for _ in range(100):
        learned.see(403.0, 9.0, 1.0, (0.95, 0.01), 0.01)
    assert learned.most(507.0 + 200.0, 3000.0) == pytest.approx(1800.0)
    assert learned.most(250.0, 3000.0) == pytest.approx(1800.0)  # nothing was seen there: as at the nearest place
    assert learned.most(480.0, 3000.0) == pytest.approx(6000.0)  # no force is believed that is many times too large
    assert learned.most(np.array([110.0, 203.0]), np.array([3000.0, 1000.0])) == pytest.approx([1800.0, 600.0])
    learned.end_lap()
    assert (learned.grip, learned.grip_std) == pytest.approx((0.95, 0.01))
    car = learned.car(believed(), 0.96)
    assert car.mu_f / believed().mu_f == pytest.approx(0.96 * 0.94)


@pytest.mark.parametrize(("power", "share", "learned"), [(3.0, 0.5, 1.0), (3.0, 0.85, 0.85), (1.0, 0.5, 0.5)])
def test_a_wheel_that_spins_is_not_learned_as_a_weak_engine(power, share, learned):
    """Half of what full throttle should give, where that is more than half of what the driven tires hold: a wheel."""
    pedals = replace(PEDALS, full=power * PEDALS.full)
    racer = sa.Racer(believed(), circuit(), pedals, lap=first_lap(), margin=MARGIN)
    racer._s, racer._gear, v = 100.0, 3, 15.0
    full = float(pedals.most(v, 3))
    assert (full > 0.5 * believed().mu_r * believed().mu_x * believed().weight * 0.55) == (power > 2.0)
    plan = SimpleNamespace(command=np.array([0.0, 1e6]), stopping=False)
    for _ in range(300):
        missing = (share * full - racer._actuators.force) / believed().mass
        racer._act(plan, np.array([0, 0, 0, v, 0, 0, missing, 0.0]), (1.0, 0.05), False)
    assert racer.learned.most(100.0, full) == pytest.approx(learned * full, rel=0.02)


def test_far_from_the_limit_no_more_grip_is_believed_than_near_it():
    learned = Learned(500.0, 0.05)
    assert learned.here(1.1) == 1.0
    for _ in range(300):
        learned.see(203.0, 1.0, 0.5, (0.95, 0.004), 0.01)
    assert learned.here(1.0) == pytest.approx(0.95, abs=0.002)
    assert learned.here(0.8) == 0.8  # what the filter reads now, where that is less
    for _ in range(300):
        learned.see(203.0, 1.0, 0.5, (1.0, 0.02), 0.01)
    assert learned.here(1.0) < 0.96


def test_a_lap_is_slow_enough_for_the_gearbox():
    lap, car = first_lap(), believed()
    slowest = float(lap.v_x.min())
    box = Gearbox(up=(0.9 * lap.v_x.max(),), down=(0.97 * slowest,))
    two = {name: getattr(PEDALS, name)[:2] for name in ("full", "closed", "brake")}
    racer = sa.Racer(car, circuit(), replace(PEDALS, gearbox=box, **two), lap=lap, margin=MARGIN, share=0.9)
    assert racer.lap.v_x.min() == slowest  # the first lap was given
    racer.learned.grip = 1.04
    racer.learn()
    assert racer.lap.car.mu_f > lap.car.mu_f
    assert racer.lap.v_x.min() < 0.97 * slowest


@pytest.mark.parametrize(
    ("between", "corners", "laps"), [(True, True, True), ("sectors", True, False), (False, False, False)]
)
def test_at_the_start_line_changes_what_was_said(between, corners, laps):
    racer = sa.Racer(believed(), circuit(), PEDALS, lap=first_lap(), margin=MARGIN, share=0.9, between=between)
    racer._count_laps(1.0)
    racer.learned.grip, racer.sectors.times[:], racer.sectors.room[:] = 1.04, 5.0, 1.0
    sectors = racer.sectors
    racer._count_laps(racer.track.length + 1.0)
    assert (racer.lap is not first_lap()) == laps
    assert bool((sectors.faster > 0).all()) == corners


def test_where_no_plan_is_found_it_follows_the_last_one_and_then_stops():
    car = believed()
    planner = Planner(car, circuit(), PEDALS, dt=0.05, horizon=40)
    planner.follow(first_lap(), 0.5 * car.width + 0.15)
    x, plan = planner.at(np.array([100.0]))[0], None
    ages = []
    for _ in range(8):
        plan = planner.plan(x, 100.0, 1.0, lambda s, v: PEDALS.most(v), EXPLAINED, plan)
        ages.append((plan.age, plan.stopping))
        x = np.where(np.arange(len(x)) == 1, np.nan, x)
    assert ages == [(0, False), *((k, False) for k in range(1, 6)), (6, True), (7, True)]
    x[1] = 0.0
    assert planner.plan(x, 100.0, 1.0, lambda s, v: PEDALS.most(v), EXPLAINED, plan).age == 0


def test_a_plan_from_beyond_the_edge_leads_back_between_them():
    car, track, lap = believed(), circuit(), first_lap()
    planner = Planner(car, track, PEDALS, dt=0.05, horizon=40)
    planner.follow(lap, 0.5 * car.width + 0.15)
    x = planner.at(np.array([100.0]))[0]
    x[0] = 5.0 - 0.5 * car.width + 0.6  # m to the left of the lap's line: 0.6 m out
    plan = planner.plan(x, 100.0, 1.0, lambda s, v: PEDALS.most(v), EXPLAINED, None)
    assert plan.status.solved
    assert plan.x[-1, 0] < 5.0 - 0.5 * car.width - 0.1
    assert np.abs(plan.u[:, 0]).max() <= car.delta_rate + 1e-9


@pytest.mark.parametrize("s", [460.0, 480.0])
def test_a_plan_keeps_to_the_limits_of_the_tires_on_a_slippery_road(s):
    """Before and in a corner; over the whole plan, as single stages of two plans are not at one place."""
    car, lap = believed(), first_lap()
    planner = Planner(car, circuit(), PEDALS, dt=0.05, horizon=40)
    planner.follow(lap, 0.5 * car.width + 0.15)
    start = planner.at(np.array([s]))[0]
    plans = [planner.plan(start, s, grip, lambda s, v: PEDALS.most(v), EXPLAINED, None) for grip in (1.0, 0.6)]
    assert all(plan.status.solved for plan in plans)
    slip = planner.mpc.ocp.limited.index("slip_f")

    def largest(plan):
        """Front slip on the slippery road over that of the peak."""
        row = reference_row(planner, 0.6)
        stages = [planner.mpc.ocp.stage(x, u, row, x[:7])[1] for x, u in zip(plan.x[:-1], plan.u, strict=True)]
        return max(abs(float(limited[slip])) for limited in stages)

    assert largest(plans[1]) < min(0.95 * largest(plans[0]), 1.0)


def test_a_plan_of_a_car_that_is_slower_than_its_lap_keeps_its_line():
    """Where the speed can not be reached, none of it is bought with the way between the edges."""
    car, lap = believed(), first_lap()
    planner = Planner(car, circuit(), PEDALS, dt=0.05, horizon=40)
    planner.follow(lap, 0.5 * car.width + 0.15)
    x = planner.at(np.array([440.0]))[0]
    x[2:5] *= 0.8
    plan = planner.plan(x, 440.0, 1.0, lambda s, v: 0.2 * PEDALS.most(v), EXPLAINED, None)
    assert plan.status.solved
    lags = planner.at(440.0 + np.cumsum(0.05 * plan.x[:, 2]))
    assert (lags[:, 2] - plan.x[:, 2]).min() > 1.0
    assert np.abs(plan.x[:, 0] - lags[:, 0]).max() < 0.3


def test_what_is_unexplained_now_fades_from_a_plan():
    car, lap = believed(), first_lap()
    planner = Planner(car, circuit(), PEDALS, dt=0.05, horizon=40)
    planner.follow(lap, 0.5 * car.width + 0.15)
    x = planner.at(np.array([100.0]))[0]
    plans = [
        planner.plan(x, 100.0, 1.0, lambda s, v: PEDALS.most(v), {"d_v_x": 0.0, "d_r": d}, None) for d in (0.0, 0.5)
    ]
    turned = plans[1].x[:, 5] - plans[0].x[:, 5]  # against a yaw acceleration to the left
    assert turned[:10].min() < -0.003
    assert np.abs(turned[25:]).max() < 0.3 * -turned[:10].min()


def reference_row(planner, grip):
    """What a stage of the planner is given on a straight."""
    car, given = planner.car, dict.fromkeys(planner.mpc.ocp.exogenous, 0.0)
    given |= {"stage": 1.0, "mu_f": grip * car.mu_f, "mu_r": grip * car.mu_r}
    return [given[name] for name in planner.mpc.ocp.exogenous]


def glitch(kind, k, measured, rng):
    """What sensors read at a sample: one of all channels wrong every half second, for one or five samples, or 1 %."""
    i, now = k // 50 % len(SEEN), {"once": k % 50 < 1, "burst": k % 50 < 5, "random": False}[kind]
    wrong = [(kind == "random" and rng.uniform() < 0.01) or (now and name == SEEN[i]) for name in SEEN]
    sizes = dict(zip(SEEN, (30.0, 2.0, 0.3, 1e6, 2.0, 20.0, 30.0), strict=True))
    off = {
        name: rng.choice([-1, 1]) * rng.uniform(0.5, 1.5) * sizes[name] * bad
        for name, bad in zip(SEEN, wrong, strict=True)
    }
    return {name: value + off[name] for name, value in measured.items()}


@pytest.mark.parametrize("kind", [*(pytest.param(k, marks=pytest.mark.slow) for k in ("once", "random")), "burst"])
def test_glitches_of_sensors_do_not_move_it(kind):
    racer, rng = sa.Racer(believed(), circuit(), PEDALS, lap=first_lap(), margin=MARGIN), np.random.default_rng(7)
    step, count = racer.step, iter(range(100_000))
    racer.step = lambda measured, t: step(glitch(kind, next(count), measured, rng), t)
    run, times = raced(racer, 1.2)
    _, clean, clean_times = two_laps()
    assert run.inside
    assert times[0] == pytest.approx(clean_times[0], abs=0.03)
    assert np.abs(run.e_y - clean.e_y[: len(run.e_y)]).max() < 0.15
    assert racer.sensing.restarts == {"once": 1, "burst": 5, "random": 0}[kind]  # before it sets out
    assert all(count > 0 for count in racer.sensing.outliers.values())


@pytest.mark.parametrize("seconds", [1.5, pytest.param(9.0, marks=pytest.mark.slow)])
def test_without_a_pose_it_brakes_on_its_line_until_there_is_one(seconds):
    racer, rng = sa.Racer(believed(), circuit(), PEDALS, lap=first_lap(), margin=MARGIN), np.random.default_rng(3)
    plant, lap, places, speeds = sa.Plant(car_on(FRICTION)), racer.lap, [], []
    simulation = plant.start(plant.straight(lap.v_x[-2], X=lap.X[-2], Y=lap.Y[-2], psi=lap.psi[-2]), np.zeros(3))
    lost_at = found_at = None
    for k in range(1500):
        true = simulation.measure()
        told = {n: true[n] + NOISE[n] * rng.normal() for n in SEEN}
        if k > 20 and (lost_at is None or k < lost_at + 100 * seconds):
            told = {n: told[n] for n in ("v_x", "r", "a_x", "a_y")}
        said = racer.step(told, 0.01 * k)
        lost_at = k if lost_at is None and said.message == UNSURE[0] else lost_at
        found_at = k if lost_at and not found_at and said.wanted_v_x > 0.0 else found_at
        assert (said.wanted_v_x == 0.0) == (said.plan is None or said.message == UNSURE[0])
        places.append([true[n] for n in ("X", "Y")])
        speeds.append(true["v_x"])
        if found_at and k > found_at + 50:
            break
        simulation.advance(np.array([said.values[n] for n in plant.model.inputs]), 10)
    assert 150 < lost_at < 400  # a metre off for all that is known, but not at once
    assert found_at - lost_at - 100 * seconds < 30
    assert speeds[found_at] == pytest.approx(max(speeds[lost_at] - STOP * 9.81 * seconds, 0.0), abs=1.0)
    assert speeds[-1] > speeds[found_at] + 0.5
    assert circuit().inside(*np.array(places).T, racer.car.width).all()


def test_before_the_first_pose_it_waits():
    racer = sa.Racer(believed(), circuit(), PEDALS, lap=first_lap(), margin=MARGIN)
    said = racer.step({"v_x": 10.0}, 0.0)
    assert said.plan is None
    assert "not known" in said.message
    assert said["throttle"] == said["brake"] == 0.0


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"track": straight()}, "closed track"),
        ({"share": 0.0}, "share is 0"),
        ({"dt": 0.033}, "whole multiple"),
        ({"between": "laps"}, "between is 'laps'; expected True, False or \"sectors\""),
        ({"sample": 0.0}, "sample is 0.0 s"),
        ({"sample": float("nan")}, "sample is nan s"),
        ({"dt": -0.05}, "dt -0.05 s"),
        ({"steering_lag": -0.1}, "steering_lag is -0.1"),
        ({"steering_delay": 5.0}, "steering_delay is 5"),
        ({"track": ring()}, "the first lap is one of 'circuit', .* expected one of 'ring'"),
        ({"lap": 3}, "the first lap is 3; expected a Lap of 'circuit'"),
        ({"pedals": None}, "pedals is None; expected Pedals"),
        ({"margin": 5.0}, "expected a wider track"),
    ],
)
def test_a_race_that_cannot_be_driven_is_refused(changed, words):
    given = {"car": believed(), "track": circuit(), "pedals": PEDALS, "lap": first_lap(), **changed}
    with pytest.raises(ParameterError, match=words):
        sa.Racer(given.pop("car"), given.pop("track"), given.pop("pedals"), **given)
