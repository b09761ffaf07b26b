"""CSV in and out: what is recognised, what is refused and with which sentence."""

import math

import numpy as np
import pytest

from slipangle import errors
from slipangle.data.dataset import Channel, Dataset, join
from slipangle.data.readers import Column, open_log, read, read_csv, write_csv
from slipangle.data.readers.text_dialect import parse_heading

GOOD = "t [s],delta [deg],yaw [deg/s]\n" + "".join(f"{0.01 * k:.2f},{math.sin(k):.6f},{k * 0.5}\n" for k in range(30))


def table(rows, head="t,delta,r"):
    return head + "\n" + "\n".join(",".join(str(c) for c in row) for row in rows) + "\n"


def steady(n=30, dt=0.01, t0=0.0):
    return [[round(t0 + dt * k, 9), round(0.1 * math.sin(k), 6), round(0.2 * math.cos(k), 6)] for k in range(n)]


@pytest.fixture
def log(tmp_path):
    def write(text, name="run.csv", encoding="utf-8"):
        path = tmp_path / name
        path.write_bytes(text.encode(encoding))
        return path

    return write


# ---- what is recognised ------------------------------------------------------------------------------------------


def test_units_are_converted_at_the_door(log):
    data = read_csv(log(GOOD), {"delta": "delta", "r": "yaw"}, inputs=["delta"], outputs=["r"])
    assert data.dt == 0.01
    assert [c for c in data.channels] == [Channel("delta", "rad"), Channel("r", "rad/s")]
    assert data["r"][7] == pytest.approx(np.deg2rad(3.5), rel=1e-15)
    assert data.inputs == ("delta",)
    assert data.outputs == ("r",)
    assert data.name == "run"


@pytest.mark.parametrize(
    ("text", "name", "unit"),
    [
        ("vx(m/s)", "vx", "m/s"),
        ("brake [kPa]", "brake", "kPa"),
        ("throttle_ped_cmd(%)", "throttle_ped_cmd", "%"),
        ("ax(m/s^2)", "ax", "m/s^2"),
        ('"yaw rate [°/s]"', "yaw rate", "°/s"),
        ("acc x (IMU)", "acc x (IMU)", None),
        ("W (IMU)", "W (IMU)", None),
        ("v_x", "v_x", None),
        ("time [sec]", "time", "sec"),
        ("Speed, km/h", "Speed", "km/h"),
        ("FX_N", "FX_N", None),
        ("weird [furlong]", "weird", "furlong"),
    ],
)
def test_headings(text, name, unit):
    heading = parse_heading(text)
    assert (heading.name, heading.unit) == (name, unit)


@pytest.mark.parametrize(
    ("channel", "heading", "factor"),
    [
        ("v_x", "speed_kmh", 1 / 3.6),
        ("v_x", "GroundSpeedMph", 0.44704),
        ("v_x", "speed_mps", 1.0),
        ("v_x", "speed m/s", 1.0),
        ("delta", "steer_deg", np.pi / 180),
        ("r", "yaw_rate_dps", np.pi / 180),
        ("r", "r_rad_s", 1.0),
        ("a_y", "lat_acc_g", 9.80665),
        ("a_y", "ayCoG", 1.0),
        ("omega_f", "wheel_rpm", np.pi / 30),
    ],
)
def test_a_unit_that_a_heading_ends_with_is_taken(log, channel, heading, factor):
    x = 1 + 0.3 * np.sin(0.1 * np.arange(50))
    path = log(f"time_ms,{heading}\n" + "\n".join(f"{20 * k},{v:.9f}" for k, v in enumerate(x)))
    data = read_csv(path, {channel: heading}, time="time_ms")
    assert data.dt == pytest.approx(0.02)
    np.testing.assert_allclose(data[channel], factor * x, rtol=1e-7)
    told = f"units that headings end with: {channel} in " if heading != "ayCoG" else f"no unit named for {channel}"
    assert any(note.startswith(told) for note in data.notes)
    scaled = read_csv(path, {channel: Column(heading, scale=0.5)}, time=Column("time_ms", scale=0.001))
    np.testing.assert_allclose(scaled[channel], 0.5 * x, rtol=1e-7)  # who scales without a unit makes SI units
    assert scaled.dt == pytest.approx(0.02)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " ", ", ", "   ", "|", " | "])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_separators_and_line_ends(log, delimiter, newline):
    text = table(steady()).replace(",", delimiter).replace("\n", newline)
    data = read_csv(log(text))
    assert data.names == ("delta", "r")
    np.testing.assert_array_equal(data.values, [row[1:] for row in steady()])


def test_decimal_comma_with_semicolons(log):
    text = table(steady()).replace(",", ";").replace(".", ",")
    np.testing.assert_array_equal(read_csv(log(text)).values, [row[1:] for row in steady()])


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_encodings(log, encoding):
    data = read_csv(log(table(steady(), "t,delta [°],r [°/s]"), encoding=encoding))
    assert data.unit("delta") == "rad"
    assert data["delta"][5] == pytest.approx(np.deg2rad(steady()[5][1]), rel=1e-15)


