"""The arithmetic of recursive least squares, one sample at a time: one expression, in C where there is a compiler.

The covariance is kept as ``P = U diag(d) U'``, so it stays symmetric and positive whatever the rounding ([1]_): U is
unit upper triangular and stored by columns, the measurement update is Bierman's, the rank-one update of the forgetting
that of Agee and Turner.

P is the inverse of the information as it is weighted, not how far the estimate scatters: of white errors of variance
one, ``P^-1 (theta - truth)`` is a sum of regressors times errors, each by its weight, so the estimate scatters by
``P S P``, where S, "scatter", sums the regressors' squares by the squares of their weights. Without forgetting S is
P^-1; where a sample counts less by a factor every step, evenly excited, the two differ by one plus that factor.

References
----------
.. [1] G. J. Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. 3 and 5.
"""

from __future__ import annotations

from functools import cache, partial

import casadi as ca
import numpy as np

from slipangle.codegen.compiler import library
from slipangle.codegen.expression import emit, preamble
from slipangle.models.fast import bind

MOST = 50  # regressors, above which the compiler would take too long
LARGEST = 1e12  # of a measurement: no channel reads it, and squares stay inside single precision
DIFFUSE = 1e6  # variance of the prediction, in that of the noise, from which an error says nothing about the noise

_SOURCE = """
#include <string.h>

int rls_advance(double *state, const double *sample, const double *settings)
{
    double next[N_STATE];
    int good = 1;
    for (int i = 0; i < N_SAMPLE; i++) if (!isfinite(sample[i])) return 1;
    for (int i = 0; i < N_SAMPLE; i++) good &= fabs(sample[i]) <= LARGEST;
    if (good) advance(state, sample, settings, next);
    for (int i = 0; good && i < N_STATE; i++) good = isfinite(next[i]);
    if (!good) {
        state[FILLED] = 0;
        return 2;
    }
    memcpy(state, next, sizeof next);
    return 0;
}

long rls_advance_many(double *state, const double *samples, const double *settings, long count, double *out)
{
    for (long k = 0; k < count; k++) {
        if (rls_advance(state, samples + k * N_SAMPLE, settings)) return k;
        memcpy(out + k * N_OUT, state, N_OUT * sizeof(double));
    }
    return count;
}
"""


