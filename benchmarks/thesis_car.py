"""The thesis' front-drive car on a double lane change, as benchmarks drive it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slipangle.control.mpc import MPC
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_2
from slipangle.optimal.ocp import Reference
from slipangle.optimal.solution import Plan
from slipangle.paths.lane_change import double_lane_change
from slipangle.reproduce._chapter_6 import FRONT_DRIVE

PATH = double_lane_change(20.0, blend=12.0)
CAR = FRONT_DRIVE
Q, S, LIMITS = (dict(CAR.settings[name]) for name in ("Q", "S", "limits"))
SCALE = np.array([high for _, high in LIMITS.values()])


def drive(mpc: MPC, steps: int) -> Iterator[tuple[np.ndarray, Reference, Plan | None, Plan]]:
    """State, reference, plan before and plan along one drive on the full model."""
    plant = CAR.model(SOUSA_TABLE_6_2).functions[0]
    x, plan, s = CAR.model(SOUSA_TABLE_6_2).straight(19.0, X=PATH.start[0]), None, 0.0
    for _ in range(steps):
        s = PATH.project(x[5], x[6], s).s
        reference = mpc.reference(PATH.ahead(s, mpc.times), T_r=0.0)
        before, plan = plan, mpc.plan(x, reference, plan)
        yield x, reference, before, plan
        x = np.asarray(plant(x, [*plan.command, 0.0])).ravel()