def test_comments_and_a_heading_inside_them(log):
    text = "# logger 4.2\n# t(s),delta(rad),r(rad/s)\n" + table(steady(), "# end of preamble")
    data = read_csv(log(text))
    assert data.names == ("delta", "r")
    assert not any("no unit" in n for n in data.notes)


@pytest.mark.parametrize(
    ("unit", "one", "si"),
    [
        ("C", 1.0, "degC"),
        ("°F", -31 / 1.8, "degC"),
        ("K", -272.15, "degC"),
        ("mbar", 100.0, "Pa"),
        ("1/min", np.pi / 30, "rad/s"),
        ("U/min", np.pi / 30, "rad/s"),
        ("kW", 1000.0, "W"),
        ("ft/s", 0.3048, "m/s"),
        ("knots", 1852 / 3600, "m/s"),
        ("mi", 1609.344, "m"),
        ("m/s/s", 1.0, "m/s2"),
        ("rad/m", 1.0, "1/m"),
        ("mrad", 0.001, "rad"),
        ("l", 0.001, "m3"),
        ("h", 3600.0, "s"),
        ("A", 1.0, "A"),
        ("Hz", 1.0, "Hz"),
    ],
)
def test_units_of_race_logs(log, unit, one, si):
    data = read_csv(log(table([[0.01 * k, 1.0] for k in range(9)], f"t,x [{unit}]")))
    assert data.unit("x") == si
    np.testing.assert_allclose(data["x"], one, rtol=1e-12)


def test_a_channel_of_a_unit_that_nobody_knows_keeps_its_numbers(log, tmp_path):
    """Of a standard channel it is refused, by column and file; written and read again it is the same."""
    path = log(table([[0.01 * k, k, 20.0] for k in range(9)], "t [s],fuel [lb/h],v_x [m/s]"))
    data = read_csv(path)
    np.testing.assert_array_equal(data["fuel"], np.arange(9))
    assert (data.unit("fuel"), data.unit("v_x")) == ("lb/h", "m/s")
    assert "units that are not known, numbers as they are: fuel in 'lb/h'" in data.notes
    again = read_csv(write_csv(data, tmp_path / "again.csv"))
    assert again == data
    with pytest.raises(
        errors.UnitError, match=r"column 'fuel' of 'run.csv' \(channel 'v_x'\) is in 'lb/h', which is no"
    ):
        read_csv(path, {"v_x": "fuel"})
    with pytest.raises(
        errors.UnitError, match=r"column 'fuel' of 'run.csv' \(channel 'fuel'\) is in 'lbh', which is no"
    ):
        read_csv(path, {"fuel": Column("fuel", "lbh")})


def test_a_line_of_units_under_the_heading(log):
    data = read_csv(log(table([["s", "deg", "rad/s"], *steady()])))
    assert data["delta"][3] == pytest.approx(np.deg2rad(steady()[3][1]), rel=1e-15)
    assert data["r"][3] == steady()[3][2]


@pytest.mark.parametrize("none", ["-", "[-]", "none", "n/a", "1", "", "()"])
@pytest.mark.parametrize("above", ["", "Logger 7\nDriver,A. Driver\n\n"])
def test_a_number_without_unit_has_any_word_for_that_in_the_line_of_units(log, none, above):
    rows = [["s", "[km/h]", none], *([0.01 * k, 72 + k, k] for k in range(12))]
    data = read_csv(log(above + table(rows, "t,v_x,gear")))
    np.testing.assert_allclose(data["v_x"], (72 + np.arange(12)) / 3.6)
    np.testing.assert_array_equal(data["gear"], np.arange(12))


@pytest.mark.parametrize("first", ["1,nan,N", "nan,nan,nan", "0,-,-"])
def test_a_row_of_data_with_missing_cells_is_no_line_of_units(log, first):
    rest = "\n".join(f"{1 + k},{k},{k}" for k in range(1, 12))
    seen = open_log(log(f"t,a,b\n{first}\n{rest}\n")).tables[""]
    assert [h.unit for h in seen.headers] == [None] * 3


def test_columns_by_position_without_heading(log):
    text = table(steady()).split("\n", 1)[1]
    data = read_csv(log(text, "run.dat"), {"delta": Column(1, "rad"), "r": Column(-1, "rad/s")}, time=Column(0))
    np.testing.assert_array_equal(data["r"], [row[2] for row in steady()])


def test_lines_above_the_heading_can_be_left_out(log):
    assert read_csv(log("Event, Targa\nCar\n" + table(steady())), skip_lines=2).n_samples == 30


def test_factor_turns_a_sign(log):
    data = read_csv(log(table(steady())), {"delta": Column("delta", "rad", factor=-0.5)})
    np.testing.assert_array_equal(data["delta"], [-0.5 * row[1] for row in steady()])


