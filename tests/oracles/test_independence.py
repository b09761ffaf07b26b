"""What makes an oracle one: its module takes nothing from the package."""

import ast
from pathlib import Path

import pytest

ORACLES = sorted(p for p in Path(__file__).parent.glob("*.py") if not p.name.startswith(("test_", "__")))


@pytest.mark.parametrize("path", ORACLES, ids=lambda p: p.stem)
def test_an_oracle_imports_nothing_of_the_package(path):
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    names = [a.name for n in nodes if isinstance(n, ast.Import) for a in n.names]
    names += [n.module or "" for n in nodes if isinstance(n, ast.ImportFrom)]
    assert names
    own = tuple(f"tests.oracles.{other.stem}" for other in ORACLES)
    assert not [
        n for n in names if n.split(".")[0] not in ("numpy", "casadi", "math") and n not in ("tests.oracles", *own)
    ]
