"""`plan` whatever it is given: shapes raise, values get a status, fallbacks say where they lead, counters tell."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from slipangle.control.mpc import MPC
from slipangle.errors import ParameterError
from slipangle.optimal.engine import Engine
from slipangle.optimal.ocp import Reference
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.interpreted import InterpretedEngine
from slipangle.optimal.solution import Health, Status
from slipangle.optimal.terms import Limits, Values, Weights
from tests.control.test_copies import PATH, interpreted, posed


def moment(mpc, s=20.0):
    """State and reference on a path."""
    reference = mpc.reference(PATH.ahead(s, mpc.times))
    X, Y, psi = reference.tracked[0, :3]
    return np.array([0.0, 0.0, X, Y + 0.3, psi]), reference


@pytest.fixture(scope="module", params=["realtime", "interpreted", "ipopt"])
def mpc(request):
    if request.param == "interpreted":
        return interpreted(posed(rates=Limits(delta=1.0)))
    return posed(solver=RealTime() if request.param == "realtime" else "ipopt", rates=Limits(delta=1.0))


WRONG = {
    "reference None": lambda x, r: (x, None),
    "reference array": lambda x, r: (x, r.tracked),
    "tracked missing": lambda x, r: (x, Reference(tracked=None, exogenous=r.exogenous)),
    "tracked text": lambda x, r: (x, replace(r, tracked="straight on")),
    "tracked ragged": lambda x, r: (x, replace(r, tracked=[[1.0], [2.0, 3.0]])),
    "exogenous long": lambda x, r: (x, replace(r, exogenous=np.zeros(20))),
    "exogenous complex": lambda x, r: (x, replace(r, exogenous=r.exogenous + 0j)),
    "x column": lambda x, r: (x[:, None], r),
    "x short": lambda x, r: (x[:-1], r),
    "x None": lambda x, r: (None, r),
    "x text": lambda x, r: (["a"] * len(x), r),
    "previous": lambda x, r: (x, r, {"u": 1.0}),
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_wrong_shapes_and_types_raise_a_sentence(mpc, wrong):
    with pytest.raises(ParameterError, match="expected") as caught:
        mpc.plan(*wrong(*moment(mpc)))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("applied", [np.zeros(2), "left", np.zeros((1, 1)), [None, 1.0]])
def test_a_wrong_applied_input_raises_a_sentence(mpc, applied):
    with pytest.raises(ParameterError, match="applied"):
        mpc.plan(*moment(mpc), applied=applied)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e13])
def test_an_applied_input_that_cannot_be_is_said_and_does_without(mpc, wrong):
    x, reference = moment(mpc)
    first = mpc.plan(x, reference)
    for previous in (None, first):
        plan, usual = (mpc.plan(x, reference, previous, applied=applied) for applied in (np.array([wrong]), None))
        assert plan.status.solved
        assert plan.u == pytest.approx(usual.u, abs=1e-9)
        assert plan.detail.startswith(f"applied is {wrong:g} for '{mpc.controls[0]}', which no input can be; ")
        assert plan.detail in plan.message
        assert usual.detail == ""
    lost = mpc.plan(np.full_like(x, np.nan), reference, first, applied=np.array([wrong]))
    assert lost.age == 1
    assert f"applied is {wrong:g}" in lost.message


@pytest.mark.parametrize("degrees", [20.0, -20.0])
def test_an_applied_input_far_beyond_its_limits_is_said_and_counts_as_one_at_them(mpc, degrees):
    """A steering angle of degrees where radians are meant; one that is off by what a measurement is says nothing."""
    (x, reference), name = moment(mpc), mpc.controls[0]
    low, high = mpc.ocp.input_bounds[0]
    limit = high if degrees > 0 else low
    first = mpc.plan(x, reference)
    for previous in (None, first, mpc.plan(x, reference, first)):
        plan, usual = (mpc.plan(x, reference, previous, applied=np.array([a])) for a in (degrees, limit))
        assert plan.status is usual.status
        assert plan.u == pytest.approx(usual.u, abs=1e-12)
        assert plan.detail.startswith(
            f"applied is {degrees:g} for '{name}', beyond its limits of {low:g} and {high:g}, "
        )
        assert usual.detail == ""
        near = mpc.plan(x, reference, previous, applied=np.array([limit + 0.004 * np.sign(limit) * (high - low)]))
        assert near.detail == ""


@pytest.mark.parametrize("applied", [0.1, [0.1], np.array(0.1), np.array([0.1], dtype=np.float32)])
def test_numbers_lists_and_other_precisions_will_do(mpc, applied):
    x, reference = moment(mpc)
    lists = replace(reference, tracked=reference.tracked.tolist(), exogenous=reference.exogenous.tolist())
    plan = mpc.plan(x.tolist(), lists, applied=applied)
    assert plan.u == pytest.approx(mpc.plan(x, reference, applied=np.array([0.1])).u, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "value", "status"),
    [
        ("X", 1e100, Status.IMPLAUSIBLE),
        ("v_y", 1e5, Status.IMPLAUSIBLE),
        ("r", -300.0, Status.IMPLAUSIBLE),
        ("psi", 1e200, Status.NOT_FINITE),
        ("psi", np.nan, Status.NOT_FINITE),
        ("Y", -np.inf, Status.NOT_FINITE),
    ],
)
def test_a_state_that_cannot_be_is_no_answer_and_leaves_no_trace(mpc, name, value, status):
    x, reference = moment(mpc)
    good = mpc.plan(x, reference)
    wrong = np.where(np.array(mpc.model.states) == name, value, x)
    plan = mpc.plan(wrong, reference, good)
    assert plan.status is status
    assert (name in plan.message) is (status is Status.IMPLAUSIBLE)
    assert plan.command == pytest.approx(good.u[1])
    assert np.isfinite(plan.x).all()
    after = mpc.plan(x, reference, plan)
    assert after.status.solved
    column = reference.tracked.copy()
    column[3, 1] = value if name != "r" else 1e8
    assert mpc.plan(x, replace(reference, tracked=column), good).status in (Status.IMPLAUSIBLE, Status.NOT_FINITE) or (
        name == "v_y"  # 1e5 m is far, but a place
    )


def test_ranges_can_be_said():
    mpc = posed(plausible=Limits(X=50.0, v_x=(1.0, 20.0)))
    x, reference = moment(mpc)
    assert mpc.plan(x, reference).status.solved
    assert mpc.plan(x + np.array([0, 0, 100.0, 0, 0]), reference).status is Status.IMPLAUSIBLE
    stopped = replace(reference, exogenous=np.zeros((8, 1)))
    assert "v_x is 0, outside 1 to 20" in mpc.plan(x, stopped).message
    with pytest.raises(ParameterError, match="plausible"):
        posed(plausible=Limits(Z=1.0))


BROKEN = {
    "u nan": lambda p: replace(p, u=p.u * np.nan),
    "x nan": lambda p: replace(p, x=p.x * np.nan),
    "u inf": lambda p: replace(p, u=p.u + np.inf),
    "u shape": lambda p: replace(p, u=p.u[:3]),
    "u none": lambda p: replace(p, u=None),
    "x none": lambda p: replace(p, x=None),
    "u one number": lambda p: replace(p, u=np.float64(1.0)),
    "other controls": lambda p: replace(p, controls=("throttle",)),
    "age": lambda p: replace(p, age=-7),
    "age text": lambda p: replace(p, age="old"),
    "memory": lambda p: replace(p, memory=object()),
    "times": lambda p: replace(p, times=np.zeros(3)),
    "health": lambda p: replace(p, health=None),
}


@pytest.mark.parametrize("broken", BROKEN.values(), ids=BROKEN)
def test_a_broken_plan_before_costs_at_most_the_warm_start(mpc, broken):
    x, reference = moment(mpc)
    good = mpc.plan(x, reference)
    previous = broken(good)
    plan = mpc.plan(x, reference, previous)
    assert plan.status.solved
    assert np.isfinite(plan.u).all()
    assert np.isfinite(plan.x).all()
    assert plan.health.fallbacks == 0
    lost = mpc.plan(x * np.nan, reference, previous)
    assert lost.status is Status.NOT_FINITE
    assert np.isfinite(lost.u).all()
    assert np.isfinite(lost.x).all()
    assert mpc.plan(x, reference, lost).status.solved
    mpc.prepare(reference, previous)


def test_memory_with_nan_is_not_taken():
    for mpc in (posed(), interpreted(posed())):
        x, reference = moment(mpc)
        good = copy.deepcopy(mpc.plan(x, reference))  # no solver holds its numbers any more
        for name in ("found",) if hasattr(good.memory, "found") else ("x", "k"):
            getattr(good.memory, name)[:] = np.nan
        plan = mpc.plan(x, reference, good)
        assert plan.status.solved
        assert plan.u == pytest.approx(mpc.plan(x, reference, replace(good, memory=None)).u)


@pytest.mark.parametrize("steps", [None, (1, 1, 2, 2, 3, 3, 4, 4)], ids=["equal", "growing"])
@pytest.mark.parametrize("stopping", [False, True], ids=["shifted", "stop law"])
@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "interpreted"])
def test_a_fallback_says_where_it_leads(steps, stopping, compiled):
    mpc = posed(deadline=1e-12, steps=steps, safe=Values(delta=0.1), fallback=0 if stopping else 5)
    if not compiled:
        vars(mpc)["_engine"] = InterpretedEngine(mpc.ocp, RealTime(), 1e-12)
    x, reference = moment(mpc)
    good = replace(mpc, deadline=None).plan(x, reference)
    late = replace(mpc, deadline=None)
    if not compiled:
        interpreted(late)
    x = x + np.array([0.1, 0.05, 0.0, 0.1, 0.02])
    wanted = late._fallback(late_call(late, x, reference, good), Status.TIME_OUT)  # the same fallback without a clock
    assert wanted.stopping is stopping
    states = [x]
    for u, w, n in zip(wanted.u, reference.exogenous[:-1], mpc.ocp.lengths, strict=True):
        now = states[-1]
        for _ in range(n):
            now = np.asarray(mpc.ocp.dynamics(now, u, w)).ravel()
        states.append(now)
    assert wanted.x == pytest.approx(np.array(states), abs=1e-5 if compiled else 2e-3)
    plan = mpc.plan(x, reference, good)
    assert plan.status is Status.TIME_OUT
    assert plan.u == pytest.approx(wanted.u)


def late_call(mpc, x, reference, previous):
    from time import perf_counter

    from slipangle.control.fallback import Call

    return Call(x=x, wanted=reference, previous=previous, before=mpc._before(previous, None), begin=perf_counter())


def test_counters_tell_what_happened():
    mpc = posed()
    x, reference = moment(mpc)
    plan = mpc.plan(x, reference)
    assert plan.health == Health(plans=1)
    for k in range(1, 4):
        plan = mpc.plan(x * np.nan, reference, plan)
        assert plan.health == Health(plans=1 + k, fallbacks=k, fallbacks_in_a_row=k)
    plan = mpc.plan(x, reference, plan)
    assert plan.health == Health(plans=5, fallbacks=3)
    hasty = replace(mpc, deadline=1e-9)
    for k in range(1, 3):
        plan = hasty.plan(x, reference, plan)
        assert plan.status is Status.TIME_OUT
        assert plan.health == Health(5 + k, 3 + k, k, k, k)
    plan = mpc.plan(x, reference, plan)
    assert plan.health == Health(plans=8, fallbacks=5, overruns=2)


def test_an_engine_that_stops_with_any_error_is_survived():
    class Stops(Engine):
        def build(self, ocp, deadline):
            return self

        def solve(self, start):
            raise ZeroDivisionError

    model = posed().model
    mpc = MPC(model, horizon=4, Q=Weights(e_y=1.0), limits=Limits(delta=0.3), solver=Stops())
    x, reference = moment(mpc)
    plan = mpc.plan(x, reference)
    assert plan.status is Status.FAILED
    assert "ZeroDivisionError" in plan.message


@pytest.mark.parametrize("value", [1e13, -1e30, 1e100, 7.5, -1.0, 3.0])
def test_memory_that_was_written_over_is_survived(value):
    """Working rows travel as numbers: one that is no row's must not be taken for one."""
    mpc = posed(corridor=1.0, slack=Weights(e_y=1.0), slack_linear=Weights(e_y=10.0), rates=Limits(delta=1.0))
    x, reference = moment(mpc)
    good = mpc.plan(x, reference)
    found = getattr(good.memory, "found", None)
    if found is None:
        pytest.skip("no compiler")
    size = good.u.size + good.x.size
    for first in range(size, len(found) - 3, 7):
        spoiled = found.copy()
        spoiled[first : first + 7] = value
        plan = mpc.plan(x, reference, replace(good, memory=replace(good.memory, found=spoiled, area=-1)))
        assert np.isfinite(plan.u).all()
        assert np.abs(plan.u).max() <= 0.3
        assert mpc.plan(x, reference, good).status.solved
