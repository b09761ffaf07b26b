"""An exported moving horizon estimator finds what the one in Python does, alone and in a driver, on any machine."""

import math
from dataclasses import fields

import numpy as np
import pytest

from slipangle.codegen import compiler
from slipangle.control.driver import Driver
from slipangle.errors import NotFiniteError, ParameterError
from slipangle.estimate.moving_horizon import MHE
from slipangle.export.drivers import channels
from slipangle.export.kinds import project_of
from slipangle.export.precision import as_precision
from slipangle.paths.lane_change import double_lane_change
from tests.export import test_drivers, test_estimators
from tests.export.test_drivers import KNOWN, LoadedDriver, told_by
from tests.export.tools import MACHINES, STRICT, built_and_run, needs, run

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
MORE = {
    "observer": {"horizon": 8, "limits": {"v_y": 0.5}},
    "late, gate, offsets": {"horizon": 6},
    "many steps": {"horizon": 6},
    "one state": {"horizon": 6},
    "parameters": {"horizon": 5, "gate": 5.0},
}


def looking_back(settings, **more):
    """A moving horizon estimator with the settings of a filter."""
    return MHE(**({f.name: getattr(settings, f.name) for f in fields(settings)} | more))


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """The solver in Python is compiled as the exported one is."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0 -march=native")


EVERYDAY = (("late, gate, offsets", "double"), ("observer", "single"))
VARIANTS = {name: looking_back(settings, **MORE[name]) for name, settings in test_estimators.VARIANTS.items()}
EACH = pytest.mark.parametrize(
    ("variant", "precision"),
    [
        pytest.param(v, p, marks=[pytest.mark.slow] * ((v, p) not in EVERYDAY))
        for v in (*VARIANTS, "driver")
        for p in ("double", "single")
    ],
)
USE = """
#include "car.h"
#include <math.h>
#include <stdio.h>
static car_estimator e;
static car_sample s;
static car_estimate o;
int main(void)
{
    static const double start[CAR_STATES] = CAR_START;
    int again;
    if (car_start(&e, 8, start) != CAR_TOO_SMALL || car_start(&e, sizeof e, start) != CAR_OK)
        return 2;
    while (scanf("%d", &again) == 1) {
        for (int i = 0; i < CAR_OUTPUTS; i++)
            if (scanf("%lf", s.y + i) != 1)
                return 3;
        for (int i = 0; i < CAR_INPUTS; i++)
            if (scanf("%lf", s.u + i) != 1)
                return 3;
        if (again && car_restart(&e, start) != CAR_OK)
            return 4;
        printf("%d %d", car_update(&e, &s, &o), (int)o.failures);
        for (int i = 0; i < CAR_STATES; i++)
            printf(" %.17g %.17g", o.state[i], o.state_std[i]);
        for (int i = 0; i < CAR_OUTPUTS; i++)
            printf(" %.17g %.17g %d", o.innovation[i], o.innovation_std[i], o.taken[i]);
        printf("\\n");
    }
    return 0;
}
"""


def written(project, folder):
    for file, content in project.everything.items():
        (folder / file).write_text(content)
    return project


def wild(model, start, n=300):
    """Whether to restart, outputs and inputs of each sample: missing, wild, no numbers."""
    rng, x = np.random.default_rng(4), start
    for k in range(n):
        u = np.array([0.03 * np.sin(0.1 * k), 20.0])
        x = np.asarray(model.step(x, u))
        y = np.asarray(model.output(x, u)) + 0.02 * rng.normal(size=model.n_outputs)
        y[rng.uniform(size=len(y)) < 0.2] = np.nan
        if k % 17 == 3:
            y[rng.integers(len(y))] = rng.choice([50.0, np.inf, -1e4])
        yield k == 200, y, np.array([u[0], np.nan]) if k % 41 == 7 else u


@needs_compiler
@pytest.mark.parametrize(
    "variant", [pytest.param(v, marks=[pytest.mark.slow] * (v in ("many steps", "one state"))) for v in VARIANTS]
)
def test_same_as_python_whatever_it_is_given(variant, tmp_path):
    """Estimates, how sure, innovations and outliers, to 1e-9; a bound on v_y holds in both."""
    needs("gcc")
    settings = VARIANTS[variant]
    project = written(project_of(settings, "car", 3), tmp_path)
    (tmp_path / "use.c").write_text(USE)
    run("gcc", "-std=c99", "-O1", "-o", "use", *project.sources, "use.c", "-lm", folder=tmp_path)
    line = next(s for s in project.everything["car.h"].splitlines() if "CAR_START" in s)
    start = np.array(line.partition("{")[2].partition("}")[0].split(","), dtype=float)
    samples = list(wild(settings.model, start))
    lines = [" ".join(map(repr, [int(again), *y.tolist(), *u.tolist()])) for again, y, u in samples]
    (tmp_path / "samples").write_text("\n".join(lines) + "\n")
    found = np.array(
        [r.split() for r in run("./use", folder=tmp_path, stdin=tmp_path / "samples").splitlines()], dtype=float
    )
    tracker, model, refused = settings.start_at(start), settings.model, 0
    for row, (again, y, u) in zip(found, samples, strict=True):
        if again:
            tracker.restart(start)
        try:
            tracker.update(y, u)
        except NotFiniteError:
            refused += 1
            assert row[0] == 2
            continue
        assert row[0] == 0
        assert row[1] == tracker.failures
        states, seen = row[2 : 2 + 2 * model.n_states], row[2 + 2 * model.n_states :]
        assert states[::2] == pytest.approx(tracker.state, rel=1e-9, abs=1e-9)
        assert states[1::2] == pytest.approx(tracker.state_std, rel=1e-8, abs=1e-12)
        error, std = tracker.innovation
        assert seen[::3] == pytest.approx(error, rel=1e-9, abs=1e-9, nan_ok=True)
        assert seen[1::3] == pytest.approx(std, rel=1e-8, nan_ok=True)
        assert np.array_equal(seen[2::3] > 0, tracker.taken)
    assert refused > 5
    if "v_y" in dict(settings.limits):
        assert np.abs(found[:, 2]).max() == pytest.approx(0.5, abs=1e-6)


@EACH
@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
def test_compilers_have_nothing_to_say(variant, compiler_, precision, tmp_path):
    needs(compiler_)
    thing, kind = (driver(), "Driver") if variant == "driver" else (VARIANTS[variant], "Estimator")
    project = written(as_precision(project_of(thing, "racer", 3), precision), tmp_path)
    for file in [*(s.replace("car", "racer") for s in project.sources), "main.c"]:
        run(compiler_, *STRICT, "-O1", "-fsyntax-only", file, folder=tmp_path)
    does = "step({}).planned" if variant == "driver" else "update({})"
    (tmp_path / "use.cpp").write_text(f'#include "racer.hpp"\nint main() {{ racer::{kind} e; return e.{does}; }}')
    if compiler_ == "gcc":
        needs("g++")
        run("g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "use.cpp", folder=tmp_path)


def test_the_folder_says_what_is_in_it(tmp_path):
    folder = VARIANTS["observer"].export(tmp_path / "made", name="racer", drive=2)
    assert "moving horizon estimator, 8 steps back" in (folder / "README.md").read_text()


@pytest.mark.slow
def test_the_folder_is_made_and_replayed(tmp_path):
    needs("make", "gcc")
    folder = VARIANTS["observer"].export(tmp_path / "made", name="racer", drive=100)
    assert "100 samples" in run("make", "-s", "replay", "strict", "CC=gcc", folder=folder)


def test_what_has_no_c_is_said():
    """A solver that is not the real-time one."""
    other = looking_back(test_estimators.VARIANTS["observer"], solver="ipopt")
    with pytest.raises(ParameterError, match="which has no C; expected the real-time one"):
        project_of(other, "", 3)


@needs_compiler
def test_single_precision_estimates_alike(tmp_path):
    """To a fiftieth of what is estimated."""
    needs("gcc")
    project = written(as_precision(project_of(VARIANTS["observer"], "car", 300), "single"), tmp_path)
    run("gcc", "-std=c99", "-O1", "-o", "program", *project.sources, "main.c", "-lm", folder=tmp_path)
    found = states(run("./program", "--states", folder=tmp_path, stdin=tmp_path / "drive.csv"))
    wanted = np.loadtxt(tmp_path / "drive.csv", delimiter=",", skiprows=1)[:, -found.shape[1] :]
    assert 0 < np.abs(found - wanted).max() < 0.02 * np.abs(wanted).max()


def states(said):
    return np.array([line.split(",") for line in said.split()], dtype=float)


def driver(**more):
    """One whose estimator looks back."""
    path = double_lane_change(20.0)
    whole = test_drivers.driver(path, horizon=6, **more)
    return Driver(KNOWN, path, controller=whole.controller, estimator=looking_back(whole.estimator, horizon=6))


@needs_compiler
def test_a_driver_that_looks_back_wants_the_same(tmp_path):
    """In closed loop with itself, with a gap and a second drive: commands, states and reasons, to 1e-7."""
    whole, rng, seen = driver(), np.random.default_rng(3), set()
    exported = LoadedDriver(project_of(whole, "car", 4), tmp_path)
    model, names = whole.controller.model, channels(whole)
    x = np.array(model.straight(20.0))
    for n, v in zip(("X", "Y", "psi"), whole.path.start, strict=True):
        x[model.states.index(n)] = v
    t = 0.0
    for k in range(260):
        told = told_by(model, x, t, k, rng) if k > 3 or k == 1 else {"r": 0.0} if k == 0 else {"v_x": 20.0 + 1e-3 * k}
        if k > 200:
            told = {n: v for n, v in told.items() if n not in ("X", "Y", "psi")}
        said = whole.step(told, t)
        code, out, _ = exported.step([told.get(n, math.nan) for n in names], t)
        assert code == 0
        assert out.value[0] == pytest.approx(said["delta"], abs=1e-7), k
        assert out.e_y == pytest.approx(said.e_y, abs=1e-7, nan_ok=True)
        assert out.restarts == said.restarts
        seen.add(out.reason)
        u = np.array([said["delta"] if n == "delta" else 20.0 for n in model.inputs])
        x = np.asarray(model.step(x, u))
        t += {100: 0.5, 150: 2.0}.get(k, 0.02 if k % 3 else 0.01)
    assert {0, 1, 3} <= seen


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("name", MACHINES)
def test_two_thousand_samples_on_every_machine(name, tmp_path):
    """The same states to 1e-9 from every compiler and processor: a solution has a tolerance, a filter has none."""
    project = written(project_of(VARIANTS["late, gate, offsets"], "car", 2000), tmp_path)
    found = states(
        built_and_run(name, [*project.sources, "main.c"], tmp_path, "--states", stdin=tmp_path / "drive.csv")
    )
    wanted = np.loadtxt(tmp_path / "drive.csv", delimiter=",", skiprows=1)[:, -found.shape[1] :]
    assert len(found) == 2000
    assert (np.abs(found - wanted) / (1 + np.abs(wanted))).max() <= 1e-9
