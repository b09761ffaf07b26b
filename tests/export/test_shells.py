"""S-function and ROS 2 node, against stand-ins of their headers, decide what was recorded."""

import re
import shutil
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
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1 -march=native")
    thing, before = THINGS[name]
    made = as_precision(project_of(thing(), "racer", 60), precision)
    files = made.everything
    for file, content in files.items():
        (tmp_path / file).write_text(content)
    shutil.copytree(Path(__file__).parent / "stand_ins", tmp_path / "stand_ins")
    header = {k: int(v) for k, v in re.findall(r"^#define RACER_(\w+) (\d+)\b", files["racer.h"], re.MULTILINE)}
    skip, sources = before(header), [f.replace("car", "racer") for f in made.sources]
    objects = [s.replace(".c", ".o") for s in sources]
    for source, to in zip(sources, objects, strict=True):
        run("gcc", "-std=c99", "-O1", "-c", source, "-o", to, folder=tmp_path)
    shared = (*STRICT[1:], "-Istand_ins", f"-DSKIP={skip}", "-O1")
    run("gcc", "-std=c99", *shared, "racer_sfun.c", *objects, "-o", "sfun", "-lm", folder=tmp_path)
    defined = ("-std=c++17", *shared, "-DINPUTS=RACER_BLOCK_INPUTS")
    run("g++", *defined, "racer_node.cpp", *objects, "-o", "node", "-lm", folder=tmp_path)
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


def _commands(kind, header):
    return header["STATES"] if kind == "estimator" else header["COMMANDS"] if kind in LOOPS else header["CONTROLS"]


def _numbers(text):
    return np.array([line.split(",") for line in text.split()], dtype=float)
