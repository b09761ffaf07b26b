"""What a setting means, in the words of the docstring that stands with it."""

import inspect
import re
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

_ENTRY = re.compile(r"^(\S.*?)(?: : .*)?$")
_CITED = re.compile(r" \[\d\]_[^.,]*(?:, \[\d\]_[^.,]*)*(?:\.\d+[^.,]*)*\.?(?=$)")  # at the end of a sentence
_SEE = re.compile(r"See `(\w+)`")


def meaning(thing: Callable[..., Any], name: str) -> str:
    """One line on a field or parameter: the first sentence of its docstring, with the unit behind it.

    A sentence "See `Other`" stands for that one's. Empty if nothing is said.
    """
    for home in inspect.getmro(thing) if isinstance(thing, type) else (thing,):
        text = _described(home).get(name, "")
        see = _SEE.match(text)
        if see:
            other = getattr(sys.modules[home.__module__], see.group(1))
            return meaning(other, name)
        if text:
            return _first(text)
    return ""


def summary(thing: Callable[..., Any]) -> str:
    """First paragraph of the docstring."""
    text = inspect.getdoc(thing) or ""
    return _CITED.sub("", " ".join(text.partition("\n\n")[0].split()))


def _first(text: str) -> str:
    """The first sentence, and units in brackets behind it."""
    found = re.match(r"(.*?\.)(?=\s+(?:[A-Z`]|\[)|$)((?:\s*\[[^\]]*\],?)*)", text)
    return (f"{found.group(1)}{found.group(2)}" if found else text).replace("``", "")


@cache
def _described(home: Callable[..., Any]) -> dict[str, str]:
    """Names and texts of the section "Parameters" of a docstring."""
    doc = inspect.cleandoc(home.__doc__ or "")
    _, found, rest = doc.partition("\nParameters\n----------\n")
    if not found:
        return {}
    texts: dict[str, list[str]] = {}
    own: list[str] = []
    for line in rest.splitlines():
        if not line.strip():
            break  # a blank line ends the section
        if line.startswith(" "):
            for name in own:
                texts[name].append(line.strip())
            continue
        entry = _ENTRY.match(line)
        own = [n.strip() for n in entry.group(1).split(",")] if entry else []
        texts |= {name: [] for name in own}
    return {name: " ".join(lines) for name, lines in texts.items()}
