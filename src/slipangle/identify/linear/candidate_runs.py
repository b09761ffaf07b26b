"""Free runs of many candidate models over the same stretches: one after the other in C, or side by side in NumPy."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from slipangle.codegen.compiler import library

_LANES = 20  # stretches side by side in C: a record is cut into as many, and sums that do not wait for each other
_SOURCE = """
#define LANES 20
#define EACH for (int l = 0; l < LANES; l++)

/* Sums of squared errors of the free runs of C candidates over S times LANES stretches of T steps, shape (C, ny).

   theta (C, folds, J, p, ny): past outputs, newest first, then what drives; a candidate has lags[c] past samples and
   the drives used[begins[c]] to used[begins[c + 1] - 1], as entries of z before that of the step. The last axis of all
   that belongs to stretches is the lane: z (S, before + T, nc) has the outputs first. y holds the na + T samples of a
   run, oldest first; own has room for the coefficients of a candidate, sums for ny. */
void candidate_runs(long C, long S, long T, long J, long p, long ny, long na, long folds, long nc, long before,
    const double *theta, const long *lags, const long *used, const long *columns, const long *begins,
    const long *group, const double *z, const double *weights, const double *known, const long *active,
    double *y, double *own, double *sums, double *squares)
{
    for (long c = 0; c < C; c++)
        for (long s = 0; s < S; s++) {
            const long n_past = lags[c] * ny, *at = used + begins[c], n = begins[c + 1] - begins[c];
            const double *seen = z + (s * (before + T) + before) * nc * LANES;
            double *to = own;
            for (long k = 0; k < ny * LANES; k++) sums[k] = 0.0;
            for (long j = 0; j < J; j += 2)
                for (long o = 0; o < ny; o++)
                    for (long k = 0; k < n_past + n; k++)
                        for (long h = j; h < j + 2 && h < J; h++, to += LANES) EACH {
                            const long column = k < n_past ? k : columns[begins[c] + k - n_past];
                            to[l] = theta[(((c * folds + group[s * LANES + l]) * J + h) * p + column) * ny + o];
                        }
            for (long i = 1; i <= lags[c]; i++)
                for (long q = 0; q < ny; q++) EACH y[((na - i) * ny + q) * LANES + l] = seen[(q - i * nc) * LANES + l];
            for (long t = 0; t < T; t++, seen += nc * LANES) {
                const double *w = weights + (s * T + t) * J * LANES, *b = own;
                double *now = y + (na + t) * ny * LANES;
                for (long k = 0; k < ny * LANES; k++) now[k] = 0.0;
                for (long j = 0; j < J; j += 2, w += 2 * LANES) { /* two speeds at a time read a regressor once */
                    const long both = j + 1 < J, *on = active + (s * T + t) * J + j;
                    if (!on[0] && !(both && on[1])) {
                        b += (n_past + n) * ny * (1 + both) * LANES;
                        continue;
                    }
                    for (long o = 0; o < ny; o++) {
                        double one[LANES] = {0.0}, two[LANES] = {0.0};
                        for (long k = 0; k < n_past + n; k++) {
                            const double *x = k < n_past ? now + (k % ny - (k / ny + 1) * ny) * LANES
                                                         : seen + at[k - n_past] * LANES;
                            EACH one[l] += b[l] * x[l];
                            b += LANES;
                            if (!both) continue;
                            EACH two[l] += b[l] * x[l];
                            b += LANES;
                        }
                        EACH now[o * LANES + l] += w[l] * one[l];
                        if (both) EACH now[o * LANES + l] += w[LANES + l] * two[l];
                    }
                }
                for (long o = 0; o < ny; o++) EACH {
                    const double off = now[o * LANES + l] - seen[o * LANES + l];
                    sums[o * LANES + l] += known[(s * T + t) * LANES + l] != 0.0 ? off * off : 0.0;
                }
            }
            for (long k = 0; k < ny * LANES; k++) squares[c * ny + k / LANES] += sums[k];
        }
}
"""


@dataclass(frozen=True, kw_only=True)
class Stretches:
    """What free runs start from, are driven by and compared with; shorter stretches end in zeros."""

    signals: np.ndarray  # (n_stretches, before + n_steps, n_channels), the outputs first
    weights: np.ndarray  # (n_stretches, n_steps, n_speeds), of the model at each speed
    lengths: np.ndarray  # (n_stretches,), steps of each
    group: np.ndarray  # (n_stretches,), which coefficients have not seen it
    columns: np.ndarray  # (n_columns, 2), samples back and channel of each regressor; past outputs first, newest first
    lags: int  # of outputs, at most
    n_outputs: int

    @property
    def known(self) -> np.ndarray:
        """Whether a step is one of the stretch, shape (n_stretches, n_steps)."""
        return np.arange(self.weights.shape[1]) < self.lengths[:, None]

    @property
    def wanted(self) -> np.ndarray:
        """Outputs at every step, shape (n_stretches, n_steps, n_outputs)."""
        return self.signals[:, self._before :, : self.n_outputs]

    @property
    def _before(self) -> int:
        return self.signals.shape[1] - self.weights.shape[1]

    def squares(self, theta: np.ndarray, used: Sequence[np.ndarray]) -> np.ndarray:
        """Sum of each candidate's squared errors, shape (n_candidates, n_outputs).

        Coefficients have shape (n_candidates, n_groups, n_speeds, n_columns, n_outputs); ``used`` are the columns of
        each candidate that are not zero, of the past its first lags.
        """
        return self.each(theta).sum(axis=2) if self._loaded is None else self._in_turn(self._loaded, theta, used)

    @cached_property
    def _loaded(self) -> ctypes.CDLL | None:
        return library(_SOURCE, name="candidate_runs")

    def _in_turn(self, loaded: ctypes.CDLL, theta: np.ndarray, used: Sequence[np.ndarray]) -> np.ndarray:
        (C, folds, J, p, ny), (S, T, _), nc = theta.shape, self.weights.shape, self.signals.shape[2]
        first = self.lags * ny
        drives = [columns[columns >= first] for columns in used]
        lags = [(len(columns) - len(own)) // ny for columns, own in zip(used, drives, strict=True)]
        every, begins = np.array([*np.concatenate(drives), 0], dtype=int), np.cumsum([0, *map(len, drives)])
        back = self.columns[every, 1] - self.columns[every, 0] * nc
        squares = np.zeros((C, ny))
        work = [np.empty(n * ny * _LANES) for n in (self.lags + T, J * p, 1)]
        numbers = [np.ascontiguousarray(a, np.dtype("l")) for a in (lags, back, every, begins)]
        arrays = [np.ascontiguousarray(theta), *numbers, *self._in_lanes, *work, squares]
        blocks, addresses = -(-S // _LANES), (a.ctypes.data for a in arrays)
        loaded.candidate_runs(C, blocks, T, J, p, ny, self.lags, folds, nc, self._before, *addresses)
        return squares

    @cached_property
    def _in_lanes(self) -> list[np.ndarray]:
        """What belongs to stretches, in blocks of `_LANES` of them, the lanes last."""
        made = []
        for array in (self.group, self.signals, self.weights, self.known.astype(float)):
            whole = np.zeros((-(-len(array) // _LANES) * _LANES, *array.shape[1:]), dtype=array.dtype)
            whole[: len(array)] = array
            made.append(np.ascontiguousarray(np.moveaxis(whole.reshape(-1, _LANES, *array.shape[1:]), 1, -1)))
        active = np.ascontiguousarray(made[2].any(axis=-1), np.dtype("l"))
        return [made[0].astype(np.dtype("l")), *made[1:], active]

    def each(self, theta: np.ndarray) -> np.ndarray:
        """The same for every stretch, shape (n_candidates, n_outputs, n_stretches), in NumPy."""
        (C, _, J, _, ny), (S, T, _) = theta.shape, self.weights.shape
        na, own, m = self.lags, theta[:, self.group], self._before
        back = own[:, :, :, : na * ny].reshape(C, S, J, na, ny, ny)[:, :, :, ::-1]  # oldest lag first
        back = np.ascontiguousarray(back.transpose(3, 4, 2, 5, 0, 1)).reshape(na * ny, J * ny, C * S)
        ahead = own[:, :, :, na * ny :].transpose(2, 1, 3, 0, 4).reshape(J, S, -1, C * ny)
        drive = np.stack([self.signals[:, m - k : m - k + T, i] for k, i in self.columns[na * ny :]], axis=2)
        pushed = np.zeros((S, T, C * ny))
        for j in range(J):
            pushed += self.weights[:, :, j, None] * np.matmul(drive, ahead[j])
        y = np.empty((na + T, ny, C, S))  # runs side by side in memory
        y[:na] = self.signals[:, m - na : m, :ny].transpose(1, 2, 0)[:, :, None]
        y[na:] = pushed.reshape(S, T, C, ny).transpose(1, 3, 2, 0)
        lags, weights = y.reshape(-1, ny, C * S), self.weights.transpose(1, 2, 0)[:, :, None, None]
        with np.errstate(over="ignore", invalid="ignore"):
            for t in range(T):
                newest = np.einsum("kmn,kn->mn", back, lags[t : t + na].reshape(na * ny, C * S)).reshape(J, ny, C, S)
                y[na + t] += (newest * weights[t]).sum(axis=0) if J > 1 else newest[0]
            off = y[na:]
            off -= self.wanted.transpose(1, 2, 0)[:, :, None]
            off *= self.known.T[:, None, None]
            return np.einsum("tics,tics->cis", off, off)
