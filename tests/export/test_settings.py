"""What an export is told: names, settings and flags of compilers that cannot be are refused with a sentence."""

import itertools
import re
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.data.dataset import Dataset
from slipangle.errors import ConfigError, ParameterError
from slipangle.export import Recorder, build, export
from slipangle.export.fmi import export_fmu
from slipangle.export.kinds import project_of
from slipangle.export.names import checked, constants
from slipangle.export.reserved import RESERVED
from tests.export.test_mpc import STANLEY, controller
from tests.export.test_static import EXPORTED, LONG
from tests.export.tools import ZIG, needs, run
from tests.models.all_models import ALL_MODELS

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
MODEL = ALL_MODELS["bicycle"]
FLAGS = ("-ffast-math", "-Ofast", "-ffinite-math-only", "-D_M_FP_FAST")  # the last is what /fp:fast defines
SAID = "This code tells what is missing by NaN: leave out -ffast-math"
C99 = (
    "assert complex ctype errno fenv inttypes locale math setjmp signal stdarg stddef stdio stdlib string time wchar "
    "wctype"
)


@pytest.mark.parametrize("given", [2.5, "a", None, True, 0, -1, np.float64(3.0), Recorder(STANLEY), [3]])
def test_a_drive_is_recorded_or_a_count(given, tmp_path):
    for thing, write in ((MODEL, export), (STANLEY, export), (STANLEY, build)):
        with pytest.raises(ParameterError, match=r"the drive is .*; expected one that was recorded, a Dataset, or"):
            write(thing, tmp_path / "made", drive=given)
    assert not (tmp_path / "made").exists()


def test_drives_of_every_kind_are_taken(tmp_path):
    made = export(MODEL, tmp_path / "count", drive=np.int64(3))
    assert (made / "drive.csv").read_text().count("\n") == 4
    inputs = {n: np.full(7, 20.0 if n == "v_x" else 0.01) for n in MODEL.inputs}
    data = Dataset.from_arrays(inputs, {n: np.full(7, 0.01) for n in MODEL.outputs}, dt=MODEL.dt)
    assert (export(MODEL, tmp_path / "data", drive=data) / "drive.csv").read_text().count("\n") > 4


@pytest.mark.parametrize("given", [2.5, "x", None, True, -1, 1e4])
def test_a_budget_is_a_count(given, tmp_path):
    with pytest.raises(ParameterError, match=r"the budget is .*; expected a whole number of states, or 0 for none"):
        export(STANLEY, tmp_path / "made", budget=given)


@pytest.mark.parametrize("given", [5, None, b"made", ["made"]])
def test_a_place_is_a_path(given):
    for write in (export, build, export_fmu):
        with pytest.raises(ParameterError, match=r"the (folder|path) is .*; expected where to write"):
            write(STANLEY, given)


@pytest.mark.parametrize("given", [2.0, "2", None, True, 4])
def test_a_version_is_two_or_three(given, tmp_path):
    with pytest.raises(ParameterError, match=r"the version of FMI is .*; expected 2 or 3"):
        export_fmu(MODEL, tmp_path / "it.fmu", version=given)


@pytest.mark.parametrize(
    "name",
    "log exp sin fmin fminf sqrtl y0 j1f memcpy index time tm string stdint stddef stdio signal math test all install "
    "help clean m x f r w sleep read stat poll basename malloc vector array pthread_create sem_wait size_t double "
    "features simstruc assert".split(),
)
def test_a_name_that_means_something_is_refused(name):
    """In C, its library and POSIX, whose functions C++ has as namespaces' rivals; headers; CMake's targets."""
    with pytest.raises(ParameterError, match=f"the name '{name}' is reserved in C, C.* or CMake; expected another"):
        checked(name)


def test_names_of_vehicles_are_taken():
    """What begins as a reserved one does is another one, and so are the names of kinds by default."""
    defaults = "mpc marx switched follower driver racer estimator recursion sensor model"
    for (
        name
    ) in f"{defaults} island strada torque logging car_test my_m timed saloon spin wheel rt fmu units ab".split():
        assert checked(name) == name
    assert checked("car_mpc") not in RESERVED


