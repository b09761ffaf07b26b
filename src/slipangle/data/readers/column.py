"""`Column`: where a channel stands in a file, and what makes SI units of its numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slipangle import units
from slipangle.errors import ParameterError
from slipangle.shown import Brief


@dataclass(frozen=True)
class Column(Brief):
    """One column of a log file, or what follows from several.

    A number x of the file becomes ``factor * sign / ratio * (scale * x + offset)``, the bracket being in ``unit`` and
    the rest SI.

    Raises ParameterError if there is neither a source nor an expression, or both, or a number makes no sense.

    Parameters
    ----------
    source : str or int
        Name in the file's header, with or without its unit, or position from 0.
    unit : str, optional
        Unit of the file's numbers; by default the one in the header, or that the name there ends with (speed_kmh).
    factor : float
        The converted numbers are multiplied by this: 1/13.4 makes a road wheel of a steering wheel.
    override : bool
        Use ``unit`` even if the header names another one.
    scale, offset : float
        Of raw counts: physical = scale * raw + offset, in ``unit``.
    sign : int
        -1 where the file counts the other way: delta, r, v_y and a_y are positive to the left.
    ratio : float
        Of the steering: hand wheel angle over road wheel angle. [-]
    derive : str, optional
        Instead of a source: arithmetic on other channels and columns in SI units, such as ``"curvature * v_x"`` or
        ``"heading(qx, qy, qz, qw)"``; see `slipangle.data.expression.Expression`.
    """

    source: str | int = ""
    unit: str | None = None
    factor: float = 1.0
    override: bool = False
    scale: float = 1.0
    offset: float = 0.0
    sign: int = 1
    ratio: float = 1.0
    derive: str | None = None

    def __post_init__(self) -> None:
        if (self.source == "") == (not self.derive):
            raise ParameterError(
                f"a column has {'both a source and' if self.derive else 'neither a source nor'} something to derive "
                "it from; expected one of the two: Column('yaw rate') or Column(derive='curvature * v_x')"
            )
        if self.sign not in (1, -1):
            raise ParameterError(f"the sign of a column is {self.sign!r}; expected 1 or -1")
        for name in ("factor", "scale", "ratio", "offset"):
            value = getattr(self, name)
            if not np.isfinite(value) or (value == 0 and name != "offset"):
                raise ParameterError(f"the {name} of a column is {value!r}; expected a finite number other than zero")

    def ending(self, heading: str, what: str) -> str | None:
        """The unit of the quantity ``what`` that a heading ends with, as in speed_kmh; none of numbers that are scaled.

        Whoever scales them without a unit makes SI units of them.
        """
        return units.ending(heading, what)[1] if self.scale == self.factor == 1.0 else None

    def converted(self, numbers: np.ndarray, unit: str, expected: str | None, what: str) -> np.ndarray:
        """The file's numbers in SI units; ``unit`` is what they are in, ``expected`` of which quantity, for messages.

        Raises UnitError if the unit is unknown or of another quantity than ``expected``.
        """
        raw = numbers if self.scale == 1.0 and self.offset == 0.0 else self.scale * numbers + self.offset
        return units.to_si(raw, unit, expected=expected, what=what) * (self.factor * self.sign / self.ratio)
