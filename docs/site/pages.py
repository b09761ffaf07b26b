"""Pages as they are written: which the navigation has, and where their links lead."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).parents[1]
MADE = ("api/index", "gallery/index", "notebooks")  # when the site is built


def navigation() -> list[str]:
    """Pages that the index lists, without ``.md``, in its order."""
    text = (DOCS / "index.md").read_text(encoding="utf-8")
    trees = re.findall(r"```\{toctree\}\n(.*?)```", text, re.S)
    return [line for tree in trees for line in tree.splitlines() if line and not line.startswith(":")]


def written() -> dict[str, Path]:
    """Markdown files below docs by their name in the navigation."""
    return {path.relative_to(DOCS).with_suffix("").as_posix(): path for path in sorted(DOCS.rglob("*.md"))}


def anchors(text: str) -> set[str]:
    """Anchors of the headings of a page, as GitHub and MyST make them."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)
    heads = re.findall(r"^#{1,3} (.*)$", text, re.M)
    plain = (re.sub(r"\[(.*?)\]\(.*?\)", r"\1", head).replace("`", "") for head in heads)
    return {re.sub(r"\s", "-", re.sub(r"[^\w\- ]", "", head.strip().lower())) for head in plain}


def loose(name: str, path: Path) -> list[str]:
    """Links of a page that lead to no page or heading."""
    text = path.read_text(encoding="utf-8")
    said = []
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)):
        if ":" in target:
            continue
        file, _, anchor = target.partition("#")
        other = (path.parent / file).resolve() if file else path
        made = other.is_relative_to(DOCS) and other.relative_to(DOCS).with_suffix("").as_posix() in MADE
        if not made and not other.is_file():
            said.append(f"{name}: no file {target}")
        elif anchor and not made and anchor not in anchors(other.read_text(encoding="utf-8")):
            said.append(f"{name}: no heading {target}")
    return said
