"""Tire-rig files of the FSAE Tire Test Consortium (Calspan): ``.mat`` and ``.dat`` to `TireData`.

Channels have the consortium's names: SA slip angle, SL slip ratio on the effective radius (SL = 0 gives FX = 0; SR, on
the loaded radius, only where there is no SL), FX, FY, FZ, MX, MZ, IA inclination, P pressure, V speed. Files are meant
to be in SAE axes (x forward, y right, z down) with FZ negative, degrees, km/h and kPa, or in the same with pounds,
miles per hour and psi; units are taken from the file where it names them. The sign system is read off the data, never
off a name.

References
----------
.. [1] SAE J670, Vehicle Dynamics Terminology, 2008.
.. [2] E. M. Kasprzak, D. Gentz, The Formula SAE Tire Test Consortium: tire testing and data handling, SAE 2006-01-3606.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from slipangle import errors
from slipangle.data.numerals import is_number, to_number
from slipangle.data.readers.mat5 import read_mat5
from slipangle.data.rig_runs import rig_conditions, tread_temperature, unnamed_units
from slipangle.data.tire_data import TireData
from slipangle.units import known as unit_known
from slipangle.units import quantity, to_si

# channel: (unit expected in metric files, unit in files of pounds and inches)
_CHANNELS: dict[str, tuple[str, str]] = {
    **dict.fromkeys(("SA", "IA"), ("deg", "deg")),
    **dict.fromkeys(("SL", "SR"), ("-", "-")),
    **dict.fromkeys(("FX", "FY", "FZ"), ("N", "lbf")),
    **dict.fromkeys(("MX", "MZ"), ("N m", "ft lbf")),
    **{"P": ("kPa", "psi"), "V": ("km/h", "mph"), "ET": ("s", "s"), "RE": ("cm", "in")},
    **dict.fromkeys(("TSTC", "TSTI", "TSTO"), ("degC", "degF")),
}
_NEEDED = ("SA", "FX", "FY", "FZ")
_SPELLINGS = {"lb": "lbf", "lbs": "lbf", "kph": "km/h", "kmh": "km/h", "ft-lb": "ft lbf", "ft-lbs": "ft lbf"}
_SPELLINGS |= {"n-m": "N m", "n*m": "N m", "none": "-", "unitless": "-", "[-]": "-", "lb-ft": "ft lbf"}
_SPELLINGS |= {"psig": "psi", "kpag": "kPa", "barg": "bar", "kpa(g)": "kPa", "psi(g)": "psi"}
_SPELLINGS |= {"sec": "s", "seconds": "s", "deg c": "degC", "deg f": "degF", "c": "degC", "f": "degF", "inch": "in"}
_SAE = "sae"  # in place of the unit of a slip: the sign system's name
_LARGEST = 1e8  # of any signal of a rig, in SI units
_HELD, _HELD_FORCE = math.radians(1.0), 0.1  # slip angle, and side force over load, that tell signs where both are held
_UNLOADED = 0.1  # samples below this share of the median load are not a test


@dataclass(frozen=True)
class SignSystem:
    """Which way the axes of a file point, as its data show.

    ``z_down``: the load is negative, so z points down and y to the right. ``slip_opposes``: a positive slip angle gives
    F_y below zero. ``slip_ratio_turned``: a positive slip ratio brakes. ``moment_turned``: the aligning moment does not
    align in right-handed axes, so M_z points the other way. Where the data do not tell, as at one slip angle of zero,
    ``slip_told`` or ``moment_told`` is False and that of SAE is taken.
    """

    z_down: bool
    slip_opposes: bool
    slip_ratio_turned: bool = False
    moment_turned: bool = False
    slip_told: bool = True
    moment_told: bool = True

    @property
    def name(self) -> str:
        """Name of the axis system.

        >>> SignSystem(True, True).name, SignSystem(False, True).name
        ('SAE', 'ISO-W')
        """
        if self.z_down:
            return "SAE" if self.slip_opposes else "adapted SAE"
        return "ISO-W" if self.slip_opposes else "ISO with the slip angle turned round"


def read_ttc(
    path: str | Path, *, name: str = "", units: Literal["US", "metric"] | None = None, warm_up: bool = True
) -> TireData:
    """Read a run of the Tire Test Consortium, in the signs of docs/nomenclature.md.

    The file is ``.mat`` (one variable per channel, MATLAB 7 or older) or ``.dat`` (a title, channel names, units,
    numbers). Notes say which sign system was found and what was left out.

    Units that the file does not name are those of ``units``, "US" or "metric"; without it the pressure tells them
    apart: no tire is tested at 30 kPa or at 30 psi. Samples are left out whose speed is none that the run was held at,
    as while the belt starts, and those before the tread is warm, of a file with temperatures; ``warm_up=False`` keeps
    the latter.

    Raises MissingFileError, FormatError, MissingColumnError, UnitError, ExcitationError or TooShortError with the file,
    the line or channel, and what to do.
    """
    file = Path(path)
    if not file.is_file():
        raise errors.MissingFileError(f"'{file}' does not exist; expected a .mat or .dat file: check the path")
    suffix = file.suffix.lower()
    if suffix == ".mat":
        columns, named = _read_mat(file)
    elif suffix in (".dat", ".txt"):
        columns, named = _read_dat(file)
    else:
        raise errors.FormatError(f"'{file}' ends in '{suffix}'; expected .mat or .dat: export the run in one of these")
    return from_channels(columns, named, name=name or file.stem, unnamed=units, warm_up=warm_up)


def from_channels(
    columns: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    *,
    name: str = "run",
    unnamed: Literal["US", "metric"] | None = None,
    warm_up: bool = True,
) -> TireData:
    """Rig channels by the consortium's names, shape (n_samples,) each, as `TireData`; arguments as of `read_ttc`."""
    missing = [c for c in _NEEDED if c not in columns]
    if missing:
        raise errors.MissingColumnError(
            f"'{name}' has no channel {missing[0]}; {errors.nearest(missing[0], columns)}: expected SA, FX, FY and FZ"
        )
    lengths = {len(columns[c]) for c in _CHANNELS if c in columns}
    if len(lengths) > 1:
        raise errors.FormatError(f"the channels of '{name}' have {sorted(lengths)} samples; expected as many in each")
    si, said = _to_si(columns, units, name, unnamed)
    finite = np.all([np.isfinite(v) for v in si.values()], axis=0)
    loaded = np.abs(si["FZ"]) > _UNLOADED * np.median(np.abs(si["FZ"][finite])) if finite.any() else finite
    upright = np.sign(si["FZ"]) == np.sign(np.median(si["FZ"][finite])) if finite.any() else finite
    keep = finite & loaded & upright
    cut, cuts = rig_conditions(si, keep, warm_up=warm_up)
    keep &= cut
    if keep.sum() < 20:
        raise errors.TooShortError(f"'{name}' has {int(keep.sum())} loaded samples; expected at least 20: check FZ")
    slip = "SL" if "SL" in si else "SR" if "SR" in si else ""
    picked = {key: value[keep] for key, value in si.items()}
    system = detect_signs(picked, slip_ratio=slip, name=name)
    notes = [f"sign system of the data: {system.name}" + _sentence(picked, system)]
    notes += said
    unloaded = int((~(finite & loaded & upright)).sum())
    if unloaded:
        notes.append(f"{unloaded} of {len(finite)} samples without load or number left out")
    notes += cuts
    if slip == "SR":
        notes.append("slip ratio from SR, on the loaded radius: F_x does not vanish at zero slip")
    if not slip:
        notes.append("no slip ratio in the file: taken as free rolling")
    down, opposes = (-1.0 if system.z_down else 1.0), (-1.0 if system.slip_opposes else 1.0)
    moment = down * (-1.0 if system.moment_turned else 1.0)
    kappa = np.zeros(int(keep.sum())) if not slip else picked[slip] * (-1.0 if system.slip_ratio_turned else 1.0)
    return TireData(
        slip_ratio=np.where(kappa > 0, kappa / (1 + np.maximum(kappa, 0)), kappa),  # counted on the larger speed
        slip_angle=picked["SA"] * (opposes * down),
        load=np.abs(picked["FZ"]),
        F_x=picked["FX"],
        F_y=picked["FY"] * down,
        M_x=picked.get("MX"),
        M_z=None if "MZ" not in picked else picked["MZ"] * moment,
        camber=picked.get("IA"),
        pressure=picked.get("P"),
        speed=picked.get("V"),
        time=picked.get("ET"),
        temperature=tread_temperature(picked),
        radius=None,
        name=name,
        notes=tuple(notes),
    )


