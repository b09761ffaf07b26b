"""An exported driver takes in what the one in Python does and wants the same, whatever it is told, on any machine."""

import ctypes
import math

import numpy as np
import pytest

from slipangle.codegen import compiler
from slipangle.control.commands import UNSURE
from slipangle.control.default_drive import default_controller, default_estimator, driven_model
from slipangle.control.driver import Driver
from slipangle.control.followers.compensated import Compensated
from slipangle.control.followers.followers import Stanley
from slipangle.control.speed.driver import SpeedDriver
from slipangle.errors import ParameterError
from slipangle.export.drivers import DriverRecorder, channels
from slipangle.export.kinds import project_of
from slipangle.models.vehicles.aided import RearSteered, TorqueVectored
from slipangle.models.vehicles.banked import Banked
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.vehicles.load_transfer import LoadTransfer
from slipangle.models.vehicles.saturating_bicycle import SaturatingBicycle, SaturatingBicycleParams
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from slipangle.optimal.terms import Values, Weights
from slipangle.paths.lane_change import double_lane_change
from slipangle.paths.path import Path
from slipangle.simulate.drive import drive
from slipangle.simulate.plant import Plant
from tests.export.loaded import Health, defines, given_and_made, of_kind, same
from tests.export.tools import MACHINES, STRICT, needs, repeated_on, run

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
KNOWN = Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("r",))
AROUND = {"delta_r": 0.02, "M_z": 600.0, "bank": 0.04}  # largest of what else may be measured
LAGGED = Delayed(Steered(KNOWN, steering_lag=0.05), delays={"delta": 0.02}, longest=0.04)
SHORT = SaturatingBicycleParams(mass=900.0, inertia_z=900.0, wheelbase=2.0, l_f=0.95, C_f=7e4, C_r=8e4, mu_f=0.9)
SATURATING = Steered(SaturatingBicycle(params=SHORT, dt=0.02, outputs=("r",)), steering_lag=0.05)
NOISE = {"r": 0.002, "X": 0.02, "Y": 0.02, "psi": 0.001}
LATE = dict.fromkeys(("X", "Y", "psi"), 0.1)
PEDALS = SpeedDriver(
    kp=(800.0, 900.0),
    ki=(200.0, 300.0),
    speeds=(5.0, 20.0),
    limits=(-3000.0, 1500.0),
    feedforward=600.0,
    drive=Values(T_f=1.0, T_r=0.5),
    brake=Values(T_f=0.6, T_b=0.4),
)
REASONS = ("", "speed is not known", "stands or creeps", "pose is not known", *UNSURE)


def circle():
    angle = np.linspace(0.0, 2 * np.pi, 121)
    radius = 40.0 + 5.0 * np.cos(2 * angle)
    return Path.from_points(radius * np.cos(angle), radius * np.sin(angle), closed=True).with_speed_limits(
        v_max=20.0, a_y=5.0, a_x=2.0
    )


def driver(path, model=KNOWN, horizon=None, Q=None, **more):
    """One that plans fewer stages than by default compiles sooner; ``Q`` are other weights of its errors."""
    whole = driven_model(model, 0.02)
    controller = default_controller(whole)
    if horizon:
        controller = type(controller)(
            whole,
            horizon=horizon,
            controls=("delta",),
            Q=Q or controller.ocp.Q,
            S=controller.ocp.S,
            limits=controller.ocp.limits,
            rates=controller.ocp.rates,
        )
    late = more.pop("late", {})
    return Driver(model, path, controller=controller, estimator=default_estimator(whole, NOISE, late), **more)


class LoadedDriver:
    """A driver exported under the name ``car``, called as a program in C would call it."""

    def __init__(self, project, folder, kind=ctypes.c_double):
        def array(*lengths):
            return of_kind(*lengths, kind=kind)

        files = project.everything
        self.header, self.kind = files["car.h"], kind
        for name, text in files.items():
            (folder / name).write_text(text)
        flags = (*project.flags, *compiler._levels()[0], "-shared", "-fPIC", "-std=gnu11")
        made = f"all{compiler.SUFFIX}"
        run(*compiler.compiler(), *flags, "-o", made, *project.sources, "-lm", folder=folder)
        self.library = ctypes.CDLL(str(folder / made))
        n, inner = defines(files["car.h"]), defines(files["car_planner.h"], "CAR_PLANNER")
        self.Measured = type(
            "Measured", (ctypes.Structure,), {"_fields_": [("t", ctypes.c_double), ("value", array(n["CHANNELS"]))]}
        )
        listed = [("value", array(n["COMMANDS"])), *((k, kind) for k in ("wanted_v_x", "s", "e_y"))]
        listed += [("state", array(n["STATES"])), ("state_std", array(n["STATES"])), ("age", array(n["OUTPUTS"]))]
        listed += [("restarts", ctypes.c_int64)]
        listed += [(k, ctypes.c_int) for k in ("reason", "planned", "status", "plan_age", "stopping")]
        self.Commands = type("Commands", (ctypes.Structure,), {"_fields_": [*listed, ("health", Health)]})
        _, self.Plan = given_and_made(inner, kind)
        self.library.car_last_plan.restype = ctypes.POINTER(self.Plan)
        self.bytes = n["BYTES"] + 4_000_000
        self.memory = np.zeros(self.bytes + 64, dtype=np.uint8)
        self.at = ctypes.c_void_p(self.memory.ctypes.data + -self.memory.ctypes.data % 64)
        self.start()

    def start(self):
        assert self.library.car_start(self.at, ctypes.c_size_t(self.bytes)) == 0

    def step(self, told, t):
        given, out = self.Measured(t=t), self.Commands()
        given.value[:] = told
        code = self.library.car_step(self.at, ctypes.byref(given), ctypes.byref(out))
        return code, out, self.library.car_last_plan(self.at).contents


