"""Run a job: read, inspect, identify, judge, control. `run_job` returns everything; `page.py` shows it."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any

import numpy as np

from slipangle.control.mpc import MPC
from slipangle.control.speed.driver import SpeedDriver
from slipangle.data.dataset import Dataset
from slipangle.data.public import sets as public
from slipangle.data.quality.inspect import DataReport, despike, inspect
from slipangle.data.readers import read
from slipangle.data.readers.csv import Column
from slipangle.errors import ConfigError, IdentifiabilityWarning, ModelWarning, SlipangleError, nearest
from slipangle.identify.judge.validate import Validation, validate
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.model import Model
from slipangle.models.ode import OdeModel
from slipangle.models.parameters import ParameterSet
from slipangle.models.tires.simple import MagicCurve, SimpleMagicFormula
from slipangle.models.vehicles import catalogue
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.longitudinal import Longitudinal, LongitudinalParams
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams, with_speed_derivative
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams, SingleTrackParams
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.models.wrappers.delayed import Delayed
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Limits, Values, Weights
from slipangle.paths import lane_change as manoeuvres
from slipangle.paths.path import Path
from slipangle.report.tables import number
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import Run
from slipangle.units import deg
from slipangle.workflow.black_box import BLACK_BOXES, estimator
from slipangle.workflow.settings import ControllerSettings, ModelSettings, PlantSettings, Settings

Progress = Callable[[float, str], None]

_BICYCLES = {"ferrari-250lm": catalogue.FERRARI_250LM, "sousa-table-7.2": catalogue.SOUSA_TABLE_7_2}
_PLANTS = {
    "sousa-table-6.1": (catalogue.SOUSA_TABLE_6_1, catalogue.SOUSA_TABLE_6_2),
    "sousa-table-6.10": (catalogue.SOUSA_TABLE_6_10, catalogue.SOUSA_TABLE_6_8),
}
_MANOEUVRES = {
    "iso3888-1": manoeuvres.double_lane_change,
    "iso3888-2": manoeuvres.obstacle_avoidance,
}
_MODELS: dict[str, type[OdeModel]] = {
    "bicycle": Bicycle,
    "nonlinear-bicycle": NonlinearBicycle,
    "longitudinal": Longitudinal,
}
_PARAMS: dict[str, type[ParameterSet]] = {
    "bicycle": BicycleParams,
    "nonlinear-bicycle": NonlinearBicycleParams,
    "longitudinal": LongitudinalParams,
}
_FREE = {
    "bicycle": ("C_f", "C_r", "inertia_z"),
    "nonlinear-bicycle": ("C_f", "C_r", "inertia_z", "mu_f", "mu_r", "steering_lag", "steering_offset"),
    "longitudinal": ("k_e", "k_d", "k_r"),
}
_FEWEST, _CELLS = 20, 5e8  # samples of the longest record after resampling, and numbers of all
NOISE = {"v_y": 0.02, "r": 0.002, "X": 0.02, "Y": 0.02, "psi": 0.001, "v_x": 0.02}


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Everything a job found.

    Parameters
    ----------
    settings : Settings
        What was asked.
    data, train, test : Dataset
        The log as identified from, and its two parts.
    quality : DataReport
        What was seen in the log before anything was changed.
    validations, training : tuple of Validation
        One per model, on the test part and on the training part.
    delay_check : tuple of str
        What the steering delay does to the fitted parameters.
    run : Run or None
        The closed loop.
    plant : str
        What the plant was.
    failures : dict of str to str
        Why the other models could not be fitted, or not be driven.
    """

    settings: Settings
    data: Dataset
    train: Dataset
    test: Dataset
    quality: DataReport
    validations: tuple[Validation, ...]
    training: tuple[Validation, ...]
    delay_check: tuple[str, ...]
    run: Run | None
    plant: str
    failures: dict[str, str] = field(default_factory=dict)

    def metrics(self) -> dict[str, Any]:
        """Numbers for machines; ``free_run`` is the first model's."""
        models = {
            v.name: {"free_run": _scores(v.free_run_scores), "one_step_ahead": _scores(v.one_step_scores)}
            | {
                "parameters": _parameters(v.model),
                "condition": _condition(v.model),
                "fit_seconds": v.model.fit_info.seconds if v.model.fit_info else None,
            }
            for v in self.validations
        }
        first = self.validations[0]
        found: dict[str, Any] = {
            "title": self.settings.title,
            "data": {
                "name": self.data.name,
                "dt": self.data.dt,
                "n_train": self.train.n_samples,
                "n_test": self.test.n_samples,
            },
            "model": first.name,
            "free_run": _scores(first.free_run_scores),
            "models": models,
            "warnings": {v.name: list(v.model.fit_info.warnings) for v in self.validations if v.model.fit_info},
        }
        if self.failures:
            found["failures"] = self.failures
        if self.run is not None:
            seconds = self.run.seconds
            found["closed_loop"] = {
                "rmse_y": self.run.rmse("y"),
                "max_y": self.run.max("y"),
                "inside_lane": self.run.inside,
                "end": self.run.end.name,
                "fallbacks": self.run.fallbacks,
                "solver_seconds_median": float(np.median(seconds)),
                "solver_seconds_p99": float(np.percentile(seconds, 99)),
            }
        return found

    def to_json(self) -> str:
        """`metrics` as text."""
        return json.dumps(self.metrics(), indent=2) + "\n"


