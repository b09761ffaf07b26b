"""An exported MPC with scenarios, free parameters or a free duration decides what the one in Python does."""

import ctypes
import math
import re
from dataclasses import replace

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.control.driver import Driver
from slipangle.errors import ParameterError
from slipangle.export.built import build, load
from slipangle.export.drivers import channels
from slipangle.export.drives import Recorder
from slipangle.export.kinds import project_of
from slipangle.export.precision import as_precision
from slipangle.models.custom import Ode
from slipangle.paths.lane_change import double_lane_change
from tests.export import test_drivers
from tests.export.loaded import STATUSES, Loaded
from tests.export.test_mpc import controller
from tests.export.tools import MACHINES, STRICT, built_and_run, needs, run

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """All is compiled soon, by the same flags; what an optimiser makes of such code is asked by test_mpc."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0 -march=native")


def pushed(x, u, p):
    return p.gain * u[0] - p.damping * x[1] - 0.3 * x[0] * x[0] * x[0]


RATES = {"f": lambda x, u, p: [x[1], pushed(x, u, p)]}
SOLVED = {"implicit": lambda d, x, u, p: [d[0] - x[1], d[1] + 0.2 * d[1] ** 3 - pushed(x, u, p)]}


def spring(equations=RATES, **settings):
    """A mass on a hardening spring, whose drive is not known well."""
    model = Ode(
        **equations,
        states=("p", "v"),
        inputs=("a",),
        outputs=(),
        params={"gain": 1.0, "damping": 0.2},
        dt=0.1,
    )
    given = {"horizon": 8, "controls": ("a",), "Q": {"p": 5.0, "v": 0.1}, "R": {"a": 0.05}, "S": {"a": 0.1}}
    given |= {"limits": sa.Limits(a=2.0, v=0.8), "rates": sa.Limits(a=12.0), "slack": sa.Weights(v=50.0)}
    return sa.MPC(model, **(given | settings))


GAINS = sa.Scenarios({"gain": (0.7, 1.0, 1.4)}, probabilities=(0.2, 0.5, 0.3))
ROADS = {"horizon": 5, "Q": sa.Weights(e_y=1.0, e_psi=1.0), "corridor": 1.8, "slack": sa.Weights(e_y=1e3)}
KINDS = {
    "three gains": lambda: spring(scenarios=GAINS),
    "two inputs in common": lambda: spring(
        scenarios=replace(GAINS, common=2), solver=sa.RealTime(iterations=0), fallback=2
    ),
    "a parameter and a duration": lambda: spring(free={"damping": (0.1, 1.0)}, duration=(0.4, 1.6)),
    "rates over a duration": lambda: spring(
        duration=(0.4, 1.6), rates=sa.Limits(a=4.0), terminal={"duration": 1.0, "p": 30.0}
    ),
    "scenarios and a parameter": lambda: spring(
        scenarios=GAINS, free={"damping": (0.1, 1.0)}, solver=sa.RealTime(qp="riccati")
    ),
    "a corridor at two speeds": lambda: controller(**ROADS, scenarios=sa.Scenarios({"v_x": (18.0, 22.0)})),
    "a Huber cost": lambda: spring(huber={"p": 0.1}),
    "a Huber cost, scenarios and a parameter": lambda: spring(
        huber={"p": 0.1, "v": 0.2}, scenarios=GAINS, free={"damping": (0.1, 1.0)}
    ),
    "an exact Hessian": lambda: spring(
        terms={"heat": lambda x, u, p: 0.1 * u[0] ** 4 + x[1] * u[0]},
        limits=sa.Limits(a=2.0, heat=(-np.inf, 0.0)),
        slack={},
        slack_linear={"heat": 1.0},
        free={"damping": (0.1, 1.0)},
        solver=sa.RealTime(iterations=0, hessian="exact"),
    ),
    "rates that solve equations": lambda: spring(SOLVED, scenarios=GAINS),
    "few iterations": lambda: spring(scenarios=GAINS, solver=sa.RealTime(iterations=0, max_iterations=2)),
}
PARTS = ("three gains", "a Huber cost", "few iterations")  # of what others ask together


class LoadedJoined(Loaded):
    """Loaded from both of its files."""

    folder = None

    @staticmethod
    def more(files):
        return 128 + max(int(b) for b in re.findall(r"#define CAR_JOINED_BYTES (\d+)", files["car_joined.h"]))

    def compiled(self, files, flags):
        for name, text in files.items():
            (self.folder / name).write_text(text)
        library = self.folder / f"all{compiler.SUFFIX}"
        given = (*flags, *compiler._levels()[0], "-shared", "-fPIC", "-std=gnu11")
        run(*compiler.compiler(), *given, "-o", library.name, "car.c", "car_joined.c", "-lm", folder=self.folder)
        return ctypes.CDLL(str(library))


def loaded(mpc, folder):
    LoadedJoined.folder = folder
    return LoadedJoined(project_of(mpc, "car", recorded(mpc, 3)).everything)


def recorded(mpc, steps):
    """A drive that is not of a vehicle needs its own."""
    if "X" in mpc.model.states:
        return steps
    recorder, previous = Recorder(mpc), None
    for _, x, reference, _ in asked(mpc, steps, quiet=True):
        previous = recorder.plan(x, reference, previous)
    return recorder.drive


def asked(mpc, steps, quiet=False):
    """States, references and inputs applied; now and then what no sensor should say."""
    rng, path = np.random.default_rng(5), double_lane_change(20.0)
    on_road = "X" in mpc.model.states
    x, s = (mpc.model.straight(20.0), 0.0) if on_road else (np.array([0.5, 0.0]), 0.0)
    for k in range(steps):
        if on_road:
            wanted = mpc.reference(path.ahead(s, mpc.times))
        else:
            wanted = mpc.setpoint(p=0.5 * np.sin(0.1 * k + 0.3 * mpc.times), v=0.0)
        given, applied = np.array(x), None
        if not quiet:
            if k % 7 == 3:
                given = given + 0.3 * rng.normal(size=len(x))
            if k % 11 == 5:
                given[rng.integers(len(x))] = (np.nan, np.inf, 1e13, -1e200)[k // 11 % 4]
            if k % 5 == 2:
                applied = rng.choice([0.1, -0.5, np.nan, 1e13]) * np.ones(1)
            if 40 < k < 48:
                given[0] = np.nan
        yield k, given, wanted, applied
        u = np.array([asked.last, 20.0]) if on_road else np.array([asked.last])
        x = np.asarray(mpc.model.step(x, u))
        s = min(s + 1.0, 80.0)


asked.last = 0.0


@needs_compiler
@pytest.mark.parametrize("kind", [pytest.param(k, marks=[pytest.mark.slow] * (k in PARTS)) for k in KINDS])
def test_same_as_python_whatever_happens(kind, tmp_path):
    """Commands, status, fallbacks, health and what is decided once; plans to 1e-9."""
    asked.last = 0.0
    mpc = KINDS[kind]()
    exported, previous, seen = loaded(mpc, tmp_path), None, set()
    asked.last = 0.0
    for k, given, wanted, applied in asked(mpc, 100):
        previous = mpc.plan(given, wanted, previous, applied=applied)
        out = exported.plan(given, wanted, applied)
        said = (k, previous.message)
        assert STATUSES[out.status] is previous.status, said
        assert (out.age, bool(out.stopping)) == (previous.age, previous.stopping), said
        assert tuple(getattr(out.health, n) for n, _ in out.health._fields_) == tuple(previous.health)
        assert np.array(out.command) == pytest.approx(previous.command, abs=1e-9), said
        assert np.array(out.u) == pytest.approx(previous.u, abs=1e-8), said
        near = 1e-4 if previous.age else 1e-8  # of a fallback from a state that is not known
        assert np.array(out.x) == pytest.approx(previous.x, rel=near, abs=near), said
        if mpc.ocp.decided_once:
            once = np.array(out.decided)
            if previous.age:
                assert np.isnan(once).all()
            else:
                assert once == pytest.approx([previous.decided[n] for n in mpc.ocp.decided_once], abs=1e-8), said
        seen.add((previous.status.name, previous.stopping))
        asked.last = float(previous.command[0])
    shifts = mpc.ocp.duration is None  # a plan of other steps than those of time cannot be followed a step later
    assert {("NOT_FINITE", not shifts), ("NOT_FINITE", True), ("IMPLAUSIBLE", not shifts)} <= seen
    assert len(seen) > 3


def written(thing, folder, precision="double", steps=3, name="car"):
    drive = recorded(thing, steps) if isinstance(thing, sa.MPC) else steps
    project = as_precision(project_of(thing, name, drive), precision)
    for file, content in project.everything.items():
        (folder / file).write_text(content)
    return project


def driver(path=None):
    """One whose controller plans for two speeds."""
    path = path or double_lane_change(20.0)
    whole = test_drivers.driver(path, horizon=5)
    planner = sa.MPC(ocp=replace(whole.controller.ocp, scenarios=sa.Scenarios({"v_x": (19.0, 21.0)})))
    return Driver(test_drivers.KNOWN, path, controller=planner, estimator=whole.estimator)


@needs_compiler
def test_a_driver_that_plans_for_two_speeds_wants_the_same(tmp_path):
    """In closed loop with itself: commands to 1e-9."""
    whole, rng = driver(), np.random.default_rng(3)
    exported = test_drivers.LoadedDriver(project_of(whole, "car", 4), tmp_path)
    model, names = whole.controller.model, channels(whole)
    x = np.array(model.straight(20.0))
    for n, v in zip(("X", "Y", "psi"), whole.path.start, strict=True):
        x[model.states.index(n)] = v
    for k in range(150):
        told = test_drivers.told_by(model, x, 0.02 * k, k, rng)
        said = whole.step(told, 0.02 * k)
        code, out, _ = exported.step([told.get(n, math.nan) for n in names], 0.02 * k)
        assert code == 0
        assert out.value[0] == pytest.approx(said["delta"], abs=1e-9), k
        x = np.asarray(model.step(x, np.array([said["delta"] if n == "delta" else 20.0 for n in model.inputs])))
    assert abs(out.e_y) < 0.3


@needs_compiler
def test_a_built_one_says_what_it_decided(tmp_path):
    """Free parameters by name, and when its nodes are."""
    mpc = KINDS["a parameter and a duration"]()
    built = load(build(mpc, tmp_path / "made", drive=recorded(mpc, 20)))
    reference = mpc.setpoint(p=0.4, v=0.0)
    ours, theirs = (one.plan(np.array([0.5, 0.0]), reference) for one in (mpc, built))
    assert theirs.decided == pytest.approx(ours.decided, abs=1e-9)
    assert theirs.times == pytest.approx(ours.times, abs=1e-9)
    assert theirs.times[-1] == pytest.approx(theirs.decided["duration"])


@pytest.mark.parametrize(
    ("kind", "precision"),
    [
        ("scenarios and a parameter", "double"),
        pytest.param("a corridor at two speeds", "double", marks=pytest.mark.slow),
        pytest.param("driver", "double", marks=pytest.mark.slow),
        pytest.param("scenarios and a parameter", "single", marks=pytest.mark.slow),
        pytest.param("a corridor at two speeds", "single", marks=pytest.mark.slow),
        ("driver", "single"),
    ],
)
@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
def test_compilers_have_nothing_to_say(kind, compiler_, precision, tmp_path):
    needs(compiler_)
    thing = driver() if kind == "driver" else KINDS[kind]()
    project = written(thing, tmp_path, precision, name="racer")
    for file in [*(s.replace("car", "racer") for s in project.sources), "main.c"]:
        run(compiler_, *STRICT, "-O1", "-fsyntax-only", file, folder=tmp_path)
        run(compiler_, *STRICT, "-DRACER_LANES=1", "-DRACER_JOINED_LANES=1", "-fsyntax-only", file, folder=tmp_path)
    if compiler_ == "gcc":
        needs("g++")
        assert "-DRACER_LANES=1" in (tmp_path / "README.md").read_text() or kind == "driver"
        (tmp_path / "use.cpp").write_text('#include "racer.hpp"\nint main() { return 0; }')
        run("g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "use.cpp", folder=tmp_path)


@pytest.mark.parametrize("precision", ["double", pytest.param("single", marks=pytest.mark.slow)])
def test_memory_is_what_the_header_says(precision, tmp_path):
    """Of both files; too little of it is refused, and single precision decides alike."""
    needs("gcc")
    project = written(KINDS["three gains"](), tmp_path, precision, 60)
    (tmp_path / "use.c").write_text(
        '#include "car.h"\n#include <stdio.h>\nstatic car_controller c;\nint main(void) {\n'
        '    printf("%d %d\\n", car_start(&c, sizeof c - 8), car_start(&c, sizeof c));\n    return 0;\n}\n'
    )
    for lanes in (1, 8):
        wide = (f"-DCAR_LANES={lanes}", f"-DCAR_JOINED_LANES={lanes}")
        run("gcc", *wide, "-std=c99", "-O0", "-o", "use", *project.sources, "use.c", "-lm", folder=tmp_path)
        assert run("./use", folder=tmp_path) == "1 0\n"
    run("gcc", "-std=c99", "-O0", "-o", "program", *project.sources, "main.c", "-lm", folder=tmp_path)
    if precision == "double":
        run("./program", folder=tmp_path, stdin=tmp_path / "drive.csv")
    found = commands(run("sh", "-c", "./program --commands || true", folder=tmp_path, stdin=tmp_path / "drive.csv"))
    wanted = np.loadtxt(tmp_path / "drive.csv", delimiter=",", skiprows=1)[:, -1:]
    assert np.abs(found - wanted).max() < (1e-9 if precision == "double" else 0.02)


def commands(said):
    return np.array([line.split(",") for line in said.split()], dtype=float)


def test_what_has_no_c_is_said():
    """Another solver, a trust in the model that would weigh all parts, and a page."""
    with pytest.raises(ParameterError, match="which has no C; expected the real-time one"):
        project_of(spring(scenarios=GAINS, solver="ipopt"), "car", 3)
    whole = driver()
    whole._trusts = True
    with pytest.raises(ParameterError, match="weighs scenarios, free parameters, Huber costs"):
        project_of(whole, "car", 3)


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("name", MACHINES)
def test_five_hundred_steps_on_every_machine(name, tmp_path):
    """The same commands to 1e-10 from every compiler and processor."""
    project = written(KINDS["three gains"](), tmp_path, steps=500)
    said = built_and_run(name, [*project.sources, "main.c"], tmp_path, "--commands", stdin=tmp_path / "drive.csv")
    wanted = np.loadtxt(tmp_path / "drive.csv", delimiter=",", skiprows=1)[:, -1:]
    assert len(commands(said)) == 500
    assert np.abs(commands(said) - wanted).max() <= 1e-10
