"""The first section of a job's page: what each model and the closed loop are worth, in sentences."""

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from slipangle import Run, Validation
from slipangle.identify.judge.validate import beyond_said
from slipangle.registry import Registry
from slipangle.report import Findings, Number, Section, Verdict
from slipangle.report.page import Block
from slipangle.report.robust import CHANGES
from slipangle.report.tables import Tone
from slipangle.simulate.run import SIDE
from slipangle.simulate.trials import ENOUGH
from slipangle.units import read_in, speed_said
from slipangle.workflow.drive import ControllerSettings
from slipangle.workflow.job import Outcome
from slipangle.workflow.overview import overview
from slipangle.workflow.robustness import Tried
from slipangle.workflow.settings import PublishedSettings

SECTIONS: Registry[Callable[[Outcome, str], Iterable[Section]]] = Registry("page section", "slipangle.sections")
"""Sections of a job's page in their order: functions of its outcome and the command that made it."""


@SECTIONS.register("verdict")
def _verdict_section(outcome: Outcome, command: str) -> Iterator[Section]:
    blocks: list[Block] = [*overview(outcome, command), *verdicts(outcome, command)]
    if outcome.failures:
        said = [f"{name}: {why}" for name, why in outcome.failures.items()]
        blocks.append(Findings.of("What could not be done", said, "poor"))
    yield Section(title="Verdict", blocks=tuple(blocks))


def verdicts(outcome: Outcome, command: str) -> Iterator[Verdict]:
    """One per model and output, and one of the closed loop."""
    published = {m.name: m.published for m in outcome.settings.model}
    for v in outcome.validations:
        for name in v.model.outputs:
            yield _model_verdict(outcome, v, name, published[v.name], command)
    if outcome.run is not None:
        yield _drive_verdict(outcome, outcome.run, command)


def _model_verdict(
    outcome: Outcome, v: Validation, name: str, published: PublishedSettings | None, command: str
) -> Verdict:
    score, stands = v.free_run_scores[name], v.standing[name]
    after = "" if outcome.opening is None else f", after an opening of {outcome.opening.duration:.3g} s"
    sentence = (
        f"Over {outcome.test.duration:.0f} s that it was not fitted to{after}, “{v.name}” fits, from inputs alone, "
        f"{stands.beside(spoken(name))}. {stands.reason[0].upper()}{stands.reason[1:]}."
    )
    warned = len(v.model.fit_info.warnings) if v.model.fit_info else 0
    if warned:
        sentence += (
            f" Trust its predictions more than its parameters: {warned} warning"
            f"{'s on them stand' if warned > 1 else ' on them stands'} below."
        )
    if name in v.free_run.astray:
        sentence += f" Do not use it: {v.free_run.astray[name]}."
    shown = ("fit", f"fit of {name}, free run", "%", 4), ("vaf", "VAF", "%", 4)
    factor, unit = read_in(name, outcome.data.unit(name))
    numbers = tuple(
        Number(
            label=label,
            value=(factor if key == "rmse" else 1.0) * getattr(score, key),
            unit=measure,
            digits=digits,
            reference=_scaled(getattr(published, key, None), factor if key == "rmse" else 1.0),
            reference_label=published.source if published else "",
        )
        for key, label, measure, digits in (*shown, ("rmse", "RMSE", unit, 3))
    )
    grown = [v.growth[name]] if name in v.growth else []
    for said in (*([v.misread] if v.misread else []), *grown, *beyond_said(v.free_run, name)):
        sentence += f" {said[0].upper()}{said[1:]}."
    tone: Tone = "poor" if name in v.free_run.astray else stands.word
    evidence = (f"Free run: {spoken(name)}", "Parameters", "Residuals")
    title = f"{v.name}, {spoken(name)}"
    return Verdict(title=title, sentence=sentence, tone=tone, numbers=numbers, command=command, evidence=evidence)


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value


