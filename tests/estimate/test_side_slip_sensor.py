"""A virtual sensor of lateral velocity: finds what a formula says, sample by sample too, silent where unlearned."""

from dataclasses import replace

import numpy as np
import pytest

import slipangle as sa
from slipangle.data.dataset import Dataset, join
from slipangle.errors import MissingColumnError, ParameterError, SampleTimeError, TooShortError

DT, L, L_F = 0.05, 2.6, 1.2
SENSOR = sa.SideSlipSensor(wheelbase=L, l_f=L_F)


def driven(seed, n=2500, noise=0.0, size=1.0):
    """A car whose rear slip angle is a cubic of its lateral force, softer under brakes; yaw rate and speed at will."""
    rng, t = np.random.default_rng(seed), DT * np.arange(n)
    r, v = np.zeros(n), np.full(n, 25.0)
    for f in (0.05, 0.11, 0.23, 0.4):
        r += size * 0.1 * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28))
        v += 2.0 * np.sin(2 * np.pi * 0.3 * f * t + rng.uniform(0, 6.28))
    r_dot = np.append([0.0, 0.0], (r[2:] - r[:-2]) / (2 * DT))
    a_x = np.append([0.0] * 4, (v[4:] - v[:-4]) / (4 * DT)) / 9.80665
    a_y = v * r
    u = (a_y - (L - L_F) * r_dot) / 9.80665
    slip = -(0.08 * u + 0.05 * u**3) * (1.0 - 0.4 * a_x)
    v_y = v * np.tan(np.arctan2((L - L_F) * r, v) + slip)
    delta = L * r / v
    read = {"r": r, "a_y": a_y, "v_y": v_y + noise * rng.standard_normal(n)}
    return Dataset.from_arrays({"delta": delta, "v_x": v}, read, DT)


def test_it_finds_what_it_can_say():
    """Without noise nearly all of it; of a drive that it has not seen too."""
    learned = SENSOR.fit(driven(1))
    other = driven(2)
    said = learned(other)
    known = np.isfinite(said)
    assert known.mean() > 0.9
    assert np.sqrt(np.mean((said - other["v_y"])[known] ** 2)) < 0.02 * other["v_y"].std()
    assert learned.std < 0.02 * np.arctan2(other["v_y"], other["v_x"]).std()


def test_it_says_how_far_off_it_is():
    """Its standard deviation is that of its errors on another drive: here mostly the noise that it learned from."""
    noise = 0.2
    learned = SENSOR.fit(driven(3, n=5000, noise=noise))
    other = driven(4, n=5000, noise=noise)
    error = np.arctan2(learned(other), other["v_x"]) - np.arctan2(other["v_y"], other["v_x"])
    error = error[np.isfinite(error)]
    assert learned.std == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.1)
    assert learned.std == pytest.approx(noise / 25.0, rel=0.15)
    held_out = learned.held_out
    assert np.isnan(held_out[:8]).all()
    assert np.isfinite(held_out[8:]).all()


def test_a_stretch_is_predicted_without_itself():
    """A stretch whose v_y is wrong does not teach the sensor what is said of it."""
    data = driven(5, n=2508)
    v_y = data["v_y"].copy()
    v_y[8:508] += 3.0  # the first of five stretches
    learned = SENSOR.fit(data.with_channel("v_y", v_y, "m/s"))
    assert np.abs(learned.held_out[8:508] - data["v_y"][8:508]).max() < 0.2


def test_channels_may_stand_in_any_order():
    data, other = driven(8), driven(9)
    names = ["v_y", "a_y", "r", "v_x", "delta"]
    turned = Dataset.from_arrays({n: other[n] for n in names[3:]}, {n: other[n] for n in names[:3]}, DT)
    learned = SENSOR.fit(data)
    np.testing.assert_array_equal(learned(turned), learned(other))


def test_a_car_a_tenth_as_long_is_the_same_car():
    """Lengths and speeds over ten: so is what is said, at 2.5 m/s too."""
    data, other = driven(8), driven(9)

    def small(log):
        tenth = {n: log[n] / (1.0 if n in ("delta", "r") else 10.0) for n in log.names}
        return Dataset.from_arrays(
            {n: tenth[n] for n in ("delta", "v_x")}, {n: tenth[n] for n in ("r", "a_y", "v_y")}, DT
        )

    told = sa.SideSlipSensor(wheelbase=L / 10, l_f=L_F / 10).fit(small(data))(small(other))
    np.testing.assert_allclose(10 * told, SENSOR.fit(data)(other), rtol=1e-6, atol=1e-9)


