"""Spikes, jumps, delays, offsets, excitation: found where they are, silent where there are none."""

import numpy as np
import pytest
from scipy import signal

from slipangle import errors
from slipangle.data.dataset import Channel, Dataset, join
from slipangle.data.quality.delay import Delay
from slipangle.data.quality.inspect import (
    despike,
    estimate_delay,
    find_jumps,
    find_spikes,
    inspect,
)
from slipangle.data.signals import excitation as excite


def smooth(n=4000, dt=0.01, corner=1.0, seed=0, size=0.05):
    margin = round(5 / corner / dt)
    noise = np.random.default_rng(seed).normal(size=n + 2 * margin)
    wave = signal.sosfiltfilt(signal.butter(3, corner, fs=1 / dt, output="sos"), noise)[margin:-margin]
    return size * wave / wave.std()


def one(x, name="delta", unit="rad", dt=0.01, t0=100.0):
    return Dataset(values=x, channels=(Channel(name, unit),), dt=dt, start_times=(t0,), inputs=(name,))


# ---- spikes ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [0.03, -0.1, 0.5])
@pytest.mark.parametrize("quantum", [0.0, 1e-3])
@pytest.mark.parametrize("samples", [1, 2])
def test_spikes_are_found_with_time_and_size_and_removed(size, quantum, samples):
    clean = smooth()
    if quantum:
        clean = np.round(clean / quantum) * quantum
    rows = [2, 700, 1500, 3997] if samples == 1 else [700, 1500, 3990]
    dirty = clean.copy()
    for row in rows:
        dirty[row : row + samples] += size
    found = find_spikes(one(dirty), "delta")
    assert [s.row for s in found if s.samples == samples] == pytest.approx(rows, abs=samples - 1)
    assert len(found) == len(rows)
    for spike in found:
        assert spike.size == pytest.approx(size, abs=5e-3)
        assert spike.t == pytest.approx(100 + 0.01 * spike.row)
        assert f"{spike.t:.2f} s" in spike.sentence
        assert "deg" in spike.sentence
    repaired, same = despike(one(dirty), "delta")
    assert tuple(same) == found
    touched = np.flatnonzero(repaired["delta"] != dirty)
    assert set(touched) <= {r + k for r in rows for k in range(samples)}
    np.testing.assert_allclose(repaired["delta"], clean, atol=5e-3)
    assert len(repaired.notes) == len(rows)


