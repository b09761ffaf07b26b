"""Channels that contradict each other are named, sound ones are not."""

import re
from dataclasses import replace

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.data.quality.events import despike
from slipangle.data.quality.inspect import inspect, resting
from slipangle.data.quality.plausible import doubts, kinematic_gain

LENGTH = 2.7


def drive(speed, seed):
    """A car in steady cornering at every instant, a little understeering, 100 ms behind its steering; with noise."""
    rng, dt = np.random.default_rng(seed), 0.02
    t = np.arange(1500) * dt
    delta = 0.04 * np.sin(2 * np.pi * 0.2 * t) + 0.02 * np.sin(2 * np.pi * (0.05 + 0.03 * t) * t)
    r = speed * np.interp(t - 0.1, t, delta) / LENGTH / (1 + (speed / 28.0) ** 2)
    v_y = r * (1.2 - 0.004 * speed**2)
    a_y = speed * r + np.gradient(v_y, dt)
    noise = {n: s * rng.standard_normal(len(t)) for n, s in (("r", 0.003), ("v_y", 0.03), ("a_y", 0.05), ("v_x", 0.05))}
    inputs = {"delta": delta, "v_x": speed + noise["v_x"]}
    return Dataset.from_arrays(inputs, {"r": r + noise["r"], "v_y": v_y + noise["v_y"], "a_y": a_y + noise["a_y"]}, dt)


def clean():
    return join(*(drive(v, seed) for seed, v in enumerate((9.0, 14.0, 19.0, 25.0))))


def changed(name, change):
    data = clean()
    return data.with_channel(name, change(data[name]), "-")


def without_a_y(data):
    names = ("r",)
    return Dataset.from_arrays({n: data[n] for n in ("delta", "v_x")}, {n: data[n] for n in names}, data.dt)


def late(r):
    return np.concatenate([np.full(15, r[0]), r[:-15]])


def stuck(r):
    r = r.copy()
    r[400:700] = r[400]
    return r


def swapped():
    data = clean()
    return data.with_channel("v_y", data["a_y"], "m/s").with_channel("a_y", data["v_y"], "m/s2")


PLANTED = {
    "sign": (changed("delta", np.negative), "sign = -1"),
    "degrees": (changed("delta", np.rad2deg), "degrees"),
    "km/h": (changed("v_x", lambda v: 3.6 * v), "km/h"),
    "offset of the yaw rate": (changed("r", lambda r: r + 0.2), "subtract it"),
    "mph": (changed("v_x", lambda v: v / 0.447), "in mph"),
    "hand wheel": (changed("delta", lambda d: 15 * d), "hand wheel"),
    "radians": (changed("delta", np.deg2rad), "delta is logged in rad"),
    "deg/s": (changed("r", np.rad2deg), "deg/s"),
    "late": (changed("r", late), "behind a_y"),
    "rad/s declared deg/s": (changed("r", np.deg2rad), "r is declared in deg/s and logged in rad/s"),
    "m/s declared km/h": (changed("v_x", lambda v: v / 3.6), "v_x is declared in km/h and logged in m/s"),
    "m/s2 declared g": (changed("a_y", lambda a: 9.80665 * a), "a_y is declared in g and logged in m/s2"),
    "stuck": (changed("r", stuck), "r is stuck"),
    "swapped": (swapped(), "swapped"),
    "sign of v_y": (changed("v_y", np.negative), "v_y moves against r at low speed"),
    "v_y in km/h": (changed("v_y", lambda v: 3.6 * v), "logged in km/h or another unit"),
    "v_y sensor turned": (changed("v_y", lambda v: v + 0.03 * clean()["v_x"]), "turned by 1.7 deg; subtract"),
    "steering stuck": (changed("delta", stuck), "delta is stuck at one value for 6 s while the car turns"),
    "side slip angle": (changed("v_y", lambda v: np.arctan2(v, clean()["v_x"])), "v_y moves as a side slip angle does"),
    "milliseconds": (replace(clean(), dt=20.0, start_times=(0.0, 1e5, 2e5, 3e5)), "ms"),
}


