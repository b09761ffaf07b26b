"""Settings behind published numbers, by the table that prints them; ``replace(SOUSA_TABLE_4_2, ...)`` varies one.

All are for vehicles or systems that the name's table describes; other data want other lags and layers, which
`slipangle.identify.search` looks for.
"""

from __future__ import annotations

from dataclasses import replace

from slipangle.identify.networks.narx import NARX
from slipangle.identify.networks.narx_free_run import FreeRunNARX
from slipangle.identify.networks.problem import Stage

SOUSA_TABLE_4_2 = NARX(
    na=3,
    nb=2,
    hidden=(50, 50, 50),
    activation="elu",
    stages=(Stage(horizon=1, epochs=4000, learning_rate=1e-3, batch=100, patience=4000),),
    linear_start=False,
)
"""The robot arm's NARX."""

SOUSA_TABLE_8_2 = NARX(
    na=5,
    nb=5,
    hidden=(40, 40),
    stages=(Stage(horizon=1, epochs=200), Stage(horizon=40, epochs=1000, learning_rate=3e-3)),
    holdout=0.0,
    linear_start=False,
)
"""What a race car's bicycle leaves of its yaw rate."""

_SMALL = NARX(
    na=5,
    nb=5,
    hidden=(12,),
    activation="tanh",
    stages=(Stage(horizon=1, epochs=100, learning_rate=3e-3), Stage(horizon=40, epochs=150, learning_rate=3e-3)),
    linear_start=False,
)
SOUSA_TABLE_8_2_FREE_RUN = FreeRunNARX(start=_SMALL)
"""M4, the yaw rate itself: a small network, Adam on windows, then Gauss-Newton on the free run."""

_ONE, _MANY = _SMALL.stages
SOUSA_TABLE_8_3_DISCREPANCY = replace(_SMALL, na=3, stages=(_ONE, replace(_MANY, horizon=60)))
"""What a race car's driveline leaves of its speed."""

SOUSA_TABLE_8_3 = replace(
    SOUSA_TABLE_8_3_DISCREPANCY, na=2, nb=2, hidden=(6,), stages=(_ONE, replace(_MANY, horizon=60, epochs=300))
)
"""The speed itself, from the pedals."""
