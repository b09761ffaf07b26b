"""`impulse_response`: what a log itself says of the response over time, regularised, with bands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import linalg, optimize

from slipangle.data.dataset import Dataset
from slipangle.errors import ExcitationError, ParameterError, TooShortError
from slipangle.models.analysis.frequency import chosen, per
from slipangle.models.analysis.responses import TimeResponse

Kernel = Literal["TC", "DC"]
_MOST = 400  # taps
_DECAY = np.array([0.7, 0.85, 0.93, 0.97, 0.99])  # of the kernel over one sample, where the search starts


def impulse_response(
    data: Dataset,
    output: str | None = None,
    input: str | None = None,
    *,
    duration: float = 2.0,
    kernel: Kernel = "TC",
    name: str = "",
) -> TimeResponse:
    """Impulse response from an input to an output of a log, regularised by a kernel that the data choose.

    A finite impulse response of ``duration`` by least squares is unbiased and rough. Here its taps have a Gaussian
    prior, smooth and decaying: ``E[g_i g_j] = c lambda^max(i, j)`` ("TC") or ``c lambda^((i + j) / 2) rho^|i - j|``
    ("DC"), whose hyperparameters and noise maximise the likelihood of the data (empirical Bayes). The estimate is the
    posterior mean, its band the posterior's standard deviation with the hyperparameters taken as known. Means of every
    experiment are taken away first, and the first ``duration`` of each only serves as past.

    Raises ParameterError if a channel or the duration is none, TooShortError if no experiment is longer than twice the
    duration, and ExcitationError if the input does not move.

    Parameters
    ----------
    data : Dataset
        The log; inputs are taken as held over a sample.
    output, input : str, optional
        Channels; by default the first output and the first input.
    duration : float
        Length of the response; at most 400 samples, so resample a fast log. [s]
    kernel : {"TC", "DC"}
        Tuned and correlated, or with a correlation of its own.
    name : str, optional
        For figures; by default the log's.

    Returns
    -------
    TimeResponse
        Response to an impulse of area 1 over the past samples from 0; the direct part is the first tap.

    For example ``sa.impulse_response(data, "r", "delta").plot(sa.linearize(model, v_x=20.0).impulse("r", "delta"))``.

    References
    ----------
    .. [1] T. Chen, H. Ohlsson, L. Ljung, Automatica 48(8), 2012, sec. 4 and 5.
    .. [2] G. Pillonetto, G. De Nicolao, Automatica 46(1), 2010.
    """
    y_name, u_name = chosen(data, output, "output"), chosen(data, input, "input")
    n = round(duration / data.dt) + 1 if np.isfinite(duration) else 0
    if kernel not in ("TC", "DC"):
        raise ParameterError(f"kernel is {kernel!r}; expected 'TC' or 'DC'")
    if not 3 <= n <= _MOST:
        raise ParameterError(
            f"duration is {duration:g} s, {n} samples of {data.dt:g} s; expected 3 to {_MOST}: resample the log"
        )
    parts = [part for part in data.experiments if len(part) >= 2 * n]
    if not parts:
        raise TooShortError(
            f"'{data.name}' has no experiment of {2 * duration:g} s; expected one: shorten the duration"
        )
    u, y = ([part[c] - part[c].mean() for part in parts] for c in (u_name, y_name))
    if all(np.ptp(v) == 0 for v in u):
        raise ExcitationError(f"'{u_name}' does not move in '{data.name}'; expected an input that excites the car")
    rows = np.concatenate([np.lib.stride_tricks.sliding_window_view(v, n)[:, ::-1] for v in u])
    seen = np.concatenate([v[n - 1 :] for v in y])
    found = _posterior(rows, seen, kernel)
    return TimeResponse(
        t=data.dt * np.arange(n),
        y=found.mean / data.dt,
        std=found.std / data.dt,
        output=y_name,
        input=u_name,
        kind="impulse",
        unit=_rate(per(data.unit(y_name), data.unit(u_name))),
        name=name or data.name,
        final=0.0,
    )


def _rate(unit: str) -> str:
    return "1/s" if unit == "-" else f"({unit})/s"


@dataclass(frozen=True)
class _Posterior:
    mean: np.ndarray
    std: np.ndarray
    decay: float
    noise: float


class _Evidence:
    """Minus twice the log likelihood of the data, from products of n taps only. [1]_ sec. 5"""

    def __init__(self, rows: np.ndarray, seen: np.ndarray, kernel: Kernel) -> None:
        self.n, self.count, self.kernel = rows.shape[1], len(seen), kernel
        self.gram, self.cross, self.power = rows.T @ rows, rows.T @ seen, float(seen @ seen)

    def prior(self, theta: np.ndarray) -> np.ndarray:
        """Covariance of the taps over ``c``; theta holds the logit of lambda, then that of rho."""
        i = np.arange(self.n, dtype=float)
        decay = 1 / (1 + np.exp(-theta[0]))
        if self.kernel == "TC":
            return decay ** np.maximum(i[:, None], i)
        rho = np.tanh(theta[1])
        return decay ** ((i[:, None] + i) / 2) * rho ** np.abs(i[:, None] - i)

    def root(self, theta: np.ndarray) -> np.ndarray:
        P = self.prior(theta)
        return linalg.cholesky(P + 1e-10 * np.eye(self.n) * P[0, 0], lower=True)

    def __call__(self, theta: np.ndarray) -> float:
        """At c and lambda (and rho), the noise being at its best: theta holds log(c / noise) last."""
        try:
            L, ratio = self.root(theta[:-1]), np.exp(theta[-1])
            M = np.eye(self.n) + ratio * L.T @ self.gram @ L
            R = linalg.cholesky(M, lower=True)
        except (linalg.LinAlgError, ValueError):
            return 1e30
        z = linalg.solve_triangular(R, L.T @ self.cross, lower=True)
        left = max(self.power - ratio * float(z @ z), 1e-14 * self.power)
        return float(self.count * np.log(left / self.count) + 2 * np.log(np.diag(R)).sum())


def _posterior(rows: np.ndarray, seen: np.ndarray, kernel: Kernel) -> _Posterior:
    problem = _Evidence(rows, seen, kernel)
    scale = problem.power / max(float(np.trace(problem.gram)) / problem.n, 1e-300)
    usual = np.log(10.0 * max(scale, 1e-300) * problem.count / max(problem.power, 1e-300))
    starts = []
    for decay in _DECAY:
        for shift in (-3.0, 0.0, 3.0):
            rest = [] if kernel == "TC" else [np.arctanh(np.sqrt(decay))]
            starts.append(np.array([np.log(decay / (1 - decay)), *rest, usual + shift]))
    best = min(starts, key=problem)
    found = optimize.minimize(
        problem, best, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-6, "maxiter": 400}
    )
    theta = found.x if found.fun <= problem(best) else best
    L, ratio = problem.root(theta[:-1]), np.exp(theta[-1])
    R = linalg.cholesky(np.eye(problem.n) + ratio * L.T @ problem.gram @ L, lower=True)
    half = linalg.solve_triangular(R, L.T, lower=True)
    z = half @ problem.cross
    mean = ratio * half.T @ z
    noise = max(problem.power - ratio * float(z @ z), 1e-14 * problem.power) / problem.count
    std = np.sqrt(noise * ratio * np.sum(half**2, axis=0))
    return _Posterior(mean, std, float(1 / (1 + np.exp(-theta[0]))), noise)