def test_text_columns_that_are_not_asked_for_do_not_matter(log):
    rows = [[*row, "lap one"] for row in steady()]
    assert read_csv(log(table(rows, "t,delta,r,lap")), ["delta", "r"]).n_samples == 30


def test_time_in_other_units_and_epoch(log):
    rows = [[1_700_000_000_000 + 10 * k, *row[1:]] for k, row in enumerate(steady())]
    data = read_csv(log(table(rows, "time [ms],delta,r")))
    assert data.dt == 0.01
    assert data.start_times == (0.0,)
    assert any("1.7e+09 s" in n for n in data.notes)


def test_si_is_assumed_aloud(log):
    assert "no unit named for delta, r: taken as SI" in read_csv(log(table(steady()))).notes


def test_experiment_column_splits(log):
    rows = [[*row, int(k >= 12)] for k, row in enumerate(steady())]
    assert read_csv(log(table(rows, "t,delta,r,lap")), ["delta", "r"], experiment="lap").starts == (0, 12)


# ---- gaps --------------------------------------------------------------------------------------------------------


def test_single_samples_that_a_logger_lost_do_not_cut_a_log_to_pieces(log):
    """Some of a hundred rows are lost, as on a busy bus; what is cut on request, or missing for longer, is a gap."""
    t = np.delete(0.01 * np.arange(1000), [*range(40, 900, 50), 500, 502, 801, 802, 803])
    text = "t,r,v\n" + "".join(f"{x:.4f},{0.2 * x:.4f},{x % 1:.4f}\n" for x in t)
    data = read_csv(log(text), ["r"])
    assert len(data.experiments) == 2
    assert data.dt == 0.01
    np.testing.assert_allclose(data["r"], 0.2 * data.t, atol=1e-6)
    assert any("20 single samples that were lost: filled in linearly" in note for note in data.notes)
    cut = read_csv(log(text), ["r"], filter="t < 0.095 or t > 0.105")
    assert len(cut.experiments) == 3


def test_gaps_split_and_nothing_is_interpolated(log):
    rows = steady(60)
    kept = rows[:20] + rows[23:45] + rows[47:]
    data = read_csv(log(table(kept)))
    assert data.starts == (0, 20, 42)
    assert data.start_times == pytest.approx((0.0, 0.23, 0.47))
    np.testing.assert_array_equal(data.values, [row[1:] for row in kept])
    assert "2 gaps split the log: 0.04 s at line 22 (t = 0.19 s), 0.03 s at line 44 (t = 0.44 s)" in data.notes


@pytest.mark.parametrize("cell", ["", "nan", "NaN", "NA", "inf", "-inf"])
def test_missing_numbers_split_on_request(log, cell):
    rows = steady(40)
    for k in (10, 11, 12, 30):
        rows[k][2] = cell
    path = log(table(rows))
    data = read_csv(path, nan="gap")
    assert data.starts == (0, 10, 27)
    kept = [row[1:] for k, row in enumerate(rows) if k not in (10, 11, 12, 30)]
    np.testing.assert_array_equal(data.values, kept)
    with pytest.raises(errors.NotFiniteError) as caught:
        read_csv(path)
    for part in ("channel 'r'", "4 missing", "2 runs", "3 samples from line 12 to line 14", "t = 0.1 to 0.12", "gap"):
        assert part in str(caught.value)


def test_missing_numbers_split_without_a_time_column(log):
    rows = [row[1:] for row in steady(40)]
    rows[15][0] = ""
    data = read_csv(log(table(rows, "delta,r")), dt=0.1, nan="gap")
    assert data.starts == (0, 15)
    assert data.start_times == pytest.approx((0.0, 1.6))


# ---- what is refused, and how ------------------------------------------------------------------------------------

