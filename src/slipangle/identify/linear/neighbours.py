"""Orders of an ARX model, and those that are next to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from slipangle.identify.linear.lags import PerInput

Chosen = Literal["chosen"]


@dataclass(frozen=True, order=True)
class Orders:
    """Lags of outputs, of each input, and the delay of each input."""

    na: int
    nb: tuple[int, ...]
    nk: tuple[int, ...]

    @property
    def reach(self) -> int:
        """Samples that the oldest regressor lies back."""
        return max(self.na, *(b + k - 1 for b, k in zip(self.nb, self.nk, strict=True)))

    def coefficients(self, n_outputs: int, offset: bool) -> int:
        """Per output."""
        return self.na * n_outputs + sum(self.nb) + offset

    def later(self, by: Sequence[int]) -> Orders:
        """The same with delays that are longer by so many samples."""
        return replace(self, nk=tuple(k + more for k, more in zip(self.nk, by, strict=True)))

    @property
    def said(self) -> str:
        """In words."""
        each = ("/".join(map(str, v if len(set(v)) > 1 else v[:1])) for v in (self.nb, self.nk))
        return "na = {}, nb = {}, nk = {}".format(self.na, *each)


def near(best: Orders, groups: Sequence[range], open_: tuple[bool, bool, bool], least: tuple[int, ...]) -> list[Orders]:
    """Orders that differ little from some, in one number, or in the lags of an input that begin later.

    Delays that are open are the ``least`` of each input or more.
    """
    moves = [(-2, 0, 0), (-1, 0, 0), (1, 0, 0), (2, 0, 0)]
    moves += [(0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1), (0, -1, 1), (0, 1, -1)]
    near = []
    for of in groups:
        for a, b, k in (m for m in moves if all(free or not d for free, d in zip(open_, m, strict=True))):
            nb, nk = with_input(best.nb, of, best.nb[of[0]] + b), with_input(best.nk, of, best.nk[of[0]] + k)
            near.append(Orders(best.na + a, nb, nk))
    held = [not open_[2] or all(k >= low for k, low in zip(o.nk, least, strict=True)) for o in near]
    return [o for o, holds in zip(near, held, strict=True) if holds and min(o.na, *o.nb) >= 1]


def each_input(value: PerInput | Chosen, n: int) -> tuple[int, ...]:
    """For every input; one where it is open."""
    if isinstance(value, tuple):
        return value
    return (1 if isinstance(value, str) else value,) * n


def with_input(values: tuple[int, ...], of: range, value: int) -> tuple[int, ...]:
    """The numbers with those of some inputs replaced."""
    return tuple(value if i in of else v for i, v in enumerate(values))
