"""Stages of several steps: the problem on the fine grid with the input held, in the loop, when solves fail."""

from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.control.mpc import MPC
from slipangle.control.switched import SwitchedMPC
from slipangle.errors import ParameterError
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.ocp import OCP, Reference
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.solution import Status, inputs_later, states_later, within
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths.lane_change import double_lane_change
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant
from tests.models.all_models import ALL_MODELS
from tests.optimal.linear import double_integrator

CAR = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r", "a_y")))
STEPS = (1, 1, 2, 3, 1, 4, 2)
LANE = MPC(
    CAR,
    solver="ipopt",
    horizon=7,
    steps=STEPS,
    Q=Weights(e_y=10.0, e_psi=1.0),
    R=Weights(delta=3.0),
    S=Weights(delta=20.0),
    terminal=Weights(e_y=5.0),
    limits=Limits(delta=0.2, r=(-0.24, 0.24), a_y=4.0, v_y=0.14),
    rates=Limits(delta=0.6),
    slack=Weights(r=30.0, a_y=0.2),
    slack_linear=Weights(r=2.0, a_y=0.01),
)
PATH = double_lane_change(15.0)
X = np.array([0.05, 0.1, 40.0, 0.3, 0.03])
CART = MPC(
    double_integrator(),
    solver="ipopt",
    horizon=6,
    steps=(1, 1, 2, 3, 4, 4),
    Q=Weights(p=1.0, v=0.1),
    R=Weights(a=0.05),
    limits=Limits(a=(-2.0, 2.0)),
    rates=Limits(a=4.0),
    fallback=20,
)


def still(mpc, target=0.0):
    return Reference(
        tracked=np.full((mpc.horizon + 1, len(mpc.references)), target),
        exogenous=np.zeros((mpc.horizon, len(mpc.exogenous))),
    )


# ---- the same as a problem written out on the fine grid ------------------------------------------------------------


def written_out(mpc, x, reference, before):
    """Inputs and cost of the problem as a sum over the model's steps, states rolled out, slack as variables."""
    n, steps, dt = mpc.horizon, mpc.ocp.steps, mpc.dt
    u, slack = ca.MX.sym("u", len(mpc.controls), n), ca.MX.sym("slack", len(mpc.ocp.soft), n + 1)
    q, end, r, s = (ca.DM(w) for w in mpc.ocp.weights)
    square, plain = (ca.DM(w) for w in mpc.ocp.slack_weights)
    rate = np.array([mpc.ocp.rates[name] for name in mpc.controls])
    bounds = mpc.ocp.state_bounds(reference)
    soft = [mpc.ocp.limited.index(name) for name in mpc.ocp.soft]
    cost, state, last, middle, now = ca.MX(0), ca.MX(ca.DM(x)), ca.DM(before), -0.5 * dt, 0.0
    rows, low, high = [], [], []

    def limit(i, limited, which):
        nonlocal cost
        for j in which:
            k = soft.index(j) if j in soft else None
            e = 0 if k is None else slack[k, i]
            for row, lower, upper in (
                (limited[j] + e, bounds[i, j, 0], np.inf),
                (limited[j] - e, -np.inf, bounds[i, j, 1]),
            ):
                rows.append(row)
                low.append(lower)
                high.append(upper)
            if k is not None:
                cost += (1 if i == 0 else steps[i - 1]) * (square[k] * e**2 + plain[k] * e)

    for i in range(n):
        held, w = u[:, i], ca.DM(reference.exogenous[i])
        error, limited = mpc.ocp.stage(state, held, w, ca.DM(reference.tracked[i]))
        limit(i, limited, np.flatnonzero(mpc.ocp.limited_now) if i == 0 else range(len(mpc.ocp.limited)))
        distance = now + 0.5 * steps[i] * dt - middle
        middle += distance
        rows.append(held - last)
        low += (rate[:, 0] * distance).tolist()
        high += (rate[:, 1] * distance).tolist()
        cost += ca.dot(s, (held - last) ** 2) * dt / distance
        for _ in range(steps[i]):
            cost += ca.dot(q, error**2) + ca.dot(r, held**2)
            state, now = mpc.ocp.dynamics(state, held, w), now + dt
        last = held
    error, limited = mpc.ocp.stage(state, last, w, ca.DM(reference.tracked[n]))
    limit(n, limited, range(len(mpc.ocp.limited)))
    cost += ca.dot(end, error**2)
    options = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False, "ipopt.tol": 1e-10}
    nlp = {"x": ca.veccat(u, slack), "f": cost, "g": ca.vertcat(*rows)}
    solver = ca.nlpsol("fine", "ipopt", nlp, options)
    box = np.tile(mpc.ocp.input_bounds, (n, 1))
    extra = slack.numel()
    found = solver(
        lbx=[*box[:, 0], *np.zeros(extra)], ubx=[*box[:, 1], *np.full(extra, np.inf)], lbg=low, ubg=high, x0=0
    )
    assert solver.stats()["success"]
    return np.asarray(found["x"]).ravel()[: u.numel()].reshape(n, -1), float(found["f"])


