"""Huber costs by name, against Ipopt on the Huber function itself in a plain program."""

import casadi as ca
import numpy as np
import pytest

from slipangle.control.mpc import MPC
from slipangle.errors import ParameterError
from slipangle.models.custom import Ode
from slipangle.optimal.end import TerminalCost
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.scenarios import Scenarios
from slipangle.optimal.terms import Limits, Weights

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler was found")

N, DT = 15, 0.1


def posed(qp="auto", stiffness=0.3, **settings):
    """A mass on a hardening spring."""
    model = Ode(
        f=lambda x, u, p: [x[1], u[0] - p.stiffness * x[0] ** 3],
        states=("p", "v"),
        inputs=("a",),
        outputs=(),
        params={"stiffness": stiffness},
        dt=DT,
        substeps=1,
    )
    usual = {
        "horizon": N,
        "controls": ("a",),
        "Q": Weights(p=5.0, v=0.5),
        "R": Weights(a=0.1),
        "limits": Limits(a=2.0),
        "huber": Weights(p=0.2),
    }
    return MPC(model, solver=RealTime(iterations=0, tolerance=1e-11, qp=qp), **{**usual, **settings})


def huber(e, weight, bend):
    return ca.if_else(ca.fabs(e) <= bend, weight * e**2, weight * bend * (2 * ca.fabs(e) - bend))


def after(x, a, stiffness):
    """One classical Runge-Kutta step."""

    def rate(x):
        return ca.vertcat(x[1], a - stiffness * x[0] ** 3)

    k1 = rate(x)
    k2 = rate(x + DT / 2 * k1)
    k3 = rate(x + DT / 2 * k2)
    k4 = rate(x + DT * k3)
    return x + DT / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def minimum(cost, u, bound=2.0):
    """The least cost and its inputs, by Ipopt."""
    quiet = {"print_level": 0, "sb": "yes", "tol": 1e-13, "bound_relax_factor": 0.0}
    solve = ca.nlpsol("plain", "ipopt", {"x": u, "f": cost}, {"print_time": False, "ipopt": quiet})
    found = solve(x0=0.0, lbx=-bound, ubx=bound)
    return float(found["f"]), np.asarray(found["x"]).ravel()


def rolled(x, u, wanted, weights, bend, stiffness, lengths=(1,) * N):
    """Cost of inputs, with a weight of the position at each node."""
    at, cost = ca.SX(x), 0
    for k, length in enumerate(lengths):
        cost += huber(at[0] - wanted, length * weights[k], bend) + length * (0.5 * at[1] ** 2 + 0.1 * u[k] ** 2)
        for _ in range(length):
            at = after(at, u[k], stiffness)
    return cost + huber(at[0] - wanted, weights[-1], bend) + 0.5 * at[1] ** 2, at


@pytest.mark.parametrize("qp", ["condensed", "riccati"])
def test_random_problems_end_as_those_with_the_huber_function(qp):
    rng, linear, square = np.random.default_rng(3), 0, 0
    weight, bend, stiffness = rng.uniform(2.0, 10.0), rng.uniform(0.1, 0.4), rng.uniform(0.0, 0.5)
    mpc = posed(qp, stiffness, Q=Weights(p=weight, v=0.5), huber=Weights(p=bend))
    for _ in range(8):
        x, wanted = rng.uniform(-1.0, 1.0, 2), rng.uniform(-0.5, 0.5)
        plan = mpc.plan(x, p=wanted, v=0.0)
        u = ca.SX.sym("u", N)
        cost, best = minimum(rolled(x, u, wanted, [weight] * (N + 1), bend, stiffness)[0], u)
        assert plan.status.solved
        assert plan.cost == pytest.approx(cost, rel=1e-10)
        assert plan.u == pytest.approx(best[:, None], abs=1e-8)
        again = mpc.plan(x, p=wanted, v=0.0, previous=plan, applied=plan.command)
        assert again.u == pytest.approx(plan.u, abs=1e-8)
        e = np.abs(plan.x[:, 0] - wanted)
        linear, square = linear + (e > bend).sum(), square + (e < bend).sum()
    assert linear > 5
    assert square > 5


