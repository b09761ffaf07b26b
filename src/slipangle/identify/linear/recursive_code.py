"""The arithmetic of recursive least squares, one sample at a time: in C where there is a compiler, else in NumPy.

Both work in place on the same arrays, which are allocated once. The covariance is kept as ``P = U diag(d) U'``, so it
stays symmetric and positive whatever the rounding ([1]_): U is unit upper triangular and stored by columns, the
measurement update is Bierman's, the rank-one update of the forgetting that of Agee and Turner.

References
----------
.. [1] G. J. Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. 3 and 5.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np

from slipangle.codegen.compiler import compiler, library

DIFFUSE = 1e6  # variance of the prediction, in that of the noise, from which an error says nothing about the noise

_SOURCE = (
    f"#define DIFFUSE {DIFFUSE!r}\n"
    + """\
#include <math.h>
#include <string.h>

typedef struct {
    long n, ny, nu, na, reach, memory, directional, filled, updates; /* reach: samples of the inputs that are kept */
    double forgetting, along, threshold, ceiling, trace, weight; /* along: of the prediction's variance */
    double *y, *u, *lags, *phi, *theta, *columns, *d, *f, *gain, *error, *noise, *prior;
    const long *pick;
} rls;

static double project(rls *s) /* f = U' phi; returns phi' P phi */
{
    const long n = s->n;
    double r = 0.0;
    for (long j = 0; j < n; j++) {
        const double *c = s->columns + j * n;
        double sum = s->phi[j];
        for (long i = 0; i < j; i++) sum += c[i] * s->phi[i];
        s->f[j] = sum;
        r += s->d[j] * sum * sum;
    }
    return r;
}

/* Agee and Turner: P + share P phi phi' P, unless the trace would pass the ceiling; leaves the gain P phi */
static int widen(rls *s, double share)
{
    const long n = s->n;
    double *v = s->gain, *a = s->f, growth = 0.0;
    for (long j = 0; j < n; j++) {
        const double *c = s->columns + j * n, w = s->d[j] * s->f[j];
        for (long i = 0; i < j; i++) v[i] += c[i] * w;
        v[j] = w;
    }
    for (long j = 0; j < n; j++) growth += v[j] * v[j] / s->prior[j];
    if (!(s->trace + share * growth <= s->ceiling)) return 0;
    s->trace += share * growth;
    memcpy(a, v, n * sizeof(double));
    for (long j = n - 1; j >= 0; j--) {
        double *c = s->columns + j * n;
        const double now = a[j], fresh = s->d[j] + share * now * now, pull = share * now / fresh;
        for (long i = 0; i < j; i++) {
            a[i] -= now * c[i];
            c[i] += pull * a[i];
        }
        share *= s->d[j] / fresh;
        s->d[j] = fresh;
    }
    return 1;
}

static double forget_everywhere(rls *s, double r) /* returns the new phi' P phi */
{
    const long n = s->n;
    double trace = 0.0; /* summed anew: an error of it would grow with every division */
    for (long j = 0; j < n; j++) {
        const double *c = s->columns + j * n;
        double sum = 1.0 / s->prior[j];
        for (long i = 0; i < j; i++) sum += c[i] * c[i] / s->prior[i];
        trace += s->d[j] * sum;
    }
    s->trace = trace;
    if (!(trace / s->forgetting <= s->ceiling)) return r;
    s->trace /= s->forgetting;
    for (long j = 0; j < n; j++) s->d[j] /= s->forgetting;
    return r / s->forgetting;
}

/* Bierman: P - P phi phi' P / (noise + phi' P phi); leaves the gain P phi */
static void narrow(rls *s, double noise)
{
    const long n = s->n;
    double alpha = noise, less = 0.0;
    for (long j = 0; j < n; j++) {
        double *c = s->columns + j * n;
        const double f = s->f[j], v = s->d[j] * f, back = -f / alpha, before = alpha;
        alpha += f * v;
        s->d[j] *= before / alpha;
        for (long i = 0; i < j; i++) {
            const double old = c[i];
            c[i] = old + back * s->gain[i];
            s->gain[i] += old * v;
        }
        s->gain[j] = v;
    }
    for (long j = 0; j < n; j++) less += s->gain[j] * s->gain[j] / s->prior[j];
    s->trace -= less / alpha;
}

