"""Long horizons of a plant that swings for ever when it is left alone: a van der Pol oscillator brought to rest."""

import pytest

import slipangle as sa
from slipangle.codegen.compiler import compiler
from slipangle.optimal.solution import Status
from tests.optimal.oscillator import START, van_der_pol

LEAST = 36.689004437  # of Ipopt, whatever the horizon from 20 s on; over 10 s 5.5e-5 less


def brought_to_rest(stages, hessian):
    return van_der_pol(stages, sa.RealTime(iterations=0, hessian=hessian), fallback=0).plan(START)


pytestmark = pytest.mark.skipif(compiler() is None, reason="the steps of the compiled solver")


@pytest.mark.parametrize(("stages", "most"), [(100, 16), (200, 25), (300, 100)])
def test_curvature_that_was_remembered_on_the_way_does_not_spoil_the_steps(stages, most):
    plan = brought_to_rest(stages, "gauss-newton")
    assert plan.status is Status.SOLVED
    assert plan.cost == pytest.approx(LEAST - 5.5e-5 * (stages == 100), rel=1e-7)
    assert plan.iterations <= most


def test_nor_beside_second_derivatives():
    plan = brought_to_rest(200, "exact")
    assert plan.status is Status.SOLVED
    assert plan.cost == pytest.approx(LEAST, rel=1e-7)
    assert plan.iterations <= 25


@pytest.mark.slow
@pytest.mark.parametrize("hessian", ["gauss-newton", "exact"])
def test_steps_that_end_under_multipliers_beyond_all_numbers_are_no_solution(hessian):
    """Seven times the least cost was named solved."""
    plan = brought_to_rest(600, hessian)
    assert plan.status is not Status.SOLVED or plan.cost == pytest.approx(LEAST, rel=1e-6)
