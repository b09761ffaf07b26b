"""How far gain and phase may be from a spectral estimate, also where noise hides most of them."""

from __future__ import annotations

import numpy as np
import scipy
from scipy import special

from slipangle.numerics.critical import require_level

_CLEAR = 200.0  # squared distance from zero in variances, from which the error along the estimate is all that counts


def student(freedom: float, level: float = 0.95) -> float:
    """Half width of an interval in estimated standard deviations, over that of the normal law in true ones."""
    return float(scipy.stats.t.isf((1 - level) / 2, freedom) / scipy.stats.norm.isf((1 - level) / 2))


def gain_limits(s: np.ndarray, freedom: float, level: float) -> np.ndarray:
    """Ends of the interval of the true gain over the estimated one, shape (n, 2).

    ``s``, shape (n,), is the standard deviation of the estimate's real part over its magnitude, estimated with
    ``freedom`` degrees of freedom. The estimate's squared magnitude is non-central chi-square of two degrees of freedom
    ([1]_ sec. 4.2, Rice's law), which is solved for the gain; Student's quantile stands in for the normal one, as the
    noise is estimated. Zero is in it where the gain is not told from none.

    References
    ----------
    .. [1] J. S. Bendat, A. G. Piersol, Random Data, 4th ed., 2010.
    """
    require_level(level)
    half = float(scipy.stats.t.isf((1 - level) / 2, freedom))
    tail = float(scipy.stats.norm.sf(half))
    with np.errstate(divide="ignore"):
        square = 1 / s**2
    near = np.where(square < 2 * _CLEAR, square, 1.0)

    def solved(share: float) -> np.ndarray:
        some = special.chndtr(near, 2, 0.0) > share
        central = special.chndtrinc(near, 2, share)
        return np.sqrt(np.where(some, central, 0.0) * s**2)

    with np.errstate(invalid="ignore"):
        ends = np.column_stack([solved(1 - tail), np.maximum(solved(tail), 1 + half * s)])
    return np.where((square < 2 * _CLEAR)[:, None], ends, np.column_stack([1 - half * s, 1 + half * s]))


def phase_half(s: np.ndarray, freedom: float, level: float) -> np.ndarray:
    """Half width of the interval of the phase, shape (n,); ``s`` and ``freedom`` are those of `gain_limits`. [rad]

    Across the true direction the error is Student's. Where the gain is not told from zero, any phase is possible.
    """
    require_level(level)
    with np.errstate(divide="ignore"):
        told = 0.5 / s**2 > scipy.stats.f.isf(1 - level, 2, freedom)
    reach = np.minimum(scipy.stats.t.isf((1 - level) / 2, freedom) * s, 1.0)
    return np.where(told, np.arcsin(reach), np.pi)
