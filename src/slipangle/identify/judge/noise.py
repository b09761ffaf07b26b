"""How much of an output is noise, which no model explains: from the part of its spectrum that no input made."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from slipangle.data.dataset import Dataset

_SHORTEST, _LONGEST = 32, 512  # samples of a stretch
_STRETCHES = 8  # for each input and one, at least, where the record allows it
_WIDE, _NARROW = 4, 20  # bands that the level is sought in, bands that it is added up over
_CLEAN = 0.6  # of the highest frequency: what is above, an anti-alias filter may have taken out

_LOW = 1.03  # standard errors by which the least of four equal levels is below them, on average
_SPARE = 0.8 * _CLEAN / _WIDE  # degrees of freedom of one band for each sample; neighbours share some under the window


def noise_floor(data: Dataset, output: str) -> float:
    """Standard deviation of the noise in one output, as if it were white, in its unit.

    Spectra of Hann-windowed stretches, half overlapping; in each frequency what is linear in the inputs' spectra is
    taken out [1]_, and the level of the rest is that of the quietest of four bands [2]_, up to 0.6 of the highest
    frequency, corrected for being the least. What lies below it elsewhere, as behind an anti-alias filter, counts as it
    is. So neither the inputs, nor slow dynamics or disturbances, nor distortions in some bands count as noise: the
    floor is at least this where the noise is coloured. It is too high where a nonlinearity is driven evenly up to 0.6
    of the highest frequency.

    NaN if there are not enough samples to tell.

    References
    ----------
    .. [1] J. S. Bendat, A. G. Piersol, Random Data, 4th ed., 2010, sec. 7.3 (conditioned spectra).
    .. [2] R. Martin, Noise power spectral density estimation based on optimal smoothing and minimum statistics, IEEE
       Trans. Speech and Audio Processing 9(5), 2001.
    """
    moving = [n for n in data.inputs if np.ptp(data[n]) > 0]
    length = _LONGEST
    while length > _SHORTEST and (
        length > data.n_longest or 2 * data.n_samples // length - 1 < _STRETCHES * (len(moving) + 1)
    ):
        length //= 2
    names = (output, *moving)
    stretches = [
        sliding_window_view(data[name][a:b], length)[:: length // 2]
        for name in names
        for a, b in zip(data.starts, data.stops, strict=True)
        if b - a >= length
    ]
    per = len(stretches) // len(names)
    spectra = [_spectra(np.concatenate(stretches[i * per : (i + 1) * per])) for i in range(len(names))] if per else []
    spare = len(spectra[0]) - len(moving) if spectra else 0
    if spare < 2:
        return float("nan")
    left = _unexplained(spectra[0], np.array(spectra[1:])) / spare
    edges = (np.linspace(0, _CLEAN, _WIDE + 1) * left.size).round().astype(int)
    level = min(float(left[a:b].mean()) for a, b in pairwise(edges.tolist()))
    narrow = np.array_split(left, min(_NARROW, left.size // 2))
    found = np.sqrt(sum(min(float(part.mean()), level) * part.size for part in narrow) / left.size)
    return float(found / (1 - _LOW * uncertainty(len(spectra[0]) * length // 2)))


def uncertainty(n_samples: int) -> float:
    """Relative standard error of `noise_floor`: that of a level in a quarter of 0.6 of the band, windowed. [-]

    >>> round(uncertainty(200), 2), round(uncertainty(5000), 2)
    (0.1, 0.02)
    """
    return float(0.5 / np.sqrt(_SPARE * n_samples))


def _spectra(stretches: np.ndarray) -> np.ndarray:
    """Fourier transforms whose mean square is the variance of white noise; shape (n_stretches, n_frequencies)."""
    length = stretches.shape[1]
    window = np.hanning(length + 1)[:-1]
    window /= np.sqrt(np.sum(window**2))
    moved = stretches - stretches.mean(axis=1, keepdims=True)
    return np.fft.rfft(window * moved, axis=1)[:, 3 : length // 2]  # without what the mean and its neighbours leak into


def _unexplained(y: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Sum of squares of ``y`` over the stretches that no combination of the ``u`` makes, shape (n_frequencies,)."""
    columns = np.moveaxis(u, 0, -1).transpose(1, 0, 2) if len(u) else np.zeros((y.shape[1], len(y), 0))
    left = y.T.copy()
    basis: list[np.ndarray] = []
    for i in range(columns.shape[2]):  # Gram-Schmidt, an input at a time, all frequencies at once
        own = columns[:, :, i].copy()
        before = np.sum(np.abs(own) ** 2, axis=1)
        for q in (*basis, *basis):  # twice is enough
            own -= q * np.sum(np.conj(q) * own, axis=1)[:, None]
        power = np.sum(np.abs(own) ** 2, axis=1)
        told = power > 1e-12 * before
        q = np.where(told[:, None], own / np.sqrt(np.where(told, power, 1.0))[:, None], 0.0)
        basis.append(q)
        left -= q * np.sum(np.conj(q) * left, axis=1)[:, None]
    return np.sum(np.abs(left) ** 2, axis=1)
