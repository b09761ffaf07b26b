"""What a learned model knows of the data it was trained on, and what is said of runs that leave them."""

import warnings

import numpy as np
import pytest
from scipy.signal import lfilter

import slipangle as sa
from slipangle.data.dataset import join
from slipangle.errors import ModelWarning
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.region import OUTSIDE, Region
from slipangle.models.wrappers.hybrid import OffsetModel

DT = 0.05


def filtered(rng, n):
    """Noise of unit size, slower than 1 Hz or so."""
    x = lfilter([1.0], [1, -1.7, 0.74], rng.standard_normal(n + 200))[200:]
    return x / x.std()


def drive(seed, *, seconds=180.0, amp=1.0, v_x=15.0):
    """A car whose yaw rate follows ``v_x delta / (L + K v_x^2)`` with a lag of a quarter of a second."""
    rng, n = np.random.default_rng(seed), round(seconds / DT)
    speed = v_x + 1.5 * np.clip(filtered(rng, n), -2.5, 2.5)
    delta = amp * 0.02 * np.clip(filtered(rng, n), -2.5, 2.5)
    steady = speed * delta / (2.6 + 0.003 * speed**2)
    r = lfilter([1 - np.exp(-DT / 0.25)], [1, -np.exp(-DT / 0.25)], np.append(0.0, steady[:-1]))
    r = r + 0.003 * rng.standard_normal(n)
    return sa.Dataset.from_arrays({"delta": delta, "v_x": speed}, {"r": r}, DT, name=f"drive {seed}")


def left(region, data):
    columns = {name: data[name] for name in region.channels}
    return region.left(columns, t=data.t, what="drive", unit=data.unit)


def pairs(x, y):
    return sa.Dataset.from_arrays({"v_x": np.asarray(x, float)}, {"r": np.asarray(y, float)}, DT)


def test_the_hull_holds_what_came_together_and_not_what_never_did():
    rng = np.random.default_rng(0)
    v = 20 + 10 * np.sin(np.linspace(0, 300, 100_000))  # long at either end
    seen = pairs(v, np.sin(rng.uniform(0, 7, 100_000)) * (34 - v) / 24)  # slow: up to 1 rad/s, fast: up to 0.17
    region = Region.of(seen)
    assert region.low == pytest.approx([10, -1], abs=0.06)
    assert region.high == pytest.approx([30, 1], abs=0.06)
    inside = region.excess(np.array([[10, 1.0], [20, 0.55], [30, 0.16], [20, 0.0], [30, -0.16]]))
    assert np.all(inside < 0.1)
    one, *_, both = region.excess(np.array([[30, 0.9]]))[0]
    # the corner of the hull at (30, 0.17) is (1, 0.17) in half ranges, its side from (-1, 1) has a slope of -0.415
    assert one < 0.1
    assert both == pytest.approx(0.73 * np.cos(np.pi / 8), abs=0.03)
    outside = region.excess(np.array([[36, 0.0]]))[0]
    assert outside[0] == pytest.approx(0.6, abs=0.01)
    found = left(region, pairs([20] * 90 + [30] * 10, [0.1] * 90 + [0.9] * 10))
    assert found is not None
    assert found.rows.sum() == 10
    assert "10 % of the drive, first at t = 4.5 s, lie outside of the training data" in found.sentence
    assert "v_x 108 km/h with r 51.6 deg/s, which never came together there" in found.sentence


def test_channels_are_named_with_their_ranges_in_units_people_read():
    region = Region.of(pairs(np.linspace(10, 20, 500), np.linspace(-0.2, 0.2, 500)))
    found = left(region, pairs([15.0] * 80 + [30.0] * 20, [0.0] * 100))
    assert found is not None
    assert "v_x 108 km/h, there 36 to 72 km/h; the model extrapolates" in found.sentence


