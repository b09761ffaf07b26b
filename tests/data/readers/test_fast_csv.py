"""Large text tables are read as small ones are: the same numbers, the same sentences, with pyarrow and without."""

import sys

import numpy as np
import pytest

from slipangle import errors
from slipangle.data.readers import Column, read_csv, text_table
from slipangle.data.readers.fast_csv import StreamedTable
from tests.data.readers.logs import drive, motec_csv, race_capture
from tests.data.readers.test_csv import CASES, GOOD, steady, table

MADE = drive(120)
TEXTS = {
    "plain": (GOOD, {}),
    "chosen columns": (GOOD, {"columns": {"r": "yaw", "delta": Column("delta", "deg", sign=-1)}}),
    "derived and filtered": (GOOD, {"columns": {"r": Column(derive="yaw * delta")}, "filter": "t > 0.1"}),
    "MoTeC": (motec_csv(MADE), {"columns": {"delta": "Steered Angle", "r": "Gyro Yaw Velocity"}}),
    "semicolons": (motec_csv(MADE).replace(",", ";").replace(".", ","), {"columns": ["Steered Angle", "Distance"]}),
    "RaceCapture": (race_capture(MADE), {"columns": {"delta": "Steering", "v_x": "Speed", "r": "Yaw"}}),
    "empty cells": (table([[k / 10, k if k % 7 else "", k] for k in range(60)]), {"nan": "gap", "columns": ["delta"]}),
    "words for nothing": (
        table([[k / 10, k if k % 7 else "NaN", "n/a" if k == 9 else k] for k in range(60)]),
        {"nan": "gap"},
    ),
    "blank lines": (GOOD.replace("0.10,", "\n0.10,").replace("0.20,", "\n\n0.20,"), {}),
    "lines of separators": (GOOD + ",,\n,,\n", {}),
    "comments between": (GOOD.replace("0.10,", "# here\n0.10,"), {}),
    "a word": (GOOD.replace("0.10,", "oops,"), {}),
    "cut short": (GOOD[:-15], {}),
    "dates": (table([[f"2026-05-01T14:00:{k / 10:04.1f}Z", k, k] for k in range(60)]), {}),
    "quotes": (GOOD.replace("delta [deg]", '"delta, front [deg]"'), {}),
    "tabs": (GOOD.replace(",", "\t"), {}),
    "other ends of line": (GOOD.replace("\n", "\r\n"), {}),
    "a gap": (table([*steady(20), *steady(20, t0=3.0)]), {"inputs": ["delta"], "outputs": ["r"]}),
    "hexadecimal": (table([[k / 10, "0x10", 1] for k in range(40)]), {}),
    "underscores": (table([[k / 10, "1_0", 1] for k in range(40)]), {}),
} | {name: (text, options) for name, (text, options, _, _) in CASES.items()}


def outcome(path, options):
    try:
        data = read_csv(path, **options)
    except errors.SlipangleError as error:
        return type(error), str(error)
    return data


@pytest.mark.parametrize("without", [(), ("pyarrow", "pyarrow.csv")], ids=["pyarrow", "numpy"])
@pytest.mark.parametrize("name", TEXTS)
def test_block_by_block_reads_what_the_whole_does(name, without, tmp_path, monkeypatch):
    text, options = TEXTS[name]
    path = tmp_path / "run.csv"
    path.write_bytes(text.encode())
    whole = outcome(path, options)
    for module in without:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr(text_table, "_LARGE", 0)
    streamed = outcome(path, options)
    if isinstance(whole, tuple):
        assert streamed == whole
        return
    np.testing.assert_array_equal(streamed.values, whole.values)
    assert streamed.starts == whole.starts
    assert streamed.start_times == whole.start_times
    assert (streamed.dt, streamed.channels, streamed.notes) == (whole.dt, whole.channels, whole.notes)


@pytest.mark.parametrize("without", [(), ("pyarrow", "pyarrow.csv")], ids=["pyarrow", "numpy"])
def test_only_columns_that_are_asked_for_are_loaded(without, tmp_path, monkeypatch):
    for module in without:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr(text_table, "_LARGE", 0)
    path = tmp_path / "run.csv"
    path.write_text(table([[k / 10, k, "a word"] for k in range(60)], "t,u,driver"))
    asked = []
    fetch = StreamedTable.fetch

    def noted(self, columns):
        asked.append(set(columns))
        fetch(self, columns)

    monkeypatch.setattr(StreamedTable, "fetch", noted)
    data = read_csv(path, ["u"])
    assert data.names == ("u",)
    assert asked == [{0, 1}]


def test_a_large_file_is_streamed_and_a_damaged_cell_deep_in_it_is_named(tmp_path):
    t = 0.01 * np.arange(200_000)
    rows = [f"{a:.2f},{b:.9f},{b + 1:.9f}" for a, b in zip(t, np.sin(t), strict=True)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["t,a,b", *rows]) + "\n")
    assert path.stat().st_size > text_table._LARGE
    assert isinstance(text_table.read_table(path), StreamedTable)
    np.testing.assert_allclose(read_csv(path, ["b"])["b"], np.sin(t) + 1, atol=1e-9)
    rows[150_000] = "1500.00,oops,1"
    path.write_text("\n".join(["t,a,b", *rows]) + "\n")
    with pytest.raises(errors.FormatError, match="line 150002, column 'a' holds 'oops'"):
        read_csv(path, ["a"])
