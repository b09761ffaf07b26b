"""Scenarios, free parameters and a free duration, against a plain program with every branch written out."""

import warnings
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from slipangle.control.mpc import MPC
from slipangle.errors import ModelWarning, ParameterError
from slipangle.models.custom import Ode
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime import RealTime, backend
from slipangle.optimal.scenarios import Scenarios
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights
from tests.optimal.linear import double_integrator
from tests.oracles import branches

N = 12


@pytest.fixture(params=["condensed", "riccati", "interpreted", "ipopt"])
def solver(request, monkeypatch):
    """Every solver, iterated to convergence."""
    if request.param == "interpreted":
        monkeypatch.setenv("SLIPANGLE_CC", "none")
        backend._say_once.cache_clear()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        if request.param == "ipopt":
            yield Ipopt(tolerance=1e-11)
        else:
            yield RealTime(iterations=0, qp=request.param if request.param != "interpreted" else "auto")


LESS = pytest.mark.parametrize(
    "solver", [pytest.param("condensed", marks=pytest.mark.slow), "riccati", "interpreted", "ipopt"], indirect=True
)


def spring(**settings):
    """A mass on a hardening spring, whose drive is not known well."""
    return Ode(
        f=lambda x, u, p: [x[1], p.gain * u[0] - p.damping * x[1] - 0.3 * x[0] * x[0] * x[0]],
        states=("p", "v"),
        inputs=("a",),
        outputs=(),
        params={"gain": 1.0, "damping": 0.2},
        dt=0.1,
        **settings,
    )


def posed(solver, **settings):
    usual = {
        "horizon": N,
        "controls": ("a",),
        "Q": Weights(p=5.0, v=0.1),
        "R": Weights(a=0.05),
        "S": Weights(a=0.1),
        "limits": Limits(a=2.0, v=0.8),
        "rates": Limits(a=12.0),
        "slack": Weights(v=50.0),
        "slack_linear": Weights(v=10.0),
    }
    return MPC(spring(), solver=solver, **{**usual, **settings})


def plain(step, **more):
    """The same problem for the oracle."""
    weigh = ca.DM([5.0, 0.1])
    return {
        "step": step,
        "stage": lambda x, u, value, once: ca.dot(weigh, x**2) + 0.05 * u[0] ** 2,
        "end": lambda x, once: ca.dot(weigh, x**2),
        "values": [1.0],
        "shares": [1.0],
        "horizon": N,
        "common": 1,
        "bounds": [(-2.0, 2.0)],
        "applied": [0.0],
        "change": [0.1],
        "rate": 1.2,
        "soft": (1, 0.8, 50.0, 10.0),
        **more,
    }


def test_every_branch_is_that_of_the_plain_program(solver):
    common = 2
    gains, shares, x = (0.5, 1.0, 1.5), (0.2, 0.5, 0.3), np.array([1.0, 0.0])
    mpc = posed(solver, scenarios=Scenarios({"gain": gains}, probabilities=shares, common=common))
    plan = mpc.plan(x, p=0.0, v=0.0)
    models = {gain: spring().with_values(gain=gain) for gain in gains}
    cost, inputs, states, _ = branches.solve(
        plain(lambda x, u, gain, once: models[gain].functions[0](x, u), values=gains, shares=shares, common=common), x
    )
    assert plan.status in (Status.SOLVED, Status.ACCEPTABLE)
    assert plan.cost == pytest.approx(cost, rel=1e-8)
    assert [b.probability for b in plan.branches] == list(shares)
    for branch, u, at in zip(plan.branches, inputs, states, strict=True):
        assert branch.u == pytest.approx(u, abs=1e-6)
        assert branch.x == pytest.approx(at, abs=1e-6)
    first = np.array([b.u[:common] for b in plan.branches])
    assert np.ptp(first, axis=0).max() < 1e-9
    assert np.ptp([b.u for b in plan.branches], axis=0).max() > 0.1
    assert (plan.u == plan.branches[1].u).all()  # the most probable one
    after = mpc.plan(plan.x[1], p=0.0, v=0.0, previous=plan, applied=plan.command)
    again = posed(solver, scenarios=mpc.ocp.scenarios).plan(plan.x[1], p=0.0, v=0.0, applied=plan.command)
    assert after.status.solved
    assert after.cost == pytest.approx(again.cost, rel=1e-8)


