"""A steering, or a speed, that is logged late is named, with its time; and a speed of another scale."""

from functools import cache

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.data.quality.plausible import doubts

LENGTH, DT, FINE = 2.7, 0.02, 4
CAR = dict(mass=1400.0, inertia_z=2100.0, l_f=1.2, C_f=9e4, C_r=1.1e5)
OWN = 0.05  # s, of the steering's lag
ROLL = 1.06  # a_y as an accelerometer on a rolling body reads it


@cache
def driven(seed, one_speed=False, slow=1.0):
    """A linear single track with a lag in its steering, in bends at changing speeds; every channel with noise."""
    rng, n = np.random.default_rng(seed), 4500
    t = np.arange(n * FINE) * DT / FINE
    v = 17.0 + (0.0 if one_speed else 1.0) * (5.0 * np.sin(0.35 * t) + 3.0 * np.sin(0.83 * t + seed))
    delta = 0.3 / v * (np.sin(0.9 * t + seed) + 0.7 * np.sin(0.31 * t) + 0.5 * np.sin((1.0 + 0.04 * t) * t / 2))
    m, J, a, C_f, C_r = (CAR | {"inertia_z": slow * CAR["inertia_z"]}).values()
    b, (v_y, r, wheels), rows = LENGTH - a, (0.0, 0.0, 0.0), np.empty((n * FINE, 3))
    for k in range(n * FINE):
        wheels += (delta[k] - wheels) * DT / FINE / OWN
        F_f, F_r = C_f * (wheels - (v_y + a * r) / v[k]), -C_r * (v_y - b * r) / v[k]
        rows[k] = v_y, r, (F_f + F_r) / m
        v_y, r = v_y + DT / FINE * ((F_f + F_r) / m - v[k] * r), r + DT / FINE * (a * F_f - b * F_r) / J
    v_y, r, a_y = rows.T
    a_x = np.gradient(v, DT / FINE) - v_y * r
    logged = {"delta": delta, "v_x": v, "r": r, "v_y": v_y, "a_y": ROLL * a_y, "a_x": a_x}
    size = {"delta": 3e-4, "v_x": 0.05, "r": 0.003, "v_y": 0.04, "a_y": 0.08, "a_x": 0.08}
    return {name: x[::FINE] + size[name] * rng.standard_normal(n) for name, x in logged.items()}


def log(outputs, seed=0, one_speed=False, slow=1.0, **change):
    """A log of some outputs, channels changed by functions."""
    table = dict(driven(seed, one_speed, slow))
    table |= {name: f(table[name]) for name, f in change.items()}
    return Dataset.from_arrays({n: table[n] for n in ("delta", "v_x")}, {n: table[n] for n in outputs}, DT)


def later(seconds):
    def shift(x):
        t = np.arange(len(x)) * DT
        return np.interp(t - seconds, t, x)

    return shift


def held(x):
    """As GPS at 5 Hz gives it, 0.2 s late."""
    return later(0.2)(np.repeat(x[::10], 10))


CHANNELS = [("r",), ("r", "a_y"), ("r", "v_y"), ("r", "v_y", "a_y"), ("r", "v_y", "a_y", "a_x")]


@pytest.mark.parametrize("outputs", CHANNELS, ids="+".join)
@pytest.mark.parametrize("seed", range(3))
def test_a_sound_log_raises_no_doubt(outputs, seed):
    assert doubts(log(outputs, seed), wheelbase=LENGTH) == ()
    assert doubts(log(outputs, seed, one_speed=True), wheelbase=LENGTH) == ()


@pytest.mark.parametrize("outputs", CHANNELS, ids="+".join)
@pytest.mark.parametrize("one_speed", [False, True])
@pytest.mark.parametrize("seconds", [0.3, 0.5])
def test_a_steering_that_is_logged_late_is_named_with_its_time(outputs, one_speed, seconds):
    (said,) = doubts(log(outputs, 1, one_speed, delta=later(seconds)), wheelbase=LENGTH)
    told = float(said.removeprefix("r comes ").split(" s before the steering that makes it")[0])
    assert seconds - 0.25 < told < seconds  # what the car takes is hidden by it
    assert "delta is logged late" in said
    assert ("so does a_y" in said) == ("a_y" in outputs)


def test_what_tires_take_grows_with_speed_and_is_told_from_the_steerings_lateness():
    """Of a car that turns slowly more is hidden where its speed is always the same."""

    def told(one_speed):
        (said,) = doubts(log(("r",), 1, one_speed, 2.0, delta=later(0.3)), wheelbase=LENGTH)
        return float(said.removeprefix("r comes ").split(" s before")[0])

    assert 0.07 < told(one_speed=True) < 0.13 < told(one_speed=False) < 0.3
    assert doubts(log(("r",), 1, False, 2.0), wheelbase=LENGTH) == ()


def test_a_steering_that_is_as_late_as_the_car_takes_is_not_seen_and_a_late_car_is_none():
    for seconds in (0.05, -0.1, -0.3):  # a car with so much delay
        assert doubts(log(("r",), delta=later(seconds)), wheelbase=LENGTH) == ()


def test_a_yaw_rate_that_is_early_is_told_from_it_by_a_y():
    (said,) = doubts(log(("r", "a_y"), r=later(-0.35)), wheelbase=LENGTH)
    assert "and a_y after it: r is logged early" in said
    assert "delta is logged late" not in said


@pytest.mark.parametrize("slow", [later(0.2), later(0.4), held], ids=["0.2 s", "0.4 s", "5 Hz"])
@pytest.mark.parametrize(
    ("outputs", "by"), [(("r", "a_x"), "what a_x makes of it"), (("r", "v_y", "a_y"), "a_y over r")], ids=["a_x", "a_y"]
)
def test_a_speed_that_is_logged_late_is_named_with_its_time(slow, outputs, by):
    (said,) = doubts(log(outputs, v_x=slow), wheelbase=LENGTH)
    assert f"s behind {by}: it is logged late" in said
    expected = 0.3 if slow is held else float(1.0 - slow(np.arange(200) * DT)[50])
    assert float(said.removeprefix("v_x comes ").split(" s behind")[0]) == pytest.approx(expected, abs=0.06)


def test_a_late_speed_that_never_changes_harms_nothing_and_is_not_named():
    assert doubts(log(("r", "v_y", "a_y"), one_speed=True, v_x=later(0.4)), wheelbase=LENGTH) == ()


@pytest.mark.parametrize("share", [0.88, 1.12])
@pytest.mark.parametrize("channel", ["v_x", "r"])
def test_a_speed_or_a_yaw_rate_of_another_scale_is_named_beside_v_y(share, channel):
    (said,) = doubts(log(("r", "v_y", "a_y"), 1, **{channel: lambda x: share * x}), wheelbase=LENGTH)
    assert float(said.removeprefix("v_x r is ").split(" times what a_y and dv_y/dt")[0]) == pytest.approx(
        share, abs=0.03
    )
    assert "check v_x over a known distance" in said
