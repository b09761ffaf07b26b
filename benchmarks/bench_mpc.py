"""Predictive control of the thesis' front-drive car on a double lane change: time of one plan.

Same problem (tables 6.1 to 6.3, eq. 6-3, steps of 0.1 s), same drive, one thread, warm, every candidate in turn.
Inside C: monotonic clock around the whole solve. Through Python: process and wall time of ``MPC.plan``.

Beside ours, where they are installed (``pip install --group bench``): do-mpc, crocoddyl and fatrop (as CasADi ships it)
on the whole problem, converged to 1e-8 against our plans converged to 1e-8, and one iteration against one. And on the
quadratic programs of our real-time iterations, taken from our solver: OSQP, PIQP, Clarabel, DAQP, ProxQP, and HPIPM as
CasADi ships it, in the forms that suit them, those of two longer problems of the benchmark ``horizon`` too. Each is set
up once, has a tolerance of 1e-8, absolute and relative, and starts warm where it can; counted is the call that hands it
new matrices and vectors and solves; the least of the rounds for each program. A time counts only if the answer is ours:
the first input to 1e-4 of half its range, the cost to 1e-5.
"""

from __future__ import annotations

import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))  # a benchmark is found by its file, its peers by their name

from benchmarks.bench_horizon import chain, push, race, race_car
from benchmarks.peers.compare import compared
from benchmarks.peers.controllers import Outcome, crocoddyl, do_mpc, fatrop, problems
from benchmarks.peers.programs import Drive, Driven
from benchmarks.thesis_car import CAR, PATH, drive

from slipangle.control.mpc import MPC
from slipangle.errors import ModelWarning
from slipangle.models.tires.neural import NeuralTire
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from slipangle.models.vehicles.quasi_steady import QuasiSteadySingleTrack
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.engine import CompiledEngine
from slipangle.optimal.terms import Limits, Weights
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._chapter_6 import thesis_way
from slipangle.reproduce._tires_6 import simulated_tires
from slipangle.reproduce.table_6_4 import data, settings

ROUNDS, STEPS = 10, 60  # 600 plans of each
PEERS = (("do-mpc", do_mpc, 100), ("fatrop", fatrop, None), ("crocoddyl", crocoddyl, None))

Candidate = tuple[str, MPC, Callable[[np.ndarray], np.ndarray]]


class Times:
    """Samples of one candidate. [s]"""

    def __init__(self) -> None:
        self.inside: list[float] = []
        self.process: list[float] = []
        self.wall: list[float] = []
        self.e_y: list[float] = []

    def median(self, what: str) -> float:
        """Of one kind of time."""
        return float(np.median(getattr(self, what)))

    def p99(self, what: str) -> float:
        """Of one kind of time."""
        return float(np.percentile(getattr(self, what), 99))


def situations(mpc: MPC, choose: Callable[[np.ndarray], np.ndarray], times: Times, steps: int) -> None:
    """One drive on the full model; every plan is timed."""
    plant = CAR.model(SOUSA_TABLE_6_2).functions[0]
    x, plan, s = CAR.model(SOUSA_TABLE_6_2).straight(19.0, X=PATH.start[0]), None, 0.0
    for k in range(steps):
        foot = PATH.project(x[5], x[6], s)
        s = foot.s
        times.e_y.append(foot.e_y)
        reference = mpc.reference(PATH.ahead(s, mpc.times), T_r=0.0)
        wall, process = time.perf_counter(), time.process_time()
        plan = mpc.plan(choose(x), reference, plan)
        spent = time.process_time() - process, time.perf_counter() - wall
        if k >= 2:
            times.process.append(spent[0])
            times.wall.append(spent[1])
            if isinstance(mpc.engine, CompiledEngine):
                times.inside.append(mpc.engine.timing.total)
        x = np.asarray(plant(x, [*plan.command, 0.0])).ravel()


