"""Without a compiler the same controller runs, gives the same answers and says so once."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.errors import ModelWarning
from slipangle.optimal.realtime import RealTime, backend
from slipangle.optimal.solution import Status
from tests.models.all_models import ALL_MODELS
from tests.optimal.realtime.test_realtime import (
    CONVERGED,
    car,
    drive,
    past_the_peak,
    problem,
    require_plans_of_their_arguments_alone,
    situation,
)


@pytest.fixture
def no_compiler(monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    backend._say_once.cache_clear()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        yield


def test_it_says_so_once(monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    backend._say_once.cache_clear()
    with pytest.warns(ModelWarning, match="no C compiler"):
        car(horizon=2).prepare()
    car(horizon=3).prepare()  # a second warning would be an error


@pytest.mark.parametrize("name", ["bicycle", "state space", "NARX", "bicycle on the ground"])
def test_same_answer_as_ipopt(no_compiler, name):
    mpc = problem(ALL_MODELS[name], np.random.default_rng(0), 6)
    ours = replace(mpc, solver=CONVERGED)
    for seed in range(3):
        x, reference, before = situation(mpc, seed)
        mine, theirs = ours.plan(x, reference, applied=before), mpc.plan(x, reference, applied=before)
        assert mine.status is Status.SOLVED
        assert mine.cost == pytest.approx(theirs.cost, rel=1e-6)
        assert mine.command == pytest.approx(theirs.command, abs=3e-5 * mpc.ocp.input_bounds[:, 1].max())


@pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
def test_same_drive_as_compiled(monkeypatch, no_compiler):
    slow = [plan for *_, plan in drive(car(solver=RealTime()), steps=40)]
    monkeypatch.delenv("SLIPANGLE_CC")
    fast = [plan for *_, plan in drive(car(solver=RealTime()), steps=40)]
    for a, b in zip(slow, fast, strict=True):
        assert a.status is b.status
        assert a.command / [0.03, 2500] == pytest.approx(b.command / [0.03, 2500], abs=2e-3)


def test_bad_states_fall_back(no_compiler):
    mpc = car(horizon=5)
    *_, (x, reference, previous, _) = drive(mpc, steps=4)
    plan = mpc.plan(x * np.nan, reference, previous)
    assert plan.age == 1
    assert np.isfinite(plan.u).all()
    assert mpc.plan(x, reference, plan).age == 0


def test_wheels_far_past_the_peak_of_their_tires_are_planned_for(no_compiler):
    """Where Newton's method finds no stages, the model's own steps take over."""
    mpc = car(5)
    solved = 0
    for seed in range(5):
        x, reference = past_the_peak(mpc, seed)
        plan = mpc.plan(x, reference)
        assert np.isfinite(plan.u).all()
        assert np.isfinite(plan.x).all()
        if plan.status is Status.SOLVED:
            solved += 1
            assert plan.x[1] == pytest.approx(mpc.model.step(x, [*plan.command, 0.0]), rel=0.05, abs=0.05)
    assert solved >= 4


def test_a_plan_does_not_depend_on_what_the_work_area_remembers(no_compiler):
    require_plans_of_their_arguments_alone(car(solver=RealTime()), steps=12, every=3)


def test_a_state_off_the_predicted_one_is_planned_for(no_compiler):
    """Derivatives at the predicted state serve a measured one near it; the plan says how good it is all the same."""
    mpc = car(solver=RealTime())
    best = replace(mpc, solver=CONVERGED)
    rng = np.random.default_rng(1)
    *_, (x, reference, previous, _) = drive(mpc, steps=8)
    for size in (1e-3, 5e-3, 1e-2, 5e-2):
        off = x + size * rng.normal(size=len(x))
        plan, there = mpc.plan(off, reference, previous), best.plan(off, reference, previous)
        ends = [mpc.model.step(a, [*u, 0.0]) for a, u in zip(plan.x, plan.u, strict=False)]
        assert plan.violation == pytest.approx(np.abs(np.array(ends) - plan.x[1:]).max(), rel=0.3, abs=1e-6)
        assert plan.x[0] == pytest.approx(off, abs=0)
        assert np.abs((plan.u[0] - there.u[0]) / [0.03, 2500]).max() <= 10 * plan.residual + 1e-6