def run_job(settings: Settings, progress: Progress = lambda share, what: None) -> Outcome:
    """Do the whole job; nothing is written.

    A model that cannot be fitted costs the others nothing: it is in `Outcome.failures`.

    Raises
    ------
    SlipangleError
        For every kind of bad input, before any later step begins; or if no model could be fitted.
    """
    progress(0.0, "reading the log")
    raw = load_data(settings)
    quality = inspect(raw)
    data = condition(raw, settings)
    train, test = data.split(settings.data.train)
    judged, failures = _judged(settings, train, test, progress)
    progress(0.5, "checking the steering delay")
    said = delay_check(settings, quality, train)
    run, plant_name = None, ""
    wanted = settings.controller
    if wanted is not None and wanted.model in failures:
        failures["controller"] = f"its model '{wanted.model}' could not be fitted"
    elif wanted is not None:
        progress(0.55, "building the controller")
        run, plant_name = drive(
            wanted,
            settings.plant,
            judged[wanted.model][0].model,
            lambda share: progress(0.55 + 0.4 * share, "driving in closed loop"),
        )
    return Outcome(
        settings=settings,
        data=data,
        train=train,
        test=test,
        quality=quality,
        validations=tuple(test for test, _ in judged.values()),
        training=tuple(training for _, training in judged.values()),
        delay_check=said,
        run=run,
        plant=plant_name,
        failures=failures,
    )


def _judged(
    settings: Settings, train: Dataset, test: Dataset, progress: Progress
) -> tuple[dict[str, tuple[Validation, Validation]], dict[str, str]]:
    """Verdicts on the test and the training part of each model that could be fitted, and why the others could not."""
    judged, failures = {}, {}
    for i, wanted in enumerate(settings.model):
        progress(0.1 + 0.4 * i / len(settings.model), f"identifying {wanted.name}")
        try:
            model = identify(wanted, train)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ModelWarning)  # shown on the page
                seen = validate(model, train, name=wanted.name, on_training_data=True)
                judged[wanted.name] = validate(model, test, name=wanted.name), seen
        except ConfigError:
            raise
        except SlipangleError as error:
            if len(settings.model) == 1 or (not judged and i == len(settings.model) - 1):
                raise
            failures[wanted.name] = str(error)
    return judged, failures


# ---- data ----------------------------------------------------------------------------------------------------------


def load_data(settings: Settings) -> Dataset:
    """The log as it is, in SI units."""
    wanted = settings.data
    if wanted.set:
        data = public.load(wanted.set)
        return data.select(inputs=wanted.inputs or data.inputs, outputs=wanted.outputs or data.outputs)
    columns = {name: Column(c.column, c.unit or None) for name, c in wanted.columns.items()} or None
    time = Column(wanted.time.column, wanted.time.unit or None) if wanted.time is not None else None
    return read(
        settings.folder / wanted.file,
        columns=columns,
        time=time,
        dt=wanted.dt,
        inputs=wanted.inputs,
        outputs=wanted.outputs,
        nan=wanted.nan,
    )


def condition(data: Dataset, settings: Settings) -> Dataset:
    """Despiked and resampled as asked; each step leaves a note."""
    for channel in settings.data.despike:
        data, _ = despike(data, channel)
    rate = settings.data.rate
    if rate is not None and not math.isclose(rate * data.dt, 1.0, rel_tol=1e-9):
        longest = max(b - a for a, b in zip(data.starts, data.stops, strict=True)) * data.dt
        cells = data.duration * rate * len(data.channels)
        if longest * rate < _FEWEST or cells > _CELLS:
            raise ConfigError(
                f"[data] rate is {rate:g} Hz for a record of {longest:.4g} s and {len(data.channels)} channels; "
                f"expected {_FEWEST / longest:.2g} to {_CELLS / (data.duration * len(data.channels)):.2g} Hz: it was "
                f"logged at {1 / data.dt:.4g} Hz"
            )
        data = data.resample(1 / rate, cutoff=settings.data.cutoff)
    if "v_x" in data and "v_x_dot" not in data:
        data = with_speed_derivative(data)
    return data.hold_mean() if settings.data.hold == "mean" else data


