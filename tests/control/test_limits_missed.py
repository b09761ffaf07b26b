"""Limits that nothing keeps for many steps: a step looks in fewer places for a plan, every fifth in all of them."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.optimal.solution import RETRIES, Plan, Status

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler")
STEPS, X = 9, np.array([0.0, 3.0])


def train() -> sa.MPC:
    return sa.MPC(
        sa.Ode(
            f=lambda x, u, p: [x[1], u[0] - 0.1 * x[1] ** 2 + 0.1 * u[1] * x[1]],
            states=("s", "speed"),
            inputs=("a", "b"),
            params={},
            dt=0.2,
        ),
        horizon=6,
        Q=sa.Weights(speed=1.0),
        R=sa.Weights(a=0.1, b=0.1),
        parameters=("wall",),
        terms={"gap": lambda x, u, p: p.wall - x[0]},
        limits=sa.Limits(a=2.0, b=1.0, gap=(0.0, np.inf)),
    )


def before_a_wall(mpc: sa.MPC, steps: int) -> list[Plan]:
    """Plans of a train that is held where nothing stops it in time."""
    plan, seen = None, []
    for _ in range(steps):
        plan = mpc.plan(X, previous=plan, speed=3.0, wall=0.5)
        seen.append(plan)
    return seen


@pytest.mark.parametrize("engine", ["", "none"])
def test_a_row_of_steps_without_a_plan_takes_turns_where_to_look(engine: str, monkeypatch: pytest.MonkeyPatch):
    if engine:
        monkeypatch.setenv("SLIPANGLE_CC", engine)
    seen = before_a_wall(train(), STEPS)
    assert {plan.status for plan in seen} == {Status.INFEASIBLE}
    assert [plan.age for plan in seen] == [*range(1, STEPS + 1)]
    steps, turns = np.array([plan.iterations for plan in seen]), np.arange(STEPS) - 1  # fallbacks before the last one
    in_turn = (turns > 0) & (turns % RETRIES > 0)
    assert steps[in_turn].max() < 0.6 * steps[~in_turn].min()


def test_a_plan_that_is_there_again_is_found_at_once():
    mpc = train()
    for steps in range(2, 2 + RETRIES):
        before = before_a_wall(mpc, steps)[-1]
        assert before.age == steps
        assert mpc.plan(X, previous=before, speed=3.0, wall=1000.0).status.solved
