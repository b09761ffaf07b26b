"""Model code for CasADi's virtual machine: one Newton step of the implicit integrator, calls without copies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from slipangle.codegen.derivatives import jacobians
from slipangle.codegen.expression import arguments, fewer_divisions, scalar_code
from slipangle.numerics.integrate import RADAU_A
from slipangle.optimal.ocp import OCP
from slipangle.optimal.realtime.parts import Implicit, rest_after

MOST_INSTRUCTIONS = 20_000  # that are turned into one of columns each


def newton_node(ocp: OCP, parts: Implicit) -> ca.Function:
    """``(x, u, w, k, slopes) -> next, A, B, k, Z``: one Newton step on the stages of Radau IIA, and derivatives there.

    ``Z`` is how the three stages of each state of the core move away from it, by the core and u: see `along`.

    ``slopes`` has one column per stage, what `parts.slopes` gives there: see `columns`. In the stages z themselves,
    ``inv(A) (z - x) = h f(z)``, one state is coupled over the stages with constants only, which takes the fewest
    operations to eliminate; the last stage is the state at the end of the step.
    """
    x, u, w = (ca.SX.sym(n, parts.slopes.size1_in(i)) for i, n in enumerate("xuw"))
    core, rest = list(parts.core), list(parts.rest)
    nc, nk, nu, nx, h = len(core), 3 * len(core), parts.slopes.size1_in(1), ocp.model.n_states, ocp.dt
    k, slopes = ca.SX.sym("k", nk), ca.SX.sym("slopes", sum(parts.slopes.nnz_out(i) for i in range(3)), 3)
    inverse = np.linalg.inv(RADAU_A)
    move = [h * sum(RADAU_A[j, m] * k[3 * c + m] for m in range(3)) for c in range(nc) for j in range(3)]
    matrix, right = ca.SX(nk, nk), ca.SX(nk, 1 + nc + nu)
    for j in range(3):
        first = np.cumsum([0, *(parts.slopes.nnz_out(i) for i in range(3))])
        f, fx, fu = (
            ca.SX(parts.slopes.sparsity_out(i), slopes[int(first[i]) : int(first[i + 1]), j]) for i in range(3)
        )
        for a in range(nc):
            row = 3 * a + j
            right[row, 0] = h * (k[row] - f[a])  # inv(A) (z - x) is h k
            right[row, 1 + a] = float(inverse[j].sum())
            right[row, 1 + nc :] = h * fu[a, :]
            for m in range(3):
                matrix[row, 3 * a + m] = float(inverse[j, m])
            for b in range(nc):
                if fx.has_nz(a, b):
                    matrix[row, 3 * b + j] -= h * fx[a, b]
    behind = _rest(parts, nx, h) if rest else None
    ends = [3 * c + 2 for c in range(nc)]
    solved = _eliminate(ca.sparsify(matrix), ca.sparsify(right))
    step, by_start = solved[:, 0], solved[:, 1:]
    z = ca.vertcat(*[x[core[i // 3]] + move[i] - step[i] for i in range(nk)])
    after = [
        k[3 * c + j] - sum(inverse[j, m] / h * step[3 * c + m] for m in range(3)) for c in range(nc) for j in range(3)
    ]
    later, A, B = ca.SX(x), ca.SX.eye(nx), ca.SX(nx, nu)
    for i, a in enumerate(core):
        later[a] = z[ends[i]]
        for b in range(nc):
            A[a, core[b]] = by_start[ends[i], b]
        B[a, :] = by_start[ends[i], nc:]
    if behind:
        q, by_stages, by_state, by_input = behind(z, x, u, w)
        through = ca.mtimes(by_stages, by_start)
        for i, a in enumerate(rest):
            later[a] = q[i]
            A[a, :] = by_state[i, :]
            for b in range(nc):
                A[a, core[b]] += through[i, b]
            B[a, :] = by_input[i, :] + through[i, nc:]
    Z = ca.SX(by_start)
    for c in range(nc):
        Z[3 * c : 3 * c + 3, c] -= 1
    results = [ca.densify(later), ca.densify(A), ca.densify(B), ca.densify(ca.vertcat(*after)), ca.densify(Z)]
    return ca.Function("node", [x, u, w, k, slopes], results)


def along(moved: Any, h: float) -> Any:
    """Changes of stage slopes where stages move away from the states by so much, three of each state in a column."""
    slopes = ca.mtimes(ca.DM(np.linalg.inv(RADAU_A) / h), ca.reshape(moved, 3, moved.numel() // 3))
    return ca.reshape(slopes, *moved.shape)


def _rest(parts: Implicit, nx: int, h: float) -> ca.Function:
    """``(z, x, u, w) -> rest`` behind the stages z of the core, three of each state, and its derivatives."""
    x, u, w = (ca.SX.sym(n, parts.derivative.size1_in(i)) for i, n in enumerate("xuw"))
    z = ca.SX.sym("z", 3 * len(parts.core))
    places = []
    for j in range(3):
        place = ca.SX(x)
        for c, a in enumerate(parts.core):
            place[a] = z[3 * c + j]
        places.append(place)
    q = rest_after(parts.derivative, parts.rest, h, x, u, w, places)
    return ca.Function("rest", [z, x, u, w], [q, *jacobians([q], [z, x, u])])


def _eliminate(matrix: Any, right: Any) -> Any:
    """Solution of a system with structural zeros, without pivoting."""
    n, m = matrix.shape[0], right.shape[1]
    a = [{j: matrix[i, j] for j in range(n) if matrix.has_nz(i, j)} for i in range(n)]
    b = [{j: right[i, j] for j in range(m) if right.has_nz(i, j)} for i in range(n)]
    inverse = []
    for k in range(n):
        inverse.append(1 / a[k][k])
        for i in range(k + 1, n):
            if k not in a[i]:
                continue
            factor = a[i].pop(k) * inverse[k]
            for row, other in ((a[i], a[k]), (b[i], b[k])):
                for j, value in other.items():
                    if row is b[i] or j > k:
                        row[j] = row[j] - factor * value if j in row else -factor * value
    out = ca.SX(n, m)
    for c in range(m):
        for i in reversed(range(n)):
            value = b[i].get(c, ca.SX(0))
            for j, coefficient in a[i].items():
                if j > i:
                    value = value - coefficient * out[j, c]
            out[i, c] = value * inverse[i]
    return out


def dense(function: ca.Function) -> ca.Function:
    """The function with dense outputs."""
    given = arguments(function)
    return ca.Function(function.name(), given, [ca.densify(o) for o in function.call(given)])


def columns(function: ca.Function, times: int) -> ca.Function:
    """The function of ``times`` columns; of scalar code, each instruction works on all of them at once.

    The virtual machine spends ten times as long on an instruction as on one number, so this is faster from about five
    columns on.
    """
    plain = scalar_code(function) if function.is_a("SXFunction") else None  # None where it calls, say, an interpolant
    if plain is None or times < 5 or function.n_instructions() > MOST_INSTRUCTIONS:
        return function.map(times)
    function = fewer_divisions(plain)
    given = [ca.MX.sym(function.name_in(i), function.nnz_in(i), times) for i in range(function.n_in())]
    rows = [ca.horzsplit(g.T) if g.numel() else [] for g in given]
    results = [[ca.MX.zeros(times)] * function.nnz_out(i) for i in range(function.n_out())]
    work: dict[int, Any] = {}
    for k in range(function.n_instructions()):
        op, inputs, outputs = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            results[outputs[0]][outputs[1]] = work[inputs[0]]
        elif op == ca.OP_INPUT:
            work[outputs[0]] = rows[inputs[0]][inputs[1]]
        elif op == ca.OP_CONST:
            work[outputs[0]] = ca.MX(function.instruction_constant(k))
        else:
            make = ca.MX.binary if len(inputs) == 2 else ca.MX.unary
            work[outputs[0]] = make(op, *(work[i] for i in inputs))
    full = [[v if v.shape[0] == times else ca.repmat(v, times) for v in row] for row in results]
    made = [ca.horzcat(*row).T if row else ca.MX(0, times) for row in full]
    return ca.Function(function.name(), given, made)


def newton_columns(ocp: OCP, parts: Implicit | None, function: ca.Function, times: int) -> ca.Function:
    """`columns` of a function whose fifth input is ``slopes``, as that of `newton_node`: it is found and goes.

    The model is evaluated at the stages of all columns at once. Without ``parts`` there is no such input.
    """
    many = columns(function, times)
    if parts is None:
        return many
    given = [ca.MX.sym(function.name_in(i), function.nnz_in(i), times) for i in range(function.n_in()) if i != 4]
    x, u, w, k = given[:4]
    places = columns(_places(ocp, parts), times)(x, k), ca.repmat(u, 3, 1), ca.repmat(w, 3, 1)
    at = [ca.reshape(v, g.shape[0], 3 * times) for v, g in zip(places, (x, u, w), strict=True)]
    slopes = columns(_whole(parts.slopes), 3 * times).call(at)[0]
    return ca.Function(
        function.name(), given, many.call([x, u, w, k, ca.reshape(slopes, *many.size_in(4)), *given[4:]])
    )


def _places(ocp: OCP, parts: Implicit) -> ca.Function:
    """``(x, k) -> states at the three stages``, one column each."""
    x, k = ca.SX.sym("x", ocp.model.n_states), ca.SX.sym("k", 3 * len(parts.core))
    places = ca.repmat(x, 1, 3)
    for j in range(3):
        for c, a in enumerate(parts.core):
            places[a, j] += ocp.dt * sum(RADAU_A[j, m] * k[3 * c + m] for m in range(3))
    return ca.Function("places", [x, k], [places])


def _whole(function: ca.Function) -> ca.Function:
    """All nonzeros of the results as one column."""
    given = [ca.SX.sym(function.name_in(i), function.size1_in(i)) for i in range(function.n_in())]
    return ca.Function("whole", given, [ca.vertcat(*[v.nz[:] for v in function.call(given)])])


def inputs_of(function: ca.Function, times: int) -> list[np.ndarray]:
    """Arrays for the inputs of a function of ``times`` columns, by row."""
    return [np.zeros((times, function.nnz_in(i) // times)) for i in range(function.n_in())]


def bind(function: ca.Function, times: int, inputs: list[np.ndarray]) -> tuple[Callable[[], None], list[np.ndarray]]:
    """A call of a function of ``times`` columns on the first rows of ``inputs``, and its outputs, by row."""
    outputs = [np.zeros((times, function.numel_out(i) // times)) for i in range(function.n_out())]
    buffer: Any
    buffer, run = function.buffer()
    for i, array in enumerate(inputs):
        if array.size:
            buffer.set_arg(i, array.data)
    for i, array in enumerate(outputs):
        if array.size:
            buffer.set_res(i, array.data)

    def call(keep: Any = (function, buffer, inputs, outputs)) -> None:  # they must outlive the call
        run()

    return call, outputs
