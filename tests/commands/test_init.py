"""From a log as a logger leaves it to a fitted model, with nothing but `inspect`, `init` and the lines they write."""

import json
import re
import tomllib

import numpy as np
import pytest
from scipy.io import savemat

from slipangle.cli import main
from slipangle.data.dataset import Dataset
from slipangle.data.quality.survey import survey
from slipangle.data.readers import open_log
from slipangle.models.storage import load
from slipangle.models.vehicles.bicycle import Bicycle, BicycleParams
from slipangle.workflow.log import read_logs
from slipangle.workflow.settings import read_settings
from tests.data.readers.logs import Made, motec_csv, race_capture, write_mat73

TRUE = BicycleParams(mass=1340, wheelbase=2.57, l_f=1.21, inertia_z=1900, C_f=7e4, C_r=9e4)
CAR = ("--kind", "bicycle", "--mass", "1340", "--wheelbase", "2.57", "--l-f", "1.21")


def drive(n=6000, dt=0.01):
    """A minute of a car that weaves, with the noise of a gyroscope. [s, rad, m/s, rad/s]"""
    rng = np.random.default_rng(11)
    t = dt * np.arange(n)
    delta = 0.03 * np.sin(0.9 * t) + 0.02 * np.sin(2.9 * t + 1) + 0.01 * np.sin(7 * t)
    v_x = 19 + 5 * np.sin(0.15 * t)
    data = Dataset.from_arrays({"delta": delta, "v_x": v_x}, {"r": np.zeros(n)}, dt)
    r = Bicycle(params=TRUE, dt=dt, outputs=("r",)).simulate(data).y[:, 0]
    return Made(t, delta, v_x, r + 0.002 * rng.normal(size=n))


MADE = drive()


def motec(folder):
    """A hand wheel of 14 to 1, positive to the right, every cell in quotes under fourteen lines about the session."""
    path = folder / "run 7.csv"
    path.write_text(motec_csv(MADE._replace(delta=-14 * MADE.delta)))
    return path


def capture(folder):
    path = folder / "capture.csv"
    path.write_text(race_capture(MADE))
    return path


