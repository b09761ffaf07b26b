"""The real-time solver agrees with Ipopt on any model, keeps what it promises, and survives bad input."""

import re
from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.control.mpc import MPC
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2, SOUSA_TABLE_7_2
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.engine import Start
from slipangle.optimal.ocp import Reference
from slipangle.optimal.realtime import RealTime, backend
from slipangle.optimal.realtime.program import source
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths.lane_change import double_lane_change
from tests.models.all_models import ALL_MODELS, SIZE, typical
from tests.optimal.linear import double_integrator, lqr, two_masses
from tests.optimal.optimality import projected_gradient

pytestmark = pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
CONVERGED = RealTime(iterations=0)
GAIN = 30.0


def car(horizon=10, **options):
    """The thesis' front-drive car: input is the road-wheel angle, a thirtieth of the steering wheel's."""
    if options.keys() <= {"solver", "deadline"}:
        return replace(usual_car(horizon), **options)
    return posed_car(horizon, **options)


@cache
def usual_car(horizon):
    """Its problem is put into C once."""
    return posed_car(horizon)


def posed_car(horizon, **options):
    model = SingleTrack(params=SOUSA_TABLE_6_1, dt=0.1, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2, method="radau")
    settings = {
        "horizon": horizon,
        "Q": Weights(v_x=1500.0, X=200.0, Y=2500.0),
        "S": Weights(delta=100.0 * GAIN**2, T_f=1e-6),
        "limits": Limits(delta=0.9 / GAIN, T_f=2500.0),
        "solver": "realtime",
    }
    return MPC(model, **(settings | options))


def pose(path, s):
    """X, Y, psi of the path, as keywords of ``straight``."""
    at = path.at(s)
    return {"X": at.X[0], "Y": at.Y[0], "psi": at.psi[0]}


def drive(mpc, steps=60):
    """Closed loop on the model itself; yields state, reference, plan."""
    path = double_lane_change(20.0, blend=12.0)
    x, plan, s = mpc.model.straight(19.0, X=path.start[0]), None, 0.0
    for _ in range(steps):
        s = path.project(x[5], x[6], s).s
        reference = mpc.reference(path.ahead(s, mpc.horizon, mpc.dt), T_r=0.0)
        previous, plan = plan, mpc.plan(x, reference, plan)
        yield x, reference, previous, plan
        x = np.asarray(mpc.model.functions[0](x, [*plan.command, 0.0])).ravel()


# ---- the same answer as Ipopt --------------------------------------------------------------------------------------


def problem(model, rng, horizon):
    """Random weights on outputs, limits that bite, sometimes rates and soft limits."""
    controls = ("delta",) if "delta" in model.inputs else model.inputs[:1]
    size = {n: SIZE.get(n, 1.0) for n in (*model.inputs, *model.outputs, *model.states)}
    tracked = model.outputs[:2]
    soft = [n for n in model.states if n in ("v_y", "r")][:1]
    return MPC(
        model,
        solver="ipopt",
        horizon=horizon,
        controls=controls,
        Q=Weights(**{n: 10.0 ** rng.uniform(-1, 1) / size[n] ** 2 for n in tracked}),
        R=Weights(**{n: 10.0 ** rng.uniform(-3, -1) / size[n] ** 2 for n in controls}),
        S=Weights(**{n: 10.0 ** rng.uniform(-2, 0) / size[n] ** 2 for n in controls}),
        limits=Limits(**{n: rng.uniform(0.5, 2.0) * size[n] for n in (*controls, *soft)}),
        rates=Limits(**({n: rng.uniform(2, 20) * size[n] for n in controls} if rng.random() < 0.5 else {})),
        slack=Weights(**{n: 5.0 / size[n] ** 2 for n in soft}),
        slack_linear=Weights(**{n: rng.choice([0.0, 1.0]) / size[n] for n in soft}),
    )


