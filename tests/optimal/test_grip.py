"""A car at its grip's edge: tires that give less beyond a slip angle, a friction ellipse, a lane that bends."""

from typing import Any

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen.compiler import compiler, sentence
from slipangle.ops import atan2, cos, sin, tanh
from slipangle.optimal.solution import Status

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler")
INF, G, N = float("inf"), 9.81, 40


def racer(x: Any, u: Any, p: Any) -> list[Any]:
    """Along a bend of 50 m radius that begins at 20 m, on tires that give less beyond a slip angle of 0.26."""
    s, e_y, e_psi, v_x, v_y, r = (x[i] for i in range(6))
    curvature = 0.02 * tanh((s - 20.0) / 10.0)
    front = 0.55 * 1500.0 * G * sin(1.3 * atan2(10.0 * (u[0] - atan2(v_y + 1.2 * r, v_x)), 1.0))
    rear = 0.45 * 1500.0 * G * sin(1.3 * atan2(-10.0 * atan2(v_y - 1.5 * r, v_x), 1.0))
    along = (v_x * cos(e_psi) - v_y * sin(e_psi)) / (1.0 - e_y * curvature)
    return [
        along,
        v_x * sin(e_psi) + v_y * cos(e_psi),
        r - curvature * along,
        u[1] + v_y * r - front * sin(u[0]) / 1500.0,
        (front * cos(u[0]) + rear) / 1500.0 - v_x * r,
        (1.2 * front * cos(u[0]) - 1.5 * rear) / 2500.0,
    ]


def race() -> sa.MPC:
    return sa.MPC(
        sa.Ode(
            f=racer,
            states=("way", "e", "turn", "v", "v_y", "r"),
            inputs=("delta", "a"),
            params={},
            dt=0.05,
            substeps=3,
        ),
        horizon=N,
        Q=sa.Weights(way=0.02, v_y=0.01),
        R=sa.Weights(delta=1.0, a=0.01),
        S=sa.Weights(delta=10.0, a=0.05),
        terms={"ellipse": lambda x, u, p: (u[1] / G) ** 2 + (x[3] * x[5] / G) ** 2},
        limits=sa.Limits(delta=0.4, a=(-8.0, 4.0), e=(-2.0, 2.0), ellipse=(-INF, 0.8)),
        solver=sa.RealTime(iterations=0),
    )


@pytest.mark.parametrize("engine", ["", "none"])
def test_a_lane_that_can_be_kept_is_though_whole_steps_lead_astray(engine: str, monkeypatch: pytest.MonkeyPatch):
    """Ipopt finds 2958 from nothing; whole steps lead to where tires give less, from which no step keeps the lane."""
    if engine:
        monkeypatch.setenv("SLIPANGLE_CC", engine)
    plan = race().plan(np.array([18.709, -0.32, -0.05, 19.39, -0.18, 0.05]), way=98.709)
    assert plan.status is Status.SOLVED, plan.message
    assert plan.violation < 1e-8
    assert plan.cost < 2960.0


@pytest.mark.skipif(compiler() is None, reason=sentence())
@pytest.mark.parametrize(
    ("x", "cost"),  # that Ipopt finds from nothing
    [([0.0, 1.0, 0.0, 20.0, 0.0, 0.0], 2894.1), ([1.79, 0.19, -0.02, 24.41, -0.17, 0.01], 2536.3)],
)
def test_lanes_are_kept_from_other_states_too(x: list[float], cost: float):
    plan = race().plan(np.array(x), way=x[0] + 80.0)
    assert plan.age == 0, plan.message  # a plan that keeps all limits, finished or not
    assert plan.violation < 1e-6
    assert plan.cost < cost