def alike(out, plan, said, whole):
    """Whether what C wants is what Python does, to the last bit."""
    ages = [said.age.get(n, math.nan) for n in whole.controller.model.outputs]
    listed = [
        (out.value, [said[n] for n in whole.controls]),
        ([out.wanted_v_x, out.s, out.e_y], [said.wanted_v_x, said.s, said.e_y]),
        (out.state, said.state),
        (out.state_std, said.state_std),
        (out.age, ages),
    ]
    good = all(np.array_equal(np.array(a), np.array(b), equal_nan=True) for a, b in listed)
    good &= out.restarts == said.restarts and bool(out.planned) == (said.plan is not None)
    good &= REASONS[out.reason] in said.message
    return good and (said.plan is None or (same(plan, said.plan) and out.plan_age == said.plan.age))


def told_by(plant, x, t, k, rng):
    """Measurements at a call: slow, missing, held, wild; v_x is wrong, then gone, then slow for a while."""
    true = dict(zip(plant.states, x.tolist(), strict=True))
    told = {"r": true["r"] + 0.002 * rng.normal(), "v_x": 20.0 + 0.02 * rng.normal()}
    if k % 5 == 0:
        told |= {n: true[n] + 0.01 * rng.normal() for n in ("X", "Y", "psi")}
    told = {n: v for n, v in told.items() if rng.uniform() > 0.1}
    if rng.uniform() < 0.1:
        told[str(rng.choice(("X", "Y", "psi", "r", "v_x")))] = float(
            rng.choice([np.nan, np.inf, 1e300, 5.0, -1e8, 0.0])
        )
    if 150 < k < 160:
        told["v_x"] = 0.5 + 1e-3 * k
    return told


VARIANTS = {
    "plain": lambda: driver(double_lane_change(20.0), horizon=6),
    "late, lagged, pedals": lambda: Driver(LAGGED, circle(), noise=NOISE, late=LATE, speed=PEDALS),
    "rear wheels, moment, bank": lambda: driver(
        double_lane_change(20.0), Banked(TorqueVectored(RearSteered(KNOWN))), 6, Weights(e_y=1.0, e_psi=10.0)
    ),
    "shifting loads, saturating": lambda: driver(double_lane_change(20.0), LoadTransfer(SATURATING, height=0.5)),
    "short, saturating": lambda: driver(double_lane_change(20.0), SATURATING, speed=PEDALS),
}
EACH = pytest.mark.parametrize(
    "variant", [pytest.param(n, marks=() if "," not in n or "bank" in n else pytest.mark.slow) for n in VARIANTS]
)


