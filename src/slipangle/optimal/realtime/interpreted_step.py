"""Real-time iterations without a compiler where only inputs are limited: few calls, no copies, memory made once."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from time import perf_counter
from typing import Any

import casadi as ca
import daqp
import numpy as np

from slipangle.codegen.expression import arguments
from slipangle.optimal.ocp import OCP, Reference
from slipangle.optimal.realtime.interpreted_model import along, bind, columns, newton_columns
from slipangle.optimal.realtime.interpreted_truth import units
from slipangle.optimal.realtime.parts import Implicit, input_scale
from slipangle.optimal.solution import Status, finite, inputs_later

NEAR = 0.02  # largest difference of the state from the one predicted, in `units`, with which derivatives stay
DOUBT = 1e-2  # largest correction of the stages by Newton's method after which one more would change nothing


class InputStep:
    """Full Gauss-Newton steps on a problem whose only limits are bounds of inputs.

    Everything is a function of ``(x, 1, u)``, so that one product per stage condenses derivatives, defects and inputs
    alike: `_G` holds it by the scaled step of all inputs and, in the last column, without one. Inputs are counted in
    units of `input_scale`. Costs are sums of squares of rows, those of inputs below those of errors.

    A plan's states and inputs have a row more than it has, for the step after its last. The model and its derivatives
    are found at each plan once: they say how good it is, and from the second row on they are those of the next plan,
    unless that has other exogenous inputs, stages of several steps, or a state far from the predicted one.

    Parameters
    ----------
    ocp : OCP
        The problem.
    node, stage, after, truth : Function
        What `functions` gives.

    Attributes
    ----------
    x, u, k : array, shape (steps + 2, n_states), (horizon + 2, n_controls) and (steps + 1, n_slopes)
        States, inputs and stage slopes: of the plan after a step, else, but for the first row, of the guess.
    before : array, shape (steps, n_slopes)
        Stage slopes of the guess.
    truth : tuple of float
        Cost, largest violation and residual of the plan, see `slipangle.optimal.solution.Plan`.
    """

    def __init__(self, ocp: OCP, node: ca.Function, stage: ca.Function, after: ca.Function, truth: ca.Function) -> None:
        n, nx, nu, ne = ocp.horizon, ocp.model.n_states, len(ocp.controls), len(ocp.tracked)
        self._n, self._steps, size, wide = n, int(ocp.nodes[-1]), n * nu, nx + 1 + nu
        steps, self._nx, self._dt = self._steps, nx, ocp.dt
        self._lengths, self._nodes, self._held = ocp.lengths, ocp.nodes, ocp.stage_of
        self._long = steps > n  # otherwise steps and stages share their arrays
        scale = input_scale(ocp)
        self._both = np.tile(scale, n)
        self.u, self.x = np.zeros((n + 2, nu)), np.zeros((steps + 2, nx))
        self._w, self._p = np.zeros((n + 2, len(ocp.exogenous))), np.zeros((n + 1, len(ocp.references)))
        slopes = node.numel_out(2) // (steps + 1)
        self.k = np.zeros((steps + 1, slopes))
        u_steps, w_steps, x_guess, x_plan = self.u[:-1], self._w[:-1], self.x[1:], self.x[:-1]
        if self._long:
            u_steps, w_steps = np.zeros((steps + 1, nu)), np.zeros((steps + 1, len(ocp.exogenous)))
            x_guess = x_plan = np.zeros((n + 1, nx))
        self._u_steps, self._w_steps, self._x_stages = u_steps, w_steps, x_plan
        kept = [self.k] if slopes else []
        self._node, (A, Z, self._slopes) = bind(node, steps + 1, [self.x[:-1], u_steps, w_steps, *kept, self.x[1:]])
        q, r, s = ocp.stage_weights
        root = np.sqrt(q)
        self._stage, (E,) = bind(stage, n + 1, [x_guess, self.u[1:], self._w[1:], self._p, root])
        self._G = np.zeros((steps + 1, wide, size + 1))
        self._G[0, nx, -1] = 1.0
        self._gap = np.zeros(nx)  # from the first state of the guess to the one measured
        for G, i in zip(self._G, [*self._held, n - 1], strict=True):
            G[nx + 1 :, i * nu : (i + 1) * nu] = np.eye(nu)
        self._A = list(zip(A.reshape(steps + 1, nx + 1, wide)[1:], self._G[:-1], self._G[1:, : nx + 1], strict=True))
        self._derivatives = A, Z, self._slopes
        self.before = np.zeros((steps, slopes))
        self._E = E.reshape(n + 1, ne, wide)
        self._inputs, self._used = _input_rows(ocp)
        self._by_change, self._by_input = np.sqrt(s[0]), np.sqrt(r)
        self._applied = np.zeros(2 * size)
        self._wanted, many = np.zeros(len(self._inputs)), (n + 1) * ne
        self._rows = np.zeros((many + len(self._inputs), size + 1))
        self._errors = self._rows[:many].reshape(n + 1, ne, size + 1)
        self._rows[many:, :-1] = self._inputs * self._both
        self._now = self._rows[many:, -1]
        self._low, self._high = (np.tile(b, n) for b in ocp.input_bounds.T)
        self._H = np.zeros((size, size))
        self._diagonal = self._H.reshape(-1)[:: size + 1]
        self._z, self._none = np.zeros(size), np.zeros((0, size))
        self._after, linear = bind(after, 1, [self._z, self._gap, A, self._slopes, Z, E, self.x])
        self._k_after, self._x_after = (a.reshape(b.shape) for a, b in zip(linear, (self.k, self.x), strict=False))
        self._truth, (self._measures,) = bind(
            truth,
            1,
            [self.x[:-1], x_plan, self.u[:-1], self._w[:-1], self._p, root, A, self._wanted, self._z, *linear[2:]],
        )
        self._holds: Any = None
        self.truth = np.inf, np.inf, np.inf

    @staticmethod
    def functions(
        ocp: OCP, parts: Implicit | None, node: ca.Function, stage: ca.Function
    ) -> tuple[ca.Function, ca.Function, ca.Function, ca.Function]:
        """Model of all steps and one more, errors of all stages, where a step leads, and how good it was.

        Parameters
        ----------
        ocp : OCP
            The problem.
        parts : Implicit, optional
            Of the integrator.
        node : Function
            ``(x, u, w, k, slopes) -> next, A, B, k, Z``, dense; without k, slopes and Z for explicit models.
        stage : Function
            ``(x, u, w, p) -> error, limited`` and their derivatives by x and u, dense.
        """
        scale = input_scale(ocp)
        many = newton_columns(ocp, parts, _augmented(node, scale), int(ocp.nodes[-1]) + 1)
        errors = columns(_errors(stage, scale), ocp.horizon + 1)
        values = columns(_values(stage), ocp.horizon + 1)
        return many, errors, _after(ocp, parts.core if parts else ()), _truth(ocp, values)

    def load(self, x: np.ndarray, applied: np.ndarray, reference: Reference, memory: Any) -> None:
        """Start from a plan's inputs, states and slopes, a step later; the step closes the gap to the last state."""
        n, w = self._n, reference.exogenous
        moved = memory is not self._holds
        self._holds = None
        if moved:
            self.x[:-1], self.k[:] = memory.x, memory.k
            self.x[-1] = 2 * self.x[-2] - self.x[-3]
            self.u[:n], self.u[n:] = memory.u, memory.u[-1]
        if self._long:
            self.u[1:-1] = inputs_later(self.u[:n], self._lengths)
            self.u[-1] = self.u[-2]
            self._u_steps[1:], self._w_steps[1:] = self.u[1 + self._held], w[self._held]
        moved = moved or self._long or (self._w[1:-1] != w[:n]).any()
        self._w[1:-1], self._w[-1] = w[:n], w[-1]
        np.subtract(x, self.x[1], out=self._gap)
        near = np.vdot(self._gap, self._gap) <= NEAR * NEAR  # enough, and nearly always so
        if not (near or (np.abs(self._gap) <= NEAR * units(self.x[:-1])).all()):
            self.x[1], self._gap[:], moved = x, 0.0, True
        self._G[0, : self._nx, -1], self._x0 = self._gap, x
        if moved:
            self._node()
        self._p[:] = reference.tracked
        self._applied[: len(applied)] = self._by_change * applied
        wanted = 0.0 if reference.inputs is None else np.ravel(self._by_input * reference.inputs)
        self._applied[len(self._both) :] = wanted
        self._wanted[:] = self._applied[self._used]

    def holds(self, memory: Any) -> None:
        """The plan at hand is the one of this memory; the next `load` of it finds everything done."""
        self._holds = memory

    def run(self, iterations: int, until: float) -> tuple[Status, int]:
        """Some full steps: status and how many."""
        rows, took = self._rows, 0.0
        for count in range(iterations):
            begin = perf_counter()
            if begin + took > until:
                return Status.TIME_OUT, count
            if count:
                self._stay()
            u = self.u[1:-1].reshape(-1)
            self._condense(u)
            square = rows.T @ rows
            if not finite(square):
                return Status.NOT_FINITE, count
            self._H[:] = square[:-1, :-1]
            self._diagonal += 1e-12 * max(self._diagonal.max(), 1e-300)
            z, _, flag, _ = daqp.solve(
                self._H,
                square[:-1, -1].copy(),
                self._none,
                (self._high - u) / self._both,
                (self._low - u) / self._both,
                primal_tol=1e-9,
                dual_tol=1e-10,
            )
            if flag != 1:
                return (Status.INFEASIBLE if flag == -1 else Status.FAILED), count
            self._move(z, u)
            took = perf_counter() - begin
        return (Status.TIME_OUT if perf_counter() > until else Status.REAL_TIME), iterations

    def _condense(self, u: np.ndarray) -> None:
        """Weighted errors and inputs by the scaled step and, in the last column, without one."""
        if self._long:
            self._x_stages[:] = self.x[1 + self._nodes]
        self._stage()
        for A, here, after in self._A:
            np.matmul(A, here, out=after)
        np.matmul(self._E, self._G[self._nodes] if self._long else self._G, out=self._errors)
        np.subtract(self._inputs @ u, self._wanted, out=self._now)

    def _move(self, z: np.ndarray, u: np.ndarray) -> None:
        """Take the step and find the model there; stage slopes follow along their derivatives."""
        n = self._n
        self._z[:], self.before[:] = z, self._slopes[1:]
        self._after()
        self.x[:], self.k[:] = self._x_after, self._k_after
        self.x[0] = self._x0
        u += z * self._both
        np.minimum(np.maximum(u, self._low, out=u), self._high, out=u)
        self.u[:-2] = self.u[1:-1]
        self.u[-2:] = self.u[-3]
        self._w[:-1] = self._w[1:]
        if self._long:
            self._u_steps[:-1], self._u_steps[-1] = self.u[self._held], self.u[n]
            self._w_steps[:-1], self._w_steps[-1] = self._w[self._held], self._w[n]
            self._x_stages[:] = self.x[self._nodes]
        self._node()
        if self.k.size and not np.abs(self._slopes - self.k).max() * self._dt <= DOUBT:
            self.k[:] = self._slopes
            self._node()
        self._truth()
        cost, violation, off, reach, beyond, bend = self._measures[0].tolist()
        residual = max(off, reach * (beyond / bend if beyond < bend else 1.0))
        known = isfinite(cost + residual + beyond)
        self.truth = (cost, violation, residual) if known else (cost, np.inf, np.inf)

    def _stay(self) -> None:
        """The plan is the next guess, not that of a step before."""
        for rows in (self.x, self.u, self._w, self.k, *self._derivatives):
            rows[1:] = rows[:-1].copy()
        self._gap[:] = self._G[0, : self._nx, -1] = 0.0


