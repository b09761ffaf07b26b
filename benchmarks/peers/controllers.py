"""Others' predictive controllers on the thesis' problem, N = 10: converged to 1e-8, and one iteration a plan.

All plan in the same situations, those of a drive by our converged plans, each warm from its own plan before, and what
they command is compared with ours. Derivatives and problem are built before the clock starts.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import casadi as ca
import numpy as np
from benchmarks.thesis_car import CAR, LIMITS, PATH, SCALE, Q, S

from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_2
from slipangle.optimal.realtime import RealTime

TOLERANCE = 1e-8  # of all that converge
COUNT = 25  # plans, of which the first two do not count


class Problem(NamedTuple):
    """State, input before, X and Y wanted, and the converged command."""

    state: np.ndarray
    before: np.ndarray
    wanted: np.ndarray
    command: np.ndarray


@dataclass(frozen=True)
class Outcome:
    """Of one way to plan: median process time [s], and how far its command is from ours, in parts of its range."""

    way: str
    seconds: float
    far: float


@cache
def problems() -> tuple[tuple[Problem, ...], Outcome, Outcome]:
    """The situations, and what our converged plans and our single iterations take in them."""
    converged = CAR.controller(CAR.model(SOUSA_TABLE_6_2), 10, RealTime(iterations=0, tolerance=TOLERANCE))
    single = CAR.controller(CAR.model(SOUSA_TABLE_6_2), 10, RealTime())
    x, plan, once, s = converged.model.functions[0], None, None, 0.0
    found: list[Problem] = []
    spent: dict[str, list[float]] = {"converged": [], "one iteration": []}
    far = 0.0
    state = CAR.model(SOUSA_TABLE_6_2).straight(19.0, X=PATH.start[0])
    for _ in range(COUNT):
        s = PATH.project(state[5], state[6], s).s
        look = PATH.ahead(s, 10, 0.1)
        before = np.zeros(2) if plan is None else plan.command
        reference = converged.reference(look, T_r=0.0)
        began = time.process_time()
        later = converged.plan(state, reference, plan)
        middle = time.process_time()
        once = single.plan(state, reference, once, applied=before)
        spent["converged"].append(middle - began)
        spent["one iteration"].append(time.process_time() - middle)
        plan = later
        far = max(far, _distance(once.command, plan.command)) if len(found) > 1 else 0.0
        found.append(Problem(state, before, np.column_stack([look.X, look.Y]), plan.command))
        state = np.asarray(x(state, [*plan.command, 0.0])).ravel()
    medians = [float(np.median(times[2:])) for times in spent.values()]
    return tuple(found), Outcome("converged", medians[0], 0.0), Outcome("one iteration", medians[1], far)


def _outcome(way: str, times: list[float], commands: list[np.ndarray]) -> Outcome:
    given = problems()[0]
    far = max(_distance(u, p.command) for u, p in zip(commands[2:], given[2:], strict=True))
    return Outcome(way, float(np.median(times[2:])), far)


def _distance(command: np.ndarray, ours: np.ndarray) -> float:
    return float(np.abs((command - ours) / SCALE).max())


def do_mpc() -> Iterator[Outcome]:
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
    mpc.settings.nlpsol_opts = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0, "ipopt.tol": TOLERANCE}
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
    spent, commands = [], []
    for k, (state, before, goal, command) in enumerate(problems()[0]):
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
        commands.append(u)
        mpc.u0 = command
    yield _outcome("converged", spent, commands)


def _augmented() -> tuple[ca.Function, ca.Function]:
    """``(z, u, p) -> z`` and its residual terms, z the eight states and the input before, one Radau step each."""
    step = CAR.controller(CAR.model(SOUSA_TABLE_6_2), 10, RealTime()).ocp.dynamics
    z, u, p = ca.MX.sym("z", 10), ca.MX.sym("u", 2), ca.MX.sym("p", 2)
    later = ca.vertcat(step(z[:8], u, ca.DM([0.0])), u)
    q, s = (np.sqrt(list(weights.values())) for weights in (Q, S))
    error = ca.vertcat(q[0] * (z[0] - 20), q[1] * (z[5] - p[0]), q[2] * (z[6] - p[1]), s * (u - z[8:]))
    return ca.Function("later", [z, u, p], [later]), ca.Function("error", [z, u, p], [error])


def fatrop() -> Iterator[Outcome]:
    """Fatrop on multiple shooting, exact Hessian, warm in inputs and states."""
    for way, most in (("converged", 1000), ("one iteration", 1)):
        yield _fatrop(way, most)


def _fatrop(way: str, most: int) -> Outcome:
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
        "fatrop.tol": TOLERANCE,
        "fatrop.max_iter": most,
    }
    try:
        solver = ca.nlpsol("fatrop", "fatrop", nlp, options)
    except RuntimeError as refused:
        raise ImportError(f"fatrop refuses this problem: {str(refused).splitlines()[-1][:80]}") from refused
    spent, commands, guess = [], [], None
    for state, before, goal_now, _ in problems()[0]:
        z_now = np.concatenate([state, before])
        if guess is None:
            guess = np.concatenate([z_now, np.tile(np.concatenate([before / scale, z_now]), 10)])
        p = np.concatenate([z_now, goal_now.ravel()])
        began = time.process_time()
        found = np.asarray(solver(x0=guess, p=p, lbx=lower, ubx=upper, lbg=0, ubg=0)["x"]).ravel()
        spent.append(time.process_time() - began)
        if not np.isfinite(found).all():
            raise ImportError("fatrop returns NaN on this problem")
        commands.append(found[10:12] * scale)
        guess = np.concatenate([found[12:22], found[22:], found[-12:]])
    return _outcome(way, spent, commands)


def crocoddyl() -> Iterator[Outcome]:
    """Crocoddyl: box-constrained FDDP on action models written in Python over CasADi's derivatives."""
    for way, most in (("converged", 50), ("one iteration", 1)):
        yield _crocoddyl(way, most)


def _crocoddyl(way: str, most: int) -> Outcome:
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
    spent, commands, guess = [], [], None
    for state, before, goal, _ in problems()[0]:
        now = np.concatenate([state, before])
        for model, place in zip([*running, last], goal, strict=True):
            model.goal = place
        solver = lib.SolverBoxFDDP(lib.ShootingProblem(now, running, last))
        solver.th_stop = TOLERANCE
        us = [before / scale] * 10 if guess is None else guess[1]
        began = time.process_time()
        if guess is None:
            solver.solve(solver.problem.rollout(us), us, 50, True)
        else:
            solver.solve([now, *guess[0]], us, most, False)
        spent.append(time.process_time() - began)
        commands.append(np.asarray(solver.us[0]) * scale)
        guess = [*list(solver.xs)[2:], solver.xs[-1]], [*list(solver.us)[1:], solver.us[-1]]
    return _outcome(way, spent, commands)
