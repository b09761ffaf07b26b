"""Entries of a TOML table, checked against the names and types that a record or a function takes."""

import inspect
import typing
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from slipangle.errors import ConfigError, ParameterError, nearest, shown
from slipangle.fields import Seed as Seed
from slipangle.fields import Within
from slipangle.workflow.hints import (
    SIMPLE,
    bound,
    called,
    expressible,
    is_log,
    is_model,
    is_named,
    is_record,
    parts,
    words,
)

T = TypeVar("T")
_LARGEST = 10**15  # of the whole numbers in a job
_COUNT = 10**6  # of those that have no bound of their own
_MANY, _WIDE = 64, 1000  # entries that a list and a table of a job may have

Weight = Annotated[float, Within(0, 1e12)]


class OtherModel(str):
    """The name of another model of a job, where a setting is a model."""

    __slots__ = ()


class OtherLogs(tuple[str, ...]):
    """The names of files of another log than the job's own, where a setting is a data set."""

    __slots__ = ()


@dataclass(frozen=True)
class Entry:
    """One name that a table may have: what it takes, and what it is otherwise; MISSING where the table must say it."""

    name: str
    hint: Any
    default: Any = MISSING

    @property
    def needed(self) -> bool:
        """Whether a table must have it."""
        return self.default is MISSING


@dataclass(frozen=True)
class Made:
    """A class whose settings a job says, and a function that makes one of it from them and what it knows otherwise.

    Parameters
    ----------
    of : type
        Its fields are the entries of the table.
    given : tuple of str
        Fields that the function gives.
    make : callable
        Called with what a function in its place would be called with.
    """

    of: type
    given: tuple[str, ...]
    make: Callable[..., Any]

    def __call__(self, *known: Any, **entries: Any) -> Any:
        """What the function makes."""
        return self.make(*known, **entries)


def entries_of(thing: Callable[..., Any], skip: int = 0) -> dict[str, Entry]:
    """What a table for a record, a class or a function may say; what TOML cannot say is left out.

    Parameters
    ----------
    thing : callable
        Its fields or parameters are the entries; of `Made` those of the class that are not given.
    skip : int
        How many leading ones of a function are given otherwise.
    """
    if isinstance(thing, Made):
        return {name: entry for name, entry in entries_of(thing.of).items() if name not in thing.given}
    hints = _hints(thing)
    if isinstance(thing, type) and is_dataclass(thing):
        known = {f.name: _default(f) for f in fields(thing) if f.init and f.metadata.get("in_jobs", True)}
    else:
        named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
        takes = [p for p in inspect.signature(thing).parameters.values() if p.kind in named]
        known = {p.name: MISSING if p.default is inspect.Parameter.empty else p.default for p in takes}
    own = {name: Entry(name, hints.get(name, Any), known[name]) for name in list(known)[skip:]}
    return {name: entry for name, entry in own.items() if expressible(entry.hint)}


def _default(field: Any) -> Any:
    return field.default if field.default_factory is MISSING else field.default_factory()


def _hints(thing: Callable[..., Any]) -> dict[str, Any]:
    own = is_dataclass(thing) or inspect.isfunction(thing)
    try:
        return typing.get_type_hints(thing if own else thing.__init__, include_extras=True)
    except (NameError, TypeError, AttributeError):  # annotations that only a type checker can read
        return {}


def record(cls: type[T], table: dict[str, Any], where: str) -> T:
    """A dataclass from a table.

    Raises ConfigError if an entry is unknown, missing or of the wrong type; the nearest names are given.
    """
    try:
        return cls(**_checked(table, entries_of(cls), where))
    except ParameterError as error:
        raise ConfigError(f"{where}: {error}") from None


def common(cls: type[T], table: dict[str, Any], where: str) -> tuple[T, dict[str, Any]]:
    """A dataclass from those entries of a table that are its own, and the other ones."""
    own = entries_of(cls)
    others = {key: value for key, value in table.items() if key not in own}
    return record(cls, {key: table[key] for key in table if key in own}, where), others


