"""Lines of a ``.tir`` file: what each says, and how one is written with another value."""

import math
import re
import string
from dataclasses import dataclass, replace

from slipangle.data.numerals import to_number
from slipangle.errors import FormatError, shown

SECTION = re.compile(r"\[\s*([^\]]+?)\s*\]\s*$")
_KEY = re.compile(r"[A-Za-z_][\w.\-]*$")
_COEFFICIENT = re.compile(r"[A-Z][A-Z_]*\d+$")
_OPENS_WORDS = frozenset("(" + string.ascii_letters)
_WORD = re.compile(r"[A-Za-z_][\w .\-/]*$")


@dataclass(frozen=True, kw_only=True)
class TirLine:
    """One line of the file: as it stands, its number from 1 (0 if it was added), the heading above it in capitals.

    An entry has a key in capitals, a value in the units of the file (None where that is blank) and a comment; a line
    of a table has a row of numbers. ``wrapped`` is the rest of the comment in the line above.
    """

    text: str  # as it stands
    number: int = 0  # from 1; 0 if it was added
    section: str = ""  # heading above it, in capitals
    key: str = ""  # in capitals; empty where the line is no entry
    value: float | str | None = None  # in the units of the file; None where it is blank
    comment: str = ""  # what follows the value
    row: tuple[float, ...] = ()  # numbers of a line of a table, in the units of the file
    wrapped: bool = False


def parse_line(text: str, number: int, section: str, name: str, *, above: str = "") -> TirLine:
    """What a line says, in the section before it unless it opens another.

    Words below a line with a comment, ``above``, are the rest of that comment, unless they look like a key and its
    value.

    Raises FormatError if it cannot be read, with its number.
    """
    body, comment = _split_comment(text)
    body = body.strip()
    line = TirLine(text=text, number=number, section=section, comment=comment)
    if not body or body.startswith("{"):
        return line
    heading = SECTION.match(body)
    if heading:
        return replace(line, section=heading[1].upper())
    key, equals, value = (part.strip() for part in body.partition("="))
    if equals and _KEY.match(key):
        return replace(line, key=key.upper(), value=_parse_value(value, key, number, name))
    row = tuple(_to_float(word) for word in body.split())
    if above and not equals and body[0] in _OPENS_WORDS and not _like_an_entry(body, row):
        return replace(line, comment=text.strip(), wrapped=True)
    if equals or not section or not all(math.isfinite(x) for x in row):
        raise FormatError(
            f"line {number} of '{name}' reads {text.strip()[:60]!r}; expected a [SECTION], a 'KEY = value' line, "
            "a row of numbers or a comment after '!' or '$': correct that line"
        )
    return replace(line, row=row)


def _like_an_entry(body: str, row: tuple[float, ...]) -> bool:
    """Whether a line reads like ``PKY1 -20.5`` or ``MASS 9``."""
    first = body.split()[0].rstrip(":")
    return bool(_COEFFICIENT.match(first)) or (len(row) > 1 and bool(_KEY.match(first)) and math.isfinite(row[1]))


def _split_comment(text: str) -> tuple[str, str]:
    """The line before its comment, and the comment; quoted '!' and '$' do not start one."""
    quote = ""
    for i, char in enumerate(text):
        if quote:
            quote = "" if char == quote else quote
        elif char in "'\"":
            quote = char
        elif char in "!$":
            return text[:i], text[i + 1 :].strip()
    return text, ""


def _parse_value(value: str, key: str, number: int, name: str) -> float | str | None:
    if not value:
        return None
    if value[0] in "'\"":
        if len(value) > 1 and value.endswith(value[0]):
            return value[1:-1].strip()
    else:
        parsed = _to_float(value)
        if math.isfinite(parsed):
            return parsed
        if _WORD.match(value) and value.lower() not in ("nan", "inf", "infinity"):
            return value
    hint = " (a point, not a comma, separates decimals)" if "," in value else ""
    raise FormatError(
        f"line {number} of '{name}' gives {key} the value {shown(value)}; expected a number or a quoted text{hint}: "
        "correct that line"
    )


def _to_float(word: str) -> float:
    """The number, Fortran's exponent D included; NaN where it is none."""
    try:
        return to_number(word)
    except ValueError:
        try:
            fortran = re.fullmatch(r"([-+.\d]+)[dD]([-+]?\d+)", word)
            return float(f"{fortran[1]}e{fortran[2]}") if fortran else math.nan
        except ValueError:
            return math.nan


def _format(value: float | str | None) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        return f"'{value}'"
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)


def rewritten(line: TirLine, value: float | str | None, comment: str) -> TirLine:
    """The line with another value and comment, its layout kept where they fit."""
    body, _ = _split_comment(line.text)
    start = body.index("=") + 1
    lead = body[start:][: len(body[start:]) - len(body[start:].lstrip())] if body[start:].strip() else " "
    tail_at = line.text.find("$", len(body)) if len(body) < len(line.text) else -1
    mark = line.text[len(body)] if len(body) < len(line.text) else "$"
    head = body[:start] + lead + _format(value)
    if not comment:
        text = head
    elif comment == line.comment and len(body) < len(line.text):
        text = head + " " * max(1, len(body) - len(head)) + line.text[len(body) :]
    else:
        text = head + " " * max(1, (tail_at if tail_at > 0 else len(body)) - len(head)) + mark + comment
    return replace(line, text=text, value=value, comment=comment)


def new_line(section: str, key: str, value: float | str | None, comment: str) -> TirLine:
    """A line for a key that the file does not have yet."""
    text = f"{key:<24} = {_format(value)}"
    return TirLine(
        text=f"{text:<48}${comment}" if comment else text, section=section, key=key, value=value, comment=comment
    )


def insert_line(lines: list[TirLine], section: str, new: TirLine) -> None:
    """Put a line behind the last entry of its section, or open the section at the end."""
    for i in range(len(lines) - 1, -1, -1):
        if lines[i].section == section and (lines[i].key or lines[i].row or SECTION.match(lines[i].text.strip())):
            lines.insert(i + 1, new)
            return
    lines.extend([TirLine(text=f"[{section}]", section=section), new])
