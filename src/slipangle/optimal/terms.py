"""Numbers by channel name: `Values`, `Weights`, `Limits`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import MISSING
from typing import Any, ClassVar, Generic, Self, TypeVar

import casadi as ca
import numpy as np

from slipangle.errors import ParameterError, nearest, place
from slipangle.ops import Scalar, is_symbolic
from slipangle.optimal.arrays import short
from slipangle.shown import WIDEST, Brief

T = TypeVar("T")


class Named(Brief, Mapping[str, T], Generic[T]):
    """A checked number, or two, by channel name, immutable; ``given`` is a dictionary, or ``named`` keywords are.

    Raises ParameterError if a name is no text or a number makes no sense.
    """

    __slots__ = ("_items",)
    _what: ClassVar[str]

    def __init__(self, given: Mapping[str, Any] | None = None, /, **named: Any) -> None:
        if not isinstance(given, Mapping | None):
            raise ParameterError(
                f"{type(self).__name__} of {short(given)}; expected names and numbers, such as "
                f"{type(self).__name__}(delta=0.1), or a dictionary of them"
            )
        self._items: dict[str, T] = {}
        for name, value in {**(given or {}), **named}.items():
            if not isinstance(name, str):
                raise ParameterError(f"a {self._what} is named {short(name)}; expected the name of a channel")
            self._items[name] = self._checked(name, value)

    def _checked(self, name: str, value: Any) -> T:
        raise NotImplementedError

    @classmethod
    def of(cls, given: Any, what: str) -> Self:
        """The same, from a dictionary ``given`` too.

        Raises
        ------
        ParameterError
            If it is neither; ``what`` says whose it is.
        """
        if isinstance(given, cls):
            return given
        if not isinstance(given, Mapping):
            raise ParameterError(f"{what} is {short(given)}; expected {cls.__name__}, or a dictionary by channel name")
        return cls(given)

    def __getitem__(self, name: str) -> T:
        return self._items[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def __hash__(self) -> int:
        return hash(frozenset(self._items.items()))

    def _entries(self) -> Iterator[tuple[str, Any, Any]]:
        for name, value in self._items.items():
            yield name, value, MISSING

    def __repr__(self) -> str:
        plain = all(name.isidentifier() for name in self._items)
        whole = ", ".join(f"{k}={v!r}" for k, v in self._items.items()) if plain else repr(self._items)
        line = f"{type(self).__name__}({whole})"  # Python reads it again
        return line if len(line) <= WIDEST else super().__repr__()


class Values(Named[float]):
    """Numbers by channel name, immutable; from a dictionary where a name is no Python identifier.

    >>> Values(delta=0.1, T_f=-200.0)["delta"]
    0.1
    >>> Values({"r[k-1]": 0.5})
    Values({'r[k-1]': 0.5})
    """

    __slots__ = ()
    _what = "value"
    _least: ClassVar[float] = -math.inf

    def _checked(self, name: str, value: Any) -> float:
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not (math.isfinite(number) and number >= self._least):
            least = "" if self._least == -math.inf else f" of at least {self._least:g}"
            raise ParameterError(f"the {self._what} of '{name}' is {short(value)}; expected a finite number{least}")
        return number


class Read:
    """Parameters of a model and others beside them, by name: ``p.arm``, ``p["arm"]``."""

    def __init__(self, params: Any, beside: Mapping[str, Any]) -> None:
        self._params, self._beside = params, beside

    def __getattr__(self, name: str) -> Any:
        """A value by name."""
        return self._beside[name] if name in self._beside else getattr(self._params, name)

    def __getitem__(self, name: str) -> Any:
        """A value by name."""
        return self._beside[name] if name in self._beside else self._params[name]


class Weights(Values):
    """Weights of squared terms by channel name; none is negative.

    >>> Weights(Y=100.0, psi=10.0)
    Weights(Y=100.0, psi=10.0)
    """

    __slots__ = ()
    _what = "weight"
    _least = 0.0


class Limits(Named[tuple[float, float]]):
    """Lower and upper limit by channel name, immutable; one number stands for plus and minus that.

    >>> Limits(delta=0.3, T_f=(-2000.0, 1000.0))["delta"]
    (-0.3, 0.3)
    """

    __slots__ = ()
    _what = "limit"

    def _checked(self, name: str, value: Any) -> tuple[float, float]:
        try:
            lower, upper = value if isinstance(value, Iterable) else (-value, value)
            both = float(lower), float(upper)
        except (TypeError, ValueError, OverflowError):
            both = math.nan, math.nan
        if not both[0] <= both[1]:
            raise ParameterError(
                f"the limit of '{name}' is {short(value)}; expected (lower, upper) with lower <= upper, or one "
                "positive number for both sides"
            )
        return both


def coerce(settings: Any, kind: type[Named[Any]], *names: str) -> None:
    """Make these attributes of a frozen dataclass what they are meant to be, from dictionaries too.

    Raises
    ------
    ParameterError
        If one is neither, or holds what it must not.
    """
    for name in names:
        object.__setattr__(settings, name, kind.of(getattr(settings, name), name))


def require_names(given: Iterable[str], known: Iterable[str], what: str, fix: str = "use one of these names") -> None:
    """Raise unless every name is known.

    Raises
    ------
    ParameterError
        Naming the first unknown one and the nearest known ones.
    """
    names = list(known)
    for name in given:
        if name not in names:
            raise ParameterError(f"{what} names '{name}'; {nearest(name, names)}: {fix}")


def evaluated(name: str, term: Any, x: Any, u: Any, params: Any) -> Scalar:
    """What a term gives on symbols.

    Raises
    ------
    ParameterError
        If it is no function of state, inputs and parameters, or what it gives is no single number.
    """
    needs = (
        "expected a function (x, u, p) of state, inputs and parameters that gives one number, by arithmetic and "
        f"slipangle.ops, such as ops.sin and ops.where: see {place(term)}"
    )
    try:
        value = term(x, u, params)
    except Exception as error:
        said = str(error).strip().partition("\n")[0]
        raise ParameterError(f"the term '{name}' fails on symbols ({type(error).__name__}: {said}); {needs}") from error
    single = value.numel() == 1 if is_symbolic(value) else np.ndim(value) == 0 and _is_finite(value)
    if not single:
        raise ParameterError(f"the term '{name}' gives {short(value)}; {needs}")
    return value


def require_same(name: str, term: Any, value: Scalar, symbols: tuple[Any, Any, Any], read: Any) -> None:
    """Raise unless a term gives on symbols what it gives on numbers, as functions of `math` do not.

    Parameters
    ----------
    name, term : str, callable
        The term.
    value : scalar
        What it gives on ``symbols``.
    symbols : tuple
        State, all inputs of the model, and exogenous values.
    read : callable
        From state and exogenous values to what the term reads as ``p``.

    Raises
    ------
    ParameterError
        With the term.
    """
    if not is_symbolic(value):
        return
    x, u, w = (0.3 + 0.1 * np.arange(symbol.numel()) for symbol in symbols)
    number = None
    with suppress(Exception):  # such as a function of CasADi's, that takes symbols alone
        number = float(term(x, u, read(x, w)))
    if number is None or not np.isfinite(number):
        return
    symbolic = float(ca.Function("term", list(symbols), [value])(x, u, w))
    if not np.isclose(symbolic, number, rtol=1e-9, atol=1e-12):
        raise ParameterError(
            f"the term '{name}' gives {symbolic:g} on symbols and {number:g} on numbers; expected the same: write it "
            f"with slipangle.ops, such as ops.sin, where it has functions of math: see {place(term)}"
        )


def _is_finite(value: Any) -> bool:
    try:
        return bool(np.isfinite(float(value)))
    except (TypeError, ValueError):
        return False
