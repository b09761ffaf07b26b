"""Every format of a log gives the numbers that were written into it, whatever the file is called."""

import gc
import lzma
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

import slipangle as sa
from slipangle.data.race import equirectangular
from slipangle.data.readers import open_log
from slipangle.data.readers.recording import Recording
from slipangle.data.readers.tables import ArrayTable, Header
from slipangle.errors import (
    ConfigError,
    FormatError,
    MissingColumnError,
    NotFiniteError,
    ParameterError,
    TimeError,
)
from tests.data.readers.logs import (
    LdChannel,
    drive,
    gpx,
    kml,
    labelled,
    motec_csv,
    race_capture,
    vbo,
    write_bag,
    write_ld,
    write_mat5,
    write_mat73,
)

MADE = drive()
SLOW = slice(None, None, 10)


def frame():
    import pyarrow as pa

    inner = pa.StructArray.from_arrays([pa.array(MADE.r), pa.array(0 * MADE.r)], ["z", "x"])
    stamps = pa.array(1_777_644_000_000_000_000 + np.rint(MADE.t * 1e9).astype("int64"))
    text = pa.array(["drive"] * len(MADE.t))
    slow = np.where(np.arange(len(MADE.t)) % 10 == 0, 3.6 * MADE.v_x, np.nan)
    return pa.table(
        {
            "stamp": stamps.cast(pa.timestamp("ns")),
            "steer [deg]": np.degrees(MADE.delta),
            "gyro": inner,
            "speed": pa.array(slow, from_pandas=True),
            "mode": text,
        }
    )


def parquet(path):
    import pyarrow.parquet as pq

    pq.write_table(frame(), path)


def feather(path):
    import pyarrow.feather as feather

    feather.write_feather(frame(), path)


def mat5(path):
    gps = {"time": MADE.t[SLOW], "speed": 3.6 * MADE.v_x[SLOW]}
    savemat(path, {"time": MADE.t, "delta": MADE.delta, "imu": {"wz": np.degrees(MADE.r)}, "gps": gps, "who": "me"})


def mat73(path):
    gps = {"time": MADE.t[SLOW], "speed": 3.6 * MADE.v_x[SLOW]}
    write_mat73(path, {"time": MADE.t, "delta": MADE.delta, "imu": {"wz": np.degrees(MADE.r)}, "gps": gps, "who": "me"})


def mdf(path):
    from asammdf import MDF, Signal

    version = "3.30" if path.stem == "mdf3" else "4.10"
    with MDF(version=version) as file:
        fast = (("steer", "deg", np.degrees(MADE.delta)), ("yaw", "deg/s", np.degrees(MADE.r)))
        file.append([Signal(x, MADE.t, name=n, unit=u) for n, u, x in fast])
        file.append([Signal(MADE.v_x[SLOW].astype("f4"), MADE.t[SLOW], name="speed", unit="m/s")])
        file.save(path.with_suffix(".mf4"), overwrite=True).replace(path)


def ld(path):
    fast = LdChannel("Steered Angle", "deg", 100, np.degrees(MADE.delta).astype("f4"), 7)
    yaw = LdChannel("Gyro Yaw", "deg/s", 100, np.round(np.degrees(MADE.r) / 0.01).astype("i2"), 3, 0, 1, 1, 2)
    speed = LdChannel(
        "Ground Speed", "km/h", 10, np.round((3.6 * MADE.v_x[SLOW] - 30) * 200).astype("i4"), 5, 30, 1, 200
    )
    write_ld(path, [fast, yaw, speed])