@LESS
def test_values_of_scenarios_change_with_the_plan(solver):
    x = np.array([1.0, 0.0])
    mpc = posed(solver, scenarios=Scenarios({"gain": (0.5, 1.5)}))
    said = mpc.plan(x, p=0.0, v=0.0, scenarios={"gain": (0.8, np.linspace(1.0, 1.2, N + 1))})
    models = [spring().with_values(gain=gain) for gain in (0.8, *np.linspace(1.0, 1.2, N + 1))]
    ramp = iter(models[1:])

    def step(at, u, which, once):
        return (models[0] if which == 0 else next(ramp)).functions[0](at, u)

    cost, inputs, *_ = branches.solve(plain(step, values=[0, 1], shares=[0.5, 0.5]), x)
    assert said.cost == pytest.approx(cost, rel=1e-8)
    assert [b.u for b in said.branches] == [pytest.approx(u, abs=1e-6) for u in inputs]


def test_a_free_parameter_and_the_common_inputs_are_those_of_the_plain_program(solver):
    x = np.array([0.3, 0.0])
    mpc = posed(
        solver,
        Q=Weights(p=5.0, v=0.1),
        terminal=Weights(p=5.0, v=0.1, damping=0.4),
        free=Limits(damping=(0.1, 4.0)),
        scenarios=Scenarios({"gain": (0.5, 1.5)}),
    )
    plan = mpc.plan(x, p=1.0, v=0.0, applied=np.array([0.4]))
    weigh = ca.DM([5.0, 0.1])
    model = Ode(
        f=lambda x, u, p: [x[1], u[2] * u[0] - u[1] * x[1] - 0.3 * x[0] * x[0] * x[0]],
        states=("p", "v"),
        inputs=("a", "damping", "gain"),
        params={},
        dt=0.1,
    )
    cost, inputs, _, once = branches.solve(
        plain(
            lambda x, u, gain, once: model.functions[0](x, ca.vertcat(u, once, gain)),
            stage=lambda x, u, value, once: ca.dot(weigh, (x - ca.DM([1.0, 0.0])) ** 2) + 0.05 * u[0] ** 2,
            end=lambda x, once: ca.dot(weigh, (x - ca.DM([1.0, 0.0])) ** 2) + 0.4 * once[0] ** 2,
            values=[0.5, 1.5],
            shares=[0.5, 0.5],
            applied=[0.4],
            once=[(0.1, 4.0)],
        ),
        x,
    )
    assert plan.decided is not None
    assert plan.decided["damping"] == pytest.approx(once[0], abs=1e-5)
    assert plan.cost == pytest.approx(cost, rel=1e-8)
    assert [b.u for b in plan.branches] == [pytest.approx(u, abs=1e-5) for u in inputs]
    assert mpc.plan(plan.x[1], p=1.0, v=0.0, previous=plan).status.solved


def test_a_parameter_of_terms_alone_is_free(solver):
    """The best height of a level, in the mean of squares, is the mean of the states."""
    mpc = posed(
        solver,
        parameters=("level",),
        terms={"above": lambda x, u, p: x[0] - p.level},
        Q=Weights(above=3.0, v=0.1),
        slack={},
        slack_linear={},
        limits=Limits(a=2.0),
        free=Limits(level=(-5.0, 5.0)),
    )
    plan = mpc.plan(np.array([1.0, 0.5]), v=0.0, level=0.3)
    assert plan.decided is not None
    assert plan.status.solved
    assert plan.decided["level"] == pytest.approx(plan.x[:, 0].mean(), abs=1e-7)


