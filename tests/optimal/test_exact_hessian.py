"""Costs that are no squares: the exact Hessian ends where a plain program by Ipopt does, and Gauss-Newton nowhere."""

import casadi as ca
import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.control.mpc import MPC
from slipangle.control.phases import Phases
from slipangle.errors import ParameterError
from slipangle.models.custom import Ode
from slipangle.ops import exp, sin
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.joined import Joined
from slipangle.optimal.realtime import RealTime, backend
from slipangle.optimal.realtime.curvature import curvature_function
from slipangle.optimal.solution import CURVED, Status
from slipangle.optimal.terms import Limits, Weights

pytestmark = pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())

N, DT = 12, 0.1


def economic(x, u, p):
    """Never below zero, and no square."""
    return (x[0] - 1.0) ** 4 + exp(0.5 * x[1]) + exp(-0.5 * x[1]) + 0.1 * u[0] ** 2 + 0.05 * u[0] ** 4


def posed(qp="auto", hessian="exact", **settings):
    """A pendulum whose cost comes by the price of a limit at zero that is always exceeded."""
    model = Ode(
        f=lambda x, u, p: [x[1], u[0] - sin(x[0])],
        states=("phi", "rate"),
        inputs=("a",),
        params={},
        dt=DT,
        substeps=1,
    )
    usual = {
        "horizon": N,
        "controls": ("a",),
        "Q": {},
        "terminal": Weights(rate=0.5),
        "limits": Limits(a=3.0, cost=(-np.inf, 0.0), rate=1.2),
        "terms": {"cost": economic},
        "slack_linear": Weights(cost=1.0),
        "solver": RealTime(iterations=0, tolerance=1e-11, qp=qp, hessian=hessian, max_iterations=100),
    }
    return MPC(model, **(usual | settings))


def plain(x0):
    u, x, cost, rates = ca.SX.sym("u", N), ca.SX(x0), 0, []

    def rate(x, a):
        return ca.vertcat(x[1], a - ca.sin(x[0]))

    for k in range(N):
        cost += economic(x, [u[k]], None)
        k1 = rate(x, u[k])
        k2 = rate(x + DT / 2 * k1, u[k])
        k3 = rate(x + DT / 2 * k2, u[k])
        k4 = rate(x + DT * k3, u[k])
        x = x + DT / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        rates.append(x[1])
    cost += 0.5 * x[1] ** 2 + economic(x, [u[N - 1]], None)  # the end is limited too, and sees the last input
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-13, "bound_relax_factor": 0.0}}
    solve = ca.nlpsol("plain", "ipopt", {"x": u, "f": cost, "g": ca.vertcat(*rates)}, options)
    found = solve(x0=0.0, lbx=-3.0, ubx=3.0, lbg=-1.2, ubg=1.2)
    return float(found["f"]), np.asarray(found["x"]).ravel()


@pytest.mark.parametrize("qp", ["condensed", "riccati"])
def test_an_economic_cost_ends_where_a_plain_program_does(qp):
    exact, gauss_newton, rng, lost = posed(qp), posed(qp, "gauss-newton"), np.random.default_rng(1), 0
    for _ in range(6):
        x = rng.uniform(-0.8, 0.8, 2)
        plan = exact.plan(x, rate=0.0)
        cost, u = plain(x)
        assert plan.status.solved
        assert plan.iterations < 25
        assert plan.cost == pytest.approx(cost, rel=1e-10)
        assert plan.u[:, 0] == pytest.approx(u, abs=1e-8)
        again = exact.plan(x, rate=0.0, previous=plan, applied=plan.command)
        assert again.u == pytest.approx(plan.u, abs=1e-8)
        other = gauss_newton.plan(x, rate=0.0)
        lost += not (other.status is Status.SOLVED and other.cost < cost * (1 + 1e-6))
        assert (CURVED in other.message) == (other.status is not Status.SOLVED)
        assert CURVED not in plan.message
    assert lost == 6  # none converges; one may come near by its last iteration


@pytest.mark.parametrize("qp", ["condensed", "riccati"])
def test_it_begins_where_a_cost_is_at_its_least_and_has_no_curvature(qp):
    """At rest nothing wears: the price of the limit is known before any multiplier is."""
    wearing = {"cost": lambda x, u, p: x[1] ** 4 + 0.1 * u[0] ** 2 + 0.05 * u[0] ** 4}
    limits = Limits(a=2.0, cost=(-np.inf, 0.0))
    settings = {"terms": wearing, "limits": limits, "terminal_limits": Limits(phi=(0.2, 0.2))}
    ours = posed(qp, **settings).plan(np.zeros(2), rate=0.0)
    theirs = posed(**settings | {"solver": Ipopt(tolerance=1e-13)}).plan(np.zeros(2), rate=0.0)
    assert ours.status.solved
    assert ours.u == pytest.approx(theirs.u, abs=1e-7)


