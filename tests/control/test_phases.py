"""Several phases of different models in one plan, against plain programs by Ipopt with every phase written out."""

import math
import pickle

import casadi as ca
import numpy as np
import pytest

from slipangle.control.mpc import MPC
from slipangle.control.phases import Phases
from slipangle.errors import ParameterError
from slipangle.export import export
from slipangle.models.custom import Ode
from slipangle.ops import cos, log, sin, sqrt
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.scenarios import Scenarios
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler was found")


def rolling(x, u):
    """Place and speed; drag takes the root of the speed, which another phase's numbers must not reach."""
    return [x[1], u[0] - 0.1 * sqrt(3.0 + x[1]) * x[1]]


def swinging(x, u, drag):
    """Angle, rate and a lagging push."""
    return [x[1], -2.0 * sin(x[0]) - drag * x[1] + x[2], 4.0 * (u[0] * cos(x[0]) + 0.3 * u[1] - x[2])]


def first(**settings):
    model = Ode(f=lambda x, u, p: rolling(x, u), states=("s", "v"), inputs=("a",), params={}, dt=0.1, substeps=1)
    given = {"horizon": 6, "controls": ("a",), "Q": Weights(s=1.0, v=0.1), "R": Weights(a=0.1), "S": Weights(a=0.2)}
    given |= {"limits": Limits(a=2.0, v=1.0), "slack": Weights(v=30.0), "terminal": Weights(v=0.3)}
    return MPC(model, **(given | settings))


def second(**settings):
    model = Ode(
        f=lambda x, u, p: swinging(x, u, p.drag),
        states=("phi", "rate", "push"),
        inputs=("a", "fan"),
        params={"drag": 0.3},
        dt=0.05,
        substeps=1,
    )
    given = {"horizon": 8, "controls": ("a", "fan"), "Q": Weights(phi=5.0), "R": Weights(a=0.1, fan=0.2)}
    given |= {"S": Weights(a=0.2, fan=0.1), "rates": Limits(a=15.0), "limits": Limits(a=2.0, fan=(-0.5, 1.0))}
    return MPC(model, **(given | settings))


def link(x):
    return [0.5 * x[0], x[1] + 0.1 * x[0] * x[0], 0.0]


def after(rates, x, u, h):
    """One classical Runge-Kutta step."""

    def f(x):
        return ca.vertcat(*rates(x, u))

    k1 = f(x)
    k2 = f(x + h / 2 * k1)
    k3 = f(x + h / 2 * k2)
    k4 = f(x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def minimum(cost, variables, low, high, g, below):
    """The least cost and its variables by Ipopt, with rows g below these, or equal to zero."""
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-13, "bound_relax_factor": 0.0}}
    program = {"x": ca.vertcat(*variables), "f": cost, "g": ca.vertcat(*g)}
    start = np.clip(0.0, np.asarray(low) + 0.1, np.asarray(high))
    limits = {"lbg": 0.0, "ubg": 0.0} if below is None else {"lbg": -np.inf, "ubg": below}
    found = ca.nlpsol("plain", "ipopt", program, options)(x0=start, lbx=low, ubx=high, **limits)
    return float(found["f"]), np.asarray(found["x"]).ravel()


def plain(x0, s, phi, applied):
    """Both phases: cost, inputs of the first, inputs of the second."""
    a, b, fan, over = (ca.SX.sym(n, k) for n, k in (("a", 6), ("b", 8), ("fan", 8), ("over", 6)))
    x, cost, before, g = ca.SX(x0), 0, applied, []
    for k in range(6):
        cost += (x[0] - s) ** 2 + 0.1 * x[1] ** 2 + 0.1 * a[k] ** 2 + 0.2 * (a[k] - before) ** 2
        x, before = after(rolling, x, [a[k]], 0.1), a[k]
        g += [x[1] - over[k], -x[1] - over[k]]
        cost += 30.0 * over[k] ** 2
    cost += 0.3 * x[1] ** 2
    x, blown, changes = ca.vertcat(*link(x)), None, []
    for k in range(8):
        cost += 5.0 * (x[0] - phi) ** 2 + 0.1 * b[k] ** 2 + 0.2 * (b[k] - before) ** 2 + 0.2 * fan[k] ** 2
        cost += 0.1 * (fan[k] - blown) ** 2 if blown is not None else 0
        changes.append(b[k] - before)
        x, before, blown = after(lambda x, u: swinging(x, u, 0.3), x, [b[k], fan[k]], 0.05), b[k], fan[k]
    cost += 5.0 * (x[0] - phi) ** 2
    low = [-2.0] * 14 + [-0.5] * 8 + [0.0] * 6
    high = [2.0] * 14 + [1.0] * 8 + [np.inf] * 6
    # |v| <= 1 + over as two rows below 1; changes within the rate over the time from middle to middle of their stages
    rows, below = [*g, *changes, *(-c for c in changes)], [1.0] * 12 + 2 * ([15.0 * 0.075] + [15.0 * 0.05] * 7)
    least, v = minimum(cost, [a, b, fan, over], low, high, rows, below)
    return least, v[:6], v[6:22].reshape(2, 8).T


