"""The usual call, judged in compiled code: the answer of the close look to the last bit, or none."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.mpc import MPC
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.solution import Plan, Status
from slipangle.optimal.terms import Limits, Values, Weights
from tests.control.marx.test_mpc import BOTH, situation
from tests.control.test_copies import PATH, posed

pytestmark = pytest.mark.skipif(compiler() is None, reason=sentence())


def nothing(*given):
    return None


def closely(mpc):
    """The same controller, for which no call is usual."""
    made = replace(mpc)
    vars(made.engine if isinstance(made, MPC) else made.solver)["again"] = nothing
    return made


def count(mpc, name="_again"):
    """What the short way returned, call by call."""
    seen, short = [], getattr(mpc, name)

    def noted(*args):
        seen.append(short(*args))
        return seen[-1]

    vars(mpc)[name] = noted
    return seen


def drive(mpc, steps=12):
    """States, references and plans along the path, the first reference a turn away."""
    x, plan, found = np.array([0.0, 0.0, *PATH_START]), None, []
    for k in range(steps):
        reference = mpc.reference(PATH.ahead(20.0 + 0.75 * k, mpc.times))
        plan = mpc.plan(x, reference, plan)
        found.append((x, reference, plan))
        x = plan.x[1] + 1e-3 * np.sin(np.arange(len(x)) + k)
    return found


PATH_START = [float(PATH.at(20.0).X[0]), float(PATH.at(20.0).Y[0]) + 0.3, float(PATH.at(20.0).psi[0])]


@pytest.fixture(scope="module")
def fast():
    return posed(solver=RealTime(), rates=Limits(delta=1.0))


def test_a_drive_is_the_same_to_the_last_bit_as_with_a_close_look(fast):
    mpc = replace(fast)
    seen = count(mpc)
    plans, others = drive(mpc), drive(closely(fast))
    assert sum(p is not None for p in seen) == len(plans) - 1
    for (*_, a), (*_, b) in zip(plans, others, strict=True):
        assert np.array_equal(a.u, b.u)
        assert np.array_equal(a.x, b.x)
        assert (a.status, a.health, a.iterations, a.cost, a.controls) == (
            b.status,
            b.health,
            b.iterations,
            b.cost,
            b.controls,
        )
        assert set(vars(a)) == set(vars(b))


def spoilt(array, at, value):
    out = np.array(array)
    out[at] = value
    return out


ODD = {
    "state nan": (lambda x, r: (spoilt(x, 0, np.nan), r), Status.NOT_FINITE),
    "state inf": (lambda x, r: (spoilt(x, 2, -np.inf), r), Status.NOT_FINITE),
    "state far": (lambda x, r: (spoilt(x, 0, 1e5), r), Status.IMPLAUSIBLE),
    "reference nan": (lambda x, r: (x, replace(r, tracked=spoilt(r.tracked, (-1, 1), np.nan))), Status.NOT_FINITE),
    "reference far": (lambda x, r: (x, replace(r, tracked=spoilt(r.tracked, (-1, 0), 1e9))), Status.IMPLAUSIBLE),
    "speed nan": (lambda x, r: (x, replace(r, exogenous=spoilt(r.exogenous, -1, np.nan))), Status.NOT_FINITE),
    "speed far": (lambda x, r: (x, replace(r, exogenous=spoilt(r.exogenous, -1, 1e4))), Status.IMPLAUSIBLE),
}


@pytest.mark.parametrize(("wrong", "status"), ODD.values(), ids=ODD)
def test_what_cannot_be_gets_its_sentence_and_leaves_no_trace(fast, wrong, status):
    mpc, twin = replace(fast), closely(fast)
    x, reference, plan = drive(mpc, 3)[-1]
    *_, other = drive(twin, 3)[-1]
    seen = count(mpc)
    given = wrong(x, reference)
    bad, close = mpc.plan(*given, plan), twin.plan(*given, other)
    assert seen == [None]
    assert bad.status is status
    assert bad.message == close.message
    assert np.array_equal(bad.u, close.u)
    assert bad.health == plan.health.after(True, False)
    again = mpc.plan(x, reference, plan)
    assert again.status.solved
    assert np.array_equal(again.u, undisturbed(fast, 3, x, reference))


def undisturbed(mpc, steps, x, reference):
    """Inputs after the same drive, without what came between."""
    mpc = replace(mpc)
    *_, plan = drive(mpc, steps)[-1]
    return mpc.plan(x, reference, plan).u


def test_another_turn_inputs_and_spoilt_plans_get_a_close_look(fast):
    mpc, twin = replace(fast), closely(fast)
    x, reference, plan = drive(mpc, 3)[-1]
    *_, other = drive(twin, 3)[-1]
    turned = replace(reference, tracked=reference.tracked + np.array([0.0, 0.0, 4 * np.pi]))
    strange = [
        (turned, {}, None),
        (replace(reference, inputs=np.zeros((mpc.horizon, 1))), {}, None),
        (reference, {"u": plan.u.tolist()}, None),
        (reference, {"u": plan.u.copy()}, None),
        (reference, {"health": None}, None),
        (reference, {"controls": ["delta"]}, None),
        (reference, {}, np.array([np.nan])),
        (reference, {}, 0.1),
    ]
    seen = count(mpc)
    for given, changed, applied in strange:
        found = mpc.plan(x, given, replace(plan, **changed), applied=applied)
        close = twin.plan(x, given, replace(other, **changed), applied=applied)
        assert found.status.solved
        assert np.array_equal(found.u, close.u)
    assert all(p is None for p in seen)


@pytest.mark.parametrize("steps", [None, (1, 1, 2, 2, 3, 3, 4, 4)], ids=["equal", "growing"])
@pytest.mark.parametrize("fallback", [0, 2])
def test_a_fallback_in_one_piece_is_the_one_put_together(fast, steps, fallback):
    mpc, twin = (replace(fast, steps=steps, fallback=fallback, safe=Values(delta=0.1)) for _ in "12")
    vars(twin.engine).update(lost=nothing, rescue=nothing, follow=nothing)
    x, reference, plan = drive(mpc, 3)[-1]
    short = count(mpc, "_lost")
    one = other = plan
    for _ in range(fallback + 2):
        one, other = mpc.plan(x * np.nan, reference, one), twin.plan(x * np.nan, reference, other)
        assert one.u == pytest.approx(other.u, abs=1e-12)
        assert one.x == pytest.approx(other.x, abs=5e-3 if one.stopping else 1e-12, rel=0)
        assert (one.status, one.message, one.health) == (other.status, other.message, other.health)
        assert set(vars(one)) == set(vars(other))
    assert one.stopping
    assert all(isinstance(p, Plan) for p in short)
    assert mpc.plan(x, reference, plan).u == pytest.approx(undisturbed(replace(fast, steps=steps), 3, x, reference))


def test_edges_of_a_corridor_become_limits_as_elsewhere():
    mpc = posed(
        solver=RealTime(),
        rates=Limits(delta=1.0),
        corridor=1.0,
        slack=Weights(e_y=1.0),
        slack_linear=Weights(e_y=10.0),
    )
    seen, rng, x, reference, plan = count(mpc), np.random.default_rng(4), *drive(mpc, 3)[-1]
    odd = np.array([[3.0, np.inf], [-np.inf, 2.0], [0.2, 0.1], [np.inf, -np.inf], [-np.inf, -3.0], [0.6, 0.7]])
    for k in range(8):
        edges = rng.uniform(0.0, 3.0, (mpc.horizon + 1, 2)) if k else np.resize(odd, (mpc.horizon + 1, 2))
        given = replace(reference, corridor=edges)
        after = mpc.plan(x, given, plan)
        assert np.array_equal(mpc.engine._areas.mine._view["bounds"], mpc.ocp.state_bounds(given))
        plan = after if after.status.solved else plan
    assert any(isinstance(p, Plan) for p in seen)
    assert mpc.plan(x, replace(reference, corridor=spoilt(edges, (2, 0), np.nan)), plan).status is Status.NOT_FINITE


def test_an_unfinished_solve_goes_on_by_the_short_way(fast):
    mpc = replace(fast, solver=RealTime(max_iterations=1, accept=1e-300))
    twin = closely(mpc)
    x, reference, _ = drive(fast, 2)[-1]
    seen, a, b = count(mpc), None, None
    for _ in range(6):
        a, b = mpc.plan(x, reference, a), twin.plan(x, reference, b)
        assert (a.status, a.age, a.health) == (b.status, b.age, b.health)
        assert np.array_equal(a.u, b.u)
    assert any(isinstance(p, Plan) for p in seen)


@BOTH
def test_the_usual_plan_of_blended_models_is_that_of_a_close_look(mpc):
    short, long = replace(mpc), closely(mpc)
    seen, a, b = count(short), None, None
    for seed in range(20):
        x, reference, applied = situation(mpc, seed)
        given = applied if seed % 3 else None
        a, b = short.plan(x, reference, a, applied=given), long.plan(x, reference, b, applied=given)
        assert np.array_equal(a.u, b.u)
        assert np.array_equal(a.x, b.x)
        assert np.array_equal(a.weights, b.weights)
        assert (a.status, a.health, a.cost, a.outside, a.offset) == (b.status, b.health, b.cost, b.outside, b.offset)
    assert all(isinstance(p, Plan) for p in seen)


@BOTH
@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300, 1e13])
def test_blended_models_refuse_what_cannot_be(mpc, value):
    short, long = replace(mpc), closely(mpc)
    x, reference, _ = situation(mpc, 1)
    plan = short.plan(x, reference)
    cases = [(spoilt(x, i, value), reference) for i in range(len(x))]
    cases += [(x, replace(reference, tracked=spoilt(reference.tracked, (-1, i), value))) for i in range(3)]
    cases += [(x, replace(reference, exogenous=spoilt(reference.exogenous, -1, value)))]
    for given in cases:
        a, b = short.plan(*given, plan), long.plan(*given, plan)
        assert a.status in (Status.NOT_FINITE, Status.IMPLAUSIBLE)
        assert (a.status, a.message, a.health) == (b.status, b.message, b.health)
        assert np.array_equal(a.u, b.u)


@pytest.mark.parametrize("rows", [0, 1])
def test_a_plan_before_that_has_lost_rows_gets_a_close_look(rows):
    mpc = posed(solver=RealTime())
    x, reference, plan = drive(mpc, 3)[-1]
    after = mpc.plan(x, reference, replace(plan, u=plan.u[:rows]))
    assert np.isfinite(after.u).all()
    assert after.u.shape == plan.u.shape
