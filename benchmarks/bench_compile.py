"""How long a predictive controller takes to be compiled, and one that was built ahead of time to its first plan.

The thesis' front-drive car (8 states, implicit wheels, 10 stages), a dual track of 12 states (planar motion, four
wheels with loads that follow the accelerations and combined slip, pose, lagged steering and torque; implicit, 20
stages), and a car as `identify_car` finds it of hard laps (15 states: tires that relax and saturate, loads that shift,
steering late and lagged, pose; 20 explicit steps a sample, 20 stages). The exported plan is timed by a clock in C
around its call, beside what the solver that Python drives says of itself, at the same states of the drive that the
export recorded, in turn. Compiling is processor time of the compiler alone, the least of all rounds, with the flags in
use and with -O2 in turn, and what the plans of both take; loading is wall time from the folder that `slipangle build`
wrote to the first plan, checks of the library included, in a process that has the package loaded. The last rows are an
extended Kalman filter of that car, with its pose.
"""

from __future__ import annotations

import ctypes
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))  # a benchmark is found by its file, its test bed by its name

from benchmarks.bench_mpc import CAR

from slipangle.codegen import compiler
from slipangle.control.mpc import MPC
from slipangle.estimate.ekf import EKF
from slipangle.export import build, load
from slipangle.export.built_controller import BuiltController
from slipangle.models.custom import Ode
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_2
from slipangle.models.vehicles.load_transfer import LoadTransfer
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.models.vehicles.saturating_bicycle import RelaxingBicycle, SaturatingBicycleParams
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.ops import atan, cos, sin, sqrt
from slipangle.optimal.ocp import Reference
from slipangle.optimal.realtime.backend import RealTime
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths.lane_change import double_lane_change
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

ROUNDS, PLANS = 3, 400
STATES, STATE_ROUNDS = 200, 12
BOUNDS = {"front drive, 8 states": 4.0, "dual track, 12 states": 8.0, "identified car": 8.0}  # s
BOUNDS["filter of the identified car"] = 6.0
SIDES = ((1, 1), (1, -1), (-1, 1), (-1, -1))  # front or rear, left or right


def rates(x: Any, u: Any, p: Any) -> list[Any]:
    """Of a dual track: v_x, v_y, r, four wheels, X, Y, psi, steering and drive torque."""
    v_x, v_y, r, psi, delta, torque = x[0], x[1], x[2], x[9], x[10], x[11]
    l_r, a_y, a_x = p.wheelbase - p.l_f, v_x * r, torque / (p.radius * p.mass)
    X = Y = N = 0.0
    spins = []
    for i, (end, side) in enumerate(SIDES):
        along, across = (p.l_f if end > 0 else -l_r), 0.5 * side * p.track
        share = (l_r if end > 0 else p.l_f) / p.wheelbase
        load = 0.5 * p.mass * (GRAVITY * share - end * a_x * p.height / p.wheelbase)
        load = load - side * p.mass * a_y * p.height * share / p.track
        angle = delta if end > 0 else 0.0
        c, s = cos(angle), sin(angle)
        at_x, at_y = v_x - across * r, v_y + along * r
        roll = c * at_x + s * at_y
        rim = p.radius * x[3 + i]
        slip, aside = (rim - roll) / (roll + 0.5), (s * at_x - c * at_y) / (roll + 0.5)
        total = sqrt(slip * slip + aside * aside + 1e-6)
        grip = p.friction * load * sin(p.shape * atan(p.steepness * total)) / total
        F_x, F_y = grip * slip, grip * aside
        X, Y = X + c * F_x - s * F_y, Y + s * F_x + c * F_y
        N = N + along * (s * F_x + c * F_y) - across * (c * F_x - s * F_y)
        spins.append(((0.5 * torque if end > 0 else 0.0) - p.radius * F_x) / p.inertia_w)
    c, s = cos(psi), sin(psi)
    moved = [c * v_x - s * v_y, s * v_x + c * v_y, r]
    actuators = [(u[0] - delta) / 0.05, (u[1] - torque) / 0.1]
    return [X / p.mass + v_y * r, Y / p.mass - v_x * r, N / p.inertia_z, *spins, *moved, *actuators]


