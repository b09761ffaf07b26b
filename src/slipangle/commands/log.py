"""``slipangle inspect`` and ``slipangle advise``: what a log is worth, and what to drive next."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from slipangle.commands import Answer, Commands
from slipangle.commands.models import load_models, read_job
from slipangle.commands.progress import Bar
from slipangle.errors import ConfigError

if TYPE_CHECKING:
    from slipangle.data.dataset import Dataset
    from slipangle.data.quality.survey import Survey
    from slipangle.models.model import Model

_CAR = ("delta", "v_x", "r")  # what ties the channels of a car's log together
_ABOUT = """\
Say what is in a log, with rates, units, ranges and gaps, and which columns look like the channels of a car's model, in
the words of a job; then what spoils an identification: spikes, jumps, clipping, offsets, delay and lag, poor
excitation, and channels that contradict each other in sign, unit or time. Nothing is changed or repaired.

FILE is a job, whose log is then read as it says, or a log itself, with --channel for what its headings do not say.
"""
_MORE = """\
With --json: samples, dt, duration, doubts, sentences, and delays with seconds, pure, lag and their deviations.
Exit code 1 if channels contradict each other.
"""
_ADVISE = """\
Say which manoeuvre would determine a fitted model's parameters better: steps, sweeps, ramps and random sequences
within what the car did in the log, simulated with the model and ranked by the Fisher information they add.

