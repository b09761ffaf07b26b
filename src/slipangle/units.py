"""Units at the door: everything inside is SI and radians.

`to_si` converts a column; `SI` is the metadata on the fields of a parameter set.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slipangle.errors import UnitError, nearest, shown

# unit: (quantity, SI unit, factor); value_SI = factor * value
_UNITS: dict[str, tuple[str, str, float]] = {
    "-": ("ratio", "-", 1.0),
    "%": ("ratio", "-", 0.01),
    "s": ("time", "s", 1.0),
    "ms": ("time", "s", 1e-3),
    "us": ("time", "s", 1e-6),
    "ns": ("time", "s", 1e-9),
    "min": ("time", "s", 60.0),
    "m": ("length", "m", 1.0),
    "mm": ("length", "m", 1e-3),
    "cm": ("length", "m", 1e-2),
    "km": ("length", "m", 1e3),
    "in": ("length", "m", 0.0254),
    "ft": ("length", "m", 0.3048),
    "m/s": ("speed", "m/s", 1.0),
    "km/h": ("speed", "m/s", 1 / 3.6),
    "mph": ("speed", "m/s", 0.44704),
    "kn": ("speed", "m/s", 1852 / 3600),
    "m/s2": ("acceleration", "m/s2", 1.0),
    "g": ("acceleration", "m/s2", 9.80665),
    "rad": ("angle", "rad", 1.0),
    "deg": ("angle", "rad", math.pi / 180),
    "rad/s": ("angular rate", "rad/s", 1.0),
    "deg/s": ("angular rate", "rad/s", math.pi / 180),
    "rpm": ("angular rate", "rad/s", math.pi / 30),
    "rad/s2": ("angular acceleration", "rad/s2", 1.0),
    "deg/s2": ("angular acceleration", "rad/s2", math.pi / 180),
    "kg": ("mass", "kg", 1.0),
    "lb": ("mass", "kg", 0.45359237),
    "kg m2": ("moment of inertia", "kg m2", 1.0),
    "N": ("force", "N", 1.0),
    "kN": ("force", "N", 1e3),
    "lbf": ("force", "N", 4.4482216152605),
    "N m": ("torque", "N m", 1.0),
    "kN m": ("torque", "N m", 1e3),
    "ft lbf": ("torque", "N m", 1.3558179483314),
    "N/rad": ("cornering stiffness", "N/rad", 1.0),
    "N/deg": ("cornering stiffness", "N/rad", 180 / math.pi),
    "Pa": ("pressure", "Pa", 1.0),
    "kPa": ("pressure", "Pa", 1e3),
    "bar": ("pressure", "Pa", 1e5),
    "psi": ("pressure", "Pa", 6894.757293168),
    "V": ("voltage", "V", 1.0),
    "degC": ("temperature", "degC", 1.0),
}
_ALIASES = {
    "": "-",
    "1": "-",
    "percent": "%",
    "kmh": "km/h",
    "kmph": "km/h",
    "kph": "km/h",
    "m/s^2": "m/s2",
    "m/s²": "m/s2",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "°/s": "deg/s",
    "dps": "deg/s",
    "radian": "rad",
    "radians": "rad",
    "meter": "m",
    "newton": "N",
    "kg": "kg",
    "nm": "N m",
    "n": "N",
    "kg*m^2": "kg m2",
    "sec": "s",
}


def canonical(unit: str) -> str:
    """The table's spelling of a unit.

    Raises
    ------
    UnitError
        If the unit is unknown.
    """
    text = unit.strip()
    if text in _UNITS:
        return text
    lower = text.lower()
    found = _ALIASES.get(lower) or next((u for u in _UNITS if u.lower() == lower), None)
    if found is None:
        raise UnitError(f"the unit {shown(unit)} is not known; {nearest(unit, _UNITS)}")
    return found


def known(unit: str) -> bool:
    """Whether the table has the unit, by any spelling.

    >>> known("km/h"), known("furlong")
    (True, False)
    """
    try:
        canonical(unit)
    except UnitError:
        return False
    return True


def si_unit(unit: str) -> str:
    """The SI unit of the same quantity.

    >>> si_unit("km/h")
    'm/s'
    """
    return _UNITS[canonical(unit)][1]


def quantity(unit: str) -> str:
    """The quantity a unit measures.

    >>> quantity("deg/s")
    'angular rate'
    """
    return _UNITS[canonical(unit)][0]


def to_si(values: np.ndarray | float, unit: str, *, expected: str | None = None, what: str = "value") -> np.ndarray:
    """Convert to SI.

    Parameters
    ----------
    values : array or float
        In ``unit``.
    unit : str
        Such as ``"deg/s"`` or ``"km/h"``.
    expected : str, optional
        A unit of the quantity that is wanted; another quantity is an error.
    what : str
        Name of the values, for the message.

    Raises
    ------
    UnitError
        If the unit is unknown or of another quantity than expected.

    >>> round(float(to_si(36.0, "km/h")), 9)
    10.0
    """
    name, _, factor = _UNITS[canonical(unit)]
    if expected is not None and quantity(expected) != name:
        raise UnitError(
            f"{what} is given in {unit!r}, which is {name}; expected {quantity(expected)}, such as "
            f"{si_unit(expected)!r}: correct the unit or choose another column"
        )
    with np.errstate(over="ignore", invalid="ignore"):  # infinite and NaN, signalling too, are missing values
        return np.asarray(values, dtype=float) * factor


def from_si(values: np.ndarray | float, unit: str) -> np.ndarray:
    """Convert SI values to ``unit``; inverse of `to_si`."""
    return np.asarray(values, dtype=float) / _UNITS[canonical(unit)][2]


def deg(value: float) -> float:
    """Degrees to radians."""
    return math.radians(value)


def kmh(value: float) -> float:
    """Kilometres per hour to metres per second."""
    return value / 3.6


@dataclass(frozen=True)
class SI:
    """Unit, meaning and admissible range of a parameter, as field metadata."""

    unit: str
    doc: str
    lower: float = -math.inf
    upper: float = math.inf