def situation(mpc, seed):
    """State, reference and input before."""
    rng = np.random.default_rng(seed)
    x, u = typical(mpc.model, seed)
    size = np.array([SIZE.get(n, 1.0) for n in mpc.references])
    goal = size * (np.array([n == "v_x" for n in mpc.references]) + 0.3 * rng.standard_normal(len(size)))
    exogenous = np.array([u[mpc.model.inputs.index(n)] for n in mpc.exogenous])
    reference = Reference(tracked=np.tile(goal, (mpc.horizon + 1, 1)), exogenous=np.tile(exogenous, (mpc.horizon, 1)))
    return x, reference, 0.3 * mpc.ocp.input_bounds[:, 1] * rng.uniform(-1, 1, len(mpc.controls))


def compare(model, seeds, *, horizon=6, steps=None, relative=1e-5):
    """First inputs agree with Ipopt; returns how many were compared.

    At most one may be another, worse optimum, and then from Ipopt's answer we find Ipopt's.
    """
    mpc = replace(problem(model, np.random.default_rng(0), horizon), steps=steps)
    ours = replace(mpc, solver=CONVERGED)
    scale = mpc.ocp.input_bounds[:, 1]
    compared = worse = 0
    for seed in seeds:
        x, reference, before = situation(mpc, seed)
        mine, theirs = ours.plan(x, reference, applied=before), mpc.plan(x, reference, applied=before)
        if not (mine.status is Status.SOLVED and theirs.status.solved):
            continue
        compared += 1
        if abs(mine.cost - theirs.cost) > 1e-7 * (1 + abs(theirs.cost)):
            if mine.cost < theirs.cost:
                continue
            worse += 1
            start = Start(x=x, applied=before, reference=reference, guess_u=theirs.u, guess_x=theirs.x)
            mine = ours.engine.solve(start)
            assert abs(mine.cost - theirs.cost) <= 1e-7 * (1 + abs(theirs.cost)), seed
        assert np.abs((mine.u[0] - theirs.command) / scale).max() <= relative * 3, seed
    assert worse <= 1
    return compared


FEW = [
    "bicycle",
    "ARX, two inputs, delay, constant",
    "state space",
    "NARX",
    "hybrid of a bicycle",
    "bicycle on the ground",
    "ARX on the ground",
]
FEWEST = ("ARX, two inputs, delay, constant", "hybrid of a bicycle", "bicycle on the ground")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n not in FEWEST)) for n in FEW if n in ALL_MODELS]
)
def test_the_same_call_for_any_model_gives_ipopts_answer(name):
    assert compare(ALL_MODELS[name], range(4), horizon=3 if "hybrid" in name else 6) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in ALL_MODELS if n not in FEW])
def test_every_other_model_too(name):
    assert compare(ALL_MODELS[name], range(6)) >= 4


def thesis_problems(seeds, horizon=10, steps=None, first=0):
    """Random weights, states and references of the thesis' problem: seed, both solvers, x, reference, input before."""
    for group in range(first, len(seeds), 10):
        rng = np.random.default_rng([group, 5])
        q, s = 10.0 ** rng.uniform(-0.5, 0.5, 3), 10.0 ** rng.uniform(-0.5, 1, 2)
        mpc = car(
            horizon,
            Q=Weights(v_x=1500.0 * q[0], X=200.0 * q[1], Y=2500.0 * q[2]),
            S=Weights(delta=100.0 * s[0] * GAIN**2, T_f=1e-6 * s[1]),
            solver=CONVERGED,
            steps=steps,
        )
        reference_solver = replace(mpc, solver="ipopt")
        path = double_lane_change(20.0, blend=12.0)
        for seed in seeds[group : group + 10]:
            draw = np.random.default_rng(seed)
            s0 = draw.uniform(0, path.length - 30)
            x = mpc.model.straight(draw.uniform(15, 25), **pose(path, s0))
            x[[1, 2, 6, 7]] += draw.normal(0, [0.2, 0.05, 0.3, 0.02])
            before = np.array([0.02, 800.0]) * draw.uniform(-1, 1, 2)
            yield seed, mpc, reference_solver, x, mpc.reference(path.ahead(s0, mpc.times), T_r=0.0), before


def assert_same(mine, theirs, seed):
    assert abs(mine.cost - theirs.cost) <= 1e-8 * abs(theirs.cost), seed
    assert np.abs((mine.u - theirs.u) / [0.03, 2500.0]).max() <= 1e-5, seed
    assert mine.x == pytest.approx(theirs.x, abs=1e-5), seed


