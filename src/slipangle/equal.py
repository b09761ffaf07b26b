"""`Equal`: things made of fields that are the same where their fields are, arrays by their numbers."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


class Equal:
    """Mixin of dataclasses, whose own comparison does not know arrays.

    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Line(Equal):
    ...     points: np.ndarray
    >>> Line(np.arange(3.0)) == Line(np.arange(3.0)), Line(np.arange(3.0)) == Line(np.ones(3))
    (True, False)
    """

    def __init_subclass__(cls, **given: Any) -> None:
        super().__init_subclass__(**given)
        for name in ("__eq__", "__hash__"):  # a class has these of its own, or `dataclass` would write others
            if name not in vars(cls):
                setattr(cls, name, vars(Equal)[name])

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        if type(other) is not type(self) or not is_dataclass(self):
            return NotImplemented
        return all(_same(getattr(self, name), getattr(other, name)) for name in _compared(self))

    def __hash__(self) -> int:
        if not is_dataclass(self):
            return object.__hash__(self)
        return hash((type(self), *(_hashed(getattr(self, name)) for name in _compared(self))))


def _compared(thing: Any) -> list[str]:
    return [f.name for f in fields(thing) if f.compare]


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return type(a) is type(b) and np.array_equal(a, b)
    if isinstance(a, tuple | list) and type(a) is type(b):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    return bool(a == b)


def _hashed(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.shape
    if isinstance(value, tuple | list):
        return tuple(map(_hashed, value))
    if isinstance(value, dict):
        return frozenset(value)
    return value
