"""`LookupTable`: a table over one or two quantities, as an expression that every solver and its C can use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from slipangle.equal import Equal
from slipangle.errors import ParameterError, nearest
from slipangle.ops import Scalar, is_symbolic, where
from slipangle.shown import Brief

KINDS = ("linear", "cubic", "monotone")


@dataclass(frozen=True)
class LookupTable(Brief, Equal):
    """Values on a grid of one or two axes, with what is between them: for equations, terms and measured curves.

    It works on numbers, arrays and symbols. Segments are picked by comparisons that are multiplied, so that C has no
    branches and works on several columns at once; time grows with the number of grid points. At a grid point of a
    linear table the derivative is that to the right.

    Parameters
    ----------
    grid : array, shape (n,), or two of them
        Grid points, rising, in the unit of the argument; two for a table over two arguments.
    values : array, shape (n,) or (n, m)
        Values there, in the unit of the result.
    kind : {"cubic", "linear", "monotone"}
        Between them: a cubic spline with continuous second derivatives (not-a-knot ends), straight lines, or cubics
        that never overshoot ([1]_, one axis only).
    outside : {"hold", "line"}
        Beyond the grid: the value at its end, or a straight line of the slope there.

    Raises
    ------
    ParameterError
        If grid and values do not fit, or are not finite, or the grid does not rise.

    References
    ----------
    .. [1] F. N. Fritsch, R. E. Carlson, SIAM J. Numer. Anal. 17, 238-246, 1980.

    Examples
    --------
    >>> torque = LookupTable([0.0, 100.0, 200.0], [300.0, 280.0, 150.0], kind="linear")
    >>> float(torque(150.0)), float(torque(500.0))
    (215.0, 150.0)
    """

    grid: Any
    values: Any
    kind: Literal["cubic", "linear", "monotone"] = "cubic"
    outside: Literal["hold", "line"] = "hold"

    def __post_init__(self) -> None:
        if self.kind not in KINDS or self.outside not in ("hold", "line"):
            known, said = (KINDS, self.kind) if self.kind not in KINDS else (("hold", "line"), self.outside)
            raise ParameterError(f"the table is {said!r}; {nearest(str(said), known)}: use one of these")
        two = isinstance(self.grid, tuple | list) and len(self.grid) > 0 and np.ndim(self.grid[0]) == 1
        try:
            axes = tuple(np.array(a, dtype=float) for a in (self.grid if two else (self.grid,)))
            values = np.array(self.values, dtype=float)
        except (TypeError, ValueError):
            axes, values = (np.zeros(0),), np.zeros(0)
        shape = tuple(len(a) for a in axes if a.ndim == 1)
        if values.shape != shape or not 1 <= len(axes) <= 2 or min(shape) < 2 or not np.isfinite(values).all():
            raise ParameterError(
                f"the table has a grid of {shape} points and values of shape {values.shape}; expected one or two axes "
                "of two or more points, and a finite value at each"
            )
        for axis in axes:
            if not (np.isfinite(axis).all() and (np.diff(axis) > 0).all()):
                raise ParameterError("the grid of the table does not rise; expected finite points, each above the last")
        if self.kind == "monotone" and len(axes) == 2:
            raise ParameterError("a monotone table has one axis; expected 'cubic' or 'linear' for two")
        object.__setattr__(self, "grid", axes)
        object.__setattr__(self, "values", values)

    def __call__(self, *at: Scalar) -> Scalar:
        """Value at an argument, or at two.

        Raises
        ------
        ParameterError
            If there are not as many arguments as axes.
        """
        if len(at) != len(self.grid):
            raise ParameterError(
                f"the table is asked with {len(at)} arguments; expected {len(self.grid)}, one per axis"
            )
        inside = [_kept(v, axis) for v, axis in zip(at, self.grid, strict=True)]
        value = self._inside(inside, [0] * len(at))
        if self.outside == "line":
            for i, (v, kept) in enumerate(zip(at, inside, strict=True)):
                order = [int(j == i) for j in range(len(at))]
                value = value + (v - kept) * self._inside(inside, order)
        return value

    def _inside(self, at: Sequence[Scalar], order: Sequence[int]) -> Scalar:
        """Value or first derivative within the grid: corners picked along the first axis, then along the second."""
        (first, *rest), values = self.grid, self.values
        segment = _Segment(at[0], first)
        corners = [values] if self.kind == "linear" else [values, _slopes(first, values, self.kind)]
        if not rest:
            return segment.between(*(segment.ends(c) for c in corners), order=order[0])
        second = _Segment(at[1], rest[0])
        along = [corners, [_slopes(rest[0], c.T, self.kind).T for c in corners]] if self.kind != "linear" else [corners]
        columns = [
            [segment.between(*(segment.ends(c[:, j]) for c in row), order=order[0]) for j in range(len(rest[0]))]
            for row in along
        ]
        return second.between(*(second.ends(c) for c in columns), order=order[1])


def _slopes(axis: np.ndarray, values: np.ndarray, kind: str) -> np.ndarray:
    """Slopes at the grid points, along the first axis of the values."""
    if kind == "monotone":
        return np.asarray(PchipInterpolator(axis, values)(axis, 1))
    return np.asarray(CubicSpline(axis, values)(axis, 1))


def _kept(v: Scalar, axis: np.ndarray) -> Scalar:
    """The argument, or the end of the axis beyond which it is; what is no number stays so."""
    return where(v < axis[0], axis[0], where(v > axis[-1], axis[-1], v))


class _Segment:
    """In which segment of an axis an argument is, and where there."""

    def __init__(self, v: Scalar, axis: np.ndarray) -> None:
        self._symbolic = is_symbolic(v)
        beyond = [self._one(v >= t) for t in axis[1:-1]]
        self._within = [a - b for a, b in zip([1.0, *beyond], [*beyond, 0.0], strict=True)]
        start, self.width = self._picked(axis[:-1]), self._picked(np.diff(axis))
        self.share = (v - start) * self._picked(1.0 / np.diff(axis))

    def _one(self, holds: Any) -> Scalar:
        return holds if self._symbolic else where(holds, 1.0, 0.0)

    def _picked(self, values: Any) -> Scalar:
        """That of the values, one per segment, which belongs to the segment; all others count zero times."""
        return sum((w * values[k] for k, w in enumerate(self._within)), 0.0)

    def ends(self, values: Any) -> tuple[Scalar, Scalar]:
        """Values at both ends of the segment, of one per grid point."""
        return self._picked(values[:-1]), self._picked(values[1:])

    def between(
        self, values: tuple[Scalar, Scalar], slopes: tuple[Scalar, Scalar] | None = None, order: int = 0
    ) -> Scalar:
        """What is between values, with these slopes or on a straight line; its derivative where ``order`` is 1."""
        (a, b), s = values, self.share
        rise = b - a
        if slopes is None:
            return a + rise * s if order == 0 else rise / self.width
        p, q = slopes[0] * self.width, slopes[1] * self.width
        second, third = 3.0 * rise - 2.0 * p - q, p + q - 2.0 * rise
        if order == 1:
            return (p + s * (2.0 * second + 3.0 * s * third)) / self.width
        return a + s * (p + s * (second + s * third))
