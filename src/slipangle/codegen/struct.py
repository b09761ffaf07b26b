"""The memory of a compiled solver: one C struct, whose fields are arrays here."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from importlib.resources import files
from math import prod

import numpy as np

ALIGNED = 64  # bytes, of the widest vectors


def clock() -> str:
    """C of ``monotonic()``, seconds of the system's clock; to be put before anything else."""
    text = (files("slipangle.codegen") / "clock.h").read_text(encoding="utf-8")
    return f"#define _POSIX_C_SOURCE 200809L\n{text}"


def accessors(prefix: str, names: Sequence[str]) -> str:
    """C of ``PREFIX_size`` and ``PREFIX_at`` for a struct ``Work``: its bytes, and where its fields are."""
    cases = "\n".join(f"    case {i}: return &s->{name};" for i, name in enumerate(names))
    return f"""
long {prefix}_size(void) {{ return (long)sizeof(Work); }}
void *{prefix}_at(Work *s, int i)
{{
    switch (i) {{
{cases}
    }}
    return (void *)0;
}}
"""


class Struct:
    """A struct of a library with `accessors`, zeros to begin with, in memory of this object.

    Fields are numbers, or arrays of these ``shapes``; those in ``counts`` are whole numbers.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        prefix: str,
        names: Sequence[str],
        shapes: Mapping[str, tuple[int, ...]],
        counts: Sequence[str] = (),
    ) -> None:
        size, at = (getattr(library, f"{prefix}_{what}") for what in ("size", "at"))
        raw = np.zeros(size() + ALIGNED, dtype=np.uint8)
        self._memory = raw[-raw.ctypes.data % ALIGNED :]
        start = self._memory.ctypes.data
        self.pointer = ctypes.c_void_p(start)
        self.fields: dict[str, np.ndarray] = {}
        for i, name in enumerate(names):
            shape = shapes.get(name, (1,))
            first = at(self.pointer, i) - start
            block = self._memory[first : first + 8 * max(prod(shape), 1)]
            self.fields[name] = block.view(np.int64 if name in counts else np.float64)[: prod(shape)].reshape(shape)