MAT = {"delta": "delta", "v_x": sa.Column("gps.speed", "km/h"), "r": sa.Column("imu.wz", "deg/s")}
FORMATS = {
    "MoTeC CSV": (
        lambda p: p.write_text(motec_csv(MADE)),
        {"delta": "Steered Angle", "v_x": "Ground Speed", "r": "Gyro Yaw Velocity"},
        {},
        1e-7,
    ),
    "semicolons and decimal commas": (
        lambda p: p.write_text(motec_csv(MADE).replace(",", ";").replace(".", ",")),
        {"delta": "Steered Angle", "v_x": "Ground Speed", "r": "Gyro Yaw Velocity"},
        {},
        1e-7,
    ),
    "RaceCapture": (
        lambda p: p.write_text(race_capture(MADE)),
        {"delta": "Steering", "v_x": "Speed", "r": "Yaw"},
        {},
        2e-3,
    ),
    "Parquet": (
        parquet,
        {"delta": "steer", "v_x": sa.Column("speed", "km/h"), "r": "gyro.z"},
        {"nan": "merge"},
        2e-3,
    ),
    "Feather": (
        feather,
        {"delta": "steer", "v_x": sa.Column("speed", "km/h"), "r": "gyro.z"},
        {"nan": "merge"},
        2e-3,
    ),
    "MATLAB 5": (
        mat5,
        {"delta": "delta", "v_x": sa.Column("gps.speed", "km/h"), "r": sa.Column("imu.wz", "deg/s")},
        {},
        2e-3,
    ),
    "MATLAB 7.3": (
        mat73,
        {"delta": "delta", "v_x": sa.Column("gps.speed", "km/h"), "r": sa.Column("imu.wz", "deg/s")},
        {},
        2e-3,
    ),
    "mdf3": (mdf, {"delta": "steer", "v_x": "speed", "r": "yaw"}, {}, 2e-3),
    "mdf4": (mdf, {"delta": "steer", "v_x": "speed", "r": "yaw"}, {}, 2e-3),
    "Racelogic VBO": (
        lambda p: p.write_text(vbo(MADE), newline=""),
        {"delta": "steer", "v_x": "velocity", "r": "yaw"},
        {},
        1e-6,
    ),
    "MoTeC ld": (ld, {"delta": "Steered Angle", "v_x": "Ground Speed", "r": "Gyro Yaw"}, {}, 5e-3),
}


@pytest.mark.parametrize("name", FORMATS)
def test_a_log_is_known_by_its_content_and_gives_its_numbers(name, tmp_path):
    write, columns, settings, tolerance = FORMATS[name]
    path = tmp_path / f"{name}.csv"
    write(path)
    data = sa.read(path, columns, inputs=["delta", "v_x"], outputs=["r"], **settings)
    assert data.dt == pytest.approx(0.01)
    assert data.n_samples >= 390
    assert [data.unit(n) for n in ("delta", "v_x", "r")] == ["rad", "m/s", "rad/s"]
    for channel in ("delta", "v_x", "r"):
        written = getattr(MADE, channel)[: data.n_samples]
        np.testing.assert_allclose(data[channel], written, atol=tolerance * np.ptp(written))


@pytest.mark.parametrize(("ros", "name"), [(1, "drive.bag"), (2, "drive"), (3, "drive")])
def test_topics_of_a_bag_are_merged_by_their_time(ros, name, tmp_path):
    path = write_bag(tmp_path / name, MADE, ros=ros)
    log = open_log(path)
    assert set(log.tables) == {"/imu", "/steering", "/speed"}
    assert log.signal("/speed.data").dt == pytest.approx(0.1, abs=1e-6)
    columns = {
        "delta": "/steering.data",
        "v_x": "/speed.data",
        "r": "angular_velocity.z",
        "a_y": "linear_acceleration.y",
    }
    data = sa.read(path, columns, inputs=["delta", "v_x"], outputs=["r"])
    assert data.dt == pytest.approx(0.01)
    for channel, written in (("delta", MADE.delta), ("v_x", MADE.v_x), ("r", MADE.r)):
        np.testing.assert_allclose(data[channel], written[: data.n_samples], atol=2e-3 * np.ptp(written))
    inside = next(path.glob("*.mcap"), None) or next(path.glob("*.db3"), None) if path.is_dir() else None
    if inside is not None:
        assert np.array_equal(sa.read(inside, columns).values, data.values)


@pytest.mark.parametrize("first", [39590.0, 39598.0, 86398.5, 0.0])
def test_places_and_times_of_a_vbo_file_are_those_of_the_world(first, tmp_path):
    path = tmp_path / "lap.vbo"
    path.write_text(vbo(MADE, first))
    data = sa.read(path)
    assert (data.dt, data.starts, data.start_times) == (pytest.approx(0.01), (0,), pytest.approx((first,)))
    assert data.unit("count") == "-"
    np.testing.assert_array_equal(data["count"], np.arange(len(MADE.t)))
    longitude = 11 - 1e-3 / 60 * MADE.t  # minutes that count to the west
    np.testing.assert_allclose(np.degrees(data["longitude"]), longitude, atol=2e-9)
    np.testing.assert_allclose(np.degrees(data["latitude"]), 52.0, rtol=1e-12)
    radius = 6378137 / np.sqrt(1 - 0.00669437999 * np.sin(np.radians(52)) ** 2) * np.cos(np.radians(52))
    np.testing.assert_allclose(data["X"], radius * np.radians(longitude - 11), atol=2e-4)
    np.testing.assert_allclose(data["Y"], 0, atol=1e-9)
    assert np.degrees(data["heading"][0]) == pytest.approx(270)


