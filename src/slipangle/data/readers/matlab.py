"""MATLAB files as logs: vectors of one length belong together, by variable or inside structs.

Versions 5 to 7 are read by `slipangle.data.readers.mat5`, version 7.3, which is HDF5 [1]_, by h5py, timetables and
tables of both by `slipangle.data.readers.matlab_objects`. Of other objects MATLAB makes structs.

References
----------
.. [1] The MathWorks, MAT-File Versions; The HDF Group, HDF5 File Format Specification 3.0.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slipangle.data.readers.mat5 import read_all
from slipangle.data.readers.matlab_objects import Objects, Opaque, Piece
from slipangle.data.readers.recording import Recording
from slipangle.data.readers.registry import reader
from slipangle.data.readers.tables import Header, LazyTable
from slipangle.data.readers.text_dialect import parse_heading
from slipangle.errors import FormatError, MissingColumnError
from slipangle.extras import extra

HDF = b"\x89HDF\r\n\x1a\n"
META = "slipangle_notes"  # the variable that our writer leaves
_TIME = ("t", "time", "tout", "timestamp", "timestamps", "zeit")
_DEEPEST = 12
_WIDEST = 64  # columns of a matrix, elements of a struct array
_LARGEST = 2**27  # numbers of one variable
_FEWEST = 2
_MANY = 100_000  # parts of an object
_LONGEST = 80  # letters of a name
_UNIT, _LABEL = ("units", "unit"), ("label", "name", "channelname")  # text beside a vector in a struct


class Vector(NamedTuple):
    """A column of numbers: the way to it, how many, how to load them, and the unit that stands beside it."""

    way: str
    rows: int
    load: Callable[[], np.ndarray]
    unit: str | None = None
    place: str = ""  # the way without the label that stands in it


def _known(head: bytes) -> bool:
    return head.startswith((b"MATLAB 5.0", b"MATLAB 7.3", HDF)) or head[126:128] in (b"IM", b"MI")


@reader("MATLAB", recognises=_known, suffixes=(".mat",))
def read_mat(path: Path) -> Recording:
    """A MATLAB file of version 5, 6, 7 or 7.3, or vectors in any HDF5 file.

    Raises FormatError if it is damaged, MissingColumnError if it holds no vectors, ConfigError if version 7.3 needs
    h5py, which is not installed.
    """
    with path.open("rb") as file:
        head = file.read(520)
    if HDF in (head[:8], head[512:520]):
        vectors, meta, named = _read_hdf(path)
    else:
        variables, (cells, order) = read_all(path)
        text = variables.pop(META, None)
        meta = _noted(text)
        named = Named(lambda: Objects(cells, order))
        vectors = [v for name, value in variables.items() for v in _in_value(value, name, 0, named)]
    if not vectors:
        left = f", but {named.notes[0]}" if named.notes else ""
        raise MissingColumnError(
            f"'{path}' holds no vectors of numbers that can be read{left}; expected some: other objects than "
            "timetables and tables become structs in MATLAB with S = struct(object)"
        )
    count = Counter(v.way for v in vectors)
    vectors = [v._replace(way=v.place) if v.place and count[v.way] > 1 else v for v in vectors]
    tables = grouped(vectors, path, meta.get("units", {}))
    return Recording(name=path.stem, tables=tables, meta=meta, notes=tuple(named.notes))


class Named:
    """The objects of a file, read when a variable names one; ``notes`` has what is left out."""

    def __init__(self, objects: Callable[[], Objects]) -> None:
        self._read, self._objects = objects, None
        self.notes: list[str] = []

    def real(self, values: np.ndarray, way: str) -> np.ndarray:
        """Real numbers as they are; of complex ones the real part, and a note."""
        if values.dtype.kind != "c":
            return values
        self.dropped(way)
        return values.real

    def dropped(self, way: str) -> None:
        """Note that a variable is complex."""
        self.notes.append(
            f"'{way[:60]}' is complex: only its real part is read; save real(), imag(), abs() or angle() of it"
        )

    def vectors(self, kind: str, content: Any, way: str) -> Iterator[Vector]:
        """Vectors of one object."""
        try:
            self._objects = self._objects or self._read()
            pieces: list[Piece] = list(self._objects.pieces(content, way))
        except (ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError, UnicodeDecodeError):
            self.notes.append(f"'{way[:60]}' is an object of class {kind[:60]}, which is not read")
            return
        for piece in pieces:
            values = self.real(np.squeeze(piece.values), piece.way)
            yield from (v._replace(unit=piece.unit) for v in _columns(values, piece.way))


def _noted(text: Any) -> dict[str, Any]:
    try:
        meta = json.loads(text) if isinstance(text, str) else {}
    except ValueError:
        return {}
    return meta if isinstance(meta, dict) else {}


# ---- which vectors belong together ---------------------------------------------------------------------------------


def grouped(vectors: list[Vector], path: Path, units: Mapping[str, str]) -> dict[str, LazyTable]:
    """Vectors of one length as a table; where several clocks have one length, each with what stands nearest to it."""
    tables: dict[str, LazyTable] = {}
    for count in sorted({v.rows for v in vectors}, reverse=True):
        alike = [v for v in vectors if v.rows == count]
        clocks = [v for v in alike if _last(v.way).lower() in _TIME]
        parts: dict[str, list[Vector]] = {}
        for v in alike:
            home = max(clocks, key=lambda c: (_shared(c.way, v.way), c is v)).way if len(clocks) > 1 else ""
            parts.setdefault(home, []).append(v)
        for home, own in parts.items():
            clock = home or next((c.way for c in clocks), "")
            topic = clock.rpartition(".")[0] or f"{count} samples"
            tables[topic if topic not in tables else f"{topic} ({count} samples)"] = _table(
                own, clock, topic, path, units
            )
    return tables if len(tables) > 1 else {"": next(iter(tables.values()))}


def _last(way: str) -> str:
    return way.rpartition(".")[2]


def _shared(a: str, b: str) -> int:
    """How many names two ways begin with together."""
    pairs = zip(a.split("."), b.split("."), strict=False)
    return next((k for k, (x, y) in enumerate(pairs) if x != y), min(a.count("."), b.count(".")) + 1)


def _table(vectors: list[Vector], clock: str, topic: str, path: Path, units: Mapping[str, str]) -> LazyTable:
    headers = []
    for v in vectors:
        name = v.way.removeprefix(f"{topic}.")
        name = "t" if v.way == clock else name
        column = re.search(r"\(\d+\)$", name)  # of a matrix: M(1) is in no unit 1
        found = Header(text=name, name=name) if column else parse_heading(name)
        headers.append(Header(text=name, name=found.name, unit=units.get(name, v.unit or found.unit)))
    return LazyTable(name=f"'{path.name}'", headers=tuple(headers), load=lambda i: vectors[i].load())


def described(found: list[Vector], texts: Mapping[str, str], place: str, parent: str | None) -> list[Vector]:
    """Vectors of a struct with the unit that stands beside them, as loggers and Simulink write it.

    An element of a struct array with a single one, and a name beside it, is called so below its ``parent``.
    """
    unit = next((texts[key].strip() for key in _UNIT if texts.get(key, "").strip()), None)
    label = next((texts[key].strip() for key in _LABEL if texts.get(key, "").strip()), "")
    own = [k for k, v in enumerate(found) if v.way.rpartition(".")[0] == place and _last(v.way).lower() not in _TIME]
    if unit:
        found = [v._replace(unit=v.unit or unit) if k in own else v for k, v in enumerate(found)]
    if parent is not None and len(own) == 1 and label.isprintable() and 0 < len(label) <= _LONGEST:
        k = own[0]
        found[k] = found[k]._replace(way=f"{parent}.{label.replace('.', '_')}", place=found[k].way)
    return found


# ---- version 5 to 7 ------------------------------------------------------------------------------------------------


def _in_value(value: Any, way: str, depth: int, named: Named) -> Iterator[Vector]:
    """Vectors in a variable that `read_mat5` gave: arrays as they are, structs and their elements by name."""
    if depth > _DEEPEST:
        return
    if isinstance(value, Opaque):
        yield from named.vectors(value.kind, value.content, way)
    elif isinstance(value, dict):
        elements = max((len(v) for v in value.values()), default=0)
        if elements > _WIDEST:
            return
        for k in range(elements):
            place = way if elements == 1 else f"{way}({k + 1})"
            inside = {name: cells[k] for name, cells in value.items()}
            found = [v for name, cell in inside.items() for v in _in_value(cell, f"{place}.{name}", depth + 1, named)]
            texts = {name.lower(): cell for name, cell in inside.items() if isinstance(cell, str)}
            yield from described(found, texts, place, way if elements > 1 else None)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        yield from _columns(named.real(np.squeeze(value) if value.ndim > 2 else value, way), way)


def _columns(values: np.ndarray, way: str) -> Iterator[Vector]:
    """A vector as it is, a matrix column by column as MATLAB counts them."""
    if values.ndim == 1 or (values.ndim == 2 and min(values.shape) == 1):
        flat = values.reshape(-1)
        if len(flat) >= _FEWEST:
            yield Vector(way, len(flat), lambda: flat)
    elif values.ndim == 2 and values.shape[1] <= _WIDEST and values.shape[0] > values.shape[1]:
        for k in range(values.shape[1]):
            yield Vector(f"{way}({k + 1})", values.shape[0], lambda k=k: values[:, k])


# ---- version 7.3 ---------------------------------------------------------------------------------------------------


def _read_hdf(path: Path) -> tuple[list[Vector], dict[str, Any], Named]:
    h5py = extra("h5py", "io", "reading a MATLAB 7.3 file")
    try:
        with h5py.File(path, "r") as file:
            named = Named(lambda: Objects(_value(file["#subsystem#/MCOS"], _MANY)))
            places = [name for name in file if not name.startswith("#")]
            vectors = [v for name in places for v in _in_node(file[name], name, path, 0, named)]
            note = _letters(file[META]) if META in file else None
    except MissingColumnError:
        raise
    except Exception as error:  # of many kinds: it trusts every byte
        raise _damaged(path, error) from None
    return vectors, _noted(note), named


def _damaged(path: Path, error: Exception) -> FormatError:
    why = (str(error).splitlines() or [type(error).__name__])[0][:120]
    return FormatError(f"'{path}' cannot be read as HDF5 ({why}); expected a whole file: copy or save it again")


def _letters(node: Any) -> str | None:
    values = np.asarray(node)
    return "".join(map(chr, values.reshape(-1).tolist())) if values.dtype.kind == "u" else None


def _in_node(node: Any, way: str, path: Path, depth: int, named: Named) -> Iterator[Vector]:
    """Vectors in a group (a struct) or a dataset, which may name an object."""
    if depth > _DEEPEST:
        return
    if "MATLAB_object_decode" in node.attrs:
        kind = node.attrs.get("MATLAB_class", b"")
        yield from named.vectors(kind.decode("ascii", "replace"), _value(node, _MANY), way)
        return
    if hasattr(node, "keys"):
        yield from _in_group(node, way, path, depth, named)
        return
    kind = node.attrs.get("MATLAB_class", b"double")
    parts = node.dtype.names == ("real", "imag")
    if (node.dtype.kind not in "biuf" and not parts) or kind in (b"char", b"cell") or node.attrs.get("MATLAB_empty", 0):
        return
    shape = node.shape
    if not shape or node.size > _LARGEST or len(shape) > 2:
        return
    if parts and node.size >= _FEWEST:
        named.dropped(way)
    address = node.name
    if len(shape) == 1 or min(shape) == 1:
        if node.size >= _FEWEST:
            yield Vector(way, int(node.size), lambda: _loaded(path, address, None), _unit_of(node))
    elif "MATLAB_class" in node.attrs and shape[0] <= _WIDEST and shape[1] > shape[0]:  # stored row by row
        for k in range(shape[0]):
            yield Vector(f"{way}({k + 1})", int(shape[1]), lambda k=k: _loaded(path, address, k), _unit_of(node))


def _unit_of(node: Any) -> str | None:
    """The unit that a dataset names in its attributes, as NetCDF and NeXus files do; of time, without its origin."""
    for name in node.attrs:
        if name.lower() in _UNIT:
            text = next(iter(np.ravel(node.attrs[name])), None)
            text = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
            if isinstance(text, str) and text.strip():
                return text.partition(" since ")[0].strip()
    return None


def _in_group(node: Any, way: str, path: Path, depth: int, named: Named) -> Iterator[Vector]:
    """Vectors of a struct, or of the elements of a struct array, whose fields are lists of references."""
    plain = {n: item for n, item in node.items() if not hasattr(item, "keys") and "MATLAB_class" not in item.attrs}
    lists = {name: item for name, item in plain.items() if item.dtype.kind == "O"}
    elements = max((item.size for item in lists.values()), default=0)
    if elements > _WIDEST:
        return
    for k in range(max(elements, 1)):
        place = f"{way}({k + 1})" if elements > 1 else way
        inside = {n: node.file[item[()].reshape(-1)[k]] for n, item in lists.items() if k < item.size}
        inside = inside if elements else {name: node[name] for name in node}
        found = [
            v for name, inner in inside.items() for v in _in_node(inner, f"{place}.{name}", path, depth + 1, named)
        ]
        texts = {n.lower(): _letters(x) or "" for n, x in inside.items() if x.attrs.get("MATLAB_class") == b"char"}
        yield from described(found, texts, place, way if elements > 1 else None)


def _value(node: Any, most: int) -> Any:
    """What `read_mat5` makes of the same content: numbers, text, cells and structs, of at most so many parts."""
    left = [most]

    def inside(node: Any, depth: int) -> Any:
        left[0] -= 1
        if depth > _DEEPEST or left[0] < 0:
            raise ValueError("cells in cells without end")
        if hasattr(node, "keys"):
            return {name: [inside(node[name], depth + 1)] for name in node}
        if node.dtype.kind == "O" and not node.attrs.get("MATLAB_empty", 0):
            cells = np.empty(node.size, dtype=object)
            for k, reference in enumerate(node[()].reshape(-1)):
                cells[k] = inside(node.file[reference], depth + 1)
            return cells
        return _leaf(node)

    return inside(node, 0)


def _leaf(node: Any) -> Any:
    """Numbers or text."""
    if node.attrs.get("MATLAB_empty", 0) or node.size > _LARGEST:
        return np.empty((0, 0))
    values = np.asarray(node["real"] if node.dtype.names else node[()])
    text = node.attrs.get("MATLAB_class") == b"char"
    return "".join(map(chr, values.reshape(-1).tolist())) if text else values.T


def _loaded(path: Path, address: str, row: int | None) -> np.ndarray:
    h5py = extra("h5py", "io", "reading a MATLAB 7.3 file")
    try:
        with h5py.File(path, "r") as file:
            node = file[address]
            values = node["real"] if node.dtype.names else node
            return np.asarray(values[()] if row is None else values[row], dtype=float).reshape(-1)
    except Exception as error:
        raise _damaged(path, error) from None
