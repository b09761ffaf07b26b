"""A job's controller on cars that differ from its model: some for the verdict, thousands for ``slipangle robust``."""

from __future__ import annotations

import contextlib
import hashlib
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from slipangle.codegen.compiler import compiler
from slipangle.control.controller import Controller
from slipangle.control.driver import Driver
from slipangle.errors import ConfigError, SlipangleError
from slipangle.export import build, load
from slipangle.identify.search.pool import Cluster, Local, Report, Task, Value
from slipangle.models.model import Model
from slipangle.models.provenance import content
from slipangle.optimal.terms import Values
from slipangle.report import Figure, Number, Page, Section, Verdict
from slipangle.report.robust import CHANGES, breaking_map, shares_by_change, worst_cars
from slipangle.simulate.robust import Trial, cause, try_on
from slipangle.simulate.trials import COLUMNS, ENOUGH, Trials
from slipangle.workflow.drive import (
    NOISE,
    ControllerSettings,
    EstimatorSettings,
    PlantSettings,
    build_path,
    catalogued,
    identified_bicycle,
    late,
    plant_chassis,
    require_effect,
    whole_driver,
)
from slipangle.workflow.log import Logs
from slipangle.workflow.settings import Settings
from slipangle.workflow.tires import TIRES, equivalent, plant_tires

ACCELEROMETER = 0.1  # m/s2, standard deviation of its noise
BATCH = 50  # cars side by side
WORTH = 20_000  # plans of all cars from which on it pays to compile their driver


@dataclass(frozen=True, kw_only=True)
class Tried:
    """What came of the cars, and which change made the worst one what it is; or why none were driven."""

    trials: Trials | None = None
    cause: tuple[str, float] = ("", 0.0)
    why_not: str = ""


def trial_of(
    wanted: ControllerSettings,
    plant: PlantSettings,
    model: Model,
    controller: Controller | Driver,
    estimator: EstimatorSettings | None = None,
) -> Trial:
    """The controller, its path, and the car that others are drawn around; a driver has the job's estimator.

    Raises SlipangleError with the reason where there is no such car or the controller needs more than it measures.
    """
    if plant.kind:
        raise ConfigError("a vehicle from outside cannot be perturbed; expected a plant of the toolbox: leave kind out")
    known, tires = identified_bicycle(model), plant_tires(plant, model)
    if not tires:
        require_effect(plant)
    if tires:
        bicycle, friction = equivalent(plant, plant_chassis(plant, model), tires)
    elif plant.catalogue:
        bicycle, friction = catalogued(plant.catalogue)
    elif known is not None:
        bicycle, friction = known, plant.friction
    else:
        raise ConfigError("there is no car to perturb; expected a bicycle's model or a catalogue name in [plant]")
    times = Values() if plant.catalogue else late(model, "delay_delta"), late(model, "steering_lag")
    return Trial(
        controller=whole_driver(controller, None, estimator) if isinstance(controller, Driver) else controller,
        path=build_path(wanted),
        bicycle=bicycle,
        friction=friction,
        noise=Values(**{**NOISE, "a_y": ACCELEROMETER, **plant.noise}),
        delay=times[0].get("delta", 0.0),
        lag=0.0 if plant.catalogue else times[1].get("delta", 0.0),
        width=wanted.width,
        seed=plant.seed,
    )


def tried(
    wanted: ControllerSettings,
    plant: PlantSettings,
    model: Model,
    controller: Controller | Driver,
    progress: Callable[[float], None],
    estimator: EstimatorSettings | None = None,
) -> Tried | None:
    """The controller on as many cars as the job says; None on a vehicle from outside, which is no model of ours."""
    if plant.kind or not wanted.cars:
        return None
    if compiler() is None:
        return Tried(why_not="that needs a C compiler")
    try:
        numbers = range(wanted.cars)
        with compiled(trial_of(wanted, plant, model, controller, estimator), len(numbers)) as trial:
            trials = try_on(trial, numbers, progress=progress)
            return Tried(trials=trials, cause=cause(trial, trials, numbers, trials.worst))
    except SlipangleError as error:
        return Tried(why_not=str(error))


@contextmanager
def compiled(trial: Trial, cars: int) -> Iterator[Trial]:
    """The trial with its driver compiled for as long, where that is worth it and the driver has C."""
    with tempfile.TemporaryDirectory(prefix="slipangle-") as folder:
        built = None
        if isinstance(trial.controller, Driver) and cars * trial.steps >= WORTH and compiler() is not None:
            with contextlib.suppress(SlipangleError):  # a part of it has no C: it is driven in Python
                built = load(build(trial.controller, Path(folder) / "driver"))
        yield replace(trial, built=built)


# ---- many ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Batches:
    """The objective of a pool: drives the cars from one number to another and reports what came of them."""

    trial: Trial

    def __call__(self, settings: Mapping[str, Value], seed: int, report: Report) -> float:
        """Share of the cars that stayed in their lanes; all results are reported one after another."""
        trials = try_on(self.trial, range(int(settings["first"]), int(settings["last"])))
        for value in trials.results.ravel():
            report(float(value))
        return trials.share