def _augmented(node: ca.Function, scale: np.ndarray) -> ca.Function:
    """``(x, u, w, k, slopes, after) -> [A, next - after, B scaled; 0, 1, 0], Z scaled, k``, first two stored by row."""
    given = arguments(node)
    kind, results_at, nx, nu = type(given[0]), node.call(given), node.size1_in(0), node.size1_in(1)
    after = kind.sym("after", nx)
    unit = ca.diag(ca.DM(scale))
    top = ca.horzcat(results_at[1], results_at[0] - after, ca.mtimes(results_at[2], unit))
    last = ca.horzcat(kind.zeros(1, nx), kind.ones(1, 1), kind.zeros(1, nu))
    results = [ca.densify(ca.vertcat(top, last)).T, kind(0, 1), kind(0, 1)]
    if len(results_at) > 3:
        nc = results_at[4].shape[1] - nu
        Z = ca.horzcat(results_at[4][:, :nc], ca.mtimes(results_at[4][:, nc:], unit))
        results[1:] = ca.densify(Z).T, results_at[3]
    return ca.Function("augmented", [*given, after], results)


def _errors(stage: ca.Function, scale: np.ndarray) -> ca.Function:
    """``(x, u, w, p, root) -> [derivative by x, error, derivative by the scaled u]`` times root, stored by row."""
    given = arguments(stage)
    derivatives = stage.call(given)
    root = type(given[0]).sym("root", stage.size1_out(0))
    rows = ca.horzcat(derivatives[2], derivatives[0], ca.mtimes(derivatives[3], ca.diag(ca.DM(scale))))
    return ca.Function("errors", [*given, root], [ca.densify(ca.mtimes(ca.diag(root), rows)).T])


