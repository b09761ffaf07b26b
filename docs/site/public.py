"""What is public: the names of `slipangle`, what their calls return, and the bases that they inherit from, by room."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Iterator
from functools import cached_property
from types import FunctionType
from typing import Any

import slipangle

# Rooms in the order of the work, with the page that each is on.
PAGES = {
    "data": ("Data", ("data",)),
    "models": ("Models", ("models",)),
    "tires": ("Tires", ("models.tires",)),
    "analysis": ("Linear analysis", ("models.analysis",)),
    "identify": ("Identification", ("identify",)),
    "estimate": ("Estimation", ("estimate",)),
    "control": ("Control", ("optimal", "control", "paths")),
    "simulate": ("Simulation", ("simulate",)),
    "report": ("Figures and pages", ("report",)),
    "export": ("Export", ("export",)),
    "rest": ("Units, numbers, errors", ("",)),
}
INNER = (  # machinery that results or bases speak of, and nobody calls
    "control.fallback",
    "control.marx.problem",
    "control.marx.blended",
    "estimate.window",
    "identify.physics.simulation_error",
    "models.fast",
    "models.vehicles.dual_track",
    "numerics",
    "optimal.engine",
    "optimal.ipopt.IpoptEngine",
    "paths.line",
)
MORE = ("slipangle.export.export", "slipangle.export.build", "slipangle.export.load", "slipangle.export.fmi.export_fmu")


def page_of(thing: Any) -> str:
    """Key in `PAGES` of the room that a class or function lives in, the longest that fits."""
    module = thing.__module__.removeprefix("slipangle.")
    fits = [(len(room), key) for key, (_, rooms) in PAGES.items() for room in rooms if f"{module}.".startswith(room)]
    return max(fits)[1]


def function_of(member: Any) -> FunctionType | None:
    """The function behind a method, property or class method; None for data."""
    for inside in ("fget", "func", "__func__"):
        member = getattr(member, inside, member)
    return member if inspect.isfunction(member) else None


def members(kind: type) -> dict[str, Any]:
    """Public methods and properties that a class itself defines, by name, in the order of its source."""
    own = {k: (v, function_of(v)) for k, v in vars(kind).items() if not k.startswith("_")}
    return {
        k: v  # what a class takes from what it wraps has no name of its own
        for k, (v, f) in own.items()
        if f is not None and f.__module__.startswith("slipangle.") and f.__name__ != "<lambda>"
    }


def is_property(member: Any) -> bool:
    """Whether it is read without a call."""
    return isinstance(member, property | cached_property)


def public() -> dict[str, Any]:
    """Classes and functions of the reference by full name: each of `slipangle`, with what it returns and inherits."""
    named = [getattr(slipangle, name) for name in slipangle.__all__]
    named += [e for e in vars(slipangle.errors).values() if inspect.isclass(e) and issubclass(e, Exception | Warning)]
    named += [_at(name) for name in MORE]
    found: dict[str, Any] = {}
    waiting = list(named)
    while waiting:
        thing = waiting.pop()
        name = f"{thing.__module__}.{thing.__qualname__}"
        inner = name.removeprefix("slipangle.").startswith(INNER) and thing not in named
        if name in found or inner or not thing.__module__.startswith("slipangle."):
            continue
        found[name] = thing
        waiting += _returned(thing)
        if inspect.isclass(thing):
            waiting += [base for base in thing.__mro__[1:] if members(base)]
            for member in members(thing).values():
                waiting += _returned(function_of(member))
    return dict(sorted(found.items()))


def _at(name: str) -> Any:
    module, _, last = name.rpartition(".")
    return getattr(__import__(module, fromlist=[last]), last)


def _returned(function: Any) -> Iterator[type]:
    """Classes of the toolbox that a function says it returns."""
    if not inspect.isfunction(function):
        return
    hint = function.__annotations__.get("return")
    if isinstance(hint, str):
        try:
            hint = eval(hint, {**vars(typing), **function.__globals__})
        except (NameError, TypeError):  # taken from a room for type checkers only
            return
    stack = [hint]
    while stack:
        hint = stack.pop()
        stack += typing.get_args(hint)
        if inspect.isclass(hint) and hint.__module__.startswith("slipangle.") and not hint.__name__.startswith("_"):
            yield hint
