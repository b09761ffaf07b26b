"""Numbers by channel name: `Values`, `Weights`, `Limits`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping

from slipangle.errors import ParameterError, nearest


class Values(Mapping[str, float]):
    """Numbers by channel name, immutable.

    >>> Values(delta=0.1, T_f=-200.0)["delta"]
    0.1
    """

    __slots__ = ("_items",)
    _what = "value"

    def __init__(self, **values: float) -> None:
        self._items: dict[str, float] = {}
        for name, value in values.items():
            number = float(value)
            self._check(name, number)
            self._items[name] = number

    def _check(self, name: str, number: float) -> None:
        if not math.isfinite(number):
            raise ParameterError(f"the {self._what} of '{name}' is {number}; expected a finite number")

    def __getitem__(self, name: str) -> float:
        return self._items[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def __hash__(self) -> int:
        return hash(frozenset(self._items.items()))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{k}={v!r}' for k, v in self._items.items())})"


class Weights(Values):
    """Weights of squared terms by channel name; none is negative.

    >>> Weights(Y=100.0, psi=10.0)
    Weights(Y=100.0, psi=10.0)
    """

    __slots__ = ()
    _what = "weight"

    def _check(self, name: str, number: float) -> None:
        if not (math.isfinite(number) and number >= 0):
            raise ParameterError(f"the weight of '{name}' is {number}; expected a finite number of at least 0")


class Limits(Mapping[str, tuple[float, float]]):
    """Lower and upper limit by channel name, immutable; one number stands for plus and minus that.

    >>> Limits(delta=0.3, T_f=(-2000.0, 1000.0))["delta"]
    (-0.3, 0.3)
    """

    __slots__ = ("_items",)

    def __init__(self, **limits: float | tuple[float, float]) -> None:
        self._items: dict[str, tuple[float, float]] = {}
        for name, limit in limits.items():
            both = (-limit, limit) if isinstance(limit, int | float) else tuple(limit)
            if len(both) != 2 or any(math.isnan(b) for b in both) or not both[0] <= both[1]:
                raise ParameterError(
                    f"the limit of '{name}' is {limit!r}; expected (lower, upper) with lower <= upper, or one "
                    "positive number for both sides"
                )
            self._items[name] = (float(both[0]), float(both[1]))

    def __getitem__(self, name: str) -> tuple[float, float]:
        return self._items[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def __hash__(self) -> int:
        return hash(frozenset(self._items.items()))

    def __repr__(self) -> str:
        return f"Limits({', '.join(f'{k}={v!r}' for k, v in self._items.items())})"


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
