"""What shows itself in a notebook: `table`, one per kind of result, and one for all settings and records."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from typing import Any

import numpy as np

from slipangle.control.phases import PhasedPlan
from slipangle.data.dataset import Dataset
from slipangle.data.quality.inspect import DataReport
from slipangle.data.readers.recording import Recording
from slipangle.errors import ParameterError
from slipangle.identify.car.identify_car import IdentifiedCar
from slipangle.identify.judge.compare import Comparison, CrossValidation, Fold
from slipangle.identify.judge.scores import Score
from slipangle.identify.judge.validate import Validation
from slipangle.identify.linear.statespace import OrderChoice
from slipangle.identify.physics.advise import Advice
from slipangle.identify.search.search import SearchResult
from slipangle.models.model import FitInfo, Model, Trajectory
from slipangle.optimal.lap.driven import DrivenLap, LapDelta
from slipangle.optimal.lap.lap import Lap
from slipangle.optimal.solution import Plan
from slipangle.paths.path import Path
from slipangle.report.lap import sector_table
from slipangle.report.meanings import meaning, summary
from slipangle.report.parameters import parameter_table
from slipangle.report.robust import worst_cars
from slipangle.report.search import search_table
from slipangle.report.style import pretty_unit
from slipangle.report.tables import Heading, Row, ScoreRow, Table, score_table
from slipangle.shown import Brief, said
from slipangle.simulate.run import Run
from slipangle.simulate.trials import Trials
from slipangle.units import read_in

UNITS = {"r": "rad/s", "a_y": "m/s2", "a_x": "m/s2", "beta": "rad", "psi": "rad", "delta": "rad", "X": "m", "Y": "m"}
UNITS |= {"v_x": "m/s", "v_y": "m/s", "e_y": "m", "e_psi": "rad", "e_course": "rad", "e_v": "m/s", "s": "m"}


def _sentences(*said: str) -> str:
    """Each with a capital and a full stop."""
    return " ".join(f"{s[:1].upper()}{s[1:].rstrip('.')}." for s in said if s)


def _facts(title: str, rows: Sequence[tuple[str, Any, str]], caption: str = "") -> Table:
    """A table of names, values and units."""
    columns = Heading("", words=True), Heading("value"), Heading("unit", words=True)
    return Table(
        title=title, columns=columns, rows=tuple(Row((n, v, pretty_unit(u))) for n, v, u in rows), caption=caption
    )


@singledispatch
def table(result: Any) -> Table:
    """The table of a result."""
    raise ParameterError(f"a {type(result).__name__} has no table; expected a result of the toolbox")


@table.register
def _(result: Dataset) -> Table:
    rows = []
    for channel in result.channels:
        factor, unit = read_in(channel.name, channel.unit)
        x = factor * result[channel.name]
        role = "input" if channel.name in result.inputs else "output" if channel.name in result.outputs else ""
        rows.append(Row((channel.name, role, x.min(), x.mean(), x.max(), x.std(), pretty_unit(unit))))
    columns = Heading("channel", words=True), Heading("role", words=True)
    numbers = tuple(Heading(n) for n in ("lowest", "mean", "highest", "std"))
    return Table(
        title=f"{result.name}: {result._words()}",
        columns=(*columns, *numbers, Heading("unit", words=True)),
        rows=tuple(rows),
        caption=_sentences(*result.notes),
    )


@table.register
def _(result: Brief) -> Table:
    about = type(result)
    units = {n: (si.unit, f"{si.doc[0].upper()}{si.doc[1:]}.") for n, si in getattr(about, "metadata", dict)().items()}
    rows = []
    for name, value, _ in result._entries():
        explained = filter(None, (meaning(home, name) for home in (about, *result._explained_by)))
        unit, doc = units.get(name) or ("", next(explained, ""))
        rows.append(Row((name, said(value), pretty_unit(unit), doc)))
    columns = Heading("", words=True), Heading("value", words=True), Heading("unit", words=True)
    columns = *columns, Heading("meaning", words=True)
    return Table(title=about.__name__, columns=columns, rows=tuple(rows), caption=summary(about).replace("`", ""))


@table.register
def _(result: FitInfo) -> Table:
    return parameter_table(result)


@table.register
def _(result: Model) -> Table:
    if result.fit_info is not None:
        return parameter_table(result.fit_info, title=f"{type(result).__name__}, fitted")
    rows = [(n, ", ".join(getattr(result, n)[:8]), "") for n in ("inputs", "outputs", "states")]
    value: Any = getattr(result, "value", None)
    own = getattr(result, "parameter_names", ()) if value is not None else ()
    given: Any = result
    numbers = [(n, float(given.value(n)), given.si(n).unit) for n in own]
    return _facts(type(result).__name__, [*rows, ("sample time", result.dt, "s"), *numbers])


@table.register
def _(result: Trajectory) -> Table:
    kept = result.error[result.predicted]
    rows = []
    for i, n in enumerate(result.outputs):
        factor, unit = read_in(n, result.unit(n))
        rows.append((f"RMS error of {n}", factor * float(np.sqrt(np.mean(kept[:, i] ** 2))), unit))
    return _facts(f"Trajectory, {result._words()}", rows, " ".join(result.astray.values()))


@table.register
def _(result: Validation) -> Table:
    rows = [
        _scored(result.name, n, run.unit(n), kind, s[n], _tone(result, n))
        for n in result.model.outputs
        for kind, run, s in (
            ("free run", result.free_run, result.free_run_scores),
            ("one-step-ahead", result.one_step, result.one_step_scores),
        )
    ]
    said = " ".join(f"{n}: {s.sentence}." for n, s in result.standing.items())
    return score_table(rows, title=f"Verdict on {result.name}", caption=said)


def _scored(model: str, name: str, unit: str, kind: str, score: Score, tone: Any = None) -> ScoreRow:
    """A score with its RMSE in the unit that people read."""
    factor, read = read_in(name, unit)
    numbers = {**vars(score), "rmse": factor * score.rmse}
    return ScoreRow(model=model, channel=name, unit=read, kind=kind, tone=tone, **numbers)


def _tone(result: Validation, name: str) -> Any:
    return result.standing[name].word if name in result.standing else None


@table.register
def _(result: Comparison) -> Table:
    rows = [
        _scored(e.name, n, e.free_run.unit(n), "free run", e.scores[n])
        for e in result.entries
        if e.free_run is not None
        for n in result.outputs
    ]
    failed = " ".join(f"{e.name} failed: {e.failure}." for e in result.entries if e.failure)
    return score_table(rows, title=f"Ranking on {result.data_name}, {result.n_samples} samples", caption=failed)


@table.register
def _(result: IdentifiedCar) -> Table:
    said = _sentences(*result.sentences)
    found = parameter_table(result.model.fit_info, title="The identified car")
    return Table(title=found.title, columns=found.columns, rows=found.rows, caption=said)


@table.register
def _(result: Run) -> Table:
    rows: list[tuple[str, Any, str]] = [
        ("distance from the path, RMS", result.rmse("y"), "m"),
        ("distance from the path, largest", result.max("y"), "m"),
        ("time of the drive", float(result.t[-1] - result.t[0]), "s"),
        ("inside the lanes", result.inside if result.marked else "none are marked", ""),
    ]
    if len(result.plans):
        late = 1000 * float(np.percentile(result.warm_seconds, 99))
        rows += [("solver, 99th percentile", late, "ms"), ("commands of an older plan", result.fallbacks, "")]
    return _facts("Closed loop", rows, _sentences(result.end.value))


@table.register
def _(result: Plan) -> Table:
    columns = Heading("from", "s", words=True), *(Heading(n) for n in result.controls)
    times = np.arange(len(result.u)) if result.times is None else result.times[:-1]
    if result.times is None:
        columns = Heading("stage", words=True), *columns[1:]
    rows = (Row((f"{t:.4g}", *map(float, u))) for t, u in zip(times, result.u, strict=True))
    caption = f"{result.status.name}: {result.status.value}. {1000 * result.seconds:.3g} ms, cost {result.cost:.6g}."
    return Table(title="Plan", columns=columns, rows=tuple(rows), caption=caption)


@table.register
def _(result: PhasedPlan) -> Table:
    columns = Heading("phase", words=True), Heading("from", "s"), Heading("to", "s"), Heading("stages")
    columns = *columns, Heading("inputs", words=True), Heading("states", words=True)
    rows = (
        Row((f"{k}", float(p.times[0]), float(p.times[-1]), len(p.u), ", ".join(p.controls), ", ".join(p.states)))
        for k, p in enumerate(result.phases, 1)
    )
    caption = f"{result.status.name}: {result.status.value}. {1000 * result.seconds:.3g} ms, cost {result.cost:.6g}."
    return Table(title="Plan of several phases", columns=columns, rows=tuple(rows), caption=caption)


@table.register
def _(result: CrossValidation) -> Table:
    rows = [
        _scored(f"without {spans(fold)}", n, fold.units[n], "free run", score)
        for fold in result.folds
        for n, score in fold.scores.items()
    ]
    failed = " ".join(f"Fold {k + 1} failed: {fold.failure}." for k, fold in enumerate(result.folds) if fold.failure)
    return score_table(rows, title=f"Cross-validation, {len(result.folds)} folds", caption=failed)


def spans(fold: Fold) -> str:
    """The experiments that a fold leaves out, by their times."""
    return ", ".join(f"{a:.4g} to {b:.4g} s" for a, b in fold.spans)


@table.register
def _(result: OrderChoice) -> Table:
    columns = Heading("order", words=True), Heading("error on held-out data", "-")
    rows = (
        Row((f"{n}", float(e)), tone="good" if n == result.order else None)
        for n, e in zip(result.orders, result.errors, strict=True)
    )
    caption = _sentences(result.said, *result.failures)
    return Table(title="Choice of the order", columns=columns, rows=tuple(rows), caption=caption)


@table.register
def _(result: Advice) -> Table:
    columns = Heading("parameter", words=True), Heading("standard deviation now"), Heading("with it")
    rows = []
    for n, own, a, b in zip(result.names, result.units, result.present, result.std, strict=True):
        factor, unit = read_in(n, own)
        rows.append(Row((n, factor * float(a), factor * float(b), pretty_unit(unit))))
    return Table(
        title="Advice",
        columns=(*columns, Heading("unit", words=True)),
        rows=tuple(rows),
        caption=_sentences(result.sentence),
    )


@table.register
def _(result: DataReport) -> Table:
    rows = [Row((getattr(f, "channel", ""), f.sentence)) for f in result.findings if f.sentence]
    columns = Heading("channel", words=True), Heading("what was seen", words=True)
    caption = _sentences(result.clock_sentence, *result.notes)
    return Table(title=f"What is in {result.name}", columns=columns, rows=tuple(rows), caption=caption)


@table.register
def _(result: Recording) -> Table:
    rows = [Row((h.name, topic, pretty_unit(h.unit or ""))) for topic, t in result.tables.items() for h in t.headers]
    columns = Heading("channel", words=True), Heading("clock", words=True), Heading("unit", words=True)
    return Table(title=result.name, columns=columns, rows=tuple(rows), caption=_sentences(*result.notes))


@table.register
def _(result: SearchResult) -> Table:
    return search_table(result, rows=20)


@table.register
def _(result: Trials) -> Table:
    return worst_cars(result)


def _speeds(v_x: np.ndarray) -> list[tuple[str, Any, str]]:
    factor, unit = read_in("v_x", "m/s")
    ends = ("lowest", float(v_x.min())), ("highest", float(v_x.max()))
    return [(f"speed, {name}", factor * v, unit) for name, v in ends]


@table.register
def _(result: Lap) -> Table:
    rows: list[tuple[str, Any, str]] = [
        ("lap time", result.time, "s"),
        ("lap time, quasi-steady", result.quasi_steady, "s"),
        *_speeds(result.v_x),
    ]
    worth = [(f"1 % more {n}", 10.0 * result.worth(n, getattr(result.car, n)), "ms") for n in result.sensitivities]
    return _facts(f"Fastest lap of {result.track.name}", [*rows, *(w for w in worth if abs(w[1]) >= 0.1)])


@table.register
def _(result: DrivenLap) -> Table:
    rows: list[tuple[str, Any, str]] = [
        ("lap time", result.time, "s"),
        *_speeds(result.v_x),
    ]
    return _facts(f"Lap {result.number} of {result.track.name}", rows)


@table.register
def _(result: LapDelta) -> Table:
    return sector_table(result)


@table.register
def _(result: Path) -> Table:
    bend = float(np.abs(result.curvature).max())
    rows: list[tuple[str, Any, str]] = [("length", result.length, "m"), ("closed", result.closed, "")]
    rows.append(("tightest radius", 1 / bend if bend > 0 else float("inf"), "m"))
    if result.v_x is not None:
        rows += _speeds(result.v_x)
    return _facts(f"Path {result.name}", rows)
