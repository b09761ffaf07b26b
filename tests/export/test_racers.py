"""An exported racer takes in what the one in Python does and wants the same, lap by lap, whatever it is told."""

import ctypes
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.control.commands import UNSURE, Commands
from slipangle.control.racing.racer import _held
from slipangle.control.racing.sensing import NOISE
from slipangle.errors import ParameterError
from slipangle.export import DriverRecorder, build, load
from slipangle.export.drives import NO_DRIVE, channels
from slipangle.export.fmi import export_fmu
from slipangle.export.kinds import project_of
from slipangle.export.precision import as_precision
from slipangle.export.racers import standard_racer_drive
from slipangle.simulate.drive import drive
from tests.control.racing.test_racer import (
    FRICTION,
    MARGIN,
    PEDALS,
    SEEN,
    believed,
    car_on,
    circuit,
    first_lap,
)
from tests.export.loaded import array, defines
from tests.export.test_drivers import LoadedDriver, alike
from tests.export.tools import MACHINES, STRICT, needs, repeated_on, run

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
LATE = {"steering_delay": 0.08, "steering_lag": 0.06}


def racer(**how):
    return sa.Racer(believed(), circuit(), PEDALS, lap=first_lap(), margin=MARGIN, **{"between": "sectors", **how})


class LoadedRacer(LoadedDriver):
    """A racer exported under the name ``car``, and what it says that it learned."""

    def learned(self):
        n, kind = defines(self.header)["SECTORS"], self.kind
        fields = [("laps", ctypes.c_int64), ("grip", kind), ("grip_std", kind)]
        fields += [("faster", array(n, kind=kind)), ("narrower", array(n, kind=kind))]
        said = type("Learned", (ctypes.Structure,), {"_fields_": fields})()
        self.library.car_learned_by_now(self.at, ctypes.byref(said))
        return said


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A racer of few stages, and its C, both without what compilers fuse and reorder."""
    whole = racer(horizon=6)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SLIPANGLE_CFLAGS", "-O0 -march=native")
        yield whole, LoadedRacer(project_of(whole, "car", NO_DRIVE), tmp_path_factory.mktemp("racer"))


@pytest.fixture
def short(compiled):
    """The same before their first call."""
    whole, made = compiled
    whole.reset()
    made.start()
    return whole, made


def estimating(whole):
    """What `alike` asks of a driver."""
    return SimpleNamespace(controls=whole.controls, controller=whole.sensing.filter)


def spoiled(measured, rng):
    """What sensors show, a tenth of it missing, a twentieth with a value that is none, or wrong."""
    told = {n: measured[n] for n in SEEN if rng.uniform() > 0.1}
    if rng.uniform() < 0.05:
        told[str(rng.choice(SEEN))] = float(rng.choice([np.nan, np.inf, -np.inf, 1e300, 5.0, -1e8, 0.0]))
    return told


def garbage(k, rng):
    """No sensor, then poses that disagree, then a car beside the track, too far away for a plan."""
    if k < 30 or k % 50 == 49:
        return {n: float(rng.choice([np.nan, np.inf, 1e300, -1e300, 1e6 * rng.normal()])) for n in SEEN}
    if k < 60:
        return {"X": 50.0 * rng.normal(), "Y": 50.0 * rng.normal(), "psi": 3.0 * rng.normal(), "v_x": 20.0 * k}
    far = {
        "X": 300.0 + 0.2 * k,
        "Y": 1e-3 * rng.normal(),
        "psi": 1e-4 * rng.normal(),
        "v_x": 20.0 + 1e-3 * rng.normal(),
    }
    return far


class Beside:
    """Whether C wants what Python does, call by call."""

    def __init__(self, whole, made):
        self.whole, self.made, self.ages, self.rng = whole, made, set(), np.random.default_rng(3)

    def __getattr__(self, name):
        return getattr(self.whole, name)

    def step(self, told, t):
        said = self.whole.step(told, t)
        code, out, plan = self.made.step([told.get(n, math.nan) for n in channels(self.whole)], t)
        assert code == 0
        assert alike(out, plan, said, estimating(self.whole)), (t, said.message)
        self.ages.add(out.plan_age if out.planned else None)
        return said


def driven(beside, late, calls):
    """Drive from before the last corners on; places, shape (calls, 2)."""
    plant, rng = sa.Plant(car_on(FRICTION), noise=sa.Values(**{n: NOISE[n] for n in SEEN}), seed=1, **late), beside.rng
    lap, at = first_lap(), int(0.45 * len(first_lap().s))
    x0 = plant.straight(lap.v_x[at], X=lap.X[at], Y=lap.Y[at], psi=lap.psi[at])
    places, simulation = [], plant.start(x0, np.zeros(plant.model.n_inputs))
    for k in range(calls):
        places.append([simulation.true()[n] for n in ("X", "Y")])
        commands = beside.step(spoiled(simulation.measure(), rng), 0.01 * k)
        simulation.advance(np.array([commands.values[n] for n in plant.model.inputs]), 10)
    for k in range(220):
        beside.step(garbage(k, rng), 0.01 * (calls + k))
    return np.array(places)


@needs_compiler
def test_same_as_python_to_the_last_bit_whatever_it_is_told(short):
    """In closed loop, then with what no car shows, where no plan is found, and from the start."""
    whole, made = short
    beside = Beside(whole, made)
    driven(beside, {}, 120)
    assert whole.sensing.restarts > 0
    assert {None, 0, *range(1, 7)} <= beside.ages
    assert beside.made.step([math.nan] * 7, 1.0)[0] == 3
    assert beside.made.step([math.nan] * 7, math.nan)[0] == 3
    for wrong in (1.0, math.nan):
        with pytest.raises(ParameterError, match="expected finite times"):
            whole.step({}, wrong)
    whole.reset()
    beside.made.start()
    lap = first_lap()
    for k in range(12):
        told = {"X": lap.X[0], "Y": lap.Y[0] + 1e-3 * k, "psi": lap.psi[0] + 1e-4 * k, "v_x": 10.0 + 0.1 * k}
        beside.step(told, 0.01 * k)


@needs_compiler
def test_a_stiff_car_whose_wheels_spin_is_driven_alike(tmp_path, monkeypatch):
    """In as many steps as it needs, and with nothing learned of full throttle that gives a third of what it should."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0 -march=native")
    stiff, lap = replace(believed(), C_f=4.0 * believed().C_f, C_r=4.0 * believed().C_r), first_lap()
    fast = int(np.argmax(lap.F_x))
    v = 0.3 * float(lap.v_x[fast])
    strong = replace(PEDALS, full=0.55 * _held(stiff) / float(PEDALS.most(v)) * PEDALS.full)
    whole = sa.Racer(stiff, circuit(), strong, lap=lap, margin=MARGIN, between="sectors", horizon=4)
    assert whole._planner.mpc.model.substeps > 2
    beside, pressed = Beside(whole, LoadedRacer(project_of(whole, "car", NO_DRIVE), tmp_path)), []
    for k in range(250):  # at a third of the lap's speed, and slower
        s = float(lap.s[fast]) + 1e-4 * k
        X, Y, psi = (float(np.interp(s, lap.s, c)) for c in (lap.X, lap.Y, np.unwrap(lap.psi)))
        said = beside.step({"X": X, "Y": Y, "psi": psi, "v_x": v - 1e-2 * k, "r": 1e-4 * (k % 7)}, 0.01 * k)
        pressed.append(said["throttle"])
    assert np.convolve(np.array(pressed) > 0.99, np.ones(40)).max() == 40
    assert whole.learned.most(s, 1.0) == 1.0


