"""A plan that someone wrote is a start: its states count as its inputs do."""

from dataclasses import replace

import numpy as np
import pytest

import slipangle as sa
from slipangle.optimal.solution import Status
from tests.optimal.oscillator import START, van_der_pol

N = 100


def written(plan, x):
    """The plan with other states, without its inputs and all that a solver left."""
    return replace(plan, u=np.zeros((N, 1)), x=x, memory=None, status=Status.SOLVED, age=0)


@pytest.mark.filterwarnings("ignore:no C compiler")
@pytest.mark.parametrize("compiler", ["", "none"])
def test_states_near_the_optimum_lead_there_sooner(monkeypatch, compiler):
    if compiler:
        monkeypatch.setenv("SLIPANGLE_CC", compiler)
    mpc = van_der_pol(N, sa.RealTime(iterations=0))
    rolled = mpc.plan(START)
    plan = mpc.plan(START, previous=written(rolled, np.vstack([START, rolled.x[:-1]])), applied=np.zeros(1))
    assert rolled.status.solved
    assert plan.status.solved
    assert plan.cost == pytest.approx(rolled.cost, rel=1e-9)
    assert plan.u == pytest.approx(rolled.u, abs=1e-6)
    assert plan.iterations < rolled.iterations - 1


def test_states_of_another_shape_or_no_numbers_are_rolled_out_anew():
    mpc = van_der_pol(N, sa.RealTime(iterations=0))
    rolled = mpc.plan(START)
    for x in (np.zeros((3, 2)), np.full((N + 1, 2), np.nan)):
        plan = mpc.plan(START, previous=written(rolled, x), applied=np.zeros(1))
        assert plan.status.solved
        assert plan.cost == pytest.approx(rolled.cost, rel=1e-9)
        assert plan.iterations == rolled.iterations
