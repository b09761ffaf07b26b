"""Headings wrap: nothing interpolates or averages across the circle, and what is no heading stays as it is."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.data.headings import is_heading, unwrapped, wraps

TURNING = np.arange(60.0)  # deg, one each 10 ms
TIME = 0.01 * np.arange(60)


def logged(degrees):
    """As a compass says it, 0 to 360 deg."""
    return (350 + degrees) % 360


def heading(data, name="psi"):
    return np.rad2deg(data[name])


def from_log(rows=slice(None), time=TIME):
    frame = {"t": time, "psi [deg]": logged(100 * time), "r [rad/s]": np.ones(60)}
    return sa.from_frame({name: column[rows] for name, column in frame.items()})


def told(data, name="psi"):
    return [note for note in data.notes if note == f"{name} wraps: leaps of a full turn are taken out"]


@pytest.mark.parametrize(
    ("name", "unit", "is_one"),
    [
        ("psi", "rad", True),
        ("psi", "-", True),
        ("psi", None, True),
        ("psi", "Pa", False),
        ("heading", "deg", True),
        ("GPS Course", "rad", True),
        ("imu.yaw", "rad", True),
        ("cog", "deg", True),
        ("GPS Track", "deg", True),
        ("beta CoG", "deg", False),
        ("roll angle cog", "rad", False),
        ("track width", "deg", False),
        ("heading", "-", False),
        ("heading", None, False),
        ("yaw", "deg/s", False),
        ("yaw rate", "deg", False),
        ("r", "rad/s", False),
        ("delta", "rad", False),
        ("delta_sw", "rad", False),
        ("beta", "rad", False),
        ("steering course", "rad", False),
        ("epsilon", "rad", False),
        ("Lenkwinkel", "deg", False),
        ("heading", "furlong", False),
    ],
)
def test_what_is_a_heading(name, unit, is_one):
    assert is_heading(name, unit) is is_one


@pytest.mark.parametrize("scale", [1.0, 180 / np.pi])
def test_whole_turns_and_nothing_else_are_added(scale):
    true = np.cumsum(np.random.default_rng(0).uniform(-2.0, 2.0, 400))
    wrapped = (true + np.pi) % (2 * np.pi) - np.pi
    found = unwrapped(scale * wrapped, 2 * np.pi * scale)
    np.testing.assert_allclose(found - found[0], scale * (true - true[0]), atol=1e-9 * scale)
    smooth = np.linspace(0, 50, 400)
    assert unwrapped(smooth) is smooth
    assert not len(wraps(np.rad2deg(wrapped)))  # degrees taken for radians span too much for an angle


def test_a_heading_is_resampled_on_the_circle():
    data = from_log()
    for dt in (0.0075, 0.05, 0.02):
        there = data.resample(dt)
        np.testing.assert_allclose(heading(there), 350 + 100 * there.t, atol=0.01)
        assert len(told(there)) == 1
    assert len(told(data.resample(0.0075).resample(0.02))) == 1  # once it goes on, it wraps no more


def test_a_lost_sample_at_the_wrap_is_filled_on_the_circle():
    data = from_log(np.arange(60) != 10)
    np.testing.assert_allclose(heading(data), 350 + TURNING, atol=1e-9)
    assert len(told(data)) == 1


def test_uneven_stamps_at_the_wrap_are_interpolated_on_the_circle():
    time = TIME + 0.001 * np.random.default_rng(1).uniform(-1, 1, 60)
    data = from_log(time=time)
    np.testing.assert_allclose(heading(data), 350 + 100 * data.t, atol=1e-6)


@pytest.mark.parametrize(
    ("columns", "name"),
    [
        (None, "psi"),
        ({"psi": sa.Column("psi", "deg"), "r": "r"}, "psi"),
        ({"course": "psi", "r": "r"}, "course"),
    ],
)
def test_a_slow_heading_is_merged_on_the_circle(columns, name):
    slow = np.where(np.arange(60) % 4 == 0, logged(TURNING), np.nan)
    frame = {"t": TIME, "psi [deg]": slow, "r [rad/s]": np.ones(60)}
    data = sa.from_frame(frame, columns, nan="merge")
    np.testing.assert_allclose(heading(data, name), 350 + 100 * data.t, atol=1e-6)
    assert len(told(data, name)) == 1


def test_a_slow_heading_that_a_channel_follows_from_is_merged_on_the_circle():
    slow = np.where(np.arange(60) % 4 == 0, logged(TURNING), np.nan)
    columns = {"psi": sa.Column(derive="course - 0.1"), "r": "r"}
    data = sa.from_frame({"t": TIME, "course [deg]": slow, "r": np.ones(60)}, columns, nan="merge")
    np.testing.assert_allclose(data["psi"], np.deg2rad(350 + 100 * data.t) - 0.1, atol=1e-6)


def test_raw_counts_of_a_slow_heading_wrap_by_their_own_turn():
    slow = np.where(np.arange(60) % 4 == 0, logged(TURNING) * 100, np.nan)
    columns = {"psi": sa.Column("heading", "deg", scale=0.01), "r": "r"}
    data = sa.from_frame({"t": TIME, "heading": slow, "r": np.ones(60)}, columns, nan="merge")
    np.testing.assert_allclose(heading(data), 350 + 100 * data.t, atol=1e-6)


def test_means_over_a_sample_and_levels_are_taken_on_the_circle():
    data = sa.Dataset.from_arrays({"psi": np.deg2rad(logged(TURNING))}, {"r": np.ones(60)}, 0.01)
    np.testing.assert_allclose(heading(data.hold_mean())[:-1], 350.5 + TURNING[:-1], atol=1e-9)
    np.testing.assert_allclose(heading(data.detrend()[0]), TURNING - TURNING.mean(), atol=1e-9)


def test_every_experiment_goes_on_by_itself_and_others_stay_as_logged():
    one = sa.Dataset.from_arrays({"u": TURNING}, {"psi": np.deg2rad(logged(TURNING))}, 0.01)
    both = sa.join(one, one)
    there = both.unwrapped()
    np.testing.assert_allclose(heading(there), np.tile(350 + TURNING, 2), atol=1e-9)
    np.testing.assert_array_equal(there["u"], both["u"])
    assert len(told(there)) == 1
    assert there.unwrapped() is there
    assert one["psi"][10] == 0.0  # what nothing interpolates stays as logged


@pytest.mark.parametrize("name", ["delta", "delta_sw", "beta", "hand"])
def test_other_angles_are_never_touched(name):
    x = np.deg2rad(logged(TURNING))
    data = sa.Dataset.from_arrays({name: x}, {"r": np.ones(60)}, 0.01, units={name: "rad"})
    assert data.unwrapped() is data
    assert data.hold_mean()[name][9] == pytest.approx(np.deg2rad(179.5))
    (wrap,) = sa.inspect(data).wraps
    assert "what interpolates runs through its half turn" in wrap.sentence


def test_inspect_tells_of_wraps_and_does_not_call_them_jumps():
    rng = np.random.default_rng(2)
    psi = (np.cumsum(0.02 + 0.01 * rng.standard_normal(2000)) + np.pi) % (2 * np.pi) - np.pi
    report = sa.inspect(
        sa.Dataset.from_arrays({"psi": psi}, {"other": psi}, 0.01, units={"psi": "rad", "other": "rad"})
    )
    assert not report.jumps
    assert not report.spikes
    assert [(w.channel, w.heading) for w in report.wraps] == [("psi", True), ("other", False)]
    turns = int((np.diff(psi) < -np.pi).sum())
    assert {len(w.rows) for w in report.wraps} == {turns}
    assert f"the first of {turns} such leaps: an angle that wraps; data.unwrapped()" in report.wraps[0].sentence
    steady = sa.Dataset.from_arrays({"psi": np.linspace(0, 30, 500)}, {"r": np.ones(500)}, 0.01)
    assert sa.inspect(steady).wraps == ()
