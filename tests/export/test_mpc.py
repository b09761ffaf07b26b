"""An exported MPC decides what the one in Python does, in any state of mind, on any machine."""

import ctypes
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.errors import ParameterError, WriteError
from slipangle.export.drives import standard_drive
from slipangle.export.kinds import project_of
from slipangle.export.memory import size_of
from slipangle.export.names import checked, comment, constants
from slipangle.models.vehicles.catalogue import FERRARI_250LM
from slipangle.ops import sin
from slipangle.optimal.solution import Status
from tests.control.marx.test_mpc import BY_POSE
from tests.control.test_switched import LIMIT, SWITCHED
from tests.export.loaded import Loaded, same
from tests.export.test_drivers import circle, driver
from tests.export.tools import MACHINES, STRICT, driven_on, needs, run
from tests.models.all_models import ALL_MODELS

STANLEY = sa.Stanley(params=FERRARI_250LM)
needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())


def controller(horizon=10, **settings):
    model = sa.OnGround(sa.Bicycle(params=FERRARI_250LM, dt=0.05, outputs=("v_y", "r")))
    given = {"Q": {"Y": 1.0, "psi": 1.0}, "S": {"delta": 50.0}, "limits": {"delta": 0.35}, "rates": {"delta": 1.0}}
    given = {k: (sa.Limits if k in ("limits", "rates") else sa.Weights)(**v) for k, v in given.items()}
    return sa.MPC(model, horizon=horizon, **(given | settings))