@pytest.mark.parametrize("many", [36, 44, 80, 200])
def test_dropouts_are_found_however_many_there_are(many):
    """From 1 % of the samples on they are the tail that the usual scatter was once told by."""
    rng = np.random.default_rng(4)
    clean = 20 + 2 * np.sin(0.002 * np.arange(4000)) + 0.02 * rng.normal(size=4000)
    rows = np.arange(15, 3990, 3980 // many)[:many]
    dirty = clean.copy()
    dirty[rows] = 0.0
    data = one(dirty, "v_x", "m/s", dt=0.02)
    assert [s.row for s in find_spikes(data, "v_x")] == rows.tolist()
    repaired, _ = despike(data, "v_x")
    np.testing.assert_allclose(repaired["v_x"], clean, atol=0.2)


@pytest.mark.parametrize(
    "x",
    [
        smooth(),
        np.round(smooth(), 2),
        np.random.default_rng(1).normal(size=4000),
        np.random.default_rng(2).laplace(size=4000),
        excite.prbs(4000, hold=20),
        excite.staircase(4000, 0.01, levels=(0, 1, 3, -1)),
        np.sin(0.3 * np.arange(4000)),
        np.zeros(4000),
        np.ones(3),
    ],
    ids=["smooth", "rounded", "normal", "laplace", "prbs", "stairs", "sine", "zeros", "three"],
)
def test_no_spikes_where_there_are_none(x):
    data = one(x)
    assert find_spikes(data, "delta") == ()
    same, found = despike(data, "delta")
    assert same is data
    assert found == []


def test_corners_of_a_steering_between_slow_and_quick_are_no_spikes():
    """Most of the samples move slowly, so that where it turns into a quick swing a corner stands out of the bulk."""
    slope = np.tile(np.concatenate([np.full(388, -2e-5), np.full(12, 38.8e-4 / 6)]), 10)
    x = np.cumsum(np.convolve(slope, np.hanning(7)[1:-1] / 3, "same"))
    assert find_spikes(one(x), "delta") == ()
    x[1000] += 0.05
    assert [s.row for s in find_spikes(one(x), "delta")] == [1000]


def test_spikes_do_not_reach_across_experiments():
    low, high = one(smooth(seed=1)), one(smooth(seed=2) + 50.0)
    assert find_spikes(join(low, high), "delta") == ()


@pytest.mark.parametrize(("width", "threshold"), [(4, 12), (1, 12), (5, 0), (5, -1)])
def test_bad_spike_settings(width, threshold):
    with pytest.raises(errors.ParameterError, match="expected"):
        find_spikes(one(smooth()), "delta", width=width, threshold=threshold)


# ---- jumps -------------------------------------------------------------------------------------------------------


def test_jumps_of_a_speed_beyond_what_tires_can_do():
    v = 30 + np.cumsum(np.full(4000, -0.09))
    v[1000:] += 0.3
    v[2500:] -= 0.4
    found = find_jumps(one(v, "v_x", "m/s"), "v_x")
    assert [(j.row, round(j.size, 2)) for j in found] == [(1000, 0.21), (2500, -0.49)]
    assert "jumps by +0.756 km/h in one sample at t = 110.00 s" in found[0].sentence
    assert find_jumps(one(v, "v_x", "m/s"), "v_x", fastest=100.0) == ()


@pytest.mark.parametrize("size", [0.05, -0.2])
def test_jumps_of_other_channels_stay(size):
    x = smooth()
    x[1200:] += size
    x[3000] += 0.5
    spikes = find_spikes(one(x), "delta")
    found = find_jumps(one(x), "delta", skip=spikes)
    assert [j.row for j in found] == [1200]
    assert found[0].size == pytest.approx(size, abs=5e-3)


@pytest.mark.parametrize("seed", range(3))
def test_no_jumps_where_there_are_none(seed):
    for x in (smooth(seed=seed), np.random.default_rng(seed).normal(size=4000), np.zeros(4000)):
        assert find_jumps(one(x), "delta") == ()


def test_borders_of_experiments_are_no_jumps():
    assert find_jumps(join(one(smooth(seed=1)), one(smooth(seed=2) + 5.0)), "delta") == ()


# ---- delays ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [0.01, 0.02, 0.05])
@pytest.mark.parametrize("delay", [0.0, 0.0375, 0.08, 0.213])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_pure_delay_is_found_between_the_samples(dt, delay, sign):
    fine = 0.0025
    u = smooth(int(120 / fine), fine, corner=2.0, seed=3)
    shift, every = round(delay / fine), round(dt / fine)
    y = sign * np.roll(u, shift)[::every]
    noise = 0.1 * u.std() * np.random.default_rng(5).normal(size=len(y))
    data = Dataset.from_arrays({"u": u[::every]}, {"y": y + noise}, dt)
    found = estimate_delay(data, "u", "y")
    assert found.clear
    assert found.seconds == pytest.approx(delay, abs=3e-3)
    assert np.sign(found.agreement) == sign
    back = estimate_delay(data, "y", "u")
    assert back.seconds == pytest.approx(-delay, abs=3e-3)
    if delay:
        assert "follows" in found.sentence
        assert "before" in back.sentence


@pytest.mark.parametrize("seed", range(5))
def test_no_delay_between_strangers(seed):
    data = Dataset.from_arrays({"u": smooth(20000, seed=seed)}, {"y": smooth(20000, seed=seed + 50)}, 0.01)
    found = estimate_delay(data, "u", "y")
    assert not found.clear
    assert found.sentence.startswith("no clear delay between u and y: what they have in common is no more than chance")


def test_delay_of_a_gapped_recording():
    u = smooth(12000, seed=7)
    data = Dataset.from_arrays({"u": u[10:]}, {"y": u[:-10]}, 0.01)
    parts = join(data.rows(0, 6000), data.rows(6100, 11990))
    assert estimate_delay(parts, "u", "y").seconds == pytest.approx(0.1, abs=3e-3)


def test_delay_refuses_what_cannot_tell():
    data = Dataset.from_arrays({"u": smooth(500)}, {"y": np.zeros(500)}, 0.01)
    with pytest.raises(errors.ExcitationError, match="channel 'y' is constant"):
        estimate_delay(data, "u", "y")
    with pytest.raises(errors.TooShortError, match=r"add up to 4 s .the longest lasts 5 s.; expected at least 32 s"):
        estimate_delay(data, "u", "u")
    with pytest.raises(errors.ParameterError, match="positive"):
        estimate_delay(data, "u", "u", longest=0.0)


def short_experiments(pure, lag, seed, count=18, seconds=20.0):
    """Experiments of a first-order system with a pure delay, simulated ten times as finely as they are logged."""
    fine, every, rng, made = 0.001, 10, np.random.default_rng(seed), []
    for k in range(count):
        u = smooth(round(seconds / fine), fine, corner=3.0, seed=1000 * seed + k, size=1.0)
        y = np.concatenate([np.zeros(round(pure / fine)), u])[: len(u)]
        if lag:
            y = signal.lfilter([1 - np.exp(-fine / lag)], [1, -np.exp(-fine / lag)], y)
        y = y[::every] + 0.1 * rng.normal(size=len(y[::every]))
        made.append(Dataset.from_arrays({"u": u[::every]}, {"y": y}, every * fine))
    return join(*made)


@pytest.mark.parametrize(("pure", "lag"), [(0.02, 0.05), (0.06, 0.0), (0.0, 0.1), (0.1, 0.03), (0.02, 0.2)])
@pytest.mark.parametrize("seed", [1, 2])
def test_delay_and_lag_come_apart_over_many_short_experiments(pure, lag, seed):
    found = estimate_delay(short_experiments(pure, lag, seed), "u", "y")
    assert found.clear
    assert found.apart
    assert found.pure == pytest.approx(pure, abs=0.002 + 1.96 * found.pure_std)  # a lag at zero is a corner
    assert found.lag == pytest.approx(lag, abs=0.002 + 1.96 * found.lag_std)
    assert 1.96 * max(found.pure_std, found.lag_std) < 0.0045
    assert 0.5 * (pure + lag) < found.seconds < pure + lag + 0.002
    assert f"pure delay {round(1000 * found.pure)} (±" in found.sentence


def test_a_slow_input_does_not_tell_delay_from_lag():
    u = smooth(12000, corner=0.15, seed=3)
    y = np.roll(u, 6) + 0.05 * u.std() * np.random.default_rng(1).normal(size=len(u))
    found = estimate_delay(Dataset.from_arrays({"u": u}, {"y": y}, 0.01), "u", "y")
    assert found.clear
    assert not found.apart
    assert "how much of it is pure delay and how much lag, these data do not tell" in found.sentence


COLOURS = {"white": None, "below 1.5 Hz": 1.5, "below 0.3 Hz": 0.3, "a random walk": 0.0}


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(1, 40), (18, 20), (10, 6)], ids=["one", "many", "short"])
@pytest.mark.parametrize("colour", COLOURS)
def test_strangers_have_a_delay_in_two_of_a_hundred_logs_at_most(shape, colour):
    """Noise against noise, 200 seeds; five alarms is what 1 % exceeds in 2 % of such experiments."""
    count, n = shape[0], 50 * shape[1]
    alarms = 0
    for seed in range(200):
        made = []
        for part in range(count):
            u, y = np.random.default_rng((seed, part)).normal(size=(2, n))
            if COLOURS[colour] == 0.0:
                u, y = np.cumsum(u), np.cumsum(y)
            elif COLOURS[colour]:
                low = signal.butter(2, COLOURS[colour], fs=50, output="sos")
                u, y = signal.sosfiltfilt(low, u), signal.sosfiltfilt(low, y)
            made.append(Dataset.from_arrays({"u": u}, {"y": y}, 0.02))
        alarms += estimate_delay(join(*made) if count > 1 else made[0], "u", "y").clear
    assert alarms <= 5