def agree(seeds, **options):
    """How many plans are the same to 1e-5, and how many are two different optima.

    Of two optima, ours has no slope left, and from Ipopt's answer we find Ipopt's.
    """
    same = other = 0
    for seed, mpc, ipopt, x, reference, before in thesis_problems(seeds, **options):
        mine, theirs = mpc.plan(x, reference, applied=before), ipopt.plan(x, reference, applied=before)
        assert mine.status is Status.SOLVED, seed
        if not theirs.status.solved:
            continue
        if abs(mine.cost - theirs.cost) <= 1e-8 * abs(theirs.cost):
            same += 1
            assert_same(mine, theirs, seed)
        else:
            other += 1
            assert projected_gradient(mpc.ocp, x, reference, before, mine.u) <= 1e-6, seed
            start = Start(x=x, applied=before, reference=reference, guess_u=theirs.u, guess_x=theirs.x)
            assert_same(mpc.engine.solve(start), theirs, seed)
    return same, other


def test_a_gradient_that_states_alone_have_changed_is_no_curvature():
    """All inputs at their bounds while the states close their gaps: one was held there by what that looked like."""
    *_, (seed, mpc, ipopt, x, reference, before) = thesis_problems(range(354), first=350)
    assert_same(mpc.plan(x, reference, applied=before), ipopt.plan(x, reference, applied=before), seed)


def test_the_thesis_problem_agrees_with_ipopt():
    assert agree(range(10))[0] >= 9


@pytest.mark.slow
def test_the_thesis_problem_agrees_with_ipopt_a_thousand_times():
    same, other = agree(range(1000))
    print(f"{same} the same to 1e-5, {other} two optima")
    assert same >= 970
    assert same + other >= 995


@pytest.mark.parametrize("horizon", [*(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2)), 9])
@pytest.mark.parametrize("model", [double_integrator(), two_masses()], ids=["double integrator", "two masses"])
def test_without_active_limits_it_is_the_lqr(model, horizon):
    rng = np.random.default_rng(horizon)
    n, m = model.n_states, model.n_inputs
    q, r, x, before = rng.uniform(0.1, 3, n), rng.uniform(0.05, 1, m), rng.standard_normal(n), rng.standard_normal(m)
    mpc = MPC(
        model,
        horizon=horizon,
        Q=Weights(**dict(zip(model.states, q, strict=True))),
        R=Weights(**dict(zip(model.inputs, r, strict=True))),
        S=Weights(**dict.fromkeys(model.inputs, 0.7)),
        solver="realtime",
    )
    reference = Reference(tracked=np.zeros((horizon + 1, n)), exogenous=np.zeros((horizon, 0)))
    plan = mpc.plan(x, reference, applied=before)
    expected = lqr(model.A, model.B, np.diag(q), np.diag(r), 0.7 * np.eye(m), np.diag(q), horizon, x, before)
    assert plan.status is Status.SOLVED
    assert plan.u == pytest.approx(expected, abs=1e-8)
    assert replace(mpc, solver="ipopt").plan(x, reference, applied=before).cost == pytest.approx(plan.cost, rel=1e-7)


# ---- real-time iteration -------------------------------------------------------------------------------------------


def test_real_time_iterations_track_as_well_as_converged_plans():
    errors = []
    for solver in (RealTime(), CONVERGED):
        plans = list(drive(car(solver=solver)))
        path = double_lane_change(20.0, blend=12.0)
        errors.append([path.project(x[5], x[6], None).e_y for x, *_ in plans])
        wanted = Status.REAL_TIME if solver.iterations else Status.SOLVED
        assert {plan.status for *_, plan in plans[1:]} == {wanted}
        assert all(plan.residual <= (1e-2 if solver.iterations else 1e-7) for *_, plan in plans[1:])
    fast, slow = (np.sqrt(np.mean(np.square(e))) for e in errors)
    assert fast <= 1.1 * slow
    assert slow < 0.03


def test_stages_of_the_integrator_are_found_to_the_tolerance():
    """Newton's method ends as soon as the shrinking of its steps promises it, not a step later."""
    given = [[p.u / [0.03, 2500] for *_, p in drive(car(solver=RealTime(newton=n)), steps=40)] for n in (1e-7, 1e-13)]
    assert np.array(given[0]) == pytest.approx(np.array(given[1]), abs=1e-6)


