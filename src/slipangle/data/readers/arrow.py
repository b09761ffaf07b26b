"""Parquet and Feather files, by pyarrow: columns in columns of structs too, each loaded when it is asked for."""

from __future__ import annotations

import ast
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from slipangle.data.readers.recording import Recording
from slipangle.data.readers.registry import reader
from slipangle.data.readers.tables import DATE, Header, LazyTable
from slipangle.data.readers.text_dialect import parse_heading
from slipangle.errors import FormatError
from slipangle.extras import extra

META = b"slipangle"  # the key of what `slipangle.data.writers` notes in a file's schema
_DEEPEST = 8
_LONGEST = 1000  # letters of a heading in several levels
Leaf = tuple[str, tuple[str, ...], Any, bytes | None]  # name, path to it, type, unit by the file


@reader("Parquet", recognises=lambda head: head.startswith(b"PAR1"), suffixes=(".parquet",))
def read_parquet(path: Path) -> Recording:
    """A Parquet file.

    Raises FormatError if it is damaged, ConfigError if pyarrow is not installed.
    """
    parquet = extra("pyarrow.parquet", "io", "reading a Parquet file")

    def column(top: str) -> Any:
        return parquet.read_table(path, columns=[top], use_threads=False)[top]

    return _recording(path, lambda: parquet.read_schema(path), column)


@reader("Feather", recognises=lambda head: head[:6] in (b"ARROW1", b"FEA1"), suffixes=(".feather", ".arrow"))
def read_feather(path: Path) -> Recording:
    """A Feather or Arrow file.

    Raises FormatError if it is damaged, ConfigError if pyarrow is not installed.
    """
    feather = extra("pyarrow.feather", "io", "reading a Feather file")
    arrow = extra("pyarrow", "io", "reading a Feather file")

    def schema() -> Any:
        with arrow.memory_map(str(path)) as source:
            return arrow.ipc.open_file(source).schema

    def column(top: str) -> Any:
        return feather.read_table(path, columns=[top], use_threads=False, memory_map=False)[top]

    return _recording(path, schema, column)


def _whole(path: Path, call: Callable[[], Any]) -> Any:
    """What pyarrow gives; its complaints about the file as one sentence."""
    arrow = extra("pyarrow", "io", "reading this file")
    try:
        return call()
    except (arrow.ArrowException, OSError, ValueError, KeyError, MemoryError, OverflowError) as error:
        why = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise FormatError(f"'{path}' cannot be read ({why}); expected a whole file: copy or export it again") from None


def _recording(path: Path, schema_of: Callable[[], Any], column_of: Callable[[str], Any]) -> Recording:
    schema = _whole(path, schema_of)
    leaves = [leaf for field in schema for leaf in _leaves(field, (), 0)]
    if len({field.name for field in schema}) < len(schema):
        raise FormatError(f"'{path}' has two columns of one name; expected each once: rename one")
    headers = tuple(_header(leaf) for leaf in leaves)

    def load(i: int) -> np.ndarray:
        _, way, kind, _ = leaves[i]

        def values() -> np.ndarray:
            compute = extra("pyarrow.compute", "io", "reading this file")
            column = column_of(way[0])
            for part in way[1:]:
                column = compute.struct_field(column, part)
            return _as_numbers(column, kind)

        return _whole(path, values)

    return Recording(
        name=path.stem,
        tables={"": LazyTable(name=f"'{path.name}'", headers=headers, load=load)} if headers else {},
        meta=_meta(schema),
    )


def _leaves(field: Any, above: tuple[str, ...], depth: int) -> Iterator[Leaf]:
    """Columns of numbers or instants, those inside structs by the names on the way."""
    types = extra("pyarrow.types", "io", "reading this file")
    kind, way = field.type, (*above, field.name)
    if types.is_struct(kind) and depth < _DEEPEST:
        for k in range(kind.num_fields):
            yield from _leaves(kind.field(k), way, depth + 1)
    elif (
        types.is_integer(kind)
        or types.is_floating(kind)
        or types.is_boolean(kind)
        or types.is_decimal(kind)
        or types.is_timestamp(kind)
        or types.is_duration(kind)
    ):
        yield ".".join((levels(way[0]), *way[1:])), way, kind, (field.metadata or {}).get(b"unit")


def levels(heading: str) -> str:
    """A heading; of one in several levels, which pandas writes as a tuple, those that are not empty.

    >>> levels("('imu', 'wz')"), levels("('t', '')"), levels("speed (km/h)")
    ('imu.wz', 't', 'speed (km/h)')
    """
    if not heading.startswith("('") or len(heading) > _LONGEST:
        return heading
    try:
        parts = ast.literal_eval(heading)
    except (SyntaxError, ValueError):
        return heading
    named = isinstance(parts, tuple) and all(isinstance(part, str) for part in parts)
    return ".".join(filter(None, parts)) or heading if named else heading


def _header(leaf: Leaf) -> Header:
    name, _, kind, unit = leaf
    types = extra("pyarrow.types", "io", "reading this file")
    if types.is_timestamp(kind) or types.is_duration(kind):
        return Header(text=name, name=name, unit=DATE if types.is_timestamp(kind) else "s")
    if unit is not None:
        return Header(text=name, name=name, unit=unit.decode("utf-8", "replace"))
    return parse_heading(name) if name.strip() else Header(text=name, name=name)


def _as_numbers(column: Any, kind: Any) -> np.ndarray:
    """Floats with NaN for what is missing; instants and durations in seconds."""
    arrow = extra("pyarrow", "io", "reading this file")
    if arrow.types.is_timestamp(kind) or arrow.types.is_duration(kind):
        ticks = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[kind.unit]
        return column.cast(arrow.int64()).cast(arrow.float64(), safe=False).to_numpy() / ticks
    if arrow.types.is_boolean(kind):
        column = column.cast(arrow.int8())
    return np.asarray(column.cast(arrow.float64(), safe=False).to_numpy(), dtype=float)


def _meta(schema: Any) -> dict[str, Any]:
    """What a writer of ours noted in the file, or nothing."""
    try:
        meta = json.loads((schema.metadata or {}).get(META, b"{}"))
    except ValueError:
        return {}
    return meta if isinstance(meta, dict) else {}
