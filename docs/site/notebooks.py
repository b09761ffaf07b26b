"""Notebooks from the pages whose blocks run one after the other: ``python -m docs.site.notebooks FOLDER``."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[1]
PAGES = ("tutorial", "howto/formula-student", "howto/autonomous-racer", "howto/steering-ratio-and-delay")
PAGES += ("howto/several-logs", "howto/own-model", "howto/own-controller", "linear-analysis", "plots")

_PAGE = """\
# Notebooks

Each is a page of this site, made with it, so that both say the same: open it in Jupyter or an editor.

{lines}
"""


def notebook(name: str) -> dict[str, Any]:
    """A page as a notebook, format 4.5: a cell for each block of Python, the text between them as Markdown."""
    text = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    cells = []
    for k, part in enumerate(re.split(r"```python\n(.*?)```\n?", text, flags=re.S)):
        if not part.strip():
            continue
        kind = "code" if k % 2 else "markdown"
        cell = {"cell_type": kind, "id": f"cell-{k}", "metadata": {}, "source": part.strip().splitlines(keepends=True)}
        cells.append(cell | ({"execution_count": None, "outputs": []} if kind == "code" else {}))
    kernel = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return {"cells": cells, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}


def write_notebooks(folder: Path) -> list[Path]:
    """Write one file for each page into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{Path(name).name}.ipynb" for name in PAGES]
    for path, name in zip(paths, PAGES, strict=True):
        path.write_text(json.dumps(notebook(name), indent=1) + "\n", encoding="utf-8")
    return paths


def write_page(source: Path) -> None:
    """Write the notebooks, and the page that offers them, into the pages of the site."""
    paths = write_notebooks(source / "notebooks")
    lines = [f"* [{p.name}](notebooks/{p.name}): [the page]({n}.md)" for p, n in zip(paths, PAGES, strict=True)]
    (source / "notebooks.md").write_text(_PAGE.format(lines="\n".join(lines)), encoding="utf-8")


if __name__ == "__main__":
    print("\n".join(map(str, write_notebooks(Path(sys.argv[1] if len(sys.argv) > 1 else "notebooks")))))
