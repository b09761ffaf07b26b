"""The quadratic program's C code alone, random problems for it, and their optimality conditions in NumPy."""

import ctypes
from functools import cache
from importlib.resources import files

import numpy as np

from slipangle.codegen import compiler as compiled
from slipangle.codegen.expression import preamble
from slipangle.codegen.struct import Struct, accessors, clock

SOLVED, INFEASIBLE = 0, 1
MOST_INPUTS, MOST_ROWS = 40, 120
HEAD = f"""{clock()}
#define QP_ANY_SIZE
#define QN {MOST_INPUTS}
#define QR 1
#define QD {MOST_ROWS}
"""
CALLS = (
    accessors("qp", ["u"])
    + """
/* H, A by row; limits, weights: inputs first, then rows of A. */
int qp_run(Qp *q, int n, int m, const double *H, const double *g, const double *A, const double *lo, const double *hi,
           const double *plain, const double *square, int warm, double *u, double *lambda, double *kkt)
{
    q->n = n, q->rates = 0, q->dense = m, q->until = INFINITY;
    memset(q->H, 0, sizeof q->H);
    memset(q->C, 0, sizeof q->C);
    memset(q->g, 0, sizeof q->g);
    for (int a = 0; a < n; a++) {
        for (int b = a; b < n; b++)
            ((double *)q->H)[a * QL + b] = H[a * n + b];
        q->g[a] = g[a];
    }
    for (int i = 0; i < m; i++)
        memcpy((double *)q->C + i * QL, A + i * n, sizeof(double) * (size_t)n);
    memcpy(q->lo, lo, sizeof(double) * (size_t)(n + m));
    memcpy(q->hi, hi, sizeof(double) * (size_t)(n + m));
    memcpy(q->plain, plain, sizeof(double) * (size_t)(n + m));
    memcpy(q->square, square, sizeof(double) * (size_t)(n + m));
    int status = qp_factor(q) ? qp_solve(q, warm) : QP_NUMBER;
    memcpy(u, q->u, sizeof(double) * (size_t)n);
    memcpy(lambda, q->lambda, sizeof(double) * (size_t)(n + m));
    *kkt = q->kkt;
    return status;
}
"""
)


@cache
def library():
    own = (files("slipangle.optimal.realtime") / "qp.c").read_text(encoding="utf-8")
    return compiled.library("\n".join([HEAD, preamble("V"), own, "typedef Qp Work;", CALLS]), name="qp")


class Solver:
    def __init__(self):
        self.lib = library()
        self.memory = Struct(self.lib, "qp", ["u"], {})
        self.at = self.memory.pointer

    def __call__(self, problem, warm=False):
        H, g, A, lo, hi, plain, square = problem
        n, m = len(g), len(A)
        u, lam, kkt = np.empty(n), np.empty(n + m), ctypes.c_double()
        arrays = [np.ascontiguousarray(a, dtype=float) for a in (H, g, A, lo, hi, plain, square)]
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in arrays]
        status = self.lib.qp_run(
            self.at,
            n,
            m,
            *pointers,
            int(warm),
            u.ctypes.data_as(ctypes.c_void_p),
            lam.ctypes.data_as(ctypes.c_void_p),
            ctypes.byref(kkt),
        )
        return status, u, lam, kkt.value


def residual(problem, u, lam):
    """Largest violation of the optimality conditions, each relative to the size of its terms."""
    H, g, A, lo, hi, plain, square = problem
    C = np.vstack([np.eye(len(g)), A])
    v = C @ u
    terms = g, H @ u, C.T @ lam
    worst = np.abs(sum(terms)).max() / max(sum(map(np.abs, terms)).max(), 1e-300)
    for i in range(len(v)):
        limit = hi[i] if lam[i] > 0 else lo[i]
        e = max(v[i] - hi[i], lo[i] - v[i])
        size = 1 + abs(v[i])
        if lam[i] == 0:
            worst = max(worst, e / size if plain[i] > 0 or square[i] > 0 else 0)
            continue
        e = v[i] - hi[i] if lam[i] > 0 else lo[i] - v[i]
        above = abs(lam[i]) - plain[i]
        if above < -1e-9 * plain[i] if np.isfinite(plain[i]) else True:  # kept: on the limit
            worst = max(worst, abs(e) / (size + abs(limit)))
        elif square[i] > 0:  # paid, or kept with the largest multiplier
            worst = max(worst, min(abs(e - max(above, 0) / square[i]), max(abs(e), abs(above))) / (size + abs(limit)))
        else:  # spent: exceeded by any amount
            worst = max(worst, abs(above) / (1 + plain[i]), -e / (size + abs(limit)))
    return worst


def draw(rng, *, soft=True, kind=None):
    """A random problem; kinds of trouble on purpose."""
    kind = kind or rng.choice(["plain", "degenerate", "ill", "tight", "box", "equal"])
    n = int(rng.integers(1, 25))
    m = 0 if kind == "box" else int(rng.integers(0, 2 * n + 2))
    root = rng.standard_normal((n, n + 2))
    H = root @ root.T / n + 1e-3 * np.eye(n)
    if kind == "ill":
        scale = 10.0 ** rng.uniform(-2, 2, n)
        H = H * np.outer(scale, scale)
    g = rng.standard_normal(n) * 10.0 ** rng.uniform(-1, 2)
    A = rng.standard_normal((m, n)) * (rng.random((m, n)) < 0.6)
    if kind == "degenerate" and m > 1:  # repeated, opposite and dependent rows, rows that are bounds
        for i in range(1, m):
            choice = rng.integers(5)
            if choice == 0:
                A[i] = A[i - 1]
            elif choice == 1:
                A[i] = -2 * A[i - 1]
            elif choice == 2 and i > 1:
                A[i] = A[i - 1] + A[i - 2]
            elif choice == 3:
                A[i] = np.eye(n)[rng.integers(n)]
    inside = rng.standard_normal(n)
    C = np.vstack([np.eye(n), A])
    room = {"tight": 1e-6, "equal": 1.0}.get(kind, 1.0)
    lo = C @ inside - room * rng.uniform(0, 1, n + m) * (rng.random(n + m) < 0.8)
    hi = C @ inside + room * rng.uniform(0, 1, n + m) * (rng.random(n + m) < 0.8)
    if kind == "equal":
        same = rng.random(n + m) < 0.2
        hi[same] = lo[same]
        lo = np.minimum(lo, C @ inside)
        lo[same] = hi[same] = (C @ inside)[same]
    if rng.random() < 0.15 and m:  # perhaps nobody keeps these
        push = rng.integers(n + m)
        lo[push] += 2.0
        hi[push] += 2.0
    open_low, open_high = rng.random(n + m) < 0.2, rng.random(n + m) < 0.2
    lo, hi = np.where(open_low, -np.inf, lo), np.where(open_high, np.inf, hi)
    plain, square = np.full(n + m, np.inf), np.zeros(n + m)
    if soft:
        is_soft = np.r_[np.zeros(n, bool), rng.random(m) < 0.6]
        plain[is_soft] = rng.choice([0.0, 0.3, 3.0, 1e3], is_soft.sum())
        square[is_soft] = np.where(
            plain[is_soft] == 0, 10.0 ** rng.uniform(-2, 3, is_soft.sum()), rng.choice([0.0, 1.0, 50.0], is_soft.sum())
        )
    return H, g, A, lo, hi, plain, square