def test_prepared_plans_are_the_same_when_the_state_is_as_expected():
    mpc = car()
    for _, reference, previous, plan in drive(mpc, steps=6):
        if previous is None:
            continue
        x = previous.x[1]
        whole = mpc.plan(x, reference, previous)
        mpc.prepare(reference, previous)
        split = mpc.plan(x, reference, previous)
        assert split.u == pytest.approx(whole.u, rel=1e-9, abs=1e-12)
        off = x + np.array([0.05, 0.01, 0.002, 0.1, 0.1, 0.0, 0.01, 0.001])
        mpc.prepare(reference, previous)
        assert mpc.plan(off, reference, previous).u == pytest.approx(mpc.plan(off, reference, previous).u, abs=20.0)
        assert plan.status.solved


def test_a_plan_depends_on_its_arguments_only():
    mpc = car()
    *_, (x, reference, previous, plan) = drive(mpc, steps=10)
    mpc.plan(x + 0.01, reference)  # something else in between
    again = mpc.plan(x, reference, previous)
    assert again.u == pytest.approx(plan.u, rel=1e-9, abs=1e-9)
    fresh = posed_car(10).plan(x, reference, previous)  # another controller knows only the inputs
    assert fresh.status is Status.SOLVED


def require_plans_of_their_arguments_alone(mpc, steps, every):
    """What a work area holds serves the next plan; elsewhere that is found again, the same to the last bit."""
    other, rng = deepcopy(mpc), np.random.default_rng(0)
    for k, (x, reference, previous, plan) in enumerate(drive(mpc, steps=steps)):
        if previous is None:
            continue
        again = other.plan(x, reference, previous)  # never what `other` has at hand
        assert (again.u == plan.u).all()
        assert (again.x == plan.x).all()
        assert (again.x[0] == x).all()
        assert (again.cost, again.violation, again.residual) == (plan.cost, plan.violation, plan.residual)
        if k % every == 0:  # another state, near or far, and other exogenous inputs
            off = x + 10.0 ** rng.uniform(-4, 0) * rng.normal(size=len(x))
            torque = replace(reference, exogenous=reference.exogenous + 100.0)
            for given in ((off, reference, plan), (x, torque, plan), (x, reference, plan)):
                mine, theirs = mpc.plan(*given), other.plan(*given)
                mpc.plan(x, reference, previous)  # the area holds the plan again
                assert (mine.u == theirs.u).all()
                assert (mine.x == theirs.x).all()
                assert mine.residual == theirs.residual


@pytest.mark.parametrize("n", [10, pytest.param(8, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)])
def test_a_plan_is_the_same_whatever_the_work_area_holds(n):
    require_plans_of_their_arguments_alone(car(n), steps=14, every=2)


def test_soft_envelope_and_corridor_hold_where_they_can():
    model = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r", "v_y")))
    mpc = MPC(
        model,
        horizon=20,
        Q=Weights(e_y=10.0, e_psi=1.0),
        R=Weights(delta=1.0),
        limits=Limits(delta=0.3, r=0.25, v_y=1.0),
        rates=Limits(delta=1.0),
        slack=Weights(r=100.0, v_y=100.0, e_y=100.0),
        slack_linear=Weights(r=1000.0, v_y=1000.0, e_y=1000.0),
        corridor=1.8,
        solver=CONVERGED,
    )
    path = double_lane_change(15.0)
    x = np.array([0.0, 0.0, *pose(path, 40.0).values()])
    reference = mpc.reference(path.ahead(40.0, 20, 0.05))
    mine, theirs = mpc.plan(x, reference), replace(mpc, solver="ipopt").plan(x, reference)
    assert mine.status is Status.SOLVED
    assert mine.cost == pytest.approx(theirs.cost, rel=1e-6)
    assert mine.u == pytest.approx(theirs.u, abs=1e-5)


