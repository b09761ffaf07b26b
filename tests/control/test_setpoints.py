"""Problems without a path: what is wanted is said by name; and many of them at once."""

from typing import Any

import numpy as np
import pytest

import slipangle as sa
from slipangle.control.mpc import MPC
from slipangle.errors import ParameterError
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.ocp import Reference
from slipangle.optimal.scenarios import Scenarios
from slipangle.optimal.terms import Limits, Weights
from tests.optimal.linear import two_masses


@pytest.fixture(scope="module")
def masses():
    """Two masses whose positions and second speed are tracked, with limits that matter."""
    return MPC(
        two_masses(),
        horizon=15,
        Q=Weights(p1=10.0, p2=10.0, v2=0.1),
        R=Weights(a1=0.01, a2=0.01),
        limits=Limits(a1=3.0, a2=3.0),
    )


def test_values_by_name_are_the_reference_of_them(masses):
    x, ramp = np.array([0.3, 0.0, -0.2, 0.1]), np.linspace(0, 1, 16)
    tracked = np.zeros((16, 3))
    tracked[:, masses.references.index("p1")] = 0.4
    tracked[:, masses.references.index("p2")] = ramp
    inputs = np.tile([1.5, 0.0], (15, 1))
    known = masses.plan(x, Reference(tracked=tracked, exogenous=np.zeros((16, 0)), inputs=inputs))
    said = masses.plan(x, p1=0.4, p2=ramp, a1=1.5)
    assert (said.u == known.u).all()
    assert np.abs(known.u - masses.plan(x, p1=0.4, p2=ramp).u).max() > 1e-3  # the wanted input counts
    later = masses.plan(said.x[1], previous=said, p1=0.4, p2=ramp, a1=1.5)
    assert (later.u == masses.plan(said.x[1], masses.setpoint(p1=0.4, p2=ramp, a1=1.5), said).u).all()


def test_the_setpoint_is_reached(masses):
    x, plan = np.zeros(4), None
    for _ in range(120):
        plan = masses.plan(x, previous=plan, p1=0.1, p2=-0.1, a1=1.0, a2=-0.5)
        x = np.asarray(masses.ocp.dynamics(x, plan.command, [])).ravel()
    assert x[[1, 3]] == pytest.approx(0.0, abs=1e-3)
    assert plan.status.solved


def test_what_is_said_is_checked(masses):
    x, reference = np.zeros(4), Reference(tracked=np.zeros((16, 3)), exogenous=np.zeros((16, 0)))
    with pytest.raises(ParameterError, match=r"'p3'.*'p1'"):
        masses.plan(x, p3=1.0)
    with pytest.raises(ParameterError, match="expected one of both"):
        masses.plan(x, reference, p1=1.0)
    with pytest.raises(ParameterError, match=r"expected \(16,\)|expected 16"):
        masses.plan(x, p1=np.zeros(9))
    with pytest.raises(ParameterError, match=r"expected \(16,\)|expected 16"):
        masses.plan(x, p1=np.zeros(15))  # a state has a value at the end too ...
    assert masses.plan(x, a1=np.zeros(15)).status.solved  # ... and an input has none
    with pytest.raises(ParameterError, match="expected a number, or 16 of them"):
        masses.plan(x, p1="far")


def test_a_pose_and_exogenous_inputs_must_be_said():
    car = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r",)))
    mpc = MPC(car, horizon=5, Q=Weights(e_y=1.0, r=1.0), S=Weights(delta=1.0), controls=("delta",))
    with pytest.raises(ParameterError, match="lacks the exogenous input"):
        mpc.setpoint(r=0.3)
    given = dict.fromkeys(mpc.exogenous, 15.0)
    with pytest.raises(ParameterError, match="lacks 'X'"):
        mpc.setpoint(r=0.3, **given)
    assert mpc.setpoint(r=0.3, X=0.0, Y=0.0, psi=0.0, **given).tracked.shape == (6, len(mpc.references))


@pytest.mark.parametrize("threads", [None, 1, 3])
def test_many_plans_are_those_of_one_after_the_other(masses, threads):
    rng = np.random.default_rng(0)
    x, applied = rng.standard_normal((40, 4)), rng.uniform(-1, 1, (40, 2))
    references = [masses.setpoint(p1=rng.uniform(-1, 1)) for _ in x]
    first = masses.plan_many(x, references, applied=applied, threads=threads)
    alone = [masses.plan(*each, applied=u) for *each, u in zip(x, references, applied, strict=True)]
    assert all((a.u == b.u).all() and a.status is b.status for a, b in zip(first, alone, strict=True))
    then = masses.plan_many(x + 0.01, references[0], first, threads=threads)
    alone = [masses.plan(s, references[0], p) for s, p in zip(x + 0.01, first, strict=True)]
    assert all((a.u == b.u).all() for a, b in zip(then, alone, strict=True))
    assert masses.plan_many(np.zeros((0, 4)), references[0], threads=threads) == []


