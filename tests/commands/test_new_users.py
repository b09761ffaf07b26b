"""A log as somebody else's program wrote it becomes a car by `inspect`, `init` and `run`, and nothing else.

The car is four Runge-Kutta steps of the bicycle in plain NumPy, the files are written by the programs that users have
(pandas, SciPy, rosbags) or byte by byte after what i2 exports; nothing of the toolbox made them.
"""

import json
from typing import NamedTuple

import numpy as np
import pytest

from slipangle.cli import main
from slipangle.workflow.log import read_logs
from slipangle.workflow.settings import read_settings

MASS, WHEELBASE, L_F, INERTIA, C_F, C_R = 1180.0, 2.55, 1.15, 1750.0, 85e3, 98e3
RATIO = 13.5
CAR = ("--mass", "1180", "--wheelbase", "2.55", "--l-f", "1.15")
START = 1_700_000_000  # s since 1970, of the first sample


class Drive(NamedTuple):
    """SI units, positive to the left, one sample for each of ``t``."""

    t: np.ndarray
    delta: np.ndarray
    v_x: np.ndarray
    v_y: np.ndarray
    r: np.ndarray
    a_y: np.ndarray

    def at(self, t: np.ndarray) -> "Drive":
        return Drive(t, *(np.interp(t, self.t, x) for x in self[1:]))


def driven(seconds=90.0, dt=0.01, seed=3) -> Drive:
    """The car stands, drives off, weaves and stops; gyroscope and accelerometer are noisy."""
    rng = np.random.default_rng(seed)
    t = dt * np.arange(round(seconds / dt))
    going = np.clip((t - 4) / 5, 0, 1) * np.clip((seconds - 3 - t) / 5, 0, 1)
    v_x = (18 + 6 * np.sin(0.17 * t)) * going
    delta = 0.03 * np.sin(0.7 * t) + 0.02 * np.sin(1.9 * t + 1) + 0.012 * np.sin(5.1 * t) + 0.006 * np.sin(9 * t)
    delta *= np.clip((t - 2) / 2, 0, 1)
    l_r, x, states, a_y = WHEELBASE - L_F, np.zeros(2), np.zeros((len(t), 2)), np.zeros(len(t))

    def rate(x, k):
        if v_x[k] < 1:
            return np.array([-20 * x[0], 20 * (v_x[k] * delta[k] / WHEELBASE - x[1])])
        front = C_F * (delta[k] - (x[0] + L_F * x[1]) / v_x[k])
        rear = C_R * -(x[0] - l_r * x[1]) / v_x[k]
        return np.array([(front + rear) / MASS - v_x[k] * x[1], (L_F * front - l_r * rear) / INERTIA])

    for k in range(len(t)):
        states[k], a_y[k] = x, rate(x, k)[0] + v_x[k] * x[1]
        for _ in range(2):
            h = dt / 2
            k1 = rate(x, k)
            k2 = rate(x + h / 2 * k1, k)
            k3 = rate(x + h / 2 * k2, k)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3, k))
    noise = rng.normal(size=(2, len(t)))
    return Drive(t, delta, v_x, states[:, 0], states[:, 1] + 0.002 * noise[0], a_y + 0.05 * noise[1])


@pytest.fixture(scope="module")
def drive():
    return driven()


# ---- what their programs write -------------------------------------------------------------------------------------

I2 = """"Format","MoTeC CSV File",,,"Workbook","Circuit 1"
"Venue","Mallala",,,"Worksheet","Driver"
"Vehicle","Car 12",,,"Vehicle Desc",""
"Driver","J. Smith",,,"Engine ID",""
"Device","ADL3",,,"Session","P2"
"Comment","",,,"",""
"Log Date","14/03/2021",,,"Origin Time","0.000","s"
"Log Time","10:32:11",,,"Start Time","0.000","s"
"Sample Rate","50.000","Hz",,"End Time","89.980","s"
"Duration","89.980","s",,"Start Distance","0","m"
"Range","entire outing",,,"End Distance","1513","m"
"Beacon Markers","12.1 70.2"


"Time","Corr Dist","Engine RPM","Ground Speed","G Force Lat","Steered Angle","Gyro Yaw Velocity","Gear","Fuel Temp"
"s","m","rpm","km/h","G","deg","deg/s","","C"


"""