def crossed():
    """The yaw rate and v_y in each other's columns."""
    data = clean()
    return data.with_channel("v_y", data["r"], "m/s").with_channel("r", data["v_y"], "rad/s")


PLANTED["r and v_y"] = (crossed(), "r and v_y are swapped")


def with_rear(size):
    """Rear wheels that turn against the front ones at low speed and with them at high speed, logged times ``size``."""
    data = clean()
    rear = np.where(data["v_x"] < 17.0, -0.3, 0.3) * data["delta"]
    data = data.with_channel("delta", data["delta"] + rear, "rad")
    return data.with_channel("delta_r", size * rear, "rad")


def test_steered_rear_wheels_are_part_of_the_steering():
    assert doubts(with_rear(1.0), wheelbase=LENGTH) == ()
    (said,) = doubts(with_rear(180 / np.pi), wheelbase=LENGTH)
    assert said.startswith("delta_r is up to 0.93 rad")
    assert "declare its unit as deg" in said
    assert kinematic_gain(with_rear(1.0), wheelbase=LENGTH) == pytest.approx(1.0, rel=0.35)


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_mistake_is_named_alone(name):
    data, said = PLANTED[name]
    found = doubts(data, wheelbase=LENGTH)
    assert len(found) == 1
    assert said in found[0]


@pytest.mark.parametrize("name", ["sign", "degrees", "km/h", "hand wheel", "deg/s"])
def test_units_are_named_without_an_accelerometer_too(name):
    data, said = PLANTED[name]
    assert any(said in sentence for sentence in doubts(without_a_y(data), wheelbase=LENGTH))


def test_steering_ratio_and_gain_come_with_their_range():
    """A share of 0.067 is that of a ratio of 15, or of less where understeer takes up to half of the angle."""
    said = doubts(changed("delta", lambda d: 15 * d), wheelbase=LENGTH)[0]
    low, high = map(float, re.search(r"ratio, about \d+ \((\d+) to (\d+), as understeer", said).groups())
    assert low < 8 < 15 <= high < 20
    said = doubts(without_a_y(changed("delta", lambda d: 5 * d)), wheelbase=LENGTH)[0]
    low, high = map(float, re.search(r"steering_gain, about 0\.\d+ \((0\.\d+) to (0\.\d+), as", said).groups())
    assert 0.15 < low <= 0.2 < 0.38 < high < 0.6


@pytest.mark.parametrize("speed", [9.0, 14.0, 19.0, 25.0, 35.0])
def test_one_speed_alone_raises_no_doubt_and_shows_degrees(speed):
    data = drive(speed, 7)
    assert doubts(without_a_y(data), wheelbase=LENGTH) == ()
    turned = data.with_channel("delta", np.rad2deg(data["delta"]), "rad")
    assert "degrees" in doubts(without_a_y(turned), wheelbase=LENGTH)[0]


def test_an_acceleration_called_v_y_is_named_without_another_one():
    data = swapped()
    alone = Dataset.from_arrays({n: data[n] for n in ("delta", "v_x")}, {n: data[n] for n in ("r", "v_y")}, data.dt)
    (said,) = doubts(replace(alone, starts=data.starts, start_times=data.start_times), wheelbase=LENGTH)
    assert "it is a lateral acceleration" in said


def test_a_yaw_rate_against_steering_and_v_y_is_the_one_that_is_wrong():
    data = clean()
    r, v_y = -data["r"], data["v_y"]
    alone = Dataset.from_arrays({n: data[n] for n in ("delta", "v_x")}, {"r": r, "v_y": v_y}, data.dt)
    (said,) = doubts(replace(alone, starts=data.starts, start_times=data.start_times), wheelbase=LENGTH)
    assert said.endswith("set sign = -1 for r")


