"""Model code for CasADi's virtual machine: one Newton step of the implicit integrator, calls without copies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from slipangle.control.ocp import OCP
from slipangle.control.realtime.program import Implicit
from slipangle.models.integrate import RADAU_A


def newton_node(ocp: OCP, parts: Implicit) -> ca.Function:
    """``(x, u, w, k) -> next, A, B, k``: one Newton step on the stages of Radau IIA, and the derivatives there."""
    x, u, w = (ca.SX.sym(n, parts.slopes.size1_in(i)) for i, n in enumerate("xuw"))
    core, rest = list(parts.core), list(parts.rest)
    nc, nk, nu, nx, h = len(core), 3 * len(core), parts.slopes.size1_in(1), ocp.model.n_states, ocp.dt
    k = ca.SX.sym("k", nk)
    matrix, right = ca.SX.eye(nk), ca.SX(nk, 1 + nc + nu)
    for j in range(3):
        place = ca.SX(x)
        for c, a in enumerate(core):
            place[a] = x[a] + h * sum(RADAU_A[j, m] * k[3 * c + m] for m in range(3))
        f, fx, fu = parts.slopes(place, u, w)
        for a in range(nc):
            row = 3 * a + j
            right[row, 0] = k[row] - f[a]
            right[row, 1 : 1 + nc] = fx[a, :]
            right[row, 1 + nc :] = fu[a, :]
            for b in range(nc):
                if fx.has_nz(a, b):
                    for m in range(3):
                        matrix[row, 3 * b + m] -= h * RADAU_A[j, m] * fx[a, b]
    solved = _eliminate(ca.sparsify(matrix), ca.sparsify(right))
    slopes, sensitivity = k - solved[:, 0], solved[:, 1:]
    later, A, B = ca.SX(x), ca.SX.eye(nx), ca.SX(nx, nu)
    for c, a in enumerate(core):
        weights = [h * float(RADAU_A[2, m]) for m in range(3)]
        three = slice(3 * c, 3 * c + 3)
        later[a] = x[a] + ca.mtimes(ca.DM(weights).T, slopes[three])
        row = ca.mtimes(ca.DM(weights).T, sensitivity[three, :])
        for b in range(nc):
            A[a, core[b]] = row[b] + (1.0 if a == core[b] else 0.0)
        B[a, :] = row[nc:]
    if rest:
        q, qk, qx, qu = parts.quadrature(slopes, x, u, w)
        through = ca.mtimes(qk, sensitivity)
        for i, a in enumerate(rest):
            later[a] = q[i]
            A[a, :] = qx[i, :]
            for b in range(nc):
                A[a, core[b]] += through[i, b]
            B[a, :] = qu[i, :] + through[i, nc:]
    results = ca.cse([ca.densify(later), ca.densify(A), ca.densify(B), ca.densify(slopes)])
    return ca.Function("node", [x, u, w, k], results)


def _eliminate(matrix: Any, right: Any) -> Any:
    """Solution of a system with structural zeros, without pivoting."""
    n, m = matrix.shape[0], right.shape[1]
    a = [{j: matrix[i, j] for j in range(n) if matrix.has_nz(i, j)} for i in range(n)]
    b = [{j: right[i, j] for j in range(m) if right.has_nz(i, j)} for i in range(n)]
    for k in range(n):
        inverse = 1 / a[k][k]
        for i in range(k + 1, n):
            if k not in a[i]:
                continue
            factor = a[i].pop(k) * inverse
            for row, other in ((a[i], a[k]), (b[i], b[k])):
                for j, value in other.items():
                    if row is b[i] or j > k:
                        row[j] = row[j] - factor * value if j in row else -factor * value
    out = ca.SX(n, m)
    for i in reversed(range(n)):
        inverse = 1 / a[i][i]
        for c in range(m):
            value = b[i].get(c, ca.SX(0))
            for j, coefficient in a[i].items():
                if j > i:
                    value = value - coefficient * out[j, c]
            out[i, c] = value * inverse
    return out


def dense(function: ca.Function) -> ca.Function:
    """The function with dense outputs."""
    kind: Any = ca.SX if function.is_a("SXFunction") else ca.MX
    inputs = [kind.sym(function.name_in(i), function.size1_in(i)) for i in range(function.n_in())]
    return ca.Function(function.name(), inputs, [ca.densify(o) for o in function.call(inputs)])


def bind(function: ca.Function, times: int, inputs: list[np.ndarray]) -> tuple[Callable[[], None], list[np.ndarray]]:
    """A call that evaluates ``times`` columns at once from the first rows of ``inputs``, and its outputs, by row."""
    many = function.map(times)
    outputs = [np.zeros((times, function.numel_out(i))) for i in range(function.n_out())]
    buffer: Any
    buffer, run = many.buffer()
    for i, array in enumerate(inputs):
        if array.size:
            buffer.set_arg(i, array.data)
    for i, array in enumerate(outputs):
        if array.size:
            buffer.set_res(i, array.data)

    def call(keep: Any = (many, buffer, inputs)) -> None:  # they must outlive the call
        run()

    return call, outputs
