"""Orders of linear models behind published numbers; ``replace(SOUSA_SEC_7_2, ...)`` varies them."""

from __future__ import annotations

from slipangle.identify.linear.arx import ARX

SOUSA_SEC_7_2 = ARX(na=1, nb=2)
"""Lateral velocity and yaw rate from steering at one speed, of which chapter 7 blends several: MARX."""
