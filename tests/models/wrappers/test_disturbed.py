"""`Disturbed`: pushes what it says, by hand and against the equations of motion; steady states of a pushed car."""

import numpy as np
import pytest

from slipangle.control.targets import SteadyStates
from slipangle.errors import ParameterError
from slipangle.identify.linear.arx import ARX
from slipangle.models.vehicles.aided import RearSteered, TorqueVectored
from slipangle.models.vehicles.banked import Banked
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from slipangle.models.wrappers.disturbed import Disturbed
from slipangle.models.wrappers.on_ground import OnGround
from tests.estimate.test_ekf import drive

CAR = Bicycle(params=SOUSA_TABLE_7_2, dt=0.01, outputs=("v_y", "r"))
LATE = Delayed(Steered(CAR, steering_lag=0.05), delays={"delta": 0.02}, longest=0.04)
NOISE = {"v_y": 0.01, "r": 0.001}


def arx():
    return ARX(na=2, nb=2).fit(
        drive(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("v_y", "r")), 300, 1, noise=NOISE)
    )


@pytest.mark.parametrize("model", [CAR, LATE], ids=["bicycle", "late"])
def test_the_named_states_change_by_so_much_more(model):
    pushed, rng = Disturbed(model), np.random.default_rng(0)
    assert pushed.states == (*model.states, "d_v_y", "d_r")
    x, u = rng.standard_normal(model.n_states), np.array([0.02, 20.0])
    plain = np.asarray(model.step(x, u))
    later = np.asarray(pushed.step(np.append(x, [0.3, -0.2]), u))
    expected = plain.copy()
    expected[:2] += 0.01 * np.array([0.3, -0.2])
    assert later == pytest.approx([*expected, 0.3, -0.2], abs=1e-14)
    assert np.asarray(pushed.output(np.append(x, [0.3, -0.2]), u)) == pytest.approx(np.asarray(model.output(x, u)))


def test_lags_are_pushed_at_their_newest():
    model = arx()
    pushed = Disturbed(model)
    x, u = 0.1 * np.arange(model.n_states), np.array([0.02, 20.0])
    later, plain = np.asarray(pushed.step(np.append(x, [1.0, 2.0]), u)), np.asarray(model.step(x, u))
    assert later[: model.n_states] - plain == pytest.approx([0.05, 0.10, *np.zeros(model.n_states - 2)], abs=1e-14)


@pytest.mark.parametrize("model", [CAR, LATE, "ARX"], ids=["bicycle", "late", "ARX"])
def test_a_steady_state_is_one(model):
    """The steering that is said, held, brings the pushed model to the yaw rate and side slip that are said."""
    model = arx() if model == "ARX" else model
    pushed, d = Disturbed(model), np.array([0.4, -0.1])
    targets = SteadyStates(OnGround(pushed))
    assert [pushed.states[i] for i in targets.disturbances] == ["d_v_y", "d_r"]
    v_y, delta = targets(20.0, np.array([0.1]), d)
    x = np.append(np.zeros(model.n_states), d)
    for _ in range(2500):
        x = pushed.functions[0](x, [delta[0], 20.0]).full()[:, 0]
    y = np.asarray(pushed.output(x, np.array([delta[0], 20.0])))
    assert y == pytest.approx([v_y[0], 0.1], abs=1e-8)


def test_a_steady_state_is_one_with_what_is_measured_around_the_car():
    aided = Steered(Banked(TorqueVectored(RearSteered(CAR))), steering_lag=0.05)
    model = Delayed(aided, delays={"delta": 0.02, "delta_r": 0.01}, longest=0.04)
    pushed, around = Disturbed(model), {"delta_r": 0.015, "M_z": 900.0, "bank": 1e-4}
    targets = SteadyStates(OnGround(pushed))
    assert {pushed.inputs[i] for i in targets.measured} == {*around}
    d = np.array([0.2, -0.05, *(around[pushed.inputs[i]] for i in targets.measured)])
    v_y, delta = targets(20.0, np.array([0.1]), d)
    x, known = np.append(np.zeros(model.n_states), d[:2]), around | {"delta": delta[0], "v_x": 20.0}
    u = np.array([known[n] for n in pushed.inputs])
    for _ in range(2500):
        x = pushed.functions[0](x, u).full()[:, 0]
    assert np.asarray(pushed.output(x, u)) == pytest.approx([v_y[0], 0.1], abs=1e-6)
    straight, _ = targets(20.0, np.array([0.1]), np.append(d[:2], np.zeros(3)))
    assert v_y[0] - straight[0] == pytest.approx(0.015 * 20.0, abs=0.1)


def test_the_steady_state_of_the_bicycle_is_that_of_the_understeer_gradient():
    p = SOUSA_TABLE_7_2
    targets = SteadyStates(CAR)
    v, r = 25.0, 0.08
    l_r = p.wheelbase - p.l_f
    gradient = p.mass * (l_r / p.C_f - p.l_f / p.C_r) / p.wheelbase
    v_y, delta = targets(v, np.array([r]), np.zeros(0))
    assert delta[0] == pytest.approx(p.wheelbase * r / v + gradient * v * r, rel=2e-3)  # between two table speeds
    assert v_y[0] == pytest.approx(l_r * r - p.mass * p.l_f * v**2 * r / (p.wheelbase * p.C_r), rel=5e-3)


def test_bad_input_says_what_to_do():
    with pytest.raises(ParameterError, match="no state 'p'"):
        Disturbed(CAR, on=("p",))
    with pytest.raises(ParameterError, match="each once"):
        Disturbed(CAR, on=("r", "r"))
    with pytest.raises(ParameterError, match="on the ground already"):
        Disturbed(OnGround(CAR))
    with pytest.raises(ParameterError, match="an input 'T_f'"):
        SteadyStates(CAR, "T_f")
