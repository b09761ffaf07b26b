"""`MPC.guess`: a plan begins where its caller says, in states, inputs and what is decided once."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ParameterError
from slipangle.optimal.engine import Engine
from slipangle.optimal.solution import Solution, Status
from tests.optimal.oscillator import START, van_der_pol

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler")
ENGINES = ["", "none", "ipopt"]
N = 10


def settled(monkeypatch: pytest.MonkeyPatch, engine: str) -> Any:
    """A solver to convergence: compiled, without a compiler, or Ipopt."""
    if engine == "none":
        monkeypatch.setenv("SLIPANGLE_CC", engine)
    return sa.Ipopt(tolerance=1e-10) if engine == "ipopt" else sa.RealTime(iterations=0)


def mass(**settings: Any) -> sa.MPC:
    model = sa.Ode(f=lambda x, u, p: [x[1], u[0]], states=("s", "speed"), inputs=("a",), params={}, dt=0.1)
    posed: dict[str, Any] = {
        "horizon": N,
        "Q": sa.Weights(s=1.0),
        "R": sa.Weights(a=0.1),
        "limits": sa.Limits(a=2.0),
        **settings,
    }
    return sa.MPC(model, **posed)


def timed(solver: Any = "realtime") -> sa.MPC:
    """From rest to rest in the shortest time."""
    return mass(
        Q={},
        R=sa.Weights(a=1e-4),
        terminal=sa.Weights(duration=1.0),
        terminal_limits=sa.Limits(s=(0.0, 0.0), speed=(0.0, 0.0)),
        duration=(0.5, 10.0),
        solver=solver,
    )


def wells(solver: Any) -> sa.MPC:
    """A free parameter with an optimum on either side of zero."""
    return mass(
        parameters=("side",),
        free=sa.Limits(side=2.0),
        terms={"well": lambda x, u, p: p.side**2 - 1.0},
        Q=sa.Weights(s=1.0, well=1.0),
        solver=solver,
    )


class Recorder(Engine):
    """A solver from outside that keeps what it was to start from, and answers that."""

    def build(self, ocp: Any, deadline: float | None) -> Engine:
        return self

    def solve(self, start: Any) -> Solution:
        self.start = start
        return Solution(u=start.guess_u, x=start.guess_x, status=Status.SOLVED, cost=0.0, iterations=1, violation=0.0)


def begun(start: dict[str, Any], x: Any = (1.0, 0.5), applied: Any = None, **settings: Any) -> Any:
    """What a solver is to begin with."""
    mpc = mass(solver=Recorder(), **settings)
    mpc.plan(np.array(x), previous=mpc.guess(**start), applied=applied)
    engine: Any = mpc.engine
    return engine.start


# ---- what a solve begins with --------------------------------------------------------------------------------------


def test_arrays_are_what_a_plan_begins_with_without_a_shift():
    x, u = np.arange(2.0 * (N + 1)).reshape(N + 1, 2), np.linspace(-1.0, 1.0, N)[:, None]
    start = begun({"x": x, "u": u})
    assert start.guess_u == pytest.approx(u)
    assert start.guess_x[1:] == pytest.approx(x[1:])
    assert start.guess_x[0] == pytest.approx([1.0, 0.5])


def test_names_that_are_not_said_stay_and_inputs_are_held():
    start = begun({"x": {"s": np.linspace(1.0, 0.0, N + 1)}}, applied=[0.7])
    assert start.guess_x[:, 0] == pytest.approx(np.linspace(1.0, 0.0, N + 1))
    assert start.guess_x[:, 1] == pytest.approx(0.5)
    assert start.guess_u == pytest.approx(0.7)


def test_inputs_lead_to_their_states_within_limits_and_rates():
    start = begun({"u": {"a": 3.0}}, x=(0.0, 0.0), rates=sa.Limits(a=10.0))
    assert start.guess_u[:, 0] == pytest.approx([1.0, *[2.0] * (N - 1)])
    assert start.guess_x[:3, 1] == pytest.approx([0.0, 0.1, 0.3])
    assert start.guess_x[-1, 1] == pytest.approx(0.1 + 0.2 * (N - 1))


@pytest.mark.parametrize("ends", [{"x": [[5.0, 0.5], [2.0, 1.5]]}, {"x": {"s": (5.0, 2.0), "speed": [0.5, 1.5]}}])
def test_two_states_have_a_straight_line_between_them_in_time(ends):
    steps = (1, 1, *[2] * (N - 2))
    times = np.concatenate([[0.0], np.cumsum(steps)])
    start = begun(ends, steps=steps)
    assert start.guess_x[1:, 0] == pytest.approx((5.0 - 3.0 * times / times[-1])[1:])
    assert start.guess_x[1:, 1] == pytest.approx((0.5 + times / times[-1])[1:])


def test_states_that_are_no_numbers_stay_where_they_are():
    model = sa.Ode(f=lambda x, u, p: [x[0] ** 9 + u[0]], states=("s",), inputs=("a",), params={}, dt=0.1)
    mpc = sa.MPC(model, horizon=N, Q=sa.Weights(s=1.0), R=sa.Weights(a=1.0), solver=Recorder())
    mpc.plan(np.array([1e4]), previous=mpc.guess(u={"a": 1.0}))
    engine: Any = mpc.engine
    assert engine.start.guess_x == pytest.approx(1e4)


# ---- where it leads ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
def test_the_optimum_leads_to_itself_at_once(monkeypatch, engine):
    mpc = van_der_pol(100, settled(monkeypatch, engine))
    cold = mpc.plan(START)
    for start in (mpc.guess(x=cold.x, u=cold.u), mpc.guess(u=cold.u)):
        plan = mpc.plan(START, previous=start)
        assert plan.status.solved
        assert plan.u == pytest.approx(cold.u, abs=1e-5)
        assert plan.iterations < cold.iterations
        assert engine == "ipopt" or plan.iterations <= 3


@pytest.mark.parametrize("engine", ENGINES)
def test_an_obstacle_is_passed_on_the_side_where_the_start_is(monkeypatch, engine):
    model = sa.Ode(
        f=lambda x, u, p: [1.0 + 0 * x[0], x[2], u[0]], states=("X_b", "Y_b", "v"), inputs=("a",), params={}, dt=0.2
    )
    mpc = sa.MPC(
        model,
        horizon=20,
        Q=sa.Weights(Y_b=0.1),
        R=sa.Weights(a=0.1),
        terms={"clear": lambda x, u, p: (x[0] - 2.0) ** 2 + x[1] ** 2},
        limits=sa.Limits(a=5.0, clear=(0.25, np.inf)),
        slack_linear=sa.Weights(clear=100.0),
        solver=settled(monkeypatch, engine),
    )
    bow = np.sin(np.linspace(0.0, np.pi, 21))
    plans = [
        mpc.plan(np.zeros(3), previous=mpc.guess(x={"X_b": (0.0, 4.0), "Y_b": side * bow})) for side in (1.0, -1.0)
    ]
    assert all(plan.status.solved for plan in plans)
    assert plans[0].x[10, 1] > 0.49
    assert plans[1].x[:, 1] == pytest.approx(-plans[0].x[:, 1], abs=1e-5)


# ---- what is decided once ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_free_parameter_begins_where_it_is_said(monkeypatch, engine, side):
    mpc, x = wells(settled(monkeypatch, engine)), np.array([1.0, 0.0])
    plan = mpc.plan(x, previous=mpc.guess(decided={"side": 1.5 * side}))
    assert plan.status.solved
    assert plan.decided == {"side": pytest.approx(side, abs=1e-4)}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_what_a_written_plan_decides_is_begun_with(monkeypatch, engine, side):
    mpc, x = wells(settled(monkeypatch, engine)), np.array([1.0, 0.0])
    other = mpc.plan(x, previous=mpc.guess(decided={"side": -1.5 * side}))
    mine = replace(other, decided={"side": 1.5 * side}, memory=None)
    assert mpc.plan(x, previous=mine).decided == {"side": pytest.approx(side, abs=1e-4)}


@pytest.mark.parametrize("engine", ENGINES)
def test_inputs_lead_through_the_duration_that_is_said(monkeypatch, engine):
    mpc, x = timed(settled(monkeypatch, engine)), np.array([-1.0, 0.0])
    cold = mpc.plan(x)
    assert cold.status.solved
    assert mpc.engine.roll_out(x, cold.u, mpc.setpoint(), cold.decided or {}) == pytest.approx(cold.x, abs=1e-6)
    plan = mpc.plan(x, previous=mpc.guess(u=cold.u, decided=cold.decided))
    assert plan.decided == {"duration": pytest.approx(np.sqrt(2.0), abs=1e-3)}
    assert plan.iterations < cold.iterations


def test_scenarios_begin_with_one_start():
    known = sa.Scenarios({"push": (0.0, 0.2)})
    mpc = mass(
        parameters=("push",), terms={"pushed": lambda x, u, p: x[0] + p.push}, Q={"pushed": 1.0}, scenarios=known
    )
    x = np.array([1.0, 0.0])
    cold = mpc.plan(x)
    plan = mpc.plan(x, previous=mpc.guess(u=cold.u))
    assert plan.status.solved
    for one, other in zip(plan.branches, cold.branches, strict=True):
        assert one.u == pytest.approx(other.u, abs=1e-7)


# ---- beside plans --------------------------------------------------------------------------------------------------


def test_many_plans_have_a_start_each():
    mpc = mass(solver=sa.RealTime(iterations=0))
    x = np.array([[1.0, 0.0], [-1.0, 0.0]])
    starts = [mpc.guess(u={"a": -1.0}), None]
    plans = mpc.plan_many(x, mpc.setpoint(), starts, threads=1)
    for i, plan in enumerate(plans):
        assert plan.u.tobytes() == mpc.plan(x[i], mpc.setpoint(), starts[i]).u.tobytes()


def test_preparing_for_a_start_only_builds():
    mpc = mass()
    mpc.prepare(mpc.setpoint(), mpc.guess(u={"a": 0.0}))
    assert mpc.plan(np.zeros(2), previous=mpc.guess(u={"a": 0.0})).status.solved


def test_a_state_that_is_no_number_has_no_plan_behind_a_start():
    mpc = mass()
    plan = mpc.plan(np.array([np.nan, 0.0]), previous=mpc.guess(u={"a": 1.0}))
    assert plan.status is Status.NOT_FINITE
    assert plan.stopping
    assert np.isfinite(plan.u).all()


WRONG = {
    "nothing": ({}, "guess() is given nothing; expected states x, inputs u or decided values: name one"),
    "shape": ({"x": np.zeros((N, 2))}, f"x of the guess has shape ({N}, 2); expected ({N + 1}, 2): ['s', 'speed']"),
    "inputs": ({"u": np.zeros(N)}, f"u of the guess has shape ({N},); expected ({N}, 1): ['a']"),
    "column": ({"x": {"s": [1.0] * 3}}, f"x of the guess for 's' has 3 entries; expected {N + 1}: ['s']"),
    "no state": ({"x": {"sped": 1.0}}, "x of the guess names 'sped'; "),
    "no input": ({"u": {"s": 1.0}}, "u of the guess names 's'; "),
    "nan": ({"x": {"s": np.nan}}, "x of the guess is nan for 's' in row 0; expected finite numbers"),
    "infinite": (
        {"u": [[1.0]] * (N - 1) + [[np.inf]]},
        f"u of the guess is inf for 'a' in row {N - 1}; expected finite",
    ),
    "text": ({"u": {"a": "full"}}, "u of the guess for 'a' is 'full'; expected real numbers"),
    "no duration": ({"decided": {"duration": 2.0}}, "decided of the guess names 'duration', but the problem decides"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_start_is_refused_in_a_sentence(name):
    given, said = WRONG[name]
    with pytest.raises(ParameterError) as error:
        mass().guess(**given)
    assert str(error.value).startswith(said)


@pytest.mark.parametrize(
    ("decided", "said"),
    [
        ({"time": 2.0}, "decided of the guess names 'time'; "),
        (
            {"duration": 20.0},
            "decided of the guess is 20.0 for 'duration'; expected a number within its limits, 0.5 to 10",
        ),
        ({"duration": np.nan}, "decided of the guess is nan for 'duration'; expected a number"),
        ({"duration": "long"}, "decided of the guess is 'long' for 'duration'; expected a number"),
        (2.0, "decided of the guess is 2.0; expected values by name"),
    ],
)
def test_what_cannot_be_decided_is_refused_in_a_sentence(decided, said):
    with pytest.raises(ParameterError) as error:
        timed().guess(decided=decided)
    assert str(error.value).startswith(said)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (mass(horizon=N + 1).guess(u={"a": 0.0}), f"the guess is of another horizon; expected one of {N} stages"),
        (timed().guess(decided={"duration": 1.0}), "the guess names 'duration'; "),
        (van_der_pol(N, "realtime").guess(x=np.zeros((2, 2))), "the guess is of a problem with the states ['"),
    ],
)
def test_the_start_of_another_problem_is_refused_in_a_sentence(other, said):
    with pytest.raises(ParameterError) as error:
        mass().plan(np.zeros(2), previous=other)
    assert str(error.value).startswith(said)
