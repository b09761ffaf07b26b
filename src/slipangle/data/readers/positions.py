"""GPX and KML: positions over time, as degrees and as metres east and north of the first."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from slipangle.data.race import equirectangular
from slipangle.data.readers.registry import reader
from slipangle.data.readers.tables import ArrayTable, Header
from slipangle.data.readers.text_dialect import to_instant
from slipangle.errors import FormatError, ParameterError, TooShortError
from slipangle.files import read_bytes


@reader("GPX", recognises=lambda head: b"<gpx" in head, suffixes=(".gpx",))
def read_gpx(path: Path) -> ArrayTable:
    """Track points of a GPX file (Topografix 1.0 and 1.1); speeds and headings of extensions are not read.

    Raises FormatError if it is damaged, TooShortError if it has fewer than two points with a time.
    """
    points = [p for p in _parsed(path).iter() if _tag(p) == "trkpt"]
    rows = []
    for point in points:
        own = {_tag(child): (child.text or "") for child in point}
        if "time" in own:
            rows.append((own["time"], point.get("lon", ""), point.get("lat", ""), own.get("ele", "nan")))
    return _table(rows, path)


@reader("KML", recognises=lambda head: b"<kml" in head, suffixes=(".kml",))
def read_kml(path: Path) -> ArrayTable:
    """A track of a KML file (OGC KML 2.3, ``Track`` of ``when`` and ``coord``); a bare line has no time.

    Raises FormatError if it is damaged, TooShortError if it has fewer than two points with a time.
    """
    rows: list[tuple[str, str, str, str]] = []
    for track in _parsed(path).iter():
        if _tag(track) == "Track":
            when = [child.text or "" for child in track if _tag(child) == "when"]
            where = [(child.text or "").replace(",", " ").split() for child in track if _tag(child) == "coord"]
            if len(when) != len(where) or any(len(w) not in (2, 3) for w in where):
                raise FormatError(
                    f"'{path}' has a track of {len(when)} times and {len(where)} positions; expected as many of each, "
                    "of 2 or 3 numbers: export it again"
                )
            rows += [(t, w[0], w[1], w[2] if len(w) == 3 else "nan") for t, w in zip(when, where, strict=True)]
    return _table(rows, path)


@reader("CommonRoad", recognises=lambda head: b"<commonRoad" in head)
def read_commonroad(path: Path) -> ArrayTable:
    """Refused: a scenario is a road, not a drive; `slipangle.Path.from_file` reads it.

    Raises FormatError.
    """
    raise FormatError(f"'{path}' is a CommonRoad scenario, a road and no log; expected a drive: use Path.from_file")


def _tag(element: ElementTree.Element) -> str:
    return str(element.tag).rpartition("}")[2]


def _parsed(path: Path) -> ElementTree.Element:
    """The file's tree; entities, which can grow without end, are refused."""
    raw = read_bytes(path, "the log", "a readable file: check its permissions")
    if b"<!DOCTYPE" in raw or b"<!ENTITY" in raw or b"\0" in raw:
        raise FormatError(f"'{path}' declares a document type; expected plain GPX or KML in UTF-8: export it again")
    try:
        return ElementTree.fromstring(raw)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise FormatError(
            f"'{path}' is no whole XML ({str(error)[:80]}); expected GPX or KML: export it again"
        ) from None


def _table(rows: list[tuple[str, str, str, str]], path: Path) -> ArrayTable:
    if len(rows) < 2:
        raise TooShortError(
            f"'{path}' holds {len(rows)} positions with a time; expected at least 2: export the track with time stamps"
        )
    try:
        numbers = np.array([[to_instant(t.strip()), float(x), float(y), float(z or "nan")] for t, x, y, z in rows])
    except (ValueError, OverflowError) as error:
        raise FormatError(f"'{path}' holds what is no time or position ({str(error)[:80]}); expected numbers") from None
    t, longitude, latitude, height = numbers.T
    try:
        east, north = equirectangular(np.radians(latitude), np.radians(longitude))
    except ParameterError:
        raise FormatError(f"'{path}' has latitudes beyond the poles; expected degrees") from None
    names = (("t", "s"), ("longitude", "deg"), ("latitude", "deg"), ("Z", "m"), ("X", "m"), ("Y", "m"))
    columns = [t, longitude, latitude, height, east, north]
    if not np.isfinite(height).any():
        del columns[3]
        names = tuple(n for n in names if n[0] != "Z")
    headers = tuple(Header(text=n, name=n, unit=u) for n, u in names)
    return ArrayTable(name=f"'{path.name}'", headers=headers, values=np.column_stack(columns))