def motec(folder, drive):
    """i2 counts everything to the right here, the hand wheel is logged, lines end as in Windows."""
    d = drive.at(drive.t[::2])
    columns = (d.t, np.cumsum(d.v_x) * 0.02, 2000 + 150 * d.v_x, 3.6 * d.v_x, -d.a_y / 9.80665)
    columns += (-np.degrees(RATIO * d.delta), -np.degrees(d.r), 3 + 0 * d.t, 40 + 0 * d.t)
    shown = ("%.3f", "%.0f", "%.0f", "%.2f", "%.3f", "%.2f", "%.2f", "%.0f", "%.1f")
    rows = (",".join(f'"{s % v}"' for s, v in zip(shown, row, strict=True)) for row in zip(*columns, strict=True))
    path = folder / "outing12.csv"
    path.write_bytes((I2 + "\n".join(rows) + "\n").replace("\n", "\r\n").encode())
    return path


def motec_mat(folder, drive):
    """i2's export for MATLAB: a struct for each channel, each at its own rate."""
    from scipy.io import savemat

    def channel(x, every, unit):
        return {"Units": unit, "Time": drive.t[None, ::every], "Value": x[None, ::every]}

    content = {
        "Ground_Speed": channel(3.6 * drive.v_x, 5, "km/h"),
        "Steered_Angle": channel(np.degrees(RATIO * drive.delta), 1, "deg"),
        "Gyro_Yaw_Velocity": channel(np.degrees(drive.r), 2, "deg/s"),
        "Engine_RPM": channel(2000 + 150 * drive.v_x, 10, "rpm"),
    }
    savemat(folder / "i2.mat", content)
    return folder / "i2.mat"


def parquet(folder, drive):
    """Topics of a bag joined by pandas: fields by their whole names, an index of instants, empty cells."""
    import pandas as pd

    def topic(drive, **columns):
        stamps = pd.to_datetime(START * 10**9 + np.round(1e9 * drive.t).astype("int64"))
        return pd.DataFrame(columns, index=stamps)

    imu, odometry, steering = drive, drive.at(drive.t[::4] + 0.009), drive.at(drive.t[::2] + 0.003)
    turn = {f"/imu/data.angular_velocity.{a}": x for a, x in zip("xyz", (0 * imu.t, 0 * imu.t, imu.r), strict=True)}
    parts = [
        topic(imu, **turn, **{"/imu/data.linear_acceleration.y": imu.a_y}),
        topic(odometry, **{"/odom.twist.twist.linear.x": odometry.v_x, "/odom.twist.twist.linear.y": odometry.v_y}),
        topic(steering, **{"/vehicle/steering_report.steering_wheel_angle": RATIO * steering.delta}),
    ]
    table = pd.concat(parts).sort_index(kind="stable").rename_axis("time")
    table.to_parquet(folder / "log.parquet")
    return folder / "log.parquet"


def levels(folder, drive):
    """A frame of pandas whose headings have two levels."""
    import pandas as pd

    columns = {("t", ""): drive.t, ("imu", "yaw_rate"): drive.r, ("can", "speed [km/h]"): 3.6 * drive.v_x}
    columns[("can", "steer [deg]")] = np.degrees(drive.delta)
    pd.DataFrame(columns).to_parquet(folder / "levels.parquet")
    return folder / "levels.parquet"