def _values(stage: ca.Function) -> ca.Function:
    """``(x, u, w, p, root) -> error times root``."""
    given = arguments(stage)
    root = type(given[0]).sym("root", stage.size1_out(0))
    return ca.Function("values", [*given, root], [root * stage.call(given)[0]])


def _input_rows(ocp: OCP) -> tuple[np.ndarray, np.ndarray]:
    """What inputs cost as rows whose squares add up, by all inputs, and which of all rows they are: changes first."""
    size, nu = ocp.horizon * len(ocp.controls), len(ocp.controls)
    _, r, s = ocp.stage_weights
    change, one = np.eye(size) - np.eye(size, k=-nu), np.eye(size)
    inputs = np.vstack([np.sqrt(s).reshape(-1, 1) * change, np.sqrt(r).reshape(-1, 1) * one])
    used = np.flatnonzero(inputs.any(axis=1))
    return inputs[used], used


def _after(ocp: OCP, core: Sequence[int]) -> ca.Function:
    """``(z, gap, A, k, Z, E, x) -> slopes, x, dx, errors, multipliers, curvature`` of a step in the linear model.

    z is the scaled step of the inputs, gap that of the first state; A, k, Z and E are those of `InputStep`, x the
    states of the guess from the row before its first on. Slopes and states are those of the plan and of the step after
    its last, which begins where that one ended. The curvature is that of the cost along the step.
    """
    n, steps, nx, nu, ne = ocp.horizon, int(ocp.nodes[-1]), ocp.model.n_states, len(ocp.controls), len(ocp.tracked)
    wide, nodes = nx + 1 + nu, ocp.nodes.tolist()
    z, gap, x = ca.MX.sym("z", nu, n), ca.MX.sym("gap", nx), ca.MX.sym("x", nx, steps + 2)
    slopes = 3 * len(core)
    k, ZT = ca.MX.sym("k", slopes, steps + 1), ca.MX.sym("Z", len(core) + nu if core else 0, slopes * (steps + 1))
    AT, ET = ca.MX.sym("A", wide, (nx + 1) * (steps + 1)), ca.MX.sym("E", wide, ne * (n + 1))
    A, E = ca.horzsplit(AT, nx + 1), ca.horzsplit(ET, ne)
    inputs, points = ca.horzsplit(z), ca.horzsplit(x)
    moved = [ca.vertcat(gap, 1, inputs[0])]
    for j, i in enumerate([*ocp.stage_of[1:], n - 1], start=1):
        moved.append(ca.vertcat(ca.mtimes(moved[-1].T, A[j])[:nx].T, 1, inputs[i]))
    later = [point + m[:nx] for point, m in zip(points[1:], moved, strict=True)]
    if core:
        ahead = ca.vertcat(later[-1] - points[steps], 1, inputs[-1])
        Z, at = ca.horzsplit(ZT, slopes), [*core, *range(nx + 1, wide)]
        pairs = zip([*moved[:-1], ahead], [*Z[1:], Z[-1]], strict=True)
        k_after = ca.horzcat(k[:, 1:], k[:, -1]) + along(
            ca.horzcat(*(ca.mtimes(m[at].T, z).T for m, z in pairs)), ocp.dt
        )
    else:
        k_after = ca.MX(0, steps + 1)
    errors = [ca.mtimes(moved[j].T, E[i]) for i, j in enumerate(nodes)]
    rows = ca.sparsify(ca.DM(_input_rows(ocp)[0] * np.tile(input_scale(ocp), n)))
    bend = ca.sumsqr(ca.horzcat(*errors) - ET[nx, :]) + ca.sumsqr(ca.mtimes(rows, ca.vec(z)))
    forced = {j: ca.mtimes(E[i], errors[i].T)[:nx] for i, j in enumerate(nodes)}
    pi = [forced[steps]]
    for j in range(steps - 1, 0, -1):
        back = ca.mtimes(A[j + 1], ca.vertcat(pi[-1], 0))[:nx]
        pi.append(back + forced[j] if j in forced else back)
    dx = ca.horzcat(*(m[:nx] for m in moved[1:]))
    states = ca.horzcat(*later, 2 * later[-1] - later[-2])
    results = [k_after, states, dx, ca.horzcat(*errors), ca.horzcat(*reversed(pi)), bend]
    return ca.Function("after", [z, gap, AT, k, ZT, ET, x], results)


