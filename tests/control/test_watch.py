"""What a driver is told that cannot be, and where it should stop and say so, on a point that turns as a car."""

import math
from typing import Any

import numpy as np
import pytest

from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.driver import Driver
from slipangle.control.speed.driver import SpeedDriver
from slipangle.control.watch import CONTRADICTED, Watch
from slipangle.estimate.ekf import EKF
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Values
from slipangle.paths.path import Path

needs_compiler = pytest.mark.skipif(compiler() is None, reason=sentence())
MASS, WHEELBASE = SOUSA_TABLE_7_2.mass, SOUSA_TABLE_7_2.wheelbase
KNOWN = Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("r",))
NOISE = {"r": 0.002, "X": 0.02, "Y": 0.02, "psi": 0.001}
PEDALS = SpeedDriver(
    kp=4000.0, ki=200.0, limits=(-12e3, 5e3), feedforward=MASS, drive=Values(F=1.0), brake=Values(F=1.0)
)
LINE = Path.from_points(np.linspace(0.0, 1500.0, 300), np.zeros(300)).with_speed(15.0)
ANGLE = np.linspace(0, 2 * np.pi, 181)
RING = Path.from_points(60 * np.cos(ANGLE), 60 * np.sin(ANGLE), closed=True).with_speed(12.0)


class Drive:
    """A point of the car's mass whose front wheel rolls where it points; ``told`` changes what the driver is told."""

    def __init__(self, path, seconds, told=lambda t, seen: seen, v=12.0, start=None, driver=None):
        X, Y, psi = path.start if start is None else start
        self.whole = driver or Driver(KNOWN, path, speed=PEDALS, noise=NOISE)
        self.commands, rng, rows = [], np.random.default_rng(0), []
        for k in range(round(seconds / 0.02)):
            t = 0.02 * k
            noise = 0.01 * rng.standard_normal(5)
            delta = self.commands[-1]["delta"] if k else 0.0
            r = v * math.tan(delta) / WHEELBASE
            seen = {"r": r + 0.1 * noise[0], "v_x": v + noise[1], "X": X + noise[2], "Y": Y + noise[3]}
            self.commands.append(said := self.whole.step(told(t, {**seen, "psi": psi + 0.1 * noise[4]}), t))
            rows.append((X, Y, v))
            psi += 0.02 * v * math.tan(said["delta"]) / WHEELBASE
            X, Y = X + 0.02 * v * math.cos(psi), Y + 0.02 * v * math.sin(psi)
            v = max(v + 0.02 * said["F"] / MASS, 0.0)
        self.X, self.Y, self.v = np.array(rows).T
        self.wanted = np.array([c.wanted_v_x for c in self.commands])

    @property
    def last(self) -> Any:
        return self.commands[-1]


def without(*names, after=3.0):
    return lambda t, seen: {n: v for n, v in seen.items() if n not in names or t < after}


@needs_compiler
@pytest.mark.parametrize("way", ["half", pytest.param("whole", marks=pytest.mark.slow)])
def test_headings_of_instruments_are_turns_of_one_heading(way):
    """From -180 to 180 degrees or 0 to 360; over a lap the drive is that of a heading that goes on."""

    def wrapped(t, seen):
        psi = seen["psi"]
        return seen | {"psi": math.remainder(psi, 2 * math.pi) if way == "half" else psi % (2 * math.pi)}

    plain, turned = Drive(RING, 40.0), Drive(RING, 40.0, wrapped)
    np.testing.assert_allclose(np.hypot(turned.X, turned.Y), np.hypot(plain.X, plain.Y), atol=1e-6)
    assert np.abs(np.hypot(turned.X, turned.Y)[500:] - 60).max() < 0.3
    assert (turned.wanted[5:] == 12.0).all()


