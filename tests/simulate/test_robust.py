"""Cars that differ from the model: the nominal one is the identified bicycle, equal draws give equal drives."""

import re
from dataclasses import replace

import numpy as np
import pytest

from slipangle.codegen.compiler import compiler
from slipangle.control.driver import Driver
from slipangle.control.mpc import MPC
from slipangle.errors import ParameterError, SampleTimeError
from slipangle.models.vehicles.aided import RearSteered, TorqueVectored
from slipangle.models.vehicles.banked import Banked
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams
from slipangle.models.vehicles.saturating_bicycle import RelaxingBicycle, SaturatingBicycleParams
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Limits, Values, Weights
from slipangle.paths.lane_change import double_lane_change
from slipangle.paths.path import Path
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.perturbed import Fleet, Spread
from slipangle.simulate.plant import Plant
from slipangle.simulate.robust import Trial, cause, try_on
from slipangle.simulate.trials import Trials
from slipangle.workflow.drive import unmoved
from slipangle.workflow.robustness import sentence

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler")
CAR = BicycleParams(mass=1500, inertia_z=2500, wheelbase=2.7, l_f=1.2, C_f=9e4, C_r=1.1e5)
NAMES = Spread().names


def fleet(friction=1.0, **changes):
    values = np.zeros((1, len(NAMES)))
    for name, value in changes.items():
        values[0, NAMES.index(name)] = value
    return Fleet(bicycle=CAR, friction=friction, changes=values)


def settled(cars, delta, v_x=20.0, seconds=3.0):
    """State after a steady turn, by name."""
    x = cars.straight(v_x, 0.0, 0.0, 0.0)
    for _ in range(round(seconds / 0.1)):
        x = cars.advance(x, np.full((100, 1), delta), np.array([v_x]))[-1]
    return dict(zip(cars.states, x[0].tolist(), strict=True))


@pytest.mark.parametrize(("stiffness_f", "stiffness_r", "mass"), [(0, 0, 0), (0.2, 0, 0), (0, -0.2, 0), (0, 0, 0.15)])
def test_a_steady_turn_is_that_of_the_changed_bicycle(stiffness_f, stiffness_r, mass):
    end = settled(fleet(stiffness_f=stiffness_f, stiffness_r=stiffness_r, mass=mass), 0.005)
    C_f, C_r, m, L = CAR.C_f * (1 + stiffness_f), CAR.C_r * (1 + stiffness_r), CAR.mass * (1 + mass), CAR.wheelbase
    understeer = m / L * ((L - CAR.l_f) / C_f - CAR.l_f / C_r)
    assert end["r"] == pytest.approx(end["v_x"] * 0.005 / (L + understeer * end["v_x"] ** 2), rel=0.01)


def test_a_steady_turn_of_a_car_with_downforce_is_that_of_the_loads_there():
    known = {n: getattr(CAR, n) for n in ("mass", "inertia_z", "wheelbase", "l_f", "C_f", "C_r")}
    winged = SaturatingBicycleParams(**known, downforce_f=1.0, downforce_r=4.0)
    end = settled(Fleet(bicycle=winged, friction=1.0, changes=np.zeros((1, len(NAMES)))), 0.005, v_x=30.0)
    L, weight, v = CAR.wheelbase, CAR.mass * GRAVITY, end["v_x"]
    C_f = CAR.C_f * (1 + 1.0 * v**2 / (weight * (L - CAR.l_f) / L))
    C_r = CAR.C_r * (1 + 4.0 * v**2 / (weight * CAR.l_f / L))
    understeer = CAR.mass / L * ((L - CAR.l_f) / C_f - CAR.l_f / C_r)
    assert end["r"] == pytest.approx(v * 0.005 / (L + understeer * v**2), rel=0.01)


@pytest.mark.parametrize(("scale", "v_x"), [(1.0, 15.0), (0.1, 4.0)])
def test_a_car_a_tenth_as_long_answers_its_steering_as_quickly_for_its_size(scale, v_x):
    """Tires relax within a share of the wheelbase; with those of a full car a small one swung and left every lane."""
    small = BicycleParams(
        **dict(mass=1500 * scale**3, inertia_z=2500 * scale**5, wheelbase=2.7 * scale, l_f=1.2 * scale),
        **dict(C_f=9e4 * scale**3, C_r=1.1e5 * scale**3),
    )
    cars = Fleet(bicycle=small, friction=1.0, changes=np.zeros((1, len(NAMES))))
    x = cars.straight(v_x, 0.0, 0.0, 0.0)
    r = cars.advance(x, np.full((2000, 1), 0.005), np.array([v_x]))[:, 0, cars.states.index("r")]
    late = 0.001 * float(np.argmax(r > 0.63 * r[-1]))
    assert late < 0.16 * np.sqrt(scale)
    assert r.max() < 1.3 * r[-1]