@pytest.mark.parametrize("tolerance", [1e-9, 1e-12])
def test_the_shortest_time_between_two_rests_is_known(solver, tolerance):
    """A mass under a bounded force: full push to the middle, full brake from there, twice the root of the distance.

    The inputs hardly count, so what rounding leaves of them is far above the smaller tolerance.
    """
    solver = replace(solver, tolerance=tolerance)
    mass = Ode(f=lambda x, u, p: [x[1], u[0]], states=("p", "v"), inputs=("a",), outputs=(), params={}, dt=0.1)
    mpc = MPC(
        mass,
        horizon=20,
        controls=("a",),
        Q=Weights(),
        terminal=Weights(duration=1.0),
        R=Weights(a=1e-7),
        limits=Limits(a=1.0),
        terminal_limits=Limits(p=(0.0, 0.0), v=(0.0, 0.0)),
        duration=(0.5, 10.0),
        solver=solver,
    )
    plan = mpc.plan(np.array([-2.25, 0.0]))
    assert plan.status.solved
    assert plan.decided == {"duration": pytest.approx(3.0, abs=1e-6)}
    assert plan.u[:, 0] == pytest.approx(np.repeat([1.0, -1.0], 10), abs=1e-5)
    assert plan.times is not None
    assert plan.times[-1] == pytest.approx(3.0, abs=1e-6)
    assert replace(mpc, duration=(0.5, 2.5)).plan(np.array([-2.25, 0.0])).status is Status.INFEASIBLE


@LESS
def test_implicit_models_have_scenarios_on_the_quick_path(solver):
    """Wheels in steps of Radau IIA, a lane, and an output that hangs on the steering: against the branches apart."""
    if isinstance(solver, Ipopt):
        pytest.skip("judged by it")
    stiff = Ode(
        f=lambda x, u, p: [40.0 * (p.gain * u[0] * (1.0 - 0.2 * x[0] * x[0]) - x[0]), x[0], 0.3 * x[1] - x[2]],
        states=("force", "v", "lag"),
        inputs=("a",),
        more=lambda x, u, p: {"felt": x[0] + 0.1 * u[0]},
        outputs=("felt",),
        params={"gain": 1.0},
        dt=0.1,
        method="radau",
    )
    mpc = MPC(
        stiff,
        horizon=10,
        controls=("a",),
        Q=Weights(v=2.0, felt=0.3, lag=0.1),
        R=Weights(a=0.1),
        limits=Limits(a=1.0, felt=0.6),
        scenarios=Scenarios({"gain": (0.6, 1.0)}, common=2),
        solver=solver,
    )
    x, plan = np.array([0.0, 1.0, 0.0]), None
    theirs = replace(mpc, solver=Ipopt(tolerance=1e-11))
    for _ in range(3):
        plan = mpc.plan(x, previous=plan, applied=np.zeros(1) if plan is None else None)
        other = theirs.plan(x, applied=np.zeros(1))
        assert plan.status.solved
        assert plan.cost == pytest.approx(other.cost, rel=1e-7)
        assert [b.u for b in plan.branches] == [pytest.approx(b.u, abs=1e-5) for b in other.branches]
        x = np.asarray(stiff.with_values(gain=0.6).step(x, plan.command)).ravel()


def test_real_time_iterations_follow_the_worst_scenario():
    """In the loop with the weakest drive, one iteration a plan ends where converged plans end."""
    scenarios = Scenarios({"gain": (0.5, 1.5)}, common=1)
    ends = []
    for iterations in (0, 1):
        mpc, x, plan = posed(RealTime(iterations=iterations), scenarios=scenarios), np.array([1.0, 0.0]), None
        for _ in range(30):
            plan = mpc.plan(x, p=0.0, v=0.0, previous=plan)
            assert plan.status.solved
            x = np.asarray(spring().with_values(gain=0.5).step(x, plan.command)).ravel()
        ends.append(x)
    assert ends[0] == pytest.approx(ends[1], abs=1e-3)
    assert abs(ends[0][0]) < 0.1


