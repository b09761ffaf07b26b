"""The reference solver: multiple shooting, or collocation where the wheels are stiff, with Ipopt."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from time import perf_counter
from typing import Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np

from slipangle.fields import Checked, Count, Positive
from slipangle.models.ode import OdeModel
from slipangle.numerics.integrate import RADAU_A, radau_equations
from slipangle.optimal.engine import Engine, Start
from slipangle.optimal.joined import Joined
from slipangle.optimal.joined_engine import JoinedEngine
from slipangle.optimal.ocp import OCP, Reference, at_nodes
from slipangle.optimal.solution import Solution, Status, between, finite

_STATUS = {
    "Solve_Succeeded": Status.SOLVED,
    "Solved_To_Acceptable_Level": Status.ACCEPTABLE,
    "Feasible_Point_Found": Status.ACCEPTABLE,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
    "Search_Direction_Becomes_Too_Small": Status.STALLED,
    "Maximum_CpuTime_Exceeded": Status.TIME_OUT,
    "Maximum_WallTime_Exceeded": Status.TIME_OUT,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Restoration_Failed": Status.INFEASIBLE,
    "Invalid_Number_Detected": Status.NOT_FINITE,
}

_ONE_AT_A_TIME = threading.Lock()  # its linear solver and CasADi's statistics know one call at a time
HAIR = 1e-8  # by which two equations that say the same, which Ipopt cannot tell from a contradiction, may be missed
RADAU_C = RADAU_A.sum(axis=1)


@dataclass(frozen=True, kw_only=True)
class Ipopt(Checked):
    """Multiple shooting ([1]_ eq. 5-8) by the interior-point method of [2]_.

    Where the model is integrated by one step of Radau IIA, its stages become variables of the program (collocation):
    the same solution, found many times faster than with Newton's method inside every evaluation.

    Parameters
    ----------
    tolerance : float
        Of the optimality conditions, scaled; near active limits inputs are good to about the square root
        of it: 1e-13 for inputs to 1e-8. Where rounding stops the solver short of it, 1e-8 is acceptable.
    max_iterations : int
        Per solve.
    warm : bool
        Start from the previous plan's multipliers too, not only from its inputs and states.
    collocation : bool
        Whether stages of the implicit integrator are variables.

    References
    ----------
    .. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023.
    .. [2] A. Waechter, L. T. Biegler, Math. Program. 106, 25-57, 2006.
    """

    composes: ClassVar[bool] = True

    tolerance: Positive = 1e-10
    max_iterations: Count = 200
    warm: bool = True
    collocation: bool = True

    def build(self, ocp: OCP, deadline: float | None = None) -> Engine:
        """The solver for one problem."""
        if ocp.composed:
            joined = Joined(ocp)
            return JoinedEngine(joined, self.build(joined, deadline))
        return IpoptEngine(ocp, self, deadline)


class _Memory(NamedTuple):
    """Variables and the multipliers of their bounds and of the constraints, as Ipopt left them; of which problem."""

    owner: str
    v: np.ndarray
    bounds: np.ndarray
    constraints: np.ndarray


class _Layout(NamedTuple):
    """Where everything is among the variables and constraints.

    Of the variables, ``u``, ``x`` and ``slack`` have a row per stage; ``inner``, stages of the integrator, and
    ``ends``, states after it, a row per step of the model. Of the constraints, ``limits`` (rates and limits) has a row
    per stage, ``first`` are those on the first input. ``later`` and ``later_rows`` say where the solve before had what
    is here a step later. ``hard``, ``soft`` and ``rated`` number limited quantities and inputs.
    """

    hard: list[int]
    soft: list[int]
    hard_now: list[int]
    soft_now: list[int]
    rated: list[int]
    u: np.ndarray
    x: np.ndarray
    slack: np.ndarray
    inner: np.ndarray
    ends: np.ndarray
    limits: np.ndarray
    first_slack: np.ndarray
    first: np.ndarray
    later: np.ndarray
    later_rows: np.ndarray


def _layout(ocp: OCP, n_inner: int) -> _Layout:
    """Columns of the stages one after the other, then what belongs to the first input only."""
    nx, nu, ns = ocp.model.n_states, len(ocp.controls), len(ocp.soft)
    soft = [ocp.limited.index(name) for name in ocp.soft]
    hard = [j for j in range(len(ocp.limited)) if j not in soft]
    hard_now, soft_now = ([j for j in group if ocp.limited_now[j]] for group in (hard, soft))
    rated = ocp.rated.tolist()
    high = len(rated) + len(hard) + 2 * ns
    wide, n_model = nu + nx + ns, nx + n_inner
    size = height = 0
    u, x, slack, inner, ends, model, limits = ([] for _ in range(7))
    for length in ocp.lengths.tolist():
        u.append(size + np.arange(nu))
        x.append(size + nu + np.arange(nx))
        slack.append(size + nu + nx + np.arange(ns))
        inside = size + wide + np.arange(length * n_inner)
        inner += list(inside.reshape(length, n_inner))
        within = size + wide + length * n_inner + np.arange((length - 1) * nx)
        ends += [*within.reshape(length - 1, nx), x[-1]]
        size += wide + length * n_inner + (length - 1) * nx
        model += list((height + np.arange(length * n_model)).reshape(length, n_model))
        limits.append(height + length * n_model + np.arange(high))
        height += length * n_model + high
    u, x, slack, inner, ends, model, limits = (
        np.array(part, dtype=int) for part in (u, x, slack, inner, ends, model, limits)
    )
    first_slack = size + np.arange(len(soft_now))
    first = height + np.arange(len(hard_now) + 2 * len(soft_now))
    later, later_rows = np.arange(size + len(first_slack)), np.arange(height + len(first))
    after = ocp.stage_of[np.minimum(ocp.nodes[:-1] + 1, ocp.nodes[-1] - 1)]
    for where, stage, step in ((later, (u, x, slack), (inner, ends)), (later_rows, (limits,), (model,))):
        for part in stage:
            where[part] = part[after]
        for part in step:
            where[part[:-1]] = part[1:]
    places = u, x, slack, inner, ends, limits
    return _Layout(hard, soft, hard_now, soft_now, rated, *places, first_slack, first, later, later_rows)


class IpoptEngine(Engine):
    """The nonlinear program of one `OCP`, built once.

    Variables are the stages' columns ``[u_i; x_{i+1}; slack_{i+1}; inner stages of the integrator; states within the
    stage]``, constraints the columns ``[model; rates; limits]``, so a plan and its multipliers shift along with time.
    """

    def __init__(self, ocp: OCP, settings: Ipopt, deadline: float | None) -> None:
        self.ocp = ocp
        self._settings = settings
        self._deadline = deadline
        self._layout, self._nlp, self._expand = _program(ocp, settings.collocation)
        self._cold = self._solver({})
        self._warm = self._warm_solver() if settings.warm else self._cold

    def _warm_solver(self) -> ca.Function:
        names = "bound_push bound_frac slack_bound_push slack_bound_frac mult_bound_push".split()
        push = {f"ipopt.warm_start_{name}": 1e-6 for name in names}
        return self._solver({"ipopt.warm_start_init_point": "yes", "ipopt.mu_init": 1e-4, **push})

    def _solver(self, extra: dict[str, Any]) -> ca.Function:
        options: dict[str, Any] = {
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "print_time": False,
            "show_eval_warnings": False,
            "expand": self._expand,
            "ipopt.tol": self._settings.tolerance,
            "ipopt.max_iter": self._settings.max_iterations,
            "ipopt.acceptable_tol": max(1e-8, self._settings.tolerance),
            "ipopt.acceptable_constr_viol_tol": 1e-8,
            "ipopt.acceptable_iter": 5,
            "ipopt.bound_relax_factor": 0.0,
            "error_on_fail": False,
            **extra,
        }
        if self._deadline is not None:
            options["ipopt.max_wall_time"] = self._deadline
        return ca.nlpsol("ocp", "ipopt", self._nlp, options)

    def solve(self, start: Start) -> Solution:
        """Solve from a state; see `slipangle.optimal.solution.Start`."""
        ocp, at = self.ocp, self._layout
        reference = start.reference
        inputs = np.zeros(at.u.shape) if reference.inputs is None else reference.inputs
        w = at_nodes(reference.exogenous, ocp.horizon)
        p = (start.x, start.applied, w, reference.tracked, inputs, *ocp.weights_for(reference))
        memory = start.memory if self._settings.warm and isinstance(start.memory, _Memory) else None
        if memory is not None and not (memory.owner == ocp.identity and finite(*memory[1:])):
            memory = None
        lower_v, upper_v = np.full(len(at.later), -np.inf), np.full(len(at.later), np.inf)
        lower_v[at.u], upper_v[at.u] = ocp.input_bounds.T
        lower_v[at.slack] = lower_v[at.first_slack] = 0.0
        lower_g, upper_g = self._constraint_bounds(reference)
        arguments: dict[str, Any] = {
            "x0": self._guess(start, memory),
            "p": np.concatenate([np.asarray(q, dtype=float).ravel() for q in p]),
            "lbx": lower_v,
            "ubx": upper_v,
            "lbg": lower_g,
            "ubg": upper_g,
        }
        with _ONE_AT_A_TIME:
            return self._solution(start, arguments, memory, lower_g, upper_g)

    def _solution(
        self, start: Start, arguments: dict[str, Any], memory: _Memory | None, lower_g: np.ndarray, upper_g: np.ndarray
    ) -> Solution:
        at, solver = self._layout, self._cold
        if memory is not None:
            solver = self._warm
            arguments["lam_x0"] = memory.bounds[at.later]
            arguments["lam_x0"][at.first_slack] = 0.0
            arguments["lam_g0"] = memory.constraints[at.later_rows]
        begin = perf_counter()
        result = solver(**arguments)
        stats: dict[str, Any] = solver.stats()
        late = self._deadline is not None and perf_counter() - begin > self._deadline / 2
        if stats["return_status"] == "Restoration_Failed" and not late:  # as of equations that say the same
            result = self._cold(**{**arguments, **_apart(at.limits, lower_g, upper_g)})
            stats = self._cold.stats()
        v, g = (np.asarray(result[k].full()).ravel() for k in "xg")
        status = _STATUS.get(str(stats["return_status"]), Status.FAILED)
        excess = np.concatenate([lower_g - g, g - upper_g, [0.0]])
        good, kept = finite(v, g), None
        if good and status.solved:
            kept = _Memory(self.ocp.identity, v, *(np.asarray(result[k].full()).ravel() for k in ("lam_x", "lam_g")))
        return Solution(
            u=v[at.u],
            x=np.vstack([start.x, v[at.x]]),
            status=status if good or not status.solved else Status.NOT_FINITE,
            cost=float(result["f"]),
            iterations=int(stats.get("iter_count", 0)),
            violation=float(excess.max()) if good else np.inf,
            memory=kept,
        )

    def _guess(self, start: Start, memory: _Memory | None) -> np.ndarray:
        """Variables to start from: the guess, on straight lines within stages; inner stages as they were a step ago."""
        ocp, at = self.ocp, self._layout
        guess = np.zeros(len(at.later))
        guess[at.u] = start.guess_u
        states = between(start.guess_x, ocp.nodes)
        guess[at.ends] = states[1:]
        if at.inner.size:
            before, after = states[:-1], states[1:]
            guess[at.inner] = np.hstack([before + c * (after - before) for c in RADAU_C[:-1]])
            if memory is not None:
                guess[at.inner[:-1]] = memory.v[at.inner[1:]]
        return guess

    def _constraint_bounds(self, reference: Reference) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the constraints, in the order of `_program`."""
        ocp, at = self.ocp, self._layout
        bounds, steps = ocp.state_bounds(reference), ocp.step_bounds[:, at.rated]
        now, later = bounds[0], bounds[1:]
        free = np.full((ocp.horizon, len(at.soft)), np.inf)
        lower, upper = np.zeros(len(at.later_rows)), np.zeros(len(at.later_rows))
        lower[at.limits] = np.hstack([steps[..., 0], later[:, at.hard, 0], -free, later[:, at.soft, 0]])
        upper[at.limits] = np.hstack([steps[..., 1], later[:, at.hard, 1], later[:, at.soft, 1], free])
        none = np.full(len(at.soft_now), np.inf)
        lower[at.first] = np.concatenate([now[at.hard_now, 0], -none, now[at.soft_now, 0]])
        upper[at.first] = np.concatenate([now[at.hard_now, 1], now[at.soft_now, 1], none])
        return lower, upper


