"""Speed driver: poles where they were put, anti-windup, schedule, limits."""

import numpy as np
import pytest

from slipangle.control.speed.driver import DriverState, SpeedDriver
from slipangle.errors import ParameterError
from slipangle.optimal.terms import Values

CAR = SpeedDriver.for_car(mass=1500.0, radius=0.3, limits=(-3000.0, 2000.0))


def drive(driver, wanted, seconds, v=10.0, mass=1500.0, radius=0.3, load=0.0):
    """Speeds and outputs of a point mass."""
    state, speeds, outputs = DriverState(), [], []
    for k in range(round(seconds / driver.dt)):
        output, state = driver.step(state, wanted(k * driver.dt), v)
        v += driver.dt * (output / radius - load) / mass
        speeds.append(v)
        outputs.append(output)
    return np.array(speeds), np.array(outputs)


def test_small_steps_follow_the_second_order_design():
    bandwidth = 2.0
    speeds, outputs = drive(CAR, lambda t: 10.5, 6.0)
    t = CAR.dt * np.arange(1, len(speeds) + 1)
    # critically damped PI on an integrator: e = (1 - w t) exp(-w t) of the step
    expected = 10.5 - 0.5 * (1 - bandwidth * t) * np.exp(-bandwidth * t)
    assert np.abs(outputs).max() < 2000.0
    assert speeds == pytest.approx(expected, abs=0.01)


def test_a_steady_load_leaves_no_error():
    speeds, _ = drive(CAR, lambda t: 10.0, 20.0, load=600.0)
    assert speeds[-1] == pytest.approx(10.0, abs=1e-4)


@pytest.mark.parametrize("target", [40.0, 0.0])
def test_saturation_does_not_wind_up(target):
    speeds, outputs = drive(CAR, lambda t: target, 40.0, v=20.0)
    low, high = CAR.limits
    assert outputs.min() >= low
    assert outputs.max() <= high
    assert (outputs == (high if target > 20 else low)).sum() > 100  # it does saturate
    overshoot = (speeds.max() - target) if target > 20 else (target - speeds.min())
    assert overshoot < 0.15 * abs(target - 20.0) / 2
    assert speeds[-1] == pytest.approx(target, abs=1e-3)


def test_drive_and_brake_keep_to_what_the_tires_leave():
    low, high = CAR.limits
    for grip, most, least in (
        (1.0, high, low),
        (0.6, 0.6 * high, 0.6 * low),
        (0.1, 0.1 * high, 0.3 * low),
        (-1.0, 0.0, 0.3 * low),
    ):
        assert CAR.step(DriverState(), 40.0, 10.0, grip=grip)[0] == pytest.approx(most)
        assert CAR.step(DriverState(), 0.0, 40.0, grip=grip)[0] == pytest.approx(least)
    state = DriverState()
    for _ in range(2000):  # held back for 20 s, it does not store up what it would have liked to do
        _, state = CAR.step(state, 12.0, 10.0, grip=0.0)
    assert CAR.step(state, 10.0, 10.0)[0] < 0.1 * high


def test_gains_are_scheduled():
    driver = SpeedDriver(kp=(100.0, 300.0), ki=(0.0, 0.0), speeds=(0.0, 20.0), limits=(-1e4, 1e4))
    for v, gain in ((-5.0, 100.0), (0.0, 100.0), (10.0, 200.0), (20.0, 300.0), (50.0, 300.0)):
        assert driver.step(DriverState(), v + 1.0, v)[0] == pytest.approx(gain)


def test_feedforward():
    assert CAR.step(DriverState(), 10.0, 10.0, a_x=2.0)[0] == pytest.approx(2.0 * 1500 * 0.3)


def test_a_lost_measurement_holds_the_output():
    output, state = CAR.step(DriverState(), 11.0, 10.0)
    for v in (np.nan, np.inf):
        again, after = CAR.step(state, 11.0, v)
        assert again == output
        assert after == state


def test_output_is_shared_out():
    driver = SpeedDriver.for_car(
        mass=1000.0, radius=0.3, limits=(-1e3, 1e3), drive=Values(T_r=1.0), brake=Values(T_f=0.6, T_r=0.4)
    )
    assert driver.inputs(100.0) == pytest.approx({"T_r": 100.0, "T_f": 0.0})
    assert driver.inputs(-100.0) == pytest.approx({"T_r": -40.0, "T_f": -60.0})


@pytest.mark.parametrize(
    "options",
    [
        {"kp": (1.0, 2.0)},
        {"speeds": (0.0, 0.0), "kp": (1.0, 1.0), "ki": (1.0, 1.0)},
        {"kp": (-1.0,)},
        {"limits": (1.0, 2.0)},
        {"dt": 0.0},
    ],
)
def test_bad_settings(options):
    with pytest.raises(ParameterError):
        SpeedDriver(**({"kp": (1.0,), "ki": (1.0,), "limits": (-1.0, 1.0)} | options))
