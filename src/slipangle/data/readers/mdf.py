"""ASAM MDF 3 and 4 files (.mdf, .dat, .mf4), by asammdf: each channel group with its master is a clock of its own."""

from __future__ import annotations

import gc
import html
import json
import logging
import sys
import warnings
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from slipangle.data.readers.mdf_chains import require_chains
from slipangle.data.readers.recording import Recording
from slipangle.data.readers.registry import reader
from slipangle.data.readers.tables import ChannelTable, Header, LazyTable
from slipangle.errors import FormatError, SlipangleError
from slipangle.extras import extra
from slipangle.files import read_bytes

T = TypeVar("T")
_NUMBERS = {3: (0, 1, 2, 3, 9, 10, 11, 12, 13, 14, 15, 16), 4: (0, 1, 2, 3, 4, 5)}  # data types of MDF 3 and 4
_MOST = 100_000  # channels
OURS = "slipangle: "  # begins the comment that our writer leaves


@reader(
    "MDF",
    recognises=lambda head: head[:8] in (b"MDF     ", b"UnFinMF "),
    suffixes=(".mf4", ".mdf"),
)
def read_mdf(path: Path) -> Recording:
    """A measurement file of MDF 3 or 4.

    Raises FormatError if it is damaged, ConfigError if asammdf is not installed.
    """
    asammdf = extra("asammdf", "io", "reading an MDF file")
    require_chains(read_bytes(path, "the log", "an MDF file: check its permissions"), path)
    file = _File(_trusted(path, lambda: asammdf.MDF(path)))

    def tables_of() -> tuple[dict[str, ChannelTable], dict[str, Any]]:
        tables: dict[str, ChannelTable] = {}
        for i in range(len(file.opened.groups)):
            _add_group(file, i, path, tables)
        return tables, _meta(file.opened)

    tables, meta = _trusted(path, tables_of)
    return Recording(name=path.stem, tables=tables, meta=meta)


class _File:
    """A file of asammdf's, closed when the last table that reads from it is forgotten."""

    def __init__(self, opened: Any) -> None:
        self.opened = opened
        weakref.finalize(self, opened.close)


def _trusted(path: Path, call: Callable[[], T]) -> T:
    """What asammdf gives; whatever it stumbles over is a damaged file, and what it logs is not shown."""
    logger, hook = logging.getLogger("asammdf"), sys.unraisablehook
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    sys.unraisablehook = lambda _: None  # a file half opened complains once more when it is forgotten
    try:
        with warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
            try:
                return call()
            except SlipangleError:
                raise
            except Exception as error:  # of many kinds: it trusts every byte
                why = (str(error).splitlines() or [type(error).__name__])[0][:120]
            gc.collect()  # the file half opened, while nobody listens
    finally:
        logger.setLevel(level)
        sys.unraisablehook = hook
    raise FormatError(
        f"'{path}' cannot be read as MDF ({why}); expected a whole, finalised file: copy or export it again"
    )


def _add_group(file: _File, i: int, path: Path, tables: dict[str, ChannelTable]) -> None:
    opened = file.opened
    group = opened.groups[i]
    master = opened.masters_db.get(i)
    numeric = _NUMBERS[3 if opened.version < "4" else 4]
    found = [k for k, c in enumerate(group.channels[:_MOST]) if k != master and c.data_type in numeric]
    if not found or int(group.channel_group.cycles_nr) < 2:
        return
    headers = tuple(
        Header(text=group.channels[k].name, name=_short(group.channels[k].name), unit=_unit(group.channels[k]))
        for k in found
    )
    time = (Header(text="t", name="t", unit="s"),) if master is not None else ()

    def loaded(column: int) -> np.ndarray:
        if time and column == 0:
            return np.asarray(file.opened.get_master(i), dtype=float)
        k = found[column - len(time)]
        found_there = file.opened.get(group=i, index=k, ignore_invalidation_bits=True)
        values, invalid = np.asarray(found_there.samples), found_there.invalidation_bits
        if values.dtype.kind not in "biuf" or values.ndim != 1:  # a conversion to text
            values = np.asarray(file.opened.get(group=i, index=k, raw=True).samples)
        if values.dtype.kind not in "biuf" or values.ndim != 1:
            raise FormatError(f"channel '{headers[column - len(time)].name}' of '{path}' holds no plain numbers")
        values = values.astype(float)
        if invalid is not None:  # what did not come, as a frame of a bus: the bytes are old, or anything
            values[np.asarray(invalid, dtype=bool)] = np.nan
        return values

    name = str(getattr(group.channel_group, "acq_name", "") or "").strip() or f"group {i}"
    topic = name if name not in tables else f"{name} {i}"
    tables[topic] = LazyTable(
        name=f"{topic!r} of '{path.name}'",
        headers=(*time, *headers),
        load=lambda column: _trusted(path, lambda: loaded(column)),
    )


def _short(name: str) -> str:
    """The name without the device that CANape and INCA write behind a backslash."""
    return name.split("\\")[0] or name


def _unit(channel: Any) -> str | None:
    unit = getattr(channel, "unit", "") or getattr(getattr(channel, "conversion", None), "unit", "") or ""
    text = unit.decode("latin-1", "replace") if isinstance(unit, bytes) else str(unit)
    return text.strip().strip("\0") or None


def _meta(opened: Any) -> dict[str, Any]:
    """What our writer noted in the file's comment, or nothing."""
    comment = html.unescape(str(getattr(opened.header, "comment", "") or ""))  # it is XML
    start = comment.find(OURS)
    if start < 0:
        return {}
    try:
        meta, _ = json.JSONDecoder().raw_decode(comment[start + len(OURS) :])
    except ValueError:
        return {}
    return meta if isinstance(meta, dict) else {}