def bag(folder, drive, *, mcap=False, samples=1500):
    """A bag of an autonomous car with a message type of its own, a command beside what was measured."""
    from rosbags.rosbag1 import Writer as Bag1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Bag2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE if mcap else Stores.ROS1_NOETIC)
    report = "car_msgs/msg/SteeringReport"
    store.register(get_types_from_msg("std_msgs/Header header\nfloat32 steering_angle\n", report))
    make = {n.rpartition("/")[2]: kind for n, kind in store.types.items() if n != "std_msgs/msg/Time"}

    def header(t):
        ns = round(1e9 * t)
        stamp = make["Time"](START + ns // 10**9, ns % 10**9)
        return make["Header"](stamp, "car") if mcap else make["Header"](0, stamp, "car")

    def vector(x=0.0, y=0.0, z=0.0):
        return make["Vector3"](float(x), float(y), float(z))

    def imu(k):
        pull, none = vector(0, drive.a_y[k], 9.81), np.zeros(9)
        straight = make["Quaternion"](0.0, 0.0, 0.0, 1.0)
        return make["Imu"](header(drive.t[k]), straight, none, vector(z=drive.r[k]), none, pull, none)

    def speed(k):
        twist = make["Twist"](vector(drive.v_x[k], drive.v_y[k]), vector(z=drive.r[k]))
        return make["TwistStamped"](header(drive.t[k]), twist)

    topics = {
        "/imu/data": ("sensor_msgs/msg/Imu", imu, 1),
        "/vehicle/twist": ("geometry_msgs/msg/TwistStamped", speed, 4),
        "/vehicle/steering": (report, lambda k: make["SteeringReport"](header(drive.t[k]), float(drive.delta[k])), 2),
        "/steering_cmd": (report, lambda k: make["SteeringReport"](header(drive.t[k]), 0.3 * np.sin(drive.t[k])), 2),
    }
    path = folder / ("bag" if mcap else "drive.bag")
    with Bag2(path, version=9, storage_plugin=StoragePlugin.MCAP) if mcap else Bag1(path) as writer:
        drive = drive.at(drive.t[:samples])
        for topic, (kind, message, every) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=store)
            for k in range(0, len(drive.t), every):
                raw = (store.serialize_cdr if mcap else store.serialize_ros1)(message(k), kind)
                writer.write(connection, START * 10**9 + round(1e9 * drive.t[k]), raw)
    return path


def mcap(folder, drive):
    return bag(folder, drive, mcap=True)


def long_bag(folder, drive):
    return bag(folder, drive, samples=len(drive.t))


def simulink(folder, drive):
    """A To Workspace block, "Structure With Time": the signals' names are labels beside them."""
    from scipy.io import savemat

    d = drive.at(drive.t[::2])
    signals = np.empty((1, 3), dtype=[(n, "O") for n in ("values", "dimensions", "label", "blockName")])
    for k, (label, x) in enumerate((("delta", d.delta), ("v_x", d.v_x), ("r", d.r))):
        signals[0, k] = (x[:, None], 1.0, label, f"car/{label}")
    savemat(folder / "simout.mat", {"simout": {"time": d.t[:, None], "signals": signals, "blockName": "car/Out"}})
    return folder / "simout.mat"


def dates(folder, drive):
    """What table2struct makes of a table whose time is a datenum, beside scalars of a workspace."""
    from scipy.io import savemat

    d = drive.at(drive.t[::2])
    table = {"Time": 738000.43 + d.t / 86400, "SteeringWheelAngle": np.degrees(RATIO * d.delta)}
    table |= {"VehicleSpeed": 3.6 * d.v_x, "YawRate": np.degrees(d.r)}
    savemat(folder / "table.mat", {"S": {n: x[:, None] for n, x in table.items()}, "m": 1180.0, "name": "car"})
    return folder / "table.mat"


# ---- what they see -------------------------------------------------------------------------------------------------


def told(capsys, *arguments):
    assert main([str(a) for a in arguments]) == 0
    return capsys.readouterr().out


def written(write, folder, drive, capsys, *more):
    """The job that `init` writes, after `inspect`, with the steering's ratio put where it asks for it."""
    needs = {parquet: "pyarrow", levels: "pyarrow", bag: "rosbags", mcap: "rosbags", long_bag: "rosbags"}
    pytest.importorskip(needs.get(write, "scipy"))
    log, job = write(folder, drive), folder / "job.toml"
    seen = told(capsys, "inspect", log)
    assert "no column looks like" not in seen
    told(capsys, "init", log, "--out", job, *CAR, *more)
    text = job.read_text(encoding="utf-8")
    job.write_text(text.replace("ratio = 15", "ratio = 13.5"), encoding="utf-8")
    return job, text


