"""Tables once, shown twice: aligned text for the terminal, HTML for the page."""

import html
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from slipangle.errors import ParameterError
from slipangle.models.model import FitInfo
from slipangle.report.style import pretty_unit
from slipangle.report.why import why_html

Tone = Literal["good", "fair", "poor"]
Cell = str | float | int | bool | None

_UNIT = r"(?:%|°|[kmµ]?[msgNV]|Hz|rad|deg|km|kg|bar|rpm)(?:/(?:s|h|rad|deg)[²2]?|[ ]?m[²2])?"
_BEFORE_UNIT = re.compile(rf"(\d) ({_UNIT})(?![\w/])")
_IN_NUMBER = re.compile(r"(?<=\d) (?=\d{3}(?!\d))")  # between thousands


def number(value: Cell, digits: int = 4) -> str:
    """A value in ``digits`` significant digits, plain where that reads well.

    >>> number(81.4567), number(-1234567.0), number(0.000012345), number(None), number(True)
    ('81.46', '-1 235 000', '1.234e-05', '–', 'yes')
    """
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (int, np.integer)):
        return f"{int(value):,}".replace(",", " ")
    value = float(value)
    if math.isnan(value):
        return "n/a"
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    if value == 0:
        return "0"
    size = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if not -4 <= size < 9:
        return f"{value:.{digits - 1}e}"
    rounded = round(value, digits - 1 - size)
    return f"{rounded:,.{max(digits - 1 - size, 0)}f}".replace(",", " ")


@dataclass(frozen=True)
class Heading:
    """Heading of a column: title, unit in brackets beside it, significant digits of its numbers.

    ``words`` is true for text: aligned to the left and allowed to wrap.
    """

    title: str
    unit: str = ""
    digits: int = 4
    words: bool = False

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title} [{pretty_unit(self.unit)}]" if self.unit else self.title


