"""Whether the angle of steered rear wheels is logged with its sign and in its unit, by what explains the motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.quality.plausible import REAR, doubts
from slipangle.identify.car.stretches import Stretches
from slipangle.identify.car.structures import Fitted, change, errors

_BETTER = 0.4, 2.0  # fall of the error's logarithm, and that over its scatter, from which another reading is told
_DEGREES = np.pi / 180
_FEW = 2  # stretches, fewer of which do not tell how far they scatter
_OTHERS = (
    (-1.0, "of the other sign", "it has the wrong sign; set sign = -1 for delta_r, left is positive"),
    (_DEGREES, "read as degrees", "it is logged in degrees; declare its unit as deg"),
    (180 / np.pi, "57 times as large", "it is logged in rad, and was declared as deg: declare its unit as rad"),
)


def doubts_with_rear(
    data: Dataset, wheelbase: float, fitted: Callable[[Dataset], Fitted], whole: Stretches
) -> tuple[str, ...]:
    """Sentences about channels that contradict each other, see `doubts`; first of delta_r, where there is one.

    ``fitted`` is a fit of the linear bicycle to stretches. Where delta_r with another sign or unit explains them far
    better than as logged, by as many parameters, the other channels are doubted beside that one.
    """
    if "delta_r" not in data:
        return doubts(data, wheelbase=wheelbase)
    some = whole.held_out if len(whole.held_out.starts) >= _FEW else whole.all
    largest = float(np.quantile(np.abs(data["delta_r"]), 0.99))
    at, best, factor, said = errors(fitted(some), some), 0.0, 1.0, tuple[str, ...]()
    for other, how, fix in _OTHERS:
        if other > 1 and not 0 < other * largest < REAR:
            continue
        read = _scaled(some, other)
        moved, scatter = change(at, errors(fitted(read), read))
        if moved < min(best, -_BETTER[0], -_BETTER[1] * scatter):
            share = 100 * np.exp(moved / 2)
            said = (f"with delta_r {how} the error is {share:.2g} % of what it is as logged: {fix}",)
            best, factor = moved, other
    if factor == _DEGREES:  # a channel that has nothing to do with the car is better the smaller it is read
        none, read = _scaled(some, 0.0), _scaled(some, factor)
        if change(errors(fitted(none), none), errors(fitted(read), read))[0] > -_BETTER[0]:
            said, factor = ("the car moves as if delta_r were not there: check its column, and its zero",), 0.0
    return (*said, *doubts(_scaled(data, factor), wheelbase=wheelbase))


def _scaled(data: Dataset, factor: float) -> Dataset:
    return data.with_channel("delta_r", factor * data["delta_r"], "rad")
