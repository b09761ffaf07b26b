"""Bayesian model averaging: linear least squares where whole groups of coefficients may be zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

SCALES = (1.0, 3.0)  # of the priors' widths, as likely as each other: together they have heavy tails


@dataclass(frozen=True)
class Average:
    """Coefficients over all hypotheses, each as much as it is likely."""

    mean: np.ndarray  # (n,), of the coefficients
    covariance: np.ndarray  # (n, n), about the mean if no group is zero: what is left out is not thereby known
    nothing: float  # probability that all coefficients are zero

    @property
    def given_some(self) -> np.ndarray:
        """Mean given that some group is not zero, shape (n,)."""
        return self.mean / max(1.0 - self.nothing, np.finfo(float).tiny)


def averaged(
    information: np.ndarray, pull: np.ndarray, width: np.ndarray, groups: Sequence[str], *, none: float = 0.5
) -> Average:
    """Average [1]_ over which groups are zero, for the likelihood ``exp(pull' x - x' information x / 2)``.

    Parameters
    ----------
    information : array, shape (n, n)
        Inverse covariance of the coefficients by the data alone; may be singular.
    pull : array, shape (n,)
        The information times the coefficients that the data alone would give.
    width : array, shape (n,)
        Standard deviations of the normal priors around zero of coefficients that are not zero; as likely, thrice that.
    groups : sequence of str
        To which group each coefficient belongs; groups are zero or not independently of each other.
    none : float
        Probability before the data that all groups are zero.

    References
    ----------
    .. [1] J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky, Bayesian model averaging: a tutorial, Statistical
       Science 14(4), 1999, 382-417.
    """
    kinds = list(dict.fromkeys(groups))
    absent = none ** (1.0 / len(kinds))
    n = len(width)
    weights, means, covariances = [], [], []
    for present in product((False, True), repeat=len(kinds)):
        on = np.array([present[kinds.index(group)] for group in groups])
        before = sum(np.log(1.0 - absent if p else absent) for p in present)
        for scale in SCALES if on.any() else (1.0,):
            mean, covariance, w = np.zeros(n), np.zeros((n, n)), scale * width[on]
            hessian = information[np.ix_(on, on)] * np.outer(w, w) + np.eye(on.sum())
            inverse = np.linalg.inv(hessian)
            mean[on], covariance[np.ix_(on, on)] = w * (inverse @ (w * pull[on])), inverse * np.outer(w, w)
            gained = 0.5 * float(pull @ mean - np.linalg.slogdet(hessian)[1])
            weights.append(before - np.log(len(SCALES) if on.any() else 1) + gained)
            means.append(mean)
            covariances.append(covariance)
    share = np.exp(np.array(weights) - max(weights))
    share /= share.sum()
    mean = share @ np.array(means)
    every = slice(-len(SCALES), None)  # hypotheses without a zero
    full, apart = share[every] / share[every].sum(), np.array(means[every]) - mean
    covariance = np.einsum("k,kab->ab", full, covariances[every]) + np.einsum("k,ka,kb->ab", full, apart, apart)
    return Average(mean=mean, covariance=covariance, nothing=float(share[0]))
