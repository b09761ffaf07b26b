"""Pages of the API reference, from the source: every class and function of `public`, each on the page of its room."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

from docs.site.public import PAGES, members, page_of, public

import slipangle
from slipangle.models.parameters import ParameterSet

_INDEX = """\
# API reference

Made from the source. `import slipangle as sa`; every name of `sa` is here with all its methods, then what its calls
return and what it inherits from. Arrays have shape `(n_samples, n_channels)`, values are in SI units and radians
([nomenclature](../nomenclature.md)); errors are those of [the last page](rest.md), each a `ValueError` with one
sentence.

{lists}

```{{toctree}}
:hidden:
{names}
```
"""


def write_pages(folder: Path) -> None:
    """Write ``index.md`` and a page for each room into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    named = {getattr(slipangle, name): name for name in slipangle.__all__}
    things = public()
    lists = []
    for key, (title, _) in PAGES.items():
        here = {full: thing for full, thing in things.items() if page_of(thing) == key}
        ours = sorted((full for full in here if here[full] in named), key=lambda f: named[here[f]].lower())
        rest = [full for full in here if full not in ours]
        lines = [f"({key}-reference)=", f"# {title}", ""]
        for head, group in (("Of slipangle", ours), ("What these return and inherit", rest)):
            lines += [f"## {head}", ""] if group else []
            for full in group:
                lines += _entry(full, here[full], named.get(here[full]))
        (folder / f"{key}.md").write_text("\n".join(lines), encoding="utf-8")
        shown = ", ".join(f"[`{named[here[full]]}`](#{full})" for full in ours)
        lists.append(f"**[{title}]({key}.md)**: {shown or 'what all rooms share.'}\n")
    names = "\n".join(PAGES)
    (folder / "index.md").write_text(_INDEX.format(lists="\n".join(lists), names=names), encoding="utf-8")


def _entry(full: str, thing: Any, short: str | None) -> list[str]:
    """Directives for one class or function, under the name that a user types."""
    title = f"sa.{short}" if short else thing.__qualname__
    kind = "autoclass" if inspect.isclass(thing) else "autofunction"
    lines = [f"### {title}", "", "```{eval-rst}", f".. {kind}:: {full}"]
    if inspect.isclass(thing):
        own = list(members(thing))
        lines += [f"   :members: {', '.join(own)}"] if own else []
        lines += ["   :show-inheritance:", "   :member-order: bysource"]
    lines += ["```", ""]
    if inspect.isclass(thing) and issubclass(thing, ParameterSet):
        lines += _parameters(thing)
    return lines


def _parameters(kind: type[ParameterSet]) -> list[str]:
    """Table of a record whose fields carry unit, meaning and range."""
    lines = ["| parameter | meaning | unit | from | to |", "|---|---|---|---|---|"]
    lines += [f"| `{n}` | {si.doc} | {si.unit} | {si.lower:g} | {si.upper:g} |" for n, si in kind.metadata().items()]
    return [*lines, ""] if len(lines) > 2 else []