def test_many_plans_need_one_of_each(masses):
    wanted = masses.setpoint()
    with pytest.raises(ParameterError, match=r"expected states of shape \(n, 4\)"):
        masses.plan_many(np.zeros(4), wanted)
    with pytest.raises(ParameterError, match="reference has 1 entries; expected one for each of the 2 states"):
        masses.plan_many(np.zeros((2, 4)), [wanted])
    with pytest.raises(ParameterError, match="previous has 3 entries"):
        masses.plan_many(np.zeros((2, 4)), wanted, [None] * 3)
    with pytest.raises(ParameterError, match="threads is 0"):
        masses.plan_many(np.zeros((2, 4)), wanted, threads=0)


def test_many_plans_have_names_as_one_has(masses):
    rng = np.random.default_rng(1)
    x, p1 = rng.standard_normal((5, 4)), rng.uniform(-1, 1, 5)
    course = np.linspace(0.0, 1.0, masses.horizon + 1)
    a1 = rng.uniform(-1, 1, (5, masses.horizon))
    Q = [{"p1": float(k)} for k in range(1, 6)]
    given: dict[str, Any] = {"p1": p1, "v2": 0.2, "p2": course[None], "a1": a1, "Q": Q, "R": {"a1": 2.0}}
    plans = masses.plan_many(x, threads=2, **given)
    for i, plan in enumerate(plans):
        alone = masses.plan(x[i], p1=p1[i], v2=0.2, p2=course, a1=a1[i], Q=Q[i], R={"a1": 2.0})
        assert plan.u.tobytes() == alone.u.tobytes()
    same = masses.plan_many(x, p1=0.3)
    assert same[2].u.tobytes() == masses.plan(x[2], p1=0.3).u.tobytes()
    assert (
        masses.plan_many(x[:1], p1=[0.3], p2=[course])[0].u.tobytes()
        == masses.plan(x[0], p1=0.3, p2=course).u.tobytes()
    )


def test_many_plans_refuse_names_that_do_not_fit(masses):
    x, course = np.zeros((3, 4)), np.zeros(masses.horizon + 1)
    rows = masses.horizon + 1
    with pytest.raises(ParameterError, match=f"'p1' has {rows} entries; expected one, or one for each of the 3 states"):
        masses.plan_many(x, p1=course)
    with pytest.raises(ParameterError, match="one of both"):
        masses.plan_many(x, masses.setpoint(), p1=0.3)
    with pytest.raises(ParameterError, match="the setpoint names 'p'"):
        masses.plan_many(x, p=0.3)
    with pytest.raises(ParameterError, match="the setpoint of 'p1'"):
        masses.plan_many(x, p1=[[1.0], [2.0, 3.0], 1.0])


def damped(**settings):
    model = sa.Ode(
        f=lambda x, u, p: [x[1], u[0] - p.k * x[1]],
        **{"states": ("s", "v"), "inputs": ("a",), "params": {"k": (1.0, 0.1, 5.0)}, "dt": 0.1},
    )
    return sa.MPC(model, horizon=6, controls=("a",), Q={"s": 1.0}, R={"a": 0.1}, **settings)


@pytest.mark.parametrize("given", [{"scenarios": Scenarios({"k": (0.01, 9)})}, {"free": {"k": (-1, 10)}}])
def test_parameters_keep_within_the_range_that_the_model_declares(given):
    with pytest.raises(ParameterError, match=r"for 'k'; expected values from 0\.1 to 5, the range that the model"):
        damped(**given)


def test_scenarios_of_a_plan_keep_within_the_range_too():
    controller = damped(scenarios=Scenarios({"k": (0.5, 2)}))
    with pytest.raises(ParameterError, match=r"scenarios has 0\.5 to 9 for 'k'; expected values from 0\.1 to 5"):
        controller.setpoint(s=1.0, scenarios={"k": (0.5, 9)})


def test_weights_of_another_length_are_named_as_weights():
    for what, said in (("R", r"R of 'a' has 3 entries; expected a number or 6"), ("Q", r"Q of 's' has 3 entries")):
        with pytest.raises(ParameterError, match=said):
            damped().setpoint(s=1.0, **{what: {"a" if what == "R" else "s": [1.0, 2.0, 3.0]}})


def test_a_limit_below_zero_is_refused_as_in_the_problem():
    mpc = damped(limits=Limits(a=2.0, v=1.0))
    for given in (lambda: Limits(v=-0.5), lambda: mpc.setpoint(s=1.0, limits={"v": -0.5})):
        with pytest.raises(ParameterError, match=r"the limit of 'v' is -0\.5; expected \(lower, upper\)"):
            given()
    same = [mpc.setpoint(s=1.0, limits={"v": both}).limits for both in (0.5, (-0.5, 0.5))]
    assert (same[0] == same[1]).all()
