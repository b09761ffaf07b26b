"""Race logs: metres on the earth, laps through a gate, corners and their phases."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.data.public.sets import ferrari_250lm, public
from slipangle.data.quality.events import find_spikes
from slipangle.data.quality.inspect import estimate_delay, inspect
from slipangle.data.race import (
    EARTH,
    corners,
    equirectangular,
    lap_starts,
    laps,
    rmse_by_level,
    rmse_by_phase,
    with_position,
)
from slipangle.errors import ParameterError, TooShortError
from slipangle.identify.judge.compare import cross_validate
from slipangle.identify.linear.arx import ARX


def on_the_ellipsoid(lat, lon):
    """Places in space on WGS 84, whose chords are the distances over a track to a millimetre. [m]"""
    flat = 1 / 298.257223563
    square = flat * (2 - flat)
    N = 6378137.0 / np.sqrt(1 - square * np.sin(lat) ** 2)
    return np.array([N * np.cos(lat) * np.cos(lon), N * np.cos(lat) * np.sin(lon), N * (1 - square) * np.sin(lat)])


@pytest.mark.parametrize("lat", [-0.9, 0.0, 0.466, 1.1])
@pytest.mark.parametrize("bearing", [0.0, 1.0, 2.5, 4.0])
def test_distances_over_a_track_are_those_on_the_earth(lat, bearing):
    step = 1000 / EARTH
    ends = np.array([lat, lat + step * np.cos(bearing)]), np.array([3.1, 3.1 + step * np.sin(bearing) / np.cos(lat)])
    x, y = equirectangular(*ends)
    exact = np.linalg.norm(np.diff(on_the_ellipsoid(*ends)))
    assert np.hypot(x[1], y[1]) == pytest.approx(exact, rel=2e-4)  # 0.1 m at 1 km, far north more


@pytest.mark.parametrize("lat", [-0.9, 0.0, 0.863, 1.2])
def test_a_circle_on_the_earth_is_one_on_the_map(lat):
    turn = np.linspace(0, 2 * np.pi, 400)
    reach = 200 / EARTH
    around = lat + reach * np.sin(turn), 3.1 + reach * np.cos(turn) / np.cos(lat)
    x, y = equirectangular(*around, origin=(lat, 3.1))
    middle = on_the_ellipsoid(np.array(lat), np.array(3.1))[:, None]
    assert np.hypot(x, y) == pytest.approx(np.linalg.norm(on_the_ellipsoid(*around) - middle, axis=0), rel=1e-4)


def test_across_the_date_line():
    x, _ = equirectangular(np.zeros(2), np.array([np.pi - 1e-6, -np.pi + 1e-6]))
    assert x[1] == pytest.approx(2e-6 * EARTH, rel=1e-6)


def test_degrees_are_refused():
    with pytest.raises(ParameterError, match="convert degrees"):
        equirectangular(np.array([26.7]), np.array([-80.1]))


def circle(turns=3.2, n=1281, radius=100.0, v=20.0):
    """A steady left circle about the origin."""
    angle = np.linspace(0, 2 * np.pi * turns, n)
    dt = 2 * np.pi * turns * radius / v / (n - 1)
    return Dataset.from_arrays(
        {"v_x": np.full(n, v)},
        {"r": np.full(n, v / radius)},
        dt,
        extra={"X": radius * np.cos(angle), "Y": radius * np.sin(angle)},
    )


def test_laps_of_a_circle():
    data = circle()
    rows = lap_starts(data, gate=(0.0, 100.0), heading=np.pi)
    assert len(rows) == 3  # at 0.25, 1.25 and 2.25 turns
    lap = 2 * np.pi * 100 / 20
    assert np.diff(data.t[rows]) == pytest.approx(lap, abs=2 * data.dt)
    split = laps(data, rows)
    assert len(split.starts) == 2
    assert len(lap_starts(data, gate=(0.0, 100.0), heading=0.0)) == 0  # the other way round
    assert len(lap_starts(data, gate=(0.0, 150.0), heading=np.pi)) == 0  # beside the gate
    with pytest.raises(TooShortError, match="at least twice"):
        laps(data, rows[:1])


def test_position_channels():
    data = circle().with_channel("latitude", np.full(1281, 0.4), "rad").with_channel("longitude", np.zeros(1281), "rad")
    assert np.all(with_position(data)["X"] == 0)


def bends():
    """Straight, left bend of 3 s, straight, right bend of 2 s, a twitch of 0.2 s, straight."""
    t = np.arange(0, 20, 0.05)
    r = 0.3 * ((t >= 3) & (t < 6)) - 0.4 * ((t >= 10) & (t < 12)) + 0.5 * ((t >= 15) & (t < 15.2))
    return Dataset.from_arrays({"v_x": np.full(len(t), 20.0)}, {"r": r}, 0.05)


def test_corners_have_direction_and_phases():
    found = corners(bends())
    assert [c.left for c in found] == [True, False]
    assert found[0].start == pytest.approx(60, abs=4)
    assert found[0].stop == pytest.approx(120, abs=4)
    assert [found[0].phase(row) for row in (found[0].start, found[0].apex, found[0].stop - 1)] == [
        "entry",
        "middle",
        "exit",
    ]
    with pytest.raises(ParameterError, match="a_y"):
        corners(bends(), a_y=0.0)


def test_errors_by_phase_and_by_level():
    data, found = bends(), corners(bends())
    error = np.zeros(data.n_samples)
    for corner in found:
        error[corner.start : corner.stop] = [
            {"entry": 1.0, "middle": 2.0, "exit": 3.0}[corner.phase(k)] for k in range(corner.start, corner.stop)
        ]
    assert rmse_by_phase(error, found) == {"straight": 0.0, "entry": 1.0, "middle": 2.0, "exit": 3.0}
    assert np.isnan(rmse_by_phase(error, ())["entry"])
    level = np.array([0.0, -1.0, 1.0, 3.0, 4.0])
    by = rmse_by_level(np.array([1.0, 2.0, 2.0, 5.0, 5.0]), level, np.array([0.0, 1.0, 2.0, 3.0, 4.0]))
    assert by[[0, 1, 3]] == pytest.approx([1.0, 2.0, 5.0])
    assert np.isnan(by[2])


# ---- the real logs -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ferrari(real_data):
    return ferrari_250lm()


def test_the_ferraris_spikes_are_reported_and_gone(real_data, ferrari):
    raw = public("ferrari-250lm")
    spikes = find_spikes(raw, "delta")
    assert [s.t for s in spikes] == pytest.approx([207.26, 503.48, 524.84, 671.66], abs=0.02)
    assert all(s.samples == 1 and 0.1 < abs(s.size) < 0.6 for s in spikes)
    told = [note for note in ferrari.notes if "delta has a spike" in note]
    assert len(told) == 4
    assert "replaced by the median of 5 samples" in told[0]
    for spike in spikes:
        k = int(np.argmin(np.abs(ferrari.t - spike.t)))
        assert np.abs(np.diff(ferrari["delta"][k - 4 : k + 5], 2)).max() < 0.1 * abs(spike.size)


def test_resampling_the_ferrari_lets_nothing_fold_back(real_data):
    """A tone above the new Nyquist frequency, laid over the yaw rate, is gone after resampling."""
    raw = public("ferrari-250lm")
    tone = raw.with_channel("r", raw["r"] + 0.1 * np.sin(2 * np.pi * 17.0 * raw.t), "rad/s")  # would fold to 3 Hz
    plain, toned = (d.resample(0.05, cutoff=8.0)["r"] for d in (raw, tone))
    assert np.std(toned - plain) < 2e-3
    assert np.std(tone["r"][::5] - raw["r"][::5]) > 0.05


def test_laps_and_corners_of_palm_beach(ferrari):
    """A circuit of 3.3 km with ten turns, driven clockwise."""
    starts = lap_starts_by_dead_reckoning(ferrari)
    split = laps(ferrari, starts)
    lengths = [float(np.sum(part["v_x"]) * part.dt) for part in split.experiments]
    assert len(lengths) == 5
    assert np.median(lengths) == pytest.approx(3200, rel=0.05)  # the racing line cuts what the map adds up
    assert np.ptp(lengths) < 0.03 * np.median(lengths)
    part = split.experiments[1]
    found = corners(part)
    assert len(found) == 10
    right = sum(c.stop - c.start for c in found if not c.left)
    assert right > 0.5 * sum(c.stop - c.start for c in found)
    assert {found[0].phase(k) for k in range(found[0].start, found[0].stop)} == {"entry", "middle", "exit"}


def lap_starts_by_dead_reckoning(data):
    """Dead reckoning drifts, so a lap ends where heading has turned by another full turn on the fast straight."""
    turned = -(data["psi"] - data["psi"][0]) / (2 * np.pi)  # clockwise
    fast = int(np.argmax(data["v_x"]))
    offset = turned[fast] % 1.0
    whole = np.floor(turned - offset)
    rows = np.flatnonzero(np.diff(np.maximum.accumulate(whole)) > 0) + 1
    return rows


def test_the_dallara_crosses_its_gate_once_a_lap(real_data):
    data = public("iac-putnam")
    fast = data.t > 202.0
    k = int(np.argmax(np.where(fast, data["v_x"], 0.0)))
    heading = float(np.arctan2(*(data[n][k + 5] - data[n][k] for n in ("Y", "X"))))
    rows = lap_starts(data, gate=(float(data["X"][k]), float(data["Y"][k])), heading=heading)
    lengths = [float(np.sum(part["v_x"]) * part.dt) for part in laps(data, rows).experiments]
    assert len(lengths) >= 2
    assert lengths == pytest.approx([2865] * len(lengths), rel=0.03)  # Putnam Park, 1.78 miles


def test_lags_and_offsets_between_the_ferraris_channels(ferrari):
    found = estimate_delay(ferrari, "delta", "r")
    assert found.clear
    assert found.seconds == pytest.approx(0.085, abs=0.015)  # 80 to 90 ms
    shifted = ferrari.rows(0, ferrari.n_samples - 4).with_channel("r", ferrari["r"][4:], "rad/s")
    earlier = estimate_delay(shifted, "delta", "r")
    assert earlier.seconds == pytest.approx(found.seconds - 4 * ferrari.dt, abs=0.02)
    assert {o.channel for o in inspect(ferrari).offsets} >= {"delta", "v_y"}


def test_sessions_are_split_as_wholes(ferrari):
    """Each session is left out once; windows and lags never reach from one into the other."""
    other = public("ferrari-250lm-session").resample(0.05)
    parts = []
    for d in (ferrari.rows(0, 4000), other):
        one = Dataset.from_arrays({n: d[n] for n in ("delta", "v_x")}, {"r": d["r"]}, 0.05, name=d.name)
        parts.append(one)
    both = join(*parts)
    assert both.starts == (0, 4000)
    folds = cross_validate(ARX(na=2, nb=2), both).folds
    assert len(folds) == 2
    alone = ARX(na=2, nb=2).fit(parts[1])
    assert np.allclose(folds[0].model.A, alone.A)
    judged = alone.simulate(parts[0])
    assert folds[0].scores["r"].rmse == pytest.approx(np.sqrt(np.mean(judged.error[judged.predicted] ** 2)))