def _apart(rows: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> dict[str, np.ndarray]:
    """The bounds of the constraints, with a hair between those of these rows that are equal."""
    same = np.zeros(len(lower), dtype=bool)
    same[rows] = lower[rows] == upper[rows]
    hair = np.where(same, HAIR * (1.0 + np.abs(np.where(same, upper, 0.0))), 0.0)
    return {"lbg": lower - hair, "ubg": upper + hair}


def _collocation(ocp: OCP) -> ca.Function | None:
    """``(x, z, u, w) -> residual`` of a model with one step of Radau IIA per sample, see `radau_equations`."""
    model = ocp.model
    if not isinstance(model, OdeModel) or model.own_step or model.method != "radau" or model.substeps != 1:
        return None
    try:
        equations = radau_equations(model.derivative, model.dt, model.n_states, model.n_inputs)
    except (NotImplementedError, TypeError):  # a derivative that holds CasADi functions of its own
        return None
    x, z = ca.SX.sym("x", model.n_states), ca.SX.sym("z", model.n_states, 3)
    u, w = ca.SX.sym("u", len(ocp.controls)), ca.SX.sym("w", len(ocp.exogenous))
    return ca.Function("collocation", [x, z, u, w], [ca.vec(equations(x, z, ocp.all_inputs(u, w)))])


def _program(ocp: OCP, collocate: bool) -> tuple[_Layout, dict[str, Any], bool]:
    """Cost and constraints as expressions of the stages' columns."""
    # Long: every part of the program once, in the order of its columns.
    n, nx, nu = ocp.horizon, ocp.model.n_states, len(ocp.controls)
    collocation = _collocation(ocp) if collocate else None
    at = _layout(ocp, 2 * nx if collocation is not None else 0)
    v = ca.MX.sym("v", len(at.later))
    U, later, slack = (_take(v, rows) for rows in (at.u, at.x, at.slack))
    first_slack = _take(v, at.first_slack[:, None]).T
    x0, applied = ca.MX.sym("x0", nx), ca.MX.sym("applied", nu)
    W_nodes = ca.MX.sym("w", len(ocp.exogenous), n + 1)
    W = W_nodes[:, :n]
    P = ca.MX.sym("p", len(ocp.references), n + 1)
    wanted = ca.MX.sym("r", nu, n)

    X = ca.horzcat(x0, later[:, : n - 1]) if n > 1 else x0
    error, limited = ocp.stage.map(n)(X, U, W, P[:, :n])
    last_error, last_limited = ocp.stage(later[:, n - 1], U[:, n - 1], W_nodes[:, n], P[:, n])
    change = U - (ca.horzcat(applied, U[:, : n - 1]) if n > 1 else applied)
    q, r, s = (ca.MX.sym(name, *w.T.shape) for name, w in zip("qrs", ocp.stage_weights, strict=True))
    square, plain = (ca.DM(w) for w in ocp.slack_weights)
    cost = (
        ca.dot(q[:, :n], error**2)
        + ca.dot(q[:, n], last_error**2)
        + ca.dot(r, (U - wanted) ** 2)
        + ca.dot(s, change**2)
    )
    if at.soft:
        often = ca.DM(ocp.excess_counts[None, 1:])
        cost += ca.dot(ca.mtimes(square, often), slack**2) + ca.dot(ca.mtimes(plain, often), slack)
    if at.soft_now:
        chosen = [at.soft.index(j) for j in at.soft_now]
        now = float(ocp.excess_counts[0])
        cost += now * (ca.dot(square[chosen], first_slack**2) + ca.dot(plain[chosen], first_slack))

    ends = _take(v, at.ends)
    m = ends.shape[1]
    starts = ca.horzcat(x0, ends[:, : m - 1]) if m > 1 else x0
    held = (starts, *(part if m == n else part[:, ocp.stage_of.tolist()] for part in (U, W)))
    if collocation is not None:
        z = ca.reshape(ca.vertcat(_take(v, at.inner), ends), nx, 3 * m)
        model = collocation.map(m)(held[0], z, *held[1:])
    else:
        model = ocp.dynamics.map(m)(*held) - ends
    if ocp.jump is not None:
        columns = ca.horzsplit(model, 1)
        for i in ocp.jumps:
            columns[i] = ca.vertcat(
                ocp.jump(starts[:, i], U[:, i], W[:, i]) - ends[:, i], *_idle(v, at, i, collocation is not None)
            )
        model = ca.horzcat(*columns)
    ahead = ca.horzcat(limited[:, 1:], last_limited) if n > 1 else last_limited
    limits = ca.vertcat(
        _pick(change, at.rated), _pick(ahead, at.hard), _pick(ahead, at.soft) - slack, _pick(ahead, at.soft) + slack
    )
    constraints = []
    for i in range(n):
        constraints += [ca.vec(model[:, ocp.nodes[i] : ocp.nodes[i + 1]]), limits[:, i]]
    at_first = _pick(limited[:, 0], at.soft_now)
    constraints += [_pick(limited[:, 0], at.hard_now), at_first - first_slack, at_first + first_slack]
    nlp = {
        "x": v,
        "p": ca.vertcat(x0, applied, ca.vec(W_nodes), ca.vec(P), ca.vec(wanted), *map(ca.vec, (q, r, s))),
        "f": cost,
        "g": ca.vertcat(*constraints),
    }
    expand = (collocation is not None or ocp.dynamics.is_a("SXFunction")) and ocp.stage.is_a("SXFunction")
    return at, nlp, expand


def _idle(v: ca.MX, at: _Layout, i: int, inner: bool) -> list[ca.MX]:
    """Stages of the integrator that a jump has no use for, brought to zero."""
    return [v[at.inner[i].tolist()]] if inner else []


def _take(vector: ca.MX, rows: np.ndarray) -> ca.MX:
    """Entries as a matrix; a row of the index becomes a column."""
    return ca.reshape(vector[rows.ravel().tolist()], *rows.shape[::-1]) if rows.size else ca.MX(*rows.shape[::-1])


def _pick(matrix: ca.MX, rows: list[int]) -> ca.MX:
    """Some rows, none of them included."""
    return matrix[rows, :] if rows else ca.MX(0, matrix.shape[1])
