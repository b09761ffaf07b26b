"""From a ``.tir`` file to Magic Formula coefficients and back."""

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from typing import Any, Literal, NamedTuple

import numpy as np

from slipangle.data.readers.tir import TirFile, parse_tir
from slipangle.errors import FormatError, ModelWarning, ParameterError, nearest
from slipangle.models.tires.magic_formula.coefficients import MagicCoefficients, MF52Coefficients, MF61Coefficients
from slipangle.models.tires.magic_formula.terms import Conventions
from slipangle.models.tires.magic_formula.validity import ValidRange
from slipangle.ops import is_symbolic
from slipangle.units import SI

_VERSIONS: dict[int, type[MagicCoefficients]] = {
    **dict.fromkeys((5, 6, 21, 52), MF52Coefficients),
    **dict.fromkeys((60, 61, 62), MF61Coefficients),
}
_ONLY_61 = ("PKY4", "PKY6", "PKY7", "PEY5", "PPY5", "QDZ10", "RBX3", "RBY4", "LKYC")
# Spellings of the same coefficient: name here -> names in the field.
_SPELLINGS: dict[str, tuple[str, ...]] = {
    **{"LFZO": ("LFZ0",), "INFLPRES": ("IP",), "NOMPRES": ("IP_NOM",), "LKYG": ("LKG", "LGYG")},
    **{"PPZ1": ("QPZ1",), "PPZ2": ("QPZ2",), "PPMX1": ("QPX1",), "Q_V1": ("QV1",), "PFZ1": ("QPFZ1",)},
}
# Coefficients of what is not a steady-state slip force: gyroscopic couple, damping at low speed, vertical and belt
# dynamics. They are kept in the file.
_ELSEWHERE = ("QTZ1", "MBELT", "PTX4", "PTY3", "LGYR", "LIP", "LCZ", "LSGKP", "LSGAL", "LGAX", "LGAY", "LGAZ", "LKG")
_FIRM = ("FNOMIN", "UNLOADED_RADIUS", "LONGVL", "LFZO")  # what the others count by: no range of theirs is waived
_NOT_ZERO = ("Q_RE0",)  # zero stands for "not given"
_STEMS = {"load": "FZ", "slip_ratio": "KPU", "slip_angle": "ALP", "camber": "CAM", "pressure": "PRES"}
_LIMITS = {name: (f"{stem}MIN", f"{stem}MAX") for name, stem in _STEMS.items()}
_SECTIONS = {  # of a new key, by what its name begins with; the first that fits
    "VERTICAL_FORCE_RANGE": "FZM",
    "LONG_SLIP_RANGE": "KPUM",
    "SLIP_ANGLE_RANGE": "ALPM",
    "INCLINATION_ANGLE_RANGE": "CAMM",
    "INFLATION_PRESSURE_RANGE": "PRESM",
    "OPERATING_CONDITIONS": "INFLPRES NOMPRES",
    "MODEL": "LONGVL VXLOW",
    "DIMENSION": "UNLOADED_RADIUS WIDTH RIM_RADIUS",
    "STRUCTURAL": "LONGITUDINAL_STIFFNESS LATERAL_STIFFNESS PCF",
    "VERTICAL": "FNOMIN VERTICAL_STIFFNESS BREFF DREFF FREFF Q_ PFZ",
    "TURNSLIP_COEFFICIENTS": "PDXP PKYP PDYP PHYP PECP QDTP QCRP QBRP QDRP",
    "OVERTURNING_COEFFICIENTS": "PPMX QSX",
    "ROLLING_COEFFICIENTS": "QSY",
    "ALIGNING_COEFFICIENTS": "QBZ QCZ QDZ QEZ QHZ PPZ SSZ",
    "LONGITUDINAL_COEFFICIENTS": "PCX PDX PEX PKX PHX PVX PPX PTX RBX RCX REX RHX",
    "LATERAL_COEFFICIENTS": "PCY PDY PEY PKY PHY PVY PPY PTY RBY RCY REY RHY RVY",
    "SCALING_COEFFICIENTS": "L",
}


