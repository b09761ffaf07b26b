"""In single precision exported C drives as in double, and holds what it promises, whatever it is given."""

import ctypes
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from slipangle.codegen import compiler
from slipangle.control.mpc import MPC
from slipangle.errors import ParameterError
from slipangle.export import export
from slipangle.export.kinds import project_of
from slipangle.export.memory import size_of
from slipangle.export.precision import as_precision, single
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths.lane_change import double_lane_change
from tests.export import test_drivers, test_estimators, test_followers, test_marx
from tests.export.loaded import STATUSES, Loaded
from tests.export.test_mpc import KINDS, controller, upset
from tests.export.tools import STRICT, built_and_run, needs, run
from tests.models.all_models import ALL_MODELS

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
SOFT = KINDS["corridor and soft limits"] | {"horizon": 14}  # with fewer stages its loop is not stable


def thesis_car():
    """Implicit wheels, torque and steering, with the car's own sample time."""
    model = SingleTrack(params=SOUSA_TABLE_6_1, dt=0.1, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2, method="radau")
    return MPC(
        model,
        horizon=10,
        controls=("delta", "T_f"),
        Q=Weights(X=1.0, Y=1.0, psi=1.0),
        S=Weights(delta=20.0, T_f=1e-6),
        limits=Limits(delta=0.35, T_f=600.0),
    )


CONTROLLERS = {
    "MPC": lambda: controller(),
    "MPC, corridor and soft limits": lambda: controller(**SOFT),
    "MPC, hard limit": lambda: controller(12, limits=Limits(delta=0.35, r=0.35)),
    "MPC, long stages": lambda: controller(**KINDS["long stages"]),
    "MPC by stages": lambda: controller(10, solver=RealTime(qp="riccati"), limits=Limits(delta=0.35, r=0.35)),
    "MPC to convergence": lambda: controller(10, solver=RealTime(iterations=0)),
    "MPC, implicit wheels": thesis_car,
    "MARX": lambda: test_marx.INTEGRAL,
    "pure pursuit": lambda: test_followers.KINDS["pure pursuit"],
    "Stanley": lambda: test_followers.KINDS["Stanley"],
    "LQR with preview": lambda: test_followers.KINDS["LQR with preview"],
    "Stanley, compensated": lambda: test_followers.KINDS["Stanley, compensated"],
    "feed-forward": lambda: test_followers.KINDS["feed-forward and feedback law"],
}
THINGS = CONTROLLERS | {
    "driver": test_drivers.VARIANTS["plain"],
    "driver, late, lagged, pedals": test_drivers.VARIANTS["late, lagged, pedals"],
    "estimator": lambda: test_estimators.VARIANTS["late, gate, offsets"],
    "estimator of parameters": lambda: test_estimators.VARIANTS["parameters"],
    **{name: lambda n=name: ALL_MODELS[n] for name in ("bicycle", "NARX", "neural state space", "Lur'e")},
}


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1 -march=native")


def projects(thing, steps=3):
    made = project_of(thing, "car", steps)
    return made, as_precision(made, "single")


def written(project, folder):
    for file, content in project.everything.items():
        (folder / file).write_text(content)
    return project


@needs_compiler
@pytest.mark.parametrize("name", THINGS)
def test_compilers_have_nothing_to_say(name, tmp_path):
    """And no number is promoted to double on the way, but times of the clock and what is printed."""
    needs("gcc", "clang")
    made = written(projects(THINGS[name]())[1], tmp_path)
    for simd in ("-march=native", "-DCAR_LANES=1", "-DCAR_LANES=4"):
        for source in made.sources:
            run("gcc", *STRICT, "-Wdouble-promotion", simd, "-fsyntax-only", source, folder=tmp_path)
    for source in (*made.sources, "main.c"):
        run("clang", *STRICT, "-fsyntax-only", source, folder=tmp_path)


