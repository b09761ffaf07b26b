"""Grey boxes of linear vehicles."""

from __future__ import annotations

from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM, SOUSA_TABLE_7_2
from tests.identify.physics.test_grey_box import drive
from tests.machines.fits_black_box import free_run
from tests.machines.registry import Errors, fit

GREY = {
    "bicycle": (SOUSA_TABLE_7_2, ("C_f", "C_r", "inertia_z"), ("r",)),
    "bicycle with v_y": (FERRARI_250LM, ("C_f", "C_r", "inertia_z", "steering_gain", "l_f"), ("v_y", "r")),
}


def grey_box(name: str) -> Errors:
    """A bicycle from starts 30 % off, on its own free run with noise."""
    params, free, outputs = GREY[name]
    true = Bicycle(params=params, dt=0.05, outputs=outputs)
    train, test = drive(true, noise=0.1), drive(true, seed=1, noise=0.1, name="other")
    start = true.with_values(**{n: 1.3 * true.value(n) for n in free})
    return free_run(GreyBox(start=start, free=free).fit(train), train, test)


for name in GREY:
    fit(f"grey box, {name}")(lambda name=name: grey_box(name))
