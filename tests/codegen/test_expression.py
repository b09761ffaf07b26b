"""C of CasADi expressions: functions to the last places, every operation, lanes that differ in constants."""

import ctypes
from functools import cache

import casadi as ca
import numpy as np
import pytest

from slipangle import ops
from slipangle.codegen.compiler import compiler, library, sentence
from slipangle.codegen.expression import differing_constants, emit, fewer_divisions, lanes_alike, preamble, scalar_code
from slipangle.codegen.network import aligned
from slipangle.errors import ParameterError

needs_compiler = pytest.mark.skipif(compiler() is None, reason=sentence())
KINDS = pytest.mark.parametrize("kind", ["double", "v4", "v8", "V"])
TINY = np.concatenate([10.0 ** -np.linspace(0, 300, 901), -(10.0 ** -np.linspace(0, 300, 901))])
NEAR_ONE = 1 - 10.0 ** -np.linspace(0, 16, 901)


def grid(low, high):
    """Points of an interval, many of them near zero and near one."""
    return np.clip(np.concatenate([np.linspace(low, high, 8001), TINY, NEAR_ONE, -NEAR_ONE]), low, high)


UNARY = {  # NumPy's name, points, largest error in units of the last place
    "sin": (np.sin, grid(-50, 50), 2),
    "far sin": (np.sin, np.linspace(-1e9, 1e9, 4001), None),
    "cos": (np.cos, grid(-50, 50), 2),
    "far cos": (np.cos, np.linspace(-6e10, 6e10, 4001), None),
    "tan": (np.tan, grid(-50, 50), 4),
    "asin": (np.arcsin, grid(-1, 1), 3),
    "acos": (np.arccos, grid(-1, 1), 3.5),
    "atan": (np.arctan, np.concatenate([grid(-1e3, 1e3), [1e300, -1e300, np.inf, -np.inf]]), 2),
    "exp": (np.exp, grid(-700, 700), 1.5),
    "expm1": (np.expm1, grid(-40, 700), 2.5),
    "log": (np.log, np.concatenate([grid(1e-300, 1e3), [5e-324, 1e-310, 1e308, np.inf]]), 1.5),
    "log1p": (np.log1p, grid(-0.999, 1e3), 2),
    "sinh": (np.sinh, grid(-700, 700), 3),
    "cosh": (np.cosh, grid(-700, 700), 2),
    "tanh": (np.tanh, grid(-30, 30), 3),
    "asinh": (np.arcsinh, grid(-1e3, 1e3), 2),
    "acosh": (np.arccosh, 1 + np.abs(grid(-1e3, 1e3)), 2),
    "atanh": (np.arctanh, grid(-0.999, 0.999), 2),
    "sqrt": (np.sqrt, np.abs(grid(-9, 9)), 0.5),
    "fabs": (np.abs, grid(-2, 2), 0),
    "sign": (np.sign, grid(-2, 2), 0),
    "floor": (np.floor, grid(-9, 9), 0),
    "ceil": (np.ceil, grid(-9, 9), 0),
}
BINARY = {
    "atan2": (np.arctan2, 2.5),
    "hypot": (np.hypot, 1.5),
    "fmin": (np.minimum, 0),
    "fmax": (np.maximum, 0),
    "fmod": (np.fmod, 0),
    "copysign": (np.copysign, 0),
}


def code_of(functions, kind):
    """A library with ``run_NAME(inputs, results, blocks)`` for each scalar function of a vector."""
    code = preamble(kind) + f"int width(void) {{ return sizeof({kind}) / sizeof(double); }}\n"
    for name, function in functions.items():
        code += emit(function, name, kind)
        code += f"void run_{name}(const {kind} *x, {kind} *y, long n)\n{{ for (long i = 0; i < n; i++) "
        code += f"{name}(x + i * {function.size1_in(0)}, y + i * {function.numel_out(0)}); }}\n"
    return library(code, name="expressions", flags=("-fno-math-errno",))


