"""Settings of controllers behind published numbers, by what prints them: ``MPC(model, **SOUSA_TABLE_7_3)``.

Their S counts the angle of the steering wheel in rad and torque in kN m; ours counts the road wheel in rad and N m.
The common factor 10^3 of eqs. 6-3 and 6-4 is taken to stand before Q and S alike, so it is left out.
"""

from __future__ import annotations

from typing import Any

from slipangle.optimal.terms import Limits, Weights
from slipangle.units import deg

SOUSA_EQ_6_3: dict[str, Any] = {
    "Q": Weights(v_x=1500.0, X=200.0, Y=2500.0),
    "S": Weights(delta=100.0 * 30.0**2, T_f=1e-6),
    "limits": Limits(delta=0.9 / 30.0, T_f=2500.0),
}
"""The front-drive car of table 6.1, steering ratio 30; horizons of 5, 10 and 15 steps of 0.1 s."""

SOUSA_EQ_6_4: dict[str, Any] = {
    "Q": Weights(v_x=2500.0, X=200.0, Y=1500.0),
    "S": Weights(delta=1000.0 * 10.0**2, T_r=1e-6),
    "limits": Limits(delta=0.9 / 10.0, T_r=1200.0),
}
"""The rear-drive car of table 6.10, steering ratio 10; horizons as of `SOUSA_EQ_6_3`."""

SOUSA_TABLE_7_3: dict[str, Any] = {
    "horizon": 10,
    "Q": Weights(e_y=100.0),
    "S": Weights(delta=100.0 * 10.0**2),
    "limits": Limits(delta=deg(20.0)),
}
"""LMPC, NMPC and MARX-MPC at 0.05 s; the steering ratio of 10 is taken over from chapter 6."""

SOUSA_TABLE_7_3_TIRES = {"LMPC": 0.8, "NMPC": 0.9}
"""Share of the plant's slip stiffness that the tires inside each controller have: softer ones predict better, since the
single track of eq. 7-1 lacks the relaxation that delays the plant's forces."""

SOUSA_TABLE_7_5: dict[str, Any] = SOUSA_TABLE_7_3 | {"horizon": 20, "knots": (0, 2, 4, 6, 8, 10, 14, 19)}
"""MARX with heading: eight decisions, which fill a vector of any processor, over twice the horizon."""