def test_an_input_that_hardly_moves_gives_no_delay():
    rng = np.random.default_rng(0)
    delta = 1e-4 * rng.normal(size=6000)  # noise of the sensor
    data = Dataset.from_arrays({"delta": delta}, {"r": 0.01 * rng.normal(size=6000)}, 0.01)
    (delay,) = inspect(data).delays
    assert not delay.clear


# ---- the report --------------------------------------------------------------------------------------------------


def drive(offset=0.01):
    """A car that weaves, drives straight, and weaves again; steering shows an offset."""
    n = 12000
    r = smooth(n + 8, size=0.3, seed=4)
    ahead, r = r[8:], r[:n]
    taper = np.clip((np.abs(np.arange(n) - n / 2) - 1500) / 500, 0, 1) ** 2
    ahead, r = ahead * taper, r * taper
    v_x = 20 + smooth(n, corner=0.2, size=2.0, seed=5)
    delta = ahead * 2.5 / v_x + offset
    return Dataset.from_arrays(
        {"delta": delta, "v_x": v_x},
        {"r": r},
        0.01,
        extra={"a_y": v_x * r},
        units={"delta": "rad", "v_x": "m/s", "r": "rad/s", "a_y": "m/s2"},
    )


def test_report_finds_offset_delay_and_rest():
    report = inspect(drive())
    (offset,) = [o for o in report.offsets if o.channel == "delta"]
    assert offset.value == pytest.approx(0.01, abs=1e-3)
    assert "+0.57 deg" in offset.sentence
    (delay,) = [d for d in report.delays if d.input == "delta"]
    assert delay.seconds == pytest.approx(0.08, abs=0.01)
    (rest,) = [s for s in report.stretches if s.channel == "r"]
    assert rest.duration == pytest.approx(30.0, abs=0.5)
    assert report.spikes == ()
    assert report.sentences[0] == "12000 samples at 100 Hz, 120 s, no gaps"
    assert all(f.sentence in report.sentences for f in report.findings)


