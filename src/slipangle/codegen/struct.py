"""The memory of a compiled solver: one C struct, whose fields are arrays here."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from math import prod
from typing import Any

import numpy as np


def accessors(prefix: str, names: Sequence[str]) -> str:
    """C of ``PREFIX_new``, ``PREFIX_free`` and ``PREFIX_at`` for a struct ``Work``: zeros, and where its fields are."""
    cases = "\n".join(f"    case {i}: return &s->{name};" for i, name in enumerate(names))
    return f"""
Work *{prefix}_new(void)
{{
    void *at = NULL;
    return posix_memalign(&at, 64, sizeof(Work)) ? NULL : memset(at, 0, sizeof(Work));
}}
void {prefix}_free(Work *s) {{ free(s); }}
void *{prefix}_at(Work *s, int i)
{{
    switch (i) {{
{cases}
    }}
    return NULL;
}}
"""


class Struct:
    """A struct of a library with `accessors`, freed with this object.

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
        new, self._free, at = (getattr(library, f"{prefix}_{what}") for what in ("new", "free", "at"))
        self.pointer = ctypes.c_void_p(new())
        if not self.pointer:
            raise MemoryError("no memory for the solver")
        self.fields: dict[str, np.ndarray] = {}
        for i, name in enumerate(names):
            shape = shapes.get(name, (1,))
            kind, dtype = (ctypes.c_int64, np.int64) if name in counts else (ctypes.c_double, np.float64)
            block: Any = (kind * max(prod(shape), 1)).from_address(at(self.pointer, i))
            self.fields[name] = np.frombuffer(block, dtype=dtype)[: prod(shape)].reshape(shape)

    def __del__(self) -> None:
        if getattr(self, "pointer", None):
            self._free(self.pointer)