def candidates() -> Iterator[Candidate]:
    """Name, controller, and which of the eight states it knows."""

    def whole(x: np.ndarray) -> np.ndarray:
        return x

    pacejka, neural = SOUSA_TABLE_6_2, simulated_tires()[1]["Neural"]
    longitudinal, lateral = data()
    rbf = settings("RBF {4}")
    radial = NeuralTire(longitudinal=rbf.fit(*longitudinal), lateral=rbf.fit(*lateral))
    yield "8 states, N = 10", CAR.controller(CAR.model(pacejka), 10, RealTime()), whole
    yield "8 states, N = 15", CAR.controller(CAR.model(pacejka), 15, RealTime()), whole
    yield "8 states, N = 10, MLP {2 2}", CAR.controller(CAR.model(neural), 10, RealTime()), whole
    yield "8 states, N = 10, RBF {4}", CAR.controller(CAR.model(radial), 10, RealTime()), whole
    quasi = QuasiSteadySingleTrack(params=SOUSA_TABLE_6_1, dt=0.1, tire_f=pacejka, tire_r=pacejka)
    keep = [0, 1, 2, 5, 6, 7]
    yield "quasi-steady wheels, N = 10", CAR.controller(quasi, 10, RealTime()), lambda x: x[keep]
    base = CAR.controller(replace(CAR.model(pacejka), outputs=("alpha_f", "alpha_r")), 20, RealTime())
    soft = ("alpha_f", "alpha_r", "r", "e_y")
    envelope = replace(
        base,
        limits=Limits(**base.ocp.limits, alpha_f=0.02, alpha_r=0.02, r=0.15),
        slack=Weights(**dict.fromkeys(soft, 1e5)),
        slack_linear=Weights(**dict.fromkeys(soft, 1e3)),
        corridor=1.8,
    )
    yield f"8 states, N = 20, {SOFT}", envelope, whole
    yield "8 states, N = 22", CAR.controller(CAR.model(pacejka), 22, RealTime()), whole
    few = CAR.controller(CAR.model(pacejka), 10, RealTime())
    yield "8 states, 10 stages over 22 steps", replace(few, steps=(1, 1, 1, 1, 2, 2, 2, 4, 4, 4)), whole
    few = replace(envelope, horizon=10, steps=(1, 1, 1, 1, 2, 2, 2, 3, 3, 4))
    yield f"8 states, 10 stages over 20 steps, {SOFT}", few, whole


SOFT = "soft slip angles, yaw rate, corridor"
EVEN = {
    "MLP {2 2}": "; once both are compiled the thesis' claim does not hold: this network takes as long as Pacejka's"
}
STAGES = {  # few stages of several steps, and equal steps over the same time ahead
    "8 states, 10 stages over 22 steps": "8 states, N = 22",
    f"8 states, 10 stages over 20 steps, {SOFT}": f"8 states, N = 20, {SOFT}",
}
BOUNDS = {  # microseconds: median in C, p99 in C, median through Python
    "8 states, N = 10": (50.0, 120.0, 80.0),
    "8 states, N = 15": (80.0, None, None),
    "quasi-steady wheels, N = 10": (30.0, None, None),
    f"8 states, N = 20, {SOFT}": (200.0, None, None),
}


def bench(progress: Progress) -> Reproduction:
    """Time every candidate, then the peers on the same situations."""
    runs = list(candidates())
    times = {name: Times() for name, *_ in runs}
    for _, mpc, choose in runs:
        situations(mpc, choose, Times(), 20)
    for i in range(ROUNDS):
        progress(0.5 * i / ROUNDS, f"real-time solver, round {i + 1}")
        for name, mpc, choose in runs:
            situations(mpc, choose, times[name], STEPS)
    found: list[Record] = []
    for name, t in times.items():
        bounds = BOUNDS.get(name, (None, None, None))
        values = (t.median("inside"), t.p99("inside"), t.median("process"))
        labels = ("in C [us], median", "in C [us], p99", "through Python [us], median")
        for value, bound, label in zip(values, bounds, labels, strict=True):
            found.append(
                Record(
                    row=name,
                    quantity=label,
                    thesis=1.5745e6 if "N = 10" in name and "8 states" in name else None,
                    here=1e6 * value,
                    bound="" if bound is None else f"<= {bound:g}",
                    holds=None if bound is None else 1e6 * value <= bound,
                    note=""
                    if "Python" not in label
                    else f"p99 {1e6 * t.p99('process'):.0f}; wall time "
                    f"{1e6 * t.median('wall'):.0f} / {1e6 * t.p99('wall'):.0f}",
                )
            )
    found += _neural(times)
    for few, long in STAGES.items():
        found += _stages(times, few, long)
    ours = times["8 states, N = 10"].median("process")
    progress(0.5, "fallbacks and deadlines")
    found += fallbacks("8 states, N = 10", runs[0][1])
    found += deadlines(*next((name, mpc) for name, mpc, _ in runs if name == f"8 states, N = 20, {SOFT}"))
    progress(0.5, "without a compiler")
    found += _no_compiler()
    progress(0.6, "the thesis' way")
    old = thesis_way(CAR, CAR.model(SOUSA_TABLE_6_2), 10, PATH, steps=4)
    found.append(_ratio("Ipopt with CVODES inside, as in the thesis", old, ours, 3000))
    reference = CAR.controller(CAR.model(SOUSA_TABLE_6_2), 10, Ipopt(tolerance=1e-8))
    t = Times()
    situations(reference, lambda x: x, t, 12)
    found.append(_ratio("Ipopt on one Radau step per interval, warm", t.median("process"), ours, None))
    for name, peer, least in PEERS:
        progress(0.6, name)
        found += _peer(name, peer, least)
    for i, (name, mpc, way) in enumerate(programs(runs)):
        progress(0.7 + 0.07 * i, f"quadratic programs of {name}")
        found += compared(name, mpc, way, min(ROUNDS, 3))
    return Reproduction(
        title="Predictive control, time of one plan",
        records=tuple(found),
        protocol=" ".join((__doc__ or "").split()) + f" {ROUNDS * (STEPS - 2)} plans of each of ours.",
    )