def test_rows_of_a_vbo_file_without_a_place_have_none(tmp_path):
    """Before the receiver has one it writes zeros, which are a place in the sea off Africa."""
    path = tmp_path / "lap.vbo"
    lines = vbo(MADE).split("\r\n")
    rows = lines.index("[data]") + 1
    for k in range(50):
        cells = lines[rows + k].split()
        cells[2:4] = ["+00000.00000", "+00000.00000"]
        lines[rows + k] = " ".join(cells)
    path.write_text("\r\n".join(lines), newline="")
    with pytest.raises(NotFiniteError):
        sa.read(path)
    data = sa.read(path, nan="gap")
    assert data.n_samples == len(MADE.t) - 50
    assert np.abs(data["X"]).max() < 1000.0


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("steer\r\n", "", r"9 channels under \[header\], 10 under"),
        ("[data]", "[rows]", r"0 rows under \[data\]"),
        ("270.00", "", r"no even table of numbers|rows of 9 numbers"),
        ("+03120", "x03120", "no even table of numbers"),
        ("+03120", "+93120", "beyond the poles; expected minutes"),
    ],
)
@pytest.mark.parametrize("rows", [1, -1])
def test_a_damaged_vbo_file_is_refused(old, new, said, rows, tmp_path):
    path = tmp_path / "lap.vbo"
    path.write_text(vbo(MADE).replace(old, new, rows), newline="")
    with pytest.raises(FormatError, match=said):
        sa.read(path)


@pytest.mark.parametrize(("unit", "factor"), [("kmh", 1 / 3.6), ("mph", 0.44704), ("m/s", 1.0), ("kn", 1852 / 3600)])
def test_the_speed_of_a_vbo_file_is_in_the_unit_of_its_title(unit, factor, tmp_path):
    path = tmp_path / "lap.vbo"
    path.write_text(vbo(MADE).replace("velocity kmh", f"velocity {unit}"))
    np.testing.assert_allclose(sa.read(path, ["velocity"])["velocity"], 3.6 * MADE.v_x * factor, rtol=1e-6)


@pytest.mark.parametrize("lines", ["deg", "deg\r\n\r\n\r\ndeg/s\r\n"])
def test_units_of_a_vbo_file_that_may_be_of_other_channels_are_not_taken(lines, tmp_path):
    path = tmp_path / "lap.vbo"
    path.write_text(vbo(MADE).replace("deg\r\n\r\ndeg/s\r\n", f"{lines}\r\n"), newline="")
    data = sa.read(path)
    assert [data.unit(n) for n in ("steer", "yaw", "velocity")] == ["-", "-", "m/s"]
    assert any("[channel units] is not one line for each" in note for note in data.notes)


@pytest.mark.parametrize("write", [gpx, kml])
def test_positions_become_metres(write, tmp_path):
    t = 0.2 * np.arange(100)
    latitude, longitude = 48.0 + 1e-5 * np.sin(t), 11.0 + 2e-5 * t
    path = tmp_path / "lap.xml"
    path.write_text(write(latitude, longitude, t))
    data = sa.read(path)
    east, north = equirectangular(np.radians(latitude), np.radians(longitude))
    assert data.dt == pytest.approx(0.2)
    np.testing.assert_allclose(data["X"], east, atol=1e-3)
    np.testing.assert_allclose(data["Y"], north, atol=1e-3)
    assert data["Z"] == pytest.approx(12.5)
    np.testing.assert_allclose(data["latitude"], np.radians(latitude), atol=1e-11)