# ---- models --------------------------------------------------------------------------------------------------------


def identify(wanted: ModelSettings, train: Dataset) -> Model:
    """Fit one model; what the data do not determine is in its ``fit_info.warnings``."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentifiabilityWarning)  # shown on the page
        warnings.simplefilter("ignore", ModelWarning)
        if wanted.kind in BLACK_BOXES:
            data = train.select(inputs=wanted.inputs or None, outputs=wanted.outputs or None)
            return estimator(wanted).fit(data)
        start, free = _start(wanted, train), wanted.free or _FREE[wanted.kind]
        late = {n.removeprefix("delay_"): 0.5 * train.dt for n in free if n.startswith("delay_")}
        return GreyBox(start=Delayed(start, delays=late) if late else start, free=free).fit(train)


def _start(wanted: ModelSettings, train: Dataset) -> OdeModel:
    kind: type[ParameterSet] = _PARAMS[wanted.kind]
    if wanted.catalogue:
        if wanted.kind != "bicycle" or wanted.catalogue not in _BICYCLES:
            raise ConfigError(
                f"model '{wanted.name}': there is no {wanted.kind} '{wanted.catalogue}' in the catalogue; "
                f"{nearest(wanted.catalogue, _BICYCLES)}: use one of these names"
            )
        params: Any = _BICYCLES[wanted.catalogue].with_values(**wanted.car)
    else:
        for name in wanted.car:
            kind.si(name)
        try:
            params = kind(**wanted.car)
        except TypeError:
            optional = {f.name for f in fields(kind) if f.default is not MISSING or f.default_factory is not MISSING}
            needed = [n for n in kind.metadata() if n not in wanted.car and n not in optional]
            raise ConfigError(
                f"model '{wanted.name}': car lacks {', '.join(needed)}; expected every parameter of the {wanted.kind} "
                "(free ones as start values), or a catalogue name"
            ) from None
    l_f, wheelbase = getattr(params, "l_f", 0.0), getattr(params, "wheelbase", math.inf)
    if not l_f < wheelbase:
        raise ConfigError(
            f"model '{wanted.name}': l_f is {l_f:g} m and the wheelbase {wheelbase:g} m; expected the centre of "
            "gravity between the axles: l_f is its distance from the front one"
        )
    outputs = wanted.outputs or train.outputs
    return _MODELS[wanted.kind](params=params, dt=train.dt, outputs=outputs)


def delay_check(settings: Settings, quality: DataReport, train: Dataset) -> tuple[str, ...]:
    """Refit the first bicycle with the steering shifted, and say which parameters that moves."""
    wanted = next((m for m in settings.model if m.kind == "bicycle"), None)
    if wanted is None or "delta" not in train.inputs:
        return ()
    found = next((d for d in quality.delays if d.input == "delta" and d.output in ("r", "a_y")), None)
    if found is None or abs(found.seconds) < 0.5 * train.dt:
        return ()
    fits = []
    shifts = (0.0, 0.5 * train.dt, train.dt)
    try:
        for shift in shifts:
            model = identify(wanted, _shifted(train, shift))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ModelWarning)
                score = validate(model, _shifted(train, shift), on_training_data=True)
            if model.fit_info is not None:
                fits.append((model.fit_info, score.free_run_scores[model.outputs[0]].fit))
    except SlipangleError as error:  # a check is worth no lost job
        return (f"what the steering delay does to the parameters cannot be told: {error}",)
    said = [
        f"{found.output} follows delta by {1000 * found.seconds:.0f} ms; what of that is delay of actuator or logger "
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
    parts = []
    for part in data.experiments:
        t = part.t
        parts.append(np.interp(t - delay, t, part["delta"]))
    return data.with_channel("delta", np.concatenate(parts), data.unit("delta"))


# ---- control -------------------------------------------------------------------------------------------------------


def drive(
    wanted: ControllerSettings, plant_settings: PlantSettings, model: Model, progress: Callable[[float], None]
) -> tuple[Run, str]:
    """Closed loop of an MPC on the identified model with the plant at a millisecond."""
    plant, driver, description = build_plant(plant_settings, model)
    controller = build_mpc(wanted, model)
    path = build_path(wanted)
    run = closed_loop(plant, controller, path, driver=driver, width=wanted.width, progress=progress)
    return run, description


def build_mpc(wanted: ControllerSettings, model: Model) -> MPC:
    """The controller; its model is re-discretised at the controller's step where it is an ODE."""
    if isinstance(model, Bicycle):
        model = replace(model, dt=wanted.dt, substeps=0, outputs=("v_y", "r"))
    elif not math.isclose(model.dt, wanted.dt, rel_tol=1e-6):
        raise ConfigError(
            f"[controller] works at {wanted.dt:g} s, the model '{wanted.model}' was identified at {model.dt:g} s; "
            f"expected the same: set rate = {1 / wanted.dt:g} in [data] or dt = {model.dt:g} in [controller]"
        )
    limit, rate = deg(wanted.delta_max), deg(wanted.delta_rate_max)
    return MPC(
        OnGround(model),
        horizon=wanted.horizon,
        steps=wanted.steps or None,
        controls=("delta",),
        Q=Weights(**wanted.Q),
        S=Weights(**wanted.S),
        limits=Limits(delta=(-limit, limit)),
        rates=Limits(delta=(-rate, rate)),
        solver=wanted.solver,
    )