def check_random_phases(solver, count, seed):
    """Other states, inputs, steps and weights behind the link; a soft limit before it; changes and rates across it."""
    phases, rng = Phases([first(), second()], links=[link], solver=solver), np.random.default_rng(seed)
    for _ in range(count):
        x, s, phi, applied = rng.uniform(-0.8, 0.8, 2), rng.uniform(-2, 2), rng.uniform(-1, 1), rng.uniform(-1, 1)
        plan = phases.plan(x, [{"s": s, "v": 0.0}, {"phi": phi}], applied=np.array([applied]))
        cost, a, b = plain(x, s, phi, applied)
        assert plan.status.solved
        assert plan.cost == pytest.approx(cost, rel=1e-9)
        assert plan.phases[0].u[:, 0] == pytest.approx(a, abs=1e-8)
        assert plan.phases[1].u == pytest.approx(b, abs=1e-8)
        assert plan.phases[1].x[0] == pytest.approx(link(plan.phases[0].x[-1]), abs=1e-9)
        assert plan.phases[1].times == pytest.approx(0.6 + 0.05 * np.arange(9))
        assert (plan.command == plan.phases[0].u[0]).all()
        again = phases.plan(x, [{"s": s, "v": 0.0}, {"phi": phi}], plan, applied=np.array([applied]))
        assert again.phases[1].u == pytest.approx(b, abs=1e-8)


def test_random_phases_of_two_models_are_those_of_a_plain_program(solver):
    check_random_phases(solver, 5, 1)


@pytest.mark.slow
@pytest.mark.parametrize("qp", ["condensed", "riccati"])
def test_many_random_phases_are_those_of_a_plain_program(qp):
    check_random_phases(RealTime(iterations=0, tolerance=1e-11, qp=qp), 100, 2)


def test_each_phase_takes_as_long_as_it_must(solver):
    """A mass that is pushed hard and then may only brake gently: the shortest time of both is known."""

    def mass(bound, **settings):
        model = Ode(f=lambda x, u, p: [x[1], u[0]], states=("s", "v"), inputs=("a",), params={}, dt=0.1)
        usual = {"horizon": 5, "Q": {}, "R": Weights(a=1e-9), "terminal": Weights(duration=1.0), "duration": (0.1, 9.0)}
        return MPC(model, controls=("a",), limits=Limits(a=bound), **(usual | settings))

    phases = Phases(
        [mass((0.0, 3.0)), mass((-1.0, 0.0), terminal_limits=Limits(s=(6.0, 6.0), v=(0.0, 0.0)))], solver=solver
    )
    plan = phases.plan(np.zeros(2), [{}, {}])
    # least T_1^2 + T_2^2 from rest to rest: v = 3 T_1 = T_2 where both are at their limits, over 1.5 T_1^2 + 4.5 T_1^2
    t = plan.phases[0].decided["duration"], plan.phases[1].decided["duration"]
    d1, d2, a, b = ca.SX.sym("d1"), ca.SX.sym("d2"), ca.SX.sym("a", 5), ca.SX.sym("b", 5)
    x = ca.SX.zeros(2)
    for u, d in ((a, d1 / 5), (b, d2 / 5)):
        for k in range(5):
            x = ca.vertcat(x[0] + d * x[1] + d * d / 2 * u[k], x[1] + d * u[k])
    cost = d1**2 + d2**2 + 1e-9 * (ca.sumsqr(a) + ca.sumsqr(b))
    low, high = [0.1, 0.1, *[0.0] * 5, *[-1.0] * 5], [9.0, 9.0, *[3.0] * 5, *[0.0] * 5]
    known, v = minimum(cost, [d1, d2, a, b], low, high, [x[0] - 6.0, x[1]], None)
    assert plan.status.solved
    assert plan.cost == pytest.approx(known, rel=1e-7)
    assert t == pytest.approx(v[:2], abs=1e-5)
    assert plan.phases[1].times[0] == pytest.approx(t[0])
    assert plan.phases[1].x[-1] == pytest.approx([6.0, 0.0], abs=1e-7)


