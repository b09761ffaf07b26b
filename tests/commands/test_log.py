"""`slipangle inspect` and `slipangle advise`: what they print, in words and in JSON, and what they refuse."""

import json

import numpy as np
import pytest

from slipangle.cli import main
from slipangle.data.dataset import Dataset
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2 as PARAMS

JOB = """
title = "a weave"
[data]
file = "log.csv"
inputs = ["delta", "v_x"]
outputs = ["r"]
[data.columns]
delta = {{ column = "steer", unit = "deg" }}
v_x = {{ column = "speed", unit = "km/h" }}
r = {{ column = "yaw", unit = "deg/s" }}
[[model]]
name = "{kind}"
kind = "{kind}"
{more}
"""
CAR = (
    f"car = {{ mass = {PARAMS.mass}, wheelbase = {PARAMS.wheelbase}, l_f = {PARAMS.l_f}, inertia_z = 1500, "
    "C_f = 8e4, C_r = 9e4 }"
)
CHANNELS = ("--channel", "delta=steer:deg", "--channel", "v_x=speed:km/h", "--channel", "r=yaw:deg/s")


@pytest.fixture
def folder(tmp_path):
    """A job and its log: a car that weaves at speeds from 8 to 22 m/s, in the units of a logger."""
    t = 0.05 * np.arange(1600)
    rng = np.random.default_rng(4)
    delta = 0.02 * np.sin(0.9 * t) + 0.012 * np.sin(2.7 * t + 1) + 0.01 * np.sin(7 * t)
    v_x = 15 + 7 * np.sin(0.1 * t)
    drive = Dataset.from_arrays({"delta": delta, "v_x": v_x}, {"r": np.zeros(len(t))}, 0.05)
    r = Bicycle(params=PARAMS, dt=0.05, outputs=("r",)).simulate(drive).y[:, 0] + 0.002 * rng.normal(size=len(t))
    rows = np.column_stack([t, np.degrees(delta), 3.6 * v_x, np.degrees(r)])
    head = "time,steer,speed,yaw"
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=head, comments="", fmt="%.6f")
    (tmp_path / "job.toml").write_text(JOB.format(kind="bicycle", more=CAR))
    return tmp_path


def said(capsys, *arguments, code=0):
    assert main([str(a) for a in arguments]) == code
    out = capsys.readouterr()
    return out.out if code < 2 else out.err


def test_inspect_says_the_same_of_a_log_and_of_its_job(folder, capsys):
    of_job = said(capsys, "inspect", folder / "job.toml")
    of_log = said(capsys, "inspect", folder / "log.csv", *CHANNELS, "--wheelbase", PARAMS.wheelbase)
    assert of_job == of_log
    assert of_job.startswith("1600 samples at 20 Hz, 80 s, no gaps")
    assert "r follows delta by" in of_job
    assert "contradiction" not in of_job
    without = said(capsys, "inspect", folder / "log.csv", *CHANNELS)
    assert without == of_log.rstrip("\n") + "\nsigns and units of the channels are checked with --wheelbase\n"


def test_inspect_gives_numbers_to_machines(folder, capsys):
    found = json.loads(said(capsys, "inspect", folder / "job.toml", "--json"))
    assert (found["samples"], found["dt"], found["doubts"]) == (1600, 0.05, [])
    (delay,) = found["delays"]
    assert delay["clear"]
    assert 0.0 < delay["seconds"] < 0.3
    assert delay["sentence"] in found["sentences"]


def test_inspect_names_channels_that_contradict_each_other(folder, capsys):
    wrong = ("--channel", "delta=steer:rad", *CHANNELS[2:], "--wheelbase", PARAMS.wheelbase)
    text = said(capsys, "inspect", folder / "log.csv", *wrong, code=1)
    assert text.startswith("contradiction: r wheelbase / v_x is about")
    assert "delta is logged in degrees" in text.splitlines()[0]


def test_degrees_called_radians_are_not_explained_by_the_ratio_that_was_guessed(folder, capsys):
    rows = np.loadtxt(folder / "log.csv", delimiter=",", skiprows=1)
    rows[:, 2:] *= [1 / 3.6, np.pi / 180]
    head = "time,delta [rad],v_x [m/s],r [rad/s]"
    np.savetxt(folder / "other.csv", rows, delimiter=",", header=head, comments="", fmt="%.6f")
    words = said(capsys, "inspect", folder / "other.csv", "--wheelbase", PARAMS.wheelbase, code=1)
    assert "ratio = 15" in words
    assert "of delta: delta is logged in degrees: declare its unit as deg" in words


def test_advise_takes_a_job_or_a_saved_model(folder, capsys):
    text = said(capsys, "advise", folder / "job.toml", "--best", "3")
    assert len(text.splitlines()) == 3
    assert text.startswith("drive ")
    said(capsys, "identify", folder / "job.toml", "--out", folder / "models")
    saved = folder / "models" / "bicycle.json"
    again = json.loads(said(capsys, "advise", saved, "--data", folder / "job.toml", "--best", "3", "--json"))
    assert [row["sentence"] for row in again] == [
        line.removesuffix(", which helps little") for line in text.splitlines()
    ]
    of_inertia = said(capsys, "advise", folder / "job.toml", "--parameter", "inertia_z", "--duration", "10")
    assert all("deviation of inertia_z" in line and "for 10 s" in line for line in of_inertia.splitlines())


def test_advise_takes_a_whole_car_and_asks_for_what_it_is_made_of(folder, capsys):
    """As the first pages show it; where a sensor sits, or how late it is, may well be nothing and is not asked for."""
    more = f"mass = {PARAMS.mass}\nwheelbase = {PARAMS.wheelbase}\nl_f = {PARAMS.l_f}"
    (folder / "car.toml").write_text(JOB.format(kind="car", more=more))
    lines = (folder / "log.csv").read_text().splitlines(keepends=True)
    (folder / "log.csv").write_text("".join(lines[:601]))
    text = said(capsys, "advise", folder / "car.toml", "--best", "2")
    assert text.startswith("drive ")
    assert any(f"deviation of {name} " in text for name in ("C_f", "C_r", "inertia_z", "mu_f", "mu_r"))


def test_what_cannot_be_done_is_refused_in_a_sentence(folder, capsys):
    log = folder / "log.csv"
    cases = {
        ("inspect", log, "--channel", "delta"): "expected NAME=HEADING or NAME=HEADING:UNIT",
        ("inspect", log, *CHANNELS, "--wheelbase", "-2"): "--wheelbase is -2 m; expected a number between 0 and 30",
        ("inspect", log, *CHANNELS[:4], "--wheelbase", "2.6"): "the log has no r; expected all three",
        ("inspect", folder / "job.toml", *CHANNELS): "a job names its columns itself",
        ("inspect", folder / "none.csv"): "does not exist",
        ("advise", folder / "bicycle.json"): "expected --data FILE.toml",
        ("advise", folder / "job.toml", "--parameter", "mass"): "'mass' was not fitted",
        ("advise", folder / "job.toml", "--duration", "nan"): "duration is nan s; expected",
        ("advise", folder / "job.toml", "--duration", "1"): "duration is 1 s; expected 2 s or more, 40 samples",
        ("advise", folder / "job.toml", "--best", "0"): "--best is 0; expected",
    }
    for arguments, sentence in cases.items():
        assert sentence in said(capsys, *arguments, code=2)
    (folder / "arx.toml").write_text(JOB.format(kind="arx", more="na = 2\nnb = 2"))
    assert "has physical parameters" in said(capsys, "advise", folder / "arx.toml", code=2)
