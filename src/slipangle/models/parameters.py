"""`ParameterSet`: frozen records whose fields carry unit, meaning and range."""

from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Annotated, Any, Self, get_args, get_origin, get_type_hints

import numpy as np

from slipangle.errors import ParameterError, nearest, shown
from slipangle.ops import is_symbolic, is_traced
from slipangle.shown import Brief
from slipangle.units import SI

__all__ = ["MOST_LAGS", "SI", "Annotated", "ParameterSet", "require_few_lags"]

MOST_LAGS = 5000  # past samples that a model keeps as states, per signal


def require_few_lags(samples: float, what: str) -> None:
    """Raise a `ParameterError` if a model would keep more than `MOST_LAGS` past samples of a signal."""
    if not samples <= MOST_LAGS:
        raise ParameterError(
            f"{what} reaches {samples:.6g} samples back; expected at most {MOST_LAGS}: choose a smaller delay or fewer "
            "lags, or a longer sample time"
        )


def require_in_range(what: str, value: Any, meta: SI) -> None:
    """Raise a `ParameterError` if a value is no number or outside its range, but for symbols, tracers and arrays."""
    if is_symbolic(value) or is_traced(value) or isinstance(value, np.ndarray):
        return
    unit = "" if meta.unit == "-" else f" {meta.unit}"
    try:
        inside = bool(meta.lower <= value <= meta.upper)
    except TypeError:
        raise ParameterError(
            f"{what} is {shown(value)}; expected a number, {meta.lower:g} to {meta.upper:g}{unit}"
        ) from None
    if not inside:
        raise ParameterError(
            f"{what} is {value:g}{unit}; expected {meta.lower:g} to {meta.upper:g}{unit}: check the value and its unit"
        )


@dataclass(frozen=True, kw_only=True)
class ParameterSet(Brief):
    """Base of parameter records; every field is ``Annotated[float, SI(unit, doc, lower, upper)]``.

    One record feeds the range check, the bounds of identification and the report. Raises ParameterError if a value is
    outside its range; symbols and tracers are not checked.
    """

    def __post_init__(self) -> None:
        for name, meta in self.metadata().items():
            value = getattr(self, name)
            if type(value) is float and meta.lower <= value <= meta.upper:
                continue  # most of them, of sets that a fit makes by the thousand
            require_in_range(f"{type(self).__name__}.{name} ({meta.doc})", value, meta)

    @classmethod
    @cache
    def metadata(cls) -> dict[str, SI]:
        """`SI` of every field, in order."""
        hints = get_type_hints(cls, include_extras=True)
        extras = {f.name: get_args(hints[f.name])[1:] for f in fields(cls) if get_origin(hints[f.name]) is Annotated}
        return {name: meta for name, metas in extras.items() for meta in metas if isinstance(meta, SI)}

    @classmethod
    def si(cls, name: str) -> SI:
        """`SI` of one field; raises ParameterError if there is no such parameter; the nearest names are given."""
        known = cls.metadata()
        if name not in known:
            raise ParameterError(
                f"{cls.__name__} has no parameter '{name}'; {nearest(name, known)}: use one of these names"
            )
        return known[name]

    @property
    def doubts(self) -> dict[str, Any]:
        """Of values that do not go together: what is wrong where a number, or a symbol's, is not above zero."""
        return {}

    def with_values(self, **values: Any) -> Self:
        """A copy with some values replaced (numbers or symbols)."""
        known = self.metadata()
        for name in (n for n in values if n not in known):
            self.si(name)
        return replace(self, **values)