def test_a_speed_in_whole_km_h_is_not_stuck_but_one_that_goes_on_with_a_leap_is():
    """A car's own bus tells whole km/h, ten times a second, which stay at one value for seconds."""
    t = 0.02 * np.arange(6000)
    v_x = 15.0 + 6.0 * np.sin(0.05 * t)
    whole = np.interp(t, t[::5], np.round(3.6 * v_x[::5]) / 3.6)
    data = without_a_y(clean()).with_channel("v_x", whole, "m/s")
    data = data.with_channel("r", data["delta"] * v_x / LENGTH, "rad/s")
    assert any(b - a > 60 for a, b in resting(data, "v_x"))
    assert doubts(data, wheelbase=LENGTH) == ()
    held = data["v_x"].copy()
    held[3100:3300] = held[3100]
    assert "v_x is stuck at one value" in doubts(data.with_channel("v_x", held, "m/s"), wheelbase=LENGTH)[0]


@pytest.mark.parametrize("step", [0.01, 0.05])
def test_a_coarse_yaw_rate_is_not_stuck_but_one_that_goes_on_with_a_leap_is(step):
    """As of a bus: it stays at one value for long while a car steers little, and goes on with the next one."""
    data = clean()
    coarse = data.with_channel("r", step * np.round(data["r"] / step), "rad/s")
    assert doubts(coarse, wheelbase=LENGTH) == ()
    assert any(
        "r is stuck" in s for s in doubts(changed("r", lambda r: stuck(step * np.round(r / step))), wheelbase=LENGTH)
    )


def test_a_small_car_s_late_yaw_rate_is_not_swapped():
    """Its v_y, that of a place far ahead of the rear axle, follows the steering better than what is 0.3 s late."""
    data = clean().with_channel("r", np.roll(clean()["r"], 15), "rad/s")
    data = data.with_channel("v_y", 0.1 * clean()["r"], "m/s")
    assert not any("swapped" in said for said in doubts(data, wheelbase=LENGTH))


def test_swapped_channels_are_named_where_v_y_moves_against_the_turn_too():
    """As of a car whose rear axle slips much: v_y then is small beside v_x r, and of the other sign."""
    data = clean()
    turn = data["v_x"] * data["r"]
    small = data.with_channel("a_y", -0.1 * turn, "m/s2").with_channel("v_y", turn, "m/s")
    assert ["swapped" in s for s in doubts(small, wheelbase=LENGTH)] == [True]


def test_a_stuck_sensor_makes_up_no_other_mistake():
    """Most of one drive's yaw rate at one value: what is left agrees with the steering."""
    data = clean()
    r = data["r"].copy()
    for a in data.starts:
        r[a + 300 : a + 1300] = r[a + 300]
    (said,) = doubts(data.with_channel("r", r, "rad/s"), wheelbase=LENGTH)
    assert said.startswith("r is stuck at one value for 20 s")


@pytest.mark.parametrize("seed", range(4))
def test_of_noise_no_sensor_is_called_late(seed):
    rng, data = np.random.default_rng(seed), clean()
    for name, size in (("r", 0.1), ("v_y", 0.3), ("a_y", 1.0)):
        data = data.with_channel(name, size * rng.standard_normal(len(data)), "-")
    assert doubts(data, wheelbase=LENGTH) == ()


def test_a_long_car_is_not_called_late():
    """By kinematics a_y is ahead of r by the time in which the car moves on by its rear length: 0.4 s here."""
    t, dt = 0.02 * np.arange(3000), 0.02
    v = np.full(3000, 9.0) + 2.0 * np.sin(0.05 * t)
    delta = 0.1 * np.sin(2 * np.pi * (0.05 + 0.004 * t) * t)
    r = v * delta / 7.0
    a_y = v * r + 3.6 * np.gradient(r, dt)
    noise = np.random.default_rng(0).standard_normal((2, 3000))
    outputs = {"r": r + 0.003 * noise[0], "a_y": a_y + 0.05 * noise[1]}
    data = Dataset.from_arrays({"delta": delta, "v_x": v}, outputs, dt)
    assert doubts(data, wheelbase=7.0) == ()
    late = data.with_channel("r", np.concatenate([np.zeros(15), data["r"][:-15]]), "rad/s")
    assert "behind a_y" in doubts(late, wheelbase=7.0)[0]


