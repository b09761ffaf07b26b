"""A steering that is stuck at one value is named in quick and in slow driving; one that is held, or coarse, is not."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.data.quality.stuck import stuck

LENGTH, DT = 2.7, 0.01
T = np.arange(6000) * DT


def drive(delta, speed, seed=0):
    rng = np.random.default_rng(seed)
    r = speed * np.interp(T - 0.15, T, delta) / LENGTH / (1 + (speed / 28.0) ** 2)
    noise = {n: s * rng.standard_normal(len(T)) for n, s in (("delta", 3e-4), ("v_x", 0.05), ("r", 0.005))}
    inputs = {"delta": delta + noise["delta"], "v_x": speed + noise["v_x"]}
    return Dataset.from_arrays(inputs, {"r": r + noise["r"]}, DT)


def with_rests(data, value=None):
    delta = data["delta"].copy()
    for a in (1500, 4000):
        delta[a : a + 600] = delta[a] if value is None else value
    return data.with_channel("delta", delta, "rad")


QUICK = 0.03 * np.sin(2 * np.pi * 1.3 * T)
SLOW = np.where(T < 30.0, 0.15 * np.sin(2 * np.pi * 0.1 * T), 0.03 * np.sin(2 * np.pi * 0.3 * T))
SPEEDS = np.where(T < 30.0, 4.5, 22.0)


@pytest.mark.parametrize(("delta", "speed"), [(QUICK, 20.0 + 0.0 * T), (SLOW, SPEEDS)], ids=["quick", "slow"])
def test_a_steering_that_is_stuck_is_named_in_quick_swerves_and_in_slow_driving(delta, speed):
    data = drive(delta, speed)
    assert stuck(data) == {}
    rows = stuck(with_rests(data))["delta"]
    assert rows[0][0] == 1500
    assert {*rows} <= {(1500, 2100), (4000, 4600)}


def test_a_steering_at_its_stop_while_the_speed_falls_and_one_in_coarse_steps_are_not_stuck():
    held = np.where((T > 15) & (T < 22), 0.06, SLOW)
    still = drive(held, np.where((T > 15) & (T < 22), 14.0 - 1.2 * (T - 15.0), SPEEDS))
    rests = still.with_channel("delta", np.where(held == 0.06, 0.06, still["delta"]), "rad")
    assert stuck(rests) == {}
    straight = drive(0.004 * np.sin(2 * np.pi * 0.5 * T) + np.where(T > 50, 0.05, 0.0), 20.0 + 0.0 * T)
    coarse = straight.with_channel("delta", np.deg2rad(0.5) * np.round(straight["delta"] / np.deg2rad(0.5)), "rad")
    assert stuck(coarse) == {}
