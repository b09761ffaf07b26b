"""TYDEX tire measurements (``.tdx``): headers, constants and measured channels of one run, to `TireData`.

The format is lines of at most 80 characters in blocks that a line ``**NAME`` opens; ``!`` begins a comment.
``**CONSTANTS`` and ``**MEASURCHANNELS`` have name, description and unit in 10, 30 and 10 characters, and then a value,
or what turns stored numbers into measured ones: a factor, an offset before it and one behind it. ``**MEASURDATA`` has a
row of numbers per sample, in the order of the channels.

Axes are those that a channel's last letter names; x points forward in all of them. W has y left and z up on the road,
with its origin where the wheel touches; H is parallel to it through the wheel's centre; C is H turned about x by the
inclination, with the wheel. Forces and moments in H or C are brought to W.

References
----------
.. [1] J. J. M. van Oosten, H.-J. Unrau, A. Riedel, E. Bakker, TYDEX Workshop: standardisation of data exchange in tyre
   testing and tyre modelling, Vehicle System Dynamics 27 (1997) S1.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from slipangle import errors
from slipangle.data.numerals import is_number, to_number
from slipangle.data.readers.ttc import from_channels, read_ttc
from slipangle.data.tire_data import TireData
from slipangle.files import read_bytes
from slipangle.units import to_si

# channel of TYDEX: that of `from_channels`, and its usual unit
_CHANNELS = {
    **{"SLIPANGL": ("SA", "deg"), "LONGSLIP": ("SL", "%"), "INCLANGL": ("IA", "deg"), "RUNTIME": ("ET", "s")},
    **{
        "FXW": ("FX", "N"),
        "FX": ("FX", "N"),
        "FYW": ("FY", "N"),
        "FZW": ("FZ", "N"),
        "MXW": ("MX", "N m"),
        "MZW": ("MZ", "N m"),
    },
    **{"TRAJVELW": ("V", "m/s"), "TRAJVELH": ("V", "m/s"), "LONGVEL": ("V", "m/s"), "INFLPRES": ("P", "bar")},
    **{"TYRETEMP": ("TSTC", "degC"), "TREADTMP": ("TSTC", "degC")},
}
_HEIGHT = "DSTGRWHC"  # of the wheel's centre above the road
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
    if any(len(row) != len(channels) for row in rows):
        raise errors.FormatError(
            f"'{path}' names channels below its data; expected **MEASURCHANNELS above **MEASURDATA: repair the file"
        )
    table = np.array(rows)
    found: dict[str, tuple[str, np.ndarray]] = {}
    for k, (key, unit, (factor, before, behind)) in enumerate(channels):
        with np.errstate(over="ignore", invalid="ignore"):
            found.setdefault(key, (unit, (table[:, k] + before) * factor + behind))
    for key, (unit, value) in constants.items():
        found.setdefault(key, (unit, np.full(len(table), value)))
    notes = _to_w_axes(found)
    for key, (unit, values) in found.items():
        known = _CHANNELS.get(key)
        if known and known[0] not in columns:
            columns[known[0]] = values
            units[known[0]] = unit or known[1]
    data = from_channels(columns, units, name=name or Path(path).stem, warm_up=warm_up)
    return replace(data, notes=(*data.notes, *notes)) if notes else data


def _to_w_axes(found: dict[str, tuple[str, np.ndarray]]) -> list[str]:
    """Add FXW to MZW from what is in H or C axes, where the file has no FYW; notes say what was done.

    Moments need the height of the wheel's centre, those in C axes all three, and a load that is positive upwards.
    """
    system = next((s for s in "HC" if f"FY{s}" in found and f"FZ{s}" in found), "")
    if "FYW" in found or not system:
        return []

    def si(key: str, usual: str) -> np.ndarray | None:
        unit, values = found.get(key, ("", None))
        return None if values is None else to_si(values, unit or usual, expected=usual, what=f"the channel {key}")

    def turned(y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (y * cos - z * sin, y * sin + z * cos) if system == "C" else (y, z)

    lean = si("INCLANGL", "deg")
    camber = np.zeros(len(found[f"FY{system}"][1])) if lean is None else lean
    with np.errstate(over="ignore", invalid="ignore"):
        sin, cos = np.sin(camber), np.cos(camber)
        forward = next((x for x in (si(f"FX{s}", "N") for s in ("W", "", system)) if x is not None), None)
        F_y, F_z = turned(*(np.asarray(si(f"F{a}{system}", "N")) for a in "YZ"))
        found |= {"FYW": ("N", F_y), "FZW": ("N", F_z)} | ({} if forward is None else {"FXW": ("N", forward)})
        notes = [f"forces in {system} axes of TYDEX are brought to W axes"]
        notes += ["no inclination in the file: taken as none"] if lean is None and system == "C" else []
        M_x, M_y, M_z = (si(f"M{a}{system}", "N m") for a in "XYZ")
        if "MXW" in found or M_x is None or M_z is None or forward is None:
            return notes
        height = si(_HEIGHT, "m")
        if height is None or (M_y is None and system == "C") or not np.nanmedian(F_z) > 0:
            why = f"expected {_HEIGHT}, all three moments and loads above zero"
            return [*notes, f"moments in {system} axes are left out: {why}"]
        _, up = turned(np.zeros(len(F_y)) if M_y is None else M_y, M_z)
        offset = height * np.tan(camber)  # of the wheel's centre to the right of where it touches
        found |= {"MXW": ("N m", M_x - height * F_y - offset * F_z), "MZW": ("N m", up + offset * forward)}
    return notes


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
