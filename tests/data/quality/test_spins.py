"""A spin is cut out from where the car breaks away; gentle driving, a halt and a channel in another unit are none."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.data.quality.plausible import doubts
from slipangle.data.quality.spins import spinning

LENGTH, DT = 2.7, 0.02
T = np.arange(3000) * DT


def drive(*spins, length=LENGTH, v_y=True):
    """Steady cornering at every instant from 8 to 24 m/s, each spin from when it begins [s] until the car stands."""
    delta = 0.03 * np.sin(2 * np.pi * 0.21 * T) + 0.02 * np.sin(2 * np.pi * (0.05 + 0.01 * T) * T)
    v_x = (16.0 + 8.0 * np.sin(2 * np.pi * T / 47.0)) * length / LENGTH
    r = v_x * delta / length / (1 + (v_x / 28.0 * LENGTH / length) ** 2)
    side = r * (0.45 * length - 0.0015 * v_x**2)
    for begins in spins:
        s = np.clip((T - begins) / 2.5, 0.0, 1.0)
        slides, stands = (s > 0) & (s < 1), (s >= 1) & (begins + 8.0 > T)
        angle = np.where(slides, 0.5 * np.pi * s**2, 0.0)
        v = v_x * (1 - 0.6 * s)
        v_x, side = (np.where(slides, v * f(angle), x) for f, x in ((np.cos, v_x), (np.sin, side)))
        r = np.where(slides, -2.5 * s**2, r)
        v_x, side, r = (np.where(stands, 0.0, x) for x in (v_x, side, r))
    outputs = {"r": r, "v_y": side} if v_y else {"r": r}
    return Dataset.from_arrays({"delta": delta, "v_x": v_x}, outputs, DT)


@pytest.mark.parametrize("v_y", [True, False])
@pytest.mark.parametrize("length", [LENGTH, 0.26])
def test_a_spin_is_cut_from_where_the_car_breaks_away_until_it_stands(length, v_y):
    found = T[spinning(drive(20.0, length=length, v_y=v_y), length)]
    assert found[0] < 20.0 + 0.5
    assert 22.4 < found[-1] < 24.0
    assert np.ptp(found) == pytest.approx((len(found) - 1) * DT)


@pytest.mark.parametrize("v_y", [True, False])
def test_driving_has_no_spin(v_y):
    assert not spinning(drive(v_y=v_y), LENGTH).any()


def test_outliers_are_no_spin():
    data = drive()
    v_y = data["v_y"].copy()
    v_y[[500, 900, 1700]] = 40.0
    assert not spinning(data.with_channel("v_y", v_y, "m/s"), LENGTH).any()


def test_a_channel_in_another_unit_is_no_spin():
    data = drive()
    assert not spinning(data.with_channel("r", np.rad2deg(data["r"]), "rad/s"), LENGTH).any()


def test_no_channel_is_doubted_because_the_car_span():
    """Two seconds of a spin outweighed a minute: v_y was said to have the wrong sign, r an offset, v_x another unit."""
    assert doubts(drive(), wheelbase=LENGTH) == ()
    assert doubts(drive(20.0), wheelbase=LENGTH) == ()
    assert doubts(drive(20.0, 40.0), wheelbase=LENGTH) == ()
