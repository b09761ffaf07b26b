"""What Cppcheck, its MISRA addon and clang-tidy find in exported code is among what docs/export.md explains."""

import json
import re
from pathlib import Path

import pytest

from slipangle.export.fmi import export_fmu
from slipangle.export.kinds import project_of
from slipangle.paths.lane_change import double_lane_change
from tests.control.marx.test_mpc import BY_POSE
from tests.export import test_joined, test_marx_learns, test_racers, test_sensors, test_switched, test_windows
from tests.export.test_drivers import driver
from tests.export.test_estimators import VARIANTS
from tests.export.test_mpc import KINDS, STANLEY, controller
from tests.export.test_recursions import started
from tests.export.tools import needs, run
from tests.models.all_models import ALL_MODELS

DOCS = Path(__file__).parents[2] / "docs" / "export.md"
EXPORTED = {
    "path follower": lambda: STANLEY,
    "estimator": lambda: VARIANTS["late, gate, offsets"],
    "moving horizon": lambda: test_windows.VARIANTS["late, gate, offsets"],
    "virtual sensor": lambda: test_sensors.LEARNED,
    "recursion": lambda: started("directional, constant"),
    "model": lambda: ALL_MODELS["saturating bicycle"],
    "MARX-MPC": lambda: BY_POSE,
    "switched": lambda: test_switched.SWITCHED,
    "MARX that learns": lambda: test_marx_learns.INTEGRAL,
    "MPC": lambda: controller(**KINDS["corridor and soft limits"]),
    "scenarios": test_joined.KINDS["a corridor at two speeds"],
    "driver": lambda: driver(double_lane_change(20.0), horizon=6),
    "racer": lambda: test_racers.racer(horizon=6),
}
LONG = {*EXPORTED} - {"path follower", "model"}
EACH = pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=[pytest.mark.slow] * (k in LONG)) for k in (*EXPORTED, "FMU 2", "FMU 3")]
)
DEFINED = (
    "-DCAR_LANES=1",
    "-DCAR_PLANNER_LANES=1",
    "-DCAR_WINDOW_LANES=1",
    "-DCAR_JOINED_LANES=1",
    "-DCAR_CALM_LANES=1",
    "-DCAR_LIMIT_LANES=1",
)
FINDINGS = {  # of Cppcheck, and what stands in their lines; the documents explain each
    "negativeIndex": "LIMIT_STAGE",
    "overlappingWriteFunction": "memcpy(",
    "legacyUninitvar": "of_l[k]",
}
CHECKS = (
    "-*,clang-analyzer-*,bugprone-*,cert-*,-bugprone-easily-swappable-parameters,"
    "-bugprone-implicit-widening-of-multiplication-result,-cert-flp30-c,-clang-analyzer-security.FloatLoopCounter,"
    "-clang-analyzer-deadcode.DeadStores,-bugprone-reserved-identifier,-cert-dcl37-c,-cert-err33-c,"
    "-clang-analyzer-security.insecureAPI.DeprecatedOrUnsafeBufferHandling"
)


def written(kind, folder):
    """Names of the C files."""
    if kind.startswith("FMU"):
        import zipfile

        made = export_fmu(ALL_MODELS["bicycle"], folder / "a.fmu", version=int(kind[-1]), binary=False)
        with zipfile.ZipFile(made) as archive:
            (folder / "model.c").write_bytes(archive.read("sources/model.c"))
        return ("model.c",)
    project = project_of(EXPORTED[kind](), "car", 3)
    for name, content in project.everything.items():
        (folder / name).write_text(content)
    return project.sources


def explained():
    """Rules of MISRA C 2012 in the table of the documents."""
    rows = re.findall(r"^\| ([\d., ]+) \| [A-Z]", DOCS.read_text(), re.MULTILINE)
    return {rule for row in rows for rule in row.split(", ")}


@EACH
def test_rules_that_are_not_kept_are_explained(kind, tmp_path):
    needs("cppcheck")
    addon = next((p for p in Path("/usr").glob("**/cppcheck/addons/misra.py")), None)
    if addon is None:
        pytest.skip("Cppcheck's MISRA addon is not installed: apt-get install cppcheck")
    sources = written(kind, tmp_path)
    (tmp_path / "misra.json").write_text(json.dumps({"script": str(addon)}))
    given = ("--quiet", "--std=c99", "--enable=warning,performance,portability", "--addon=misra.json")
    said = run(
        "sh",
        "-c",
        '"$@" 2>&1',
        "-",
        "cppcheck",
        *given,
        "--template={file}:{line}:{id}",
        *DEFINED,
        *sources,
        folder=tmp_path,
    )
    found = re.findall(r"^(\S+?):(\d+):(\S+)$", said, re.MULTILINE)
    assert found
    broken = {name.removeprefix("misra-c2012-") for *_, name in found if name.startswith("misra-")}
    assert broken <= explained()
    for file, line, name in found:
        if not name.startswith("misra-"):
            text = (tmp_path / file).read_text().splitlines()[int(line) - 1]
            assert FINDINGS.get(name, "nowhere") in text, (name, text)


@pytest.mark.slow
@EACH
def test_clang_tidy_has_nothing_to_say(kind, tmp_path):
    needs("clang-tidy")
    sources = written(kind, tmp_path)
    said = run("clang-tidy", "--quiet", f"-checks={CHECKS}", *sources, "--", "-std=c99", *DEFINED, folder=tmp_path)
    assert re.findall(r"^\S+:\d+:\d+: (?:warning|error): .*", said, re.MULTILINE) == []


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=[pytest.mark.slow] * (k in LONG)) for k in (*EXPORTED, "implicit model")]
)
def test_all_memory_is_the_callers_and_all_names_are_the_projects_own(kind, tmp_path):
    """No file holds data that change, so that instances and threads do not meet, and several go into one program."""
    needs("gcc", "nm")
    thing = ALL_MODELS["single track, Radau"] if kind == "implicit model" else EXPORTED[kind]()
    project = project_of(thing, "racer", 3)
    for name, content in project.everything.items():
        (tmp_path / name).write_text(content)
    for source in (n.replace("car", "racer") for n in project.sources):
        run("gcc", "-std=c99", "-O0", *(d.replace("CAR", "RACER") for d in DEFINED), "-c", source, folder=tmp_path)
        symbols = run("nm", "--defined-only", source.replace(".c", ".o"), folder=tmp_path).split()
        kinds, names = symbols[1::3], symbols[2::3]
        assert set(kinds) <= {"T", "t", "r", "R"}, source
        assert [n for k, n in zip(kinds, names, strict=True) if k.isupper() and not n.startswith("racer_")] == []
        assert "racer_start" in names or "racer_step" in names or source != "racer.c"


def test_no_explanation_is_for_a_rule_about_memory_or_recursion():
    """What an ECU asks first is kept, not explained away."""
    kept = {"17.2", "18.8", "21.3", "21.4", "21.5", "21.6", "21.8", "21.10", "9.1", "17.1", "15.1", "13.6", "22.2"}
    assert not explained() & kept
    assert len(explained()) > 10
