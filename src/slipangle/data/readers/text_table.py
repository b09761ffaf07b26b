"""Text tables of any separator: where the headings are, what is a number, what is a comment."""

import csv
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from slipangle import units
from slipangle.data.numerals import decoded, is_number, to_number
from slipangle.data.readers.columns import Header
from slipangle.errors import FormatError, MissingFileError, TooShortError, nearest, shown
from slipangle.files import read_bytes

_MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "inf", "+inf", "-inf", "infinity"}
OURS = "# slipangle: "  # begins the line that `write_csv` says its settings in
_COMMENTS = ("#", "%", "//")
_POINT = re.compile(r"[+-]?\d*\.\d+([eE][+-]?\d+)?")
_COMMA = re.compile(r"[+-]?\d*(,\d+)+([eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")


@dataclass(frozen=True, kw_only=True)
class TextTable:
    """A text file cut into cells; see `slipangle.data.readers.columns.ChannelTable`."""

    name: str
    headers: tuple[Header, ...]
    named: bool
    lines: tuple[str, ...]
    line_numbers: tuple[int, ...]
    delimiter: str | None
    decimal_comma: bool
    meta: Mapping[str, Any]

    def row_name(self, row: int) -> str:
        """The row as ``line`` and its number in the file, counted from 1."""
        return f"line {self.line_numbers[row]}"

    def numbers(self, column: int) -> np.ndarray:
        """The numbers of one column, NaN where a cell is empty, shape (n_rows,).

        Raises FormatError if a cell is not a number; its line and column are given.
        """
        if self._table is not None:
            return self._table[:, column]
        return np.array([self._number(row, column) for row in range(len(self.lines))])

    @cached_property
    def _table(self) -> np.ndarray | None:
        """All numbers at once, or None if a cell somewhere is empty or foreign."""
        lines = [line.replace(",", ".") for line in self.lines] if self.decimal_comma else self.lines
        try:
            return np.loadtxt(lines, delimiter=self.delimiter, ndmin=2, comments=None)
        except (ValueError, IndexError):
            return None

    @cached_property
    def _split(self) -> list[list[str]]:
        return [_cells(line, self.delimiter) for line in self.lines]

    def _number(self, row: int, column: int) -> float:
        cell = self._split[row][column].strip()
        text = cell.replace(",", ".") if self.decimal_comma else cell
        try:
            return to_number(text)
        except ValueError:
            if text.lower() in _MISSING:
                return np.nan
            raise FormatError(
                f"{self.name}, {self.row_name(row)}, column '{self.headers[column].name}' holds {shown(cell)}; "
                "expected a number: correct the cell, or leave it empty and read with nan='gap'"
            ) from None