def test_friction_that_is_too_low_for_the_axles_is_named_with_the_least():
    with pytest.raises(ParameterError, match=r"raise the friction from 0.1 to 0\.\d+, or check") as refused:
        fleet(friction=0.1)
    lowest = float(re.search(r"to (0\.\d+),", str(refused.value))[1])
    fleet(friction=lowest)
    with pytest.raises(ParameterError):
        fleet(friction=lowest - 0.02)


@pytest.mark.parametrize("friction", [0.7, 1.0, 1.3])
def test_the_largest_lateral_acceleration_is_the_friction(friction):
    cars = fleet(friction=friction)
    x, most = cars.straight(25.0, 0.0, 0.0, 0.0), 0.0
    v_x, v_y, r = (cars.states.index(n) for n in ("v_x", "v_y", "r"))
    for k in range(40):
        states = cars.advance(x, np.full((50, 1), 0.004 * k), np.array([25.0]))[:, 0]
        a_y = np.diff(states[:, v_y]) / 0.001 + states[1:, v_x] * states[1:, r]
        x, most = states[-1:], max(most, float(a_y.max()))
    assert most / GRAVITY == pytest.approx(friction, rel=0.06)  # one axle saturates before the other


def test_crosswind_pushes_with_its_force():
    cars = fleet(crosswind=0.5)
    x = cars.straight(20.0, 0.0, 0.0, 0.0)
    after = cars.advance(x, np.zeros((20, 1)), np.array([20.0]))[-1][0]
    assert after[cars.states.index("v_y")] == pytest.approx(0.5 * 0.02, rel=0.15)


def trial(v_x=15.0, around=lambda car: car, **options):
    mpc = MPC(
        OnGround(around(Bicycle(params=CAR, dt=0.05, outputs=("v_y", "r")))),
        horizon=15,
        controls=("delta",),
        Q=Weights(X=0.1, Y=1.0, psi=1.0),
        S=Weights(delta=50.0),
        limits=Limits(delta=0.35),
    )
    return Trial(controller=mpc, path=double_lane_change(v_x), bicycle=CAR, **options)


@pytest.fixture(scope="module")
def many():
    wanted = trial(noise=Values(r=0.002, X=0.02, Y=0.02), spread=Spread(friction=0.6, lag=0.15))
    return wanted, try_on(wanted, range(24))


def test_the_nominal_car_drives_as_the_closed_loop_has_it():
    """The same controller on the bicycle itself, in the ordinary loop: tires and wheels differ by a little."""
    wanted = trial(v_x=14.0)
    ours = try_on(wanted, [0], changes=np.zeros((1, 8)))
    plant = Plant(OnGround(Bicycle(params=CAR, dt=0.001, outputs=("v_y", "r"))))
    run = closed_loop(plant, wanted.controller, wanted.path)
    assert ours.column("finished")[0] == run.inside == 1
    assert ours.column("e_y")[0] == pytest.approx(run.max("y"), abs=0.03)


def test_a_car_is_the_same_wherever_it_is_driven(many):
    wanted, all_cars = many
    apart = np.vstack([try_on(wanted, [k]).results for k in (3, 11, 20)])
    assert np.array_equal(apart, all_cars.results[[3, 11, 20]])
    assert np.array_equal(wanted.spread.draw([11]), all_cars.changes[[11]])
    assert not np.array_equal(wanted.spread.draw([11], seed=1), all_cars.changes[[11]])


def test_what_is_drawn_is_within_the_spread():
    spread = Spread(friction=0.3, delay=0.02)
    drawn = spread.draw(range(3000))
    for j, name in enumerate(spread.names):
        low = 0.0 if name in ("delay", "lag") else -getattr(spread, name)
        assert drawn[:, j].min() == pytest.approx(low, abs=0.02 * getattr(spread, name))
        assert drawn[:, j].max() == pytest.approx(getattr(spread, name), rel=0.02)
    assert np.abs(np.corrcoef(drawn.T) - np.eye(8)).max() < 0.08


