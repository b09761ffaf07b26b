"""Whether the column v_y is a side slip angle, by what a fit explains of it as a speed and as an angle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.identify.car.stretches import Stretches
from slipangle.identify.car.structures import Fitted, change, errors

_BETTER = 0.4, 2.0  # fall of the error's logarithm, and that over its scatter, from which it is an angle
_LARGEST = 0.4  # rad, of a side slip angle
_LEFT = 0.5  # share of its variance that is not explained of an angle, at most
_FEW = 2  # stretches, fewer of which do not tell how far they scatter


def side_slip(fitted: Callable[[Dataset], Fitted], whole: Stretches) -> tuple[str, ...]:
    """A sentence where v_y as v_x times its tangent is explained far better; ``fitted`` is a fit of a linear bicycle.

    Errors are those of all outputs, over what these move by. At one speed an angle is too small a speed, so that the
    yaw rate is explained badly beside it.
    """
    some = whole.held_out if len(whole.held_out.starts) >= _FEW else whole.all
    if "v_y" not in some.outputs or float(np.quantile(np.abs(some["v_y"]), 0.99)) > _LARGEST:
        return ()
    as_angle = some.with_channel("v_y", some["v_x"] * np.tan(some["v_y"]), "m/s")
    shares = [errors(fitted(read), read) / np.var(read.y, axis=0) for read in (some, as_angle)]
    moved, scatter = change(*shares)
    left = float(shares[1][:, some.outputs.index("v_y")].mean())
    if left > _LEFT or moved > -max(_BETTER[0], _BETTER[1] * scatter):
        return ()
    return (
        f"v_y is a side slip angle: read as v_x times its tangent the log leaves {100 * np.exp(moved / 2):.2g} % of "
        "the error as logged; derive v_y so, or give the column another name: until then no interval of this car holds",
    )
