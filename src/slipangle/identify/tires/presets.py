"""Settings of fits to friction curves behind published numbers; ``replace(SOUSA_TABLE_4_3[...], ...)`` varies one."""

from __future__ import annotations

from slipangle.identify.tires.curves import MLPCurveFit, NetworkCurveFit, RBFCurveFit

SOUSA_TABLE_4_3: dict[str, NetworkCurveFit] = {
    "RBF {3}": RBFCurveFit(neurons=3, centre=(-1.0, 1.0), width=(0.01, 7.0), weight=(-20.0, 20.0)),
    "MLP {2 2}": MLPCurveFit(hidden=(2, 2), weight=(-2.0, 2.0), bias=(-2.0, 2.0)),
}
"""Both networks of table 4.4, within the bounds of table 4.3."""