@pytest.mark.parametrize(
    ("write", "mirrored", "hand_wheel", "also"),
    [
        (motec, True, True, ("a_y",)),
        (motec_mat, False, True, ()),
        (parquet, False, True, ("a_y", "v_y")),
        (levels, False, False, ()),
        (bag, False, False, ("a_y", "v_y")),
        (mcap, False, False, ("a_y", "v_y")),
        (simulink, False, False, ()),
        (dates, False, True, ()),
    ],
    ids=lambda x: getattr(x, "__name__", ""),
)
def test_what_init_guesses_is_what_was_logged(write, mirrored, hand_wheel, also, drive, tmp_path, capsys):
    job, text = written(write, tmp_path, drive, capsys)
    assert ("ratio = 15" in text) == hand_wheel
    data = read_logs(read_settings(job)).raw
    assert {c.name for c in data.channels} >= {"delta", "v_x", "r", *also}
    true = drive.at(data.t - data.t[0])
    for name in ("delta", "v_x", "r", *also):
        sign = -1 if mirrored and name != "v_x" else 1
        size = {"delta": 0.003, "v_x": 0.2, "r": 0.02, "a_y": 0.5, "v_y": 0.05}[name]  # a merge is late by a sample
        assert np.quantile(np.abs(sign * data[name] - getattr(true, name)), 0.995) < size, name


def test_a_sign_that_one_channel_alone_has_is_turned(drive, tmp_path, capsys):
    """Where two of three agree, the third is the one that counts to the right."""
    for odd in ("delta", "r", "a_y"):
        signs = {n: -1 if n == odd else 1 for n in ("delta", "r", "a_y")}
        table = [drive.t, drive.v_x, *(sign * getattr(drive, n) for n, sign in signs.items())]
        path = tmp_path / f"{odd}.csv"
        head = "time [s],speed [m/s],steer [rad],yaw rate [rad/s],lat acc [m/s2]"
        np.savetxt(path, np.column_stack(table)[::2], delimiter=",", header=head, comments="", fmt="%.6f")
        told(capsys, "init", path)
        lines = path.with_suffix(".toml").read_text(encoding="utf-8").splitlines()
        assert [line.split(" =")[0] for line in lines if "sign = -1 }" in line] == [odd]


def test_a_command_is_taken_only_where_nothing_was_measured(tmp_path, drive, capsys):
    path = tmp_path / "cmd.csv"
    table = np.column_stack([drive.t, drive.delta, drive.v_x, drive.r, drive.v_x])[::2]
    head = "time,steering_cmd [rad],gps_velocity_x [m/s],yaw rate [rad/s],speed [m/s]"
    np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.6f")
    seen = told(capsys, "inspect", path)
    assert 'delta = { column = "steering_cmd" }' in seen
    assert "what was asked for, no measurement" in seen
    assert 'v_x = { column = "speed" }' in seen  # the x of a position sensor may point east


def test_inspect_says_what_no_column_looks_like(tmp_path, drive, capsys):
    path = tmp_path / "no_speed.csv"
    table = np.column_stack([drive.t, drive.delta, drive.r])[::2]
    np.savetxt(path, table, delimiter=",", header="time,steer [rad],yaw rate [rad/s]", comments="", fmt="%.6f")
    assert "no column looks like v_x: name it with --channel v_x=HEADING" in told(capsys, "inspect", path)


@pytest.mark.slow
@pytest.mark.parametrize("write", [motec, parquet, long_bag, simulink], ids=lambda x: x.__name__)
def test_three_commands_end_with_a_page_and_the_car(write, drive, tmp_path, capsys):
    job, _ = written(write, tmp_path, drive, capsys, "--kind", "bicycle")
    result = json.loads(told(capsys, "run", job, "--out", tmp_path / "out", "--json"))
    found = result["models"]["bicycle"]["parameters"]
    for name, true in (("C_f", C_F), ("C_r", C_R), ("inertia_z", INERTIA)):
        assert found[name]["value"] == pytest.approx(true, rel=0.1)
    assert (tmp_path / "out" / "index.html").stat().st_size > 1e5


@pytest.mark.slow
def test_the_controller_that_init_writes_drives(drive, tmp_path, capsys):
    job, text = written(motec, tmp_path, drive, capsys, "--kind", "bicycle")
    start = text.index("# [controller]")
    on = "\n".join(line.removeprefix("# ") for line in text[start:].splitlines())
    job.write_text(text[:start].replace("ratio = 15", "ratio = 13.5") + on, encoding="utf-8")
    result = json.loads(told(capsys, "run", job, "--out", tmp_path / "out", "--json"))
    assert result["closed_loop"]["rmse_y"] < 0.1