def driven(controller, exported, steps):
    """Distances from a double lane change, over and over, of a loop closed by exported C; and its commands."""
    path, model = double_lane_change(20.0), controller.model
    known = {"v_x": 20.0, "X": 0.0, "Y": 0.0, "psi": 0.0}
    start = controller.start(known) if hasattr(controller, "start") else np.array(model.straight(20.0))
    step, at = model.functions[0], [model.states.index(n) for n in ("X", "Y")]
    x, s, e_y, commands = np.array(start), 0.0, [], []
    exported.start()
    for _ in range(steps):
        foot = path.project(*(float(x[i]) for i in at), s)
        s = foot.s
        e_y.append(foot.e_y)
        if s > path.length - 20.0 * controller.times[-1]:
            x, s = np.array(start), 0.0
        wanted = controller.reference(path.ahead(s, controller.times), **dict.fromkeys(_unknown(controller), 0.0))
        out = exported.plan(x, controller.check_reference(wanted))
        commands.append(list(out.command))
        given = {"v_x": 20.0, **dict(zip(controller.controls, out.command, strict=True))}
        x = np.asarray(step(x, [given.get(n, 0.0) for n in model.inputs])).ravel()
    assert out.health.fallbacks == 0
    return np.array(e_y), np.array(commands)


def _unknown(controller):
    return [n for n in controller.exogenous if n not in ("v_x", "v_x_dot", "curvature")]


@needs_compiler
@pytest.mark.parametrize("name", ["MPC", *(pytest.param(n, marks=pytest.mark.slow) for n in [*CONTROLLERS][1:])])
def test_two_thousand_steps_of_a_closed_loop_stay_where_they_are(name):
    """The RMSE of the lateral error within 2 % of that in double precision, no step without a plan."""
    whole = CONTROLLERS[name]()
    made = projects(whole)
    loops = [
        driven(whole, Loaded(p.everything, p.flags, kind=kind), 2000)
        for p, kind in zip(made, (ctypes.c_double, ctypes.c_float), strict=True)
    ]
    rmse = [math.sqrt(np.mean(e_y**2)) for e_y, _ in loops]
    assert rmse[0] > 1e-3
    assert rmse[1] == pytest.approx(rmse[0], rel=0.02)
    size = np.abs(loops[0][1]).max(axis=0)
    assert 0 < (np.abs(loops[0][1] - loops[1][1]) / size).max() < 0.05


@needs_compiler
def test_commands_are_finite_and_within_limits_whatever_is_given():
    whole = controller()
    exported = Loaded(projects(whole)[1].everything, kind=ctypes.c_float)
    path, rng, before, seen = double_lane_change(20.0), np.random.default_rng(5), 0.0, set()
    for k in range(400):
        reference = whole.reference(path.ahead(float(rng.uniform(0, 80)), whole.times))
        given, wanted, _ = upset(whole.model.straight(20.0, X=40.0), reference, k, rng)
        with np.errstate(over="ignore"):  # numbers that float has no place for are infinite
            out = exported.plan(given, wanted)
        u = np.array(out.u)[:, 0]
        assert np.abs(u).max() <= np.float32(0.35)
        assert np.abs(np.diff(u, prepend=np.float32(before))).max() <= 0.05 + 1e-6
        before = out.command[0]
        seen.add(out.status)
    assert len(seen) >= 4


@needs_compiler
@pytest.mark.parametrize("variant", ["plain", pytest.param("late, lagged, pedals", marks=pytest.mark.slow)])
def test_a_whole_driver_drives_alike(variant, tmp_path):
    """Estimator, path, plan and speed law in one; two thousand calls, noise and all, RMSE within 2 %."""
    whole, rmse = test_drivers.VARIANTS[variant](), []
    model, names, path = whole.controller.model, test_drivers.channels(whole), whole.path
    for project, kind in zip(projects(whole), (ctypes.c_double, ctypes.c_float), strict=True):
        folder = tmp_path / kind.__name__
        folder.mkdir()
        exported, rng = test_drivers.LoadedDriver(project, folder, kind), np.random.default_rng(3)
        x, e_y, s, past = _at_start(model, path), [], 0.0, []
        for k in range(2000):
            if s > path.length - 40.0 and not path.closed:
                x, s, past = _at_start(model, path), 0.0, []
                exported.start()
            now = dict(zip(model.states, x.tolist(), strict=True))
            v_x, late = path.speed(s), round(whole.estimator.late.get("X", 0.0) / 0.02)
            past.append(now)
            told = {"r": now["r"] + 0.002 * rng.normal(), "v_x": v_x + 0.02 * rng.normal()}
            if k % 5 == 0 or len(past) == 1:
                told |= {n: past[max(-1 - late, -len(past))][n] + 0.01 * rng.normal() for n in ("X", "Y", "psi")}
            code, out, _ = exported.step([told.get(n, math.nan) for n in names], 0.02 * k)
            assert code == 0
            foot = path.project(now["X"], now["Y"], s)
            s = foot.s
            e_y.append(foot.e_y)
            x = np.asarray(model.step(x, [out.value[0] if n == "delta" else v_x for n in model.inputs]))
        rmse.append(math.sqrt(np.mean(np.square(e_y))))
    assert rmse[0] > 1e-3
    assert rmse[1] == pytest.approx(rmse[0], rel=0.02)
    assert rmse[0] != rmse[1]


