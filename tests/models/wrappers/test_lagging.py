"""`Lagging`: a lag before the equations of motion, solved by SciPy; a filter finds it, and it fades."""

import math
from dataclasses import asdict

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from slipangle.control.default_drive import default_estimator, driven_model
from slipangle.errors import ParameterError
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.lagging import Lagging
from slipangle.models.wrappers.on_ground import OnGround
from tests.oracles import vehicles

CAR = Bicycle(params=SOUSA_TABLE_7_2, dt=0.01, outputs=("v_y", "r"))
ANGLES = 0.02 * np.sign(np.sin(0.13 * np.arange(200)))


def truth(lag, angles, dt, v_x=20.0):
    """v_y, r, the angle behind the lag, psi, X and Y, after each of the angles held for dt."""
    car, x, found = asdict(SOUSA_TABLE_7_2), np.zeros(6), []
    for delta in angles:

        def rates(_, x, delta=delta):
            motion = vehicles.bicycle(car, x[0], x[1], x[2], v_x)
            return [*motion, (delta - x[2]) / lag, x[1], *vehicles.turned(x[3], v_x, x[0])]

        x = solve_ivp(rates, (0, dt), x, rtol=1e-9, atol=1e-12).y[:, -1]
        found.append(x)
    return np.array(found)


def test_it_is_a_first_order_lag_before_the_car():
    lag, model = 0.06, Lagging(CAR)
    assert model.states == ("v_y", "r", "delta_lagged", "lag_delta")
    x, found = np.array([0.0, 0.0, 0.0, lag - model.least**2 / lag]), []  # its smooth positive part is the lag
    assert float(model.lag(x)) == pytest.approx(lag, rel=1e-12)
    for delta in ANGLES:
        x[3] = lag - model.least**2 / lag
        x = np.asarray(model.step(x, np.array([delta, 20.0])))
        found.append(x[:3])
    expected = truth(lag, ANGLES, 0.01)[:, :3]
    assert np.abs(found - expected).max(axis=0) == pytest.approx([0, 0, 0], abs=2e-3 * np.abs(expected).max())
    assert np.asarray(found)[:, 2] == pytest.approx(expected[:, 2], abs=1e-9)


def test_with_no_lag_it_is_the_car_and_what_was_found_fades():
    model, x, plain = Lagging(CAR, least=1e-6), np.array([0.0, 0.0, 0.0, -0.05]), np.zeros(2)
    for delta in ANGLES:
        u = np.array([delta, 20.0])
        x, plain = np.asarray(model.step(x, u)), np.asarray(CAR.step(plain, u))
    assert x[:2] == pytest.approx(plain, rel=1e-3)
    assert x[3] == pytest.approx(-0.05 * math.exp(-200 * 0.01 / 20.0))


@pytest.mark.parametrize("lag", [0.01, 0.05])
def test_the_filter_of_a_driver_finds_it(lag):
    """Swerving with measured yaw rate and pose; the model knows no lag, and no push is made up."""
    model = driven_model(Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("r",)), 0.02)
    noise, rng = {"r": 0.002, "X": 0.02, "Y": 0.02, "psi": 0.001}, np.random.default_rng(0)
    angles = 0.015 * np.sin(2 * np.pi * 0.5 * 0.02 * np.arange(600))
    car = truth(lag, angles, 0.02)
    measured = car[:, [1, 4, 5, 3]]
    measured = measured + rng.normal(size=measured.shape) * [noise[n] for n in ("r", "X", "Y", "psi")]
    assert model.outputs == ("r", "X", "Y", "psi")
    estimator = default_estimator(model, noise, {}).start_at()
    for y, delta in zip(measured[:-1], angles[1:], strict=True):
        estimator.update(y, np.array([delta, 20.0]))
    late, x = model.model.model, estimator.state
    std = dict(zip(model.states, estimator.state_std, strict=True))["lag_delta"]
    assert std < 0.02  # 0.03 at the start
    assert float(late.lag(x[: late.n_states])) == pytest.approx(lag, abs=0.012)
    assert abs(x[model.states.index("d_r")]) < 0.02


def test_bad_input_says_what_to_do():
    with pytest.raises(ParameterError, match="no input 'T_f'"):
        Lagging(CAR, control="T_f")
    with pytest.raises(ParameterError, match="on the ground already"):
        Lagging(OnGround(CAR))
    with pytest.raises(ParameterError, match="least"):
        Lagging(CAR, least=0.0)
    with pytest.raises(ParameterError, match="fading"):
        Lagging(CAR, fading=-1.0)