def _drive_verdict(outcome: Outcome, run: Run, command: str) -> Verdict:
    wanted = outcome.settings.controller
    if wanted is None:
        raise AssertionError
    seconds = run.warm_seconds
    median, late = float(np.median(seconds)), float(np.percentile(seconds, 99))
    in_time = late < wanted.dt
    others = outcome.tried
    word: Tone = "good" if others is None else "fair" if others.trials is None else others.trials.word
    own: Tone = "poor" if not run.kept else "good" if run.fallbacks == 0 and in_time else "fair"
    order: tuple[Tone, ...] = ("good", "fair", "poor")
    tone = order[max(order.index(word), order.index(own))]
    named = {"mpc": "An MPC", "driver": "A driver"}.get(wanted.kind, f"The controller {wanted.kind}")
    if run.marked:
        where = "stays inside its lanes" if run.inside else "leaves its lanes"
    else:
        far = "keeps within" if run.max("y") <= SIDE else "goes farther than"
        where = f"{far} {100 * SIDE:.0f} cm from a path without lanes"
    if not run.finished:
        where += f", {run.s.max():.0f} of {run.path.length:.0f} m far, until {run.end.value}"
    sentence = (
        f"{named} on “{wanted.model}” drives {_driven(wanted)} {speed_said(wanted.v_x)} and {where}, "
        f"{100 * run.rmse('y'):.1f} cm (RMS) from the path. The plant is {outcome.plant}."
    )
    if run.fallbacks:
        sentence += f" {run.fallbacks} of {len(run.plans)} commands came from an older plan."
    driven = next((v.model for v in outcome.validations if v.name == wanted.model), None)
    for said in () if driven is None else run.beyond(driven):
        sentence += f" {said[0].upper()}{said[1:]}."
    if others is not None:
        sentence += f" {_on_others(others, run.marked)}"
    deadline = f"deadline {1000 * wanted.dt:g} ms, margin {100 * (1 - late / wanted.dt):.0f} %"
    numbers = (
        Number(label="lateral error, RMS", value=run.rmse("y"), unit="m", digits=3),
        Number(label="lateral error, largest", value=run.max("y"), unit="m", digits=3),
        Number(label="solver, median", value=1000 * median, unit="ms", digits=3),
        Number(label="solver, 99th percentile", value=1000 * late, unit="ms", digits=3, note=deadline),
    )
    if others is not None and others.trials is not None:
        note = f"of {len(others.trials)}; good needs {100 * ENOUGH:g} %"
        share = Number(label="cars inside", value=100 * others.trials.share, unit="%", digits=3, note=note)
        numbers = (*numbers, share)
    evidence = ("Controller in closed loop", "Cars that differ from the model")
    return Verdict(
        title="Closed loop", sentence=sentence, tone=tone, numbers=numbers, command=command, evidence=evidence
    )


def _driven(wanted: ControllerSettings) -> str:
    """What was driven, and how its speed is meant."""
    if wanted.track is not None:
        return f"the track “{wanted.track.name}” at up to"
    return f"{_MANOEUVRE[wanted.manoeuvre]} at"


def _on_others(others: Tried, marked: bool) -> str:
    """What cars that differ from the model do, in sentences."""
    trials = others.trials
    if trials is None:
        return f"It was not tried on cars that differ from the model: {others.why_not}."
    count, row, (name, gain) = len(trials), trials.worst, others.cause
    margin = trials.column("margin")[row]
    stay = "stay inside" if marked else "stay so near"
    said = f"{round(count * trials.share)} of {count} cars that differ from the model {stay}."
    end = f"{100 * margin:.0f} cm from its lane's edge" if margin >= 0 else "leaves its lanes"
    if not marked:
        end = f"{'' if margin >= 0 else 'goes '}{100 * (SIDE - margin):.0f} cm from its path"
    why = f", most of all by its {CHANGES[name][0]}" if gain > 0 else ""
    return f"{said} The worst of them {'stays ' if margin >= 0 else ''}{end}{why}. {trials.lacking}".strip()


_MANOEUVRE = {
    "iso3888-1": "the ISO 3888-1 double lane change",
    "iso3888-2": "the ISO 3888-2 obstacle avoidance",
    "lane-changes": "a sequence of lane changes",
}
_SPOKEN = {
    "r": "the yaw rate",
    "v_y": "the lateral velocity",
    "v_x": "the speed",
    "a_y": "the lateral acceleration",
    "beta": "the side slip angle",
}


def spoken(name: str) -> str:
    """A channel in words."""
    return _SPOKEN.get(name, f"the {name}")