def test_a_speed_that_agrees_with_a_y_is_not_called_km_h():
    less = changed("delta", lambda delta: 4.5 * delta)
    (said,) = doubts(less, wheelbase=LENGTH)
    assert "delta is a command" in said
    assert "km/h" not in said
    (said,) = doubts(without_a_y(less), wheelbase=LENGTH)
    assert "v_x is logged in km/h: declare its unit as km/h, or delta is a command" in said


@pytest.mark.parametrize("share", [-1.0, 0.0])
def test_a_car_that_does_not_drive_forward_is_said_not_to(share):
    (said,) = doubts(changed("v_x", lambda v: share * v), wheelbase=LENGTH)
    assert said.startswith("v_x is hardly ever above zero")


def test_a_sound_log_raises_no_doubt():
    assert doubts(clean(), wheelbase=LENGTH) == ()
    assert doubts(without_a_y(clean()), wheelbase=LENGTH) == ()


@pytest.mark.parametrize("speed", [9.0, 25.0])
def test_at_one_speed_an_offset_of_the_yaw_rate_is_not_told_from_one_of_the_steering(speed):
    data = drive(speed, 1)
    assert doubts(data.with_channel("r", data["r"] + 0.2, "rad/s"), wheelbase=LENGTH) == ()


@pytest.mark.parametrize(
    ("name", "offset"), [("r", 0.06), ("r", -0.06), ("v_y", 0.5), ("delta", 0.02)], ids=["r", "-r", "v_y", "delta"]
)
def test_an_offset_turns_no_sensor_of_v_y(name, offset):
    """One of r, up to what a fit corrects, is slip that grows with speed as an angle of the sensor does."""
    assert doubts(changed(name, lambda x: x + offset), wheelbase=LENGTH) == ()


@pytest.mark.parametrize("bank", [0.03, -0.03])
def test_a_banked_road_turns_no_sensor_of_v_y(bank):
    """Its rear tires slip by bank g over what they hold per radian, 100 m/s2 here."""
    data = clean()
    slipped = data.with_channel("v_y", data["v_y"] - 9.81 * bank / 100.0 * data["v_x"], "m/s")
    assert doubts(slipped, wheelbase=LENGTH) == ()


def test_an_offset_of_the_steering_is_none_of_the_yaw_rate():
    assert doubts(changed("delta", lambda delta: delta + 0.03), wheelbase=LENGTH) == ()


@pytest.mark.parametrize("offset", [0.0, 0.12])
def test_tires_near_their_limit_are_no_offset_of_the_yaw_rate_and_change_none(offset):
    """A track that turns one way, at the grip's end: its understeer grows faster than its lateral acceleration."""
    parts = []
    for k, speed in enumerate((7.0, 10.0, 13.0, 16.0)):
        t, rng = np.arange(1500) * 0.02, np.random.default_rng(k)
        a_y = np.minimum(7.5, 0.03 * speed**2) * (1.0 + 0.3 * np.sin(2 * np.pi * 0.1 * t + k))
        r = a_y / speed
        delta = LENGTH * r / speed + 0.002 * a_y + 0.0001 * a_y**3
        noisy = r + offset + 0.003 * rng.standard_normal(len(t))
        parts.append(Dataset.from_arrays({"delta": delta, "v_x": np.full(len(t), speed)}, {"r": noisy}, 0.02))
    said = doubts(join(*parts), wheelbase=LENGTH)
    told = [float(s.split()[2]) for s in said if "on a straight" in s]
    assert told == ([] if offset == 0.0 else [pytest.approx(offset, abs=0.006)])
    assert len(said) == len(told)


def offset_anew(seed):
    """Drives whose steering sensors have other zeros; each at speeds that change inside it."""
    rng = np.random.default_rng(seed)
    parts = [join(drive(v, seed), drive(v + 6.0, seed + 1)) for v in (9.0, 14.0, 19.0)]
    return join(*(p.with_channel("delta", p["delta"] + 0.02 * rng.standard_normal(), "rad") for p in parts))


