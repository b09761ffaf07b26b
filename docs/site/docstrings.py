"""Docstrings of the house as reStructuredText: sources become plain lines, bars stay bars."""

from __future__ import annotations

import inspect
import re
import sys
from typing import Any

from docs.site.described import added, text_of
from sphinx.application import Sphinx

_CODE = re.compile(r"(``.+?``)")


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx; before napoleon reads the sections."""
    app.connect("autodoc-process-docstring", _process, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _process(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    text = _with_text_first("\n".join(lines))
    if what in ("class", "function", "method"):
        text = _completed(text, list(added(thing, _contract(name) if what == "method" else "")))
    cited = set(re.findall(r"\[(\d+)\]_", text)) - set(re.findall(r"^\.\. \[(\d+)\]", text, re.M))
    text = re.sub(r"^\.\. \[(\d+)\] (.*(?:\n {3,}.*)*)", _plain, text, flags=re.M)
    text = re.sub(r"\[(\d+)\]_", r"[\1]", text)
    sources = _sources(thing)
    below = [sources[number] for number in sorted(cited) if number in sources]
    if below:
        text = "\n\n".join([text.rstrip(), ".. rubric:: References", *below, ""])
    lines[:] = "".join(_marked(part) for part in _CODE.split(text)).replace("\0", "\\ ").split("\n")


def _contract(name: str) -> str:
    """Docstrings of a method and of those that it overrides."""
    full, _, method = name.rpartition(".")
    module, _, kind = full.rpartition(".")
    return text_of(getattr(sys.modules[module], kind), method)


def _completed(text: str, more: list[tuple[str, str, str]]) -> str:
    """The docstring with entries for arguments that it does not describe."""
    entries = "".join(f"{key} : {kind}\n    {meaning}\n" for key, kind, meaning in more)
    head = "Parameters\n----------\n"
    if not entries:
        return text
    if head not in text:
        section = re.search(r"^[A-Z]\w+\n---+\n", text, re.M)
        place = section.start() if section else len(text)
        return f"{text[:place].rstrip()}\n\n{head}{entries}\n{text[place:]}"
    before, after = text.split(head)
    own, *rest = re.split(r"\n\s*\n", after, maxsplit=1)
    return "\n\n".join([f"{before}{head}{own.rstrip()}\n{entries.rstrip()}", *rest])


def _with_text_first(text: str) -> str:
    """Sentences that stand below a section of a docstring come before it: sections end where the next one starts."""
    head, *sections = re.split(r"\n(?=[A-Z]\w+\n---+\n)", text)
    for i, section in enumerate(sections):
        blocks = re.split(r"\n\s*\n", section.rstrip())
        below = [b for b in blocks[1:] if "\n " not in b and not b.startswith((" ", "..", ">>>"))]
        sections[i] = "\n\n".join(b for b in blocks if b not in below) + "\n"
        head = "\n\n".join([head.rstrip(), *below, ""]) if below else head
    return "\n".join([head, *sections])


def _plain(found: re.Match[str]) -> str:
    return f"[{found[1]}] {' '.join(found[2].split())}\n"


def _sources(thing: Any) -> dict[str, str]:
    """Lines that the docstring of the file that holds a thing gives as sources, by number."""
    module = sys.modules.get(getattr(thing, "__module__", None) or "")
    text = inspect.getdoc(module) or "" if module else ""
    found = re.finditer(r"^\s*\.\. \[(\d+)\] (.*(?:\n {3,}.*)*)", text, re.M)
    return {one[1]: _plain(one).strip() for one in found}


def _marked(part: str) -> str:
    """A piece of code with an end that a following letter does not undo; else text whose bars are bars."""
    return f"{part}\0" if part.startswith("``") else re.sub(r"(?<!\\)\|", r"\\|", part)