def test_squares_alone_take_fewer_steps_too():
    """Large errors that stay: Gauss-Newton steps are slow, second derivatives are not."""
    far = {"Q": Weights(phi=3.0), "limits": Limits(a=1.0), "terms": {}, "slack_linear": {}, "R": Weights(a=0.01)}
    plans = [posed(hessian=h, **far).plan(np.array([0.3, 0.0]), phi=2.5, rate=0.0) for h in ("exact", "gauss-newton")]
    assert plans[0].u == pytest.approx(plans[1].u, abs=1e-7)
    assert plans[0].iterations <= plans[1].iterations


def test_second_derivatives_are_those_of_differences():
    """Of the whole Lagrangian, at a random point with random multipliers."""
    ocp = Joined(posed().ocp, curved=True)
    function, rng, h = curvature_function(ocp), np.random.default_rng(2), 1e-5
    given = [rng.normal(size=function.size1_in(i)) for i in range(7)]
    x, u, w, p, pi, mu, nu = given
    w[-1] = 0.0

    def lagrangian(z):
        error, limited = ocp.stage(z[:2], z[2:], w, p)
        return float(ca.dot(pi, ocp.dynamics(z[:2], z[2:], w)) + ca.dot(mu, limited) + ca.dot(nu, error))

    at, moves = np.concatenate([x, u]), np.eye(3) * h
    both = [
        [
            (lagrangian(at + a + b) - lagrangian(at + a - b) - lagrangian(at - a + b) + lagrangian(at - a - b))
            / 4
            / h**2
            for a in moves
        ]
        for b in moves
    ]
    assert np.asarray(function(x, u, w, p, pi, mu, nu)) == pytest.approx(np.array(both), rel=1e-3, abs=1e-3)


def test_what_it_does_not_go_with_is_said(monkeypatch):
    with pytest.raises(ParameterError, match="iterations=0"):
        RealTime(hessian="exact")
    x = np.zeros(2)
    with pytest.raises(ParameterError, match="several steps long"):
        posed(steps=(1,) * (N - 1) + (2,)).plan(x, rate=0.0)
    stiff = Ode(
        f=lambda x, u, p: [x[1], u[0] - x[0]], states=("phi", "rate"), inputs=("a",), params={}, dt=DT, method="radau"
    )
    with pytest.raises(ParameterError, match="implicit integrator"):
        MPC(stiff, horizon=3, Q=Weights(phi=1.0), controls=("a",), solver=posed().solver).plan(x, phi=0.0)
    with pytest.raises(ParameterError, match="several phases"):
        Phases([posed(), posed()], solver=posed().solver).plan(x, [{"rate": 0.0}] * 2)
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    monkeypatch.setattr(backend, "_say_once", lambda words: None)
    with pytest.raises(ParameterError, match="no C compiler"):
        posed().plan(x, rate=0.0)


def test_an_exact_hessian_is_named_only_where_there_is_one(monkeypatch):
    """Not to who takes real-time iterations, whose first plan is to convergence, nor beside an implicit integrator."""
    x = np.array([0.7, -0.5])
    for settings in ({"solver": RealTime(max_iterations=3)}, {"steps": (1,) * (N - 1) + (2,)}):
        usual = {"solver": RealTime(iterations=0, max_iterations=3)} | settings
        plan = posed(**usual).plan(x, rate=0.0)
        assert not plan.status.solved
        assert CURVED not in plan.message
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    monkeypatch.setattr(backend, "_say_once", lambda words: None)
    plan = posed(solver=RealTime(iterations=0, max_iterations=3)).plan(x, rate=0.0)
    assert plan.status is Status.ITERATION_LIMIT
    assert CURVED not in plan.message


def test_it_is_what_ipopt_finds_with_a_huber_cost():
    settings = {"huber": Weights(phi=0.2), "Q": Weights(phi=2.0)}
    ours = posed(**settings).plan(np.array([-0.5, 0.3]), phi=0.5, rate=0.0)
    theirs = posed(**settings, solver=Ipopt(tolerance=1e-12)).plan(np.array([-0.5, 0.3]), phi=0.5, rate=0.0)
    assert ours.status.solved
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-9)
    assert ours.u == pytest.approx(theirs.u, abs=1e-7)
