"""Where a model stands between simple models fitted with it and the noise; the words of a verdict follow from that.

A fit percentage says little by itself: 60 % is all that a noisy output allows, 90 % is poor where a line does as well.
Errors here are root mean squares over the predicted samples, in parts of the output's standard deviation, so that an
error is ``1 - fit / 100``: ``m`` of the model, ``b`` of the best simple model (at most 1, the mean's), ``n`` of the
noise. The words and their limits, reasoned but for the 2 % and the two standard errors, which came from made data:

* good: better than the best simple model, beyond chance and by more than 2 % of its error, and it takes off at least
  half of what that one leaves and noise allows, ``b - m >= (b - n) / 2``: nearer to the noise than to the simple model;
  or what it leaves is as much as the noise, within two standard errors of that.
* poor: it explains less than half of what noise allows, ``1 - m < (1 - n) / 2``, or errs half as much again as the best
  simple model, ``m > 1.5 b``, or a quarter as much again where that is beyond chance, ``m > 1.25 b``: whoever needs a
  number is better off with that one.
* fair: all between. A model that a simple one equals is never called good, and one that a simple one beats is told so.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import scipy

from slipangle.data.dataset import Dataset
from slipangle.identify.judge.baselines import baselines
from slipangle.identify.judge.noise import noise_floor, uncertainty
from slipangle.identify.judge.scores import Score, score
from slipangle.models.model import Trajectory

_NEARER = 0.5  # share of what the best simple model leaves and noise allows that a good model takes off
_EXPLAINED = 0.5  # share of what noise allows that any but a poor model explains
_WORSE = 1.5  # times the best simple model's error, from which a model is poor
_BEATEN = 1.25  # the same where the simple model is better beyond chance
_GAIN = 0.02  # of the best simple model's error, below which another is as good
_BATCHES, _LEVEL = 10, 0.05  # of the test that the model is better than the simple one
_MOSTLY = 0.5  # of all squared errors, from which a single stretch is most of them
_ERRORS = 2.0  # standard errors of the noise, up to which what a model leaves is said to be noise


@dataclass(frozen=True, kw_only=True)
class Standing:
    """Verdict on one output of a model, beside simple models on the same samples and the noise."""

    output: str
    score: Score  # of the model's free run
    baselines: dict[str, Score] = field(default_factory=dict)  # of the simple models' free runs, by name
    noise: float  # standard deviation of the output's noise; NaN where the test data are too few to tell
    highest: float  # fit that this noise leaves a perfect model [%]; 100 where it is not known
    better: bool  # than the best simple model, beyond chance and by more than 2 % of its error
    worse: bool  # than that one, beyond chance and by more than 2 % of its own error
    at_the_noise: bool  # what the model leaves is as much as the noise
    word: Literal["good", "fair", "poor"]

    @property
    def best(self) -> str:
        """Name of the best of the simple models."""
        return max(self.baselines, key=lambda name: self.baselines[name].fit)

    @property
    def share(self) -> float:
        """What the model takes off of what the best simple model leaves and noise allows; 1 is all of it.

        NaN where the simple model leaves noise only.
        """
        m, b, n = _errors(self.score, self.baselines[self.best], self.highest)
        return (b - m) / (b - n) if b > n else float("nan")

    @property
    def sentence(self) -> str:
        """Fit, noise and the best simple model, and what follows."""
        return f"fits {self.beside(self.output)}: {self.word}, {self.reason}"

    def beside(self, output: str) -> str:
        """The fit beside what noise leaves and beside the best simple model's; ``output`` is what to call it."""
        leaves = "" if np.isnan(self.noise) else f" where its noise leaves at most {self.highest:.1f} %"
        fit, other = (_percent(s.fit) for s in (self.score, self.baselines[self.best]))
        return f"{fit} of {output}{leaves}; the best of the simple models ({self.best}) {other}"

    @property
    def reason(self) -> str:
        """Why the word."""
        m, b, n = _errors(self.score, self.baselines[self.best], self.highest)
        if self.word == "poor":
            if m > _WORSE * b or 1 - m >= _EXPLAINED * (1 - n):
                return f"its error is {min(m / b, 9999):.3g} times that of the simple model, which is the better one"
            return f"it explains {100 * max(0.0, (1 - m) / (1 - n)) if n < 1 else 0:.0f} % of what noise allows"
        if self.worse:
            return f"the simple model is better, with {b / m:.2g} times its error"
        if m > (1 + _GAIN) * b:
            return f"its error is {m / b:.3g} times that of the simple model, which may be chance"
        if not self.better:
            return "it is not better than the simple model beyond chance"
        if self.at_the_noise:
            return "what it leaves is noise"
        return f"it takes off {100 * self.share:.0f} % of what the simple model leaves and noise allows"