def test_sample_by_sample_it_says_the_same():
    learned, data = SENSOR.fit(driven(6)), driven(7, n=60)
    stream = learned.begin()
    values = data.columns(("delta", "v_x", "r", "a_y"))
    said = [stream.take(dict(zip(("delta", "v_x", "r", "a_y"), row, strict=True))) for row in values]
    np.testing.assert_allclose(said, learned(data), atol=1e-12)
    both = join(data, data)
    np.testing.assert_allclose(learned(both), np.tile(learned(data), 2), atol=1e-12)


def test_it_is_silent_where_it_has_not_learned():
    learned = SENSOR.fit(driven(8))
    hard, slow = driven(9, size=3.0), driven(9)
    said = learned(hard)
    far = np.abs(hard["a_y"]) > 1.3 * np.abs(driven(8)["a_y"]).max()
    assert far.any()
    assert np.isnan(said[far]).all()
    crawling = slow.with_channel("v_x", np.full(slow.n_samples, 2.0), "m/s")
    assert np.isnan(learned(crawling)).all()
    stream, said = learned.begin(), []
    for k in range(60):
        row = {n: slow[n][k] for n in ("delta", "v_x", "r", "a_y") if not (k == 30 and n == "a_y")}
        said.append(stream.take(row))
    assert np.flatnonzero(np.isnan(said)).tolist()[:9] == [*range(8), 30]
    assert np.isfinite(said[45:]).all()


@pytest.mark.parametrize(
    ("channel", "value"),
    [("a_y", 15.0), ("a_y", 1e300), ("r", 3.0), ("r", -0.9), ("delta", 1.0), ("v_x", 200.0), ("v_x", np.nan)],
)
@pytest.mark.parametrize("dt", [0.05, 0.02])
def test_one_implausible_sample_is_never_taken_at_its_word(channel, value, dt):
    """Whatever is said within its memory is what is said without; all that it touches is not said."""
    data = {seed: driven(seed, n=2500).resample(dt) for seed in (8, 9)}
    learned = SENSOR.fit(data[8])
    names = ("delta", "v_x", "r", "a_y")
    table, first = data[9].columns(names).copy(), learned.look.first
    k = next(k for k in range(300, 2000) if np.isfinite(learned(data[9])[k - 1 : k + 2 * first]).all())
    table[k, names.index(channel)] = value
    stream = learned.begin()
    said = np.array([stream.take(dict(zip(names, row, strict=True))) for row in table[: k + 2 * first]])
    with_it, without = said[k:], learned(data[9])[k : k + 2 * first]
    known = np.isfinite(with_it)
    assert not known[0]
    assert np.array_equal(with_it[known], without[known])
    held = first if channel != "a_y" else learned.look.lags * learned.look.spacing
    assert not known[: held + 1].any()
    assert known[held + 1 :].all()


def test_a_filter_takes_it_for_a_measurement():
    """Of a car whose model is wrong by a third, side slip is better with it than without."""
    train, test = driven(10), driven(11)
    learned = SENSOR.fit(train)
    bicycle = sa.Bicycle(
        params=sa.BicycleParams(mass=1400.0, inertia_z=2000.0, wheelbase=L, l_f=L_F, C_f=1.3e5, C_r=1.3e5),
        dt=DT,
        outputs=("r", "v_y"),
    )
    errors = []
    for told in (np.full(test.n_samples, np.nan), learned(test)):
        estimator = sa.EKF(start=bicycle, noise_std={"r": 0.01, "v_y": 0.05}, process_std={"v_y": 0.3, "r": 0.1})
        run = estimator.start_at().run(test, measured={"v_y": told})
        errors.append(np.sqrt(np.mean((run.states[:, 0] - test["v_y"]) ** 2)))
    assert errors[1] < 0.3 * errors[0]


def test_bad_input_says_what_to_do():
    with pytest.raises(ParameterError, match=r"l_f is 3 m; expected less than the wheelbase of 2\.6 m"):
        sa.SideSlipSensor(wheelbase=L, l_f=3.0)
    with pytest.raises(ParameterError, match="folds is 1; expected at least 2"):
        sa.SideSlipSensor(wheelbase=L, l_f=L_F, folds=1)
    data = driven(12, n=300)
    with pytest.raises(
        TooShortError, match=r"292 samples faster than 3\.2 m/s with all channels; expected at least 525"
    ):
        SENSOR.fit(data)
    with pytest.raises(MissingColumnError, match="'a_y'"):
        SENSOR.fit(Dataset.from_arrays({n: data[n] for n in ("delta", "v_x")}, {n: data[n] for n in ("r", "v_y")}, DT))
    with pytest.raises(SampleTimeError, match=r"the sensor works at 0\.05 s"):
        SENSOR.fit(driven(12))(replace(data, dt=0.1))
