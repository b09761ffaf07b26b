"""A least-squares fit of an ODE as one sparse nonlinear program: Radau collocation of every sample interval."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from slipangle.errors import ParameterError, SimulationError, nearest
from slipangle.identify.physics.simulation_error import FreeRunProblem as Problem
from slipangle.identify.physics.simulation_error import Minimum
from slipangle.numerics.integrate import RADAU_A
from slipangle.ops import is_symbolic, stack

Constraint = Callable[[Any], Any]


@dataclass(frozen=True, kw_only=True)
class CollocationPoint:
    """Solution of the program."""

    z: np.ndarray  # (n_z,), scaled unknowns, as in `FreeRunProblem`
    states: list[np.ndarray]  # (n_samples, n_states), states at the samples of each experiment
    variables: np.ndarray  # all of them, for a warm start
    bounds_force: np.ndarray  # multipliers of their bounds
    rows_force: np.ndarray  # multipliers of the constraints
    active: np.ndarray  # (n_active, n_z), derivatives of active constraints and bounds on parameters
    converged: bool
    status: str  # Ipopt's word for it


class Transcription:
    """The program of one fit.

    Variables are the scaled unknowns of `FreeRunProblem` but for initial states, then for each experiment its states
    at the first sample, and for every interval those at the three Radau points of each element, the last being the next
    sample. Constraints are the collocation equations, the initial states, and what the user gave.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        elements: int,
        at_most_zero: Sequence[Constraint],
        zero: Sequence[Constraint],
        state_bounds: Mapping[str, tuple[float, float]],
    ) -> None:
        self.problem, self.elements = problem, elements
        self.hessian = "Gauss-Newton"  # or "exact", near a solution with large errors
        ode = problem.model.ode
        for name in state_bounds:
            if name not in ode.states:
                raise ParameterError(f"state_bounds names '{name}'; {nearest(name, ode.states)}: expected a state")
        self.guesses = [self._guess(i) for i in range(problem.n_e)]
        self.size = np.maximum(np.max([np.abs(x).max(axis=0) for x in self.guesses], axis=0), 0.1)
        low, high = np.full(ode.n_states, -np.inf), np.full(ode.n_states, np.inf)
        for name, (a, b) in state_bounds.items():
            low[ode.states.index(name)], high[ode.states.index(name)] = a, b
        self.x_bounds = low / self.size, high / self.size
        self.interval, self.output = self._functions()
        self.user = self._user(at_most_zero, zero)
        self._build()

    # ---- pieces ------------------------------------------------------------------------------------------------

    def _guess(self, i: int) -> np.ndarray:
        """States at every sample: measured ones as measured, the others from the start model kept on the track."""
        problem = self.problem
        varied = problem.model.with_values(**dict(zip(problem.free, problem.parameters(i, problem.start), strict=True)))
        ode, rows, y = varied.ode, problem.rows[i], problem.measured[i]
        u = np.array([np.asarray(varied.drive(row), dtype=float) for row in rows])
        x0 = problem.initial(i, problem.start)[0]
        with np.errstate(all="ignore"):
            states = np.vstack([x0, ode.track(x0, u, y), np.full((1, len(x0)), np.nan)])[: len(y)]
        states[~np.isfinite(states).all(axis=1)] = x0
        for j, name in enumerate(ode.states):
            if name in ode.outputs:
                column = y[:, ode.outputs.index(name)]
                states[:, j] = column
        return states

    def _functions(self) -> tuple[ca.Function, ca.Function]:
        """Collocation equations of one interval, and the outputs, of scaled states and unscaled parameters."""
        problem = self.problem
        model, nx, n_points = problem.model, problem.n_x, 3 * self.elements
        h = model.dt / self.elements
        inverse, size = np.linalg.inv(RADAU_A), ca.DM(self.size)
        x, z = ca.SX.sym("x", nx), ca.SX.sym("z", nx * n_points)
        w, p = ca.SX.sym("w", problem.rows[0].shape[1]), ca.SX.sym("p", len(problem.free))
        varied = model.with_values(**{name: p[i] for i, name in enumerate(problem.free)})
        u, before, defects = varied.drive(w), x, []
        for e in range(self.elements):
            points = [z[nx * k : nx * (k + 1)] for k in range(3 * e, 3 * e + 3)]
            for i in range(3):
                slope = sum(inverse[i, j] * (points[j] - before) for j in range(3))
                defects.append(slope - h * varied.ode.derivative(size * points[i], u) / size)
            before = points[2]
        y = varied.ode.output(size * x, u)
        interval = ca.Function(
            "interval", [x, z, w, p], [ca.vertcat(*defects)], {"is_diff_in": [True, True, False, True]}
        )
        return interval, ca.Function("output", [x, w, p], [ca.densify(y)], {"is_diff_in": [True, False, True]})

    def _user(self, at_most_zero: Sequence[Constraint], zero: Sequence[Constraint]) -> tuple[ca.Function, int]:
        """The user's constraints on one experiment's parameters; how many are inequalities, which come first."""
        problem = self.problem
        p = ca.SX.sym("p", len(problem.free))
        params = problem.model.with_values(**{name: p[i] for i, name in enumerate(problem.free)}).params

        def column(constraints: Sequence[Constraint], what: str) -> Any:
            rows = []
            for constraint in constraints:
                value = constraint(params)
                value = stack(list(value)) if isinstance(value, list | tuple) else value
                if not is_symbolic(value):
                    raise ParameterError(
                        f"a constraint in {what} does not depend on any of {list(problem.free)}; expected one that does"
                    )
                rows.append(value)
            return ca.vertcat(*rows) if rows else ca.SX(0, 1)

        below, equal = column(at_most_zero, "at_most_zero"), column(zero, "zero")
        return ca.Function("user", [p], [ca.vertcat(below, equal)]), below.shape[0]

    def _build(self) -> None:
        problem = self.problem
        n_p, nx, scale = problem.n_p, problem.n_x, ca.DM(problem.scale[: problem.n_p])
        theta = ca.MX.sym("theta", n_p)
        sigma = ca.MX.sym("sigma", problem.model.n_outputs)
        start, slope = ca.MX.sym("start", nx, problem.n_e), ca.MX.sym("slope", nx * len(problem.free), problem.n_e)
        firsts, points, outputs, defects, initial, user = [], [], [], [], [], []
        for i, y in enumerate(problem.measured):
            n = len(y)
            first, inner = ca.MX.sym(f"first_{i}", nx), ca.MX.sym(f"points_{i}", nx, 3 * self.elements * (n - 1))
            nodes = ca.horzcat(first, inner[:, 3 * self.elements - 1 :: 3 * self.elements])
            p = (scale * theta)[problem.columns(i)[: len(problem.free)].tolist()]
            w = ca.DM(problem.rows[i].T)
            wide = ca.repmat(p, 1, n - 1)
            block = ca.reshape(inner, nx * 3 * self.elements, n - 1)
            defects.append(ca.vec(self.interval.map(n - 1)(nodes[:, :-1], block, w[:, :-1], wide)))
            outputs.append(ca.vec((self.output.map(n - 1)(nodes[:, 1:], w[:, 1:], wide) - ca.DM(y[1:].T)) / sigma))
            if not problem.n_x0:
                shift = ca.mtimes(ca.reshape(slope[:, i], nx, len(problem.free)), p)
                initial.append(first - (start[:, i] + shift) / ca.DM(self.size))
            if problem.own or i == 0:
                user.append(self.user[0](p))
            firsts.append(first)
            points.append(inner)
        self.error = ca.vertcat(*outputs)
        states = [ca.vec(v) for pair in zip(firsts, points, strict=True) for v in pair]
        self.variables = ca.vertcat(theta, *states)
        self.given = ca.vertcat(sigma, ca.vec(start), ca.vec(slope))
        self.equations = ca.vertcat(*defects, *initial)
        self.n_equations = self.equations.shape[0]
        users, below = ca.vertcat(*user), self.user[1]
        per = self.user[0].size1_out(0)
        low = np.tile(np.concatenate([np.full(below, -np.inf), np.zeros(per - below)]), len(user))
        self.g_low = np.concatenate([np.zeros(self.n_equations), low])
        self.g_high = np.zeros(self.n_equations + len(low))
        self.constraints = ca.vertcat(self.equations, users)
        self.user_jacobian = ca.Function("user_slopes", [theta], [users, ca.jacobian(users, theta)])
        counts = [nx * (1 + 3 * self.elements * (len(y) - 1)) for y in problem.measured]
        self.low, self.high = (
            np.concatenate([bound[:n_p], np.tile(x_bound, sum(counts) // nx)])
            for bound, x_bound in zip((problem.lower, problem.upper), self.x_bounds, strict=True)
        )

    # ---- solving -----------------------------------------------------------------------------------------------

    def first_guess(self) -> np.ndarray:
        """Parameters of the start model, and states between the samples on straight lines."""
        share = np.concatenate([(e + RADAU_A.sum(axis=1)) / self.elements for e in range(self.elements)])
        parts = [self.problem.start[: self.problem.n_p]]
        for x in self.guesses:
            scaled = x / self.size
            between = scaled[:-1, None] + share[:, None] * np.diff(scaled, axis=0)[:, None]
            parts += [scaled[0], between.ravel()]
        guess = np.concatenate(parts)
        return np.clip(guess, self.low, self.high)

    def numbers(self, z: np.ndarray) -> np.ndarray:
        """What the program is given at z: weights, and the initial states linear in the parameters."""
        problem, starts, slopes = self.problem, [], []
        for i in range(problem.n_e):
            at, slope = problem.initial(i, z) if not problem.n_x0 else (np.zeros(problem.n_x), None)
            slope = np.zeros((problem.n_x, len(problem.free))) if slope is None else slope[:, : len(problem.free)]
            starts.append(at - slope @ problem.parameters(i, z))
            slopes.append(slope.T.ravel())
        return np.concatenate([problem.sigma, np.concatenate(starts), np.concatenate(slopes)])

    def solve(self, warm: CollocationPoint | None, max_iterations: int, tolerance: float) -> CollocationPoint:
        """Solve from the first guess, or from a solution."""
        ipopt: dict[str, Any] = {"print_level": 0, "sb": "yes", "tol": tolerance, "constr_viol_tol": tolerance}
        ipopt |= {"max_iter": max_iterations, "bound_relax_factor": 0.0}
        options: dict[str, Any] = dict.fromkeys(("print_time", "show_eval_warnings", "error_on_fail"), False)
        if self.hessian == "Gauss-Newton":
            options["hess_lag"] = self._gauss_newton()
        if warm is not None:
            ipopt |= {"warm_start_init_point": "yes", "mu_init": 1e-8}
            pushes = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
            ipopt |= {f"warm_start_{name}": 1e-9 for name in pushes}
        nlp = {"x": self.variables, "p": self.given, "f": 0.5 * ca.sumsqr(self.error), "g": self.constraints}
        solver = ca.nlpsol("collocation", "ipopt", nlp, options | {"ipopt": ipopt})
        z = self._z(self.first_guess()) if warm is None else warm.z
        begin: Any = {"x0": self.first_guess() if warm is None else warm.variables}
        if warm is not None:
            begin |= {"lam_x0": warm.bounds_force, "lam_g0": warm.rows_force}
        ends = {"lbx": self.low, "ubx": self.high, "lbg": self.g_low, "ubg": self.g_high}
        result = solver(p=self.numbers(z), **begin, **ends)
        variables = np.array(result["x"]).ravel()
        if not np.isfinite(variables).all():
            raise SimulationError(
                "the collocation program ended at infinite states; expected equations defined everywhere: give "
                "state_bounds"
            )
        return self._found(variables, result, str(solver.stats()["return_status"]))

    def _gauss_newton(self) -> ca.Function:
        """Hessian without second derivatives: never indefinite, however poor the start."""
        share, force = ca.MX.sym("share"), ca.MX.sym("force", self.constraints.shape[0])
        slopes = ca.jacobian(self.error, self.variables)
        matrix = ca.triu(share * ca.mtimes(slopes.T, slopes))
        return ca.Function("nlp_hess_l", [self.variables, self.given, share, force], [matrix])

    def _z(self, variables: np.ndarray) -> np.ndarray:
        """Scaled unknowns among the variables."""
        problem = self.problem
        parts = [variables[: problem.n_p]]
        if problem.n_x0:
            parts += [x[0] / problem.scale[problem.columns(i)[len(problem.free) :]] for i, x in self._states(variables)]
        return np.concatenate(parts)

    def _states(self, variables: np.ndarray) -> list[tuple[int, np.ndarray]]:
        """Number and states at the samples of each experiment."""
        at, states, nx, step = self.problem.n_p, [], self.problem.n_x, 3 * self.elements
        for i, y in enumerate(self.problem.measured):
            first = variables[at : at + nx]
            end = at + nx * (1 + step * (len(y) - 1))
            points = variables[at + nx : end].reshape(-1, nx)
            states.append((i, np.vstack([first, points[step - 1 :: step]]) * self.size))
            at = end
        return states

    def _found(self, variables: np.ndarray, result: dict, status: str) -> CollocationPoint:
        n_p = self.problem.n_p
        theta = variables[:n_p]
        value, slopes = (np.array(v) for v in self.user_jacobian(theta))
        force = np.array(result["lam_g"]).ravel()[self.n_equations :]
        equal = self.g_low[self.n_equations :] == 0
        pull = np.abs(force) * np.linalg.norm(np.atleast_2d(slopes), axis=1)
        tight = equal | (pull > 1e-6 * max(1.0, float(result["f"])))
        tight &= np.abs(value.ravel()) < 1e-4 * np.abs(slopes * theta).sum(axis=1)
        unit = np.eye(n_p)[(theta - self.low[:n_p] < 1e-7) | (self.high[:n_p] - theta < 1e-7)]
        active = np.vstack([slopes[tight], unit])
        z = self._z(variables)
        return CollocationPoint(
            z=z,
            states=[x for _, x in self._states(variables)],
            variables=variables,
            bounds_force=np.array(result["lam_x"]).ravel(),
            rows_force=np.array(result["lam_g"]).ravel(),
            active=np.hstack([active, np.zeros((len(active), len(z) - n_p))]),
            converged=status in ("Solve_Succeeded", "Solved_To_Acceptable_Level"),
            status=status,
        )

    def minimum(self, found: CollocationPoint) -> Minimum:
        """Errors and their derivatives on the collocated states, by the implicit function theorem.

        Unlike a free run this holds for motions that a free run cannot follow, because they are unstable.
        """
        problem = self.problem
        n_p, n_z = problem.n_p, len(found.z)
        parts = [self.error, self.equations, ca.jacobian(self.error, self.variables)]
        parts.append(ca.jacobian(self.equations, self.variables))
        at_solution: Any = ca.Function("slopes", [self.variables, self.given], parts)
        e, _, e_v, g_v = at_solution(found.variables, self.numbers(found.z))
        e_v, g_v = (csc_matrix(m.sparse()) for m in (e_v, g_v))
        independent = np.zeros(self.variables.shape[0], dtype=bool)
        independent[:n_p] = True
        at = n_p
        for y in problem.measured:
            if problem.n_x0:
                independent[at : at + problem.n_x] = True
            at += problem.n_x * (1 + 3 * self.elements * (len(y) - 1))
        free = np.flatnonzero(independent)
        moved = splu(csc_matrix(g_v[:, ~independent])).solve(-g_v[:, free].toarray())
        jacobian = e_v[:, free].toarray() + e_v[:, ~independent] @ moved
        for i in range(problem.n_e if problem.n_x0 else 0):
            columns = problem.columns(i)[len(problem.free) :]
            jacobian[:, columns] *= problem.scale[columns] / self.size
        error = np.array(e).ravel()
        return Minimum(
            z=found.z, error=error, jacobian=jacobian[:, :n_z], sigma=problem.sigma, converged=found.converged
        )