@needs_compiler
@EACH
def test_same_as_python_to_the_last_bit_whatever_it_is_told(variant, tmp_path, monkeypatch):
    """In closed loop with itself; gaps of half a second and of two, wild numbers, a car that stops."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", f"-O{variant == 'plain':d} -march=native")
    whole, rng, seen = VARIANTS[variant](), np.random.default_rng(3), set()
    exported = LoadedDriver(project_of(whole, "car", 4), tmp_path)
    model, names = whole.controller.model, channels(whole)
    x = np.array(model.straight(20.0))
    for n, v in zip(("X", "Y", "psi"), whole.path.start, strict=True):
        x[model.states.index(n)] = v
    t = 0.0
    for k in range(460):
        told = told_by(model, x, t, k, rng) if k > 3 or k == 1 else {"r": 0.0} if k == 0 else {"v_x": 20.0 + 1e-3 * k}
        around = {n: AROUND[n] * math.sin(3.0 * t + len(n)) for n in model.inputs if n in AROUND}
        told |= {n: v for n, v in around.items() if k % 7}
        if 300 < k:
            told = {n: v for n, v in told.items() if n not in ("X", "Y", "psi")}
        said = whole.step(told, t)
        code, out, plan = exported.step([told.get(n, math.nan) for n in names], t)
        assert code == 0
        assert alike(out, plan, said, whole), (k, said.message)
        seen.add(out.reason)
        u = np.array([said["delta"] if n == "delta" else around.get(n, 20.0) for n in model.inputs])
        x = np.asarray(model.step(x, u))
        t += {100: 0.5, 200: 2.0}.get(k, 0.8 if k > 330 else 0.02 if k % 3 else 0.01)
    assert exported.step([math.nan] * len(names), t - 1.0)[0] == 3
    assert exported.step([math.nan] * len(names), math.nan)[0] == 3
    assert seen - {7, 9, 10, 11} == {0, 1, 2, 3, 4}  # and, by wild numbers, headings, facing away, far beside
    whole.reset()
    exported.start()
    told = {"X": 0.0, "Y": 0.1, "psi": 0.0, "v_x": 20.0, "r": 0.0}
    code, out, plan = exported.step([told.get(n, math.nan) for n in names], 5.0)
    assert alike(out, plan, whole.step(told, 5.0), whole)


@needs_compiler
def test_same_as_python_where_the_car_should_stop(tmp_path, monkeypatch):
    """Headings from -pi to pi, a speed that is lost, then stuck, negative, and the end of the path."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0 -march=native")
    path = Path.from_points(np.linspace(0.0, -160.0, 80), np.zeros(80)).with_speed(15.0)
    pedals = SpeedDriver(kp=800.0, ki=200.0, limits=(-3000.0, 1500.0), drive=Values(T_f=1.0), brake=Values(T_f=1.0))
    whole, seen, rng = driver(path, horizon=6, speed=pedals), [], np.random.default_rng(2)
    exported, names = LoadedDriver(project_of(whole, "car", 1), tmp_path), channels(whole)
    X, turned = 0.0, 0
    for k in range(800):
        t = 0.02 * k
        X -= 0.02 * (22.0 if 350 <= k < 500 else 15.0)
        psi = math.remainder(math.pi + 0.01 * rng.normal(), 2 * math.pi)
        turned += psi < 0
        told = {"X": X, "Y": 0.1 * rng.normal(), "psi": psi, "r": 0.002 * rng.normal(), "v_x": 15.0 + 1e-9 * k}
        if 100 <= k < 180:
            del told["v_x"]
        if 350 <= k < 500:
            told["v_x"] = 15.0
        if k >= 700:
            told["v_x"] = -2.0 - 1e-3 * k
        said = whole.step(told, t)
        _, out, plan = exported.step([told.get(n, math.nan) for n in names], t)
        assert alike(out, plan, said, whole), (k, said.message)
        assert out.wanted_v_x == (0.0 if out.reason else 15.0)
        assert out.value[1] <= 0 or not out.reason or k < 50
        seen.append(out.reason)
    assert 100 < turned < 700
    assert {5, 6, 8} <= {*seen}
    assert {*seen[:100]} == {0}
    assert {*seen[152:180]} == {5}
    whole.reset()
    exported.start()
    away = [*np.linspace(0.0, 24.0, 120), *np.linspace(24.0, 14.0, 80), *np.linspace(14.0, 5.0, 60)]
    seen = []
    for k, e_y in enumerate(away):  # far beside, farther, back
        told = {"X": -0.3 * k, "Y": -e_y, "psi": math.pi, "r": 0.002 * rng.normal(), "v_x": 15.0 + 1e-9 * k}
        said = whole.step(told, 0.02 * k)
        _, out, plan = exported.step([told.get(n, math.nan) for n in names], 0.02 * k)
        assert alike(out, plan, said, whole), (k, said.message)
        seen.append(out.reason)
    assert [r for r, before in zip(seen, [-1, *seen], strict=False) if r != before] == [0, 11, 10, 11, 0]
    whole.reset()
    exported.start()
    X, Y, seen = 0.0, 0.0, []
    for k in range(800):  # it swings to and fro, by a yaw rate of the wrong sign for six seconds
        t = 0.02 * k
        psi, rate = math.pi + 0.8 * math.sin(0.8 * t), 0.64 * math.cos(0.8 * t)
        X, Y = X + 0.08 * math.cos(psi), Y + 0.08 * math.sin(psi)
        told = {"X": X, "Y": Y, "psi": psi, "r": rate if k > 300 else -rate, "v_x": 4.0 + 1e-9 * k}
        said = whole.step(told, 0.02 * k)
        _, out, plan = exported.step([told.get(n, math.nan) for n in names], 0.02 * k)
        assert alike(out, plan, said, whole), (k, said.message)
        seen.append(out.reason)
    assert [r for r, before in zip(seen, [-1, *seen], strict=False) if r != before] == [0, 7, 0]


