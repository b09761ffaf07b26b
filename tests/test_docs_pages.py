"""Python on the pages of the documentation and in the README runs, block after block, as a reader would paste it."""

import re
import warnings
from pathlib import Path

import pytest

from tests.docs_things import PAGES, names, said

ROOT = Path(__file__).parents[1]
QUICK = ["linear-analysis", "plots", "howto/own-model", "howto/several-logs", "theory/estimator", "theory/grey-box"]
QUICK += ["theory/hybrids", "theory/marx", "theory/prediction-error", "theory/real-time-iteration", "logs"]
SLOW = ["tutorial", "howto/formula-student", "howto/autonomous-racer", "howto/mpc-in-c", "howto/own-controller"]
SLOW += ["optimal-control", "howto/steering-ratio-and-delay", "howto/ttc-data", "fastest-lap", "README", "tires"]
SLOW += ["choosing-a-model", "driving", "export", "page", "plants"]
EXTRAS = {"sa.Joint(": "jax", "sa.PlantFMU(": "fmpy", "sa.open_log(": "rosbags"}  # what a block cannot run without


def blocks(name: str) -> list[str]:
    path = ROOT / "README.md" if name == "README" else ROOT / "docs" / f"{name}.md"
    return re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.S)


def test_every_page_with_python_is_run():
    docs = ROOT / "docs"
    pages = {p.relative_to(docs).with_suffix("").as_posix() for p in docs.rglob("*.md")} | {"README"}
    assert {name for name in pages if blocks(name)} == {*QUICK, *SLOW}
    assert PAGES.keys() <= {*QUICK, *SLOW}


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_python_on_a_page_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # pages show logs that leave something open
        known = names(name, tmp_path)
        for block in blocks(name):
            for call, package in EXTRAS.items():
                if call in block:
                    pytest.importorskip(package)
            exec(compile(block, name, "exec"), known)
        said(name, known)
