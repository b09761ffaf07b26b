"""The reference solver: multiple shooting, or collocation where the wheels are stiff, with Ipopt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipangle.control.ocp import OCP, Reference
from slipangle.control.plan import Solution, Start, Status
from slipangle.errors import ParameterError
from slipangle.models.integrate import RADAU_A, radau_equations
from slipangle.models.vehicles import OdeModel

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

RADAU_C = RADAU_A.sum(axis=1)


@dataclass(frozen=True, kw_only=True)
class Ipopt:
    """Multiple shooting ([1]_ eq. 5-8) by the interior-point method of [2]_.

    Where the model is integrated by one step of Radau IIA, its stages become variables of the program (collocation):
    the same solution, found many times faster than with Newton's method inside every evaluation.

    Parameters
    ----------
    tolerance : float
        Of the optimality conditions, scaled; near active limits inputs are good to about the square root
        of it. Where rounding stops the solver short of it, 1e-8 is acceptable.
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

    tolerance: float = 1e-10
    max_iterations: int = 200
    warm: bool = True
    collocation: bool = True

    def __post_init__(self) -> None:
        if not (self.tolerance > 0 and self.max_iterations >= 1):
            raise ParameterError(
                f"tolerance is {self.tolerance}, max_iterations {self.max_iterations}; expected a positive tolerance "
                "and at least one iteration"
            )

    def build(self, ocp: OCP, deadline: float | None = None) -> IpoptEngine:
        """The solver for one problem."""
        return IpoptEngine(ocp, self, deadline)


class _Multipliers(NamedTuple):
    """Of bounds and constraints, one column per stage; those of constraints on the first input apart.

    With them, inner stages of the integrator.
    """

    bounds: np.ndarray
    stages: np.ndarray
    first: np.ndarray
    inner: np.ndarray


