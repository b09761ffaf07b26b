"""Race logs: metres on the earth, laps through a gate, corners and their phases."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
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


def haversine(a, b):
    h = np.sin((b[0] - a[0]) / 2) ** 2 + np.cos(a[0]) * np.cos(b[0]) * np.sin((b[1] - a[1]) / 2) ** 2
    return 2 * EARTH * np.arcsin(np.sqrt(h))


@pytest.mark.parametrize("lat", [-0.9, 0.0, 0.466, 1.1])
@pytest.mark.parametrize("bearing", [0.0, 1.0, 2.5, 4.0])
def test_distances_over_a_track_are_those_on_the_sphere(lat, bearing):
    step = 1000 / EARTH
    ends = np.array([lat, lat + step * np.cos(bearing)]), np.array([3.1, 3.1 + step * np.sin(bearing) / np.cos(lat)])
    x, y = equirectangular(*ends)
    exact = haversine((ends[0][0], ends[1][0]), (ends[0][1], ends[1][1]))
    assert np.hypot(x[1], y[1]) == pytest.approx(exact, rel=3e-4)


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
