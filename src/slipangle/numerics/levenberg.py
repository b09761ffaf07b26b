"""Levenberg-Marquardt on triangular factors: the normal equations are never formed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

TRIALS = 14  # dampings tried before a point is called a minimum


@dataclass(frozen=True, kw_only=True)
class Descent:
    """Outcome of `descend`: the last point, its cost, whether it is a minimum, and how many steps were made."""

    point: Any
    cost: float
    converged: bool
    steps: int


def descend(
    point: Any,
    *,
    cost: Callable[[Any], float],
    linearise: Callable[[Any], tuple[np.ndarray, np.ndarray, Any]],
    move: Callable[[Any, Any, np.ndarray], Any],
    max_iterations: int,
) -> Descent:
    """Minimise a sum of squares from a point of any kind.

    Parameters
    ----------
    point : object
        Where to start.
    cost : callable
        Sum of squared errors at a point; infinite where it does not exist.
    linearise : callable
        ``(r, e, context)`` of a point: moving by ``eta`` changes the errors so that their squared norm is
        ``|e - r eta|^2`` plus a constant; shapes (m, d), (m,).
    move : callable
        The point moved by ``eta``, given the context of its linearisation.
    max_iterations : int
        Limit on steps.
    """
    now, damping, grow = cost(point), 1e-3, 2.0
    costs = [now]
    for step in range(max_iterations):
        r, e, context = linearise(point)
        norms = np.linalg.norm(r, axis=0)
        scale = np.maximum(norms, 1e-12 * max(norms.max(initial=0.0), 1e-300))
        left, size, right = np.linalg.svd(r / scale, full_matrices=False)
        pull = left.T @ e
        for _ in range(TRIALS):
            eta = right.T @ (size / (size**2 + damping) * pull) / scale
            predicted = float(e @ e - np.sum((e - r @ eta) ** 2))
            trial = move(point, context, eta)
            after = cost(trial)
            if after < now:
                break
            damping, grow = damping * grow, grow * 2
        else:
            return Descent(point=point, cost=now, converged=True, steps=step)
        gain = (now - after) / max(predicted, 1e-300)
        damping, grow = max(damping * max(1 / 3, 1 - (2 * min(gain, 1.0) - 1) ** 3), 1e-12), 2.0
        flat = now - after < 1e-10 * now and predicted < 1e-9 * now
        point, now = trial, after
        costs.append(now)
        creeping = len(costs) > 10 and costs[-11] - now < 1e-5 * now
        if flat or creeping:
            return Descent(point=point, cost=now, converged=True, steps=step + 1)
    return Descent(point=point, cost=now, converged=False, steps=max_iterations)
