"""Real-time iterations without a compiler where only inputs are limited: few calls, no copies, memory made once."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import casadi as ca
import daqp
import numpy as np

from slipangle.control.ocp import OCP, Reference
from slipangle.control.plan import Status, finite, inputs_later
from slipangle.control.realtime.interpreted_model import bind, columns, newton_columns
from slipangle.control.realtime.interpreted_truth import Promise, reach_of
from slipangle.control.realtime.parts import Implicit, input_scale


class InputStep:
    """Full Gauss-Newton steps on a problem whose only limits are bounds of inputs.

    Everything is a function of ``(x, 1, u)``, so that one product per stage condenses derivatives, defects and inputs
    alike: `_G` holds it by the scaled step of all inputs and, in the last column, without one. Inputs are counted in
    units of `input_scale`. Costs are sums of squares of rows, those of inputs below those of errors.

    Parameters
    ----------
    ocp : OCP
        The problem.
    node, stage : Function
        What `functions` gives.
    """

    def __init__(self, ocp: OCP, node: ca.Function, stage: ca.Function) -> None:
        n, nx, nu, ne = ocp.horizon, ocp.model.n_states, len(ocp.controls), len(ocp.tracked)
        self._n, size, wide, steps = n, n * nu, nx + 1 + nu, int(ocp.nodes[-1])
        self._lengths, self._nodes, self._held = ocp.lengths, ocp.nodes, ocp.stage_of
        self._long = steps > n  # otherwise steps and stages share their arrays
        scale = input_scale(ocp)
        self._both = np.tile(scale, n)
        self.u, self.x = np.zeros((n + 1, nu)), np.zeros((steps + 1, nx))
        self._w, self._p = np.zeros((n + 1, len(ocp.exogenous))), np.zeros((n + 1, len(ocp.references)))
        slopes = node.numel_out(1) // steps
        self.k = np.zeros((steps, slopes))
        self._x_stages, self._u_steps, self._w_steps = self.x, self.u, self._w
        if self._long:
            self._x_stages, self._u_steps = np.zeros((n + 1, nx)), np.zeros((steps, nu))
            self._w_steps = np.zeros((steps, len(ocp.exogenous)))
        kept = [self.k] if slopes else []
        self._node, (A, self.slopes) = bind(node, steps, [self.x, self._u_steps, self._w_steps, *kept, self.x[1:]])
        q, r, s = ocp.stage_weights
        self._stage, (E,) = bind(stage, n + 1, [self._x_stages, self.u, self._w, self._p, np.sqrt(q)])
        self._G = np.zeros((steps + 1, wide, size + 1))
        self._G[0, nx, -1] = 1.0  # the first state is the one measured
        for G, i in zip(self._G, [*self._held, n - 1], strict=True):
            G[nx + 1 :, i * nu : (i + 1) * nu] = np.eye(nu)
        self._flat = self._G.reshape(-1, size + 1)
        self._A = list(zip(A.reshape(steps, nx + 1, wide), self._G[:-1], self._G[1:, : nx + 1], strict=True))
        self._E = E.reshape(n + 1, ne, wide)
        change, one = np.eye(size) - np.eye(size, k=-nu), np.eye(size)
        inputs = np.vstack([np.sqrt(s).reshape(-1, 1) * change, np.sqrt(r).reshape(-1, 1) * one])
        self._used = np.flatnonzero(inputs.any(axis=1))
        self._inputs, self._by_change, self._by_input = inputs[self._used], np.sqrt(s[0]), np.sqrt(r)
        self._before = np.zeros(2 * size)
        self._rows = np.zeros(((n + 1) * ne + len(self._inputs), size + 1))
        self._errors = self._rows[: (n + 1) * ne].reshape(n + 1, ne, size + 1)
        self._rows[(n + 1) * ne :, :-1] = self._inputs * self._both
        self._now = self._rows[(n + 1) * ne :, -1]
        self._low, self._high = (np.tile(b, n) for b in ocp.input_bounds.T)
        self._H = np.zeros((size, size))
        self._diagonal = self._H.reshape(-1)[:: size + 1]
        self._step = np.ones(size + 1)
        self._none = np.zeros((0, size))
        self._dx = np.zeros(self.x.shape)

    @staticmethod
    def functions(
        ocp: OCP, parts: Implicit | None, node: ca.Function, stage: ca.Function
    ) -> tuple[ca.Function, ca.Function]:
        """Model and errors of all steps.

        Parameters
        ----------
        ocp : OCP
            The problem.
        parts : Implicit, optional
            Of the integrator.
        node : Function
            ``(x, u, w, k, slopes) -> next, A, B, k``, dense; without k and slopes for explicit models.
        stage : Function
            ``(x, u, w, p) -> error, limited`` and their derivatives by x and u, dense.
        """
        scale = input_scale(ocp)
        many = newton_columns(ocp, parts, _augmented(node, scale), int(ocp.nodes[-1]))
        return many, columns(_errors(stage, scale), ocp.horizon + 1)

    def load(
        self,
        x: np.ndarray,
        applied: np.ndarray,
        reference: Reference,
        u: np.ndarray,
        states: np.ndarray,
        k: np.ndarray,
    ) -> None:
        """Start from a plan's inputs, states and slopes, shifted; the step closes the gap to the last state."""
        n = self._n
        if self._long:
            self.u[:n] = inputs_later(u, self._lengths)
        else:
            self.u[: n - 1], self.u[n - 1] = u[1:], u[-1]
        self.x[:-1] = states[1:]
        self.x[0] = x
        self.x[-1] = 2 * self.x[-2] - self.x[-3] if len(self.x) > 2 else states[1]
        self.k[:-1], self.k[-1] = k[1:], k[-1]
        self._w[:n], self._w[n] = reference.exogenous[:n], reference.exogenous[-1]
        self._p[:] = reference.tracked
        self._before[: len(applied)] = self._by_change * applied
        if reference.inputs is not None:
            self._before[len(self._both) :] = np.ravel(self._by_input * reference.inputs)
        else:
            self._before[len(self._both) :] = 0.0
        self._wanted = self._before[self._used]

    def run(self, iterations: int, until: float) -> tuple[Status, int]:
        """Some full steps: status and how many."""
        rows, u = self._rows, self.u[:-1].reshape(-1)
        took = 0.0
        for count in range(iterations):
            begin = perf_counter()
            if begin + took > until and count:
                return Status.TIME_OUT, count
            if count:
                self.k[:] = self.slopes
            self._condense()
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
            self._step[:-1] = z
            u += z * self._both
            np.minimum(np.maximum(u, self._low, out=u), self._high, out=u)
            self._dx = (self._flat @ self._step).reshape(len(self.x), -1)[:, : self.x.shape[1]]
            self.x += self._dx
            took = perf_counter() - begin
        return (Status.TIME_OUT if perf_counter() > until else Status.REAL_TIME), iterations

    def promise(self) -> Promise:
        """What the linear model makes of the last step."""
        nx, z = self.x.shape[1], self._step[:-1]
        after = self._errors @ self._step
        change = self._rows[self._errors.size // len(self._step) :, :-1] @ z
        bend = np.square(after - self._E[:, :, nx]).sum() + change @ change
        pi = np.zeros(self.x.shape)
        pi[self._nodes] = (after[:, None] @ self._E[:, :, :nx])[:, 0]
        for j in range(len(self._A) - 1, -1, -1):
            pi[j] += pi[j + 1] @ self._A[j][0][:nx, :nx]
        return Promise(
            errors=after,
            limited=np.zeros(0),
            multipliers=np.zeros(0),
            pi=pi,
            bend=float(bend),
            reach=reach_of(z, self.x, self._dx),
        )

    def _condense(self) -> None:
        """Weighted errors and inputs by the scaled step and, in the last column, without one."""
        self.u[-1] = self.u[-2]
        if self._long:
            self._x_stages[:] = self.x[self._nodes]
            self._u_steps[:], self._w_steps[:] = self.u[self._held], self._w[self._held]
        self._node()
        self._stage()
        for A, here, after in self._A:
            np.matmul(A, here, out=after)
        np.matmul(self._E, self._G[self._nodes] if self._long else self._G, out=self._errors)
        self._now[:] = self._inputs @ self.u[:-1].reshape(-1) - self._wanted


def _augmented(node: ca.Function, scale: np.ndarray) -> ca.Function:
    """``(x, u, w, k, slopes, after) -> [A, next - after, B scaled; 0, 1, 0], k``, stored by row."""
    kind: Any = ca.SX if node.is_a("SXFunction") else ca.MX
    given = [kind.sym(node.name_in(i), *node.size_in(i)) for i in range(node.n_in())]
    found = node.call(given)
    after = kind.sym("after", node.size1_in(0))
    nx, nu = node.size1_in(0), node.size1_in(1)
    top = ca.horzcat(found[1], found[0] - after, ca.mtimes(found[2], ca.diag(ca.DM(scale))))
    last = ca.horzcat(kind.zeros(1, nx), kind.ones(1, 1), kind.zeros(1, nu))
    results = [ca.densify(ca.vertcat(top, last)).T, ca.densify(found[3]) if len(found) > 3 else kind(0, 1)]
    return ca.Function("augmented", [*given, after], results)


def _errors(stage: ca.Function, scale: np.ndarray) -> ca.Function:
    """``(x, u, w, p, root) -> [derivative by x, error, derivative by the scaled u]`` times root, stored by row."""
    kind: Any = ca.SX if stage.is_a("SXFunction") else ca.MX
    given = [kind.sym(name, stage.size1_in(i)) for i, name in enumerate("xuwp")]
    found = stage.call(given)
    root = kind.sym("root", found[0].shape[0])
    rows = ca.horzcat(found[2], found[0], ca.mtimes(found[3], ca.diag(ca.DM(scale))))
    return ca.Function("errors", [*given, root], [ca.densify(ca.mtimes(ca.diag(root), rows)).T])
