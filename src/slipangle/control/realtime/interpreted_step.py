"""Real-time iterations without a compiler where only inputs are limited: few calls, no copies, memory made once."""

from __future__ import annotations

from math import isfinite
from time import perf_counter
from typing import Any

import casadi as ca
import daqp
import numpy as np

from slipangle.control.ocp import OCP, Reference
from slipangle.control.plan import Status, inputs_later
from slipangle.control.realtime.interpreted_model import bind
from slipangle.control.realtime.program import input_scale


class InputStep:
    """Full Gauss-Newton steps on a problem whose only limits are bounds of inputs.

    States carry a constant 1 as their last entry, so that one product per stage condenses derivatives and defects
    alike. Inputs are counted in units of `input_scale`.

    Parameters
    ----------
    ocp : OCP
        The problem.
    node : Function
        ``(x, u, w, k) -> next, A, B, k``, dense; k of no entries for explicit models.
    stage : Function
        ``(x, u, w, p) -> error, limited`` and their derivatives by x and u, dense.
    """

    def __init__(self, ocp: OCP, node: ca.Function, stage: ca.Function) -> None:
        n, nx, nu, steps = ocp.horizon, ocp.model.n_states, len(ocp.controls), int(ocp.nodes[-1])
        self._sizes = n, nx, nu
        size, wide = n * nu, nx + 1
        scale = input_scale(ocp)
        self.u, self.x = np.zeros((n + 1, nu)), np.zeros((steps + 1, nx))
        self._w, self._after = np.zeros((n + 1, len(ocp.exogenous))), np.zeros((steps, nx))
        self.k = np.zeros((steps, node.size1_in(3) if node.n_in() > 3 else 0))
        self._p = np.zeros((n + 1, len(ocp.references)))
        self._lengths, self._nodes = ocp.lengths, ocp.nodes
        self._held = ocp.stage_of if steps > n else None  # otherwise steps and stages share their arrays
        at_stages, u, w = self.x, self.u, self._w
        if self._held is not None:
            at_stages, u, w = np.zeros((n + 1, nx)), np.zeros((steps, nu)), np.zeros((steps, len(ocp.exogenous)))
        self._at_stages, self._u_held, self._w_held = at_stages, u, w
        given = [self.x, u, w, self.k, self._after]
        self._node, (self._A, self._B, self._slopes) = bind(_augmented(node, scale), steps, given)
        stage_in = [at_stages, self.u, self._w, self._p]
        self._stage, (self._E, self._D) = bind(_errors(stage, scale), n + 1, stage_in)
        self._A, self._B = self._A.reshape(steps, wide, wide), self._B.reshape(steps, wide, nu)
        ne = len(ocp.tracked)
        self._E, self._D = self._E.reshape(n + 1, ne, wide), self._D.reshape(n + 1, ne, nu)
        self._through = bool(stage.nnz_out(3)) and bool(stage.sparsity_out(3).nnz())
        q, r, s = ocp.stage_weights
        self._root = np.sqrt(q)[:, :, None]
        change, both = np.eye(size) - np.eye(size, k=-nu), np.tile(scale, n)
        inputs = change.T @ np.diag(s.ravel()) @ change + np.diag(r.ravel())
        self._quadratic = both[:, None] * inputs * both
        self._scale, self._both = scale, both
        self._r, self._s = r.ravel(), s[0]
        low, high = ocp.input_bounds.T
        self._low, self._high = np.tile(low, n) / both, np.tile(high, n) / both
        self._range = low, high
        self._G = np.zeros((steps + 1, wide, size + 1))
        self._G[0, -1, -1] = 1.0
        pairs = [
            (self._A[m], self._G[m], self._G[m + 1], self._G[m + 1][:, i * nu : (i + 1) * nu], self._B[m])
            for m, i in enumerate(ocp.stage_of.tolist())
        ]
        self._stages = pairs
        self._rows = np.zeros((n + 1, ne, size + 1))
        self._H = np.zeros((size, size))
        self._diagonal = self._H.reshape(-1)[:: size + 1]
        self._step = np.ones(size + 1)
        self._none = np.zeros((0, size))

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
        n, last = self._sizes[0], len(states) - 1
        low, high = self._range
        if self._held is None:
            self.u[: n - 1], self.u[n - 1] = u[1:], u[-1]
        else:
            self.u[:n] = inputs_later(u, self._lengths)
        np.maximum(self.u, low, out=self.u)
        np.minimum(self.u, high, out=self.u)
        self.x[:last] = states[1:]
        self.x[0] = x
        self.x[last] = 2 * self.x[last - 1] - self.x[last - 2] if last > 1 else states[1]
        self.k[:-1], self.k[-1] = k[1:], k[-1]
        self._w[:n], self._w[n] = reference.exogenous, reference.exogenous[-1]
        self._p[:] = reference.tracked
        wanted = None if reference.inputs is None else np.asarray(reference.inputs, dtype=float).ravel()
        self._pull = np.zeros(len(self._both)) if wanted is None else self._both * self._r * wanted
        self._pull[: len(applied)] += self._scale * self._s * applied
        self._constant = float(self._s @ (applied * applied))
        if wanted is not None:
            self._constant += float(self._r @ (wanted * wanted))

    def run(self, iterations: int, until: float) -> tuple[Status, float, int, float]:
        """Some full steps: status, cost, how many, and the size of the last."""
        n, nx, _ = self._sizes
        cost, size = float("nan"), 0.0
        for count in range(iterations):
            rows = self._condense()
            square = rows.T @ rows
            np.add(square[:-1, :-1], self._quadratic, out=self._H)
            v = self.u[:n].ravel() / self._both
            slope = square[:-1, -1] + self._quadratic @ v - self._pull
            if not isfinite(square.sum()):
                return Status.NOT_FINITE, cost, count, size
            self._diagonal += 1e-12 * max(self._diagonal.max(), 1e-300)
            z, _, flag, _ = daqp.solve(
                self._H, slope, self._none, self._high - v, self._low - v, primal_tol=1e-9, dual_tol=1e-10
            )
            if flag != 1:
                return (Status.INFEASIBLE if flag == -1 else Status.FAILED), cost, count, size
            self._step[:-1] = z
            v += z
            self.u[:n] = (v * self._both).reshape(n, -1)
            self.x += (self._G.reshape(-1, len(self._step)) @ self._step).reshape(-1, nx + 1)[:, :nx]
            self.k[:] = self._slopes
            e = rows @ self._step
            cost = float(e @ e + v @ (self._quadratic @ v - 2 * self._pull)) + self._constant
            size = max(float(z.max()), -float(z.min()))
            if perf_counter() > until:
                return Status.TIME_OUT, cost, count + 1, size
        return Status.REAL_TIME, cost, iterations, size

    def _condense(self) -> np.ndarray:
        """Weighted errors by the scaled inputs and, in the last column, without a step in them."""
        n, nx, nu = self._sizes
        self.u[n] = self.u[n - 1]
        self._after[:] = self.x[1:]
        if self._held is not None:
            self._at_stages[:] = self.x[self._nodes]
            self._u_held[:], self._w_held[:] = self.u[self._held], self._w[self._held]
        self._G[0, :nx, -1] = 0.0  # the first state is the one measured
        self._node()
        self._stage()
        for A, G, after, here, B in self._stages:
            np.matmul(A, G, out=after)
            here += B
        G = self._G if self._held is None else self._G[self._nodes]
        np.matmul(self._E * self._root, G, out=self._rows)
        if self._through:
            for i in range(n + 1):
                at = min(i, n - 1) * nu
                self._rows[i, :, at : at + nu] += self._root[i] * self._D[i]
        return self._rows.reshape(-1, n * nu + 1)


