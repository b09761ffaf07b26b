"""Stages of several steps in the real-time solver: Ipopt's answer on any model, with and without a compiler."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from slipangle.models.vehicles.quasi_steady import QuasiSteadySingleTrack
from slipangle.optimal.engine import Start
from slipangle.optimal.realtime import RealTime, program
from slipangle.optimal.realtime.interpreted import InterpretedEngine
from slipangle.optimal.realtime.program import source
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths.lane_change import double_lane_change
from tests.models.all_models import ALL_MODELS
from tests.optimal.realtime.test_realtime import CONVERGED, GAIN, agree, car, compare, pose, problem, situation

pytestmark = pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
PATH = double_lane_change(20.0, blend=12.0)
STEPS = (1, 1, 2, 1, 3, 4)
KINKED = "steered, rate limit, delayed"
QUICK = ["bicycle on the ground", "ARX, two inputs, delay, constant", "NARX"]


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n != "NARX")) for n in QUICK])
def test_any_model_gives_ipopts_answer(name):
    assert compare(ALL_MODELS[name], range(4), steps=STEPS) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in ALL_MODELS if n not in [*QUICK, KINKED]])
def test_every_other_model_too(name):
    assert compare(ALL_MODELS[name], range(6), steps=STEPS) >= 4


@pytest.mark.slow
def test_about_the_kinks_of_a_rate_limit_ipopt_finds_nothing_better():
    """From our plans, as from its own start, it comes to its iteration limit there."""
    mpc = replace(problem(ALL_MODELS[KINKED], np.random.default_rng(0), 6), steps=STEPS)
    ours, solved = replace(mpc, solver=CONVERGED), 0
    for seed in range(6):
        x, reference, before = situation(mpc, seed)
        plan = ours.plan(x, reference, applied=before)
        if plan.status is Status.SOLVED:
            start = Start(x=x, applied=before, reference=reference, guess_u=plan.u, guess_x=plan.x)
            assert plan.cost <= mpc.engine.solve(start).cost * (1 + 1e-9), seed
            solved += 1
    assert solved >= 4


def test_code_of_casadi_gives_the_same(monkeypatch):
    """Models too long for straight-line code are called step by step."""
    mpc = replace(problem(ALL_MODELS["bicycle"], np.random.default_rng(0), 6), steps=STEPS, solver=CONVERGED)
    straight = [mpc.plan(*situation(mpc, seed)[:2]) for seed in range(3)]
    monkeypatch.setattr(program, "MOST_INSTRUCTIONS", 0)
    monkeypatch.setattr(program, "repeated_steps", lambda ocp: None)
    called = replace(mpc)
    assert "#define DYNAMICS CALLED" in source(called.ocp)
    for seed, expected in enumerate(straight):
        assert called.plan(*situation(mpc, seed)[:2]).u == pytest.approx(expected.u, rel=1e-7, abs=1e-9)


def wheels(**options):
    """Stiff wheels with soft limits on slip angles, yaw rate and the lane, and rates."""
    base = car(horizon=6, solver=CONVERGED, steps=(1, 1, 1, 2, 2, 3))
    soft = ("alpha_f", "alpha_r", "r", "e_y")
    return replace(
        base,
        model=replace(base.model, outputs=("alpha_f", "alpha_r")),
        limits=Limits(**base.ocp.limits, alpha_f=0.02, alpha_r=0.02, r=0.15),
        rates=Limits(delta=0.5 / GAIN, T_f=8000.0),
        slack=Weights(**dict.fromkeys(soft, 1e5)),
        slack_linear=Weights(**dict.fromkeys(soft, 1e3)),
        corridor=1.8,
        **options,
    )


def quasi():
    """The car with quasi-steady wheels."""
    model = QuasiSteadySingleTrack(params=SOUSA_TABLE_6_1, dt=0.1, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2)
    return replace(car(horizon=6, solver=CONVERGED, steps=(1, 1, 1, 2, 2, 3)), model=model)


@pytest.mark.parametrize("make", [wheels, pytest.param(quasi, marks=pytest.mark.slow)])
def test_the_car_is_ipopts_too(make):
    mpc = make()
    ipopt, interpreted = replace(mpc, solver="ipopt"), InterpretedEngine(mpc.ocp, CONVERGED, None)
    compared = 0
    for s in (15.0, 40.0):
        x = mpc.model.straight(20.0, **pose(PATH, s))
        x[mpc.model.states.index("Y")] += 0.4
        before = np.array([0.005, 300.0])
        reference = mpc.reference(PATH.ahead(s, mpc.times), T_r=0.0)
        mine, theirs = mpc.plan(x, reference, applied=before), ipopt.plan(x, reference, applied=before)
        assert mine.status is Status.SOLVED
        other = interpreted.resume(x, before, reference, None)
        assert other.u == pytest.approx(mine.u, rel=1e-5, abs=1e-6)
        assert other.x == pytest.approx(mine.x, rel=1e-6, abs=1e-6)
        if theirs.cost < mine.cost * (1 - 1e-8):  # another optimum: from there we find it too
            start = Start(x=x, applied=before, reference=reference, guess_u=theirs.u, guess_x=theirs.x)
            mine = mpc.engine.solve(start)
        assert mine.cost == pytest.approx(theirs.cost, rel=1e-6)
        compared += bool(np.abs((mine.u - theirs.u) / [0.03, 2500.0]).max() <= 1e-5)
    assert compared == 2


def test_the_thesis_problem_agrees_with_ipopt():
    assert agree(range(6), horizon=6, steps=(1, 1, 1, 2, 2, 3))[0] >= 5


@pytest.mark.slow
def test_the_thesis_problem_agrees_with_ipopt_two_hundred_times():
    same, other = agree(range(200), steps=(1, 1, 1, 1, 2, 2, 2, 4, 4, 4))
    print(f"{same} the same to 1e-5, {other} two optima")
    assert same >= 185
    assert same + other >= 198


def drive(mpc, steps=40):
    """Plans of a closed loop on the model itself, and its lateral errors."""
    x, plan, s, plans, errors = mpc.model.straight(19.0, X=PATH.start[0]), None, 0.0, [], []
    for _ in range(steps):
        s, e_y, _ = PATH.project(x[5], x[6], s)
        plan = mpc.plan(x, mpc.reference(PATH.ahead(s, mpc.times), T_r=0.0), plan)
        plans.append(plan)
        errors.append(e_y)
        x = np.asarray(mpc.model.functions[0](x, [*plan.command, 0.0])).ravel()
    return plans, float(np.sqrt(np.mean(np.square(errors))))


@pytest.mark.parametrize(
    ("steps", "uniform"),
    [
        ((1, 1, 1, 2, 2, 3), 10),
        pytest.param((1, 1, 1, 1, 2, 2, 2, 4, 4, 4), 22, marks=pytest.mark.slow),
    ],
)
def test_one_step_per_plan_tracks_as_converged_plans_and_as_a_long_uniform_horizon(steps, uniform):
    mpc = car(horizon=len(steps), steps=steps)
    (fast, one), (_, converged), (_, alike) = (
        drive(m, 60) for m in (mpc, replace(mpc, solver=CONVERGED), car(horizon=uniform))
    )
    assert {p.status for p in fast[1:]} == {Status.REAL_TIME}
    assert all(p.residual <= 1e-2 for p in fast[1:])
    assert one <= 1.1 * converged
    assert one <= 1.1 * alike


@pytest.mark.slow
@pytest.mark.parametrize("limited", [False, True])
def test_without_a_compiler_the_drive_is_the_same(monkeypatch, limited):
    """With limits on inputs only, and with rates too: two ways through the code without a compiler."""
    mpc = car(horizon=5, steps=(1, 1, 2, 2, 3), rates=Limits(**({"delta": 1.0 / GAIN} if limited else {})))
    fast, _ = drive(mpc, 25)
    other = replace(mpc)
    monkeypatch.setitem(other.__dict__, "_engine", InterpretedEngine(other.ocp, RealTime(), None))
    slow, _ = drive(other, 25)
    for a, b in zip(slow, fast, strict=True):
        assert a.status is b.status
        assert a.command / [0.03, 2500] == pytest.approx(b.command / [0.03, 2500], abs=2e-3)


def test_prepared_plans_are_the_same_when_the_state_is_as_expected():
    mpc = car(horizon=6, steps=(1, 1, 1, 2, 2, 3))
    plans, _ = drive(mpc, 6)
    for previous in plans[1:]:
        x = previous.x[1]
        reference = mpc.reference(PATH.ahead(PATH.project(x[5], x[6]).s, mpc.times), T_r=0.0)
        whole = mpc.plan(x, reference, previous)
        mpc.prepare(reference, previous)
        assert mpc.plan(x, reference, previous).u == pytest.approx(whole.u, rel=1e-9, abs=1e-12)


def test_equal_steps_compile_to_what_no_steps_do():
    assert source(car(horizon=3, steps=(1, 1, 1)).ocp) == source(car(horizon=3).ocp)
    assert "NODES[]" not in source(car(horizon=3).ocp)
