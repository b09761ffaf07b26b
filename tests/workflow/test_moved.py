"""What was made on one machine runs on another: jobs, logs and models in a folder that moves."""

import json
import shutil

import pytest

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
