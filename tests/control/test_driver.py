"""`Driver`: from measurements to commands, whatever is missing, late, wrong or pushed."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.default_drive import (
    SLOWER,
    WANDER,
    default_controller,
    default_estimator,
    driven_model,
    less_trusting,
)
from slipangle.control.driver import Driver
from slipangle.control.mpc import MPC
from slipangle.control.speed.driver import SpeedDriver
from slipangle.errors import ParameterError
from slipangle.models.vehicles.aided import RearSteered
from slipangle.models.vehicles.banked import Banked
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from slipangle.models.wrappers.disturbed import Disturbed
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Values
from slipangle.paths.lane_change import double_lane_change
from slipangle.paths.path import Path
from slipangle.simulate.drive import drive
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import End
from slipangle.simulate.sensors import Sensor, Sensors

pytestmark = pytest.mark.skipif(compiler() is None, reason=sentence())
KNOWN = Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("r",))
LATE = Delayed(Steered(KNOWN, steering_lag=0.05), delays={"delta": 0.02}, longest=0.04)
NOISE = {"r": 0.002, "X": 0.02, "Y": 0.02, "psi": 0.001}
STEERING = {"delay": Values(delta=0.02), "lag": Values(delta=0.05)}
RAW = ("r", "v_x", "X", "Y", "psi")
NOISY = Sensors(
    r=Sensor(noise=0.002), v_x=Sensor(noise=0.02), X=Sensor(noise=0.02), Y=Sensor(noise=0.02), psi=Sensor(noise=1e-3)
)
LINE = Path.from_points(np.linspace(0.0, 400.0, 200), np.zeros(200), name="straight").with_speed(25.0)


def driver(path=LINE, model=LATE, **more):
    return Driver(model, path, noise=NOISE, **more)


@cache
def car(*, softer=1.0, offset=0.0, d_v_y=0.0, bank=0.0):
    """A plant at 1 ms; the push of a wind on the mass is that of `Disturbed`, which is tested by itself."""
    p = SOUSA_TABLE_7_2.with_values(
        C_f=softer * SOUSA_TABLE_7_2.C_f, C_r=softer * SOUSA_TABLE_7_2.C_r, steering_offset=offset
    )
    plain = Bicycle(params=p, dt=0.001, outputs=("v_y", "r"))
    return OnGround(Disturbed(Banked(plain))) if bank or d_v_y else OnGround(plain)


# 2 kN of wind on 2000 kg; 6 % of bank; tires softer by 20 %; 1 degree of steering offset
PUSHED = {
    "wind": {"d_v_y": 1.0},
    "bank": {"bank": 0.06},
    "soft tires": {"softer": 0.8},
    "steering offset": {"offset": float(np.deg2rad(1.0))},
}


@pytest.mark.parametrize("what", [pytest.param(n, marks=[pytest.mark.slow] * (n != "wind")) for n in PUSHED])
@pytest.mark.parametrize(
    "bend", [pytest.param(0.0, marks=pytest.mark.slow, id="straight"), pytest.param(1 / 250, id="bend")]
)
def test_no_steady_error_whatever_pushes_the_car(what, bend):
    """On a straight and on a bend of 250 m at 25 m/s, after 8 s: at most 1 cm."""
    model = car(**PUSHED[what])
    angle = bend * np.linspace(0.0, 300.0, 151)
    line = np.sin(angle) / bend if bend else np.linspace(0.0, 300.0, 151)
    path = Path.from_points(line, (1 - np.cos(angle)) / bend if bend else 0.0 * angle).with_speed(25.0)
    plant = Plant(model, **STEERING)
    x0 = plant.straight(25.0)
    if "d_v_y" in model.states:
        x0[model.states.index("d_v_y")] = PUSHED[what].get("d_v_y", 0.0)
    held = Values(bank=PUSHED[what].get("bank", 0.0)) if "bank" in model.inputs else None
    run = drive(plant, driver(path), channels=RAW, x0=x0, duration=10.0, held=held)
    steady = run.e_y[run.t > 8.0]
    assert np.abs(steady).max() < 0.01
    assert np.abs(run.e_y).max() < 0.5


def late_plant(seed, **more):
    pose = {n: Sensor(interval=0.1, delay=0.1, noise=NOISE[n], **more) for n in ("X", "Y", "psi")}
    rest = {"r": Sensor(noise=0.002, interval=0.01, **more), "v_x": Sensor(noise=0.02, interval=0.01, **more)}
    model = car()
    return Plant(model, sensors=Sensors(**pose, **rest), seed=seed, **STEERING)


@pytest.mark.slow
def test_a_late_pose_and_lost_samples():
    path, late = double_lane_change(24.0), dict.fromkeys(("X", "Y", "psi"), 0.1)
    run = drive(late_plant(1), driver(path, late=late), channels=RAW)
    assert run.end is End.FINISHED
    assert run.rmse("y") < 0.04
    lossy = drive(late_plant(2, drop_out=0.2, drop_length=4.0, lost="nan"), driver(path, late=late), channels=RAW)
    assert lossy.end is End.FINISHED
    assert np.isfinite(lossy.inputs).all()
    assert np.abs(lossy.inputs[:, lossy.input_names.index("delta")]).max() <= 0.5
    assert lossy.rmse("y") < 0.1


def test_a_pose_between_two_samples_of_the_estimator_is_moved_there():
    """At 25 m/s a pose taken for 9 ms later would be 22 cm off."""
    whole = driver(late={"X": 0.051})
    for k in range(400):
        t = 0.003 * k
        true = {"X": 25.0 * t, "Y": 0.0, "psi": 0.0, "v_x": 25.0, "r": 1e-9 * k}
        if k % 7 == 0:
            true["X"] = 25.0 * (t - 0.051)
        else:
            del true["X"]
        if k == 0:
            true["X"] = 0.0
        commands = whole.step(true, t)
    at = whole._model.states.index("X")
    assert commands.state[at] == pytest.approx(25.0 * (whole._t0 + whole._tick * whole.dt), abs=0.01)


def test_commands_say_how_the_drive_is():
    whole = driver()
    first = whole.step({"r": 0.0}, 0.0)
    assert (first.status, first.fallback, first["delta"], first.wanted_v_x) == (Status.NOT_FINITE, True, 0.0, 0.0)
    assert "speed is not known" in first.message
    known = {"X": 0.0, "Y": 0.2, "psi": 0.0, "v_x": 25.0, "r": 0.0}
    assert "pose is not known" in whole.step({"v_x": 25.0}, 0.02).message
    good = whole.step(known, 0.04)
    assert good.status.solved
    assert not good.fallback
    assert good.wanted_v_x == 25.0
    assert good["delta"] < 0.0  # back to the right
    assert good.e_y == pytest.approx(0.2, abs=0.02)
    assert whole.step({}, 0.05) is good
    blind = whole.step({}, 0.5)
    assert blind.age["Y"] == pytest.approx(0.46)
    assert blind.status.solved
    for k in range(1500):
        t = 0.52 + 0.02 * k
        blind = whole.step({"v_x": 25.0 + 1e-6 * k}, t)
        if blind.wanted_v_x == 0.0:
            break
    assert blind.wanted_v_x == 0.0
    assert "should stop" in blind.message
    for k in range(10):  # too quick for a car at first
        slow = whole.step({"v_x": 0.5 + 1e-6 * k}, t + 0.5 + 0.02 * k)
    assert slow.plan is None  # it creeps
    assert (slow.wanted_v_x, "position is not known" in slow.message) == (0.0, True)
    again = whole.step({"v_x": 0.4, "X": 9.0, "Y": 0.2, "psi": 0.0}, t + 1.0)
    assert again["delta"] == slow["delta"]
    assert "creeps" in again.message
    assert again.wanted_v_x == 25.0
    for wrong in (0.9, np.nan, np.inf, -2e10, 2e10):
        with pytest.raises(ParameterError, match=r"expected finite times, at most 1e\+10 s, that do not go back"):
            whole.step({}, wrong)
    whole.reset()
    assert whole.step(known, 0.0)["delta"] == driver().step(known, 0.0)["delta"]


def test_wild_measurements_never_make_a_wild_command():
    rng = np.random.default_rng(5)
    whole, last = driver(double_lane_change(24.0)), 0.0
    wild = (np.nan, np.inf, -np.inf, 1e300, -1e12, 0.0, 1e-300, 5.0)
    for k in range(300):
        t = 0.02 * k
        seen = {"X": -30.0 + 24.0 * t, "Y": 0.0, "psi": 0.0, "v_x": 24.0, "r": 0.0}
        seen = {n: v + 0.001 * rng.standard_normal() for n, v in seen.items() if rng.uniform() > 0.3}
        if rng.uniform() < 0.3:
            seen[str(rng.choice(RAW))] = float(rng.choice(wild))
        commands = whole.step(seen, t)
        assert np.isfinite(commands["delta"])
        assert abs(commands["delta"]) <= 0.5
        assert abs(commands["delta"] - last) <= 1.05 * 0.02 / np.sqrt(3.0 / 2.7) + 1e-9
        last = commands["delta"]


def test_defaults_scale_with_the_car_and_its_steering():
    """The same car a tenth as long, and one steered by a hand wheel, are driven alike in their own units."""
    model = driven_model(LATE, 0.02)
    assert model.dt == 0.02
    assert [n for n in model.states if n.startswith("d_")] == ["d_v_y", "d_r"]
    assert driven_model(OnGround(LATE), 0.02).states == model.states
    turned = Delayed(
        Steered(
            Bicycle(params=SOUSA_TABLE_7_2.with_values(steering_gain=0.1), dt=0.02, outputs=("r",)), steering_lag=0.05
        ),
        delays={"delta": 0.02},
        longest=0.04,
    )
    a, b = default_controller(model), default_controller(driven_model(turned, 0.02))
    assert b.ocp.limits["delta"][1] == pytest.approx(10 * a.ocp.limits["delta"][1])
    assert b.ocp.S["delta"] == pytest.approx(0.01 * a.ocp.S["delta"])
    assert a.times[-1] == pytest.approx(1.0)
    assert [n for n in model.states if "lag" in n] == ["delta_lagged", "lag_delta"]
    assert default_estimator(model, NOISE, {}).process_std["d_v_y"] == WANDER["d_v_y"] * SLOWER["d_v_y"]
    told = driven_model(LATE, 0.02, lagging=False)
    assert not [n for n in told.states if "lag" in n]
    assert default_estimator(told, NOISE, {}).process_std["d_v_y"] == WANDER["d_v_y"]


def test_a_model_is_trusted_as_far_as_it_foretells():
    """Weights by hand; a controller that is given keeps its own."""
    controller = default_controller(driven_model(LATE, 0.02))
    ocp = controller.ocp
    reference = controller.reference(LINE.ahead(0.0, controller.times), v_x=25.0)
    for surprise, doubt in ((0.2, 1.0), (1.5, 1.0), (3.75, 2.5), (40.0, 10.0)):
        q, _, s = ocp.weights_for(less_trusting(controller, reference, surprise))
        usual_q, _, usual_s = ocp.stage_weights
        course = ocp.tracked.index("e_course")
        others = [i for i in range(len(ocp.tracked)) if i != course]
        assert q[:, course] == pytest.approx(doubt * usual_q[:, course])
        assert np.array_equal(q[:, others], usual_q[:, others])
        assert s == pytest.approx(doubt**3 * usual_s)
    told = {"X": 0.0, "Y": 0.3, "psi": 0.0, "v_x": 25.0, "r": 0.0}
    own, given = Driver(LATE, LINE, noise=NOISE), Driver(LATE, LINE, controller=controller, noise=NOISE)
    first = own.step(told, 0.0)["delta"]
    assert abs(first) < 0.9 * abs(given.step(told, 0.0)["delta"])  # not known yet
    speed = SpeedDriver(kp=(800.0,), ki=(200.0,), limits=(-3000.0, 1500.0), drive=Values(T_f=1.0))
    other = own.with_parts(speed=speed, estimator=default_estimator(own.estimator.model, NOISE, {}))
    assert other.step(told, 0.0)["delta"] == first
    assert other.with_parts().step(told, 0.0)["delta"] == first
    assert other.controls == ("delta", "T_f")
    given.reset()
    assert given.with_parts(speed=speed).step(told, 0.0)["delta"] == given.step(told, 0.0)["delta"]


@pytest.mark.parametrize(("late", "trusted"), [(0.0, True), (0.25, False)])
def test_surprise_tells_a_car_that_is_the_model_from_one_that_is_not(late, trusted):
    """Steering that answers a quarter of a second late, in a lane change; one is what a right model comes to."""
    path, heard = double_lane_change(15.0), []
    whole = driver(path)
    plant = Plant(car(), delay=Values(delta=0.02 + late), lag=Values(delta=0.05), sensors=NOISY)
    drive(plant, whole, channels=RAW, watch=lambda t, said: heard.append(whole._surprise))
    assert heard[0] > 4.3
    assert (max(heard[300:]) < 2.0) is trusted


def test_what_does_not_fit_is_said():
    with pytest.raises(ParameterError, match="no speed profile"):
        driver(Path.from_points(np.linspace(0, 50, 30), np.zeros(30)))
    other = default_controller(driven_model(LATE, 0.04))
    with pytest.raises(ParameterError, match="expected the same model in both"):
        Driver(LATE, LINE, controller=other, estimator=default_estimator(driven_model(LATE, 0.02), NOISE, {}))
    whole = default_controller(driven_model(LATE, 0.02))
    told = replace(
        whole.ocp, terms={"far": lambda x, u, p: p.k * x[1]}, parameters=("k",), limits={"delta": 0.5, "far": 9.0}
    )
    with pytest.raises(ParameterError, match=r"the controller is told \['k'\] over its horizon, which no driver knows"):
        Driver(LATE, LINE, controller=replace(whole, ocp=told), noise=NOISE)
    aided = RearSteered(KNOWN)
    both = MPC(driven_model(aided, 0.02), horizon=3, controls=("delta", "delta_r"), Q=whole.ocp.Q)
    with pytest.raises(ParameterError, match=r"decides \['delta', 'delta_r'\]; expected the steering alone"):
        Driver(aided, LINE, controller=both, noise=NOISE)
    with pytest.raises(ParameterError, match="nobody sets the plant's input 'bank'"):
        drive(Plant(car(bank=0.06)), driver())
