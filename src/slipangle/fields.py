"""`Checked`: settings that check themselves; range and choices stand on the field, as unit and range do on parameters.

>>> @dataclass(frozen=True)
... class Smoother(Checked):
...     order: Annotated[int, Within(1, 9)] = 2
...     kind: Literal["mean", "median"] = "mean"
>>> Smoother(order=0)
Traceback (most recent call last):
slipangle.errors.ParameterError: order is 0; expected a whole number from 1 to 9
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from math import inf
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from slipangle.errors import ParameterError, nearest, shown
from slipangle.shown import Brief


@dataclass(frozen=True)
class Within:
    """Range of a number, and its unit; of a table, of each entry.

    Parameters
    ----------
    low, high : float
        Ends; they belong to the range unless `open` says otherwise.
    unit : str
        Of both.
    open : {"", "low", "high", "both"}
        Ends that do not belong to it.
    example : str
        A usual value, for messages.
    """

    low: float
    high: float = inf
    unit: str = ""
    open: Literal["", "low", "high", "both"] = ""
    example: str = ""

    def __contains__(self, value: float) -> bool:
        above = value > self.low if self.open in ("low", "both") else value >= self.low
        return bool(above and (value < self.high if self.open in ("high", "both") else value <= self.high))

    def sentence(self, whole: bool) -> str:
        """What is expected, such as "a whole number of at least 1"."""
        bounded = self.low not in (-inf, 0) or self.high < inf or self.open not in ("low", "both")
        unit = "" if not self.unit else f" {self.unit}" if bounded else f" [{self.unit}]"
        example = f", such as {self.example}" if self.example else ""
        kind = "a whole number" if whole else "a number"
        if self.low == -inf and self.high == inf:
            text = "a finite number"
        elif self.open in ("low", "both"):
            text = "a positive number" if self.low == 0 and self.high == inf else f"{kind} above {self.low:g}"
        elif self.high == inf:
            text = f"{kind} of at least {self.low:g}"
        else:
            text = f"{kind} from {self.low:g}"
        if self.high < inf:
            joint = " and" if self.open in ("low", "both") else ""
            most = " below" if self.open in ("high", "both") else " at most" if joint else ""
            text += f"{joint or ' to'}{most} {self.high:g}"
        return text + unit + example


Count = Annotated[int, Within(1)]
Whole = Annotated[int, Within(0)]
Finite = Annotated[float, Within(-inf, open="both")]
Positive = Annotated[float, Within(0, open="low")]
NotNegative = Annotated[float, Within(0)]
Radius = Annotated[float, Within(0, open="low", example="0.999")]
Seed = Annotated[int, Within(0, 2**32 - 1)]


class Checked(Brief):
    """Base of settings records: numbers lie in their ``Within``, words are among their ``Literal``, lists are tuples.

    A subclass that relates fields to each other does so in ``__post_init__`` after ``super().__post_init__()``.

    Raises ParameterError with the field, what it is and what was expected.
    """

    def __post_init__(self) -> None:
        for name, hint, as_tuple in _plan(type(self)):
            value = getattr(self, name)
            if as_tuple and not isinstance(value, tuple):
                many = isinstance(value, Sequence) and not isinstance(value, str)
                value = tuple(value) if many else (value,)
                object.__setattr__(self, name, value)
            for what, one, kind in _entries(name, value, hint):
                said = _expected(one, kind)
                if said:
                    raise ParameterError(f"{what} is {shown(one)}; {said}")


@cache
def _plan(cls: type) -> list[tuple[str, Any, bool]]:
    """Names and hints of the fields that have something to check, and whether what is given becomes a tuple."""
    hints = get_type_hints(cls, include_extras=True)
    names = [f.name for f in fields(cls) if f.init and _matters(hints[f.name])]  # type: ignore[arg-type]  # a dataclass
    return [(name, hints[name], _plain(hints[name]) is tuple) for name in names]


def _matters(hint: Any) -> bool:
    """Whether not every value fits."""
    kind = get_origin(hint)
    if kind in (Union, UnionType, Mapping):
        return any(map(_matters, get_args(hint)))
    return hint in (int, float, tuple) or kind in (Annotated, Literal, tuple)


def _entries(name: str, value: Any, hint: Any) -> list[tuple[str, Any, Any]]:
    """A field's name, value and hint, or those of each entry of a table."""
    inside = get_args(hint)
    if not isinstance(value, Mapping) or get_origin(hint) not in (Mapping, Annotated):
        return [(name, value, hint)]
    each = Annotated[float, *inside[1:]] if get_origin(hint) is Annotated else inside[1]
    return [(f"{name} of '{key}'", one, each) for key, one in value.items()]


def _plain(hint: Any) -> Any:
    """The class behind a hint: ``tuple`` for ``Annotated[tuple[int, ...], ...]``."""
    return _plain(get_args(hint)[0]) if get_origin(hint) is Annotated else get_origin(hint) or hint


def _expected(value: Any, hint: Any) -> str:
    """What was expected instead, or nothing."""
    origin, inside = get_origin(hint), get_args(hint)
    if origin is Annotated:
        said = _expected(value, inside[0])
        whole = inside[0] is int
        for span in inside[1:]:
            if isinstance(span, Within) and (said or value not in span):
                return f"expected {span.sentence(whole)}"
        return said
    if origin in (Union, UnionType):
        if value is None and NoneType in inside:
            return ""
        said = [_expected(value, option) for option in inside if option is not NoneType]
        suits = [_plain(option) is tuple for option in inside if option is not NoneType]
        if "" in said:
            return ""
        best = said[suits.index(True)] if isinstance(value, tuple) and True in suits else said[0]
        return best + (", or None" if NoneType in inside else "")
    if origin is Literal:
        if any(type(value) is type(option) and value == option for option in inside):
            return ""
        return f"{nearest(str(value), map(str, inside))}: use one of these"
    if origin is tuple and inside[1:] == (...,):
        if not isinstance(value, tuple):
            return "expected several values"
        return next((said for said in (_expected(v, inside[0]) for v in value) if said), "")
    if hint is int and (not isinstance(value, Integral) or isinstance(value, bool)):
        return "expected a whole number"
    if hint is float and (not isinstance(value, Real) or isinstance(value, bool)):
        return "expected a number"
    return ""