def dual_track() -> MPC:
    """The controller of the dual track."""
    numbers = {"mass": 1100.0, "inertia_z": 1800.0, "wheelbase": 2.6, "l_f": 1.15, "track": 1.4, "height": 0.5}
    numbers |= {"radius": 0.34, "inertia_w": 1.7, "friction": 1.0, "shape": 1.3, "steepness": 14.0}
    wheels = tuple(f"omega_{n}" for n in ("fl", "fr", "rl", "rr"))
    model = Ode(
        f=rates,
        states=("v_x", "v_y", "r", *wheels, "X", "Y", "psi", "delta", "T"),
        inputs=("delta_set", "T_set"),
        params=numbers,
        dt=0.05,
        method="radau",
    )
    return MPC(
        model,
        horizon=20,
        controls=("delta_set", "T_set"),
        Q=Weights(X=0.1, Y=1.0, psi=1.0, v_x=0.1),
        S=Weights(delta_set=50.0, T_set=1e-6),
        limits=Limits(delta_set=0.35, T_set=1500.0),
        solver=RealTime(),
    )


def identified() -> MPC:
    """A controller on the kind of model that is found of hard laps."""
    numbers = dict(mass=1000.0, inertia_z=800.0, wheelbase=2.4, l_f=1.3, C_f=6e4, C_r=1e5, mu_f=0.9, mu_r=1.0)
    params = SaturatingBicycleParams(**numbers, relaxation_f=0.4, relaxation_r=0.4)
    car = LoadTransfer(RelaxingBicycle(params=params, dt=0.05), height=0.4)
    return MPC(
        OnGround(Delayed(Steered(car, steering_lag=0.05), delays={"delta": 0.04})),
        horizon=20,
        controls=("delta",),
        Q=Weights(X=0.1, Y=1.0, psi=1.0),
        S=Weights(delta=50.0),
        limits=Limits(delta=0.35),
        solver=RealTime(),
    )


def front_drive() -> MPC:
    """The thesis' controller."""
    return CAR.controller(CAR.model(SOUSA_TABLE_6_2), 10, RealTime())


CARS = {"front drive, 8 states": front_drive, "dual track, 12 states": dual_track, "identified car": identified}


def bench(progress: Progress) -> Reproduction:
    """Compile times, and first plans."""
    found: list[Record] = []
    if compiler.compiler() is not None:
        for k, (name, made) in enumerate(CARS.items()):
            progress(k / len(CARS), name)
            found += _of(name, made())
        found += exported("front drive, 8 states", front_drive())
        found += filtered("filter of the identified car", identified().model)
    return Reproduction(
        title="Compiling controllers, and loading what was built",
        records=tuple(found),
        protocol=f"Processor time of the compiler, the least of {ROUNDS} rounds in turn; {PLANS} plans along ISO "
        f"3888-1 from states off the path, the least of five rounds in turn; {compiler.sentence()}.",
    )


def _of(name: str, mpc: MPC) -> list[Record]:
    seconds: dict[str, list[float]] = {"-O3": [], "-O2": []}
    plans: dict[str, np.ndarray] = {}
    loading: list[float] = []
    with tempfile.TemporaryDirectory() as scratch:
        for k in range(ROUNDS):
            for level, spent in seconds.items():
                folder = Path(scratch) / f"{level}{k}"
                with _flags(f"{level} -march=native"):
                    spent.append(_processor(lambda at=folder: build(mpc, at, drive=60)))
        for _ in range(5):
            begin = time.perf_counter()
            loaded = load(Path(scratch) / "-O30")
            _drive(loaded, mpc, 1)
            loading.append(time.perf_counter() - begin)
        built = {level: load(Path(scratch) / f"{level}0") for level in seconds}
        for _ in range(5):
            for level, one in built.items():
                took = _drive(one, mpc, PLANS)
                plans[level] = np.minimum(plans.get(level, took), took)
    slower = float(np.mean(plans["-O2"]) / np.mean(plans["-O3"]))
    return [
        Record.judged(name, "compiling [s]", None, min(seconds["-O3"]), at_most=BOUNDS[name]),
        Record.judged(name, "compiling with -O2 instead of -O3 [s]", None, min(seconds["-O2"])),
        Record.judged(name, "mean plan with -O2, over that with -O3", None, slower),
        Record.judged(name, "folder to first plan, median [ms]", None, 1e3 * median(loading), at_most=20.0),
    ]


TIMED = """#include <time.h>
double timed(void *plan, void *controller, void *input, void *output)
{
    struct timespec a, b;
    clock_gettime(CLOCK_MONOTONIC, &a);
    ((int (*)(void *, void *, void *))plan)(controller, input, output);
    clock_gettime(CLOCK_MONOTONIC, &b);
    return (double)(b.tv_sec - a.tv_sec) + 1e-9 * (double)(b.tv_nsec - a.tv_nsec);
}
"""


