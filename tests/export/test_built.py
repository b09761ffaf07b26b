"""A controller built ahead of time plans as the one it was built from, without a compiler, or says why not."""

import hashlib
import json
import os
import pickle
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.errors import ConfigError, FormatError, HashError, MissingFileError, ParameterError
from slipangle.export import build, load
from slipangle.models.vehicles.catalogue import PASSENGER_TIRE, SOUSA_CAR_7, SOUSA_TABLE_7_2
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.optimal.realtime import backend
from slipangle.optimal.terms import Values
from slipangle.paths.lane_change import double_lane_change
from slipangle.simulate.compiled import compiled_loop
from slipangle.simulate.drive import drive
from slipangle.simulate.robust import Trial, try_on
from slipangle.simulate.run import End
from slipangle.simulate.sensors import Sensor, Sensors
from slipangle.workflow import robustness
from tests.control.marx.test_mpc import BY_POSE
from tests.export.test_drivers import LAGGED, LATE, PEDALS, driver
from tests.export.test_mpc import KINDS, controller

pytestmark = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SLIPANGLE_CFLAGS", "-O1")
        settings = dict(KINDS["corridor and soft limits"])
        mpc = controller(settings.pop("horizon"), **settings)
        mpc.prepare()
        return mpc, build(mpc, tmp_path_factory.mktemp("built") / "made", name="racer", drive=60)


@pytest.fixture
def copy(built, tmp_path):
    return shutil.copytree(built[1], tmp_path / "copy")


def test_plans_as_the_one_it_was_built_from(built):
    mpc, folder = built
    loaded, path = load(folder), sa.double_lane_change(20.0)
    mine = other = None
    x, s = mpc.model.straight(20.0), 0.0
    for _ in range(40):
        preview = path.ahead(s, mpc.times)
        assert np.array_equal(loaded.reference(preview).tracked, mpc.reference(preview).tracked)
        mine, other = mpc.plan(x, mpc.reference(preview), mine), loaded.plan(x, preview, other)
        assert np.array_equal(mine.u, other.u)
        assert np.array_equal(mine.x, other.x)
        assert (mine.status, mine.health, mine.iterations) == (other.status, other.health, other.iterations)
        x = np.asarray(mpc.model.step(x, np.array([mine.command[0], 20.0])))
        s += 1.0
    assert loaded.model == mpc.model
    again = pickle.loads(pickle.dumps(loaded)).plan(x, preview)
    assert np.array_equal(again.u, loaded.plan(x, preview).u)
    with pytest.raises(ParameterError, match="not the last plan of this built controller"):
        loaded.plan(x, preview, other)


def test_drives_in_closed_loop(built):
    mpc, folder = built
    plant = sa.Plant(mpc.model)
    path = sa.double_lane_change(20.0)
    runs = [sa.closed_loop(plant, c, path, duration=3.0, sample=0.05) for c in (mpc, load(folder))]
    assert np.array_equal(runs[0].commands, runs[1].commands)


def test_needs_no_compiler(built):
    code = (
        "import sys, slipangle.export as e, numpy as np; c = e.load(sys.argv[1]);"
        "r = e.Recorder(c); from slipangle.paths.lane_change import double_lane_change as d;"
        "print(c.plan(np.zeros(5), c.reference(d(20.0).ahead(0.0, c.times))).status.name)"
    )
    environment = {**os.environ, "SLIPANGLE_CC": "none"}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code, str(built[1])],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    assert done.returncode == 0, done.stderr[-500:]
    assert done.stdout.strip() in ("SOLVED", "REAL_TIME")


def test_a_start_is_found_or_refused(built, tmp_path, monkeypatch):
    mpc, folder = built
    assert np.array_equal(load(folder).start({"Y": 2.0}), [2.0 * (n == "Y") for n in mpc.model.states])
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1")
    lagged = load(build(BY_POSE, tmp_path / "made", drive=60))
    with pytest.raises(ParameterError, match="does not know the state to start from"):
        lagged.start({"Y": 2.0})


