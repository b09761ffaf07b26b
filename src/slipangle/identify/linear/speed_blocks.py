"""Normal equations of models that stand at several speeds and are blended between neighbours."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from slipangle.identify.linear.lags import Windows
from slipangle.models.wrappers.multi_arx import speed_weights

_CHUNK = 1 << 12  # samples whose regressors stay in the cache


@dataclass(frozen=True)
class SpeedBlocks:
    """Gram matrices of models that are blended between neighbouring speeds: only neighbours have products."""

    same: np.ndarray  # (n_groups, n_speeds, n, n), at one speed; of candidates with their number first
    next: np.ndarray  # (n_groups, n_speeds - 1, n, n), with the next speed
    targets: np.ndarray  # (n_groups, n_speeds, n, n_outputs)

    @classmethod
    def of(cls, gram: np.ndarray, J: int, p: int) -> SpeedBlocks:
        """Blocks of whole matrices, shape (n_groups, J p + n_outputs, J p + n_outputs)."""
        whole = gram[..., : J * p, : J * p].reshape(*gram.shape[:-2], J, p, J, p)
        same = np.stack([whole[..., j, :, j, :] for j in range(J)], axis=-3)
        beside = [whole[..., j, :, j + 1, :] for j in range(J - 1)]
        between = np.stack(beside, axis=-3) if beside else np.zeros((*gram.shape[:-2], 0, p, p))
        return cls(same, between, gram[..., : J * p, J * p :].reshape(*gram.shape[:-2], J, p, -1))

    def picked(self, at: np.ndarray) -> SpeedBlocks:
        """Those of candidates' columns, shape (n_candidates, n): candidates come first."""
        rows, columns = at[:, :, None], at[:, None]
        same, beside = self.same[:, :, rows, columns], self.next[:, :, rows, columns]
        return SpeedBlocks(*(block.transpose(2, 0, 1, 3, 4) for block in (same, beside, self.targets[:, :, at])))

    @property
    def lengths(self) -> np.ndarray:
        """Of the columns in the last group, shape (n_speeds, n); 1 where a column is zero."""
        size = np.sqrt(np.diagonal(self.same[-1], axis1=-2, axis2=-1))
        return np.where(size > 0, size, 1.0)

    def others(self) -> SpeedBlocks:
        """Of all data, which the last group is, without each group; of all for the last."""
        several = (self.same, self.next, self.targets)
        return SpeedBlocks(*(np.concatenate([b[-1:] - b[:-1], b[-1:]]) for b in several))

    def over(self, scale: np.ndarray) -> SpeedBlocks:
        """The same of columns that are divided by numbers, shape (n_speeds, n)."""
        same = self.same / (scale[:, :, None] * scale[:, None])
        return SpeedBlocks(same, self.next / (scale[:-1, :, None] * scale[1:, None]), self.targets / scale[:, :, None])

    def solved(self, ridge: float) -> np.ndarray:
        """Coefficients, shape (..., n_speeds, n, n_outputs), by elimination from speed to speed.

        ``ridge`` is added to the diagonal, of columns of one length over all data, times how many there are.
        """
        J, n = self.same.shape[-3:-1]
        same, held = self.same + ridge * J * n * np.eye(n), []
        pivot, right = same[..., 0, :, :], self.targets[..., 0, :, :]
        for j in range(J):
            more = [self.next[..., j, :, :]] if j + 1 < J else []
            held.append(np.linalg.solve(pivot, np.concatenate([right, *more], axis=-1)))
            if more:
                back = more[0].swapaxes(-1, -2) @ held[j]
                ny = right.shape[-1]
                right, pivot = self.targets[..., j + 1, :, :] - back[..., :ny], same[..., j + 1, :, :] - back[..., ny:]
        ny, found = self.targets.shape[-1], [held[-1]]
        for part in held[-2::-1]:
            found.append(part[..., :ny] - part[..., ny:] @ found[-1])
        return np.stack(found[::-1], axis=-3)

    def rise(self, theta: np.ndarray) -> np.ndarray:
        """What the squared errors of such coefficients are beyond the targets' squares, shape (..., ny, ny)."""
        turned = theta.swapaxes(-1, -2)
        cross = turned @ self.targets
        between = turned[..., :-1, :, :] @ (self.next @ theta[..., 1:, :, :])
        squares = turned @ (self.same @ theta) - cross - cross.swapaxes(-1, -2)
        return squares.sum(axis=-3) + (between + between.swapaxes(-1, -2)).sum(axis=-3)


def gram_of_speeds(
    windows: Windows,
    columns: Sequence[tuple[int, int]],
    n_outputs: int,
    speeds: Sequence[float],
    size: np.ndarray,
    *,
    constant: bool,
) -> np.ndarray:
    """Gram matrix of regressors, at every speed, then of the targets, which are the first channels of the windows.

    ``columns`` are samples back and channel of each regressor, channels over ``size``; a constant comes after them.
    Between two neighbouring speeds only the models at these have weights.
    """
    p, J = len(columns) + constant, len(speeds)
    gram = np.zeros((J * p + n_outputs,) * 2)
    for full, v_x in _regressors(windows, columns, n_outputs, size, constant):
        lower = np.clip(np.searchsorted(speeds, v_x, side="right") - 1, 0, J - 2)
        order = np.argsort(lower, kind="stable")
        lower, full, weights = lower[order], full[:, order], np.stack(speed_weights(v_x[order], speeds))
        each, wide = np.arange(len(order)), np.empty((2 * p + n_outputs, len(order)))
        for k in (0, 1):
            np.multiply(full[:p], weights[lower + k, each], out=wide[k * p : (k + 1) * p])
        wide[2 * p :] = full[p:]
        edges = np.searchsorted(lower, np.arange(J))
        for j in np.flatnonzero(np.diff(edges)).tolist():
            here = wide[:, edges[j] : edges[j + 1]]
            own, last, product = slice(j * p, (j + 2) * p), slice(J * p, None), here @ here.T
            gram[own, own] += product[: 2 * p, : 2 * p]
            gram[own, last] += product[: 2 * p, 2 * p :]
            gram[last, own] += product[2 * p :, : 2 * p]
            gram[last, last] += product[2 * p :, 2 * p :]
    return gram


def _regressors(
    windows: Windows, columns: Sequence[tuple[int, int]], n_outputs: int, size: np.ndarray, constant: bool
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Regressors and targets, one in a row, and v_x a sample before, some thousand samples at a time."""
    p, m, at = len(columns) + constant, windows.lags - 1, 0
    room = min(_CHUNK, windows.count)
    full, v_x = np.ones((p + n_outputs, room)), np.empty(room)
    for start, stop in windows.spans():
        first = start + m
        while first < stop:
            n = min(room - at, stop - first)
            signals = (windows.block(first - m, first + n) / size).T
            for row, (lag, channel) in enumerate(columns):
                full[row, at : at + n] = signals[channel, m - lag : m - lag + n]
            full[p:, at : at + n] = signals[:n_outputs, m:]
            v_x[at : at + n] = windows.data["v_x"][first - 1 : first - 1 + n]
            at, first = at + n, first + n
            if at == room:
                yield full, v_x
                at = 0
    if at:
        yield full[:, :at], v_x[:at]
