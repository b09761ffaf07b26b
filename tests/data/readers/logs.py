"""Log files as programs write them, made from known numbers byte by byte: for tests, not for use."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np


class Made(NamedTuple):
    """A drive with known numbers at two rates. [s, rad, m/s, rad/s]"""

    t: np.ndarray
    delta: np.ndarray
    v_x: np.ndarray
    r: np.ndarray


def drive(n: int = 400, dt: float = 0.01) -> Made:
    """Smooth signals, so that a merge by lines is close to them."""
    t = dt * np.arange(n)
    return Made(t, 0.05 * np.sin(1.3 * t), 20.0 + 2.0 * np.sin(0.4 * t), 0.3 * np.sin(1.3 * t - 0.2))


def motec_csv(made: Made) -> str:
    """As i2 exports it: lines about the session, headings, units, an empty line, every cell in quotes."""
    above = [
        '"Format","MoTeC CSV File",,,"Workbook",""',
        '"Venue","Testring",,,"Worksheet","","","","4"',
        '"Vehicle","Car 7",,,"Vehicle Desc",""',
        '"Driver","A. Driver",,,"Engine ID",""',
        '"Device","M1",,,"","","","","1"',
        '"Comment","wet, cold",,,"Session",""',
        '"Log Date","01/05/2026",,,"Origin Time","0.000","s"',
        '"Log Time","14:00:00",,,"Start Time","0.000","s"',
        '"Sample Rate","100.000","Hz",,"End Time","4.000","s"',
        '"Duration","4.000","s",,"Start Distance","0","m"',
        '"Range","entire outing",,,"End Distance","80","m"',
        '"Beacon Markers","1.5 2.5"',
        "",
        "",
    ]
    head = ['"Time","Distance","Steered Angle","Ground Speed","Gyro Yaw Velocity","Lap Number"']
    head += ['"s","m","deg","km/h","deg/s","lap"', "", ""]
    columns = (
        made.t,
        np.cumsum(made.v_x) * (made.t[1] - made.t[0]),
        np.degrees(made.delta),
        3.6 * made.v_x,
        np.degrees(made.r),
        np.ones(len(made.t)),
    )
    rows = [",".join(f'"{v:.6f}"' for v in row) for row in zip(*columns, strict=True)]
    return "\n".join([*above, *head, *rows]) + "\n"


def race_capture(made: Made, slow: int = 10) -> str:
    """Headings with name, unit, range and rate between bars; a cell is empty where its channel has no sample."""
    head = (
        '"Interval"|"ms"|0|0|1,"Utc"|"ms"|0|0|1,"Steering"|"Deg"|-120.0|120.0|100,"Speed"|"km/h"|0.0|250.0|10,'
        '"Yaw"|"deg/s"|-120|120|100'
    )
    rows = []
    for k in range(len(made.t)):
        ms = round(1000 * made.t[k])
        speed = f"{3.6 * made.v_x[k]:.5f}" if k % slow == 0 else ""
        utc = f"{1777644000000 + ms}" if k % slow == 0 else ""
        rows.append(f"{ms + 5000},{utc},{np.degrees(made.delta[k]):.6f},{speed},{np.degrees(made.r[k]):.6f}")
    return "\n".join([head, *rows]) + "\n"


class LdChannel(NamedTuple):
    """A channel of an .ld file: its raw numbers and how they are scaled."""

    name: str
    unit: str
    rate: int
    raw: np.ndarray
    family: int  # 7 floats, 3 and 5 integers
    shift: int = 0
    multiplier: int = 1
    scale: int = 1
    decimals: int = 0


def write_ld(path: Path, channels: Sequence[LdChannel]) -> Path:
    """An .ld file: the header up to the first channel record at 0x3448, the records in a chain, then the samples."""
    first, size = 0x3448, 124
    at = first + size * len(channels)
    records, blocks = b"", b""
    for k, c in enumerate(channels):
        block = c.raw.tobytes()
        before = first + size * (k - 1) if k else 0
        after = first + size * (k + 1) if k + 1 < len(channels) else 0
        records += struct.pack("<4I", before, after, at + len(blocks), len(c.raw))
        records += struct.pack("<4H", 0x2EE1 + k, c.family, c.raw.itemsize, c.rate)
        records += struct.pack("<4h", c.shift, c.multiplier, c.scale, c.decimals)
        records += c.name.encode("latin-1").ljust(32, b"\0") + b"".ljust(8, b"\0")
        records += c.unit.encode("latin-1").ljust(12, b"\0") + bytes(40)
        blocks += block
    head = struct.pack("<II", 0x40, 0) + struct.pack("<II", first, at)
    head = head.ljust(0x5E, b"\0") + b"01/05/2026".ljust(32, b"\0") + b"14:00:00".ljust(32, b"\0")
    path.write_bytes(head.ljust(first, b"\0") + records + blocks)
    return path


def gpx(latitude: Sequence[float], longitude: Sequence[float], t: Sequence[float]) -> str:
    """A track with a point for each instant. [deg, deg, s after 14:00 UTC]"""
    points = "".join(
        f'<trkpt lat="{a:.9f}" lon="{o:.9f}"><ele>12.5</ele><time>2026-05-01T14:00:{s:09.6f}Z</time></trkpt>'
        for a, o, s in zip(latitude, longitude, t, strict=True)
    )
    return f'<?xml version="1.0"?><gpx version="1.1" xmlns="x"><trk><trkseg>{points}</trkseg></trk></gpx>'


def kml(latitude: Sequence[float], longitude: Sequence[float], t: Sequence[float]) -> str:
    """The same as a track of KML."""
    when = "".join(f"<when>2026-05-01T14:00:{s:09.6f}Z</when>" for s in t)
    where = "".join(f"<gx:coord>{o:.9f} {a:.9f} 12.5</gx:coord>" for a, o in zip(latitude, longitude, strict=True))
    head = '<?xml version="1.0"?><kml xmlns="k" xmlns:gx="g"><Document><Placemark>'
    return f"{head}<gx:Track>{when}{where}</gx:Track></Placemark></Document></kml>"


def vbo(made: Made, first: float = 39590.0) -> str:
    """As a VBOX writes it, from an instant of the day on [s]: a car that drives west from 52 N, 11 E, and a CAN bus."""
    titles = [
        "satellites",
        "time",
        "latitude",
        "longitude",
        "velocity kmh",
        "heading",
        "height",
        "steer",
        "count",
        "yaw",
    ]
    rows = []
    for k, t in enumerate(made.t):
        minutes, s = divmod(round(100 * (first + t)), 6000)
        hours, minutes = divmod(minutes, 60)
        rows.append(
            f"009 {hours % 24:02d}{minutes:02d}{s // 100:02d}.{s % 100:02d} +03120.00000 {-660 + 1e-3 * t:+013.7f} "
            f"{3.6 * made.v_x[k]:011.7f} 270.00 +00152.58 {np.degrees(made.delta[k]):+.8E} {k:d} "
            f"{np.degrees(made.r[k]):+.8E}"
        )
    parts = [
        "File created on 31/07/2006 at 09:55:20",
        "",
        "[header]",
        *titles,
        "",
        "[channel units]",
        "deg",
        "",
        "deg/s",
    ]
    parts += ["", "[comments]", "(c) 2001 2003 Racelogic", "Log Rate (Hz) : 100.00", "", "[column names]"]
    parts += ["sats time lat long velocity heading height steer count yaw", "", "[data]", *rows]
    return "\r\n".join(parts) + "\r\n"


def labelled(made: Made) -> dict[str, object]:
    """Variables of a MATLAB file whose names and units stand beside the numbers: of Simulink and of a logger."""
    names = ("delta", "v_x", "r")
    signals = [{"values": getattr(made, n)[:, None], "label": n, "dimensions": 1.0} for n in names]
    yaw = {"Time": made.t[::2, None], "Value": np.degrees(made.r[::2, None]), "Units": "deg/s"}
    return {"simout": {"time": made.t[:, None], "signals": signals}, "Gyro_Yaw": yaw}


def write_mat5(path: Path, variables: Mapping[str, object]) -> Path:
    """The same variables as `write_mat73`, by SciPy."""
    from scipy.io import savemat

    def value(given: object) -> object:
        if isinstance(given, Mapping):
            return {n: value(x) for n, x in given.items()}
        if isinstance(given, list):
            array = np.empty((1, len(given)), dtype=[(n, "O") for n in given[0]])
            for k, element in enumerate(given):
                array[0, k] = tuple(element.values())
            return array
        return given

    savemat(path, {n: value(x) for n, x in variables.items()})
    return path


def write_mat73(path: Path, variables: Mapping[str, object]) -> Path:
    """A MATLAB 7.3 file as `save -v7.3` lays it out: a header of 512 bytes, matrices stored transposed, classes."""
    import h5py

    def put(group: h5py.Group, name: str, value: object) -> None:
        if isinstance(value, Mapping):
            struct_ = group.create_group(name)
            struct_.attrs["MATLAB_class"] = np.bytes_("struct")
            for key, inner in value.items():
                put(struct_, key, inner)
        elif isinstance(value, list):  # a struct array: each field a list of references
            struct_ = group.create_group(name)
            struct_.attrs["MATLAB_class"] = np.bytes_("struct")
            for key in value[0]:
                places = []
                for k, element in enumerate(value):
                    put(group.file.require_group("#refs#"), f"{name}_{key}_{k}", element[key])
                    places.append(group.file[f"#refs#/{name}_{key}_{k}"].ref)
                struct_.create_dataset(key, data=np.array([places], dtype=h5py.ref_dtype))
        elif isinstance(value, str):
            text = group.create_dataset(name, data=np.array([[ord(c)] for c in value], dtype="u2"))
            text.attrs["MATLAB_class"] = np.bytes_("char")
        else:
            matrix = np.atleast_2d(np.asarray(value))
            stored = group.create_dataset(name, data=matrix.T if np.ndim(value) == 2 else matrix)
            stored.attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            put(file, name, value)
    raw = bytearray(path.read_bytes())
    raw[:128] = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM"
    path.write_bytes(bytes(raw))
    return path


def write_bag(path: Path, made: Made, *, ros: int, slow: int = 10) -> Path:
    """A bag with an IMU and a steering topic at every instant, a speed topic at every ``slow``-th."""
    from rosbags.rosbag1 import Writer as Bag1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Bag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    types = store.types
    vector, stamp = types["geometry_msgs/msg/Vector3"], types["builtin_interfaces/msg/Time"]

    def header(t: float) -> object:
        seconds = 1_777_644_000 + int(t)
        parts = (stamp(seconds, round((t % 1) * 1e9)), "car")
        return types["std_msgs/msg/Header"](*((0, *parts) if ros == 1 else parts))

    def imu(k: int) -> object:
        turn, pull = vector(0.0, 0.0, float(made.r[k])), vector(0.0, float(made.v_x[k] * made.r[k]), 9.8)
        none, quaternion = np.zeros(9), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        return types["sensor_msgs/msg/Imu"](header(made.t[k]), quaternion, none, turn, none, pull, none)

    def number(value: float) -> object:
        return types["std_msgs/msg/Float64"](float(value))

    plain, far = "std_msgs/msg/Float64", 1_777_644_000_000_000_000
    topics = {
        "/imu": ("sensor_msgs/msg/Imu", imu, 1),
        "/steering": (plain, lambda k: number(made.delta[k]), 1),
        "/speed": (plain, lambda k: number(made.v_x[k]), slow),
    }
    writer = (
        Bag1(path)
        if ros == 1
        else Bag2(path, version=9, storage_plugin=StoragePlugin.MCAP if ros == 3 else StoragePlugin.SQLITE3)
    )
    with writer:
        for topic, (kind, make, every) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=store)
            for k in range(0, len(made.t), every):
                message = make(k)
                raw = store.serialize_ros1(message, kind) if ros == 1 else store.serialize_cdr(message, kind)
                writer.write(connection, far + round(made.t[k] * 1e9), raw)
    return path
