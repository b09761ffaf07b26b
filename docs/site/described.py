"""What an argument is, as the reference says it, and what the reference lacks: words, units, shapes, errors."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

from docs.site.conventions import ARGUMENTS, FILES
from docs.site.public import function_of, is_property, members

from slipangle import errors
from slipangle.models.parameters import ParameterSet

_ERRORS = {name for name, thing in vars(errors).items() if inspect.isclass(thing) and issubclass(thing, Exception)}
_UNIT = re.compile(r"\[[^\[\]\n]{1,40}\]|\bSI\b|\bunits?\b|\bseed\b|\bfactor\b|\bshare\b|\bsamples\b|\bshape\b")
_SHAPE = re.compile(r"\bshapes? |one per|for each|per (?:sample|row|column)")
_NUMBER, _ARRAY = re.compile(r"\bfloat\b|\bScalar\b"), re.compile(r"ndarray|\bVector\b|ArrayLike")


def lacks(name: str, thing: Any) -> list[str]:
    """Sentences on what the reference does not say of a class, with its own members, or of a function."""
    if not inspect.isclass(thing):
        return _of_callable(name, thing, inspect.getdoc(thing) or "")
    said = _of_class(name, thing)
    for key, member in members(thing).items():
        said += _of_callable(f"{name}.{key}", function_of(member), text_of(thing, key), is_property(member))
    return said


def text_of(kind: type, key: str) -> str:
    """Docstring of a method or property, with those of what it overrides: a contract is described once."""
    found = [function_of(vars(base)[key]) for base in kind.__mro__ if key in vars(base)]
    listed = (_entry(inspect.getdoc(base) or "", key) for base in kind.__mro__ if key in inspect.get_annotations(base))
    return "\n\n".join([*(inspect.cleandoc(f.__doc__) for f in found if f and f.__doc__), *(e for e in listed if e)])


def added(thing: Any, contract: str = "") -> Iterator[tuple[str, str, str]]:
    """Arguments that a docstring does not describe: name, type, meaning.

    They are those of comments, of the ``contract`` (docstrings of what a method overrides), and of conventions.
    """
    text, hints = (
        (_class_text(thing), _fields(thing)) if inspect.isclass(thing) else (inspect.getdoc(thing) or "", None)
    )
    hints = _hints(thing) if hints is None else hints
    comments = _comments(thing) if inspect.isclass(thing) else {}
    for key, hint in hints.items():
        if _entry(text, key) is None:
            if key in comments:
                yield key, hint, comments[key]
            elif said := re.search(rf"^{key} : (.*)\n((?: +.*\n?)+)", contract, re.M):
                yield key, said[1], " ".join(said[2].split())
            elif (known := _convention(key, hint)) is not None:
                yield key, *known


def _convention(key: str, hint: str) -> tuple[str, str] | None:
    file = key in ("path", "folder") and "str" in hint
    return FILES if file else ARGUMENTS.get(key)


def _of_class(name: str, kind: type) -> list[str]:
    if not kind.__doc__:
        return [f"{name}: no docstring"]
    if issubclass(kind, BaseException):
        return []
    text, known = _class_text(kind), kind.metadata() if issubclass(kind, ParameterSet) else {}
    text += "".join(f"\n{key} : {hint}\n    {meaning}\n" for key, hint, meaning in added(kind))
    said = []
    for key, hint in _fields(kind).items():
        entry = _entry(text, key)
        if key not in known and entry is None:
            said.append(f"{name}: argument {key} is not described")
        elif key not in known and _NUMBER.search(hint) and not _UNIT.search(entry or ""):
            said.append(f"{name}: no unit of {key}")
    first = kind.__dict__.get("__post_init__") or kind.__dict__.get("__init__")
    return said + _unsaid(name, first, text)


def _of_callable(name: str, function: Any, text: str, reads: bool = False) -> list[str]:
    if not text:
        return [f"{name}: no docstring"]
    said = []
    for key, hint in ({} if reads else _hints(function)).items():
        known = _convention(key, hint)
        if known is None and not re.search(rf"\b{key}\b", text):
            said.append(f"{name}: argument {key} is not described")
        elif known is None and _NUMBER.search(hint) and not _UNIT.search(text):
            said.append(f"{name}: no unit of {key}")
    back = str(function.__annotations__.get("return", ""))
    if _ARRAY.search(back) and not (_SHAPE.search(text) or _UNIT.search(text)):
        said.append(f"{name}: no shape of what is returned")
    elif back in ("float", "Scalar", "<class 'float'>") and not _UNIT.search(text):
        said.append(f"{name}: no unit of what is returned")
    return said + _unsaid(name, function, text)


def _class_text(kind: type) -> str:
    return "\n\n".join(inspect.cleandoc(base.__doc__ or "") for base in kind.__mro__ if base is not object)


def _fields(kind: type) -> dict[str, str]:
    """Arguments of the constructor with their types in words, but for what a fit fills in."""
    if is_dataclass(kind):
        found = {f.name: str(f.type) for f in fields(kind) if f.init}
    else:
        first = kind.__dict__.get("__init__")
        found = _hints(first) if inspect.isfunction(first) else {}
    return {key: hint for key, hint in found.items() if not key.startswith("_") and key != "fit_info"}


def _hints(function: Any) -> dict[str, str]:
    given = inspect.signature(function).parameters
    return {k: str(p.annotation) for k, p in given.items() if k not in ("self", "cls") and not k.startswith("_")}


@cache
def _comments(kind: type) -> dict[str, str]:
    """Comments of the fields of a record and its bases, on their line or above it."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if not base.__module__.startswith("slipangle."):
            continue
        above: list[str] = []
        for line in inspect.getsource(base).splitlines():
            if match := re.match(r"    #:? ?(.*)", line):
                above.append(match[1])
                continue
            if match := re.match(r"    (\w+): [^#]*(?:# (.*))?$", line):
                meaning = match[2] or " ".join(above)
                if meaning:
                    found[match[1]] = meaning[0].upper() + meaning[1:]
            above = []
    return found


def _entry(text: str, key: str) -> str | None:
    """The lines of a docstring that describe an argument: its entry in a section, or the sentences that name it."""
    found = re.findall(rf"^(?:[\w, *]*, )?\**{key}(?:, [\w, *]*)?(?: :.*)?$\n(?:^ +.*\n?)+", text, re.M)
    if found:
        return "\n".join(found)
    return " ".join(re.findall(rf"[^.]*`{{1,2}}{key}`{{1,2}}[^.]*\.[^.]*", text)) or None


def _unsaid(name: str, function: Any, text: str) -> list[str]:
    """Errors that a function raises by itself and does not name."""
    if not inspect.isfunction(function):
        return []
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    except (OSError, SyntaxError):
        return []
    raised = {
        node.exc.func.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and isinstance(node.exc.func, ast.Name)
    }
    return [f"{name}: {error} is not said" for error in sorted(raised & _ERRORS) if error not in text]