def of_kind(
    cls: type[T],
    kinds: Mapping[str, Callable[..., Any]],
    table: dict[str, Any],
    where: str,
    *,
    skip: int = 0,
    every: bool = True,
) -> T:
    """A dataclass whose ``kind`` is one of ``kinds``, and whose ``entries`` are what that one takes, checked.

    ``skip`` is that of `arguments`, ``every`` that of `slipangle.errors.nearest`. Raises ConfigError as `arguments`
    does, and if there is no such kind.
    """
    wanted: Any
    wanted, own = common(cls, table, where)
    if wanted.kind not in kinds:
        near = nearest(wanted.kind[:60], kinds, every=every)
        raise ConfigError(f"{where}: kind is {shown(wanted.kind)}; {near}: use one of these")
    return replace(wanted, entries=arguments(kinds[wanted.kind], own, where, skip=skip))


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
    return _checked(table, entries_of(call, skip), where)


def _checked(table: dict[str, Any], known: dict[str, Entry], where: str) -> dict[str, Any]:
    for key in table:
        if key not in known:
            near = nearest(key[:60], known, every=True)
            raise ConfigError(f"{where} has no entry {shown(key)}; {near}: use one of these names")
    for name, entry in known.items():
        if entry.needed and name not in table:
            raise ConfigError(f"{where} lacks the entry '{name}'; expected it: add {name} = ...")
    return {key: _value(value, known[key].hint, f"{where}: {key}", known[key].default) for key, value in table.items()}


def _value(value: Any, hint: Any, where: str, default: Any = None) -> Any:
    """One entry, converted to what the record's field says."""
    hint = bound(hint)
    kind, options = parts(hint)
    if kind is Annotated:
        return _in_range(_value(value, options[0], where), options, where)
    if kind is typing.Union:
        return _value_of_any(value, [o for o in options if expressible(o)], where, default)
    if kind is Literal:
        if not any(type(value) is type(o) and value == o for o in options):
            near = nearest(str(value)[:60], map(str, options), every=True)
            raise ConfigError(f"{where} is {shown(value)}; {near}: use one of these")
        return value
    if kind is tuple:
        return _list(value, options, where)
    if kind is dict:
        if not isinstance(value, dict):
            raise ConfigError(f"{where} is {shown(value)}; expected a table of name = value")
        _bounded(len(value), _WIDE, where)
        return {k: _value(v, options[1], f"{where}.{shown(k)[1:-1]}") for k, v in value.items()}
    if hint is Path:
        return Path(_value(value, str, where))
    if is_model(hint):
        return OtherModel(_value(value, str, where))
    if is_log(hint):
        return _logs(value, where)
    if is_named(hint):
        try:
            return hint(_value(value, dict[str, Any], where))
        except ParameterError as error:
            raise ConfigError(f"{where}: {error}") from None
    if is_record(hint):
        return _table(value, hint, where, default)
    return _plain(value, hint, where)


def _in_range(number: Any, options: tuple[Any, ...], where: str) -> Any:
    for span in options[1:]:
        if not isinstance(span, Within) or is_named(options[0]):
            continue
        if options[0] is int and span.high == inf:
            span = replace(span, high=_COUNT)
        if number not in span:
            unit = f" {span.unit}" if span.unit else ""
            said = f"{span.low:g} to {span.high:g}{unit}" if span.high < inf else span.sentence(options[0] is int)
            raise ConfigError(f"{where} is {shown(number)}{unit}; expected {said}: correct it")
    return number


def _list(value: Any, options: tuple[Any, ...], where: str) -> tuple[Any, ...]:
    inner: Any = options[0]
    items = value if isinstance(value, list | tuple) else [value]  # one entry may stand without brackets
    _bounded(len(items), _MANY, where)
    if items is not value and not isinstance(value, str | dict) and not _is_number(value):
        raise ConfigError(f"{where} is {shown(value)}; expected a list")
    if options[-1] is not ... and len(options) > 1 and len(items) != len(options):
        raise ConfigError(f"{where} is {shown(value)}; expected {len(options)} entries")
    return tuple(_value(v, inner, f"{where}[{i}]") for i, v in enumerate(items))


