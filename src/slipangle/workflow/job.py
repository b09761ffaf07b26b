"""Run a job: read, inspect, identify, judge, control. `run_job` returns everything; `page.py` shows it."""

import json
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from slipangle import Dataset, Model, Run, Validation, inspect, validate
from slipangle.control.controller import Controller
from slipangle.data.quality.inspect import DataReport
from slipangle.errors import (
    ConfigError,
    IdentifiabilityWarning,
    MissingColumnError,
    MissingExtraError,
    ModelWarning,
    ParameterError,
    SimulationError,
    SlipangleError,
)
from slipangle.files import or_null
from slipangle.identify.judge.standing import Standing
from slipangle.report.tables import number
from slipangle.workflow.drive import drive
from slipangle.workflow.kinds import KINDS, fitted, needed
from slipangle.workflow.log import Logs, as_of_the_day, read_logs
from slipangle.workflow.robustness import Tried, tried
from slipangle.workflow.settings import ModelSettings, Settings

Progress = Callable[[float, str], None]
T = TypeVar("T")
_NUMERICAL = (np.linalg.LinAlgError, FloatingPointError, OverflowError, ZeroDivisionError)  # of a fit's own numbers


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Everything a job found.

    ``data`` is the log as identified from, ``train``, ``opening`` and ``test`` its parts; ``quality`` is what was seen
    in the log before anything was changed. There is one validation per model on the test part, one on the training
    part; ``delay_check`` says what the steering delay does to the parameters, ``failures`` why the other models could
    not be fitted, or not be driven. ``tried`` is the controller on cars that differ from its model.
    """

    settings: Settings
    validations: tuple[Validation, ...]
    training: tuple[Validation, ...]
    data: Dataset
    train: Dataset
    test: Dataset
    quality: DataReport
    delay_check: tuple[str, ...]
    run: Run | None
    plant: str
    opening: Dataset | None = None
    controller: Controller | None = None
    tried: Tried | None = None
    failures: dict[str, str] = field(default_factory=dict)

    def metrics(self) -> dict[str, Any]:
        """Numbers for machines; ``free_run`` is the first model's."""
        models = {
            v.name: {"free_run": plain(v.free_run_scores), "one_step_ahead": plain(v.one_step_scores)}
            | {
                "standing": {o: _stands(s) for o, s in v.standing.items()},
                "parameters": _parameters(v.model),
                "condition": _condition(v.model),
                "fit_seconds": v.model.fit_info.seconds if v.model.fit_info else None,
            }
            for v in self.validations
        }
        first = self.validations[0]
        record: dict[str, Any] = {
            "title": self.settings.title,
            "data": {"name": self.data.name, "dt": self.data.dt}
            | {"n_train": self.train.n_samples, "n_test": self.test.n_samples}
            | ({} if self.opening is None else {"n_opening": self.opening.n_samples}),
            "model": first.name,
            "free_run": plain(first.free_run_scores),
            "models": models,
            "warnings": {v.name: list(v.model.fit_info.warnings) for v in self.validations if v.model.fit_info},
            "corrections": {v.name: list(v.model.fit_info.corrections) for v in self.validations if v.model.fit_info},
        }
        if self.failures:
            record["failures"] = self.failures
        if self.run is not None:
            seconds = self.run.warm_seconds
            record["closed_loop"] = {
                "rmse_y": self.run.rmse("y"),
                "max_y": self.run.max("y"),
                "inside_lane": self.run.inside if self.run.marked else None,
                "kept": self.run.kept,
                "end": self.run.end.name,
                "finished": self.run.finished,
                "fallbacks": self.run.fallbacks,
                "solver_seconds_median": float(np.median(seconds)),
                "solver_seconds_p99": float(np.percentile(seconds, 99)),
            }
            if self.tried is not None and self.tried.trials is not None:
                record["closed_loop"]["cars"] = self.tried.trials.metrics()
        return record

    def to_json(self) -> str:
        """`metrics` as text."""
        return json.dumps(self.metrics(), indent=2) + "\n"


