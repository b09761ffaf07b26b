"""Damage to bytes, text and trees: what disks, editors, exporters and people do to files, and worse."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np

Rng = np.random.Generator

CELLS = (
    *("", " ", "-", ".", ",", "nan", "NaN", "inf", "-inf", "Infinity", "null", "None", "true", "x", "'", '"', '"a,b"'),
    *("0", "-0.0", "1e9", "-1e9", "1e308", "-1e308", "1e400", "1e-308", "5e-324", "1_0", "1,5", "2.5", "1,234", "0x10"),
    *("1e", "e5", "1.2.3", "--1", "+-1", "1 2", "１２", "½", "ü", "\x00", "\ufeff", "%", "#", "//", "9" * 400),
    *("[deg]", "(m/s)", "t [s]", "=1+1", "2024-01-02", "12:30:01", "1d5", "1D+5", "\u2212" + "1", "$", "!", "[", "]"),
    *("{", "}", "x" * 5000),
)  # fmt: skip
NUMBERS = (
    *(0, -0.0, 1, -1, 2, 0.5, 1e-9, 1e9, -1e9, 1e15, 1e16, 1e100, 1e308, -1e308, 5e-324, 2**31, 2**63),
    *(-(2**63), 10**400, float("nan"), float("inf"), float("-inf")),
)  # fmt: skip


def bytes_of(rng: Rng, raw: bytes) -> bytes:
    """The file with a few bytes changed, lost, doubled, swapped or cut off."""
    data = bytearray(raw)
    for _ in range(int(rng.choice([1, 2, 4, 16]))):
        n = len(data)
        if not n:
            break
        a = int(rng.integers(n))
        b = min(n, a + int(rng.choice([1, 2, 8, 64, 1024])))
        kind = int(rng.integers(8))
        if kind == 0:
            data[a] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[a] = int(rng.integers(256))
        elif kind == 2:
            del data[a:b]
        elif kind == 3:
            data[a:a] = data[a:b]
        elif kind == 4:
            data[a:a] = rng.integers(256, size=b - a, dtype=np.uint8).tobytes()
        elif kind == 5:
            data[a : a + 4] = int(rng.choice([0, 1, 2**31 - 1, 2**31, 2**32 - 1, 255, 65535])).to_bytes(4, "little")
        elif kind == 6:
            data[a:b] = b"\0" * (b - a)
        else:
            del data[a:]
    return bytes(data)


def text_of(rng: Rng, text: str) -> str:
    """The text with cells or lines changed, lost, doubled or swapped."""
    lines = text.split("\n")
    for _ in range(int(rng.choice([1, 1, 2, 5, 20]))):
        i = int(rng.integers(len(lines)))
        kind = int(rng.integers(9))
        if kind < 4:
            lines[i] = _cell_changed(rng, lines[i])
        elif kind == 4 and len(lines) > 1:
            del lines[i]
        elif kind == 5:
            lines.insert(i, lines[int(rng.integers(len(lines)))])
        elif kind == 6:
            lines[i] = str(rng.choice(CELLS))
        elif kind == 7:
            old, new = (str(c) for c in rng.choice([",", ";", "\t", " ", ".", "=", "'", '"', "\r", "\0"], 2))
            lines[i:] = [line.replace(old, new) for line in lines[i:]]
        else:
            lines[i] = lines[i][: int(rng.integers(len(lines[i]) + 1))]
    return str(rng.choice(["\n", "\n", "\r\n", "\r"])).join(lines)


def _cell_changed(rng: Rng, line: str) -> str:
    for separator in rng.permutation([",", ";", "\t", " ", "="]).tolist():
        if separator in line:
            cells = line.split(separator)
            i = int(rng.integers(len(cells)))
            change = str(rng.choice(CELLS))
            cells[i] = change if rng.random() < 0.7 else cells[i] + change
            return separator.join(cells)
    return line + str(rng.choice(CELLS))


def encoded(rng: Rng, text: str) -> bytes:
    """The text in one of the encodings that files have, rarely a wrong one."""
    name = str(rng.choice(["utf-8", "utf-8", "utf-8", "utf-8-sig", "latin-1", "utf-16", "utf-16-le", "cp1252"]))
    return text.encode(name, errors="replace")


def places(node: Any, path: tuple = ()) -> Iterator[tuple]:
    """Paths to every entry of nested dictionaries and lists."""
    yield path
    for key, child in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield from places(child, (*path, key))


def tree_of(rng: Rng, tree: Any) -> Any:
    """The tree with entries changed, lost, doubled, renamed, or put in another place."""
    tree = copy.deepcopy(tree)
    for _ in range(int(rng.choice([1, 1, 2, 4]))):
        every = [p for p in places(tree) if p]
        if not every:
            break
        path = every[int(rng.integers(len(every)))]
        parent = tree
        for key in path[:-1]:
            parent = parent[key]
        key = path[-1]
        kind = int(rng.integers(10))
        if kind < 5:
            parent[key] = _value(rng, parent[key])
        elif kind == 5:
            del parent[key]
        elif kind == 6:
            other = every[int(rng.integers(len(every)))]
            node = tree
            for k in other:
                node = node[k]
            parent[key] = copy.deepcopy(node)
        elif kind == 7 and isinstance(parent, list):
            parent.insert(key, copy.deepcopy(parent[key]))
        elif kind == 8 and isinstance(parent, dict):
            parent[f"{key}{rng.choice(['', 's', '_', 'ü', 'x' * 3000])}"] = parent.pop(key)
        else:
            parent[key] = [parent[key]] if rng.random() < 0.5 else {str(key): parent[key]}
    return tree


def _value(rng: Rng, old: Any) -> Any:
    if isinstance(old, (int, float)) and abs(old) < 1e300 and rng.random() < 0.7:
        near = (NUMBERS[int(rng.integers(len(NUMBERS)))], old * 10.0, -old, old + 1, int(old))
        return near[int(rng.integers(len(near)))]
    odd = (None, True, False, [], {}, "", "x", "ü", "x" * 3000, [[]], [0] * 50, {"float": {}}, {"array": []}, [None])
    number = NUMBERS[int(rng.integers(len(NUMBERS)))]
    return number if rng.random() < 0.3 else odd[int(rng.integers(len(odd)))]
