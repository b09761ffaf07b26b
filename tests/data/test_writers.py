"""What is written, or given to another library, comes back equal."""

import sys

import numpy as np
import pytest

import slipangle as sa
from slipangle.data.dataset import Channel, join
from slipangle.errors import ConfigError, FormatError, MissingColumnError, NotFiniteError, ParameterError, WriteError

RNG = np.random.default_rng(5)


def recording(n, start):
    data = sa.Dataset(
        values=RNG.normal(size=(n, 3)) * np.array([1e-3, 20.0, 1.0]),
        channels=(Channel("delta", "rad"), Channel("v_x", "m/s"), Channel("rho")),
        dt=0.01,
        inputs=("delta", "v_x"),
        outputs=("rho",),
        name="run <7> & more",
        start_times=(start,),
        notes=("a note", "another, with 'quotes' & <marks>"),
    )
    return data


ONE = recording(40, 3.5)
SEVERAL = join(recording(40, 0.0), recording(25, 7.25), recording(30, 1e3))
KINDS = ["csv", "parquet", "feather", "mat", "mf4"]


def assert_equal(a, b):
    np.testing.assert_array_equal(a.values, b.values)
    for name in ("channels", "dt", "inputs", "outputs", "name", "starts", "start_times", "notes"):
        assert getattr(a, name) == getattr(b, name), name
    assert a == b


@pytest.mark.parametrize("data", [ONE, SEVERAL], ids=["one", "several"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_file_gives_the_data_back(kind, data, tmp_path):
    path = sa.write(data, tmp_path / f"run.{kind}")
    assert_equal(sa.read(path), data)
    assert [p.name for p in tmp_path.iterdir()] == [f"run.{kind}"]
    some = sa.read(path, ["rho"])
    assert (some.names, some.inputs, some.outputs) == (("rho",), (), ("rho",))


@pytest.mark.parametrize("data", [ONE, SEVERAL], ids=["one", "several"])
@pytest.mark.parametrize("kind", ["pandas", "xarray"])
def test_a_frame_gives_the_data_back(kind, data):
    assert_equal(sa.from_frame(getattr(data, f"to_{kind}")()), data)


def test_a_frame_of_polars_has_the_samples():
    frame = SEVERAL.to_polars()
    columns = {"delta": "delta", "v_x": "v_x", "rho": "rho"}
    back = sa.from_frame(frame, columns, experiment="experiment")
    np.testing.assert_array_equal(back.values, SEVERAL.values)
    assert back.starts == SEVERAL.starts


def test_frames_of_others_are_logs():
    import pandas as pd
    import polars as pl
    import pyarrow as pa

    t = 0.02 * np.arange(50)
    instants = pd.to_datetime("2026-05-01T14:00:00Z") + pd.to_timedelta(t, unit="s")
    columns = {"time": t, "speed [km/h]": 36 + t, "who": ["me"] * 50}
    frames = [
        pd.DataFrame(columns),
        pd.DataFrame({k: v for k, v in columns.items() if k != "time"}, index=instants),
        pl.DataFrame(columns),
        pa.table(columns),
        {k: v for k, v in columns.items() if k != "who"},
    ]
    for frame in frames:
        data = sa.from_frame(frame, {"v_x": "speed"}, outputs=["v_x"])
        assert data.dt == pytest.approx(0.02)
        np.testing.assert_allclose(data["v_x"], (36 + t) / 3.6, rtol=1e-12)
    sparse = pl.DataFrame({"t": t, "a": t, "b": [x if k % 5 == 0 else None for k, x in enumerate(t)]})
    merged = sa.from_frame(sparse, nan="merge")
    np.testing.assert_allclose(merged["b"], merged["a"], atol=1e-12)


def test_masked_samples_and_instants_of_a_frame_are_missing():
    t = 0.01 * np.arange(100)
    late, gone = t > 0.895, (t > 0.195) & (t < 0.395)
    frame = {"t": t, "v_x": np.ma.MaskedArray(20 + t, late | gone), "k": np.ma.MaskedArray(np.arange(100), late)}
    data = sa.from_frame(frame, nan="gap")
    np.testing.assert_allclose(data["v_x"], (20 + t)[~(late | gone)])
    assert len(data.starts) == 2
    with pytest.raises(NotFiniteError, match="'v_x' of 'frame' has 30 missing samples"):
        sa.from_frame(frame)
    stamps = np.datetime64("2026-05-01T14:00:00", "ns") + (10_000_000 * np.arange(100)).astype("m8[ns]")
    dated = {"time": np.ma.MaskedArray(stamps, late), "v_x": 20 + t}
    assert sa.from_frame(dated, nan="merge").duration == pytest.approx(0.9, abs=0.011)


@pytest.mark.parametrize(
    "wrong", [np.ones((100, 2)), np.ones(100) * 1j, np.float64(3.0)], ids=["two", "complex", "one"]
)
def test_columns_that_are_no_row_of_real_numbers_are_refused(wrong):
    with pytest.raises(ParameterError, match=r"channel 'v_x' .*; expected one real number a sample"):
        sa.from_frame({"t": 0.01 * np.arange(100), "v_x": wrong})


def test_what_cannot_be_written_or_read_is_said(tmp_path, monkeypatch):
    with pytest.raises(WriteError, match=r"suffix '\.xlsx'; .* use one of \.csv, \.parquet, \.feather, \.mat, \.mf4"):
        sa.write(ONE, tmp_path / "run.xlsx")
    odd = ONE.with_channel("wheel speed", np.ones(40))
    with pytest.raises(ParameterError, match="channel 'wheel speed' cannot be a variable of MATLAB"):
        sa.write(odd, tmp_path / "run.mat")
    with pytest.raises(FormatError, match="a list is no frame"):
        sa.from_frame([1, 2, 3])
    with pytest.raises(MissingColumnError, match="no column of numbers"):
        sa.from_frame({"a": np.array(["x", "y"])})
    with pytest.raises(FormatError, match="different lengths"):
        sa.from_frame({"t": np.arange(3), "a": np.arange(4)})
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ConfigError, match="pandas, which is not installed"):
        ONE.to_pandas()