@dataclass(frozen=True)
class Row:
    """One row: a cell per column, with how it is meant, the command that reproduces it and a remark."""

    cells: tuple[Cell, ...]
    tone: Tone | None = None
    command: str = ""
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table for terminal and page: one cell per column in each row, an explanation and the command under it.

    ``warnings`` are sentences that a reader must not miss.

    Raises ParameterError if a row has another number of cells than there are columns.
    """

    title: str
    columns: tuple[Heading, ...]
    rows: tuple[Row, ...]
    caption: str = ""
    warnings: tuple[str, ...] = ()
    command: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", tuple(self.columns))
        object.__setattr__(self, "rows", tuple(self.rows))
        for k, row in enumerate(self.rows):
            if len(row.cells) != len(self.columns):
                raise ParameterError(
                    f"row {k} of the table '{self.title}' has {len(row.cells)} cells; expected {len(self.columns)}, "
                    "one per column: add or drop cells"
                )

    def texts(self) -> list[list[str]]:
        """Every cell as text, row by row."""
        return [[number(c, col.digits) for c, col in zip(r.cells, self.columns, strict=True)] for r in self.rows]

    def to_rich(self) -> RichTable:
        """The table for a rich console; user text is not taken as markup."""
        table = RichTable(
            title=Text(self.title, style="bold"),
            box=SIMPLE_HEAD,
            title_justify="left",
            caption=Text(self.caption) if self.caption else None,
            caption_justify="left",
            pad_edge=False,
        )
        for column in self.columns:
            table.add_column(
                Text(column.heading, no_wrap=False),
                justify="left" if column.words else "right",
                no_wrap=not column.words,
                overflow="fold",
            )
        styles = {"good": "green", "fair": "yellow", "poor": "bold red", None: ""}
        for row, texts in zip(self.rows, self.texts(), strict=True):
            table.add_row(*(Text(t) for t in texts), style=styles[row.tone])
        return table

    def to_text(self, width: int = 120) -> str:
        """The table as aligned plain text without colour, notes and commands below it."""
        stream = io.StringIO()
        console = Console(file=stream, width=width, color_system=None, highlight=False, emoji=False, markup=False)
        console.print(self.to_rich())
        lines = [line.rstrip() for line in stream.getvalue().splitlines()]
        lines += self._remarks()
        commands = [self.command, *(row.command for row in self.rows)]
        lines += [f"$ {command}" for command in dict.fromkeys(commands) if command]
        return "\n".join(lines).strip("\n") + "\n"

    def _remarks(self) -> list[str]:
        """Warnings and what is noted of single rows, a line each."""
        lines = [f"warning: {' '.join(sentence.split())}" for sentence in self.warnings]
        names = [texts[0] if texts else "" for texts in self.texts()]
        notes = [
            f"{name}: {' '.join(row.note.split())}" for name, row in zip(names, self.rows, strict=True) if row.note
        ]
        return lines + notes

    def to_markdown(self) -> str:
        """The table as Markdown: title, rows, explanation, warnings, notes."""
        rule = [":--" if c.words else "--:" for c in self.columns]
        rows = [[c.heading for c in self.columns], rule, *self.texts()]
        lines = ["| " + " | ".join(t.replace("|", "\\|") for t in row) + " |" for row in rows]
        under = [t for text in (self.caption, *self._remarks()) if text for t in ("", text)]
        return "\n".join([f"**{self.title}**", "", *lines, *under]) + "\n"

    def to_latex(self) -> str:
        r"""The table for LaTeX with ``\usepackage{booktabs}``; text is escaped, exponents and signs are LaTeX's.

        Warnings and notes are comments above it, for its author to decide on.
        """
        kinds = "".join("l" if c.words else "r" for c in self.columns)
        rows = [" & ".join(map(latex, row)) + r" \\" for row in self.texts()]
        head = " & ".join(latex(c.heading) for c in self.columns) + r" \\"
        inside = [r"\toprule", head, r"\midrule", *rows, r"\bottomrule"]
        inside = [r"\begin{tabular}{" + kinds + "}", *inside, r"\end{tabular}"]
        inside += [r"\caption{" + latex(f"{self.title}. {self.caption}".strip()) + "}"]
        remarks = [f"% {line}" for line in self._remarks()]
        return "\n".join([*remarks, r"\begin{table}", r"\centering", *inside, r"\end{table}"]) + "\n"

    def _repr_html_(self) -> str:
        return f"<b>{html.escape(self.title)}</b>{self.to_html()}"

    def to_html(self) -> str:
        """The table as HTML; all text is escaped."""
        head = "".join(
            f'<th scope="col"{"" if c.words else " class=num"}>{html.escape(c.heading)}</th>' for c in self.columns
        )
        body = "".join(self._row_html(row, texts) for row, texts in zip(self.rows, self.texts(), strict=True))
        table = f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
        under = f"<p>{typeset(self.caption)}</p>" if self.caption else ""
        under += command_html(self.command)
        items = "".join(
            f'<li><span class="mark poor" title="warning"></span><span>{typeset(w)}{why_html(w)}</span></li>'
            for w in self.warnings
        )
        table += f'<ul class="findings">{items}</ul>' if items else ""
        return table + (f'<div class="caption">{under}</div>' if under else "")

    def _row_html(self, row: Row, texts: Sequence[str]) -> str:
        cells = []
        for k, (text, column) in enumerate(zip(texts, self.columns, strict=True)):
            mark = f'<span class="mark {row.tone}" title="{row.tone}"></span>' if k == 0 and row.tone else ""
            tag, scope = ("th", ' scope="row"') if k == 0 else ("td", "")
            short = "short" if len(text) <= 24 else ""
            kinds = [k for k in (short if column.words else "num", "marked" if mark else "") if k]
            kind = f' class="{" ".join(kinds)}"' if kinds else ""
            cells.append(f"<{tag}{scope}{kind}>{mark}{html.escape(text)}</{tag}>")
        extra = (f'<p class="note">{typeset(row.note)}</p>' if row.note else "") + command_html(row.command)
        if not extra:
            return f"<tr>{''.join(cells)}</tr>"
        return (
            f'<tr class="with-extra">{"".join(cells)}</tr>'
            f'<tr class="extra"><td colspan="{len(self.columns)}">{extra}</td></tr>'
        )


_LATEX = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
_LATEX |= {c: "\\" + c for c in "&%$#_{}"}
_LATEX |= {"±": r"$\pm$", "²": r"\textsuperscript{2}", "³": r"\textsuperscript{3}", "∞": r"$\infty$", "–": "--"}
_LATEX |= {"°": r"\textdegree{}", "µ": r"\textmu{}", "<": r"\textless{}", ">": r"\textgreater{}", "\u00a0": "~"}
_THOUSANDS = re.compile(r"(?<=\d) (?=\d{3}(?!\d))")


def latex(text: str) -> str:
    r"""Text for LaTeX.

    >>> latex("C_f = 81 200 N/rad, 5 %")
    'C\\_f = 81\\,200 N/rad, 5 \\%'
    """
    return _THOUSANDS.sub(r"\,", "".join(_LATEX.get(c, c) for c in text))


def typeset(text: str) -> str:
    r"""Escaped text in which no line breaks inside a number or between it and its unit, with ± for +-.

    >>> typeset("5 < 165 s of <b> 12 300").split(" ")[2:]
    ['165\xa0s', 'of', '&lt;b&gt;', '12\xa0300']
    """
    whole = _BEFORE_UNIT.sub("\\1\u00a0\\2", text.replace(" +- ", " ± "))
    return html.escape(_IN_NUMBER.sub("\u00a0", whole))


def command_html(command: str) -> str:
    """A command in monospace, for the page."""
    return f'<pre class="command"><code>{html.escape(command)}</code></pre>' if command else ""


def published(value: Cell, digits: int = 4) -> str:
    """A number of somebody else's, without digits that they did not give.

    >>> published(0.054), published(72.87), published(5.0)
    ('0.054', '72.87', '5')
    """
    text = number(value, digits)
    if isinstance(value, (float, np.floating)) and "." in text and "e" not in text:
        text = text.rstrip("0").rstrip(".")
    return text


@dataclass(frozen=True, kw_only=True)
class ScoreRow:
    """How well one output of one model is predicted; fit and VAF in percent, RMSE in the output's unit.

    ``kind`` is ``"free run"`` or ``"one-step-ahead"``; ``tone`` is how the row is meant, ``command`` reproduces it.
    """

    model: str
    channel: str
    unit: str
    kind: str
    fit: float | None
    vaf: float | None
    r2: float | None
    rmse: float | None
    tone: Tone | None = None
    command: str = ""
    note: str = ""


def score_table(
    scores: Sequence[ScoreRow], *, title: str = "Free run beside one-step-ahead", caption: str = "", command: str = ""
) -> Table:
    """Scores of models and published results, one row each."""
    units = {s.unit for s in scores}
    shared = units.pop() if len(units) == 1 else ""
    return Table(
        title=title,
        columns=(
            *(Heading(name, words=True) for name in ("model", "output", "prediction")),
            Heading("fit", "%"),
            Heading("VAF", "%"),
            Heading("R²", "-"),
            Heading("RMSE", shared, 3),
        ),
        rows=tuple(
            Row(
                (s.model, s.channel, s.kind, s.fit, _zero(s.vaf), s.r2, _with_unit(s.rmse, "" if shared else s.unit)),
                tone=s.tone,
                command=s.command,
                note=s.note,
            )
            for s in scores
        ),
        caption=caption,
        command=command,
    )


def _zero(value: float | None) -> float | None:
    """Zero for what rounding leaves of it."""
    return 0.0 if value is not None and abs(value) < 1e-9 else value


def _with_unit(value: float | None, unit: str) -> Cell:
    return f"{number(value, 3)} {pretty_unit(unit)}" if value is not None and unit and unit != "-" else value


def orders_table(fit: FitInfo, *, title: str = "Orders that were compared", most: int = 20, command: str = "") -> Table:
    """The best ``most`` candidates of an estimator that chose its orders, the chosen one first, unstable ones poor.

    Raises ParameterError if no orders were compared.
    """
    if not fit.candidates:
        raise ParameterError("the fit compared no orders; expected one that chose: leave na, nb and nk out")
    rows = [
        Row(
            (c.orders, c.n_parameters, 100 * c.error, 100 * c.one_step_error, c.aic, c.bic, c.fpe),
            tone="poor" if not c.stable else "good" if k == 0 else None,
        )
        for k, c in enumerate(fit.candidates[:most])
    ]
    left = len(fit.candidates) - len(rows)
    more = f" {left} that did worse are left out." if left else ""
    columns = (Heading("orders", words=True), Heading("coefficients"), Heading("free run", "%"))
    columns += (Heading("one step ahead", "%"), Heading("AIC", digits=6), Heading("BIC", digits=6), Heading("FPE"))
    return Table(
        title=title,
        columns=columns,
        rows=tuple(rows),
        caption="Errors on stretches held out in turn, RMSE over standard deviation; AIC, BIC and FPE of the data "
        f"fitted to, one step ahead, outputs over their standard deviations.{more}",
        command=command,
    )


def lost(value: float, half: float) -> bool:
    """Whether a value is 0 to the digits of its uncertainty: it is a hundredth of that and less."""
    return math.isfinite(half) and abs(value) <= 0.01 * half


def to_digit(value: float, half: float) -> str:
    """A value written to the second significant digit of its uncertainty; 0 where it is `lost` in that.

    >>> to_digit(112345.678, 2345.6), to_digit(0.99996, 0.071), to_digit(1e-9, 0.1)
    ('112 300', '1.000', '0')
    """
    if lost(value, half):
        return "0"
    if not (math.isfinite(value) and math.isfinite(half)) or half <= 0 or value == 0:
        return number(value)
    decimals = 1 - math.floor(math.log10(half))
    digits = math.floor(math.log10(abs(round(value, decimals) or value))) + decimals + 1
    return number(value, min(max(digits, 2), 8))
