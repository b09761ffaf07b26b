"""A loop as WebAssembly decides as the one in Python does, whatever its settings."""

import json
import os
import subprocess

import numpy as np
import pytest

import slipangle as sa
from slipangle.control.driver import Driver
from slipangle.control.mpc import MPC
from slipangle.control.speed.driver import SpeedDriver
from slipangle.errors import ParameterError
from slipangle.export.live import MOST_BYTES, Live
from slipangle.export.live_driver import LiveDriver
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Limits, Values, Weights
from slipangle.paths.lane_change import double_lane_change
from slipangle.simulate.drive import drive
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant
from tests.export.tools import needs
from tests.export.tools import run as call

DRIVE = """
import { readFile } from 'node:fs/promises'
const made = await WebAssembly.compile(await readFile('live.wasm'))
if (WebAssembly.Module.imports(made).length) throw new Error('it asks for something')
const e = (await WebAssembly.instantiate(made, {})).exports
e._initialize()
const answers = []
for (const settings of JSON.parse(await readFile('settings.json', 'utf8'))) {
  new Float64Array(e.memory.buffer, e.live_settings(), settings.length).set(settings)
  e.live_begin()
  let end = 0
  while (!end) { e.live_plan(); end = e.live_go() }
  const commands = Array.from(new Float64Array(e.memory.buffer, e.live_commands(), e.live_plans()))
  const rows = Array.from(new Float64Array(e.memory.buffer, e.live_rows(), e.live_count() * ROW))
  answers.push({ commands, rows, end })
}
console.log(JSON.stringify(answers))
"""
CASES = (
    {},
    {"pace": 1.1, "delay": 0.03},
    {"friction": 0.6, "mass": 1.2, "pace": 0.8},
    {"weight_Y": 10.0, "weight_delta": 0.1, "weight_psi": 3.0},
)


def loop(horizon=20, **more):
    car = sa.SingleTrack(params=SOUSA_TABLE_6_1, dt=0.001, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2)
    p = SOUSA_TABLE_6_1
    known = {n: getattr(p, n) for n in ("mass", "inertia_z", "wheelbase", "l_f")}
    model = sa.Bicycle(params=sa.BicycleParams(**known, C_f=1.2e5, C_r=1.2e5), dt=0.05, outputs=("v_y", "r"))
    mpc = MPC(
        OnGround(model),
        horizon=horizon,
        controls=("delta",),
        Q=Weights(X=0.1, Y=1.0, psi=1.0),
        S=Weights(delta=50.0),
        limits=Limits(delta=(-0.35, 0.35)),
        rates=Limits(delta=(-1.0, 1.0)),
    )
    parts = {
        "plant": Plant(car, noise=Values(r=0.01), lag=Values(delta=0.03)),
        "mpc": mpc,
        "path": double_lane_change(20.0),
        "driver": SpeedDriver.for_car(mass=p.mass, radius=p.radius, limits=(-8000.0, 4000.0)),
    }
    return Live(**{**parts, **more})


def answers_of(live, cases, folder):
    """What the program does at these settings, by Node.js."""
    program = live.wasm()
    assert 0 < len(program) <= MOST_BYTES
    (folder / "live.wasm").write_bytes(program)
    (folder / "drive.mjs").write_text(DRIVE.replace("ROW", str(live.row)))
    names = [s.name.replace(" ", "_") for s in live.settings]
    values = [[case.get(n, s.value) for n, s in zip(names, live.settings, strict=True)] for case in cases]
    (folder / "settings.json").write_text(json.dumps(values))
    return json.loads(call("node", "drive.mjs", folder=folder))


@pytest.mark.slow
@pytest.mark.parametrize("horizon", [20, 13])
def test_commands_are_those_of_python(tmp_path, horizon):
    """By Node.js, at the job's settings and at others, to 1e-9 rad; the car is where it is in Python, to 1e-6 m.

    None of them spins the car: what comes then hangs on the last bit.
    """
    needs("zig", "node")
    live = loop(horizon)
    answers = answers_of(live, CASES, tmp_path)
    for case, answer in zip(CASES, answers, strict=True):
        run = closed_loop(**live.loop(**case))
        wanted = [float(p.command[0]) for p in run.plans]
        assert np.abs(np.subtract(answer["commands"], wanted)).max() < 1e-9, case
        rows = np.reshape(answer["rows"], (-1, live.row))
        columns = [run.t, run.s, run.e_y, run.v_x, run["X"], run["Y"], run["psi"], run["delta"]]
        assert np.abs(rows[:, :8] - np.column_stack(columns)).max() < 1e-6, case
        assert answer["end"] == 1