@LESS
def test_models_of_any_kind_have_scenarios_of_their_inputs(solver):
    """A linear model of no equations: two scenarios with the same values plan what one alone does."""
    pushed = replace(double_integrator(), B=np.array([[0.005, 0.005], [0.1, 0.1]]), inputs=("a", "wind"))
    pushed = replace(pushed, D=np.zeros((1, 2)))
    settings = {"horizon": 8, "controls": ("a",), "Q": Weights(p=1.0), "R": Weights(a=0.1), "limits": Limits(a=1.0)}
    alone = MPC(pushed, solver=solver, **settings).plan(np.array([1.0, 0.0]), p=0.0, wind=0.2)
    both = MPC(pushed, solver=solver, scenarios=Scenarios({"wind": (0.2, 0.2)}), **settings)
    plan = both.plan(np.array([1.0, 0.0]), p=0.0)
    assert plan.cost == pytest.approx(alone.cost, rel=1e-8)
    assert [b.u for b in plan.branches] == [pytest.approx(alone.u, abs=1e-6)] * 2


@LESS
def test_an_impossible_scenario_is_named(solver):
    mpc = posed(
        solver,
        horizon=6,
        limits=Limits(a=0.5),
        slack={},
        slack_linear={},
        terminal_limits=Limits(p=(-0.1, 0.1)),
        scenarios=Scenarios({"gain": (0.01, 1.5)}),
    )
    plan = mpc.plan(np.array([2.0, 0.0]), p=0.0, v=0.0)
    assert plan.status is Status.INFEASIBLE
    assert plan.branches == ()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"scenarios": "friction"}, "expected Scenarios"),
        ({"scenarios": Scenarios({"gian": (1.0, 2.0)})}, "gain"),
        ({"scenarios": Scenarios({"gain": (1.0, 2.0)}, common=N + 1)}, "at most the horizon"),
        ({"scenarios": Scenarios({"gain": (1.0, 2.0)}), "free": Limits(gain=(1.0, 2.0))}, "one of both"),
        ({"free": Limits(mass=(1.0, 2.0))}, "free names 'mass'"),
        ({"duration": (2.0, 1.0)}, "shortest"),
        ({"duration": 1.0}, "shortest"),
        ({"free": Limits(gain=(1.0, 2.0)), "steps": (1,) * (N - 1) + (2,)}, "one step"),
    ],
)
def test_what_makes_no_sense_is_said(settings, words):
    with pytest.raises(ParameterError, match=words):
        posed("realtime", **settings)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (({},), "values by name"),
        (({"gain": (1.0,)},), "two or more"),
        (({"gain": (1.0, 2.0), "damping": (1.0, 2.0, 3.0)},), "as many of each"),
        (({"gain": (1.0, 2.0)}, (0.5, 0.6)), "sum 1"),
        (({"gain": (1.0, 2.0)}, None, 0), "at least 1"),
    ],
)
def test_scenarios_say_what_is_wrong(given, words):
    with pytest.raises(ParameterError, match=words):
        Scenarios(*given)


def test_refused_with_a_sentence():
    mpc = posed("realtime", scenarios=Scenarios({"gain": (0.5, 1.5)}))
    with pytest.raises(ParameterError, match="one for each of 2"):
        mpc.plan(np.zeros(2), p=0.0, v=0.0, scenarios={"gain": (0.5,)})
    with pytest.raises(ParameterError, match="a problem with some"):
        posed("realtime").plan(np.zeros(2), p=0.0, v=0.0, scenarios={"gain": (0.5,)})

    class Outside:
        def build(self, ocp, deadline):
            raise AssertionError

    with pytest.raises(ParameterError, match="cannot know the problem's scenarios"):
        replace(mpc, solver=Outside()).plan(np.zeros(2), p=0.0, v=0.0)
    free = MPC(
        double_integrator(),
        horizon=3,
        Q={"p": 1.0, "off": 1.0},
        terms={"off": lambda x, u, p: p.k - x[0]},
        controls=("a",),
        parameters=("k",),
        free={"k": (0.0, 1.0)},
    )
    assert free.ocp.presumed == {"k": 0.5}
    with pytest.raises(ParameterError, match="no ODE"):
        replace(free, duration=(1.0, 2.0))