def build_path(wanted: ControllerSettings) -> Path:
    """The manoeuvre's path with its lanes."""
    if wanted.manoeuvre == "lane-changes":
        return manoeuvres.lane_changes(wanted.v_x)
    return _MANOEUVRES[wanted.manoeuvre](wanted.v_x, width=wanted.width)


def build_plant(wanted: PlantSettings, model: Model) -> tuple[Plant, SpeedDriver, str]:
    """A single track with wheel spin and saturating tires: from the catalogue, or around the identified bicycle."""
    if wanted.catalogue:
        if wanted.catalogue not in _PLANTS:
            raise ConfigError(
                f"[plant] catalogue is '{wanted.catalogue}'; {nearest(wanted.catalogue, _PLANTS)}: use one of these"
            )
        params, tire = _PLANTS[wanted.catalogue]
        tires = (tire, tire)
        text = f"the catalogue car {wanted.catalogue} with wheel spin and Magic Formula tires"
    elif isinstance(model, Bicycle):
        params, tires = around(model.params, wanted.friction)
        text = (
            "a stand-in for the car: the identified mass, geometry and cornering stiffness on Magic Formula tires that "
            f"saturate at a friction coefficient of {wanted.friction:g}, with wheel spin"
        )
    else:
        raise ConfigError(
            "[plant] has no catalogue name and the controller's model is no bicycle; expected one of both"
        )
    car = SingleTrack(params=params, dt=0.001, tire_f=tires[0], tire_r=tires[1])
    noise = {**NOISE, **wanted.noise}
    reach = 0.8 * params.mass * GRAVITY * params.radius
    driver = SpeedDriver.for_car(mass=params.mass, radius=params.radius, limits=(-reach, 0.5 * reach))
    return Plant(car, noise=Values(**noise), seed=wanted.seed), driver, text


def around(
    p: BicycleParams, friction: float
) -> tuple[SingleTrackParams, tuple[SimpleMagicFormula, SimpleMagicFormula]]:
    """A single track whose tires have the bicycle's cornering stiffness near zero slip.

    Shape factors are typical of passenger-car tires (C = 1.3 across, 1.65 along, E = -0.5); the
    longitudinal stiffness is twice the cornering stiffness at equal load.
    """
    params = SingleTrackParams(
        **{
            name: getattr(p, name)
            for name in ("mass", "inertia_z", "wheelbase", "l_f", "steering_gain", "steering_offset")
        },
        inertia_wheel_f=2e-3 * p.mass,
        inertia_wheel_r=2e-3 * p.mass,
        radius=0.32,
    )

    def tire(axle_stiffness: float, load: float) -> SimpleMagicFormula:
        slope = axle_stiffness / (2 * load)  # friction coefficient per rad
        lateral = MagicCurve(B=slope / (1.3 * friction), C=1.3, D=friction, E=-0.5)
        along = MagicCurve(B=2 * slope / (1.65 * friction), C=1.65, D=friction, E=-0.5)
        return SimpleMagicFormula(longitudinal=along, lateral=lateral, combined="ellipse")

    return params, (tire(p.C_f, params.load_f), tire(p.C_r, params.load_r))


def _scores(scores: dict) -> dict[str, dict[str, float]]:
    return {k: {"fit": s.fit, "vaf": s.vaf, "rmse": s.rmse, "r2": s.r2} for k, s in scores.items()}


def _condition(model: Model) -> float | None:
    """Condition number of the fit, where it has one."""
    info = model.fit_info
    return info.condition if info is not None and len(info.names) > 1 and np.isfinite(info.condition) else None


def _parameters(model: Model) -> dict[str, dict[str, float]]:
    info = model.fit_info
    if info is None:
        return {}
    rows = zip(info.names, info.values, info.interval(), strict=True)
    return {n: {"value": float(v), "low": float(ci[0]), "high": float(ci[1])} for n, v, ci in rows}