@pytest.mark.parametrize("scale", [0.1, 3.0])
def test_a_straight_is_one_for_a_car_of_any_size(scale):
    data = drive()
    for name, unit in (("v_x", "m/s"), ("a_y", "m/s2")):
        data = data.with_channel(name, scale * data[name], unit)
    assert [o for o in inspect(data).offsets if o.channel == "delta"] == [
        o for o in inspect(drive()).offsets if o.channel == "delta"
    ]


def test_between_two_bends_a_car_does_not_drive_straight():
    """Its steering is ahead of it then; what it shows at no yaw rate is the lag, not an offset."""
    t = np.arange(0.0, 60.0, 0.01)
    ahead, now = (
        sum(0.02 * np.sin(2 * np.pi * f * (t + lead) + 7 * f) for f in (0.2, 0.5, 1.1)) for lead in (0.1, 0.0)
    )
    data = Dataset.from_arrays(
        {"delta": ahead, "v_x": 20.0 + 0.0 * t}, {"r": 6.0 * now}, 0.01, extra={"a_y": 120.0 * now}
    )
    assert inspect(data).offsets == ()


def test_report_names_pairs_that_physics_ties_and_points_to_a_model():
    delays = inspect(drive()).delays
    assert [(d.input, d.output) for d in delays] == [("delta", "r")]
    assert "delay, actuator and the car's own lag together" in delays[0].sentence
    assert delays[0].sentence.endswith("identify_car separates them with a model")


def test_report_says_why_there_is_no_delay():
    report = inspect(drive().rows(0, 2000))
    (said,) = [s for s in report.sentences if "delay" in s]
    assert said.startswith("no clear delay between delta and r: stretches of")
    assert "expected at least 32 s" in said


def test_report_on_gaps_and_notes():
    data = join(one(smooth(), t0=0.0), one(smooth(), t0=41.5)).with_note("seen")
    report = inspect(data)
    assert report.gaps == pytest.approx((1.5,))
    assert "1 border between experiments, the longest gap 1.5 s" in report.sentences[0]
    assert report.sentences[-1] == "seen"


def test_report_on_clipping_resolution_and_repeats():
    x = smooth(size=1.0)
    clipped = np.clip(x, -1.2, 1.2)
    (high, low) = inspect(one(clipped)).clippings
    assert (high.value, low.value) == (1.2, -1.2)
    assert high.share == pytest.approx(np.mean(x >= 1.2), abs=1e-3)
    assert inspect(one(x)).clippings == ()
    assert inspect(one(excite.prbs(4000, hold=20))).clippings == ()
    (steps,) = inspect(one(np.round(x, 2))).resolutions
    assert steps.step == pytest.approx(0.01)
    held = np.repeat(x[::4], 4)
    (repeats,) = inspect(one(held)).resolutions
    assert repeats.repeats == pytest.approx(0.75, abs=0.01)
    assert "about 25 Hz" in repeats.sentence
    assert inspect(one(x)).resolutions == ()


