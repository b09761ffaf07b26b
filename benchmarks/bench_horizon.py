"""Long horizons and many active limits: time of one plan by how the quadratic program is solved.

Two problems over several horizons, one thread, warm, every candidate in turn: a chain of six masses between two walls
(12 states, two forces with limits, steps of 0.1 s), pushed about; and a miniature race car (six states, rates of duty
cycle and steering, soft limits of both accelerations and of the track, steps of 0.02 s) that goes as far as it can. Of
each situation the least process time of the thread over the rounds counts, the call from Python included.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from slipangle.control.mpc import MPC
from slipangle.models.custom import Ode
from slipangle.ops import Scalar, Vector, cos, sin, tanh
from slipangle.optimal.ocp import Reference
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.solution import Plan
from slipangle.optimal.terms import Limits, Weights
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

ROUNDS, STEPS = 5, 120
WAYS = ("condensed", "riccati", "auto")
MASSES = 6
BOUNDS = {  # microseconds: median, and p99
    "chain, N = 200": (2000.0, None),
    "race car, N = 50": (400.0, 1000.0),
}
ACADOS = {  # microseconds in C, HPIPM with its best block size, on another machine
    "chain, N = 20": 182,
    "chain, N = 50": 372,
    "chain, N = 100": 1481,
    "chain, N = 200": 2109,
    "race car, N = 50": 1140,
}


def chain(horizon: int) -> MPC:
    """Six masses on springs and dampers, forces on the second and the fifth."""

    def f(x: Vector, u: Vector, p: object) -> list[Scalar]:
        q = [0.0, *(x[i] for i in range(MASSES)), 0.0]
        a = [q[i - 1] - 2 * q[i] + q[i + 1] - 0.05 * x[MASSES + i - 1] for i in range(1, MASSES + 1)]
        a[1], a[4] = a[1] + u[0], a[4] + u[1]
        return [*(x[MASSES + i] for i in range(MASSES)), *a]

    q, v = (tuple(f"{n}{i}" for i in range(MASSES)) for n in "qv")
    model = Ode(f=f, states=(*q, *v), inputs=("F1", "F2"), outputs=(), params={}, dt=0.1, method="rk4")
    return MPC(
        model,
        horizon=horizon,
        Q=Weights(**dict.fromkeys(q, 1.0), **dict.fromkeys(v, 0.1)),
        R=Weights(F1=0.1, F2=0.1),
        limits=Limits(F1=0.6, F2=0.6),
    )


Planned = tuple[np.ndarray, Reference, Plan | None, Plan, float]  # state, reference, plan before, plan, its time [s]


def push(mpc: MPC) -> Iterator[Planned]:
    """One run of the chain."""
    rng, n, plan = np.random.default_rng(0), mpc.horizon, None
    x = np.concatenate([rng.standard_normal(MASSES), np.zeros(MASSES)])
    goal = Reference(tracked=np.zeros((n + 1, 2 * MASSES)), exogenous=np.zeros((n, 0)))
    for k in range(STEPS):
        before, began = plan, time.thread_time()
        plan = mpc.plan(x, goal, plan)
        yield x, goal, before, plan, time.thread_time() - began
        x = np.asarray(mpc.ocp.dynamics(x, plan.command, [])).ravel()
        x = x.copy()
        x[MASSES:] += (0.3 if k % 20 == 19 else 0.002) * rng.standard_normal(MASSES)


MASS, C_1, C_2 = 0.043, 0.5, 15.5  # of the car [kg], and of its kinematic steering [-], [1/m]


def _push(x: Vector) -> Scalar:
    v = x[3]
    return ((0.28 - 0.05 * v) * x[4] - 0.006 * v * v - 0.011 * tanh(5 * v)) / MASS


def race_car(horizon: int) -> MPC:
    """States on the track: s, distance and angle from it, speed, duty cycle, steering; the last two by their rates."""

    def f(x: Vector, u: Vector, p: object) -> list[Scalar]:
        along = x[3] * cos(x[2] + C_1 * x[5]) / (1 - u[2] * x[1])
        across = x[3] * sin(x[2] + C_1 * x[5])
        return [along, across, x[3] * C_2 * x[5] - u[2] * along, _push(x) * cos(C_1 * x[5]), u[0], u[1]]

    names = ("s", "n", "alpha", "v", "D", "delta")
    inputs = ("D_rate", "delta_rate", "kappa")
    soft = ("a_x", "a_y", "n")
    return MPC(
        Ode(f=f, states=names, inputs=inputs, outputs=(), params={}, dt=0.02, method="rk4"),
        horizon=horizon,
        controls=inputs[:2],
        Q=Weights(s=0.1, n=1e-8, alpha=1e-8, v=1e-8, D=1e-3, delta=5e-3),
        R=Weights(D_rate=1e-3, delta_rate=5e-3),
        terminal=Weights(s=5.0, n=10.0, alpha=1e-8, v=1e-8, D=5e-3, delta=2e-3),
        terms={
            "a_x": lambda x, u, p: _push(x),
            "a_y": lambda x, u, p: C_2 * x[3] * x[3] * x[5] + _push(x) * sin(C_1 * x[5]),
        },
        limits=Limits(D_rate=10.0, delta_rate=2.0, D=1.0, delta=0.4, n=0.12, a_x=4.0, a_y=4.0),
        slack=Weights(**dict.fromkeys(soft, 2.0)),
        slack_linear=Weights(**dict.fromkeys(soft, 200.0)),
    )


def curvature(s: np.ndarray) -> np.ndarray:
    """Of a closed track of 8 m. [1/m]"""
    corners = ((1.2, 2.6, 1.8), (3.0, 3.6, -1.5), (4.0, 5.6, 1.8), (6.2, 7.4, 1.5))
    s = np.asarray(s) % 8.0
    return sum((0.5 * k * (np.tanh(6 * (s - a)) - np.tanh(6 * (s - b))) for a, b, k in corners), np.zeros_like(s))


def race(mpc: MPC) -> Iterator[Planned]:
    """One drive of the car."""
    n, plan = mpc.horizon, None
    x, tracked = np.array([-2.0, 0, 0, 0.5, 0, 0]), np.zeros((n + 1, 6))
    for _ in range(2 * STEPS):
        places = (
            x[0] + np.arange(n + 1) / n if plan is None else np.append(plan.x[1:, 0], 2 * plan.x[-1, 0] - plan.x[-2, 0])
        )
        tracked[:, 0] = x[0] + 3.0 * np.arange(n + 1) / n
        kappa = curvature(places)[:, None]
        goal = Reference(tracked=tracked.copy(), exogenous=kappa)
        before, began = plan, time.thread_time()
        plan = mpc.plan(x, goal, plan)
        yield x, goal, before, plan, time.thread_time() - began
        x = np.asarray(mpc.ocp.dynamics(x, plan.command, kappa[0])).ravel()


def bench(progress: Progress) -> Reproduction:
    """Time every way on every problem."""
    problems = [(f"chain, N = {n}", chain(n), push) for n in (10, 20, 50, 100, 200)]
    problems += [(f"race car, N = {n}", race_car(n), race) for n in (20, 50, 100)]
    found: list[Record] = []
    for done, (name, mpc, drive) in enumerate(problems):
        progress(done / len(problems), name)
        found += _problem(name, mpc, drive)
    return Reproduction(
        title="Predictive control on long horizons, time of one plan",
        records=tuple(found),
        protocol=" ".join((__doc__ or "").split()),
    )


def _problem(name: str, mpc: MPC, drive: Callable[[MPC], Iterator[Planned]]) -> list[Record]:
    ways = {qp: replace(mpc, solver=RealTime(qp=qp)) for qp in WAYS}
    spent: dict[str, list[list[float]]] = {qp: [] for qp in WAYS}
    plans: dict[str, list[Plan]] = {}
    for _ in range(ROUNDS):
        for qp, way in ways.items():
            *_, said, times = zip(*drive(way), strict=True)
            spent[qp].append(list(times[2:]))
            plans[qp] = list(said)
    found = []
    for qp in WAYS:
        least = 1e6 * np.min(spent[qp], axis=0)
        many = np.mean([p.iterations for p in plans[qp]])
        far = max(float(np.abs(a.u - b.u).max()) for a, b in zip(plans[qp], plans["condensed"], strict=True))
        times = float(np.median(least)), float(np.percentile(least, 99))
        bounds = BOUNDS.get(name, (None, None)) if qp == "auto" else (None, None)
        note = f"{many:.2f} iterations a plan; inputs as condensed to {far:.0e}"
        for what, value, bound in zip(("median", "p99"), times, bounds, strict=True):
            found.append(
                Record(
                    row=f"{name}, {qp}",
                    quantity=f"through Python [us], {what}",
                    thesis=None,
                    here=value,
                    bound="" if bound is None else f"<= {bound:g}",
                    holds=None if bound is None else value <= bound,
                    note=note if what == "median" else "",
                )
            )
    return found
