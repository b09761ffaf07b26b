"""Intervals of a car's parameters from what stretches of the log, and structures as good, disagree on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from slipangle.identify.car.structures import Fitted
from slipangle.numerics import covariance as uncertainty

_UNTOLD = 1e-9  # information left over information, of a parameter, below which there is none


def covariance(fitted: Fitted) -> tuple[np.ndarray, str]:
    """Covariance of the free parameters, SI units, and how it was found.

    The larger one, parameter by parameter, of that for coloured residuals and of the jackknife over stretches: what the
    model lacks makes stretches of unlike speed and size disagree, which no colour of residuals shows. Where the data
    are silent, what is ordinary for a car bounds it.

    References
    ----------
    .. [1] A. C. Cameron, D. L. Miller, "A practitioner's guide to cluster-robust inference", J. Human Resources 50(2),
       2015, 317-372, the estimator CV3.
    """
    n, ny, n_p = fitted.jacobian.shape
    e, J = fitted.error.ravel(), fitted.jacobian.reshape(n * ny, n_p)
    prior = fitted.pull.T @ fitted.pull
    full, moves = J.T @ J + prior, []
    middle, lags = uncertainty.middle_of_sandwich(e, J, ny)
    middle = middle if lags else (full - prior) * float(e @ e) / len(e)
    inverse = _inverse(full)
    share = len(e) / max(1, len(e) - n_p)
    coloured = inverse @ (share * middle + fitted.thinning * prior) @ inverse
    for k in np.unique(fitted.stretch):
        rows = np.repeat(fitted.stretch == k, ny)
        rest = full - J[rows].T @ J[rows]
        told = np.diag(rest) > _UNTOLD * np.diag(full)  # not where the only stretch of a recording is left out
        move = np.zeros(n_p)
        move[told] = _inverse(rest[np.ix_(told, told)]) @ (J[rows][:, told].T @ e[rows])
        moves.append(move)
    count = len(moves)
    spread = np.array(moves) - np.mean(moves, axis=0)
    jackknife = spread.T @ spread * (count - 1) / count
    wide = few(count)
    std = np.maximum(np.sqrt(np.maximum(np.diag(coloured), 0.0)), wide * np.sqrt(np.diag(jackknife)))
    along = np.sqrt(np.maximum(np.diag(coloured), 1e-300))
    scaled = coloured / np.outer(along, along) * np.outer(std, std)
    scale = fitted.problem.scale
    how = uncertainty.coloured(lags) if lags else "covariance for white residuals"
    return scaled * np.outer(scale, scale), f"{how} or jackknife over {count} stretches, the larger"


def few(count: int) -> float:
    """By how much wider a 95 % interval is whose spread so many stretches tell: few tell their own badly."""
    return float(scipy.stats.t.ppf(0.975, count - 1) / scipy.stats.t.ppf(0.975, np.inf))


def _inverse(information: np.ndarray) -> np.ndarray:
    lengths = np.sqrt(np.maximum(np.diag(information), 1e-300))
    even = np.linalg.pinv(information / np.outer(lengths, lengths), rcond=1e-12, hermitian=True)
    return even / np.outer(lengths, lengths)


def hull_of_sum(names: Sequence[str], best: Fitted, others: Sequence[tuple[Fitted, float]]) -> tuple[float, float]:
    """95 % limits of a sum of parameters, from the lowest to the highest of the fits in which all are free."""
    reached = []
    for fitted, share in ((best, 1.0), *others):
        if {*names} <= {*fitted.names}:
            at = [fitted.names.index(name) for name in names]
            half = 1.96 * float(np.sqrt(max(covariance(fitted)[0][np.ix_(at, at)].sum(), 0.0)))
            ends = sum(fitted.values[name] for name in names) + np.array([-half, half])
            reached.append(ends if fitted is best else reached[0] + share * (ends - reached[0]))
    return float(np.min(reached)), float(np.max(reached))


def hull(
    names: Sequence[str], best: Fitted, others: Sequence[tuple[Fitted, float]]
) -> tuple[np.ndarray, np.ndarray, str]:
    """Covariance, 95 % limits, shape (n_names, 2), and method of a fit, and of others that explain the data as well.

    A parameter's limits reach from the lowest to the highest of the fits in which it is free, as far as each counts.
    """
    spread, how = covariance(best)
    half = 1.96 * np.sqrt(np.maximum(np.diag(spread), 0.0))
    values = np.array([best.values[name] for name in names])
    limits = np.column_stack([values - half, values + half])
    own_limits = limits.copy()
    for other, share in others:
        own = 1.96 * np.sqrt(np.maximum(np.diag(covariance(other)[0]), 0.0))
        for i, name in enumerate(names):
            if name in other.names:
                value, reach = other.values[name], own[other.names.index(name)]
                low, high = own_limits[i] + share * (np.array([value - reach, value + reach]) - own_limits[i])
                limits[i] = min(limits[i, 0], low), max(limits[i, 1], high)
    ranges = best.problem.ranges.T
    return spread, np.clip(limits, ranges[:, :1], ranges[:, 1:]), how
