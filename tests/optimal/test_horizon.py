"""Ends, parameters, limits and weights over the horizon: every solver, against oracles and each other."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from slipangle.control.mpc import MPC
from slipangle.errors import ModelWarning, ParameterError
from slipangle.models.custom import Ode
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.ops import cos, sin
from slipangle.optimal.end import TerminalCost, lqr
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.ocp import OCP
from slipangle.optimal.realtime import RealTime, backend
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights
from tests.optimal.linear import two_masses

SOLVERS = {
    "condensed": lambda: RealTime(qp="condensed"),
    "riccati": lambda: RealTime(qp="riccati"),
    "interpreted": RealTime,
    "ipopt": Ipopt,
}
X0 = np.array([0.5, -0.2, 0.1, 0.3])


@pytest.fixture(params=["condensed", *(pytest.param(n, marks=pytest.mark.slow) for n in [*SOLVERS][1:])])
def solver(request, monkeypatch):
    """Every solver."""
    if request.param == "interpreted":
        monkeypatch.setenv("SLIPANGLE_CC", "none")
        backend._say_once.cache_clear()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        yield SOLVERS[request.param]()


def masses(solver, **more):
    """Two masses, nothing limited."""
    wanted = {"Q": Weights(p1=10.0, p2=4.0, v1=1.0), "R": Weights(a1=0.1, a2=0.2), **more}
    return MPC(two_masses(), horizon=8, controls=("a1", "a2"), solver=solver, **wanted)


def pendulum(solver, **more):
    """A nonlinear one; its wind is a parameter of the model, an exogenous input."""

    def f(x, u, p):
        return [x[1], u[0] * cos(x[0]) - 9.81 * sin(x[0]) / p.arm + u[1]]

    model = Ode(f=f, states=("phi", "rate"), inputs=("a", "wind"), outputs=(), params={"arm": 0.8}, dt=0.05)
    wanted = {"Q": Weights(phi=4.0, rate=0.1), "R": Weights(a=0.05), "limits": Limits(a=12.0), **more}
    return MPC(model, horizon=12, controls=("a",), solver=solver, **wanted)


def same(mpc, x, **wanted):
    """The plan of this solver, after it was held against Ipopt's."""
    plan, exact = mpc.plan(x, **wanted), replace(mpc, solver=Ipopt()).plan(x, **wanted)
    assert plan.status is Status.SOLVED
    assert exact.status is Status.SOLVED
    assert plan.cost == pytest.approx(exact.cost, rel=1e-7, abs=1e-9)
    assert np.abs(plan.u - exact.u).max() < 3e-5 * max(1.0, np.abs(exact.u).max())
    return plan


def endless(model, Q, R, S, x, before, n=300):
    """Inputs over a horizon so long that its end does not matter, by dense least squares."""
    m, rows, wanted = 2, [], []
    to, free = np.zeros((4, n * m)), x
    inputs, last = np.eye(n * m), np.zeros((m, n * m))
    for i in range(n):
        now = inputs[i * m : (i + 1) * m]
        parts = (Q, to, -free), (R, now, np.zeros(m)), (S, now - last, before if i == 0 else np.zeros(m))
        for weight, row, value in parts:
            rows.append(np.sqrt(weight) @ row)
            wanted.append(np.sqrt(weight) @ value)
        to, free, last = model.A @ to + model.B @ now, model.A @ free, now
    return np.linalg.lstsq(np.vstack(rows), np.concatenate(wanted), rcond=None)[0].reshape(n, m)


# ---- the end -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("changes", [{}, {"S": Weights(a1=0.4, a2=0.1)}], ids=["inputs", "changes"])
def test_a_short_horizon_that_ends_in_its_lqr_is_an_endless_one(solver, changes):
    mpc = masses(solver, terminal="lqr", **changes)
    model = mpc.model
    before = np.array([0.3, -0.1])
    plan = mpc.plan(X0, applied=before)
    Q, R = np.diag([10.0, 1.0, 4.0, 0.0]), np.diag([0.1, 0.2])
    S = np.diag([0.4, 0.1]) if changes else np.zeros((2, 2))
    assert plan.u == pytest.approx(endless(model, Q, R, S, X0, before)[:8], abs=1e-6)
    if not changes:
        assert lqr(mpc.ocp).matrix == pytest.approx(solve_discrete_are(model.A, model.B, Q, R), rel=1e-9)
        assert plan.cost == pytest.approx(X0 @ solve_discrete_are(model.A, model.B, Q, R) @ X0, rel=1e-7)


