"""Covariance of least-squares estimates, and sentences about parameters that the data do not determine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from slipangle.numerics.critical import NORMAL, critical_values, spectral_factor
from slipangle.units import SI

TOO_WIDE = 0.5  # half of a 95 % interval over the value, above which a parameter counts as not determined
CONDITION = 300.0  # of the Jacobian with columns of one length, above which parameters cannot be told apart
_ROUNDING = 1e-7  # singular value of that Jacobian over the largest, up to which it is the rounding of zero
_NO_SHARE = 1e-6  # of an unknown in a direction of length one, up to which it is the rounding of zero


def covariance(
    error: np.ndarray, jacobian: np.ndarray, n_outputs: int, *, lengths: Sequence[int] = ()
) -> tuple[np.ndarray, str]:
    """Covariance of the unknowns, allowing for coloured residuals when they are; and a few words on how.

    Residuals, shape (n_rows * n_outputs,), are of about the same size for every output; the Jacobian has their
    derivatives, shape (n_rows * n_outputs, n). ``lengths`` are the rows of each experiment, by default all of one.
    It is that of what the data determine: along `loose_directions` nothing is added, `unlimited` does that.

    Where residuals are coloured, standard deviations are so wide that 1.96 of them hold the truth at 95 % for noise of
    their autoregression: see `slipangle.numerics.critical`.
    """
    dof = max(1, len(error) - jacobian.shape[1])
    inverse = inverse_information(jacobian)
    residuals = error.reshape(-1, n_outputs)
    lags = bandwidth(residuals)
    if not lags:
        return inverse * float(error @ error) / dof, "covariance for white residuals"
    ends = np.cumsum([n for n in lengths if n][:-1]).astype(int)
    pieces = np.split(residuals, ends)
    slopes = np.split(jacobian.reshape(*residuals.shape, -1), ends)
    scores = [np.einsum("kyi,ky->ki", j, e) for j, e in zip(slopes, pieces, strict=True)]
    sandwich = inverse @ sum(long_run(s, min(lags, len(s) - 1)) for s in scores) @ inverse * len(error) / dof
    coefficients, driving = autoregression(pieces)
    middle = sum(middle_of_autoregression(j, coefficients, driving) for j in slopes)
    critical = critical_values(slopes, coefficients, driving, inverse, np.diag(inverse @ middle @ inverse), lags)
    wide = critical / NORMAL
    said = f"{coloured(lags)}, widened to hold 95 % for their autoregression of order {len(coefficients)}"
    return sandwich * np.outer(wide, wide), said


def _even(jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The Jacobian with columns of one length, but for zeros; and their lengths."""
    norms = np.linalg.norm(jacobian, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    return jacobian / norms, norms


def inverse_information(jacobian: np.ndarray) -> np.ndarray:
    """Inverse of J' J where that has one, shape (n, n)."""
    even, norms = _even(jacobian)
    return np.linalg.pinv(even.T @ even, rcond=_ROUNDING**2, hermitian=True) / np.outer(norms, norms)


def loose_directions(jacobian: np.ndarray) -> np.ndarray:
    """Directions in which the unknowns move without moving any residual, but for rounding, shape (n, n_directions).

    Two parameters that only act as a product leave one: that of a constant product.
    """
    even, norms = _even(jacobian)
    _, s, vt = np.linalg.svd(even, full_matrices=len(even) < even.shape[1])
    size = np.concatenate([s, np.zeros(len(vt) - len(s))])
    free = vt[size <= _ROUNDING * max(size.max(initial=0.0), 1e-300)].T
    return np.where(np.abs(free) > _NO_SHARE, free, 0.0) / norms[:, None]


def unlimited(known: np.ndarray, loose: np.ndarray) -> np.ndarray:
    """Covariance where besides a ``known`` part, shape (n, n), nothing is known along loose directions, (n, n_loose).

    Its entries are the limit as these move ever further: infinite variances, and covariances of either sign.
    """
    lengths = np.linalg.norm(loose, axis=1)
    unit = loose / np.where(lengths > 0, lengths, 1.0)[:, None]
    together = unit @ unit.T
    return np.where(np.abs(together) > _NO_SHARE, np.copysign(np.inf, together), known)


def middle_of_sandwich(error: np.ndarray, jacobian: np.ndarray, n_outputs: int) -> tuple[np.ndarray, int]:
    """Covariance of the gradient where residuals are of unlike size (White) and coloured (Newey-West); and its lags.

    No lags where neighbouring residuals are independent; else as many as suit a first-order autoregression, up to a
    quarter of the samples: with fewer, the intervals of slow residuals come out too narrow.

    References
    ----------
    .. [1] H. White, Econometrica 48, 1980.
    .. [2] W. K. Newey, K. D. West, Econometrica 55, 1987; bandwidth by D. W. K. Andrews, Econometrica 59, 1991.
    """
    residuals = error.reshape(-1, n_outputs)
    scores = (error[:, None] * jacobian).reshape(len(residuals), n_outputs, -1).sum(axis=1)
    lags = bandwidth(residuals)
    return long_run(scores, lags), lags


def bandwidth(residuals: np.ndarray) -> int:
    """Lags over which residuals, shape (n_samples, n_outputs), are coloured; 0 where neighbours are independent."""
    n = len(residuals)
    rho = float(np.clip(max(abs(_lag_one(column)) for column in residuals.T), 0, 0.999))
    if rho < 3.3 / np.sqrt(n):
        return 0
    alpha = 4 * rho**2 / (1 - rho**2) ** 2
    return int(min(1.1447 * (alpha * n) ** (1 / 3), n // 4)) + 1


def long_run(scores: np.ndarray, lags: int) -> np.ndarray:
    """Covariance of the sum of scores, shape (n_samples, n), that depend on each other over so many lags."""
    middle = scores.T @ scores
    for lag in range(1, lags + 1):
        gamma = scores[lag:].T @ scores[:-lag]
        middle += (1 - lag / (lags + 1)) * (gamma + gamma.T)
    return middle


def autoregression(pieces: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Stable vector autoregression of signals without a trend, pooled over pieces; its order has the least BIC.

    Every piece has shape (n_samples, n_outputs); returns the coefficients, shape (order, n_outputs, n_outputs), and the
    covariance of what drives them, shape (n_outputs, n_outputs).

    Source: L. Whittle's multivariate Yule-Walker equations, as in H. Lütkepohl, New Introduction to Multiple Time
    Series Analysis, 2005, ch. 3, 4.
    """
    n, ny = sum(map(len, pieces)), pieces[0].shape[1]
    most = max(0, min(int(10 * np.log10(n)), n // (10 * ny) - 1, max(map(len, pieces)) - 1))
    gamma = np.array([sum(p[lag:].T @ p[: max(0, len(p) - lag)] for p in pieces) / n for lag in range(most + 1)])
    best, found = np.inf, (np.zeros((0, ny, ny)), gamma[0])
    tiny = np.diag(1e-12 * np.diag(gamma[0]) + 1e-300)
    for order in range(most + 1):
        lags = np.subtract.outer(np.arange(order), np.arange(order)).T
        blocks = np.where((lags >= 0)[..., None, None], gamma[np.abs(lags)], gamma[np.abs(lags)].swapaxes(-1, -2))
        known = blocks.transpose(0, 2, 1, 3).reshape(order * ny, order * ny)
        wanted = gamma[1 : order + 1].transpose(1, 0, 2).reshape(ny, order * ny)
        rows = np.linalg.lstsq(known.T, wanted.T, rcond=1e-12)[0].T if order else wanted
        driving = gamma[0] - rows @ wanted.T
        sign, size = np.linalg.slogdet((driving + driving.T) / 2 + tiny)
        score = n * size + np.log(n) * order * ny**2
        if sign > 0 and score < best:
            best, found = score, (rows.reshape(ny, order, ny).swapaxes(0, 1), (driving + driving.T) / 2)
    return found


def middle_of_autoregression(jacobian: np.ndarray, coefficients: np.ndarray, driving: np.ndarray) -> np.ndarray:
    """Covariance of the gradient where residuals are such an autoregression, which the Jacobian does not depend on.

    The Jacobian has shape (n_samples, n_outputs, n), and the result (n, n). Sums over all pairs of samples are products
    of spectra.
    """
    n_samples, ny, n = jacobian.shape
    size = 1 << int(np.ceil(np.log2(2 * n_samples)))
    spectrum = np.fft.rfft(jacobian, size, axis=0)
    root = spectral_factor(coefficients, driving, size)
    seen = np.einsum("fyw,fyi->fwi", root.conj(), spectrum).reshape(-1, n)
    weight = np.full(len(spectrum), 2.0 / size)
    weight[[0, -1]] /= 2
    return np.real((seen.conj() * np.repeat(weight, ny)[:, None]).T @ seen)


def coloured(lags: int) -> str:
    """How a covariance with so many lags is called."""
    return f"covariance for coloured residuals (Newey-West, {lags} lags)"


def _lag_one(e: np.ndarray) -> float:
    e = e - e.mean()
    power = float(e @ e)
    return float(e[1:] @ e[:-1]) / power if power > 0 else 0.0


def undetermined(values: np.ndarray, std: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Which parameters have an interval wider than half their value (or than their scale, where they are about 0)."""
    size = np.maximum(np.abs(values), scale * (np.abs(values) < 0.02 * scale))
    return 1.96 * std > TOO_WIDE * size


def notes(
    names: Sequence[str],
    values: np.ndarray,
    std: np.ndarray,
    scale: np.ndarray,
    metadata: Sequence[SI],
    jacobian: np.ndarray,
    better: Mapping[str, str] | None = None,
) -> list[str]:
    """Sentences that name parameters which the data do not determine, cannot tell apart, or push to a bound.

    ``names`` to ``metadata`` have one entry per parameter, ``scale`` being a typical size; the Jacobian, shape (n,
    n_parameters), is that of the weighted errors; ``better`` says what to do about a parameter, by name.
    """
    said, known = [], better or {}
    norms = np.linalg.norm(jacobian, axis=0)
    tied = loose_directions(jacobian).any(axis=1) & (norms > 0)
    wide = undetermined(values, std, scale) & (norms > 0)
    for name, value, sd, poor, size, meta in zip(names, values, std, wide, scale, metadata, strict=True):
        if poor:
            said.append(
                f"the data do not determine {name}: {value:.4g} ± {1.96 * sd:.2g} {meta.unit} (95 %); expected "
                f"an interval below half the value: fix it, or {known.get(name, 'add a manoeuvre that moves it')}"
            )
        bounds = [b for b in (meta.lower, meta.upper) if np.isfinite(b)]
        if any(abs(value - b) < 1e-5 * size for b in bounds):
            said.append(
                f"{name} ends at its bound, {value:.4g} {meta.unit}; expected an interior optimum: check units, "
                "signs and the fixed parameters, or widen the range"
            )
    said += [f"the outputs do not depend on {n}; expected an influence: fix it" for n in np.array(names)[norms == 0]]
    if tied.any():
        group = ", ".join(np.array(names)[tied])
        said.append(
            f"{group} can hardly be told apart: the outputs show combinations of them alone (condition number "
            f"infinite); expected below {CONDITION:.0f}: fix one of them, or add a manoeuvre that separates them"
        )
    elif len(names) > 1 and (norms > 0).all():
        _, s, vt = np.linalg.svd(jacobian / norms, full_matrices=False)
        if s[0] > CONDITION * s[-1]:
            group = [n for n, v in zip(names, vt[-1], strict=True) if abs(v) > 0.3]
            said.append(
                f"{', '.join(group)} can hardly be told apart (condition number {s[0] / max(s[-1], 1e-300):.0f}); "
                f"expected below {CONDITION:.0f}: fix one of them, or add a manoeuvre that separates them"
            )
    return said
