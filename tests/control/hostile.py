"""Calls of `plan` with everything that can go wrong in what is given; seeded, the same for every controller."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from slipangle.errors import ParameterError
from slipangle.optimal.solution import Kept, Plan, Status

NEVER = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e200, -1e154, 1e100, -1e30, 1e13)  # no quantity is that
ODD = (0.0, -0.0, 5e-324, -5e-324, 1e-300, 1e-12, 1.0, -1.0, 9.0, -40.0)  # but a number
NO_ANSWER = (Status.NOT_FINITE, Status.IMPLAUSIBLE)


def never(rng):
    return NEVER[rng.integers(len(NEVER))]


def poisoned(array, rng, values, share=0.0):
    """A copy with one entry replaced, or with many."""
    out = np.array(array, dtype=float)
    where = rng.random(out.shape) < share if share and rng.random() < 0.3 else np.zeros(out.shape, dtype=bool)
    if out.size:
        where.flat[rng.integers(out.size)] = True
    out[where] = values[rng.integers(len(values))]
    return out


@dataclass
class Hostile:
    """Calls of one controller, each checked; ``counts`` says what came of them.

    ``others`` share its plans: the same controller in a hurry, a foreign one.
    """

    controller: Any
    path: Any
    others: list = field(default_factory=list)
    low: float = -0.3
    high: float = 0.3
    step: float = np.inf
    counts: Counter = field(default_factory=Counter)

    def __post_init__(self):
        first = self.controller
        self.situations = []
        for s in np.linspace(0, 100, 40):
            reference = first.reference(self.path.ahead(s, first.times, v_x=15.0))
            X, Y, psi = reference.tracked[0, :3]
            x = np.array(start(first, {"v_x": 15.0, "X": X, "Y": Y, "psi": psi}), dtype=float)
            self.situations.append((x, reference))
        self.pool: list[Plan] = []

    def run(self, calls, seed=0):
        """So many calls, some of them by other threads."""
        rng = np.random.default_rng(seed)
        with ThreadPoolExecutor(2) as threads:
            for _ in range(calls):
                arguments = self.arguments(rng)
                if rng.random() < 0.05:
                    threads.submit(self.call, *arguments).result()
                else:
                    self.call(*arguments)
        return self.counts

    # ---- what is given -----------------------------------------------------------------------------------------

    def arguments(self, rng):
        mpc = self.controller
        if self.others and rng.random() < 0.3:
            mpc = self.others[rng.integers(len(self.others))]
        x, reference = self.situations[rng.integers(len(self.situations))]
        x = x + 0.02 * rng.standard_normal(len(x))
        impossible, wrong_shape = False, False
        kind = rng.random()
        if kind < 0.12:
            x, impossible = poisoned(x, rng, NEVER, 0.5), True
        elif kind < 0.2:
            x = poisoned(x, rng, ODD, 0.3)
        elif kind < 0.22:
            x = self.situations[0][0]  # stale
        elif kind < 0.25:
            x, wrong_shape = [x[:-1], x[:, None], "x", None][rng.integers(4)], True
        kind = rng.random()
        if kind < 0.1:
            name = ("tracked", "exogenous")[rng.integers(2)]
            reference = replace(reference, **{name: poisoned(getattr(reference, name), rng, NEVER, 0.5)})
            impossible = True
        elif kind < 0.16:
            name = ("tracked", "exogenous")[rng.integers(2)]
            reference = replace(reference, **{name: poisoned(getattr(reference, name), rng, ODD, 0.3)})
        elif kind < 0.19:
            reference = [None, reference.tracked, replace(reference, exogenous=np.zeros(3))][rng.integers(3)]
            wrong_shape = True
        applied = None
        if rng.random() < 0.3:
            applied = np.array([rng.uniform(-0.4, 0.4) if rng.random() < 0.5 else never(rng)])
        return mpc, x, reference, self.previous(rng), applied, impossible, wrong_shape

    def previous(self, rng):
        """A plan of before: the last one, none, an old or a foreign one, a broken one."""
        if not self.pool or rng.random() < 0.05:
            return None
        plan = self.pool[-1] if rng.random() < 0.5 else self.pool[rng.integers(len(self.pool))]
        if rng.random() < 0.7:
            return plan
        how = rng.integers(10)
        if how == 0:
            return replace(plan, u=poisoned(plan.u, rng, NEVER, 0.5))
        if how == 1:
            return replace(plan, x=poisoned(plan.x, rng, NEVER, 0.5))
        if how == 2:
            return replace(plan, u=plan.u[: rng.integers(len(plan.u))])
        if how == 3:
            return replace(plan, controls=("throttle",))
        if how == 4:
            return replace(plan, memory=(None, 3, Kept(u=plan.u * np.nan, x=plan.x, age=0))[rng.integers(3)])
        if how == 5:
            return replace(plan, age=(-3, 10**30, np.nan, None)[rng.integers(4)])
        if how == 6:
            return replace(plan, times=poisoned(plan.times, rng, NEVER))
        if how == 7:
            return replace(plan, u=None)
        if how == 8:
            return replace(plan, health=None)
        return replace(plan, memory=spoiled(plan.memory, rng))

    # ---- what comes of it --------------------------------------------------------------------------------------

    def call(self, mpc, x, reference, previous, applied, impossible, wrong_shape):
        if wrong_shape:
            with pytest.raises(ParameterError) as caught:
                mpc.plan(x, reference, previous, applied=applied)
            assert len(str(caught.value)) < 600
            self.counts["refused"] += 1
            return
        plan = mpc.plan(x, reference, previous, applied=applied)
        self.counts[plan.status.name] += 1
        self.counts["fallback" if plan.age else "answer"] += 1
        before = self.before(mpc, previous, applied)
        assert plan.u.shape == (mpc.horizon, 1)
        assert np.isfinite(plan.u).all()
        assert np.isfinite(plan.x).all()
        assert plan.u.min() >= self.low
        assert plan.u.max() <= self.high
        changes = np.diff(np.concatenate([[before], plan.u[:, 0]]))
        assert np.abs(changes).max() <= self.step * (1 + 1e-9)
        if hasattr(plan, "active"):  # it looks at the state of one of its models
            part = np.abs(mpc.model.split(np.asarray(x))[plan.active])
            given = np.concatenate([part, *(np.abs(a).ravel() for a in (reference.tracked, reference.exogenous))])
            impossible = not (given <= 1e12).all()
        if impossible:
            assert plan.status in NO_ANSWER, (plan.status, x, reference)
        if plan.status.solved:
            assert plan.age == 0
        elif not plan.status.unfinished:
            assert plan.age > 0
        assert plan.health.plans >= 1
        assert plan.health.fallbacks_in_a_row == 0 or plan.age > 0
        self.pool.append(plan)
        if len(self.pool) > 30:
            del self.pool[0]

    def before(self, mpc, previous, applied):
        """The input that was applied, as far as that can be known."""
        given = 0.0
        if previous is not None and previous.controls == mpc.controls and previous.u is not None and len(previous.u):
            given = previous.u[0, 0] if abs(previous.u[0, 0]) < 1e12 else 0.0
        if applied is not None and abs(applied[0]) < 1e12:
            given = applied[0]
        return float(np.clip(given, self.low, self.high))


def start(controller, measured):
    """State of a controller's model."""
    if hasattr(controller, "start"):
        return controller.start(measured)
    return [measured.get(n, 0.0) for n in controller.model.states]


def spoiled(memory, rng):
    """A copy of a solver's memory with numbers that are none."""
    if hasattr(memory, "found"):
        return replace(memory, found=poisoned(memory.found, rng, NEVER, 0.5))
    if hasattr(memory, "theta"):
        name = ("theta", "P")[rng.integers(2)]
        return memory._replace(**{name: poisoned(getattr(memory, name), rng, NEVER)})
    if hasattr(memory, "v"):
        return memory._replace(v=poisoned(memory.v, rng, NEVER, 0.5))
    if hasattr(memory, "k") and isinstance(getattr(memory, "x", None), np.ndarray):
        return replace(memory, x=poisoned(memory.x, rng, NEVER, 0.5))
    return memory
