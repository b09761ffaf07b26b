"""A plan to convergence is no dearer than the plan that it began with."""

from typing import Any

import numpy as np
import pytest

import slipangle as sa
from slipangle.ops import exp

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler")
N = 20
GOAL = {"c": 0.5, "Temp": 350.0}


def rates(x: Any, u: Any, p: Any) -> list[Any]:
    """A stirred tank near its runaway: Seborg et al., Process Dynamics and Control, 4th ed., 2016, example 2.5."""
    k = 7.2e10 * exp(-8750.0 / x[1])
    return [(1.0 - x[0]) - k * x[0], (350.0 - x[1]) + 209.2 * k * x[0] + 2.09 * (u[0] - x[1])]


MODEL = sa.Ode(f=rates, states=("c", "Temp"), inputs=("Tc",), params={}, dt=0.05)


def reactor() -> sa.MPC:
    return sa.MPC(
        MODEL,
        horizon=N,
        controls=("Tc",),
        Q=sa.Weights(c=100.0, Temp=0.01),
        S=sa.Weights(Tc=0.01),
        limits=sa.Limits(Tc=(280.0, 370.0), Temp=(300.0, 370.0)),
        slack=sa.Weights(Temp=1.0),
        slack_linear=sa.Weights(Temp=1.0),
        rates=sa.Limits(Tc=400.0),
        solver=sa.RealTime(iterations=0),
    )


def roll_out(x: Any, u: np.ndarray) -> np.ndarray:
    """States; those of a tank that has run away may be beyond all numbers."""
    states = [np.array(x, dtype=float)]
    with np.errstate(all="ignore"):
        for v in u:
            states.append(np.asarray(MODEL.step(states[-1], np.atleast_1d(v))))
    return np.array(states)


def cost(x: np.ndarray, u: np.ndarray, applied: float) -> float:
    states = roll_out(x, u)
    if not np.isfinite(states).all():
        return np.inf
    beyond = np.maximum(np.maximum(states[1:, 1] - 370.0, 300.0 - states[1:, 1]), 0.0)
    changes = np.diff(u, prepend=applied)
    with np.errstate(over="ignore"):  # infinite then, as beyond all numbers
        errors = 100 * (states[:, 0] - 0.5) ** 2 + 0.01 * (states[:, 1] - 350.0) ** 2
        return float(errors.sum() + 0.01 * (changes**2).sum() + (beyond**2 + beyond).sum())


@pytest.mark.parametrize("engine", ["", "none"])
@pytest.mark.parametrize("now", [(0.818, 348.6), (0.82, 348.2), (0.80, 349.0), (0.75, 350.0)])
def test_from_states_of_a_runaway_the_tank_is_still_held(
    monkeypatch: pytest.MonkeyPatch, engine: str, now: tuple[float, float]
) -> None:
    """Full cooling holds it; the states that the plan begins with are those of tanks that run away under it."""
    if engine:
        monkeypatch.setenv("SLIPANGLE_CC", engine)
    mpc, cooled = reactor(), np.full(N, 280.0)
    assert cost(np.array(now), cooled, 280.0) < 130.0
    for other in [(0.80, 349.2), (0.78, 350.0), (0.72, 351.4), (0.77, 349.9), (0.70, 353.0)]:
        away = roll_out(other, cooled)
        guess = mpc.guess(u=cooled[:, None], x=away)
        plan = mpc.plan(np.array(now), previous=guess, applied=np.array([280.0]), **GOAL)
        assert plan.status.solved
        assert plan.cost == pytest.approx(cost(np.array(now), plan.u[:, 0], 280.0), rel=1e-6)
        assert plan.cost < cost(np.array(now), cooled, 280.0)


def test_from_step_to_step_no_plan_is_dearer_than_the_one_before_shifted() -> None:
    """Near the runaway, with noise on the states of 0.1 %."""
    mpc, told = reactor(), 0
    for seed in range(4):
        rng, x, plan, applied = np.random.default_rng(seed), np.array([0.9, 310.0]), None, np.array([300.0])
        for _ in range(30):
            before, plan = plan, mpc.plan(x, previous=plan, applied=applied, **GOAL)
            if before is not None and before.status.solved and plan.status.solved:
                shifted = np.append(before.u[1:, 0], before.u[-1, 0])
                assert plan.cost <= cost(x, shifted, float(applied[0])) * (1 + 1e-6)
                told += 1
            applied = plan.command
            x = roll_out(x, applied)[1] * (1 + 1e-3 * rng.normal(size=2))
    assert told > 60
