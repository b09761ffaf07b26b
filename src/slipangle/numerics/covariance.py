"""Covariance of least-squares estimates, and sentences about parameters that the data do not determine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from slipangle.units import SI

TOO_WIDE = 0.5  # half of a 95 % interval over the value, above which a parameter counts as not determined
CONDITION = 300.0  # of the Jacobian with columns of one length, above which parameters cannot be told apart


def covariance(error: np.ndarray, jacobian: np.ndarray, n_outputs: int) -> tuple[np.ndarray, str]:
    """Covariance of the unknowns, allowing for coloured residuals when they are; and a few words on how.

    Residuals, shape (n_rows * n_outputs,), are of about the same size for every output; the Jacobian has their
    derivatives, shape (n_rows * n_outputs, n).
    """
    dof = max(1, len(error) - jacobian.shape[1])
    lengths = np.linalg.norm(jacobian, axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0)
    even = jacobian / lengths
    inverse = np.linalg.pinv(even.T @ even, rcond=1e-14, hermitian=True) / np.outer(lengths, lengths)
    middle, lags = middle_of_sandwich(error, jacobian, n_outputs)
    if not lags:
        return inverse * float(error @ error) / dof, "covariance for white residuals"
    return inverse @ middle @ inverse * len(error) / dof, coloured(lags)


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
    middle = scores.T @ scores
    rho = float(np.clip(max(abs(_lag_one(column)) for column in residuals.T), 0, 0.999))
    if rho < 3.3 / np.sqrt(len(residuals)):
        return middle, 0
    alpha = 4 * rho**2 / (1 - rho**2) ** 2
    lags = int(min(1.1447 * (alpha * len(scores)) ** (1 / 3), len(scores) // 4)) + 1
    for lag in range(1, lags + 1):
        gamma = scores[lag:].T @ scores[:-lag]
        middle += (1 - lag / (lags + 1)) * (gamma + gamma.T)
    return middle, lags


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
    wide = undetermined(values, std, scale)
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
    norms = np.linalg.norm(jacobian, axis=0)
    if (norms == 0).any():
        for name in np.array(names)[norms == 0]:
            said.append(f"the outputs do not depend on {name}; expected an influence: fix it")
    elif len(names) > 1:
        _, s, vt = np.linalg.svd(jacobian / norms, full_matrices=False)
        if s[0] > CONDITION * s[-1]:
            group = [n for n, v in zip(names, vt[-1], strict=True) if abs(v) > 0.3]
            said.append(
                f"{', '.join(group)} can hardly be told apart (condition number {s[0] / max(s[-1], 1e-300):.0f}); "
                f"expected below {CONDITION:.0f}: fix one of them, or add a manoeuvre that separates them"
            )
    return said
