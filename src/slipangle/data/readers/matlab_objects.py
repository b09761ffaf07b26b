"""Timetables, tables, durations and datetimes in MATLAB files: the part of a file that holds all of its objects.

A variable that is an object names objects by number; a list of cells at the end of the file has what they hold, and
its first cell says which class each is of and in which cell each property stands. MATLAB does not document it; the
layout is that of [1]_.

References
----------
.. [1] foreverallama, matio: subsystem data format and field contents, 2025.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from slipangle.data.readers.tables import DATE

_MARK = 0xDD000000  # begins what names an object
_HEAD, _REGIONS = 40, 8  # bytes before the names; parts that follow them
_MOST = 10_000  # properties of an object, columns of a table


class Opaque(NamedTuple):
    """An object as a variable has it: its class, and what names it; of the list of all objects, the cells."""

    kind: str
    content: Any


class Piece(NamedTuple):
    """Numbers of an object, shape (n,) or (n, m): the way to them and their unit, seconds since 1970 for `DATE`."""

    way: str
    values: np.ndarray
    unit: str | None


class Objects:
    """Every object of a file, from its cells and byte order; text is str, a struct a dictionary of lists of values.

    Raises ValueError, KeyError or IndexError, here and everywhere, if what the cells say does not hold together.
    """

    def __init__(self, cells: Any, order: str = "<") -> None:
        self._cells = cells
        raw = np.asarray(cells[0]).reshape(-1).astype("u1").tobytes()
        version, count, *ends = (int(v) for v in np.frombuffer(raw, order + "u4", 2 + _REGIONS))
        if not 2 <= version <= 4:
            raise ValueError(f"objects of version {version}")
        names = raw[_HEAD : ends[0]].split(b"\0")[:count]
        self._names = ["", *(name.decode("utf-8", "replace") for name in names)]
        regions = [raw[a:b] for a, b in pairwise(ends[:5])]
        classes, saved, known, own = (np.frombuffer(r[: len(r) // 4 * 4], order + "u4") for r in regions)
        self._classes, self._known = classes.reshape(-1, 4), known.reshape(-1, 6)
        self._properties = (_blocks(saved), _blocks(own))

    def read(self, named: np.ndarray) -> tuple[str, dict[str, Any]]:
        """Class and properties of what names one object."""
        marks = np.asarray(named).reshape(-1)
        dims = int(marks[1])
        number, kind = int(marks[2 + dims]), int(marks[-1])
        if len(marks) != 4 + dims or marks[0] != _MARK:
            raise ValueError("an array of objects")
        saved, own = self._known[number, 3:5]
        block = self._properties[0][saved] if saved else self._properties[1][own]
        values = {self._names[name]: self._cells[2 + int(cell)] for name, what, cell in block if what == 1}
        return self._names[self._classes[kind, 1]], values

    def pieces(self, named: np.ndarray, way: str) -> Iterator[Piece]:
        """Columns of a timetable or table, or the numbers of a duration or datetime; ValueError for other classes."""
        kind, has = self.read(named)
        if kind == "timetable":
            held = {name: values[0] for name, values in has["any"].items()}
            yield Piece(f"{way}.Time", *self._instants(held["rowTimes"], int(_number(held["numRows"]))))
            yield from self._columns(held["data"], held["varNames"], held.get("varUnits"), way)
        elif kind == "table":
            more = {name: values[0] for name, values in has["props"].items()} if "props" in has else {}
            yield from self._columns(has["data"], has["varnames"], more.get("VariableUnits"), way)
        elif kind in ("duration", "datetime"):
            yield Piece(way, *self._instants(named, 0))
        else:
            raise ValueError(f"an object of class {kind}")

    def _columns(self, cells: Any, names: Any, units: Any, way: str) -> Iterator[Piece]:
        said = [unit if isinstance(unit, str) and unit.strip() else None for unit in np.atleast_1d(units).tolist()]
        said = said if len(said) == len(names) else [None] * len(names)
        for name, cell, unit in zip(names[:_MOST], cells, said, strict=False):
            place = f"{way}.{str(name).replace('.', '_')}"
            if is_named(cell):
                try:
                    yield from self.pieces(cell, place)
                except ValueError:
                    continue  # words and categories
            elif isinstance(cell, np.ndarray) and cell.dtype.kind in "biuf":
                yield Piece(place, cell, unit)

    def _instants(self, times: Any, rows: int) -> tuple[np.ndarray, str]:
        """Durations [s] or instants since 1970 [s], and which; those of a regular timetable from their step."""
        if is_named(times):
            kind, has = self.read(times)
            if kind not in ("duration", "datetime"):
                raise ValueError(f"times of class {kind}")
            held = np.asarray(has["millis" if kind == "duration" else "data"], dtype=float).reshape(-1)
            return held / 1e3, "s" if kind == "duration" else DATE
        regular = {name: values[0] for name, values in times.items()}
        start, unit = self._instants(regular["origin"], 1)
        if bool(_number(regular["specifiedAsRate"])):
            step = 1 / _number(regular["sampleRate"])
        else:
            step = float(self._instants(regular["stepSize"], 1)[0][0])
        return start[0] + step * np.arange(rows), unit


def is_named(value: Any) -> bool:
    """Whether numbers name an object."""
    return isinstance(value, np.ndarray) and value.dtype.kind in "uf" and value.size >= 5 and value.flat[0] == _MARK


def _number(value: Any) -> float:
    return float(np.asarray(value, dtype=float).reshape(-1)[0])


def _blocks(numbers: np.ndarray) -> list[np.ndarray]:
    """Properties of each object as rows of name, kind and value; a block begins with its count, at 8 bytes each."""
    blocks, at = [], 0
    while at < len(numbers):
        count = int(numbers[at])
        rows = numbers[at + 1 : at + 1 + 3 * count]
        if count > _MOST or len(rows) != 3 * count:
            raise ValueError("properties that do not add up")
        blocks.append(rows.reshape(-1, 3))
        at += 1 + 3 * count
        at += at % 2
    return blocks
