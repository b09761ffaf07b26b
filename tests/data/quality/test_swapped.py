"""Steering, yaw rate and a_y under each other's name are said to be so; what is late or in another unit is not."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.data.quality.plausible import doubts

LENGTH, DT = 2.7, 0.02


def drive(speed, seed, length=LENGTH, low=0.03):
    """A car a little behind its steering, in bends and sweeps at about one speed."""
    rng, t = np.random.default_rng(seed), np.arange(1500) * DT
    delta = 0.04 * np.sin(2 * np.pi * 0.2 * t) + 0.02 * np.sin(2 * np.pi * (0.05 + low * t) * t)
    r = speed * np.interp(t - 0.12, t, delta) / length / (1 + (speed / 28.0) ** 2)
    noise = {n: s * rng.standard_normal(len(t)) for n, s in (("r", 0.003), ("a_y", 0.05), ("v_x", 0.05))}
    inputs = {"delta": delta + 3e-4 * rng.standard_normal(len(t)), "v_x": speed + noise["v_x"]}
    return Dataset.from_arrays(inputs, {"r": r + noise["r"], "a_y": 1.05 * speed * r + noise["a_y"]}, DT)


def log(speeds, **how):
    return join(*(drive(v, seed, **how) for seed, v in enumerate(speeds)))


def without_a_y(data):
    parts = [Dataset.from_arrays({n: p[n] for n in ("delta", "v_x")}, {"r": p["r"]}, DT) for p in data.experiments]
    return join(*parts)


def swapped(data, one, other):
    return data.with_channel(one, data[other], data.unit(one)).with_channel(other, data[one], data.unit(other))


SPEEDS = {"four speeds": (9.0, 14.0, 19.0, 25.0), "one speed": (18.0,) * 4}


@pytest.mark.parametrize("speeds", SPEEDS)
@pytest.mark.parametrize(("other", "said"), [("delta", "delta and r are swapped"), ("a_y", "r and a_y are swapped")])
def test_a_yaw_rate_under_another_name_is_said_to_be_so_alone(speeds, other, said):
    found = doubts(swapped(log(SPEEDS[speeds]), "r", other), wheelbase=LENGTH)
    assert len(found) == 1
    assert said in found[0]


@pytest.mark.parametrize("speeds", SPEEDS)
def test_steering_under_the_yaw_rate_s_name_is_told_without_a_y_and_of_a_long_car(speeds):
    data = without_a_y(log(SPEEDS[speeds], length=6.2))
    assert doubts(data, wheelbase=6.2) == ()
    found = doubts(swapped(data, "r", "delta"), wheelbase=6.2)
    assert len(found) == 1
    assert "delta and r are swapped" in found[0]


@pytest.mark.parametrize("ratio", [15.0, 9.81, 60.0])  # 15 L2 / v2 may be a gain of 1, swapped back
@pytest.mark.parametrize("speed", [3.13, 10.5, 18.0])  # at 3.13 m/s a_y in g is to r as m/s2 are to v_x r
def test_other_units_and_late_channels_swap_nothing(ratio, speed):
    data = log((speed,) * 4)
    late = np.concatenate([np.interp(np.arange(1500) - 10, np.arange(1500), part["r"]) for part in data.experiments])
    for wrong in (
        data.with_channel("delta", ratio * data["delta"], "rad"),
        data.with_channel("r", 57.3 * data["r"], "rad/s"),
        data.with_channel("a_y", data["a_y"] / 9.81, "m/s2"),
        data.with_channel("v_x", 3.6 * data["v_x"], "m/s"),
        data.with_channel("r", late, "rad/s"),
    ):
        assert "swapped" not in " ".join(doubts(wrong, wheelbase=LENGTH))


def test_km_h_at_one_speed_are_one_of_three_things_said_and_a_y_or_other_speeds_tell_which():
    data = log(SPEEDS["one speed"])
    alone = without_a_y(data)
    assert doubts(alone, wheelbase=LENGTH) == ()
    found = doubts(alone.with_channel("v_x", 3.6 * alone["v_x"], "m/s"), wheelbase=LENGTH)
    assert len(found) == 1
    assert "km/h" in found[0]
    assert "at the one speed that was driven" in found[0]
    found = doubts(data.with_channel("delta", 4.0 * data["delta"], "rad"), wheelbase=LENGTH)
    assert "km/h" not in " ".join(found)
