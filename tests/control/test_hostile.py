"""Whatever is given, the answer is a finite command within limits and rates, and its status is true."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.control.followers.followers import PurePursuit, Stanley
from slipangle.control.followers.preview_lqr import PreviewLQR
from slipangle.control.marx.adaptation import AdaptiveMultiARXMPC
from slipangle.control.speed.driver import DriverState, SpeedDriver
from slipangle.control.switched import SwitchedMPC
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits
from tests.control.hostile import NEVER, ODD, Hostile
from tests.control.test_copies import PATH, interpreted, lagged, posed

RATES = {"rates": Limits(delta=2.0)}


def real_time(**options):
    mpc = posed(**RATES, **options)
    hurried = [replace(mpc, deadline=t) for t in (1e-9, 5e-5, 2e-4)]
    return Hostile(mpc, PATH, [*hurried, replace(mpc)], step=0.1)


def without_compiler():
    mpc = interpreted(posed(**RATES))
    return Hostile(mpc, PATH, [interpreted(replace(mpc))], step=0.1)


def marx(kind=lambda base: base, **options):
    base = replace(lagged(), horizon=8, limits=Limits(delta=0.3), **RATES, **options)
    return Hostile(kind(base), PATH, [kind(replace(base))], step=0.1)


def switched():
    base = replace(lagged(), horizon=8, limits=Limits(delta=0.3), **RATES)
    both = SwitchedMPC(base, posed(**RATES), friction=0.8)
    return Hostile(both, PATH, step=0.1)


def follower(kind):
    return Hostile(kind(params=SOUSA_TABLE_7_2, dt=0.05, horizon=8, limit=0.3, rate=2.0), PATH, step=0.1)


HOSTILE = {
    "real time": real_time,
    "real time, limits of states": lambda: real_time(corridor=1.0),
    "without a compiler": without_compiler,
    "ipopt": lambda: Hostile(posed(solver="ipopt", **RATES), PATH, step=0.1),
    "MARX": marx,
    "MARX, integral": lambda: marx(integral=0.2),
    "adaptive": lambda: marx(AdaptiveMultiARXMPC),
    "switched": switched,
    "pure pursuit": lambda: follower(PurePursuit),
    "Stanley": lambda: follower(Stanley),
    "preview LQR": lambda: follower(PreviewLQR),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_few_hostile_calls(name):
    counts = HOSTILE[name]().run(300 if name != "ipopt" else 100, seed=1)
    assert counts["answer"] > 20
    assert counts["fallback"] > 10
    assert counts["refused"] > 2
    assert counts[Status.IMPLAUSIBLE.name] > 2
    assert counts[Status.NOT_FINITE.name] > 2


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_a_hundred_thousand_hostile_calls(name):
    counts = HOSTILE[name]().run(100_000 if name != "ipopt" else 20_000, seed=2)
    print(name, dict(counts))
    assert counts["answer"] > 2_000


def hostile_driver(calls):
    rng, low, high = np.random.default_rng(3), -3000.0, 1000.0
    driver = SpeedDriver.for_car(mass=1500.0, radius=0.3, limits=(low, high))
    state, held = DriverState(), 0
    for _ in range(calls):
        wanted, v_x, a_x = (float(rng.uniform(0, 30)) for _ in "123")
        kind = rng.random()
        if kind < 0.2:
            given = wanted, v_x, a_x
            wanted, v_x, a_x = (v if rng.random() < 0.5 else NEVER[rng.integers(len(NEVER))] for v in given)
        elif kind < 0.4:
            wanted, v_x, a_x = (ODD[rng.integers(len(ODD))] for _ in "123")
        if rng.random() < 0.1:
            state = DriverState(*rng.choice([*NEVER, *ODD], 2).tolist())
        output, after = driver.step(state, wanted, v_x, a_x)
        assert low <= output <= high
        assert np.isfinite(after.integral)
        held += output == state.output
        state = after
    assert held > 0


def test_a_few_hostile_samples_for_the_driver():
    hostile_driver(2000)


@pytest.mark.slow
def test_a_hundred_thousand_hostile_samples_for_the_driver():
    hostile_driver(100_000)


def test_a_plan_whose_memory_was_changed_by_hand_is_no_way_into_other_memory():
    """Finite numbers where the solver keeps indices of rows: beyond the end, negative, twice the same, fractions."""
    rng = np.random.default_rng(5)
    hostile = real_time(corridor=1.0)
    mpc, (x, reference) = hostile.controller, hostile.situations[3]
    plan = mpc.plan(x, reference)
    for value in (1e3, 1e6, 1e9, -1.0, 7.0, 2.5):
        for share in (0.02, 0.5, 1.0):
            found = np.where(rng.random(plan.memory.found.shape) < share, value, plan.memory.found)
            again = mpc.plan(x, reference, replace(plan, memory=replace(plan.memory, found=found)))
            assert np.isfinite(again.u).all()
            assert np.abs(again.u).max() <= 0.3
