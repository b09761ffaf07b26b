"""The budget of an export: instructions and stack as counted, no less than other tools say."""

import json
import re
import shutil

import pytest

from slipangle.codegen import compiler
from slipangle.errors import ConfigError, ParameterError
from slipangle.export import export
from slipangle.export.budget import measured
from slipangle.export.kinds import project_of
from slipangle.paths.lane_change import double_lane_change
from tests.control.marx.test_mpc import BY_POSE
from tests.export.test_drivers import driver
from tests.export.test_mpc import STANLEY, controller
from tests.export.tools import needs, run
from tests.models.all_models import ALL_MODELS


def frames(project, folder):
    """Bytes of each function's own frame, as the compiler says."""
    for name, content in project.everything.items():
        (folder / name).write_text(content)
    said = []
    for source in project.sources:
        flags = (*(f"-DCAR{part}_LANES=1" for part in ("", "_PLANNER", "_WINDOW")), "-O2", "-fstack-usage", "-c")
        run("gcc", *flags, source, "-o", "made.o", folder=folder)
        said += re.findall(r"\t(\d+)\t", next(folder.glob("*.su")).read_text())
        next(folder.glob("*.su")).unlink()
    return [int(n) for n in said]


@pytest.mark.parametrize(
    "kind", ["Stanley", *(pytest.param(k, marks=pytest.mark.slow) for k in ("MPC", "MARX-MPC", "driver"))]
)
def test_stack_and_instructions(kind, tmp_path):
    needs("valgrind", "gcc", "size")
    thing = {
        "MPC": lambda: controller(5),
        "Stanley": lambda: STANLEY,
        "MARX-MPC": lambda: BY_POSE,
        "driver": lambda: driver(double_lane_change(20.0), horizon=6),
    }[kind]()
    project = project_of(thing, "car", 60)
    budget, again = measured(project, 60), measured(project, 120)
    assert again.most >= budget.most >= budget.median > 1000  # the first of the calls are the same
    own = frames(project, tmp_path)
    assert max(own) < budget.stack < sum(own) + 4096  # and what mathematics needs
    assert budget.code > 1000
    assert budget.memory == project.facts["bytes"][1]


def test_readme_and_manifest_say_it(tmp_path):
    needs("valgrind", "size")
    made = export(STANLEY, tmp_path / "made", budget=20, drive=20)
    record = json.loads((made / "manifest.json").read_text())["budget"]
    assert record["states"] == 20
    assert f"| instructions, longest call | {record['most']} |" in (made / "README.md").read_text()


def test_what_cannot_be_counted_is_said(monkeypatch):
    with pytest.raises(ParameterError, match="a model has no budget; expected a controller or a driver"):
        measured(project_of(ALL_MODELS["bicycle"], "", 2))
    project = project_of(STANLEY, "", 2)
    with pytest.raises(ParameterError, match="of 0 states"):
        measured(project, 0)
    if compiler.compiler():
        found = shutil.which
        monkeypatch.setattr(shutil, "which", lambda name: None if name == "valgrind" else found(name))
        with pytest.raises(ConfigError, match=r"valgrind was not found; expected it.*apt-get install valgrind"):
            measured(project, 5)
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    with pytest.raises(ConfigError, match="no C compiler was found"):
        measured(project, 5)
