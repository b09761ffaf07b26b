"""A model of many explicit steps a sample, whose code would be long: one step is written out, and taken so often."""

from typing import Any

import casadi as ca
import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.models.vehicles.load_transfer import LoadTransfer
from slipangle.models.vehicles.saturating_bicycle import RelaxingBicycle, SaturatingBicycleParams
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from slipangle.models.wrappers.disturbed import Disturbed
from slipangle.models.wrappers.lagging import Lagging
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.numerics.integrate import Method
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


def car(method: Method = "rk4", substeps=6, **changed) -> dict:
    """As it is found of hard laps, with all that is put around its equations."""
    numbers = dict(mass=1000.0, inertia_z=800.0, wheelbase=2.4, l_f=1.3, C_f=6e4, C_r=1e5, mu_f=0.9, mu_r=1.0)
    params = SaturatingBicycleParams(**numbers, relaxation_f=0.5, relaxation_r=0.6)
    equations = RelaxingBicycle(params=params, dt=0.05, method=method, substeps=substeps)
    steered = Steered(LoadTransfer(equations, height=0.4), steering_lag=0.06)
    wrapped = OnGround(Disturbed(Lagging(Delayed(steered, delays={"delta": 0.07}), control="delta")))
    settings = {
        "horizon": 8,
        "controls": ("delta",),
        "Q": sa.Weights(Y=1.0, psi=1.0),
        "S": sa.Weights(delta=50.0),
        "limits": sa.Limits(delta=0.2),
        "solver": sa.RealTime(iterations=0),
    }
    return {"model": wrapped, **settings, **changed}


def moving(mpc):
    """A state that turns and slides, from which it is to go straight."""
    names = mpc.model.states
    here = {
        "v_y": -0.4,
        "r": 0.3,
        "alpha_f": 0.02,
        "alpha_r": 0.03,
        "v_x_s": 17.0,
        "delta_s": 0.05,
        "psi": 0.2,
        "Y": 0.7,
    }
    x = np.array([here.get(name, 0.0) for name in names])
    x[[i for i, name in enumerate(names) if name.startswith("delta(k")]] = 0.04
    return x


def call_steps(monkeypatch):
    """As of a model whose steps would be long, written out."""
    monkeypatch.setattr(parts, "MOST_INSTRUCTIONS", 10)
    monkeypatch.setattr(program, "MOST_INSTRUCTIONS", 10)


def write_out(monkeypatch):
    """Whatever there is to repeat."""
    monkeypatch.setattr(program, "repeated_steps", lambda ocp: None)


def problem(made=swing, **changed):
    return sa.MPC(**made(**changed)).ocp


def by_casadi(ocp, given):
    """The model's step and its derivatives, as CasADi finds them."""
    x, u, w = (ca.MX.sym(n, len(v)) for n, v in zip("xuw", given, strict=True))
    later = ocp.dynamics(x, u, w)
    whole = ca.Function("whole", [x, u, w], [later, ca.jacobian(later, x), ca.jacobian(later, u)])
    return [np.array(ca.DM(v)) for v in whole(*given)]


SCENARIOS = {"scenarios": Scenarios({"k": (9.0, 10.5)})}
SWING = [np.array([0.4, -0.3]), np.array([1.7]), np.array([0.2])]


@pytest.mark.parametrize(
    ("made", "changed"),
    [
        (swing, {}),
        (swing, {"substeps": 5}),
        (car, {}),
        (car, {"method": "euler", "substeps": 30}),
        (car, {"substeps": 3}),
    ],
    ids=["pendulum", "odd", "car", "Euler", "three"],
)
def test_steps_and_derivatives_are_those_written_out(monkeypatch, made, changed):
    ocp = problem(made, **changed)
    given = SWING if made is swing else [moving(sa.MPC(**made(**changed))), np.array([0.06]), np.array([18.0])]
    call_steps(monkeypatch)
    called = parts.dynamics_function(ocp, parts.repeated_steps(ocp))
    assert not called.is_a("SXFunction")
    for one, other in zip(by_casadi(ocp, given), called(*given), strict=True):
        assert np.array(ca.DM(other)) == pytest.approx(one, rel=1e-11, abs=1e-13)


def test_code_does_not_grow_with_the_steps():
    for made in (swing, car):
        few, many = (program.source(problem(made, substeps=n)).splitlines() for n in (12, 36))
        assert len(few) == len(many)  # another number of steps, another length of one


def test_steps_of_a_linear_model_are_one_by_another_matrix():
    """Their derivatives are numbers, and products of these too."""
    chain = sa.Ode(
        f=lambda x, u, p: [*(x[3 + i] for i in range(3)), x[1] - 2 * x[0], x[0] + x[2] - 2 * x[1], x[1] - x[2] + u[0]],
        states=(*(f"place_{i}" for i in range(3)), *(f"speed_{i}" for i in range(3))),
        inputs=("force",),
        params={"k": 1.0},
        dt=0.1,
        substeps=10,
    )
    ocp = sa.MPC(chain, horizon=5, controls=("force",), Q=sa.Weights(place_0=1.0), limits=sa.Limits(force=1.0)).ocp
    assert parts.repeated_steps(ocp) is not None
    assert "void explicit_dynamics_step(" not in program.source(ocp)
    assert "void explicit_dynamics_step(" in program.source(problem(car))


