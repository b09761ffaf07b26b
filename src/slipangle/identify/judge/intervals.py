"""Predictive intervals of free runs, calibrated on stretches that the models were not fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError, TooShortError
from slipangle.identify.judge.compare import Estimator
from slipangle.models.model import Model, Trajectory


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """How wide an interval must be, from errors on held-out stretches.

    The width at a sample is the quantile of ``|error| / scale`` times ``scale``, and the scale is
    ``sqrt(floor^2 + spread^2 + (share |y|)^2)``: where members disagree or the output is large, errors are.

    References
    ----------
    .. [1] V. Vovk, A. Gammerman, G. Shafer, Algorithmic Learning in a Random World, 2005: split conformal prediction.
    """

    scores: np.ndarray  # (n, n_outputs), ``|error| / scale`` of every held-out sample, each column sorted
    floor: np.ndarray  # (n_outputs,), part of the scale that is always there, in the outputs' units
    share: float  # part of the scale that grows with the predicted output

    def width(self, level: float) -> np.ndarray:
        """Half width per scale at a coverage level, shape (n_outputs,).

        Raises ParameterError if the level is not between 0 and 1.
        """
        if not 0 < level < 1:
            raise ParameterError(f"the level is {level}; expected a coverage between 0 and 1, such as 0.9")
        n = len(self.scores)
        return self.scores[min(n - 1, int(np.ceil(level * (n + 1))) - 1)]

    def scale(self, run: Trajectory, spread: np.ndarray) -> np.ndarray:
        """Expected size of the error at every sample, shape (n_samples, n_outputs)."""
        return np.sqrt(self.floor**2 + spread**2 + (self.share * run.y) ** 2)

    def interval(self, model: Model, data: Dataset, level: float = 0.9) -> Interval:
        """Free run with its interval; only the first `memory` samples of the outputs are looked at."""
        run = model.simulate(data)
        half = self.width(level) * self.scale(run, model.spread(data))
        return Interval(run=run, lower=run.y - half, upper=run.y + half, level=level)


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A free run and where the measurement is expected."""

    run: Trajectory
    lower: np.ndarray  # (n_samples, n_outputs), ends of the interval, in the outputs' units
    upper: np.ndarray  # (n_samples, n_outputs), ends of the interval, in the outputs' units
    level: float  # coverage it was made for

    @property
    def coverage(self) -> np.ndarray:
        """Share of the predicted samples whose measurement lies inside, per output."""
        return self.hits.mean(axis=0)

    @property
    def hits(self) -> np.ndarray:
        """Whether each predicted sample's measurement lies inside, shape (n_predicted, n_outputs)."""
        inside = (self.run.measured >= self.lower) & (self.run.measured <= self.upper)
        return inside[self.run.predicted]

    @property
    def effective_samples(self) -> np.ndarray:
        """As how many independent samples the hits tell the coverage, per output; see `effective_samples`."""
        return np.array([effective_samples(column) for column in self.hits.T])


def effective_samples(values: np.ndarray) -> float:
    """Number of independent samples whose mean scatters as the mean of these, which follow each other in time.

    ``n / (1 + 2 sum rho_k)``, the sum over the autocorrelations of lags 1, 2, ... in pairs, none larger than the one
    before, up to the first that is not positive ([1]_, initial monotone sequence).

    It is from 1 to n, and n where all of the values, in the order of time, are the same.

    References
    ----------
    .. [1] C. J. Geyer, Practical Markov chain Monte Carlo, Statistical Science 7, 1992, sec. 3.3.

    >>> effective_samples(np.arange(1000) % 20 < 10) < 200 < effective_samples(np.arange(1000) % 2)
    True
    """
    x = np.asarray(values, dtype=float)
    n, x = len(x), x - np.mean(x)
    power = np.abs(np.fft.rfft(x, 2 * n)) ** 2
    covariance = np.fft.irfft(power)[:n] / n
    if n < 2 or not covariance[0] > 0:
        return float(n)
    pairs = covariance[: n - n % 2].reshape(-1, 2).sum(axis=1) / covariance[0]
    last = int(np.argmax(pairs <= 1e-12)) if np.any(pairs <= 1e-12) else len(pairs)
    total = np.minimum.accumulate(pairs[:last]).sum()
    return float(np.clip(n / max(2.0 * total - 1.0, 1.0), 1.0, n))


def coverage_error(level: float, tested: float, calibrated: float) -> float:
    """Standard error of the coverage of an interval, from independent samples tested and calibrated on.

    Both the coverage of new data and the quantile that sets the width scatter binomially.
    """
    return float(np.sqrt(level * (1.0 - level) * (1.0 / tested + 1.0 / calibrated)))


def calibrate(pairs: Sequence[tuple[Model, Dataset]], *, share: float = 0.05) -> Calibration:
    """Pool the free-run errors of models on data that each was not fitted to.

    The pairs are such as the folds of `rolling_holdout`; ``share`` is the part of the scale that grows with the
    predicted output.

    Raises ParameterError if there is no pair, and TooShortError if fewer than 20 samples are predicted.
    """
    if not pairs:
        raise ParameterError("no model and data were given; expected at least one pair to calibrate on")
    runs = [(model.simulate(data), model.spread(data)) for model, data in pairs]
    errors = np.concatenate([run.error[run.predicted] for run, _ in runs])
    if len(errors) < 20:
        raise TooShortError(f"{len(errors)} samples are predicted; expected at least 20 to calibrate on: hold out more")
    draft = Calibration(scores=np.zeros((1, errors.shape[1])), floor=0.5 * np.std(errors, axis=0), share=share)
    scores = np.concatenate([np.abs(run.error / draft.scale(run, s))[run.predicted] for run, s in runs])
    return replace(draft, scores=np.sort(scores, axis=0))


def rolling_holdout(estimator: Estimator, data: Dataset, shares: Sequence[float] = (0.6, 0.8, 1.0)) -> list:
    """Models fitted to the beginning of the data, each with the stretch that follows: pairs for `calibrate`.

    Raises ParameterError if the shares do not rise from above 0 to at most 1.

    A model is fitted to the data up to each share but the last and paired with the data up to the next.
    """
    return [(estimator.fit(early), next_) for early, next_ in stretches(data, shares)]


def stretches(data: Dataset, shares: Sequence[float]) -> list[tuple[Dataset, Dataset]]:
    """The data up to each share but the last, and what follows up to the next."""
    rising = all(b > a for a, b in pairwise(shares))
    if len(shares) < 2 or not rising or shares[0] <= 0 or shares[-1] > 1:
        raise ParameterError(
            f"the shares are {tuple(shares)}; expected at least two, rising, from above 0 to at most 1"
        )
    rows = [round(share * data.n_samples) for share in shares]
    return [(data.rows(0, a), data.rows(a, b)) for a, b in pairwise(rows)]