@cache
def elementary(kind):
    """All functions of one and of two numbers; compiled once for all tests."""
    z = ca.SX.sym("z", 2)
    functions = {name: getattr(ca, name)(z[0]) for name in UNARY if " " not in name}
    functions |= {name: getattr(ca, name)(z[0], z[1]) for name in BINARY}
    return code_of({f"f_{name}": ca.Function("f", [z], [value]) for name, value in functions.items()}, kind)


def at_points(made, name, *inputs, n_out=1):
    """Results at many points, shape (n,), or (n_out, n)."""
    n, width = len(inputs[0]), made.width()
    blocks = -(-n // width)
    table = np.ones((len(inputs), blocks * width))
    table[:, :n] = inputs
    x = aligned(table.reshape(len(inputs), blocks, width).transpose(1, 0, 2))
    y = aligned(np.zeros((blocks, n_out, width)))
    run = getattr(made, f"run_{name}")
    run.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long]
    run(x.ctypes.data, y.ctypes.data, blocks)
    values = y.transpose(1, 0, 2).reshape(n_out, -1)[:, :n].copy()
    return values[0] if n_out == 1 else values


def last_places(value, exact):
    """Error in units of the last place of what is exact."""
    finite = np.isfinite(exact)
    assert (value[~finite] == exact[~finite]).all()
    with np.errstate(over="ignore"):
        gap = np.abs(value[finite] - exact[finite].astype(float))
        left = np.abs(value[finite].astype(np.longdouble) - exact[finite]).astype(float)
    unit = np.spacing(np.maximum(np.abs(exact[finite].astype(float)), 1e-307))
    return float(np.max(np.minimum(gap, left) / unit))


@needs_compiler
@KINDS
def test_functions_to_the_last_places(kind):
    for name, (exact, x, most) in UNARY.items():
        value = at_points(elementary(kind), "f_" + name.split()[-1], x, x)
        if most is None:
            assert np.abs(value - exact(x)).max() < 2.5e-16, name
        else:
            assert last_places(value, exact(x.astype(np.longdouble))) <= most, name


@needs_compiler
@KINDS
def test_functions_of_two_numbers(kind):
    a, b = np.random.default_rng(0).normal(0, 3, (2, 4000))
    a[:4], b[:4] = [0, 1, -1, 0], [1, 1e-300, -2, -1]
    for name, (exact, most) in BINARY.items():
        value, exact = (
            at_points(elementary(kind), f"f_{name}", a, b),
            exact(a.astype(np.longdouble), b.astype(np.longdouble)),
        )
        assert last_places(value, exact) <= most, name
    if kind != "double":
        assert at_points(elementary(kind), "f_atan2", [0.0], [0.0]) == 0.0


@needs_compiler
@KINDS
def test_no_number_stays_none(kind):
    nothing = np.full(8, np.nan)
    for name in UNARY:
        if name not in ("far sin", "far cos", "sign"):
            assert np.isnan(at_points(elementary(kind), f"f_{name}", nothing, nothing)).all(), name
    for name, outside in (("sqrt", -1.0), ("log", -1.0), ("asin", 1.5), ("acos", -1.5), ("log", -np.inf)):
        assert np.isnan(at_points(elementary(kind), f"f_{name}", [outside], [0.0])).all(), name
    assert at_points(elementary(kind), "f_log", [0.0], [0.0]) == -np.inf


def everything(a, b):
    """Operations as models use them."""
    total = ops.maximum(a, b) - ops.minimum(a, 0.3) + ops.where(a < b, a * b, a / (1 + b * b)) + ops.atan2(a, b)
    total = total + ops.where(ops.fabs(a) <= 1.0, 1.0, 0.0) + ops.hypot(a, b) + ops.tan(ops.atan(a)) - 2.0
    return total + ops.where(a > 0.0, ops.exp(b), ops.sign(b)) + ops.clip(a, -0.5, 0.5) ** 2