def files(mpc, steps=3):
    return project_of(mpc, "car", steps).everything


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """All is compiled in a second, by the same flags."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0 -march=native")


KINDS = {
    "plain": {},
    "corridor and soft limits": {
        "horizon": 6,
        "Q": sa.Weights(e_y=1.0, e_psi=1.0),
        "limits": sa.Limits(delta=0.35, r=0.3),
        "slack": sa.Weights(r=1e3, e_y=1e3),
        "corridor": 1.8,
    },
    "long stages": {"horizon": 4, "steps": (1, 1, 2, 3)},
    "hard limits": {"horizon": 5, "limits": sa.Limits(delta=0.35, Y=(-0.6, 0.6))},
    "by stages": {
        "horizon": 6,
        "Q": sa.Weights(e_y=1.0, e_psi=1.0),
        "limits": sa.Limits(delta=0.35, r=0.3, e_psi=0.5),
        "slack": sa.Weights(r=1e3, e_y=1e3),
        "slack_linear": sa.Weights(r=1e2),
        "corridor": 1.8,
        "solver": sa.RealTime(qp="riccati"),
    },
    "to convergence": {"horizon": 5, "solver": sa.RealTime(iterations=0, max_iterations=3)},
}
AS_OTHERS = ("corridor and soft limits", "hard limits", "to convergence")  # "by stages" and in test_joined


def upset(x, reference, k, rng):
    """What a step is given: now and then what no sensor should say."""
    x, applied = np.array(x), None
    tracked = np.array(reference.tracked)
    if k % 7 == 3:
        x = x + rng.normal(size=len(x)) * [0.5, 0.2, 2.0, 0.5, 0.3]
    if k % 11 == 5:
        x[rng.integers(len(x))] = rng.choice([np.nan, np.inf, 1e9, -1e200])
    if k % 13 == 6:
        tracked[rng.integers(len(tracked)), rng.integers(tracked.shape[1])] = rng.choice([np.nan, 1e9])
    if k % 5 == 2:
        applied = rng.choice([0.1, -0.5, np.nan, 1e13]) * np.ones(1)
    if k % 17 == 8:
        x[-1] += 2 * np.pi * rng.integers(-2, 3)
    if 40 < k < 48:
        x[0] = np.nan
    return x, replace(reference, tracked=tracked), applied


@needs_compiler
@pytest.mark.parametrize("kind", [pytest.param(k, marks=[pytest.mark.slow] * (k in AS_OTHERS)) for k in KINDS])
def test_same_as_python_to_the_last_bit_whatever_happens(kind, monkeypatch):
    """Commands, plans, status, fallbacks, health; a third of the calls hold what no sensor should say."""
    if kind == "plain":  # of one, what an optimiser makes of such code
        monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1 -march=native")
    settings = dict(KINDS[kind])
    mpc = controller(settings.pop("horizon", 10), **settings)
    exported = Loaded(files(mpc))
    path, rng = sa.double_lane_change(20.0), np.random.default_rng(5)
    previous, seen = None, set()
    x, s = mpc.model.straight(20.0), 0.0
    for k in range(120):
        reference = mpc.reference(path.ahead(s, mpc.times))
        given, wanted, applied = upset(x, reference, k, rng)
        previous = mpc.plan(given, wanted, previous, applied=applied)
        out = exported.plan(given, wanted, applied)
        assert same(out, previous), (k, previous.message)
        seen.add((previous.status.name, previous.stopping))
        x = np.asarray(mpc.model.step(x, np.array([previous.command[0], 20.0])))
        s = min(s + 1.0, 80.0)
    assert {("NOT_FINITE", False), ("NOT_FINITE", True), ("IMPLAUSIBLE", False)} < seen
    assert len(seen) > 4


@needs_compiler
def test_plans_that_gauss_newton_steps_do_not_end_are_recorded_as_the_code_makes_them():
    """Python goes on by the exact Hessian there; replayed, the code would seem to decide otherwise."""
    mpc = sa.MPC(
        sa.Ode(
            f=lambda x, u, p: [x[1] - 0.5, u[0] - sin(x[0] + 1.2)],
            states=("phi", "rate"),
            inputs=("a",),
            params={},
            dt=0.1,
        ),
        horizon=40,
        Q=sa.Weights(miss=5.0),
        R=sa.Weights(a=0.1),
        terms={"miss": lambda x, u, p: 30.0 + sin(2.0 * x[0] + 2.4) * (x[1] - 0.5) + (x[0] + 1.2) ** 2},
        limits=sa.Limits(a=1000.0),
        solver=sa.RealTime(iterations=0, max_iterations=200),
    )
    alone = replace(mpc, solver=replace(mpc.solver, hessian="gauss-newton"))
    x = np.zeros(2)
    assert (mpc.plan(x).status, alone.plan(x).status) == (Status.SOLVED, Status.ITERATION_LIMIT)
    made, plain = (project_of(each, "", 3) for each in (mpc, alone))
    assert made.drive == plain.drive
    assert "at most 200 Gauss-Newton steps" in made.about
    assert "Gauss-Newton" not in plain.about


@needs_compiler
@pytest.mark.parametrize("around", ["driver", "switched"])
def test_inside_a_driver_or_beside_another_they_are_recorded_so_too(around, monkeypatch):
    """Steps that the code does not have are in no drive of it, and its README names their limit."""
    settings = sa.RealTime(iterations=0, max_iterations=77)
    if around == "driver":
        whole = driver(circle(), horizon=5)
        whole.controller = replace(whole.controller, solver=settings)
    else:
        whole = replace(SWITCHED, limit=replace(LIMIT, solver=settings), enter=0.01, leave=0.005)
    plan, asked = sa.MPC.plan, set()

    def noted(self, *given, **more):
        asked.add(self.solver)
        return plan(self, *given, **more)

    monkeypatch.setattr(sa.MPC, "plan", noted)
    made = project_of(whole, "", 8)
    assert asked == {replace(settings, hessian="gauss-newton")}
    assert "at most 77 Gauss-Newton steps" in made.about


@needs_compiler
def test_a_first_call_without_a_state_is_the_stop_law():
    mpc = controller(5, safe=sa.Values(delta=0.1))
    reference = mpc.reference(sa.double_lane_change(20.0).ahead(0.0, mpc.times))
    plan = mpc.plan(np.full(5, np.nan), reference)
    assert same(Loaded(files(mpc)).plan(np.full(5, np.nan), reference), plan)
    assert plan.stopping


@needs_compiler
def test_the_caller_bounds_iterations_and_brings_the_clock():
    mpc = controller()
    exported = Loaded(files(mpc))
    reference = mpc.reference(sa.double_lane_change(20.0).ahead(20.0, mpc.times))
    far = mpc.model.straight(20.0, X=20.0, Y=9.0, psi=1.0)
    assert exported.plan(far, reference).iterations >= 3
    exported.start()
    exported.limit(1)
    assert exported.plan(far, reference).iterations == 1
    assert exported.plan(far, reference).iterations <= 2  # that many, after the one of real-time iterations
    ticks = []
    clock = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p)(lambda of: ticks.append(0) or 1e-3 * len(ticks))
    exported.start()
    exported.limit(0, 5.5e-3, ctypes.cast(clock, ctypes.c_void_p))
    out = exported.plan(far, reference)
    assert out.status == 4  # time is over
    assert out.age == 1
    assert out.health.overruns == 1
    assert out.seconds == pytest.approx(1e-3 * (len(ticks) - 1))
    assert abs(out.command[0]) <= 0.05
    for none_left in (-1.0, np.nan, -np.inf, 1e-9):
        exported.start()
        exported.limit(0, none_left, ctypes.cast(clock, ctypes.c_void_p))
        for k in (1, 2):
            out = exported.plan(far, reference)
            assert (out.status, out.age, out.health.overruns) == (4, k, k), none_left
            assert abs(out.command[0]) <= 0.05 * k
    for any_time in (0.0, np.inf):
        exported.limit(0, any_time, ctypes.cast(clock, ctypes.c_void_p))
        out = exported.plan(far, reference)
        assert (out.status in (0, 1), out.age, out.health.overruns) == (True, 0, 2)


@needs_compiler
def test_memory_is_what_the_header_says():
    """For as many lanes as the compiler takes, which are not those of every processor that has them."""
    made = files(controller())
    exported = Loaded(made)
    said = sorted(int(size) for size in re.findall(r"#define CAR_BYTES (\d+)", made["car.h"]))
    enough = next(size for size in said if exported.start(size) == 0)
    assert exported.start(enough - 64) == 1
    assert exported.start(offset=8) == 2
    assert exported.start() == 0


def test_size_of_a_struct_is_that_of_the_compiler(tmp_path):
    """What is a pointer, a long or a vector has its alignment."""
    needs("gcc")
    made = files(controller(7))
    for lanes in (1, 8):
        said = size_of(made["car.c"].split("#define CALLERS_CLOCK\n", 1)[1], "Controller", lanes)
        text = f'{made["car.c"]}\n_Static_assert(sizeof(Controller) == {said}, "another size");\n'
        for name, content in {**made, "size.c": text}.items():
            (tmp_path / name).write_text(content)
        run("gcc", f"-DCAR_LANES={lanes}", "-fsyntax-only", "size.c", folder=tmp_path)


@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
@pytest.mark.parametrize("simd", ["-march=native", "-DCAR_LANES=1"])
def test_compilers_have_nothing_to_say(compiler_, simd, tmp_path):
    needs(compiler_)
    for kind in ("long stages", "by stages"):
        settings = dict(KINDS[kind])
        made = files(controller(settings.pop("horizon", 10), **settings))
        for name, content in made.items():
            (tmp_path / name).write_text(content)
        for name in ("car.c", "main.c"):
            run(compiler_, *STRICT, simd, "-fsyntax-only", name, folder=tmp_path)


def test_wrapper_for_cpp(tmp_path):
    needs("g++", "gcc")
    made = files(controller(4), 20)
    use = """