@pytest.mark.parametrize("qp", ["condensed", "riccati"])
def test_weights_over_the_horizon_and_at_the_end_are_bent_too(qp):
    x, u = np.array([1.0, -0.3]), ca.SX.sym("u", N)
    weights = np.append(np.linspace(0.0, 8.0, N), 30.0)
    mpc = posed(qp, terminal=Weights(p=3.0, v=0.5))
    plan = mpc.plan(x, p=-0.4, v=0.0, Q={"p": weights})
    cost, best = minimum(rolled(x, u, -0.4, weights, 0.2, 0.3)[0], u)
    assert plan.cost == pytest.approx(cost, rel=1e-10)
    assert plan.u == pytest.approx(best[:, None], abs=1e-8)


@pytest.mark.parametrize("qp", ["condensed", "riccati"])
def test_stages_of_several_steps_count_as_often(qp):
    lengths, x = (1, 1, 1, 2, 2, 3, 4), np.array([1.2, 0.4])
    u = ca.SX.sym("u", len(lengths))
    mpc = posed(qp, horizon=len(lengths), steps=lengths)
    plan = mpc.plan(x, p=0.1, v=0.0)
    cost, best = minimum(rolled(x, u, 0.1, [5.0] * (len(lengths) + 1), 0.2, 0.3, lengths)[0], u)
    assert plan.cost == pytest.approx(cost, rel=1e-10)
    assert plan.u == pytest.approx(best[:, None], abs=1e-8)


@pytest.mark.parametrize("qp", ["condensed", "riccati", "interpreted"])
def test_scenarios_have_huber_costs_of_their_own(qp, monkeypatch):
    """Three inputs in common, then two branches; and a bend that a full matrix at the end does not have."""
    if qp == "interpreted":
        monkeypatch.setenv("SLIPANGLE_CC", "none")
        qp = "auto"
    x, values, share, common = np.array([1.0, 0.5]), (0.1, 2.0), (0.3, 0.7), 3
    mpc = posed(qp, scenarios=Scenarios({"stiffness": values}, probabilities=share, common=common))
    plan = mpc.plan(x, p=-0.2, v=0.0)
    u = ca.SX.sym("u", N + N - common)
    branches = u[:N], ca.vertcat(u[:common], u[N:])
    cost = sum(
        s * rolled(x, b, -0.2, [5.0] * (N + 1), 0.2, k)[0] for s, b, k in zip(share, branches, values, strict=True)
    )
    cost, best = minimum(cost, u)
    assert plan.cost == pytest.approx(cost, rel=1e-10)
    assert plan.branches[0].u == pytest.approx(best[:N, None], abs=1e-8)
    assert plan.branches[1].u == pytest.approx(np.append(best[:common], best[N:])[:, None], abs=1e-8)


@pytest.mark.parametrize("qp", ["condensed", "riccati"])
def test_a_full_matrix_at_the_end_is_not_bent(qp):
    x, P, u = np.array([1.0, 0.5]), np.array([[4.0, 1.0], [1.0, 2.0]]), ca.SX.sym("u", N)
    plan = posed(qp, terminal=TerminalCost(("p", "v"), P)).plan(x, p=-0.2, v=0.0)
    cost, at = rolled(x, u, -0.2, [5.0] * N + [0.0], 0.2, 0.3)
    e = at - ca.DM([-0.2, 0.0])
    cost, best = minimum(cost - 0.5 * at[1] ** 2 + ca.bilin(ca.DM(P), e, e), u)
    assert plan.cost == pytest.approx(cost, rel=1e-10)
    assert plan.u == pytest.approx(best[:, None], abs=1e-8)


def test_what_makes_no_sense_is_said():
    with pytest.raises(ParameterError, match="weight in Q or terminal"):
        posed(huber=Weights(a=0.1))
    with pytest.raises(ParameterError, match="the bend of 'p' in huber is 0"):
        posed(huber=Weights(p=0.0))
    with pytest.raises(ParameterError, match="whose Huber cost ends before"):
        posed(terminal=Weights(v=0.5)).plan(np.zeros(2), p=0.0, v=0.0, Q={"p": np.full(N + 1, 2.0)})
