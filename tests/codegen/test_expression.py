"""C of CasADi expressions: vector functions to an ulp or two, every operation, lanes that differ in constants."""

import ctypes

import casadi as ca
import numpy as np
import pytest

from slipangle import ops
from slipangle.codegen.compiler import compiler, library, sentence
from slipangle.codegen.expression import differing_constants, emit, lanes_alike, preamble
from slipangle.errors import ParameterError
from slipangle.models.vehicles.dual_track.kernel import _aligned as aligned

needs_compiler = pytest.mark.skipif(compiler() is None, reason=sentence())
UNARY = {
    "sin": (np.sin, np.linspace(-50, 50, 4001)),
    "cos": (np.cos, np.linspace(-50, 50, 4001)),
    "tan": (np.tan, np.linspace(-1.5, 1.5, 2001)),
    "arctan": (np.arctan, np.concatenate([np.linspace(-5, 5, 4001), [-1e12, 1e12, -1e-12, 0.0]])),
    "exp": (np.exp, np.linspace(-30, 30, 2001)),
    "tanh": (np.tanh, np.linspace(-20, 20, 2001)),
    "sqrt": (np.sqrt, np.linspace(0, 9, 2001)),
    "sign": (np.sign, np.linspace(-2, 2, 5)),
    "fabs": (np.abs, np.linspace(-2, 2, 5)),
}


def code_of(functions, tag):
    """A library with ``run_NAME(inputs, results, blocks)`` for each scalar function of a vector, on lanes of a tag."""
    kind = "double" if tag == "d" else tag
    code = preamble(4, 8)
    for name, function in functions.items():
        code += emit(function, name, tag)
        code += f"void run_{name}(const {kind} *x, {kind} *y, long n)\n"
        code += f"{{ for (long i = 0; i < n; i++) {name}(x + i * {function.size1_in(0)}, y + i, 0); }}\n"
    return library(code, name="symbols", flags=("-fno-math-errno",))


def at_points(made, name, width, *inputs):
    """Results at many points, shape (n,)."""
    n = len(inputs[0])
    blocks = -(-n // width)
    table = np.ones((len(inputs), blocks * width))
    table[:, :n] = inputs
    x, y = aligned((blocks, len(inputs), width)), aligned((blocks, width))
    x[:] = table.reshape(len(inputs), blocks, width).transpose(1, 0, 2)
    run = getattr(made, f"run_{name}")
    run.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long]
    run(x.ctypes.data, y.ctypes.data, blocks)
    return y.ravel()[:n].copy()


@needs_compiler
@pytest.mark.parametrize(("tag", "width"), [("d", 1), ("v4", 4), ("v8", 8)])
def test_functions_to_the_last_places(tag, width):
    z = ca.SX.sym("z", 1)
    made = code_of({f"f_{name}": ca.Function("f", [z], [getattr(ca, name)(z)]) for name in UNARY}, tag)
    for name, (exact, x) in UNARY.items():
        found = at_points(made, f"f_{name}", width, x)
        scale = np.maximum(np.abs(exact(x)), 1.0 if name in ("sin", "cos") else 1e-300)
        error = np.max(np.abs(found - exact(x)) / scale)
        assert error <= 6e-16 * (4 if name in ("tan", "tanh", "exp") else 1), name


def everything(a, b):
    """Every operation that models use."""
    total = ops.maximum(a, b) - ops.minimum(a, 0.3) + ops.where(a < b, a * b, a / (1 + b * b)) + ops.atan2(a, b)
    total = total + ops.where(ops.fabs(a) <= 1.0, 1.0, 0.0) + ops.hypot(a, b) + ops.tan(ops.atan(a)) - 2.0
    return total + ops.where(a > 0.0, ops.exp(b), ops.sign(b)) + ops.clip(a, -0.5, 0.5) ** 2


@needs_compiler
@pytest.mark.parametrize(("tag", "width"), [("d", 1), ("v4", 4), ("v8", 8)])
def test_every_operation(tag, width):
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 640))
    z = ca.SX.sym("z", 2)
    function = ca.Function("f", [z], [everything(z[0], z[1])])
    exact = np.array([float(everything(float(p), float(q))) for p, q in zip(a, b, strict=True)])
    assert at_points(code_of({"f": function}, tag), "f", width, a, b) == pytest.approx(exact, rel=1e-14, abs=1e-14)


def test_lanes_share_code_and_differ_in_constants():
    z = ca.SX.sym("z", 1)

    def line(slope, name="f"):
        return ca.Function(name, [z], [ca.sin(slope * z) + 2.5])

    functions = [line(3.0), line(4.0), ca.Function("g", [z], [z]), line(5.0)]
    assert lanes_alike(functions) == [[0, 1, 3], [2]]
    alike = [functions[i] for i in (0, 1, 3)]
    assert differing_constants(alike).tolist() == [[3.0, 4.0, 5.0]]
    assert "lane[0]" in emit(alike[0], "f", "v4", lanes=alike)
    assert "lane[0]" not in emit(alike[0], "f", "v4")


def test_unknown_operation_says_so():
    z = ca.SX.sym("z", 1)
    with pytest.raises(ParameterError, match="no C here"):
        emit(ca.Function("f", [z], [ca.erf(z)]), "f", "d")
