"""The first screen of a job's page: models beside outputs, the drive as a picture, parameters and what to doubt."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from slipangle import Validation, report
from slipangle.control.driver import Driver
from slipangle.export.controllers import limits_of
from slipangle.models.model import FitInfo
from slipangle.numerics.critical import even
from slipangle.report.drawing import seen_from_above
from slipangle.report.page import Block
from slipangle.report.parameters import doubt, judged, undetermined
from slipangle.report.playback import Playback
from slipangle.report.style import pretty_unit
from slipangle.report.tables import number, to_digit
from slipangle.units import angle_said, read_in, speed_said
from slipangle.workflow.job import Outcome
from slipangle.workflow.live import live_drive, other_law, tire_use

_MOST = 14  # parameters that a first screen has room for


def overview(outcome: Outcome, command: str) -> Iterator[Block]:
    """The blocks of the first screen that come before the sentences."""
    yield scoreboard(outcome, command)
    drawn = picture(outcome)
    if drawn is not None:
        yield drawn
    for v in _told_by_parameters(outcome):
        if v.model.fit_info is not None:
            yield doubts(v.name, v.model.fit_info)


def scoreboard(outcome: Outcome, command: str) -> report.Table:
    """One row per model and output: its free run beside what noise allows and beside the best simple model."""
    rows = []
    for v in outcome.validations:
        count = len(v.model.fit_info.names) if v.model.fit_info is not None else None
        for name in v.model.outputs:
            score, stands = v.free_run_scores[name], v.standing[name]
            factor, unit = read_in(name, outcome.data.unit(name))
            lost = name in v.free_run.astray
            word = "poor" if lost else stands.word
            cells = (v.name, name, word, score.fit, stands.highest if np.isfinite(stands.noise) else None)
            simple = stands.baselines[stands.best].fit
            error = f"{number(factor * score.rmse, 3)} {pretty_unit(unit)}"
            rows.append(report.Row((*cells, simple, error, count), tone=word))
    columns = (
        *(report.Heading(title, words=True) for title in ("model", "output", "verdict")),
        *(report.Heading(title, "%", 3) for title in ("fit", "at most", "simple model")),
        *(report.Heading(title) for title in ("RMSE", "parameters")),
    )
    seconds = f"{outcome.test.duration:.0f} s"
    return report.Table(
        title="Free runs over data that no model was fitted to",
        columns=columns,
        rows=tuple(rows),
        caption=f"From inputs alone, {seconds}; at most: what the noise of the output leaves a perfect model; simple "
        f"model: the best of those that need no vehicle. {next_step(outcome)}",
        command=command,
    )


def picture(outcome: Outcome) -> Playback | None:
    """The closed loop at true scale, which plays."""
    run, wanted = outcome.run, outcome.settings.controller
    if run is None or wanted is None:
        return None
    right, left = run.path.boundaries()
    line = np.column_stack([run.path.X, run.path.Y])
    body = report.Body(width=wanted.width)
    said = f"The closed loop at {speed_said(wanted.v_x)}, seen from above"
    lanes = f", {'inside' if run.inside else 'outside'}" if run.marked else ""
    label = f"{said}: largest distance from the path {100 * run.max('y'):.0f} cm{lanes}"
    edges: dict[str, Any] = {"reference": line, "left": left, "right": right}
    svg = seen_from_above(run["X"], run["Y"], run["psi"], body=body, label=label, moving=True, **edges)
    rows = np.searchsorted(run.t, run.t_plan - 1e-9).clip(0, len(run.t) - 1)
    known = "delta" in (*run.state_names, *run.input_names)
    limit = steering_limit(outcome, wanted.delta_max)
    steering = run["delta"] if known else np.zeros(len(run.t))
    fast, speed = read_in("v_x", "m/s")
    words = [
        f"steering {angle_said(float(steering[k]), '+.1f')} of ±{angle_said(limit)}, {fast * run.v_x[k]:.1f} {speed}, "
        f"{100 * run.e_y[k]:+.1f} cm from the path"
        for k in rows
    ]
    model = next(v.model for v in outcome.validations if v.name == wanted.model)
    plant, beside = outcome.settings.plant, other_law(wanted, outcome.settings.plant, model)
    drawn = "One scale for both axes; lanes, path to follow (dashed), driven path, what the controller predicts."
    return Playback(
        title=said,
        svg=svg,
        t=run.t[rows].tolist(),
        X=run["X"][rows].tolist(),
        Y=run["Y"][rows].tolist(),
        psi=run["psi"][rows].tolist(),
        said=words,
        horizon=_horizons(outcome, len(rows)),
        steering=steering[rows].tolist() if known else (),
        limit=limit,
        axles=tire_use(run, rows, plant, model),
        beside=beside,
        live=live_drive(wanted, plant, model, outcome.controller, outcome.settings.estimator),
        caption=drawn + (f" Dotted: {beside.label}, a law that predicts nothing." if beside else ""),
    )


def _planner(outcome: Outcome) -> Any:
    """What plans: the controller, or that of a driver."""
    controller = outcome.controller
    return controller.controller if isinstance(controller, Driver) else controller


def steering_limit(outcome: Outcome, wanted: float) -> float:
    """Largest steering angle, a driver's own or that of the job, which is in degrees. [rad]"""
    if not isinstance(outcome.controller, Driver):
        return float(np.radians(wanted))
    planner = outcome.controller.controller
    most = max(map(abs, limits_of(planner)[planner.controls[0]]))
    return float(most) if np.isfinite(most) else float(np.radians(wanted))


