"""What the verdict of a job's page rests on: free runs, parameters, residuals, the data, the closed loop."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import plotly.graph_objects as go

from slipangle import MPC, Channel, Dataset, Model, Trajectory, Validation, report
from slipangle.control.driver import Driver
from slipangle.data.race import with_dead_reckoning
from slipangle.identify.judge.scores import Score
from slipangle.report.page import Block
from slipangle.report.tables import number
from slipangle.units import angle_said, deg, read_in
from slipangle.workflow.drive import ControllerSettings
from slipangle.workflow.job import Outcome
from slipangle.workflow.overview import steering_limit
from slipangle.workflow.verdict import SECTIONS, spoken

_SOLVER = {
    "ipopt": "multiple shooting, Ipopt to convergence",
    "realtime": "multiple shooting, one Gauss-Newton iteration a step in compiled code",
}


# ---- the model -----------------------------------------------------------------------------------------------------


@SECTIONS.register("free run")
def _fit_sections(outcome: Outcome, command: str) -> Iterator[report.Section]:
    for name in outcome.validations[0].model.outputs:
        yield _fit_section(outcome, name, command)


def _fit_section(outcome: Outcome, name: str, command: str) -> report.Section:
    factor, unit = read_in(name, outcome.data.unit(name))
    channel = Channel(name, unit)
    judged = {v.name: v for v in outcome.validations if name in v.model.outputs}
    free = {label: _scaled(v.free_run, factor) for label, v in judged.items()}
    errors = {label: t.error[t.predicted, t.outputs.index(name)] for label, t in free.items()}
    extent = max(float(np.abs(t.measured[:, t.outputs.index(name)]).max()) for t in free.values())
    scatter = []
    for i, (label, t) in enumerate(free.items()):
        both = t.measured[t.predicted, t.outputs.index(name)], t.channel(name)[t.predicted]
        figure = report.correlation(*both, channel=channel, limits=(-extent, extent), index=i)
        scatter.append(report.Figure(title=f"{label}: {name} measured and simulated", figure=figure))
    first = next(iter(judged.values()))
    blocks: list[Block] = [
        report.Figure(
            title=f"{spoken(name)[4:].capitalize()}, measured and simulated",
            figure=report.trajectories(free, channel),
            caption="One free run over the whole test part: after the first samples the models see inputs only. "
            "Drag to zoom, double-click to reset; click a name to hide it.",
            command=command,
        ),
        report.score_table(
            _score_rows(outcome, judged, name),
            caption="Training rows show what overfitting would; the verdict counts the test rows only.",
        ),
        report.Figure(
            title=f"Error of {spoken(name)}",
            figure=report.rainclouds(errors, channel=channel),
            caption="Density, quartiles and single samples of measured minus simulated.",
        ),
        report.Grid(figures=tuple(scatter)),
    ]
    place = _position(outcome.test)
    if place is not None:
        t = free[first.name]
        value = np.where(t.predicted, t.error[:, t.outputs.index(name)], np.nan)
        figure = report.track_map(*place, value, channel=channel, starts=t.starts)
        caption = "Test part. Colour is the size of the free-run error."
        blocks.append(report.Figure(title=f"Where on the track {first.name} errs", figure=figure, caption=caption))
    return report.Section(title=f"Free run: {spoken(name)}", short=f"Free run: {name}", blocks=tuple(blocks))


def _scaled(run: Trajectory, factor: float) -> Trajectory:
    """A trajectory in another unit, for a figure of one of its outputs."""
    return replace(run, y=factor * run.y, measured=factor * run.measured)


def _signal(name: str, unit: str, values: np.ndarray, **more: Any) -> report.Signal:
    """A signal with what belongs to it in the unit that people read."""
    factor, shown = read_in(name, unit)
    given = {key: factor * v if key in ("reference", "lower", "upper") else v for key, v in more.items()}
    return report.Signal(channel=Channel(name, shown), values=factor * values, **given)


def _score_rows(outcome: Outcome, judged: dict[str, Validation], name: str) -> list[report.ScoreRow]:
    factor, unit = read_in(name, outcome.data.unit(name))
    shared, rows = {"channel": name, "unit": unit}, []
    training = {v.name: v for v in outcome.training}
    published = {m.name: m.published for m in outcome.settings.model}
    for label, v in judged.items():
        for kind, score in (
            ("free run, test", v.free_run_scores[name]),
            ("one-step-ahead, test", v.one_step_scores[name]),
            ("free run, training", training[label].free_run_scores[name]),
        ):
            rows.append(report.ScoreRow(model=label, kind=kind, **shared, **_score(score, factor)))
    simple = next(iter(judged.values())).standing[name].baselines  # alike for all, but for the samples predicted
    rows += [
        report.ScoreRow(model=f"{label}, a simple model", kind="free run, test", **shared, **_score(score, factor))
        for label, score in simple.items()
    ]
    for label in judged:
        theirs = published[label]
        if theirs is not None:
            rmse = None if theirs.rmse is None else factor * theirs.rmse
            given = {"fit": theirs.fit, "vaf": theirs.vaf, "rmse": rmse, "r2": None, "note": "published"}
            rows.append(report.ScoreRow(model=theirs.source, kind="free run, test", **shared, **given))
    return rows


def _score(score: Score, factor: float) -> dict[str, Any]:
    """A score with its RMSE in another unit."""
    return {**vars(score), "rmse": factor * score.rmse}


def _position(data: Dataset) -> tuple[np.ndarray, np.ndarray] | None:
    """X and Y where they were logged, else dead-reckoned from speed and yaw rate."""
    if not ("X" in data and "Y" in data):
        if "v_x" not in data or "r" not in data:
            return None
        data = with_dead_reckoning(data)
    return data["X"], data["Y"]


@SECTIONS.register("parameters")
def _parameter_section(outcome: Outcome, command: str) -> Iterator[report.Section]:
    blocks: list[Block] = []
    for v in outcome.validations:
        info = v.model.fit_info
        if info is None:
            continue
        if info.candidates:
            blocks.append(report.orders_table(info, title=f"Orders compared for {v.name}", command=command))
        if v.model.told_by_poles:
            blocks.append(_poles(v.name, v.model, len(info.names)))
            continue
        blocks.append(report.parameter_table(info, title=f"Parameters of {v.name}", command=command))
        if info.corrections:
            blocks.append(report.Findings.of(f"What corrections changed in {v.name}", info.corrections))
        if 1 < len(info.names) <= 14:
            blocks.append(report.correlation_table(info, title=f"How the estimates of {v.name} depend on each other"))
        blocks.append(report.Figure(title=f"Confidence of {v.name}", figure=report.forest(info)))
    if outcome.delay_check:
        title = "What the steering delay does to the parameters"
        blocks.append(report.Findings.of(title, outcome.delay_check, "fair"))
    yield report.Section(
        title="Parameters",
        lead="Estimates with 95 % confidence intervals. A warning names what moves them or stays open.",
        blocks=tuple(blocks),
    )


def _poles(name: str, model: Model, count: int) -> report.Findings:
    """What a linear model's coefficients mean; the coefficients themselves are in metrics.json."""
    said = [f"{count} coefficients with their intervals are in metrics.json; the poles say what they mean"]
    for pole in sorted(() if model.poles is None else model.poles, key=abs, reverse=True):
        if pole.imag < 0 or abs(pole) < 0.3:
            continue
        rate = np.log(pole.astype(complex)) / model.dt
        swing = f", {abs(rate.imag) / (2 * np.pi):.2g} Hz" if abs(rate.imag) > 1e-9 else ""
        stable = "decays" if rate.real < 0 else "grows: the model is unstable"
        said.append(f"a mode that {stable} with a time constant of {number(1 / abs(rate.real), 2)} s{swing}")
    items = [report.Finding(sentence=s) for s in said]
    warned = model.fit_info.warnings if model.fit_info is not None else ()
    return report.Findings(
        title=f"Modes of {name}", items=(*items, *(report.Finding(sentence=s, tone="poor") for s in warned))
    )


