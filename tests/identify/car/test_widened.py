"""Intervals of a car take in what a single track leaves out, and what inputs that are held for a sample take."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slipangle.data.dataset import HELD, MEANS, join
from slipangle.identify.car.structures import STIFF, first_guess, fit
from slipangle.identify.car.uncertainty import covariance
from slipangle.identify.car.widened import _hold, _smoothed, limits_of, too_coarse, yaw_time
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed, interpolation
from tests.identify.car.test_identify_car import DT, KNOWN, TRUE, logs

QUICK = TRUE | dict(mass=270.0, inertia_z=140.0, wheelbase=1.55, l_f=0.82, C_f=2.4e4, C_r=3.3e4)
FREE = (*STIFF, "steering_offset", "steering_gain", "delay_delta", "steering_lag")


def found(*, dt=DT, true=TRUE, outputs=("v_y", "r"), more=lambda data: data.hold_mean()):
    """A car fitted to three drives, sampled each ``dt``; its tires bend as they do."""
    data = join(*logs((9.0, 13.0, 17.0), range(3), outputs=outputs, true=true, noise=0.3, amplitude=0.04, seconds=9.0))
    data = more(data if dt == DT else data.resample(dt))
    known = {name: true[name] for name in KNOWN}
    guess = first_guess(**known, dt=dt, outputs=outputs, gain=1.0).with_values(mu_f=true["mu_f"], mu_r=true["mu_r"])
    late = Delayed(Steered(guess.model, steering_lag=0.05), delays={"delta": 0.03}, longest=0.3)
    return fit(late, FREE, data)


@pytest.fixture(scope="module")
def across():
    """A road car with v_y and r."""
    return found()


@pytest.mark.parametrize("samples", [0.0, 0.2, 1 / 3, 0.8, 1.0, 1.6])
@pytest.mark.parametrize("note", ["", MEANS, HELD])
def test_what_a_hold_and_a_delay_take_looks_like_a_lag(samples, note):
    """To second order in frequency, 1 - (lag w)^2 of a power: of the interpolation's weights, and of a hold's sine."""
    w = 0.02  # over the rate of the samples
    late = np.array([float(k) for k in interpolation(samples, 4)]) @ np.exp(-1j * w * np.arange(4))
    held = np.sinc(w / 2 / np.pi) if note == "" else 1.0
    data = SimpleNamespace(notes=(note,) if note else ())
    car = SimpleNamespace(
        values={"delay_delta": 0.05 * samples}, model=SimpleNamespace(dt=0.05), problem=SimpleNamespace(data=data)
    )
    assert _smoothed(car) == pytest.approx((1 - abs(late * held) ** 2) / w**2, abs=2e-4)


def test_a_lag_may_be_larger_and_a_delay_smaller_by_what_looks_like_it():
    """A delay of 20 ms at 20 Hz is interpolated as by a lag of sqrt(0.4 * 0.6^2) samples, 19 ms."""
    car = found(dt=0.05)
    car = replace(car, model=car.model.with_values(delay_delta=0.02, steering_lag=0.05))
    limits = np.tile([0.0, 0.05], (len(car.names), 1))
    _hold(car, limits)
    wide = dict(zip(car.names, limits, strict=True))
    assert wide["steering_lag"] == pytest.approx([0.0, np.hypot(0.05, 0.019)], abs=1e-4)
    assert wide["delay_delta"] == pytest.approx([0.05 - np.hypot(0.05, 0.019), 0.05], abs=1e-4)
    assert wide["C_f"] == pytest.approx([0.0, 0.05])


def half(fitted):
    """95 % half widths by noise, over the values, of stiffness and inertia."""
    return [1.96 * np.sqrt(covariance(fitted)[0][i, i]) / fitted.values[name] for i, name in enumerate(STIFF)]


def test_what_a_single_track_leaves_out_is_independent_of_noise_and_of_structures(across):
    """They were added as they are: of stiffness known to 4 % by noise the interval was 9 % wide either way, not 6.4."""
    limits = limits_of(across, [], 0.0)[1]
    for i, (name, noise) in enumerate(zip(STIFF, half(across), strict=True)):
        low, high = limits[i] / across.values[name] - 1
        assert -low == pytest.approx(np.hypot(noise, 0.05), rel=1e-6)
        assert high == pytest.approx(-low, rel=1e-6)
    stiffer = replace(across, model=across.model.with_values(C_f=1.1 * across.values["C_f"]))
    low, high = limits_of(across, [(stiffer, 1.0)], 0.0)[1][0] / across.values["C_f"] - 1
    reach = 1.1 * (1 + half(stiffer)[0]) - 1
    assert (-low, high) == pytest.approx((np.hypot(half(across)[0], 0.05), np.hypot(reach, 0.05)), rel=0.02)


def test_from_the_yaw_rate_alone_the_floor_comes_on_top():
    alone = found(outputs=("r",))
    low, high = limits_of(alone, [], 0.0)[1][0] / alone.values["C_f"] - 1
    assert (-low, high) == pytest.approx((half(alone)[0] + 0.2,) * 2, rel=1e-6)


def test_an_inertia_that_samples_are_too_far_apart_for_is_said_with_the_rate_it_takes(across):
    """Of a log of a Formula Student car without noise it came out 21 % too small at 20 Hz, and 0.3 % at 50 Hz."""
    quick = found(dt=0.06, true=QUICK)
    p = QUICK | quick.values
    damping = p["C_f"] * p["l_f"] ** 2 + p["C_r"] * (p["wheelbase"] - p["l_f"]) ** 2
    assert yaw_time(quick) == pytest.approx(p["inertia_z"] * 13.0 / damping, rel=1e-3)
    (said,) = too_coarse(quick)
    assert said.startswith(f"samples are 0.06 s apart, and the yaw rate follows within {yaw_time(quick):.2g} s: ")
    rate = float(said.split("give the log at ")[1].split(" Hz")[0])
    assert (1 / rate / yaw_time(quick)) ** 2 * 2 / 27 == pytest.approx(0.02, rel=0.1)
    assert too_coarse(across) == []  # whose samples are close
    (said,) = too_coarse(found(dt=0.06, true=QUICK, more=lambda data: data))
    assert float(said.split("give the log at ")[1].split(" Hz")[0]) > 1.2 * rate  # whose hold smooths, too
    held = found(dt=0.06, true=QUICK, more=lambda data: data.hold_sample())
    assert too_coarse(held) == []  # what a controller held did not move in between
