"""MoTeC's logged data, ``.ld``, with the beacons of the ``.ldx`` beside it.

MoTeC publishes no description; the layout is what users found by comparing files with what i2 exports [1]_: a header
of which two words matter here, then a list of channel records, each linked to the next, each with a rate of its own and
a block of 16- or 32-bit numbers, and ``value = (raw / scale * 10^-decimals + shift) * multiplier``.

References
----------
.. [1] G. Gotzl, ldparser, public description of the layout in its first lines, github.com/gotzl/ldparser.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slipangle.data.readers.recording import Recording
from slipangle.data.readers.registry import reader
from slipangle.data.readers.tables import Header, LazyTable
from slipangle.errors import FormatError
from slipangle.files import read_bytes

MARK = 0x40  # the first word of every file
_CHANNEL = struct.Struct("<4I4H4h32s8s12s")
_MOST = 10_000  # channels
_KINDS = {(7, 2): "<f2", (7, 4): "<f4", (0, 2): "<i2", (3, 2): "<i2", (5, 2): "<i2"}
_KINDS |= {(0, 4): "<i4", (3, 4): "<i4", (5, 4): "<i4"}
_BEACON = re.compile(r'<Marker\b[^>]{0,400}?\bTime="([-+.\deE]{1,30})"')


class _Channel(NamedTuple):
    name: str
    unit: str
    rate: int
    start: int
    samples: int
    kind: np.dtype
    shift: int
    multiplier: int
    scale: int
    decimals: int


@reader("MoTeC", recognises=lambda head: head[:4] == struct.pack("<I", MARK), suffixes=(".ld",))
def read_ld(path: Path) -> Recording:
    """A log of a MoTeC device, as it stands on the card or as i2 keeps it.

    Raises FormatError if it is damaged.
    """
    raw = read_bytes(path, "the log", "a MoTeC .ld file: check its permissions")
    channels = _channels(raw, path)
    tables = {}
    for rate in sorted({c.rate for c in channels}, reverse=True):
        own = [c for c in channels if c.rate == rate]
        for count in sorted({c.samples for c in own}, reverse=True):
            alike = [c for c in own if c.samples == count]
            topic = f"{rate} Hz" if len({c.samples for c in own}) == 1 else f"{rate} Hz, {count} samples"
            tables[topic] = _table(raw, alike, rate, count, f"'{path.name}'")
    return Recording(name=path.stem, tables=tables, notes=_beacons(path.with_suffix(".ldx")))


def _channels(raw: bytes, path: Path) -> list[_Channel]:
    def bad(what: str) -> FormatError:
        return FormatError(
            f"'{path}' is no whole MoTeC log ({what}); expected an .ld file: copy it from the card again"
        )

    if len(raw) < 16:
        raise bad("it ends in the header")
    at, _ = struct.unpack_from("<II", raw, 8)
    found: list[_Channel] = []
    seen: set[int] = set()
    while at:
        if at in seen or len(found) >= _MOST:
            raise bad("its list of channels has no end")
        if at + _CHANNEL.size > len(raw):
            raise bad(f"channel {len(found) + 1} stands beyond its end")
        seen.add(at)
        _, following, start, count, _, family, width, rate, *numbers, name, _, unit = _CHANNEL.unpack_from(raw, at)
        kind = _KINDS.get((family, width))
        said = _words(name) or f"channel {len(found) + 1}"
        if kind is not None and count and rate:
            shift, multiplier, scale, decimals = numbers
            if start + count * np.dtype(kind).itemsize > len(raw):
                raise bad(f"the samples of {said[:40]!r} stand beyond its end")
            if scale == 0 or abs(decimals) > 20:
                raise bad(f"the scale of {said[:40]!r} is {scale} with {decimals} decimals")
            found.append(
                _Channel(said, _words(unit), rate, start, count, np.dtype(kind), shift, multiplier, scale, decimals)
            )
        at = following
    if not found:
        raise bad("it holds no channel with samples")
    return found


def _words(raw: bytes) -> str:
    return raw.split(b"\0")[0].decode("latin-1").strip()


def _table(raw: bytes, channels: list[_Channel], rate: int, count: int, name: str) -> LazyTable:
    """Channels of one rate and length."""

    def load(column: int) -> np.ndarray:
        if column == 0:
            return np.arange(count) / rate
        c = channels[column - 1]
        with np.errstate(invalid="ignore"):  # signalling NaNs are missing values too
            values = np.frombuffer(raw, c.kind, c.samples, c.start).astype(float)
        return (values / c.scale * 10.0**-c.decimals + c.shift) * c.multiplier

    headers = (Header(text=c.name, name=c.name, unit=c.unit or None) for c in channels)
    return LazyTable(name=name, headers=(Header(text="t", name="t", unit="s"), *headers), load=load)


def _beacons(path: Path) -> tuple[str, ...]:
    """A note on the laps that the file beside the log marks, in microseconds."""
    try:
        text = path.read_bytes()[:1_000_000].decode("utf-8", "replace")
    except OSError:
        return ()
    times = []
    for found in _BEACON.finditer(text):
        try:
            times.append(float(found[1]) * 1e-6)
        except ValueError:
            continue
    if not times:
        return ()
    return (f"'{path.name}' marks {len(times)} beacons, at t = {', '.join(f'{t:.3f}' for t in sorted(times)[:20])} s",)
