"""Switched MPC: the criterion, no chattering, and the same answer as the controller that is active."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.control.mpc import MPC
from slipangle.control.switched import SideBySide, SwitchedMPC
from slipangle.errors import ParameterError
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.multi_arx import MultiARXModel
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.ocp import Reference
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths.lane_change import lane_changes
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler was found")  # what it decides is the same without

V = 15.0
BICYCLE = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r", "v_y")))
SETTINGS = {
    "horizon": 10,
    "Q": Weights(e_y=100.0),
    "S": Weights(delta=1000.0),
    "limits": Limits(delta=0.35),
}


def arx():
    base = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("v_y", "r"))
    A = np.column_stack([base.step(e, np.array([0.0, V])) for e in np.eye(2)])
    B = base.step(np.zeros(2), np.array([1.0, V]))
    return ARXModel(A=-A[None], B=B[None, :, None], dt=0.05, inputs=("delta",), outputs=("v_y", "r"))


CALM = MultiARXMPC(OnGround(MultiARXModel(models=(arx(),), speeds=(V,))), **SETTINGS)
LIMIT = MPC(BICYCLE, solver="realtime", **SETTINGS)
SWITCHED = SwitchedMPC(CALM, LIMIT, enter=0.3, leave=0.2, dwell=5)


def bend(curvature, s=0.0):
    along = V * 0.05 * np.arange(11)
    psi = curvature * along
    X = np.sin(psi) / curvature if curvature else along
    Y = (1 - np.cos(psi)) / curvature if curvature else 0 * along
    return Reference(tracked=np.column_stack([X, Y, psi]), exogenous=np.full((10, 1), V))


def state(r=0.0):
    x = np.zeros(SWITCHED.model.n_states)
    for name in ("r", "r'"):
        x[SWITCHED.model.states.index(name)] = r
    return x


def test_side_by_side_each_model_is_itself():
    model = SWITCHED.model
    rng = np.random.default_rng(0)
    x, u, y = rng.standard_normal(model.n_states), np.array([0.05, V]), rng.standard_normal(5)
    a, b = model.split(x)
    assert model.step(x, u) == pytest.approx(np.concatenate([CALM.model.step(a, u), BICYCLE.step(b, u)]))
    corrected = model.correct(x, u, y)  # outputs v_y, r, X, Y, psi; the bicycle lists r first
    assert corrected[len(a) :] == pytest.approx([y[0], y[1], *y[2:]])
    assert np.asarray(model.functions[2](x, u, y)).ravel() == pytest.approx(corrected)
    assert model.output(x, u) == pytest.approx(CALM.model.output(a, u))


def test_the_criterion_is_grip_needed_over_grip():
    need = V**2 * 0.02 / 9.81
    assert SWITCHED.demand(state(), bend(0.02), None) == pytest.approx(need, rel=1e-2)
    assert replace(SWITCHED, friction=0.5).demand(state(), bend(0.02), None) == pytest.approx(2 * need, rel=1e-2)
    assert SWITCHED.demand(state(r=0.4), bend(0.0), None) == pytest.approx(V * 0.4 / 9.81)
    assert SWITCHED.demand(state(r=np.nan), bend(0.0), None) == np.inf


def test_it_switches_with_a_gap_and_a_dwell():
    x, plan, seen = state(), None, []
    curvatures = [0.0] * 5 + [0.02] * 3 + [0.011] * 20 + [0.0] * 15 + [0.002] * 5  # 0.46, then 0.25 between the two
    for k in curvatures:
        plan = SWITCHED.plan(x, bend(k), plan)
        assert plan.status.solved
        seen.append(plan.active)
    assert seen[:5] == [0] * 5
    assert seen[5:28] == [1] * 23
    assert seen[28:33] == [1] * 5
    assert seen[-5:] == [0] * 5
    assert np.count_nonzero(np.diff(seen)) == 2


def test_each_plans_as_it_would_alone():
    x = state()
    calm = SWITCHED.plan(x, bend(0.001))
    assert calm.active == 0
    assert calm.u == pytest.approx(CALM.plan(SWITCHED.model.split(x)[0], bend(0.001)).u)
    hard = SWITCHED.plan(x, bend(0.03))
    assert hard.active == 1
    assert hard.u == pytest.approx(LIMIT.plan(SWITCHED.model.split(x)[1], bend(0.03)).u, abs=1e-9)


def test_it_drives_a_lane_change_and_comes_back():
    path = lane_changes(V, offsets=(3.5,), change=40.0, hold=60.0)  # up to 0.29 g
    controller = replace(SWITCHED, enter=0.2, leave=0.12)
    plant = Plant(OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.01, outputs=("v_y", "r"))))
    run = closed_loop(plant, controller, path)
    active = [p.active for p in run.plans]
    assert active[0] == active[-1] == 0
    assert max(active) == 1
    assert np.count_nonzero(np.diff(active)) <= 4
    assert run.max("y") < 0.2


def test_never_nan():
    plan = SWITCHED.plan(state(), bend(0.001))
    for x in (state() * np.nan, state()):
        plan = SWITCHED.plan(x, bend(0.001), plan)
        assert np.isfinite(plan.u).all()
    assert plan.status.solved or plan.status is Status.NOT_FINITE


def test_a_reference_with_weights_of_its_own_is_refused():
    """As the calm controller has no place for them."""
    with pytest.raises(ParameterError, match=r"the reference has S of its own; expected none: .* keeps"):
        SWITCHED.plan(state(), LIMIT.vary(bend(0.001), S={"delta": 3.0}))


def test_bad_settings_say_what_to_do():
    with pytest.raises(ParameterError, match="horizon"):
        SwitchedMPC(CALM, replace(LIMIT, horizon=5))
    with pytest.raises(ParameterError, match="leave"):
        replace(SWITCHED, leave=0.5)
    with pytest.raises(ParameterError, match="e_y"):
        SwitchedMPC(replace(LIMIT, Q=Weights(Y=1.0)), replace(LIMIT, Q=Weights(Y=1.0)))
    with pytest.raises(ParameterError, match="differ"):
        SideBySide(BICYCLE, Bicycle(params=SOUSA_TABLE_7_2, dt=0.05))


def test_a_calm_controller_keeps_its_offsets():
    """What it believes of a steady error grows from step to step, as it does alone; a change of turns forgets it."""
    calm = replace(CALM, integral=0.2)
    both, x, alone, plan = replace(SWITCHED, calm=calm), state(), None, None
    x[SWITCHED.model.states.index("v_y")] = 0.05
    for _ in range(6):
        alone = calm.plan(SWITCHED.model.split(x)[0], bend(0.0), alone)
        plan = both.plan(x, bend(0.0), plan)
        assert plan.active == 0
        assert np.array_equal(plan.u, alone.u)
    assert np.abs(alone.offset).max() > 0.005
    assert both.plan(x, bend(0.03), plan).active == 1