@pytest.mark.parametrize("headers", C99.split())
def test_every_function_of_the_c_library_is_refused(headers, tmp_path):
    """What the headers of this machine's compiler declare, read without anything beside the standard."""
    needs("gcc")
    (tmp_path / "it.c").write_text(f"#include <{headers}.h>\n")
    text = re.sub(r"^#.*$", "", run("gcc", "-std=c99", "-E", "it.c", folder=tmp_path), flags=re.MULTILINE)
    found = set(re.findall(r"\bextern\b[^;{}()]*?\b([a-z][a-z0-9]*)\s*\(", text)) | {headers}
    for name in found:
        with pytest.raises(ParameterError, match="is reserved"):
            checked(name)


def test_constants_of_channels_are_all_different():
    """Also from one that is called as another is numbered, in any order."""
    for names in itertools.permutations(["a 2", "a", "a!", "A", "a_2", "", "!"]):
        made = constants("CAR_X", names)
        assert list(made) == list(names)
        assert len(set(made.values())) == len(names)
        assert all(re.fullmatch(r"CAR_X_[A-Z0-9_]+", c) for c in made.values())
    assert constants("CAR_X", ["r", "r[k-1]"]) == {"r": "CAR_X_R", "r[k-1]": "CAR_X_R_K_1"}


@pytest.mark.parametrize(
    "kind", [*(pytest.param(k, marks=[pytest.mark.slow] * (k in LONG)) for k in EXPORTED), "FMU 2", "FMU 3"]
)
def test_flags_without_nan_are_an_error_in_every_file(kind, tmp_path):
    """Each file that is compiled says so, whatever else it lacks here, and is silent without them."""
    needs("gcc")
    if kind in EXPORTED:
        files = project_of(EXPORTED[kind](), "racer", 3).everything
    else:
        path = export_fmu(MODEL, tmp_path / "it.fmu", version=int(kind[-1]), binary=False)
        with zipfile.ZipFile(path) as archive:
            files = {n.rpartition("/")[2]: archive.read(n).decode() for n in archive.namelist()}
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    statements = [n for n in files if n.endswith((".c", ".cpp", "_block.h"))]
    assert statements
    for name in statements:
        for flags in (("-O2",), *((flag,) for flag in FLAGS)):
            command = ["gcc", *flags, "-E", "-x", "c", name, "-o", "it.i"]
            said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
            assert (SAID in said.stderr) == (flags[0] in FLAGS), (name, flags)


def test_it_is_said_where_it_is_compiled(tmp_path):
    """Make stops with the sentence, and the folder's README names the flags."""
    needs("gcc", "make")
    folder = STANLEY.export(tmp_path / "made", name="racer", drive=20)
    said = subprocess.run(
        ["make", "CC=gcc", "CFLAGS=-Ofast", "replay"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert said.returncode
    assert SAID in said.stderr
    run("make", "CC=gcc", "CFLAGS=-O1", "replay", folder=folder)
    for readme in ("README", "DRIVER", "ESTIMATOR", "MODEL", "RECURSION", "SENSOR"):
        written = (Path(sa.export.__file__).parent / "c" / f"{readme}.md").read_text()
        assert all(f"`{flag}`" in written for flag in (*FLAGS[:3], "/fp:fast"))


@needs_compiler
def test_the_toolbox_compiles_with_flags_of_its_own(tmp_path, monkeypatch):
    """Building by such flags is an error with the reason; by any others it works."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1 -ffast-math")
    with pytest.raises(ConfigError, match="tells what is missing by NaN"):
        build(STANLEY, tmp_path / "made", drive=3)
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1")
    assert not (tmp_path / "made").exists()
    assert build(controller(3), tmp_path / "made", drive=3).is_dir()


def test_sums_keep_their_order_in_a_solver(tmp_path):
    """A compiler that reorders them drops how numbers are rounded, by adding a large one: an error, or no effect."""
    needs("gcc", "zig")
    folder = controller(4).export(tmp_path / "made", name="racer", drive=60)
    for flag in ("-fassociative-math", "-funsafe-math-optimizations", "-O2"):
        given = ("-fno-signed-zeros", "-fno-trapping-math", flag)
        command = ["gcc", *given, "-E", "racer.c", "-o", "it.i"]
        said = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        known = "__ASSOCIATIVE_MATH__" in run("gcc", *given, "-dM", "-E", "-x", "c", "/dev/null", folder=folder)
        assert ("leave out -fassociative-math" in said.stderr) == (said.returncode != 0) == known
    loose = ("-O2", "-ffast-math", "-fno-finite-math-only")
    run(*ZIG, "-std=c99", *loose, "-o", "replay", "racer.c", "main.c", "-lm", folder=folder)
    assert ", 0 of them without a solution" in run("./replay", folder=folder, stdin=folder / "drive.csv")
