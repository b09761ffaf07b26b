"""Noise and steps of a logged input, taken out by what its neighbourhood says, forwards and backwards alike."""

from __future__ import annotations

import numpy as np
import scipy

from slipangle.data.dataset import Dataset

_LONGEST = 1.0  # s, of a window
_ALIKE, _STEPPED = 0.05, 0.1  # s on either side over which noise may be the same, and over which steps are
_MEANS = 2  # samples on either side that share noise behind a mean over two of them
_FINER = 1.2  # one window over the next shorter one
_BETTER = 0.9  # mean squared error of a longer window over the shortest one's, at most
_STAYS = 0.5  # share of the samples that are those before, from which a signal moves in steps


def smoothed(data: Dataset, channel: str) -> Dataset:
    """Data with a channel free of most of its noise and of its steps; the very same data where it has neither.

    Parabolas through windows of one length [1]_, the length that best predicts samples of which the nearest ones are
    left out: more of them where a channel stays and steps, as one of whole km/h does. The channel stays as it is where
    the shortest windows are best. Not for what a model is judged by.

    References
    ----------
    .. [1] A. Savitzky, M. J. E. Golay, "Smoothing and differentiation of data by simplified least squares procedures",
       Analytical Chemistry 36(8), 1964, 1627-1639.
    """
    parts = [part[channel] for part in data.experiments]
    steps = np.concatenate([np.diff(x) for x in parts])
    alike = _STEPPED if len(steps) and np.mean(steps == 0) > _STAYS else _ALIKE
    window = _window(parts, max(_MEANS, round(alike / data.dt)), round(_LONGEST / data.dt))
    if not window:
        return data
    found = [np.asarray(scipy.signal.savgol_filter(x, window, 2)) if len(x) >= window else x for x in parts]
    return data.with_channel(channel, np.concatenate(found), data.unit(channel))


def _window(parts: list[np.ndarray], near: int, longest: int) -> int:
    """Samples of the window that predicts best, at most a quarter of the longest part; 0 where the shortest does."""
    longest, windows = min(longest, max(len(x) for x in parts) // 4), [2 * near + 5]
    while (wider := int(np.ceil(_FINER * windows[-1])) // 2 * 2 + 1) <= longest:
        windows.append(wider)
    if len(windows) == 1:
        return 0
    error = np.array([_error(parts, n, near) for n in windows])
    return windows[int(np.argmin(error))] if error.min() < _BETTER * error[0] else 0


def _error(parts: list[np.ndarray], n: int, near: int) -> float:
    """Mean squared error of samples as a parabola through the farther ones of their window of ``n`` predicts them."""
    at = np.arange(n) - n // 2
    away = np.abs(at) > near
    weights = np.zeros(n)
    weights[away] = np.linalg.pinv(np.vander(at[away], 3, increasing=True))[0]
    errors = [np.convolve(x, weights[::-1], "valid") - x[n // 2 : len(x) - n // 2] for x in parts if len(x) >= n]
    rounding = 1e-9 * max(float(np.abs(x).max()) for x in parts)
    return float(np.mean(np.concatenate(errors) ** 2)) + rounding**2
