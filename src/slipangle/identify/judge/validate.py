"""An honest verdict on a model: free run beside one-step-ahead, on data it was not fitted to."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace

import numpy as np

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.errors import ModelWarning, ParameterError, SimulationError
from slipangle.identify.judge.growth import growth_said
from slipangle.identify.judge.initial import free_run
from slipangle.identify.judge.misread import misread
from slipangle.identify.judge.residuals import Residuals, residual_tests
from slipangle.identify.judge.scores import Score, score
from slipangle.identify.judge.standing import Standing, standing
from slipangle.models.model import FitInfo, Model, Trajectory
from slipangle.models.provenance import Overlap, fingerprint, overlap
from slipangle.models.region import OUTSIDE
from slipangle.shown import Shown

_TOLD = 10  # samples that tell an error
_UNNAMED = Dataset.name  # what data are called that nobody named


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
    growth: dict[str, str] = field(default_factory=dict)  # outputs whose free run an unstable system's growth decides
    standing: dict[str, Standing] = field(default_factory=dict)  # beside simple models; empty without training data

    def _words(self) -> str:
        return f"{self.name} fits " + ", ".join(f"{s.fit:.1f} % of {n}" for n, s in self.free_run_scores.items())


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
    (`Validation.misread`); the verdict's sentences say so too, and how much worse the model is outside. Where a free
    run errs by what an unstable model makes of its start, `Validation.growth` says so, and how it fits in shorter runs.

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
        growth=growth_said(model, data, free),
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