def test_a_full_matrix_counts_between_errors(solver):
    P = np.array([[3.0, 1.0], [1.0, 2.0]])
    mpc = masses(solver, terminal=TerminalCost(("p1", "v2"), P))
    plan = mpc.plan(X0, p1=0.1, v2=0.2)
    end = plan.x[-1][[0, 3]] - [0.1, 0.2]
    stages = plan.x[:-1] - [0.1, 0.0, 0.0, 0.0]
    cost = (stages**2 @ [10.0, 1.0, 4.0, 0.0]).sum() + (plan.u**2 @ [0.1, 0.2]).sum() + end @ P @ end
    assert plan.cost == pytest.approx(cost, rel=1e-9)
    same(mpc, X0, p1=0.1, v2=0.2)


def test_a_terminal_constraint_is_met_exactly(solver):
    mpc = masses(solver, terminal_limits={"v1": (0.0, 0.0), "v2": (0.0, 0.0), "p1": (0.05, 0.06)})
    plan = same(mpc, X0)
    assert plan.x[-1][[1, 3]] == pytest.approx(0.0, abs=1e-8)
    assert plan.x[-1][0] == pytest.approx(0.06, abs=1e-8)
    assert np.abs(plan.x[:-1, 1]).max() > 0.1
    turning = pendulum(solver, terminal_limits={"phi": (0.3, 0.3), "rate": (0.0, 0.0)})
    there = same(turning, np.zeros(2), wind=0.0)
    assert there.x[-1] == pytest.approx([0.3, 0.0], abs=1e-7)


def test_an_end_that_cannot_be_reached_is_said(solver):
    mpc = masses(solver, limits={"a1": 0.1, "a2": 0.1}, terminal_limits={"p1": (3.0, 3.0)})
    assert mpc.ocp.limited == ("p1",)
    assert mpc.plan(X0).status is Status.INFEASIBLE
    with pytest.raises(ParameterError, match="at the end 'p1'"):
        replace(mpc, limits={"p1": 1.0})


def test_the_end_of_a_car_is_its_lqr(solver):
    car = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05))
    mpc = MPC(
        car, horizon=6, controls=("delta",), Q={"e_y": 1.0, "e_psi": 2.0}, S={"delta": 20.0}, limits={"delta": 0.3},
        solver=solver,
    )  # fmt: skip
    cost = lqr(mpc, v_x=20.0)
    assert set(cost.names) == {"v_y", "r", "e_y", "e_psi", "delta"}
    x = np.zeros(car.n_states)
    x[car.states.index("Y")] = 0.1
    goal = {"X": np.arange(7) * 1.0, "Y": 0.0, "psi": 0.0, "v_x": 20.0}
    short = same(replace(mpc, terminal=cost), x, **goal)
    far = replace(mpc, horizon=80, solver=Ipopt()).plan(x, **{**goal, "X": np.arange(81) * 1.0})
    assert short.command == pytest.approx(far.command, rel=2e-2)
    assert abs(mpc.plan(x, **goal).command - far.command)[0] > 2 * abs(short.command - far.command)[0]
    with pytest.raises(ParameterError, match="steady state"):
        lqr(replace(mpc, Q={"e_x": 1.0}), v_x=20.0)  # which steering does not change


def test_a_matrix_that_is_none_is_refused():
    for P in ([[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.0, 1.0]], [[1.0]], "P", [[np.nan, 0], [0, 1]]):
        with pytest.raises(ParameterError, match="terminal matrix"):
            TerminalCost(("p1", "v1"), P)
    with pytest.raises(ParameterError, match="each error once"):
        TerminalCost(("p1", "p1"), np.eye(2))
    with pytest.raises(ParameterError, match="'p9'"):
        masses(RealTime(), terminal=TerminalCost(("p9",), [[1.0]]))
    rank_one = TerminalCost(("a", "b", "c"), np.outer([1, 2, 3], [1, 2, 3]))
    assert rank_one.rows.T @ rank_one.rows == pytest.approx(rank_one.matrix)
    assert len(rank_one.rows) == 1


# ---- over the horizon ----------------------------------------------------------------------------------------------


def test_parameters_of_terms_have_a_value_at_every_node(solver):
    built = pendulum(
        solver,
        parameters=("most", "way"),
        terms={"room": lambda x, u, p: u[0] - p.most, "off": lambda x, u, p: p.arm * x[0] - p["way"]},
        Q={"off": 30.0},
        limits={"a": 12.0, "room": (-np.inf, 0.0)},
    )
    most, way = np.linspace(1.0, 9.0, 13), 0.2 * np.linspace(0.0, 1.0, 13) ** 2
    x = np.array([-0.1, 0.0])
    plan = same(built, x, wind=0.1, most=most, way=way)
    assert (plan.u[:, 0] <= most[:12] + 1e-8).all()
    assert (plan.u[:, 0] > most[:12] - 1e-6).any()
    other = same(built, x, wind=0.1, most=most[::-1].copy(), way=way)
    assert np.abs(plan.u - other.u).max() > 0.1


