"""Units at the door: everything inside is SI and radians.

`to_si` converts a column; `SI` is the metadata on the fields of a parameter set.
"""

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache

import numpy as np

from slipangle.errors import UnitError, nearest, raises, shown

_QUANTITIES: dict[str, tuple[str, dict[str, float]]] = {  # quantity: SI unit; unit: factor to SI
    "ratio": ("-", {"-": 1.0, "%": 0.01}),
    "time": ("s", {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}),
    "frequency": ("Hz", {"Hz": 1.0, "kHz": 1e3}),
    "length": ("m", {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "in": 0.0254, "ft": 0.3048, "mi": 1609.344}),
    "volume": ("m3", {"m3": 1.0, "l": 1e-3}),
    "curvature": ("1/m", {"1/m": 1.0, "1/km": 1e-3}),
    "speed": (
        "m/s",
        {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "kn": 1852 / 3600, "ft/s": 0.3048, "mm/s": 1e-3, "cm/s": 1e-2},
    ),
    "acceleration": ("m/s2", {"m/s2": 1.0, "g": 9.80665}),
    "angle": ("rad", {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180}),
    "angular rate": ("rad/s", {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": math.pi / 30}),
    "angular acceleration": ("rad/s2", {"rad/s2": 1.0, "deg/s2": math.pi / 180}),
    "mass": ("kg", {"kg": 1.0, "lb": 0.45359237}),
    "moment of inertia": ("kg m2", {"kg m2": 1.0}),
    "force": ("N", {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605}),
    "torque": ("N m", {"N m": 1.0, "kN m": 1e3, "ft lbf": 1.3558179483314}),
    "cornering stiffness": ("N/rad", {"N/rad": 1.0, "N/deg": 180 / math.pi}),
    "pressure": ("Pa", {"Pa": 1.0, "kPa": 1e3, "mbar": 100.0, "bar": 1e5, "psi": 6894.757293168}),
    "voltage": ("V", {"V": 1.0, "mV": 1e-3}),
    "current": ("A", {"A": 1.0}),
    "power": ("W", {"W": 1.0, "kW": 1e3, "hp": 745.6998715822702}),
    "temperature": ("degC", {"degC": 1.0, "K": 1.0, "degF": 5 / 9}),
}
_ZEROS = {"K": 273.15, "degF": 32.0}  # what they show at zero of the SI unit's scale, where that is not zero
_UNITS = {unit: (what, si, factor) for what, (si, units) in _QUANTITIES.items() for unit, factor in units.items()}
_ALIASES = {
    **dict.fromkeys(("", "1"), "-"),
    **dict.fromkeys(("kmh", "kmph", "kph"), "km/h"),
    **dict.fromkeys(("c", "°c", "deg c", "celsius"), "degC"),
    **dict.fromkeys(("f", "°f", "deg f", "fahrenheit"), "degF"),
    **dict.fromkeys(("1/min", "u/min", "rev/min", "r/min"), "rpm"),
    **dict.fromkeys(("knots", "knot", "kt", "kts"), "kn"),
    **dict.fromkeys(("inch", "inches"), "in"),
    **dict.fromkeys(("mile", "miles"), "mi"),
    **dict.fromkeys(("hr", "hour", "hours"), "h"),
    **{"fps": "ft/s", "m/s/s": "m/s2", "rad/m": "1/m"},
    **dict.fromkeys(("m/s^2", "m/s²", "m s-2"), "m/s2"),
    **dict.fromkeys(("degree", "degrees", "°", "degrees_north", "degrees_east"), "deg"),
    **dict.fromkeys(("°/s", "dps", "deg/sec", "degrees/s", "degrees/sec", "deg s-1", "degree s-1"), "deg/s"),
    **dict.fromkeys(("rad/sec", "radians/s", "radians/sec", "rad s-1"), "rad/s"),
    **dict.fromkeys(("m/sec", "meters/s", "mps", "m s-1"), "m/s"),
    **dict.fromkeys(("sec", "second", "seconds"), "s"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("newton", "n"), "N"),
    **{"percent": "%", "meter": "m", "kg": "kg", "nm": "N m", "kg*m^2": "kg m2", "days": "d"},
}


_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|[°%]")  # of a name, CamelCase and snake_case


def canonical(unit: str) -> str:
    """The table's spelling of a unit.

    Raises UnitError if the unit is unknown.
    """
    text = unit.strip()
    if text in _UNITS:
        return text
    lower = text.lower()
    name = _ALIASES.get(lower) or next((u for u in _UNITS if u.lower() == lower), None)
    if name is None:
        raise UnitError(f"the unit {shown(unit)} is not known; {nearest(unit, _UNITS)}")
    return name


def known(unit: str) -> bool:
    """Whether the table has the unit, by any spelling.

    >>> known("km/h"), known("furlong")
    (True, False)
    """
    return not raises(UnitError, canonical, unit)


def names() -> tuple[str, ...]:
    """Every unit of the table."""
    return tuple(_UNITS)


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


def ending(name: str, what: str) -> tuple[str, str | None]:
    """A name without the unit it ends with, where that is one of the quantity ``what``, and the unit.

    A unit of one letter is one only after a stroke or a blank: the end of ayCoG is none.

    >>> ending("speed_kmh", "speed"), ending("yawRateRad_s", "angular rate"), ending("ay m/s²", "acceleration")
    (('speed', 'km/h'), ('yawRate', 'rad/s'), ('ay', 'm/s2'))
    >>> ending("delta_r", "angle"), ending("time_ms", "speed"), ending("deg", "angle")
    (('delta_r', None), ('time', 'm/s'), ('deg', None))
    >>> ending("ayCoG", "acceleration"), ending("ay_g", "acceleration")
    (('ayCoG', None), ('ay', 'g'))
    """
    words = list(_WORD.finditer(name.replace("²", "2")))
    for first in range(max(1, len(words) - 4), len(words)):
        at, text = words[first].start(), "".join(w[0] for w in words[first:]).lower()
        if text in _spelled(what) and (len(text) > 1 or not name[at - 1].isalnum()):
            return name[:at].rstrip(" _-.,/"), _spelled(what)[text]
    return name, None


@cache
def _spelled(what: str) -> dict[str, str]:
    """Units of a quantity as names are written, without strokes and blanks."""
    written = {**_ALIASES, **{unit: unit for unit in _UNITS}}
    return {
        re.sub(r"[\s/*^.-]", "", text.replace("/", stroke)).lower(): unit
        for stroke in ("/", "p", "per")
        for text, unit in written.items()
        if _UNITS[unit][0] == what and re.search("[a-z°%]", text.lower())
    }


def to_si(values: np.ndarray | float, unit: str, *, expected: str | None = None, what: str = "value") -> np.ndarray:
    """Convert to SI.

    Raises UnitError if the unit is unknown or of another quantity than expected.

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

    >>> round(float(to_si(36.0, "km/h")), 9), round(float(to_si(212.0, "°F")), 9)
    (10.0, 100.0)
    """
    name, _, factor = _UNITS[canonical(unit)]
    if expected is not None and quantity(expected) != name:
        raise UnitError(
            f"{what} is given in {unit!r}, which is {name}; expected {quantity(expected)}, such as "
            f"{si_unit(expected)!r}: correct the unit or choose another column"
        )
    with np.errstate(over="ignore", invalid="ignore"):  # infinite and NaN, signalling too, are missing values
        return (np.asarray(values, dtype=float) - _ZEROS.get(canonical(unit), 0.0)) * factor


def from_si(values: np.ndarray | float, unit: str) -> np.ndarray:
    """Convert SI values to ``unit``; inverse of `to_si`."""
    name = canonical(unit)
    return np.asarray(values, dtype=float) / _UNITS[name][2] + _ZEROS.get(name, 0.0)


def deg(value: float) -> float:
    """Degrees, ``value``, to radians. [rad]"""
    return math.radians(value)


def kmh(value: float) -> float:
    """Kilometres per hour, ``value``, to metres per second. [m/s]"""
    return value / 3.6


@dataclass(frozen=True)
class SI:
    """Unit, meaning and admissible range of a parameter, as field metadata."""

    unit: str
    doc: str  # meaning in a few words
    lower: float = -math.inf  # smallest value, in unit
    upper: float = math.inf  # largest value, in unit


_AS_KEPT: ContextVar[bool] = ContextVar("as_kept", default=False)


@contextmanager
def shown_in_si(wanted: bool = True) -> Iterator[None]:
    """What is shown inside is in SI units and radians, as it is kept: pages, tables, figures.

    >>> with shown_in_si():
    ...     read_in("v_x", "m/s"), speed_said(20.0)
    ((1.0, 'm/s'), '20 m/s')
    """
    before = _AS_KEPT.set(wanted)
    try:
        yield
    finally:
        _AS_KEPT.reset(before)


def shows_si() -> bool:
    """Whether people read SI units now, see `shown_in_si`."""
    return _AS_KEPT.get()


def read_in(name: str, unit: str) -> tuple[float, str]:
    """Factor and unit in which people read a channel or parameter: degrees, km/h for speeds of travel, ms for delays.

    Inside `shown_in_si` they read SI units.

    >>> read_in("v_y", "m/s"), read_in("C_f", "N/rad")
    ((1.0, 'm/s'), (1.0, 'N/rad'))
    >>> read_in("delay_delta", "s"), round(read_in("v_x", "m/s")[0], 3)
    ((1000.0, 'ms'), 3.6)
    """
    if shows_si():
        return 1.0, unit
    if unit in ("rad", "rad/s", "rad/s2"):
        return math.degrees(1.0), unit.replace("rad", "deg")
    if unit == "m/s" and name in ("v_x", "v"):
        return 3.6, "km/h"
    return (1000.0, "ms") if unit == "s" and name != "t" else (1.0, unit)


def speed_said(v_x: float) -> str:
    """A speed of travel [m/s] as people read it.

    >>> speed_said(20.0)
    '72 km/h'
    """
    factor, unit = read_in("v_x", "m/s")
    return f"{factor * v_x:.3g} {unit}"


def angle_said(angle: float, digits: str = ".3g") -> str:
    """An angle [rad] as people read it.

    >>> angle_said(0.1), angle_said(0.1, "+.1f")
    ('5.73°', '+5.7°')
    """
    if shows_si():
        return f"{angle:{'+' if '+' in digits else ''}.3f} rad"
    return f"{math.degrees(angle):{digits}}°"