def whole(**more):
    """The same car driven by a driver, with every default."""
    given = loop()
    p = SOUSA_TABLE_6_1
    known = {n: getattr(p, n) for n in ("mass", "inertia_z", "wheelbase", "l_f")}
    model = sa.Bicycle(params=sa.BicycleParams(**known, C_f=1.2e5, C_r=1.2e5), dt=0.02, outputs=("v_y", "r"))
    driver = Driver(model, given.path, speed=given.driver, noise={"v_y": 0.05, "r": 0.005}, **more)
    return LiveDriver(plant=given.plant, whole=driver)


@pytest.mark.slow
@pytest.mark.parametrize("own", [True, False])
def test_a_driver_in_a_page_is_that_of_python(tmp_path, own):
    """Told what instruments without errors show; a controller of one's own has weights that stay."""
    needs("zig", "node")
    live = whole() if own else whole(controller=whole().mpc)
    cases = [
        {},
        {"pace": 1.1, "delay": 0.03},
        {"friction": 0.7, "mass": 1.2, "pace": 0.8},
        *([{"weight_e_y": 5.0, "weight_delta": 0.3}] if own else []),
    ]
    for case, answer in zip(cases, answers_of(live, cases, tmp_path), strict=True):
        run = drive(**live.loop(**case))
        wanted = [float(p.command[0]) for p in run.plans]
        assert np.abs(np.subtract(answer["commands"], wanted)).max() < 1e-9, case
        rows = np.reshape(answer["rows"], (-1, live.row))
        columns = [run.t, run.s, run.e_y, run.v_x, run["X"], run["Y"], run["psi"], run["delta"]]
        assert np.abs(rows[:, :8] - np.column_stack(columns)).max() < 1e-6, case
        assert answer["end"] == 1


def test_a_driver_without_speed_law_has_no_place_in_a_page():
    live = whole()
    with pytest.raises(ParameterError, match=r"^the driver has no MPC or no speed law; expected both"):
        LiveDriver(plant=live.plant, whole=live.whole.with_parts())
    assert live.weights == ("e_y", "e_course", "delta")
    assert whole(controller=live.mpc).weights == ()


def test_settings_reach_what_they_name():
    live = loop()
    parts = live.loop(pace=1.5, friction=0.5, mass=1.2, delay=0.02, weight_Y=3.0)
    p, plant = SOUSA_TABLE_6_1, parts["plant"]
    assert plant.model.params.mass == pytest.approx(1.2 * p.mass)
    assert plant.model.params.inertia_z == pytest.approx(1.2 * p.inertia_z)
    assert plant.model.tire_f.forces(0.0, 0.05, 5000.0).F_y == pytest.approx(
        0.5 * SOUSA_TABLE_6_2.forces(0.0, 0.05, 5000.0).F_y
    )
    assert dict(plant.delay) == {"delta": 0.02}
    assert not plant.noise
    assert parts["path"].v_x[0] == 30.0
    assert dict(parts["controller"].ocp.Q) == {"X": 0.1, "Y": 3.0, "psi": 1.0}
    assert [s.name for s in live.settings if s.low == s.high] == []
    with pytest.raises(ParameterError, match="there is no setting 'speed'; expected one of pace"):
        live.loop(speed=3.0)


def closed():
    t = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    return sa.Path.from_points(50 * np.cos(t), 50 * np.sin(t), closed=True).with_speed(20.0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"path": closed()}, "the path is closed or has no speed"),
        ({"path": double_lane_change(2.0)}, "the drive takes more than 60 s"),
        ({"driver": SpeedDriver(kp=(1.0,), ki=(1.0,), limits=(-1.0, 1.0))}, ""),
        (
            {"driver": SpeedDriver(kp=(1.0, 2.0), ki=(1.0, 1.0), limits=(-1.0, 1.0), speeds=(1.0, 2.0))},
            "the speed law has gains over speed",
        ),
    ],
)
def test_a_loop_that_has_no_place_in_a_page_is_told_so(change, said):
    if not said:
        loop(**change)
        return
    with pytest.raises(ParameterError, match=f"^{said}; expected a loop"):
        loop(**change)


def test_no_compiler_means_no_program(monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    assert loop().wasm() is None


def test_a_program_that_does_not_compile_is_none(monkeypatch, tmp_path):
    needs("zig")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    live = loop()
    real = subprocess.run

    def broken(call, **more):
        return real(["false"], **more) if "ziglang" in call else real(call, **more)

    monkeypatch.setattr(subprocess, "run", broken)
    assert live.wasm() is None
    assert not [f for f in os.listdir(tmp_path) if f.startswith(".live")]
