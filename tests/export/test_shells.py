"""S-function and ROS 2 node, against stand-ins of their headers, decide what was recorded."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from slipangle.codegen import compiler
from slipangle.export.kinds import project_of
from slipangle.export.precision import as_precision
from tests.control.marx.test_mpc import BY_POSE
from tests.export import test_drivers, test_estimators, test_racers
from tests.export.test_mpc import STANLEY, controller
from tests.export.tools import STRICT, needs, run
from tests.models.all_models import ALL_MODELS

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
THINGS = {  # what it is, how many columns of its drive come before its inputs
    "MPC": (lambda: controller(6), lambda n: 0),
    "MARX": (lambda: BY_POSE, lambda n: 0),
    "Stanley": (lambda: STANLEY, lambda n: 0),
    "model": (lambda: ALL_MODELS["bicycle"], lambda n: n["STATES"]),
    "model without inputs that are told": (lambda: ALL_MODELS["NARX"], lambda n: n["STATES"]),
    "estimator": (lambda: test_estimators.VARIANTS["parameters"], lambda n: 0),
    "driver": (test_drivers.VARIANTS["plain"], lambda n: 1),
    "racer": (lambda: test_racers.racer(horizon=6), lambda n: 1),
}
LOOPS = ("driver", "racer")
PRECISIONS = {"double": 1e-9, "single": 1e-3}


@needs_compiler
@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in LOOPS)) for n in THINGS])
@pytest.mark.parametrize("precision", ["double", pytest.param("single", marks=pytest.mark.slow)])
def test_a_drive_through_both(name, precision, tmp_path, monkeypatch):
    """Two blocks side by side, and a node with messages of a wrong size between and silence at the end."""
    needs("gcc", "g++")
    made, header, skip = shells(name, precision, tmp_path, monkeypatch)
    rows = np.loadtxt(tmp_path / "drive.csv", delimiter=",", skiprows=1)
    said = [_numbers(run(f"./{n}", folder=tmp_path, stdin=tmp_path / "drive.csv")) for n in ("sfun", "node")]
    assert len(said[0]) == len(rows) == 60
    assert len(said[1]) == 65
    n_inputs = {"model": header.get("INPUTS", 0)}.get(made.kind, 0) or rows.shape[1] - skip - _commands(
        made.kind, header
    )
    wanted = rows[:, skip + n_inputs :]
    for each in said:
        off = np.abs(each[:60, : wanted.shape[1]] - wanted) / (1 + np.abs(wanted))
        assert off.max() <= PRECISIONS[precision]
    if made.kind not in ("model", "estimator"):
        assert np.isfinite(said[1][60:, : wanted.shape[1]]).all()
    if "controller" in made.kind:
        status = said[1][:, header["CONTROLS"]]
        assert (status[:62] <= 1).all()
        assert (status[62:] == 6).all()  # of what is unknown: not finite, which the fallback answers


@needs_compiler
@pytest.mark.parametrize("name", ["driver", pytest.param("racer", marks=pytest.mark.slow)])
def test_a_clock_that_is_set_stops_no_car(name, tmp_path, monkeypatch):
    """By Unix time, and where a clock is set back or says no number: commands as a period after those before."""
    needs("gcc", "g++")
    _, header, _ = shells(name, "double", tmp_path, monkeypatch)
    drive = (tmp_path / "drive.csv").read_text().splitlines()
    t = np.array([float(row.split(",")[0]) for row in drive[1:]])
    dt = float(re.search(r"#define RACER_DT (\S+)", (tmp_path / "racer.h").read_text())[1])
    k, n = np.arange(60), header["COMMANDS"]

    def by(shell, times):
        rows = [f"{now!r},{row.partition(',')[2]}" for now, row in zip(times.tolist(), drive[1:], strict=True)]
        (tmp_path / "set.csv").write_text("\n".join([drive[0], *rows]) + "\n")
        with (tmp_path / "set.csv").open() as given:
            done = subprocess.run([tmp_path / shell], stdin=given, capture_output=True, text=True, check=True)
        return _numbers(done.stdout)[:60], done.stderr

    clocks = {  # what it says, and what it would say if it had not been set
        "Unix": (t + 1.79e9, t),
        "back": (t - 3600.0 * (k >= 30), t + (t[29] + dt - t[30]) * (k >= 30)),
        "none": (np.where(k > 40, np.nan, t), np.where(k > 40, t[40] + dt * (k - 40), t)),
        "late": (np.where(k < 9, np.nan, t), np.where(k < 9, dt * k, t + 9 * dt - t[9])),
    }
    for which, (said, meant) in clocks.items():
        wanted, _ = by("sfun", meant)
        assert (np.ptp(wanted[45:], axis=0)[[0, n + 1]] > 0).all()  # steering and place
        for shell in ("sfun", "node"):
            got, warned = by(shell, said)
            assert got == pytest.approx(wanted, abs=1e-4), which
            assert ("the clock was set" in warned) == (shell == "node" and which != "Unix")


def shells(name, precision, folder, monkeypatch):
    """Project, numbers of its header, and columns before its inputs, of a thing whose S-function and node are built."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1 -march=native")
    thing, before = THINGS[name]
    made = as_precision(project_of(thing(), "racer", 60), precision)
    files = made.everything
    for file, content in files.items():
        (folder / file).write_text(content)
    shutil.copytree(Path(__file__).parent / "stand_ins", folder / "stand_ins")
    header = {k: int(v) for k, v in re.findall(r"^#define RACER_(\w+) (\d+)\b", files["racer.h"], re.MULTILINE)}
    skip, sources = before(header), [f.replace("car", "racer") for f in made.sources]
    objects = [s.replace(".c", ".o") for s in sources]
    for source, to in zip(sources, objects, strict=True):
        run("gcc", "-std=c99", "-O1", "-c", source, "-o", to, folder=folder)
    shared = (*STRICT[1:], "-Istand_ins", f"-DSKIP={skip}", "-O1")
    run("gcc", "-std=c99", *shared, "racer_sfun.c", *objects, "-o", "sfun", "-lm", folder=folder)
    defined = ("-std=c++17", *shared, "-DINPUTS=RACER_BLOCK_INPUTS")
    run("g++", *defined, "racer_node.cpp", *objects, "-o", "node", "-lm", folder=folder)
    return made, header, skip


def _commands(kind, header):
    return header["STATES"] if kind == "estimator" else header["COMMANDS"] if kind in LOOPS else header["CONTROLS"]


def _numbers(text):
    return np.array([line.split(",") for line in text.split()], dtype=float)
