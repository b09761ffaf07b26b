"""C source of CasADi functions on one number or on a vector of numbers at a time.

The same expression becomes C for ``double`` or for GCC's vector types (which Clang and Zig share), so that several
wheels or several cars go through it side by side; sine, arctangent and so on of vectors are evaluated by polynomials
without branches, to about one unit in the last place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np

from slipangle.errors import ParameterError

_BINARY = {
    ca.OP_ADD: "({0} + {1})",
    ca.OP_SUB: "({0} - {1})",
    ca.OP_MUL: "({0} * {1})",
    ca.OP_DIV: "({0} / {1})",
    ca.OP_FMIN: "min_{t}({0}, {1})",
    ca.OP_FMAX: "max_{t}({0}, {1})",
    ca.OP_ATAN2: "atan2_{t}({0}, {1})",
    ca.OP_HYPOT: "sqrt_{t}({0} * {0} + {1} * {1})",
    ca.OP_LT: "lt_{t}({0}, {1})",
    ca.OP_LE: "le_{t}({0}, {1})",
    ca.OP_EQ: "eq_{t}({0}, {1})",
    ca.OP_NE: "ne_{t}({0}, {1})",
    ca.OP_AND: "({0} * {1})",
    ca.OP_OR: "max_{t}({0}, {1})",
    ca.OP_IF_ELSE_ZERO: "keep_{t}({0}, {1})",
    ca.OP_POW: "pow_{t}({0}, {1})",
    ca.OP_CONSTPOW: "pow_{t}({0}, {1})",
}
_UNARY = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "(-{0})",
    ca.OP_SQ: "({0} * {0})",
    ca.OP_TWICE: "({0} + {0})",
    ca.OP_INV: "(1.0 / {0})",
    ca.OP_NOT: "(1.0 - {0})",
    ca.OP_SQRT: "sqrt_{t}({0})",
    ca.OP_SIN: "sin_{t}({0})",
    ca.OP_COS: "cos_{t}({0})",
    ca.OP_TAN: "tan_{t}({0})",
    ca.OP_ATAN: "atan_{t}({0})",
    ca.OP_EXP: "exp_{t}({0})",
    ca.OP_TANH: "tanh_{t}({0})",
    ca.OP_FABS: "abs_{t}({0})",
    ca.OP_SIGN: "sign_{t}({0})",
}


@dataclass(frozen=True)
class _Stream:
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
    groups: list[tuple[object, list[int]]] = []
    for i, function in enumerate(functions):
        shape = _stream(function).shape
        for known, members in groups:
            if known == shape:
                members.append(i)
                break
        else:
            groups.append((shape, [i]))
    return [members for _, members in groups]


def differing_constants(functions: Sequence[ca.Function]) -> np.ndarray:
    """Constants in which functions of one shape differ, shape (n_constants, n_functions)."""
    table = np.array([_stream(f).constants for f in functions]).T.reshape(-1, len(functions))
    return table[(table != table[:, :1]).any(axis=1)] if len(table) else table


def emit(function: ca.Function, name: str, tag: str, *, lanes: Sequence[ca.Function] = ()) -> str:
    """C of ``static void NAME(const T *i0, ..., T *o0, ..., const T *lane)``.

    Parameters
    ----------
    function : Function
        Of scalar expressions (SX).
    name : str
        Of the C function.
    tag : str
        Number type: ``"d"`` for double, ``"v4"`` and so on for what `preamble` defines.
    lanes : sequence of Function, optional
        Functions of the same shape whose other constants, see `differing_constants`, are read from ``lane``.

    Raises
    ------
    ParameterError
        If the function has an operation that has no C here.
    """
    stream, kind = _stream(function), "double" if tag == "d" else tag
    others = [_stream(f).constants for f in lanes]
    ins = [f"const {kind} *restrict i{k}" for k in range(function.n_in())]
    outs = [f"{kind} *restrict o{k}" for k in range(function.n_out())]
    lines = [f"static void {name}({', '.join([*ins, *outs, f'const {kind} *restrict lane'])})", "{"]
    names: dict[int, str] = {}
    known: dict[str, str] = {}  # right-hand side: name
    source: dict[str, tuple[int, str]] = {}  # name: operation and operand, for tan(atan(x))
    constant = varying = 0

    def put(where: int, text: str, *, code: int = -1, operand: str = "") -> None:
        if text not in known:
            known[text] = f"a{len(known)}"
            lines.append(f"    const {kind} {known[text]} = {text};")
            source[known[text]] = (code, operand)
        names[where] = known[text]

    for code, inputs, outputs in stream.shape:
        if code == ca.OP_CONST:
            value = stream.constants[constant]
            if any(o[constant] != value for o in others):
                put(outputs[0], f"lane[{varying}]")
                varying += 1
            else:
                names[outputs[0]] = _number(value)
            constant += 1
        elif code == ca.OP_INPUT:
            put(outputs[0], f"i{inputs[0]}[{inputs[1]}]")
        elif code == ca.OP_OUTPUT:
            value = names[inputs[0]]
            plain = value if value.startswith("a") or tag == "d" else f"all_{tag}({value})"
            lines.append(f"    o{outputs[0]}[{outputs[1]}] = {plain};")
        elif code in _UNARY or code in _BINARY:
            operands = [names[i] for i in inputs]
            if code == ca.OP_TAN and source.get(operands[0], (-1, ""))[0] == ca.OP_ATAN:
                names[outputs[0]] = source[operands[0]][1]
                continue
            text = (_UNARY.get(code) or _BINARY[code]).format(*_vectors(code, operands, tag), t=tag)
            put(outputs[0], text, code=code, operand=operands[0])
        else:
            raise ParameterError(
                f"the operation {code} of CasADi has no C here; expected elementary functions: use those of ops"
            )
    lines += ["    (void)lane;", "}", ""]
    return "\n".join(lines)


def _number(value: float) -> str:
    if math.isnan(value) or math.isinf(value):
        return "(0.0 / 0.0)" if math.isnan(value) else f"({'-' if value < 0 else ''}1.0 / 0.0)"
    return float.hex(value) if value >= 0 else f"({float.hex(value)})"


def _vectors(code: int, operands: Sequence[str], tag: str) -> list[str]:
    """Constants as vectors where a function takes them; operators mix numbers and vectors by themselves."""
    plain = code in (ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_AND, ca.OP_NEG, ca.OP_SQ, ca.OP_INV)
    if tag == "d" or plain:
        return list(operands)
    return [o if o.startswith("a") else f"all_{tag}({o})" for o in operands]


# ---- the functions of numbers and vectors --------------------------------------------------------------------------


@cache
def _series() -> dict[str, list[float]]:
    """Coefficients of the polynomials, by Chebyshev interpolation of what is left after the leading terms."""

    def fit(f: Callable[[np.ndarray], np.ndarray], upper: float, degree: int) -> list[float]:
        series = np.polynomial.Chebyshev.interpolate(f, degree, domain=[0.0, upper])
        return [float(c) for c in series.convert(kind=np.polynomial.Polynomial).coef]

    def taylor(z: np.ndarray, terms: Sequence[float]) -> np.ndarray:
        total = np.zeros_like(z)
        for c in reversed(terms):
            total = total * z + c
        return total

    n = 12
    sine = [(-1) ** k / math.factorial(2 * k + 1) for k in range(n)]
    cosine = [(-1) ** k / math.factorial(2 * k) for k in range(n)]
    arctangent = [(-1) ** k / (2 * k + 1) for k in range(40)]
    quarter = (math.pi / 4 * 1.01) ** 2
    return {
        "sin": fit(lambda z: taylor(z, sine[1:]), quarter, 6),
        "cos": fit(lambda z: taylor(z, cosine[2:]), quarter, 6),
        "atan": fit(lambda z: taylor(z, arctangent[1:]), math.tan(math.pi / 8) ** 2 * 1.01, 11),
        "exp": [1 / math.factorial(k) for k in range(14)],
    }


def _horner(name: str, variable: str) -> str:
    """Polynomial in C, Estrin's scheme: pairs first, so that the steps overlap."""
    terms = [float.hex(c) if c >= 0 else f"({float.hex(c)})" for c in _series()[name]]
    power = variable
    while len(terms) > 1:
        pairs = [f"({terms[i + 1]} * {power} + {terms[i]})" for i in range(0, len(terms) - 1, 2)]
        terms = pairs + ([terms[-1]] if len(terms) % 2 else [])
        power = f"({power} * {power})"
    return terms[0]