def version_of(tir: TirFile) -> type[MagicCoefficients]:
    """Coefficient record of the file's version: by FITTYP; where that is absent by its format or its coefficients.

    Raises FormatError if FITTYP is not one of the Magic Formula.
    """
    fit_type = tir.fit_type
    if fit_type is None:
        if tir.word("PROPERTY_FILE_FORMAT") in ("PAC2002", "MF_05"):
            return MF52Coefficients
        return MF61Coefficients if any(tir.get(name) is not None for name in _ONLY_61) else MF52Coefficients
    if fit_type not in _VERSIONS:
        raise FormatError(
            f"'{tir.name}' has FITTYP {fit_type}; expected one of {', '.join(map(str, sorted(_VERSIONS)))}: "
            "other versions are not supported, fit one of these or correct FITTYP"
        )
    return _VERSIONS[fit_type]


def coefficients_from(tir: TirFile, o: Conventions, *, force: bool = False) -> MF61Coefficients | MF52Coefficients:
    """Coefficients of a file.

    Blank and absent coefficients take the defaults of the record; nonzero ones that no equation here knows are named in
    a `ModelWarning`, as are those outside their range with ``force``. Raises FormatError if a coefficient without
    default is missing, a value is a word, or, without ``force``, outside its range.
    """
    kind = version_of(tir)
    values: dict[str, float] = {}
    for name in kind.metadata():
        for spelling in (name, *_SPELLINGS.get(name, ())):
            value = tir.number(spelling)
            if value is not None and not (value == 0 and name in _NOT_ZERO):
                values[name] = value
                break
    missing = [f.name for f in fields(kind) if f.default is MISSING and f.name not in values]
    if missing:
        which = ", ".join(missing)
        raise FormatError(
            f"'{tir.name}' lacks {which}, which the Magic Formula cannot do without; expected "
            f"{'a value' if len(missing) == 1 else 'values'}: add {'it' if len(missing) == 1 else 'them'} to the file"
        )
    if "QSY7" not in values and o.rolling_resistance == "paper":
        values["QSY7"] = 1.0  # that form carries the load in this power alone
    _warn_unknown(tir, kind)
    ranges = {name: kind.si(name) for name in values}
    waived = tuple(n for n, meta in ranges.items() if not meta.lower <= values[n] <= meta.upper)
    said = [_beyond(name, values[name], ranges[name]) for name in waived]
    if said and (not force or set(waived) & set(_FIRM)):
        raise FormatError(
            f"'{tir.name}' has {said[0]}: correct the file"
            + ("" if set(waived) & set(_FIRM) else ", or read it all the same with force=True (--force)")
        )
    if said:
        text = f"'{tir.name}' has {'; '.join(said)}: used as it stands, because force was given"
        warnings.warn(text, ModelWarning, stacklevel=3)
    c: Any = kind(**values, waived=waived)
    return c


def _beyond(name: str, value: float, meta: SI) -> str:
    unit = "" if meta.unit == "-" else f" {meta.unit}"
    return f"{name} = {value:g}{unit} ({meta.doc}); expected {meta.lower:g} to {meta.upper:g}{unit}"


def warn_signs(c: MF61Coefficients | MF52Coefficients, stiffness: Callable[..., Any], name: str) -> None:
    """Say where a slip ratio is turned round, and where no axis system makes a tire of the coefficients.

    ``stiffness`` is the cornering stiffness of the coefficients' version over load, pressure and camber.
    """
    if c.PKX1 < 0:
        warnings.warn(
            f"'{name}' has a slip stiffness below zero (PKX1 = {c.PKX1:g}): a positive slip ratio of its coefficients "
            "brakes and is turned round, so that a positive one drives here",
            ModelWarning,
            stacklevel=3,
        )
    load = c.FNOMIN * np.array([0.25, 0.5, 1.0, 1.5, 2.0])
    K = np.asarray(stiffness(c, load, 0.0, 0.0), dtype=float)
    if K.min() < 0 < K.max():
        turned = load[np.sign(K) != np.sign(K[2])]
        warnings.warn(
            f"the cornering stiffness of '{name}' changes its sign with load, at {turned[0]:.4g} N against "
            f"{load[2]:.4g} N; expected one sign up to twice the nominal load: check PKY1, PKY2 and PKY4",
            ModelWarning,
            stacklevel=3,
        )


class Switches(NamedTuple):
    """What a file says beside its coefficients."""

    combined: Literal["weighting", "ellipse", "none"]
    axes: Literal["ISO-W", "SAE", "adapted SAE"]
    side: Literal["LEFT", "RIGHT", ""]
    mirrored: bool


