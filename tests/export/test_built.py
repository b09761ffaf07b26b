"""A controller built ahead of time plans as the one it was built from, without a compiler, or says why not."""

import hashlib
import json
import os
import pickle
import shutil
import subprocess
import sys

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.errors import ConfigError, FormatError, HashError, MissingFileError, ParameterError
from slipangle.export import build, load
from tests.control.marx.test_mpc import BY_POSE
from tests.export.test_mpc import KINDS, controller

pytestmark = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SLIPANGLE_CFLAGS", "-O1")
        settings = dict(KINDS["corridor and soft limits"])
        mpc = controller(settings.pop("horizon"), **settings)
        mpc.prepare()
        return mpc, build(mpc, tmp_path_factory.mktemp("built") / "made", name="racer", drive=60)


@pytest.fixture
def copy(built, tmp_path):
    return shutil.copytree(built[1], tmp_path / "copy")


def test_plans_as_the_one_it_was_built_from(built):
    mpc, folder = built
    loaded, path = load(folder), sa.double_lane_change(20.0)
    mine = other = None
    x, s = mpc.model.straight(20.0), 0.0
    for _ in range(40):
        preview = path.ahead(s, mpc.times)
        assert np.array_equal(loaded.reference(preview).tracked, mpc.reference(preview).tracked)
        mine, other = mpc.plan(x, mpc.reference(preview), mine), loaded.plan(x, preview, other)
        assert np.array_equal(mine.u, other.u)
        assert np.array_equal(mine.x, other.x)
        assert (mine.status, mine.health, mine.iterations) == (other.status, other.health, other.iterations)
        x = np.asarray(mpc.model.step(x, np.array([mine.command[0], 20.0])))
        s += 1.0
    assert loaded.model == mpc.model
    again = pickle.loads(pickle.dumps(loaded)).plan(x, preview)
    assert np.array_equal(again.u, loaded.plan(x, preview).u)
    with pytest.raises(ParameterError, match="not the last plan of this built controller"):
        loaded.plan(x, preview, other)


def test_drives_in_closed_loop(built):
    mpc, folder = built
    plant = sa.Plant(mpc.model)
    path = sa.double_lane_change(20.0)
    runs = [sa.closed_loop(plant, c, path, duration=3.0, sample=0.05) for c in (mpc, load(folder))]
    assert np.array_equal(runs[0].commands, runs[1].commands)


def test_needs_no_compiler(built):
    code = (
        "import sys, slipangle.export as e, numpy as np; c = e.load(sys.argv[1]);"
        "r = e.Recorder(c); from slipangle.paths.lane_change import double_lane_change as d;"
        "print(c.plan(np.zeros(5), c.reference(d(20.0).ahead(0.0, c.times))).status.name)"
    )
    environment = {**os.environ, "SLIPANGLE_CC": "none"}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code, str(built[1])],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    assert done.returncode == 0, done.stderr[-500:]
    assert done.stdout.strip() in ("SOLVED", "REAL_TIME")


def test_a_start_is_found_or_refused(built, tmp_path, monkeypatch):
    mpc, folder = built
    assert np.array_equal(load(folder).start({"Y": 2.0}), [2.0 * (n == "Y") for n in mpc.model.states])
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1")
    lagged = load(build(BY_POSE, tmp_path / "made", drive=60))
    with pytest.raises(ParameterError, match="does not know the state to start from"):
        lagged.start({"Y": 2.0})


def test_marx(tmp_path, monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1")
    folder = build(BY_POSE, tmp_path / "made", drive=60)
    assert load(folder).controls == BY_POSE.controls


def changed(folder, change):
    file = folder / "manifest.json"
    record = json.loads(file.read_text())
    change(record)
    file.write_text(json.dumps(record))


def test_what_was_changed_is_not_run(copy):
    library = copy / json.loads((copy / "manifest.json").read_text())["build"]["library"]
    raw = library.read_bytes()
    library.write_bytes(raw[:-1] + bytes([raw[-1] ^ 1]))
    with pytest.raises(HashError, match="is not the file that was built"):
        load(copy)
    library.unlink()
    with pytest.raises(MissingFileError, match="cannot be read"):
        load(copy)


def test_a_drive_that_it_does_not_repeat(copy):
    """As where a processor computes otherwise: the checksum is right, the commands are not."""
    lines = (copy / "drive.csv").read_text().splitlines()
    row = lines[30].split(",")
    row[-1] = repr(float(row[-1]) + 1e-6)
    lines[30] = ",".join(row)
    (copy / "drive.csv").write_text("\n".join(lines) + "\n")
    sum_ = hashlib.sha256((copy / "drive.csv").read_bytes()).hexdigest()
    changed(copy, lambda record: record["sha256"].update({"drive.csv": sum_}))
    with pytest.raises(ConfigError, match="decides otherwise than when it was built"):
        load(copy)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [("system", "Plan 9", "system Plan 9"), ("bits", 32, "bits 32"), ("processor", "x", "another processor")],
)
def test_another_machine(key, value, said, copy):
    changed(copy, lambda record: record["build"].update({key: value}))
    with pytest.raises(ConfigError, match=f"was built for {said}"):
        load(copy)


def test_no_manifest(copy, tmp_path):
    with pytest.raises(MissingFileError, match="expected a folder that 'slipangle build' wrote"):
        load(tmp_path / "nowhere")
    changed(copy, lambda record: record.pop("build"))
    with pytest.raises(FormatError, match="was exported, not built"):
        load(copy)
    for text in ("", "[]", "{"):
        (copy / "manifest.json").write_text(text)
        with pytest.raises(FormatError):
            load(copy)


def test_no_compiler_says_so(tmp_path, monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    with (
        pytest.warns(sa.errors.ModelWarning),
        pytest.raises(ConfigError, match="no C compiler was found; expected one"),
    ):
        build(controller(3), tmp_path / "made", drive=2)