@pytest.mark.parametrize("seed", range(6))
def test_offsets_that_differ_between_drives_raise_no_doubt_and_hide_none(seed):
    data = offset_anew(seed)
    assert doubts(data, wheelbase=LENGTH) == ()
    for wrong, word in (
        (data.with_channel("v_x", 3.6 * data["v_x"]), "km/h"),
        (data.with_channel("delta", np.rad2deg(data["delta"])), "degrees"),
        (data.with_channel("delta", 15 * data["delta"]), "hand wheel"),
    ):
        (said,) = doubts(join(*map(without_a_y, wrong.experiments)), wheelbase=LENGTH)
        assert word in said


def test_drives_of_one_angle_each_show_units_together():
    """Steady circles: what the steering does inside a drive tells nothing."""
    parts = []
    for k, angle in enumerate((-0.06, -0.03, 0.02, 0.05)):
        t = np.arange(500) * 0.02
        v = 8.0 + 4.0 * t / 10
        rng = np.random.default_rng(k)
        r = v * angle / LENGTH / (1 + (v / 28.0) ** 2) + 0.003 * rng.standard_normal(500)
        delta = angle + 1e-4 * rng.standard_normal(500)
        parts.append(Dataset.from_arrays({"delta": delta, "v_x": v}, {"r": r}, 0.02))
    data = join(*parts)
    assert doubts(data, wheelbase=LENGTH) == ()
    (said,) = doubts(data.with_channel("delta", np.rad2deg(data["delta"])), wheelbase=LENGTH)
    assert "degrees" in said


@pytest.mark.parametrize("late", [0.1, 0.3, 0.5])
@pytest.mark.parametrize("gain", [1.0, 1 / 15])
def test_lane_changes_of_a_car_that_answers_late_are_no_hand_wheels(late, gain):
    """What is late looks small beside the steering; a lorry at one speed was said to log its hand wheel."""
    rng, dt = np.random.default_rng(3), 0.02
    t = np.arange(6000) * dt
    delta = 0.03 * np.sin(2 * np.pi * t / 3.0) * (np.mod(t, 9.0) < 3.0) * np.sign(np.sin(2 * np.pi * t / 18.0))
    delta += 0.002 * np.sin(2 * np.pi * 0.11 * t)
    speed = 18.0 + 2.0 * np.sin(2 * np.pi * t / 50.0)
    wheels, follows = 0.0, np.empty(len(t))
    for k, angle in enumerate(delta):
        wheels += (angle - wheels) * dt / late
        follows[k] = wheels
    r = follows * speed / LENGTH / (1 + (speed / 28.0) ** 2) + 0.003 * rng.standard_normal(len(t))
    data = Dataset.from_arrays({"delta": delta / gain, "v_x": speed}, {"r": r}, dt)
    said = doubts(data, wheelbase=LENGTH)
    assert [s for s in said if "hand wheel" not in s] == []
    assert len(said) == (gain != 1.0)
    assert kinematic_gain(data, wheelbase=LENGTH) == pytest.approx(gain, rel=1 / 3)


def session(seed, **change):
    """Half a minute at a low, then at a high speed, in one recording; ``change`` by channel."""
    parts = [drive(9.0, seed), drive(19.0, seed + 100)]
    table = {n: np.concatenate([p[n] for p in parts]) for n in parts[0].names}
    table |= {n: f(table[n]) for n, f in change.items()}
    return Dataset.from_arrays({n: table.pop(n) for n in ("delta", "v_x")}, table, parts[0].dt)


ODD = {
    "sign": ({"delta": np.negative}, "sign = -1 for delta"),
    "sign of r and v_y": ({"r": np.negative, "v_y": np.negative}, "wrong sign"),
    "g": ({"a_y": lambda a: a / 9.80665}, "a_y is logged in g"),
    "deg/s": ({"r": np.rad2deg}, "r is logged in deg/s"),
    "km/h": ({"v_x": lambda v: 3.6 * v}, "v_x is logged in km/h"),
}


@pytest.mark.parametrize("name", ODD)
@pytest.mark.parametrize("sound", [1, 2])
def test_a_mistake_of_one_recording_is_said_of_that_one(name, sound):
    change, said = ODD[name]
    days = [*(session(seed) for seed in range(sound)), session(7, **change)]
    found = doubts(join(*days), wheelbase=LENGTH)
    assert len(found) >= 1
    assert said in found[0]
    assert all(sentence.startswith(f"in recording {sound + 1} of {sound + 1}: ") for sentence in found)
    assert doubts(join(*(session(seed) for seed in range(3))), wheelbase=LENGTH) == ()


