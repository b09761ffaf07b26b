"""Closed loops beside their parts: what `closed_loop` takes above the plant's steps and the controller's plans.

Dual-track BMW 320i at one millisecond with sensor noise, ISO 3888-1 at 20 m/s, predictive control at 20 Hz, horizon 20,
a speed driver at 100 Hz. The parts are the same number of steps of the compiled plant, ten at a time, and of `MPC.plan`
calls, all through Python; the loop's own share is projection, look ahead, noise, driver and record. Wall time of whole
drives, one thread, in turn, the least of all rounds.

Then the same car with a `Driver` that was built (20 ms between plans): the loop in C, and the one in Python around the
same library. Its parts are the plant's steps in one call, and the driver's steps with a plan, as the loop in C timed
them.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from slipangle.codegen import compiler
from slipangle.control.driver import Driver
from slipangle.control.mpc import MPC
from slipangle.control.speed.pedals import pedal_driver
from slipangle.export import build, load
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import BMW_320I, PASSENGER_TIRE
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Limits, Values, Weights
from slipangle.paths.lane_change import double_lane_change
from slipangle.paths.path import Path
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.simulate.drive import drive as drive_by
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import Run

ROUNDS, CALLS = 15, 100
P = BMW_320I
CAR = DualTrack(params=P, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001)
PLANT = Plant(CAR, noise=Values(r=0.002, v_y=0.02, v_x=0.02, X=0.01, Y=0.01, psi=0.001))
STIFFNESS = 21.92 * P.mass * GRAVITY / P.wheelbase
BICYCLE = BicycleParams(
    **{n: getattr(P, n) for n in ("mass", "inertia_z", "wheelbase", "l_f")},
    C_f=STIFFNESS * P.l_r,
    C_r=STIFFNESS * P.l_f,
)


def bench(progress: Progress) -> Reproduction:
    """Time of drives, of their parts, and of what is asked of a path."""
    mpc = MPC(
        OnGround(Bicycle(params=BICYCLE, dt=0.05, outputs=("v_y", "r"))),
        horizon=20,
        controls=("delta",),
        Q=Weights(X=0.1, Y=1.0, psi=1.0),
        S=Weights(delta=50.0),
        limits=Limits(delta=0.35),
    )
    path, driver = double_lane_change(20.0), pedal_driver(P)
    plain = replace(path)
    vars(plain)["line"] = None  # NumPy, as without a compiler

    def drive(on: Path) -> Run:
        return closed_loop(PLANT, mpc, on, driver=driver)

    run = drive(path)
    jobs: dict[str, Callable[[], object]] = {
        "drive, compiled path": lambda: drive(path),
        "drive, path in NumPy": lambda: drive(plain),
        "plant alone": lambda: _plant(len(run.t)),
        "plans alone": lambda: _plans(mpc, run, path),
    }
    least = dict.fromkeys(jobs, np.inf)
    for i in range(ROUNDS):
        for name, job in jobs.items():
            progress((i + 0.5) / ROUNDS, f"{name}, round {i + 1}")
            began = time.perf_counter()
            job()
            least[name] = min(least[name], time.perf_counter() - began)
    parts = least["plant alone"] + least["plans alone"]
    ratio = least["drive, compiled path"] / parts
    plainly = least["drive, path in NumPy"] / parts
    records = [
        Record(row=name, quantity="wall time of one drive [ms]", thesis=None, here=1000 * seconds)
        for name, seconds in least.items()
    ]
    records.append(
        Record(
            row="drive over plant and plans",
            quantity="ratio of wall times",
            thesis=None,
            here=ratio,
            bound="<= 3",
            holds=ratio <= 3,
            note=f"{len(run.t)} samples, {len(run.plans)} plans; path in NumPy {plainly:.3g}",
        )
    )
    gap = max(float(np.abs(getattr(run, n) - getattr(drive(plain), n)).max()) for n in ("states", "e_y", "commands"))
    records.append(
        Record(
            row="compiled path and NumPy",
            quantity="largest difference of a state, error or command over the drive",
            thesis=None,
            here=gap,
            bound="<= 1e-9",
            holds=gap <= 1e-9,
        )
    )
    records += [_call(name, call(path), call(plain)) for name, call in ASKED.items()]
    if compiler.compiler() is not None:
        records += _built(progress, path)
    return Reproduction(
        title="Closed loop beside its parts",
        records=tuple(records),
        protocol=f"ISO 3888-1 at 20 m/s; least wall time of {ROUNDS} rounds in turn, one thread; calls: least of "
        f"{ROUNDS} rounds of {CALLS}.",
    )


def _built(progress: Progress, path: Path) -> list[Record]:
    """A driver that was built, in a loop that is compiled too and in one that is not."""
    progress(1.0, "compiling a driver")
    model = Bicycle(params=BICYCLE, dt=0.02, outputs=("r",))
    driver = Driver(model, path, speed=pedal_driver(P), noise={"r": 0.002, "X": 0.01, "Y": 0.01, "psi": 0.001})
    with tempfile.TemporaryDirectory() as folder:
        loaded = load(build(driver, f"{folder}/pilot", drive=100))
        ours, python, gap = np.inf, np.inf, 0.0
        planning = plant = np.inf
        for _ in range(ROUNDS):
            began = time.perf_counter()
            run = drive_by(PLANT, loaded)
            ours = min(ours, time.perf_counter() - began)
            planning = min(planning, sum(plan.seconds for plan in run.plans))
            began = time.perf_counter()
            other = drive_by(PLANT, loaded, watch=lambda *_: None)
            python = min(python, time.perf_counter() - began)
            gap = max(float(np.abs(getattr(run, n) - getattr(other, n)).max()) for n in ("states", "e_y", "commands"))
            if CAR.steps is not None:
                u = np.tile([0.001, 0.1, 0.0], (10 * len(run.t), 1))
                began = time.perf_counter()
                CAR.steps.run(PLANT.straight(20.0), u)
                plant = min(plant, time.perf_counter() - began)
    row, ratio = "built driver, loop in C", ours / (plant + planning)
    listed = {"": ours, ", loop in Python": python, ", plant alone": plant, ", steps with a plan alone": planning}
    records = [
        Record(row=f"built driver{n}" if n else row, quantity="wall time of one drive [ms]", thesis=None, here=1000 * t)
        for n, t in listed.items()
    ]
    note = f"{len(run.t)} samples, {len(run.plans)} plans; the loop in Python {python / (plant + planning):.3g}"
    return [
        *records,
        Record(
            row=row,
            quantity="ratio of wall times over plant and plans",
            thesis=None,
            here=ratio,
            bound="<= 3",
            holds=ratio <= 3,
            note=note,
        ),
        Record(
            row=row,
            quantity="largest difference of a state, error or command from the loop in Python",
            thesis=None,
            here=gap,
            bound="<= 1e-9",
            holds=gap <= 1e-9,
        ),
    ]


TIMES = 0.05 * np.arange(21)
ASKED: dict[str, Callable[[Path], Callable[[], object]]] = {
    "Path.project": lambda path: lambda: path.project(50.0, 1.0, 80.0),
    "Path.ahead, 21 rows": lambda path: lambda: path.ahead(70.0, TIMES, v_x=19.0),
}


def _call(name: str, *both: Callable[[], object]) -> Record:
    spent = []
    for call in both:
        least = np.inf
        for _ in range(ROUNDS):
            began = time.perf_counter()
            for _ in range(CALLS):
                call()
            least = min(least, (time.perf_counter() - began) / (CALLS))
        spent.append(1e6 * least)
    note = f"in NumPy {spent[1]:.3g}"
    return Record(row=name, quantity="time of a call through Python [us]", thesis=None, here=spent[0], note=note)


def _plant(samples: int) -> None:
    """As many samples of ten steps as a drive has."""
    kernel, x, u = CAR.steps, PLANT.straight(20.0), np.tile([0.001, 0.1, 0.0], (10, 1))
    step = CAR.functions[0].mapaccum("many", 10)
    for _ in range(samples):
        if kernel is not None:
            kernel.run(x, u)
        else:
            step(x, u.T)


def _plans(mpc: MPC, run: Run, path: Path) -> None:
    """The drive's plans again, from the states that it went through."""
    every = round(mpc.dt / (run.t[1] - run.t[0]))
    rows = [run.state_names.index(n) for n in ("v_y", "r", "X", "Y", "psi")]
    preview, plan = path.ahead(50.0, mpc.times, v_x=20.0), None
    wanted = mpc.reference(preview)
    for x in run.states[::every, rows]:
        plan = mpc.plan(x, wanted, plan)