@SECTIONS.register("residuals")
def _residual_section(outcome: Outcome, command: str) -> Iterator[report.Section]:
    blocks: list[Block] = []
    for i, v in enumerate(outcome.validations):
        for name, tests in v.residuals.items():
            half = len(tests.lags) // 2
            shared = {"dt": outcome.data.dt, "index": i}
            own = tests.lags[half + 1 :], tests.autocorrelation[1:]
            figure = report.correlogram(*own, band=tests.band, label="autocorrelation", **shared)
            figures = [report.Figure(title=f"{v.name}: one-step-ahead residual of {name}", figure=figure)]
            for u, cross, band in zip(v.inputs, tests.cross, tests.cross_band, strict=True):
                figure = report.correlogram(
                    tests.lags, cross, band=float(band), label=f"correlation with {u}", **shared
                )
                figures.append(report.Figure(title=f"{v.name}: free-run residual of {name} against {u}", figure=figure))
            blocks.append(report.Grid(figures=tuple(figures)))
            said = [f"{v.name}, {name}: {s}" for s in tests.sentences]
            blocks.append(report.Findings.of(f"{v.name}, {name}: what the residuals say", said))
    yield report.Section(
        title="Residuals",
        lead="What a model leaves unexplained. A perfect model leaves white noise that does not depend on the inputs; "
        "the band of an autocorrelation holds 99 % of the lags of such a model, those of the correlations with inputs "
        "all lags from 0 on, of every input and output, in 99 of 100 such models.",
        blocks=tuple(blocks),
    )