def test_channels_stay_at_their_rates_until_they_are_resampled(tmp_path):
    path = tmp_path / "drive.ld"
    ld(path)
    log = open_log(path)
    assert log.names == ("100 Hz.t", "Steered Angle", "Gyro Yaw", "10 Hz.t", "Ground Speed")
    speed = log.signal("Ground Speed")
    assert (len(speed.values), speed.dt, speed.unit) == (40, pytest.approx(0.1), "km/h")
    np.testing.assert_allclose(speed.values, 3.6 * MADE.v_x[SLOW], atol=0.003)
    slow = log.resample(0.05, {"v_x": "Ground Speed", "r": "Gyro Yaw"})
    assert slow.dt == 0.05
    assert any("low-pass" in note for note in slow.notes)
    assert any("Ground Speed at 10 Hz" in note for note in log.resample(columns=["Gyro Yaw", "Ground Speed"]).notes)
    alone = sa.read(path, {"v_x": "Ground Speed"})
    assert alone.dt == pytest.approx(0.1)


def test_scaling_of_an_ld_channel_is_the_documented_one(tmp_path):
    raw = np.arange(-50, 50, dtype="<i2")
    path = write_ld(
        tmp_path / "x.ld", [LdChannel("Brake Pres", "bar", 50, raw, 3, shift=7, multiplier=3, scale=4, decimals=1)]
    )
    values = open_log(path).signal("Brake Pres").values
    np.testing.assert_allclose(values, (raw / 4 * 0.1 + 7) * 3, rtol=1e-15)
    half = write_ld(tmp_path / "y.ld", [LdChannel("Lat", "g", 50, np.linspace(-1, 1, 9).astype("<f2"), 7)])
    np.testing.assert_array_equal(open_log(half).signal("Lat").values, np.linspace(-1, 1, 9).astype("f2"))


def test_beacons_beside_an_ld_file_are_told(tmp_path):
    path = tmp_path / "drive.ld"
    ld(path)
    path.with_suffix(".ldx").write_text(
        '<?xml version="1.0"?><LDXFile><Layers><Layer><MarkerBlock><MarkerGroup Name="Beacons">'
        '<Marker Version="100" ClassName="BCN" Name="Manual.1" Flags="77" Time="1.5e+06"/>'
        '<Marker Version="100" ClassName="BCN" Name="Manual.2" Flags="77" Time="3.25e+06"/>'
        "</MarkerGroup></MarkerBlock></Layer></Layers></LDXFile>"
    )
    notes = sa.read(path, {"v_x": "Ground Speed"}).notes
    assert "'drive.ldx' marks 2 beacons, at t = 1.500, 3.250 s" in notes


def test_a_file_beside_a_file_brings_more_channels(tmp_path):
    imu, wheel = tmp_path / "imu.csv", tmp_path / "wheel.csv"
    far = 1_777_644_000.0
    imu.write_text("t,yaw [rad/s]\n" + "\n".join(f"{far + t:.6f},{r:.9f}" for t, r in zip(MADE.t, MADE.r, strict=True)))
    late = MADE.t[::5] + 0.0031
    rows = zip(late, np.interp(late, MADE.t, MADE.delta), strict=True)
    wheel.write_text("t,angle\n" + "\n".join(f"{far + t:.6f},{a:.9f}" for t, a in rows))
    data = sa.read(imu, {"delta": "angle", "r": "yaw"}, beside=[wheel], inputs=["delta"], outputs=["r"])
    assert data.dt == pytest.approx(0.01)
    at = data.t + 0.01  # the clock is that of the faster one, from its first sample on that both have
    np.testing.assert_allclose(data["r"], np.interp(at, MADE.t, MADE.r), atol=1e-6)
    np.testing.assert_allclose(data["delta"], np.interp(at, MADE.t, MADE.delta), atol=1e-4)


@pytest.mark.parametrize("rate", [1024.0, 102.4, 128.5, 256.0, 60.0, 100.0])
@pytest.mark.parametrize("late", [0.0, 0.0037])
def test_the_fastest_channel_is_not_interpolated_when_others_are_put_on_its_clock(rate, late):
    t, slow = np.arange(int(4 * rate)) / rate, 0.1 * np.arange(38) + late
    fast = np.sin(2 * np.pi * 0.1 * rate * t)
    tables = {
        topic: ArrayTable(
            name=topic,
            headers=(Header(text="t", name="t", unit="s"), Header(text=name, name=name, unit="m")),
            values=np.column_stack([stamps, values]),
        )
        for topic, name, stamps, values in (("one", "a", t, fast), ("two", "b", slow, np.cos(slow)))
    }
    data = Recording(name="run", tables=tables).resample(columns={"a": "a", "b": "b"})
    assert data.dt == pytest.approx(1 / rate, rel=1e-9)
    assert late <= data.t[0] < late + 1 / rate
    np.testing.assert_allclose(data["a"], np.sin(2 * np.pi * 0.1 * rate * data.t), atol=1e-9)
    np.testing.assert_allclose(data["b"], np.cos(data.t), atol=2e-3)