ROWS = steady()
BAD_TIME = [*ROWS[:10], [0.05, 0, 0], *ROWS[10:]]
SLOWER = [*ROWS, *steady(30, 0.02, ROWS[-1][0] + 0.02)]
CASES = {
    "empty file": ("", {}, errors.TooShortError, ["'run.csv'", "is empty", "expected a header line", "export"]),
    "only comments": ("# a\n# b\n", {}, errors.TooShortError, ["is empty"]),
    "no rows": ("t,delta,r\n", {}, errors.TooShortError, ["headings but no rows", "expected rows"]),
    "one row": (table(ROWS[:1]), {}, errors.TooShortError, ["1 samples", "at least 2", "record longer"]),
    "too short": (table(ROWS), {"shortest": 31}, errors.TooShortError, ["30 samples", "at least 31"]),
    "only short pieces": (
        table(ROWS[:4] + ROWS[8:12]),
        {"shortest": 6},
        errors.TooShortError,
        ["longest of 2", "4 samples", "at least 6"],
    ),
    "missing column": (
        table(ROWS, "t,steer,yawRate"),
        {"columns": {"r": Column("yawrat", "rad/s")}},
        errors.MissingColumnError,
        ["'run.csv'", "'yawrat'", "channel 'r'", "nearest are 'yawRate'", "correct"],
    ),
    "no such position": (
        table(ROWS),
        {"columns": {"r": Column(3, "rad/s")}},
        errors.MissingColumnError,
        ["column number 3", "0 to 2"],
    ),
    "name without heading": (
        table(ROWS).split("\n", 1)[1],
        {"columns": ["r"], "dt": 0.01},
        errors.MissingColumnError,
        ["no header", "Column(0) to Column(2)"],
    ),
    "missing input": (
        table(ROWS),
        {"inputs": ["Delta"]},
        errors.MissingColumnError,
        ["input 'Delta'", "nearest are 'delta'"],
    ),
    "missing output": (table(ROWS), {"outputs": ["rr"]}, errors.MissingColumnError, ["output 'rr'", "'r'"]),
    "column twice": (table(ROWS, "t,r,r"), {}, errors.FormatError, ["several columns named 'r'", "Column(1)"]),
    "column twice, asked for": (
        table(ROWS, "t,r,r"),
        {"columns": ["r"]},
        errors.ParameterError,
        ["2 columns named 'r'", "by position"],
    ),
    "not a number": (
        table([*ROWS[:6], [0.06, "abc", 0.1], *ROWS[7:]]),
        {},
        errors.FormatError,
        ["'run.csv'", "line 8", "column 'delta'", "'abc'", "expected a number", "correct the cell"],
    ),
    "thousands separator": (
        table([*ROWS[:6], ["0,06", "1.234,5", "0,1"], *ROWS[7:]]).replace(",", ";").replace("1.234;5", "1.234,5"),
        {},
        errors.FormatError,
        ["line 8", "cells"],
    ),
    "cut-off line": (
        table(ROWS) + "0.30,0.1",
        {},
        errors.FormatError,
        ["line 32", "2 cells", "expected 3", "delete the line"],
    ),
    "quotes that swallow cells": (
        table([*ROWS[:6], ['"0.06', '0.1"', "0.2"], *ROWS[7:]]),
        {},
        errors.FormatError,
        ["line 8", "2 cells", "expected 3"],
    ),
    "endless cell": (
        table([*ROWS[:2], ["1" * 200_000 + '"', '"', "0"]]),
        {},
        errors.FormatError,
        ["cannot be cut into cells"],
    ),
    "not text": ("\0\1\2\3", {}, errors.FormatError, ["not a text file", "CSV"]),
    "time goes back": (
        table(BAD_TIME),
        {},
        errors.TimeError,
        ["goes back", "line 12", "0.09 s, then 0.05 s", "expected rising", "delete"],
    ),
    "time repeats": (
        table([*ROWS[:10], ROWS[9], *ROWS[10:]]),
        {},
        errors.TimeError,
        ["repeats", "line 12", "0.09 s, then 0.09 s"],
    ),
    "time missing": (table([*ROWS[:4], ["", 0, 0], *ROWS[5:]]), {}, errors.NotFiniteError, ["time", "line 6"]),
    "slower later": (
        table(SLOWER),
        {},
        errors.TimeError,
        ["changes its sample time at line 31", "t = 0.29", "from 0.01 to 0.02 s", "resample"],
    ),
    "faster later": (
        table([*steady(30, 0.02), *steady(40, 0.01, 0.59)]),
        {},
        errors.TimeError,
        ["changes its sample time at line 31", "t = 0.58", "from 0.02 to 0.01 s"],
    ),
    "one odd step": (
        table([*ROWS[:10], [0.0965, 0, 0], *ROWS[11:]]),
        {},
        errors.TimeError,
        ["mixes sample times", "after line 12 (t = 0.0965 s)", "0.0135 s", "0.01 s", "within 20 %", "jitter="],
    ),
    "dt disagrees": (table(ROWS), {"dt": 0.02}, errors.SampleTimeError, ["every 0.01 s", "0.02 s", "correct dt"]),
    "dt negative": (table(ROWS), {"dt": -1.0}, errors.SampleTimeError, ["-1.0 s", "positive"]),
    "no time": (
        table(ROWS, "clock,delta,r"),
        {},
        errors.TimeError,
        ["no time column", "'clock', 'delta', 'r'", "time=", "dt="],
    ),
    "time in metres": (table(ROWS, "t [m],delta,r"), {}, errors.UnitError, ["time column 't'", "length", "time"]),
    "unit of another quantity": (
        table(ROWS, "t,delta [rad],r [m/s]"),
        {},
        errors.UnitError,
        ["column 'r'", "channel 'r'", "'m/s'", "speed", "angular rate", "'rad/s'", "correct the unit"],
    ),
    "unit of another quantity in the settings": (
        table(ROWS),
        {"columns": {"r": Column("r", "m/s")}},
        errors.UnitError,
        ["channel 'r'", "speed", "angular rate"],
    ),
    "header and settings disagree": (
        table(ROWS, "t,delta [deg],r"),
        {"columns": {"delta": Column("delta", "rad")}},
        errors.UnitError,
        ["'deg' by its header", "'rad' by the settings", "override"],
    ),
    "unknown unit": (table(ROWS, "t,delta [grd],r"), {}, errors.UnitError, ["'grd'", "nearest", "'rad'"]),
    "degrees passed off as SI": (
        table([[0.01 * k, 30 * math.sin(k), 0.1] for k in range(30)]),
        {},
        errors.UnitError,
        ["column 'delta'", "names no unit", "reaches 30;", "1.6 rad", "'deg'"],
    ),
    "nan is misspelt": (table(ROWS), {"nan": "drop"}, errors.ParameterError, ["'drop'", "'error', 'gap' or 'merge'"]),
    "nothing chosen": ("t\n0\n1\n2\n", {}, errors.MissingColumnError, ["no column", "at least one"]),
    "broken note of ours": ("# slipangle: {oops\n" + table(ROWS), {}, errors.FormatError, ["line 1", "JSON"]),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_gets_one_sentence(log, case):
    text, options, kind, parts = CASES[case]
    with pytest.raises(errors.SlipangleError) as caught:
        read_csv(log(text), **options)
    assert type(caught.value) is kind
    message = str(caught.value)
    assert "\n" not in message
    assert "expected" in message or "nearest" in message or "there are" in message
    for part in parts:
        assert part in message, message


@pytest.mark.parametrize("seed", range(40))
def test_damaged_files_never_raise_anything_else(log, seed):
    rng = np.random.default_rng(seed)
    alphabet = list("0123456789.,;\t -+eE#%[]()\"'\nnaNinf\u00b0/\0")
    for _ in range(8):
        text = list(GOOD)
        for _ in range(int(rng.choice([1, 3, 20, 100]))):
            where = int(rng.integers(len(text)))
            if rng.random() < 0.6:
                text[where] = str(rng.choice(alphabet))
            else:
                del text[where : where + int(rng.integers(1, 9))]
                text = text or ["x"]
        said = ""
        try:
            data = read_csv(log("".join(text)), nan=str(rng.choice(["error", "gap"])))
            assert np.isfinite(data.values).all()
        except errors.SlipangleError as error:
            said = str(error)
        assert "\n" not in said


def test_missing_file_offers_its_neighbours(log):
    path = log(GOOD, "run_1.csv")
    with pytest.raises(errors.MissingFileError, match=r"run1\.csv' does not exist; .*nearest are 'run_1\.csv'"):
        read_csv(path.with_name("run1.csv"))
    with pytest.raises(errors.MissingFileError, match="there is no folder"):
        read_csv(path.parent / "nowhere" / "run.csv")
    with pytest.raises(errors.MissingFileError, match="is a folder"):
        read_csv(path.parent)


def test_override_trusts_the_settings(log):
    path = log(table(steady(), "t,delta [deg],r"))
    data = read_csv(path, {"delta": Column("delta", "rad", override=True)})
    assert data["delta"][4] == steady()[4][1]


def test_read_dispatches_on_the_suffix(log):
    assert read(log(GOOD, "run.TXT"), ["delta"]).n_samples == 30
    with pytest.raises(errors.FormatError, match=r"suffix '\.xyz' .* expected one of .*\.csv, .*\.txt"):
        read(log(GOOD, "run.xyz"))
    with pytest.raises(errors.MissingFileError, match=r"'.*run\.csw' does not exist; .* nearest are 'run\.xyz'"):
        read(log(GOOD, "run.xyz").with_name("run.csw"))


# ---- jitter ------------------------------------------------------------------------------------------------------


def test_rounded_stamps_are_not_touched(log):
    rows = [[round(k / 60, 3), math.sin(k), math.cos(k)] for k in range(200)]
    data = read_csv(log(table(rows)))
    assert data.dt == pytest.approx(1 / 60, rel=1e-12)
    np.testing.assert_array_equal(data.values, np.array(rows)[:, 1:])
    assert not any("interpolated" in n for n in data.notes)


@pytest.mark.parametrize("amount", [0.05, 0.12, 0.3])
def test_jitter_is_put_back_on_the_grid(log, amount):
    rng = np.random.default_rng(1)
    t = 0.01 * np.arange(500) + rng.uniform(-amount, amount, 500) * 0.005
    t[0] = 0.0
    rows = np.column_stack([t, np.sin(2 * t), np.cos(2 * t)])
    path = log(table(rows.tolist()))
    if amount > 0.2:
        with pytest.raises(errors.TimeError, match="mixes sample times"):
            read_csv(path)
        return
    data = read_csv(path)
    assert data.dt == pytest.approx(0.01, rel=1e-4)
    assert any("interpolated linearly" in n for n in data.notes)
    np.testing.assert_allclose(data["delta"], np.sin(2 * data.t), atol=1e-4)


# ---- round trips -------------------------------------------------------------------------------------------------


def some_data(n=50, seed=0, **options):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(n, 3)) * [1e-7, 1.0, 1e9]
    channels = (Channel("delta", "rad"), Channel("v_x", "m/s"), Channel("odd, name (of mine)", "-"))
    return Dataset(values=values, channels=channels, **{"dt": 0.05, **options})