@pytest.mark.parametrize("solver", ["ipopt", RealTime(iterations=0)], ids=["ipopt", "realtime"])
def test_it_is_the_problem_on_the_fine_grid_with_the_input_held(solver):
    mpc = replace(LANE, solver=solver)
    reference = mpc.reference(PATH.ahead(40.0, mpc.times))
    before = np.array([0.02])
    plan = mpc.plan(X, reference, applied=before)
    u, cost = written_out(LANE, X, reference, before)
    assert plan.status is Status.SOLVED
    assert plan.u == pytest.approx(u, abs=1e-6)
    assert plan.cost == pytest.approx(cost, rel=1e-6)
    rolled, now = [X], X
    for i, length in enumerate(STEPS):
        for _ in range(length):
            now = CAR.step(now, [*plan.u[i], reference.exogenous[i, 0]])
        rolled.append(now)
    assert plan.x == pytest.approx(np.array(rolled), abs=1e-7)
    changes = np.abs(np.diff(np.vstack([before, plan.u]), axis=0))[:, 0] / mpc.ocp.step_bounds[:, 0, 1]
    outputs = np.array([CAR.output(x, [*v, 15.0]) for x, v in zip(plan.x, plan.u, strict=False)])
    reached = [changes.max(), np.abs(plan.x[1:, 0]).max() / 0.14, np.abs(outputs[:, 0]).max() / 0.24]
    assert reached == pytest.approx([1.0, 1.0, max(reached[2], 1.001)], abs=1e-5)  # each kind of limit is at work


@pytest.mark.parametrize(
    "solver", ["ipopt", RealTime(iterations=0), RealTime()], ids=["ipopt", "converged", "one step"]
)
def test_steps_of_one_change_nothing(solver):
    plain = replace(LANE, steps=None, solver=solver)
    ones = replace(plain, steps=[1] * 7)
    assert ones.ocp.steps == (1,) * 7
    assert ones.times == pytest.approx(plain.times)
    a = b = None
    for k in range(4):
        reference = plain.reference(PATH.ahead(40.0 + 0.75 * k, plain.times))
        x = X if a is None else a.x[1]
        a, b = plain.plan(x, reference, a), ones.plan(x, reference, b)
        assert np.array_equal(a.u, b.u)
        assert np.array_equal(a.x, b.x)
        assert a.cost == b.cost


# ---- time passes ---------------------------------------------------------------------------------------------------


def test_plans_move_along_in_time():
    lengths, nodes = np.array([1, 1, 2, 4]), np.array([0, 1, 2, 4, 8])
    u = np.array([[1.0], [2.0], [4.0], [8.0]])
    fine = np.repeat(u, lengths, axis=0).ravel()
    for k in range(10):
        ahead = np.append(fine, np.full(20, 8.0))[k : k + 8]
        means = [ahead[a:b].mean() for a, b in pairwise(nodes)]
        assert inputs_later(u, lengths, k).ravel() == pytest.approx(means)
        assert inputs_later(u, lengths, k)[0] == ahead[0]
    x = np.array([[0.0], [1.0], [3.0], [5.0], [13.0]])
    line = np.interp(np.arange(9), nodes, x.ravel())
    for k in range(10):
        assert states_later(x, nodes, k).ravel() == pytest.approx(line[np.minimum(nodes + k, 8)])


