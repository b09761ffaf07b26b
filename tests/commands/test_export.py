"""`slipangle export`: what it writes of a job, what it refuses."""

import json

import numpy as np
import pytest

from slipangle.cli import main
from tests.commands.test_log import folder  # noqa: F401  # a fixture

CONTROLLER = """
[controller]
model = "bicycle"
manoeuvre = "iso3888-1"
v_x = 15.0
horizon = 6
"""


@pytest.mark.slow
def test_controller_of_a_job(folder, capsys):  # noqa: F811
    job = folder / "job.toml"
    out = ["--out", str(folder / "made"), "--name", "racer", "--json"]
    assert main(["export", "c", str(job), *out]) == 2
    assert "has no [controller]; expected one to export" in capsys.readouterr().err
    job.write_text(job.read_text().replace('outputs = ["r"]', 'outputs = ["r"]\nrate = 20.0') + CONTROLLER)
    assert main(["export", "c", str(job), *out]) == 0
    listed = json.loads(capsys.readouterr().out)["files"]
    assert {"racer.c", "racer.h", "racer.hpp", "main.c", "drive.csv", "manifest.json"} < set(listed)
    drive = np.loadtxt(folder / "made" / "drive.csv", delimiter=",", skiprows=1)
    assert np.abs(drive[:, -1]).max() > 0.01  # the job's manoeuvre
    assert main(["export", "c", str(job), *out]) == 2
    assert "is not empty" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["if", "../racer", "Racer"])
def test_names_are_checked_first(name, capsys):
    assert main(["export", "c", "no.toml", "--name", name]) == 2
    assert "expected" in capsys.readouterr().err