@pytest.mark.parametrize(
    "data",
    [
        some_data(),
        some_data(n=1),
        some_data(dt=1 / 3, start_times=(149.99,)),
        some_data(inputs=("delta", "v_x"), outputs=("odd, name (of mine)",), name="a, b", notes=("x\ny", "ü")),
        some_data(starts=(0, 1, 20), start_times=(0.0, 3.7, 1.0)),
        some_data(starts=(0, 20), start_times=(1.7e9, 1.8e9)),
        join(some_data(seed=1), some_data(seed=2), some_data(seed=3)),
    ],
    ids=lambda d: f"{d.n_samples}x{len(d.starts)}",
)
def test_written_data_read_back_identically(tmp_path, data):
    path = write_csv(data, tmp_path / "sub" / "run.csv")
    back = read(path)
    np.testing.assert_array_equal(back.values, data.values)
    for key in ("channels", "dt", "inputs", "outputs", "starts", "start_times", "name", "notes"):
        assert getattr(back, key) == getattr(data, key), key
    assert [p.name for p in path.parent.iterdir()] == ["run.csv"]


def test_writing_to_an_impossible_place(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(errors.WriteError, match="cannot be written"):
        write_csv(some_data(), tmp_path / "file" / "run.csv")


def test_a_unit_that_no_heading_holds_is_not_written(tmp_path):
    data = some_data().with_channel("z", np.zeros(50), "furlong [UK]")
    with pytest.raises(errors.UnitError, match="cannot stand in a heading"):
        write_csv(data, tmp_path / "x.csv")
    assert not list(tmp_path.iterdir())


# ---- what a column makes of its numbers --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("column", "expected"),
    [
        (Column("raw", scale=0.1, offset=-40), lambda x: 0.1 * x - 40),
        (Column("raw", "deg", sign=-1), lambda x: -np.radians(x)),
        (Column("raw", "deg", ratio=13.4, sign=-1), lambda x: -np.radians(x) / 13.4),
        (Column("raw", "km/h", scale=0.01, offset=2), lambda x: (0.01 * x + 2) / 3.6),
        (Column("raw", "deg", 2.0, scale=3.0, offset=1.0, ratio=4.0), lambda x: 2 / 4 * np.radians(3 * x + 1)),
        (Column(derive="raw * 'other (one)' + 1"), lambda x: x * (x + 5) + 1),
        (Column(derive="raw / 100", unit="g"), lambda x: 9.80665 * x / 100),
        (Column(derive="t + 0 * raw"), lambda x: 0.1 * x),
    ],
)
def test_a_column_scales_shifts_turns_and_derives(log, column, expected):
    raw = np.arange(20.0)
    path = log("t,raw,other (one)\n" + "\n".join(f"{0.1 * x:.1f},{x},{x + 5}" for x in raw))
    np.testing.assert_allclose(read_csv(path, {"u": column})["u"], expected(raw), rtol=1e-12, atol=1e-15)