def _cells(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except csv.Error as error:
        raise FormatError(
            f"a line that starts with {line[:40]!r} cannot be cut into cells ({error}); expected text cut by "
            f"{delimiter!r}: export the log again, or name the separator with delimiter="
        ) from None


def _text(path: Path) -> str:
    """The file's text in whichever common encoding it has."""
    if not path.is_file():
        kind = "is a folder" if path.is_dir() else "does not exist"
        folder = path.parent
        others = [p.name for p in folder.iterdir() if p.is_file()] if folder.is_dir() else []
        near = f"in '{folder}' {nearest(path.name, others)}" if folder.is_dir() else f"there is no folder '{folder}'"
        raise MissingFileError(f"the log '{path}' {kind}; expected a file, {near}: correct the path")
    raw = read_bytes(path, "the log", "a readable file: check its permissions")
    return decoded(raw, path, "comma-separated text: export the log as CSV")


def _delimiter(lines: Sequence[str]) -> str | None:
    """The separator that cuts most lines into the same number of cells; None for blanks."""
    best, score = None, (0.0, 0)
    for candidate in (";", "\t", ",", None):
        counts = [len(_cells(line.strip() if candidate is None else line, candidate)) for line in lines]
        usual = max(set(counts), key=counts.count)
        share = counts.count(usual) / len(counts)
        if usual > 1 and (share > score[0] + 1e-9):
            best, score = candidate, (share, usual)
    return best


def _is_number(cell: str, decimal_comma: bool = False) -> bool:
    text = cell.strip()
    if text.lower() in _MISSING:
        return True
    return is_number(text.replace(",", ".") if decimal_comma else text)


def parse_heading(text: str) -> Header:
    """Name and unit of a column heading.

    Brackets always hold a unit; parentheses and what follows a comma only if it is a known one.

    >>> parse_heading("vx(m/s)").name, parse_heading("brake [kPa]").unit, parse_heading("acc x (IMU)").name
    ('vx', 'kPa', 'acc x (IMU)')
    """
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
        cleaned = [u.strip().strip("[]()") for u in unit_row]
        headers = [
            h if h.unit is not None or not u else Header(text=h.text, name=h.name, unit=u)
            for h, u in zip(headers, cleaned, strict=True)
        ]
    return tuple(headers)


def read_table(path: str | Path, *, delimiter: str | None = None, skip_lines: int = 0) -> TextTable:
    """Cut a text file into headings and rows; no number is read yet.

    Raises MissingFileError, FormatError or TooShortError if the file is missing, not text, ragged or empty.
    """
    path = Path(path)
    name = f"'{path.name}'"
    lines = _text(path).splitlines()
    comments: list[str] = []
    body: list[tuple[int, str]] = []
    meta: dict[str, Any] = {}
    for number, line in enumerate(lines[skip_lines:], start=skip_lines + 1):
        text = line.strip()
        if text.startswith(OURS):
            meta = _meta(text[len(OURS) :], name, number)
        elif text.startswith(_COMMENTS):
            comments.append(text.lstrip("#%/ ").strip())
        elif text.strip(",;\t "):
            body.append((number, line))
    if not body:
        raise TooShortError(f"the log {name} is empty; expected a header line and rows of numbers: export it again")
    sample = [line for _, line in body[:50]]
    cut = delimiter if delimiter is not None else _delimiter(sample)
    comma = cut in (";", "\t") and any("," in line and re.search(r"\d,\d", line) for _, line in body)
    rows = [_cells(line, cut) for line in sample]
    named, headers, skip = _find_headings(rows, comments, cut, comma)
    body = body[skip:]
    if not body:
        raise TooShortError(f"the log {name} has headings but no rows; expected rows of numbers: export it again")
    _check_ragged(body, cut, len(headers), name)
    if comma:
        _check_decimal_commas(body, cut, name)
    return TextTable(
        name=name,
        headers=headers,
        named=named,
        lines=tuple(line for _, line in body),
        line_numbers=tuple(number for number, _ in body),
        delimiter=cut,
        decimal_comma=comma,
        meta=meta,
    )


def _find_headings(
    rows: list[list[str]], comments: list[str], delimiter: str | None, comma: bool
) -> tuple[bool, tuple[Header, ...], int]:
    """Whether there are headings, what they are, and how many lines of the body they take."""
    if not all(_is_number(c, comma) for c in rows[0]):
        second = rows[1] if len(rows) > 1 and len(rows[1]) == len(rows[0]) else []
        cleaned = [c.strip().strip("[]()") for c in second]
        has_units = bool(second) and not any(_is_number(c) and c for c in second) and all(map(units.known, cleaned))
        return True, _headings(rows[0], second if has_units else None), 2 if has_units else 1
    for comment in reversed(comments):
        cells = _cells(comment, delimiter)
        if len(cells) == len(rows[0]) and not all(_is_number(c, comma) for c in cells):
            return True, _headings(cells, None), 0
    return False, tuple(Header(text=f"column {i}", name=f"column {i}") for i in range(len(rows[0]))), 0


def _check_ragged(body: list[tuple[int, str]], delimiter: str | None, width: int, name: str) -> None:
    for number, line in body:
        if delimiter is None or '"' in line:
            count = len(_cells(line, delimiter))
        else:
            count = line.count(delimiter) + 1  # the same, faster
        if count != width:
            raise FormatError(
                f"{name}, line {number} has {count} cells; expected {width} like the header: complete or delete the "
                "line (a log cut off while writing ends like this), leave lines above the header out with skip_lines=, "
                "or name the separator with delimiter="
            )


def _check_decimal_commas(body: list[tuple[int, str]], delimiter: str | None, name: str) -> None:
    """Raise unless every number has a decimal comma; points beside them, or groups of three digits, do not tell."""
    pointed: tuple[int, str] | None = None
    with_comma: tuple[int, str] | None = None
    proven = False  # a comma that cannot part thousands
    for number, line in body:
        for cell in line.split(delimiter):
            text = cell.strip(" \"'")
            if "," in text and _COMMA.fullmatch(text):
                with_comma = with_comma or (number, text)
                proven = proven or not _THOUSANDS.fullmatch(text)
            elif pointed is None and "." in text and _POINT.fullmatch(text):
                pointed = (number, text)
    if with_comma and pointed:
        raise FormatError(
            f"{name} holds {shown(with_comma[1])} in line {with_comma[0]} and {shown(pointed[1])} in line "
            f"{pointed[0]}; expected one decimal mark: export the log again with a point"
        )
    if with_comma and not proven:
        plain = with_comma[1][:20]
        raise FormatError(
            f"{name} holds {shown(with_comma[1])} in line {with_comma[0]}, which can be {plain.replace(',', '.')} or "
            f"{plain.replace(',', '')}; expected a decimal mark that tells: export the log again with a point, and "
            "without marks between thousands"
        )


def _meta(text: str, name: str, number: int) -> dict[str, Any]:
    try:
        meta = json.loads(text)
    except json.JSONDecodeError as error:
        raise FormatError(
            f"{name}, line {number} should hold what write_csv noted but is not JSON ({error}); expected the line as "
            "written: restore or delete it"
        ) from None
    return meta if isinstance(meta, dict) else {}
