"""Compare models by their free runs, look k steps ahead, cross-validate over experiments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from numbers import Integral
from typing import Protocol

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.errors import MissingColumnError, ParameterError, SimulationError, SlipangleError, shown
from slipangle.identify.judge.growth import growth_said
from slipangle.identify.judge.initial import Start, free_run
from slipangle.identify.judge.scores import Score, score
from slipangle.identify.judge.validate import require_unseen
from slipangle.identify.networks.training import Progress
from slipangle.models.model import Model, Trajectory
from slipangle.shown import Shown

_FEWEST = 2  # samples of a free run that can be judged
HORIZONS = (1, 2, 5, 10, 20, 50, 100)


class Estimator(Protocol):
    """Frozen settings whose `fit` returns a model."""

    def fit(self, data: Dataset) -> Model:
        """A model of ``data``."""
        ...


# ---- ranking -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One model of a comparison; all but its name, model and `failure` are those of a model that did not fail."""

    name: str
    model: Model
    # free-run metrics of each output over the samples that every model predicts
    scores: dict[str, Score] = field(default_factory=dict)
    # free-run RMSE over the standard deviation of the measured output, mean over the outputs [-]; ranks a `Comparison`
    error: float = np.inf
    one_step_error: float = np.inf  # the same for one-step-ahead prediction [-]
    free_run: Trajectory | None = None  # its samples are those that every model predicts; None where it failed
    failure: str = ""  # why there is no free run
    warnings: tuple[str, ...] = ()  # what its fit and its free run give cause to say


@dataclass(frozen=True, kw_only=True)
class Comparison(Shown):
    """Models ranked by free run, the best first."""

    entries: tuple[Entry, ...]  # every model, failed ones last
    outputs: tuple[str, ...]  # what they were compared on
    data_name: str  # of the data they were compared on
    start: Start | int  # protocol of the initial state
    n_samples: int  # samples that every model predicts

    def _words(self) -> str:
        fits = ", ".join(f"{s.fit:.1f} % of {n}" for n, s in self.best.scores.items())
        return f"the best of {len(self.entries)} on {self.data_name} is {self.best.name}{f', {fits}' if fits else ''}"

    @property
    def best(self) -> Entry:
        """The winner."""
        return self.entries[0]

    @property
    def trajectories(self) -> dict[str, Trajectory]:
        """Free runs by name, for plots; failed models are left out."""
        return {entry.name: entry.free_run for entry in self.entries if entry.free_run is not None}


def compare(
    models: Mapping[str, Model] | Sequence[Model],
    data: Dataset,
    *,
    outputs: Sequence[str] | None = None,
    start: Start | int = "first samples",
    on_training_data: bool = False,
) -> Comparison:
    """Rank models by their free-run error on data that none of them was fitted to.

    All are judged on the same samples, those that every model predicts. A model whose free run leaves the finite
    numbers is ranked last, with the reason.

    Raises ParameterError if there is no model, no common output, or the data overlap training data, and
    SampleTimeError, MissingColumnError or TooShortError if the data do not suit a model.

    Parameters
    ----------
    models : mapping of str to Model, or sequence of Model
        A sequence is named by class, with a number where classes repeat.
    outputs : sequence of str, optional
        What to compare; by default the outputs that all models have.
    start : {"first samples", "least squares"} or int
        Protocol of the initial state, see `slipangle.identify.judge.initial.free_run`.
    on_training_data : bool
        Allow data that overlap the training data of a model.
    """
    named = _named(models)
    judged = _common(named, outputs)
    runs: dict[str, tuple[Trajectory, Trajectory] | str] = {}
    for name, model in named.items():
        if not on_training_data:
            require_unseen(model, data)
        try:
            runs[name] = free_run(model, data, start=start), model.predict(data)
        except SimulationError as error:
            runs[name] = str(error)
    masks = [pair[0].predicted for pair in runs.values() if not isinstance(pair, str)]
    mask = np.logical_and.reduce(masks) if masks else np.zeros(data.n_samples, dtype=bool)
    entries = [_entry(name, model, runs[name], judged, mask, data) for name, model in named.items()]
    return Comparison(
        entries=tuple(sorted(entries, key=lambda entry: entry.error)),
        outputs=judged,
        data_name=data.name,
        start=start,
        n_samples=int(mask.sum()),
    )


