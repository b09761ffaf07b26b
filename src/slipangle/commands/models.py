"""``slipangle identify``, ``validate`` and ``compare``: models as files."""

from __future__ import annotations

import argparse
import math
import re
import warnings
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from slipangle.commands import Answer, Commands
from slipangle.commands.progress import Bar
from slipangle.errors import ConfigError, ModelWarning, SlipangleError
from slipangle.files import check_output, or_null, replaced

if TYPE_CHECKING:
    from slipangle.data.dataset import Dataset
    from slipangle.models.model import FitInfo, Model
    from slipangle.workflow.log import Logs
    from slipangle.workflow.settings import ModelSettings, Settings

_MANY = 40  # parameters that are told one by one
_FEW = 14  # of which it is said how they hang together


def add(commands: Commands) -> None:
    """Describe the commands."""
    sub = commands.add("identify", _identify, "fit the models of a job and keep each as a readable file")
    sub.add_argument("file", metavar="FILE.toml", help="a job, as for 'slipangle run'")
    sub.add_argument("--out", default="slipangle-out/models", help="folder for the models (default: %(default)s)")
    for name, function, text in (
        ("validate", _validate, "judge one model: free run beside one-step-ahead, residuals"),
        ("compare", _compare, "rank models by their free run, k steps ahead beside it"),
    ):
        data = "those of the job FILE.toml: its test part, or\nall of it with --whole, for a log that no model has seen"
        sub = commands.add(name, function, text, about=f"{text[0].upper()}{text[1:]}. The data are {data}.")
        sub.add_argument("models", metavar="MODEL.json", nargs="+" if name == "compare" else 1)
        sub.add_argument("--data", required=True, metavar="FILE.toml", help="the job whose data to use")
        sub.add_argument("--whole", action="store_true", help="use all of the data, not only the test part")
    sub.add_argument("--out", help="also write a page with the free runs and errors over the horizon there")


def _identify(options: argparse.Namespace) -> Answer:
    """Read the log that FILE.toml names, fit its models to the training part, and write each to a JSON file.

    'validate', 'compare' and slipangle.models.storage.load read it.
    """
    from slipangle.models.storage import save
    from slipangle.workflow.job import each_model, identify

    check_output(options.out)
    with Bar(quiet=options.json or options.quiet) as bar:
        settings, logs = read_job(options.file)

        fitted: dict[str, Model] = {}

        def fit(i: int, wanted: ModelSettings) -> Model:
            bar(i / len(settings.model), f"identifying {wanted.name}")
            fitted[wanted.name] = identify(wanted, logs, fitted)
            return fitted[wanted.name]

        models, failures = each_model(settings, fit)
    targets = _files(options.out, models)
    before = {name: replaced(path) for name, path in targets.items()}
    paths = {name: save(model, targets[name]) for name, model in models.items()}
    fits = {name: _fits(model, logs, settings) for name, model in models.items()}
    warned = {name: list(m.fit_info.warnings) if m.fit_info else [] for name, m in models.items()}
    words = []
    for name, path in paths.items():
        info = models[name].fit_info
        said = _confounding(info) if info is not None and 1 < len(info.names) <= _FEW else ""
        words += [f"{name}: {path}{before[name]}", *(f"  {line}" for line in (*_estimates(info), *fits[name].values()))]
        corrected = info.corrections if info is not None else ()
        words += [f"  {sentence}" for sentence in (said, *corrected, *warned[name]) if sentence]
    words += [f"{name}: failed. {why}" for name, why in failures.items()]
    if any(warned.values()):
        words.append('what a sentence means: slipangle help why "words of it"')
    listed: dict[str, dict] = {
        n: {"file": str(p), "replaced": bool(before[n]), "warnings": warned[n]} | _parameters(models[n].fit_info)
        for n, p in paths.items()
    }
    return Answer(listed | {n: {"failure": why} for n, why in failures.items()}, "\n".join(words), int(bool(failures)))


def _confounding(info: FitInfo) -> str:
    """How the estimates hang together; of a state space without physics that its states are one choice of many."""
    if math.isinf(info.condition) and not any(unit.strip(" -") for unit in info.units):
        return "other states give the same outputs: its poles mean something, single coefficients do not"
    return info.confounding


def _parameters(info: FitInfo | None) -> dict[str, dict]:
    """Estimates for machines, each with the ends of its 95 % interval, SI units; None where it has no end."""
    if info is None:
        return {}
    rows = zip(info.names, info.values.tolist(), info.interval().tolist(), strict=True)
    return {"parameters": {n: {"value": or_null(v), "interval": [*map(or_null, ends)]} for n, v, ends in rows}}


def _estimates(info: FitInfo | None) -> list[str]:
    """Estimates with their 95 % intervals; of a network's many weights only how many."""
    from slipangle.report.tables import number
    from slipangle.units import read_in

    if info is None or not info.names:
        return []
    if len(info.names) > _MANY:
        return [f"{len(info.names)} parameters"]
    units = info.units or ("",) * len(info.names)
    words = []
    for name, *ends, own in zip(info.names, info.values, *info.interval().T, units, strict=True):
        factor, unit = read_in(name, own)
        v, a, b = (number(factor * float(end)) for end in ends)
        words.append(f"{name:16} {v} {unit} (95 %: {a} to {b})")
    return words