def test_huber_costs_free_parameters_and_implicit_steps_have_their_place(solver):
    """The same as Ipopt on the same phases; three of them, the same model twice without a link of one's own."""
    stiff = MPC(
        Ode(
            f=lambda x, u, p: swinging(x, u, p.drag),
            states=("phi", "rate", "push"),
            inputs=("a", "fan"),
            params={"drag": 0.3},
            dt=0.05,
            method="radau",
        ),
        horizon=4,
        controls=("a", "fan"),
        Q=Weights(phi=5.0),
        R=Weights(a=0.1, fan=0.2),
        limits=Limits(a=2.0, fan=(-0.5, 1.0)),
        terminal_limits=Limits(rate=(-0.2, 0.2)),
    )
    middle = second(
        horizon=4, free=Limits(drag=(0.1, 2.0)), terminal=Weights(drag=0.5, phi=1.0), huber=Weights(phi=0.1)
    )
    problems, links = [first(horizon=3), middle, stiff], [link, lambda x: [x[0], x[1], x[2]]]
    goals = [{"s": 1.0, "v": 0.0}, {"phi": 0.4, "drag": 0.3}, {"phi": 0.2}]
    plan = Phases(problems, links=links, solver=solver).plan(np.array([0.2, 0.1]), goals)
    theirs = Phases(problems, links=links, solver=Ipopt(tolerance=1e-12)).plan(np.array([0.2, 0.1]), goals)
    assert plan.status.solved
    assert plan.cost == pytest.approx(theirs.cost, rel=1e-8)
    assert plan.phases[1].decided["drag"] == pytest.approx(theirs.phases[1].decided["drag"], abs=1e-6)
    for ours, other in zip(plan.phases, theirs.phases, strict=True):
        assert ours.u == pytest.approx(other.u, abs=1e-6)
    assert abs(plan.phases[2].x[-1, 1]) <= 0.2 + 1e-8


@pytest.mark.parametrize(("dt", "later"), [(0.1, 0.2), (0.2, 0.1)])
def test_the_rate_over_a_junction_is_that_from_middle_to_middle(solver, dt, later):
    """Full throttle, then the far side as soon as the rate lets it."""
    push = [
        MPC(
            Ode(f=lambda x, u, p: [x[1], u[0]], states=("s", "v"), inputs=("a",), params={}, dt=step),
            **dict(horizon=4, controls=("a",), Q=Weights(v=1.0), R=Weights(a=1e-6), terminal=Weights(v=1.0)),
            **dict(limits=Limits(a=1.0), rates=Limits(a=(-1.5, 1.5))),
        )
        for step in (dt, later)
    ]
    plan = Phases(push, solver=solver).plan(np.zeros(2), [{"v": 9.0}, {"v": -9.0}], applied=np.array([1.0]))
    assert plan.phases[1].u[0] - plan.phases[0].u[-1] == pytest.approx(-1.5 * 0.5 * (dt + later), abs=1e-6)


def test_a_junction_without_an_effect_is_one_horizon(solver):
    """Two halves of one problem plan what the whole does."""
    goal = {"s": 1.0, "v": 0.0}
    whole = MPC(ocp=first(horizon=8, terminal=Weights(s=3.0), rates=Limits(a=10.0)).ocp, solver=solver)
    ends = (
        first(horizon=3, terminal=Weights(), rates=Limits(a=10.0)),
        first(horizon=5, terminal=Weights(s=3.0), rates=Limits(a=10.0)),
    )
    plan, alone = (
        Phases(ends, solver=solver).plan(np.array([0.2, 0.1]), [goal, goal]),
        whole.plan(np.array([0.2, 0.1]), **goal),
    )
    assert plan.cost == pytest.approx(alone.cost, rel=1e-9)
    assert np.vstack([p.u for p in plan.phases]) == pytest.approx(alone.u, abs=1e-8)