def run_job(settings: Settings, progress: Progress = lambda share, what: None) -> Outcome:
    """Do the whole job; nothing is written.

    A model that cannot be fitted costs the others nothing: it is in `Outcome.failures`.

    Raises SlipangleError for every kind of bad input, before any later step begins; or if no model could be fitted.
    """
    progress(0.0, "reading the log")
    logs = read_logs(settings)
    quality, train, test = inspect(logs.raw), logs.train, logs.test
    judged, failures = _judged(settings, logs, progress)
    progress(0.5, "checking the steering delay")
    said = delay_check(settings, quality, logs)
    run, plant_name, controller, cars = None, "", None, None
    wanted = settings.controller
    if wanted is not None and wanted.model in failures:
        failures["controller"] = f"its model '{wanted.model}' could not be fitted"
    elif wanted is not None:
        progress(0.55, "building the controller")
        run, plant_name, controller = drive(
            wanted,
            settings.plant,
            judged[wanted.model][0].model,
            lambda share: progress(0.55 + 0.2 * share, "driving in closed loop"),
            settings.estimator,
        )
        cars = tried(
            wanted,
            settings.plant,
            judged[wanted.model][0].model,
            controller,
            lambda share: progress(0.75 + 0.2 * share, f"driving {wanted.cars} other cars"),
            settings.estimator,
        )
    return Outcome(
        settings=settings,
        data=logs.data,
        train=train,
        test=test,
        opening=logs.opening,
        quality=quality,
        validations=tuple(test for test, _ in judged.values()),
        training=tuple(training for _, training in judged.values()),
        delay_check=said,
        run=run,
        plant=plant_name,
        controller=controller,
        tried=cars,
        failures=failures,
    )


def _judged(
    settings: Settings, logs: Logs, progress: Progress
) -> tuple[dict[str, tuple[Validation, Validation]], dict[str, str]]:
    """Verdicts on the test and the training part of each model that could be fitted, and why the others could not."""
    models: dict[str, Model] = {}

    def judge(i: int, wanted: ModelSettings) -> tuple[Validation, Validation]:
        progress(0.1 + 0.4 * i / len(settings.model), f"identifying {wanted.name}")
        model = models[wanted.name] = identify(wanted, logs, models)
        with warnings.catch_warnings(action="ignore", category=ModelWarning):  # shown on the page
            seen = validate(model, logs.train, name=wanted.name, on_training_data=True)
            today = as_of_the_day(model, logs.opening)
            return validate(today, logs.test, train=logs.train, name=wanted.name, start=settings.data.start), seen

    return each_model(settings, judge)


def each_model(settings: Settings, make: Callable[[int, ModelSettings], T]) -> tuple[dict[str, T], dict[str, str]]:
    """What is made of each model of a job, by its name in the job's order, and why the others failed.

    ``make`` takes how many were tried before and the model's settings, each after those that it is made of.

    Raises SlipangleError if all fail, that of the first; or if an entry of the job is wrong.
    """
    made: dict[str, T] = {}
    failures: dict[str, str] = {}
    causes: list[SlipangleError] = []
    for i, wanted in enumerate(settings.model_order()):
        try:
            made[wanted.name] = make(i, wanted)
        except SlipangleError as error:
            if isinstance(error, ConfigError) and not isinstance(error, MissingExtraError):
                raise
            causes.append(error)
            failures[wanted.name] = str(error)
        except _NUMERICAL as error:
            said = f"its fit broke down in numbers ({str(error)[:120]}); expected richer data: fewer lags or parameters"
            causes.append(SimulationError(f"'{wanted.name}': {said}"))
            failures[wanted.name] = said
    if not made:
        raise causes[0]  # of which others may be the consequence
    return {m.name: made[m.name] for m in settings.model if m.name in made}, failures


# ---- models --------------------------------------------------------------------------------------------------------


