"""Generated eliminations solve sparse systems on every lane."""

import ctypes

import numpy as np
import pytest

from slipangle.codegen.compiler import compiler, library, sentence
from slipangle.codegen.elimination import elimination_code, increments_code, increments_pattern
from slipangle.codegen.expression import preamble

pytestmark = pytest.mark.skipif(compiler() is None, reason=sentence())

WRAP = """
int lanes(void) { return LANES; }
void run(const double *in, double *out, int ni, int no) {
    V i[64], o[256];
    memset(o, 0, sizeof o);
    for (int a = 0; a < ni; a++) i[a] = v_all(0.0);
    for (int a = 0; a < ni; a++) for (int l = 0; l < LANES; l++) v_lane(i[a], l) = in[a * LANES + l];
    f(i, o);
    for (int a = 0; a < no; a++) for (int l = 0; l < LANES; l++) out[a * LANES + l] = v_lane(o[a], l);
}
"""


def run(code, values, n_out):
    lib = library("\n".join([preamble("V"), code, WRAP]), name="elimination")
    lanes = lib.lanes()
    columns = values.shape[1] // lanes * lanes
    out = np.empty((n_out, columns))
    for at in range(0, columns, lanes):
        given = np.ascontiguousarray(values[:, at : at + lanes], dtype=float)
        found = np.empty((n_out, lanes))
        lib.run(*(a.ctypes.data_as(ctypes.c_void_p) for a in (given, found)), len(values), n_out)
        out[:, at : at + lanes] = found
    return out


def test_elimination_solves_sparse_systems():
    rng = np.random.default_rng(1)
    n = 7
    mask = rng.random((n, n)) < 0.4
    pattern = _columns(mask)
    np.fill_diagonal(mask, True)
    code = elimination_code(pattern, "e") + (
        f"static void f(const V *i, V *o) {{ V m[{n * n}]; for (int a = 0; a < {n * n}; a++) m[a] = i[a];"
        f" e_factor(m); for (int a = 0; a < {n}; a++) o[a] = i[{n * n} + a]; e_solve(m, o); }}"
    )
    A = np.where(mask, rng.standard_normal((n, n)), 0) + 4 * np.eye(n)
    b = rng.standard_normal(n)
    found = run(code, np.tile(np.r_[A.ravel(), b][:, None], 8), n)[:, 0]
    assert found == pytest.approx(np.linalg.solve(A, b), rel=1e-12)


def test_several_right_hand_sides_at_once():
    rng = np.random.default_rng(2)
    n, sides = 6, 4
    mask = rng.random((n, n)) < 0.4
    np.fill_diagonal(mask, True)
    given = np.array([[1, 1, 1, 1, 1, 1], [0, 0, 0, 0, 0, 1], [1, 0, 0, 1, 0, 0], [0, 0, 1, 0, 0, 0]], dtype=bool).T
    code = elimination_code(_columns(mask), "e", sides=_columns(given.T)) + (
        f"static void f(const V *i, V *o) {{ V m[{n * n}]; for (int a = 0; a < {n * n}; a++) m[a] = i[a]; e_factor(m);"
        f" for (int a = 0; a < {n * sides}; a++) o[a] = i[{n * n} + a]; e_solve_sides(m, o); }}"
    )
    A = np.where(mask, rng.standard_normal((n, n)), 0) + 4 * np.eye(n)
    B = np.where(given, rng.standard_normal((n, sides)), 0)
    found = run(code, np.tile(np.r_[A.ravel(), B.ravel()][:, None], 8), n * sides)[:, 0]
    assert found.reshape(n, sides) == pytest.approx(np.linalg.solve(A, B), rel=1e-12)


def test_the_matrix_of_the_increments_is_the_inverse_of_radaus_less_the_derivatives():
    rng = np.random.default_rng(3)
    n = 3
    coupled = np.array([[0, 1, 0], [1, 1, 1], [0, 0, 0]], dtype=bool)
    G, J = rng.standard_normal((3, 3)), rng.standard_normal((3, n, n)) * coupled
    code = increments_code(coupled, "e") + (
        "static void f(const V *i, V *o) { double g[9]; for (int a = 0; a < 9; a++) g[a] = v_lane(i[a], 0);"
        " e_matrix(i + 9, g, o); }"
    )
    found = run(code, np.tile(np.r_[G.ravel(), J.ravel()][:, None], 8), 9 * n * n)[:, 0].reshape(3 * n, 3 * n)
    wanted = np.kron(np.eye(n), G)
    for a in range(n):
        for b in range(n):
            wanted[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] -= np.diag(J[:, a, b])
    assert found == pytest.approx(wanted, rel=1e-14)
    assert _columns(found != 0) == increments_pattern(coupled)


def _columns(mask):
    """Of the nonzeros of each row."""
    return [set(np.flatnonzero(row).tolist()) for row in mask]
