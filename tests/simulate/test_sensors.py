"""Sensors: each effect alone, all together, and in a plant whatever the chunks it is advanced in."""

import math

import numpy as np
import pytest

from slipangle.errors import ParameterError, SampleTimeError
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import PASSENGER_TIRE, SOUSA_CAR_7, SOUSA_TABLE_7_2
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Values
from slipangle.simulate.plant import Plant
from slipangle.simulate.sensors import Sensor, Sensors

RAMP = np.arange(100.0)
CAR = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.001))


def test_a_perfect_sensor_shows_the_truth():
    assert np.array_equal(Sensor().record(RAMP, 0.01), RAMP)


def test_bias_gain_quantum_and_range():
    assert Sensor(bias=0.5, gain=0.1).record(RAMP, 0.01) == pytest.approx(1.1 * RAMP + 0.5)
    coarse = Sensor(quantum=4.0).record(RAMP, 0.01)
    assert set(coarse % 4) == {0.0}
    assert np.abs(coarse - RAMP).max() <= 2.0
    assert Sensor(range=(10.0, 20.0)).record(RAMP, 0.01)[[0, 15, 99]].tolist() == [10.0, 15.0, 20.0]


@pytest.mark.parametrize(("interval", "delay"), [(0.05, 0.0), (0.0, 0.03), (0.05, 0.02), (0.1, 0.25)])
def test_sampling_and_delay(interval, delay):
    every, late = max(round(interval / 0.01), 1), round(delay / 0.01)
    expected = [max((k - late) // every * every, 0) for k in range(100)]
    assert Sensor(interval=interval, delay=delay).record(RAMP, 0.01).tolist() == expected


def test_noise_is_white_of_the_given_size():
    error = Sensor(noise=0.3, gain=0.5).record(np.zeros(20_000), 0.01, seed=5)
    assert error.std() == pytest.approx(0.3, rel=0.02)
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 0.03
    again = Sensor(noise=0.3).record(np.zeros(20_000), 0.01, seed=6)
    assert not np.array_equal(error, again)


def test_drift_walks_with_the_root_of_time():
    ends = [Sensor(drift=0.2).record(np.zeros(401), 0.01, seed=s)[-1] for s in range(400)]
    assert np.std(ends) == pytest.approx(0.2 * 2.0, rel=0.12)


@pytest.mark.parametrize("length", [1.0, 5.0])
@pytest.mark.parametrize("share", [0.1, 0.4])
def test_drop_outs_come_in_the_given_share_and_length(share, length):
    shown = Sensor(drop_out=share, drop_length=length, lost="nan").record(np.zeros(60_000), 0.01, seed=2)
    lost = np.isnan(shown)
    assert lost.mean() == pytest.approx(share, abs=0.03)
    bursts = np.count_nonzero(np.diff(lost.astype(int)) == 1)
    expected = length if length > 1 else 1.0
    assert lost.sum() / bursts == pytest.approx(expected, rel=0.15)
    held = Sensor(drop_out=share, drop_length=length).record(np.arange(1000.0), 0.01, seed=2)
    assert np.isfinite(held).all()
    assert (np.diff(held) >= 0).all()
    assert np.unique(held).size < 1000


@pytest.mark.parametrize("chunk", [1, 7, 40])
def test_in_a_plant_whatever_the_chunks(chunk):
    plant = Plant(
        CAR,
        sensors=Sensors(r=Sensor(interval=0.01, delay=0.003, noise=0.01), delta=Sensor(bias=0.1), X=Sensor(delay=0.02)),
        noise=Values(Y=0.1),
        seed=4,
    )
    simulation = plant.start(np.zeros(5), np.array([0.0, 20.0]))
    fine = Plant(CAR, sensors=plant.sensors, noise=plant.noise, seed=4).start(np.zeros(5), np.array([0.0, 20.0]))
    for _ in range(280 // chunk):
        simulation.advance(np.array([0.02, 20.0]), chunk)
        for _ in range(chunk):
            fine.advance(np.array([0.02, 20.0]), 1)
        seen, reference = simulation.measure(), fine.measure()
        assert seen["r"] == pytest.approx(reference["r"], rel=1e-12)
        assert seen["X"] == pytest.approx(reference["X"], rel=1e-12)
        assert seen["delta"] == pytest.approx(0.12)
        assert seen["psi"] == pytest.approx(simulation.true()["psi"])
    assert seen["X"] == pytest.approx(simulation.true()["X"] - 0.02 * 20.0, rel=1e-3)
    assert simulation.measure()["r"] == simulation.measure()["r"]


def test_outputs_that_are_no_states_are_sensed_too():
    car = DualTrack(params=SOUSA_CAR_7, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001, outputs=("a_y", "r"))
    plant = Plant(car, sensors=Sensors(a_y=Sensor(bias=1.0)), lag=Values(delta=0.05), delay=Values(delta=0.02))
    simulation = plant.start(car.straight(20.0), np.zeros(3))
    simulation.advance(np.array([0.02, 0.1, 0.0]), 400)
    assert simulation.measure()["a_y"] == pytest.approx(simulation.true()["a_y"] + 1.0, rel=1e-9)
    # delay, then lag, then the compiled car
    assert simulation.inputs[0] == pytest.approx(0.02 * -math.expm1(-0.38 / 0.05), rel=1e-9)
    assert simulation.inputs[1] == 0.1


def test_bad_input_says_what_to_do():
    with pytest.raises(ParameterError, match="noise is -1"):
        Sensor(noise=-1.0)
    with pytest.raises(ParameterError, match=r"drop_out is 1\.0; expected a number from 0 to below 1"):
        Sensor(drop_out=1.0)
    with pytest.raises(ParameterError, match="range"):
        Sensor(range=(1.0, 0.0))
    with pytest.raises(ParameterError, match="lost"):
        Sensor(lost="zero")
    with pytest.raises(ParameterError, match="nearest"):
        Plant(CAR, sensors=Sensors(rr=Sensor()))
    with pytest.raises(ParameterError, match="both name"):
        Plant(CAR, sensors=Sensors(r=Sensor()), noise=Values(r=0.1))
    with pytest.raises(ParameterError, match="expected Sensor"):
        Sensors(r=0.1)
    with pytest.raises(SampleTimeError, match="multiple"):
        Plant(CAR, sensors=Sensors(r=Sensor(interval=0.0015))).start(np.zeros(5), np.zeros(2))