def switches_from(tir: TirFile) -> Switches:
    """Combined slip, axes, side and mirroring of a file.

    ``FE_METHOD = 'YES'`` asks for the friction ellipse, a USE_MODE that ends in 3 for no combined slip; without
    coefficients of combined slip the ellipse stands in. A negative USE_MODE mirrors. ``AXIS_SYSTEM``, a key of ours,
    names the axes of the coefficients; without it they are ISO-W, or adapted SAE where the cornering stiffness at
    nominal load is positive. Raises FormatError if AXIS_SYSTEM is unknown.
    """
    mode = int(tir.number("USE_MODE") or 0)
    weights = any(tir.number(name) for name in ("RBX1", "RBY1", "RCX1", "RCY1"))
    combined: Literal["weighting", "ellipse", "none"] = "weighting" if weights else "ellipse"
    if tir.word("FE_METHOD") == "YES":
        combined = "ellipse"
    elif abs(mode) % 10 == 3:
        combined = "none"
    known: dict[str, Literal["ISO-W", "SAE", "adapted SAE"]] = {
        "ISO-W": "ISO-W",
        "SAE": "SAE",
        "ADAPTED SAE": "adapted SAE",
        "": "adapted SAE" if _cornering_sign(tir) > 0 else "ISO-W",
    }
    word = tir.word("AXIS_SYSTEM")
    if word not in known:
        raise FormatError(f"'{tir.name}' has AXIS_SYSTEM {word!r}; {nearest(word, known)}: use one of these")
    side = tir.word("TYRESIDE")
    return Switches(combined, known[word], "LEFT" if side == "LEFT" else "RIGHT" if side == "RIGHT" else "", mode < 0)


def _cornering_sign(tir: TirFile) -> float:
    """Sign of K_yalpha at nominal load, 4.E25; PKY1 alone does not have it where PKY2 or PKY4 is negative."""
    size, top, shape = (tir.number(f"PKY{i}") or 0.0 for i in (1, 2, 4))
    if version_of(tir) is MF52Coefficients or tir.number("PKY4") is None:
        shape = 2.0
    return math.copysign(1.0, math.sin(shape * math.atan(1.0 / top))) * size if top else size


def _with_switches(tir: TirFile, wanted: Switches) -> TirFile:
    """The file, changed where it says something else."""
    values: dict[str, float | str] = {}
    now = switches_from(tir)
    if now.side != wanted.side:
        values["TYRESIDE"] = wanted.side or "UNKNOWN"
    if now.axes != wanted.axes:
        values["AXIS_SYSTEM"] = wanted.axes
    if now[0] != wanted.combined or now.mirrored != wanted.mirrored:
        mode = abs(int(tir.number("USE_MODE") or 4))
        mode += (3 if wanted.combined == "none" else 4) - mode % 10 if now.combined != wanted.combined else 0
        values["USE_MODE"] = float(-mode if wanted.mirrored else mode)
    if now.combined != wanted.combined and (wanted.combined == "ellipse" or tir.word("FE_METHOD") == "YES"):
        values["FE_METHOD"] = "YES" if wanted.combined == "ellipse" else "NO"
    changed = tir.with_values(values, section=dict.fromkeys(values, "MODEL")) if values else tir
    if switches_from(changed) != wanted:
        raise ParameterError(
            f"a .tir file cannot say combined={wanted.combined!r} without coefficients of combined slip (RBX1 to "
            "RHY2); expected combined='ellipse' or 'none': choose one of these"
        )
    return changed


def _warn_unknown(tir: TirFile, kind: type[MagicCoefficients]) -> None:
    known = {*kind.metadata(), *_ELSEWHERE, *(s for many in _SPELLINGS.values() for s in many)}
    unknown = [
        key
        for key, line in tir.entries.items()
        if line.section.endswith("_COEFFICIENTS") and isinstance(line.value, float) and line.value != 0.0
        if key not in known and not (key.startswith("L") and line.value == 1.0)  # a scaling that scales nothing
    ]
    if unknown:
        warnings.warn(
            f"'{tir.name}' has {', '.join(unknown)}, which version {kind.version} of the "
            "Magic Formula does not use: they are kept in the file and have no effect",
            ModelWarning,
            stacklevel=4,
        )


