"""Where the duration is decided, rates are limits per second of the time that is found, not of the model's steps."""

from typing import Any

import casadi as ca
import numpy as np
import pytest

import slipangle as sa
from tests.optimal.test_guess import settled

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler")
N, RATE, LIMIT = 20, 2.0, 1.0
FIRST = RATE * 0.5  # the first change counts over a step of the model


def crane(solver: Any = "realtime", **more: Any) -> sa.MPC:
    """A mass from rest to rest, one metre on, as soon as can be."""
    model = sa.Ode(
        f=lambda x, u, p: [x[1], p.gain * u[0]], states=("s", "speed"), inputs=("a",), params={"gain": 1.0}, dt=0.5
    )
    posed: dict[str, Any] = {
        "horizon": N,
        "controls": ("a",),
        "Q": {},
        "R": sa.Weights(a=1e-6),
        "terminal": sa.Weights(duration=1.0),
        "terminal_limits": sa.Limits(s=(0.0, 0.0), speed=(0.0, 0.0)),
        "limits": sa.Limits(a=LIMIT),
        "rates": sa.Limits(a=RATE),
        "duration": (0.5, 10.0),
        "solver": solver,
    }
    return sa.MPC(model, **(posed | more))


def shortest() -> float:
    """By Ipopt, with the exact response to inputs that are held."""
    opti = ca.Opti()
    u, T = opti.variable(N), opti.variable()
    s, v, h = -1.0, 0.0, T / N
    for i in range(N):
        s, v = s + v * h + 0.5 * u[i] * h * h, v + u[i] * h
    opti.subject_to(s == 0)
    opti.subject_to(v == 0)
    opti.subject_to(opti.bounded(-LIMIT, u, LIMIT))
    opti.subject_to(opti.bounded(-FIRST, u[0], FIRST))
    opti.subject_to(opti.bounded(-RATE * h, u[1:] - u[:-1], RATE * h))
    opti.minimize(T)
    opti.set_initial(T, 3.0)
    opti.solver("ipopt", {"print_time": False, "ipopt.print_level": 0})
    return float(opti.solve().value(T))


@pytest.mark.parametrize("engine", ["", "none", "ipopt"])
def test_no_input_changes_faster_than_its_rate(monkeypatch: pytest.MonkeyPatch, engine: str) -> None:
    plan = crane(settled(monkeypatch, engine)).plan(np.array([-1.0, 0.0]))
    assert plan.status.solved
    assert plan.decided is not None
    middles = 0.5 * (plan.times[1:] + plan.times[:-1])
    assert np.abs(np.diff(plan.u[:, 0]) / np.diff(middles)).max() <= RATE + 1e-6
    assert plan.decided["duration"] == pytest.approx(shortest(), abs=2e-3)


def test_rates_of_one_side_bind_that_side_alone() -> None:
    """There and back: what falls on the way there rises on the way back."""
    mpc = crane(sa.RealTime(iterations=0), rates=sa.Limits(a=(-RATE, np.inf)))
    there, back = (mpc.plan(np.array([s, 0.0])) for s in (-1.0, 1.0))
    assert there.status.solved
    assert back.status.solved
    fall, rise = (np.diff(plan.u[:, 0]) / np.diff(plan.times)[1:] for plan in (there, back))
    assert fall.min() == pytest.approx(-RATE, abs=1e-6)
    assert rise.max() > 2 * RATE


def test_scenarios_keep_to_them_too() -> None:
    """Each scenario has its own inputs, but the first, and all the same time."""
    found = crane(sa.RealTime(iterations=0), scenarios=sa.Scenarios({"gain": (0.8, 1.2)})).plan(np.array([-1.0, 0.0]))
    assert found.status.solved
    for branch in found.branches:
        change = np.diff(branch.u[:, 0]) / np.diff(found.times)[1:]
        assert 0.9 * RATE < np.abs(change).max() <= RATE + 1e-6


def test_phases_keep_to_them_too() -> None:
    two = [crane(terminal_limits=sa.Limits(s=(-0.5, -0.5))), crane()]
    plan = sa.Phases(two, links=[lambda x: [x[0], x[1]]]).plan(np.array([-1.0, 0.0]), [{}, {}])
    assert plan.status.solved
    for phase in plan.phases:
        change = np.diff(phase.u[:, 0]) / np.diff(phase.times)[1:]
        assert np.abs(change).max() <= RATE + 1e-6