def test_a_filter_takes_a_heading_from_the_nearest_turn():
    """Of a car that turns ten times, in a record that wraps; a start elsewhere is left as it is."""
    model = OnGround(KNOWN)
    ekf = EKF(start=model, noise_std=NOISE, process_std={"r": 0.5, "v_y": 0.5})
    tracker, psi, rng = (
        ekf.begin({"X": 0.0, "Y": 0.0, "psi": 0.0, "r": 0.5, "v_x": 10.0}),
        0.0,
        np.random.default_rng(0),
    )
    X, Y = 0.0, 0.0
    for _ in range(6000):
        psi, X, Y = psi + 0.01, X + 0.2 * math.cos(psi), Y + 0.2 * math.sin(psi)
        said = math.remainder(psi + 0.001 * rng.standard_normal(), 2 * math.pi)
        tracker.take({"X": X, "Y": Y, "psi": said, "r": 0.5 + 1e-6 * rng.standard_normal(), "v_x": 10.0, "delta": 0.13})
    assert tracker.state[model.states.index("psi")] == pytest.approx(60.0, abs=0.02)
    other = ekf.start_at()
    other.update([0.0, 0.0, 0.0, 5.0], [0.0, 10.0])
    assert other.state[model.states.index("psi")] > 2


@needs_compiler
def test_a_speed_that_is_lost_or_stuck_ends_in_a_stop():
    lost = Drive(LINE, 12.0, without("v_x"))
    assert lost.wanted[149] == 15.0
    assert (lost.wanted[202:] == 0).all()
    assert lost.v.max() < 16
    assert lost.v[-1] == 0.0
    assert "speed was not measured" in lost.commands[205].message
    stuck = Drive(LINE, 20.0, lambda t, seen: seen if t < 0.5 else seen | {"v_x": 9.0}, v=9.0)
    assert any("contradict" in c.message for c in stuck.commands)
    assert stuck.v.max() < 20
    assert stuck.v[-1] < 1
    assert stuck.wanted[-1] == 0
    flipped = Drive(LINE, 15.0, lambda t, seen: seen | {"v_x": -seen["v_x"]}, v=15.0)
    assert flipped.v.max() < 23
    assert flipped.v[-1] < 0.5


@needs_compiler
def test_sound_speeds_are_not_doubted():
    """Wheels that slip a tenth, a brisk start, a ring, poses once a second, a jump of the position."""
    for told, path in (
        (lambda t, seen: seen | {"v_x": 1.1 * seen["v_x"]}, LINE),
        (lambda t, seen: seen, RING),
        (lambda t, seen: seen if round(50 * t) % 50 == 0 else {n: seen[n] for n in ("v_x", "r")}, RING),
        (lambda t, seen: seen | {"X": seen["X"] + 8.0 * (t > 5)}, LINE),
    ):
        assert (Drive(path, 15.0, told, v=4.0).wanted[60:] > 0).all()


@pytest.mark.parametrize(
    ("every", "true", "told", "doubted"),
    [(2.0, 12.0, 12.0, False), (1.0, 12.0, 12.0, False), (2.0, 20.0, 12.0, True), (1.0, 12.0, 22.0, True)],
)
@pytest.mark.parametrize("radius", [12.0, 60.0, 1e6])
def test_a_way_that_bends_back_is_no_contradiction(every, true, told, doubted, radius):
    """Positions every second or two of a car that turns by up to 1 rad/s, whose chords are shorter than its way."""
    watch = Watch(RING, 1.0, 1.0)
    for k in range(1000):
        t = 0.02 * k
        place = (radius * math.cos(true * t / radius), radius * math.sin(true * t / radius))
        for name in ("v_x", "X", "Y", "psi"):
            watch.note(name, t)
        posed = place if k % round(50 * every) == 0 else None
        watch.move(t, told + 1e-6 * k, 0.02, posed)
        if posed:
            watch.see(t)
    hidden = radius == 12.0 and every == 2.0  # a turn of 190 degrees between two positions
    assert (watch.reason(t, 0.0, (0.0, 0.0, 0.0)) == CONTRADICTED) == (doubted and not hidden)


@needs_compiler
def test_a_car_that_creeps_for_long_is_not_lost():
    """Below the speed of lateral models nothing is filtered; the pose is known all the same."""
    slow = Path.from_points(np.linspace(0.0, 300.0, 60), np.zeros(60)).with_speed(1.0)
    crept = Drive(slow, 90.0, v=1.0)
    assert crept.X[-1] > 80
    assert {c.message for c in crept.commands[5:]} == {"the car stands or creeps, the wheels stay where they are"}