@pytest.mark.parametrize(
    "solver", ["ipopt", RealTime(), RealTime(iterations=0)], ids=["ipopt", "one step", "converged"]
)
def test_a_warm_start_finds_what_a_cold_one_finds(solver):
    mpc = replace(LANE, solver=solver, limits=Limits(delta=0.2, v_y=0.3), slack=Weights(), slack_linear=Weights())
    cold = replace(mpc, solver=Ipopt(warm=False))
    x, plan, before = X, None, np.zeros(1)
    exact = 1e-5 if solver != RealTime() else 3e-3
    for k in range(6):
        reference = mpc.reference(PATH.ahead(40.0 + 0.75 * k, mpc.times))
        plan = mpc.plan(x, reference, plan)
        assert plan.status.solved
        assert plan.u == pytest.approx(cold.plan(x, reference, applied=before).u, abs=exact)
        before, x = plan.command, CAR.step(x, [*plan.command, 15.0])


@pytest.mark.parametrize("solver", ["ipopt", RealTime()], ids=["ipopt", "realtime"])
def test_fallbacks_follow_the_old_plan_in_time(solver):
    mpc = replace(CART, solver=solver, rates=Limits(a=40.0))
    plan = good = mpc.plan(np.array([1.0, 0.5]), still(mpc))
    held = np.repeat(good.u, mpc.ocp.steps, axis=0)
    assert np.ptp(held) > 1.0
    for k in range(1, 16):
        plan = mpc.plan(np.full(2, np.nan), still(mpc), plan)
        assert (plan.status, plan.age, plan.stopping) == (Status.NOT_FINITE, k, k > 14)
        if k <= 14:
            assert plan.command == pytest.approx(held[k])
    assert mpc.plan(np.array([1.0, 0.5]), still(mpc), plan).status is Status.SOLVED


def test_a_plan_at_other_instants_is_no_fallback():
    other = replace(CART, steps=None)
    plan = CART.plan(np.full(2, np.nan), still(CART), other.plan(np.array([1.0, 0.5]), still(other)))
    assert plan.stopping
    assert other.plan(np.full(2, np.nan), still(other), replace(plan, stopping=False)).stopping


def test_killed_solves_keep_rates_and_bounds_from_sample_to_sample():
    """A coarse plan changes by more at the end of a stage than may be in one sample."""
    rng = np.random.default_rng(3)
    most = 4.0 * CART.dt
    widest = 0.0
    for _ in range(20):
        x, plan, last = rng.uniform(-3, 3, 2), None, 0.0
        for k in range(30):
            lost = plan is not None and (k % 10 >= 2 or rng.random() < 0.1)
            plan = CART.plan(np.full(2, np.nan) if lost else x, still(CART), plan)
            if plan.age == 0:
                widest = max(widest, float(np.abs(np.diff(plan.u[:, 0])).max()))
            u = np.concatenate([[last], plan.u[:, 0]])
            assert np.isfinite(u).all()
            assert np.abs(u).max() <= 2.0
            assert abs(u[1] - last) <= most * (1 + 1e-9)
            assert (np.abs(np.diff(u)) <= CART.ocp.step_bounds[:, 0, 1] * (1 + 1e-9)).all()
            last = float(plan.command[0])
            x = CART.model.step(x, plan.command)
    assert widest > 2 * most


def test_the_stop_law_takes_the_same_time():
    a, b = CART, replace(CART, horizon=15, steps=None)
    plans = [m.plan(np.full(2, np.nan), still(m), applied=np.array([1.5])) for m in (a, b)]
    assert plans[0].stopping
    assert plans[0].u[-1] == pytest.approx(plans[1].u[-1])


