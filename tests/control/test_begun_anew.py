"""A solve that leads nowhere begins anew, in the same call; none fails for ever because the plan before did."""

import copy
from dataclasses import replace

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen.compiler import compiler, sentence
from slipangle.export.drives import Recorder
from slipangle.export.kinds import project_of
from slipangle.optimal.engine import Engine
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime import RealTime, backend
from slipangle.optimal.solution import ANEW, Solution, Status
from tests.export.loaded import STATUSES
from tests.export.test_joined import LoadedJoined
from tests.export.test_mpc import Loaded

SOLVERS = ["condensed", "riccati", "interpreted"]
FAR = np.array([1.2, 0.0])  # from here no input of constant size keeps the ball from running away within the horizon
PARTS = {
    "one part": {},
    "scenarios": {"scenarios": sa.Scenarios({"gain": (0.9, 1.0, 1.1)})},
    "a free duration": {"duration": (1.0, 2.5), "terminal": sa.Weights(a=1.0, duration=0.1)},
    "long stages": {"horizon": 10, "steps": (1, 1, 1, 1, 2, 2, 3, 3, 3, 3)},
    "stages of an implicit integrator": {"method": "radau"},
}


def ball(solver="realtime", *, method="rk4", **settings):
    """On a hill that grows ever steeper: what is not caught in time is beyond all numbers soon."""
    model = sa.Ode(
        f=lambda x, u, p: [x[1], 8.0 * x[0] ** 3 + p.gain * u[0]],
        states=("a", "b"),
        inputs=("F",),
        params={"gain": 1.0},
        dt=0.1,
        method=method,
    )
    usual = {"horizon": 20, "Q": {"a": 1.0, "b": 0.1}, "R": {"F": 0.01}, "limits": {"F": 20.0}}
    return sa.MPC(model, controls=("F",), solver=solver, **(usual | settings))


@pytest.fixture(params=SOLVERS)
def solver(request, monkeypatch):
    if request.param == "interpreted":
        monkeypatch.setenv("SLIPANGLE_CC", "none")
        monkeypatch.setattr(backend, "_say_once", lambda words: None)
        return RealTime()
    if compiler() is None:
        pytest.skip(sentence())
    return RealTime(qp=request.param)


@pytest.mark.parametrize("parts", PARTS)
def test_a_first_plan_is_found_though_held_inputs_lead_beyond_all_numbers(solver, parts):
    mpc, judge = ball(replace(solver, iterations=0), **PARTS[parts]), ball(Ipopt(tolerance=1e-12), **PARTS[parts])
    wanted = mpc.setpoint(a=0.0, b=0.0)
    plan, theirs = mpc.plan(FAR, wanted), judge.plan(FAR, wanted)
    assert plan.status is Status.SOLVED
    assert plan.cost == pytest.approx(theirs.cost, rel=1e-8)
    assert plan.u == pytest.approx(theirs.u, abs=1e-6)
    assert (plan.detail == ANEW) is not mpc.ocp.composed  # those with parts were given better states
    assert (ANEW in plan.message) is not mpc.ocp.composed


def test_thrown_far_off_and_back_it_plans_at_once(solver):
    """Where no plan is, a fallback; a step later, from a state that has one, that plan, as good as from nothing."""
    mpc = ball(solver)
    wanted, plan, anew = mpc.setpoint(a=0.0, b=0.0), None, 0
    fresh = mpc.plan(FAR, wanted)
    for k, x in enumerate([FAR, FAR, [3.0, 3.0], FAR, [np.nan, 0.0], FAR, [3.0, -1.0], [3.0, 3.0], FAR, FAR]):
        x = np.asarray(x, dtype=float)
        plan = mpc.plan(x, wanted, plan)
        anew += plan.detail == ANEW
        assert plan.status.solved is bool(x[0] == FAR[0]), k
        assert plan.health.begun_anew == anew
        assert np.isfinite(plan.u).all()
        assert np.isfinite(plan.x).all()
        if plan.status.solved:
            assert plan.cost <= 1.02 * fresh.cost
            assert plan.age == plan.health.fallbacks_in_a_row == 0
    assert plan.health.fallbacks == 4
    assert anew > 0