def _augmented(node: ca.Function, scale: np.ndarray) -> ca.Function:
    """``(x, u, w, k, after) -> [A, next - after; 0, 1], [B; 0] scaled, k``, stored by row."""
    kind: Any = ca.SX if node.is_a("SXFunction") else ca.MX
    given = [kind.sym(name, node.size1_in(i)) for i, name in zip(range(node.n_in()), "xuwk", strict=False)]
    k = given[3] if len(given) > 3 else kind.sym("k", 0)
    found = node.call(given)
    slopes = found[3] if len(found) > 3 else kind(0, 1)
    after = kind.sym("after", node.size1_in(0))
    nx, nu = node.size1_in(0), node.size1_in(1)
    last = ca.horzcat(kind.zeros(1, nx), kind.ones(1, 1))
    A = ca.vertcat(ca.horzcat(found[1], found[0] - after), last)
    B = ca.vertcat(ca.mtimes(found[2], ca.diag(ca.DM(scale))), kind.zeros(1, nu))
    results = [ca.densify(A).T, ca.densify(B).T, ca.densify(slopes)]
    return ca.Function("augmented", [*given[:3], k, after], results)


def _errors(stage: ca.Function, scale: np.ndarray) -> ca.Function:
    """``(x, u, w, p) -> [derivative by x, error], derivative by the scaled u``, stored by row."""
    kind: Any = ca.SX if stage.is_a("SXFunction") else ca.MX
    given = [kind.sym(name, stage.size1_in(i)) for i, name in enumerate("xuwp")]
    found = stage.call(given)
    by_state, by_input = ca.horzcat(found[2], found[0]), ca.mtimes(found[3], ca.diag(ca.DM(scale)))
    return ca.Function("errors", given, [ca.densify(by_state).T, ca.densify(by_input).T])
