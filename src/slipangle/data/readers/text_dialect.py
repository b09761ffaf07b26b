"""How a text file writes a table: its separator, where the headings are, what is a number, a date or a unit."""

import csv
import re
from collections.abc import Sequence
from datetime import UTC, datetime

from slipangle import units
from slipangle.data.numerals import is_number
from slipangle.data.readers.tables import DATE, Header
from slipangle.errors import FormatError, raises

MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "inf", "+inf", "-inf", "infinity"}
_INSTANT = re.compile(r"\d{4}([-/])\d\d\1\d\d[T ]\d\d:\d\d(:\d\d([.,]\d+)?)?( ?(Z|UTC|[+-]\d\d:?\d\d))?")
_DOTTED = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})[T ]+(\d{1,2}:\d\d(:\d\d([.,]\d+)?)?)")  # day.month.year
_AMBIGUOUS = re.compile(r"\d{1,2}/\d{1,2}/\d{1,4}\b.*|.*\d\s*[AaPp][Mm]")
_CLOCK = re.compile(r"(\d{1,3}):([0-5]\d):([0-5]\d([.,]\d+)?)")
_LAP = re.compile(r"(\d{1,4}):([0-5]\d[.,]\d+)")  # minutes and seconds, which alone have decimals
_RATED = re.compile(r'"?([^|"]+)"?\|"?([^|"]*)"?\|[^|]*\|[^|]*\|(\d{1,6}(?:\.\d+)?)')  # RaceCapture
_ROWS = 3  # of numbers make a table begin


def cells_of(line: str, delimiter: str | None) -> list[str]:
    """The cells of a line; a delimiter of None cuts at blanks.

    Raises FormatError if quotes make no sense.
    """
    if delimiter is None and '"' not in line:
        return line.split()
    try:
        if delimiter is None:
            return next(csv.reader([" ".join(line.split())], delimiter=" "))
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except csv.Error as error:
        raise FormatError(
            f"a line that starts with {line[:40]!r} cannot be cut into cells ({error}); expected text cut by "
            f"{delimiter!r}: export the log again, or name the separator with delimiter="
        ) from None


def separator_of(lines: Sequence[str]) -> str | None:
    """The separator that cuts most lines into the same number of cells; None for blanks."""
    best, score = None, (0.0, 0)
    for candidate in (";", "\t", ",", "|", None):
        counts = [len(cells_of(line.strip() if candidate is None else line, candidate)) for line in lines]
        usual = max(set(counts), key=counts.count)
        share = counts.count(usual) / len(counts)
        if usual > 1 and (share > score[0] + 1e-9):
            best, score = candidate, (share, usual)
    return best


def _is_number(cell: str, decimal_comma: bool = False) -> bool:
    text = cell.strip()
    if text.lower() in MISSING:
        return True
    return is_number(text.replace(",", ".") if decimal_comma else text)


def is_value(cell: str, decimal_comma: bool = False) -> bool:
    """Whether a cell is a number, missing, a date or a time of day."""
    return _is_number(cell, decimal_comma) or is_instant(cell)


def is_instant(cell: str) -> bool:
    """Whether a cell is a date with a time, as ISO 8601 or day.month.year, a time of day with seconds or a lap's."""
    text = cell.strip()
    dated = _INSTANT.fullmatch(text) or _DOTTED.fullmatch(text)
    return bool(_CLOCK.fullmatch(text) or _LAP.fullmatch(text)) or (
        bool(dated) and not raises(ValueError, to_instant, text)
    )


def is_ambiguous(cell: str) -> bool:
    """Whether a cell may be a date of which nobody knows what is the day and what the month, or half a clock."""
    return bool(_AMBIGUOUS.fullmatch(cell.strip()))


def to_instant(cell: str) -> float:
    """Seconds since 1970, or since midnight or a lap's start, of a date or a time; without a zone it counts as UTC. [s]

    Raises ValueError if it is neither.

    >>> to_instant("1970-01-02T00:00:01.500Z"), to_instant("02.01.1970 00:00:01,5"), to_instant("10:00:00.25")
    (86401.5, 86401.5, 36000.25)
    >>> to_instant("1970/01/02 00:00:01"), to_instant("1:02.345")
    (86401.0, 62.345)
    """
    text = cell.strip().replace(",", ".")
    clock = _CLOCK.fullmatch(text)
    if clock:
        return 3600.0 * int(clock[1]) + 60.0 * int(clock[2]) + float(clock[3])
    lap = _LAP.fullmatch(text)
    if lap:
        return 60.0 * int(lap[1]) + float(lap[2])
    dotted = _DOTTED.fullmatch(text)
    if dotted:
        day, month, year, hour = dotted.group(1, 2, 3, 4)
        text = f"{year}-{month:0>2}-{day:0>2} {hour if hour[1].isdigit() else '0' + hour}"
    instant = datetime.fromisoformat(text.replace("/", "-").removesuffix("UTC").strip())
    return (instant if instant.tzinfo is not None else instant.replace(tzinfo=UTC)).timestamp()


