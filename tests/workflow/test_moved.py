"""What was made on one machine runs on another: jobs, logs and models in a folder that moves."""

import json
import os
import platform
import shutil
import subprocess
import sys

import pytest

import slipangle as sa
from slipangle.cli import main
from tests.workflow.test_cli import JOB, log_rows, write_job


def identified(job, out, capsys):
    assert main(["identify", str(job), "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    return {name: entry.get("parameters") for name, entry in found.items()}


@pytest.mark.parametrize("named", ['"logs/day.csv"', r"'logs\day.csv'", r"'logs\d*.csv'"])
def test_a_folder_that_moves(named, tmp_path, capsys, monkeypatch):
    """A job names its log and a saved model below its own folder, with slashes of either kind."""
    here = tmp_path / "here"
    (here / "logs").mkdir(parents=True)
    text = JOB.replace('"log.csv"', named)
    job = write_job(here, job=text)
    (here / "log.csv").rename(here / "logs" / "day.csv")
    first = identified(job, here / "models", capsys)
    job.write_text(text.format(more="[[model]]\nname = 'old'\nkind = 'saved'\nfile = 'models/bicycle.json'"))
    there = tmp_path / "another disk" / "there"
    shutil.copytree(here, there)
    shutil.rmtree(here)
    monkeypatch.chdir(tmp_path)
    again = identified(there / "job.toml", tmp_path / "out", capsys)
    assert again["bicycle"] == first["bicycle"] == again["old"]


def test_init_names_the_log_from_the_job_on(tmp_path, capsys):
    (tmp_path / "a" / "logs").mkdir(parents=True)
    (tmp_path / "a" / "jobs").mkdir()
    log, out = tmp_path / "a" / "logs" / "day.csv", tmp_path / "a" / "jobs" / "new.toml"
    head = "time [s],steering angle [deg],speed [km/h],yaw rate [deg/s]"
    log.write_text("\n".join([head, *map(",".join, log_rows())]) + "\n")
    assert main(["init", str(log), "--kind", "bicycle", "--out", str(out)]) == 0
    assert 'file = "../logs/day.csv"' in out.read_text()
    (tmp_path / "a").rename(tmp_path / "b")
    capsys.readouterr()
    assert identified(tmp_path / "b" / "jobs" / "new.toml", tmp_path / "out", capsys)["bicycle"]


def test_runs_again_say_what_they_replace(tmp_path, capsys):
    job = write_job(tmp_path)
    for command, made in (("identify", "bicycle.json"), ("run", "index.html")):
        for again in (False, True):
            assert main([command, str(job), "--out", str(tmp_path / "out")]) == 0
            line = next(line for line in capsys.readouterr().out.splitlines() if made in line)
            assert (", which replaces the one of 20" in line) is again


COLUMNS = {"delta": ("steer", "deg"), "v_x": ("speed", "km/h"), "r": ("yaw", "deg/s")}


def elsewhere(folder, *arguments):
    """A command on another machine: kernels of a small processor, no compiler, ASCII, another time zone and folder."""
    small = {"OPENBLAS_CORETYPE": "Nehalem"} if platform.machine() in ("x86_64", "AMD64") else {}
    env = {**os.environ, **small, "SLIPANGLE_CC": "none", "LC_ALL": "C", "PYTHONUTF8": "0"}
    env |= {"PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "", "TZ": "Asia/Kathmandu", "HOME": str(folder)}
    call = [sys.executable, "-m", "slipangle.cli", *map(str, arguments)]
    done = subprocess.run(call, cwd=folder, env=env, capture_output=True, timeout=120, check=False)
    assert not done.stderr, done.stderr.decode("ascii", "replace")[-2000:]
    assert done.returncode == 0
    return done.stdout.decode("ascii")


def windows(path):
    """The file as a text editor of Windows saves it: a mark of UTF-8 at its start, CR and LF."""
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))


@pytest.mark.slow
def test_another_machine_does_the_same(tmp_path, capsys):
    """A model saved, a job written and a log converted here: what they say there is what they say here."""
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    job = write_job(here, job='subtitle = "Nürburgring, trocken: 20 °C"\n' + JOB)
    first = identified(job, here / "models", capsys)["bicycle"]
    data = sa.read(here / "log.csv", {n: sa.Column(*c) for n, c in COLUMNS.items()})
    sa.write(data.select(inputs=["delta", "v_x"], outputs=["r"]), here / "log.mat")
    assert main(["validate", str(here / "models" / "bicycle.json"), "--data", str(job), "--json"]) == 0
    judged = json.loads(capsys.readouterr().out)["free_run"]["r"]
    shutil.copytree(here, there)
    windows(there / "job.toml")
    windows(there / "log.csv")
    again = json.loads(elsewhere(there, "identify", "job.toml", "--out", "new", "--json"))["bicycle"]["parameters"]
    for name, found in first.items():
        assert again[name]["value"] == pytest.approx(found["value"], rel=1e-4)
    said = json.loads(elsewhere(there, "validate", "models/bicycle.json", "--data", "job.toml", "--json"))
    assert said["free_run"]["r"] == pytest.approx(judged, rel=1e-6)
    converted = json.loads(elsewhere(there, "inspect", "log.mat", "--json"))
    assert (converted["samples"], converted["dt"]) == (data.n_samples, pytest.approx(data.dt))