def test_a_derived_channel_takes_channels_before_columns(log):
    path = log("t,curvature,v_x\n" + "\n".join(f"{0.1 * k:.1f},{0.01 * k:.2f},36" for k in range(20)))
    columns = {"r": Column(derive="curvature * v_x"), "v_x": Column("v_x", "km/h"), "a_y": Column(derive="r * v_x")}
    data = read_csv(path, columns)
    assert data.names == ("r", "v_x", "a_y")
    np.testing.assert_allclose(data["r"], 0.01 * np.arange(20) * 10, atol=1e-12)
    np.testing.assert_allclose(data["a_y"], data["r"] * 10, atol=1e-12)
    assert data.unit("r") == "rad/s"


UNITS = "t,speed [km/h],curvature [1/km],lat [mG],bare\n" + "\n".join(
    f"{0.1 * k:.1f},36,{k},500,{k}" for k in range(20)
)


def test_a_derived_channel_takes_columns_in_the_unit_that_they_name(log):
    columns = {"v_x": "speed", "r": Column(derive="curvature * v_x"), "q": Column(derive="bare + 1")}
    data = read_csv(log(UNITS), columns)
    np.testing.assert_allclose(data["r"], 0.001 * np.arange(20) * 10, atol=1e-12)
    np.testing.assert_allclose(data["q"], np.arange(20) + 1)


