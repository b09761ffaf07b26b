"""What a reader knows of a log before units and time are settled: headings, and the numbers under each."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from slipangle.errors import MissingColumnError, ParameterError, nearest

DATE = "date"  # stands as the unit of a column of instants, whose numbers are seconds since 1970 or since midnight


@dataclass(frozen=True, kw_only=True)
class Header:
    """A column heading: as written, its name and unit apart, and the rate of its samples if the file says it. [Hz]"""

    text: str
    name: str
    unit: str | None = None
    rate: float | None = None


class ChannelTable(Protocol):
    """What a reader knows of a file before units and time are settled."""

    @property
    def name(self) -> str:
        """The file, for messages."""
        ...

    @property
    def headers(self) -> tuple[Header, ...]:
        """One per column."""
        ...

    @property
    def named(self) -> bool:
        """Whether the file names its columns."""
        ...

    def numbers(self, column: int) -> np.ndarray:
        """The numbers of one column, NaN where a cell is empty, shape (n_rows,)."""
        ...

    def row_name(self, row: int) -> str:
        """A row in words, such as ``line 12``."""
        ...


@dataclass(frozen=True, kw_only=True)
class ArrayTable:
    """A `ChannelTable` of numbers that a reader has already, shape (n_rows, n_columns), NaN where one is missing."""

    name: str
    headers: tuple[Header, ...]
    values: np.ndarray
    named: bool = True

    def numbers(self, column: int) -> np.ndarray:
        """One column, shape (n_rows,)."""
        return np.asarray(self.values[:, column], dtype=float)

    def row_name(self, row: int) -> str:
        """The row counted from 1."""
        return f"row {row + 1}"


@dataclass(frozen=True, kw_only=True)
class LazyTable:
    """A `ChannelTable` whose columns are loaded when they are asked for, each by ``load`` from its position."""

    name: str
    headers: tuple[Header, ...]
    load: Callable[[int], np.ndarray]
    named: bool = True

    def numbers(self, column: int) -> np.ndarray:
        """One column, shape (n_rows,)."""
        return np.asarray(self.load(column), dtype=float).reshape(-1)

    def row_name(self, row: int) -> str:
        """The row counted from 1."""
        return f"row {row + 1}"


def find_column(table: ChannelTable, source: str | int, channel: str) -> int:
    """Position of a column.

    Raises MissingColumnError with the nearest names if there is none, and ParameterError if two have that name.
    """
    count = len(table.headers)
    if isinstance(source, int):
        if -count <= source < count:
            return source % count
        raise MissingColumnError(
            f"{table.name} has no column number {source} for channel '{channel}'; expected 0 to {count - 1}: "
            "count from 0"
        )
    for key in ("text", "name"):
        matches = [i for i, h in enumerate(table.headers) if getattr(h, key) == source]
        if len(matches) == 1:
            return matches[0]
        if matches:
            raise ParameterError(
                f"{table.name} has {len(matches)} columns named '{source}'; expected one: choose by position, "
                f"such as Column({matches[0]})"
            )
    if not table.named:
        raise MissingColumnError(
            f"{table.name} has no header, so no column '{source}' for channel '{channel}'; expected a first line with "
            f"names: add one, or choose by position, Column(0) to Column({count - 1})"
        )
    known = [h.name for h in table.headers]
    raise MissingColumnError(
        f"{table.name} has no column '{source}' for channel '{channel}'; {nearest(source, known)}: correct the name"
    )


def prefetch(table: ChannelTable, columns: Iterable[int]) -> None:
    """Tell a table which columns will be asked for; one that has a ``fetch`` loads them at once."""
    fetch = getattr(table, "fetch", None)
    if fetch is not None:
        fetch(list(columns))
