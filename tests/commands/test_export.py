"""`slipangle export`: what it writes of a job, what it refuses."""

import json
import zipfile

import numpy as np
import pytest

from slipangle.cli import main
from slipangle.codegen import compiler
from slipangle.export import load
from slipangle.models.storage import save
from tests.commands.test_log import folder  # noqa: F401  # a fixture
from tests.export.tools import needs, run
from tests.models.all_models import ALL_MODELS
from tests.workflow.test_race import LAP
from tests.workflow.test_race import job as race_job

CONTROLLER = """
[controller]
model = "bicycle"
manoeuvre = "iso3888-1"
v_x = 15.0
horizon = 6
"""


@pytest.mark.slow
@pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
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


@pytest.mark.slow
def test_racer_of_a_job(tmp_path, capsys):
    """Its program repeats a lap on the job's plant."""
    needs("gcc", "make")
    made, more = tmp_path / "made", LAP.replace("1.5e5", "1.2e5, mu_f = 1.1, mu_r = 1.15, C_f = 1.2e5, C_r = 1.6e5")
    assert main(["export", "c", race_job(tmp_path, f"{more}[race]\n"), "--out", str(made), "--json"]) == 0
    assert {"racer.c", "racer_planner.c"} < set(json.loads(capsys.readouterr().out)["files"])
    drive = np.loadtxt(made / "drive.csv", delimiter=",", skiprows=1)
    assert len(drive) > 2000
    said = run("make", "-s", "replay", "CC=gcc", folder=made)
    assert f"{len(drive)} calls in" in said
    no_track = race_job(tmp_path, "[race]\n")
    assert main(["export", "c", no_track, "--out", str(tmp_path / "none")]) == 2
    assert "names no track; expected one: add [lap] with track" in capsys.readouterr().err


@pytest.mark.slow
def test_driver_of_a_job(folder, capsys):  # noqa: F811
    """Its program repeats the drive of the job's plant, which knows nothing of the driver's model."""
    needs("gcc", "make")
    job = folder / "job.toml"
    text = job.read_text().replace('outputs = ["r"]', 'outputs = ["r"]\nrate = 20.0')
    job.write_text(text + CONTROLLER.replace("horizon = 6", 'kind = "driver"'))
    made = folder / "made"
    assert main(["export", "c", str(job), "--out", str(made), "--name", "racer", "--json"]) == 0
    assert {"racer.c", "racer_planner.c"} < set(json.loads(capsys.readouterr().out)["files"])
    drive = np.loadtxt(made / "drive.csv", delimiter=",", skiprows=1)
    assert len(drive) > 500
    said = run("make", "-s", "replay", "CC=gcc", folder=made)
    assert f"{len(drive)} calls in" in said
    built = folder / "built"
    assert main(["build", str(job), "--out", str(built), "--json"]) == 0
    assert "path.csv" in json.loads(capsys.readouterr().out)["files"]
    loaded = load(built)
    names, n = loaded._names["channels"], len(loaded.controls)
    wanted = [
        list(loaded.step(dict(zip(names, row[1:-n], strict=True)), row[0]).values.values()) for row in drive[:200]
    ]
    assert np.array(wanted) == pytest.approx(drive[:200, -n:], rel=1e-9, abs=1e-9)
    assert main(["export", "fmu", str(job), "--out", str(folder / "driver.fmu"), "--source-only"]) == 0
    with zipfile.ZipFile(folder / "driver.fmu") as archive:
        assert {"sources/driver_fmu.c", "sources/driver.c", "sources/driver_planner.c"} < set(archive.namelist())


@pytest.mark.parametrize("name", ["if", "../racer", "Racer"])
def test_names_are_checked_first(name, capsys):
    assert main(["export", "c", "no.toml", "--name", name]) == 2
    assert "expected" in capsys.readouterr().err


def test_an_fmu_is_called_one_before_anything_is_identified(capsys):
    assert main(["export", "fmu", "no.toml", "--out", "m2"]) == 2
    assert "'m2' does not end in .fmu; expected that" in capsys.readouterr().err


def test_a_model_s_file(tmp_path, capsys):
    save(ALL_MODELS["bicycle"], tmp_path / "car.json")
    given = [str(tmp_path / "car.json"), "--json"]
    assert main(["export", "c", *given, "--out", str(tmp_path / "made"), "--name", "racer"]) == 0
    assert "racer.c" in json.loads(capsys.readouterr().out)["files"]
    fmu = ["export", "fmu", *given, "--out", str(tmp_path / "car.fmu"), "--source-only"]
    assert main(fmu) == 0
    with zipfile.ZipFile(tmp_path / "car.fmu") as archive:
        assert "sources/model.c" in archive.namelist()
    assert main([*fmu, "--fmi", "3", "--force"]) == 0
    with zipfile.ZipFile(tmp_path / "car.fmu") as archive:
        assert b'fmiVersion="3.0"' in archive.read("modelDescription.xml")
    capsys.readouterr()
    assert main(fmu) == 2
    assert "is there already" in capsys.readouterr().err
    assert main(["build", str(tmp_path / "car.json"), "--out", str(tmp_path / "built")]) == 2
    assert "holds a model; expected a job with a [controller]" in capsys.readouterr().err
    assert not (tmp_path / "built").exists()
