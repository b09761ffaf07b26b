"""CasADi expressions as C code that runs on several columns at once (see ``lanes.h``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

_INFIX = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
_COMPARE = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
_CALL = {
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_SQRT: "sqrt",
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
    ca.OP_ATAN: "atan",
    ca.OP_ATAN2: "atan2",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_ASINH: "asinh",
    ca.OP_ACOSH: "acosh",
    ca.OP_ATANH: "atanh",
    ca.OP_LOG1P: "log1p",
    ca.OP_EXPM1: "expm1",
    ca.OP_ERF: "erf",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
    ca.OP_FMOD: "fmod",
    ca.OP_REMAINDER: "remainder",
    ca.OP_FABS: "fabs",
    ca.OP_SIGN: "sign",
    ca.OP_COPYSIGN: "copysign",
    ca.OP_FMIN: "fmin",
    ca.OP_FMAX: "fmax",
    ca.OP_HYPOT: "hypot",
    ca.OP_AND: "and",
    ca.OP_OR: "or",
    ca.OP_NOT: "not",
    ca.OP_IF_ELSE_ZERO: "if",
}


def scalar_code(function: ca.Function) -> ca.Function | None:
    """The function as scalar instructions, or None if it holds something that has none, such as a linear solve."""
    if not function.is_a("SXFunction"):
        try:
            function = function.expand()
        except RuntimeError:
            return None
    known = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_ASSIGN, ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE, ca.OP_INV}
    known |= {*_INFIX, *_COMPARE, *_CALL}
    used = {function.instruction_id(k) for k in range(function.n_instructions())}
    return function if used <= known else None


def fewer_divisions(function: ca.Function) -> ca.Function:
    """The function, of scalar instructions, with products by reciprocals in place of divisions.

    Divisions by numbers, and those by one expression more than once; each is off by at most one more rounding.
    """
    simplify = ca.GlobalOptions.getSimplificationOnTheFly()
    ca.GlobalOptions.setSimplificationOnTheFly(False)  # it would turn the products back into divisions
    try:
        return _by_reciprocals(function)
    finally:
        ca.GlobalOptions.setSimplificationOnTheFly(simplify)


def _by_reciprocals(function: ca.Function) -> ca.Function:
    given = [ca.SX.sym(function.name_in(i), function.sparsity_in(i)) for i in range(function.n_in())]
    results = [[ca.SX(0)] * function.nnz_out(i) for i in range(function.n_out())]
    work: dict[int, ca.SX] = {}
    inverse: dict[int, Any] = {}
    for k in range(function.n_instructions()):
        op, inputs, outputs = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            results[outputs[0]][outputs[1]] = work[inputs[0]]
            continue
        if op == ca.OP_CONST:
            value = ca.SX(function.instruction_constant(k))
        elif op == ca.OP_INPUT:
            value = given[inputs[0]].nz[inputs[1]]
        elif op == ca.OP_DIV and not work[inputs[0]].is_constant():
            bottom = work[inputs[1]]
            key = bottom.element_hash()
            inverse.setdefault(key, 1 / float(bottom) if bottom.is_constant() else ca.SX.unary(ca.OP_INV, bottom))
            value = work[inputs[0]] * inverse[key]
        elif len(inputs) == 2:
            value = ca.SX.binary(op, work[inputs[0]], work[inputs[1]])
        else:
            value = ca.SX.unary(op, work[inputs[0]])
        work[outputs[0]] = value
    dense = [ca.SX(function.sparsity_out(i), ca.vertcat(*r) if r else ca.SX(0, 1)) for i, r in enumerate(results)]
    return ca.Function(function.name(), given, ca.cse(dense), function.name_in(), function.name_out())


def lanes_code(function: ca.Function, name: str) -> str:
    """C source of ``static void name(const V *i0, ..., V *o0, ...)``.

    Outputs are dense and stored by row; only their structural nonzeros are written, so the caller's memory
    must hold zeros elsewhere.

    Parameters
    ----------
    function : Function
        Of scalar instructions, see `scalar_code`.
    name : str
        Of the C function.
    """
    function = fewer_divisions(function)
    places = [_by_row(function.sparsity_out(i)) for i in range(function.n_out())]
    arguments = [f"const V *restrict i{i}" for i in range(function.n_in())]
    arguments += [f"V *restrict o{i}" for i in range(function.n_out())]
    lines = [f"static void {name}({', '.join(arguments)})", "{"]
    value: dict[int, str] = {}  # what each place of the work vector holds now
    for k in range(function.n_instructions()):
        op, inputs, outputs = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            lines.append(f"    o{outputs[0]}[{places[outputs[0]][outputs[1]]}] = {value[inputs[0]]};")
            continue
        if op == ca.OP_CONST:
            expression = f"v_all({function.instruction_constant(k)!r})"
        elif op == ca.OP_INPUT:
            expression = f"i{inputs[0]}[{inputs[1]}]"
        else:
            expression = _expression(op, [value[i] for i in inputs])
        lines.append(f"    const V t{k} = {expression};")
        value[outputs[0]] = f"t{k}"
    lines.append("}\n")
    return "\n".join(lines).replace("v_all(inf)", "v_all(INFINITY)").replace("v_all(-inf)", "v_all(-INFINITY)")


def _expression(op: int, a: Sequence[str]) -> str:
    if op in _INFIX:
        return f"{a[0]} {_INFIX[op]} {a[1]}"
    if op in _COMPARE:
        return f"v_true({a[0]} {_COMPARE[op]} {a[1]})"
    if op in _CALL:
        return f"v_{_CALL[op]}({', '.join(a)})"
    simple = {
        ca.OP_ASSIGN: "{0}",
        ca.OP_NEG: "-{0}",
        ca.OP_SQ: "{0} * {0}",
        ca.OP_TWICE: "{0} + {0}",
        ca.OP_INV: "1.0 / {0}",
    }
    return simple[op].format(a[0])


def _by_row(sparsity: ca.Sparsity) -> list[int]:
    """Place of each nonzero in a dense matrix stored by row."""
    rows, columns = sparsity.get_triplet()
    return [r * sparsity.size2() + c for r, c in zip(rows, columns, strict=True)]


def nonzeros(sparsity: ca.Sparsity) -> list[list[int]]:
    """Columns of the nonzeros of each row."""
    found: list[list[int]] = [[] for _ in range(sparsity.size1())]
    for r, c in zip(*sparsity.get_triplet(), strict=True):
        found[r].append(c)
    return found


def elimination_code(pattern: list[set[int]], name: str) -> str:
    """C source of the factors of a square matrix without pivoting, and of the solution of systems with them.

    Only nonzeros and their fill are touched, so rows and columns that should be eliminated first, such as
    those of stiff wheels, come first.

    Parameters
    ----------
    pattern : list of set of int
        Columns of the nonzeros of each row.
    name : str
        Stem of the two functions, ``name_factor(V *m)`` and ``name_solve(const V *m, V *b)``.
    """
    n = len(pattern)
    rows = [set(p) | {i} for i, p in enumerate(pattern)]
    factor = [f"static void {name}_factor(V *restrict m)", "{", "    V f;"]
    for k in range(n):
        factor.append(f"    m[{k * n + k}] = 1.0 / m[{k * n + k}];")
        for i in range(k + 1, n):
            if k not in rows[i]:
                continue
            factor.append(f"    f = m[{i * n + k}] * m[{k * n + k}];")
            factor.append(f"    m[{i * n + k}] = f;")
            for j in sorted(c for c in rows[k] if c > k):
                at, term = f"m[{i * n + j}]", f"f * m[{k * n + j}]"
                factor.append(f"    {at} = {at} - {term};" if j in rows[i] else f"    {at} = -{term};")
                rows[i].add(j)
    solve = [f"static void {name}_solve(const V *restrict m, V *restrict b)", "{", "    V r;"]
    for i in range(n):
        left = [f" - m[{i * n + k}] * b[{k}]" for k in sorted(c for c in rows[i] if c < i)]
        if left:
            solve.append(f"    b[{i}] = b[{i}]{''.join(left)};")
    for i in reversed(range(n)):
        right = [f" - m[{i * n + k}] * b[{k}]" for k in sorted(c for c in rows[i] if c > i)]
        solve.append(f"    r = b[{i}]{''.join(right)};")
        solve.append(f"    b[{i}] = r * m[{i * n + i}];")
    return "\n".join([*factor, "}\n", *solve, "}\n"])
