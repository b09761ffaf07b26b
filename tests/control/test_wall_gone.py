"""A hard limit that nothing can keep for a while: the loop plans again soon after it is gone."""

from typing import Any

import numpy as np
import pytest

import slipangle as sa
from slipangle.ops import cos, sin, tan
from slipangle.optimal.solution import RETRIES, Status

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler")
WALL = range(10, 30)  # steps with a wall so near that no brakes stop the car before it


def motion(x: Any, u: Any, p: Any) -> list[Any]:
    return [x[3] * cos(x[2]), x[3] * sin(x[2]), x[3] * tan(u[0]) / 2.7, u[1]]


def car(**settings: Any) -> sa.MPC:
    states = ("X_c", "Y_c", "turn", "v")
    return sa.MPC(
        sa.Ode(f=motion, states=states, inputs=("delta", "a"), params={}, dt=0.1, substeps=2),
        horizon=20,
        controls=("delta", "a"),
        Q=sa.Weights(Y_c=1.0, turn=1.0, v=0.5),
        R=sa.Weights(delta=5.0, a=0.2),
        parameters=("wall",),
        terms={"gap": lambda x, u, p: p.wall - x[0]},
        limits=sa.Limits(delta=0.5, a=(-4.0, 3.0), gap=(2.0, np.inf), Y_c=2.5),
        **settings,
    )


@pytest.mark.parametrize("engine", ["", "none"])
def test_what_was_unfinished_about_a_wall_is_left_soon_after_the_wall(engine: str, monkeypatch: pytest.MonkeyPatch):
    """Solves that a few iterations cut short, as deadlines do, went on from each other for fifty steps."""
    if engine:
        monkeypatch.setenv("SLIPANGLE_CC", engine)
    mpc, x, plan, seen = car(solver=sa.RealTime(max_iterations=6)), np.array([0.0, 0.5, 0.0, 15.0]), None, []
    for k in range(WALL[-1] + RETRIES + 5):
        plan = mpc.plan(x, previous=plan, Y_c=0.0, v=15.0, wall=x[0] + 9.0 if k in WALL else x[0] + 1000.0)
        x = np.asarray(mpc.model.step(x, plan.command))
        seen.append(plan)
    assert {seen[k].status for k in WALL} == {Status.INFEASIBLE, Status.ITERATION_LIMIT}
    assert all(each.status.solved for each in seen[: WALL[0]] + seen[WALL[-1] + 1 + RETRIES :])