def test_a_unit_that_is_not_known_is_refused_in_what_is_derived_too(log):
    path = log(UNITS)
    for settings in ({"columns": {"a_y": Column(derive="lat + 0")}}, {"columns": ["bare"], "filter": "lat > 0"}):
        with pytest.raises(errors.UnitError, match=r"column 'lat' of .* is in 'mG', .* nearest are .*Column\('lat'"):
            read_csv(path, **settings)
    own = {"lateral": Column("lat", "-", scale=0.00980665), "a_y": Column(derive="lateral - 0.1")}
    assert read_csv(path, own)["a_y"][0] == pytest.approx(4.803325)


@pytest.mark.parametrize(
    ("columns", "settings", "kind", "said"),
    [
        ({"u": Column(derive="nothing * 2")}, {}, errors.MissingColumnError, "no channel or column 'nothing'; "),
        ({"u": Column(derive="w"), "w": Column(derive="u")}, {}, errors.FormatError, "need each other"),
        ({"u": Column(derive="u + 1")}, {}, errors.FormatError, "need each other or themselves"),
        (["delta"], {"filter": "delta"}, errors.ParameterError, "is no condition"),
        (
            ["delta"],
            {"filter": "delta > 7"},
            errors.ParameterError,
            r"keeps no row .*\(delta from .* to .*, SI units\)",
        ),
        (["delta"], {"filter": "import os"}, errors.FormatError, "is no expression"),
    ],
)
def test_what_cannot_be_derived_or_kept_is_said(log, columns, settings, kind, said):
    with pytest.raises(kind, match=said):
        read_csv(log(table(steady())), columns, **settings)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({}, "neither a source nor"),
        ({"source": "a", "derive": "b"}, "both a source and"),
        ({"source": "a", "sign": 0}, "sign of a column is 0"),
        ({"source": "a", "ratio": 0.0}, "ratio of a column is 0"),
        ({"source": "a", "scale": math.inf}, "scale of a column is inf"),
        ({"source": "a", "offset": math.nan}, "offset of a column is nan"),
    ],
)
def test_a_column_that_makes_no_sense_is_refused(arguments, said):
    with pytest.raises(errors.ParameterError, match=said):
        Column(**arguments)


def test_a_filter_cuts_rows_and_leaves_gaps(log):
    t = 0.1 * np.arange(100)
    rows = [[f"{x:.1f}", f"{10 * np.sin(x):.6f}", "" if 50 <= k < 55 else f"{k}"] for k, x in enumerate(t)]
    path = log(table(rows, "t,v_x,u"))
    data = read_csv(path, filter="v_x > 0 and t < 9")  # the empty cells are where v_x < 0
    kept = (10 * np.sin(t) > 0) & (t < 9) & (np.arange(100) > 0)
    assert data.n_samples == kept.sum()
    assert len(data.starts) == 2
    np.testing.assert_allclose(data.t, t[kept], atol=1e-9)
    assert any("keeps 58 of 100 rows" in note for note in data.notes)


# ---- times -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stamps", "settings"),
    [
        ([f"{1777644000000000000 + 10_000_000 * k}" for k in range(30)], {"time": Column("t", "ns")}),
        ([f"{1777644000000000 + 10_000 * k}" for k in range(30)], {"time": Column("t", "us")}),
        ([f"{5000 + 10 * k}" for k in range(30)], {"time": Column("t", "ms")}),
        ([f"2026-05-01T14:00:00.{10 * k:03d}Z" for k in range(30)], {}),
        ([f"2026-05-01 14:00:00.{10 * k:03d}+02:00" for k in range(30)], {}),
        ([f"23:59:59.{10 * k:03d}" for k in range(30)], {}),
        ([f"1.05.2026 9:00:59.{10 * k:03d}" for k in range(30)], {}),
        ([f"2026/05/01 14:00:00.{10 * k:03d}" for k in range(30)], {}),
        ([f"{59 + k // 60}:{k % 60:02d}.500" for k in range(45, 75)], {"dt": 1.0}),
    ],
)
def test_time_comes_in_many_forms(log, stamps, settings):
    text = "t,r\n" + "\n".join(f"{s},{0.1 * k}" for k, s in enumerate(stamps))
    data = read_csv(log(text), ["r"], **settings)
    assert data.dt == pytest.approx(settings.get("dt", 0.01), rel=1e-6)
    assert data.n_samples == 30
    assert len(data.starts) == 1


@pytest.mark.parametrize("stamp", ["03/04/2026 14:00:00.{:03d}", "2:00:00.{:03d} PM"])
def test_a_date_that_can_be_read_in_two_ways_is_refused(log, stamp):
    lines = [f"{stamp.format(10 * k)},{k}" for k in range(30)]
    with pytest.raises(errors.FormatError, match=r"expected a date and time that can be read in one way"):
        read_csv(log("t,r\n" + "\n".join(lines)), ["r"], time="t")


def test_the_day_stands_before_the_month_between_dots(log):
    rows = [f"{day:02d}.02.2026 23:59:59.{ms:03d},1" for day, ms in ((27, 0), (27, 500), (28, 0))]
    stamps = open_log(log("t,r\n" + "\n".join(rows))).tables[""].numbers(0)
    np.testing.assert_allclose(np.diff(stamps), [0.5, 86399.5])