#include "car.hpp"
#include <cstdio>
int main()
{
    car::Controller controller;
    car::Input input{};
    int calls = 0;
    auto clock = [&calls] { return 1e-9 * ++calls; };
    controller.limit(5);
    controller.limit(5, 1.0, clock);
    const car::Output &out = controller.plan(input);
    std::printf("%d %d", out.status, calls > 0);
}
"""
    for name, content in {**made, "use.cpp": use}.items():
        (tmp_path / name).write_text(content)
    run("gcc", "-c", "-O1", "car.c", folder=tmp_path)
    run(
        "g++",
        "-std=c++17",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-pedantic",
        "use.cpp",
        "car.o",
        "-o",
        "use",
        folder=tmp_path,
    )
    assert run("./use", folder=tmp_path) == "0 1"


@needs_compiler
def test_source_asks_nothing_of_the_system():
    """No memory, no file, no time: functions of string.h and math.h, and the caller's clock."""
    text = files(controller(4))["car.c"]
    assert (
        re.findall(r"\b(malloc|calloc|free|alloca|printf|fopen|clock_gettime|time|getenv|exit|abort)\s*\(", text) == []
    )
    assert set(re.findall(r"#include <(\w+)\.h>", text)) == {"math", "stdint", "string", "immintrin"}


@needs_compiler
def test_a_folder_is_new_or_asked_for(tmp_path):
    mpc = controller(3)
    folder = mpc.export(tmp_path / "new", drive=2)
    made = {p.name for p in folder.iterdir()}
    listed = "mpc.c mpc.h mpc.hpp mpc_block.h mpc_sfun.c mpc_node.cpp main.c drive.csv".split()
    listed += "Makefile CMakeLists.txt README.md LICENSE manifest.json".split()
    assert made == set(listed)
    (folder / "mine.txt").write_text("kept")
    with pytest.raises(WriteError, match="is not empty; expected a new one"):
        mpc.export(folder, drive=2)
    mpc.export(folder, drive=2, force=True)
    assert (folder / "mine.txt").read_text() == "kept"
    with pytest.raises(ParameterError, match="expected the real-time one"):
        controller(3, solver="ipopt").export(tmp_path / "other", drive=2)
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    "name", ["int", "Car", "1st", "a b", "class", "a-b", "x" * 40, "../up", "a__b", "size_t", 3, "main"]
)
def test_names_are_those_of_c(name):
    with pytest.raises(ParameterError, match="expected"):
        checked(name)


def test_names_of_channels_cannot_be_code():
    """What a model file calls its channels is data."""
    evil = ['r */ int system(const char *); /* "', "a\nb", "r[k-1]", "r(k-1)", "\\"]
    made = constants("CAR_X", evil)
    assert len(set(made.values())) == len(evil)
    assert all(re.fullmatch(r"[A-Z0-9_]+", c) for c in made.values())
    for name in evil:
        assert not set(comment(name)) & {"*", "\n", "\\", '"', "#"}


