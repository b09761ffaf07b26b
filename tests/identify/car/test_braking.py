"""A car that brakes into its bends and drives off out of them is the same car as one that keeps its speed."""

from functools import cache

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.data.quality.smooth import smoothed
from slipangle.identify.car.corrections import corrections
from slipangle.identify.car.identify_car import identify_car
from slipangle.identify.car.late import late as lateness
from slipangle.identify.car.logged_speed import following
from slipangle.identify.car.structures import STIFF, corrected, errors, first_guess, fit, free_runs

KNOWN = dict(mass=1300.0, wheelbase=2.6, l_f=1.2)
TRUE = dict(C_f=95e3, C_r=120e3, inertia_z=1900.0)
HEIGHT, DRIVEN, BRAKED, MU = 0.5, 1.0, 0.35, 1.0
G, DT, FINE = 9.81, 0.02, 10


def held(C, load, along, alpha):
    """Force across of an axle, from its stiffness, what loads and what pushes it, both over the mass, and its slip."""
    most = MU * load * KNOWN["mass"]
    left = np.sqrt(1 - (along * KNOWN["mass"] / (1.1 * most)) ** 2)
    return left * most * np.sin(1.4 * np.arctan(C / (1.4 * most) * alpha))


@cache
def drive(seed, brakes=3.5, outputs=("v_y", "r"), noise_v_x=0.03):
    """A bicycle by Euler steps of 2 ms, with noise; braking in m/s2.

    Its axles are as stiff as loaded. They hold what an ellipse a tenth longer than wide leaves of a Magic Formula of
    friction `MU`; the rear one has `DRIVEN` and `BRAKED` of what pushes the car along, the front one the rest,
    where its wheels point.
    """
    rng, h = np.random.default_rng(seed), DT / FINE
    t = np.arange(1000 * FINE) * h
    m, L, l_f = KNOWN["mass"], KNOWN["wheelbase"], KNOWN["l_f"]
    pace = 2 * np.pi / rng.uniform(5.0, 7.0)
    v = 17.0 + brakes / pace * np.cos(pace * t + seed)
    a_x = -brakes * np.sin(pace * t + seed)
    wave = sum(np.cos(2 * np.pi * (f * t + rng.uniform())) for f in np.arange(0.1, 1.6, 0.1))
    delta = 0.02 * np.cos(pace * t + seed + 1.0) + 0.025 * wave / np.abs(wave).max()
    v_y, r = np.zeros(len(t) + 1), np.zeros(len(t) + 1)
    for k in range(len(t)):
        moved = HEIGHT * a_x[k] / (G * L)
        C_f, C_r = TRUE["C_f"] * (1 - moved * L / (L - l_f)), TRUE["C_r"] * (1 + moved * L / l_f)
        rear = a_x[k] * (DRIVEN if a_x[k] > 0 else BRAKED)
        F_f = held(C_f, G * ((L - l_f) / L - moved), a_x[k] - rear, delta[k] - (v_y[k] + l_f * r[k]) / v[k])
        F_f = F_f + m * (a_x[k] - rear) * delta[k]
        F_r = held(C_r, G * (l_f / L + moved), rear, -(v_y[k] - (L - l_f) * r[k]) / v[k])
        v_y[k + 1] = v_y[k] + h * ((F_f + F_r) / m - v[k] * r[k])
        r[k + 1] = r[k] + h * (l_f * F_f - (L - l_f) * F_r) / TRUE["inertia_z"]
    noise = {"v_y": 0.01, "r": 0.003, "v_x": noise_v_x}
    seen = {"v_y": v_y[:-1:FINE], "r": r[:-1:FINE], "v_x": v[::FINE]}
    seen = {name: x + noise[name] * rng.standard_normal(len(x)) for name, x in seen.items()}
    logged = {"delta": delta[::FINE], "v_x": seen["v_x"]}
    return Dataset.from_arrays(logged, {name: seen[name] for name in outputs}, DT)


def found_by(data):
    """Bicycle that saturates, then with loads that shift and forces along that take grip."""
    guess = first_guess(**KNOWN, dt=DT, outputs=data.outputs, gain=1.0).with_values(mu_f=0.8, mu_r=0.8)
    before = fit(guess, (*STIFF, "steering_offset", "mu_f", "mu_r"), data)
    loads = next(c for c in corrections(data, KNOWN["wheelbase"], ()) if "height" in c.free)
    return before, corrected(before, loads, data)


def off(found, name):
    return abs(found.values[name] / TRUE[name] - 1)