class IpoptEngine:
    """The nonlinear program of one `OCP`, built once.

    Variables are the stages' columns ``[u_i; x_{i+1}; slack_{i+1}; inner stages of the integrator]``, constraints the
    columns ``[model; rates; limits]``, so a plan and its multipliers shift by one column per step.
    """

    def __init__(self, ocp: OCP, settings: Ipopt, deadline: float | None) -> None:
        self.ocp = ocp
        self._settings = settings
        self._deadline = deadline
        self._nlp, self._rows, self._expand = _program(ocp, settings.collocation)
        self._cold = self._solver({})
        self._warm = self._warm_solver() if settings.warm else self._cold

    def _warm_solver(self) -> ca.Function:
        push = dict.fromkeys(
            (
                "ipopt.warm_start_bound_push",
                "ipopt.warm_start_bound_frac",
                "ipopt.warm_start_slack_bound_push",
                "ipopt.warm_start_slack_bound_frac",
                "ipopt.warm_start_mult_bound_push",
            ),
            1e-6,
        )
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
        """Solve from a state; see `slipangle.control.plan.Start`."""
        ocp, n = self.ocp, self.ocp.horizon
        nu, nx = len(ocp.controls), ocp.model.n_states
        ns, n_first = len(ocp.soft), self._rows.first
        reference = start.reference
        inputs = np.zeros((n, nu)) if reference.inputs is None else np.asarray(reference.inputs, dtype=float)
        p = [start.x, start.applied, reference.exogenous.ravel(), reference.tracked.ravel(), inputs.ravel()]
        ni = self._rows.inner
        memory = start.memory if self._settings.warm and isinstance(start.memory, _Multipliers) else None
        if memory is not None and memory.bounds.shape != (n, nu + nx + ns + ni):
            memory = None
        inner = np.zeros((n, 0))
        if ni:
            before, after = start.guess_x[:-1], start.guess_x[1:]
            inner = np.hstack([before + c * (after - before) for c in RADAU_C[:-1]])
            if memory is not None:
                inner[:-1] = memory.inner[1:]
        guess = np.hstack([start.guess_u, start.guess_x[1:], np.zeros((n, ns)), inner]).ravel()
        lower_v = np.hstack([ocp.input_bounds[:, 0], np.full(nx, -np.inf), np.zeros(ns), np.full(ni, -np.inf)])
        upper_v = np.hstack([ocp.input_bounds[:, 1], np.full(nx + ns + ni, np.inf)])
        extra = np.zeros(self._rows.first_slack)
        lower_g, upper_g = self._constraint_bounds(reference)
        arguments: dict[str, Any] = {
            "x0": np.concatenate([guess, extra]),
            "p": np.concatenate([np.asarray(q, dtype=float).ravel() for q in p]),
            "lbx": np.concatenate([np.tile(lower_v, n), extra]),
            "ubx": np.concatenate([np.tile(upper_v, n), extra + np.inf]),
            "lbg": lower_g,
            "ubg": upper_g,
        }
        solver = self._cold
        if memory is not None and len(memory.first) == n_first:
            solver = self._warm
            moved = [np.vstack([m[1:], m[-1:]]).ravel() for m in (memory.bounds, memory.stages)]
            arguments["lam_x0"] = np.concatenate([moved[0], extra])
            arguments["lam_g0"] = np.concatenate([moved[1], memory.first])
        result = solver(**arguments)
        stats: dict[str, Any] = solver.stats()
        found = np.asarray(result["x"].full()).ravel()
        g = np.asarray(result["g"].full()).ravel()
        status = _STATUS.get(str(stats["return_status"]), Status.FAILED)
        width, height = nu + nx + ns + ni, len(lower_g) - n_first
        table = found[: n * width].reshape(n, width)
        excess = np.concatenate([lower_g - g, g - upper_g, [0.0]])
        finite = bool(np.isfinite(found).all() and np.isfinite(g).all())
        multipliers = None
        if finite and status.solved:
            lam_x, lam_g = (np.asarray(result[k].full()).ravel() for k in ("lam_x", "lam_g"))
            multipliers = _Multipliers(
                bounds=lam_x[: n * width].reshape(n, width),
                stages=lam_g[:height].reshape(n, -1),
                first=lam_g[height:],
                inner=table[:, nu + nx + ns :],
            )
        return Solution(
            u=table[:, :nu],
            x=np.vstack([start.x, table[:, nu : nu + nx]]),
            status=status if finite or not status.solved else Status.NOT_FINITE,
            cost=float(result["f"]),
            iterations=int(stats.get("iter_count", 0)),
            violation=float(excess.max()) if finite else np.inf,
            memory=multipliers,
        )

    def _constraint_bounds(self, reference: Reference) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the constraints, in the order of `_program`."""
        ocp = self.ocp
        bounds = ocp.state_bounds(reference)
        hard, soft, rated = self._rows.hard, self._rows.soft, self._rows.rated
        n = ocp.horizon
        model = np.zeros((n, ocp.model.n_states + self._rows.inner))
        lower_rate, upper_rate = (np.tile(ocp.step_bounds[rated, k], (n, 1)) for k in (0, 1))
        free = np.full((n, len(soft)), np.inf)
        later, now = bounds[1:], bounds[0]
        lower = np.hstack([model, lower_rate, later[:, hard, 0], -free, later[:, soft, 0]])
        upper = np.hstack([model, upper_rate, later[:, hard, 1], later[:, soft, 1], free])
        hard_now, soft_now = ([j for j in group if ocp.limited_now[j]] for group in (hard, soft))
        none = np.full(len(soft_now), np.inf)
        return (
            np.concatenate([lower.ravel(), now[hard_now, 0], -none, now[soft_now, 0]]),
            np.concatenate([upper.ravel(), now[hard_now, 1], now[soft_now, 1], none]),
        )


class _Rows(NamedTuple):
    """Which limited quantities are hard and soft, which inputs have rates, how much there is at the first input.

    ``inner`` counts the entries of the integrator's inner stages in a column.
    """

    hard: list[int]
    soft: list[int]
    rated: list[int]
    first: int
    first_slack: int
    inner: int


def _collocation(ocp: OCP) -> ca.Function | None:
    """``(x, z, u, w) -> residual`` of a model with one step of Radau IIA per sample, see `radau_equations`."""
    model = ocp.model
    if not (isinstance(model, OdeModel) and model.method == "radau" and model.substeps == 1):
        return None
    try:
        equations = radau_equations(model.derivative, model.dt, model.n_states, model.n_inputs)
    except (NotImplementedError, TypeError):  # a derivative that holds CasADi functions of its own
        return None
    x, z = ca.SX.sym("x", model.n_states), ca.SX.sym("z", model.n_states, 3)
    u, w = ca.SX.sym("u", len(ocp.controls)), ca.SX.sym("w", len(ocp.exogenous))
    return ca.Function("collocation", [x, z, u, w], [ca.vec(equations(x, z, ocp.all_inputs(u, w)))])


def _program(ocp: OCP, collocate: bool) -> tuple[dict[str, Any], _Rows, bool]:
    """Cost and constraints as expressions of the stages' columns."""
    n, nx, nu = ocp.horizon, ocp.model.n_states, len(ocp.controls)
    soft = [ocp.limited.index(name) for name in ocp.soft]
    hard = [j for j in range(len(ocp.limited)) if j not in soft]
    rated = [j for j in range(nu) if np.isfinite(ocp.step_bounds[j]).any()]
    ns = len(soft)
    soft_now = [i for i, j in enumerate(soft) if ocp.limited_now[j]]
    hard_now = [j for j in hard if ocp.limited_now[j]]

    collocation = _collocation(ocp) if collocate else None
    ni = 2 * nx if collocation is not None else 0

    stages = ca.MX.sym("v", nu + nx + ns + ni, n)
    first_slack = ca.MX.sym("first_slack", len(soft_now))
    U, later, slack = stages[:nu, :], stages[nu : nu + nx, :], stages[nu + nx : nu + nx + ns, :]
    x0, applied = ca.MX.sym("x0", nx), ca.MX.sym("applied", nu)
    W = ca.MX.sym("w", len(ocp.exogenous), n)
    P = ca.MX.sym("p", len(ocp.references), n + 1)
    wanted = ca.MX.sym("r", nu, n)

    X = ca.horzcat(x0, later[:, : n - 1]) if n > 1 else x0
    error, limited = ocp.stage.map(n)(X, U, W, P[:, :n])
    last_error, last_limited = ocp.stage(later[:, n - 1], U[:, n - 1], W[:, n - 1], P[:, n])
    change = U - (ca.horzcat(applied, U[:, : n - 1]) if n > 1 else applied)
    q, end, r, s = (ca.DM(w) for w in ocp.weights)
    square, plain = ocp.slack_weights

    cost = (
        ca.dot(ca.repmat(q, 1, n), error**2)
        + ca.dot(end, last_error**2)
        + ca.dot(ca.repmat(r, 1, n), (U - wanted) ** 2)
        + ca.dot(ca.repmat(s, 1, n), change**2)
    )
    for value, columns in ((slack, range(ns)), (first_slack, soft_now)):
        chosen = list(columns)
        if not chosen:
            continue
        many = value.shape[1]
        cost += ca.dot(ca.repmat(ca.DM(square[chosen]), 1, many), value**2)
        cost += ca.dot(ca.repmat(ca.DM(plain[chosen]), 1, many), value)

    ahead = ca.horzcat(limited[:, 1:], last_limited) if n > 1 else last_limited
    if collocation is not None:
        z = ca.reshape(ca.vertcat(stages[nu + nx + ns :, :], later), nx, 3 * n)
        model = collocation.map(n)(X, z, U, W)
    else:
        model = ocp.dynamics.map(n)(X, U, W) - later
    constraints = ca.vertcat(
        model,
        _pick(change, rated),
        _pick(ahead, hard),
        _pick(ahead, soft) - slack,
        _pick(ahead, soft) + slack,
    )
    at_first = _pick(limited[:, 0], [soft[i] for i in soft_now])
    first = ca.vertcat(_pick(limited[:, 0], hard_now), at_first - first_slack, at_first + first_slack)
    nlp = {
        "x": ca.vertcat(ca.vec(stages), first_slack),
        "p": ca.vertcat(x0, applied, ca.vec(W), ca.vec(P), ca.vec(wanted)),
        "f": cost,
        "g": ca.vertcat(ca.vec(constraints), first),
    }
    expand = (collocation is not None or ocp.dynamics.is_a("SXFunction")) and ocp.stage.is_a("SXFunction")
    return nlp, _Rows(hard, soft, rated, first.shape[0], len(soft_now), ni), expand


def _pick(matrix: ca.MX, rows: list[int]) -> ca.MX:
    """Some rows, none of them included."""
    return matrix[rows, :] if rows else ca.MX(0, matrix.shape[1])
