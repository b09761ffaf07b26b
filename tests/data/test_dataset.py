"""The Dataset: experiments stay apart, splits never mix, resampling keeps what lies below the corner."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle import errors
from slipangle.data.dataset import Channel, Dataset, join


def make(n=100, dt=0.01, starts=(0,), start_times=None, **options):
    """Channel 'u' counts rows, so every sample tells where it came from."""
    values = np.column_stack([np.arange(n), np.sin(np.arange(n))])
    times = start_times or tuple(10.0 * k for k in range(len(starts)))
    channels = (Channel("u", "rad"), Channel("y", "rad/s"))
    return Dataset(values=values, channels=channels, dt=dt, starts=starts, start_times=times, **options)


def sine(frequency, dt=0.01, n=4000, phase=0.3):
    t = dt * np.arange(n)
    return Dataset.from_arrays({"u": np.sin(2 * np.pi * frequency * t + phase)}, {"y": 0 * t}, dt)


# ---- bad input ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "kind", "parts"),
    [
        ({"values": np.zeros((5, 3))}, errors.ParameterError, ["3 columns", "2 channel names", "expected"]),
        ({"channels": (Channel("a"), Channel("a"))}, errors.ParameterError, ["repeat", "'a'", "rename"]),
        ({"dt": 0.0}, errors.SampleTimeError, ["0.0 s", "positive"]),
        ({"dt": "0.1"}, errors.SampleTimeError, ["'0.1' s", "positive"]),
        ({"dt": None}, errors.SampleTimeError, ["None s", "positive"]),
        ({"dt": float("nan")}, errors.SampleTimeError, ["nan s", "positive"]),
        ({"starts": (0, 3)}, errors.ParameterError, ["2 starts", "1 start times"]),
        ({"starts": (1,)}, errors.ParameterError, ["rows [1]", "from 0 to below 5"]),
        ({"starts": ()}, errors.ParameterError, ["0 starts"]),
        ({"starts": (0, 3, 3), "start_times": (0, 1, 2)}, errors.ParameterError, ["[0, 3, 3]", "rising"]),
        ({"starts": (0, 5), "start_times": (0, 1)}, errors.ParameterError, ["[0, 5]", "below 5"]),
        ({"values": np.zeros((0, 2))}, errors.TooShortError, ["no sample", "at least one"]),
        ({"inputs": ("Y",)}, errors.MissingColumnError, ["no channel 'Y'", "nearest are 'y'"]),
        ({"outputs": ("z",)}, errors.MissingColumnError, ["no channel 'z'"]),
    ],
)
def test_bad_construction(options, kind, parts):
    good = {"values": np.zeros((5, 2)), "channels": (Channel("x"), Channel("y")), "dt": 0.1}
    with pytest.raises(kind) as caught:
        Dataset(**{**good, **options})
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_missing_numbers(bad):
    values = np.ones((9, 2))
    values[3:6, 1] = bad
    with pytest.raises(errors.NotFiniteError, match=r"channel 'y' holds 3 NaN .* at sample 3; expected finite"):
        Dataset(values=values, channels=(Channel("x"), Channel("y")), dt=0.1)


@pytest.mark.parametrize("fraction", [0, 1, -0.1, 1.5, float("nan"), "a"])
def test_bad_split(fraction):
    with pytest.raises(errors.ParameterError, match=r"between 0 and 1, such as 0\.7"):
        make().split(fraction)


def test_split_too_short():
    with pytest.raises(errors.TooShortError, match=r"has 4 samples, a split at 0\.9 leaves 4 and 0"):
        make(4).split(0.9)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (["a", "b"], "holds 'a'"),
        ([1j, 2], "holds 1j"),
        (np.zeros((2, 3)), r"has the shape \(2, 3\)"),
        (3.0, r"has the shape \(\)"),
        ([[1], [1, 2]], r"holds \[1\]"),
    ],
)
def test_a_channel_that_is_no_row_of_numbers_is_refused(values, said):
    with pytest.raises(errors.ParameterError, match=rf"channel 'u' {said}; expected one real number a sample"):
        Dataset.from_arrays({"u": values}, {"y": [1.0, 2.0]}, 0.1)
    with pytest.raises(errors.ParameterError, match=rf"channel 'u' {said}; expected one real number a sample"):
        make(2).with_channel("u", values)


@pytest.mark.parametrize("kind", [float, np.float32, int])
def test_masked_samples_are_missing(kind):
    masked = np.ma.masked_greater(np.arange(100).astype(kind), 89)
    table = np.ma.column_stack([masked, masked])
    for make_it in (
        lambda: Dataset.from_arrays({"u": masked}, {"y": np.zeros(100)}, 0.1),
        lambda: make().with_channel("u", masked),
        lambda: Dataset(values=table, channels=(Channel("u"), Channel("v")), dt=0.1),
    ):
        with pytest.raises(errors.NotFiniteError, match=r"channel 'u' holds 10 NaN .* at sample 90"):
            make_it()
    whole = np.ma.masked_greater(np.arange(100), 100)
    np.testing.assert_array_equal(make().with_channel("u", whole)["u"], np.arange(100))


def test_other_bad_requests():
    data = make()
    with pytest.raises(errors.TooShortError, match="rows 50 to 50 "):
        data.rows(50, 50)
    for start, stop in ((-5, 10), (0, 5000), (-500, 100)):
        with pytest.raises(errors.TooShortError, match=rf"rows {start} to {stop} .* not all in the record; .* <= 100"):
            data.rows(start, stop)
    with pytest.raises(errors.SampleTimeError, match=r"sampled at 0\.01 s, the model works at 0\.05 s; .*resample"):
        data.require_dt(0.05)
    data.require_dt(0.01 * (1 + 1e-9))
    with pytest.raises(errors.ParameterError, match="has 99 samples, the data have 100"):
        data.with_channel("z", np.zeros(99))
    with pytest.raises(errors.ParameterError, match="lengths \\[3, 4\\]"):
        Dataset.from_arrays({"u": np.zeros(3)}, {"y": np.zeros(4)}, 0.1)
    with pytest.raises(errors.ParameterError, match="ambiguous"):
        make(starts=(0, 10)).head(3)
    with pytest.raises(errors.SampleTimeError, match="-1 s"):
        data.resample(-1)
    for cutoff in (0.0, 50.0, 80.0):
        with pytest.raises(errors.ParameterError, match="between 0 and half the sample rate, 50 Hz"):
            data.resample(0.05, cutoff=cutoff)


def test_what_is_no_channel_no_row_and_no_data_set_is_said():
    data = make()
    for index in (slice(0, 10), 3):
        with pytest.raises(errors.ParameterError, match=r"expected a channel's name: samples are data\.rows"):
            data[index]
    with pytest.raises(errors.ParameterError, match=r"rows 0\.0 to 20\.0 .*divide times by the sample time, 0\.01 s"):
        data.rows(0.0, 20.0)
    assert data.rows(np.int64(3), np.int64(5)).n_samples == 2
    for n in (-5, 0, 2.5):
        with pytest.raises(errors.ParameterError, match=rf"head\(\) got {n}; expected a whole number"):
            data.head(n)
    with pytest.raises(errors.ParameterError, match=r"join\(\) got list; .*join\(\*parts\)"):
        join([data, data])
    for given in ((np.ones(3), {"y": np.ones(3)}), ({"u": np.ones(3)}, [1.0, -1.0, 1.0])):  # as iddata takes them
        with pytest.raises(errors.ParameterError, match=r"puts is a .*; expected channels by name, such as {'delta'"):
            Dataset.from_arrays(*given, 0.1)
    with pytest.raises(errors.ParameterError, match=r"channels \['u'\] are given twice"):
        Dataset.from_arrays({"u": np.zeros(3)}, {"y": np.zeros(3)}, 0.1, extra={"u": np.ones(3)})


# ---- looking -----------------------------------------------------------------------------------------------------


def test_the_callers_array_stays_the_callers():
    values = np.zeros((5, 1))
    data = Dataset(values=values, channels=(Channel("u"),), dt=0.1)
    values[0, 0] = 7.0
    assert data["u"][0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        data.values[0, 0] = 1.0


def test_time_and_experiments():
    data = make(10, starts=(0, 4), start_times=(1.0, 5.0), inputs="u", outputs="y")
    np.testing.assert_allclose(data.t, [1, 1.01, 1.02, 1.03, 5, 5.01, 5.02, 5.03, 5.04, 5.05])
    first, second = data
    assert (first.n_samples, second.n_samples, second.start_times) == (4, 6, (5.0,))
    np.testing.assert_array_equal(second["u"], np.arange(4, 10))
    assert (data.n_longest, second.n_longest) == (6, 6)
    assert make(10, starts=(0, 7, 9)).n_longest == 7
    assert data.duration == pytest.approx(0.1)
    assert data.u.shape == data.y.shape == (10, 1)
    assert "u" in data
    assert "nothing" not in data
    assert data.unit("y") == "rad/s"
    joined = join(first, second)
    np.testing.assert_array_equal(joined.values, data.values)
    assert joined.starts == data.starts
    assert joined.start_times == data.start_times


def test_join_refuses_what_does_not_fit():
    a = make(5, notes=("one",))
    with pytest.raises(errors.ParameterError, match="at least one"):
        join()
    with pytest.raises(errors.SampleTimeError):
        join(a, make(5, dt=0.02))
    with pytest.raises(errors.MissingColumnError):
        join(a, Dataset.from_arrays({"u": np.zeros(3)}, {"z": np.zeros(3)}, 0.01))
    with pytest.raises(errors.UnitError, match="'m' in 'data' and in 'rad' in 'data'"):
        join(a, a.with_channel("u", np.zeros(5), "m"))
    assert join(a, make(5, notes=("one", "two"))).notes == ("one", "two")


def test_join_says_which_channels_it_leaves_out():
    a, b = make(5), make(5).with_channel("z", np.ones(5)).with_channel("w", np.ones(5))
    assert join(a, b, b).notes == ("without z, w of 'data', which 'data' has not",)


def test_channels_of_the_nomenclature_have_their_units():
    data = Dataset.from_arrays({"delta": np.zeros(3), "u": np.zeros(3)}, {"r": np.zeros(3)}, 0.1, units={"u": "V"})
    assert [c.unit for c in data.channels] == ["rad", "V", "rad/s"]
    assert Dataset.from_arrays({"delta": np.zeros(3)}, {}, 0.1, units={"delta": "-"}).unit("delta") == "-"


@pytest.mark.parametrize(
    ("unit", "si"), [("deg", "rad"), ("km/h", "m/s"), ("kmh", "m/s"), ("g", "m/s2"), ("%", "-"), ("ms", "s")]
)
def test_units_other_than_si_are_refused(unit, si):
    said = rf"channel 'z' is in '{unit}'; expected SI units, '{si}': give .*from_frame\(\)"
    z, data = np.ones(3), make(3)
    with pytest.raises(errors.UnitError, match=said):
        Dataset.from_arrays({"z": z}, {}, 0.1, units={"z": unit})
    with pytest.raises(errors.UnitError, match=said):
        data.with_channel("z", z, unit)
    with pytest.raises(errors.UnitError, match=said):
        Dataset(values=z, channels=(Channel("z", unit),), dt=0.1)
    with pytest.raises(errors.UnitError, match="unit of channel 'z' is None; expected text"):
        data.with_channel("z", z, None)
    for free in ("m/s^2", "rad m/s", "(kN/m)/s", "", "1", si):
        assert data.with_channel("z", z, free).unit("z") == free


def test_order_of_channels_does_not_matter_to_join():
    a, b = make(5), make(5)
    swapped = Dataset(values=b.values[:, ::-1], channels=b.channels[::-1], dt=b.dt)
    np.testing.assert_array_equal(join(a, swapped).values, np.vstack([a.values, b.values]))


# ---- cutting -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fraction", [0.1, 0.37, 0.5, 0.7, 0.85, 0.97])
@pytest.mark.parametrize("starts", [(0,), (0, 50), (0, 13, 37, 70, 90)])
def test_split_never_mixes(fraction, starts):
    data = make(starts=starts)
    train, test = data.split(fraction)
    n = round(100 * fraction)
    np.testing.assert_array_equal(train["u"], np.arange(n))
    np.testing.assert_array_equal(test["u"], np.arange(n, 100))
    np.testing.assert_allclose(np.concatenate([train.t, test.t]), data.t)
    borders = set(np.cumsum([len(e) for e in train])) | {n + b for b in np.cumsum([len(e) for e in test])}
    assert borders == {*starts[1:], n, 100}


def test_rows_keep_borders():
    part = make(starts=(0, 30, 60)).rows(20, 70)
    assert part.starts == (0, 10, 40)
    assert part.start_times == pytest.approx((0.2, 10.0, 20.0))


def test_select_and_with_channel():
    data = make(inputs="u", outputs="y")
    assert data.select(inputs=("y",), outputs=()).inputs == ("y",)
    assert data.select().outputs == ("y",)
    more = data.with_channel("z", np.arange(100) * 2.0, "m")
    assert more.names == ("u", "y", "z")
    assert more.unit("z") == "m"
    replaced = more.with_channel("u", np.zeros(100), "m")
    assert replaced.names == ("u", "y", "z")
    assert replaced.unit("u") == "m"
    assert data["u"][5] == 5.0
    assert data.with_note("seen").notes == ("seen",)


def test_detrend_uses_training_offsets_on_test_data():
    data = make(inputs="u", outputs="y")
    train, test = data.split(0.5)
    flat, offsets = train.detrend()
    assert offsets["u"] == pytest.approx(24.5)
    assert flat["u"].mean() == pytest.approx(0, abs=1e-12)
    moved, same = test.detrend(offsets)
    np.testing.assert_allclose(moved["u"], test["u"] - 24.5)
    assert same == offsets


# ---- resampling --------------------------------------------------------------------------------------------------


def fitted(data, frequency):
    """Amplitude and phase of a tone, by least squares over the middle of the record."""
    keep = slice(len(data) // 4, 3 * len(data) // 4)
    t, u = data.t[keep], data["u"][keep]
    basis = np.column_stack([np.sin(2 * np.pi * frequency * t), np.cos(2 * np.pi * frequency * t)])
    s, c = np.linalg.lstsq(basis, u, rcond=None)[0]
    return np.hypot(s, c), np.arctan2(c, s)


@pytest.mark.parametrize("rate", [20.0, 25.0, 30.0, 33.3])
@pytest.mark.parametrize("frequency", [0.3, 1.0, 3.0])
def test_a_slow_tone_keeps_amplitude_and_phase(rate, frequency):
    data = sine(frequency).resample(1 / rate)
    amplitude, phase = fitted(data, frequency)
    expected = 1 / (1 + (np.tan(np.pi * frequency * 0.01) / np.tan(np.pi * 0.4 * rate * 0.01)) ** 8)
    assert amplitude == pytest.approx(expected, rel=2e-3)
    assert phase == pytest.approx(0.3, abs=1e-3)


@pytest.mark.parametrize(("rate", "tone"), [(20.0, 19.0), (20.0, 22.0), (25.0, 24.0), (30.0, 45.0)])
def test_a_tone_that_would_alias_is_attenuated(rate, tone):
    data = sine(tone)
    assert data.values.std() > 0.4
    kept = data.resample(1 / rate)["u"]
    middle = kept[len(kept) // 4 : 3 * len(kept) // 4]
    assert np.abs(middle).max() < 2e-3


def test_amplitude_at_the_corner_is_one_half():
    amplitude, _ = fitted(sine(8.0).resample(0.02, cutoff=8.0), 8.0)
    assert amplitude == pytest.approx(0.5, rel=1e-3)


def test_resampling_stays_inside_experiments():
    n = 1000
    step = np.r_[np.zeros(n), np.full(n, 100.0)]
    data = Dataset(values=step, channels=(Channel("u"),), dt=0.01, starts=(0, n), start_times=(0.0, 50.0))
    slow = data.resample(0.05)
    assert slow.starts == (0, 200)
    assert slow.start_times == (0.0, 50.0)
    np.testing.assert_allclose(slow["u"], np.r_[np.zeros(200), np.full(200, 100.0)], atol=1e-9)
    assert "from 100 to 20 Hz after a zero-phase low-pass at 8 Hz" in slow.notes[-1]


def test_speeding_up_is_linear_and_never_overshoots():
    fast = make(10).resample(0.0025)
    assert fast.n_samples == 37
    np.testing.assert_allclose(fast["u"], 0.25 * np.arange(37), atol=1e-12)
    step = Dataset.from_arrays({"u": np.r_[np.zeros(5), np.ones(5)]}, {"y": np.zeros(10)}, 0.1).resample(0.01)
    assert step["u"].min() == 0.0
    assert step["u"].max() == 1.0


def test_a_higher_rate_is_said_to_interpolate():
    data = make(100)
    fast = data.resample(0.0025)
    said = "what is between the samples is interpolated, not measured; sample time before: 0.01 s"
    assert fast.notes == ("resampled from 100 to 400 Hz", said)
    assert (data.dt_recorded, fast.dt_recorded, fast.resample(0.001).dt_recorded) == (0.01, 0.01, 0.01)
    assert fast.resample(0.05).dt_recorded == 0.05
    assert data.resample(0.0099).notes == ("resampled from 100 to 101.01 Hz",)  # a clock that is off


def test_same_rate_changes_nothing():
    data = make()
    same = data.resample(0.01)
    np.testing.assert_array_equal(same.values, data.values)
    assert same.notes == ()
    assert data.resample(0.01, cutoff=5.0).notes == ("a zero-phase low-pass at 5 Hz",)


@pytest.mark.parametrize("n", [1, 2, 5, 20])
def test_short_experiments_survive(n):
    data = make(n).resample(0.04)
    assert data.n_samples == (n - 1) // 4 + 1
    assert np.isfinite(data.values).all()


# ---- equality ----------------------------------------------------------------------------------------------------


def test_equal_data_are_equal_and_have_one_hash():
    one = make(starts=(0, 40), inputs=("u",), outputs=("y",), notes=("as logged",))
    same = make(starts=(0, 40), inputs=("u",), outputs=("y",), notes=("as logged",))
    assert one == same
    assert hash(one) == hash(same)
    assert len({one, same}) == 1
    assert one in [None, same]
    assert one != "data"
    assert one != None  # noqa: E711


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.with_channel("u", d["u"] + 1e-12, "rad"),
        lambda d: d.with_channel("u", d["u"], "m"),
        lambda d: d.with_channel("w", d["u"]),
        lambda d: d.with_note("touched"),
        lambda d: d.select(inputs=()),
        lambda d: d.select(outputs=("u",)),
        lambda d: d.rows(0, 99),
        lambda d: replace(d, dt=0.02),
        lambda d: replace(d, name="other"),
        lambda d: replace(d, starts=(0, 41)),
        lambda d: replace(d, start_times=(0.0, 11.0)),
    ],
)
def test_data_that_differ_in_anything_are_not_equal(change):
    one = make(starts=(0, 40), inputs=("u",), outputs=("y",))
    assert one != change(one)
    assert change(one) == change(one)