def identify(wanted: ModelSettings, logs: Logs, others: Mapping[str, Model] | None = None) -> Model:
    """Fit one model to the training part; what the data do not determine is in its ``fit_info.warnings``.

    ``others`` are the job's models so far, among them those that this one is made of.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentifiabilityWarning)  # shown on the page
        warnings.simplefilter("ignore", ModelWarning)
        channels = (wanted.inputs, wanted.outputs)
        try:
            return fitted(KINDS[wanted.kind], wanted.entries, *channels, logs.train, wanted.name, others, logs.others)
        except (MissingColumnError, ParameterError):
            if wanted.outputs or logs.train.outputs:
                raise
            raise ConfigError(
                f"neither [data] nor model '{wanted.name}' names outputs; expected the channels to be explained: add "
                'such as outputs = ["r"] to [data]'
            ) from None


def identify_named(settings: Settings, name: str, logs: Logs) -> Model:
    """Fit one model of a job by its name, after those that it is made of."""
    wanted = next(m for m in settings.model if m.name == name)
    others = {other: identify_named(settings, other, logs) for other in needed(wanted.entries)}
    return identify(wanted, logs, others)


def delay_check(settings: Settings, quality: DataReport, logs: Logs) -> tuple[str, ...]:
    """Refit the first bicycle with the steering shifted, and say which parameters that moves."""
    train = logs.train
    wanted = next((m for m in settings.model if m.kind == "bicycle"), None)
    if wanted is None or "delta" not in train.inputs:
        return ()
    delay = next((d for d in quality.delays if d.input == "delta" and d.output in ("r", "a_y")), None)
    if delay is None or not delay.clear or abs(delay.seconds) < 0.5 * train.dt:
        return ()
    fits = []
    shifts = (0.0, 0.5 * train.dt, train.dt)
    try:
        for shift in shifts:
            shifted = replace(logs, train=_shifted(train, shift))
            model = identify(wanted, shifted)
            with warnings.catch_warnings(action="ignore", category=ModelWarning):
                score = validate(model, shifted.train, on_training_data=True)
            if model.fit_info is not None:
                fits.append((model.fit_info, score.free_run_scores[model.outputs[0]].fit))
    except SlipangleError as error:  # a check is worth no lost job
        return (f"what the steering delay does to the parameters cannot be told: {error}",)
    said = [
        f"{delay.output} follows delta by {1000 * delay.seconds:.0f} ms; what of that is delay of actuator or logger "
        "and not lag of the car ends up in the parameters"
    ]
    agree = max(f for _, f in fits) - min(f for _, f in fits)  # %: fits this close cannot choose the delay
    for i, name in enumerate(fits[0][0].names):
        values = [info.values[i] for info, _ in fits]
        spread = (max(values) - min(values)) / max(abs(v) for v in values)
        if spread > 0.2 and agree < 0.5:
            parts = ", ".join(f"{number(v, 3)} at {1000 * s:.0f} ms" for v, s in zip(values, shifts, strict=True))
            said.append(
                f"{name} is not identifiable without knowing the steering delay: {parts} ({fits[0][0].units[i]}), "
                f"while the training fit stays at {min(f for _, f in fits):.1f} to {max(f for _, f in fits):.1f} %"
            )
    return tuple(said)


def _shifted(data: Dataset, delay: float) -> Dataset:
    """The data with delta delayed, experiment by experiment."""
    parts = [np.interp(part.t - delay, part.t, part["delta"]) for part in data.experiments]
    return data.with_channel("delta", np.concatenate(parts), data.unit("delta"))


def plain(scores: dict) -> dict[str, dict[str, float]]:
    """Scores of each output for machines."""
    return {k: {"fit": s.fit, "vaf": s.vaf, "rmse": s.rmse, "r2": s.r2} for k, s in scores.items()}


def _stands(s: Standing) -> dict[str, Any]:
    """Where a model stands beside simple models and the noise, for machines."""
    known = np.isfinite(s.noise)
    return {
        "word": s.word,
        "noise": s.noise if known else None,
        "highest_fit": s.highest if known else None,
        "better_beyond_chance": s.better,
        "simple_models": plain(s.baselines),
    }


def _condition(model: Model) -> float | None:
    """Condition number of the fit, where it has one."""
    info = model.fit_info
    return info.condition if info is not None and len(info.names) > 1 and np.isfinite(info.condition) else None


def _parameters(model: Model) -> dict[str, dict[str, float | None]]:
    info = model.fit_info
    if info is None:
        return {}
    rows = zip(info.names, info.values, info.interval(), strict=True)
    return {n: dict(zip(("value", "low", "high"), map(or_null, (v, *ends)), strict=True)) for n, v, ends in rows}