def test_a_silent_topic_is_a_gap(tmp_path):
    t = 0.01 * np.arange(600)
    keep = (t < 2.0) | (t > 3.0)
    rows = [
        f"{t[k]:.2f},{np.sin(t[k]):.6f},{20 + np.sin(t[k]) if keep[k] and k % 5 == 0 else ''}" for k in range(len(t))
    ]
    path = tmp_path / "wide.csv"
    path.write_text("t,r,v_x\n" + "\n".join(rows))
    with pytest.raises(NotFiniteError, match=r"nan='merge'"):
        sa.read(path)
    data = sa.read(path, nan="merge")
    assert len(data.starts) == 2
    first, second = data.experiments
    assert first.t[-1] == pytest.approx(1.95)
    assert second.t[0] == pytest.approx(3.05)
    np.testing.assert_allclose(data["v_x"], 20 + np.sin(data.t), atol=1e-3)


def test_single_empty_cells_that_merging_fills_are_told(tmp_path):
    rows = [f"{0.01 * k:.2f},{k / 100},{'' if k in (7, 30) else k / 200},{k if k % 5 == 0 else ''}" for k in range(100)]
    path = tmp_path / "cells.csv"
    path.write_text("t,r,delta,v_x\n" + "\n".join(rows))
    data = sa.read(path, nan="merge")
    assert "single cells without a number, filled in linearly: 2 of delta" in data.notes
    np.testing.assert_allclose(data["delta"], data["r"] / 2)


@pytest.mark.parametrize("write", [write_mat5, write_mat73])
def test_names_and_units_beside_the_numbers_of_a_matlab_file_are_theirs(write, tmp_path):
    log = open_log(write(tmp_path / "x.mat", labelled(MADE)))
    assert {"simout.signals.delta", "simout.signals.v_x", "Gyro_Yaw.Value"} <= {
        f"{topic}.{h.name}" for topic, table in log.tables.items() for h in table.headers
    }
    assert log.signal("Gyro_Yaw.Value").unit == "deg/s"
    data = log.resample(None, {"delta": "simout.signals.delta", "v_x": "simout.signals.v_x", "r": "Gyro_Yaw.Value"})
    for name in ("delta", "v_x", "r"):
        np.testing.assert_allclose(data[name], np.interp(data.t, MADE.t, getattr(MADE, name)), atol=1e-4)


@pytest.mark.parametrize("write", [write_mat5, write_mat73])
def test_odd_labels_of_a_matlab_file_leave_its_numbers_findable(write, tmp_path):
    """Two of one name, one with a dot, one that no terminal shows, and one that is empty."""
    labels = ("same", "same", "a.b", "bell\a", " ")
    signals = [{"values": k + np.arange(9.0)[:, None], "label": n} for k, n in enumerate(labels)]
    log = open_log(write(tmp_path / "x.mat", {"time": 0.1 * np.arange(9.0), "signals": signals}))
    firsts = {n: log.tables[""].numbers(i)[0] for i, n in enumerate(h.name for h in log.tables[""].headers)}
    assert firsts == {"t": 0, "signals(1).values": 0, "signals(2).values": 1, "signals.a_b": 2} | {
        f"signals({k + 1}).values": k for k in (3, 4)
    }


@pytest.mark.parametrize("write", [write_mat5, write_mat73])
def test_columns_of_a_matrix_of_a_matlab_file_are_counted_and_in_no_unit(write, tmp_path):
    matrix = np.column_stack([20 + MADE.t, MADE.delta, MADE.r])
    log = open_log(write(tmp_path / "x.mat", {"t": MADE.t[:, None], "M": matrix}))
    assert set(log.names) == {"t", "M(1)", "M(2)", "M(3)"}
    data = log.resample(None, {"v_x": "M(1)", "r": "M(3)"})
    np.testing.assert_array_equal(data["v_x"], matrix[:, 0])
    assert "no unit named for v_x, r: taken as SI" in data.notes


