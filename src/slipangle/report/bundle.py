"""The part of plotly.js that a page needs: the whole is 4.8 MB, of which three quarters draw maps, globes and solids.

Plotly comes as one file of small modules, each run when another one asks for it, and a last one that asks for every
kind of trace. Asking for the kinds that a page draws, and leaving out the modules that nobody asks for any more, gives
the same program in a quarter of the size. Where the file is not as expected, the whole of it is taken.
"""

from __future__ import annotations

import base64
import gzip
import re
from functools import cache

from plotly.offline import get_plotlyjs

_MODULE = re.compile(r"var ([\w$]+)=[\w$]+\((?:\([\w$,]*\)|[\w$]+)=>\{")
_CALL = re.compile(r"([\w$]+)\(\)")
_REGISTER = re.compile(r"\.register\(\[((?:[\w$]+\(\),){10,}[\w$]+\(\))\]\)")
_TRACE = re.compile(r'moduleType:"trace",name:"(\w+)"')
_EXPORT = re.compile(r"\.exports=([\w$]+)\(\)")


def packed(kinds: frozenset[str]) -> str:
    """`bundle` as base64 of gzip, for a script element that the page unpacks."""
    return base64.b64encode(gzip.compress(bundle(kinds).encode(), 9, mtime=0)).decode()


@cache
def bundle(kinds: frozenset[str]) -> str:
    """plotly.js with these kinds of traces, such as ``{"scatter", "box"}``; scatter is always in it."""
    return smaller(get_plotlyjs(), kinds) or get_plotlyjs()


def smaller(source: str, kinds: frozenset[str]) -> str:
    """The source without the modules that these kinds of traces do not ask for; empty where it is not as expected."""
    starts = [m.start() for m in _MODULE.finditer(source)]
    entries = [m for m in _REGISTER.finditer(source)]
    if len(starts) < 100 or len(entries) != 1:
        return ""
    entry = entries[0]
    ends = [*starts[1:], source.find(";", entry.end()) + 1]
    names = [_MODULE.match(source, a).group(1) for a in starts]  # type: ignore[union-attr]  # they were found there
    text = {name: source[a:b] for name, a, b in zip(names, starts, ends, strict=True)}
    known = _traces(_CALL.findall(entry.group(1)), text)
    wanted = kinds - {"scatter"}
    if len(text) < len(names) or not wanted <= set(known):
        return ""
    last = names[-1]
    if not starts[-1] < entry.start() < ends[-1]:
        return ""
    chosen = ",".join(f"{known[kind]}()" for kind in sorted(wanted))
    text[last] = text[last].replace(entry.group(0), f".register([{chosen}])")
    before, after = source[: starts[0]], source[ends[-1] :]
    kept = _reached(
        text, [last, *(n for n, t in text.items() if not t.rstrip().endswith("});")), *_CALL.findall(after)]
    )
    return before + "".join(text[name] for name in names if name in kept) + after


def _traces(asked: list[str], text: dict[str, str]) -> dict[str, str]:
    """Names of the modules that were asked for, by the kind of trace they draw."""
    found = {}
    for name in asked:
        inner = _EXPORT.search(text.get(name, ""))
        kind = _TRACE.search(text.get(inner.group(1), "")) if inner else None
        if kind:
            found[kind.group(1)] = name
    return found


def _reached(text: dict[str, str], first: list[str]) -> set[str]:
    """Modules that are asked for, directly or by one that is; a local name that looks like one does no harm."""
    kept: set[str] = set()
    left = list(first)
    while left:
        name = left.pop()
        if name not in kept and name in text:
            kept.add(name)
            left += _CALL.findall(text[name])
    return kept