def test_functions_of_another_phase_are_not_asked_where_they_have_no_value(solver):
    """The logarithm of a negative number, in dynamics, in a term and in a limit of the phase before."""
    model = Ode(
        f=lambda x, u, p: [u[0] - 0.1 * log(1.0 + x[0])],
        states=("level",),
        inputs=("a",),
        more=lambda x, u, p: {"bits": log(1.0 + x[0]) + 0.1 * u[0]},
        outputs=("bits",),
        params={},
        dt=0.1,
    )
    settings = {
        "terms": {"half": lambda x, u, p: sqrt(1.0 + x[0]) - 1.2},
        "controls": ("a",),
        "limits": Limits(a=2.0, bits=0.8),
    }
    before = MPC(model, horizon=4, Q=Weights(half=1.0), R=Weights(a=0.1), **settings)
    phases = Phases([before, first(horizon=4)], links=[lambda x: [-3.0 * x[0], -2.0]], solver=solver)
    plan = phases.plan(np.array([1.4]), [{}, {"s": -2.0, "v": -0.5}])
    assert plan.status.solved
    assert plan.phases[0].x.min() > 0
    assert plan.phases[1].x[:, 0].max() < 0


def test_what_has_no_answer_is_named(solver):
    phases = Phases([first(), second(terminal_limits=Limits(phi=(4.0, 5.0)))], links=[link], solver=solver)
    assert phases.plan(np.zeros(2), [{"s": 0.0, "v": 0.0}, {"phi": 0.0}]).status is Status.INFEASIBLE


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"problems": [first()]}, "two or more"),
        ({"problems": [first(), second()], "links": None}, r"expected links=\[lambda x"),
        ({"problems": [first(), second()], "links": []}, "one per junction"),
        ({"problems": [first(), second()], "links": link}, r"links is .*; expected a list of 1 functions"),
        (
            {"problems": [first(), second()], "links": [link, link]},
            r"of 2; expected a list of 1 functions",
        ),
        ({"problems": [first(), first()], "links": [3.0]}, r"links is .*; expected a list of 1 functions"),
        ({"problems": [first(), first()], "solver": "osqp"}, "the solver is 'osqp'; expected"),
        ({"problems": [first(), first()], "solver": None}, "the solver is None; expected"),
        ({"problems": [first(), first(steps=(1, 1, 1, 1, 1, 2))], "links": None}, "several steps"),
        ({"problems": [second(scenarios=Scenarios({"drag": (0.1, 0.3)})), second()], "links": None}, "scenarios"),
    ],
)
def test_what_makes_no_sense_is_said(given, words):
    with pytest.raises(ParameterError, match=words):
        Phases(**given)


def test_copies_plan_alike_and_there_is_no_c(tmp_path):
    phases = Phases([first(), first(horizon=3)])
    goals = [{"s": 1.0, "v": 0.0}] * 2
    plan = phases.plan(np.zeros(2), goals)
    assert pickle.loads(pickle.dumps(phases)).plan(np.zeros(2), goals).command == pytest.approx(plan.command, abs=1e-12)
    with pytest.raises(ParameterError, match="Phases"):
        export(phases, tmp_path / "c")


def test_arguments_are_looked_at():
    phases = Phases([first(), second()], links=[lambda x: [x[0]]])
    with pytest.raises(ParameterError, match="one for each of 2 phases"):
        phases.plan(np.zeros(2), [{}])
    with pytest.raises(ParameterError, match="wanted is one dict; expected a list of 2"):
        phases.plan(np.zeros(2), {"s": 0.0, "v": 0.0})
    with pytest.raises(ParameterError, match="the state has 3 entries"):
        phases.plan(np.zeros(3), [{}, {}])
    with pytest.raises(ParameterError, match="link 0 gives 1 states"):
        phases.plan(np.zeros(2), [{"s": 0.0, "v": 0.0}, {"phi": 0.0}])
    for wanted, words in (
        (None, "wanted is None; expected a list of 2"),
        ([None, {}], r"wanted\[0\] is None; expected what is wanted in phase 0"),
        ([{}, 2], r"wanted\[1\] is 2; expected what is wanted in phase 1"),
    ):
        with pytest.raises(ParameterError, match=words):
            phases.plan(np.zeros(2), wanted)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda x: None,
        lambda x: [x[0] if x[0] > 0 else 0.0, x[1]],
        lambda x: [x[5], x[1]],
        lambda x: [math.sin(x[0]), x[1]],
        lambda x: ["s", "v"],
    ],
)
def test_a_link_that_is_no_function_of_the_state_is_named(wrong):
    phases = Phases([first(), first()], links=[wrong])
    with pytest.raises(ParameterError, match=r"link 0 fails on symbols \(.*\); expected a function of the 2 states"):
        phases.plan(np.zeros(2), [{"s": 0.0, "v": 0.0}] * 2)