def detect_signs(si: Mapping[str, np.ndarray], *, slip_ratio: str, name: str) -> SignSystem:
    """Read the sign system off the data.

    The load's sign tells where z points; the correlation of SA and FY tells the slip angle, or their signs where one is
    held, that of slip ratio and FX the slip ratio, that of MZ and FY at small slip angles the moment, which aligns in
    right-handed axes.

    Raises ExcitationError if no slip moves, or slip angle and side force do not go together.
    """
    angle, ratio = si["SA"], si.get(slip_ratio, np.zeros(len(si["SA"])))
    cornering = np.ptp(np.quantile(angle, (0.01, 0.99))) > math.radians(2.0)
    driving = np.ptp(np.quantile(ratio, (0.01, 0.99))) > 0.03
    if not cornering and not driving:
        raise errors.ExcitationError(
            f"in '{name}' neither slip angle nor slip ratio moves; expected a sweep: choose a cornering or "
            "drive/brake run"
        )
    friction = si["FY"] / np.abs(si["FZ"])
    link, told = 0.0, True
    if np.ptp(angle) > math.radians(0.5):
        link = _correlation(angle, friction, ratio, limit=0.02 if driving else math.inf)
    if abs(link) <= 0.3:
        if cornering:
            raise errors.ExcitationError(
                f"slip angle and side force of '{name}' hardly go together (correlation {link:.2f}); expected at least "
                "0.3 either way: check that SA and FY belong together"
            )
        link = _held(angle, friction, ratio)
        told = link != 0.0
    opposes = link <= 0  # SAE and ISO-W agree on this
    turned = False
    if driving:
        turned = float(np.corrcoef(ratio, si["FX"] / np.abs(si["FZ"]))[0, 1]) < 0
    moment, aligned = False, False
    if "MZ" in si and cornering:
        small = (np.abs(angle) < math.radians(3.0)) & (np.abs(ratio) < 0.02)
        if small.sum() > 20 and np.std(si["MZ"][small]) > 0:
            aligned = True
            moment = float(np.corrcoef(si["MZ"][small], si["FY"][small])[0, 1]) > 0.3
    return SignSystem(bool(np.median(si["FZ"]) < 0), bool(opposes), turned, moment, told, aligned)