def _logs(value: Any, where: str) -> OtherLogs:
    files = OtherLogs(_value(value, tuple[str, ...], where))
    if not files or not all(name.strip() for name in files):
        raise ConfigError(f'{where} is {shown(value)}; expected files such as ["log.csv"]: name one or more')
    return files


def _table(value: Any, hint: Any, where: str, default: Any) -> Any:
    """A record from its table; where there is a default, the table says what differs from it."""
    if isinstance(value, str) and hasattr(hint, "from_text"):
        return hint.from_text(value)
    if not isinstance(value, dict):
        raise ConfigError(f"{where} is {shown(value)}; expected a table")
    if hasattr(hint, "from_table"):
        return hint.from_table(value, where)
    if value.get("kind") == called(hint) and "kind" not in entries_of(hint):
        value = {key: own for key, own in value.items() if key != "kind"}
    if type(default) is not hint:
        return record(hint, value, where)
    optional = {name: replace(entry, default=None) for name, entry in entries_of(hint).items()}
    try:
        return replace(default, **_checked(value, optional, where))
    except ParameterError as error:
        raise ConfigError(f"{where}: {error}") from None


def _plain(value: Any, hint: Any, where: str) -> Any:
    """A number, text, or true and false."""
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > _LARGEST:
        raise ConfigError(f"{where} is {shown(value)}; expected a number of at most {len(str(_LARGEST))} digits")
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if hint not in SIMPLE:  # of a kind that TOML does not have: whoever asked for it checks it
        return value
    if not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool):
        raise ConfigError(f"{where} is {shown(value)}; expected {SIMPLE[hint]}")
    if isinstance(value, float) and not isfinite(value):
        raise ConfigError(f"{where} is {value}; expected a finite number")
    return value


def _value_of_any(value: Any, hints: list[Any], where: str, default: Any) -> Any:
    """One entry of several kinds: those that its shape fits, the first that takes it."""
    fitting = [hint for hint in hints if _fits(value, hint)]
    fitting = fitting or [hint for hint in hints if parts(hint)[0] is tuple and not isinstance(value, dict)]
    if isinstance(value, dict) and len(fitting) > 1 and all(map(is_record, fitting)):
        return _of_kind(value, fitting, where, default)
    for hint in fitting[:-1]:
        try:
            return _value(value, hint, where, default)
        except ConfigError:
            continue
    if len(fitting) == 1 and parts(fitting[0])[0] is not Literal:
        return _value(value, fitting[0], where, default)
    if fitting:
        try:
            return _value(value, fitting[-1], where, default)
        except ConfigError:
            if not isinstance(value, str):
                raise
    raise ConfigError(f"{where} is {shown(value)}; expected {words(typing.Union[tuple(hints)])}")  # noqa: UP007


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value has the shape of a hint: a list, a table, text, or a number."""
    kind, options = parts(hint)
    if kind is Annotated:
        return _fits(value, options[0])
    if kind is tuple:
        return isinstance(value, list | tuple)
    if is_log(hint):
        return isinstance(value, str | list | tuple)
    if kind is dict or is_named(hint):
        return isinstance(value, dict)
    if is_record(hint):
        return isinstance(value, dict) or (isinstance(value, str) and hasattr(hint, "from_text"))
    if kind is Literal:
        return any(type(value) is type(o) for o in options)
    if hint in (str, Path) or is_model(hint):
        return isinstance(value, str)
    return not isinstance(value, dict | list | tuple) and (not isinstance(value, str) or hint is Any)


def _of_kind(table: dict[str, Any], hints: list[Any], where: str, default: Any) -> Any:
    """A record of one of several kinds, named by ``kind``; by default that of the default, else the first."""
    kinds = {called(hint): hint for hint in hints}
    usual = called(type(default)) if type(default) in hints else next(iter(kinds))
    name = table.get("kind", usual)
    if not isinstance(name, str) or name not in kinds:
        raise ConfigError(f"{where}: kind is {shown(name)}; {nearest(str(name)[:60], kinds)}: use one of these")
    return _table({k: v for k, v in table.items() if k != "kind"}, kinds[name], where, default)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _bounded(count: int, most: int, where: str) -> None:
    if count > most:
        raise ConfigError(f"{where} has {count} entries; expected at most {most}")
