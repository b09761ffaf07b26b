"""Normal equations of models that stand at several speeds and are blended between neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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

    def solved(self, ridge: float) -> np.ndarray:
        """Coefficients, shape (..., n_speeds, n, n_outputs), by elimination from speed to speed.

        ``ridge`` is added to the diagonal, of columns of one length over all data, times how many there are.
        """
        J, n = self.same.shape[-3:-1]
        scale = np.sqrt(np.diagonal(self.same[:, -1], axis1=-2, axis2=-1))[:, None, :, :, None]
        scale = np.where(scale > 0, scale, 1.0)
        same = self.same / (scale * scale.swapaxes(-1, -2)) + ridge * J * n * np.eye(n)
        beside = self.next / (scale[..., :-1, :, :] * scale[..., 1:, :, :].swapaxes(-1, -2))
        wanted, held = self.targets / scale, []
        pivot, right = same[..., 0, :, :], wanted[..., 0, :, :]
        for j in range(J):
            more = [beside[..., j, :, :]] if j + 1 < J else []
            held.append(np.linalg.solve(pivot, np.concatenate([right, *more], axis=-1)))
            if more:
                back = more[0].swapaxes(-1, -2) @ held[j]
                ny = right.shape[-1]
                right, pivot = wanted[..., j + 1, :, :] - back[..., :ny], same[..., j + 1, :, :] - back[..., ny:]
        ny, found = wanted.shape[-1], [held[-1]]
        for part in held[-2::-1]:
            found.append(part[..., :ny] - part[..., ny:] @ found[-1])
        return np.stack(found[::-1], axis=-3) / scale

    def rise(self, theta: np.ndarray) -> np.ndarray:
        """What the squared errors of such coefficients are beyond the targets' squares, shape (..., ny, ny)."""
        turned = theta.swapaxes(-1, -2)
        cross = turned @ self.targets
        between = turned[..., :-1, :, :] @ (self.next @ theta[..., 1:, :, :])
        squares = turned @ (self.same @ theta) - cross - cross.swapaxes(-1, -2)
        return squares.sum(axis=-3) + (between + between.swapaxes(-1, -2)).sum(axis=-3)
