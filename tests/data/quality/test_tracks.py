"""Laps of tracks that turn one way: what one speed in all bends leaves open is no mistake, nor are tires that slide."""

import numpy as np
import pytest
from scipy import signal

from slipangle.data.dataset import Dataset
from slipangle.data.quality.plausible import doubts, kinematic_gain
from slipangle.data.quality.slow_motion import zero_of_r
from tests.oracles import vehicles

DT, FINE = 0.05, 5
CAR = dict(mass=1180.0, inertia_z=1700.0, wheelbase=2.55, l_f=1.0, C_f=9e4, C_r=9e4, mu_f=0.9, mu_r=1.0, shape=1.4)
UNDERSTEER = 1180.0 / 2.55 * (1.55 / 9e4 - 1.0 / 9e4)
LIMIT = 0.6 * vehicles.G  # lateral acceleration at which bends are taken
OVAL = ((0.0, 210.0), (1 / 88.0, np.pi * 88.0)) * 2
BENDS = ((60.0, 0.9, 36.0), (110.0, 1.6, 95.0), (85.0, -0.9, 60.0), (40.0, 2.4, 40.0), (95.0, 2.0, 75.0))
CIRCUIT = tuple(p for straight, a, R in BENDS for p in ((0.0, straight), (np.sign(a) / R, abs(a) * R)))


def ridden(segments, way, fastest, seconds):
    """Curvature [1/m] and speed [m/s] over time: bends at their limit, a car that brakes before them."""
    along = np.concatenate([np.full(round(length), bend) for bend, length in segments])
    along = signal.sosfiltfilt(signal.butter(2, 0.06, output="sos"), np.tile(along, 20))
    speed = np.minimum(fastest, np.sqrt(LIMIT / np.maximum(np.abs(along), 1e-9)))
    for k in range(len(speed) - 2, -1, -1):
        speed[k] = min(speed[k], np.sqrt(speed[k + 1] ** 2 + 5.0))
    for k in range(1, len(speed)):
        speed[k] = min(speed[k], np.sqrt(speed[k - 1] ** 2 + 2.4))
    t = np.cumsum(1.0 / speed)
    times = np.arange(round(seconds / DT * FINE)) * DT / FINE
    return way * np.interp(times, t, along), np.interp(times, t, speed)


def laps(segments, way, seed, *, fastest=30.0, seconds=120.0):
    """A car that understeers, by the oracle's equations at 10 ms, and a driver's corrections; noise on all channels."""
    rng, h = np.random.default_rng(seed), DT / FINE
    bend, v_x = ridden(segments, way, fastest, seconds)
    busy = signal.sosfiltfilt(signal.butter(2, 2 * 0.8 * h, output="sos"), rng.standard_normal(len(bend)))
    delta = bend * (CAR["wheelbase"] + UNDERSTEER * v_x**2) + 0.006 * busy / busy.std()
    wheel, v_y, r, rows = delta[0], 0.0, 0.0, []
    for k in range(len(bend)):
        wheel += (delta[k] - wheel) * h / 0.05
        slip = vehicles.small_slip(CAR, v_y, r, wheel, v_x[k])
        v_y_dot, r_dot, _ = vehicles.saturating_bicycle(CAR, v_y, r, *slip, v_x[k])
        rows.append((v_y, r))
        v_y, r = v_y + h * v_y_dot, r + h * r_dot
    v_y, r = np.array(rows)[::FINE].T
    sizes = {"v_y": (v_y, 0.015), "r": (r, 0.002), "v_x": (v_x[::FINE], 0.015)}
    seen = {n: x + size * rng.standard_normal(len(x)) for n, (x, size) in sizes.items()}
    inputs = {"delta": delta[::FINE], "v_x": seen["v_x"]}
    return Dataset.from_arrays(inputs, {n: seen[n] for n in ("v_y", "r")}, DT).hold_mean()


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("segments", [OVAL, CIRCUIT], ids=["oval", "circuit"])
def test_a_track_that_turns_one_way_raises_no_doubt(segments, way):
    """On an oval, whose bends are driven at one speed, understeer took the steering's gain."""
    data = laps(segments, way, 0)
    assert doubts(data, wheelbase=CAR["wheelbase"]) == ()
    assert 0.45 < kinematic_gain(data, wheelbase=CAR["wheelbase"]) < 1.3
    assert abs(zero_of_r(data, wheelbase=CAR["wheelbase"])) < 0.02


@pytest.mark.parametrize("segments", [OVAL, CIRCUIT], ids=["oval", "circuit"])
def test_a_turned_sensor_and_an_offset_are_still_told_there(segments):
    data = laps(segments, 1.0, 0)
    turned = data.with_channel("v_y", data["v_y"] + np.deg2rad(2.0) * data["v_x"], "m/s")
    (said,) = doubts(turned, wheelbase=CAR["wheelbase"])
    assert float(said.split("turned by ")[1].split()[0]) == pytest.approx(2.0, abs=0.3)
    offset = data.with_channel("r", data["r"] + 0.15, "rad/s")
    told = [s for s in doubts(offset, wheelbase=CAR["wheelbase"]) if "on a straight" in s and s.startswith("r ")]
    assert float(told[0].split()[2]) == pytest.approx(0.15, abs=0.03)