def _truth(ocp: OCP, values: ca.Function) -> ca.Function:
    """Of a plan and the step to it: cost, violation, that in units, reach, twice what is beyond the model, curvature.

    ``(x, x of stages, u, w, p, root, A, wanted, z, dx, errors, multipliers, curvature)``: `interpreted_truth` has the
    same measures in words. The last four are those of `_after`.
    """
    n, steps, nx = ocp.horizon, int(ocp.nodes[-1]), ocp.model.n_states
    x, at, u = ca.MX.sym("x", nx, steps + 1), ca.MX.sym("at", nx, n + 1), ca.MX.sym("u", len(ocp.controls), n + 1)
    w, p = ca.MX.sym("w", len(ocp.exogenous), n + 1), ca.MX.sym("p", len(ocp.references), n + 1)
    root, A = (
        ca.MX.sym("root", len(ocp.tracked), n + 1),
        ca.MX.sym("A", nx + 1 + len(ocp.controls), (nx + 1) * (steps + 1)),
    )
    rows, _ = _input_rows(ocp)
    wanted, z = ca.MX.sym("wanted", len(rows)), ca.MX.sym("z", rows.shape[1])
    dx, pi, bend = ca.MX.sym("dx", nx, steps), ca.MX.sym("pi", nx, steps), ca.MX.sym("bend")
    errors = ca.MX.sym("errors", 1, root.numel())
    e = ca.vec(values(at, u, w, p, root)).T
    defects = ca.reshape(A[nx, :], nx + 1, steps + 1)[:nx, :steps]
    costs = ca.mtimes(ca.sparsify(ca.DM(rows)), ca.vec(u[:, :n])) - wanted
    units = ca.repmat(1 + ca.sum2(ca.fabs(x[:, 1:] - x[:, :-1])) / steps, 1, steps)
    reach = ca.fmax(_largest(z), _largest(dx / units))
    beyond = ca.sum2(ca.fabs(e * (e - errors))) + ca.sum1(ca.fabs(ca.vec(pi * defects)))
    measures = ca.vertcat(
        ca.sumsqr(e) + ca.sumsqr(costs), _largest(defects), _largest(defects / units), reach, 2 * beyond, bend
    )
    return ca.Function("truth", [x, at, u, w, p, root, A, wanted, z, dx, errors, pi, bend], [measures])


def _largest(values: ca.MX) -> ca.MX:
    """Largest size of an entry; CasADi 3.6 cannot evaluate its own norm_inf."""
    return ca.mmax(ca.fabs(ca.vec(values)))
