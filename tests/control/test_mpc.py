"""Linear MPC equals LQR; limits hold whatever happens; failures fall back and are said."""

import itertools
from dataclasses import replace
from math import inf

import numpy as np
import pytest

from slipangle.control.fallback import RELAX
from slipangle.control.mpc import MPC
from slipangle.errors import ParameterError
from slipangle.models.custom import Ode
from slipangle.ops import cos, sin
from slipangle.optimal.engine import Engine
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.ocp import OCP, Reference
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.solution import Status, within
from slipangle.optimal.terms import Limits, Values, Weights
from tests.optimal.linear import Linear, double_integrator, lqr, two_masses


def still(mpc, target=0.0):
    return Reference(
        tracked=np.full((mpc.horizon + 1, len(mpc.references)), target),
        exogenous=np.zeros((mpc.horizon, len(mpc.exogenous))),
    )


def weights(names, values):
    return Weights(**dict(zip(names, values, strict=True)))


@pytest.mark.parametrize("horizon", [1, 2, 7, 25])
@pytest.mark.parametrize("terminal", [None, 0.0, 20.0])
@pytest.mark.parametrize("s", [0.0, 0.7])
@pytest.mark.parametrize("model", [double_integrator(), two_masses()], ids=["double integrator", "two masses"])
def test_without_active_limits_it_is_the_finite_horizon_lqr(model, horizon, terminal, s):
    rng = np.random.default_rng(horizon)
    n, m = model.n_states, model.n_inputs
    q, r, x, before = rng.uniform(0.1, 3, n), rng.uniform(0.05, 1, m), rng.standard_normal(n), rng.standard_normal(m)
    mpc = MPC(
        model,
        solver="ipopt",
        horizon=horizon,
        Q=weights(model.states, q),
        R=weights(model.inputs, r),
        S=weights(model.inputs, np.full(m, s)),
        terminal=None if terminal is None else weights(model.states, terminal * q),
        limits=Limits(**dict.fromkeys(model.inputs, 1e3)),
    )
    plan = mpc.plan(x, still(mpc), applied=before)
    end = np.diag(q if terminal is None else terminal * q)
    expected = lqr(model.A, model.B, np.diag(q), np.diag(r), s * np.eye(m), end, horizon, x, before)
    assert plan.status is Status.SOLVED
    assert plan.u == pytest.approx(expected, abs=1e-6)
    roll = [x]
    for u in plan.u:
        roll.append(model.step(roll[-1], u))
    assert plan.x == pytest.approx(np.array(roll), abs=1e-7)
    errors, inputs = np.array(roll), plan.u
    changes = np.diff(np.vstack([before, inputs]), axis=0)
    cost = (
        (errors[:-1] ** 2 @ q).sum() + errors[-1] ** 2 @ np.diag(end) + (inputs**2 @ r).sum() + s * (changes**2).sum()
    )
    assert plan.cost == pytest.approx(cost, rel=1e-7)


def test_input_references_move_the_input():
    mpc = MPC(double_integrator(), solver="ipopt", horizon=4, Q=Weights(p=1e-9), R=Weights(a=1.0))
    wanted = replace(still(mpc), inputs=np.array([[0.1], [0.2], [0.3], [0.4]]))
    assert mpc.plan(np.zeros(2), wanted).u == pytest.approx(wanted.inputs, abs=1e-6)


def test_outputs_can_be_tracked():
    mpc = MPC(double_integrator(), solver="ipopt", horizon=30, Q=Weights(y=1.0), R=Weights(a=1e-3))
    x, plan = np.zeros(2), None
    for _ in range(60):
        plan = mpc.plan(x, still(mpc, 2.0), plan)
        x = mpc.model.step(x, plan.command)
    assert mpc.model.output(x, plan.command) == pytest.approx([2.0], abs=1e-3)


