"""C source of CasADi functions on one number or on a vector of numbers at a time.

The same expression becomes C for ``double`` or for the vector types that GCC, Clang and Zig share, so that several
wheels, cars or stages of a horizon go through it side by side. `preamble` gives the elementary functions of each type
(those of vectors stand in ``vectors.h`` and ``vector_math.h``), `emit` the function itself.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipangle.codegen.inline import applied, inlined
from slipangle.errors import ParameterError

MOST_INSTRUCTIONS = 40_000  # of straight-line code; beyond, CasADi's own C with loops
_SIMPLE = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
}
_COMPARE = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
_LOGIC = {ca.OP_AND: "{0} & {1}", ca.OP_OR: "{0} | {1}", ca.OP_NOT: "{prefix}unless({0})"}  # of masks
_LIBRARY = {  # by their name in <math.h>
    getattr(ca, f"OP_{name.upper()}"): name
    for name in (
        "exp log pow sqrt sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh log1p expm1 erf "
        "floor ceil fmod remainder fabs copysign"
    ).split()
}
_CALL = _LIBRARY | {
    ca.OP_CONSTPOW: "pow",
    ca.OP_HYPOT: "hypot",
    ca.OP_SIGN: "sign",
    ca.OP_FMIN: "fmin",
    ca.OP_FMAX: "fmax",
    ca.OP_AND: "and",
    ca.OP_OR: "or",
    ca.OP_NOT: "not",
    ca.OP_IF_ELSE_ZERO: "if",
}

_DOUBLE = """\
#include <math.h>
#define d_true(condition) ((double)(condition))
static inline __attribute__((unused)) double d_fmin(double a, double b) { return a < b ? a : b; }
static inline __attribute__((unused)) double d_fmax(double a, double b) { return a > b ? a : b; }
static inline __attribute__((unused)) double d_hypot(double a, double b) { return sqrt(a * a + b * b); }
static inline __attribute__((unused)) double d_sign(double a) { return (double)((a > 0.0) - (a < 0.0)); }
static inline __attribute__((unused)) double d_and(double a, double b) { return a != 0.0 && b != 0.0; }
static inline __attribute__((unused)) double d_or(double a, double b) { return a != 0.0 || b != 0.0; }
static inline __attribute__((unused)) double d_not(double a) { return a == 0.0; }
static inline __attribute__((unused)) double d_if(double condition, double a) { return condition != 0.0 ? a : 0.0; }
"""
_NATIVE = """\
#ifndef LANES
#if defined __AVX512F__ && !(defined HALF_IDLE && (defined __znver3__ || defined __znver4__)) /* two halves */
#define LANES 8
#elif defined __AVX__
#define LANES 4
#else
#define LANES 2 /* wider vectors than the processor's are taken apart badly */
#endif
#endif
"""


@cache
def preamble(*kinds: str) -> str:
    """C of the functions that `emit` uses for types of numbers.

    They are ``"double"``; ``"v4"``, ``"v8"`` and so on for vectors of that width; ``"V"`` for vectors of ``LANES``
    numbers, by default what the processor has.
    """
    text = "\n".join(
        (files("slipangle.codegen") / f"{n}.h").read_text(encoding="utf-8") for n in ("vectors", "vector_math")
    )
    parts = []
    for kind in kinds:
        if kind == "double":
            parts += [_DOUBLE, *(f"#define d_{name} {name}" for name in _LIBRARY.values())]
        elif kind == "V":
            parts += [_NATIVE, text]
        else:
            names = {"V": kind, "I": f"{kind}i", "LANES": kind[1:], "v_": f"{kind}_"}
            parts.append(re.sub(r"\b(?:V|I|LANES)\b|\bv_(?=[\w#])", lambda m, n=names: n[m[0]], text))
    return "\n".join([*parts, ""])


class _Stream(NamedTuple):
    """A CasADi function as a list of instructions."""

    shape: tuple[tuple[int, tuple[int, ...], tuple[int, ...]], ...]
    constants: tuple[float, ...]


def _stream(function: ca.Function) -> _Stream:
    shape, constants = [], []
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        inputs, outputs = tuple(function.instruction_input(k)), tuple(function.instruction_output(k))
        if code == ca.OP_CONST:
            constants.append(function.instruction_constant(k))
        shape.append((code, inputs, outputs))
    return _Stream(tuple(shape), tuple(constants))


def lanes_alike(functions: Sequence[ca.Function]) -> list[list[int]]:
    """Which functions differ in constants only, and so can run side by side: lists of their numbers."""
    groups: dict[object, list[int]] = {}
    for i, function in enumerate(functions):
        groups.setdefault(_stream(function).shape, []).append(i)
    return list(groups.values())


def differing_constants(functions: Sequence[ca.Function]) -> np.ndarray:
    """Constants in which functions of one shape differ, shape (n_constants, n_functions)."""
    table = np.array([_stream(f).constants for f in functions]).T.reshape(-1, len(functions))
    return table[(table != table[:, :1]).any(axis=1)] if len(table) else table


def scalars(function: ca.Function) -> ca.Function | None:
    """The function as scalar expressions, to be differentiated; None if it holds something that has none."""
    try:
        return function if function.is_a("SXFunction") else function.expand()
    except RuntimeError:
        return None


def scalar_code(function: ca.Function) -> ca.Function | None:
    """The function as scalar instructions, or None if it holds something that has none, such as a linear solve."""
    plain = scalars(function)
    if plain is None:
        return None
    function = inlined(plain)
    known = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, *_SIMPLE, *_COMPARE, *_CALL}
    used = {function.instruction_id(k) for k in range(function.n_instructions())}
    return function if used <= known else None


def arguments(function: ca.Function) -> list[Any]:
    """A symbol for each input of a function, of its own kind."""
    kind: Any = ca.SX if function.is_a("SXFunction") else ca.MX
    return [kind.sym(function.name_in(i), function.sparsity_in(i)) for i in range(function.n_in())]


def only(function: ca.Function, results: Sequence[int]) -> ca.Function:
    """The function with some of its results."""
    given = arguments(function)
    values = function.call(given)
    return ca.Function(function.name(), given, [values[i] for i in results])


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
    function = inlined(function)
    given = arguments(function)
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
        else:
            value = applied(op, [work[i] for i in inputs])
        work[outputs[0]] = value
    dense = [ca.SX(function.sparsity_out(i), ca.vertcat(*r) if r else ca.SX(0, 1)) for i, r in enumerate(results)]
    return ca.Function(function.name(), given, ca.cse(dense), function.name_in(), function.name_out())


def emit(function: ca.Function, name: str, kind: str = "double", *, lanes: Sequence[ca.Function] = ()) -> str:
    """C of ``static void NAME(const T *i0, ..., T *o0, ...)``.

    Inputs are read nonzero after nonzero. Outputs are dense and stored by row; only their structural nonzeros are
    written, so the caller's memory must hold zeros elsewhere. The function is one of scalar expressions (SX), see
    `scalar_code`; ``kind`` is the type T, one of those of `preamble`; ``lanes`` are functions of the same shape whose
    other constants, see `differing_constants`, are read from a last argument, ``const T *lane``.

    Raises
    ------
    ParameterError
        If the function has an operation that has no C here.
    """
    function = inlined(function)
    stream, prefix = _stream(function), {"double": "d_", "V": "v_"}.get(kind, f"{kind}_")
    others = [_stream(f).constants for f in lanes]
    places = [_by_row(function.sparsity_out(i)) for i in range(function.n_out())]
    arguments = [f"const {kind} *restrict i{k}" for k in range(function.n_in())]
    arguments += [f"{kind} *restrict o{k}" for k in range(function.n_out())]
    arguments += [f"const {kind} *restrict lane"] if lanes else []
    lines = [f"static void {name}({', '.join(arguments)})", "{"]
    value: dict[int, str] = {}  # what each place of the work vector holds now
    known: dict[str, str] = {}  # right-hand side: name
    arc: dict[str, str] = {}  # name of an arc tangent: its argument, for tan(atan(x))
    constant = varying = 0
    for code, inputs, outputs in stream.shape:
        operands, mask = [value[i] for i in inputs] if code not in (ca.OP_CONST, ca.OP_INPUT) else [], ""
        if code == ca.OP_OUTPUT:
            wanted = _as_vectors(operands, kind, prefix)[0]
            lines.append(f"    o{outputs[0]}[{places[outputs[0]][outputs[1]]}] = {wanted};")
            continue
        if code == ca.OP_CONST:
            here, constant = stream.constants[constant], constant + 1
            if not any(o[constant - 1] != here for o in others):
                value[outputs[0]] = _number(here)
                continue
            text, varying = f"lane[{varying}]", varying + 1
        elif code == ca.OP_INPUT:
            text = f"i{inputs[0]}[{inputs[1]}]"
        elif code == ca.OP_ASSIGN or (code == ca.OP_TAN and operands[0] in arc):
            value[outputs[0]] = arc[operands[0]] if code == ca.OP_TAN else operands[0]
            continue
        else:
            mask = _mask(code, operands, kind, prefix)
            text = mask or _expression(code, operands, kind, prefix)
        if text not in known:
            known[text] = f"{'m' if mask else 'a'}{len(known)}"
            lines.append(f"    const {_mask_of(kind) if mask else kind} {known[text]} = {text};")
        value[outputs[0]] = known[text]
        if code == ca.OP_ATAN:
            arc[known[text]] = operands[0]
    names = [a.rpartition(" ")[2].removeprefix("*restrict ") for a in arguments]
    said = "\n".join(lines[1:])
    unused = [f"(void){name};" for name in names if f"{name}[" not in said]
    return "\n".join([*lines, *([f"    {' '.join(unused)}"] if unused else []), "}", ""])


def _mask_of(kind: str) -> str:
    return "I" if kind == "V" else f"{kind}i"


def _mask(code: int, operands: Sequence[str], kind: str, prefix: str) -> str:
    """A comparison of vectors, or what is made of such alone: lanes, which are a number only where one is asked for."""
    if kind == "double":
        return ""
    if code in _COMPARE:
        return f" {_COMPARE[code]} ".join(_as_vectors(operands, kind, prefix))
    if code in _LOGIC and all(o.startswith("m") for o in operands):
        return _LOGIC[code].format(*operands, prefix=prefix)
    return ""


def _expression(code: int, operands: Sequence[str], kind: str, prefix: str) -> str:
    """One operation; operators mix numbers and vectors by themselves."""
    if code == ca.OP_IF_ELSE_ZERO and operands[0].startswith("m"):
        return f"{prefix}where({operands[0]}, {_as_vectors(operands[1:], kind, prefix)[0]})"
    vectors = _as_vectors(operands, kind, prefix)
    if code in _SIMPLE:
        mixed = any(o.startswith("a") for o in operands)
        return _SIMPLE[code].format(*(_as_numbers(operands, prefix) if mixed else vectors))
    if code in _COMPARE:
        return f"{prefix}true({vectors[0]} {_COMPARE[code]} {vectors[1]})"
    if code in _CALL:
        return f"{prefix}{_CALL[code]}({', '.join(vectors)})"
    raise ParameterError(
        f"the operation {code} of CasADi has no C here; expected elementary functions: use those of ops"
    )


def _as_numbers(operands: Sequence[str], prefix: str) -> list[str]:
    return [f"{prefix}true({o})" if o.startswith("m") else o for o in operands]


def _as_vectors(operands: Sequence[str], kind: str, prefix: str) -> list[str]:
    both = zip(operands, _as_numbers(operands, prefix), strict=True)
    return [n if kind == "double" or o[0] in "am" else f"{prefix}all({n})" for o, n in both]


def _number(value: float) -> str:
    if math.isnan(value) or math.isinf(value):
        return "NAN" if math.isnan(value) else f"({'-' if value < 0 else ''}INFINITY)"
    return float.hex(value) if value >= 0 else f"({float.hex(value)})"


def _by_row(sparsity: ca.Sparsity) -> list[int]:
    """Place of each nonzero in a dense matrix stored by row."""
    rows, columns = sparsity.get_triplet()
    return [r * sparsity.size2() + c for r, c in zip(rows, columns, strict=True)]