@pytest.mark.parametrize("name", ["", "rt", "marx", "plain", "fmu", "units"])
def test_no_name_is_one_inside(name, tmp_path):
    """What a kind is called by default, and what its own functions are called."""
    needs("gcc")
    for thing in (controller(3), BY_POSE, ALL_MODELS["bicycle"], STANLEY):
        made = project_of(thing, name, 2)
        for file, content in made.everything.items():
            (tmp_path / file).write_text(content)
        run("gcc", *STRICT, "-fsyntax-only", f"{made.name}.c", "main.c", folder=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_two_thousand_steps_on_every_machine(name, tmp_path):
    """The same commands to 1e-10 from every compiler and processor."""
    needs()
    mpc = controller(10)
    commands, wanted = driven_on(name, mpc, tmp_path)
    assert np.abs(commands - wanted).max() <= 1e-10


@pytest.mark.slow
@needs_compiler
def test_two_thousand_steps_to_the_last_bit(monkeypatch):
    """By the compiler and the flags that Python's is compiled with."""
    monkeypatch.delenv("SLIPANGLE_CFLAGS")
    mpc = controller(10)
    drive = standard_drive(mpc, 2000)
    exported = Loaded(project_of(mpc, "car", drive).everything)
    n = exported.size
    for asked, command in zip(drive.asked, drive.commands, strict=True):
        x, tracked, w, _ = np.split(asked, np.cumsum([n["STATES"], n["NODES"] * n["REFERENCES"], n["NODES"]]))
        wanted = sa.Reference(tracked=tracked.reshape(n["NODES"], -1), exogenous=w.reshape(n["NODES"], -1))
        assert exported.plan(x, wanted).command[0] == command[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "sanitizer",
    [
        ("gcc", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-march=native"),
        ("gcc", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-DCAR_LANES=1"),
        ("clang", "-fsanitize=memory", "-march=native"),
    ],
    ids=["address, undefined", "address, undefined, without SIMD", "memory"],
)
def test_sanitizers_have_nothing_to_say(sanitizer, tmp_path):
    """Of 100 000 random inputs, a third of which hold NaN, infinities and what no sensor says."""
    needs(sanitizer[0])
    made = files(controller(**KINDS["corridor and soft limits"] | {"horizon": 10}))
    for file, content in {**made, "fuzz.c": (Path(__file__).parent / "fuzz.c").read_text()}.items():
        (tmp_path / file).write_text(content)
    run(*sanitizer, "-std=c99", "-O1", "-g", "-o", "fuzz", "car.c", "fuzz.c", "-lm", folder=tmp_path)
    said = run("./fuzz", "100000", folder=tmp_path, limit=900)
    fallbacks = int(re.search(r"^100000 calls, (\d+) without a solution, 0 inputs outside", said)[1])
    assert 10_000 < fallbacks < 60_000


@pytest.mark.slow
def test_cortex_m7(tmp_path):
    """Compiled for the bare microcontroller; its code then runs below a main that user mode knows."""
    needs("arm-none-eabi-gcc", "arm-linux-gnueabihf-gcc", "qemu-arm")
    mpc = controller(10)
    drive = standard_drive(mpc, 200)
    for file, content in project_of(mpc, "car", drive).everything.items():
        (tmp_path / file).write_text(content)
    m7 = ("-mcpu=cortex-m7", "-mfpu=fpv5-d16", "-mfloat-abi=hard", "-mthumb")
    run("arm-none-eabi-gcc", *m7, *STRICT, "-O2", "-fno-short-enums", "-c", "car.c", folder=tmp_path)
    run("arm-none-eabi-objcopy", "--remove-section", ".ARM.attributes", "car.o", folder=tmp_path)  # "for a profile M"
    run("arm-linux-gnueabihf-gcc", "-O2", "-static", "-o", "program", "main.c", "car.o", "-lm", folder=tmp_path)
    said = run("qemu-arm", "./program", "--commands", folder=tmp_path, stdin=tmp_path / "drive.csv")
    assert np.abs(np.array(said.split(), dtype=float) - drive.commands[:, 0]).max() <= 1e-10


@pytest.mark.slow
def test_make_and_cmake(tmp_path):
    needs("make", "cmake", "gcc")
    folder = controller(5).export(tmp_path / "made", name="racer", drive=50)
    said = run("make", "-s", "replay", "strict", "CC=gcc", folder=folder)
    assert re.search(r"^50 steps in \d+ bytes", said)
    run("cmake", "-S", ".", "-B", "build", folder=folder)
    run("cmake", "--build", "build", folder=folder)
    assert "100% tests passed" in run("ctest", "--test-dir", "build", folder=folder)