# ---- limits --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bound", "rate"), list(itertools.product([(-1.0, 1.0), (-0.3, 2.0), (0.2, 0.9), (-inf, inf)], [0.5, 3.0, None]))
)
def test_bounds_and_rates_are_never_violated(bound, rate):
    rng = np.random.default_rng(1)
    mpc = MPC(
        double_integrator(),
        solver="ipopt",
        horizon=10,
        Q=Weights(p=100.0),
        R=Weights(a=1e-3),
        limits=Limits(a=bound),
        rates=Limits(a=inf if rate is None else rate),
    )
    low, high = bound
    step = inf if rate is None else rate * mpc.dt
    x, plan, last, touched = np.array([3.0, 0.0]), None, np.clip(0.0, low, high), False
    for k in range(40):
        if k in (7, 8, 20):
            measured = np.array([np.nan, 0.0])
        else:
            measured = x + 0.5 * rng.standard_normal(2)
        plan = mpc.plan(measured, still(mpc, 5.0 * (-1) ** (k // 10)), plan)
        u = np.concatenate([[last], plan.u[:, 0]])
        assert np.isfinite(u).all()
        assert u.min() >= low
        assert u.max() <= high
        assert np.abs(np.diff(u)).max() <= step * (1 + 1e-9)
        touched |= bool(np.isclose(u[1:], low).any() or np.isclose(u[1:], high).any())
        last = plan.command[0]
        x = mpc.model.step(x, plan.command)
    assert touched or np.isinf(high) or rate == 0.5


def test_hard_limits_of_states_hold_and_are_used():
    mpc = MPC(
        double_integrator(),
        solver="ipopt",
        horizon=25,
        Q=Weights(p=1.0),
        R=Weights(a=1e-3),
        limits=Limits(v=(-0.5, 0.5)),
    )
    mpc = replace(mpc, controls=("a",))
    plan = mpc.plan(np.zeros(2), still(mpc, 10.0))
    assert plan.status is Status.SOLVED
    assert plan.x[1:, 1].max() == pytest.approx(0.5, abs=1e-6)
    assert plan.x[1:, 1].max() <= 0.5 + 1e-8


def test_a_limit_on_an_output_with_feedthrough_holds_now_too():
    model = double_integrator(feedthrough=1.0)
    mpc = MPC(model, solver="ipopt", horizon=6, Q=Weights(p=1.0), R=Weights(a=1e-4), limits=Limits(y=(-0.4, 0.4)))
    assert mpc.ocp.limited_now.tolist() == [True]
    plan = mpc.plan(np.zeros(2), still(mpc, 3.0))
    y = [model.output(x, u)[0] for x, u in zip(plan.x, plan.u, strict=False)]
    assert max(y) == pytest.approx(0.4, abs=1e-6)
    assert y[0] == pytest.approx(0.4, abs=1e-6)
    soft = replace(mpc, slack=Weights(y=1.0))
    assert soft.ocp.limited_now.tolist() == [True]
    y = [
        model.output(x, u)[0]
        for x, u in zip(*(lambda p: (p.x, p.u))(soft.plan(np.zeros(2), still(mpc, 3.0))), strict=False)
    ]
    assert y[0] > 0.41


def test_soft_limits_cost_what_they_say():
    """An excess that cannot be avoided is paid with both weights."""
    hold = Linear(A=np.eye(1), B=np.zeros((1, 1)), C=np.eye(1), D=np.zeros((1, 1)), states=("z",))
    mpc = MPC(
        hold,
        solver="ipopt",
        horizon=4,
        Q=Weights(z=0.0),
        R=Weights(a=1.0),
        limits=Limits(z=(-1.0, 1.0)),
        slack=Weights(z=3.0),
        slack_linear=Weights(z=5.0),
    )
    for z in (1.5, -2.0):
        plan = mpc.plan(np.array([z]), still(mpc))
        excess = abs(z) - 1.0
        assert plan.cost == pytest.approx(4 * (3.0 * excess**2 + 5.0 * excess), rel=1e-6)


def test_a_large_plain_slack_weight_is_exact():
    hard = MPC(
        double_integrator(),
        solver="ipopt",
        horizon=20,
        Q=Weights(p=1.0),
        R=Weights(a=1e-2),
        limits=Limits(v=(-0.5, 0.5)),
    )
    exact = replace(hard, slack_linear=Weights(v=1e4))
    soft = replace(hard, slack=Weights(v=1.0))
    plans = [m.plan(np.zeros(2), still(m, 4.0)) for m in (hard, exact, soft)]
    assert all(p.status.solved for p in plans)
    assert plans[1].u == pytest.approx(plans[0].u, abs=1e-5)
    assert plans[2].x[:, 1].max() > 0.6


# ---- warm start ----------------------------------------------------------------------------------------------------


def test_warm_start_saves_iterations_and_changes_no_answer():
    mpc = MPC(
        two_masses(),
        solver="ipopt",
        horizon=20,
        Q=Weights(p1=10.0, p2=1.0),
        R=Weights(a1=0.01, a2=0.01),
        limits=Limits(a1=1.0, a2=1.0),
    )
    cold = replace(mpc, solver=Ipopt(warm=False))
    x, plan, counts, applied = np.array([1.0, 0.0, -1.0, 0.0]), None, [], None
    for _ in range(15):
        plan = mpc.plan(x, still(mpc), plan)
        fresh = cold.plan(x, still(mpc), applied=applied)
        assert plan.u == pytest.approx(fresh.u, abs=1e-5)
        counts.append((plan.iterations, fresh.iterations))
        applied = plan.command
        x = mpc.model.step(x, plan.command)
    warm, fresh = np.array(counts[3:]).mean(axis=0)
    assert warm < fresh


def test_applied_overrides_the_previous_command():
    mpc = MPC(double_integrator(), solver="ipopt", horizon=5, Q=Weights(p=1.0), S=Weights(a=1.0), rates=Limits(a=1.0))
    plan = mpc.plan(np.array([5.0, 0.0]), still(mpc))
    other = mpc.plan(np.array([5.0, 0.0]), still(mpc), plan, applied=np.array([2.0]))
    assert abs(other.command[0] - 2.0) <= 0.1 + 1e-12


# ---- failure -------------------------------------------------------------------------------------------------------

CART = MPC(
    double_integrator(),
    solver="ipopt",
    horizon=10,
    Q=Weights(p=1.0, v=0.1),
    R=Weights(a=0.1),
    limits=Limits(a=(-2.0, 2.0)),
    rates=Limits(a=20.0),
    fallback=3,
)
BAD = {
    "state": (np.array([np.nan, 0.0]), still(CART)),
    "infinite state": (np.array([0.0, inf]), still(CART)),
    "reference": (np.array([1.0, 0.0]), still(CART, np.nan)),
}


@pytest.mark.parametrize("bad", BAD.values(), ids=BAD.keys())
def test_nan_falls_back_to_the_shifted_plan_then_stops(bad):
    plan = good = CART.plan(np.array([1.0, 0.0]), still(CART))
    for k in range(1, 4):
        plan = CART.plan(*bad, plan)
        assert (plan.status, plan.age, plan.stopping) == (Status.NOT_FINITE, k, False)
        assert plan.command == pytest.approx(good.u[k])
        assert "shifted" in plan.message
    before = plan.command
    for k in range(4, 60):
        plan = CART.plan(*bad, plan)
        assert (plan.status, plan.age, plan.stopping) == (Status.NOT_FINITE, k, True)
        assert np.isfinite(plan.u).all()
        assert np.isfinite(plan.x).all()
    assert np.abs(plan.command) < 1e-3 * (1 + np.abs(before))
    fresh = CART.plan(np.array([1.0, 0.0]), still(CART), plan)  # and back, with nothing left of it
    assert (fresh.status, fresh.age) == (Status.SOLVED, 0)


def test_nan_at_the_first_step_starts_the_stop_law():
    plan = CART.plan(np.full(2, np.nan), still(CART))
    assert (plan.status, plan.age, plan.stopping) == (Status.NOT_FINITE, 1, True)
    assert plan.command == pytest.approx([0.0])
    assert plan.u.shape == (10, 1)


def test_stop_law_goes_to_the_safe_input_within_limits():
    mpc = replace(CART, safe=Values(a=-1.5), fallback=0)
    plan = mpc.plan(np.array([np.nan, 0.0]), still(mpc), applied=np.array([2.0]))
    expected = -1.5 + 3.5 * np.exp(-0.1 * np.arange(1, 11) / RELAX)
    assert plan.u[:, 0] == pytest.approx(expected)
    slow = replace(mpc, rates=Limits(a=1.0))
    assert slow.plan(np.full(2, np.nan), still(mpc), applied=np.array([2.0])).command == pytest.approx([1.9])
    assert replace(CART, limits=Limits(a=(0.3, 2.0))).plan(np.full(2, np.nan), still(CART)).u == pytest.approx(0.3)


def test_a_safe_input_beyond_its_limits_is_refused():
    with pytest.raises(ParameterError, match="safe is 9 for 'a', whose limits are -2 and 2"):
        replace(CART, limits=Limits(a=2.0), safe=Values(a=9.0))


@pytest.mark.parametrize("solver", [Ipopt, RealTime])
def test_a_solver_that_is_a_class_is_named(solver):
    with pytest.raises(ParameterError, match=r"settings such as Ipopt\(\)"):
        replace(CART, solver=solver)


def test_infeasible_is_said_and_survived():
    mpc = replace(CART, limits=Limits(a=2.0, p=(-1.0, 1.0)))
    good = mpc.plan(np.array([0.5, 0.0]), still(mpc))
    assert good.status is Status.SOLVED
    plan = mpc.plan(np.array([0.9, 8.0]), still(mpc), good)
    assert plan.status is Status.INFEASIBLE
    assert "slack" in plan.message
    assert plan.command == pytest.approx(good.u[1])
    soft = replace(mpc, slack=Weights(p=100.0))
    assert soft.plan(np.array([0.9, 8.0]), still(mpc)).status is Status.SOLVED


@pytest.mark.filterwarnings("ignore:no C compiler was found")
@pytest.mark.parametrize("ahead", [1.5, 2.0])
def test_an_obstacle_that_appears_is_passed_by_the_plan_of_that_step(solver, ahead):
    """No step that keeps the limits as they are at the plan before: it led straight through."""
    unicycle = Ode(
        f=lambda x, u, p: [x[3] * cos(x[2]), x[3] * sin(x[2]), u[0], u[1]],
        **dict(states=("p_x", "p_y", "way", "speed"), inputs=("turn", "push"), params={}, dt=0.1),
    )
    mpc = MPC(
        unicycle,
        **dict(horizon=15, Q=Weights(p_x=1.0, p_y=1.0), R=Weights(turn=0.05, push=0.05), parameters=("at",)),
        terms={"gap": lambda x, u, p: (x[0] - p.at) ** 2 + (x[1] - 0.05) ** 2 - 0.5**2},
        limits=Limits(turn=2.0, push=3.0, speed=(-1.0, 4.0), gap=(0.0, inf)),
        rates=Limits(turn=15.0),
        terminal_limits=Limits(speed=(0.0, 0.0)),
        solver=replace(solver, iterations=1) if isinstance(solver, RealTime) else solver,
    )
    x = np.array([0.0, 0.0, 0.0, 2.8])
    free = mpc.plan(x, at=50.0, p_x=2.9)
    plan = mpc.plan(free.x[1], previous=free, at=free.x[1, 0] + ahead, p_x=2.9)
    assert (plan.status.solved, plan.age) == (True, 0)
    X, Y, way, speed = free.x[1]
    for turn, push in plan.u:  # driven in a hundred steps each
        for _ in range(100):
            X, Y, way, speed = X + 1e-3 * speed * np.cos(way), Y + 1e-3 * speed * np.sin(way), way + 1e-3 * turn, speed
            speed += 1e-3 * push
        assert np.hypot(X - free.x[1, 0] - ahead, Y - 0.05) > 0.5 - 0.02


def test_deadline_gives_time_out_and_a_fallback():
    mpc = replace(CART, deadline=1e-9)
    plan = mpc.plan(np.array([1.0, 0.0]), still(mpc), CART.plan(np.array([1.0, 0.0]), still(mpc)))
    assert plan.status is Status.TIME_OUT
    assert plan.age == 1
    assert replace(CART, deadline=10.0).plan(np.array([1.0, 0.0]), still(mpc)).status is Status.SOLVED


def test_iteration_limit_is_said():
    mpc = replace(CART, solver=Ipopt(max_iterations=1), limits=Limits(a=0.5, v=0.2), slack=Weights(v=1.0))
    plan = mpc.plan(np.array([4.0, 1.0]), still(mpc))
    assert plan.status is Status.ITERATION_LIMIT
    assert np.isfinite(plan.u).all()


class Broken(Engine):
    """A solver that fails in a chosen way."""

    def __init__(self, answer):
        self.answer = answer

    def build(self, ocp, deadline):
        return self

    def solve(self, start):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


def test_a_killed_or_lying_solver_is_survived():
    engine = Ipopt().build(CART.ocp, None)
    good = CART.plan(np.array([1.0, 0.0]), still(CART))
    from slipangle.optimal.engine import Start

    start = Start(
        x=np.array([1.0, 0.0]),
        applied=np.zeros(1),
        reference=still(CART),
        guess_u=np.zeros((10, 1)),
        guess_x=np.zeros((11, 2)),
    )
    answer = engine.solve(start)
    wrong = replace(answer, u=np.full((10, 1), np.nan))
    wild = replace(answer, u=np.full((10, 1), 1e6))
    for reply, age in ((RuntimeError("killed"), 1), (wrong, 1), (wild, 0)):
        plan = replace(CART, solver=Broken(reply)).plan(np.array([1.0, 0.0]), still(CART), good)
        assert plan.age == age
        assert ("killed" in plan.message) is isinstance(reply, RuntimeError)
        assert np.isfinite(plan.u).all()
        assert np.abs(plan.u).max() <= 2.0
        assert np.abs(np.diff(np.vstack([good.command, plan.u]), axis=0)).max() <= 2.0 + 1e-12


def test_a_fallback_never_outlives_the_plan():
    mpc = replace(CART, horizon=2, fallback=50)
    plan = mpc.plan(np.array([1.0, 0.0]), still(mpc))
    stops = []
    for _ in range(4):
        plan = mpc.plan(np.full(2, np.nan), still(mpc), plan)
        stops.append(plan.stopping)
    assert stops == [False, True, True, True]


def test_ipopt_is_silent(capfd):
    CART.plan(np.array([1.0, 0.0]), still(CART))
    replace(CART, limits=Limits(a=2.0, p=(-1.0, 1.0))).plan(np.array([5.0, 0.0]), still(CART))
    MPC(explode(), solver="ipopt", horizon=5, Q=Weights(p=1.0), R=Weights(a=1.0)).plan(
        np.array([1e200, 1e200]), Reference(tracked=np.zeros((6, 1)), exogenous=np.empty((5, 0)))
    )
    out = capfd.readouterr()
    assert (out.out, out.err) == ("", "")


def explode():
    """Squares its state: leaves the finite numbers within a few steps."""

    class Explode(Linear):
        def step(self, x, u):
            return x * x + super().step(x, u)

    base = double_integrator()
    return Explode(A=base.A, B=base.B, C=base.C, D=base.D)


def test_a_model_that_overflows_is_said():
    mpc = MPC(explode(), solver="ipopt", horizon=5, Q=Weights(p=1.0), R=Weights(a=1.0), limits=Limits(a=1.0))
    reference = Reference(tracked=np.zeros((6, 1)), exogenous=np.empty((5, 0)))
    plan = mpc.plan(np.array([1e200, 1e200]), reference)
    assert not plan.status.solved
    assert plan.stopping
    assert np.isfinite(plan.u).all()
    assert np.isfinite(plan.x).all()


@pytest.mark.parametrize(
    "options",
    [
        {"solver": "ipop"},
        {"deadline": 0.0},
        {"fallback": -1},
        {"safe": Values(b=1.0)},
        {"safe": 0.0},
        {"plausible": ()},
    ],
)
def test_bad_settings(options):
    with pytest.raises(ParameterError):
        replace(CART, **options)


def test_every_setting_of_the_controller_is_kept():
    options = {"solver": Ipopt(tolerance=1e-6), "deadline": 0.5, "fallback": 2, "safe": Values(a=0.1)}
    mpc = replace(CART, **options)
    assert {k: getattr(mpc, k) for k in options} == options
    with pytest.raises(ParameterError):
        Ipopt(tolerance=0.0)


def test_the_problem_may_be_posed_before_and_settings_beside_it_replace_its_own():
    problem = OCP(double_integrator(), horizon=8, Q=Weights(p=1.0), R=Weights(a=0.1), limits=Limits(a=2.0))
    mpc = MPC(ocp=problem, solver="ipopt")
    x, still = np.array([3.0, 0.0]), Reference(tracked=np.zeros((9, 1)), exogenous=np.empty((9, 0)))
    posed_here = MPC(problem.model, solver="ipopt", horizon=8, Q=Weights(p=1.0), R=Weights(a=0.1), limits=Limits(a=2.0))
    assert mpc.ocp is problem
    assert np.array_equal(mpc.plan(x, still).u, posed_here.plan(x, still).u)
    narrow = MPC(ocp=problem, limits=Limits(a=0.5), solver="ipopt")
    assert np.abs(narrow.plan(x, still).u).max() == pytest.approx(0.5, abs=1e-6)
    assert replace(mpc, R=Weights(a=1.0)).ocp.limits == problem.limits
    with pytest.raises(TypeError, match="horizon"):
        MPC(double_integrator(), Q=Weights(p=1.0))
    with pytest.raises(ParameterError, match="names 'limit'; nearest are 'limits'"):
        MPC(double_integrator(), horizon=8, Q=Weights(p=1.0), limit=Limits(a=2.0))


def test_within_keeps_bounds_before_rates():
    u = within(np.array([[5.0], [-5.0]]), np.array([3.0]), np.array([[-1.0, 1.0]]), np.array([[-0.5, 0.5]]))
    assert u.ravel() == pytest.approx([1.0, 0.5])