def test_what_breaks_it_is_named(many):
    wanted, trials = many
    assert trials.worst == int(np.argmin(trials.column("margin")))
    name, gain = cause(wanted, trials, range(24), trials.worst)
    again = trials.changes[[trials.worst]].copy()
    again[0, NAMES.index(name)] = 0.0
    better = try_on(wanted, [trials.worst], changes=again)
    assert min(better.column("margin")[0], 20.0) - max(trials.column("margin").min(), -20.0) == pytest.approx(gain)
    assert set(trials.influence) == set(NAMES)


def test_influence_finds_the_change_that_did_it():
    changes = Spread().draw(range(500))
    margin = 0.3 - np.abs(changes[:, NAMES.index("crosswind")])
    results = np.column_stack([margin >= 0, margin, -margin, np.ones(500), np.zeros(500)])
    trials = Trials(names=NAMES, changes=changes, results=results)
    assert next(iter(trials.influence)) == "crosswind"
    assert trials.influence["crosswind"] > 0.99
    assert trials.share == pytest.approx(0.3 / 0.7, abs=0.06)
    assert not trials.good


def test_late_steering_is_late():
    wanted = trial(delay=0.3)
    assert try_on(wanted, [0], changes=np.zeros((1, 8))).column("margin")[0] < 0
    assert try_on(trial(), [0], changes=np.zeros((1, 8))).column("margin")[0] > 0


def test_a_car_that_crawls_has_the_time_to_arrive():
    """At 0.2 m/s 3 m take 15 s; the car is a tenth as long, so that they are eleven of its wheelbases."""
    small = BicycleParams(mass=1.5, inertia_z=0.025, wheelbase=0.27, l_f=0.12, C_f=90.0, C_r=110.0)
    mpc = MPC(
        OnGround(Bicycle(params=small, dt=0.05, outputs=("v_y", "r"))),
        horizon=10,
        controls=("delta",),
        Q=Weights(Y=1.0, psi=0.1),
        S=Weights(delta=0.1),
        limits=Limits(delta=0.35),
    )
    x = np.linspace(0.0, 3.0, 61)
    crawl = Trial(controller=mpc, path=Path.from_points(x, 0.0 * x).with_speed(0.2), bicycle=small, width=0.2)
    assert crawl.steps * mpc.dt > 15.0
    assert try_on(crawl, [0], changes=np.zeros((1, len(NAMES)))).column("finished")[0] == 1


def aided(car):
    return Banked(TorqueVectored(RearSteered(car)))


def test_what_the_cars_have_not_stays_zero_and_is_said():
    """A controller that knows of rear wheels, a moment and the bank drives them as one that does not."""
    changes = np.zeros((2, len(NAMES)))
    changes[1, NAMES.index("stiffness_f")] = -0.15
    plain, knowing = (try_on(trial(noise=NOISE, around=w), [0, 1], changes=changes) for w in (lambda car: car, aided))
    assert knowing.column("finished").all()
    assert knowing.column("e_y") == pytest.approx(plain.column("e_y"), abs=0.05)  # of other draws of the noise
    assert knowing.without == ("delta_r", "M_z", "bank")
    assert sentence(knowing).endswith(" They have no delta_r and no M_z and no bank: these stayed zero.")
    assert plain.lacking == ""
    exact = [try_on(trial(around=w), [0], changes=changes[:1]) for w in (lambda car: car, aided)]
    assert exact[0].results == pytest.approx(exact[1].results, abs=1e-6)


def test_a_controller_that_knows_load_transfer_is_tried_too():
    """Its v_x_dot is that of the path ahead, and zero until now: it drives as in the ordinary loop."""
    known = {n: getattr(CAR, n) for n in ("mass", "inertia_z", "wheelbase", "l_f", "C_f", "C_r")}
    limit = NonlinearBicycle(params=NonlinearBicycleParams(**known), dt=0.05, substeps=3, outputs=("v_y", "r"))
    wanted = trial(v_x=14.0, around=lambda car: limit)
    ours = try_on(wanted, [0], changes=np.zeros((1, len(NAMES))))
    plant = Plant(OnGround(Bicycle(params=limit.params.bicycle, dt=0.001, outputs=("v_y", "r"))))
    run = closed_loop(plant, wanted.controller, wanted.path, held=unmoved(plant, wanted.controller))
    assert ours.column("finished")[0] == run.inside == 1
    assert ours.column("e_y")[0] == pytest.approx(run.max("y"), abs=0.03)
    assert ours.without == ()