def _entry(
    name: str,
    model: Model,
    runs: tuple[Trajectory, Trajectory] | str,
    outputs: tuple[str, ...],
    mask: np.ndarray,
    data: Dataset,
) -> Entry:
    fitted = model.fit_info.warnings if model.fit_info is not None else ()
    if isinstance(runs, str):
        return Entry(name=name, model=model, failure=runs, warnings=fitted)
    said = tuple(sentence for run in runs for sentence in run.astray.values())
    said += () if runs[0].beyond is None else (runs[0].beyond.sentence,)
    said += tuple(growth_said(model, data, runs[0]).values())
    free, one = (replace(run, predicted=mask) for run in runs)
    return Entry(
        name=name,
        model=model,
        scores={o: score(free, o) for o in outputs},
        error=_relative(free, outputs),
        one_step_error=_relative(one, outputs),
        free_run=free,
        warnings=(*fitted, *said),
    )


def _relative(run: Trajectory, outputs: tuple[str, ...]) -> float:
    """RMSE over standard deviation, mean over the outputs; ``1 - F / 100``."""
    return float(np.mean([1 - score(run, o).fit / 100 for o in outputs]))


def _named(models: Mapping[str, Model] | Sequence[Model]) -> dict[str, Model]:
    if isinstance(models, Mapping):
        named = dict(models)
    else:
        named, classes = {}, [type(m).__name__ for m in models]
        for i, (name, model) in enumerate(zip(classes, models, strict=True)):
            named[f"{name} {classes[: i + 1].count(name)}" if classes.count(name) > 1 else name] = model
    if not named:
        raise ParameterError("no model was given; expected at least one to compare")
    return named


def _common(named: Mapping[str, Model], outputs: Sequence[str] | None) -> tuple[str, ...]:
    first = next(iter(named.values()))
    if outputs is None:
        shared = tuple(o for o in first.outputs if all(o in m.outputs for m in named.values()))
        if not shared:
            has = "; ".join(f"'{n}' has {', '.join(m.outputs)}" for n, m in named.items())
            raise ParameterError(f"the models have no output in common ({has}); expected one to compare them by")
        return shared
    chosen = (outputs,) if isinstance(outputs, str) else tuple(outputs)
    for name, model in named.items():
        for o in chosen:
            if o not in model.outputs:
                raise MissingColumnError(
                    f"'{name}' has no output '{o}', only {', '.join(model.outputs)}; expected one that all models have"
                )
    if not chosen:
        raise ParameterError("no output was given; expected at least one to compare the models by")
    return chosen


# ---- k steps ahead -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class HorizonErrors:
    """Error over how far a model looks ahead."""

    horizons: np.ndarray  # (n_horizons,), steps ahead of the last measured output used
    rmse: np.ndarray  # (n_horizons, n_outputs), RMSE at each horizon, in the outputs' units
    free_run: np.ndarray  # (n_outputs,), RMSE of the free run on the same samples: the limit of long horizons
    outputs: tuple[str, ...]
    dt: float  # sample time [s]


def horizon_errors(
    model: Model, data: Dataset, horizons: Sequence[int] = HORIZONS, *, on_training_data: bool = False
) -> HorizonErrors:
    """RMSE of k-step-ahead predictions for several k, all over the same samples.

    Raises ParameterError if no horizon fits into the data, one is below 1, or the data overlap training data.

    Horizons are steps ahead; those that no experiment is long enough for are left out. ``on_training_data`` allows data
    that overlap the training data.
    """
    if not on_training_data:
        require_unseen(model, data)
    room = data.n_longest - model.memory
    steps = sorted({k for k in horizons if k <= room})
    if not steps:
        raise ParameterError(
            f"the horizons are {list(horizons)}; expected some up to {room}, which the longest experiment has room for"
        )
    runs = [model.predict(data, k) for k in steps]
    mask = runs[-1].predicted
    free = model.simulate(data)

    def rmse(run: Trajectory) -> np.ndarray:
        return np.sqrt(np.mean(run.error[mask] ** 2, axis=0))

    return HorizonErrors(
        horizons=np.array(steps),
        rmse=np.array([rmse(run) for run in runs]),
        free_run=rmse(free),
        outputs=model.outputs,
        dt=data.dt,
    )


