"""A model of many explicit steps a sample, whose code would be long: one step is compiled, and called so often."""

import casadi as ca
import numpy as np
import pytest

import slipangle as sa
from slipangle.optimal.realtime import parts, program
from slipangle.optimal.scenarios import Scenarios


def swing(substeps=12, **changed) -> dict:
    pendulum = sa.Ode(
        f=lambda x, u, p: [x[1], u[0] - u[1] - p.k * sa.ops.sin(x[0])],
        states=("angle", "rate"),
        inputs=("torque", "wind"),
        params={"k": 9.81},
        dt=0.1,
        substeps=substeps,
    )
    settings = {
        "horizon": 8,
        "controls": ("torque",),
        "Q": sa.Weights(angle=10.0, rate=1.0),
        "R": sa.Weights(torque=0.1),
        "limits": sa.Limits(torque=6.0, rate=(-1.5, 1.5)),
        "solver": sa.RealTime(iterations=0),
    }
    return {"model": pendulum, **settings, **changed}


def call_steps(monkeypatch):
    """As of a model whose steps would be long, written out."""
    monkeypatch.setattr(parts, "MOST_INSTRUCTIONS", 10)
    monkeypatch.setattr(program, "MOST_INSTRUCTIONS", 10)


def problem(**changed):
    return sa.MPC(**swing(**changed)).ocp


def test_steps_and_derivatives_are_those_written_out(monkeypatch):
    whole = parts.dynamics_function(problem())
    call_steps(monkeypatch)
    called = parts.dynamics_function(problem())
    assert whole.is_a("SXFunction")
    assert not called.is_a("SXFunction")
    given = [np.array([0.4, -0.3]), np.array([1.7]), np.array([0.2])]
    for one, other in zip(whole(*given), called(*given), strict=True):
        assert np.array(ca.DM(other)) == pytest.approx(np.array(ca.DM(one)), rel=1e-12, abs=1e-14)


def test_code_does_not_grow_with_the_steps(monkeypatch):
    call_steps(monkeypatch)
    few, many = (len(program.source(problem(substeps=n))) for n in (12, 120))
    assert many < few + 108 * 600  # characters a call


@pytest.mark.filterwarnings("ignore:no C compiler")
@pytest.mark.parametrize("qp", ["condensed", "riccati"])
@pytest.mark.parametrize("changed", [{}, {"scenarios": Scenarios({"k": (9.0, 10.5)})}], ids=["alone", "scenarios"])
def test_plans_are_the_same(monkeypatch, qp, changed):
    solver, start = sa.RealTime(iterations=0, qp=qp), np.array([0.8, 0.0])
    expected = sa.MPC(**swing(solver=solver, **changed)).plan(start, wind=0.1)
    call_steps(monkeypatch)
    plan = sa.MPC(**swing(solver=solver, **changed)).plan(start, wind=0.1)
    assert plan.status.solved
    assert plan.u == pytest.approx(expected.u, abs=1e-8)


@pytest.mark.filterwarnings("ignore:no C compiler")
def test_without_a_compiler_too(monkeypatch):
    call_steps(monkeypatch)
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    plan = sa.MPC(**swing()).plan(np.array([0.8, 0.0]), wind=0.1)
    exact = sa.MPC(**swing(solver="ipopt")).plan(np.array([0.8, 0.0]), wind=0.1)
    assert plan.status.solved
    assert plan.u == pytest.approx(exact.u, abs=1e-6)