def test_a_mistake_of_two_recordings_in_three_is_said_of_both():
    days = [session(0), *(session(seed).with_channel("a_y", session(seed)["a_y"] / 9.80665, "m/s2") for seed in (1, 2))]
    found = doubts(join(*days), wheelbase=LENGTH)
    assert [(s[:22], "logged in g" in s) for s in found] == [(f"in recording {k} of 3: a_y"[:22], True) for k in (2, 3)]


def test_a_unit_that_changes_within_a_log_is_named_by_what_no_tires_give():
    data = without_a_y(session(3))
    later = np.where(np.arange(data.n_samples) < data.n_samples // 2, 1.0, 180 / np.pi)
    (said,) = doubts(data.with_channel("r", later * data["r"], "rad/s"), wheelbase=LENGTH)
    assert "no tires give" in said
    assert "deg/s" in said or "over a part of the log" in said


@pytest.mark.parametrize("hz", [50, 20, 10, 5])
def test_a_value_that_is_held_is_not_called_coarse(hz):
    rng, k = np.random.default_rng(4), 100 // hz
    t = np.arange(3000) * 0.01
    smooth = np.sin(0.7 * t) + 0.02 * rng.standard_normal(len(t))
    held = np.repeat(smooth[::k], k)
    data = Dataset.from_arrays({"delta": 0.02 * np.sin(t)}, {"r": held}, 0.01)
    (seen,) = [r for r in inspect(data).resolutions if r.channel == "r"]
    assert seen.step == 0.0
    assert seen.repeats == pytest.approx(1 - hz / 100, abs=0.02)
    coarse = data.with_channel("r", np.round(smooth, 1), "rad/s")
    (seen,) = [r for r in inspect(coarse).resolutions if r.channel == "r"]
    assert seen.step == pytest.approx(0.1)
    assert seen.repeats == 0.0


@pytest.mark.parametrize("row", [0, -1, 1, 2, -2, 200])
def test_a_spike_at_an_end_leaves_its_neighbours_as_they_are(row):
    y = np.sin(0.05 * np.arange(400))
    bad = y.copy()
    bad[row] += 5.0
    data = Dataset.from_arrays({"delta": 0.01 * y}, {"r": bad}, 0.01)
    mended, spikes = despike(data, "r")
    found = [] if row in (0, -1) else [row % 400]
    assert [s.row for s in spikes] == found
    assert np.flatnonzero(mended["r"] != bad).tolist() == found
    assert mended["r"][found] == pytest.approx(y[found], abs=0.11)


def test_a_recording_that_comes_twice_is_said_to():
    (said,) = doubts(join(session(0), session(1), session(0)), wheelbase=LENGTH)
    assert said.startswith("recording 3 has the samples of recording 1 again")


@pytest.mark.parametrize("share", [0.75, 1.3])
def test_an_a_y_of_another_scale_is_named_beside_v_y(share):
    (said,) = doubts(changed("a_y", lambda a: share * a), wheelbase=LENGTH)
    assert re.match(r"a_y is (0\.7|1\.[23])\d? times v_x r; expected 1 to 1\.15", said)
    assert "the scale of a_y is off, or that of r or v_x" in said


@pytest.mark.parametrize("share", [0.97, 1.15])
def test_an_a_y_that_feels_the_body_roll_is_none(share):
    assert doubts(changed("a_y", lambda a: share * a), wheelbase=LENGTH) == ()


def test_the_scale_of_an_a_y_without_v_y_is_left_to_the_fit():
    data = changed("a_y", lambda a: 1.3 * a)
    alone = {n: data[n] for n in ("r", "a_y")}
    inputs = {n: data[n] for n in ("delta", "v_x")}
    assert doubts(Dataset.from_arrays(inputs, alone, data.dt), wheelbase=LENGTH) == ()