@pytest.fixture(scope="module")
def pilot(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SLIPANGLE_CFLAGS", "-O1 -march=native")
        whole = driver(double_lane_change(20.0), LAGGED, horizon=6, late=LATE, speed=PEDALS)
        return whole, build(whole, tmp_path_factory.mktemp("built") / "made", name="pilot", drive=60)


def test_a_driver_drives_as_the_one_it_was_built_from(pilot):
    """On a plant that is not its model, to the last bit; its messages and plans are the same too."""
    whole, folder = pilot
    built = load(folder)
    assert (built.controls, built.dt) == (whole.controls, whole.dt)
    for key in ("X", "Y", "psi", "curvature", "v_x", "right", "left"):
        assert np.array_equal(getattr(built.path, key), getattr(whole.path, key))
    assert (built.path.name, built.path.closed) == (whole.path.name, whole.path.closed)
    plant = sa.Plant(sa.OnGround(sa.Bicycle(params=SOUSA_TABLE_7_2, dt=0.01, outputs=("r",))))
    heard, runs = [], []
    for one in (whole, built, pickle.loads(pickle.dumps(built))):
        heard.append([])
        runs.append(drive(plant, one, duration=3.0, watch=lambda _, c: heard[-1].append((c.message, c.age, c.s))))
    for one, said in zip(runs[1:], heard[1:], strict=True):
        assert np.array_equal(runs[0].states, one.states)
        assert np.array_equal(runs[0].commands, one.commands)
        assert runs[0].controls == one.controls
        assert [p.status for p in runs[0].plans] == [p.status for p in one.plans]
        assert heard[0] == said
    assert np.abs(runs[0].states[:, plant.model.states.index("Y")]).max() > 1.0


CAR = DualTrack(params=SOUSA_CAR_7, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001)
WHITE = Values(r=0.002, X=0.01, Y=0.01, psi=0.001, v_x=0.02)
LAGS = {"delay": Values(delta=0.023), "lag": Values(delta=0.05, throttle=0.1)}
SENSORS = Sensors(
    X=Sensor(interval=0.1, delay=0.05, noise=0.02, drop_out=0.1, lost="nan"),
    Y=Sensor(interval=0.1, delay=0.047, drift=0.01, bias=0.01, gain=0.01),
    psi=Sensor(interval=0.007, noise=0.001, quantum=0.0005, delay=0.013),
    v_x=Sensor(noise=0.02, drop_out=0.05, drop_length=3.0, range=(0.0, 20.5)),
    delta=Sensor(interval=0.01),
)


@pytest.mark.parametrize(
    ("settings", "called"),
    [
        ({}, {}),
        ({"noise": WHITE, "seed": 3, **LAGS}, {"sample": 0.02, "width": 2.0}),
        ({"sensors": SENSORS, "noise": Values(r=0.002), "seed": 4, **LAGS}, {"channels": ("X", "Y", "psi", "v_x")}),
        ({"sensors": SENSORS, "seed": 5}, {"duration": 2.5, "sample": 0.005}),
    ],
)
def test_a_loop_without_python_has_the_same_numbers(pilot, settings, called):
    """Sensors, delay, lag, ends and plans, to the last bit; a drive that is watched is one in Python."""
    built, plant = load(pilot[1]), sa.Plant(CAR, **settings)
    fixed = {"held": Values(throttle=0.05, brake=0.0), **called}
    asked = called.get("channels")
    assert compiled_loop(plant, built, asked) is not None
    ours, watched = drive(plant, built, **fixed), drive(plant, built, watch=lambda *_: None, **fixed)
    assert ours.end is watched.end
    for name in ("t", "s", "e_y", "e_psi", "v_x", "states", "inputs", "reference", "t_plan"):
        assert np.array_equal(getattr(ours, name), getattr(watched, name)), name
    assert len(ours.plans) == len(watched.plans)
    for a, b in zip(ours.plans, watched.plans, strict=True):
        assert np.array_equal(a.u, b.u)
        assert (a.status, a.health, a.age, a.memory) == (b.status, b.health, b.age, None)
    assert 0 < ours.plans[-1].seconds < 1
    assert np.abs(ours["Y"]).max() > 0.1
    again = drive(plant, built, **fixed)
    assert np.array_equal(again.states, ours.states)


def test_a_loop_without_python_ends_as_the_one_in_python(pilot):
    """Far from the path at once, off it with a late steering, and out of time."""
    built, plant = load(pilot[1]), sa.Plant(CAR, delay=Values(delta=0.5))
    held = Values(throttle=0.05, brake=0.0)
    far, near = plant.straight(20.0, Y=30.0), plant.straight(20.0, Y=-19.0)
    for x0, end in ((far, End.LEFT_PATH), (near, End.LEFT_PATH), (None, End.TIME)):
        pair = [drive(plant, built, held=held, x0=x0, watch=w) for w in (None, lambda *_: None)]
        assert pair[0].end is pair[1].end is end
        assert all(np.array_equal(getattr(pair[0], n), getattr(pair[1], n)) for n in ("states", "inputs", "t_plan"))


def test_what_a_loop_without_python_cannot_do_is_done_in_python(pilot):
    whole, built = pilot[0], load(pilot[1])
    assert compiled_loop(sa.Plant(CAR), whole, None) is None
    slow = sa.Plant(sa.OnGround(sa.Bicycle(params=SOUSA_TABLE_7_2, dt=0.01, outputs=("r",))))
    assert compiled_loop(slow, built, None) is None
    sensed = sa.Plant(replace(CAR, outputs=("a_y",)), sensors=Sensors(a_y=Sensor(interval=0.01)))
    assert compiled_loop(sensed, built, None) is None


def test_many_cars_driven_by_a_built_driver_end_as_by_the_one_in_python(pilot):
    """Each car has a memory of its own; a job's trial compiles its driver itself where the cars are many."""
    whole, folder = pilot
    trial = Trial(controller=whole, path=whole.path, bicycle=SOUSA_TABLE_7_2, noise=WHITE)
    python, ours = try_on(trial, range(4)), try_on(replace(trial, built=load(folder)), range(4))
    assert np.array_equal(ours.results, python.results)
    assert np.array_equal(try_on(replace(trial, built=load(folder)), [3]).results[0], python.results[3])
    assert len(ours.seconds) == len(python.seconds)
    assert 0 < np.median(ours.seconds) < 1


def test_a_trial_compiles_its_driver_where_the_plans_are_many(pilot, monkeypatch):
    whole, folder = pilot
    trial, made = Trial(controller=whole, path=whole.path, bicycle=SOUSA_TABLE_7_2), []
    monkeypatch.setattr(robustness, "build", lambda driver, _: made.append(driver) or folder)
    enough = -(-robustness.WORTH // trial.steps)
    with robustness.compiled(trial, enough - 1) as few:
        assert few.built is None
    with robustness.compiled(trial, enough) as many:
        assert many.built is not None
        assert np.array_equal(try_on(many, [1]).results, try_on(few, [1]).results)
    assert made == [whole]

    def refused(*_):
        raise ParameterError("no C")

    monkeypatch.setattr(robustness, "build", refused)
    with robustness.compiled(trial, enough) as python:
        assert python.built is None


def test_a_built_driver_answers_as_the_one_in_python_where_it_cannot_plan(pilot):
    whole, folder = pilot
    built = load(folder)
    for one in (whole, built):
        one.reset()
    told = [({"r": 0.0}, 0.0), ({"v_x": 0.5}, 0.1), ({"v_x": 20.0}, 0.3), ({"X": 0.0, "Y": 0.1, "psi": 0.0}, 0.35)]
    told += [({"unknown": 1.0, "v_x": 20.1}, 0.41), ({}, 0.411), ({"v_x": np.nan}, 3.0)]
    for measured, t in told:
        a, b = whole.step(measured, t), built.step(measured, t)
        assert (a.message, a.values, a.wanted_v_x, a.s, a.e_y) == (b.message, b.values, b.wanted_v_x, b.s, b.e_y)
        assert (a.age, a.restarts, a.fallback, a.status) == (b.age, b.restarts, b.fallback, b.status)
        assert np.array_equal(a.state, b.state)
        assert np.array_equal(a.state_std, b.state_std)
        if a.plan is not None:
            assert np.array_equal(a.plan.u, b.plan.u)
            assert (a.plan.health, a.plan.controls) == (b.plan.health, b.plan.controls)
    assert built.step({}, 3.001) is built.step({}, 3.002)
    for t in (1.0, np.nan, np.inf):
        with pytest.raises(ParameterError, match="expected finite times that do not go back"):
            built.step({}, t)


def test_a_path_that_was_changed_is_not_driven(pilot, tmp_path):
    folder = shutil.copytree(pilot[1], tmp_path / "copy")
    text = (folder / "path.csv").read_text()
    (folder / "path.csv").write_text(text.replace("20.0", "30.0"))
    with pytest.raises(HashError, match=r"'path\.csv' in .* is not the file that was built"):
        load(folder)


def test_marx(tmp_path, monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1")
    folder = build(BY_POSE, tmp_path / "made", drive=60)
    assert load(folder).controls == BY_POSE.controls


def changed(folder, change):
    file = folder / "manifest.json"
    record = json.loads(file.read_text())
    change(record)
    file.write_text(json.dumps(record))


def test_what_was_changed_is_not_run(copy):
    library = copy / json.loads((copy / "manifest.json").read_text())["build"]["library"]
    raw = library.read_bytes()
    library.write_bytes(raw[:-1] + bytes([raw[-1] ^ 1]))
    with pytest.raises(HashError, match="is not the file that was built"):
        load(copy)
    library.unlink()
    with pytest.raises(MissingFileError, match="cannot be read"):
        load(copy)


def test_a_drive_that_it_does_not_repeat(copy):
    """As where a processor computes otherwise: the checksum is right, the commands are not."""
    lines = (copy / "drive.csv").read_text().splitlines()
    row = lines[12].split(",")
    row[-1] = repr(float(row[-1]) + 1e-6)
    lines[12] = ",".join(row)
    (copy / "drive.csv").write_text("\n".join(lines) + "\n")
    sum_ = hashlib.sha256((copy / "drive.csv").read_bytes()).hexdigest()
    changed(copy, lambda record: record["sha256"].update({"drive.csv": sum_}))
    with pytest.raises(ConfigError, match="decides otherwise than when it was built"):
        load(copy)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [("system", "Plan 9", "system Plan 9"), ("bits", 32, "bits 32"), ("processor", "x", "another processor")],
)
def test_another_machine(key, value, said, copy):
    changed(copy, lambda record: record["build"].update({key: value}))
    with pytest.raises(ConfigError, match=f"was built for {said}"):
        load(copy)


def test_no_manifest(copy, tmp_path):
    with pytest.raises(MissingFileError, match="expected a folder that 'slipangle build' wrote"):
        load(tmp_path / "nowhere")
    changed(copy, lambda record: record.pop("build"))
    with pytest.raises(FormatError, match="was exported, not built"):
        load(copy)
    for text in ("", "[]", "{"):
        (copy / "manifest.json").write_text(text)
        with pytest.raises(FormatError):
            load(copy)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ConfigError("it ran out of memory")])
def test_a_build_that_is_stopped_leaves_the_one_before(error, copy, monkeypatch):
    def stopped(sources, target, **options):
        target.write_bytes(b"half")
        raise error

    before = {p.name: p.read_bytes() for p in copy.iterdir()}
    monkeypatch.setattr(compiler, "compile_file", stopped)
    with pytest.raises(type(error)):
        build(controller(3), copy, name="racer", drive=2, force=True)
    assert {p.name: p.read_bytes() for p in copy.iterdir()} == before
    load(copy)


def test_no_compiler_says_so(tmp_path, monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    backend._say_once.cache_clear()
    with (
        pytest.warns(sa.errors.ModelWarning),
        pytest.raises(ConfigError, match="no C compiler was found; expected one"),
    ):
        build(controller(3), tmp_path / "made", drive=2)