static void learn(rls *s)
{
    const long n = s->n, ny = s->ny;
    for (long j = 0; j < n; j++) s->phi[j] = s->lags[s->pick[j]];
    for (long o = 0; o < ny; o++) {
        double sum = s->y[o];
        for (long j = 0; j < n; j++) sum -= s->theta[o * n + j] * s->phi[j];
        s->error[o] = sum;
    }
    double r = project(s), before = r, added = 1.0; /* what the sample adds to the information along phi */
    if (s->forgetting < 1.0) {
        if (r < s->threshold || r == 0.0) return;
        if (s->directional) {
            before = r / s->along;
            added = 1.0 - (1.0 - s->along) / r;
        } else {
            before = r = forget_everywhere(s, r);
        }
    }
    if (added <= 0.0 && !widen(s, -added / (1.0 + added * r))) {
        before = r;
        added = 1.0;
    }
    if (added > 0.0) narrow(s, 1.0 / added);
    const double size = 1.0 + added * r;
    for (long o = 0; o < ny; o++)
        for (long j = 0; j < n; j++) s->theta[o * n + j] += s->gain[j] / size * s->error[o];
    s->updates++;
    if (before > DIFFUSE) return;
    s->weight = s->forgetting * s->weight + 1.0;
    for (long i = 0; i < ny; i++)
        for (long j = 0; j < ny; j++) {
            double *at = s->noise + i * ny + j;
            *at += (s->error[i] * s->error[j] / (1.0 + before) - *at) / s->weight;
        }
}

int rls_advance(rls *s)
{
    const long ny = s->ny, nu = s->nu, split = s->na * ny;
    for (long i = 0; i < ny; i++) if (!isfinite(s->y[i])) return 1;
    for (long i = 0; i < nu; i++) if (!isfinite(s->u[i])) return 1;
    double *past = s->lags + split;
    memcpy(past, s->u, nu * sizeof(double));
    if (s->filled >= s->memory) learn(s);
    else {
        s->filled++;
        memset(s->error, 0, ny * sizeof(double));
    }
    if (s->na > 1) memmove(s->lags + ny, s->lags, (split - ny) * sizeof(double));
    if (s->na > 0) memcpy(s->lags, s->y, ny * sizeof(double));
    if (s->reach > 1) memmove(past + nu, past, (s->reach - 1) * nu * sizeof(double));
    return 0;
}

