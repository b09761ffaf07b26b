"""The [UNITS] block of a tire property file, and which key carries which dimension."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from slipangle.errors import UnitError, nearest, shown

# Names of units in the field (Adams, MF-Tyre, cosin): name -> (SI factor, system)
_NAMES: dict[str, dict[str, tuple[float, str]]] = {
    "LENGTH": {
        **dict.fromkeys(("METER", "METERS", "METRE", "M"), (1.0, "metric")),
        **dict.fromkeys(("MILLIMETER", "MILLIMETRE", "MM"), (1e-3, "metric")),
        **dict.fromkeys(("CENTIMETER", "CENTIMETRE", "CM"), (1e-2, "metric")),
        **dict.fromkeys(("KILOMETER", "KM"), (1e3, "metric")),
        **dict.fromkeys(("INCH", "IN"), (0.0254, "imperial")),
        **dict.fromkeys(("FOOT", "FEET", "FT"), (0.3048, "imperial")),
        "MILE": (1609.344, "imperial"),
    },
    "FORCE": {
        **dict.fromkeys(("NEWTON", "NEWTONS", "N"), (1.0, "metric")),
        **dict.fromkeys(("KNEWTON", "KILONEWTON", "KN"), (1e3, "metric")),
        **dict.fromkeys(("KG_FORCE", "KILOGRAM_FORCE", "KGF"), (9.80665, "metric")),
        **dict.fromkeys(("DYNE", "DYN"), (1e-5, "metric")),
        **dict.fromkeys(("POUND_FORCE", "POUNDFORCE", "LBF"), (4.4482216152605, "imperial")),
        **dict.fromkeys(("KPOUND_FORCE", "KPOUNDFORCE", "KLBF"), (4448.2216152605, "imperial")),
        **dict.fromkeys(("OUNCE_FORCE", "OUNCEFORCE"), (0.27801385095378125, "imperial")),
    },
    "MASS": {
        **dict.fromkeys(("KG", "KILOGRAM"), (1.0, "metric")),
        **dict.fromkeys(("GRAM", "G"), (1e-3, "metric")),
        **dict.fromkeys(("TONNE", "MEGAGRAM"), (1e3, "metric")),
        **dict.fromkeys(("POUND_MASS", "POUNDMASS", "LBM", "LB"), (0.45359237, "imperial")),
        **dict.fromkeys(("KPOUND_MASS", "KPOUNDMASS"), (453.59237, "imperial")),
        "SLUG": (14.593902937206, "imperial"),
        **dict.fromkeys(("OUNCE_MASS", "OUNCEMASS"), (0.028349523125, "imperial")),
    },
    "TIME": {
        **dict.fromkeys(("SECOND", "SECONDS", "SEC", "S"), (1.0, "")),
        **dict.fromkeys(("MILLISECOND", "MILLI", "MSEC", "MS"), (1e-3, "")),
        **dict.fromkeys(("MINUTE", "MIN"), (60.0, "")),
        **dict.fromkeys(("HOUR", "H"), (3600.0, "")),
    },
    "ANGLE": {
        **dict.fromkeys(("RADIAN", "RADIANS", "RAD"), (1.0, "")),
        **dict.fromkeys(("DEGREE", "DEGREES", "DEG"), (math.pi / 180, "")),
        **dict.fromkeys(("GRAD", "GRADS"), (math.pi / 200, "")),
    },
    "PRESSURE": {
        **dict.fromkeys(("PASCAL", "PA"), (1.0, "metric")),
        **dict.fromkeys(("KPASCAL", "KILOPASCAL", "KPA"), (1e3, "metric")),
        **dict.fromkeys(("MPASCAL", "MEGAPASCAL", "MPA"), (1e6, "metric")),
        "BAR": (1e5, "metric"),
        "PSI": (6894.757293168, "imperial"),
        "KSI": (6894757.293168, "imperial"),
    },
}
# Keys with a dimension, as exponents of length, force, mass, time, angle, or "pressure". Every Magic Formula
# coefficient is dimensionless or per radian, whatever [UNITS] says.
_DIMENSIONS: dict[str, str] = {
    **dict.fromkeys(
        ("UNLOADED_RADIUS", "WIDTH", "RIM_RADIUS", "RIM_WIDTH", "BOTTOMING_RADIUS", "BOTTOM_OFFST", "ROAD_INCREMENT"),
        "length",
    ),
    **dict.fromkeys(("FNOMIN", "FZMIN", "FZMAX"), "force"),
    **dict.fromkeys(("ALPMIN", "ALPMAX", "CAMMIN", "CAMMAX"), "angle"),
    **dict.fromkeys(("LONGVL", "VXLOW"), "length / time"),
    **dict.fromkeys(("INFLPRES", "NOMPRES", "PRESMIN", "PRESMAX", "IP", "IP_NOM"), "pressure"),
    **dict.fromkeys(
        ("VERTICAL_STIFFNESS", "LONGITUDINAL_STIFFNESS", "LATERAL_STIFFNESS", "BOTTOM_STIFF"), "force / length"
    ),
    "YAW_STIFFNESS": "force * length / angle",
    "VERTICAL_DAMPING": "force * time / length",
    **dict.fromkeys(("MASS", "BELT_MASS", "MBELT"), "mass"),
    **dict.fromkeys(("IXX", "IYY", "BELT_IXX", "BELT_IYY"), "mass * length * length"),
    "GRAVITY": "length / time / time",
}
_PLAUSIBLE: dict[str, tuple[float, float, str]] = {
    "UNLOADED_RADIUS": (0.02, 4.0, "m"),
    "WIDTH": (0.005, 3.0, "m"),
    "FNOMIN": (5.0, 1e6, "N"),
    "INFLPRES": (1e4, 3e6, "Pa"),
    "NOMPRES": (1e4, 3e6, "Pa"),
    "IP": (1e4, 3e6, "Pa"),
    "IP_NOM": (1e4, 3e6, "Pa"),
    "ALPMAX": (0.0, 3.2, "rad"),
    "CAMMAX": (0.0, 3.2, "rad"),
}


@dataclass(frozen=True)
class Units:
    """SI factor of each base quantity of the file, 1 where it says nothing: SI = value in the file * factor."""

    factors: Mapping[str, float] = field(default_factory=dict)

    def factor(self, key: str) -> float:
        """SI factor of a key; 1 for the coefficients, which carry no unit of the file."""
        dimension = _DIMENSIONS.get(key.upper())
        if dimension is None:
            return 1.0
        value = 1.0
        for operator, name in re.findall(r"([*/]?)\s*(\w+)", dimension):
            base = self.factors.get(name, 1.0)
            value = value / base if operator == "/" else value * base
        return value

    def check_plausible(self, numbers: Mapping[str, float], name: str) -> None:
        """Refuse numbers that cannot be in the units that the file names.

        Raises UnitError with the key, its value in SI units and the range of tires.
        """
        for key, (lower, upper, unit) in _PLAUSIBLE.items():
            value = numbers.get(key)
            if value is not None and value != 0.0 and not lower <= abs(value) <= upper:
                raise UnitError(
                    f"{key} of '{name}' is {value:g} {unit} by its [UNITS]; expected {lower:g} to {upper:g} {unit}: "
                    "the file mixes units, correct [UNITS] or the value"
                )


def read_units(entries: Sequence[tuple[str, str, int]], name: str) -> Units:
    """Factors from the entries ``(key, value, line number)`` of [UNITS]; SI where the block says nothing.

    Raises UnitError if a unit is unknown, given twice, or metric and imperial units are mixed.
    """
    chosen: dict[str, tuple[str, float, str]] = {}
    for key, value, number in entries:
        known = _NAMES.get(key)
        if known is None:
            continue
        unit = known.get(value.strip().upper())
        if unit is None:
            raise UnitError(
                f"line {number} of '{name}' gives {key} in {shown(value)}; {nearest(value, known)}: use one of these"
            )
        if key in chosen and chosen[key][1] != unit[0]:
            raise UnitError(
                f"[UNITS] of '{name}' gives {key} twice, {chosen[key][0]!r} and {value!r}; expected one unit: "
                "delete one of the lines"
            )
        chosen[key] = (value, *unit)
    systems = {system: f"{key} in {text!r}" for key, (text, _, system) in chosen.items() if system}
    if len(systems) > 1:
        mixed = " and ".join(systems[s] for s in sorted(systems))
        raise UnitError(
            f"[UNITS] of '{name}' mixes {mixed}; expected units of one system: convert the values and correct [UNITS]"
        )
    factors = {key.lower(): factor for key, (_, factor, _) in chosen.items()}
    if "pressure" not in factors:
        factors["pressure"] = factors.get("force", 1.0) / factors.get("length", 1.0) ** 2
    return Units(factors)