# ---- the data ------------------------------------------------------------------------------------------------------


@SECTIONS.register("data")
def _data_section(outcome: Outcome, command: str) -> Iterator[report.Section]:
    q, data = outcome.quality, outcome.data
    used = {*data.inputs, *data.outputs}
    noticed = [f for f in (*q.spikes, *q.jumps, *q.dropouts, *q.wraps, *q.clippings) if f.channel in used]
    items = [report.Finding(sentence=q.clock_sentence)]
    items += [report.Finding(sentence=f.sentence, tone="fair") for f in noticed]
    plain = [f for f in (*q.stretches, *q.offsets, *q.excitations, *q.resolutions) if f.channel in used]
    items += [report.Finding(sentence=f.sentence) for f in (*q.delays, *plain)]
    others = sum(f.channel not in used for f in (*q.spikes, *q.jumps, *q.dropouts, *q.clippings, *q.stretches))
    if others:
        items.append(report.Finding(sentence=f"{others} more spikes, jumps or stretches in channels not used here"))
    blocks: list[Block] = [report.Findings(title="Seen in the log, before anything was changed", items=tuple(items))]
    if data.notes:
        blocks.append(report.Findings.of("Done to the data", data.notes))
    rows = [_signal(n, data.unit(n), data[n]) for n in (*data.inputs, *data.outputs)]
    edge, first = float(outcome.test.t[0]), outcome.opening
    fitted = edge if first is None else float(first.t[0])
    spans = [report.Span(start=float(data.t[0]), end=fitted, label="training")]
    spans += [] if first is None else [report.Span(start=fitted, end=edge, label="opening")]
    spans += [report.Span(start=edge, end=float(data.t[-1]), label="test")]
    figure = report.signals(data.t, rows, spans=tuple(spans), starts=data.starts)
    caption = "Models are fitted to the training part and judged on the test part."
    if first is not None:
        caption += " From the opening they read what is that day's own, such as offsets; no score counts it."
    blocks.append(report.Figure(title="The log as identified from", figure=figure, caption=caption))
    yield report.Section(title="Data", blocks=tuple(blocks))


