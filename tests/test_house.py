"""The house is as docs/architecture.md draws it: rooms and their doors, one way for imports, no circles."""

import ast
import re
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "slipangle"
PLAN = (ROOT / "docs" / "architecture.md").read_text()
ROOMS = sorted(p.parent.relative_to(SOURCE).as_posix() for p in SOURCE.rglob("__init__.py") if p.parent != SOURCE)


def _module(path):
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {_module(p): p for p in SOURCE.rglob("*.py")}


def _imports(path):
    """Modules of the house that a file takes something from, inside functions and for types too."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names if name.name in FILES)
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("slipangle"):
            inside = {f"{node.module}.{name.name}" for name in node.names} & FILES.keys()
            yield from inside
            if len(inside) < len(node.names):
                yield node.module


@pytest.mark.parametrize("room", ROOMS)
def test_every_door_says_what_is_behind_it(room):
    """The table of rooms is made of the doors' first sentences."""
    door = ast.get_docstring(ast.parse((SOURCE / room / "__init__.py").read_text()))
    assert door is not None
    assert len(door.splitlines()[0].split()) >= 4
    assert f"| `{room}/` | {door.splitlines()[0]} |" in PLAN


def test_the_plan_names_no_room_that_is_not_there():
    assert re.findall(r"^\| `(.*?)/` \|", PLAN, re.M) == ROOMS


def test_the_plan_has_the_order_that_imports_are_checked_against():
    layers = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0]["layers"]
    here = [re.sub(r"slipangle\.|[()]", "", layer).replace(" | ", ", ") for layer in layers]
    drawn = re.search(r"^cli > .*$", PLAN, re.M).group(0)
    assert drawn.split(" > ") == here


def test_no_circles():
    """No file needs one that needs it, by whatever way, at import or later."""
    needs = {name: {m for m in _imports(path) if m != name} for name, path in FILES.items()}
    found, done = [], set()

    def walk(name, way):
        if name in way:
            found.append(" > ".join([*way[way.index(name) :], name]))
            return
        if name in done:
            return
        for other in sorted(needs[name]):
            walk(other, [*way, name])
        done.add(name)

    for name in sorted(needs):
        walk(name, [])
    assert found == []


LONGEST_FILE, LONGEST_FUNCTION = 400, 60  # lines; of a function without its docstring


@pytest.mark.parametrize(
    "path",
    [p for p in sorted(SOURCE.rglob("*")) if p.suffix in (".py", ".c", ".h")],
    ids=lambda p: p.relative_to(SOURCE).as_posix(),
)
def test_what_is_long_says_why(path):
    """A long file has a line ``# Long: why``, a long function one inside it."""
    text = path.read_text()
    lines = text.splitlines()
    assert len(lines) <= LONGEST_FILE or re.search(r"^(# |/\* )Long: \w+", text, re.M)
    for node in ast.walk(ast.parse(text)) if path.suffix == ".py" else ():
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0]
            said = first.end_lineno - first.lineno + 1 if ast.get_docstring(node) is not None else 0
            inside = lines[node.lineno - 1 : node.end_lineno]
            short = len(inside) - said <= LONGEST_FUNCTION
            assert short or any(re.match(r"\s+# Long: \w+", line) for line in inside), node.name


def test_a_wheel_has_every_file_of_the_package():
    """The build takes the whole folder but for what .gitignore names, which is nothing that the package needs."""
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]
    also = {"docs/troubleshooting.md": "slipangle/report/troubleshooting.md"}  # for `slipangle.report.why`
    assert build == {"wheel": {"packages": ["src/slipangle"], "force-include": also}}
    files = [p.relative_to(SOURCE) for p in SOURCE.rglob("*") if p.is_file() and p.parent.name != "__pycache__"]
    assert {".c", ".h", ".toml", ".css", ".js", ".pyi"} <= {p.suffix for p in files}
    assert Path("py.typed") in files
    ignored = [line.strip("/") for line in (ROOT / ".gitignore").read_text().split()]
    assert [p for p in files if any(fnmatch(part, name) for part in p.parts for name in ignored)] == []