def _held(angle: np.ndarray, friction: np.ndarray, ratio: np.ndarray) -> float:
    """Sign of slip angle times side force of a run that holds one angle; 0 where that is too small to tell."""
    near = np.abs(ratio) < 0.02
    near = near if near.sum() >= 20 else np.ones_like(near)
    held, force = float(np.median(angle[near])), float(np.median(friction[near]))
    return float(np.sign(held * force)) if abs(held) > _HELD and abs(force) > _HELD_FORCE else 0.0


def _correlation(angle: np.ndarray, friction: np.ndarray, ratio: np.ndarray, *, limit: float) -> float:
    near = np.abs(ratio) < limit
    if near.sum() < 20 or np.std(angle[near]) == 0 or np.std(friction[near]) == 0:
        return 0.0
    return float(np.corrcoef(angle[near], friction[near])[0, 1])


def _sentence(si: Mapping[str, np.ndarray], system: SignSystem) -> str:
    slip = f"SA > 0 gives FY {'< 0' if system.slip_opposes else '> 0'}"
    parts = [
        f"FZ is {'negative' if system.z_down else 'positive'}",
        slip if system.slip_told else f"that {slip} is taken, at this slip angle the data do not tell",
    ]
    if system.slip_ratio_turned:
        parts.append("a positive slip ratio brakes")
    if "MZ" in si and not system.moment_told:
        parts.append("that MZ aligns in right-handed axes is taken")
    if "MZ" in si and system.moment_turned:
        parts.append("MZ points against right-handed axes")
    return f" ({', '.join(parts)})"


