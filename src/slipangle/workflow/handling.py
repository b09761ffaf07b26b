"""The section of a job's page on handling: what engineers look at before they trust a car's model."""

import warnings
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from slipangle import Model, report
from slipangle.errors import ModelWarning, SlipangleError
from slipangle.models.analysis.frequency import frequency_response
from slipangle.models.analysis.handling import Handling, handling
from slipangle.models.analysis.linearize import linearize
from slipangle.models.analysis.responses import FrequencyResponse
from slipangle.report.limits import gg_diagram
from slipangle.report.linear import bode, handling_curves, handling_table
from slipangle.report.page import Block
from slipangle.units import speed_said
from slipangle.workflow.job import Outcome
from slipangle.workflow.verdict import SECTIONS

_SPEEDS = 9  # at which quantities are taken
_SLOWEST = 3.0  # m/s, below which a car is not steered by its slip
_MOST = 5  # models in one figure


@SECTIONS.register("handling")
def _handling_section(outcome: Outcome, command: str) -> Iterator[report.Section]:
    """Nothing where the job is not about a car that is steered, or its models have no linear answer."""
    data = outcome.data
    if "v_x" not in data or "delta" not in data.inputs or "r" not in data.outputs:
        return
    v_x = data["v_x"][data["v_x"] > _SLOWEST]
    if not len(v_x):
        return
    low, middle, high = np.percentile(v_x, [5, 50, 95])
    speeds = np.linspace(low, high, _SPEEDS) if high - low > 2.0 else np.array([middle])
    models = {v.name: v.model for v in outcome.validations[:_MOST] if "r" in v.model.outputs}
    answers = [found for name, model in models.items() if (found := _answers(name, model, speeds)) is not None]
    curves = _responses(outcome, models, float(middle))
    place = {v.name: k for k, v in enumerate(outcome.validations)}  # in all figures of the page
    blocks: list[Block] = []
    if answers:
        blocks.append(handling_table(answers[0], float(middle)))
        if len(speeds) > 1:
            figure = handling_curves(answers, places=[place[one.name] for one in answers])
            caption = "Over the speeds of the log, with 95 % bands where the fit gives them."
            blocks.append(report.Figure(title="Handling over speed", figure=figure, caption=caption))
    if curves:
        said = f"Models at {speed_said(middle)}; the log at all its speeds, with coherence and 95 % bands."
        figure = bode(curves, [place[one.name] if one.coherence is None else -1 for one in curves])
        blocks.append(report.Figure(title="Yaw rate over steering, by frequency", figure=figure, caption=said))
    blocks += _limits(outcome, models, float(middle))
    if blocks:
        lead = "Small motions around straight driving: what the models say of the car, in the terms of ISO standards."
        yield report.Section(title="Handling", lead=lead, blocks=tuple(blocks))


def _limits(outcome: Outcome, models: dict[str, Model], v_x: float) -> list[Block]:
    """The log's accelerations inside the limits of the first model that has some; nothing where none has."""
    for name, model in models.items():
        try:
            figure = gg_diagram(outcome.data, model, v_x=[v_x], name=name).plot()
        except SlipangleError:  # its tires hold any force
            continue
        said = "Samples of the log and what the model's tires could hold at the log's middle speed; engine not counted."
        return [report.Figure(title="Accelerations and the car's limits", figure=figure, caption=said)]
    return []


def _answers(name: str, model: Model, speeds: np.ndarray) -> Handling | None:
    """Quantities over speed of a model that has parameters of a car; None of one that has not."""
    try:
        with warnings.catch_warnings(action="error", category=ModelWarning):
            return handling(model, v_x=speeds, name=name)
    except (SlipangleError, ModelWarning):
        return None


def _responses(outcome: Outcome, models: dict[str, Model], v_x: float) -> list[FrequencyResponse]:
    """What the log says, then each model that has a steady state at this speed, at the same frequencies."""
    found = []
    top, bottom = 0.5 / outcome.data.dt, 0.1
    try:
        measured = frequency_response(outcome.data, "r", "delta")
        sure = measured.coherence is not None and (measured.coherence > 0.2).any()
        if sure:
            found.append(_until(measured))
            bottom, top = found[0].frequency[0], min(top, 1.5 * found[0].frequency[-1])
    except SlipangleError:  # too short a log says nothing by frequency
        pass
    frequency = np.geomspace(bottom, top, 120)
    for name, model in models.items():
        speed = v_x if "v_x" in (*model.off_ground.states, *model.off_ground.inputs) else None
        try:
            with warnings.catch_warnings(action="error", category=ModelWarning):
                linear = linearize(model, v_x=speed, name=name)
            linear = linear if linear.dt else linear.sampled(model.dt)
            found.append(linear.bode("r", "delta", frequency=frequency))
        except (SlipangleError, ModelWarning):  # no steady state, or a kink in it
            continue
    return found if len(found) > 1 else []


def _until(measured: FrequencyResponse) -> FrequencyResponse:
    """The response up to the last frequency at which the output follows the input."""
    coherence = measured.coherence if measured.coherence is not None else np.ones(len(measured.frequency))
    n = int(np.flatnonzero(coherence > 0.2)[-1]) + 1
    names = ("frequency", "value", "magnitude_std", "phase_std", "coherence")
    return replace(measured, name="the log", **{k: getattr(measured, k)[:n] for k in names})