_SCALAR = """\
#include <math.h>
static inline double min_d(double a, double b) { return a < b ? a : b; }
static inline double max_d(double a, double b) { return a > b ? a : b; }
static inline double lt_d(double a, double b) { return a < b; }
static inline double le_d(double a, double b) { return a <= b; }
static inline double eq_d(double a, double b) { return a == b; }
static inline double ne_d(double a, double b) { return a != b; }
static inline double keep_d(double c, double x) { return c != 0.0 ? x : 0.0; }
static inline double abs_d(double x) { return fabs(x); }
static inline double sign_d(double x) { return (double)((x > 0.0) - (x < 0.0)); }
#define sqrt_d sqrt
#define sin_d sin
#define cos_d cos
#define tan_d tan
#define atan_d atan
#define atan2_d atan2
#define exp_d exp
#define tanh_d tanh
#define pow_d pow
"""

_VECTOR = """\
typedef double @T __attribute__((vector_size(@B), aligned(@B)));
typedef long long @Ti __attribute__((vector_size(@B), aligned(@B)));
static inline @T all_@T(double x) { @T v = {0}; return v + x; }
static inline @T pick_@T(@Ti m, @T a, @T b) { return (@T)((m & (@Ti)a) | (~m & (@Ti)b)); }
static inline @T ones_@T(@Ti m) { return (@T)(m & (@Ti)all_@T(1.0)); }
static inline @T min_@T(@T a, @T b) { return pick_@T(a < b, a, b); }
static inline @T max_@T(@T a, @T b) { return pick_@T(a > b, a, b); }
static inline @T lt_@T(@T a, @T b) { return ones_@T(a < b); }
static inline @T le_@T(@T a, @T b) { return ones_@T(a <= b); }
static inline @T eq_@T(@T a, @T b) { return ones_@T(a == b); }
static inline @T ne_@T(@T a, @T b) { return ones_@T(a != b); }
static inline @T keep_@T(@T c, @T x) { return (@T)((c != 0.0) & (@Ti)x); }
static inline @T abs_@T(@T x) { return (@T)((@Ti)x & 0x7fffffffffffffffLL); }
static inline @T sign_@T(@T x) { return ones_@T(x > 0.0) - ones_@T(x < 0.0); }
static inline @T signed_@T(@T size, @T from)
{
    return (@T)(((@Ti)size & 0x7fffffffffffffffLL) ^ ((@Ti)from & (-0x7fffffffffffffffLL - 1)));
}
static inline @T sqrt_@T(@T x)
{
    for (int i = 0; i < @N; i++) x[i] = __builtin_sqrt(x[i]);
    return x;
}
static inline @T sincos_@T(@T x, long long turn)
{
    const @T big = all_@T(0x1.8p52);
    @T shifted = x * 0x1.45f306dc9c883p-1 + big, k = shifted - big;
    @Ti q = (@Ti)shifted + turn;
    @T r = ((x - k * 0x1.921fb544p0) - k * 0x1.0b4611a6p-34) - k * 0x1.3198a2e037073p-69;
    @T z = r * r;
    @T s = r + r * z * @SIN;
    @T c = 1.0 - (0.5 * z - z * z * @COS);
    @T y = pick_@T((q & 1) != 0, c, s);
    return (@T)((@Ti)y ^ ((q & 2) << 62));
}
static inline @T sin_@T(@T x) { return sincos_@T(x, 0); }
static inline @T cos_@T(@T x) { return sincos_@T(x, 1); }
static inline @T tan_@T(@T x) { return sincos_@T(x, 0) / sincos_@T(x, 1); }
static inline @T atan_@T(@T x)
{
    @T a = abs_@T(x);
    @Ti large = a > 0x1.3504f333f9de6p1, middle = a > 0x1.a827999fcef32p-2;
    @T up = pick_@T(large, all_@T(-1.0), pick_@T(middle, a - 1.0, a));
    @T down = pick_@T(large, a, pick_@T(middle, a + 1.0, all_@T(1.0)));
    @T base = pick_@T(large, all_@T(0x1.921fb54442d18p0), (@T)(middle & (@Ti)all_@T(0x1.921fb54442d18p-1)));
    @T t = up / down, z = t * t;
    return signed_@T(base + (t + t * z * @ATAN), x);
}
static inline @T atan2_@T(@T y, @T x)
{
    @T a = abs_@T(x), b = abs_@T(y);
    @Ti steep = b > a;
    @T low = pick_@T(steep, a, b), high = pick_@T(steep, b, a);
    @T t = atan_@T(low / pick_@T(high == 0.0, all_@T(1.0), high));
    t = pick_@T(steep, 0x1.921fb54442d18p0 - t, t);
    t = pick_@T(x < 0.0, 0x1.921fb54442d18p1 - t, t);
    return signed_@T(t, y);
}
static inline @T exp_@T(@T x)
{
    const @T big = all_@T(0x1.8p52);
    x = max_@T(min_@T(x, all_@T(709.0)), all_@T(-708.0));
    @T shifted = x * 0x1.71547652b82fep0 + big, n = shifted - big;
    @T r = (x - n * 0x1.62e42fefa38p-1) - n * 0x1.ef35793c7673p-45;
    @T p = @EXP;
    return p * (@T)(((@Ti)shifted - (@Ti)big + 1023) << 52);
}
static inline @T tanh_@T(@T x)
{
    @T e = exp_@T(-2.0 * abs_@T(x));
    return signed_@T((1.0 - e) / (1.0 + e), x);
}
static inline @T pow_@T(@T x, @T y)
{
    for (int i = 0; i < @N; i++) x[i] = pow(x[i], y[i]);
    return x;
}
"""


def preamble(*widths: int) -> str:
    """C of the functions that `emit` uses: for double, and for vectors ``v4``, ``v8``... of each of the widths."""
    parts = [_SCALAR]
    for n in widths:
        text = _VECTOR.replace("@SIN", _horner("sin", "z")).replace("@COS", _horner("cos", "z"))
        text = text.replace("@ATAN", _horner("atan", "z")).replace("@EXP", _horner("exp", "r"))
        parts.append(text.replace("@T", f"v{n}").replace("@B", str(8 * n)).replace("@N", str(n)))
    return "\n".join(parts)