def _at_start(model, path):
    x = np.array(model.straight(20.0))
    for n, v in zip(("X", "Y", "psi"), path.start, strict=True):
        x[model.states.index(n)] = v
    return x


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("name", ["estimator", "estimator of parameters", "bicycle", "NARX", "neural state space"])
def test_estimates_and_free_runs_are_alike(name, tmp_path):
    """Over 2 000 samples, to a thousandth of what they vary by."""
    needs("gcc")
    made = written(projects(THINGS[name](), 2000)[1], tmp_path)
    run("gcc", "-O1", "-o", "program", *made.sources, "main.c", "-lm", folder=tmp_path)
    what = "--states" if made.kind == "estimator" else "--outputs"
    said = run("./program", what, folder=tmp_path, stdin=tmp_path / "drive.csv")
    rows = np.array([line.split(",") for line in said.split()], dtype=float)
    wanted = np.loadtxt(tmp_path / "drive.csv", delimiter=",", skiprows=1)[:, -rows.shape[1] :]
    assert len(rows) == len(wanted) == 2000
    assert (np.abs(rows - wanted) / np.ptp(wanted, axis=0)).max() < 1e-3
    assert (rows != wanted).any()


@pytest.mark.slow
@needs_compiler
def test_cortex_m7_without_double(tmp_path):
    """Its single-precision unit does all of it: of arithmetic in double only the clock's is asked for."""
    needs("arm-none-eabi-gcc", "arm-linux-gnueabihf-gcc", "qemu-arm")
    whole = controller()
    made = written(projects(whole, 200)[1], tmp_path)
    m7 = ("-mcpu=cortex-m7", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard", "-mthumb")
    run("arm-none-eabi-gcc", *m7, *STRICT, "-O2", "-fno-short-enums", "-c", "car.c", folder=tmp_path)
    asked = set(re.findall(r"U (__aeabi_d\w+)", run("arm-none-eabi-nm", "car.o", folder=tmp_path)))
    assert asked <= {"__aeabi_dsub", "__aeabi_d2f", "__aeabi_dcmpgt"}
    run("arm-none-eabi-objcopy", "--remove-section", ".ARM.attributes", "car.o", folder=tmp_path)  # "for a profile M"
    run("arm-linux-gnueabihf-gcc", "-O2", "-static", "-o", "program", "main.c", "car.o", "-lm", folder=tmp_path)
    said = run("qemu-arm", "./program", "--commands", folder=tmp_path, stdin=tmp_path / "drive.csv")
    wanted = np.loadtxt(tmp_path / "drive.csv", delimiter=",", skiprows=1)[:, -1]
    assert len(wanted) == 200
    assert 0 < np.abs(np.array(said.split(), dtype=float) - wanted).max() < 1e-5
    assert made.facts["precision"] == "single"


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["gcc", "gcc without SIMD", "clang", "Windows", "Cortex-A53", "arm Linux", "WebAssembly"]
)
def test_every_machine_decides_alike(name, tmp_path):
    """To 1e-5 of a radian, open loop over two thousand steps."""
    made = written(projects(controller(), 2000)[1], tmp_path)
    said = built_and_run(name, [*made.sources, "main.c"], tmp_path, "--commands", stdin=tmp_path / "drive.csv")
    wanted = np.loadtxt(tmp_path / "drive.csv", delimiter=",", skiprows=1)[:, -1]
    assert np.abs(wanted).max() > 0.02
    assert np.abs(np.array(said.split(), dtype=float) - wanted).max() < 1e-5


