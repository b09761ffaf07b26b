"""Elementary functions on lanes and the code made from expressions agree with CasADi."""

import ctypes

import casadi as ca
import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.codegen.columns import elimination_code, lanes_code, scalar_code
from slipangle.optimal.realtime.program import _text

pytestmark = pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())

WRAP = """
int lanes(void) { return LANES; }
void run(const double *in, double *out, int ni, int no) {
    V i[64], o[256];
    memset(o, 0, sizeof o);
    for (int a = 0; a < ni; a++) i[a] = v_all(0.0);
    for (int a = 0; a < ni; a++) for (int l = 0; l < LANES; l++) i[a][l] = in[a * LANES + l];
    f(i, o);
    for (int a = 0; a < no; a++) for (int l = 0; l < LANES; l++) out[a * LANES + l] = o[a][l];
}
"""


def run(code, values, n_out):
    lib = compiled.library("\n".join([_text("lanes.h", "slipangle.codegen"), code, WRAP]), name="emit")
    lanes = lib.lanes()
    columns = values.shape[1] // lanes * lanes
    out = np.empty((n_out, columns))
    for at in range(0, columns, lanes):
        given = np.ascontiguousarray(values[:, at : at + lanes], dtype=float)
        found = np.empty((n_out, lanes))
        lib.run(*(a.ctypes.data_as(ctypes.c_void_p) for a in (given, found)), len(values), n_out)
        out[:, at : at + lanes] = found
    return out


FUNCTIONS = {
    "sin": (ca.sin, -50, 50),
    "far sin": (ca.sin, -1e9, 1e9),
    "cos": (ca.cos, -50, 50),
    "tan": (ca.tan, -1.5, 1.5),
    "atan": (ca.atan, -30, 30),
    "exp": (ca.exp, -700, 700),
    "tanh": (ca.tanh, -30, 30),
    "sqrt": (ca.sqrt, 0, 1e6),
    "log": (ca.log, 1e-9, 1e6),
    "fabs": (ca.fabs, -5, 5),
    "sign": (ca.sign, -5, 5),
    "asin": (ca.asin, -1, 1),
    "sinh": (ca.sinh, -5, 5),
    "erf": (ca.erf, -3, 3),
    "floor": (ca.floor, -9, 9),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_elementary_functions(name):
    function, low, high = FUNCTIONS[name]
    x = ca.SX.sym("x")
    f = ca.Function("f", [x], [function(x)])
    values = np.r_[np.linspace(low, high, 4000), [low, high, 0.5 * (low + high)], np.zeros(13)][None]
    if name == "log":
        values = np.maximum(values, low)
    found = run(lanes_code(f, "f"), values, 1)[0]
    expected = np.asarray(f.map(len(found))(values[:, : len(found)])).ravel()
    scale = np.maximum(np.abs(expected), 1e-3 if name == "tanh" else 1e-300)
    assert np.abs((found - expected) / np.where(scale > 0, scale, 1)).max() < (1e-12 if "far" not in name else 1e-9)


def test_two_arguments_and_logic():
    x = ca.SX.sym("x", 2)
    a, b = x[0], x[1]
    outputs = [
        ca.atan2(a, b),
        ca.fmin(a, b),
        ca.fmax(a, b),
        ca.hypot(a, b),
        ca.if_else(a > b, a * b, a - b),
        a**3,
        2 / b,
    ]
    outputs += [ca.logic_and(a > 0, b > 0), ca.logic_or(a > 0, b > 0), ca.logic_not(a > 0), ca.fmod(a, b), -a, a / b]
    f = ca.Function("f", [x], [ca.vertcat(*outputs)])
    rng = np.random.default_rng(0)
    values = rng.normal(0, 3, (2, 4000))
    values[:, :4] = [[0, 1, -1, 0], [1, 0, -2, -1]]
    values[1, 1] = 1e-300
    found = run(lanes_code(f, "f"), values, len(outputs))
    expected = np.asarray(f.map(values.shape[1])(values))[:, : found.shape[1]]
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-14)


def test_nan_stays_nan():
    x = ca.SX.sym("x")
    f = ca.Function("f", [x], [ca.vertcat(ca.tanh(x), ca.exp(x), ca.sin(x), ca.cos(x), ca.atan(x), ca.sqrt(x))])
    assert np.isnan(run(lanes_code(f, "f"), np.full((1, 8), np.nan), 6)).all()


def test_sparse_outputs_are_stored_by_row():
    x = ca.SX.sym("x", 3)
    f = ca.Function("f", [x], [ca.jacobian(ca.vertcat(x[0] * x[1], x[2] ** 2), x)])
    found = run(lanes_code(f, "f"), np.tile([[2.0], [3.0], [5.0]], 8), 6)[:, 0]
    assert found.tolist() == [3.0, 2.0, 0.0, 0.0, 0.0, 10.0]


def test_elimination_solves_sparse_systems():
    rng = np.random.default_rng(1)
    n = 7
    mask = rng.random((n, n)) < 0.4
    pattern = [set(np.flatnonzero(row).tolist()) for row in mask]
    np.fill_diagonal(mask, True)
    code = elimination_code(pattern, "e") + (
        f"static void f(const V *i, V *o) {{ V m[{n * n}]; for (int a = 0; a < {n * n}; a++) m[a] = i[a];"
        f" e_factor(m); for (int a = 0; a < {n}; a++) o[a] = i[{n * n} + a]; e_solve(m, o); }}"
    )
    A = np.where(mask, rng.standard_normal((n, n)), 0) + 4 * np.eye(n)
    b = rng.standard_normal(n)
    found = run(code, np.tile(np.r_[A.ravel(), b][:, None], 8), n)[:, 0]
    assert found == pytest.approx(np.linalg.solve(A, b), rel=1e-12)


def test_a_linear_solve_has_no_scalar_code():
    x = ca.MX.sym("x", 2)
    f = ca.Function("f", [x], [ca.solve(ca.diag(x) + 1, x)])
    assert scalar_code(f) is None