def test_limits_change_over_the_horizon_without_compiling(solver):
    mpc = pendulum(solver, limits={"a": 12.0, "rate": np.inf}, slack={})
    low, high = np.full(13, -np.inf), np.linspace(0.2, 0.6, 13)
    x = np.array([-0.4, 0.0])
    free = same(mpc, x, wind=0.0)
    plan = same(mpc, x, wind=0.0, limits={"rate": (low, high)})
    assert (plan.x[1:, 1] <= high[1:] + 1e-8).all()
    assert np.abs(plan.x[1:, 1] - high[1:]).min() < 1e-7
    assert (free.x[1:, 1] > high[1:] + 0.05).any()
    goal = mpc.setpoint(wind=0.0, limits={"rate": (low, high)})
    later = mpc.plan(plan.x[1], goal, plan)  # from the plan before, and after it without
    assert later.status.solved
    assert later.x[1:, 1].max() <= 0.6 + 1e-6
    again = mpc.plan(x, wind=0.0)
    assert again.u == pytest.approx(free.u, abs=1e-6)
    usual = mpc.plan(again.x[1], mpc.setpoint(wind=0.0), again)
    assert usual.x[1:, 1].max() > 0.65


def test_weights_change_over_the_horizon_without_compiling(solver):
    mpc = pendulum(solver, S={"a": 0.01}, terminal={"phi": 50.0})
    x, rising = np.array([-0.4, 0.5]), np.linspace(0.0, 20.0, 13)
    plan = same(mpc, x, wind=0.0, Q={"phi": rising, "rate": 0.3}, R={"a": 0.02}, S={"a": np.linspace(0.1, 0.0, 12)})
    before = np.concatenate([[0.0], plan.u[:-1, 0]])
    cost = (rising * plan.x[:, 0] ** 2).sum() + (0.3 * plan.x[:-1, 1] ** 2).sum() + (0.02 * plan.u**2).sum()
    cost += (np.linspace(0.1, 0.0, 12) * (plan.u[:, 0] - before) ** 2).sum()
    assert plan.cost == pytest.approx(cost, rel=1e-8)
    assert mpc.plan(x, wind=0.0).u == pytest.approx(replace(mpc).plan(x, wind=0.0).u, abs=1e-7)


def test_one_number_is_a_limit_either_way():
    mpc = pendulum(RealTime(), limits={"a": 12.0, "rate": 3.0})
    plans = [mpc.plan(np.array([0.5, 0.0]), wind=0.0, limits={"rate": both}) for both in (0.4, np.array([-0.4, 0.4]))]
    assert (plans[0].u == plans[1].u).all()
    assert abs(plans[0].x[:, 1]).max() <= 0.4 + 1e-6


def test_what_changes_is_checked():
    mpc = pendulum(RealTime(), limits={"a": 12.0, "rate": 3.0})
    for bad, said in (
        ({"limits": {"a": (-1.0, 1.0)}}, "limits names 'a'"),
        ({"limits": {"rate": (1.0,)}}, "a lower and an upper one"),
        ({"limits": {"rate": np.ones(3)}}, "a lower and an upper one"),
        (
            {"limits": {"rate": (2.0, 1.0)}},
            "limits of 2 and 1 for 'rate' at node 0; expected a lower one no higher than",
        ),
        ({"limits": {"rate": (-1.0, np.ones(12))}}, "expected 13|expected .13"),
        ({"Q": {"wind": 1.0}}, "Q names 'wind'"),
        ({"Q": {"phi": np.append(np.ones(12), -1.0)}}, "a weight of -1 for 'phi' at node 12; expected a finite number"),
        ({"S": {"a": 1.0}}, "S names 'a'"),
        ({"R": {"a": np.ones(5)}}, "expected a number or 12, one per stage"),
    ):
        with pytest.raises(ParameterError, match=said):
            mpc.plan(np.zeros(2), wind=0.0, **bad)
    for taken in ("phi", "a", "e_y"):
        with pytest.raises(ParameterError, match="parameters are"):
            replace(mpc, parameters=(taken,))
    read = {"slip": lambda x, u, p: p.mu * x[0]}
    with pytest.raises(ParameterError, match="'mu'"):
        replace(mpc, parameters=("mu",), terms=read, Q={"phi": 1.0, "slip": 1.0}).plan(np.zeros(2), wind=0.0)
    assert isinstance(mpc.ocp, OCP)