@pytest.mark.parametrize("origin", [0.0, 1.7e9])
def test_a_channel_that_shortens_the_drive_is_named(tmp_path, origin):
    """Its end or its begin is the merged log's, however long the others go on."""
    k = np.arange(2000)
    path = tmp_path / "x.csv"

    def notes(x_there, y_there):
        rows = zip(k, k < x_there, k >= y_there, strict=True)
        cells = [f"{origin + 0.01 * n:.2f},{np.sin(0.01 * n) if a else ''},{n if b else ''}" for n, a, b in rows]
        path.write_text("time [s],X [m],Y [m]\n" + "\n".join(cells))
        data = sa.read(path, {"X": "X", "Y": "Y"}, nan="merge")
        assert data.duration == pytest.approx(0.01 * (x_there - y_there), abs=0.03)
        return [n for n in data.notes if n.startswith("merged")]

    (up_to,) = notes(1000, 0)
    assert up_to == "merged up to 9.99 s, where X ends: Y ends at 19.99 s"
    both = notes(1500, 500)
    begin, other, end = (0.0, -5.0, 9.99) if origin else (5.0, 0.0, 14.99)
    assert both[0] == f"merged from {begin:g} s, where Y begins: X begins at {other:g} s"
    assert both[1].startswith(f"merged up to {end:g} s, where X ends: Y ends at ")
    assert notes(1980, 20) == []


@pytest.mark.parametrize("day", [738000.25, 46143.25], ids=["datenum", "spreadsheet"])
def test_dates_in_days_are_asked_for_by_their_unit(tmp_path, day):
    t = day + MADE.t / 86400
    path = tmp_path / "x.csv"
    path.write_text("time,r [rad/s]\n" + "\n".join(f"{a:.11f},{b:.6f}" for a, b in zip(t, MADE.r, strict=True)))
    with pytest.raises(TimeError, match=r"begins at \d+.25 and rises .* days: name the unit, .* \[d\]'"):
        sa.read(path)
    data = sa.read(path, time=sa.Column("time", "d"))
    assert data.dt == pytest.approx(0.01, rel=1e-3)
    assert data.duration == pytest.approx(MADE.t[-1] - MADE.t[0], abs=0.02)


def timetables(folder, version, change=lambda raw: raw):
    """A file of timetables that matio 1.0.2 wrote, which lays objects out as MATLAB does."""
    packed = Path(__file__).parent / f"timetables_{version}.mat.xz"
    path = folder / "x.mat"
    path.write_bytes(change(lzma.decompress(packed.read_bytes())))
    return path


@pytest.mark.parametrize("version", ["v7", "v73"])
def test_timetables_and_tables_of_a_matlab_file_are_read(version, tmp_path):
    """Row times as durations, as datetimes, by a rate and by a step, a duration in a table; beside them words."""
    log = open_log(timetables(tmp_path, version))
    assert not log.notes
    t = 0.02 * np.arange(25)
    wanted = {
        "log.SteeringWheelAngle": (t, 40 * np.sin(t), "deg"),
        "log.VehicleSpeed": (t, 60 + 5 * t, "km/h"),
        "dates.r": (1_700_000_000.25 + t, 0.1 * np.arange(25), None),
        "car.table.v_x": (t, 20 + t, None),
        "rate.YawRate": (1.5 + np.arange(25) / 40, 12 * np.cos(t), "deg/s"),
        "step.YawRate": (1.5 + t, 12 * np.cos(t), None),
    }
    for name, (times, values, unit) in wanted.items():
        topic, _, column = name.rpartition(".")
        table = log.tables[topic]
        place = [h.name for h in table.headers].index(column)
        alone = Recording(name="x", tables={topic: table})
        signal = alone.signal(column)
        assert signal.unit == table.headers[place].unit == unit
        np.testing.assert_allclose(signal.values, values, atol=1e-6)
        np.testing.assert_allclose(signal.t - signal.t[0], times - times[0], atol=1e-6)
        np.testing.assert_allclose(table.numbers([h.name for h in table.headers].index("t")), times, atol=1e-6)
    data = sa.read(tmp_path / "x.mat", {"delta": "log.SteeringWheelAngle", "r": "log.YawRate"})
    np.testing.assert_allclose(data["delta"], np.radians(40 * np.sin(t)), atol=1e-6)


