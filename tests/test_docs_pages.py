"""Python on the pages of the documentation runs, block after block, as a reader would paste it."""

import re
import warnings
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[1] / "docs"
QUICK = ["linear-analysis", "plots", "howto/own-model", "howto/several-logs", "theory/estimator", "theory/grey-box"]
QUICK += ["theory/hybrids", "theory/marx", "theory/prediction-error", "theory/real-time-iteration"]
SLOW = ["tutorial", "howto/formula-student", "howto/autonomous-racer", "howto/mpc-in-c", "howto/own-controller"]
SLOW += ["optimal-control", "howto/steering-ratio-and-delay", "howto/ttc-data", "fastest-lap"]
# Calls on a model, a plant or a log that the reader has: their names are checked, they are not run.
SHOWN = ["choosing-a-model", "driving", "export", "logs", "page", "plants", "tires"]


def blocks(name: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (DOCS / f"{name}.md").read_text(encoding="utf-8"), re.S)


def test_every_page_with_python_is_run_or_said_to_be_shown_only():
    pages = {p.relative_to(DOCS).with_suffix("").as_posix() for p in DOCS.rglob("*.md")}
    assert {name for name in pages if blocks(name)} == {*QUICK, *SLOW, *SHOWN}


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_python_on_a_page_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # pages show logs that leave something open
        for block in blocks(name):
            exec(compile(block, name, "exec"), names)


@pytest.mark.parametrize("name", SHOWN)
def test_python_that_is_shown_compiles(name):
    for block in blocks(name):
        compile(block, name, "exec")