@pytest.mark.parametrize(("east", "near"), [pytest.param(0.0, True, marks=pytest.mark.slow), (4e4, True), (5e5, False)])
def test_single_precision_refuses_a_path_far_from_the_origin(east, near, tmp_path, monkeypatch):
    """As one in UTM coordinates, where neighbouring numbers are centimetres apart."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0 -march=native")
    path = Path.from_points(east + np.linspace(0.0, 160.0, 80), np.zeros(80)).with_speed(15.0)
    whole = driver(path, horizon=6)
    whole.export(tmp_path / "double", name="car", drive=2)
    if near:
        whole.export(tmp_path / "single", name="car", drive=2, precision="single")
        return
    with pytest.raises(ParameterError, match=r"up to 5e\+05 m from the origin, where numbers .* are 0\.031 m"):
        whole.export(tmp_path / "single", name="car", drive=2, precision="single")
    assert not (tmp_path / "single").exists()


@needs_compiler
def test_an_estimate_that_runs_away_starts_anew(tmp_path, monkeypatch):
    """Side slip of kilometres a second, from poses that are believed for want of a gate."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0 -march=native")
    path = double_lane_change(20.0)
    whole = driver(path, horizon=6)
    wild = type(whole.estimator)(
        start=whole.estimator.model, noise_std=NOISE, process_std={"v_y": 1e4}, state_std={"v_y": 1e3}, gate=None
    )
    whole = Driver(KNOWN, path, controller=whole.controller, estimator=wild)
    exported, names, rng = (
        LoadedDriver(project_of(whole, "car", 1), tmp_path),
        channels(whole),
        np.random.default_rng(1),
    )
    for k in range(40):
        told = {
            "X": 0.4 * k,
            "Y": 100.0 * rng.normal(),
            "psi": 0.01 * rng.normal(),
            "v_x": 20.0,
            "r": 0.3 * rng.normal(),
        }
        said = whole.step(told, 0.02 * k)
        _, out, plan = exported.step([told.get(n, math.nan) for n in names], 0.02 * k)
        assert alike(out, plan, said, whole), k
    assert out.restarts > 0


@needs_compiler
@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
@pytest.mark.parametrize("variant", [pytest.param(n, marks=[pytest.mark.slow] * ("bank" not in n)) for n in VARIANTS])
def test_compilers_have_nothing_to_say(variant, compiler_, tmp_path):
    needs(compiler_)
    made = project_of(VARIANTS[variant](), "racer", 2).everything
    for name, content in made.items():
        (tmp_path / name).write_text(content)
    for name in ("racer.c", "racer_planner.c", "main.c"):
        run(compiler_, *STRICT, "-O1", "-fsyntax-only", name, folder=tmp_path)
    if compiler_ == "gcc":
        needs("g++")
        (tmp_path / "use.cpp").write_text(
            '#include "racer.hpp"\nint main() { racer::Driver d; return d.step({}).planned; }'
        )
        run("g++", "-std=c++17", *STRICT[1:], "-fsyntax-only", "use.cpp", folder=tmp_path)


@needs_compiler
def test_a_drive_is_recorded_and_what_has_no_c_is_said(monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0 -march=native")
    whole = driver(double_lane_change(20.0), horizon=6)
    recorder, model = DriverRecorder(whole), Bicycle(params=SOUSA_TABLE_7_2, dt=0.002, outputs=("v_y", "r"))
    with pytest.raises(ParameterError, match="nothing has been recorded"):
        _ = recorder.drive
    from slipangle.models.wrappers.on_ground import OnGround

    drive(Plant(OnGround(model)), recorder, duration=0.3, channels=("r", "v_x", "X", "Y", "psi"))
    made = project_of(whole, "", recorder.drive)
    assert (made.name, made.drive.count("\n")) == ("driver", 32)

    class Own(Driver):
        def step(self, measurements, t):
            return super().step(measurements, t)

    law = Compensated(follower=Stanley(params=SOUSA_TABLE_7_2, dt=0.02), car=KNOWN)
    with pytest.raises(ParameterError, match="a Compensated in the driver has no C; expected a plain MPC"):
        project_of(Driver(KNOWN, whole.path, controller=law, noise=NOISE), "", 2)
    with pytest.raises(ParameterError, match="a Own in the driver has no C; expected a plain Driver"):
        project_of(Own(KNOWN, whole.path, controller=whole.controller, estimator=whole.estimator), "", 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_two_thousand_calls_on_every_machine(name, tmp_path):
    """The same commands to 1e-10 from every compiler and processor."""
    needs()
    made = project_of(driver(circle(), LAGGED, late=LATE, speed=PEDALS), "car", 2000)
    said, wanted = repeated_on(name, made, tmp_path)
    assert np.abs(wanted[:, 0]).max() > 0.02
    assert (np.abs(said - wanted) / (1 + np.abs(wanted))).max() <= 1e-10