def programs(runs: Sequence[Candidate]) -> list[tuple[str, MPC, Drive]]:
    """Problems whose quadratic programs others are given, and how to drive them."""

    def on_the_lane_change(mpc: MPC) -> Iterator[Driven]:
        return drive(mpc, STEPS)

    def pushed(mpc: MPC) -> Iterator[Driven]:
        return (driven[:4] for driven in islice(push(mpc), 2 * STEPS))

    def racing(mpc: MPC) -> Iterator[Driven]:
        return (driven[:4] for driven in islice(race(mpc), 4 * STEPS))

    thesis = ("8 states, N = 10", f"8 states, N = 20, {SOFT}")
    found: list[tuple[str, MPC, Drive]] = [(name, mpc, on_the_lane_change) for name, mpc, _ in runs if name in thesis]
    return [*found, ("race car, N = 50", race_car(50), racing), ("chain, N = 200", chain(200), pushed)]


def _peer(name: str, peer: Callable[[], Iterator[Outcome]], least: float | None) -> list[Record]:
    """Converged against converged, one iteration against one iteration, in the same situations."""
    _, *ours = problems()
    by_way = {outcome.way: outcome for outcome in ours}
    found = []
    try:
        for theirs in peer():
            own = by_way[theirs.way]
            record = _ratio(f"{name}, {theirs.way}", theirs.seconds, own.seconds, least)
            note = f"{record.note}; as our converged command to {theirs.far:.0e} of its range, ours {own.far:.0e}"
            found.append(replace(record, note=note))
    except ImportError as missing:
        found.append(Record(row=name, quantity="time of a plan [us]", thesis=None, here="-", note=f"{missing}"))
    return found


def _ratio(name: str, theirs: float, ours: float, least: float | None) -> Record:
    return Record(
        row=name,
        quantity="time of a plan over ours through Python [-]",
        thesis=None,
        here=theirs / ours,
        bound="" if least is None else f">= {least}",
        holds=None if least is None else theirs >= least * ours,
        note=f"{1e6 * theirs:.0f} us and {1e6 * ours:.0f} us, process time, median",
    )


def _least(t: Times) -> float:
    """Median over the situations of a drive of the least time that any round took: the work, not the load. [s]"""
    return float(np.median(np.reshape(t.inside, (ROUNDS, -1)).min(axis=0)))


def _neural(times: dict[str, Times]) -> list[Record]:
    base = times["8 states, N = 10"]
    found = []
    for tire in ("MLP {2 2}", "RBF {4}"):
        t = times[f"8 states, N = 10, {tire}"]
        ratio = _least(t) / _least(base)
        plain = t.median("inside") / base.median("inside")
        rmse = [float(np.sqrt(np.mean(np.square(v.e_y)))) for v in (t, base)]
        found.append(
            Record(
                row=f"{tire} over Pacejka",
                quantity="time in C [-]",
                thesis="0.75 - 1.0",
                here=ratio,
                bound="" if tire in EVEN else "<= 1.0",
                holds=None if tire in EVEN else ratio <= 1.0,
                note=f"least of {ROUNDS} rounds of each situation, median over the situations; ratio of plain medians "
                f"{plain:.3f}; lateral RMSE {rmse[0]:.4f} m and {rmse[1]:.4f} m{EVEN.get(tire, '')}",
            )
        )
    return found