@pytest.mark.slow
def test_slip_angle_and_yaw_rate_envelope_is_ipopts_too():
    """Soft limits on slip angles, yaw rate and the lane on the car with stiff wheels: some exceeded, some kept."""
    base = car(solver=CONVERGED)
    soft = ("alpha_f", "alpha_r", "r", "e_y")
    mpc = replace(
        base,
        model=replace(base.model, outputs=("alpha_f", "alpha_r")),
        limits=Limits(**base.ocp.limits, alpha_f=0.02, alpha_r=0.02, r=0.15),
        slack=Weights(**dict.fromkeys(soft, 1e5)),
        slack_linear=Weights(**dict.fromkeys(soft, 1e3)),
        corridor=1.8,
    )
    path = double_lane_change(20.0, blend=12.0)
    largest = []
    for s in (15.0, 40.0, 70.0):
        x = mpc.model.straight(20.0, **pose(path, s))
        x[6] += 0.4
        reference = mpc.reference(path.ahead(s, 10, 0.1), T_r=0.0)
        mine, theirs = mpc.plan(x, reference), replace(mpc, solver="ipopt").plan(x, reference)
        assert mine.status is Status.SOLVED
        assert mine.cost == pytest.approx(theirs.cost, rel=1e-6)
        assert np.abs((mine.u - theirs.u) / [0.03, 2500.0]).max() <= 1e-4
        free = base.plan(x, base.reference(path.ahead(s, 10, 0.1), T_r=0.0))
        largest.append([np.abs(slip_angles(mpc, plan)).max() for plan in (mine, free)])
    kept, loose = np.transpose(largest)
    assert (kept <= loose + 1e-6).all()
    assert (kept < 0.95 * loose).any()


def slip_angles(mpc, plan):
    return [np.asarray(mpc.model.functions[1](x, [*u, 0.0])).ravel() for x, u in zip(plan.x, plan.u, strict=False)]


@pytest.mark.parametrize("steps", [None, (1, 1, 2, 3)])
def test_the_source_takes_no_memory(steps):
    """Not one allocation: its caller gives it a workspace, of the size that it says."""
    code = source(car(4, steps=steps).ocp)
    assert re.findall(r"\b(malloc|calloc|realloc|posix_memalign|aligned_alloc|alloca|free)\s*\(", code) == []
    assert "return (long)sizeof(Work);" in code[code.index("long rt_size(void)") :]


def test_vectors_are_half_as_wide_where_half_of_one_would_be_idle():
    """Of implicit and of explicit steps; code that is called step by step has no vectors to fill."""
    explicit = problem(ALL_MODELS["bicycle"], np.random.default_rng(0), 10)
    for mpc in (car(10), explicit):
        assert "#define HALF_IDLE" in source(mpc.ocp)
        assert "#define HALF_IDLE" not in source(replace(mpc, horizon=14).ocp)
        assert 'sched-pressure")' in source(mpc.ocp)


def test_times_of_both_parts_are_that_of_the_whole():
    mpc = car()
    assert [plan for *_, plan in drive(mpc, steps=3)][-1].status is Status.REAL_TIME
    spent = mpc.engine.timing
    assert min(spent.prepare, spent.feedback) > 0
    assert spent.total == pytest.approx(spent.prepare + spent.feedback, rel=1e-9)


def test_another_deadline_writes_and_compiles_nothing(monkeypatch):
    """Which took half a second a controller."""
    mpc = car()
    assert mpc.engine is mpc.engine
    monkeypatch.setattr(backend, "source", None)
    other = replace(mpc, deadline=0.05, solver=RealTime(max_iterations=50))
    assert other.engine is not mpc.engine
    reference = other.reference(double_lane_change(20.0, blend=12.0).ahead(0.0, 10, 0.1), T_r=0.0)
    assert other.plan(other.model.straight(19.0), reference).status.solved


def test_weights_are_data():
    """Other weights compile nothing and count at once."""
    a, b = car(), car(Q=Weights(v_x=15.0, X=2.0, Y=25.0), S=Weights(delta=1e5, T_f=1e-4))
    assert source(a.ocp) == source(b.ocp)
    x = a.model.straight(19.0, Y=0.3)
    reference = a.reference(double_lane_change(20.0, blend=12.0).ahead(0.0, 10, 0.1), T_r=0.0)
    plans = [m.plan(x, reference) for m in (a, b)]
    assert np.abs(plans[0].u - plans[1].u).max() > 1e-3
    for m, plan in zip((a, b), plans, strict=True):
        theirs = replace(m, solver="ipopt").plan(x, reference)
        assert plan.cost == pytest.approx(theirs.cost, rel=1e-8)


