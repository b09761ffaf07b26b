"""Random problems of every feature: all our solvers and Ipopt end at the same inputs, or name what has none.

Ours are both quadratic programs as compiled code and the solver without a compiler; where there is none, that alone.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.mpc import MPC
from slipangle.models.custom import Ode
from slipangle.models.lookup import LookupTable
from slipangle.ops import exp, sin, tanh
from slipangle.optimal.end import TerminalCost
from slipangle.optimal.engine import Start
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime import RealTime, backend
from slipangle.optimal.scenarios import Scenarios
from slipangle.optimal.solution import ANEW, Status
from slipangle.optimal.terms import Limits, Weights
from tests.optimal.nearby import is_local_optimum
from tests.optimal.oscillator import START, van_der_pol

CLOSE = 1e-8  # of inputs
GAINS = ("weight", "coupling", "lag")  # inputs of the model that change from problem to problem


def rates(x, u, p):
    """A pendulum, pushed by one input and, through a drive that lags, by another."""
    return [
        x[1],
        -u[2] * sin(x[0]) - 0.3 * x[1] + u[0] + 0.2 * u[3] * u[1] * x[2],
        -u[4] * x[2] + tanh(u[1]) + 0.3 * x[0] * x[1],
    ]


MODEL = Ode(
    f=rates,
    states=("a", "b", "c"),
    inputs=("u", "v", *GAINS),
    more=lambda x, u, p: {"y": x[0] + 0.5 * x[2] * x[1] + 0.1 * u[0]},
    outputs=("y",),
    params={},
    dt=0.1,
)
SOLVED = Ode(
    implicit=lambda x_dot, x, z, u, p: [
        x_dot[0] - x[1],
        x_dot[1] + 0.1 * x_dot[1] ** 3 + u[2] * sin(x[0]) + 0.3 * x[1] - z[0],
        x_dot[2] + u[4] * x[2] - tanh(u[1]) - 0.3 * x[0] * x[1],
    ],
    algebraic=lambda x, z, u, p: [z[0] + 0.2 * tanh(z[0] * x[2]) - u[0] - 0.2 * u[3] * u[1] * x[2]],
    guess={"push": 0.0},
    more=lambda x, z, u, p: {"y": x[0] + 0.5 * x[2] * x[1] + 0.1 * z[0]},
    states=MODEL.states,
    inputs=MODEL.inputs,
    outputs=("y",),
    params={},
    dt=0.1,
    substeps=2,
)
GRID = np.linspace(-4.0, 4.0, 9)
CURVE = LookupTable(GRID, np.sin(GRID) + 0.05 * GRID**2, kind="cubic", outside="line")
SIDE = np.linspace(-3.0, 3.0, 5)
MAP = LookupTable((SIDE, SIDE), np.tanh(SIDE)[:, None] * (1.0 + 0.1 * np.cos(SIDE)), kind="cubic", outside="line")
TABLES = Ode(
    f=lambda x, u, p: [
        x[1],
        -u[2] * CURVE(x[0]) - 0.3 * x[1] + u[0] + 0.2 * u[3] * u[1] * x[2],
        -u[4] * x[2] + MAP(u[1], x[0]) + 0.3 * x[0] * x[1],
    ],
    more=lambda x, u, p: {"y": CURVE(x[0]) + 0.5 * x[2] * x[1] + 0.1 * u[0]},
    **dict(states=MODEL.states, inputs=MODEL.inputs, outputs=("y",), params={}, dt=0.1),
)
STIFF = Ode(
    f=rates,
    **dict(states=MODEL.states, inputs=MODEL.inputs, outputs=(), params={}, dt=0.1, method="radau"),
)
P = np.array([[4.0, 1.0, 0.2], [1.0, 2.0, 0.1], [0.2, 0.1, 0.5]])
KINDS = {
    "inputs": {},
    "rates": {"S": Weights(u=0.5, v=0.1), "rates": Limits(u=15.0, v=15.0)},
    "soft": {
        "limits": Limits(u=3.0, v=2.0, b=1.0, y=1.2),
        "slack": Weights(y=20.0),
        "slack_linear": Weights(y=3.0, b=30.0),
    },
    "hard": {"limits": Limits(u=6.0, v=4.0, b=1.6)},
    "end": {"limits": Limits(u=4.0, v=3.0), "terminal_limits": Limits(a=(0.0, 0.0), b=0.2)},
    "solved": {
        "model": SOLVED,
        "limits": Limits(u=3.0, v=2.0, b=1.0, y=1.2),
        "slack": Weights(y=20.0),
        "slack_linear": Weights(y=3.0, b=30.0),
    },
    "exact penalty": {"limits": Limits(u=6.0, v=4.0, b=1.6), "slack_linear": Weights(b=300.0)},
    "tables": {
        "model": TABLES,
        "limits": Limits(u=3.0, v=2.0, b=1.0, y=1.2),
        "slack": Weights(y=20.0),
        "slack_linear": Weights(y=3.0, b=30.0),
    },
    "stiff": {"model": STIFF, "limits": Limits(u=3.0, v=2.0, b=1.0), "slack_linear": Weights(b=30.0)},
    "stages": {
        "parameters": ("q",),
        "terms": {"e": lambda x, u, p: sin(x[0]) - p.q * x[2] + 0.1 * u[0]},
        "Q": Weights(a=4.0, b=0.5, c=2.0, e=3.0),
        "limits": Limits(u=3.0, v=2.0, b=np.inf),
        "slack_linear": Weights(b=5.0),
        "S": Weights(u=0.5, v=0.1),
    },
    "matrix": {"terminal": TerminalCost(("a", "b", "u"), P)},
    "terms": {
        "parameters": ("q",),
        "terms": {"e": lambda x, u, p: sin(x[0]) - p.q * x[2] + 0.1 * u[0]},
        "Q": Weights(a=1.0, e=3.0),
        "limits": Limits(u=3.0, v=2.0, e=0.8),
        "slack_linear": Weights(e=2.0),
    },
    "steps": {"steps": (1, 1, 1, 1, 1, 2, 2, 2, 3, 4)},
    "scenarios": {
        "scenarios": Scenarios({"weight": (0.5, 1.0, 2.0)}, probabilities=(0.2, 0.5, 0.3), common=2),
        "limits": Limits(u=3.0, v=2.0, b=1.5),
        "slack_linear": Weights(b=5.0),
    },
    "free": {
        "parameters": ("q",),
        "free": Limits(q=(-1.0, 1.0)),
        "terms": {"e": lambda x, u, p: x[0] - p.q},
        "Q": Weights(b=0.5, c=2.0, e=3.0, q=0.2),
    },
    "exact": {
        "hessian": "exact",
        "Q": Weights(a=0.5),
        "R": Weights(),
        "terms": {
            "heat": lambda x, u, p: 0.1 * u[0] ** 4 + 0.05 * u[1] ** 2 + 0.1 * exp(x[2] * x[0]),
            "drawn": lambda x, u, p: u[0] * x[1],
        },
        "limits": Limits(u=3.0, v=2.0, heat=(-np.inf, 0.0), drawn=(-np.inf, 0.0), b=1.5),
        "slack_linear": Weights(heat=1.0, drawn=0.3, b=20.0),
    },
    "huber": {"huber": Weights(a=0.3, c=0.2), "limits": Limits(u=3.0, v=2.0, b=1.2), "slack_linear": Weights(b=5.0)},
    "duration": {"duration": (0.5, 3.0), "terminal": Weights(a=30.0, b=5.0, c=2.0, duration=1.0)},
}
MIXED = {
    "soft limits, rates, terms and a matrix": {**KINDS["soft"], **KINDS["rates"], **KINDS["matrix"]},
    "scenarios and a free parameter": {**KINDS["scenarios"], **KINDS["free"], "S": Weights(u=0.3)},
    "an exact Hessian and a free duration": {
        **KINDS["exact"],
        "duration": (0.5, 2.0),
        "terminal": Weights(a=30.0, b=5.0, c=2.0, duration=1.0),
    },
    "Huber costs over long stages": {**KINDS["steps"], **KINDS["rates"], **KINDS["huber"]},
    "Huber costs of scenarios": {**KINDS["scenarios"], "huber": Weights(a=0.3, b=0.2)},
    "a free duration and an end": {**KINDS["duration"], **KINDS["end"]},
}
AS_ABOVE = (  # of which the everyday tests ask each part elsewhere
    "Huber costs over long stages",
    "Huber costs of scenarios",
    "a free duration and an end",
)
SHORTER = {"Huber costs of scenarios": {"horizon": 6}}  # without a compiler these take seconds each


@dataclass(frozen=True, kw_only=True)
class Interpreted(RealTime):
    """As on a machine without a compiler."""

    def build(self, ocp, deadline=None):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("SLIPANGLE_CC", "none")
            patch.setattr(backend, "_say_once", lambda words: None)
            return super().build(ocp, deadline)


def ours_and_ipopt(hessian="auto"):
    """All solvers of this machine, iterated to convergence; skipped where none of ours is here."""
    own = {"iterations": 0, "tolerance": 1e-11, "newton": 1e-11, "hessian": hessian}
    ours = [RealTime(**own, qp=qp) for qp in ("condensed", "riccati")] if compiler() else []
    if hessian == "auto":
        ours.append(Interpreted(**own))
    if not ours:
        pytest.skip(sentence())
    return [*ours, Ipopt(tolerance=1e-13, max_iterations=1000)]


def solvers(settings):
    """The problem for each solver, Ipopt last; of "stages" values, limits and weights change over the horizon."""
    usual = {
        "horizon": 10,
        "controls": ("u", "v"),
        "Q": Weights(a=4.0, b=0.5, c=2.0),
        "R": Weights(u=0.1, v=0.2),
        "limits": Limits(u=3.0, v=2.0),
    }
    settings = {"model": MODEL, **usual, **settings}
    engines = ours_and_ipopt(settings.pop("hessian", "auto"))
    return [MPC(solver=engine, **settings) for engine in engines]


@cache
def ended():
    """Of an end that is kept, put together once: no plan hangs on the ones before."""
    return solvers(KINDS["end"])


def drawn(ocp, rng):
    """A state and what is wanted, by name."""
    said = {name: rng.uniform(0.3, 2.0) for name in GAINS}
    if ocp.scenarios is not None:
        said["scenarios"] = {"weight": tuple(rng.uniform(0.3, 2.0, len(ocp.scenarios)))}
    said |= {name: rng.uniform(-0.5, 0.5) for name in ("q",) if name in ocp.exogenous}
    said |= {name: rng.uniform(-1.2, 1.2) for name in ("a", "b", "c") if name in ocp.references}
    if "b" in ocp.limits and np.isinf(ocp.limits["b"]).all():  # what comes with every plan
        nodes = ocp.horizon + 1
        said = {name: value + 0.3 * rng.uniform(-1.0, 1.0, nodes) for name, value in said.items()}
        said["limits"] = {"b": (-rng.uniform(0.8, 1.5, nodes), rng.uniform(0.8, 1.5, nodes))}
        said |= {"Q": {"a": rng.uniform(1.0, 5.0, nodes)}, "R": {"u": rng.uniform(0.05, 0.3, nodes - 1)}}
        said["S"] = {"v": rng.uniform(0.0, 0.5, nodes - 1)}
    return rng.uniform(-1.0, 1.0, 3) * (1.5, 1.2, 1.0), said


def inputs(plan):
    """Of all branches."""
    return np.array([b.u for b in plan.branches]) if plan.branches else plan.u


def near(ours, theirs):
    """Whether two plans are the same."""
    same = inputs(ours) == pytest.approx(inputs(theirs), abs=CLOSE)
    return same and ours.decided == (theirs.decided and pytest.approx(theirs.decided, abs=CLOSE))


def stays(judge, ours, x, said):
    """Whether Ipopt finds nothing better beside a plan."""
    reference = judge.setpoint(**said)
    here = Start(x=x, applied=np.zeros(2), reference=reference, guess_u=ours.u, guess_x=ours.x)
    return is_local_optimum(judge.engine, here, ours, CLOSE)


def compare(settings, count, seed=1):
    """How many of so many problems have an answer; it is the same for all solvers, and what has none is named by all.

    Where there are several local optima, or Ipopt finds none, ours is one beside which Ipopt finds nothing better.
    """
    posed, rng, solved = solvers(settings), np.random.default_rng(seed), 0
    judge = posed[-1]
    for _ in range(count):
        x, said = drawn(judge.ocp, rng)
        *plans, theirs = [mpc.plan(x, **said) for mpc in posed]
        ours, what = plans[0], (x.tolist(), said, [plan.status for plan in plans], theirs.status)
        if not theirs.status.solved and not ours.status.solved:
            assert all(plan.status is Status.INFEASIBLE for plan in plans), what
            continue
        assert all(plan.status is Status.SOLVED for plan in plans), what
        assert all(near(ours, other) for other in plans[1:]), what
        if not (theirs.status.solved and near(ours, theirs)):
            assert stays(judge, ours, x, said), what
        solved += 1
    return solved


@pytest.mark.parametrize("kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind in AS_ABOVE)) for kind in MIXED])
def test_ten_random_problems_end_the_same(kind):
    assert compare({**MIXED[kind], **SHORTER.get(kind, {})}, 10) >= 5


def test_a_plan_at_the_kink_of_a_huber_cost_is_better_than_ipopt_s():
    """Which ends 1e-7 beside it, at 1e-12 more cost."""
    x = np.array([1.3944089733758014, 0.7831503474404494, -0.585836212653523])
    said = {"weight": 0.3188174279314918, "coupling": 1.5415029416224764, "lag": 0.4660967050495438}
    said |= {"a": 0.10517856860073493, "b": 0.16297279674241327, "c": -0.8439492837581296}
    said["scenarios"] = {"weight": (0.7798178320416889, 0.8353144911746202, 0.43373389286815295)}
    ours, *_, judge = solvers(MIXED["Huber costs of scenarios"])
    plan = ours.plan(x, **said)
    assert plan.status is Status.SOLVED
    assert stays(judge, plan, x, said)


def test_a_plan_beside_which_ipopt_finds_less_cost_is_no_optimum():
    ours, *_, judge = solvers(KINDS["inputs"])
    x, said = drawn(judge.ocp, np.random.default_rng(1))
    plan = ours.plan(x, **said)
    assert stays(judge, plan, x, said)
    assert not stays(judge, replace(plan, u=plan.u + 1e-5, cost=plan.cost + 1e-9), x, said)


@pytest.mark.skipif(compiler() is None, reason=sentence())
def test_a_plan_that_ipopt_confirms_only_closer_by_is_a_local_optimum():
    """Held to 1e-3 of its inputs, Ipopt ends without an answer."""
    ours, *_, judge = solvers(MIXED["an exact Hessian and a free duration"])
    x, said = at_place(judge.ocp, 722, 1)
    plan = ours.plan(x, **said)
    assert plan.status is Status.SOLVED
    assert stays(judge, plan, x, said)


ELSEWHERE = {  # problems whose limits the first start misses by least where there is no answer nearby: where it is
    "first control": (
        [-1.28, -0.16, -0.83],
        {"weight": 1.09, "coupling": 1.39, "lag": 1.06, "a": -0.24, "b": -1.11, "c": 0.76},
    ),
    "second control": (
        [-0.9098, -0.906, -0.7768],
        {"weight": 1.9818, "coupling": 0.9582, "lag": 1.5993, "a": -0.4852, "b": -0.6174, "c": 0.4017},
    ),
}
ANSWERED = {  # problems of the kind "end", by seed and place: iterations wander where limits are missed by least, far
    (725, 11): 165.91691180,  # from the answer, which costs so much; Ipopt ends there
    (705, 5): 72.72582936,  # Ipopt ends at its iteration limit
}
WANDERING = {  # problems without an answer, about whose limits the iterations never came to rest
    "once": ([1.37, -0.04, -0.48], {"weight": 1.65, "coupling": 1.14, "lag": 0.86, "a": -1.02, "b": -0.71, "c": -0.44}),
    "again": ([-1.43, 0.26, 0.26], {"weight": 1.92, "coupling": 1.46, "lag": 0.97, "a": -0.3, "b": -0.38, "c": 0.89}),
}


def at_place(ocp, seed, place):
    """What is drawn at that place."""
    rng = np.random.default_rng(seed)
    return [drawn(ocp, rng) for _ in range(place + 1)][-1]


@pytest.fixture(params=["condensed", "riccati", "interpreted"])
def own(request):
    if request.param == "interpreted":
        return Interpreted(iterations=0, tolerance=1e-11)
    if compiler() is None:
        pytest.skip(sentence())
    return RealTime(iterations=0, tolerance=1e-11, qp=request.param)


def test_a_limit_that_the_first_linear_model_cannot_keep_is_kept(own):
    """Named infeasible before, though Ipopt has an answer; and one that has none is named so."""
    posed, names = ended(), []
    rng = np.random.default_rng(2)
    mpc = replace(posed[0], solver=own)
    for _ in range(10):
        x, said = drawn(mpc.ocp, rng)
        plan, theirs = mpc.plan(x, **said), posed[-1].plan(x, **said)
        names.append(theirs.status)
        assert plan.status.solved == theirs.status.solved
        if not plan.status.solved:
            assert plan.age == 1  # a fallback, not a plan that breaks a limit
        else:
            assert inputs(plan) == pytest.approx(inputs(theirs), abs=1e-7)
    assert Status.INFEASIBLE in names
    assert Status.SOLVED in names


@pytest.mark.parametrize("turned", ELSEWHERE)
def test_limits_that_are_kept_only_elsewhere_are_kept(own, turned):
    posed, (x, said) = ended(), ELSEWHERE[turned]
    plan, theirs = replace(posed[0], solver=own).plan(x, **said), posed[-1].plan(x, **said)
    assert theirs.status.solved
    assert plan.status is Status.SOLVED
    assert plan.detail == ANEW
    assert inputs(plan) == pytest.approx(inputs(theirs), abs=1e-7)


@pytest.mark.parametrize("place", ANSWERED)
def test_an_answer_far_from_where_limits_are_missed_by_least_is_found(own, place):
    """Named infeasible before: the first starts took all iterations; and the last bit of a sum does not decide."""
    posed, rng = ended(), np.random.default_rng(1)
    mpc, (x, said) = replace(posed[0], solver=own), at_place(posed[0].ocp, *place)
    for size in (0.0, 1e-9, 1e-9):
        beside = x * (1 + size * rng.standard_normal(3))
        plan = mpc.plan(beside, **said)
        assert plan.status is Status.SOLVED
        assert plan.cost == pytest.approx(ANSWERED[place], rel=1e-6)
        assert stays(posed[-1], plan, beside, said)


@pytest.mark.parametrize("most", [5, *(pytest.param(n, marks=pytest.mark.slow) for n in (10, 20)), 30])
def test_what_iterations_have_not_come_to_is_not_named_infeasible(own, most):
    mpc = replace(ended()[0], solver=replace(own, max_iterations=most))
    x, said = at_place(mpc.ocp, 705, 5)
    plan = mpc.plan(x, **said)
    assert plan.status is Status.ITERATION_LIMIT
    assert plan.iterations == most


@pytest.mark.parametrize("most", [pytest.param(33, marks=pytest.mark.slow), 34])
def test_limits_that_a_second_start_keeps_are_not_named_infeasible(own, most):
    """Named so before, where that start ran out of iterations a few before the optimum."""
    posed, (x, said) = ended(), ELSEWHERE["first control"]
    plan, theirs = (
        replace(posed[0], solver=replace(own, max_iterations=most, hessian="gauss-newton")).plan(x, **said),
        posed[-1].plan(x, **said),
    )
    assert replace(posed[0], solver=replace(own, max_iterations=most)).plan(x, **said).status is Status.ITERATION_LIMIT
    assert plan.status is Status.ITERATION_LIMIT
    assert plan.detail.startswith(ANEW)
    assert inputs(plan) == pytest.approx(inputs(theirs), abs=1e-5)


@pytest.mark.parametrize("aside", [0.0, pytest.param(1e-9, marks=pytest.mark.slow), 1e-3])
def test_an_obstacle_straight_ahead_is_passed(own, aside):
    """Hard limits that only turning off the middle of the range keeps, from where neither side is nearer."""
    model = Ode(f=lambda x, u, p: [1.0 + 0 * x[0], u[0]], states=("s", "d"), inputs=("w",), params={}, dt=0.1)
    mpc = MPC(
        model,
        horizon=30,
        Q=Weights(d=1.0),
        R=Weights(w=0.1),
        controls=("w",),
        limits=Limits(w=3.0, near=(0.25, np.inf)),
        terms={"near": lambda x, u, p: (x[0] - 1.5) ** 2 + (x[1] - p.aside) ** 2},
        parameters=("aside",),
        solver=own,
    )
    plan = mpc.plan(np.zeros(2), aside=aside)
    assert plan.status.solved
    assert np.hypot(plan.x[:, 0] - 1.5, plan.x[:, 1] - aside).min() > 0.5 - 1e-6
    assert plan.cost == pytest.approx(
        mpc.plan(np.zeros(2), previous=mpc.guess(u={"w": 0.5}), aside=aside).cost, rel=1e-2
    )


@pytest.mark.skipif(compiler() is None, reason=sentence())
@pytest.mark.slow
def test_a_long_way_with_its_limits_kept_is_not_named_infeasible_wherever_it_is_cut():
    """A van der Pol oscillator over 30 s, whose roll-out is far from its answer: named so at every other cut before."""
    for most in range(2, 11):
        for hessian in ("gauss-newton", "auto"):
            plan = van_der_pol(300, RealTime(iterations=0, max_iterations=most, hessian=hessian)).plan(START)
            assert plan.status is Status.ITERATION_LIMIT or (hessian == "auto" and plan.status is Status.SOLVED)


@pytest.mark.skipif(compiler() is None, reason=sentence())
def test_a_plan_that_is_late_where_limits_are_paid_for_is_no_plan():
    """Whatever the deadline: one plan in a hundred was named solved, though it missed an end that has no answer."""
    mpc, (x, said) = ended()[0], WANDERING["once"]
    for deadline in np.geomspace(1e-4, 4e-3, 300):
        assert not replace(mpc, deadline=float(deadline)).plan(x, **said).status.solved


def test_a_plan_that_paid_for_its_limits_is_no_plan_whatever_the_iteration_limit(own):
    """It was named a real-time plan, as little was left: of a problem without an answer, or far from the answer."""
    mpc = ended()[0]
    limits = (12, 30, 48) if isinstance(own, Interpreted) else range(12, 60, 2)  # the former takes a second each
    for place in ((701, 9), (705, 5)):
        x, said = at_place(mpc.ocp, *place)
        plans = [replace(mpc, solver=replace(own, max_iterations=most)).plan(x, **said) for most in limits]
        assert not any(plan.status is Status.REAL_TIME and plan.violation > 1e-4 for plan in plans)


@pytest.mark.parametrize("case", ["once", pytest.param("again", marks=pytest.mark.slow)])
def test_a_problem_about_whose_limits_iterations_wander_is_named_infeasible(own, case):
    posed, (x, said) = ended(), WANDERING[case]
    plan = replace(posed[0], solver=own).plan(x, **said)
    assert posed[-1].plan(x, **said).status is Status.INFEASIBLE
    assert plan.status is Status.INFEASIBLE
    assert ANEW not in plan.detail  # no start found more than the first did
    assert plan.health.begun_anew == 0
    assert plan.iterations <= own.max_iterations


def test_a_problem_whose_limits_every_linear_model_just_keeps_is_named_infeasible(own):
    """They wander there until the iterations end, unless limits come at a price."""
    posed, x = ended(), [0.7178, 1.1328, 0.9081]
    said = {"weight": 1.0357, "coupling": 1.7754, "lag": 1.0464, "a": 1.1965, "b": -0.1201, "c": 0.8679}
    plan = replace(posed[0], solver=own).plan(x, **said)
    assert plan.status is posed[-1].plan(x, **said).status is Status.INFEASIBLE
    assert plan.iterations <= own.max_iterations


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*KINDS, *MIXED])
def test_many_random_problems_of_each_feature_end_the_same(kind):
    assert compare({**KINDS, **MIXED}[kind], 75, seed=2) >= 40