@pytest.mark.parametrize("spoilt", ["u", "x", "memory"])
def test_a_plan_that_is_no_number_is_not_gone_on_from(solver, spoilt):
    mpc = ball(solver)
    wanted = mpc.setpoint(a=0.0, b=0.0)
    plan = copy.deepcopy(mpc.plan(FAR, wanted))  # no solver holds its numbers any more
    if spoilt == "memory":
        for name in ("found",) if hasattr(plan.memory, "found") else ("x", "k"):
            getattr(plan.memory, name)[:] = np.nan
    else:
        plan = replace(plan, **{spoilt: np.full_like(getattr(plan, spoilt), np.nan)}, memory=None)
    later = mpc.plan(FAR, wanted, plan)
    assert later.status.solved
    assert later.cost == pytest.approx(mpc.plan(FAR, wanted).cost, rel=1e-6)


def test_prepared_for_a_state_that_it_is_not_in_it_begins_anew(solver):
    mpc = ball(solver)
    wanted = mpc.setpoint(a=0.0, b=0.0)
    plan = mpc.plan(np.zeros(2), wanted)
    mpc.prepare(wanted, plan)
    assert mpc.plan(FAR, wanted, plan).status.solved


def test_every_other_fallback_is_left_alone():
    """Where solves end infeasible or stalled, not NaN: a solver that only finds its way from inputs held."""
    starts = []

    class Picky(Engine):
        def build(self, ocp, deadline):
            return self

        def solve(self, start):
            starts.append(float(np.abs(start.guess_u - start.applied).max()))
            found = starts[-1] == 0.0 and start.x[0] == FAR[0]
            status = Status.SOLVED if found else Status.INFEASIBLE
            u = start.guess_u + np.linspace(0.0, 1.0, len(start.guess_u))[:, None]
            return Solution(u=u, x=start.guess_x, status=status, cost=0.0, iterations=1, violation=0.0)

    mpc = ball(Picky())
    wanted = mpc.setpoint(a=0.0, b=0.0)
    plan = mpc.plan(FAR, wanted)
    ages = []
    for x in ([0.1, 0.0], FAR, FAR, FAR):
        plan = mpc.plan(np.asarray(x), wanted, plan)
        ages.append(plan.age)
    assert ages == [1, 2, 0, 1]
    assert starts[0] == starts[3] == 0.0
    assert min(starts[1], starts[2], starts[4]) > 0.0


@pytest.mark.skipif(compiler() is None, reason=sentence())
@pytest.mark.parametrize("parts", ["one part", "scenarios"])
def test_the_exported_one_does_the_same(parts, tmp_path, monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0 -march=native")
    mpc, rng = ball(**PARTS[parts]), np.random.default_rng(1)
    LoadedJoined.folder = tmp_path
    kind = Loaded if parts == "one part" else LoadedJoined
    wanted, plan, seen = mpc.setpoint(a=0.0, b=0.0), None, set()
    exported = kind(project_of(mpc, "car", steps_of(mpc, wanted)).everything)
    for k in range(60):
        x = FAR + rng.normal(size=2) * (1.5 if k % 4 == 2 else 0.02)
        if k % 9 == 5:
            x[0] = np.nan
        plan = mpc.plan(x, wanted, plan)
        out = exported.plan(x, wanted, None)
        assert STATUSES[out.status] is plan.status, (k, plan.message)
        assert (out.age, bool(out.stopping)) == (plan.age, plan.stopping)
        assert bool(out.begun_anew) is (plan.detail == ANEW), k
        assert out.health.begun_anew == plan.health.begun_anew
        assert np.array(out.u) == pytest.approx(plan.u, abs=1e-8), k
        seen.add((plan.status.name, plan.age > 1, plan.detail == ANEW))
    assert {("NOT_FINITE", False, False), ("SOLVED", False, True)} <= seen
    assert len(seen) > 4


def steps_of(mpc, wanted):
    """A drive of three steps."""
    recorder, plan = Recorder(mpc), None
    for _ in range(3):
        plan = recorder.plan(FAR, wanted, plan)
    return recorder.drive