@needs_compiler
def test_a_pose_that_is_lost_ends_in_a_stop_before_the_car_is_elsewhere():
    """With errors that no filter knows: a yaw rate off by 0.003 rad/s, a speed by 1 %."""
    off = without("X", "Y", "psi")
    lost = Drive(RING, 40.0, lambda t, seen: off(t, seen) | {"r": seen["r"] + 0.003, "v_x": 1.01 * seen["v_x"]})
    stopped = int(np.argmax(lost.wanted[150:] == 0)) + 150
    assert 4.0 < 0.02 * stopped < 8.0
    assert abs(math.hypot(lost.X[stopped], lost.Y[stopped]) - 60) < 1.0
    assert "position is not known any more" in lost.commands[stopped].message
    assert lost.v[-1] == 0
    assert (lost.wanted[stopped + 10 :] == 0).all()  # standing, too: it does not begin where it was long ago


@needs_compiler
def test_the_end_of_a_path_and_ways_off_it_are_said():
    short = Path.from_points(np.linspace(0.0, 100.0, 60), np.zeros(60)).with_speed(12.0)
    ended = Drive(short, 20.0)
    assert "has ended" in ended.last.message
    assert ended.X[-1] < 120
    assert ended.v[-1] == 0
    away = Drive(LINE, 8.0, start=(50.0, 0.0, math.pi))  # it slows down, turns round and drives on
    assert "faces away" in away.commands[10].message
    assert (away.wanted[:40] == 0).all()
    assert away.wanted[-1] == 15.0
    assert away.X[-1] > away.X[-50] + 5
    beside = Drive(LINE, 4.0, start=(20.0, 60.0, 0.0))
    assert beside.commands[20].message == "the car is far beside the path"
    assert (beside.wanted[5:] == 15.0).all()


@needs_compiler
def test_a_yaw_rate_of_the_wrong_sign_ends_in_a_stop():
    """Or a heading in degrees; told once, a car that stands shows nothing else."""
    for wrong in (lambda t, seen: seen | {"r": -seen["r"]}, lambda t, seen: seen | {"psi": math.degrees(seen["psi"])}):
        told = Drive(RING, 15.0, wrong)
        assert any(c.message.startswith("yaw rate and headings contradict") for c in told.commands)
        assert told.v[-1] == 0
        assert (told.wanted[-200:] == 0).all()


@pytest.mark.parametrize(("gain", "bias", "noise"), [(0.8, 0.0, 0.01), (1.2, 0.0, 0.05), (1.0, 0.05, 0.03)])
def test_sound_yaw_rates_are_not_doubted(gain, bias, noise):
    """Gains off by a fifth, biases, headings of a compass, that wrap, at 10 Hz, and turns of several rad/s."""
    watch, rng, psi = Watch(RING, 1.0, 1.0), np.random.default_rng(4), 0.0
    for k in range(10000):
        t = 0.02 * k
        r = (0.5 + (k > 5000)) * math.sin(0.7 * t) + 4.0 * (7000 < k < 7400)
        psi += 0.02 * r
        for name in ("v_x", "X", "Y", "psi"):
            watch.note(name, t)
        heading = math.remainder(psi + noise * rng.standard_normal(), 2 * math.pi) if k % 5 == 0 else None
        watch.turn(t, gain * r + bias, 0.02, heading)
        watch.see(t)
        assert watch.reason(t, 0.0, (0.0, 0.0, 0.0)) == 0


@needs_compiler
def test_a_car_that_gets_ever_farther_from_its_path_stops():
    """Y to the right, as of some instruments: what it does to come back leads it away."""
    mirrored = Drive(LINE, 20.0, lambda t, seen: seen | {"Y": -seen["Y"]}, start=(0.0, 1.0, 0.0))
    assert np.abs(mirrored.Y).max() < 60
    assert mirrored.v[-1] == 0
    assert any("ever farther" in c.message for c in mirrored.commands)
