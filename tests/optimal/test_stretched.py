"""A free duration stretches the integrator's steps: where they miss the equations, that is said."""

import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import slipangle as sa
from slipangle.errors import ModelWarning
from slipangle.ops import sin


def swing_up(substeps, duration=(0.2, 15.0), **more):
    """A pendulum that little torque swings to 2 rad, with as long a time as it likes."""
    model = sa.Ode(
        f=lambda x, u, p: [x[1], -p.g * sin(x[0]) + u[0]],
        states=("a", "b"),
        inputs=("F",),
        params={"g": 9.81},
        dt=0.01,
        substeps=substeps,
    )
    return sa.MPC(
        model,
        horizon=20,
        controls=("F",),
        Q={},
        R=sa.Weights(F=1.0),
        terminal=sa.Weights(duration=0.01),
        limits=sa.Limits(F=1.5),
        terminal_limits=sa.Limits(a=(2.0, np.inf)),
        duration=duration,
        solver=sa.Ipopt(max_iterations=2000),
        **more,
    )


def true_end(plan):
    """Where the equations are led by the inputs of a plan."""
    x, h = np.zeros(2), plan.decided["duration"] / 20
    for (force,) in plan.u:
        x = solve_ivp(lambda t, x, f=force: [x[1], -9.81 * np.sin(x[0]) + f], (0, h), x, rtol=1e-10, atol=1e-12).y[
            :, -1
        ]
    return x


def test_steps_that_miss_the_equations_are_said_with_what_to_do():
    with pytest.warns(ModelWarning, match="the duration makes stages of .* s, each one step of the integrator") as said:
        plan = swing_up(1).plan(np.zeros(2), duration=5.0)
    assert plan.status.solved
    assert np.abs(true_end(plan) - plan.x[-1]).max() > 0.3
    sentence = str(said[0].message)
    assert sentence in plan.message
    wanted = int(sentence.partition("substeps=")[2].partition(" ")[0])
    assert wanted == np.ceil(plan.decided["duration"] / 20 / 0.01)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        better = swing_up(wanted).plan(np.zeros(2), duration=5.0)
    assert better.status.solved
    assert true_end(better) == pytest.approx(better.x[-1], abs=1e-3)


def test_with_free_parameters_and_other_inputs_the_equations_are_the_same():
    free = swing_up(50, free=sa.Limits(g=(9.0, 9.5)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert free.plan(np.zeros(2), duration=5.0).status.solved


def test_stages_no_longer_than_the_models_steps_are_not_looked_at():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plan = swing_up(1, duration=(0.05, 0.2)).plan(np.array([1.9, 2.0]), duration=0.2)
    assert plan.decided["duration"] <= 0.2


def test_phases_say_which_one():
    phases = sa.Phases([swing_up(1).ocp, swing_up(1).ocp], solver=sa.Ipopt(max_iterations=2000))
    start = [swing_up(1).guess(decided={"duration": 8.5}), swing_up(1).guess(decided={"duration": 8.5})]
    with pytest.warns(ModelWarning) as said:
        phases.plan(np.zeros(2), [{"duration": 5.0}] * 2, start)
    told = [str(warning.message).partition(" stages of")[0] for warning in said]
    assert told == ["phase 0: the duration makes", "phase 1: the duration makes"]


def runge_kutta(x, force, g, h):
    """One classical step of the pendulum."""

    def f(x):
        return np.array([x[1], -g * np.sin(x[0]) + force])

    k1 = f(x)
    k2 = f(x + h / 2 * k1)
    k3 = f(x + h / 2 * k2)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3))


@pytest.mark.parametrize(("told", "bent"), [(None, 1), ((9.81, 0.0), 0)], ids=["the problem's", "the plan's"])
def test_the_scenario_whose_equations_are_missed_is_named(told, bent):
    """The one with gravity: without, a step is exact however long it is. What is missed is that of four steps."""
    mpc = swing_up(1, scenarios=sa.Scenarios({"g": (0.0, 9.81)}))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        plan = mpc.plan(np.zeros(2), **({} if told is None else {"scenarios": {"g": told}}))
    assert plan.status.solved
    named, _, sentence = plan.detail.partition(": the duration makes stages of")
    assert named == f"scenario {bent}"
    branch, h, missed = plan.branches[bent], plan.decided["duration"] / 20, 0.0
    for start, (force,) in zip(branch.x, branch.u, strict=False):
        once, fine = runge_kutta(start, force, 9.81, h), start
        for _ in range(4):
            fine = runge_kutta(fine, force, 9.81, h / 4)
        missed = missed + np.abs(fine - once)
    said, _, name = sentence.partition("by ")[2].partition(" of '")
    assert float(said) == pytest.approx(missed["ab".index(name[0])], rel=1e-2)