def exported(name: str, mpc: MPC) -> list[Record]:
    """Time of the exported plan over that of the solver inside Python, the least of all rounds at each state."""
    clock = compiler.library(TIMED, name="timed")
    with tempfile.TemporaryDirectory() as scratch:
        folder = build(mpc, Path(scratch) / "made", drive=STATES)
        one = load(folder)
        rows = np.loadtxt(folder / "drive.csv", delimiter=",", skiprows=1)
    if clock is None or not isinstance(one, BuiltController):
        return []
    x, tracked, exogenous = (one._arrays[k] for k in ("x", "tracked", "exogenous"))
    ends = np.cumsum([x.size, tracked.size, exogenous.size])
    outside, inside = np.full(len(rows), np.inf), np.full(len(rows), np.inf)
    call = ctypes.cast(one._plan, ctypes.c_void_p).value
    for _ in range(STATE_ROUNDS):
        one._begin()
        plan = None
        for k, row in enumerate(rows):
            for part, to in zip(np.split(row[: ends[-1]], ends[:-1]), (x, tracked, exogenous), strict=True):
                to[...] = part.reshape(to.shape)
            one._given.applied_known = 0
            given = (one._memory.ctypes.data, ctypes.addressof(one._given), ctypes.addressof(one._out))
            outside[k] = min(outside[k], clock.timed(call, *given))
        for k, row in enumerate(rows):
            a, b, c = np.split(row[: ends[-1]], ends[:-1])
            reference = Reference(tracked=b.reshape(tracked.shape), exogenous=c.reshape(exogenous.shape))
            plan = mpc.plan(a, reference, plan)
            inside[k] = min(inside[k], mpc.engine.timing.total)
    ratio, p99 = np.median(outside) / np.median(inside), [1e6 * np.percentile(t, 99) for t in (outside, inside)]
    note = f"{1e6 * np.median(outside):.1f} and {1e6 * np.median(inside):.1f} us, p99 {p99[0]:.0f} and {p99[1]:.0f} us"
    return [Record.judged(name, "exported plan over that in Python's process", None, ratio, at_most=1.05, note=note)]


def filtered(name: str, model: Any) -> list[Record]:
    """An `EKF` of a model as C: its size, how long it takes to be compiled, and a sample in Python."""
    noise = dict.fromkeys(model.outputs, 0.01)
    settings = EKF(start=model, noise_std=noise, process_std={"v_y": 0.1, "r": 0.05})
    with tempfile.TemporaryDirectory() as scratch:
        folder = settings.export(Path(scratch) / "made", name="car", drive=3)
        size = (folder / "car.c").stat().st_size
        call = [*(compiler.compiler() or ()), "-O2", "-march=native", "-c", "car.c", "-o", "car.o"]
        spent = min(_processor(lambda: subprocess.run(call, cwd=folder, check=True)) for _ in range(ROUNDS))
    tracker, took = settings.start_at(np.array(model.straight(15.0))), []
    y, u = np.zeros(model.n_outputs), np.array([15.0 if n == "v_x" else 0.0 for n in model.inputs])
    for _ in range(STATES):
        begin = time.perf_counter()
        tracker.update(y, u)
        took.append(time.perf_counter() - begin)
    return [
        Record.judged(name, "C [kB]", None, size / 1e3, at_most=600.0),
        Record.judged(name, "compiling with -O2 [s]", None, spent, at_most=BOUNDS[name]),
        Record.judged(name, "a sample in Python, least [us]", None, 1e6 * min(took)),
    ]


@contextmanager
def _flags(text: str) -> Iterator[None]:
    before = os.environ.get("SLIPANGLE_CFLAGS")
    os.environ["SLIPANGLE_CFLAGS"] = text
    try:
        yield
    finally:
        os.environ.pop("SLIPANGLE_CFLAGS")
        if before is not None:
            os.environ["SLIPANGLE_CFLAGS"] = before


def _processor(what: Callable[[], object]) -> float:
    """Processor time of the processes that it starts. [s]"""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    what()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _drive(one: Any, mpc: MPC, steps: int) -> np.ndarray:
    """Time of each plan along a lane change, at the states that the path wants. [s]"""
    path, took, plan = double_lane_change(15.0), [], None
    states = list(mpc.model.states)
    for k in range(steps):
        preview = path.ahead(0.2 * k % path.length, mpc.times)
        x = np.array(mpc.model.straight(15.0))
        x[[i for i, n in enumerate(states) if n.startswith("omega")]] = 15.0 / 0.34
        for n, v in (("X", preview.X[0]), ("Y", preview.Y[0] + 0.2 * np.sin(k)), ("psi", preview.psi[0])):
            x[states.index(n)] = v
        plan = one.plan(x, one.reference(preview, **dict.fromkeys(one.exogenous, 0.0)), plan)
        took.append(plan.seconds)
    return np.array(took)
