"""``slipangle lap``: a page and a table of the fastest lap of a job's car."""

import json

import numpy as np
import pytest

from slipangle.cli import main
from tests.optimal.lap.cars import circuit
from tests.workflow.test_cli import write_job

CAR = """[[model]]
name = "limit"
kind = "saturating-bicycle"
car = { mass = 1500.0, inertia_z = 2500.0, wheelbase = 2.7, l_f = 1.2, C_f = 9e4, C_r = 1.1e5 }
free = ["C_f", "C_r"]
"""


@pytest.fixture
def files(tmp_path):
    track = circuit()
    table = np.column_stack([track.X, track.Y, track.right, track.left])[:-1:20]
    np.savetxt(tmp_path / "track.csv", table, delimiter=",")
    return str(write_job(tmp_path, more=CAR)), str(tmp_path / "track.csv"), tmp_path


def test_the_command_writes_a_page_and_the_lap(files, capsys):
    job, track, folder = files
    out = folder / "out"
    assert main(["lap", job, track, "--set", "power=1.5e5", "--points", "60", "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["sensitivities"]["power"] < 0
    page = (out / "lap.html").read_text()
    for words in ("The line, by speed", "g-g diagram", "What one percent more is worth"):
        assert words in page
    head, *rows = (out / "lap.csv").read_text().splitlines()
    assert len(rows) == 60
    assert float(rows[-1].split(",")[head.split(",").index("t")]) == pytest.approx(said["time"], rel=1e-4)


def test_what_is_missing_is_named(files, capsys):
    job, track, _ = files
    for given, words in (
        (["--set", "powr=1e5"], "'power'"),
        (["--set", "power=much"], "expected a number"),
        (["--model", "lmit"], "'limit'"),
        (["--points", "60"], "power"),
    ):
        assert main(["lap", job, track, *given]) == 2
        assert words in capsys.readouterr().err
