"""Large text tables: only the columns that are asked for are loaded, block by block, by pyarrow where it is installed.

What pyarrow stumbles over (a word among numbers, a line cut short, a comment between rows) is read again by
`slipangle.data.readers.text_table`, which says where it is; so both read the same numbers and refuse the same files.
"""

from __future__ import annotations

import io
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from slipangle.data.readers.tables import DATE, ChannelTable, Header
from slipangle.data.readers.text_dialect import MISSING, filled
from slipangle.errors import ConfigError
from slipangle.extras import extra

_BLOCK = 1 << 18  # bytes that pyarrow reads at once: of larger ones it holds many, and is no faster
_LINES = 5_000  # of a block without pyarrow
_NULLS = sorted(
    {form for word in MISSING if "inf" not in word for form in (word, word.upper(), word.capitalize())} | {"NaN", "N/A"}
)


@dataclass(frozen=True, kw_only=True)
class StreamedTable:
    """A large text file whose columns are loaded when they are asked for; ``exact`` is the reader of whatever fails.

    ``above`` is the number of lines over the first row of numbers.
    """

    path: Path
    headers: tuple[Header, ...]
    named: bool
    above: int
    delimiter: str
    decimal_comma: bool
    meta: Mapping[str, Any]
    exact: Callable[[], ChannelTable]
    _gapless: list[bool] = field(default_factory=list, init=False, repr=False, compare=False)  # no line is blank
    _loaded: dict[int, np.ndarray] = field(default_factory=dict, init=False, repr=False, compare=False)
    _slow: list[ChannelTable] = field(default_factory=list, init=False, repr=False, compare=False)

    @property
    def name(self) -> str:
        """The file, for messages."""
        return f"'{self.path.name}'"

    def row_name(self, row: int) -> str:
        """The row as ``line`` and its number in the file, counted from 1."""
        if self._slow:  # it knows comments between rows too
            return self._slow[0].row_name(row)
        line = self.above + 1 + row
        for blank in self._blank:
            line += blank <= line
        return f"line {line}"

    @cached_property
    def _blank(self) -> list[int]:
        """Numbers of the lines below the headings that hold nothing."""
        if self._gapless:
            return []
        with self.path.open("rb") as file:
            lines = enumerate(file, start=1)
            return [k for k, line in lines if k > self.above and not line.strip(b",;\t \r\n")]

    @cached_property
    def _count(self) -> int:
        """Number of lines below the headings, blank ones too."""
        count, last = 0, b"\n"
        with self.path.open("rb") as file:
            while block := file.read(1 << 20):
                count, last = count + block.count(b"\n"), block[-1:]
        return count + (last != b"\n") - self.above

    def numbers(self, column: int) -> np.ndarray:
        """The numbers of one column, NaN where a cell is empty, shape (n_rows,); they are loaded once and handed over.

        Raises FormatError if a cell is not a number; its line and column are given.
        """
        if column not in self._loaded:
            self.fetch([column])
        return self._slow[0].numbers(column) if self._slow else self._loaded.pop(column)

    def fetch(self, columns: Sequence[int]) -> None:
        """Load these columns at once."""
        wanted = [c for c in dict.fromkeys(columns) if c not in self._loaded]
        if not wanted or self._slow:
            return
        loaded = None
        if not any(self.headers[c].unit == DATE for c in wanted):
            try:
                loaded = self._by_arrow(wanted)
            except ConfigError:  # pyarrow is not there
                loaded = self._by_numpy(wanted)
        if loaded is None:
            self._slow.append(self.exact())
        else:
            self._loaded.update(loaded)

    def _rows(self) -> Iterator[tuple[int, bytes]]:
        """Lines of numbers, each with its number in the file."""
        with self.path.open("rb") as file:
            for number, line in enumerate(file, start=1):
                if number > self.above and line.strip(b",;\t \r\n"):
                    yield number, line

    def _by_arrow(self, columns: list[int]) -> dict[int, np.ndarray] | None:
        arrow = extra("pyarrow", "io", "reading a large text table fast")
        csv = extra("pyarrow.csv", "io", "reading a large text table fast")
        names = [str(i) for i in range(len(self.headers))]
        wanted = [names[c] for c in columns]
        held = {c: np.empty(0) for c in columns}
        rows, size = 0, self.path.stat().st_size
        blank, single = [], len(self.headers) == 1  # of one column a blank line would be an empty cell

        def odd(row: Any) -> str:
            """Blank lines, whose numbers only messages need, are left out; others stop the reading."""
            blank.append(row)
            return "error" if row.text.strip(",;\t \r\n") else "skip"

        try:
            with csv.open_csv(
                self.path,
                read_options=csv.ReadOptions(
                    column_names=names, skip_rows=self.above, block_size=_BLOCK, use_threads=False
                ),
                parse_options=csv.ParseOptions(
                    delimiter=self.delimiter, ignore_empty_lines=single, invalid_row_handler=odd
                ),
                convert_options=csv.ConvertOptions(
                    include_columns=wanted,
                    column_types=dict.fromkeys(wanted, arrow.float64()),
                    null_values=_NULLS,
                    quoted_strings_can_be_null=True,
                    decimal_point="," if self.decimal_comma else ".",
                ),
            ) as blocks:
                for block in blocks:
                    end = rows + block.num_rows
                    if end > len(held[columns[0]]):  # room for all at the first one's rows per byte; unused is unheld
                        room = max(int(1.1 * block.num_rows * size / _BLOCK), int(1.25 * end))
                        held = {c: _longer(x, rows, room) for c, x in held.items()}
                    for c, name in zip(columns, wanted, strict=True):
                        held[c][rows:end] = block[name].to_numpy(zero_copy_only=False)
                    rows = end
        except (arrow.ArrowException, OSError, ValueError, IndexError):
            return None
        finally:
            arrow.default_memory_pool().release_unused()  # what is read next needs it
        self._gapless.extend([] if blank or single else [True])
        return _whole(held, rows)

    def _by_numpy(self, columns: list[int]) -> dict[int, np.ndarray] | None:
        """The same with what NumPy has, about ten times slower."""
        order, rows = sorted(columns), 0
        held = {c: np.empty(self._count) for c in order}
        lines = (line.decode("latin-1") for _, line in self._rows())
        try:
            while block := list(itertools.islice(lines, _LINES)):
                if self.decimal_comma:
                    block = [line.replace(",", ".") for line in block]
                if any(line.count(self.delimiter) + 1 != len(self.headers) for line in block):
                    return None
                text = io.StringIO("\n".join(filled(line.rstrip("\r\n"), self.delimiter) for line in block))
                how: dict[str, Any] = {"delimiter": self.delimiter, "comments": None, "quotechar": '"', "ndmin": 2}
                part = np.loadtxt(text, usecols=order, **how)
                for k, c in enumerate(order):
                    held[c][rows : rows + len(part)] = part[:, k]
                rows += len(part)
        except (ValueError, IndexError):
            return None
        return _whole(held, rows)


def _longer(x: np.ndarray, rows: int, room: int) -> np.ndarray:
    """The first rows with room for more, which takes no memory until it is filled."""
    longer = np.empty(room)
    longer[:rows] = x[:rows]
    return longer


def _whole(held: dict[int, np.ndarray], rows: int) -> dict[int, np.ndarray] | None:
    """The rows that were filled; nothing if one is empty throughout: that may be a line of separators alone."""
    cut = {c: x[:rows] for c, x in held.items()}
    if len(cut) > 1:
        empty = np.ones(rows, dtype=bool)
        for x in cut.values():
            empty &= np.isnan(x)
        if empty.any():
            return None
    return cut if rows else None