FILE is a job, whose first model that can be asked is fitted, or a model that 'slipangle identify' saved, with --data.
"""


def add(commands: Commands) -> None:
    """Describe the commands."""
    sub = commands.add("inspect", _inspect, "what is wrong with a log, before a fit", about=_ABOUT, more=_MORE)
    sub.add_argument("file", metavar="FILE", help="a log, or a job as for 'slipangle run'")
    sub.add_argument(
        "--channel",
        action="append",
        default=[],
        metavar="NAME=HEADING[:UNIT]",
        help="where a channel stands in a log, such as delta=steer:deg; once for each",
    )
    sub.add_argument(
        "--wheelbase",
        type=float,
        metavar="M",
        help="ties steering to yaw rate: signs and units; by default the job's first car's",
    )
    more = "With --json: a list of manoeuvre, parameter, before, after, unit, helps, sentence, the best first."
    sub = commands.add("advise", _advise, "what to drive next, for narrower intervals", about=_ADVISE, more=more)
    sub.add_argument("file", metavar="FILE", help="a job FILE.toml, or a saved MODEL.json")
    sub.add_argument("--data", metavar="FILE.toml", help="the job that a saved model was fitted with")
    sub.add_argument("--parameter", metavar="NAME", help="which one to care about; by default the least known")
    sub.add_argument("--duration", type=float, default=20.0, metavar="S", help="of each manoeuvre (20)")
    sub.add_argument("--best", type=int, default=5, metavar="N", help="how many manoeuvres to tell (5)")


def _inspect(options: argparse.Namespace) -> Answer:
    from slipangle.commands.init import where
    from slipangle.data.quality.inspect import inspect
    from slipangle.data.quality.plausible import doubts

    seen, data, wheelbase = _log(options)
    report = inspect(data)
    said: tuple[str, ...] = ()
    missing = [name for name in _CAR if name not in data]
    if options.wheelbase is not None and missing:
        raise ConfigError(
            f"--wheelbase ties delta, v_x and r together, and the log has no {', '.join(missing)}; expected all three: "
            "name them with --channel, or leave --wheelbase out"
        )
    if wheelbase is not None and not missing:
        said = doubts(data, wheelbase=wheelbase)
        ratio = next((g.column.ratio for g in seen.guesses if g.channel == "delta"), 1.0) if seen else 1.0
        if said and ratio != 1:  # a guess that may be what is wrong: what the log itself says
            said = doubts(data.with_channel("delta", ratio * data["delta"], "rad"), wheelbase=wheelbase)
    unchecked = (
        () if wheelbase is not None or missing else ("signs and units of the channels are checked with --wheelbase",)
    )
    names = ("input", "output", "seconds", "clear", "apart", "pure", "pure_std", "lag", "lag_std", "sentence")
    delays = [{n: _plain(getattr(d, n)) for n in names} for d in report.delays]
    found = {"samples": report.samples, "dt": report.dt, "duration": report.duration, "doubts": list(said)}
    found |= {"sentences": list(report.sentences), "delays": delays}
    found |= {"channels": [asdict(c) for c in seen.channels] if seen else []}
    found |= {"columns": {g.channel: g.line for g in seen.guesses} if seen else {}}
    unseen = [n for n in _CAR if n not in data] if seen and seen.guesses else []
    lost = f"no column looks like {', '.join(unseen)}: name it with {where(unseen, seen)}" if seen and unseen else ""
    told = (*seen.sentences, *filter(None, [lost]), "", "read so, the log says:") if seen else ()
    words = (*told, *(f"contradiction: {s}" for s in said), *report.sentences, *unchecked)
    return Answer(found, "\n".join(words), int(bool(said)))


def _plain(value: Any) -> Any:
    """A number that JSON has, or none."""
    return None if isinstance(value, float) and not abs(value) < float("inf") else value


def _log(options: argparse.Namespace) -> tuple[Survey | None, Dataset, float | None]:
    """What is in a log that nothing else is said of, the log, and the wheelbase where one was given. [m]"""
    from slipangle.commands.init import said_channel
    from slipangle.data.quality.survey import survey
    from slipangle.data.readers import open_log, read
    from slipangle.workflow.log import load_data
    from slipangle.workflow.settings import read_settings

    wheelbase = options.wheelbase
    if wheelbase is not None and not 0 < wheelbase < 30:
        raise ConfigError(f"--wheelbase is {wheelbase:g} m; expected a number between 0 and 30: give it in metres")
    if options.file.endswith(".toml"):
        if options.channel:
            raise ConfigError("--channel is for logs, and a job names its columns itself: change them in the job")
        settings = read_settings(options.file)
        tables = [t for m in settings.model for t in (m.entries, m.entries.get("car")) if isinstance(t, Mapping)]
        own = next((float(t["wheelbase"]) for t in tables if "wheelbase" in t), None)
        return None, load_data(settings), own if wheelbase is None else wheelbase
    columns = {g.channel: g.column for g in map(said_channel, options.channel)}
    log, seen = open_log(options.file), None
    if columns or log.meta:
        data = read(options.file, columns or None)
    else:
        seen = survey(log)
        nan = "merge" if any(line.startswith("nan") for line, _ in seen.settings) else "gap"
        uneven = any(line.startswith("jitter") for line, _ in seen.settings)
        how: dict[str, Any] = {"jitter": 1.0} if uneven else {}
        data = read(options.file, seen.columns() or None, time=seen.time, nan=nan, **how)
    if data.inputs and data.outputs:
        return seen, data, wheelbase
    inputs = data.inputs or tuple(n for n in ("delta", "v_x") if n in data)
    outputs = data.outputs or tuple(n for n in ("r", "v_y", "a_y") if n in data and n not in inputs)
    return seen, data.select(inputs=inputs, outputs=outputs), wheelbase


def _advise(options: argparse.Namespace) -> Answer:
    from slipangle.identify.physics.advise import advise

    if options.best < 1:
        raise ConfigError(f"--best is {options.best}; expected how many manoeuvres to tell, 1 or more")
    with Bar(quiet=options.json or options.quiet) as bar:
        model, train = _fitted(options, bar)
        bar(0.5, "simulating manoeuvres")
        every = advise(model, train, parameter=options.parameter, duration=options.duration)
    ranked = every[: options.best]
    names = ("manoeuvre", "parameter", "before", "after", "unit", "helps", "sentence")
    rows = [{n: _plain(getattr(a, n)) for n in names} for a in ranked]
    words = [a.sentence if a.helps else f"{a.sentence}, which helps little" for a in ranked]
    return Answer(rows, "\n".join(words) or "no manoeuvre stays within what the car did in the log")


def _fitted(options: argparse.Namespace, bar: Bar) -> tuple[Model, Dataset]:
    """A model with its intervals, and what it was fitted to."""
    from slipangle.identify.car.identify_car import WholeCar
    from slipangle.workflow.job import identify
    from slipangle.workflow.kinds import KINDS, Physics

    job = options.file if options.file.endswith(".toml") else options.data
    if job is None:
        raise ConfigError("advice needs the log that the model was fitted to; expected --data FILE.toml with it")
    settings, logs = read_job(job)
    if not options.file.endswith(".toml"):
        return next(iter(load_models([options.file]).values())), logs.train
    wanted = next((m for m in settings.model if isinstance(k := KINDS[m.kind], Physics) or k is WholeCar), None)
    if wanted is None:
        raise ConfigError(
            f'no model of \'{job}\' has physical parameters; expected one such as kind = "car" or "bicycle"'
        )
    bar(0.0, f"identifying {wanted.name}")
    return identify(wanted, logs), logs.train
