"""Entries of a TOML table, checked against the names and types that a record or a function takes."""

import inspect
import types
import typing
from collections.abc import Callable, Sequence
from dataclasses import MISSING, fields
from math import isfinite
from typing import Annotated, Any, Literal, TypeVar

from slipangle.errors import ConfigError, nearest, shown
from slipangle.fields import Within

T = TypeVar("T")
_LARGEST = 10**15  # of the whole numbers in a job
_MANY, _WIDE = 64, 1000  # entries that a list and a table of a job may have

Lags = Annotated[int, Within(0, 1000, "samples")]
Seed = Annotated[int, Within(0, 2**32 - 1)]
Weight = Annotated[float, Within(0, 1e12)]


def record(cls: type[T], table: dict[str, Any], where: str) -> T:
    """A dataclass from a table.

    Raises ConfigError if an entry is unknown, missing or of the wrong type; the nearest names are given.
    """
    hints = typing.get_type_hints(cls, include_extras=True)
    known = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    needed = {n for n, f in known.items() if f.default is MISSING and f.default_factory is MISSING}
    return cls(**_checked(table, {n: hints[n] for n in known}, needed, where))


def common(cls: type[T], table: dict[str, Any], where: str) -> tuple[T, dict[str, Any]]:
    """A dataclass from those entries of a table that are its fields, but for ``entries``, and the other ones."""
    own = {f.name for f in fields(cls)} - {"entries"}  # type: ignore[arg-type]
    others = {key: value for key, value in table.items() if key not in own}
    return record(cls, {key: table[key] for key in table if key in own}, where), others


def arguments(call: Callable[..., Any], table: dict[str, Any], where: str, *, skip: int = 0) -> dict[str, Any]:
    """A table as keyword arguments of a function or class, each checked against its annotation where it has one.

    Raises ConfigError if an entry is unknown, missing or of the wrong type; the nearest names are given.

    Parameters
    ----------
    call : callable
        Its parameters are the entries that the table may have.
    table : dict
        As TOML has it.
    where : str
        Place of the table, for messages.
    skip : int
        How many leading parameters are given otherwise.
    """
    try:
        hints = typing.get_type_hints(call if inspect.isfunction(call) else call.__init__, include_extras=True)
        hints |= typing.get_type_hints(call, include_extras=True) if isinstance(call, type) else {}
    except (NameError, TypeError, AttributeError):  # annotations that only a type checker can read
        hints = {}
    named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    known = [p for p in inspect.signature(call).parameters.values() if p.kind in named][skip:]
    needed = {p.name for p in known if p.default is inspect.Parameter.empty}
    return _checked(table, {p.name: hints.get(p.name, Any) for p in known}, needed, where)


def _checked(table: dict[str, Any], known: dict[str, Any], needed: set[str], where: str) -> dict[str, Any]:
    for key in table:
        if key not in known:
            raise ConfigError(f"{where} has no entry {shown(key)}; {nearest(key[:60], known)}: use one of these names")
    for name in known:
        if name in needed and name not in table:
            raise ConfigError(f"{where} lacks the entry '{name}'; expected it: add {name} = ...")
    return {key: _value(value, known[key], f"{where}: {key}") for key, value in table.items()}


def _value(value: Any, hint: Any, where: str) -> Any:
    """One entry, converted to what the record's field says."""
    if typing.get_origin(hint) is Annotated:
        inner, *more = typing.get_args(hint)
        number = _value(value, inner, where)
        for span in more:
            if number not in span:
                unit = f" {span.unit}" if span.unit else ""
                raise ConfigError(
                    f"{where} is {shown(number)}{unit}; expected {span.low:g} to {span.high:g}{unit}: correct it"
                )
        return number
    origin, options = typing.get_origin(hint), typing.get_args(hint)
    if origin is types.UnionType or origin is typing.Union:
        return _value_of_any(value, [a for a in options if a is not type(None)], where)
    if origin is Literal:
        if value not in options:
            raise ConfigError(
                f"{where} is {shown(value)}; {nearest(str(value)[:60], map(str, options))}: use one of these"
            )
        return value
    if origin in (tuple, list, Sequence):
        items = value if isinstance(value, list | tuple) else [value]  # one entry may stand without brackets
        _bounded(len(items), _MANY, where)
        if items is not value and not isinstance(value, str | dict) and not _is_number(value):
            raise ConfigError(f"{where} is {shown(value)}; expected a list")
        return tuple(_value(v, options[0], f"{where}[{i}]") for i, v in enumerate(items))
    if origin is dict:
        if not isinstance(value, dict):
            raise ConfigError(f"{where} is {shown(value)}; expected a table of name = value")
        _bounded(len(value), _WIDE, where)
        return {k: _value(v, options[1], f"{where}.{shown(k)[1:-1]}") for k, v in value.items()}
    if hasattr(hint, "__dataclass_fields__"):
        if isinstance(value, str) and hasattr(hint, "from_text"):
            return hint.from_text(value)
        if not isinstance(value, dict):
            raise ConfigError(f"{where} is {shown(value)}; expected a table")
        return hint.from_table(value, where) if hasattr(hint, "from_table") else record(hint, value, where)
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > _LARGEST:
        raise ConfigError(f"{where} is {shown(value)}; expected a number of at most {len(str(_LARGEST))} digits")
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if hint not in _SPOKEN:  # of a kind that TOML does not have: whoever asked for it checks it
        return value
    if not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool):
        raise ConfigError(f"{where} is {shown(value)}; expected {_SPOKEN.get(hint, hint.__name__)}")
    if isinstance(value, float) and not isfinite(value):
        raise ConfigError(f"{where} is {value}; expected a finite number")
    return value


def _value_of_any(value: Any, hints: list[Any], where: str) -> Any:
    listed = isinstance(value, list | tuple)
    hints = [hint for hint in hints if (typing.get_origin(hint) is tuple) == listed] or hints
    for hint in hints[:-1]:
        try:
            return _value(value, hint, where)
        except ConfigError:
            continue
    return _value(value, hints[-1], where)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _bounded(count: int, most: int, where: str) -> None:
    if count > most:
        raise ConfigError(f"{where} has {count} entries; expected at most {most}")


_SPOKEN = {float: "a number", int: "a whole number", str: "text in quotes", bool: "true or false"}
