"""What results show of themselves: `table` in a notebook, `figure` by ``.plot()``; one of each per kind of result."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from typing import Any

import numpy as np
import plotly.graph_objects as go

from slipangle.data.dataset import Channel, Dataset
from slipangle.errors import ParameterError, nearest
from slipangle.identify.car.identify_car import IdentifiedCar
from slipangle.identify.judge.compare import Comparison
from slipangle.identify.judge.validate import Validation
from slipangle.models.model import FitInfo, Model, Trajectory
from slipangle.optimal.lap.driven import DrivenLap, LapDelta
from slipangle.optimal.lap.lap import Lap
from slipangle.paths.path import Path
from slipangle.report.diagnostics import forest
from slipangle.report.drives import Signal, signals
from slipangle.report.lap import delta_figure, lap_map, sector_table
from slipangle.report.maps import Body, path_map
from slipangle.report.parameters import parameter_table
from slipangle.report.plots import trajectories
from slipangle.report.style import pretty_unit
from slipangle.report.tables import Heading, Row, ScoreRow, Table, score_table
from slipangle.simulate.run import Run
from slipangle.units import read_in

_UNITS = {"r": "rad/s", "a_y": "m/s2", "a_x": "m/s2", "beta": "rad", "psi": "rad", "delta": "rad", "X": "m", "Y": "m"}
_UNITS |= {"v_x": "m/s", "v_y": "m/s", "e_y": "m", "e_psi": "rad", "e_course": "rad", "e_v": "m/s", "s": "m"}


def _one_of(names: Sequence[str], known: Sequence[str], what: str) -> None:
    """Raise a ParameterError if a name is not known."""
    for name in names:
        if name not in known:
            raise ParameterError(f"there is no {what} '{name}'; {nearest(name, known)}")


def _facts(title: str, rows: Sequence[tuple[str, Any, str]], caption: str = "") -> Table:
    """A table of names, values and units."""
    columns = Heading("", words=True), Heading("value"), Heading("unit", words=True)
    return Table(
        title=title, columns=columns, rows=tuple(Row((n, v, pretty_unit(u))) for n, v, u in rows), caption=caption
    )


# ---- tables --------------------------------------------------------------------------------------------------------


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
        caption=" ".join(f"{note[:1].upper()}{note[1:]}." for note in result.notes),
    )


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
    rows = [(f"RMS error of {n}", float(np.sqrt(np.mean(kept[:, i] ** 2))), "") for i, n in enumerate(result.outputs)]
    return _facts(f"Trajectory, {result._words()}", rows, " ".join(result.astray.values()))


@table.register
def _(result: Validation) -> Table:
    rows = [
        ScoreRow(model=result.name, channel=n, unit=_UNITS.get(n, "-"), kind=kind, tone=_tone(result, n), **vars(s[n]))
        for n in result.model.outputs
        for kind, s in (("free run", result.free_run_scores), ("one-step-ahead", result.one_step_scores))
    ]
    said = " ".join(f"{n}: {s.sentence}." for n, s in result.standing.items())
    return score_table(rows, title=f"Verdict on {result.name}", caption=said)


def _tone(result: Validation, name: str) -> Any:
    return result.standing[name].word if name in result.standing else None


@table.register
def _(result: Comparison) -> Table:
    rows = [
        ScoreRow(model=e.name, channel=n, unit=_UNITS.get(n, "-"), kind="free run", **vars(e.scores[n]))
        for e in result.entries
        if not e.failure
        for n in result.outputs
    ]
    failed = " ".join(f"{e.name} failed: {e.failure}." for e in result.entries if e.failure)
    return score_table(rows, title=f"Ranking on {result.data_name}, {result.n_samples} samples", caption=failed)


@table.register
def _(result: IdentifiedCar) -> Table:
    said = " ".join(f"{s[:1].upper()}{s[1:].rstrip('.')}." for s in result.sentences)
    found = parameter_table(result.model.fit_info, title="The identified car")
    return Table(title=found.title, columns=found.columns, rows=found.rows, caption=said)


@table.register
def _(result: Run) -> Table:
    rows: list[tuple[str, Any, str]] = [
        ("distance from the path, RMS", result.rmse("y"), "m"),
        ("distance from the path, largest", result.max("y"), "m"),
        ("time of the drive", float(result.t[-1] - result.t[0]), "s"),
        ("inside the lanes", result.inside, ""),
    ]
    if len(result.plans):
        late = 1000 * float(np.percentile(result.seconds, 99))
        rows += [("solver, 99th percentile", late, "ms"), ("commands of an older plan", result.fallbacks, "")]
    return _facts("Closed loop", rows, f"{result.end.value[:1].upper()}{result.end.value[1:]}.")


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


# ---- figures -------------------------------------------------------------------------------------------------------


@singledispatch
def figure(result: Any, names: Sequence[str]) -> go.Figure:
    """The figure of a result."""
    raise ParameterError(f"a {type(result).__name__} has no figure; expected a result of the toolbox")


def _signal(name: str, unit: str, values: np.ndarray) -> Signal:
    factor, shown = read_in(name, unit)
    return Signal(channel=Channel(name, shown), values=factor * values)


@figure.register
def _(result: Dataset, names: Sequence[str]) -> go.Figure:
    _one_of(names, result.names, "channel")
    chosen = names or (*result.inputs, *result.outputs) or result.names
    rows = [_signal(n, result.unit(n), result[n]) for n in chosen]
    return signals(result.t, rows, starts=result.starts)


@figure.register
def _(result: FitInfo, names: Sequence[str]) -> go.Figure:
    _one_of(names, (), "channel of a fit: leave names out,")
    return forest(result)


def _runs(runs: dict[str, Trajectory], outputs: Sequence[str], names: Sequence[str]) -> go.Figure:
    """Free runs beside the measured output, the first one unless another is named."""
    if len(names) > 1:
        raise ParameterError(f"{len(names)} outputs for one figure; expected one of {', '.join(outputs)}")
    _one_of(names, outputs, "output")
    name = (*names, *outputs)[0]
    factor, unit = read_in(name, _UNITS.get(name, "-"))
    scaled = {
        label: Trajectory(**{**vars(t), "y": factor * t.y, "measured": factor * t.measured})
        for label, t in runs.items()
    }
    return trajectories(scaled, Channel(name, unit))


@figure.register
def _(result: Trajectory, names: Sequence[str]) -> go.Figure:
    return _runs({result.kind: result}, result.outputs, names)


@figure.register
def _(result: Validation, names: Sequence[str]) -> go.Figure:
    return _runs({result.name: result.free_run}, result.free_run.outputs, names)


@figure.register
def _(result: Comparison, names: Sequence[str]) -> go.Figure:
    return _runs(result.trajectories, result.outputs, names)


@figure.register
def _(result: IdentifiedCar, names: Sequence[str]) -> go.Figure:
    return figure(result.model.fit_info, names)


@figure.register
def _(result: Run, names: Sequence[str]) -> go.Figure:
    if names:
        return signals(result.t, [_signal(n, _UNITS.get(n, "-"), result[n]) for n in names])
    right, left = result.path.boundaries()
    line = np.column_stack([result.path.X, result.path.Y])
    body = Body(width=result.width or 1.8)
    return path_map(result["X"], result["Y"], result["psi"], reference=line, left=left, right=right, body=body)


@figure.register
def _(result: Lap, names: Sequence[str]) -> go.Figure:
    units = {"v_x": "m/s", "v_y": "m/s", "r": "rad/s", "delta": "rad", "F_x": "N", "a_x": "m/s2", "a_y": "m/s2"}
    units |= {"n": "m", "chi": "rad", "grip_f": "-", "grip_r": "-"}
    _one_of(names, tuple(units), "channel of a lap")
    if not names:
        return lap_map(result)
    drawn = signals(result.s, [_signal(n, units[n], getattr(result, n)) for n in names])
    return drawn.update_layout(xaxis={"title": {"text": "arc length s [m]"}})


@figure.register
def _(result: DrivenLap, names: Sequence[str]) -> go.Figure:
    units = {"v_x": "m/s", "n": "m"}
    _one_of(names, tuple(units), "channel of a driven lap")
    drawn = signals(result.s, [_signal(n, units[n], getattr(result, n)) for n in names or tuple(units)])
    return drawn.update_layout(xaxis={"title": {"text": "arc length s [m]"}})


@figure.register
def _(result: LapDelta, names: Sequence[str]) -> go.Figure:
    _one_of(names, (), "channel of a lap's delta")
    return delta_figure(result)


@figure.register
def _(result: Path, names: Sequence[str]) -> go.Figure:
    known = ("curvature", "psi", *(("v_x",) if result.v_x is not None else ()))
    _one_of(names, known, "channel of a path")
    if names:
        units = {"curvature": "1/m", "psi": "rad", "v_x": "m/s"}
        drawn = signals(result.s, [_signal(n, units[n], getattr(result, n)) for n in names])
        return drawn.update_layout(xaxis={"title": {"text": "arc length s [m]"}})
    right, left = result.boundaries()
    return path_map(result.X, result.Y, result.psi, left=left, right=right)