class Recursion:
    """State of one recursion and its arithmetic. A sample: fill `y` and `u`, then call `advance`.

    That answers 0; 1 where a number is not finite, and all is as before; 2 where a number is larger than any
    measurement or the state would not be finite: the estimate is as before then, and the lags fill anew.

    ``sizes`` are the numbers of outputs and inputs, and how many samples of each are kept, the present input included.
    ``pick`` says where each regressor is among the kept outputs, then inputs, newest sample first; the entry behind
    them is 1. ``memory`` samples go before the first regression. A sample is left out where the variance of its
    prediction, in that of the noise, is below ``threshold``. ``directional`` forgets along the n regressors only,
    ``P^-1 - (1 - forgetting^n) phi phi' / (phi' P phi)``, else ``forgetting P^-1``. The sum of the variances divided by
    ``prior``, shape (n,), does not pass n.
    """

    def __init__(
        self,
        pick: tuple[int, ...],
        prior: np.ndarray,
        sizes: tuple[int, int, int, int],
        *,
        memory: int,
        forgetting: float,
        threshold: float,
        directional: bool,
    ) -> None:
        (ny, nu, _, _), n = sizes, len(pick)
        self.memory, self.forgetting, ceiling = memory, forgetting, n * (1 + 1e-9)
        self.settings = np.concatenate([[memory, forgetting, forgetting**n, threshold, ceiling], prior])
        shapes = _shapes(n, *sizes)
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes.values()])
        self._state, self._sample = np.zeros(ends[-1]), np.zeros(ny + nu)
        parts = np.split(self._state, ends[:-1])
        self.arrays = {name: part.reshape(shapes[name]) for name, part in zip(shapes, parts, strict=True)}
        self.y, self.u, self.theta = self._sample[:ny], self._sample[ny:], self.arrays["theta"]
        self.error, self.noise, self.prior = self.arrays["error"], self.arrays["noise"], prior
        self.covariance = np.diag(prior)
        self.function = function = _sample(pick, sizes, directional)
        loaded = library(_source(function, ny * (1 + n), self.place("filled")), name="rls") if n <= MOST else None
        self.compiled = loaded is not None
        if loaded is not None:
            pointers = [a.ctypes.data for a in (self._state, self._sample, self.settings)]
            self.advance, self._many = partial(loaded.rls_advance, *pointers), loaded.rls_advance_many
        else:
            self._next, self.advance = np.zeros_like(self._state), self._interpreted
            self._run = bind(function, (self._state, self._sample, self.settings), self._next)

    @property
    def state(self) -> np.ndarray:
        """All that it knows, as `function` takes it; not a copy."""
        return self._state

    def place(self, name: str) -> int:
        """Where an array begins in `state`."""
        names = list(self.arrays)
        return sum(self.arrays[n].size for n in names[: names.index(name)])

    @property
    def covariance(self) -> np.ndarray:
        """P, shape (n, n), in units of the noise variance."""
        columns = np.eye(len(self.prior))
        columns[np.tril_indices(len(columns), -1)] = self.arrays["columns"]
        return (columns.T * self.arrays["d"]) @ columns

    @property
    def scatter(self) -> np.ndarray:
        """Covariance of one output's estimate, given white errors of variance one, shape (n, n); at most P."""
        if self.forgetting == 1.0:
            return self.covariance
        n = len(self.prior)
        columns, squares = np.eye(n), np.zeros((n, n))
        columns[np.tril_indices(n, -1)] = self.arrays["columns"]
        squares[np.triu_indices(n)] = self.arrays["scatter"]
        squares = squares + np.triu(squares, 1).T
        root = columns.T * np.sqrt(self.arrays["d"])
        shares, axes = np.linalg.eigh(root.T @ squares @ root)
        root = root @ axes * np.sqrt(np.clip(shares, 0.0, 1.0))  # none is outside but by rounding
        return root @ root.T

    @covariance.setter
    def covariance(self, value: np.ndarray) -> None:
        lower = np.linalg.cholesky(np.asarray(value, dtype=float)[::-1, ::-1])  # of the order reversed: upper
        upper = lower[::-1, ::-1]
        size = np.diag(upper)
        self.arrays["columns"][:] = (upper / size).T[np.tril_indices(len(size), -1)]
        self.arrays["d"][:] = size**2
        self.arrays["trace"][:] = np.sum(np.diag(value) / self.prior)
        inverse = np.linalg.inv(upper)
        self.arrays["scatter"][:] = (inverse.T @ inverse)[np.triu_indices(len(size))]

    def advance_many(self, y: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """All rows in turn, up to one that is refused: errors, shape (n, ny), and estimates, (n, ny n_regressors)."""
        ny = len(self.y)
        samples, out = np.ascontiguousarray(np.hstack([y, u])), np.zeros((len(y), ny + self.theta.size))
        if self.compiled:
            pointers = self._state.ctypes.data, samples.ctypes.data, self.settings.ctypes.data
            out = out[: self._many(*pointers, len(y), out.ctypes.data)]
        else:
            for k, sample in enumerate(samples):
                self._sample[:] = sample
                if self.advance():
                    out = out[:k]
                    break
                out[k] = self._state[: out.shape[1]]
        return out[:, :ny], out[:, ny:]

    def _interpreted(self) -> int:
        """`advance` without a compiler."""
        if not np.isfinite(self._sample).all():
            return 1
        good = bool((np.abs(self._sample) <= LARGEST).all())
        if good:
            self._run()
        if not (good and np.isfinite(self._next).all()):
            self.arrays["filled"][:] = 0
            return 2
        self._state[:] = self._next
        return 0


def _shapes(n: int, ny: int, nu: int, na: int, reach: int) -> dict[str, tuple[int, ...]]:
    """Of what the state holds; U without its diagonal."""
    shapes: dict[str, tuple[int, ...]] = {"error": (ny,), "theta": (ny, n), "noise": (ny, ny), "d": (n,)}
    shapes |= {"columns": (n * (n - 1) // 2,), "past_y": (na * ny,), "past_u": ((reach - 1) * nu,)}
    shapes["scatter"] = (n * (n + 1) // 2,)  # S by rows of its upper half
    return shapes | {name: (1,) for name in ("filled", "updates", "trace", "weight")}


def _source(function: ca.Function, n_out: int, filled: int) -> str:
    sizes = {"N_STATE": function.size1_in(0), "N_SAMPLE": function.size1_in(1), "N_OUT": n_out, "FILLED": filled}
    defined = [f"#define {name} {size}" for name, size in {**sizes, "LARGEST": LARGEST}.items()]
    return "\n".join([preamble("double"), emit(function, "advance"), *defined, _SOURCE])


@cache
def _sample(pick: tuple[int, ...], sizes: tuple[int, int, int, int], directional: bool) -> ca.Function:
    """``(state, [y, u], settings) -> state`` of one sample. Where nothing is learned, shares and gains are zero."""
    n, (ny, nu, _, _), shapes = len(pick), sizes, _shapes(len(pick), *sizes)
    s = {name: ca.SX.sym(name, int(np.prod(shape))) for name, shape in shapes.items()}
    y, u, settings = ca.SX.sym("y", ny), ca.SX.sym("u", nu), ca.SX.sym("settings", 5 + n)
    memory, forgetting, along, threshold, ceiling = ca.vertsplit(settings[:5])
    phi = ca.vertcat(s["past_y"], u, s["past_u"], 1)[list(pick)]
    theta, trace, ready = ca.reshape(s["theta"], n, ny), s["trace"], s["filled"] >= memory
    error = y - ca.mtimes(theta.T, phi)
    columns = ca.vertsplit(s["columns"], [j * (j - 1) // 2 for j in range(n + 1)])
    f = phi + ca.vertcat(*(ca.dot(c, phi[:j]) for j, c in enumerate(columns)))
    r = raw = before = ca.dot(s["d"], f**2)
    go = ca.logic_and(ready, ca.logic_not(ca.logic_and(forgetting < 1, ca.logic_or(r < threshold, r == 0))))
    added, d, prior = ca.SX(1), s["d"], settings[5:]  # added: to the information along phi, by the sample
    squares = ca.tril2symm(ca.SX(ca.Sparsity.lower(n), s["scatter"]))
    if directional:
        before, added = r / along, ca.if_else(forgetting < 1, 1 - (1 - along) / r, 1)
    else:  # the trace is summed anew: an error of it would grow with every division
        shares = [ca.dot(c**2, 1 / prior[:j]) + 1 / prior[j] for j, c in enumerate(columns)]
        whole = ca.dot(d, ca.vertcat(*shares))
        fading = ca.if_else(ca.logic_and(go, whole / forgetting <= ceiling), forgetting, 1)
        trace, d, r = ca.if_else(go, whole / fading, trace), d / fading, r / fading
        before, squares = r, fading**2 * squares
    gain = d * f
    for j, c in enumerate(columns):
        gain[:j] += c * gain[j]
    growth = ca.dot(gain**2, 1 / prior)
    if directional:
        share = -added / (1 + added * r)
        fits, loses = trace + share * growth <= ceiling, added <= 0
        share = ca.if_else(ca.logic_and(ca.logic_and(go, loses), fits), share, 0)
        trace += share * growth
        columns, d = _widened(columns, d, gain, share)
        stays = ca.logic_and(loses, ca.logic_not(fits))
        before, added = ca.if_else(stays, r, before), ca.if_else(stays, 1, added)
    pushed = ca.mtimes(squares, gain)
    scatters = ca.dot(gain, pushed)  # of the prediction, in the noise's variance: at most raw
    narrows = ca.logic_and(go, added > 0)
    columns, d, alpha = _narrowed(columns, d, ca.if_else(narrows, f, 0), ca.if_else(narrows, 1 / added, 1))
    trace -= ca.if_else(narrows, growth / alpha, 0)
    theta += ca.if_else(go, gain / (1 + added * r), 0) @ error.T
    tells = ca.logic_and(go, before <= DIFFUSE)
    weight = ca.if_else(tells, forgetting * s["weight"] + 1, s["weight"])
    news = ca.vec(error @ error.T) / (1 + ca.if_else(forgetting < 1, ca.fmin(scatters, raw), raw)) - s["noise"]
    lost = ca.if_else(go, 1 - added, 0)
    squares -= lost * (phi @ pushed.T + pushed @ phi.T) - (lost**2 * scatters + go) * (phi @ phi.T)
    new = {"error": ca.if_else(ready, error, 0), "theta": ca.vec(theta), "trace": trace, "weight": weight, "d": d}
    new |= {"noise": s["noise"] + ca.if_else(tells, news / weight, 0), "columns": ca.vertcat(*columns)}
    new |= {"past_y": _newest(y, s["past_y"]), "past_u": _newest(u, s["past_u"])}
    new["scatter"] = ca.vertcat(*(squares[j:, j] for j in range(n)))
    new |= {"filled": ca.fmin(s["filled"] + 1, memory), "updates": s["updates"] + go}
    after = ca.densify(ca.vertcat(*(new[name] for name in shapes)))
    return ca.Function("rls", [ca.vertcat(*s.values()), ca.vertcat(y, u), settings], [after], {"cse": True})


def _newest(now: ca.SX, past: ca.SX) -> ca.SX:
    """The newest samples, as many as are kept; none where none are, which a slice of a scalar would not be."""
    return ca.vertcat(*ca.vertsplit(ca.vertcat(now, past))[: past.numel()]) if past.numel() else past


def _widened(columns: list[ca.SX], d: ca.SX, gain: ca.SX, share: ca.SX) -> tuple[list[ca.SX], ca.SX]:
    """Agee and Turner: factors of ``P + share gain gain'``."""
    columns, d, a = list(columns), ca.SX(d), ca.SX(gain)
    for j in reversed(range(len(columns))):
        now, before = a[j], d[j]
        d[j] += share * now**2
        a[:j] -= now * columns[j]
        columns[j] = columns[j] + share * now / d[j] * a[:j]
        share *= before / d[j]
    return columns, d


def _narrowed(columns: list[ca.SX], d: ca.SX, f: ca.SX, noise: ca.SX) -> tuple[list[ca.SX], ca.SX, ca.SX]:
    """Bierman: factors of ``P - gain gain' / alpha`` with ``alpha = noise + phi' P phi``, and alpha."""
    columns, d, alpha, gain = list(columns), ca.SX(d), noise, ca.SX.zeros(len(columns))
    for j, column in enumerate(columns):
        v, before = d[j] * f[j], alpha
        alpha += f[j] * v
        d[j] *= before / alpha
        columns[j] = column - f[j] / before * gain[:j]
        gain[:j] += column * v
        gain[j] = v
    return columns, d, alpha
