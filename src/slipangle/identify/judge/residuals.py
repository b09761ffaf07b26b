"""Residual tests: whether one-step-ahead errors are white, and free-run errors do not depend on the inputs."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from scipy import integrate, optimize, special

from slipangle.data.dataset import Dataset
from slipangle.models.model import Trajectory

_BLIND = 0.5  # correlations that a test which lets as much pass for chance does not see


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """Residual tests of one output."""

    sentences: tuple[str, ...]  # what follows, for a reader
    lags: np.ndarray  # (n_lags,), lags of the cross-correlations, in samples; `autocorrelation` uses those from 0 on
    autocorrelation: np.ndarray  # (max_lag + 1,), of the one-step-ahead residual, 1 at lag 0
    cross: np.ndarray  # (n_inputs, n_lags), correlation of the free-run residual at k + lag with each input at k
    band: float  # half width of the 99 % band of white residuals
    # (n_inputs,), half width of the band that inputs which do not correlate leave at no lag from 0 on, of no input and
    # output, in 99 % of cases, given both signals' colour
    cross_band: np.ndarray
    white_p: float  # p value of the Ljung-Box test that the one-step-ahead residual is white


def residual_tests(
    free: Trajectory,
    one: Trajectory,
    data: Dataset,
    output: str,
    max_lag: int = 40,
    trained: int | None = None,
) -> Residuals:
    """Whiteness of the one-step-ahead residual, correlation of the free-run residual with the inputs.

    The band of the autocorrelation is pointwise; that of the cross-correlations is simultaneous (see
    `simultaneous_width`), so that a true model is said to lack dynamics in 1 % of cases, however many lags, inputs and
    outputs are looked at. Its standard error is Bartlett's, which allows for the colour of both signals.

    Estimates from ``trained`` samples are off by as much as noise correlates with the inputs there, so that a true
    model's free-run error may leave the band of the noise by more, the shorter the training data. Sentences allow for
    that: the variance of a correlation over ``n`` samples then is up to ``1 + n / trained`` times that of noise alone,
    for inputs of like spectra. With None, parameters are taken as exact.

    An error and an input that move at the same few frequencies correlate by chance almost fully; where the band is
    wider than 0.5, the sentence says that nothing was tested.

    Source: L. Ljung, System Identification, 2nd ed., 1999, sec. 16.6.
    """
    i = one.outputs.index(output)
    residuals = _pieces(one.error[:, i], one)
    n = sum(map(len, residuals))
    max_lag = max(1, min(max_lag, n // 4))
    auto = _correlation(residuals, residuals, max_lag)[max_lag:]
    q = n * (n + 2) * np.sum(auto[1:] ** 2 / (n - np.arange(1, max_lag + 1)))
    p = float(scipy.stats.chi2.sf(q, max_lag))
    band = float(scipy.stats.norm.ppf(0.995)) / np.sqrt(n)
    level = 0.01 / max(1, len(data.inputs) * len(one.outputs))

    errors = _pieces(free.error[:, i], free)
    count = sum(map(len, errors))
    cross, cross_band = [], []
    for name in data.inputs:
        u = _pieces(data[name], free)
        low, high = min(p.min() for p in u), max(p.max() for p in u)
        if high - low < 1e-12 * max(1.0, -low, high):
            cross.append(np.zeros(2 * max_lag + 1))
            cross_band.append(simultaneous_width(max_lag + 1, 0.0, level) / np.sqrt(count))
            continue
        long = max(1, min(count // 4, 10 * max_lag))
        rho_e, rho_u = _correlation(errors, errors, long), _correlation(u, u, long)
        spread = max(1.0, float(np.sum(rho_e * rho_u)))
        neighbours = float(np.sum(rho_e[1:] * rho_u[:-1])) / spread
        cross.append(_correlation(errors, u, max_lag))
        cross_band.append(simultaneous_width(max_lag + 1, neighbours, level) * np.sqrt(spread / count))
    return Residuals(
        lags=np.arange(-max_lag, max_lag + 1),
        autocorrelation=auto,
        cross=np.array(cross).reshape(len(cross), 2 * max_lag + 1),
        band=band,
        cross_band=np.array(cross_band),
        white_p=p,
        sentences=_residual_sentences(auto, band, p, cross, cross_band, data, (count, trained)),
    )


def _residual_sentences(
    auto: np.ndarray,
    band: float,
    p: float,
    cross: list,
    cross_band: list,
    data: Dataset,
    samples: tuple[int, int | None],  # that were predicted, and that the model was fitted to
) -> tuple[str, ...]:
    outside = int(np.sum(np.abs(auto[1:]) > band))
    said = [
        f"the one-step-ahead residual is {'white' if p > 0.01 else 'not white'} (Ljung-Box p = {p:.2g}, {outside} of "
        f"{len(auto) - 1} lags outside the 99 % band)"
    ]
    for name, values, width in zip(data.inputs, cross, cross_band, strict=True):
        half = len(values) // 2
        past = np.abs(values[half:])  # residual after the input
        lag, (count, trained) = int(np.argmax(past)), samples
        seen = f"(correlation {values[half + lag]:+.2f} at {lag * data.dt:.2f} s)"
        if past.max() > width:
            if trained and past.max() <= width * np.sqrt(1 + count / trained):
                said.append(
                    f"the free-run error depends on {name} {seen} by no more than estimates from {trained} samples may "
                    "be wrong: train on more of them to see whether dynamics are missing"
                )
                continue
            said.append(
                f"the free-run error still depends on {name} {seen}: dynamics are missing or an input delay is not "
                "modelled"
            )
        elif width > _BLIND:
            said.append(
                f"whether the free-run error depends on {name} these data do not tell {seen}: in so short a record, or "
                f"of an input of so few frequencies, up to {min(width, 1.0):.2f} is chance"
            )
        else:
            said.append(f"the free-run error does not depend on {name}")
    return tuple(said)


def simultaneous_width(count: int, neighbours: float, level: float) -> float:
    """Half width, in standard deviations, that the largest of several normal variables exceeds at the given rate.

    The ``count`` variables have unit variance, neighbours the given correlation. The rate is bounded by that of any one
    variable, less that of neighbours exceeding it together [1]_: the slower the signals, the narrower.

    >>> round(simultaneous_width(1, 0.0, 0.01), 2), round(simultaneous_width(41, 0.0, 0.01), 2)
    (2.58, 3.67)

    References
    ----------
    .. [1] K. J. Worsley, An improved Bonferroni inequality and applications, Biometrika 69, 1982.
    """
    rho = float(np.clip(neighbours, -0.9999, 0.9999))
    root, ahead = np.sqrt(1 - rho**2), np.linspace(0.0, 8.0, 801)

    def excess(z: float) -> float:
        x = z + ahead
        both = special.ndtr((rho * x - z) / root) + special.ndtr((-rho * x - z) / root)
        together = 2 * integrate.trapezoid(np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi) * both, x)
        return float(count * 2 * special.ndtr(-z) - (count - 1) * together - level)

    return float(optimize.root_scalar(excess, bracket=(0.0, 12.0)).root)


def _pieces(values: np.ndarray, run: Trajectory) -> list[np.ndarray]:
    """The predicted samples of one column, experiment by experiment."""
    edges = (*run.starts, len(values))
    return [values[a:b][run.predicted[a:b]] for a, b in pairwise(edges) if run.predicted[a:b].any()]


def _correlation(first: list[np.ndarray], second: list[np.ndarray], max_lag: int) -> np.ndarray:
    """Correlation of a(k + lag) with b(k) for lag = -max_lag .. max_lag, both samples in the same experiment."""
    means = [np.concatenate(parts).mean() for parts in (first, second)]
    lags, powers = np.zeros(2 * max_lag + 1), np.zeros(2)
    for a, b in zip(first, second, strict=True):
        a, b = a - means[0], b - means[1]
        size = 1 << int(np.ceil(np.log2(len(a) + max_lag + 1)))
        raw = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        lags += np.concatenate([raw[-max_lag:], raw[: max_lag + 1]])
        powers += a @ a, b @ b
    scale = np.sqrt(powers[0] * powers[1])
    return lags / scale if scale > 0 else np.zeros_like(lags)