def test_other_objects_of_a_matlab_file_are_named(tmp_path):
    log = open_log(timetables(tmp_path, "v7", lambda raw: raw.replace(b"timetable", b"timeseria")))
    assert set(log.notes) == {
        f"'{name}' is an object of class timeseria, which is not read" for name in ("log", "dates", "rate", "step")
    }
    assert log.signal("v_x").values[0] == 20
    savemat(tmp_path / "y.mat", {"who": "nobody", "n": 3.0})
    with pytest.raises(MissingColumnError, match=r"holds no vectors .* struct\(object\)"):
        open_log(tmp_path / "y.mat")


@pytest.mark.parametrize(
    ("name", "module", "what"),
    [
        ("Parquet", "pyarrow.parquet", "reading a Parquet file"),
        ("Feather", "pyarrow.feather", "reading a Feather file"),
        ("mdf4", "asammdf", "reading an MDF file"),
        ("MATLAB 7.3", "h5py", "reading a MATLAB 7.3 file"),
    ],
)
def test_a_library_that_is_absent_is_asked_for_by_its_extra(name, module, what, tmp_path, monkeypatch):
    path = tmp_path / "run.bin"
    FORMATS[name][0](path)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigError, match=rf"^{what} needs {module}, which .* pip install 'slipangle\[io\]'$"):
        sa.read(path)


def test_several_columns_of_one_name_are_told_apart(tmp_path):
    path = write_ld(
        tmp_path / "x.ld",
        [LdChannel("Speed", "m/s", rate, np.arange(40 * rate // 10, dtype="<f4"), 7) for rate in (10, 100)],
    )
    with pytest.raises(ParameterError, match=r"2 columns named 'Speed'; .* 100 Hz\.Speed, 10 Hz\.Speed"):
        sa.read(path, {"v_x": "Speed"})
    assert sa.read(path, {"v_x": "10 Hz.Speed"}).n_samples == 40


@pytest.mark.parametrize("cut", [9, 16, 0x3448, 0x3460, 0x3500, -1])
def test_half_an_ld_file_is_refused(cut, tmp_path):
    path = tmp_path / "x.ld"
    ld(path)
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(FormatError, match="no whole MoTeC log"):
        open_log(path)


def test_an_ld_file_whose_channels_go_round_is_refused(tmp_path):
    path = tmp_path / "x.ld"
    ld(path)
    raw = bytearray(path.read_bytes())
    raw[0x3448 + 124 + 4 : 0x3448 + 124 + 8] = struct.pack("<I", 0x3448)
    path.write_bytes(raw)
    with pytest.raises(FormatError, match="has no end"):
        open_log(path)


def test_an_mdf_file_is_open_as_long_as_a_table_of_it_is_there(tmp_path, monkeypatch):
    """It stayed open for as long as Python ran."""
    asammdf = pytest.importorskip("asammdf")
    t = 0.01 * np.arange(300)
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(np.sin(t), t, name="r", unit="rad/s")])
        file.save(tmp_path / "log.mf4")
    closed, close = [], asammdf.MDF.close
    monkeypatch.setattr(asammdf.MDF, "close", lambda file: (closed.append(file.name), close(file)))
    log = open_log(tmp_path / "log.mf4")
    (table,) = log.tables.values()
    del log
    gc.collect()
    np.testing.assert_allclose(table.numbers(1), np.sin(t))
    assert not closed
    del table
    gc.collect()
    assert set(closed) == {tmp_path / "log.mf4"}


def test_samples_that_an_mdf_file_marks_invalid_are_missing(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    t, invalid = 0.01 * np.arange(300), np.zeros(300, dtype=bool)
    invalid[100] = True
    invalid[200:210] = True
    speed = np.where(invalid, 400.0, 72.0 + t)
    with asammdf.MDF(version="4.10") as file:
        signals = [
            asammdf.Signal(speed, t, name="v_x", unit="km/h", invalidation_bits=invalid),
            asammdf.Signal(np.sin(t), t, name="delta", unit="deg"),
        ]
        file.append(signals)
        file.save(tmp_path / "bus.mf4")
    data = sa.read(tmp_path / "bus.mf4", {"v_x": "v_x", "delta": "delta"}, nan="gap")
    assert data["v_x"].max() * 3.6 == pytest.approx(72.0 + t[-1])
    assert data.n_samples == 289
    with pytest.raises(NotFiniteError):
        sa.read(tmp_path / "bus.mf4", {"v_x": "v_x", "delta": "delta"})
