"""Least-squares fits of many candidate models to all data but each group: one after the other in C, or in NumPy."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from slipangle.codegen.compiler import library
from slipangle.identify.linear.speed_blocks import SpeedBlocks

_RIDGE = 1e-13  # of columns of one length: regressors that depend on each other share the effect
_LANES = 8  # groups side by side in C, all data among them
_SOURCE = """
#include <math.h>
#define LANES 8
#define EACH for (int l = 0; l < LANES; l++)
typedef double lanes[LANES];

/* Coefficients of C candidates at J speeds by block Cholesky factorisation, and how far the squared errors rise from
   the targets' squares. The last axis of all matrices is the lane, a group of data.

   A candidate has the columns picks[begins[c]] to picks[begins[c + 1] - 1] of p; same (J, p, p), next (J - 1, p, p)
   and targets (J, p, ny) are what is fitted to, the tested ones what the errors are taken of; theta (C, G, J, p, ny)
   of G lanes, at first zero, rise (C, G, ny, ny). No pivot is below the ridge but by rounding. */
void candidate_fits(long C, long G, long J, long p, long ny, double ridge, const long *picks, const long *begins,
    const lanes *same, const lanes *next, const lanes *targets, const lanes *tested, const lanes *tested_next,
    const lanes *tested_targets, double *theta, double *rise, lanes *work)
{
    for (long c = 0; c < C; c++) {
        const long *at = picks + begins[c], m = begins[c + 1] - begins[c];
        const double least = ridge * J * m;
        lanes *L = work, *W = L + J * m * m, *z = W + J * m * m, *x = z + J * m * ny, *sums = x + J * m * ny;
        for (long j = 0; j < J; j++) {
            lanes *l_ = L + j * m * m, *z_ = z + j * m * ny, *w_ = W + j * m * m;
            const lanes *before = W + (j - 1) * m * m, *z_before = z + (j - 1) * m * ny;
            for (long a = 0; a < m; a++) {
                for (long b = 0; b <= a; b++) {
                    lanes s;
                    const double *own = same[(j * p + at[a]) * p + at[b]], more = a == b ? least : 0.0;
                    EACH s[l] = own[l] + more;
                    if (j) for (long k = 0; k < m; k++) EACH s[l] -= before[k * m + a][l] * before[k * m + b][l];
                    for (long k = 0; k < b; k++) EACH s[l] -= l_[a * m + k][l] * l_[b * m + k][l];
                    if (a == b) EACH l_[a * m + a][l] = 1.0 / sqrt(s[l] > least ? s[l] : least);
                    else EACH l_[a * m + b][l] = s[l] * l_[b * m + b][l];
                }
                for (long o = 0; o < ny; o++) {
                    lanes s;
                    EACH s[l] = targets[(j * p + at[a]) * ny + o][l];
                    if (j) for (long k = 0; k < m; k++) EACH s[l] -= before[k * m + a][l] * z_before[k * ny + o][l];
                    for (long k = 0; k < a; k++) EACH s[l] -= l_[a * m + k][l] * z_[k * ny + o][l];
                    EACH z_[a * ny + o][l] = s[l] * l_[a * m + a][l];
                }
            }
            if (j + 1 < J)
                for (long a = 0; a < m; a++)
                    for (long b = 0; b < m; b++) {
                        lanes s;
                        EACH s[l] = next[(j * p + at[a]) * p + at[b]][l];
                        for (long k = 0; k < a; k++) EACH s[l] -= l_[a * m + k][l] * w_[k * m + b][l];
                        EACH w_[a * m + b][l] = s[l] * l_[a * m + a][l];
                    }
        }
        for (long j = J - 1; j >= 0; j--)
            for (long a = m - 1; a >= 0; a--)
                for (long o = 0; o < ny; o++) {
                    const lanes *l_ = L + j * m * m, *w_ = W + j * m * m;
                    lanes s, *x_ = x + j * m * ny;
                    EACH s[l] = z[(j * m + a) * ny + o][l];
                    if (j + 1 < J) for (long k = 0; k < m; k++) EACH s[l] -= w_[a * m + k][l] * x_[(m + k) * ny + o][l];
                    for (long k = a + 1; k < m; k++) EACH s[l] -= l_[k * m + a][l] * x_[k * ny + o][l];
                    EACH x_[a * ny + o][l] = s[l] * l_[a * m + a][l];
                    for (long g = 0; g < G; g++)
                        theta[(((c * G + g) * J + j) * p + at[a]) * ny + o] = x_[a * ny + o][g];
                }
        for (long i = 0; i < ny * ny; i++) EACH sums[i][l] = 0.0;
        for (long j = 0; j < J; j++)
            for (long a = 0; a < m; a++)
                for (long o = 0; o < ny; o++) {
                    lanes s = {0.0}, t = {0.0};
                    const lanes *x_ = x + j * m * ny;
                    for (long b = 0; b < m; b++) {
                        const double *own = tested[(j * p + at[a]) * p + at[b]];
                        EACH s[l] += own[l] * x_[b * ny + o][l];
                    }
                    if (j + 1 < J)
                        for (long b = 0; b < m; b++) {
                            const double *own = tested_next[(j * p + at[a]) * p + at[b]];
                            EACH t[l] += own[l] * x_[(m + b) * ny + o][l];
                        }
                    for (long q = 0; q < ny; q++) {
                        const double *wanted = tested_targets[(j * p + at[a]) * ny + q], *own = x_[a * ny + q];
                        EACH sums[q * ny + o][l] += own[l] * (s[l] + t[l]) - x_[a * ny + o][l] * wanted[l];
                        EACH sums[o * ny + q][l] += own[l] * t[l] - x_[a * ny + o][l] * wanted[l];
                    }
                }
        for (long i = 0; i < ny * ny; i++)
            for (long g = 0; g < G; g++) rise[(c * G + g) * ny * ny + i] = sums[i][g];
    }
}
"""


@dataclass(frozen=True)
class Fits:
    """Normal equations without each group, and of the data that each fit is tested on, columns of one length."""

    known: SpeedBlocks
    tested: SpeedBlocks

    def of(self, picks: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of each candidate's columns, and what squared errors are beyond the targets' squares.

        Shapes (n_candidates, n_groups, n_speeds, n_columns, n_outputs), (n_candidates, n_groups, n_outputs, n_outputs).
        """
        groups, J, p, ny = self.known.targets.shape
        theta, rise = np.zeros((len(picks), groups, J, p, ny)), np.zeros((len(picks), groups, ny, ny))
        if self._loaded is None or groups > _LANES:
            self._side_by_side(picks, theta, rise)
        else:
            self._in_turn(self._loaded, picks, theta, rise)
        return theta, rise

    @cached_property
    def _loaded(self) -> ctypes.CDLL | None:
        return library(_SOURCE, name="candidate_fits")

    def _in_turn(self, loaded: ctypes.CDLL, picks: Sequence[np.ndarray], theta: np.ndarray, rise: np.ndarray) -> None:
        C, groups, J, p, ny = theta.shape
        most = max(map(len, picks))
        work = np.empty((2 * J * most * (most + ny) + ny * ny, _LANES))
        numbers = [np.ascontiguousarray(a, np.dtype("l")) for a in (np.concatenate(picks), _begins(picks))]
        arrays = [*numbers, *self._in_lanes, theta, rise, work]
        loaded.candidate_fits(C, groups, J, p, ny, _RIDGE, *(a.ctypes.data for a in arrays))

    @cached_property
    def _in_lanes(self) -> list[np.ndarray]:
        """Blocks with the groups last, the last of them as often as lanes are left."""
        lanes = np.minimum(np.arange(_LANES), len(self.known.same) - 1)
        several = (b for blocks in (self.known, self.tested) for b in (blocks.same, blocks.next, blocks.targets))
        return [np.ascontiguousarray(np.moveaxis(block, 0, -1)[..., lanes]) for block in several]

    def _side_by_side(self, picks: Sequence[np.ndarray], theta: np.ndarray, rise: np.ndarray) -> None:
        for size in {len(pick) for pick in picks}:
            alike = [c for c, pick in enumerate(picks) if len(pick) == size]
            at = np.stack([picks[c] for c in alike])
            found = self.known.picked(at).solved(_RIDGE)
            rise[alike] = self.tested.picked(at).rise(found)
            for i, c in enumerate(alike):
                theta[c][:, :, at[i]] = found[i]


def _begins(picks: Sequence[np.ndarray]) -> np.ndarray:
    return np.cumsum([0, *map(len, picks)])
