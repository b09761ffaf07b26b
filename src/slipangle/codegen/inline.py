"""Functions that scalar expressions call, such as the solution of an equation, written out operation by operation.

A call whose derivatives are given otherwise, see `slipangle.numerics.newton`, stays a call until all is differentiated;
C of columns, and CasADi's own of one number, then have its operations in line.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca


def inlined(function: ca.Function) -> ca.Function:
    """The function, of scalar instructions, without calls; the same where it has none, or some of no instructions."""
    if not any(function.instruction_id(k) == ca.OP_CALL for k in range(function.n_instructions())):
        return function
    given = function.sx_in()
    results, known = function.call(given, True, False), {}
    flat = [e for r in results for e in elements(r)]
    if not _write_out(flat, known):
        return function
    new = iter([known[e.element_hash()] for e in flat])
    made = [
        ca.SX(r.sparsity(), ca.vertcat(*(next(new) for _ in range(r.nnz()))) if r.nnz() else r.nz[:]) for r in results
    ]
    return ca.Function(function.name(), given, ca.cse(made), function.name_in(), function.name_out())


def elements(matrix: Any) -> list[Any]:
    """Its nonzeros, one by one."""
    return [matrix.nz[i] for i in range(matrix.nnz())]


def applied(op: int, given: Sequence[Any]) -> Any:
    """The result of one of CasADi's operations on one or two scalars."""
    return ca.SX.binary(op, *given) if len(given) == 2 else ca.SX.unary(op, *given)


def _write_out(wanted: Sequence[Any], known: dict[int, Any]) -> bool:
    """Expressions by the hash of what they were, without calls; whether all that is called can be written out."""
    waiting, called = [*reversed(wanted)], {}
    while waiting:
        e = waiting[-1]
        key = e.element_hash()
        if key in known:
            waiting.pop()
            continue
        if e.is_constant() or e.is_symbolic():
            known[key] = e
            continue
        call = e.dep(0) if e.is_output() else e
        parts = [call.dep(i) for i in range(call.n_dep())]
        missing = [d for d in parts if d.element_hash() not in known]
        if missing:
            waiting += missing
            continue
        new = [known[d.element_hash()] for d in parts]
        if call.is_call():
            function = call.which_function()
            if not function.is_a("SXFunction"):
                return False
            same = (function.__hash__(), *(v.element_hash() for v in new))
            if same not in called:
                called[same] = evaluated(function, new)
            known[key] = called[same][e.which_output() if e.is_output() else 0]
        else:
            known[key] = applied(e.op(), new)
    return True


def evaluated(function: ca.Function, given: Sequence[Any]) -> list[Any]:
    """Nonzeros of the results of a function of scalar instructions, of the nonzeros of its inputs, all in a row."""
    first, last = [0], [0]
    for i in range(function.n_in()):
        first.append(first[-1] + function.nnz_in(i))
    for i in range(function.n_out()):
        last.append(last[-1] + function.nnz_out(i))
    results: list[Any] = [ca.SX(0)] * last[-1]
    work: dict[int, Any] = {}
    for k in range(function.n_instructions()):
        op, inputs, outputs = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            results[last[outputs[0]] + outputs[1]] = work[inputs[0]]
        elif op == ca.OP_INPUT:
            work[outputs[0]] = given[first[inputs[0]] + inputs[1]]
        elif op == ca.OP_CONST:
            work[outputs[0]] = ca.SX(function.instruction_constant(k))
        else:
            work[outputs[0]] = applied(op, [work[i] for i in inputs])
    return results