@needs_compiler
@KINDS
def test_every_operation(kind):
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 640))
    z = ca.SX.sym("z", 2)
    p, q = z[0], z[1]
    both = [everything(p, q), p**3, ca.fabs(p) ** q, 2 / q, p / q, -p, ca.erf(p), ca.remainder(p, q)]
    both += [ca.logic_and(p, q > 0), ca.logic_or(p > 0, q > 0), ca.logic_not(p > 0), ca.if_else(p == q, p, q)]
    function = ca.Function("f", [z], [ca.vertcat(*both)])
    made = code_of({"f": function, "g": fewer_divisions(function)}, kind)
    exact = np.asarray(function.map(len(a))(np.array([a, b])))
    by_hand = np.array([float(everything(float(p), float(q))) for p, q in zip(a, b, strict=True)])
    assert exact[0] == pytest.approx(by_hand, rel=1e-14, abs=1e-14)
    for name in "fg":
        assert at_points(made, name, a, b, n_out=len(both)) == pytest.approx(exact, rel=1e-14, abs=1e-14)


@needs_compiler
@KINDS
def test_conditions_of_conditions(kind):
    """As numbers, as conditions, and of numbers that are none; between vectors they stay masks."""
    a, b = np.random.default_rng(2).normal(size=(2, 640))
    a[::7], b[::11] = np.nan, 0.0
    z = ca.SX.sym("z", 2)
    p, q = z[0], z[1]
    both, either = ca.logic_and(p > 0, q <= 0), ca.logic_or(p > q, q != 0)
    neither, odd = ca.logic_not(either), ca.logic_and(p > 0, q)
    results = [ca.if_else(both, 2.0, q), ca.if_else(neither, q, 3.0), ca.if_else(odd, 1.0, q)]
    function = ca.Function("f", [z], [ca.vertcat(*results, both + neither, 2 * (p < q), either, -(p == q))])
    exact = np.asarray(function.map(len(a))(np.array([a, b])))
    value = at_points(code_of({"f": function}, kind), "f", a, b, n_out=len(exact))
    np.testing.assert_array_equal(value, exact)
    chosen = ca.Function("f", [z], [ca.if_else(ca.logic_not(both), p, q)])
    assert kind == "double" or "_true(" not in emit(chosen, "f", kind)


@needs_compiler
@KINDS
def test_constants_reach_every_lane(kind):
    z = ca.SX.sym("z", 1)
    function = ca.Function("f", [z], [ca.vertcat(2.5, -0.0, np.inf, -np.inf, ca.fmin(z, -1.5), np.nan, z)])
    value = at_points(code_of({"f": function}, kind), "f", np.arange(8.0), n_out=7)
    assert (value[:4] == [[2.5], [0.0], [np.inf], [-np.inf]]).all()
    assert (value[4] == -1.5).all()
    assert np.isnan(value[5]).all()
    assert (value[6] == np.arange(8.0)).all()


@needs_compiler
@KINDS
def test_sparse_outputs_are_stored_by_row(kind):
    x = ca.SX.sym("x", 3)
    function = ca.Function("f", [x], [ca.jacobian(ca.vertcat(x[0] * x[1], x[2] ** 2), x)])
    value = at_points(code_of({"f": function}, kind), "f", *np.tile([[2.0], [3.0], [5.0]], 8), n_out=6)
    assert value[:, 0].tolist() == [3.0, 2.0, 0.0, 0.0, 0.0, 10.0]


def test_lanes_share_code_and_differ_in_constants():
    z = ca.SX.sym("z", 1)

    def line(slope, name="f"):
        return ca.Function(name, [z], [ca.sin(slope * z) + 2.5])

    functions = [line(3.0), line(4.0), ca.Function("g", [z], [z]), line(5.0)]
    assert lanes_alike(functions) == [[0, 1, 3], [2]]
    alike = [functions[i] for i in (0, 1, 3)]
    assert differing_constants(alike).tolist() == [[3.0, 4.0, 5.0]]
    assert "lane[0]" in emit(alike[0], "f", "v4", lanes=alike)
    assert "lane" not in emit(alike[0], "f", "v4")


def test_what_has_no_scalar_code_says_so():
    x, z = ca.MX.sym("x", 2), ca.SX.sym("z", 1)
    assert scalar_code(ca.Function("f", [x], [ca.solve(ca.diag(x) + 1, x)])) is None
    assert scalar_code(ca.Function("f", [z], [ca.erfinv(z)])) is None
    with pytest.raises(ParameterError, match="no C here"):
        emit(ca.Function("f", [z], [ca.erfinv(z)]), "f")