def _to_si(
    columns: Mapping[str, np.ndarray], units: Mapping[str, str], name: str, system: str | None
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Channels in SI units (temperatures in degC), and what has to be said about their units."""
    given = {
        c: _unit(units[c], c, name)
        for c in _CHANNELS
        if c in columns and units.get(c, "").strip() and not (c in ("SL", "SR") and units[c].strip().lower() == _SAE)
    }
    force = {given[c] for c in ("FX", "FY", "FZ") if c in given}
    if len(force) > 1:
        which = ", ".join(f"{c} in {given[c]}" for c in ("FX", "FY", "FZ") if c in given)
        raise errors.UnitError(
            f"'{name}' mixes units of force: {which}; expected one for all: correct the units or the columns"
        )
    said: list[str] = []
    if force:
        pounds = force == {"lbf"}
    else:
        pounds, why = unnamed_units(columns, given, system)
        what = "pounds, miles per hour and psi" if pounds else "newtons, km/h and kPa"
        said.append(f"the file does not name its unit of force: {what} taken, {why}")
    si: dict[str, np.ndarray] = {}
    for channel, (metric, imperial) in _CHANNELS.items():
        if channel not in columns:
            continue
        expected = imperial if pounds else metric
        unit = given.get(channel, expected)
        values = np.asarray(columns[channel], dtype=float).ravel()
        if unit == "degF":
            values, unit = (values - 32.0) / 1.8, "degC"
        expected = metric if metric == "degC" else expected
        if quantity(unit) == "ratio" and quantity(expected) != "ratio":
            unit = expected
        si[channel] = to_si(values, unit, expected=expected, what=f"{channel} of '{name}'")
    _check_magnitudes(si, name)
    return si, said


def _check_magnitudes(si: Mapping[str, np.ndarray], name: str) -> None:
    """Units that contradict the numbers: a file that says degrees and holds radians, or pounds beside newtons."""
    for channel, values in si.items():
        largest = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
        if largest > _LARGEST:
            raise errors.UnitError(
                f"{channel} of '{name}' reaches {largest:.3g} in SI units; expected at most {_LARGEST:.0e}: repair or "
                "delete those samples"
            )
    angle = np.nanmax(np.abs(si["SA"])) if np.isfinite(si["SA"]).any() else 0.0
    if 0 < angle < math.radians(0.5) and "SL" not in si and "SR" not in si:
        raise errors.UnitError(
            f"SA of '{name}' reaches {np.rad2deg(angle):.2g} degrees only; expected a sweep of degrees: it may be in "
            "radians, then convert it or name its unit"
        )
    load = np.nanmedian(np.abs(si["FZ"])) if np.isfinite(si["FZ"]).any() else 0.0
    for channel in ("FX", "FY"):
        typical = np.nanquantile(np.abs(si[channel]), 0.98) if np.isfinite(si[channel]).any() else 0.0
        if load > 0 and typical > 5.0 * load:
            raise errors.UnitError(
                f"{channel} of '{name}' reaches {typical / load:.3g} times the load; expected at most 5: FZ and "
                f"{channel} seem to be in different units, newtons and pounds"
            )


def _unit(text: str, channel: str, name: str) -> str:
    plain = text.strip()
    unit = _SPELLINGS.get(plain.lower(), plain)
    if unit != "degF" and not unit_known(unit):
        raise errors.UnitError(
            f"'{name}' gives {channel} in '{plain}', an unknown unit; expected such as "
            f"'{_CHANNELS[channel][0]}': correct the units of the file"
        )
    return unit


def _read_mat(file: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    raw = read_mat5(file)
    columns = {
        key: np.asarray(value, dtype=float).ravel()
        for key, value in raw.items()
        if key in _CHANNELS and isinstance(value, np.ndarray) and value.dtype.kind == "f"
    }
    units: dict[str, str] = {}
    channel = raw.get("channel")
    if isinstance(channel, dict) and {"name", "units"} <= set(channel):
        names, texts = (_words(channel[key]) for key in ("name", "units"))
        units = dict(zip(names, texts, strict=False))
    if not columns:
        items = list(raw)
        raise errors.MissingColumnError(
            f"'{file}' has none of the channels SA, FX, FY, FZ; it holds {', '.join(items[:8]) or 'nothing'}: expected "
            "one variable per channel"
        )
    return columns, units


def _words(value: Any) -> list[str]:
    """Texts of a struct's field, whether it is one cell of texts or one text per element."""
    words: list[str] = []
    for item in np.atleast_1d(value):
        words += [str(v).strip() for v in item] if isinstance(item, np.ndarray) else [str(item).strip()]
    return words


def _read_dat(file: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    head = next((k for k, line in enumerate(lines[:50]) if {"SA", "FY", "FZ"} <= set(_cells(line))), None)
    if head is None:
        raise errors.FormatError(
            f"'{file}' has no line of channel names in its first 50 lines; expected one with SA, FX, FY and FZ: check "
            "that it is a run of the Tire Test Consortium"
        )
    names = _cells(lines[head])
    first = head + 1
    units: dict[str, str] = {}
    if first < len(lines) and not _is_numbers(lines[first]):
        texts = _cells(lines[first])
        if len(texts) == len(names):
            units = dict(zip(names, texts, strict=True))
        first += 1
    rows = []
    for k in range(first, len(lines)):
        cells = _cells(lines[k])
        if not cells:
            continue
        if len(cells) != len(names):
            raise errors.FormatError(
                f"line {k + 1} of '{file}' has {len(cells)} values; expected {len(names)}, one per channel: repair or "
                "delete that line"
            )
        try:
            rows.append([to_number(c) for c in cells])
        except ValueError:
            bad = next(c for c in cells if not is_number(c))
            raise errors.FormatError(
                f"line {k + 1} of '{file}' holds {errors.shown(bad)}; expected a number: repair or delete that line"
            ) from None
    if not rows:
        raise errors.TooShortError(f"'{file}' has channel names but no line of numbers; expected a run")
    table = np.array(rows)
    return {n: table[:, k] for k, n in enumerate(names)}, units


def _cells(line: str) -> list[str]:
    """Cells of a line: between tabs, else commas or semicolons, else blanks."""
    for separator in ("\t", ";", ","):
        if separator in line:
            return [c.strip() for c in line.strip("\n").split(separator) if c.strip() or separator != "\t"]
    return re.split(r"\s+", line.strip()) if line.strip() else []


def _is_numbers(line: str) -> bool:
    cells = _cells(line)
    return bool(cells) and all(is_number(c) for c in cells)