def limits_from(tir: TirFile, *, force: bool = False) -> ValidRange:
    """Valid ranges of a file; open where it says nothing, and with ``force`` where they are empty.

    Raises FormatError if a range is empty.
    """
    ranges: dict[str, tuple[float, float]] = {}
    for name, (low, high) in _LIMITS.items():
        a, b = tir.number(low), tir.number(high)
        if a is None and b is None:
            continue
        lowest = 0.0 if name == "load" else -math.inf
        lower, upper = (lowest if a is None else a), (math.inf if b is None else b)
        if not lower < upper and force:
            text = f"'{tir.name}' has {low} = {lower:g} and {high} = {upper:g}: no limit, because force was given"
            warnings.warn(text, ModelWarning, stacklevel=3)
            continue
        if not lower < upper:
            raise FormatError(
                f"'{tir.name}' has {low} = {lower:g} and {high} = {upper:g}; expected {low} below {high}: correct "
                "them, or leave them open with force=True (--force)"
            )
        ranges[name] = (lower, upper)
    return ValidRange(**ranges)


def file_from(
    c: MF61Coefficients | MF52Coefficients,
    *,
    source: TirFile | None,
    limits: ValidRange,
    switches: Switches,
    comments: Mapping[str, str],
) -> TirFile:
    """A file with the given coefficients: the source with what changed, or a new one with every coefficient.

    Raises ParameterError if a coefficient is a symbol.
    """
    symbols = [name for name in c.metadata() if is_symbolic(getattr(c, name))]
    if symbols:
        raise ParameterError(f"{symbols[0]} is a symbol; expected a number: give it a value before writing the file")
    if source is None:
        return _with_switches(_new_file(c, limits, comments), switches)
    defaults = {f.name: f.default for f in fields(c)}
    changed: dict[str, float] = {}
    notes: dict[str, str] = {}
    for name in c.metadata():
        value = getattr(c, name)
        written = next((s for s in (name, *_SPELLINGS.get(name, ())) if source.number(s) is not None), None)
        if written is None:
            if value != defaults[name] and not (name == "QSY7" and value == 1.0):
                changed[name] = value
        elif source.number(written) != value and not (source.number(written) == 0 and name in _NOT_ZERO):
            changed[written] = value
        if name in comments:
            notes[written or name] = comments[name]
            changed.setdefault(written or name, value)
    for key, value in _finite(limits).items():
        if source.number(key) != value and not (key == "FZMIN" and value == 0.0):
            changed[key] = value
    new = source.with_values(changed, comments=notes, section={name: _section(name) for name in changed})
    return _with_switches(new, switches)


def _finite(limits: ValidRange) -> dict[str, float]:
    """Limits by key of a file, where there are some."""
    ends = [pair for name, keys in _LIMITS.items() for pair in zip(keys, getattr(limits, name), strict=True)]
    return {key: value for key, value in ends if math.isfinite(value)}


def _section(name: str) -> str:
    return next((section for section, starts in _SECTIONS.items() if name.startswith(tuple(starts.split()))), "MODEL")


_HEADER = """\
[MDI_HEADER]
FILE_TYPE                = 'tir'
FILE_VERSION             = 3.0
FILE_FORMAT              = 'ASCII'
[UNITS]
LENGTH                   = 'meter'
FORCE                    = 'newton'
ANGLE                    = 'radians'
MASS                     = 'kg'
TIME                     = 'second'
[MODEL]
FITTYP                   = {}
TYRESIDE                 = 'UNKNOWN'
"""


def _new_file(c: MF61Coefficients | MF52Coefficients, limits: ValidRange, comments: Mapping[str, str]) -> TirFile:
    meta = c.metadata()
    values = {name: getattr(c, name) for name in meta} | _finite(limits)
    section = {key: _section(key) for key in values}
    first = list(dict.fromkeys(section.values()))  # keys of a section stand together
    ordered = {key: values[key] for key in sorted(values, key=lambda key: first.index(section[key]))}
    notes = {key: comments.get(key) or (meta[key].doc if key in meta else "") for key in ordered}
    return parse_tir(_HEADER.format(c.fit_type), name="new tire").with_values(ordered, comments=notes, section=section)
