"""What every controller does with the arguments of `plan` before it thinks."""

from __future__ import annotations

import numpy as np

from slipangle.control.controller import Ahead, Controller
from slipangle.optimal.arrays import applied_input, vector
from slipangle.optimal.checks import ANY, believable, last_input, require_plan
from slipangle.optimal.ocp import Reference
from slipangle.optimal.solution import Plan
from slipangle.paths.preview import Preview

FAR_BEYOND = 0.01  # of half an input's range, as in judge.c: less is what a measurement may be off


def given(
    controller: Controller, x: np.ndarray, reference: Ahead, previous: Plan | None
) -> tuple[np.ndarray, Reference]:
    """State and reference as arrays in the shapes of the problem.

    Raises
    ------
    ParameterError
        If an argument has the wrong type, or an array the wrong shape.
    """
    x = vector(x, controller.model.states, "x")
    wanted = controller.check_reference(
        controller.reference(reference) if isinstance(reference, Preview) else reference
    )
    require_plan(previous)
    return x, wanted


def doubt(
    applied: np.ndarray | None,
    controls: tuple[str, ...],
    low: np.ndarray | float = -np.inf,
    high: np.ndarray | float = np.inf,
) -> str:
    """What there is to say of an input applied that cannot be true, or is far beyond its limits; else empty.

    `applied_before` does without the first, and takes the limit for the other.

    Raises
    ------
    ParameterError
        If ``applied`` has the wrong shape.
    """
    if applied is None:
        return ""
    asked = applied_input(applied, controls)
    if believable(asked):
        return _beyond(asked, controls, low, high)
    worst = int(np.argmax(~(np.abs(asked) <= ANY)))
    return (
        f"applied is {asked[worst]:g} for '{controls[worst]}', which no input can be; in its place counts what was "
        "planned before, or an input at rest"
    )


def _beyond(asked: np.ndarray, controls: tuple[str, ...], low: np.ndarray | float, high: np.ndarray | float) -> str:
    """The first input that is beyond its limits by more than `FAR_BEYOND`, as one in another unit is."""
    low, high = np.broadcast_to(low, asked.shape), np.broadcast_to(high, asked.shape)
    over = np.maximum(asked - high, low - asked)
    for j in np.flatnonzero((over > 0) & (over > FAR_BEYOND * 0.5 * (high - low))).tolist():
        return (
            f"applied is {asked[j]:g} for '{controls[j]}', beyond its limits of {low[j]:g} and {high[j]:g}, the nearer "
            "of which counts in its place"
        )
    return ""


def both(detail: str, doubt: str) -> str:
    """What a solver said, and what there is to say of the call."""
    if not doubt:
        return detail
    return f"{detail}; {doubt}" if detail else doubt


def applied_before(
    previous: Plan | None,
    applied: np.ndarray | None,
    controls: tuple[str, ...],
    rest: np.ndarray,
    low: np.ndarray | float,
    high: np.ndarray | float,
) -> np.ndarray:
    """Inputs applied over the step before, within bounds: as said, else as planned, else those at rest.

    Raises
    ------
    ParameterError
        If ``applied`` has the wrong shape.
    """
    last = last_input(previous, controls)
    inputs = rest if last is None else last
    if applied is not None:
        asked = applied_input(applied, controls)
        inputs = asked if believable(asked) else inputs
    return np.minimum(np.maximum(inputs, low), high)