# ---- trouble -------------------------------------------------------------------------------------------------------


def test_near_deadbeat_weights_converge():
    mpc = car(S=Weights(delta=1e-3, T_f=1e-12), Q=Weights(v_x=1.0, X=1e-6, Y=1e6), solver=CONVERGED)
    path = double_lane_change(20.0, blend=8.0)
    for s in (20.0, 40.0, 60.0, 100.0):
        x = mpc.model.straight(20.0, **pose(path, s))
        x[6] += 0.5
        plan = mpc.plan(x, mpc.reference(path.ahead(s, 10, 0.1), T_r=0.0))
        assert plan.status in (Status.SOLVED, Status.STALLED)
        assert plan.age == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
def test_bad_states_fall_back_and_leave_no_trace(bad):
    mpc = car()
    *_, (x, reference, previous, plan) = drive(mpc, steps=8)
    broken = x.copy()
    broken[1] = bad
    fallen = mpc.plan(broken, reference, previous)
    assert fallen.age == 1
    assert np.isfinite(fallen.u).all()
    assert np.isfinite(fallen.x).all()
    assert mpc.plan(x, reference, previous).u == pytest.approx(plan.u, rel=1e-9, abs=1e-9)
    after = mpc.plan(x, reference, fallen)
    assert after.age == 0
    assert after.status is Status.SOLVED


def test_deadline_is_kept():
    mpc = car(deadline=1e-6)
    *_, (x, reference, previous, _) = drive(car(), steps=5)
    plan = mpc.plan(x, reference, previous)
    assert plan.status is Status.TIME_OUT
    assert plan.age == 1
    assert plan.seconds < 0.1  # Ipopt takes longer; the time of one step here is tens of microseconds
    assert car(deadline=1.0).plan(x, reference).status is Status.SOLVED


def test_infeasible_limits_are_said():
    mpc = MPC(
        double_integrator(),
        horizon=8,
        Q=Weights(p=1.0),
        R=Weights(a=0.1),
        limits=Limits(a=1.0, p=(-1.0, 1.0)),
        solver="realtime",
    )
    reference = Reference(tracked=np.zeros((9, 1)), exogenous=np.zeros((8, 0)))
    assert mpc.plan(np.array([0.9, 8.0]), reference).status is Status.INFEASIBLE
    assert mpc.plan(np.array([0.5, 0.0]), reference).status is Status.SOLVED


def past_the_peak(mpc, seed):
    """State with locked or spinning wheels on a slide, and the reference from there."""
    rng, path = np.random.default_rng(seed), double_lane_change(20.0, blend=12.0)
    s, v = rng.uniform(0, path.length - 60), rng.uniform(3, 35)
    x = mpc.model.straight(v, **pose(path, s))
    x[1:5] = [rng.normal(0, 0.2 * v), rng.normal(0, 0.6), *(x[3:5] * rng.choice([0, 0.3, 0.8, 1, 1.2, 2, 4], 2))]
    return x, mpc.reference(path.ahead(s, mpc.horizon, 0.1), T_r=0.0)


def test_wheels_far_past_the_peak_of_their_tires_are_planned_for():
    """Locked and spinning wheels, where one implicit step has no stages that Newton's method finds."""
    mpc = car()
    kinds = []
    for seed in range(40):
        x, reference = past_the_peak(mpc, seed)
        plan = mpc.plan(x, reference)
        following = mpc.plan(plan.x[1], reference, plan)
        for p in (plan, following):
            assert np.isfinite(p.u).all()
            assert np.isfinite(p.x).all()
        if plan.status.solved:
            # one of the two may have taken one step and the other many short ones
            assert plan.x[1] == pytest.approx(mpc.model.step(x, [*plan.command, 0.0]), rel=0.05, abs=0.05)
        kinds.append(plan.status)
    assert kinds.count(Status.SOLVED) >= 38
