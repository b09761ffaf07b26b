"""Plans to convergence that Gauss-Newton steps do not end are ended by the exact Hessian, from where those came to."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.mpc import MPC
from slipangle.models.custom import Ode
from slipangle.ops import exp, sin
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime import RealTime, backend, curvature
from slipangle.optimal.realtime.last_steps import Tail, better, leaves
from slipangle.optimal.solution import CURVED, Status
from slipangle.optimal.terms import Limits, Weights

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler")
INF = float("inf")
AUTO, PURE = RealTime(iterations=0), RealTime(iterations=0, hessian="gauss-newton")
needs_compiler = pytest.mark.skipif(compiler() is None, reason=sentence())


def swinging(f: Any = lambda x, u, p: [x[1], u[0] - sin(x[0])], **settings: Any) -> MPC:
    """A pendulum at a price that is no square, so that Gauss-Newton steps see no curvature in it."""
    usual: dict[str, Any] = {
        "horizon": 12,
        "controls": ("a",),
        "Q": {},
        "terminal": Weights(rate=0.5),
        "limits": Limits(a=3.0, cost=(-INF, 0.0), rate=1.2),
        "terms": {"cost": lambda x, u, p: (x[0] - 1.0) ** 4 + exp(0.5 * x[1]) + exp(-0.5 * x[1]) + 0.1 * u[0] ** 2},
        "slack_linear": Weights(cost=1.0),
        "solver": AUTO,
    }
    model = Ode(f=f, states=("phi", "rate"), inputs=("a",), params={}, dt=0.1, substeps=1)
    return MPC(model, **(usual | settings))


def reaching(**settings: Any) -> MPC:
    """Errors that stay large and are no straight lines, over more inputs than steps are remembered."""
    usual: dict[str, Any] = {
        "horizon": 40,
        "Q": Weights(far=5.0),
        "R": Weights(a=0.1),
        "terminal": {},
        "terms": {"far": lambda x, u, p: 30.0 + sin(2.0 * x[0]) * x[1] + x[0] ** 2},
        "limits": Limits(a=8.0),
        "slack_linear": {},
    }
    return swinging(**(usual | settings))


@pytest.fixture(params=[pytest.param("", marks=needs_compiler), "none"])
def _engine(request: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param:
        monkeypatch.setenv("SLIPANGLE_CC", "none")
        monkeypatch.setattr(backend, "_say_once", lambda words: None)


@pytest.mark.usefixtures("_engine")
def test_what_gauss_newton_does_not_end_ends_where_ipopt_does():
    mpc, reference, rng = swinging(), swinging(solver=Ipopt(tolerance=1e-13)), np.random.default_rng(1)
    for _ in range(3):
        x = rng.uniform(-0.8, 0.8, 2)
        plan, other = mpc.plan(x, rate=0.0), reference.plan(x, rate=0.0)
        assert plan.status is Status.SOLVED, plan.message
        assert plan.u == pytest.approx(other.u, abs=1e-7)
        assert CURVED not in plan.message
        later = mpc.plan(x, rate=0.0, previous=plan, applied=plan.command)  # from what the last steps left
        assert later.status is Status.SOLVED
        assert replace(mpc, solver=PURE).plan(x, rate=0.0).status is not Status.SOLVED


@pytest.mark.usefixtures("_engine")
def test_steps_that_contract_slowly_hand_over_long_before_their_limit():
    x = np.array([1.2, -0.5])
    plan, pure = (reaching(solver=solver).plan(x) for solver in (AUTO, PURE))
    assert plan.status is Status.SOLVED
    assert pure.status is Status.ITERATION_LIMIT
    assert plan.cost <= pure.cost
    assert plan.cost == pytest.approx(pure.cost, rel=1e-6)
    assert plan.iterations < 150
    assert plan.residual <= 1e-9


@needs_compiler
def test_the_last_steps_stay_at_the_optimum_that_gauss_newton_came_to():
    """From the same start the exact Hessian's own steps lead to one that is dearer by a sixth.

    It hands over after 108 to 128 of 300 steps, as the compiler rounds: from a start that took it all but 300 it went
    to the dearer one on one processor.
    """
    settings = {"horizon": 70, "terms": {"far": lambda x, u, p: 4.0 + sin(3.0 * x[0])}}
    x = np.array([1.0, -0.5])
    plan, pure, exact = (
        reaching(solver=s, **settings).plan(x) for s in (AUTO, PURE, RealTime(iterations=0, hessian="exact"))
    )
    assert plan.status is exact.status is Status.SOLVED
    assert pure.status is Status.ITERATION_LIMIT
    assert plan.cost == pytest.approx(pure.cost, rel=1e-9)
    assert plan.cost < 0.9 * exact.cost


@pytest.mark.usefixtures("_engine")
def test_plans_that_gauss_newton_ends_are_its_own_to_the_last_bit():
    mpc = reaching(horizon=10)
    for x in ([0.5, 0.0], [-0.7, 0.3]):
        plan, pure = (replace(mpc, solver=solver).plan(np.array(x)) for solver in (AUTO, PURE))
        assert plan.status is pure.status is Status.SOLVED
        assert plan.iterations == pure.iterations
        assert np.array_equal(plan.u, pure.u)


@pytest.mark.usefixtures("_engine")
def test_what_has_no_answer_is_still_infeasible():
    plan = swinging(terminal_limits=Limits(phi=(3.0, 3.0))).plan(np.zeros(2), rate=0.0)
    assert plan.status is Status.INFEASIBLE
    assert plan.iterations <= 400


@pytest.mark.usefixtures("_engine")
def test_equations_without_second_derivatives_go_on_by_gauss_newton(monkeypatch: pytest.MonkeyPatch):
    """As of a function that has no scalar code: they have all of the iterations, and end at no less."""
    monkeypatch.setattr(curvature, "scalars", lambda function: None)
    for make, said in ((reaching, {}), (swinging, {"rate": 0.0})):
        mpc, x = make(), np.array([1.2, -0.5])
        plan, pure = (replace(mpc, solver=replace(s, max_iterations=120)).plan(x, **said) for s in (AUTO, PURE))
        assert pure.status is Status.ITERATION_LIMIT
        assert plan.status is Status.SOLVED or (plan.status is pure.status and plan.iterations == pure.iterations)
        assert plan.iterations <= 120
        assert not plan.cost > pure.cost * (1 + 1e-9)


@needs_compiler
def test_its_code_is_compiled_where_a_plan_needs_it_and_before_all_where_there_is_a_deadline(
    monkeypatch: pytest.MonkeyPatch,
):
    made = []

    def counted(source: str, **given: Any) -> Any:
        made.append("#define CURVED" in source)
        return library(source, **given)

    library = backend.library
    monkeypatch.setattr(backend, "library", counted)
    x = np.array([0.3, -0.2])
    for solver in (RealTime(), PURE):
        swinging(solver=solver).plan(x, rate=0.0)
    assert not any(made)
    mpc = swinging()
    mpc.prepare()
    assert not any(made)
    assert mpc.plan(x, rate=0.0).status is Status.SOLVED
    assert any(made)
    hurried = swinging(deadline=10.0)
    made.clear()
    hurried.prepare()
    assert any(made)
    made.clear()
    assert hurried.plan(x, rate=0.0).status is Status.SOLVED
    assert not made


def test_what_the_last_steps_lead_to_is_taken_if_it_is_no_dearer_than_a_plan_that_was_there():
    cut, no_plan = (Status.ITERATION_LIMIT, 10.0, 0.0), (Status.INFEASIBLE, 10.0, 1e-3)
    assert better(cut, (Status.SOLVED, 9.0, 0.0))
    assert better(cut, (Status.SOLVED, 10.0 + 5e-6, 0.0))
    assert not better(cut, (Status.SOLVED, 10.1, 0.0))
    assert not better(cut, (Status.ITERATION_LIMIT, 9.0, 1e-3))
    assert better(cut, (Status.ITERATION_LIMIT, 9.0, 0.0))
    assert better(no_plan, (Status.SOLVED, 20.0, 0.0))
    assert not better(no_plan, (Status.INFEASIBLE, 5.0, 1e-3))
    assert leaves(Status.ITERATION_LIMIT, Status.INFEASIBLE, found=True) is Status.STALLED
    assert leaves(Status.ITERATION_LIMIT, Status.TIME_OUT, found=True) is Status.TIME_OUT
    assert leaves(Status.STALLED, Status.INFEASIBLE, found=False) is Status.INFEASIBLE


def test_steps_linger_where_more_are_to_come_than_there_were():
    """Ten steps that halve end soon; ten that take a hundredth off do not, and by one that does no wait is begun."""
    for factor, slow in ((0.5, False), (0.99, True), (1.0, True)):
        tail, size, said = Tail(), 1e-2, []
        for count in range(1, 40):
            size *= factor
            said.append(tail.lingers(size, 1e-9, count, still=count != 20))
        assert any(said[:20]) == any(said[20:]) == slow
        assert not any(said[:10])
        assert not any(said[19:29])
