"""Plans from the one before, after a jump of state and goal: found where a cold start finds one, else soon given up."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.control.mpc import MPC
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.terms import Limits, Weights
from tests.optimal.test_agreement import GAINS, KINDS, MODEL, compiler, ours_and_ipopt

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler was found")

TIGHT = {"limits": Limits(u=4.0, v=2.0, b=1.2, y=1.2)}


def posed(settings, solver):
    weights = {"Q": Weights(a=4.0, b=0.5, c=2.0), "R": Weights(u=0.1, v=0.2)}
    return MPC(MODEL, horizon=10, controls=("u", "v"), solver=solver, **weights, **settings)


def jump(mpc, seed):
    """A first plan, then what `plan` is asked for after a jump."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(-1.0, 1.0, 3) * (1.5, 1.2, 1.0)
    gains = {name: rng.uniform(0.3, 2.0) for name in GAINS}
    goals = [{name: rng.uniform(-1.2, 1.2) for name in ("a", "b", "c")} for _ in range(2)]
    first = mpc.plan(start, **gains, **goals[0])
    state = first.x[1] + 0.8 * rng.standard_normal(3)
    return first, state, {"applied": first.command, **gains, **goals[1]}


@pytest.mark.parametrize(
    "settings", [pytest.param(KINDS["hard"], id="hard", marks=pytest.mark.slow), pytest.param(TIGHT, id="tight")]
)
def test_what_a_cold_start_finds_is_found_and_what_it_does_not_is_soon_given_up(settings):
    """Of 50 jumps; a plan may take twenty steps then, as it comes nearer to the limits all the time."""
    mpc = posed(settings, RealTime())
    cold = replace(mpc, solver=RealTime(iterations=0))
    lost, found, in_vain = 0, 0, []
    for seed in range(50 if compiler() else 12):
        first, state, asked = jump(mpc, seed)
        if not first.status.solved:
            continue
        plan = mpc.plan(state, previous=first, **asked)
        found += plan.age == 0
        if plan.age:
            has_one = cold.plan(state, **asked).status.solved
            lost += has_one
            if not has_one:
                in_vain.append(plan.iterations)
                assert not plan.status.solved
    assert lost <= 1
    assert found > 0
    assert not in_vain or np.mean(in_vain) < 8.0


@pytest.mark.parametrize(
    "settings", [pytest.param(KINDS["hard"], id="hard", marks=pytest.mark.slow), pytest.param(TIGHT, id="tight")]
)
def test_it_takes_the_same_steps_without_a_compiler(settings):
    engines = [replace(engine, iterations=1) for engine in ours_and_ipopt()[:-1]]
    mpcs = [posed(settings, engine) for engine in engines]
    for seed in range(8):
        plans = []
        for mpc in mpcs:
            first, state, asked = jump(mpc, seed)
            plans.append(mpc.plan(state, previous=first, **asked))
        for other in plans[1:]:
            assert (other.status, other.iterations) == (plans[0].status, plans[0].iterations)
            assert other.u == pytest.approx(plans[0].u, abs=1e-8)
