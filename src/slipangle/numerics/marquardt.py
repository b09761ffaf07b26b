"""Levenberg-Marquardt on normal equations, for problems of many samples and a few hundred parameters with priors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import linalg


def improve(
    theta: np.ndarray,
    cost: float,
    damping: float,
    *,
    linearised: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    evaluate: Callable[[np.ndarray], float],
    lower: np.ndarray,
    upper: np.ndarray,
) -> tuple[np.ndarray, float, float] | None:
    """A step that lowers the cost, its cost and the damping for the next step; None where there is none.

    Parameters
    ----------
    theta : array, shape (n,)
        Where to start.
    cost : float
        Cost there.
    damping : float
        Relative to the diagonal of the Gauss-Newton matrix.
    linearised : callable
        Gauss-Newton matrix, shape (n, n), and half the gradient.
    evaluate : callable
        Cost of a parameter vector; not finite where the free run is not.
    lower, upper : array, shape (n,)
        Bounds, kept by projection.
    """
    matrix, gradient = linearised(theta)
    diagonal = np.diag(np.diag(matrix) + 1e-8)
    for _ in range(12):
        try:
            move: Any = linalg.cho_solve(linalg.cho_factor(matrix + damping * diagonal), gradient)
        except linalg.LinAlgError:
            damping *= 4
            continue
        new = np.clip(theta - move, lower, upper)
        new_cost = evaluate(new)
        if np.isfinite(new_cost) and new_cost < cost:
            return new, new_cost, max(damping / 3, 1e-7)
        damping *= 4
    return None
