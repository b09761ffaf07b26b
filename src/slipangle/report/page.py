"""One self-contained HTML page: verdict first, then what it rests on."""

from __future__ import annotations

import base64
import hashlib
import html
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Self

import numpy as np
import plotly.graph_objects as go

from slipangle.errors import ParameterError
from slipangle.files import write_atomic
from slipangle.report.bundle import bundle, packed
from slipangle.report.jsoned import jsoned
from slipangle.report.playback import Playback
from slipangle.report.style import dark_map, pretty_unit, template
from slipangle.report.tables import Cell, Table, Tone, command_html, number, published, typeset
from slipangle.report.why import why_html

# Nothing is fetched, and no script runs but those that are named by their own checksums: the browser refuses the rest.
_POLICY = "default-src 'none'; script-src {scripts}; style-src 'unsafe-inline'; img-src data: blob:"


@dataclass(frozen=True, kw_only=True)
class Number:
    """A key number in its unit, what it is compared to, whose that is, a remark, significant digits of both."""

    label: str
    value: Cell
    unit: str = ""
    reference: Cell = None
    reference_label: str = "thesis"
    note: str = ""
    digits: int = 4


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A judgement in one sentence, how it is meant, the key numbers it rests on, and what reproduces them.

    ``evidence`` are titles of the sections that it rests on, which it then links to.
    """

    title: str
    sentence: str
    tone: Tone
    numbers: tuple[Number, ...] = ()
    command: str = ""
    evidence: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A figure from `slipangle.report`'s functions or any other: what is seen, how to read it, what reproduces it."""

    title: str
    figure: go.Figure
    caption: str = ""
    command: str = ""


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Figures side by side where there is room, below each other where there is not."""

    figures: tuple[Figure, ...]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing seen in the data, as a sentence; without a tone it is a plain fact."""

    sentence: str
    tone: Tone | None = None


@dataclass(frozen=True, kw_only=True)
class Findings:
    """A list of findings."""

    title: str
    items: tuple[Finding, ...]

    @classmethod
    def of(cls, title: str, sentences: Iterable[str], tone: Tone | None = None) -> Self:
        """Findings that are meant alike."""
        return cls(title=title, items=tuple(Finding(sentence=s, tone=tone) for s in sentences))


@dataclass(frozen=True, kw_only=True)
class Text:
    """Paragraphs of plain text, separated by empty lines."""

    text: str


@dataclass(frozen=True, kw_only=True)
class Listing:
    """Lines of a file, such as a job's entry, as they are."""

    title: str
    text: str


Block = Verdict | Figure | Grid | Table | Findings | Text | Listing | Playback


@dataclass(frozen=True, kw_only=True)
class Section:
    """A part of the page: heading, blocks in order, a sentence under the heading, name in the navigation if another."""

    title: str
    blocks: tuple[Block, ...]
    lead: str = ""
    short: str = ""


@dataclass(frozen=True, kw_only=True)
class Fact:
    """Where the page comes from: version, data file, hash, machine, time."""

    label: str
    value: str


