"""Generated eliminations solve sparse systems on every lane."""

import ctypes

import numpy as np
import pytest

from slipangle.codegen.compiler import compiler, library, sentence
from slipangle.codegen.elimination import elimination_code
from slipangle.codegen.expression import preamble

pytestmark = pytest.mark.skipif(compiler() is None, reason=sentence())

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
