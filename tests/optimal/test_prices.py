"""Inputs that cost in proportion alone, or nearly so: a program without curvature has an answer all the same."""

import numpy as np
import pytest
from scipy.optimize import linprog

from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.mpc import MPC
from slipangle.models.custom import Ode
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime import RealTime, backend
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights

STAGES, DT = 20, 0.2


@pytest.fixture(params=["condensed", "riccati", "interpreted"])
def solver(request, monkeypatch):
    if request.param == "interpreted":
        monkeypatch.setattr(backend, "compiler", lambda: None)
        return RealTime(iterations=0)
    if compiler() is None:
        pytest.skip(sentence())
    return RealTime(iterations=0, qp=request.param)


def least_fuel(start):
    """The sum of the inputs' sizes, the last one counted at the end too, by linear programming."""
    A, B = np.array([[1.0, DT], [0.0, 1.0]]), np.array([0.5 * DT**2, DT])
    columns = np.array([np.linalg.matrix_power(A, STAGES - 1 - i) @ B for i in range(STAGES)]).T
    price = np.append(np.ones(STAGES - 1), 2.0)
    free = np.array([1.0, 0.0]) - np.linalg.matrix_power(A, STAGES) @ start
    return linprog(np.tile(price, 2), A_eq=np.hstack([columns, -columns]), b_eq=free, bounds=(0.0, 1.0)).fun


@pytest.mark.filterwarnings("ignore::slipangle.errors.ModelWarning")
def test_least_fuel_is_found_however_little_the_square_of_an_input_costs(solver):
    """Stalled or failed before, at 1e-9 and less: forces of prices that balance each other leave few digits."""
    mpc = MPC(
        Ode(f=lambda x, u, p: [x[1], u[0]], states=("s", "v"), inputs=("a",), params={}, dt=DT),
        horizon=STAGES,
        Q={},
        R=Weights(a=1e-3),
        terms={"fuel": lambda x, u, p: u[0]},
        limits=Limits(a=1.0, fuel=(0.0, 0.0)),
        slack_linear=Weights(fuel=1.0),
        terminal_limits=Limits(s=(1.0, 1.0), v=(0.0, 0.0)),
        solver=solver,
    )
    for start in ([0.0, 0.0], [0.3, -0.2]):
        least = least_fuel(np.array(start))
        for weight in (1e-9, 1e-10, 1e-12, 0.0):
            plan = mpc.plan(np.array(start), R={"a": weight})
            assert plan.status is Status.SOLVED
            assert least - 1e-9 < plan.cost < least + STAGES * weight + 1e-9


def unstable(solver):
    """Two inputs hold a plant that flees a millionfold within the horizon at zero, which costs in proportion alone."""
    return MPC(
        Ode(
            f=lambda x, u, p: [5.0 * x[0] + x[1] + u[0], 2.0 * x[1] + u[1]],
            states=("a", "b"),
            inputs=("u", "v"),
            params={},
            dt=0.05,
        ),
        horizon=60,
        Q={},
        R=Weights(u=1e-6, v=1e-6),
        limits=Limits(u=10.0, v=10.0, a=(0.0, 0.0)),
        slack_linear=Weights(a=1.0),
        solver=solver,
    )


@pytest.mark.skipif(compiler() is None, reason=sentence())
def test_a_price_is_the_measure_of_an_unstable_plant_whose_inputs_cost_next_to_nothing():
    """Failed before: an interior point began far below the price, and forces that balance each other left no digits."""
    ours, theirs = (unstable(solver) for solver in (RealTime(iterations=0), Ipopt(tolerance=1e-12)))
    for start in ([0.9, 0.3], [-0.8, 0.6]):
        plan, reference = (mpc.plan(np.array(start)) for mpc in (ours, theirs))
        assert plan.status is reference.status is Status.SOLVED
        assert plan.cost == pytest.approx(reference.cost, rel=1e-8)