# ---- cross-validation ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Fold:
    """One fold: the model fitted to the other experiments, judged on these."""

    spans: tuple[tuple[float, float], ...]  # first and last time of each held-out experiment [s]
    model: Model  # fitted to the rest
    scores: dict[str, Score] = field(default_factory=dict)  # free-run metrics; empty if it failed
    error: float = np.inf  # as in `Entry`
    failure: str = ""  # why there are no scores
    units: dict[str, str] = field(default_factory=dict)  # of the outputs, by name


@dataclass(frozen=True, kw_only=True)
class CrossValidation(Shown):
    """Every fold of a cross-validation."""

    folds: tuple[Fold, ...]  # in the order of the stretches that they leave out

    def _words(self) -> str:
        outputs = self.folds[0].model.outputs
        if not any(fold.scores for fold in self.folds):
            return f"{len(self.folds)} folds, all failed: {self.folds[0].failure}"
        means = ", ".join(f"{np.nanmean(self.fit(n)):.1f} % of {n}" for n in outputs)
        return f"{len(self.folds)} folds, on average {means}"

    @property
    def error(self) -> float:
        """Mean of the folds' errors; infinite if a fold failed. [-]"""
        return float(np.mean([fold.error for fold in self.folds]))

    def fit(self, output: str) -> np.ndarray:
        """Fit F of one output in every fold; NaN where it failed. [%]"""
        return np.array([fold.scores[output].fit if fold.scores else np.nan for fold in self.folds])


def cross_validate(
    estimator: Estimator, data: Dataset, *, folds: int | None = None, progress: Progress | None = None
) -> CrossValidation:
    """Fit to all experiments but some, judge the free run on those, in turn.

    Raises ParameterError if there are fewer than two folds, or too many for what a model takes to begin its free run.

    Parameters
    ----------
    estimator : object with a ``fit``
        Such as `ARX` or `GreyBox`.
    data : Dataset
        Training data, several experiments or one.
    folds : int, optional
        Cut the record into this many stretches of about equal length and leave out one at a time; by default each
        experiment is left out once.
    """
    edges = _edges(data, folds)
    results = []
    for i, (a, b) in enumerate(edges):
        if progress is not None:
            progress(i / len(edges), f"fold {i + 1} of {len(edges)}")
        rest = [data.rows(*rows) for rows in ((0, a), (b, data.n_samples)) if rows[0] < rows[1]]
        results.append(_fold(estimator, join(*rest), data.rows(a, b)))
        taken = results[-1].model.memory
        if folds is not None and min(stop - start for start, stop in edges) < taken + _FEWEST:
            raise ParameterError(
                f"folds is {folds}, and a model takes {taken} samples to begin its free run; expected at most "
                f"{data.n_samples // (taken + _FEWEST)}: stretches of at least {taken + _FEWEST} samples"
            )
    if progress is not None:
        progress(1.0, "done")
    return CrossValidation(folds=tuple(results))


def _edges(data: Dataset, folds: int | None) -> list[tuple[int, int]]:
    """First row and the row after the last of every stretch that is left out once."""
    if folds is None:
        if len(data.starts) < 2:
            raise ParameterError(
                f"'{data.name}' is one experiment; expected several to leave out in turn: pass folds=5 to cut it"
            )
        return list(zip(data.starts, data.stops, strict=True))
    if isinstance(folds, bool) or not isinstance(folds, Integral) or not 2 <= folds <= data.n_samples // 2:
        raise ParameterError(
            f"folds is {shown(folds)}; expected a whole number: 2 to {data.n_samples // 2} stretches of "
            f"{data.n_samples} samples"
        )
    return list(pairwise(np.linspace(0, data.n_samples, folds + 1).round().astype(int).tolist()))


def _fold(estimator: Estimator, rest: Dataset, held: Dataset) -> Fold:
    spans = tuple((float(part.t[0]), float(part.t[-1])) for part in held.experiments)
    model = estimator.fit(rest)
    if held.n_longest < model.memory + _FEWEST:
        said = f"its longest experiment has {held.n_longest} samples, and the model takes {model.memory} to begin"
        return Fold(spans=spans, model=model, failure=said)
    try:
        run = model.simulate(held)
        scores = {o: score(run, o) for o in model.outputs}
    except SlipangleError as error:
        return Fold(spans=spans, model=model, failure=str(error))
    units = {o: run.unit(o) for o in model.outputs}
    return Fold(spans=spans, model=model, scores=scores, error=_relative(run, model.outputs), units=units)
