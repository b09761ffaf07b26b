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
   the drives used[begins[c]] to used[begins[c + 1] - 1]. The last axis of all that belongs to stretches is the lane.
   y holds the na + T samples of a run, oldest first; own has room for the coefficients of a candidate. */
void candidate_runs(long C, long S, long T, long J, long p, long ny, long na, long folds, long nd,
    const double *theta, const long *lags, const long *used, const long *begins, const long *group,
    const double *drive, const double *weights, const double *wanted, const double *known, const double *past,
    double *y, double *own, double *squares)
{
    for (long c = 0; c < C; c++)
        for (long s = 0; s < S; s++) {
            const long n_past = lags[c] * ny, *at = used + begins[c], n = begins[c + 1] - begins[c];
            double *to = own;
            for (long j = 0; j < J; j++)
                for (long o = 0; o < ny; o++)
                    for (long k = 0; k < n_past + n; k++, to += LANES) EACH {
                        const long column = k < n_past ? k : na * ny + at[k - n_past];
                        to[l] = theta[(((c * folds + group[s * LANES + l]) * J + j) * p + column) * ny + o];
                    }
            for (long i = 0; i < na; i++)
                for (long q = 0; q < ny; q++) EACH
                    y[((na - 1 - i) * ny + q) * LANES + l] = past[((s * na + i) * ny + q) * LANES + l];
            for (long t = 0; t < T; t++) {
                const double *u = drive + (s * T + t) * nd * LANES, *w = weights + (s * T + t) * J * LANES, *b = own;
                double *now = y + (na + t) * ny * LANES;
                for (long k = 0; k < ny * LANES; k++) now[k] = 0.0;
                for (long j = 0; j < J; j++, w += LANES) {
                    double most = 0.0;
                    EACH most += w[l];
                    if (most == 0.0) {
                        b += (n_past + n) * ny * LANES;
                        continue;
                    }
                    for (long o = 0; o < ny; o++) {
                        double sum[LANES] = {0.0};
                        for (long i = 1; i <= lags[c]; i++)
                            for (long q = 0; q < ny; q++, b += LANES) EACH
                                sum[l] += b[l] * now[(q - i * ny) * LANES + l];
                        for (long k = 0; k < n; k++, b += LANES) EACH sum[l] += b[l] * u[at[k] * LANES + l];
                        EACH now[o * LANES + l] += w[l] * sum[l];
                    }
                }
                for (long o = 0; o < ny; o++) EACH {
                    const double off = now[o * LANES + l] - wanted[((s * T + t) * ny + o) * LANES + l];
                    if (known[(s * T + t) * LANES + l] != 0.0) squares[c * ny + o] += off * off;
                }
            }
        }
}
"""


@dataclass(frozen=True, kw_only=True)
class Stretches:
    """What free runs start from, are driven by and compared with; shorter stretches end in zeros."""

    drive: np.ndarray  # (n_stretches, n_steps, n_drives)
    wanted: np.ndarray  # (n_stretches, n_steps, n_outputs)
    weights: np.ndarray  # (n_stretches, n_steps, n_speeds), of the model at each speed
    lengths: np.ndarray  # (n_stretches,), steps of each
    past: np.ndarray  # (n_stretches, na * n_outputs), outputs before the first step, newest first
    group: np.ndarray  # (n_stretches,), which coefficients have not seen it

    @property
    def known(self) -> np.ndarray:
        """Whether a step is one of the stretch, shape (n_stretches, n_steps)."""
        return np.arange(self.wanted.shape[1]) < self.lengths[:, None]

    def squares(self, theta: np.ndarray, used: Sequence[np.ndarray]) -> np.ndarray:
        """Sum of each candidate's squared errors, shape (n_candidates, n_outputs).

        Coefficients have shape (n_candidates, n_groups, n_speeds, n_columns, n_outputs), the columns as `past`, then
        `drive`; ``used`` are those of each candidate that are not zero, of the past its first lags.
        """
        loaded = library(_SOURCE, name="candidate_runs")
        return self._side_by_side(theta) if loaded is None else self._in_turn(loaded, theta, used)

    def _in_turn(self, loaded: ctypes.CDLL, theta: np.ndarray, used: Sequence[np.ndarray]) -> np.ndarray:
        (C, folds, J, p, ny), (S, T, nd) = theta.shape, self.drive.shape
        na = self.past.shape[1] // ny
        drives = [columns[columns >= na * ny] - na * ny for columns in used]
        lags = [(len(columns) - len(own)) // ny for columns, own in zip(used, drives, strict=True)]
        begins = np.cumsum([0, *map(len, drives)])
        own, y, squares = np.empty(J * p * ny * _LANES), np.empty((na + T) * ny * _LANES), np.zeros((C, ny))
        numbers = [np.ascontiguousarray(a, np.dtype("l")) for a in (lags, [*np.concatenate(drives), 0], begins)]
        arrays = [np.ascontiguousarray(theta), *numbers, *self._in_lanes, y, own, squares]
        blocks = -(-S // _LANES)
        loaded.candidate_runs(C, blocks, T, J, p, ny, na, folds, nd, *(a.ctypes.data for a in arrays))
        return squares

    @cached_property
    def _in_lanes(self) -> list[np.ndarray]:
        """What belongs to stretches, in blocks of `_LANES` of them, the lanes last."""
        several = (self.group, self.drive, self.weights, self.wanted, self.known.astype(float), self.past)
        made = []
        for array in several:
            whole = np.zeros((-(-len(array) // _LANES) * _LANES, *array.shape[1:]), dtype=array.dtype)
            whole[: len(array)] = array
            made.append(np.ascontiguousarray(np.moveaxis(whole.reshape(-1, _LANES, *array.shape[1:]), 1, -1)))
        return [made[0].astype(np.dtype("l")), *made[1:]]

    def _side_by_side(self, theta: np.ndarray) -> np.ndarray:
        (C, _, J, _, ny), (S, T, _) = theta.shape, self.drive.shape
        na, own = self.past.shape[1] // ny, theta[:, self.group]
        back = own[:, :, :, : na * ny].reshape(C, S, J, na, ny, ny)[:, :, :, ::-1]  # oldest lag first
        back = np.ascontiguousarray(back.transpose(3, 4, 2, 5, 0, 1)).reshape(na * ny, J * ny, C * S)
        ahead = own[:, :, :, na * ny :].transpose(2, 1, 3, 0, 4).reshape(J, S, -1, C * ny)
        pushed = np.zeros((S, T, C * ny))
        for j in range(J):
            pushed += self.weights[:, :, j, None] * np.matmul(self.drive, ahead[j])
        y = np.empty((na + T, ny, C, S))  # runs side by side in memory
        y[:na] = self.past.reshape(S, na, ny)[:, ::-1].transpose(1, 2, 0)[:, :, None]
        y[na:] = pushed.reshape(S, T, C, ny).transpose(1, 3, 2, 0)
        lags, weights = y.reshape(-1, ny, C * S), self.weights.transpose(1, 2, 0)[:, :, None, None]
        with np.errstate(over="ignore", invalid="ignore"):
            for t in range(T):
                newest = np.einsum("kmn,kn->mn", back, lags[t : t + na].reshape(na * ny, C * S)).reshape(J, ny, C, S)
                y[na + t] += (newest * weights[t]).sum(axis=0) if J > 1 else newest[0]
            off = y[na:]
            off -= self.wanted.transpose(1, 2, 0)[:, :, None]
            off *= self.known.T[:, None, None]
            return np.einsum("tics,tics->ci", off, off)