def test_loads_that_braking_shifts_and_the_wheels_that_do_it_are_found_and_the_stiffness_is_right_with_them():
    before, after = found_by(join(*map(drive, range(4))).hold_mean())
    assert after.values["height"] == pytest.approx(HEIGHT, rel=0.1)
    assert after.values["drive_rear"] == pytest.approx(DRIVEN, abs=0.1)
    assert after.values["brake_rear"] == pytest.approx(BRAKED, abs=0.1)
    assert (after.sigma < 0.7 * before.sigma).all()
    for name in STIFF:
        assert off(after, name) < 0.03


def test_a_car_that_keeps_its_speed_is_not_asked():
    data = join(*(drive(seed, brakes=0.2) for seed in range(4)))
    assert not [c for c in corrections(data, KNOWN["wheelbase"], ()) if "height" in c.free]


def coarse(data):
    """With a speed in steps of 1 km/h."""
    return data.with_channel("v_x", np.round(3.6 * data["v_x"]) / 3.6, "m/s")


def late(data, samples=15):
    """With a speed that comes 0.3 s behind."""
    v_x = data["v_x"]
    return data.with_channel("v_x", np.concatenate([np.full(samples, v_x[0]), v_x[:-samples]]), "m/s")


def test_how_late_a_speed_is_logged_is_told():
    data = smoothed(join(*(late(drive(seed)) for seed in range(4))).hold_mean(), "v_x")
    without_loads, found = found_by(data)
    seconds, on_time = lateness(found, data, "v_x")
    assert seconds == pytest.approx(0.3, abs=0.05)
    assert on_time.values["drive_rear"] == pytest.approx(DRIVEN, abs=0.15)
    prompt = smoothed(join(*(drive(seed) for seed in range(4))).hold_mean(), "v_x")
    assert lateness(found_by(prompt)[1], prompt, "v_x") is None
    assert lateness(without_loads, data, "v_x") is None  # in whose place a late speed would stand


def test_free_runs_are_those_of_the_fit():
    """Over the data of the fit they leave its errors: with its parameters, not with them over other scales."""
    data = join(*map(drive, range(4))).hold_mean()
    found = found_by(data)[1]
    left = np.concatenate([run - y for run, y in free_runs(found, data)])
    np.testing.assert_allclose(left / found.sigma, found.error, atol=1e-9)


def test_loads_follow_a_noisy_speed_slowly():
    """Noise of a logged speed shifts loads and takes grip as braking does, unless loads follow slowly."""
    noisy = join(*(drive(seed, noise_v_x=0.15) for seed in range(4))).hold_mean()
    calm = smoothed(noisy, "v_x")
    found = found_by(calm)[1]
    online, others = following(found, [], noisy)
    assert others == [(found, 1.0)]
    assert following(found, [], calm) == (found, [])
    assert online.values["load_lag"] > 2 * found.values["load_lag"]
    assert online.model.value("load_lag") == pytest.approx(online.values["load_lag"])
    assert (errors(online, noisy).mean(axis=0) < errors(found, noisy).mean(axis=0)).all()
    assert {n: v for n, v in online.values.items() if n != "load_lag"} == pytest.approx(
        {n: v for n, v in found.values.items() if n != "load_lag"}
    )


@pytest.mark.slow
@pytest.mark.parametrize(("noise_v_x", "spoilt"), [(0.15, lambda data: data), (0.03, coarse)])
def test_noise_and_steps_of_the_speed_are_not_taken_for_the_car(noise_v_x, spoilt):
    """Raw, such a speed makes accelerations that no car has: the loads' lag and the yaw inertia took them up."""
    found = identify_car([spoilt(drive(seed, noise_v_x=noise_v_x)).hold_mean() for seed in range(4)], **KNOWN)
    for name, true in TRUE.items():
        low, high = found.interval(name)
        assert low < true < high
        assert high - low < 0.35 * true
    low, high = found.interval("drive_rear")
    assert low < DRIVEN <= high
    assert found.interval("height")[0] < HEIGHT < found.interval("height")[1]


@pytest.mark.slow
def test_a_speed_that_is_logged_late_is_said_and_the_intervals_hold():
    found = identify_car([late(drive(seed)).hold_mean() for seed in range(4)], **KNOWN)
    (doubt,) = (d for d in found.doubts if d.startswith("v_x comes"))
    assert "behind r, as the motion of the car tells: it is logged late" in doubt
    assert float(doubt.split()[2]) == pytest.approx(0.3, abs=0.1)
    for name, true in TRUE.items():
        low, high = found.interval(name)
        assert low < true < high


@pytest.mark.slow
def test_a_car_that_brakes_is_identified_and_its_sensors_are_not_doubted():
    """Before, v_y was said to be late: loads that shift move it as a late sensor does."""
    found = identify_car([drive(seed).hold_mean() for seed in range(4)], **KNOWN)
    for name, true in TRUE.items():
        low, high = found.interval(name)
        assert low < true < high
        assert high - low < 0.3 * true
    assert found.doubts == ()
    assert any("move to the front axle as the car brakes" in said for said in found.sentences)