def test_stamps_that_rise_too_fast_for_seconds_are_refused(log):
    """Minutes would be slow enough to be seconds, hours are not."""
    with pytest.raises(errors.TimeError, match=r"rises by 2.78e-06 .* expected seconds, which these cannot be"):
        read_csv(log("t,v_x\n" + "\n".join(f"{0.01 * k / 3600:.12f},{k}" for k in range(30))))


def test_headings_between_quotes_may_hold_blanks(log):
    rows = "\n".join(f"{0.1 * k:.1f} {k}.5   {k}" for k in range(30))
    data = read_csv(log('"time [s]" "yaw rate [deg/s]"   "v_x [km/h]"\n' + rows))
    assert data.names == ("yaw rate", "v_x")
    np.testing.assert_allclose(data["v_x"], np.arange(30) / 3.6)


def test_a_damaged_date_is_named(log):
    stamps = [f"2026-05-01T14:00:00.{10 * k:03d}Z" for k in range(30)]
    stamps[7] = "2026-13-01T14:00:00.070Z"
    with pytest.raises(errors.FormatError, match=r"line 9, column 't' holds '2026-13-.*; expected a date and time"):
        read_csv(log("t,r\n" + "\n".join(f"{s},{k}" for k, s in enumerate(stamps))))


def as_digits(seconds):
    """hhmmss.ss, as NMEA and Racelogic write the time of day."""
    minutes, s = divmod(round(100 * seconds), 6000)
    hours, minutes = divmod(minutes, 60)
    return f"{hours % 24:02d}{minutes:02d}{s // 100:02d}.{s % 100:02d}"


@pytest.mark.parametrize("first", [3600 * 10 + 60 * 59 + 55.0, 86390.0, 12.5, 34 * 60.0])
@pytest.mark.parametrize("step", [0.05, 1.0])
def test_hours_minutes_and_seconds_in_one_number_are_a_time_of_day(tmp_path, first, step):
    t = first + step * np.arange(round(130 / step))
    path = tmp_path / "vbox.csv"
    path.write_text("time,r [rad/s]\n" + "\n".join(f"{as_digits(x)},{x:.2f}" for x in t))
    data = read(path)
    assert data.dt == pytest.approx(step)
    assert (data.n_samples, data.starts, data.start_times) == (len(t), (0,), pytest.approx((first,)))
    text = as_digits(first)
    said = f"hours, minutes and seconds in one number: {float(text):.2f} is {text[:2]}:{text[2:4]}:{text[4:]}"
    assert any(said in note for note in data.notes)
    assert any("midnight" in note for note in data.notes) == (first == 86390.0)


@pytest.mark.parametrize("first", [0.0, 5.0, 105950.0, 1e6])
def test_seconds_are_no_hours_and_minutes(log, first):
    t = first + 0.05 * np.arange(3000)
    data = read_csv(log("time,r [rad/s]\n" + "\n".join(f"{x:.2f},{x:.2f}" for x in t)))
    assert (data.start_times, data.starts) == ((first,), (0,))
    broken = np.concatenate([t[:900], t[:900] + 90])  # a gap elsewhere than between minutes
    data = read_csv(log("time,r [rad/s]\n" + "\n".join(f"{x:.2f},{x:.2f}" for x in broken)))
    assert (data.start_times[0], len(data.starts)) == (first, 2)


@pytest.mark.parametrize(("heading", "per_second"), [("time_ms", 1e3), ("TimeStamp us", 1e6), ("t_s", 1.0)])
def test_time_is_known_by_a_name_that_ends_with_its_unit(log, heading, per_second):
    rows = [[f"{per_second * t:.6f}", *rest] for t, *rest in steady()]
    data = read(log(table(rows, f"{heading},lap_time_ms,r")), {"r": "r"}, outputs=("r",))
    assert data.dt == pytest.approx(0.01)


@pytest.mark.parametrize("date", ["", "2024-04-03;"])
def test_times_of_day_go_on_over_midnight(tmp_path, date):
    clock = [f"23:59:{58 + k / 10:06.3f}" if k < 20 else f"00:00:{k / 10 - 2:06.3f}" for k in range(40)]
    rows = [f"{date}{t};{k / 10}" for k, t in enumerate(clock)]
    path = tmp_path / "night.csv"
    path.write_text(("date;" if date else "") + "time;r\n" + "\n".join(rows))
    data = read(path, {"r": "r"})
    assert data.dt == pytest.approx(0.1)
    assert "the times of day pass midnight and go on from there" in data.notes
    assert data["r"] == pytest.approx(0.1 * np.arange(40))
    path.write_text(("date;" if date else "") + "time;r\n" + "\n".join([*rows, *rows[25:]]))
    with pytest.raises(errors.TimeError, match="goes back"):
        read(path, {"r": "r"})
