"""Pages of the gallery: each table of the thesis beside our numbers, and each example, from files that a test checks.

``slipangle reproduce NAME --json > docs/gallery/NAME.json`` writes the numbers of a table anew.
"""

from __future__ import annotations

import ast
import importlib.util
import json
import re
from pathlib import Path
from typing import Any

from slipangle.reproduce import names

ROOT = Path(__file__).parents[2]
STORED = ROOT / "docs" / "gallery"
EXAMPLES = sorted((ROOT / "examples").glob("*"))

_INDEX = """\
# Gallery

## The thesis' tables

Each number is printed again, with its bound, by the command on its page: exit code 1 if one does not hold. The numbers
here are what these commands said when they were stored (`docs/gallery`).

| table | what it is | numbers |
|---|---|---|
{tables}

## Examples

| file | what it does |
|---|---|
{examples}

```{{toctree}}
:hidden:

{names}
```
"""


def write_gallery(folder: Path) -> None:
    """Write ``index.md`` and a page for each table and example into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    tables, examples = [], []
    for name in names():
        title, protocol = _described(name)
        records = stored(name)
        here = f"{len(records)} stored" if records else "by the command"
        tables.append(f"| [{name}]({name}.md) | {_cell(title)} | {here} |")
        (folder / f"{name}.md").write_text(_table_page(name, title, protocol, records), encoding="utf-8")
    for path in (p for p in EXAMPLES if p.suffix in (".py", ".toml")):
        what, text = _example(path)
        examples.append(f"| [{path.name}]({path.stem}.md) | {_cell(what)} |")
        kind = {".py": "python", ".toml": "toml"}[path.suffix]
        command = f"python examples/{path.name}" if kind == "python" else f"slipangle run examples/{path.name}"
        page = (
            f"# {path.stem.replace('_', ' ').capitalize()}\n\n{what}\n\n```\n{command}\n```\n\n```{kind}\n{text}```\n"
        )
        (folder / f"{path.stem}.md").write_text(page, encoding="utf-8")
    pages = "\n".join([*names(), *(p.stem for p in EXAMPLES if p.suffix in (".py", ".toml"))])
    text = _INDEX.format(tables="\n".join(tables), examples="\n".join(examples), names=pages)
    (folder / "index.md").write_text(text, encoding="utf-8")


def stored(name: str) -> list[dict[str, Any]]:
    """Records of a table as its command wrote them; none where they were not stored."""
    path = STORED / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else []


def _described(name: str) -> tuple[str, str]:
    """Title and protocol, from the docstring of the module that makes the table."""
    spec = importlib.util.find_spec(f"slipangle.reproduce.{name.replace('-', '_').replace('.', '_')}")
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    title, _, rest = (ast.get_docstring(tree) or name).partition("\n\n")
    return " ".join(title.split()).rstrip("."), rest


def _table_page(name: str, title: str, protocol: str, records: list[dict[str, Any]]) -> str:
    lines = [f"# {title}", "", "```", f"slipangle reproduce {name}", "```", ""]
    if records:
        lines += ["| row | quantity | thesis | here | bound | holds |", "|---|---|---|---|---|---|"]
        for r in records:
            cells = (r["row"], r["quantity"], _shown(r["thesis"]), _shown(r["here"]), r["bound"], _holds(r["holds"]))
            lines.append("| " + " | ".join(_cell(str(cell)) for cell in cells) + " |")
    else:
        lines += ["Its numbers take long and are not stored here: run the command."]
    said = [f"* {r['row']}, {r['quantity']}: {r['note']}" for r in records if r["note"]]
    lines += ["", "## Protocol", "", _plain(protocol), *(["", "## Notes", "", *map(_plain, said)] if said else [])]
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    """Text in a table of Markdown."""
    return text.replace("|", "\\|")


def _plain(text: str) -> str:
    """Text of a docstring as Markdown: double backticks are single ones, sources are words."""
    text = re.sub(r"``(.+?)``", r"`\1`", text)
    return re.sub(r"^\.\. \[(\d+)\] ", r"[\1] ", re.sub(r"\[(\d+)\]_", r"[\1]", text), flags=re.M).replace("$", "\\$")


def _shown(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def _holds(value: bool | None) -> str:
    return {None: "", True: "yes", False: "**no**"}[value]


def _example(path: Path) -> tuple[str, str]:
    """First sentence, and the file."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        first = (ast.get_docstring(ast.parse(text)) or "").partition("\n\n")[0]
    else:
        comment = re.match(r"(?:# ?.*\n)+", text)
        first = re.sub(r"^# ?", "", comment.group(0), flags=re.M) if comment else json.dumps(path.stem)
    return " ".join(first.split()), text
