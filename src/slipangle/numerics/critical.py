"""Critical values of estimates whose standard deviation is itself estimated, from a few stretches of coloured noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr, ndtri

from slipangle.errors import ParameterError, shown

NORMAL = 1.96  # critical value, at 95 %, of an estimate whose standard deviation is known
_DRAWS, _FEWEST, _MOST = 2000, 20, 200  # per share of the lags in the samples; bounds: few lags scatter little
_LARGEST = 100.0  # critical value
_UNEVEN = 0.05  # difference of an interval's sides, as a share of their sum, that "±" leaves out


def require_level(level: float) -> None:
    """Raise ParameterError unless a confidence level is between 0 and 1."""
    if not 0 < level < 1:
        raise ParameterError(f"the confidence level is {shown(level)}; expected a share between 0 and 1: 95 % is 0.95")


def quantile(level: float) -> float:
    """Half width of a confidence interval in standard deviations, of the normal distribution.

    >>> round(quantile(0.95), 3)
    1.96

    Raises ParameterError unless the level is between 0 and 1.
    """
    require_level(level)
    return float(ndtri(0.5 + level / 2))


def even(value: float, low: float, high: float) -> bool:
    """Whether "± half of it" says an interval: to 5 % of that half, or it has no end on either side.

    >>> even(10.0, 8.0, 12.1), even(1.0, 0.86, 1.0), even(1.0, -np.inf, np.inf), even(1.0, 0.0, np.inf)
    (True, False, True, False)
    """
    below, above = value - low, high - value
    if not (np.isfinite(below) or np.isfinite(above)):
        return True
    return bool(np.isfinite(above - below) and abs(above - below) <= _UNEVEN * (above + below))


def critical_values(
    jacobian: Sequence[np.ndarray],
    coefficients: np.ndarray,
    driving: np.ndarray,
    inverse: np.ndarray,
    variance: np.ndarray,
    lags: int,
) -> np.ndarray:
    """Standard deviations by Newey and West that hold the truth at 95 % where the noise is such an autoregression.

    Residuals are smaller than noise, most where a few samples tell a parameter, a kernel of finite width misses part of
    a slow colour, and what it sums scatters: 1.96 standard deviations hold too little. Noise with the residuals'
    autoregression is drawn, the parameters' errors that it makes are taken off, and the covariance estimated as it is
    of the data; the estimate counts as normal and independent of it, with the variance that the autoregression gives.

    Every experiment's Jacobian has shape (n_samples, n_outputs, n), ``coefficients`` (order, n_outputs, n_outputs),
    ``driving`` is the covariance of what drives it, ``inverse``, shape (n, n), that of the Gram matrix, ``variance``,
    shape (n,), that of the estimates. Returns shape (n,), at least 1.96.

    References
    ----------
    .. [1] N. M. Kiefer, T. J. Vogelsang, "A new asymptotic theory for heteroskedasticity-autocorrelation robust tests",
       Econometric Theory 21, 2005.
    .. [2] P. Bühlmann, "Sieve bootstrap for time series", Bernoulli 3, 1997.
    """
    n, rng = sum(map(len, jacobian)), np.random.default_rng(0)
    count = int(np.clip(_DRAWS * lags / n, _FEWEST, _MOST))
    influence = [j @ inverse for j in jacobian]
    sizes = {len(j): 1 << int(np.ceil(np.log2(2 * max(len(j), 1)))) for j in jacobian}
    roots = {size: spectral_factor(coefficients, driving, size) for size in set(sizes.values())}
    ratios = np.empty((count, len(variance)))
    known = np.where(variance > 0, variance, np.inf)
    for draw in range(count):
        noise = [drawn(rng, roots[sizes[len(j)]])[: len(j)] for j in jacobian]
        moved = sum((np.einsum("kyi,ky->i", p, e) for p, e in zip(influence, noise, strict=True)), np.zeros(len(known)))
        told = np.zeros(len(known))
        for j, p, e in zip(jacobian, influence, noise, strict=True):
            told += squared_sums(np.einsum("kyi,ky->ki", p, e - j @ moved), lags)
        ratios[draw] = np.sqrt(told / known)
    low, high = np.full(len(known), NORMAL), np.full(len(known), _LARGEST)
    for _ in range(40):
        middle = (low + high) / 2
        outside = 2 * ndtr(-middle * ratios).mean(axis=0) > 0.05
        low, high = np.where(outside, middle, low), np.where(outside, high, middle)
    return np.where(variance > 0, (low + high) / 2, NORMAL)


def drawn(rng: np.random.Generator, root: np.ndarray) -> np.ndarray:
    """Stationary noise of such a `spectral_factor`, shape (size, n_outputs), whose end leads into its beginning."""
    size = 2 * (len(root) - 1)
    wave = np.fft.rfft(rng.standard_normal((size, root.shape[1])), axis=0)
    return np.fft.irfft(np.einsum("fyw,fw->fy", root, wave), size, axis=0)


def spectral_factor(coefficients: np.ndarray, driving: np.ndarray, size: int) -> np.ndarray:
    """Of an autoregression, at the frequencies of ``rfft`` of so many samples, shape (n_frequencies, ny, ny)."""
    z = np.exp(-2j * np.pi * np.arange(size // 2 + 1) / size)
    through = np.eye(len(driving)) - sum(
        (c * z[:, None, None] ** (i + 1) for i, c in enumerate(coefficients)), np.zeros((len(z), *driving.shape))
    )
    value, vector = np.linalg.eigh(driving)
    root = vector * np.sqrt(np.maximum(value, 0.0)) @ vector.T  # the symmetric one, whatever the vectors' signs
    return np.linalg.solve(through, root.astype(complex))


def squared_sums(scores: np.ndarray, lags: int) -> np.ndarray:
    """Diagonal of `slipangle.numerics.covariance.long_run`, shape (n,), of scores, shape (n_samples, n).

    The triangular weights of Newey and West are those of all sums of ``lags + 1`` neighbours.
    """
    n, width = len(scores), lags + 1
    sums = np.concatenate([np.zeros((1, scores.shape[1])), np.cumsum(scores, axis=0)])
    ends = np.arange(1, n + width)
    stretch = sums[np.minimum(ends, n)] - sums[np.maximum(ends - width, 0)]
    return np.einsum("ki,ki->i", stretch, stretch) / width
