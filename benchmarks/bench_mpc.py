"""Predictive control of the thesis' front-drive car on a double lane change: time of one plan.

Same problem (tables 6.1 to 6.3, eq. 6-3, steps of 0.1 s), same drive, one thread, warm, every candidate in turn.
Inside C: monotonic clock around the whole solve. Through Python: process and wall time of ``MPC.plan``. Peers are
skipped when not installed: do-mpc, crocoddyl, fatrop (as CasADi ships it).
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace

import casadi as ca
import numpy as np

from slipangle.control.mpc import MPC
from slipangle.errors import ModelWarning
from slipangle.models.tires.neural import NeuralTire
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from slipangle.models.vehicles.quasi_steady import QuasiSteadySingleTrack
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.ocp import Reference
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.engine import CompiledEngine
from slipangle.optimal.solution import Plan
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths.lane_change import double_lane_change
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._chapter_6 import FRONT_DRIVE, thesis_way
from slipangle.reproduce._tires_6 import simulated_tires
from slipangle.reproduce.table_6_4 import data, settings

PATH = double_lane_change(20.0, blend=12.0)
CAR = FRONT_DRIVE
Q, S, LIMITS = (dict(CAR.settings[name]) for name in ("Q", "S", "limits"))
SCALE = np.array([high for _, high in LIMITS.values()])
ROUNDS, STEPS = 10, 60  # 600 plans of each


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


def candidates() -> Iterator[tuple[str, MPC, Callable[[np.ndarray], np.ndarray]]]:
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
    for name, peer, least in (("do-mpc", do_mpc, 100), ("fatrop", fatrop, None), ("crocoddyl", crocoddyl, None)):
        progress(0.7, name)
        try:
            spent, far = peer()
        except ImportError as missing:
            found.append(Record(row=name, quantity="time of a plan [us]", thesis=None, here="-", note=f"{missing}"))
            continue
        record = _ratio(name, spent, ours, least)
        found.append(replace(record, note=f"{record.note}; first command differs by {far:.1e} of its range"))
    return Reproduction(
        title="Predictive control, time of one plan",
        records=tuple(found),
        protocol=" ".join((__doc__ or "").split()) + f" {ROUNDS * (STEPS - 2)} plans of each of ours.",
    )


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


def _drive(mpc: MPC, steps: int) -> Iterator[tuple[np.ndarray, Reference, Plan | None, Plan]]:
    """State, reference, plan before and plan along one drive on the full model."""
    plant = CAR.model(SOUSA_TABLE_6_2).functions[0]
    x, plan, s = CAR.model(SOUSA_TABLE_6_2).straight(19.0, X=PATH.start[0]), None, 0.0
    for _ in range(steps):
        s = PATH.project(x[5], x[6], s).s
        reference = mpc.reference(PATH.ahead(s, mpc.times), T_r=0.0)
        before, plan = plan, mpc.plan(x, reference, plan)
        yield x, reference, before, plan
        x = np.asarray(plant(x, [*plan.command, 0.0])).ravel()


def fallbacks(name: str, mpc: MPC) -> list[Record]:
    """Calls that end in a fallback for want of a state, beside those that end in a plan, in the same situations."""
    late = {"shifted plan": mpc, "stop law": replace(mpc, fallback=0)}
    spent: dict[str, list[float]] = {what: [] for what in ("plan", *late)}
    for _ in range(ROUNDS):
        for x, reference, before, plan in _drive(mpc, STEPS):
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
        for *_, plan in _drive(hurried, STEPS):
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


# ---- peers ---------------------------------------------------------------------------------------------------------


def first_problems(count: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """State, input before, X, Y wanted and the converged command along a drive, N = 10."""
    mpc = CAR.controller(CAR.model(SOUSA_TABLE_6_2), 10, RealTime(iterations=0))
    x, plan, s, found = mpc.model.functions[0], None, 0.0, []
    state = CAR.model(SOUSA_TABLE_6_2).straight(19.0, X=PATH.start[0])
    for _ in range(count):
        s = PATH.project(state[5], state[6], s).s
        look = PATH.ahead(s, 10, 0.1)
        before = np.zeros(2) if plan is None else plan.command
        plan = mpc.plan(state, mpc.reference(look, T_r=0.0), plan)
        found.append((state, before, np.column_stack([look.X, look.Y]), plan.command))
        state = np.asarray(x(state, [*plan.command, 0.0])).ravel()
    return found


def _distance(command: np.ndarray, ours: np.ndarray) -> float:
    return float(np.abs((command - ours) / SCALE).max())


def do_mpc() -> tuple[float, float]:
    """do-mpc: Radau collocation of degree 3, Ipopt, warm."""
    lib = importlib.import_module("do_mpc")
    car = CAR.model(SOUSA_TABLE_6_2)
    model = lib.model.Model("continuous")
    x = ca.vertcat(*[model.set_variable("_x", n) for n in car.states])
    delta, torque = model.set_variable("_u", "delta"), model.set_variable("_u", "T_f")
    for n in ("X_ref", "Y_ref"):
        model.set_variable("_tvp", n)
    rate = car.derivative(x, ca.vertcat(delta, torque, 0))
    for i, n in enumerate(car.states):
        model.set_rhs(n, rate[i])
    model.setup()
    mpc = lib.controller.MPC(model)
    mpc.settings.n_horizon, mpc.settings.t_step, mpc.settings.n_robust = 10, 0.1, 0
    mpc.settings.collocation_type, mpc.settings.collocation_deg, mpc.settings.collocation_ni = "radau", 3, 1
    mpc.settings.store_full_solution = False
    mpc.settings.nlpsol_opts = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0, "ipopt.tol": 1e-8}
    missed = model.x["v_x"] - 20, model.x["X"] - model.tvp["X_ref"], model.x["Y"] - model.tvp["Y_ref"]
    cost = sum(w * e**2 for w, e in zip(Q.values(), missed, strict=True))
    mpc.set_objective(mterm=cost, lterm=cost)
    mpc.set_rterm(**S)
    for n, bounds in LIMITS.items():
        mpc.bounds["lower", "_u", n], mpc.bounds["upper", "_u", n] = bounds
    template = mpc.get_tvp_template()
    mpc.set_tvp_fun(lambda _: template)
    with contextlib.redirect_stdout(io.StringIO()):
        mpc.setup()
    spent, far = [], 0.0
    for k, (state, before, goal, command) in enumerate(first_problems(25)):
        for i in range(11):
            template["_tvp", i] = goal[i]
        if k == 0:
            mpc.x0 = state
            mpc.u0 = before
            mpc.set_initial_guess()
        mpc.u0 = before
        began = time.process_time()
        with contextlib.redirect_stdout(io.StringIO()):
            u = np.asarray(mpc.make_step(state)).ravel()
        spent.append(time.process_time() - began)
        far = max(far, _distance(u, command))
        mpc.u0 = command
    return float(np.median(spent[2:])), far


def _augmented() -> tuple[ca.Function, ca.Function]:
    """``(z, u, p) -> z`` and its residual terms, z the eight states and the input before, one Radau step each."""
    step = CAR.controller(CAR.model(SOUSA_TABLE_6_2), 10, RealTime()).ocp.dynamics
    z, u, p = ca.MX.sym("z", 10), ca.MX.sym("u", 2), ca.MX.sym("p", 2)
    later = ca.vertcat(step(z[:8], u, ca.DM([0.0])), u)
    q, s = (np.sqrt(list(weights.values())) for weights in (Q, S))
    error = ca.vertcat(q[0] * (z[0] - 20), q[1] * (z[5] - p[0]), q[2] * (z[6] - p[1]), s * (u - z[8:]))
    return ca.Function("later", [z, u, p], [later]), ca.Function("error", [z, u, p], [error])


def fatrop() -> tuple[float, float]:
    """Fatrop on multiple shooting, exact Hessian, warm in inputs and states."""
    if not ca.has_nlpsol("fatrop"):
        raise ImportError("CasADi has no fatrop here")
    step, error = _augmented()
    scale = SCALE
    v, g, lower, upper, equal, cost = [], [], [], [], [], ca.MX(0)
    z0, goal = ca.MX.sym("z0", 10), ca.MX.sym("goal", 2, 11)
    z = ca.MX.sym("z_0", 10)
    v.append(z)
    g.append(z - z0)
    equal += [True] * 10
    for i in range(10):
        u = ca.MX.sym(f"u_{i}", 2)
        later = ca.MX.sym(f"z_{i + 1}", 10)
        cost += ca.sumsqr(error(z, u * scale, goal[:, i]))
        g = [*g[:-1], later - step(z, u * scale, goal[:, i]), g[-1]] if i == 0 else [*g, later - step(z, u * scale, 0)]
        v += [u, later]
        z = later
    cost += ca.sumsqr(error(z, z[8:], goal[:, 10])[:3])
    nlp = {"x": ca.vertcat(*v), "f": cost, "g": ca.vertcat(*g), "p": ca.vertcat(z0, ca.vec(goal))}
    size = nlp["x"].shape[0]
    lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
    for i in range(10):
        lower[10 + 12 * i : 12 + 12 * i], upper[10 + 12 * i : 12 + 12 * i] = -1.0, 1.0
    options = {
        "structure_detection": "auto",
        "equality": [True] * nlp["g"].shape[0],
        "fatrop.print_level": 0,
        "print_time": False,
        "fatrop.tol": 1e-8,
    }
    try:
        solver = ca.nlpsol("fatrop", "fatrop", nlp, options)
    except RuntimeError as refused:
        raise ImportError(f"fatrop refuses this problem: {str(refused).splitlines()[-1][:80]}") from refused
    spent, far, guess = [], 0.0, None
    for state, before, goal_now, command in first_problems(12):
        z_now = np.concatenate([state, before])
        if guess is None:
            guess = np.concatenate([z_now, np.tile(np.concatenate([before / scale, z_now]), 10)])
        p = np.concatenate([z_now, goal_now.ravel()])
        began = time.process_time()
        found = np.asarray(solver(x0=guess, p=p, lbx=lower, ubx=upper, lbg=0, ubg=0)["x"]).ravel()
        spent.append(time.process_time() - began)
        if not np.isfinite(found).all():
            raise ImportError("fatrop returns NaN on this problem")
        far = max(far, _distance(found[10:12] * scale, command))
        guess = np.concatenate([found[12:22], found[22:], found[-12:]])
    return float(np.median(spent[2:])), far


def crocoddyl() -> tuple[float, float]:
    """Crocoddyl: box-constrained FDDP on action models written in Python over CasADi's derivatives."""
    lib = importlib.import_module("crocoddyl")
    step, error = _augmented()
    z, u, p = ca.MX.sym("z", 10), ca.MX.sym("u", 2), ca.MX.sym("p", 2)
    scale = SCALE
    later, terms = step(z, u * scale, p), error(z, u * scale, p)
    value = ca.Function("value", [z, u, p], [later, terms])
    slope = ca.Function(
        "slope", [z, u, p], [ca.densify(ca.jacobian(a, b)) for a, b in ((later, z), (later, u), (terms, z), (terms, u))]
    )

    class Action(lib.ActionModelAbstract):  # type: ignore[misc, name-defined]
        def __init__(self, last: bool) -> None:
            super().__init__(lib.StateVector(10), 2, 5)
            self.goal, self.last = np.zeros(2), last
            self.u_lb, self.u_ub = -np.ones(2), np.ones(2)

        def _rows(self) -> int:
            return 3 if self.last else 5

        def calc(self, data, x, u=None):
            later, terms = value(x, np.zeros(2) if u is None else u, self.goal)
            e = np.asarray(terms).ravel()[: self._rows()]
            data.xnext, data.cost = np.asarray(later).ravel(), float(e @ e)

        def calcDiff(self, data, x, u=None):
            u = np.zeros(2) if u is None else u
            e = np.asarray(value(x, u, self.goal)[1]).ravel()[: self._rows()]
            a, b, ex, eu = (np.asarray(m) for m in slope(x, u, self.goal))
            ex, eu = ex[: self._rows()], eu[: self._rows()] * (0.0 if self.last else 1.0)
            data.Fx, data.Fu = a, b
            data.Lx, data.Lu = 2 * ex.T @ e, 2 * eu.T @ e
            data.Lxx, data.Luu, data.Lxu = 2 * ex.T @ ex, 2 * eu.T @ eu, 2 * ex.T @ eu

    running, last = [Action(False) for _ in range(10)], Action(True)
    spent, far, guess = [], 0.0, None
    for state, before, goal, command in first_problems(12):
        now = np.concatenate([state, before])
        for model, place in zip([*running, last], goal, strict=True):
            model.goal = place
        solver = lib.SolverBoxFDDP(lib.ShootingProblem(now, running, last))
        solver.th_stop = 1e-12
        us = [before / scale] * 10 if guess is None else guess
        began = time.process_time()
        solver.solve(solver.problem.rollout(us), us, 50, True)
        spent.append(time.process_time() - began)
        far = max(far, _distance(np.asarray(solver.us[0]) * scale, command))
        guess = [*list(solver.us)[1:], solver.us[-1]]
    return float(np.median(spent[2:])), far
