"""What the equations of a model with symbols for its parameters are made of: models alike in it share their code."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from enum import Enum
from types import BuiltinFunctionType, FunctionType
from typing import Any

import numpy as np

from slipangle.ops import is_symbolic

_PLAIN = bool, int, str, bytes, Enum, type, BuiltinFunctionType, type(None)


def structure(thing: Any) -> tuple[Any, ...]:
    """All that tells one nest of records from another, symbols by their names and numbers to the last bit.

    Raises TypeError where it holds something of which this is not known: an expression of symbols, or a function or a
    record of somebody else, which may look at what is not in it.

    >>> structure((1.0, "r")) == structure((1.0, "r")), structure(0.0) == structure(-0.0)
    (True, False)
    """
    kind = type(thing)
    if is_symbolic(thing):
        if not (thing.is_scalar() and thing.is_symbolic()):
            raise TypeError(f"a {kind.__name__} is an expression; expected a symbol")
        return kind, thing.name()
    if isinstance(thing, float):
        return kind, float(thing).hex()
    if isinstance(thing, _PLAIN):
        return kind, thing
    if isinstance(thing, np.ndarray) and not thing.dtype.hasobject:
        return kind, thing.shape, thing.dtype.str, thing.tobytes()
    if kind in (tuple, list):
        return kind, *map(structure, thing)
    if kind is dict:
        return kind, *((structure(key), structure(value)) for key, value in thing.items())
    if isinstance(thing, FunctionType) and thing.__closure__ is None and _is_ours(thing):
        return kind, thing
    if is_dataclass(kind) and _is_ours(kind):
        return kind, *(structure(getattr(thing, f.name)) for f in fields(kind))
    raise TypeError(f"what a {kind.__name__} is made of is not known")


def _is_ours(thing: Any) -> bool:
    return str(thing.__module__).split(".")[0] == __name__.split(".")[0]  # none of what is executed by hand