def _horizons(outcome: Outcome, count: int) -> list[list[float]]:
    """X and Y that each plan predicts, every fourth stage; none of a controller that predicts nothing."""
    states = getattr(getattr(_planner(outcome), "model", None), "states", ())
    plans = outcome.run.plans if outcome.run is not None else ()
    if not {"X", "Y"} <= {*states} or len(plans) != count:
        return []
    columns = [states.index("X"), states.index("Y")]
    fit = all(p.x.ndim == 2 and p.x.shape[1] == len(states) for p in plans)
    return [p.x[::4, columns].ravel().tolist() for p in plans] if fit else []


def doubts(name: str, info: FitInfo) -> report.Table:
    """Parameters with their intervals, and what to doubt about each."""
    ends = info.interval()
    rows = []
    for k, parameter in enumerate(info.names):
        value, half = float(info.values[k]), float(ends[k, 1] - ends[k, 0]) / 2
        factor, unit = read_in(parameter, info.units[k] if info.units else "-")
        said = doubt(info, k, half)
        shown, low, high = (to_digit(factor * float(v), factor * half) for v in (value, *ends[k]))
        width = f"± {number(factor * half, 2)}" if even(value, *ends[k]) else f"{low} to {high}"
        cells = parameter, shown, width, pretty_unit(unit), said
        rows.append(report.Row(cells, tone=judged(info, k, half)))
    columns = (
        report.Heading("parameter", words=True),
        report.Heading("estimate"),
        report.Heading("95 %"),
        *(report.Heading(title, words=True) for title in ("unit", "what to doubt")),
    )
    return report.Table(title=f"Parameters of {name}", columns=columns, rows=tuple(rows))


def next_step(outcome: Outcome) -> str:
    """What to do next, in one sentence."""
    words = {v.name: [v.standing[n].word for n in v.model.outputs] for v in outcome.validations}
    best = max(outcome.validations, key=_mean_fit)
    if outcome.failures:
        return f"Next: see why {', '.join(outcome.failures)} failed, below."
    if all(w == "poor" for w in words[best.name]):
        return "Next: look at Data and Residuals; no model explains half of what the noise allows."
    undetermined = [p for p in _told_by_parameters(outcome) if _open(p.model.fit_info)]
    if undetermined:
        names = _open(undetermined[0].model.fit_info)
        those = "them" if len(names) > 1 else "it"
        return f"Next: drive what determines {', '.join(names)} (slipangle advise), or fix {those}."
    run, wanted = outcome.run, outcome.settings.controller
    if run is not None and wanted is not None:
        late = float(np.percentile(run.warm_seconds, 99))
        if late >= wanted.dt and wanted.entries.get("solver") != "realtime":
            return f'Next: set solver = "realtime"; the solver takes {1000 * late:.0f} of {1000 * wanted.dt:.0f} ms.'
        if run.inside and not run.finished:
            return "Next: look why the car does not come to the end of its path; then judge the controller."
        if not run.kept:
            left = "lanes" if run.marked else "path"
            return f"Next: drive slower, widen the limits or change the weights; the car leaves its {left}."
        if outcome.tried is not None and outcome.tried.trials is not None and not outcome.tried.trials.good:
            return "Next: make the controller bear other cars (slipangle robust), then slipangle export c."
        return "Next: slipangle export c writes the controller as C."
    return f"Next: control with {best.name}: add a [controller] to the job."


def _mean_fit(v: Validation) -> float:
    return float(np.mean([v.free_run_scores[name].fit for name in v.model.outputs]))


def _told_by_parameters(outcome: Outcome) -> list[Validation]:
    """Models whose parameters mean something one by one, and are few."""
    return [
        v
        for v in outcome.validations
        if v.model.fit_info is not None and not v.model.told_by_poles and 0 < len(v.model.fit_info.names) <= _MOST
    ]


def _open(info: FitInfo | None) -> list[str]:
    """Parameters whose interval is as wide as their value, leaving out those that may well be zero."""
    if info is None:
        return []
    half = np.ptp(info.interval(), axis=1) / 2
    return [n for k, n in enumerate(info.names) if undetermined(info, k, half[k])]