def test_within_takes_rates_per_stage():
    u = within(
        np.array([[5.0], [-5.0]]), np.array([0.0]), np.array([[-9.0, 9.0]]), np.array([[[-1.0, 1.0]], [[-3.0, 3.0]]])
    )
    assert u.ravel() == pytest.approx([1.0, -2.0])


# ---- in the loop ---------------------------------------------------------------------------------------------------


@pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
def test_few_stages_drive_as_many_steps_do():
    path, errors = double_lane_change(15.0), []
    plant = Plant(OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.01, outputs=("r", "a_y"))))
    for horizon, steps in ((22, None), (10, (1, 1, 1, 1, 2, 2, 2, 4, 4, 4)), (10, None)):
        mpc = MPC(
            CAR,
            horizon=horizon,
            steps=steps,
            Q=Weights(e_y=10.0, e_psi=1.0),
            S=Weights(delta=100.0),
            limits=Limits(delta=0.3),
            rates=Limits(delta=1.0),
            solver="realtime",
        )
        run = closed_loop(plant, mpc, path, sample=0.05)
        assert {p.status for p in run.plans[1:]} == {Status.REAL_TIME}
        assert run.plans[3].times[-1] == pytest.approx(0.05 * (10 if horizon == 10 and steps is None else 22))
        errors.append(float(np.sqrt(np.mean(run.e_y**2))))
    long, few, short = errors
    assert few <= 1.1 * long
    assert long < 0.8 * short


def test_a_preview_at_other_instants_is_refused():
    ahead = PATH.ahead(40.0, LANE.times)
    assert ahead.t == pytest.approx(0.05 * np.array([0, 1, 2, 4, 7, 8, 12, 14]))
    assert ahead.s == pytest.approx(40.0 + 15.0 * ahead.t)
    with pytest.raises(ParameterError, match=r"looks 0.35 s ahead; expected 0.7 s.*mpc\.times"):
        LANE.plan(X, PATH.ahead(40.0, 7, 0.05))
    with pytest.raises(ParameterError, match=r"15 rows; expected horizon \+ 1 = 8"):
        LANE.plan(X, PATH.ahead(40.0, 14, 0.05))


# ---- bad input -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("steps", "what"),
    [
        ((1, 1), "steps has 2 entries; expected one for each of the 3 stages"),
        ((1, 0, 1), "whole numbers of at least 1"),
        ((1, 1.5, 2), "whole numbers of at least 1"),
        ((1, "a", 2), "whole numbers of at least 1"),
        ((2, 2, 2), r"begins with 2; expected 1, because the controller plans anew every 0\.1 s"),
    ],
)
def test_bad_steps_say_what_to_do(steps, what):
    with pytest.raises(ParameterError, match=what):
        OCP(double_integrator(), horizon=3, Q=Weights(p=1.0), R=Weights(a=1.0), steps=steps)


def test_steps_may_come_as_any_whole_numbers():
    a = OCP(double_integrator(), horizon=3, Q=Weights(p=1.0), R=Weights(a=1.0), steps=np.array([1, 2, 3]))
    assert a.steps == (1, 2, 3)
    assert a.times == pytest.approx([0.0, 0.1, 0.3, 0.6])
    assert (a.nodes.tolist(), a.stage_of.tolist()) == ([0, 1, 3, 6], [0, 1, 1, 2, 2, 2])


def test_step_bounds_go_from_middle_to_middle():
    assert LANE.ocp.step_bounds[:, 0, 1] == pytest.approx(0.6 * 0.05 * np.array([1, 1, 1.5, 2.5, 2, 2.5, 3]))


def test_switched_controllers_want_equal_steps():
    marx = ALL_MODELS["smoothly blended ARX models on the ground"]
    settings = {"horizon": 3, "Q": Weights(e_y=1.0), "S": Weights(delta=1.0)}
    calm, limit = MultiARXMPC(marx, **settings), MPC(CAR, **settings, steps=(1, 2, 2))
    assert SwitchedMPC(calm, replace(limit, steps=None)).times == pytest.approx(calm.times)
    with pytest.raises(ParameterError, match="expected equal steps"):
        SwitchedMPC(calm, limit)
