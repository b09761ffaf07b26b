"""What a type hint asks for: whether TOML can say it, and in words."""

import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from slipangle.data.dataset import Dataset
from slipangle.fields import Within
from slipangle.models.model import Model
from slipangle.optimal.terms import Limits, Named
from slipangle.units import SI

SIMPLE: dict[Any, str] = {float: "a number", int: "a whole number", str: "text in quotes", bool: "true or false"}


def parts(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """Kind of a hint, and what stands in its brackets; lists are tuples, mappings dictionaries, both unions one."""
    origin = typing.get_origin(hint)
    if origin is Annotated:
        return Annotated, typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        return typing.Union, tuple(o for o in map(bound, typing.get_args(hint)) if o is not type(None))
    if origin in (tuple, list, Sequence):
        return tuple, typing.get_args(hint)
    if origin in (dict, Mapping):
        return dict, typing.get_args(hint)
    return origin, typing.get_args(hint)


def bound(hint: Any) -> Any:
    """What a type variable stands for, else the hint."""
    return hint.__bound__ if isinstance(hint, TypeVar) else hint


def is_model(hint: Any) -> bool:
    """Whether it is a model, which a job names by the name of another one of its models."""
    return isinstance(hint, type) and issubclass(hint, Model)


def is_log(hint: Any) -> bool:
    """Whether it is a data set, which a job names by its files."""
    return hint is Dataset


def is_named(hint: Any) -> bool:
    """Whether it is `Values`, `Weights` or `Limits`."""
    return isinstance(hint, type) and issubclass(hint, Named)


def is_record(hint: Any) -> bool:
    """Whether it is a record that a table stands for."""
    return isinstance(hint, type) and is_dataclass(hint) and not is_model(hint) and not is_log(hint)


def called(cls: type) -> str:
    """A class as a job names it: "box-jenkins" for BoxJenkins, "data" for DataSettings; "job" for Settings."""
    name, text = cls.__name__.removesuffix("Settings") or "Job", ""
    for k, letter in enumerate(name):
        before, after = name[k - 1 : k], name[k + 1 : k + 2]
        text += "-" * (k > 0 and letter.isupper() and (before.islower() or after.islower())) + letter.lower()
    return text


def expressible(hint: Any) -> bool:
    """Whether TOML can say it: not a function, an array, or a table of anything."""
    hint = bound(hint)
    kind, inside = parts(hint)
    if hint is Any or hint is Path or hint in SIMPLE or kind is Literal:
        return True
    if is_model(hint) or is_log(hint) or is_named(hint):
        return True
    if kind is typing.Union:
        return any(map(expressible, inside))
    if kind is Annotated:
        return expressible(inside[0])
    if kind is tuple:
        return all(expressible(i) for i in inside if i is not ...)
    if kind is dict:
        return inside[1] is not Any and expressible(inside[1])
    if is_record(hint):
        hints = typing.get_type_hints(hint, include_extras=True)
        needed = [f for f in fields(hint) if f.default is MISSING and f.default_factory is MISSING]
        return all(expressible(hints[f.name]) for f in needed)
    return False


def words(hint: Any) -> str:
    """What is expected, such as "a whole number of at least 1, or "chosen""."""
    hint = bound(hint)
    kind, inside = parts(hint)
    if hint in SIMPLE:
        return SIMPLE[hint]
    if hint is Path:
        return "a file, relative to the job"
    if kind is Annotated:
        said = [_span(span, inside[0]) for span in inside[1:] if isinstance(span, Within | SI)]
        return said[0] if said else words(inside[0])
    if kind is Literal:
        return " or ".join(f'"{o}"' if isinstance(o, str) else str(o) for o in inside)
    if kind is typing.Union:
        return ", or ".join(dict.fromkeys(words(o) for o in inside if expressible(o)))
    if kind is tuple:
        several = inside[-1] is ... or len(inside) == 1
        return f"a list, each {words(inside[0])}" if several else f"[{', '.join(words(i) for i in inside)}]"
    if kind is dict:
        return f"a table of name = {words(inside[1])}"
    if is_named(hint):
        pair = "[lowest, highest], or one number for both" if issubclass(hint, Limits) else "a number"
        return f"a table of name = {pair}"
    if is_model(hint):
        return "the name of another model of the job"
    if is_log(hint):
        return "a list, each a file, relative to the job"
    if is_record(hint):
        return f"a table ({called(hint)})"
    return "anything"


def _span(span: Within | SI, inner: Any) -> str:
    if isinstance(span, SI):
        span = Within(span.lower, span.upper, "" if span.unit == "-" else span.unit)
    whole = inner is int
    if parts(inner)[0] is tuple or is_named(inner) or parts(inner)[0] is dict:
        return f"{words(inner)}, {span.sentence(whole).removeprefix('a ')}"
    if span.low == -inf and span.high == inf and not whole:
        return SIMPLE[float]
    return span.sentence(whole)