def standing(run: Trajectory, output: str, train: Dataset, test: Dataset) -> Standing:
    """Where the free run of a model fitted to ``train`` stands on ``test``, for one output.

    The simple models (`baselines.baselines`) see the inputs that the data name, are fitted to ``train`` and judged on
    the samples of ``test`` that ``run`` predicts; the noise is `noise.noise_floor` of those samples, and never more
    than the best free run leaves. That the model is better, or worse, is tested on the means of ten stretches of the
    difference of the squared errors [1]_, at 5 % either way; of a stretch that holds most of them no more counts than
    of the others, so a record that grows is not decided by its end.

    Raises MissingColumnError if ``train`` or ``test`` lacks the output or an input.

    References
    ----------
    .. [1] F. X. Diebold, R. S. Mariano, Comparing predictive accuracy, J. Business & Economic Statistics 13(3), 1995.
    """
    i, kept = run.outputs.index(output), run.predicted
    y, own = run.measured[kept, i], score(run, output)
    seen = test.select(inputs=train.inputs)
    simple = {b.name: b.simulate(seen, run.measured[:, i])[kept] for b in baselines(train, output)}
    scores = {name: Score.of(y, y_hat) for name, y_hat in simple.items()}
    best = max(scores, key=lambda name: scores[name].fit)
    errors = y - run.y[kept, i], y - simple[best]
    better = own.rmse < (1 - _GAIN) * scores[best].rmse and _better(*errors)
    worse = scores[best].rmse < (1 - _GAIN) * own.rmse and _better(*errors[::-1])
    noise = noise_floor(seen, output)
    if not np.isnan(noise):
        noise = min(noise, own.rmse, *(s.rmse for s in scores.values()))
    highest = 100.0 if np.isnan(noise) else 100 * (1 - noise / float(y.std()))
    m, b, n = _errors(own, scores[best], highest)
    noisy = bool(m <= n * (1 + _ERRORS * uncertainty(int(kept.sum()))))
    word: Literal["good", "fair", "poor"] = "fair"
    if better and (noisy or b - m >= _NEARER * (b - n)):
        word = "good"
    elif 1 - m < _EXPLAINED * (1 - n) or _beaten(m, b, worse):
        word = "poor"
    return Standing(
        output=output,
        score=own,
        baselines=scores,
        noise=noise,
        highest=highest,
        better=better,
        worse=worse,
        at_the_noise=noisy,
        word=word,
    )


def _errors(model: Score, simple: Score, highest: float) -> tuple[float, float, float]:
    """Of the model, the simple model and the noise, in standard deviations of the output."""
    return 1 - model.fit / 100, min(1 - simple.fit / 100, 1.0), 1 - highest / 100


def _beaten(model: float, simple: float, beyond_chance: bool) -> bool:
    """Whether the simple model's error is so much smaller that the other is poor."""
    return model > (_BEATEN if beyond_chance else _WORSE) * simple


def _better(model: np.ndarray, simple: np.ndarray) -> bool:
    """Whether the first errors are smaller beyond chance; neighbours in time depend on each other, stretches hardly.

    Where few stretches hold most of the errors, as of a system that grows or a simple model that fails in one bend,
    their spread hides what all of them say: then each stretch counts by its own size, if the mean error is smaller.
    """
    parts = min(_BATCHES, len(model))
    own, other = (np.array([float(np.mean(x)) for x in np.array_split(e**2, parts)]) for e in (model, simple))
    gain, size = other - own, other + own
    if parts < 2 or not np.isfinite(gain).all():
        return False
    alike = gain / np.where(size > 0, size, 1.0)
    if size.max() > _MOSTLY * size.sum():
        ways = (alike,)
    else:
        ways = (gain, alike) if np.mean(gain) > 0 else ()
    limit = float(scipy.stats.t.ppf(1 - _LEVEL, parts - 1)) / np.sqrt(parts)
    return any(float(np.mean(way)) > limit * float(np.std(way, ddof=1)) for way in ways)


def _percent(fit: float) -> str:
    return f"{fit:.1f} %" if fit > -999 else f"{fit:.3g} %"
