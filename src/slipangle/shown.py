"""`Shown`: results that say themselves in a line, a table, a figure; `Brief`: settings and records by their fields."""

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from slipangle.errors import ParameterError

WIDEST = 160  # letters of a line about a record with all that it holds
_INSIDE = 60  # of those, for one value that is no record
_SOME = 6  # entries of a list that are said


class _InNotebook:
    """Its own line is kept where `dataclass` would write another, and a notebook shows its table."""

    __slots__ = ()

    def __init_subclass__(cls, **given: Any) -> None:
        super().__init_subclass__(**given)
        cls.__repr__ = cls.__repr__  # what it has or inherits becomes its own, which a dataclass does not replace

    def _repr_html_(self) -> str:
        return import_module("slipangle.report.shown").table(self)._repr_html_()  # a room above all others here


class Shown(_InNotebook):
    """Mixin of results; a subclass says its line in `_words`.

    `slipangle.report.shown` has its table, `slipangle.report.drawn` its figure.
    """

    __slots__ = ()

    def _words(self) -> str:
        """What the line says: of a result that is about a fitted model, its fit."""
        fit = getattr(getattr(self, "model", None), "fit_info", None)
        return fit._words() if isinstance(fit, Shown) else ""

    def __repr__(self) -> str:
        words = self._words()
        return f"<{type(self).__name__}{f': {words}' if words else ''}>"

    def plot(self, *names: str) -> Any:
        """The figure of this result, of some channels or outputs where names are given: a Plotly figure.

        It shows in a notebook; `slipangle.save_figure` writes it for a publication.

        Raises ParameterError if there is no channel or output of a name, or something is no name.
        """
        for name in names:
            if not isinstance(name, str):
                got = said(name)
                raise ParameterError(
                    f"plot() was given {got} for a name; expected strings one by one: plot('v_x', 'r')"
                )
        return import_module("slipangle.report.drawn").figure(self, names)  # a room above all others here


class Brief(_InNotebook):
    """Mixin of settings, parameters, models: a line of what is not as by default, in a notebook a table of the fields.

    The line is at most 160 letters, where that of a dataclass fills screens; "..." stands for what it leaves out.
    """

    __slots__ = ()
    _lists: ClassVar[tuple[str, ...]] = ()  # attributes that are shown of what is no dataclass
    _explained_by: ClassVar[tuple[type, ...]] = ()  # whose docstrings say what entries mean that its own does not

    def _entries(self) -> Iterator[tuple[str, Any, Any]]:
        """Name, value and default of each field that shows; MISSING where there is no default."""
        if not is_dataclass(self):
            yield from ((name, getattr(self, name), MISSING) for name in self._lists)
            return
        for f in fields(self):
            if f.init and f.repr:
                default = f.default if f.default_factory is MISSING else f.default_factory()
                yield f.name, getattr(self, f.name), default

    def __repr__(self) -> str:
        return _line(self, WIDEST)


def said(value: Any, room: int = _INSIDE) -> str:
    """A value in at most about ``room`` letters, a number in six digits.

    >>> said(1093.2952334674046), said((0.1, None)), said(np.zeros((20, 3)))
    ('1093.3', '(0.1, None)', 'array 20 x 3')
    """
    match value:
        case Brief() if type(value).__repr__ is Brief.__repr__:
            return _line(value, room)
        case bool() | None | np.bool_():
            return str(value)
        case float() | np.floating():
            return f"{float(value):.6g}"
        case np.ndarray() if value.ndim != 1 or value.size > _SOME:
            return f"array {' x '.join(map(str, value.shape))}"
        case Mapping():
            inside = (f"{k!r}: {said(v)}" for k, v in value.items())
            return f"{{{_some(inside, len(value))}}}"
        case tuple() | list() | np.ndarray():
            share = room // max(min(len(value), _SOME), 1) - 2
            return f"({_some((said(v, share) for v in value), len(value))}{',' * (len(value) == 1)})"
    text = value.__name__ if callable(value) and hasattr(value, "__name__") else " ".join(repr(value).split())
    return text if len(text) <= _INSIDE else f"{text[: _INSIDE - 3]}..."


def _some(texts: Iterator[str], count: int) -> str:
    """The first of them, "..." for the others."""
    return ", ".join([t for t, _ in zip(texts, range(_SOME), strict=False)] + ["..."] * (count > _SOME))


def _line(record: Brief, room: int) -> str:
    """The record's name with as many of its fields as there is room for."""
    text, end = f"{type(record).__name__}(", ")"
    given = [(n, v) for n, v, default in record._entries() if not _same(v, default)]
    for k, (name, value) in enumerate(given):
        comma = ", " if k else ""
        left = room - len(text) - len(name) - len(comma) - len("=, ...)")
        what = said(value, left)
        if len(what) > left:
            return f"{text}{comma}...{end}"
        text += f"{comma}{name}={what}"
    return text + end


def _same(value: Any, default: Any) -> bool:
    """Whether a field is as by default; what cannot be compared is not."""
    try:
        return value is default or bool(type(value) is type(default) and value == default)
    except ValueError:  # arrays
        return False