def test_an_outlier_widens_nothing_and_a_channel_at_rest_is_no_narrow_range():
    x = np.linspace(10, 20, 2000)
    spiked = x.copy()
    spiked[700] = 400.0
    assert Region.of(pairs(spiked, x)).high[0] == pytest.approx(20, abs=0.1)
    region = Region.of(pairs(20 + 0.001 * np.sin(x), x))
    assert left(region, pairs(np.full(100, 20.1), np.full(100, 15.0))) is None
    assert left(region, pairs(np.full(100, 22.0), np.full(100, 15.0))) is not None


def test_places_are_no_part_of_it():
    x = np.linspace(-1, 1, 100)
    data = sa.Dataset.from_arrays({"delta": x}, {"Y": 100 * x, "r": x}, DT)
    assert Region.of(data).channels == ("delta", "r")


@pytest.mark.parametrize("seed", range(8))
def test_drives_of_one_kind_raise_no_alarm_and_others_do(seed):
    region = Region.of(drive(seed))
    assert left(region, drive(100 + seed, seconds=60.0)) is None
    assert left(region, drive(100 + seed, seconds=60.0, amp=2.0)) is not None
    assert left(region, drive(100 + seed, seconds=60.0, v_x=22.0)) is not None


def test_the_region_of_fewer_channels_is_that_of_their_data():
    data = drive(1)
    assert Region.of(data).only(("v_x", "r")) == Region.of(data, ("v_x", "r"))


@pytest.fixture(scope="module")
def blended():
    return sa.MultiARX(na=1, nb=1, nk=1, speeds=(12.0, 15.0, 18.0)).fit(drive(3))


def test_a_blend_says_where_its_nearest_model_is_used_alone(blended, tmp_path):
    assert sa.load(sa.save(blended, tmp_path / "model.json")).region == blended.region
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert blended.simulate(drive(4)).beyond is None
    fast = drive(5, v_x=24.0, seconds=60.0)
    with pytest.warns(ModelWarning, match=r"of the free run.*v_x .* km/h, there .*nearest of the models is used"):
        verdict = sa.validate(blended, fast, train=drive(3))
    said = [s for s in verdict.residuals["r"].sentences if OUTSIDE in s]
    assert len(said) == 1
    with pytest.warns(ModelWarning, match=OUTSIDE):
        ranked = sa.compare([blended], fast)
    assert any(OUTSIDE in s for s in ranked.best.warnings)


def test_a_blend_made_by_hand_knows_its_speeds():
    def arx(gain):
        channels = {"dt": DT, "inputs": ("delta",), "outputs": ("r",)}
        return ARXModel(A=np.full((1, 1, 1), -0.8), B=np.full((1, 1, 1), gain), nk=1, **channels)

    model = sa.MultiARXModel(models=(arx(1.0), arx(2.0)), speeds=(10.0, 20.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.simulate(drive(1, v_x=14.0))
    with pytest.warns(ModelWarning, match="there 36 to 72 km/h"):
        model.simulate(drive(1, v_x=24.0))


def test_the_error_outside_stands_beside_that_inside(blended):
    slow, fast = drive(6, seconds=60.0), drive(7, seconds=60.0, v_x=26.0)
    with pytest.warns(ModelWarning, match="50 % of the free run, first at t = 0 s"):
        verdict = sa.validate(blended, join(slow, fast))
    (said,) = (s for s in verdict.residuals["r"].sentences if OUTSIDE in s)
    error = verdict.free_run.error[:, 0]
    rows = verdict.free_run.beyond.rows
    inside = verdict.free_run.predicted & ~rows
    times = np.sqrt(np.mean(error[rows] ** 2) / np.mean(error[inside] ** 2))
    assert times > 1.5
    assert said.endswith(f"the error of r is {times:.2g} times that inside (RMS)")


def test_behind_other_sensors_the_region_is_what_they_would_have_read(blended):
    other = OffsetModel(model=blended, inputs_at_zero={"v_x": 1.0}, gains={"v_x": 0.5})
    assert other.region.high == pytest.approx(blended.region.high / 0.5 + 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data = drive(8, seconds=30.0)
        other.simulate(data.with_channel("v_x", data["v_x"] / 0.5 + 1.0))