long rls_advance_many(rls *s, const double *y, const double *u, long count, double *theta, double *error)
{
    const long size = s->n * s->ny;
    for (long k = 0; k < count; k++) {
        memcpy(s->y, y + k * s->ny, s->ny * sizeof(double));
        memcpy(s->u, u + k * s->nu, s->nu * sizeof(double));
        if (rls_advance(s)) return k;
        memcpy(theta + k * size, s->theta, size * sizeof(double));
        memcpy(error + k * s->ny, s->error, s->ny * sizeof(double));
    }
    return count;
}
"""
)

_LONGS = ("n", "ny", "nu", "na", "reach", "memory", "directional", "filled", "updates")
_DOUBLES = ("forgetting", "along", "threshold", "ceiling", "trace", "weight")
_ARRAYS = ("y", "u", "lags", "phi", "theta", "columns", "d", "f", "gain", "error", "noise", "prior")


class _Struct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_long) for name in _LONGS),
        *((name, ctypes.c_double) for name in _DOUBLES),
        *((name, ctypes.c_void_p) for name in _ARRAYS),
        ("pick", ctypes.c_void_p),
    )


class Recursion:
    """State of one recursion and its arithmetic. A sample: fill `y` and `u`, then call `advance`.

    ``n`` regressors, ``ny`` outputs, ``nu`` inputs; ``na`` and ``reach`` samples of the outputs and of the inputs (the
    present one included) are kept. ``pick``, shape (n,), says where each regressor is among the kept outputs, then
    inputs, newest sample first; the entry behind them is 1. ``memory`` samples go before the first regression. A sample
    is left out where the variance of its prediction, in that of the noise, is below ``threshold``. ``directional``
    forgets along the regressors only, ``P^-1 - (1 - forgetting^n) phi phi' / (phi' P phi)``, else ``forgetting P^-1``.
    The sum of the variances divided by ``prior``, shape (n,), does not pass ``ceiling``.
    """

    def __init__(self, *, pick: np.ndarray, prior: np.ndarray, **numbers: float) -> None:
        self.s = s = _Struct(**numbers, along=numbers["forgetting"] ** numbers["n"])
        self.pick = np.ascontiguousarray(pick, dtype=ctypes.c_long)
        shapes = {"y": s.ny, "u": s.nu, "lags": s.na * s.ny + s.reach * s.nu + 1, "theta": (s.ny, s.n)}
        shapes |= {"columns": (s.n, s.n), "error": s.ny, "noise": (s.ny, s.ny)}
        self.arrays = {name: np.zeros(shapes.get(name, s.n)) for name in _ARRAYS}
        for name, array in (*self.arrays.items(), ("pick", self.pick)):
            setattr(s, name, array.ctypes.data)
        self.y, self.u, self.theta = (self.arrays[k] for k in ("y", "u", "theta"))
        self.error, self.noise = self.arrays["error"], self.arrays["noise"]
        self.arrays["lags"][-1] = 1.0
        self.arrays["prior"][:] = prior
        self.covariance = np.diag(prior)
        functions = _functions()
        if functions is None:
            self.advance = self._advance
        else:
            run, self._many = functions
            pointer = ctypes.c_void_p(ctypes.addressof(self.s))
            self.advance = lambda: run(pointer)
        self.compiled = functions is not None

    @property
    def covariance(self) -> np.ndarray:
        """P, shape (n, n), in units of the noise variance."""
        columns = self.arrays["columns"]
        return (columns.T * self.arrays["d"]) @ columns

    @covariance.setter
    def covariance(self, value: np.ndarray) -> None:
        lower = np.linalg.cholesky(np.asarray(value, dtype=float)[::-1, ::-1])  # of the order reversed: upper
        upper = lower[::-1, ::-1]
        size = np.diag(upper).copy()
        self.arrays["columns"][:] = (upper / size).T
        self.arrays["d"][:] = size**2
        self.s.trace = float(np.sum(np.diag(value) / self.arrays["prior"]))

    def advance_many(self, y: np.ndarray, u: np.ndarray, theta: np.ndarray, error: np.ndarray) -> int:
        """All rows in turn, estimates and errors written to ``theta`` and ``error``; how many rows were finite."""
        if self.compiled:
            y, u = np.ascontiguousarray(y), np.ascontiguousarray(u)
            given, results = [a.ctypes.data for a in (y, u)], [a.ctypes.data for a in (theta, error)]
            return self._many(ctypes.addressof(self.s), *given, len(y), *results)
        for k in range(len(y)):
            self.y[:], self.u[:] = y[k], u[k]
            if self.advance():
                return k
            theta[k], error[k] = self.theta.ravel(), self.error
        return len(y)

    # ---- without a compiler ------------------------------------------------------------------------------------

    def _advance(self) -> int:
        s, lags = self.s, self.arrays["lags"]
        if not (np.isfinite(self.y).all() and np.isfinite(self.u).all()):
            return 1
        split, last = s.na * s.ny, s.na * s.ny + s.reach * s.nu
        lags[split : split + s.nu] = self.u
        if s.filled >= s.memory:
            self._learn()
        else:
            s.filled += 1
            self.error[:] = 0.0
        if s.na:
            lags[s.ny : split] = lags[: split - s.ny].copy()
            lags[: s.ny] = self.y
        if s.reach > 1:
            lags[split + s.nu : last] = lags[split : last - s.nu].copy()
        return 0

    def _learn(self) -> None:
        s, phi = self.s, self.arrays["phi"]
        phi[:] = self.arrays["lags"][self.pick]
        self.error[:] = self.y - self.theta @ phi
        f = self.arrays["columns"] @ phi
        r = before = float(self.arrays["d"] @ f**2)
        added = 1.0
        if s.forgetting < 1.0:
            if r < s.threshold or r == 0.0:
                return
            if s.directional:
                before, added = r / s.along, 1.0 - (1.0 - s.along) / r
            else:
                before = r = self._forget_everywhere(r)
        gain = (self.arrays["d"] * f) @ self.arrays["columns"]
        if added <= 0.0 and not self._widen(gain, -added / (1.0 + added * r)):
            before, added = r, 1.0
        if added > 0.0:
            self._narrow(f, gain, 1.0 / added)
        self.theta += np.outer(self.error, gain / (1.0 + added * r))
        s.updates += 1
        if before <= DIFFUSE:
            s.weight = s.forgetting * s.weight + 1.0
            self.noise += (np.outer(self.error, self.error) / (1.0 + before) - self.noise) / s.weight

    def _narrow(self, f: np.ndarray, gain: np.ndarray, noise: float) -> None:
        columns, d, alpha, found = self.arrays["columns"], self.arrays["d"], noise, np.zeros(self.s.n)
        for j in range(self.s.n):
            v, before, column = d[j] * f[j], alpha, columns[j, :j].copy()
            alpha += f[j] * v
            d[j] *= before / alpha
            columns[j, :j] -= f[j] / before * found[:j]
            found[:j] += column * v
            found[j] = v
        self.s.trace -= float(np.sum(gain**2 / self.arrays["prior"])) / alpha

    def _widen(self, gain: np.ndarray, share: float) -> bool:
        columns, d, a = self.arrays["columns"], self.arrays["d"], gain.copy()
        growth = share * float(np.sum(gain**2 / self.arrays["prior"]))
        if self.s.trace + growth > self.s.ceiling:
            return False
        self.s.trace += growth
        for j in reversed(range(self.s.n)):
            fresh = d[j] + share * a[j] ** 2
            a[:j] -= a[j] * columns[j, :j]
            columns[j, :j] += share * a[j] / fresh * a[:j]
            share *= d[j] / fresh
            d[j] = fresh
        return True

    def _forget_everywhere(self, r: float) -> float:
        s, d = self.s, self.arrays["d"]
        s.trace = float(np.sum(d * (self.arrays["columns"] ** 2 @ (1 / self.arrays["prior"]))))
        if s.trace / s.forgetting > s.ceiling:
            return r
        s.trace /= s.forgetting
        d /= s.forgetting
        return r / s.forgetting


@cache
def _load(source: str, command: Any) -> tuple[Any, Any] | None:
    loaded = library(source, name="rls")
    return None if loaded is None else (loaded.rls_advance, loaded.rls_advance_many)


def _functions() -> tuple[Any, Any] | None:
    """The compiled functions, or None."""
    return _load(_SOURCE, compiler())
