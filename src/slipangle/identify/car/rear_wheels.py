"""Whether the angle of steered rear wheels is logged with its sign and in its unit, by what explains the motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.quality.plausible import REAR, doubts
from slipangle.identify.car.stretches import Stretches
from slipangle.identify.car.structures import Fitted, change, errors

_BETTER = 0.4, 2.0  # fall of the held-out error's logarithm, and that over its scatter, from which another one is told
_OTHERS = (
    (-1.0, "of the other sign", "it has the wrong sign; set sign = -1 for delta_r, left is positive"),
    (np.pi / 180, "read as degrees", "it is logged in degrees; declare its unit as deg"),
    (180 / np.pi, "57 times as large", "it is logged in rad, and was declared as deg: declare its unit as rad"),
)


def doubts_with_rear(
    data: Dataset, wheelbase: float, first: Fitted, refitted: Callable[[Dataset], Fitted], whole: Stretches
) -> tuple[str, ...]:
    """Sentences about channels that contradict each other, see `doubts`; first of delta_r, where there is one.

    ``refitted`` fits what ``first`` is, the linear bicycle, to other data. Where delta_r with another sign or unit
    explains the held-out stretches far better than as logged, the others are doubted beside that one.
    """
    if "delta_r" not in data:
        return doubts(data, wheelbase=wheelbase)
    at, best, factor, said = errors(first, whole.held_out), 0.0, 1.0, tuple[str, ...]()
    largest = float(np.quantile(np.abs(data["delta_r"]), 0.99))
    for other, how, fix in _OTHERS:
        if other > 1 and not 0 < other * largest < REAR:
            continue
        moved, scatter = change(at, errors(refitted(_scaled(whole.train, other)), _scaled(whole.held_out, other)))
        if moved < min(best, -_BETTER[0], -_BETTER[1] * scatter):
            share = 100 * np.exp(moved / 2)
            said = (f"with delta_r {how} the held-out error is {share:.2g} % of what it is as logged: {fix}",)
            best, factor = moved, other
    return (*said, *doubts(_scaled(data, factor), wheelbase=wheelbase))


def _scaled(data: Dataset, factor: float) -> Dataset:
    return data.with_channel("delta_r", factor * data["delta_r"], "rad")
