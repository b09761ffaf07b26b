"""MATLAB files of version 5 to 7: numbers, text, cells and structs, without trusting a byte of them.

`scipy.io.loadmat` reads more kinds of content but can crash the interpreter on a damaged file; a log from a rig is
numbers and a few words, and this reader ends in one sentence whatever the bytes are.

References
----------
.. [1] The MathWorks, MAT-File Format, level 5.
"""

import math
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slipangle.data.readers.matlab_objects import Opaque
from slipangle.errors import FormatError

_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {16: "utf-8", 17: "utf-16", 18: "utf-32"}
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _CHAR, _OBJECT = 1, 2, 4, 17
_COMPLEX = 0x0800  # flag of an array with an imaginary part
_LARGEST = 2**28  # bytes of one variable after inflation
_DEEPEST = 20


class _Bad(Exception):
    """What is wrong, in a few words."""


class _Element(NamedTuple):
    kind: int
    data: memoryview
    end: int


def read_mat5(path: str | Path) -> dict[str, Any]:
    """Variables of a MATLAB file by name.

    Numeric variables become float arrays of their shape, text strings, cells object arrays, structs dictionaries of
    object arrays, one entry per element; other kinds are left out.

    Raises FormatError if it is no MATLAB file of version 5 to 7, or damaged.
    """
    variables, _ = read_all(path)
    return {name: value for name, value in variables.items() if not isinstance(value, Opaque)}


def read_all(path: str | Path) -> tuple[dict[str, Any], tuple[Any, str]]:
    """The same with objects as `Opaque`, and what they hold: the cells, None without any, and their byte order.

    Raises FormatError as `read_mat5` does.
    """
    raw = memoryview(Path(path).read_bytes())
    if bytes(raw[:8]) == b"\x89HDF\r\n\x1a\n" or (len(raw) > 520 and bytes(raw[512:520]) == b"\x89HDF\r\n\x1a\n"):
        raise FormatError(
            f"'{path}' is a MATLAB 7.3 file; expected version 7 or older: save it in MATLAB with save(..., '-v7')"
        )
    order = {b"IM": "<", b"MI": ">"}.get(bytes(raw[126:128]))
    if order is None:
        raise FormatError(
            f"'{path}' is not a MATLAB file of version 5 to 7; expected one: save it in MATLAB with save(..., '-v7')"
        )
    variables: dict[str, Any] = {}
    objects: tuple[Any, str] = (None, order)
    last, at = int(np.frombuffer(raw, order + "u8", 1, 116)[0]), 128  # where the objects are
    try:
        while at + 8 <= len(raw):
            element, start = _element(raw, at, order), at
            at = element.end
            if element.kind == _COMPRESSED:
                element = _element(_inflated(element.data), 0, order)
            if element.kind == _MATRIX and start == last:
                objects = _objects(element.data, order)
            elif element.kind == _MATRIX:
                name, value = _matrix(element.data, order, 0)
                if value is not None:
                    variables[name] = value
    except (_Bad, zlib.error, UnicodeDecodeError, ValueError, IndexError, OverflowError, MemoryError) as error:
        raise FormatError(
            f"'{path}' is damaged after {len(variables)} variables ({str(error).splitlines()[0]}); expected a whole "
            "MATLAB file: copy or save it again"
        ) from None
    return variables, objects


def _objects(data: memoryview, order: str) -> tuple[Any, str]:
    """Cells of all objects and their byte order: a small file of its own inside an array of bytes."""
    at = 0
    for _ in range(3):  # flags, shape, name
        at = _element(data, at, order).end
    inside = _element(data, at, order).data
    own = {b"IM": "<", b"MI": ">"}.get(bytes(inside[2:4]))
    if own is None:
        return None, order
    _, value = _matrix(_element(inside, 8, own).data, own, 0)
    held = value.get("MCOS") if isinstance(value, dict) else None
    return (held[0].content if held is not None and len(held) and isinstance(held[0], Opaque) else None), own


def _inflated(data: memoryview) -> memoryview:
    inflate = zlib.decompressobj()
    content = inflate.decompress(data, _LARGEST)
    if not inflate.eof:
        raise _Bad("compressed data end early")
    return memoryview(content)


def _element(data: memoryview, at: int, order: str) -> _Element:
    """Tag and content of the element at a position; small elements hold their content in the tag."""
    if at + 8 > len(data):
        raise _Bad("an element ends early")
    first, second = (int(v) for v in np.frombuffer(data, order + "u4", 2, at))
    if first >> 16:
        kind, size, start, end = first & 0xFFFF, first >> 16, at + 4, at + 8
        if size > 4:
            raise _Bad("a small element is too long")
    else:
        kind, size, start = first, second, at + 8
        end = start + size + (-size % 8 if kind != _COMPRESSED else 0)
    if start + size > len(data):
        raise _Bad("an element is longer than the file")
    return _Element(kind, data[start : start + size], end)


