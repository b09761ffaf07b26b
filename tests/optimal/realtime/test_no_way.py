"""A program without an answer has none, however it is solved: by stages it had prices beyond all numbers."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.optimal.solution import Status

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler")


def parking(horizon: int, qp: str) -> sa.MPC:
    """A car to the side, and to rest again; where it stands, no input leads to the side."""
    return sa.MPC(
        sa.Ode(
            f=lambda x, u, p: [x[1] * u[1], u[0]],
            states=("side", "v"),
            inputs=("a", "turn"),
            params={},
            dt=0.1,
            substeps=2,
        ),
        horizon=horizon,
        Q={},
        R=sa.Weights(a=1e-3, turn=1e-3),
        limits=sa.Limits(a=2.0, turn=0.5),
        terminal_limits=sa.Limits(side=(0.3, 0.3), v=(0.0, 0.0)),
        solver=sa.RealTime(iterations=0, qp=qp),
    )


def test_no_input_that_steers_now_is_no_end_of_the_search():
    plans = [parking(20, qp).plan(np.zeros(2)) for qp in ("condensed", "riccati")]
    assert {plan.status for plan in plans} == {Status.SOLVED}
    assert plans[0].cost == pytest.approx(plans[1].cost, rel=1e-7)
    assert max(plan.violation for plan in plans) < 1e-8
