"""Stages of a fit over scaled coefficients: noise, criterion, covariance.

Source: G. Schwarz, Estimating the dimension of a model, Annals of Statistics 6, 1978.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from slipangle.identify.tires.magic_formula_coefficients import Free
from slipangle.numerics.covariance import coloured, middle_of_sandwich
from slipangle.numerics.multistart import Optimum, Regression


class FittedStage(NamedTuple):
    """Outcome of one stage: free coefficients, outputs, solution in scaled coordinates, and its regression."""

    free: tuple[Free, ...]
    outputs: tuple[str, ...]
    solution: Optimum
    problem: Regression


def noise(stage: FittedStage) -> list[float]:
    """Standard deviation of each output's residual, over the samples that count."""
    m = len(stage.outputs)
    error = stage.solution.residual.reshape(-1, m)
    weight = stage.problem.weight
    return [float(np.sqrt(np.mean((error[weight[:, k] > 0, k] / weight[weight[:, k] > 0, k]) ** 2))) for k in range(m)]


def deviance(stage: FittedStage) -> float:
    """Minus twice the log-likelihood of every output at its own noise, but for what all fits have."""
    counts = np.count_nonzero(stage.problem.weight, axis=0)
    return float(sum(2 * n * np.log(max(sigma, 1e-12)) for n, sigma in zip(counts, noise(stage), strict=True)))


def criterion(stage: FittedStage) -> float:
    """Schwarz's criterion: the deviance, and log n for each coefficient."""
    return float(deviance(stage) + len(stage.free) * np.log(np.count_nonzero(stage.problem.weight)))


def expendable(stage: FittedStage, home: np.ndarray) -> list[int]:
    """Which coefficients could go back to ``home`` (scaled) at less cost than their place is worth, in that order.

    Backward elimination on the quadratic model of the cost around the solution: the coefficient whose return costs
    least goes first, the others moving along, as long as the cost rises by less than log n. Only those that may be
    zero, with bounds on both sides of it, or that nothing depends on, can go.
    """
    j = stage.solution.jacobian
    count = np.count_nonzero(stage.problem.weight)
    scale = np.linalg.norm(j, axis=0)
    blind = scale == 0
    gram = j.T @ j / (stage.solution.cost / max(1, count - j.shape[1]))
    gram[blind, blind] = 1e-12
    optional = blind | np.array([f.lower == -f.upper for f in stage.free])
    theta, active, gone = stage.solution.theta.copy(), list(range(len(stage.free))), []
    while True:
        part = gram[np.ix_(active, active)]
        norm = np.sqrt(np.diag(part))
        inverse = np.linalg.pinv(part / np.outer(norm, norm), rcond=1e-14, hermitian=True) / np.outer(norm, norm)
        rise = (theta[active] - home[active]) ** 2 / np.maximum(np.diag(inverse), 1e-300)
        rise[~optional[active]] = np.inf
        k = int(np.argmin(rise))
        if not rise[k] < np.log(count):
            return gone
        step = (theta[active[k]] - home[active[k]]) / inverse[k, k]
        theta[active] -= inverse[:, k] * step
        gone.append(active.pop(k))
        if not active:
            return gone


def robust_covariance(stage: FittedStage) -> tuple[np.ndarray, str]:
    """Covariance in scaled coordinates; neighbouring samples of a sweep are not independent, which is allowed for."""
    m, j, e = len(stage.outputs), stage.solution.jacobian, stage.solution.residual
    scale = np.linalg.norm(j, axis=0)
    scale = np.where(scale > 0, scale, 1e-12)
    _, s, vt = np.linalg.svd(np.linalg.qr(j / scale, mode="r"))
    root = vt.T / np.maximum(s, 1e-14 * s[0])  # what the residual does not see is unknown, not known exactly
    inverse = root @ root.T
    blind = np.linalg.norm(j, axis=0) == 0
    count = np.count_nonzero(stage.problem.weight)
    dof = max(1, count - j.shape[1])
    middle, lags = middle_of_sandwich(e, j / scale, m)  # noise need not be alike at every load
    text = coloured(lags) if lags else "covariance for independent residuals of unlike size (White)"
    spread = inverse @ middle @ inverse * count / dof
    spread = spread / np.outer(scale, scale)
    spread[blind, blind] = 1e6
    return spread, text


def coefficients(stage: FittedStage, theta: np.ndarray) -> dict[str, Any]:
    """Coefficients of a stage from their scaled values."""
    return {f.name: unscaled(f, z) for f, z in zip(stage.free, theta, strict=True)}


def undetermined(stage: FittedStage) -> list[int]:
    """Which coefficients have a 95 % interval wider than their value, the widest first."""
    std = np.sqrt(np.maximum(np.diag(robust_covariance(stage)[0]), 0.0))
    half = np.array([(f.upper - f.lower) / 2 for f in stage.free])
    values = np.array([unscaled(f, z) for f, z in zip(stage.free, stage.solution.theta, strict=True)])
    width = 1.96 * std * half / np.maximum(np.abs(values), 1e-3)
    return [int(k) for k in np.argsort(-width) if not width[k] <= 1.0]


def scaled(f: Free, value: float) -> float:
    """A coefficient between -1 and 1 over its bounds."""
    return (2 * value - f.upper - f.lower) / (f.upper - f.lower)


def unscaled(f: Free, z: Any) -> Any:
    """A coefficient from its scaled value; numbers and symbols."""
    return (f.upper + f.lower) / 2 + (f.upper - f.lower) / 2 * z
