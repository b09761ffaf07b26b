"""State spaces whose free runs would leave the data: what tells, and whether poles inside the unit circle do better."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import SlipangleError
from slipangle.identify.linear.order_search import TIE, OrderChoice
from slipangle.identify.stability import held
from slipangle.models.black_box.statespace import StateSpaceModel

_DRIFT = (
    "fits to the free run ended at poles outside the unit circle, as drifts and offsets of the data make them, and run "
    "no better over held-out data than with poles held inside; one is at the circle now, and no interval counts that; "
    "right for a system that integrates, else expected data without a drift: remove it, ask for offsets='output', or "
    "give max_radius"
)


def compared(settings: Any, data: Dataset) -> tuple[Any, OrderChoice]:
    """Orders of a `StateSpace` compared, and its settings: with poles held inside the unit circle where that is better.

    A drift of the training data is explained by a pole just outside as well as by one at the circle, but only over
    these data. So where a refined model has one, and no limit was given, orders are compared with a limit of 1 too.
    """
    choice = settings._compared(data)
    if settings.focus != "simulation" or settings.max_radius is not None or not choice.outside:
        return settings, choice
    within = replace(settings, max_radius=1.0)
    try:
        other = within._compared(data)
    except SlipangleError:
        return settings, choice
    if not _error(other) <= TIE * _error(choice):
        return settings, choice
    return within, replace(other, inside=True)


def held_said(model: StateSpaceModel, choice: OrderChoice) -> str:
    """A sentence where poles are held that were not asked to be, and one ends at the circle; else empty."""
    return _DRIFT if choice.inside and held(model.poles, 1.0) else ""


def follows(model: StateSpaceModel, data: Dataset) -> bool:
    """Whether free runs over the data err less than twice as much as their means would."""
    try:
        run = model._simulate(data)
    except SlipangleError:
        return False
    error = np.mean(run.error[run.predicted] ** 2, axis=0)
    return bool(np.all(error < 4 * np.maximum(np.var(run.measured, axis=0), 1e-300)))


def _error(choice: OrderChoice) -> float:
    """Of the chosen order on held-out data."""
    return float(choice.errors[choice.orders.index(choice.order)])
