"""State spaces of unstable systems, held by a controller or not: free runs make a stable model that is none of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import SlipangleError
from slipangle.identify.linear.poles import modulus
from slipangle.identify.stability import breakdown_said, noted
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.plausible import growth

# Twice the logarithm of the likelihood by which a model without a limit on its poles must be better. Ramps, random
# walks and growing disturbances, which mean no instability, reach 40, however many samples there are.
_SURE = 100.0
_GROWN = 0.7  # e-foldings over the longest experiment, from which on a subspace model is looked at more closely
_SAID = (
    "one step ahead the data are those of an unstable system, by a pole of modulus {size:.4g}; free runs over such "
    "data, held by a controller or not, end at a stable model that is none of it"
)
_CHOSEN = f"{_SAID}; expected StateSpace(), or orders that are given: those are fitted one step ahead"
_TAKEN = f"{_SAID}, so errors one step ahead were minimised, as by focus='prediction'"


def unstable_ahead(settings: Any, data: Dataset, order: int) -> StateSpaceModel | None:
    """The model of a `StateSpace` one step ahead, where no stable one predicts as well beyond chance; else None.

    What is unknown of a stable system, drifts of its outputs and steps of disturbances among it, has poles at 1 and not
    beyond: held there, its models predict as well.
    """
    ahead = replace(settings, focus="prediction", order=order)
    try:
        with breakdown_said("the state space", data):
            size = modulus(ahead._subspace(order)._fit(data).A)
            if not data.n_longest * np.log(max(size, 1.0)) > _GROWN:
                return None
            free = ahead._of_order(data, order)
            if not growth(free.poles, data.n_longest):
                return None
            held = replace(ahead, max_radius=1.0)._of_order(data, order)
            gain = _left(held, data) - _left(free, data)
    except SlipangleError:
        return None
    return free if data.n_samples * gain > _SURE else None


def stable_by_free_runs(settings: Any, poles: np.ndarray, data: Dataset) -> str:
    """Sentence where a stable model's orders were chosen by free runs over data of an unstable system; else empty.

    ``settings`` are a `StateSpace` of one order, by which the data are asked; ``poles`` are the model's.
    """
    stable = not growth(poles, data.n_longest)
    found = unstable_ahead(settings, data, settings.order) if stable else None
    return "" if found is None else _CHOSEN.format(size=modulus(found.A))


def _left(model: StateSpaceModel, data: Dataset) -> float:
    """Logarithm of the determinant of the covariance of errors one step ahead."""
    run = model._predict(data)
    error = run.error[run.predicted]
    return float(np.linalg.slogdet(error.T @ error / len(error))[1])


def ahead_if_unstable(settings: Any, model: StateSpaceModel, data: Dataset) -> StateSpaceModel:
    """The fit of a `StateSpace` to free runs, or the one to errors one step ahead where the system is unstable."""
    if settings.focus != "simulation" or growth(model.poles, data.n_longest):
        return model
    found = unstable_ahead(settings, data, model.order)
    if found is None:
        return model
    given = isinstance(settings.order, int)
    ahead = found if given else replace(settings, focus="prediction")._scaled_fit(data)
    return noted(ahead, _TAKEN.format(size=modulus(found.A)))