def test_size_of_a_struct_is_that_of_the_compiler(tmp_path):
    needs("gcc")
    made = projects(controller(7))[1].everything
    for lanes in (1, 8):
        text = (
            made["car.c"] + '\n#include <stdio.h>\nint main(void) { printf("%d", (int)sizeof(Controller)); return 0; }'
        )
        for name, content in {**made, "size.c": text}.items():
            (tmp_path / name).write_text(content)
        run("gcc", f"-DCAR_LANES={lanes}", "-O0", "-o", "size", "size.c", "-lm", folder=tmp_path)
        source = text.split("#define CALLERS_CLOCK\n", 1)[1]
        said = int(run("./size", folder=tmp_path))
        assert size_of(source, "Controller", lanes, number=4) == said
        assert f"CAR_LANES == {lanes}\n#define CAR_BYTES {-(-said // 8) * 8}" in made["car.h"]
    double = projects(controller(7))[0]
    assert max(double.facts["bytes"].values()) > 1.5 * max(projects(controller(7))[1].facts["bytes"].values())


@pytest.mark.parametrize(
    ("double", "wanted"),
    [
        ("double a = 1.5;", "float a = 1.5e+00f;"),
        ("x = 0x1.8p+1 * sqrt(y) - fabs(z);", "x = 3e+00f * sqrtf(y) - fabsf(z);"),
        ("if (e > 1e-8) ", "if (e > 2.9e-04f) "),
        ("#define T 1e-05", "#define T 1e-05f"),  # a number of the problem
        ("v <= 1e150 && w < -1e200", "v <= 1e18f && w < -1e18f"),
        ("/* double 1.0 */ int x1 = 3; // double", "/* double 1.0 */ int x1 = 3; // double"),
        ("typedef double car_seconds; /* of a clock */", "typedef double car_seconds; /* of a clock */"),
        ('scanf("%lf", to); printf("%.17g, 1.0");', 'scanf("%f", to); printf("%.9g, 1.0");'),
        ("t_sqrt(sqrt_of) + x.exp2", "t_sqrt(sqrt_of) + x.exp2"),
    ],
)
def test_what_becomes_of_c(double, wanted):
    assert single(double) == wanted


def test_what_has_no_single_precision_is_said():
    with pytest.raises(ParameterError, match=r"has steps in CasADi's own code.*take precision=\"double\""):
        projects(ALL_MODELS["single track, Radau"])
    with pytest.raises(ParameterError, match="the precision is 'half'; expected 'double' or 'single'"):
        as_precision(project_of(ALL_MODELS["bicycle"], "car", 3), "half")


@needs_compiler
def test_single_precision_takes_far_places_for_a_fault(tmp_path):
    """In UTM coordinates a float knows half a metre: no plan is made of that, and the header says from where on."""
    mpc, said = controller(3), {}
    for precision in ("double", "single"):
        export(mpc, tmp_path / precision, name="car", drive=2, precision=precision)
        said[precision] = (tmp_path / precision / "car.h").read_text()
    assert "[m], -65536 to 65536 */" in said["single"]
    assert "[m], -2e+07 to 2e+07 */" in said["double"]
    exported = Loaded({n: (tmp_path / "single" / n).read_text() for n in ("car.h", "car.c")}, kind=ctypes.c_float)
    path, x = double_lane_change(20.0), mpc.model.straight(20.0)
    wanted = mpc.reference(path.ahead(0.0, mpc.times))
    place = mpc.model.states.index("Y")
    for far, fault in ((6e4, False), (4.2e6, True)):
        there = np.array(x) + far * (np.arange(len(x)) == place)
        tracked = wanted.tracked + far * (np.array(mpc.references) == "Y")
        out = exported.plan(there, replace(wanted, tracked=tracked))
        assert (STATUSES[out.status] is Status.IMPLAUSIBLE) is fault
    own = replace(mpc, plausible={"Y": 50.0})
    export(own, tmp_path / "own", name="car", drive=2, precision="single")
    assert "[m], -50 to 50 */" in (tmp_path / "own" / "car.h").read_text()