def try_many(
    trial: Trial,
    cars: int,
    journal: Path,
    signature: str,
    *,
    workers: int = 2,
    cluster: str | None = None,
    progress: Callable[[float, str], None] = lambda share, what: None,
) -> Trials:
    """Cars in batches on local processes or a Ray cluster; finished batches are kept in the journal.

    Raises ConfigError if the journal is of another trial, or a batch cannot be computed.
    """
    kept = _read(journal, signature)
    edges = [(a, min(a + BATCH, cars)) for a in range(0, cars, BATCH)]
    tasks = [
        Task(number=k, settings={"first": a, "last": b}, seed=trial.seed)
        for k, (a, b) in enumerate(edges)
        if len(kept.get(k, ())) < b - a
    ]
    done = len(edges) - len(tasks)
    if tasks:
        pool: Any = Cluster(cluster) if cluster else Local(workers)
        try:
            with journal.open("a", encoding="utf-8") as file:
                for k, rows in _worked(pool, Batches(trial=trial), tasks):
                    kept[k] = rows
                    file.write(json.dumps({"batch": k, "rows": rows.tolist()}) + "\n")
                    file.flush()
                    done += 1
                    inside = float(np.mean(np.concatenate(list(kept.values()))[:, 0]))
                    progress(
                        done / len(edges), f"{min(done * BATCH, cars)} of {cars} cars, {100 * inside:.1f} % inside"
                    )
        finally:
            pool.close()
    results = np.concatenate([kept[k][: b - a] for k, (a, b) in enumerate(edges)])
    changes = trial.spread.draw(range(cars), trial.seed)
    return Trials(names=trial.spread.names, changes=changes, results=results, without=trial.without)


def _worked(pool: Any, objective: Batches, tasks: Sequence[Task]) -> Iterator[tuple[int, np.ndarray]]:
    for number, done in pool.work(objective, tasks):
        if done["failure"]:
            raise ConfigError(f"cars from number {number * BATCH} on could not be driven: {done['failure'][:300]}")
        yield number, np.array(done["steps"]).reshape(-1, len(COLUMNS))


def _read(journal: Path, signature: str) -> dict[int, np.ndarray]:
    """Finished batches; a last line that was cut off is left out. Makes the journal where there is none."""
    if not journal.exists():
        journal.write_text(json.dumps({"signature": signature}) + "\n", encoding="utf-8")
        return {}
    kept: dict[int, np.ndarray] = {}
    lines = journal.read_text(encoding="utf-8", errors="replace").splitlines()
    try:
        same = json.loads(lines[0])["signature"] == signature
    except (ValueError, IndexError, KeyError, TypeError):
        same = False
    if not same:
        raise ConfigError(
            f"'{journal}' keeps cars of another job, log or seed; expected the same: name another folder with --out"
        )
    for line in lines[1:]:
        try:
            entry = json.loads(line)
            kept[int(entry["batch"])] = np.array(entry["rows"], dtype=float).reshape(-1, len(COLUMNS))
        except (ValueError, KeyError, TypeError):
            continue
    text = journal.read_text(encoding="utf-8", errors="replace")
    if not text.endswith("\n"):
        with journal.open("a", encoding="utf-8") as file:
            file.write("\n")
    return kept


def signature_of(file: Path, settings: Settings, logs: Logs, seed: int) -> str:
    """What a journal belongs to: the job as written, the data and files it names, the seed, the size of the batches."""
    tables = [model.entries for model in settings.model] + [vars(settings.plant), vars(settings.controller)]
    named = [v for table in tables for key, v in table.items() if isinstance(v, Path) or (key in TIRES and v)]
    files = b"".join(path.read_bytes() for path in map(Path, (file, *named)) if path.is_file())
    data = [content(each) for each in (logs.train, *logs.others.values())]
    return hashlib.sha256(files + f"{data} {seed} {BATCH}".encode()).hexdigest()


# ---- the page ------------------------------------------------------------------------------------------------------


def sentence(trials: Trials) -> str:
    """What the cars say of the controller."""
    row = trials.worst
    most = next(iter(trials.influence))
    share, margin = round(len(trials) * trials.share), float(trials.column("margin")[row])
    return (
        f"{share} of {len(trials)} cars that differ from the model stay inside their lanes, "
        f"{100 * trials.share:.1f} %; good needs {100 * ENOUGH:g} %. The margin goes most with the {CHANGES[most][0]}; "
        f"car {row} is the worst, {abs(margin):.2f} m {'inside' if margin >= 0 else 'outside'}. {trials.lacking}"
    ).strip()


def page(trials: Trials, settings: Settings, command: str) -> Page:
    """Verdict, the map of what breaks it, shares by each change, the worst cars."""
    influence = "; ".join(f"{CHANGES[n][0]} {100 * v:.0f} %" for n, v in list(trials.influence.items())[:4])
    verdict = Verdict(
        title="On cars that differ from the model",
        sentence=sentence(trials),
        tone=trials.word,
        numbers=(
            Number(label="cars inside", value=100 * trials.share, unit="%", digits=4),
            Number(label="smallest margin", value=float(trials.column("margin").min()), unit="m", digits=3),
            Number(label="reached the end", value=100 * float(trials.column("finished").mean()), unit="%", digits=4),
        ),
        command=command,
    )
    figures = (
        Figure(
            title="What breaks it",
            figure=breaking_map(trials),
            caption=f"One mark per car, over the two changes that its margin goes with most. Share of the margin's "
            f"variance: {influence}.",
        ),
        Figure(
            title="Share inside, change by change",
            figure=shares_by_change(trials),
            caption="All other changes vary too. Bands: 95 % of what so many cars tell; dotted: what good needs.",
        ),
    )
    blocks = (verdict, *figures, worst_cars(trials))
    title = f"{settings.title}: robustness"
    return Page(title=title, sections=(Section(title="Robustness", blocks=blocks),), command=command)
