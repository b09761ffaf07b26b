"""A Huber cost posed by an excess that is decided too, against Ipopt on the Huber function itself."""

import warnings

import casadi as ca
import numpy as np
import pytest

from slipangle.control.mpc import MPC
from slipangle.errors import ModelWarning
from slipangle.models.custom import Ode
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.terms import Limits, Weights

N, DT = 15, 0.1
COUNTS = np.append(np.ones(N), 0.0)  # at the end the last excess would be paid once more


def posed(weight, bend, stiffness, qp):
    """A mass on a hardening spring whose position is tracked by a Huber cost."""
    model = Ode(
        f=lambda x, u, p: [x[1], u[0] - p.stiffness * x[0] ** 3],
        states=("p", "v"),
        inputs=("a", "over"),
        outputs=(),
        params={"stiffness": stiffness},
        dt=DT,
        substeps=1,
    )
    return MPC(
        model,
        horizon=N,
        controls=("a", "over"),
        parameters=("wanted", "counts"),
        terms={"near": lambda x, u, p: x[0] - p.wanted - u[1], "excess": lambda x, u, p: p.counts * u[1]},
        Q=Weights(near=weight, v=0.5),
        R=Weights(a=0.1),
        limits=Limits(a=2.0, excess=(0.0, 0.0)),
        slack_linear=Weights(excess=2 * weight * bend),
        terminal=Weights(v=1.0),
        solver=RealTime(iterations=0, qp=qp),
    )


def huber(e, weight, bend):
    return ca.if_else(ca.fabs(e) <= bend, weight * e**2, weight * bend * (2 * ca.fabs(e) - bend))


def plain(x, wanted, weight, bend, stiffness):
    """Cost and inputs by Ipopt, one classical Runge-Kutta step per stage."""
    u, at, cost = ca.SX.sym("u", N), ca.SX(x), 0

    def rate(x, a):
        return ca.vertcat(x[1], a - stiffness * x[0] ** 3)

    for k in range(N):
        cost += huber(at[0] - wanted, weight, bend) + 0.5 * at[1] ** 2 + 0.1 * u[k] ** 2
        k1 = rate(at, u[k])
        k2 = rate(at + DT / 2 * k1, u[k])
        k3 = rate(at + DT / 2 * k2, u[k])
        k4 = rate(at + DT * k3, u[k])
        at = at + DT / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    cost += at[1] ** 2
    quiet = {"print_level": 0, "sb": "yes", "tol": 1e-13, "bound_relax_factor": 0.0}
    solve = ca.nlpsol("plain", "ipopt", {"x": u, "f": cost}, {"print_time": False, "ipopt": quiet})
    found = solve(x0=0.0, lbx=-2.0, ubx=2.0)
    return float(found["f"]), np.asarray(found["x"]).ravel()


@pytest.mark.parametrize("qp", ["condensed", "riccati"])
def test_random_problems_end_as_those_with_the_huber_function(qp):
    rng, linear, square = np.random.default_rng(3), 0, 0
    problem = rng.uniform(2.0, 10.0), rng.uniform(0.1, 0.4), rng.uniform(0.0, 0.5)
    bend = problem[1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        mpc = posed(*problem, qp)
        for _ in range(6):
            x, wanted = rng.uniform(-1.0, 1.0, 2), rng.uniform(-0.5, 0.5)
            plan = mpc.plan(x, wanted=wanted, counts=COUNTS, v=0.0)
            cost, u = plain(x, wanted, *problem)
            assert plan.status.solved
            assert plan.cost == pytest.approx(cost, rel=1e-8)
            assert plan.u[:, 0] == pytest.approx(u, abs=1e-7)
            e = plan.x[:-1, 0] - wanted
            assert plan.u[:, 1] == pytest.approx(np.sign(e) * np.maximum(np.abs(e) - bend, 0.0), abs=1e-7)
            linear, square = linear + (np.abs(e) > bend).sum(), square + (np.abs(e) < bend).sum()
    assert linear > 5
    assert square > 5
