"""What a log has that a fit has no parameter for, by what it leaves of the errors; the fit to the log without it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.identify.car.structures import Fitted, fit
from slipangle.identify.car.uncertainty import few

HOLD = "the intervals of C_f, C_r and inertia_z hold for either"
NO_HOLD = "no interval holds until what else is doubted is mended"
SURE = 3.92  # standard deviations from none at which there is some, as effects count whole there
_SEARCHES = 3  # refits, each from where the last one says


def searched(
    final: Fitted,
    free: tuple[str, ...],
    change: Callable[[Fitted, np.ndarray], np.ndarray],
    mended: Callable[[np.ndarray], Dataset],
    within: tuple[float, float],
    count: int = 1,
) -> tuple[np.ndarray, Fitted] | None:
    """How much there is, and the fit to the log without it; None if that is not sure, or its size not in range.

    Parameters
    ----------
    final : Fitted
        The fit without parameters for it.
    free : tuple of str
        Parameters that are free beside it.
    change, mended : callable
        What a unit of each changes the errors of a fit by, see `left_over`, and the log, from amounts of shape (k,).
    within : (float, float)
        Range of the largest amount.
    count : int
        How many amounts, k.
    """
    found, amounts = final, np.zeros(count)
    for _ in range(_SEARCHES):
        more, std = left_over(found, change(found, amounts))
        amounts = amounts + more
        size = float(np.abs(amounts).max())
        if not ((np.abs(amounts) > SURE * std).any() and within[0] < size < within[1]):
            return None
        found = fit(final.model, free, mended(amounts), final, own=final.own)
        if (np.abs(more) < std).all():
            break
    return amounts, found


def left_over(fitted: Fitted, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How much of k things not fitted the errors hold, as all that was fitted is free to move with them; their errors.

    ``change``, shape (n, n_outputs, k), is what a unit of each changes errors by: to first order, from where the fit
    ended. Both results have shape (k,); the errors are standard ones, of a jackknife over stretches.
    """
    table = np.concatenate([fitted.jacobian, change, fitted.error[:, :, None]], axis=2)
    count, k = len(np.unique(fitted.stretch)), change.shape[2]
    pull = np.zeros((fitted.pull.shape[1] + k + 1,) * 2)
    pull[: -k - 1, : -k - 1] = fitted.pull.T @ fitted.pull
    each = np.array([np.einsum("iaj,iak->jk", t, t) for t in (table[fitted.stretch == s] for s in range(count))])

    def of(squares: np.ndarray) -> np.ndarray:
        size = np.sqrt(np.maximum(np.diag(squares), 1e-300))
        even = squares / np.outer(size, size)
        found = np.linalg.lstsq(even[:-1, :-1], even[:-1, -1], rcond=1e-12)[0]
        return -(found * size[-1] / size[:-1])[-k:]

    whole = each.sum(axis=0) + pull
    others = np.array([of(whole - one) for one in each])
    spread = np.sum((others - others.mean(axis=0)) ** 2, axis=0)
    return of(whole), few(count) * np.sqrt((count - 1) / count * spread)