@dataclass(frozen=True, kw_only=True)
class Page:
    """A report that opens from disk without a network: the verdict first, provenance and what made it at the foot.

    Notes
    -----
    The part of plotly.js that the figures need is in the file once, see `slipangle.report.bundle`; a content security
    policy forbids every request. All texts are escaped. A command that is the page's own stands at the foot only.
    """

    title: str  # first heading
    sections: tuple[Section, ...]  # in order, the verdict first
    subtitle: str = ""  # below the title
    facts: tuple[Fact, ...] = ()  # provenance, at the foot
    command: str = ""  # that made the page
    renewed: int = 0  # s after which a browser loads it anew, while what it shows goes on; 0 for never

    def write(self, path: str | Path) -> Path:
        """Write the page whole or not at all, and return where it is.

        Raises WriteError if the place cannot be written.
        """
        return write_atomic(path, self.to_html())

    def to_html(self) -> str:
        """The whole page; raises ParameterError if it has no section."""
        if not self.sections:
            raise ParameterError(f"the page '{self.title}' has no section; expected at least one: add the verdict")
        ids = _Ids({"figure-settings", "plotly", "again", "copy"})
        names = [ids.new(section.short or section.title) for section in self.sections]
        links = "".join(
            f'<li><a href="#{name}">{html.escape(section.short or section.title)}</a></li>'
            for name, section in zip(names, self.sections, strict=True)
        )
        ids.links = {section.title: name for name, section in zip(names, self.sections, strict=True)}
        body = "".join(_section(section, name, ids) for name, section in zip(names, self.sections, strict=True))
        body = body.replace(command_html(self.command), "") if self.command else body
        subtitle = f'<p class="subtitle">{typeset(self.subtitle)}</p>' if self.subtitle else ""
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{self._policy()}">\n'
            + (f'<meta http-equiv="refresh" content="{self.renewed}">\n' if self.renewed else "")
            + '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{html.escape(self.title)}</title>\n<style>\n{_asset('page.css')}</style>\n</head>\n<body>\n"
            f'<a class="skip" href="#{names[0]}">To the results</a>\n<div class="layout">\n'
            f'<nav aria-label="Sections"><p class="name">slipangle</p><ol>{links}</ol></nav>\n'
            f"<header><h1>{html.escape(self.title)}</h1>{subtitle}</header>\n"
            "<main>\n<noscript><p>The figures need JavaScript; verdict and tables do not.</p></noscript>\n"
            f"{body}{self._footer()}</main>\n</div>\n{self._scripts()}</body>\n</html>\n"
        )

    def _footer(self) -> str:
        facts = "".join(f"<dt>{html.escape(f.label)}</dt><dd>{html.escape(f.value)}</dd>" for f in self.facts)
        inside = f"<dl>{facts}</dl>" if facts else ""
        if self.command:
            inside = (
                '<h3>To make this page again</h3><div class="again"><pre><code id="again">'
                f'{html.escape(self.command)}</code></pre><button type="button" id="copy">Copy</button></div>{inside}'
            )
        return f"<footer>{inside}</footer>\n" if inside else ""

    @property
    def _kinds(self) -> frozenset[str]:
        """Kinds of traces that are drawn; none where there is no figure."""
        drawn = [f.figure for section in self.sections for f in figures(section.blocks)]
        kinds = {trace.type or "scatter" for figure in drawn for trace in figure.data}
        return frozenset({"scatter", *kinds} if drawn else ())

    def _policy(self) -> str:
        """What the browser may run: the page's own script, the library it unpacks, and WebAssembly where it drives."""
        scripts = [_script(), *([bundle(self._kinds)] if self._kinds else [])]
        allowed = [f"'sha256-{_sha256(text)}'" for text in scripts]
        live = any(isinstance(b, Playback) and b.live for section in self.sections for b in section.blocks)
        return _POLICY.format(scripts=" ".join([*allowed, *(["'wasm-unsafe-eval'"] if live else [])]))

    def _scripts(self) -> str:
        kinds = self._kinds
        settings = jsoned({"template": template().to_plotly_json(), "dark": dark_map()})
        library = f'<script type="application/gzip" id="plotly">{packed(kinds)}</script>\n' if kinds else ""
        return (
            f'<script type="application/json" id="figure-settings">{settings}</script>\n'
            f"{library}<script>{_script()}</script>\n"
        )


def _script() -> str:
    """The page's own script."""
    return f"\n{_asset('page.js')}{_asset('playback.js')}"


def _sha256(text: str) -> str:
    """Checksum of a script as a policy names it."""
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


class _Ids:
    """Unique element ids from titles."""

    def __init__(self, taken: set[str]) -> None:
        self._taken = taken
        self.links: dict[str, str] = {}  # of the sections, by title

    def new(self, title: str) -> str:
        stem = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-") or "part"
        name, k = stem, 2
        while name in self._taken or f"{name}-data" in self._taken:
            name, k = f"{stem}-{k}", k + 1
        self._taken |= {name, f"{name}-data"}
        return name


def _section(section: Section, name: str, ids: _Ids) -> str:
    lead = f'<p class="lead">{typeset(section.lead)}</p>' if section.lead else ""
    blocks = "".join(_block(block, ids) for block in section.blocks)
    return f'<section id="{name}"><h2>{html.escape(section.title)}</h2>{lead}{blocks}</section>\n'


def _block(block: Block, ids: _Ids) -> str:
    match block:
        case Verdict():
            return _verdict(block, ids.links)
        case Figure():
            return _figure(block, ids)
        case Grid():
            kind = "grid three" if len(block.figures) == 3 else "grid"
            return f'<div class="{kind}">{"".join(_figure(f, ids) for f in block.figures)}</div>'
        case Table():
            return f'<div class="block"><h3>{html.escape(block.title)}</h3>{block.to_html()}</div>'
        case Findings():
            items = "".join(
                f'<li><span class="{f"mark {i.tone}" if i.tone else "plain"}" title="{i.tone or "fact"}"></span>'
                f"<span>{typeset(i.sentence)}{why_html(i.sentence)}</span></li>"
                for i in block.items
            )
            return f'<div class="block"><h3>{html.escape(block.title)}</h3><ul class="findings">{items}</ul></div>'
        case Listing():
            code = f'<pre class="command listing"><code>{html.escape(block.text)}</code></pre>'
            return f'<div class="block"><h3>{html.escape(block.title)}</h3>{code}</div>'
        case Text():
            return "".join(f"<p>{typeset(part.strip())}</p>" for part in block.text.split("\n\n") if part.strip())
        case Playback():
            return block.to_html()
    raise ParameterError(
        f"a section holds a {type(block).__name__}; expected Verdict, Figure, Grid, Table, Findings, Text or Playback: "
        "wrap it"
    )


