"""With an exact Hessian a plan does not end at a maximum, where no first derivative leads anywhere."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen.compiler import compiler, sentence
from slipangle.ops import cos, sin
from slipangle.optimal.solution import Status

pytestmark = pytest.mark.skipif(compiler() is None, reason=sentence())
ABLE = ["auto", "riccati"]  # to tell: where states are eliminated no factor says it


def exact(qp: Any) -> sa.RealTime:
    return sa.RealTime(iterations=0, hessian="exact", qp=qp)


def hill(horizon: int, qp: str, **settings: Any) -> sa.MPC:
    """Down from the top of a hill, at x = 0, on either side."""
    posed: dict[str, Any] = {
        "Q": {},
        "R": sa.Weights(u=1e-3),
        "controls": ("u",),
        "terms": {"height": lambda x, u, p: 10.0 - x[0] ** 2},
        "limits": sa.Limits(u=1.0),
        "terminal_limits": sa.Limits(height=(-np.inf, 0.0)),
        "slack_linear": sa.Weights(height=1.0),
        "solver": exact(qp),
        **settings,
    }
    model = sa.Ode(f=lambda x, u, p: [u[0]], states=("x",), inputs=("u",), params={}, dt=0.1)
    return sa.MPC(model, horizon=horizon, **posed)


@pytest.mark.parametrize("horizon", [1, 5, 30])
@pytest.mark.parametrize("qp", ABLE)
def test_the_top_of_a_hill_is_left(horizon, qp):
    mpc = hill(horizon, qp)
    plan, beside = mpc.plan(np.zeros(1)), mpc.plan(np.array([1e-9]))
    assert plan.status is beside.status is Status.SOLVED
    assert np.abs(plan.u) == pytest.approx(1.0)
    assert np.abs(plan.x[-1]) == pytest.approx(0.1 * horizon)
    assert plan.cost == pytest.approx(beside.cost, rel=1e-6)
    assert plan.iterations < beside.iterations + 10


@pytest.mark.parametrize("qp", ABLE)
def test_inputs_that_count_by_their_change_leave_it_within_rates(qp):
    mpc = hill(12, qp, R={}, S=sa.Weights(u=0.02), rates=sa.Limits(u=2.0))
    plan = mpc.plan(np.zeros(1))
    assert plan.status is Status.SOLVED
    assert plan.cost == pytest.approx(mpc.plan(np.array([1e-9])).cost, rel=1e-6)
    assert np.abs(np.diff(plan.u[:, 0], prepend=0.0)).max() < 0.2 + 1e-9
    assert np.abs(plan.x[-1, 0]) > 0.5


@pytest.mark.parametrize("qp", ABLE)
def test_an_obstacle_ahead_is_passed_on_one_side(qp):
    """Straight on, into its middle, no first derivative says where to."""
    model = sa.Ode(
        f=lambda x, u, p: [1.0 + 0 * x[0], x[2], u[0] + 0.1 * u[1], 0.1 * u[1] - x[3]],
        states=("X_b", "Y_b", "v", "z"),
        inputs=("a", "b"),
        params={},
        dt=0.2,
    )
    mpc = sa.MPC(
        model,
        horizon=20,
        Q=sa.Weights(Y_b=0.1, z=0.1),
        R=sa.Weights(a=0.1, b=0.1),
        terms={"clear": lambda x, u, p: (x[0] - 2.0) ** 2 + x[1] ** 2},
        limits=sa.Limits(a=5.0, b=1.0, clear=(0.25, np.inf)),
        slack_linear=sa.Weights(clear=100.0),
        solver=exact(qp),
    )
    plan = mpc.plan(np.zeros(4))
    other = mpc.plan(np.array([0.0, 1e-7, 0.0, 0.0]))
    assert plan.status is Status.SOLVED
    assert np.abs(plan.x[10, 1]) == pytest.approx(0.5, abs=1e-6)
    assert plan.cost == pytest.approx(other.cost, rel=1e-5)


@pytest.mark.parametrize("qp", ABLE)
@pytest.mark.parametrize("limits", [{"u": 1.0, "x": (0.0, 0.0)}, {"u": (0.0, 0.0)}])
def test_a_maximum_that_limits_hold_is_an_optimum(qp, limits):
    plan = hill(10, qp, limits=sa.Limits(**limits)).plan(np.zeros(1))
    assert plan.status is Status.SOLVED
    assert plan.u == pytest.approx(0.0, abs=1e-9)
    assert plan.cost == pytest.approx(10.0)
    assert plan.violation < 1e-9


@pytest.mark.parametrize("qp", ABLE)
def test_no_more_steps_are_taken_than_there_are(qp):
    """Where they do not suffice for anything better, what was found stays, no optimum; later plans go on there."""
    mpc = hill(30, qp, solver=sa.RealTime(iterations=0, hessian="exact", qp=qp, max_iterations=1))
    plan = mpc.plan(np.zeros(1))
    assert plan.iterations == 1
    assert plan.status is Status.ITERATION_LIMIT
    assert plan.age == 0
    assert plan.u == pytest.approx(0.0)
    assert plan.violation < 1e-9
    later = replace(mpc, solver=exact(qp)).plan(np.zeros(1), previous=plan)
    assert later.status is Status.SOLVED
    assert np.abs(later.u) == pytest.approx(1.0)


def test_steps_beside_it_that_were_cut_short_are_kept_where_they_are_cheaper():
    """A pendulum up from hanging: where steps ran out on the way, the plan that hangs on was named an optimum."""
    model = sa.Ode(
        f=lambda x, u, p: [x[1], 9.81 * sin(x[0]) + u[0]], states=("q", "w"), inputs=("u",), params={}, dt=0.1
    )
    mpc = sa.MPC(
        model,
        horizon=30,
        Q=sa.Weights(height=10.0, w=0.1),
        R=sa.Weights(u=0.1),
        terms={"height": lambda x, u, p: 1.0 - cos(x[0])},
        limits=sa.Limits(u=5.0),
        solver=exact("auto"),
    )
    hanging, plans = np.array([np.pi, 0.0]), []
    for most in (1, 2, 4, 8, 16, 400):
        plans.append(replace(mpc, solver=replace(exact("auto"), max_iterations=most)).plan(hanging))
    for plan in plans:
        assert plan.age == 0
        assert plan.violation < 1e-6
        assert plan.cost <= plans[0].cost
    assert {plan.status for plan in plans[:-1]} == {Status.ITERATION_LIMIT}
    assert plans[-1].status is Status.SOLVED
    assert plans[-2].cost < 0.9 * plans[0].cost
