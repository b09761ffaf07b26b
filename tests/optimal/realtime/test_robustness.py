"""Closed loops under wrong parameters, lost friction, noise, delay, dropped measurements and killed solves."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.control.mpc import MPC
from slipangle.models.tires.simple import Tire
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.optimal.engine import Engine
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.solution import Plan, Status
from slipangle.optimal.terms import Limits
from slipangle.paths.lane_change import double_lane_change
from tests.optimal.realtime.test_realtime import car

pytestmark = pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
PATH = double_lane_change(20.0, blend=12.0)


class Slippery(Tire):
    """Another tire on a road of lower friction."""

    def __init__(self, tire, friction):
        self.tire, self.friction = tire, friction

    def forces(self, slip_ratio, slip_angle, load, *, camber=0.0, friction=1.0):
        return self.tire.forces(slip_ratio, slip_angle, load, camber=camber, friction=friction * self.friction)


def plant(rng, friction):
    """The car with parameters that the controller does not know, up to 20 % off, by explicit steps of 0.5 ms."""
    params = replace(
        SOUSA_TABLE_6_1,
        mass=2500.0 * rng.uniform(0.8, 1.2),
        inertia_z=2200.0 * rng.uniform(0.8, 1.2),
        l_f=1.35 * rng.uniform(0.8, 1.2),
        radius=0.42 * rng.uniform(0.8, 1.2),
        inertia_wheel_f=2.5 * rng.uniform(0.8, 1.2),
        inertia_wheel_r=2.5 * rng.uniform(0.8, 1.2),
    )
    tire = Slippery(SOUSA_TABLE_6_2, friction)
    model = SingleTrack(params=params, dt=0.0005, substeps=1, tire_f=tire, tire_r=tire)
    return model.functions[0].fold(200)


class Killed(Engine):
    """The real-time solver, killed or broken in some of its solves."""

    def __init__(self, rng, share):
        self.rng, self.share, self.kills = rng, share, 0

    def build(self, ocp, deadline):
        self.engine = RealTime().build(ocp, deadline)
        return self

    def solve(self, start):
        return self.engine.solve(start)

    def resume(self, x, applied, reference, previous):
        solution = self.engine.resume(x, applied, reference, previous)
        if self.rng.random() < self.share:
            self.kills += 1
            how = self.rng.integers(3)
            if how == 0:
                raise RuntimeError("killed")
            if how == 1:
                return replace(solution, u=solution.u * np.nan)
            return replace(solution, status=Status.FAILED)
        return solution


def loop(mpc: MPC, killed: Killed, seed: int) -> Counter:
    """One drive; whatever happens, every command is finite, within limits, and every fallback is counted and said."""
    rng = np.random.default_rng(seed)
    killed.rng = np.random.default_rng([seed, 1])
    dry = plant(rng, 1.0)
    wet = plant(rng, 0.3)
    slippery_from = rng.integers(10, 60)
    delayed, dropped, noisy = rng.random() < 0.5, rng.uniform(0, 0.1), rng.uniform(0, 2)
    x = mpc.model.straight(rng.uniform(15, 23), X=PATH.start[0], Y=rng.normal(0, 0.3))
    size = noisy * np.array([0.05, 0.02, 0.005, 0.1, 0.1, 0.02, 0.02, 0.002])
    plan: Plan | None = None
    waiting, before, s, counts = np.zeros(2), np.zeros(2), 0.0, Counter()
    low, high = mpc.ocp.input_bounds.T
    for k in range(70):
        measured = x + size * rng.standard_normal(8)
        lost = rng.random() < dropped
        if lost:
            measured[rng.integers(8)] = np.nan
        if np.isfinite(measured[[5, 6]]).all():
            s = PATH.project(measured[5], measured[6], s).s
        kills, age = killed.kills, 0 if plan is None else plan.age
        plan = mpc.plan(measured, mpc.reference(PATH.ahead(s, mpc.times), T_r=0.0), plan)
        was_killed, failed = killed.kills > kills, not (plan.status.solved or plan.status.unfinished)
        counts.update({plan.status: 1, "lost": lost, "killed": was_killed, "fallbacks": plan.age > 0})
        if lost or failed or was_killed:
            assert plan.age == age + 1
        assert plan.age in ((0, age + 1) if plan.status.unfinished else (0,) if plan.status.solved else (age + 1,))
        assert (f"fallback {plan.age} in a row" in plan.message) is (plan.age > 0)
        assert np.isfinite(plan.u).all()
        assert np.isfinite(plan.x).all()
        assert (plan.u >= low).all()
        assert (plan.u <= high).all()
        changes = np.diff(np.vstack([before, plan.u]), axis=0)
        assert (np.abs(changes) <= mpc.ocp.step_bounds[..., 1] * (1 + 1e-9)).all()
        applied, waiting = (waiting, plan.command) if delayed else (plan.command, plan.command)
        before = plan.command
        x = np.asarray((wet if k >= slippery_from else dry)(x, [*applied, 0.0])).ravel()
        assert np.isfinite(x).all()
    return counts


def loops(seeds, **options):
    """Many loops, each on a car of its own; totals of all statuses."""
    killed = Killed(np.random.default_rng(0), 0.03)
    mpc = car(solver=killed, **options, rates=Limits(delta=0.5 / 3, T_f=20000.0))
    totals: Counter = Counter()
    for seed in seeds:
        totals += loop(mpc, killed, seed)
    return totals


@pytest.mark.parametrize("steps", [None, (1, 1, 1, 1, 2, 2, 2, 4, 4, 4)], ids=["equal", "growing"])
def test_a_few_random_loops(steps):
    totals = loops(range(4), steps=steps)
    assert totals["lost"] > 5
    assert totals["killed"] > 5
    assert totals["fallbacks"] >= totals["lost"] + totals["killed"]
    assert totals[Status.REAL_TIME] > 0.7 * 4 * 70


@pytest.mark.slow
@pytest.mark.parametrize("steps", [None, (1, 1, 1, 1, 2, 2, 2, 4, 4, 4)], ids=["equal", "growing"])
def test_a_thousand_random_loops(steps):
    totals = loops(range(1000), steps=steps)
    print({getattr(k, "name", k): n for k, n in totals.items()})
    assert totals["fallbacks"] >= totals["lost"] + totals["killed"] > 4000
    assert totals[Status.REAL_TIME] > 0.7 * 1000 * 70