def parse_heading(text: str) -> Header:
    """Name and unit of a column heading.

    Brackets always hold a unit; parentheses and what follows a comma only if it is a known one. RaceCapture writes
    name, unit, range and rate with bars between them.

    >>> parse_heading("vx(m/s)").name, parse_heading("brake [kPa]").unit, parse_heading("acc x (IMU)").name
    ('vx', 'kPa', 'acc x (IMU)')
    """
    rated = _RATED.fullmatch(text.strip())
    if rated:
        unit, rate = rated[2].strip() or None, float(rated[3])
        return Header(text=text.strip(), name=rated[1].strip(), unit=unit, rate=rate or None)
    clean = text.strip().strip("\"'").strip()
    bracket = re.fullmatch(r"(.+?)\s*\[([^\[\]]*)\]", clean)
    if bracket:
        return Header(text=clean, name=bracket[1], unit=bracket[2].strip())
    for pattern in (r"(.+?)\s*\(([^()]*)\)", r"(.+?)\s*,\s*([^,]+)"):
        match = re.fullmatch(pattern, clean)
        if match and match[2].strip() and units.known(match[2]):
            return Header(text=clean, name=match[1], unit=match[2].strip())
    return Header(text=clean, name=clean)


def _headings(cells: list[str], unit_row: list[str] | None) -> tuple[Header, ...]:
    headers = [parse_heading(c) for c in cells]
    if unit_row is not None:
        cleaned = [_bare(u) for u in unit_row]
        headers = [
            h if h.unit is not None or u in ("", "1") else Header(text=h.text, name=h.name, unit=u)
            for h, u in zip(headers, cleaned, strict=True)
        ]
    return tuple(headers)


def find_headings(
    rows: list[list[str]], comments: list[str], delimiter: str | None, comma: bool
) -> tuple[bool, tuple[Header, ...], int]:
    """Whether there are headings, what they are, and how many lines of the body end with them."""
    skip = _lines_above(rows, comma)
    rows = rows[skip:]
    if not all(is_value(c, comma) for c in rows[0]):
        second = rows[1] if len(rows) > 1 and len(rows[1]) == len(rows[0]) else []
        has_units = _are_units(second)
        headers = _headings(rows[0], second if has_units else None)
        return True, _dated(headers, rows[2 if has_units else 1 :]), skip + (2 if has_units else 1)
    for comment in reversed(comments):
        cells = cells_of(comment, delimiter)
        if len(cells) == len(rows[0]) and not all(is_value(c, comma) for c in cells):
            return True, _dated(_headings(cells, None), rows), 0
    unnamed = tuple(Header(text=f"column {i}", name=f"column {i}") for i in range(len(rows[0])))
    return False, _dated(unnamed, rows), 0


def _are_units(cells: list[str]) -> bool:
    """Whether a line under the headings holds units: no numbers, and most of what stands there is known.

    A number without a unit has a bar there, or none, or 1, of which there are fewer than of units.
    """
    said = [c for c in map(_bare, cells) if c]
    named = [c for c in said if c != "1"]
    if not said:
        return bool(cells) and not any(c.strip() for c in cells)
    if any(map(is_value, named)) or 2 * len(named) <= len(said):
        return False
    return 2 * sum(map(units.known, named)) >= len(named)


def _bare(cell: str) -> str:
    """A cell of a line of units without brackets; empty where it says that there is none."""
    text = cell.strip().strip("[]()")
    return "" if text.lower() in MISSING else text


def _lines_above(rows: list[list[str]], comma: bool) -> int:
    """How many lines stand above the headings, as MoTeC i2 and AiM write them; 0 where the first line begins the table.

    The table is where lines of equally many numbers begin; the line above it, or the one above a line of units there,
    has the headings.
    """
    table = [len(r) > 1 and any(c.strip() for c in r) and all(is_value(c, comma) for c in r) for r in rows]
    for first in range(min(3, len(rows))):
        if table[first] and all(len(r) == len(rows[first]) for r in rows[:first]):
            return 0
    for first in range(2, len(rows) - _ROWS + 1):
        width = len(rows[first])
        block = range(first, first + _ROWS)
        if not all(table[k] and len(rows[k]) == width for k in block) or len(rows[first - 1]) != width:
            continue
        units_too = first > 1 and len(rows[first - 2]) == width and _are_units(rows[first - 1])
        return first - 2 if units_too else first - 1
    return 0


def _dated(headers: tuple[Header, ...], rows: list[list[str]]) -> tuple[Header, ...]:
    """The same with ``date`` as the unit of columns that hold instants."""
    cells = next((r for r in rows if all(c.strip() for c in r) and len(r) == len(headers)), rows[0] if rows else [])
    if len(cells) != len(headers):
        return headers
    return tuple(
        Header(text=h.text, name=h.name, unit=DATE) if is_instant(c) else h for h, c in zip(headers, cells, strict=True)
    )


def filled(line: str, delimiter: str) -> str:
    """The line with ``nan`` in its empty cells; quotes that hold a separator are left to whoever reads it."""
    cells = line.split(delimiter)
    return delimiter.join(c if c.strip(' "\t\r') else "nan" for c in cells)