def _verdict(verdict: Verdict, links: dict[str, str]) -> str:
    numbers = "".join(_number(n) for n in verdict.numbers)
    return (
        f'<div class="verdict"><h3 class="tone"><span class="mark {verdict.tone}"></span>'
        f'<span>{html.escape(verdict.title)}: <span class="{verdict.tone}">{verdict.tone}</span></span></h3>'
        f'<p class="sentence">{typeset(verdict.sentence)}{_evidence(verdict, links)}</p>'
        + (f'<dl class="numbers">{numbers}</dl>' if numbers else "")
        + command_html(verdict.command)
        + "</div>"
    )


def _evidence(verdict: Verdict, links: dict[str, str]) -> str:
    """Links to the sections that a verdict rests on."""
    found = [f'<a href="#{links[t]}">{html.escape(t.lower())}</a>' for t in verdict.evidence if t in links]
    return f' <span class="evidence">Evidence: {", ".join(found)}.</span>' if found else ""


def _number(item: Number) -> str:
    unit = pretty_unit(item.unit) if item.unit not in ("", "-") else ""
    shown = f'<span class="unit">{html.escape(unit)}</span>' if unit else ""
    parts = [
        f"<dt>{html.escape(item.label)}</dt>",
        f'<dd class="value">{html.escape(number(item.value, item.digits))}{shown}</dd>',
    ]
    if item.reference is not None:
        value = "\u00a0".join([published(item.reference, item.digits), *([unit] if unit else [])])
        whose = html.escape(item.reference_label)
        parts.append(f'<dd class="reference">{html.escape(value)} <span>{whose}</span></dd>')
    if item.note:
        parts.append(f'<dd class="remark">{typeset(item.note)}</dd>')
    return f"<div>{''.join(parts)}</div>"


def _figure(figure: Figure, ids: _Ids) -> str:
    name = ids.new(f"figure {figure.title}")
    spec: dict[str, Any] = figure.figure.to_dict()
    layout = dict(spec.get("layout", {}))
    layout.pop("template", None)  # the page holds the one template of all figures
    height = layout.get("height", 450)
    traces = [_even(own, trace.x) for own, trace in zip(spec.get("data", []), figure.figure.data, strict=True)]
    data = jsoned({"data": traces, "layout": layout})
    under = f"<p>{typeset(figure.caption)}</p>" if figure.caption else ""
    under += command_html(figure.command)
    return (
        f'<div class="block"><h3>{html.escape(figure.title)}</h3>'
        f'<div class="plot" id="{name}" style="height:{height:g}px" role="img" '
        f'tabindex="0" aria-label="{html.escape(f"{figure.title}. {figure.caption}".strip())}"></div>'
        f'<script type="application/json" id="{name}-data">{data}</script>'
        + (f'<div class="caption">{under}</div>' if under else "")
        + "</div>"
    )


def _even(trace: dict[str, Any], x: Any) -> dict[str, Any]:
    """A trace whose evenly spaced abscissae are said by where they begin and their step, half the page's weight."""
    if trace.get("type", "scatter") != "scatter" or not isinstance(x, np.ndarray) or len(x) < 50 or x.dtype.kind != "f":
        return trace
    first, step = float(x[0]), (float(x[-1]) - float(x[0])) / (len(x) - 1)
    if not step or not np.abs(x - (first + step * np.arange(len(x)))).max() < 2e-3 * abs(step):  # or one is not finite
        return trace
    return {k: v for k, v in trace.items() if k != "x"} | {"x0": round(first, 9), "dx": float(f"{step:.9g}")}


@cache
def _asset(name: str) -> str:
    return resources.files("slipangle.report").joinpath(name).read_text(encoding="utf-8")


def figures(blocks: Sequence[Block]) -> list[Figure]:
    """All figures among the blocks, those in grids too."""
    return [f for b in blocks for f in (b.figures if isinstance(b, Grid) else (b,)) if isinstance(f, Figure)]
