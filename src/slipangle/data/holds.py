"""What is held for a sample in place of an input that goes on moving, and the moving input from what is held."""

from __future__ import annotations

import numpy as np
import scipy


def held(x: np.ndarray) -> np.ndarray:
    """What a moving input does, to hold over each sample until the next, shape (n - 1,) of samples (n,).

    The mean of both ends of a sample h is not late as its first end is. With the hold it smooths a motion of angular
    frequency w by sin(w h) / (w h), which looks like less lag and more delay. So x is sharpened by as much to sixth
    order in w h, x + D x / 6 + D^2 x / 30 of D x[k] = -x[k - 1] + 2 x[k] - x[k + 1]. What answers at once, as a lag T
    by itself, seems later by h^2 / (12 T) still. No sharpening leaves an end at which an input rests, as a pedal that
    is not pressed.
    """
    curved = _curved(x)
    sharp = np.clip(x + curved / 6 + _curved(curved) / 30, *_rests(x))
    return 0.5 * (sharp[:-1] + sharp[1:])


def moving(values: np.ndarray) -> np.ndarray:
    """The samples (n,) of an input of which ``values`` (n - 1,) are what is `held`, but for what rests at an end.

    A share that turns its sign at each sample means do not know; there is as much as makes the input smoothest.
    """
    n = len(values) + 1
    sign = (-1.0) ** np.arange(n)
    sharp = sign * np.append(np.cumsum(2 * (sign[:-1] * values)[::-1])[::-1], 0.0)
    if n < 3:  # nothing is curved
        return sharp
    sharp -= sign * (np.mean(np.diff(sharp, 2) * sign[:-2]) / 4)
    rows = np.where((np.arange(n) > 0) & (np.arange(n) < n - 1), 1.0, 0.0)
    curved = scipy.sparse.diags_array([-rows[1:], 2 * rows, -rows[:-1]], offsets=[-1, 0, 1])
    sharpens = scipy.sparse.eye_array(n) + curved / 6 + curved @ curved / 30
    return np.asarray(scipy.sparse.linalg.spsolve(sharpens.tocsc(), sharp))


def _curved(x: np.ndarray) -> np.ndarray:
    """By how much each sample is above the mean of its neighbours, twice; the ends go on straight, shape (n,)."""
    return np.pad(-np.diff(x, 2), 1) if len(x) > 2 else np.zeros(len(x))


def _rests(x: np.ndarray) -> tuple[float, float]:
    """The ends of its range at which an input stays for a sample or longer, infinite where it does not."""
    low, high = np.min(x, initial=np.inf), np.max(x, initial=-np.inf)
    stays = [bool(np.any((x[1:] == end) & (x[:-1] == end))) for end in (low, high)]
    return low if stays[0] else -np.inf, high if stays[1] else np.inf