def ros(folder):
    """Messages of three topics in one table: nanoseconds, radians and m/s without a word, most cells empty."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    late = {"imu": 0, "steering": 3, "speed": 7}  # ms after the full hundredth
    every = {"imu": 1, "steering": 2, "speed": 5}
    rows = []
    for topic, x in (("imu", MADE.r), ("steering", MADE.delta), ("speed", MADE.v_x)):
        at = MADE.t[:: every[topic]] + 0.001 * late[topic]
        rows += [(t, topic, v) for t, v in zip(at, np.interp(at, MADE.t, x), strict=True)]
    rows.sort()
    table = {"timestamp": pa.array([1_777_644_000_000_000_000 + round(1e9 * t) for t, _, _ in rows])}
    for topic, name in (("imu", "imu.angular_velocity.z"), ("steering", "steering_angle"), ("speed", "vehicle_speed")):
        table[name] = pa.array([v if own == topic else None for _, own, v in rows])
    pq.write_table(pa.table(table), folder / "drive.parquet")
    return folder / "drive.parquet"


def variables():
    log = {"time": MADE.t, "SWA": np.degrees(14 * MADE.delta), "yaw_rate": np.degrees(MADE.r), "ax": 0 * MADE.t}
    return {"log": log, "gps": {"time": MADE.t[::10], "speed": 3.6 * MADE.v_x[::10]}, "driver": "A. Driver"}


def matlab5(folder):
    savemat(folder / "log.mat", variables())
    return folder / "log.mat"


def matlab73(folder):
    return write_mat73(folder / "log.mat", variables())


def said(capsys, *arguments, code=0):
    assert main([str(a) for a in arguments]) == code
    out = capsys.readouterr()
    return out.out if code < 2 else out.err


@pytest.mark.parametrize(
    ("write", "kept", "edits"),
    [
        (motec, ["sign = -1", "ratio = 15", "hand wheel"], {"ratio = 15": "ratio = 14"}),
        (capture, ['column = "Steering"', 'column = "Speed"', 'column = "Yaw"'], {}),
        (ros, ['nan = "merge"', 'unit = "ns"', 'unit = "m/s"', 'unit = "rad/s"'], {}),
        (matlab5, ['unit = "deg/s"', 'unit = "km/h"', "hand wheel"], {"ratio = 15": "ratio = 14"}),
        (matlab73, ['unit = "deg/s"', 'unit = "km/h"', "hand wheel"], {"ratio = 15": "ratio = 14"}),
    ],
    ids=lambda x: getattr(x, "__name__", ""),
)
def test_a_new_user_has_a_car_from_the_log_as_it_is(write, kept, edits, tmp_path, capsys):
    log, job = write(tmp_path), tmp_path / "job.toml"
    assert "100 Hz" in said(capsys, "inspect", log)
    assert "marked GUESS" in said(capsys, "init", log, "--out", job, *CAR)
    text = job.read_text()
    for words in kept:
        assert words in text
    for old, new in edits.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    job.write_text(text)
    told = said(capsys, "identify", job, "--out", tmp_path / "models")
    assert re.search(r"C_f +[\d ]{6} N/rad \(95 %: [\d ]{6} to [\d ]{6}\)", told)
    assert re.search(r"free run on the test part: r fit 9\d", told)
    found = load(tmp_path / "models" / "bicycle.json").params
    for name in ("C_f", "C_r", "inertia_z"):
        assert getattr(found, name) == pytest.approx(getattr(TRUE, name), rel=0.06)
    again = json.loads(said(capsys, "identify", job, "--out", tmp_path / "models", "--json"))
    assert again["bicycle"]["replaced"]
    assert again["bicycle"]["parameters"]["C_f"]["value"] == pytest.approx(found.C_f)
    low, high = again["bicycle"]["parameters"]["C_f"]["interval"]
    assert low < found.C_f < high
    assert said(capsys, "identify", job, "--out", tmp_path / "models", "--quiet") == ""


@pytest.mark.parametrize("write", [motec, ros, matlab5], ids=lambda x: x.__name__)
def test_a_written_job_reads_what_was_logged(write, tmp_path, capsys):
    log, job = write(tmp_path), tmp_path / "job.toml"
    said(capsys, "init", log, "--out", job)
    data = read_logs(read_settings(job)).raw
    assert data.inputs == ("delta", "v_x")
    np.testing.assert_allclose(data["v_x"], np.interp(data.t - data.t[0], MADE.t, MADE.v_x), atol=0.1)
    table = tomllib.loads(job.read_text())
    assert table["model"][0]["kind"] == "car"
    guessed = sum("# GUESS" in line for line in job.read_text().splitlines())
    assert guessed == json.loads(said(capsys, "init", log, "--out", job, "--force", "--json"))["guesses"]


def test_what_cannot_be_written_is_refused_in_a_sentence(tmp_path, capsys):
    log = capture(tmp_path)
    (tmp_path / "odd.csv").write_text("t,a,b\n" + "\n".join(f"{0.1 * k:.1f},{k},{k * k}" for k in range(30)))
    (tmp_path / "taken.toml").write_text("")
    cases = {
        ("init", log, "--out", tmp_path / "taken.toml"): "is there already; expected a new file",
        ("init", tmp_path / "odd.csv"): "no column that looks like delta or v_x or r (columns: 'a', 'b')",
        ("init", tmp_path / "none.csv"): "does not exist",
        ("init", log, "--channel", "delta"): "expected NAME=HEADING",
        ("init", log, "--interactive"): "there is none; expected one",
    }
    for arguments, sentence in cases.items():
        assert sentence in said(capsys, *arguments, code=2)


def test_channels_that_are_said_are_taken(tmp_path, capsys):
    path = tmp_path / "odd.csv"
    rows = zip(MADE.t, MADE.delta, MADE.v_x, MADE.r, strict=True)
    path.write_text("t,a,b,c\n" + "\n".join(",".join(f"{x:.5f}" for x in row) for row in rows))
    said(capsys, "init", path, "--channel", "delta=a", "--channel", "v_x=b:m/s", "--channel", "r=c")
    assert np.ptp(read_logs(read_settings(path.with_suffix(".toml"))).raw["r"]) == pytest.approx(
        np.ptp(MADE.r), rel=1e-3
    )


def test_a_survey_says_what_stands_out(tmp_path):
    t = 0.01 * np.arange(1000)
    t[600:] += 1.5
    rows = [f"{1e3 * x:.0f},{np.sin(x):.6f},7,{20 if k % 4 else 21},{np.sin(x // 0.5):.4f}" for k, x in enumerate(t)]
    path = tmp_path / "x.csv"
    path.write_text("stamp,yaw rate,lap [lap],speed,held\n" + "\n".join(rows))
    seen = survey(open_log(path))
    one = {c.name: c for c in seen.channels}
    assert (one["yaw rate"].gaps, one["yaw rate"].rate) == (1, pytest.approx(100))
    assert one["yaw rate"].longest == pytest.approx(1.51)
    assert one["lap"].remarks == ("constant", "the unit 'lap' is not known")
    assert "repeat the one before" in one["held"].remarks[0]
    assert seen.settings[0][0] == 'time = { column = "stamp", unit = "ms" }'
    assert [g.channel for g in seen.guesses] == ["v_x", "r"]


@pytest.mark.parametrize(
    "heading",
    [
        "t,StWhl,VehV,YawRate",
        "Zeit,Lenkwinkel,v_veh,Gierrate",
        "time,StrWhlAng,VehSpd,wz",
        "t,SteerWheelAngle,WheelBasedVehicleSpeed,YawRate",
    ],
)
def test_channels_are_known_by_the_names_of_control_units(heading, tmp_path):
    path = tmp_path / "x.csv"
    path.write_text(
        heading + "\n" + "\n".join(f"{0.01 * k:.2f},{np.sin(k / 9):.4f},2{k % 3},0.{k % 7}" for k in range(99))
    )
    names = heading.split(",")[1:]
    assert {g.channel: g.column.source for g in survey(open_log(path)).guesses} == dict(
        zip(("delta", "v_x", "r"), names, strict=True)
    )


@pytest.mark.parametrize(
    ("front", "rear", "unit"),
    [("delta", "delta_r", "rad"), ("delta_rad", "RearSteerAngle", "deg"), ("Lenkwinkel", "Hinterachslenkung", "deg")],
)
def test_rear_wheels_are_not_taken_for_front_ones(front, rear, unit, tmp_path, capsys):
    """Whichever comes first; they, and a yaw moment, become inputs of a car."""
    lines = [f"t,{rear},{front},v_x,r,Yaw Moment"]
    scale = np.degrees(1) if unit == "deg" else 1
    rows = zip(MADE.t, 0.3 * scale * MADE.delta, MADE.delta, MADE.v_x, MADE.r, 900 * MADE.r, strict=True)
    lines += [",".join(f"{v:.6g}" for v in row) for row in rows]
    path = tmp_path / "rear.csv"
    path.write_text("\n".join(lines))
    found = {g.channel: g.column for g in survey(open_log(path)).guesses}
    assert (found["delta"].source, found["delta_r"].source, found["M_z"].source) == (front, rear, "Yaw Moment")
    assert (found["delta_r"].unit, found["M_z"].unit) == (unit, "N m")
    assert main(["init", str(path), "--out", str(tmp_path / "job.toml"), "--mass", "1340", "--wheelbase", "2.57"]) == 0
    assert tomllib.loads((tmp_path / "job.toml").read_text())["data"]["inputs"] == ["delta", "v_x", "delta_r", "M_z"]


def test_a_clock_that_shakes_is_written_into_the_job(tmp_path, capsys):
    """Steps that vary by a third are refused unless asked for; the job that is written asks."""
    t = MADE.t + 0.0012 * np.random.default_rng(3).uniform(-1, 1, len(MADE.t))
    path = tmp_path / "shaky.csv"
    np.savetxt(path, np.column_stack([t, *MADE[1:4]]), delimiter=",", header="t,delta,v_x,r", comments="", fmt="%.6f")
    assert "jitter = 0.3" in said(capsys, "inspect", path)
    said(capsys, "init", path, *CAR)
    assert "jitter = 0.3  # GUESS" in path.with_suffix(".toml").read_text()
    assert read_logs(read_settings(path.with_suffix(".toml"))).raw.n_samples == pytest.approx(6000, abs=2)
    text = path.with_suffix(".toml").read_text()
    path.with_suffix(".toml").write_text(text.replace("jitter = 0.3", "jitter = 0.1"))
    assert "allow more with jitter" in said(capsys, "run", path.with_suffix(".toml"), code=2)


def test_an_accelerometer_is_fitted_where_v_y_is_not_measured(tmp_path, capsys):
    path = tmp_path / "x.csv"
    table = np.column_stack([MADE.t, *MADE[1:4], MADE.v_x * MADE.r])
    np.savetxt(path, table, delimiter=",", header="t,delta,v_x,r,a_y", comments="", fmt="%.6f")
    said(capsys, "init", path, *CAR[2:])
    assert tomllib.loads(path.with_suffix(".toml").read_text())["data"]["outputs"] == ["r", "a_y"]


def test_a_speed_that_only_the_wheels_tell_is_asked_for_as_their_mean(tmp_path, capsys):
    path = tmp_path / "x.csv"
    head = "t,steer,yaw rate,WheelSpeedFL [km/h],WheelSpeedFR [km/h],WheelSpeedRL [km/h],WheelSpeedRR [km/h]"
    table = np.column_stack([MADE.t, MADE.delta, MADE.r, *[3.6 * MADE.v_x] * 4])
    np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.6f")
    wanted = "v_x = { derive = \"('WheelSpeedRL' + 'WheelSpeedRR') / 2\" }"
    assert wanted in said(capsys, "inspect", path)
    assert wanted in said(capsys, "init", path, code=2)


@pytest.mark.parametrize(("name", "unit"), [("SteerWheelAngle", "rad"), ("steer", "deg")])
def test_a_hand_wheel_that_turns_by_two_is_logged_in_radians(name, unit, tmp_path):
    path = tmp_path / "x.csv"
    table = np.column_stack([MADE.t, 40 * MADE.delta, MADE.v_x, MADE.r])
    np.savetxt(path, table, delimiter=",", header=f"t,{name},v_x,r", comments="", fmt="%.6f")
    guess = next(g for g in survey(open_log(path)).guesses if g.channel == "delta")
    assert guess.column.unit == unit


@pytest.mark.parametrize(
    ("head", "units"),
    [
        (("steer_deg", "speed_kmh", "yaw_rate_dps", "lat_acc_g"), ("deg", "km/h", "deg/s", "g")),
        (("delta_rad", "v_mps", "r_rad_s", "ay_mps2"), ("rad", "m/s", "rad/s", "m/s2")),
        (("swaDeg", "vxMph", "Yaw Rate deg/s", "acc_lat_m_s2"), ("deg", "mph", "deg/s", "m/s2")),
    ],
)
@pytest.mark.parametrize("size", [0.2, 5.0])
def test_a_unit_in_a_name_outranks_the_size(head, units, size, tmp_path):
    """A calm drive in km/h and degrees has the numbers of a quick one in m/s and radians."""
    path = tmp_path / "x.csv"
    table = np.column_stack([MADE.t, size * MADE.delta, size * 12 + 0 * MADE.v_x, size * MADE.r, size * MADE.r])
    table[:, 2] += 0.1 * size * np.sin(MADE.t)
    np.savetxt(path, table, delimiter=",", header=",".join(("time_s", *head)), comments="", fmt="%.6f")
    found = survey(open_log(path))
    guesses = {g.channel: g for g in found.guesses}
    assert {n: (g.column.source, g.column.unit) for n, g in guesses.items()} == dict(
        zip(("delta", "v_x", "r", "a_y"), zip(head, units, strict=True), strict=True)
    )
    assert found.time is not None
    assert found.time.unit == "s"
    contradicted = ", though a size of 60.5 looks like km/h: check it" in str(guesses["v_x"].why)
    assert contradicted == (size > 1 and units[1] != "km/h")
    assert ("though" in str(guesses["r"].why)) == (size > 1 and units[2] == "rad/s" and np.abs(5 * MADE.r).max() > 3)
    assert f"its name says {units[1]}" in str(guesses["v_x"].why)


# ---- the rest of the command line --------------------------------------------------------------------------------


def test_a_bare_command_helps(capsys):
    assert "slipangle init log.csv" in said(capsys)


def test_the_version_is_said(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert re.fullmatch(r"slipangle \d+\.\d+\.\d+\n", capsys.readouterr().out)


def test_the_doctor_names_what_is_missing(capsys, monkeypatch):
    from slipangle.commands import doctor

    found = json.loads(said(capsys, "doctor", "--json"))
    assert found["wrong"] == []
    assert found["packages"].keys() == {"numpy", "scipy", "casadi", "daqp", "plotly", "rich"}
    have = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: "" if name in ("pyarrow", "daqp") else have(name))
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    text = said(capsys, "doctor", code=1)
    assert "for pyarrow: pip install 'slipangle[io]'" in text
    assert "wrong: daqp is not installed: pip install daqp" in text
    assert "no C compiler was found" in text


def test_questions_are_asked_and_enter_keeps_the_guess():
    from slipangle.commands import init

    answers = {"delta": "a:deg", "v_x": "", "r": "", "mass": "900", "wheelbase": "", "l_f": ""}
    asked = []

    def ask(question):
        asked.append(question)
        return answers[question.split(":")[0].split(" [")[0]]

    guesses = {n: init.said_channel(f"{n}=x{n}") for n in ("v_x", "r")}
    car = {"mass": (1500.0, False), "wheelbase": (2.7, False), "l_f": (1.3, False)}
    init._ask(guesses, car, ask)
    assert len(asked) == 6
    assert guesses["delta"].line == 'delta = { column = "a", unit = "deg" }'
    assert guesses["r"].line == 'r = { column = "xr" }'
    assert car == {"mass": (900.0, True), "wheelbase": (2.7, False), "l_f": (1.3, False)}