@pytest.mark.parametrize("made", [swing, car])
def test_one_step_is_written_out(made):
    assert parts.repeated_steps(problem(made, substeps=1)) is None
    two = parts.repeated_steps(problem(made, substeps=2))
    assert two is not None
    assert two.times == 2


@pytest.mark.filterwarnings("ignore:no C compiler")
@pytest.mark.parametrize("iterations", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_a_car_plans_the_same(monkeypatch, iterations):
    solver = sa.RealTime(iterations=iterations)
    mpc = sa.MPC(**car(solver=solver))
    start = moving(mpc)
    ahead: dict[str, Any] = {"v_x": 18.0, "Y": 0.0, "psi": 0.0}
    plans = [mpc.plan(start, **ahead)]
    plans.append(mpc.plan(plans[0].x[1], previous=plans[0], **ahead))
    write_out(monkeypatch)
    other = sa.MPC(**car(solver=solver))
    wanted = [other.plan(start, **ahead)]
    wanted.append(other.plan(plans[0].x[1], previous=wanted[0], **ahead))
    for plan, expected in zip(plans, wanted, strict=True):
        assert plan.status is expected.status
        assert plan.u == pytest.approx(expected.u, abs=1e-9)
        assert plan.x == pytest.approx(expected.x, abs=1e-8)


@pytest.mark.filterwarnings("ignore:no C compiler")
@pytest.mark.slow
def test_long_functions_are_compiled_with_less_effort_to_the_same_plan(monkeypatch):
    monkeypatch.setattr(compiler, "NATIVE", ("-O3", "-march=native"))  # without the optimiser there is no effort
    start = np.array([0.8, 0.0])
    effort, expected = program.source(problem()), sa.MPC(**swing()).plan(start, wind=0.1)
    monkeypatch.setattr(program, "LONG", 100)
    less, plan = program.source(problem()), sa.MPC(**swing()).plan(start, wind=0.1)
    assert effort.count('optimize("sched-pressure")') == less.count('optimize("no-schedule-insns")') == 1
    assert plan.u.tolist() == expected.u.tolist()


@pytest.mark.filterwarnings("ignore:no C compiler")
@pytest.mark.parametrize(
    ("qp", "changed"),
    [
        pytest.param("condensed", {}, id="condensed, alone"),
        pytest.param("riccati", {}, id="riccati, alone", marks=pytest.mark.slow),
        pytest.param("condensed", SCENARIOS, id="condensed, scenarios", marks=pytest.mark.slow),
        pytest.param("riccati", SCENARIOS, id="riccati, scenarios"),
    ],
)
def test_plans_are_the_same(monkeypatch, qp, changed):
    solver, start = sa.RealTime(iterations=0, qp=qp), np.array([0.8, 0.0])
    plan = sa.MPC(**swing(solver=solver, **changed)).plan(start, wind=0.1)
    write_out(monkeypatch)
    expected = sa.MPC(**swing(solver=solver, **changed)).plan(start, wind=0.1)
    call_steps(monkeypatch)
    called = sa.MPC(**swing(solver=solver, **changed)).plan(start, wind=0.1)
    for one in (plan, called):
        assert one.status.solved
        assert one.u == pytest.approx(expected.u, abs=1e-8)


@pytest.mark.filterwarnings("ignore:no C compiler")
def test_without_a_compiler_too(monkeypatch):
    call_steps(monkeypatch)
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    plan = sa.MPC(**swing()).plan(np.array([0.8, 0.0]), wind=0.1)
    exact = sa.MPC(**swing(solver="ipopt")).plan(np.array([0.8, 0.0]), wind=0.1)
    assert plan.status.solved
    assert plan.u == pytest.approx(exact.u, abs=1e-6)


@pytest.mark.filterwarnings("ignore:no C compiler")
def test_a_step_as_long_as_a_lag_forgets_where_it_began(monkeypatch):
    """Euler's step has no derivative by a state then that the steps before had one by."""
    lagged = sa.Ode(
        f=lambda x, u, p: [(x[1] - x[0]) * p.k, (u[0] - x[1]) * p.k, x[0] * x[1] + u[0] * x[2]],
        states=("a", "b", "c"),
        inputs=("f",),
        params={"k": 100.0},
        dt=0.05,
        substeps=5,
        method="euler",
    )
    settings = {"horizon": 6, "controls": ("f",), "Q": sa.Weights(c=1.0), "R": sa.Weights(f=0.01)}
    start, solver = np.array([3.0, -2.0, 0.5]), sa.RealTime(iterations=1)
    call_steps(monkeypatch)
    repeats = sa.MPC(lagged, **settings, solver=solver)
    assert "void explicit_dynamics_step(" in program.source(repeats.ocp)
    plans = [repeats.plan(start, c=0.2)]
    plans.append(repeats.plan(start + 0.3, previous=plans[0], c=0.4))
    monkeypatch.undo()
    write_out(monkeypatch)
    other = sa.MPC(lagged, **settings, solver=solver)
    wanted = [other.plan(start, c=0.2)]
    wanted.append(other.plan(start + 0.3, previous=wanted[0], c=0.4))
    for plan, expected in zip(plans, wanted, strict=True):
        assert plan.u == pytest.approx(expected.u, abs=1e-9)