@needs_compiler
def test_it_stops_alike_where_the_pose_is_lost(short):
    beside, lap = Beside(*short), first_lap()
    told = {"X": lap.X[0], "Y": lap.Y[0], "psi": lap.psi[0], "v_x": 8.0}
    said = []
    for k in range(400):
        moving = {n: v + 1e-4 * (k % 7) for n, v in told.items()} if k < 3 else {"r": 1e-4 * (k % 7)}
        if k >= 3 and k % 20 == 0:  # half a pose is none
            moving |= {"X": lap.X[0] + 8.0e-2 * k}
        if k > 380:
            moving |= told | {"X": lap.X[0] + 1e-3 * k}
        said.append(beside.step(moving, 0.01 * k))
    lost = [s.message == UNSURE[0] for s in said]
    assert not any(lost[:50])
    assert sum(lost) > 100
    assert any(s["brake"] > 0.1 for s in said)


@needs_compiler
def test_times_that_are_none_and_gaps_count_alike(short):
    """What C refuses Python does too, and both go on as if there had been no call; gaps and equal times are taken."""
    (whole, made), rng = short, np.random.default_rng(4)
    lap, t, refused = first_lap(), 1.79e9, 0
    for k in range(240):
        at = k // 3 % len(lap.s)
        told = [lap.X[at], lap.Y[at], lap.psi[at], lap.v_x[at], lap.r[at], 0.0, 0.0] + 1e-3 * rng.normal(size=7)
        now = t + 0.01 * k
        if k % 5 == 4:
            now = float(rng.choice([math.nan, math.inf, -math.inf, 2e10, now - 0.5, now, now + 0.3]))
        code, out, plan = made.step(told.tolist(), now)
        try:
            said = whole.step(dict(zip(SEEN, told.tolist(), strict=True)), now)
        except ParameterError:
            assert code == 3
            refused += 1
        else:
            assert code == 0
            assert alike(out, plan, said, estimating(whole)), (k, now, said.message)
            t = max(t, now - 0.01 * k)
    assert 20 < refused < 45


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("how", [{}, LATE], ids=["as it is", "with a steering that is late"])
def test_same_as_python_over_the_start_line(how, tmp_path, monkeypatch):
    """Where how corners are taken changes."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1 -march=native")
    whole = racer(horizon=20, **how)
    beside = Beside(whole, LoadedRacer(project_of(whole, "car", NO_DRIVE), tmp_path))
    places = driven(beside, {"lag": sa.Values(delta=0.06), "delay": sa.Values(delta=0.08)} if how else {}, 2100)
    assert circuit().inside(*places.T, whole.car.width).all()
    said = beside.made.learned()
    assert said.laps == 1
    assert (said.grip, said.grip_std) == (whole.learned.grip, whole.learned.grip_std)
    assert np.array_equal(said.faster, whole.sectors.faster)
    assert np.array_equal(said.narrower, whole.sectors.narrower)
    assert np.abs(said.faster).max() > 0


@needs_compiler
def test_commands_are_in_their_ranges_whatever_it_is_told(short):
    (_, made), rng = short, np.random.default_rng(0)
    lap, most = first_lap(), believed().delta_max
    for k in range(500):
        at = k // 4 % len(lap.s)
        told = [lap.X[at], lap.Y[at], lap.psi[at], lap.v_x[at], lap.r[at], 0.0, 0.0] + 0.01 * rng.normal(size=7)
        wild = rng.uniform(size=7) < rng.choice([0.0, 0.1, 1.0])
        told[wild] = rng.choice([np.nan, np.inf, -np.inf, 1e300, -1e300, 1e9, 0.0, 100.0], wild.sum())
        _, out, _ = made.step(told.tolist(), 0.01 * k)
        delta, throttle, brake = out.value
        assert -most <= delta <= most
        assert 0.0 <= throttle <= 1.0
        assert 0.0 <= brake <= 1.0


@needs_compiler
@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
@pytest.mark.parametrize(
    "how",
    [pytest.param({}, id="as it is", marks=pytest.mark.slow), pytest.param(LATE, id="with a steering that is late")],
)
def test_compilers_have_nothing_to_say(how, compiler_, tmp_path):
    needs(compiler_)
    made = project_of(racer(horizon=6, **how), "pilot", NO_DRIVE).everything
    for name, content in made.items():
        (tmp_path / name).write_text(content)
    for name in ("pilot.c", "pilot_planner.c", "main.c"):
        run(compiler_, *STRICT, "-O1", "-fsyntax-only", name, folder=tmp_path)
    if compiler_ == "gcc":
        needs("g++")
        (tmp_path / "use.cpp").write_text(
            '#include "pilot.hpp"\nint main() { pilot::Driver d; return d.step({}).planned; }'
        )
        run("g++", "-std=c++17", *STRICT[1:], "-fsyntax-only", "use.cpp", folder=tmp_path)


def lap_of(one, width):
    """A little more than a lap from its start."""
    plant = sa.Plant(car_on(FRICTION), noise=sa.Values(**{n: NOISE[n] for n in SEEN}), seed=1)
    X, Y, psi, v = (getattr(first_lap(), n)[-2] for n in ("X", "Y", "psi", "v_x"))
    x0 = plant.straight(v, X=X, Y=Y, psi=psi)
    return drive(plant, one, duration=1.1 * first_lap().time, channels=SEEN, x0=x0, width=width)


@needs_compiler
@pytest.mark.slow
def test_a_racer_built_ahead_of_time_drives_a_lap(tmp_path):
    """The same drive as that of Python, to the last bit, with C alone at the wheel."""
    whole = racer()
    build(whole, tmp_path / "built", drive=20)
    made = load(tmp_path / "built")
    runs = [lap_of(one, whole.car.width) for one in (whole, made)]
    assert runs[1].inside
    assert runs[1].fallbacks == 0
    assert runs[1].s[-1] > circuit().length
    assert np.array_equal(runs[0].states, runs[1].states)


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_two_thousand_calls_on_every_machine(name, tmp_path):
    """The same commands to 1e-10 from every compiler and processor."""
    needs()
    said, wanted = repeated_on(name, project_of(racer(), "car", 2000), tmp_path)
    assert len(said) == 2000
    assert (np.abs(said - wanted) / (1 + np.abs(wanted))).max() <= 1e-10


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_repeats_a_drive(version, tmp_path):
    validation = pytest.importorskip("fmpy.validation")
    from tests.export.test_fmi import Slave

    whole = racer(horizon=6)
    file = export_fmu(whole, tmp_path / "pilot.fmu", version=version)
    assert validation.validate_fmu(str(file)) == []
    slave, recorded = Slave(file, tmp_path / "pilot"), standard_racer_drive(whole, 60)
    for row, wanted in zip(recorded.asked, recorded.commands, strict=True):
        slave.set(**{f"measured.{n}": v for n, v in zip(channels(whole), row[1:], strict=True)})
        slave.step()
        assert slave.get(*whole.controls) == pytest.approx(wanted, rel=1e-9, abs=1e-9)
    slave.end()


@needs_compiler
def test_a_drive_is_recorded_and_what_has_no_c_is_said(tmp_path, monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0 -march=native")
    whole = racer(horizon=6)
    recorder = DriverRecorder(whole)
    recorder.step({"X": 0.0}, 0.0)
    path = whole.export(tmp_path / "out", drive=recorder.drive)
    assert (path / "racer.c").exists()
    assert (path / "drive.csv").read_text().splitlines()[0] == "t,X,Y,psi,v_x,r,a_x,a_y,command 0,command 1,command 2"
    with pytest.raises(ParameterError, match="plans a new lap where grip differs, which has no C"):
        project_of(racer(between=True), "", 2)

    class Own(sa.Racer):
        def step(self, measurements, t):
            return super().step(measurements, t)

    own = Own(believed(), circuit(), PEDALS, lap=first_lap(), between=False)
    with pytest.raises(ParameterError, match="a Own has no C; expected a plain Racer"):
        project_of(own, "", 2)


class InSingle:
    """A racer in single precision, as `drive` takes one."""

    def __init__(self, whole, made):
        self.path, self.controls, self.made = whole.path, whole.controls, made

    def reset(self):
        self.made.start()

    def step(self, told, t):
        _, out, _ = self.made.step([told.get(n, math.nan) for n in SEEN], t)
        said = {"values": dict(zip(self.controls, out.value, strict=True)), "wanted_v_x": out.wanted_v_x}
        return Commands(**said, message="", state=np.array(out.state), state_std=np.array(out.state_std))


@needs_compiler
@pytest.mark.slow
def test_in_single_precision_it_drives_as_fast(tmp_path, monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O2 -march=native")
    whole, times = racer(), []
    single = as_precision(project_of(whole, "car", NO_DRIVE), "single")
    for one in (whole, InSingle(whole, LoadedRacer(single, tmp_path, ctypes.c_float))):
        run_ = lap_of(one, whole.car.width)
        assert run_.inside
        times.append(np.interp(circuit().length, run_.s, run_.t))
    assert abs(times[1] - times[0]) < 0.02