@pytest.mark.slow
def test_a_driver_of_such_a_car_is_tried_too():
    path = double_lane_change(15.0)
    told = {n: NOISE[n] for n in ("r", "X", "Y", "psi")}
    driver = Driver(aided(Bicycle(params=CAR, dt=0.02, outputs=("r",))), path, noise=told)
    found = try_on(Trial(controller=driver, path=path, bicycle=CAR), [0], changes=np.zeros((1, len(NAMES))))
    assert found.column("inside").all()
    assert found.without == ("delta_r", "M_z", "bank")


def test_bad_trials():
    with pytest.raises(ParameterError, match="noise"):
        trial(noise=Values(a_x=0.1))
    mpc = trial().controller
    with pytest.raises(ParameterError, match="no speed profile"):
        Trial(controller=mpc, path=replace(double_lane_change(15.0), v_x=None), bicycle=CAR)
    car = OnGround(Bicycle(params=CAR, dt=0.004, outputs=("v_y", "r")))
    short = MPC(car, horizon=5, controls=("delta",), Q=Weights(Y=1.0), S=Weights(delta=1.0))
    with pytest.raises(SampleTimeError, match="a multiple of"):
        Trial(controller=short, path=double_lane_change(15.0), bicycle=CAR)


NOISE = Values(X=0.02, Y=0.02, psi=1e-3, v_x=0.02, v_y=0.02, r=2e-3, a_y=0.1)


def driven(v_x=20.0, *, relaxing=True, outputs=("v_y", "r")):
    """A driver that knows the car, relaxation of its tires (34 ms) among it or not; its sensors are noisy."""
    known = {n: getattr(CAR, n) for n in ("mass", "inertia_z", "wheelbase", "l_f", "C_f", "C_r")}
    late = 0.19 * CAR.wheelbase
    params = SaturatingBicycleParams(**known, relaxation_f=late, relaxation_r=late)
    model = RelaxingBicycle(params=params, dt=0.02, outputs=outputs)
    if not relaxing:
        model = Bicycle(params=CAR, dt=0.02, outputs=outputs)
    path = double_lane_change(v_x)
    told = {n: v for n, v in NOISE.items() if n in (*outputs, "X", "Y", "psi")}
    return Trial(controller=Driver(model, path, noise=told), path=path, bicycle=CAR, noise=NOISE)


def test_a_driver_sees_measurements_alone_and_each_car_is_driven_by_its_own():
    trial = driven()
    both, alone = try_on(trial, [3, 8]), try_on(trial, [8])
    assert np.array_equal(both.results[1], alone.results[0])
    nominal = try_on(trial, [0], changes=np.zeros((1, len(NAMES))))
    assert nominal.column("inside").all()
    assert nominal.column("e_y")[0] < 0.04


def test_a_driver_of_a_car_with_an_accelerometer_is_tried_too():
    """An accelerometer in place of v_y is what most cars have; it must tell the filter what the car does."""
    wanted = driven(outputs=("r", "a_y"))
    nominal = try_on(wanted, [0], changes=np.zeros((1, len(NAMES))))
    assert nominal.column("inside").all()
    assert nominal.column("e_y")[0] < 0.04
    deaf = replace(wanted, noise=Values(**dict(NOISE) | {"a_y": 1e3}))  # were it not read, noise would not matter
    assert try_on(deaf, [0], changes=np.zeros((1, len(NAMES)))).column("e_y")[0] != nominal.column("e_y")[0]


@pytest.mark.slow
@pytest.mark.parametrize(("v_x", "relaxing"), [(15.0, True), (20.0, True), (22.0, True), (15.0, False), (20.0, False)])
def test_a_driver_bears_cars_that_differ(v_x, relaxing):
    """At 54, 72 and 79 km/h; were the model trusted whatever it foretells, the last two would lose half of them."""
    assert try_on(driven(v_x, relaxing=relaxing), range(32)).share >= (0.96 if relaxing else 0.9)


def test_a_built_driver_is_asked_for_where_one_is_named():
    trial = driven()
    with pytest.raises(ParameterError, match="a Driver is not compiled"):
        try_on(replace(trial, built=trial.controller), [0])
    with pytest.raises(ParameterError, match="expected the driver of `controller`"):
        replace(trial, controller=trial.planner, built=trial.controller)
