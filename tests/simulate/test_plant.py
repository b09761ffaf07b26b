"""Plants: the model itself when nothing is added; lag, delay and noise as stated."""

import numpy as np
import pytest

from slipangle.errors import ParameterError
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2, SOUSA_TABLE_7_2
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Values
from slipangle.simulate.plant import Plant

CAR = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.001))
REST = np.zeros(5), np.array([0.0, 20.0])


def test_a_bare_plant_is_its_model():
    simulation = Plant(CAR).start(*REST)
    u = np.array([0.02, 20.0])
    x = REST[0]
    for steps in (1, 10, 7):
        simulation.advance(u, steps)
        for _ in range(steps):
            x = CAR.step(x, u)
    assert simulation.x == pytest.approx(x, rel=1e-12, abs=1e-14)
    true = simulation.true()
    assert true["r"] == simulation.x[1]
    assert true["delta"] == 0.02
    assert simulation.measure() == true


@pytest.mark.parametrize("chunk", [1, 3, 50])
def test_delay_is_a_shift(chunk):
    simulation = Plant(CAR, delay=Values(delta=0.02)).start(*REST)
    seen = []
    for k in range(150 // chunk):
        simulation.advance(np.array([float(k + 1), 20.0]), chunk)
        seen.append(simulation.inputs[0])
    # the input of the last step of chunk k was commanded 20 steps before
    expected = [max(((k + 1) * chunk - 1 - 20) // chunk + 1, 0) for k in range(150 // chunk)]
    assert seen == pytest.approx(expected)


def test_lag_is_first_order():
    simulation = Plant(CAR, lag=Values(delta=0.05)).start(*REST)
    for k in range(1, 11):
        simulation.advance(np.array([0.1, 20.0]), 20)
        assert simulation.inputs[0] == pytest.approx(0.1 * -np.expm1(-0.02 * k / 0.05), rel=1e-9)
        assert simulation.inputs[1] == 20.0


def test_noise_is_seeded_white_and_per_channel():
    def draws(n=2000, **options):
        simulation = Plant(CAR, **options).start(*REST)
        return np.array([[m["r"], m["Y"]] for m in (simulation.measure() for _ in range(n))])

    one = draws(noise=Values(r=0.1), seed=3)
    both = draws(noise=Values(r=0.1, Y=0.5), seed=3)
    assert np.array_equal(one[:, 0], both[:, 0])
    assert (one[:, 1] == 0).all()
    assert both.std(axis=0) == pytest.approx([0.1, 0.5], rel=0.06)
    assert np.abs(both.mean(axis=0)).max() < 0.05
    assert abs(np.corrcoef(both.T)[0, 1]) < 0.08
    assert not np.array_equal(one, draws(noise=Values(r=0.1), seed=4))


def test_straight():
    plant = Plant(SingleTrack(params=SOUSA_TABLE_6_1, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2, dt=0.001))
    x = plant.straight(20.0, X=1.0, Y=2.0, psi=0.3)
    simulation = plant.start(x, np.zeros(3))
    simulation.advance(np.zeros(3), 1000)
    true = simulation.true()
    assert true["v_x"] == pytest.approx(20.0, abs=1e-6)
    assert true["X"] == pytest.approx(1.0 + 20.0 * np.cos(0.3), abs=1e-4)
    assert Plant(CAR).straight(20.0, Y=2.0).tolist() == [0, 0, 0, 2, 0]


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"noise": Values(yaw=0.1)}, "noise"),
        ({"delay": Values(r=0.1)}, "delay"),
        ({"lag": Values(Delta=0.1)}, "'delta'"),
        ({"lag": Values(delta=-0.1)}, "at least 0"),
    ],
)
def test_bad_settings(options, what):
    with pytest.raises(ParameterError, match=what):
        Plant(CAR, **options)


def test_bad_start():
    plant = Plant(CAR)
    n, m = plant.model.n_states, plant.model.n_inputs
    with pytest.raises(ParameterError, match="shape"):
        plant.start(np.zeros(4), np.zeros(2))
    for name, x, inputs in (
        (plant.model.states[0], np.array([np.nan, *np.zeros(n - 1)]), np.zeros(m)),
        (plant.model.inputs[-1], np.zeros(n), np.array([*np.zeros(m - 1), np.inf])),
    ):
        with pytest.raises(ParameterError, match=f"starts from {name} = (nan|inf); expected a finite number"):
            plant.start(x, inputs)
