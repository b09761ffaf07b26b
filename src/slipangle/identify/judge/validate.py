"""An honest verdict on a model: free run beside one-step-ahead, on data it was not fitted to."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace
from itertools import pairwise

import numpy as np
import scipy
from scipy import integrate, optimize, special

from slipangle.data.dataset import Dataset, join, require_dataset
from slipangle.errors import ModelWarning, ParameterError, SimulationError, TooShortError
from slipangle.identify.judge.initial import free_run
from slipangle.identify.judge.misread import misread
from slipangle.identify.judge.scores import Score, score
from slipangle.identify.judge.standing import Standing, standing
from slipangle.models.model import FitInfo, Model, Trajectory
from slipangle.models.provenance import Overlap, fingerprint, overlap
from slipangle.models.region import OUTSIDE
from slipangle.shown import Shown

_BLIND = 0.5  # correlations that a test which lets as much pass for chance does not see
_TOLD = 10  # samples that tell an error
_UNNAMED = Dataset.name  # what data are called that nobody named


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


@dataclass(frozen=True, kw_only=True)
class Validation(Shown):
    """Verdict on one model; `free_run_scores` and the others are keyed by output name."""

    name: str
    model: Model
    free_run: Trajectory  # over the test data
    one_step: Trajectory  # prediction one step ahead
    free_run_scores: dict[str, Score]  # metrics of each output
    one_step_scores: dict[str, Score]  # the same one step ahead
    residuals: dict[str, Residuals]  # correlations of each output's error, with itself and with the inputs
    inputs: tuple[str, ...]
    misread: str = ""  # which channel, its sign turned or in another unit, would let the model follow the data
    standing: dict[str, Standing] = field(default_factory=dict)  # beside simple models; empty without training data

    def _words(self) -> str:
        return f"{self.name} fits " + ", ".join(f"{s.fit:.1f} % of {n}" for n, s in self.free_run_scores.items())


def restarted(data: Dataset, seconds: float, memory: int) -> Dataset:
    """The data cut into experiments that a free run starts anew in.

    Each predicts ``seconds`` (the last of a record what is left) from the ``memory`` samples before. So runs of it
    predict the same samples as one run over all the data, and what a single long run hides or shows is seen beside it.

    Lengths are in seconds [s]; experiments not longer than ``memory`` samples are left out.

    Raises ParameterError if ``seconds`` is shorter than one sample, and TooShortError if no experiment is longer than
    ``memory``.
    """
    n = round(seconds / data.dt)
    if n < 1:
        raise ParameterError(
            f"restarts every {seconds:g} s, a sample lasts {data.dt:g} s; expected at least one sample"
        )
    parts = [
        part.rows(a - memory, min(a + n, part.n_samples))
        for part in data.experiments
        for a in range(memory, part.n_samples, n)
    ]
    if not parts:
        raise TooShortError(
            f"no experiment of '{data.name}' is longer than the {memory} samples a free run starts from; record longer"
        )
    return join(*parts, name=data.name)


def validate(
    model: Model,
    data: Dataset,
    *,
    train: Dataset | None = None,
    name: str | None = None,
    max_lag: int = 40,
    start: int | None = None,
    on_training_data: bool = False,
) -> Validation:
    """Judge a model on data it was not fitted to.

    Raises ParameterError if the data overlap those the model was fitted to, or ``train``, or ``max_lag`` is below 1.

    Warns with ModelWarning if a prediction leaves any plausible range of the data, or a learned model's training data
    (`Model.region`), or a channel reads otherwise than in training, its sign turned or in another unit
    (`Validation.misread`); the verdict's sentences say so too, and how much worse the model is outside.

    Parameters
    ----------
    data : Dataset
        Test data; one free run per experiment.
    train : Dataset, optional
        What the model was fitted to: simple models are fitted to it too, and `Validation.standing` says where the model
        stands between the best of them and the noise. See `slipangle.identify.judge.standing`.
    name : str, optional
        Name for reports, by default the model's class.
    max_lag : int
        Largest lag of the residual tests. [samples]
    start : int, optional
        The free run starts from the state that fits so many first samples of each experiment best, where a protocol
        gives these; they do not count. By default from the samples that the model needs. [samples]
    on_training_data : bool
        Allow data that overlap the training data, for a training score.
    """
    require_dataset(data, "validate() got")
    if not max_lag >= 1:
        raise ParameterError(f"max_lag is {max_lag}; expected at least 1 sample")
    if not on_training_data:
        require_unseen(model, data)
        _require_apart(train, data)
    free = _free_run(model, data, start)
    doubt = misread(model, data, free)
    if doubt:
        warnings.warn(doubt, ModelWarning, stacklevel=2)
    with warnings.catch_warnings():
        if free.beyond is not None:  # said once is enough
            warnings.filterwarnings("ignore", f".*{OUTSIDE}", ModelWarning)
        one = model.predict(data)
    chosen = data.select(inputs=model.inputs, outputs=model.outputs)
    trained = model.fit_info.n_samples if model.fit_info is not None else None
    return Validation(
        name=name or type(model).__name__,
        model=model,
        free_run=free,
        one_step=one,
        free_run_scores={o: score(free, o) for o in model.outputs},
        one_step_scores={o: score(one, o) for o in model.outputs},
        residuals={
            o: _with_astray(residual_tests(free, one, chosen, o, max_lag, trained), free, one, o, doubt)
            for o in model.outputs
        },
        inputs=model.inputs,
        misread=doubt,
        standing={} if train is None else {o: standing(free, o, train, data) for o in model.outputs},
    )


def _free_run(model: Model, data: Dataset, start: int | None) -> Trajectory:
    """The free run; one that breaks down says also whether a channel reads otherwise than in training."""
    try:
        return free_run(model, data, start="first samples" if start is None else start)
    except SimulationError as error:
        doubt = misread(model, data, None)
        if not doubt:
            raise
        raise SimulationError(f"{error}; {doubt}") from None


def _with_astray(tests: Residuals, free: Trajectory, one: Trajectory, output: str, doubt: str) -> Residuals:
    """The tests, with what is to be said of a prediction that left any plausible range, or the training data, first."""
    said = tuple(run.astray[output] for run in (free, one) if output in run.astray)
    ahead = (one.beyond.sentence,) if one.beyond is not None and free.beyond is None else ()
    said = (*((doubt,) if doubt else ()), *said, *beyond_said(free, output), *ahead)
    return replace(tests, sentences=(*said, *tests.sentences))


def beyond_said(run: Trajectory, output: str) -> tuple[str, ...]:
    """What of a free run lies outside of the training data, and how much worse an output is there; empty if nothing."""
    if run.beyond is None:
        return ()
    rows, error = run.beyond.rows, run.error[:, run.outputs.index(output)] ** 2
    inside, outside = error[run.predicted & ~rows], error[run.predicted & rows]
    if min(len(inside), len(outside)) < _TOLD or not inside.any():
        return (run.beyond.sentence,)
    times = float(np.sqrt(np.mean(outside) / np.mean(inside)))
    return (f"{run.beyond.sentence}; the error of {output} is {times:.2g} times that inside (RMS)",)


def require_unseen(model: Model, data: Dataset) -> None:
    """Raise if the model, or one that it is made of, was fitted to any of these samples.

    They are known by their content, whatever their name, their time and the pieces that they come in (see
    `slipangle.models.provenance`). A model saved without a fingerprint is judged by name and time.

    Raises ParameterError with how many samples overlap and where.

    Warns with ModelWarning if nothing tells the data apart from those that the model was fitted to.
    """
    for info in _fits(model):
        seen = info.fingerprint
        shared = overlap(seen, data) if seen is not None else _same_name_and_time(info, data)
        if shared is None:
            continue
        first = float(data.t[np.argmax(shared.rows)])
        moved = abs(first - shared.earlier) > 0.5 * data.dt
        other = [f"under the name '{info.train_name}'"] if info.train_name != data.name else []
        other += [f"at t = {shared.earlier:g} s"] if moved else []
        raise ParameterError(
            f"{int(shared.rows.sum())} of {data.n_samples} samples of '{data.name}' (from t = {first:g} s) were used "
            f"to fit the model{', ' + ' '.join(other) if other else ''}; expected other data: validate on the test "
            "part, or pass on_training_data=True for a training score"
        )


def _require_apart(train: Dataset | None, data: Dataset) -> None:
    shared = overlap(fingerprint(train, train.outputs), data) if train is not None and train.outputs else None
    if shared is not None:
        raise ParameterError(
            f"{int(shared.rows.sum())} samples of the training data are in the test data '{data.name}'; expected "
            "others: validate on the test part"
        )


def _fits(model: Model) -> Iterator[FitInfo]:
    """How the model and the models inside it were fitted."""
    if model.fit_info is not None:
        yield model.fit_info
    for f in fields(model) if is_dataclass(model) else ():
        value = getattr(model, f.name)
        for inner in value if isinstance(value, tuple) else (value,):
            if isinstance(inner, Model):
                yield from _fits(inner)


def _same_name_and_time(info: FitInfo, data: Dataset) -> Overlap | None:
    """What a fit that kept no content can tell."""
    if info.train_name != data.name:
        return None
    rows = (data.t >= info.train_span[0] - 1e-9) & (data.t <= info.train_span[1] + 1e-9)
    if not rows.any():
        return None
    if data.name == _UNNAMED:
        warnings.warn(
            f"whether the model was fitted to some of these data cannot be told: both are called '{_UNNAMED}' and its "
            "file keeps nothing of their content; expected a name for each, or a model fitted anew",
            ModelWarning,
            stacklevel=4,
        )
        return None
    return Overlap(rows=rows, earlier=float(data.t[np.argmax(rows)]))


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