def _numbers(element: _Element, order: str) -> np.ndarray:
    code = _NUMBERS.get(element.kind)
    if code is None:
        raise _Bad(f"numbers of unknown type {element.kind}")
    kind = np.dtype(order + code)
    return np.frombuffer(element.data[: len(element.data) // kind.itemsize * kind.itemsize], kind)


def _text(element: _Element, order: str) -> str:
    if element.kind in _TEXTS:
        suffix = {"<": "-le", ">": "-be"}[order] if element.kind != 16 else ""
        return bytes(element.data).decode(_TEXTS[element.kind] + suffix)
    return "".join(chr(int(c)) for c in _numbers(element, order))


def _matrix(data: memoryview, order: str, depth: int) -> tuple[str, Any]:
    """Name and value of an array element; None for kinds that are not read."""
    if depth > _DEEPEST:
        raise _Bad("cells in cells without end")
    if len(data) == 0:
        return "", np.empty((0, 0))
    flags = _element(data, 0, order)
    word = int(_numbers(flags, order)[0])
    kind = word & 0xFF
    if kind == _OBJECT:
        return _opaque(data, flags.end, order, depth)
    shape_element = _element(data, flags.end, order)
    shape = tuple(int(n) for n in _numbers(shape_element, order))
    # every number takes a byte at least, every cell a tag of eight; sparse arrays (kind 5) are not read
    if len(shape) < 2 or min(shape) < 0 or (kind != 5 and math.prod(shape) > len(data)):
        raise _Bad(f"an array of shape {shape}")
    name_element = _element(data, shape_element.end, order)
    name, at = _text(name_element, order), name_element.end
    count = math.prod(shape)
    if kind == _CHAR:
        letters = _text(_element(data, at, order), order)
        if len(shape) == 2 and shape[0] > 1 and len(letters) == count > 0:
            rows = np.array(list(letters)).reshape(shape, order="F")
            return name, np.array(["".join(row).rstrip() for row in rows], dtype=object)
        return name, letters
    if kind == _CELL:
        cells = np.empty(count, dtype=object)
        for k, value in enumerate(_values(data, at, order, count, depth)):
            cells[k] = value
        return name, cells
    if kind == _STRUCT:
        return name, _struct(data, at, order, count, depth)
    if 6 <= kind <= 15:
        parts = []
        for _ in range(2 if word & _COMPLEX else 1):
            element = _element(data, at, order)
            parts.append(_numbers(element, order).astype(float))
            at = element.end
            if len(parts[-1]) != count:
                raise _Bad(f"'{name}' holds {len(parts[-1])} numbers, its shape is {shape}")
        values = parts[0] if len(parts) == 1 or not parts[1].any() else parts[0] + 1j * parts[1]
        return name, values.reshape(shape, order="F")
    return name, None


def _opaque(data: memoryview, at: int, order: str, depth: int) -> tuple[str, Any]:
    """Name and value of an object: its class, and the numbers that name it."""
    words = []
    for _ in range(3):  # name, system of types, class
        element = _element(data, at, order)
        words.append(_text(element, order))
        at = element.end
    name, system, kind = words
    content = _element(data, at, order)
    if system != "MCOS" or content.kind != _MATRIX:
        return name, None
    return name, Opaque(kind, _matrix(content.data, order, depth + 1)[1])


def _values(data: memoryview, at: int, order: str, count: int, depth: int) -> Any:
    for _ in range(count):
        element = _element(data, at, order)
        if element.kind != _MATRIX:
            raise _Bad("a cell is no array")
        at = element.end
        yield _matrix(element.data, order, depth + 1)[1]


def _struct(data: memoryview, at: int, order: str, count: int, depth: int) -> dict[str, np.ndarray]:
    """Fields by name, one entry per element of the struct array."""
    length_element = _element(data, at, order)
    length = int(_numbers(length_element, order)[0]) if len(length_element.data) >= 4 else 0
    names_element = _element(data, length_element.end, order)
    raw = bytes(names_element.data)
    if length <= 0 or len(raw) % length:
        raise _Bad("a struct's field names do not add up")
    names = [raw[k : k + length].split(b"\0")[0].decode("ascii", "replace") for k in range(0, len(raw), length)]
    fields = {name: np.empty(count, dtype=object) for name in names}
    values = _values(data, names_element.end, order, count * len(names), depth)
    for k, value in enumerate(values):
        fields[names[k % len(names)]][k // len(names)] = value
    return fields
