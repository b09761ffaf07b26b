"""How good an iterate is after a full step, from the values there; the same measures as in solver.c."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True, eq=False)
class Promise:
    """What the linear model makes of a step.

    Errors after it times the roots of their weights, limited rows after it and their multipliers, multipliers of the
    model, the curvature of the cost along the step, and how far it reaches: inputs relative to half their range, states
    in `units`.
    """

    errors: np.ndarray
    limited: np.ndarray
    multipliers: np.ndarray
    pi: np.ndarray
    bend: float
    reach: float

    def left(self, errors: np.ndarray, limited: np.ndarray, defects: np.ndarray) -> float:
        """What is left of stationarity.

        Terms of the Lagrangian beyond the model that the step was computed with, over the curvature of that model along
        the step, are about the share of the step by which the next one corrects it.
        """
        beyond = np.abs(errors * (errors - self.errors)).sum() + np.abs(self.pi[1:] * defects).sum()
        beyond += np.abs(self.multipliers * (limited - self.limited)).sum()
        return self.reach * float(2 * beyond / self.bend if 2 * beyond < self.bend else 1.0)


def reach_of(step: np.ndarray, x: np.ndarray, dx: np.ndarray) -> float:
    """How far a step of the scaled inputs and of the states reaches."""
    return max(float(np.abs(step).max()), float((np.abs(dx[1:]) / units(x)).max()))


def units(rows: np.ndarray) -> np.ndarray:
    """One plus the mean change of each column from row to row, which does not depend on where zero is."""
    return 1 + np.abs(np.diff(rows, axis=0)).mean(axis=0)


def moves_on(x: np.ndarray, states: np.ndarray) -> bool:
    """Whether the state now is nearer to that a step ahead than to the first, as when the vehicle moves on."""
    here, ahead = (np.square((x - at) / units(states)).sum() for at in states[:2])
    return bool(ahead <= here)


BLURRED = 1e-9  # as in solver.c
GROWN = 1e13  # times that a state grows over the horizon, after which rounding leaves no digit of where inputs lead
FACTORED = 1e-12  # of the largest curvature, added to each so that there is a factor


def blurred(H: np.ndarray, weights: np.ndarray, step: np.ndarray, cost: float) -> bool:
    """Whether a program whose step is all but none may leave cost, by ``weights`` of shape (n,); see solver.c."""
    curvature = np.diag(H)
    own, push = np.where(weights > 0, weights, curvature), FACTORED * curvature.max() * np.abs(step)
    some = (own > 0) & (push > BLURRED * own)
    return float((push[some] ** 2 / own[some]).sum()) > BLURRED * cost


def outgrown(A: np.ndarray, jumps: Sequence[int]) -> bool:
    """Whether steps with derivatives A multiply some state by so much, from the first on or from after a jump."""
    by = np.eye(A.shape[1])
    for m, step in enumerate(A):
        by = np.eye(len(step)) if m in jumps else step @ by
        if not (np.abs(np.diagonal(by)) <= GROWN).all():
            return True
    return False