# ---- the controller ------------------------------------------------------------------------------------------------


@SECTIONS.register("closed loop")
def _drive_section(outcome: Outcome, command: str) -> Iterator[report.Section]:
    wanted, run = outcome.settings.controller, outcome.run
    if wanted is None or run is None:
        return
    right, left = run.path.boundaries()
    own = "" if outcome.settings.plant.kind else ", stepped at 1 kHz, with sensor noise"
    limit = steering_limit(outcome, wanted.delta_max)
    rate = "" if isinstance(outcome.controller, Driver) else f" and {angle_said(deg(wanted.delta_rate_max))}/s"
    rows = [
        _signal("delta", "rad", run["delta"], lower=-limit, upper=limit, held=True),
        _signal("e_y", "m", run.e_y),
        _signal("e_psi", "rad", run.e_psi),
        _signal("v_x", "m/s", run.v_x, reference=run.reference[:, 3]),
        _signal("r", "rad/s", run["r"]),
    ]
    failed = np.array([p.age > 0 for p in run.plans])
    line, seconds = np.column_stack([run.path.X, run.path.Y]), run.warm_seconds
    body = report.Body(width=wanted.width)
    drawn = report.path_map(run["X"], run["Y"], run["psi"], reference=line, left=left, right=right, body=body)
    blocks: list[Block] = [
        report.Figure(
            title="Driven path and lanes",
            figure=_of_drive(drawn, "place"),
            caption=_edges_said(wanted, run.marked),
            command=command,
        ),
        report.Figure(
            title="Command, errors and motion",
            figure=_of_drive(report.signals(run.t, rows), "time"),
            caption=f"Steering is limited to {angle_said(limit)}{rate}.",
        ),
        report.Grid(
            figures=(
                report.Figure(
                    title="Solver time of each step",
                    figure=report.solver_time(seconds, deadline=wanted.dt, failed=failed[-len(seconds) :]),
                ),
                report.Figure(title="Solver time, spread", figure=report.solver_histogram(seconds, deadline=wanted.dt)),
            )
        ),
        report.Text(
            text=f"{_controller(outcome)}; the first step, which starts cold, took {1000 * run.seconds[0]:.1f} ms and "
            f"is left out of the statistics. Plant: {outcome.plant}{own}."
        ),
    ]
    yield report.Section(title="Controller in closed loop", short="Closed loop", blocks=tuple(blocks))


def _edges_said(wanted: ControllerSettings, marked: bool) -> str:
    """Whose the edges of the driven path are."""
    if wanted.track is None and wanted.manoeuvre.startswith("iso"):
        return (
            "Lane edges as the standard sets them for the vehicle's width. The line to follow is ours: the standard "
            "prescribes lanes only."
        )
    whose = "manoeuvre" if wanted.track is None else "track"
    return f"Edges and the line to follow are those of the {whose}." if marked else f"The {whose} has no edges."


def _of_drive(figure: go.Figure, by: str) -> go.Figure:
    """The figure, told to the page's script as one of the drive that plays, over ``time`` or ``place``."""
    meta = figure.layout.meta
    return figure.update_layout(meta={**(meta if isinstance(meta, dict) else {}), "drive": by})


def _controller(outcome: Outcome) -> str:
    """What drove, in words."""
    controller = outcome.controller
    if not isinstance(controller, MPC):
        return f"Controller: {type(controller).__name__}"
    steps = int(controller.ocp.nodes[-1])
    stages = "steps" if steps == controller.horizon else f"stages over {steps} steps"
    name = controller.solver if isinstance(controller.solver, str) else type(controller.solver).__name__
    return f"Horizon {controller.horizon} {stages} of {1000 * controller.dt:g} ms, {_SOLVER.get(name, name)}"
