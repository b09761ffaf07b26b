"""What the headings of a track file say: units of its columns, and whether its places are latitude and longitude."""

from __future__ import annotations

import re
import warnings

import numpy as np

from slipangle import units
from slipangle.data.race import equirectangular
from slipangle.errors import FormatError, ModelWarning, ParameterError

_PLACES = (
    r"((cent(er|re)_?|pos_?)?x|east(ing)?)(?![a-z])|lon|lng",
    r"((cent(er|re)_?|pos_?)?y|north(ing)?)(?![a-z])|lat",
)
_WIDTHS = (
    r"right|(^|_)(w|width|tr)_?r(?![a-z])",
    r"left|(^|_)(w|width|tr)_?l(?![a-z])",
    r"^(track_?)?(w\b|w_|width)",
)
_NOT_FLAT = r"z(?![a-z])|elev|alt(?![ae])|height|bank|camber|superelev|cross_?slope|slope|grad"
_UNIT = re.compile(r"[\s_\[(/]+(mm|cm|km|m|ft|deg|rad)[\])]?$")


def said_of_columns(line: str) -> list[str]:
    """Names of columns with their units, in lower case, of a line that may head a track; none of one with a number."""
    names = [name.strip().strip('"').lower() for name in re.split(r"[,;\t]", line.replace("#", " "))]
    if len(names) == 1:
        names = names[0].split()
    names = [re.sub(r"^gps[ _.]?(?=lat|lon|lng)", "", name) for name in names]
    worded = all(re.match(r"(?!(nan|inf)\b)[a-z]", name) for name in names)
    return names if len(names) > 1 and worded else []


def chosen(columns: list[str]) -> list[int] | None:
    """Which columns are x, y and, where both are there, the widths to the right and left; None without x and y.

    Widths that name no side are those to the right and left, if there are two, and one is that of the whole track,
    which stands twice. Other columns, such as arc length, speed or heading, are left out.
    """
    x, y = ([j for j, name in enumerate(columns) if re.match(words, name)] for words in _PLACES)
    if len(x) != 1 or len(y) != 1:
        return None
    places = sorted(x + y) if columns[x[0]].startswith("l") else x + y  # latitude first, or longitude
    right, left, whole = ([j for j, n in enumerate(columns) if re.search(words, n)] for words in _WIDTHS)
    if len(right) == len(left) == 1:
        return [*places, *right, *left]
    return [*places, *(whole * 2 if len(whole) == 1 else whole if len(whole) == 2 else [])]


def in_metres(table: np.ndarray, columns: list[str], source: str) -> tuple[np.ndarray, tuple[float, float] | None]:
    """What is `chosen` of a track in metres by the units of its headings, and its origin [rad] if it is on Earth.

    Without headings it is the table as it stands. Of latitude and longitude, in degrees unless headed in rad, x is east
    and y north of the first point. A width without a unit has that of x; numbers without any are in metres.

    Warns with ModelWarning of heights and banking, which a path does not know.

    Raises
    ------
    FormatError
        If the headings name no x and y, or a place is none on Earth.
    """
    if not columns:
        return table, None
    kept = chosen(columns)
    if kept is None:
        raise FormatError(
            f"'{source}' is headed {', '.join(columns)}; expected one x and one y among them, such as x_m, y_m, "
            "w_tr_right_m, w_tr_left_m: name the columns"
        )
    _warn_of_heights(table, columns, source)
    table, columns = table[:, kept], [columns[j] for j in kept]
    said = [found.group(1) if (found := _UNIT.search(name)) else "" for name in columns]
    order = [next((j for j in (0, 1) if columns[j].startswith(words)), None) for words in (("lat",), ("lon", "lng"))]
    share = 0.5 if len({*kept}) < len(kept) else 1.0  # of the width of the whole track
    table[:, 2:] *= [share * _metres(unit or said[0]) for unit in said[2:]]
    if None in order:
        table[:, :2] *= [_metres(unit) for unit in said[:2]]
        return table, None
    places = table[:, order]  # type: ignore[index]
    lat, lon = (places if "rad" in said[:2] else np.radians(places)).T
    try:
        table[:, 0], table[:, 1] = equirectangular(lat, lon)
    except ParameterError:
        raise FormatError(
            f"'{source}' is headed {columns[0]}, {columns[1]} and has {places[np.abs(places).argmax() // 2].tolist()}; "
            "expected degrees within 90 and 180: correct the heading, or name the columns x_m, y_m"
        ) from None
    return table, (float(lat[0]), float(lon[0]))


def _warn_of_heights(table: np.ndarray, columns: list[str], source: str) -> None:
    said = [j for j, name in enumerate(columns) if re.match(_NOT_FLAT, name) and np.ptp(table[:, j]) > 0]
    if said:
        values = " and ".join(f"{columns[j]} from {table[:, j].min():.3g} to {table[:, j].max():.3g}" for j in said)
        warnings.warn(
            f"'{source}' has {values}, which is left out: tracks here are flat, without slopes and banking; where "
            "these count, the lap is another one",
            ModelWarning,
            stacklevel=5,
        )


def _metres(unit: str) -> float:
    """Of a unit of length; 1 of others and of none."""
    return float(units.to_si(1.0, unit)) if unit and units.quantity(unit) == "length" else 1.0
