"""Regression over the drives of a log: slopes, lags, and coefficients with an error of blocks that are left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy

_BLOCKS = 12  # of a log, each of one drive
_LONGEST_LAG = 0.6  # s, either way


def slope_of(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Slope of y over x, and their correlation."""
    x, y = x - x.mean(), y - y.mean()
    power = float(x @ x)
    if power <= 0 or not y.any():
        return 0.0, 0.0
    return float(x @ y) / power, float(x @ y / np.sqrt(power * (y @ y)))


def lag_of(pairs: Sequence[tuple[np.ndarray, np.ndarray]], dt: float) -> tuple[float, float]:
    """How long y comes after x over drives with a pair (x, y) each [s], and how far they agree then, 0 to 1."""
    most = round(_LONGEST_LAG / dt)
    total = np.zeros(2 * most + 1)
    for pair in pairs:
        x, y = (scipy.signal.detrend(v) for v in pair)
        full, middle = scipy.signal.correlate(y, x, mode="full"), len(x) - 1
        total += full[middle - most : middle + most + 1] / (np.linalg.norm(x) * np.linalg.norm(y) + 1e-300)
    best = int(np.argmax(total))
    return float((best - most) * dt), float(total[best]) / len(pairs)


def rate_of(x: np.ndarray, drives: np.ndarray) -> np.ndarray:
    """Change per sample of a signal inside drives."""
    return np.concatenate([np.gradient(part) for part in np.split(x, np.flatnonzero(np.diff(drives)) + 1)])


def by_blocks(table: np.ndarray, drives: np.ndarray) -> np.ndarray:
    """Products of the columns of a table, summed over blocks of the drives, shape (n_blocks, n, n)."""
    rows = np.split(table, np.flatnonzero(np.diff(drives)) + 1)
    blocks = [b for part in rows for b in np.array_split(part, max(1, _BLOCKS // len(rows)))]
    return np.array([b.T @ b for b in blocks])


def coefficient(squares: np.ndarray, which: int = 0) -> tuple[float, float]:
    """A coefficient of the last column's regression on the others, and its standard error, of a jackknife over blocks.

    The error is infinite of three blocks or fewer (R. G. Miller, The jackknife: a review, Biometrika 61, 1974).
    """
    size = sizes(squares)

    def of(total: np.ndarray) -> float:
        found = np.linalg.lstsq(total[:-1, :-1], total[:-1, -1], rcond=1e-9)[0]
        return float(found[which] * size[-1] / size[which])

    return jackknife(squares / np.outer(size, size), of)


def sizes(squares: np.ndarray) -> np.ndarray:
    """Norm of each column, shape (n,)."""
    return np.sqrt(np.maximum(np.diagonal(squares.sum(axis=0)), 1e-300))


def jackknife(squares: np.ndarray, of: Callable[[np.ndarray], float]) -> tuple[float, float]:
    """What ``of`` makes of the sum over blocks, and its standard error, by each block left out."""
    whole, n = squares.sum(axis=0), len(squares)
    others = np.array([of(whole - one) for one in squares])
    told = n > 3 and np.isfinite(others).all()
    return of(whole), float(np.sqrt((n - 1) / n * np.sum((others - others.mean()) ** 2))) if told else np.inf


def explained(squares: np.ndarray, by: int = -1) -> float:
    """Share of the last column's squares that the first ``by`` explain, by default all others."""
    whole = squares.sum(axis=0)
    found = np.linalg.lstsq(whole[:by, :by], whole[:by, -1], rcond=1e-12)[0]
    return float(found @ whole[:by, -1] / max(whole[-1, -1], 1e-300))


def about_means(x: np.ndarray, drives: np.ndarray) -> np.ndarray:
    """The signal about its mean in each drive."""
    count = np.maximum(np.bincount(drives), 1)
    return x - (np.bincount(drives, x) / count)[drives]