def _stages(times: dict[str, Times], few: str, long: str) -> list[Record]:
    """Few stages of several steps against equal steps over the same time ahead: time and tracking."""
    spent = _least(times[few]) / _least(times[long])
    rmse = [float(np.sqrt(np.mean(np.square(times[name].e_y)))) for name in (few, long)]
    plain = [1e6 * times[name].median("inside") for name in (few, long)]
    note = f"plain medians {plain[0]:.1f} us and {plain[1]:.1f} us; least of the rounds compared"
    return [
        Record(
            row=few,
            quantity=f"{quantity} over that of equal steps [-]",
            thesis=None,
            here=value,
            bound=f"<= {most:g}",
            holds=value <= most,
            note=said,
        )
        for quantity, value, most, said in (
            ("time in C", spent, 1.0, note),
            ("lateral RMSE", rmse[0] / rmse[1], 1.1, f"{rmse[0]:.4f} m and {rmse[1]:.4f} m"),
        )
    ]


def fallbacks(name: str, mpc: MPC) -> list[Record]:
    """Calls that end in a fallback for want of a state, beside those that end in a plan, in the same situations."""
    late = {"shifted plan": mpc, "stop law": replace(mpc, fallback=0)}
    spent: dict[str, list[float]] = {what: [] for what in ("plan", *late)}
    for _ in range(ROUNDS):
        for x, reference, before, plan in drive(mpc, STEPS):
            if before is None:
                continue
            spent["plan"].append(plan.seconds)
            for what, each in late.items():
                spent[what].append(each.plan(x * np.nan, reference, before).seconds)
    whole = float(np.median(spent["plan"]))
    return [
        Record(
            row=f"{name}, {what}",
            quantity="fallback over a plan, through Python [-]",
            thesis=None,
            here=float(np.median(spent[what])) / whole,
            bound="<= 1",
            holds=bool(np.median(spent[what]) <= whole),
            note=f"median {1e6 * np.median(spent[what]):.0f} us and {1e6 * whole:.0f} us, p99 "
            f"{1e6 * np.percentile(spent[what], 99):.0f} us and {1e6 * np.percentile(spent['plan'], 99):.0f} us, wall",
        )
        for what in late
    ]


def deadlines(name: str, mpc: MPC, deadline: float = 150e-6) -> list[Record]:
    """Time of whole calls beyond a deadline."""
    hurried, over, health = replace(mpc, deadline=deadline), [], None
    for _ in range(ROUNDS):
        for *_, plan in drive(hurried, STEPS):
            over.append(plan.seconds - deadline)
            health = plan.health
    late = np.maximum(over, 0.0)
    said = "" if health is None else f"; of the last drive's {health.plans} plans {health.fallbacks} were fallbacks"
    return [
        Record(
            row=f"{name}, deadline {1e6 * deadline:.0f} us",
            quantity=f"overrun of the whole call [us], {label}",
            thesis=None,
            here=1e6 * float(np.percentile(late, share)),
            note=f"{100 * np.mean(late > 0):.1f} % of the calls overran{said}" if share == 50 else "",
        )
        for label, share in (("median", 50), ("p99", 99))
    ]


def _no_compiler() -> list[Record]:
    before = os.environ.get("SLIPANGLE_CC")
    os.environ["SLIPANGLE_CC"] = "none"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModelWarning)
            mpc = CAR.controller(CAR.model(SOUSA_TABLE_6_2), 10, RealTime())
            mpc.prepare()
    finally:
        if before is None:
            del os.environ["SLIPANGLE_CC"]
        else:
            os.environ["SLIPANGLE_CC"] = before
    t = Times()
    for _ in range(ROUNDS):
        situations(mpc, lambda x: x, t, STEPS)
    here = 1e6 * t.median("process")
    row = "8 states, N = 10, no compiler"
    plan = Record(
        row=row,
        quantity="through Python [us], median",
        thesis=None,
        here=here,
        bound="<= 250",
        holds=here <= 250,
        note=f"p99 {1e6 * t.p99('process'):.0f}",
    )
    return [plan, *fallbacks(row, mpc)]
