"""Text tables of any separator: where the headings are, what is a number, what is a comment."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from slipangle.data.numerals import decoded, to_number
from slipangle.data.readers.fast_csv import StreamedTable
from slipangle.data.readers.registry import require_log
from slipangle.data.readers.tables import DATE, Header
from slipangle.data.readers.text_dialect import (
    MISSING,
    cells_of,
    filled,
    find_headings,
    is_ambiguous,
    separator_of,
    to_instant,
)
from slipangle.errors import FormatError, TooShortError, shown
from slipangle.files import read_bytes

OURS = "# slipangle: "  # begins the line that `write_csv` says its settings in
_LARGE, _HEAD = 4 << 20, 1 << 18  # bytes from which a file is read block by block, and of its beginning
_SAMPLE = 100  # lines by which the dialect is known
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
        if self.headers[column].unit == DATE:
            return np.array([self._instant(row, column) for row in range(len(self.lines))])
        if self._table is not None:
            return self._table[:, self._countable.index(column)]
        return np.array([self._number(row, column) for row in range(len(self.lines))])

    @cached_property
    def _countable(self) -> list[int]:
        return [i for i, h in enumerate(self.headers) if h.unit != DATE]

    @cached_property
    def _table(self) -> np.ndarray | None:
        """All numbers at once, NaN where a cell is empty, or None if a cell somewhere is foreign."""
        lines = [line.replace(",", ".") for line in self.lines] if self.decimal_comma else self.lines
        how: dict[str, Any] = {"delimiter": self.delimiter, "ndmin": 2, "comments": None, "usecols": self._countable}
        try:
            return np.loadtxt(lines, quotechar='"', **how)
        except (ValueError, IndexError):
            pass
        if self.delimiter is None:
            return None
        try:
            return np.loadtxt([filled(line, self.delimiter) for line in lines], quotechar='"', **how)
        except (ValueError, IndexError):
            return None

    @cached_property
    def _split(self) -> list[list[str]]:
        return [cells_of(line, self.delimiter) for line in self.lines]

    def _number(self, row: int, column: int) -> float:
        cell = self._split[row][column].strip()
        text = cell.replace(",", ".") if self.decimal_comma else cell
        try:
            return to_number(text)
        except ValueError:
            if text.lower() in MISSING:
                return np.nan
            expected = "a number: correct the cell, or leave it empty and read with nan='gap'"
            if is_ambiguous(text):
                expected = "a date and time that can be read in one way: write it as 2026-05-01T14:00:00.25"
            raise FormatError(
                f"{self.name}, {self.row_name(row)}, column '{self.headers[column].name}' holds {shown(cell)}; "
                f"expected {expected}"
            ) from None

    def _instant(self, row: int, column: int) -> float:
        cell = self._split[row][column]
        try:
            return to_instant(cell) if cell.strip() else np.nan
        except (ValueError, OverflowError):
            raise FormatError(
                f"{self.name}, {self.row_name(row)}, column '{self.headers[column].name}' holds {shown(cell)}; "
                "expected a date and time such as 2026-05-01T14:00:00.25Z, as above: correct the cell"
            ) from None


def _text(path: Path) -> str:
    """The file's text in whichever common encoding it has."""
    require_log(path)
    raw = read_bytes(path, "the log", "a readable file: check its permissions")
    return decoded(raw, path, "comma-separated text: export the log as CSV")


def read_table(path: str | Path, *, delimiter: str | None = None, skip_lines: int = 0) -> TextTable | StreamedTable:
    """Cut a text file into headings and rows; no number is read yet.

    Raises MissingFileError, FormatError or TooShortError if the file is missing, not text, ragged or empty.
    """
    path = Path(path)
    if _is_large(path, delimiter):
        large = _streamed(path, delimiter, skip_lines)
        if large is not None:
            return large
    return _read_whole(path, delimiter, skip_lines)


def _read_whole(path: Path, delimiter: str | None, skip_lines: int) -> TextTable:
    """The table with every cell at hand, which knows the place of each."""
    return _cut(_text(path), f"'{path.name}'", delimiter, skip_lines)


def _is_large(path: Path, delimiter: str | None) -> bool:
    return path.is_file() and path.stat().st_size >= _LARGE and (delimiter is None or len(delimiter) == 1)


def _streamed(path: Path, delimiter: str | None, skip_lines: int) -> StreamedTable | None:
    """A large file by the dialect of its beginning; None where that does not tell."""
    with path.open("rb") as file:
        raw = file.read(_HEAD)
    if b"\0" in raw[:4096] or raw[:2] in (b"\xff\xfe", b"\xfe\xff") or raw.count(b"\r") > raw.count(b"\n"):
        return None
    head = raw if len(raw) < _HEAD else raw[: raw.rfind(b"\n") + 1]
    try:
        table = _cut(decoded(head, path, "text"), f"'{path.name}'", delimiter, skip_lines)
    except (FormatError, TooShortError):  # of all of it there may be more to say
        return None
    if table.delimiter is None or len(table.delimiter) != 1:
        return None
    return StreamedTable(
        path=path,
        headers=table.headers,
        named=table.named,
        above=table.line_numbers[0] - 1,
        delimiter=table.delimiter,
        decimal_comma=table.decimal_comma,
        meta=table.meta,
        exact=lambda: _read_whole(path, delimiter, skip_lines),
    )


def _cut(text: str, name: str, delimiter: str | None, skip_lines: int) -> TextTable:
    lines = text.splitlines()
    comments: list[str] = []
    body: list[tuple[int, str]] = []
    meta: dict[str, Any] = {}
    for number, line in enumerate(lines[skip_lines:], start=skip_lines + 1):
        said = line.strip()
        if said.startswith(OURS):
            meta = _meta(said[len(OURS) :], name, number)
        elif said.startswith(_COMMENTS):
            comments.append(said.lstrip("#%/ ").strip())
        elif said.strip(",;\t "):
            body.append((number, line))
    if not body:
        raise TooShortError(f"the log {name} is empty; expected a header line and rows of numbers: export it again")
    sample = [line for _, line in body[:_SAMPLE]]
    cut = delimiter if delimiter is not None else separator_of(sample)
    comma = cut in (";", "\t") and any("," in line and re.search(r"\d,\d", line) for _, line in body)
    rows = [cells_of(line, cut) for line in sample]
    named, headers, skip = find_headings(rows, comments, cut, comma)
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


def _check_ragged(body: list[tuple[int, str]], delimiter: str | None, width: int, name: str) -> None:
    for number, line in body:
        if delimiter is None or '"' in line:
            count = len(cells_of(line, delimiter))
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
