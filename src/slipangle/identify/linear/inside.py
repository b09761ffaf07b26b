"""State spaces whose free runs would leave the data: what tells, and whether poles inside the unit circle do better."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import SlipangleError
from slipangle.identify.linear.order_search import TIE, Judged, OrderChoice
from slipangle.identify.linear.poles import modulus
from slipangle.identify.stability import SETTLED, held
from slipangle.models.black_box.statespace import StateSpaceModel

_DRIFT = (
    "fits to the free run ended at poles outside the unit circle, as drifts and offsets of the data make them, and no "
    "free run over held-out data is better for them; one is at the circle now, and no interval counts that; right for "
    "a system that integrates, else expected data without a drift: remove it, ask for offsets='output', or give "
    "max_radius"
)


class Held:
    """Of each order of a `StateSpace` whether its poles are held inside the unit circle, where no limit was given.

    A drift of the training data is explained by a pole just outside as well as by one at the circle, but only over
    these data. So where a refined model has one, its order is refined with a limit of 1 too, within the same account;
    where that was better, those that come later only so.
    """

    def __init__(self, settings: Any) -> None:
        self.settings, self.within = settings, replace(settings, max_radius=1.0)
        self.held, self.compared = dict[int, bool](), set[int]()

    def of(self, order: int) -> Any:
        """The settings that an order is refined with."""
        return self.within if self.held.get(order) else self.settings

    def better(self, order: int, refine: Callable[[Any, float], Judged], most: float) -> Judged:
        """What ``refine`` makes of an order by settings and for so much work, with its poles held if that is better."""
        self.held.setdefault(order, any(self.held.values()))
        found = refine(self.of(order), most)
        if not _open(self.settings) or self.held[order] or order in self.compared or not outside(found):
            return found
        self.compared.add(order)
        try:
            other = refine(self.within, min(found.work, max(most - found.work, 0.0)))
        except SlipangleError:
            other = found
        self.held[order] = not outside(other) and other.error <= TIE * found.error
        return other if self.held[order] else found


def fitted(settings: Any, data: Dataset, choice: OrderChoice) -> tuple[OrderChoice, StateSpaceModel]:
    """The fit of a chosen order, and the choice after it.

    Poles are held inside where free runs over held-out data are for it, or say nothing for a pole outside that the fit
    of all data ends at.
    """
    if not choice.inside:
        found, model = settings._lasting(data, choice)
        if choice.outside or not _open(settings) or modulus(model.A) <= SETTLED:
            return found, model
    return replace(settings, max_radius=1.0)._lasting(data, replace(choice, inside=True))


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


def _open(settings: Any) -> bool:
    return settings.focus == "simulation" and settings.max_radius is None


def outside(judged: Judged) -> bool:
    """Whether a model has a pole outside the unit circle."""
    return any(modulus(m.A) > SETTLED for m in (judged.model, *judged.models))