def _fits(model: Model, logs: Logs, settings: Settings) -> dict[str, str]:
    """How the free run over the test part fits, by output; a model that runs away there says so."""
    from slipangle.identify.judge.validate import validate
    from slipangle.workflow.log import as_of_the_day

    with warnings.catch_warnings(action="ignore", category=ModelWarning):
        try:
            today = as_of_the_day(model, logs.opening)
            seen = validate(today, logs.test, train=logs.train, start=settings.data.start)
        except SlipangleError as error:
            return {"": f"on the test part: {error}"}
    scores = seen.free_run_scores.items()
    return {o: f"free run on the test part: {o} fit {s.fit:.2f} %, VAF {s.vaf:.2f} %" for o, s in scores}


def _validate(options: argparse.Namespace) -> Answer:
    from slipangle.identify.judge.validate import validate
    from slipangle.units import read_in
    from slipangle.workflow.job import plain

    name, file = Path(options.models[0]).stem, options.models
    with warnings.catch_warnings(action="ignore", category=ModelWarning):  # printed below
        (train, opening, test), start = _parts(options)
        (model,), read = _of_the_day(load_models(file), opening)
        verdict = validate(model, test, train=train, name=name, start=start)
    free, one_step = verdict.free_run_scores, verdict.one_step_scores
    stands = {output: s.sentence for output, s in verdict.standing.items()}
    said = [s for tests in verdict.residuals.values() for s in tests.sentences]
    words = []
    for kind, scores in (("free run", free), ("one-step-ahead", one_step)):
        for output, s in scores.items():
            factor, unit = read_in(output, verdict.free_run.unit(output))
            error = f"{factor * s.rmse:.4g} {unit}".removesuffix(" -")
            words.append(f"{kind:16} {output:8} fit {s.fit:7.2f} %   VAF {s.vaf:7.2f} %   RMSE {error}   R2 {s.r2:.4f}")
    numbers = {"free_run": plain(free), "one_step_ahead": plain(one_step), "residuals": said, "standing": stands}
    return Answer(numbers | ({"opening": read} if read else {}), "\n".join([*read, *words, *stands.values(), *said]))


def _compare(options: argparse.Namespace) -> Answer:
    from slipangle.identify.judge.compare import compare
    from slipangle.report.comparison import comparison_page

    if options.out:
        check_output(options.out)
    (train, opening, test), start = _parts(options)
    with warnings.catch_warnings(action="ignore", category=ModelWarning):  # printed below
        loaded = load_models(options.models)
        models, read = _of_the_day(loaded, opening)
        today = dict(zip(loaded, models, strict=True))
        result = compare(today, test, start="first samples" if start is None else start)
        page, before = None, ""
        if options.out:
            target = Path(options.out) / "index.html"
            before = replaced(target)
            page = comparison_page(result, test, train=train, command=options.said).write(target)
    rows = [
        {"model": e.name}
        | {"free_run": {o: {"fit": s.fit, "vaf": s.vaf, "rmse": s.rmse} for o, s in e.scores.items()}}
        | ({"failure": e.failure} if e.failure else {})
        | ({"warnings": list(e.warnings)} if e.warnings else {})
        for e in result.entries
    ]
    words = [*read, f"free run on {result.n_samples} samples of {result.data_name}, the best first"]
    for entry in result.entries:
        scores = "   ".join(f"{o}: fit {s.fit:.2f} %, VAF {s.vaf:.2f} %" for o, s in entry.scores.items())
        words += [f"{entry.name:28} {scores or entry.failure}", *(f"  {sentence}" for sentence in entry.warnings)]
    return Answer(rows, "\n".join([*words, *([f"\nThe page: {page.resolve()}{before}"] if page is not None else [])]))


def read_job(file: str) -> tuple[Settings, Logs]:
    """Settings of a job and its logs as they are identified from."""
    from slipangle.workflow.log import read_logs
    from slipangle.workflow.settings import read_settings

    settings = read_settings(file)
    return settings, read_logs(settings)


_Parts = tuple["Dataset | None", "Dataset | None", "Dataset"]


def _parts(options: argparse.Namespace) -> tuple[_Parts, int | None]:
    """Training part, where the data are to be parted, opening and what to judge on, and from how many samples."""
    from slipangle.workflow.log import opened

    settings, logs = read_job(options.data)
    parts = (None, *opened(logs.data, settings)) if options.whole else (logs.train, logs.opening, logs.test)
    return parts, settings.data.start


def _of_the_day(models: dict[str, Model], opening: Dataset | None) -> tuple[list[Model], list[str]]:
    """The models as they are in a recording with that opening, and what they read from it, in sentences."""
    from slipangle.workflow.log import as_of_the_day

    own = [as_of_the_day(model, opening) for model in models.values()]
    read = [
        f"{name}: {today.fit_info.corrections[-1]}"
        for (name, model), today in zip(models.items(), own, strict=True)
        if today is not model and today.fit_info is not None
    ]
    return own, read


def load_models(files: list[str]) -> dict[str, Model]:
    """Saved models by the names of their files, those that share one by their paths."""
    from slipangle.models.model import Model
    from slipangle.models.storage import load

    stems = Counter(Path(file).stem for file in {*files})
    models: dict[str, Model] = {}
    for file in files:
        record = load(file)
        if not isinstance(record, Model):
            raise ConfigError(
                f"'{file}' holds a {type(record).__name__}; expected a model: name a file that 'slipangle identify' "
                "wrote"
            )
        stem = Path(file).stem
        models[stem if stems[stem] == 1 else str(Path(file).with_suffix(""))] = record
    return models


def _files(folder: str, names: Iterable[str]) -> dict[str, Path]:
    """A file for each model, by its name; those that would have the same one are numbered."""
    taken: dict[str, Path] = {}
    for name in names:
        stem, count = _slug(name), 1
        while (path := Path(folder) / f"{stem}{'' if count == 1 else f'-{count}'}.json") in taken.values():
            count += 1
        taken[name] = path
    return taken


def _slug(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "model"
