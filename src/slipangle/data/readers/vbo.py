"""VBO files of Racelogic: text in sections, places in minutes of arc, those in the west positive [1]_ [2]_.

References
----------
.. [1] Racelogic, VBO File Format, support centre: sections, channels and how each is written.
.. [2] Racelogic, VBO File Structure, developer portal: units of channels that are not standard.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slipangle import units
from slipangle.data.race import equirectangular
from slipangle.data.readers.recording import Recording
from slipangle.data.readers.registry import reader
from slipangle.data.readers.stamps import seconds_of
from slipangle.data.readers.tables import DATE, ArrayTable, Header
from slipangle.errors import FormatError, ParameterError
from slipangle.files import read_bytes

_UNITS = {"time": DATE, "latitude": "deg", "longitude": "deg", "heading": "deg", "height": "m"}
_UNITS |= {"long accel": "g", "lat accel": "g"}
_STANDARD = (*_UNITS, "satellites", "velocity", "vertical velocity", "sample", "solution", "event", "trigger", "avi")


def _known(head: bytes) -> bool:
    return b"File created on" in head[:64] and b"[header]" in head


@reader("Racelogic VBO", recognises=_known, suffixes=(".vbo",))
def read_vbo(path: Path) -> Recording:
    """Every channel of a VBO file; degrees of latitude and longitude, and metres east and north of the first place.

    Raises FormatError if it is damaged.
    """
    text = read_bytes(path, "the log", "a readable file: check its permissions").decode("utf-8", "replace")
    parts = _sections(text)
    titles = [line.lower() for line in parts.get("header", []) if line]
    names = " ".join(parts.get("column names", [])).split()
    rows = [line for line in parts.get("data", []) if line]
    if not titles or len(names) != len(titles) or not rows:
        raise FormatError(
            f"'{path}' has {len(titles)} channels under [header], {len(names)} under [column names] and {len(rows)} "
            "rows under [data]; expected as many names as channels, and rows: copy or export it again"
        )
    try:
        values = np.loadtxt(rows, ndmin=2, comments=None)
    except ValueError as error:
        raise FormatError(f"'{path}' holds no even table of numbers under [data] ({str(error)[:80]})") from None
    if values.shape[1] != len(names):
        raise FormatError(f"'{path}' has rows of {values.shape[1]} numbers under [data]; expected {len(names)}")
    others, note = _others(parts.get("channel units", []), titles)
    headers = [Header(text=n, name=n, unit=_unit(t, u)) for n, t, u in zip(names, titles, others, strict=True)]
    for k, title in enumerate(titles):
        if title == "time":
            values[:, k] = seconds_of(values[:, k])
        elif title in ("latitude", "longitude"):
            values[:, k] /= 60.0 if title == "latitude" else -60.0
            headers[k] = Header(text=names[k], name=title, unit="deg")
    if {"latitude", "longitude"} <= {*titles} and not {"X", "Y"} & {*names}:
        metres = _metres(values, titles, path)
        values = np.column_stack([values, metres])
        headers += [Header(text=n, name=n, unit="m") for n in ("X", "Y")]
    table = ArrayTable(name=f"'{path.name}'", headers=tuple(headers), values=values)
    return Recording(name=path.stem, tables={"": table}, notes=note)


def _sections(text: str) -> dict[str, list[str]]:
    """Lines below each heading in square brackets, without blanks around them."""
    parts: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in map(str.strip, text.splitlines()):
        if line.startswith("[") and line.endswith("]"):
            lines = parts.setdefault(line[1:-1].lower(), [])
        else:
            lines.append(line)
    return parts


def _others(lines: list[str], titles: list[str]) -> tuple[list[str], tuple[str, ...]]:
    """What stands under [channel units], a line for each of the last channels; "" where none does. And a note."""
    said = lines[:-1] if lines and not lines[-1] else lines  # a blank line ends a section
    first = len(titles) - len(said)
    standard = [title.startswith(_STANDARD) for title in titles]
    if 0 <= first and all(standard[:first]) and not any(standard[first:]):
        return [*[""] * first, *said], ()
    none = [""] * len(titles)
    if not any(said):
        return none, ()
    return none, ("what stands under [channel units] is not one line for each channel of its own: not read",)


def _unit(title: str, other: str) -> str | None:
    """Of a standard channel, whose title may end with it (velocity kmh), or what stands under [channel units]."""
    if "velocity" in title and title.startswith(_STANDARD):
        return units.ending(title, "speed")[1] or title.partition("velocity")[2].strip() or None
    return _UNITS.get(title) or other or None


def _metres(values: np.ndarray, titles: list[str], path: Path) -> np.ndarray:
    """East and north of the first place [m], shape (n, 2).

    Rows without a place have zeros for both angles: there these, and the metres, are set to NaN.
    """
    columns = [titles.index("latitude"), titles.index("longitude")]
    placed = (values[:, columns] != 0).any(axis=1)
    metres = np.full((len(values), 2), np.nan)
    values[np.ix_(~placed, columns)] = np.nan
    if placed.any():
        try:
            metres[placed] = np.column_stack(equirectangular(*np.radians(values[np.ix_(placed, columns)]).T))
        except ParameterError:
            raise FormatError(f"'{path}' has latitudes beyond the poles; expected minutes of arc") from None
    return metres
