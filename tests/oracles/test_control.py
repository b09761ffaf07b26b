"""Plans of every solver for a linear car against the optimality conditions of `tests.oracles.control`'s problem."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog, lsq_linear

from slipangle.codegen import compiler as compiled
from slipangle.control.followers.preview_lqr import PreviewLQR
from slipangle.control.mpc import MPC
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.ocp import Reference
from slipangle.optimal.realtime import RealTime, backend
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights
from tests.optimal.linear import two_masses
from tests.oracles import control
from tests.oracles.compare import uniform

CAR = two_masses()
STEPS = (1, 1, 2, 4, 3)
WEIGHTS = dict(Q=[3.0, 0.2, 5.0, 0.1], R=[0.02, 0.05], S=[0.3, 0.7], end=[8.0, 1.0, 2.0, 0.5])
BOUNDED = MPC(
    CAR,
    horizon=len(STEPS),
    steps=STEPS,
    Q=Weights(p1=3.0, v1=0.2, p2=5.0, v2=0.1),
    R=Weights(a1=0.02, a2=0.05),
    S=Weights(a1=0.3, a2=0.7),
    terminal=Weights(p1=8.0, v1=1.0, p2=2.0, v2=0.5),
    limits=Limits(a1=(-0.9, 1.4), a2=0.6, v1=(-0.2, 0.3)),
    rates=Limits(a1=(-8.0, 12.0), a2=6.0),
    solver=Ipopt(tolerance=1e-10),
)
CONVERGED = RealTime(iterations=0, tolerance=1e-9)
KEPT = dict(inputs=[(-0.9, 1.4), (-0.6, 0.6)], rates=[(-8.0, 12.0), (-6.0, 6.0)], states={1: (-0.2, 0.3)})


def situation(seed):
    rng = np.random.default_rng(seed)
    x = rng.uniform([-0.12, -0.15, -0.12, -0.5], [0.12, 0.2, 0.12, 0.5])
    before = rng.uniform([-0.5, -0.4], [0.8, 0.4])
    wanted = rng.uniform(-0.6, 0.6, 4) + rng.uniform(-0.05, 0.05, (len(STEPS) + 1, 4))
    return x, before, wanted, rng.uniform(-0.2, 0.2, (len(STEPS), 2))


def not_optimal(u, x, before, wanted, wanted_inputs):
    """Largest excess over a limit, and the part of the cost's slope that no active limit holds, over the slope."""
    M, b = control.squares(CAR.A, CAR.B, x, before, STEPS, **WEIGHTS, wanted=wanted, wanted_inputs=wanted_inputs)
    rows, low, high = control.limits(CAR.A, CAR.B, x, before, STEPS, CAR.dt, **KEPT)
    value, slope = rows @ u.ravel(), 2 * M.T @ (M @ u.ravel() - b)
    excess = max((value - high).max(), (low - value).max())
    size = 1e-5 * (1 + np.abs(value))
    active = np.vstack([-rows[value > high - size], rows[value < low + size]]).T
    if not active.size:
        return excess, np.abs(slope).max() / np.abs(2 * M.T @ b).max(), 0
    found = lsq_linear(active, slope, bounds=(0, np.inf), tol=1e-14)
    rest = np.abs(active @ found.x - slope).max()
    return excess, rest / np.abs(2 * M.T @ b).max(), active.shape[1]


def test_path_errors_of_the_preview_lqr_are_the_bicycles():
    follower = PreviewLQR(params=SOUSA_TABLE_7_2)
    car = {n: getattr(SOUSA_TABLE_7_2, n) for n in ("mass", "inertia_z", "wheelbase", "l_f", "C_f", "C_r")}
    for *errors, delta, curvature, v in uniform(
        0, 50, (-2, 2), (-2, 2), (-0.3, 0.3), (-1, 1), (-0.2, 0.2), (-0.1, 0.1), (4, 40)
    ):
        A, B, E = follower.errors(v)
        found = A @ errors + B[:, 0] * delta + E[:, 0] * v * curvature
        np.testing.assert_allclose(found, control.path_errors(car, v, errors, delta, curvature), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("solver", ["Ipopt", "compiled", "interpreted"])
def test_plans_are_optimal_for_the_cost_and_the_limits_as_written(solver, monkeypatch):
    if solver == "compiled" and compiled.compiler() is None:
        pytest.skip(compiled.sentence())
    if solver == "interpreted":
        monkeypatch.setenv("SLIPANGLE_CC", "none")
        monkeypatch.setattr(backend, "_say_once", lambda sentence: None)
    mpc = BOUNDED if solver == "Ipopt" else replace(BOUNDED, solver=CONVERGED)
    solved, held, limited = 0, 0, 0
    for seed in range(16):
        x, before, wanted, inputs = situation(seed)
        reference = Reference(
            tracked=wanted[:, [CAR.states.index(n) for n in mpc.references]],
            exogenous=np.zeros((len(STEPS), 0)),
            inputs=inputs,
        )
        plan = mpc.plan(x, reference, applied=before)
        if plan.status is Status.INFEASIBLE:
            rows, low, high = control.limits(CAR.A, CAR.B, x, before, STEPS, CAR.dt, **KEPT)
            none = linprog(
                np.zeros(rows.shape[1]), np.vstack([rows, -rows]), np.append(high, -low), bounds=(None, None)
            )
            assert none.status == 2, seed
            continue
        assert plan.status is Status.SOLVED, (seed, plan.status)
        excess, rest, active = not_optimal(plan.u, x, before, wanted, inputs)
        assert excess < 1e-7, seed
        assert rest < 1e-6, (seed, rest)
        solved, held = solved + 1, held + (active > 0)
        free, forced = control.responses(CAR.A, CAR.B, x, STEPS)
        v1 = (free + forced @ plan.u.ravel())[1:, 1]
        limited += bool((np.abs(v1 - 0.3) < 1e-5).any() or (np.abs(v1 + 0.2) < 1e-5).any())
        np.testing.assert_allclose(plan.x, free + forced @ plan.u.ravel(), atol=1e-6)
    assert solved >= 10  # the others cannot keep the speed's limit
    assert held >= 8
    assert limited >= 4