def test_a_rounded_channel_is_not_said_to_come_at_a_lower_rate():
    """A wheel's angle in steps of 0.5 degrees, read between its samples, repeats where it moves slowly."""
    x = np.round(np.rad2deg(smooth(corner=0.5)) * 15 / 0.5) * 0.5
    x = np.interp(np.arange(4000) + 0.3 + 0.3 * np.sin(np.arange(4000)), np.arange(4000), x)  # so it has no levels
    assert np.mean(np.diff(x) == 0) > 0.1
    assert not any("new values" in r.sentence for r in inspect(one(np.deg2rad(x / 15))).resolutions)


def test_report_on_excitation():
    t = 0.01 * np.arange(6000)
    (tone,) = inspect(one(np.sin(2 * np.pi * 2.0 * t))).excitations
    assert tone.bandwidth == pytest.approx(2.0, abs=0.1)
    assert tone.sentence.startswith("delta runs from -57.2 to 57.2 deg, standard deviation 40.5")
    (still,) = inspect(one(np.full(500, 3.0))).excitations
    assert still.constant
    assert still.sentence == "delta is constant at 171.9 deg: it excites nothing"


def test_many_events_are_told_in_one_sentence():
    x = smooth()
    x[100:3900:200] += 0.3
    x[2100] = 0.6
    report = inspect(one(x))
    assert len(report.spikes) == 19
    told = [s for s in report.sentences if "spike" in s]
    assert len(told) == 1
    size = 0.6 - np.median(x[2098:2103])
    assert f"19 spikes, the largest {np.degrees(size):+.3g} deg at t = 121.00 s" in told[0]


@pytest.mark.parametrize("n", [1, 2, 3, 9, 40])
def test_tiny_recordings_do_not_break_the_report(n):
    report = inspect(drive().rows(0, n))
    assert report.samples == n
    assert all(isinstance(s, str) and s for s in report.sentences)


def test_a_lag_that_could_not_be_split_is_told_without_parts():
    found = Delay(input="delta", output="r", seconds=0.05, agreement=0.9, coherent=0.1, chance=0.001)
    assert found.sentence.startswith("r follows delta by 50 ms: delay, actuator and the car's own lag together; ")
    early = Delay(input="delta", output="a_y", seconds=-0.09, agreement=0.9, coherent=0.1, chance=0.001)
    assert early.sentence.endswith("clocks that disagree, or slow driving, where a_y is ahead")


# ---- dropouts ----------------------------------------------------------------------------------------------------


def cornering(n=4000):
    """A drive of slow bends at 50 Hz, as sensors see it."""
    rng, t = np.random.default_rng(12), 0.02 * np.arange(n)
    delta, v_x = 0.03 * np.sin(2 * np.pi * 0.3 * t), 20 + 2 * np.sin(0.1 * t) + 0.02 * rng.normal(size=n)
    r = v_x * delta / 2.7 + 0.002 * rng.normal(size=n)
    units = {"delta": "rad", "v_x": "m/s", "r": "rad/s"}
    return Dataset.from_arrays({"delta": delta, "v_x": v_x}, {"r": r}, 0.02, units=units)


@pytest.mark.parametrize("channel", ["v_x", "delta", "r"])
@pytest.mark.parametrize("samples", [1, 3, 9])
def test_channels_that_drop_to_zero_are_named(channel, samples):
    """However often they do: 3 % of the samples are neither spikes nor jumps, as those are told from the usual."""
    data = cornering()
    x = data[channel].copy()
    for k in range(30, 3950, 97):
        x[k : k + samples] = 0.0
    report = inspect(data.with_channel(channel, x, data.unit(channel)))
    (found,) = report.dropouts
    assert (found.channel, found.samples) == (channel, samples)
    assert found.count > 20
    assert any(f"{channel} drops to 0 and comes back in {found.count} places" in s for s in report.sentences)


def test_a_car_that_stands_and_an_angle_that_passes_zero_drop_out_nowhere():
    data = cornering()
    assert inspect(data).dropouts == ()
    v_x = np.clip(10 - 0.4 * np.abs(data.t - 40.0), 0.0, None)
    stands = np.concatenate([v_x, v_x, np.zeros(30)])[: len(v_x)]
    rounded = np.round(data["r"] / 0.01) * 0.01
    assert inspect(data.with_channel("v_x", stands, "m/s").with_channel("r", rounded, "rad/s")).dropouts == ()
