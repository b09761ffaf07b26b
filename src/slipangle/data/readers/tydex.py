"""TYDEX tire measurements (``.tdx``): headers, constants and measured channels of one run, to `TireData`.

The format is lines of at most 80 characters in blocks that a line ``**NAME`` opens; ``!`` begins a comment.
``**CONSTANTS`` and ``**MEASURCHANNELS`` have name, description and unit in 10, 30 and 10 characters, and then a value,
or what turns stored numbers into measured ones: a factor, an offset before it and one behind it. ``**MEASURDATA`` has a
row of numbers per sample, in the order of the channels. Axes are those that a channel's last letter names: C, H or W,
of which W is read (x forward, y left, z up in the plane of the road).

References
----------
.. [1] J. J. M. van Oosten, H.-J. Unrau, A. Riedel, E. Bakker, TYDEX Workshop: standardisation of data exchange in tyre
   testing and tyre modelling, Vehicle System Dynamics 27 (1997) S1.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from slipangle import errors
from slipangle.data.numerals import is_number, to_number
from slipangle.data.readers.ttc import from_channels, read_ttc
from slipangle.data.tire_data import TireData
from slipangle.files import read_bytes

# channel of TYDEX: that of `from_channels`, and its usual unit
_CHANNELS = {
    **{"SLIPANGL": ("SA", "deg"), "LONGSLIP": ("SL", "%"), "INCLANGL": ("IA", "deg"), "RUNTIME": ("ET", "s")},
    **{"FXW": ("FX", "N"), "FYW": ("FY", "N"), "FZW": ("FZ", "N"), "MXW": ("MX", "N m"), "MZW": ("MZ", "N m")},
    **{"TRAJVELW": ("V", "m/s"), "TRAJVELH": ("V", "m/s"), "LONGVEL": ("V", "m/s"), "INFLPRES": ("P", "bar")},
    **{"TYRETEMP": ("TSTC", "degC"), "TREADTMP": ("TSTC", "degC")},
}
_SPELLINGS = {"nm": "N m", "n*m": "N m", "kn": "kN", "-": "-", "": "", "deg c": "degC", "c": "degC", "grad": "deg"}


def read_tydex(path: str | Path, *, name: str = "", warm_up: bool = True) -> TireData:
    """Read a TYDEX measurement, in the signs of docs/nomenclature.md, which are found in its data.

    Constants such as the inflation pressure stand for a channel that was not measured.

    Raises MissingFileError, FormatError, MissingColumnError, UnitError, ExcitationError or TooShortError with the line
    or channel, and what to do.
    """
    text = read_bytes(path, "the TYDEX file", "a .tdx file: check the path").decode("latin-1")
    columns: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    channels: list[tuple[str, str, tuple[float, float, float]]] = []
    constants: dict[str, tuple[str, float]] = {}
    rows: list[list[float]] = []
    block = ""
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith("!"):
            continue
        if line.startswith("**"):
            block = line[2:].split()[0].upper() if line[2:].split() else ""
        elif block == "CONSTANTS" and line.strip():
            key, unit, values = _entry(line)
            if values:
                constants[key] = (unit, values[0])
        elif block == "MEASURCHANNELS" and line.strip():
            key, unit, values = _entry(line)
            factor, before, behind = (*values, *(1.0, 0.0, 0.0)[len(values) :])[:3]
            channels.append((key, unit, (factor if factor else 1.0, before, behind)))
        elif block == "MEASURDATA" and channels and line.strip():
            rows.append(_row(line, number, len(channels), str(path)))
    if not channels or not rows:
        what = "no **MEASURCHANNELS" if not channels else "no rows below **MEASURDATA"
        raise errors.FormatError(f"'{path}' has {what}; expected a TYDEX measurement: choose another file")
    table = np.array(rows)
    for k, (key, unit, (factor, before, behind)) in enumerate(channels):
        known = _CHANNELS.get(key)
        if known and known[0] not in columns:
            with np.errstate(over="ignore", invalid="ignore"):
                columns[known[0]] = (table[:, k] + before) * factor + behind
            units[known[0]] = unit or known[1]
    for key, (unit, value) in constants.items():
        known = _CHANNELS.get(key)
        if known and known[0] not in columns:
            columns[known[0]] = np.full(len(table), value)
            units[known[0]] = unit or known[1]
    other = next((key for key, _, _ in channels if key in ("FYC", "FYH")), None)
    if "FY" not in columns and other:
        raise errors.MissingColumnError(
            f"'{path}' has forces in the {other[-1]} axes of TYDEX only ({other}); expected FXW, FYW and FZW: convert "
            "the file to W axes"
        )
    return from_channels(columns, units, name=name or Path(path).stem, warm_up=warm_up)


def _entry(line: str) -> tuple[str, str, list[float]]:
    """Name, unit and numbers of a line: in fixed columns of 10, 30, 10 and 10 characters."""
    key, unit, rest = line[:10].strip().upper(), line[40:50].strip(), line[50:]
    values = [to_number(word) for word in rest.split() if is_number(word)]
    return key, _SPELLINGS.get(unit.lower(), unit), values


def _row(line: str, number: int, width: int, path: str) -> list[float]:
    words = line.split()
    bad = next((word for word in words if not is_number(word)), None)
    if bad is not None or len(words) != width:
        what = f"holds {errors.shown(bad)}" if bad is not None else f"has {len(words)} numbers"
        raise errors.FormatError(
            f"line {number} of '{path}' {what}; expected {width} numbers, one per channel: repair or delete that line"
        )
    return [to_number(word) for word in words]


def read_rig(
    path: str | Path, *, name: str = "", units: Literal["US", "metric"] | None = None, warm_up: bool = True
) -> TireData:
    """A run of a rig in any format that is known: TYDEX where the name ends in .tdx, else as `read_ttc` reads it."""
    if Path(path).suffix.lower() in (".tdx", ".tyd"):
        return read_tydex(path, name=name, warm_up=warm_up)
    return read_ttc(path, name=name, units=units, warm_up=warm_up)
