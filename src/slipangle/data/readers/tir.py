"""Tire property files (``.tir``): read, look up in SI, change values, write back.

The format is a TeimOrbit text: ``[SECTION]`` headings, ``KEY = value $comment`` lines, whole-line comments
(``!`` and ``$``) and tables of numbers. `TirFile` keeps every line, so an unchanged file is written back
byte for byte, with its comments, unknown keys, order and line ends. What the coefficients mean is the
business of `slipangle.models.tires.magic_formula.tire`.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from slipangle.data.readers.tir_lines import TirLine, insert_line, new_line, parse_line, rewritten
from slipangle.data.readers.tir_units import Units, read_units
from slipangle.errors import FormatError, ModelWarning, ParameterError, nearest, shown
from slipangle.files import read_bytes, write_atomic

# These headings hold words about the file; a key such as MASS there is a unit, not a number.
_DESCRIPTIVE = ("UNITS", "MDI_HEADER")


@dataclass(frozen=True, kw_only=True)
class TirFile:
    r"""A tire property file, line by line, comments and blanks included; ``name`` is for messages, usually the path.

    >>> tir = parse_tir("[UNITS]\nLENGTH = 'mm'\n[DIMENSION]\nUNLOADED_RADIUS = 344.0 $free radius\n")
    >>> tir.number("UNLOADED_RADIUS")
    0.34400000000000003
    >>> tir.with_values({"UNLOADED_RADIUS": 0.35}).text.splitlines()[-1]
    'UNLOADED_RADIUS = 350   $free radius'
    """

    lines: tuple[TirLine, ...]  # of the file, in order
    name: str = "tir"
    newline: str = "\n"  # that ends a line
    encoding: str = "utf-8"  # of the file's bytes
    final_newline: bool = True  # whether the last line ends with one
    units: Units = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        block = [line for line in self.lines if line.section == "UNITS" and line.key and line.value is not None]
        units = read_units([(line.key, str(line.value), line.number) for line in block], self.name)
        object.__setattr__(self, "units", units)
        self._refuse_contradictions()

    # ---- look up -----------------------------------------------------------------------------------------------

    @cached_property
    def entries(self) -> dict[str, TirLine]:
        """Entries by key, headings that describe the file ([UNITS], [MDI_HEADER]) left out; the first one counts."""
        lines: dict[str, TirLine] = {}
        for line in self.lines:
            if line.key and line.section not in _DESCRIPTIVE and (line.key not in lines):
                lines[line.key] = line
        return lines

    @property
    def sections(self) -> tuple[str, ...]:
        """Headings in order, in capitals."""
        return tuple(dict.fromkeys(line.section for line in self.lines if line.section))

    def get(self, key: str) -> float | str | None:
        """Value as written, in the units of the file; ``None`` where the key is absent or blank."""
        line = self.entries.get(key.upper())
        return None if line is None else line.value

    def number(self, key: str) -> float | None:
        """Value in SI units; ``None`` where the key is absent or blank.

        Raises FormatError if the value is a word, with its line number.
        """
        line = self.entries.get(key.upper())
        if line is None or line.value is None:
            return None
        if isinstance(line.value, str):
            raise FormatError(
                f"line {line.number} of '{self.name}' gives {line.key} the value {shown(line.value)}; expected a "
                "number: correct that line"
            )
        return line.value * self.units.factor(line.key)

    def word(self, key: str) -> str:
        """Value as text in capitals; empty where the key is absent or blank."""
        value = self.get(key)
        return "" if value is None else str(value).strip().upper()

    @cached_property
    def numbers(self) -> dict[str, float]:
        """Every number of the file, SI units, by key."""
        values = {key: line.value for key, line in self.entries.items() if isinstance(line.value, float)}
        return {key: value * self.units.factor(key) for key, value in values.items()}

    @cached_property
    def tables(self) -> dict[str, np.ndarray]:
        """Tables by heading, shape (n_rows, n_columns), in the units of the file.

        Raises FormatError if a row has another number of columns than the first of its table.
        """
        rows: dict[str, list[tuple[float, ...]]] = {}
        for line in self.lines:
            if line.row:
                table = rows.setdefault(line.section, [])
                table.append(line.row)
                if len(line.row) != len(table[0]):
                    raise FormatError(
                        f"line {line.number} of '{self.name}' has {len(line.row)} numbers; expected {len(table[0])} as "
                        f"in the rows of [{line.section}] above it: complete or delete that line"
                    )
        return {section: np.array(r) for section, r in rows.items()}

    @property
    def fit_type(self) -> int | None:
        """FITTYP, the version number of the Magic Formula; ``None`` where the file does not say."""
        value = self.number("FITTYP")
        return None if value is None else round(value)

    # ---- change and write --------------------------------------------------------------------------------------

    def with_values(
        self,
        values: Mapping[str, float | str | None],
        *,
        comments: Mapping[str, str] | None = None,
        section: Mapping[str, str] | None = None,
    ) -> TirFile:
        """A copy with some values replaced or added; everything else stays as it is.

        Raises ParameterError if a key is new and no heading is given for it.

        Parameters
        ----------
        values : mapping
            New values by key; numbers in SI units, written in the units of the file with all their digits; None
            leaves the key blank.
        comments : mapping, optional
            New comments by key.
        section : mapping, optional
            Heading for keys that the file does not have yet.
        """
        comments, section = comments or {}, section or {}
        pending = {key.upper(): value for key, value in values.items()}
        lines: list[TirLine] = []
        for line in self.lines:
            known = self.entries.get(line.key) if line.key else None
            if known is line and (line.key in pending or line.key in comments):
                value = pending.pop(line.key) if line.key in pending else line.value
                stored = self._stored(line.key, value) if value is not line.value else value
                lines.append(rewritten(line, stored, comments.get(line.key, line.comment)))
            else:
                lines.append(line)
        for key, value in pending.items():
            heading = section.get(key, "").upper()
            if not heading:
                raise ParameterError(
                    f"'{self.name}' has no {key}; {nearest(key, self.entries)}: use one of these, or name the section "
                    "to add it to"
                )
            insert_line(lines, heading, new_line(heading, key, self._stored(key, value), comments.get(key, "")))
        return replace(self, lines=tuple(lines))

    def _stored(self, key: str, value: float | str | None) -> float | str | None:
        if value is None or isinstance(value, str):
            return value
        factor = self.units.factor(key)
        return float(value) if factor == 1.0 else float(f"{float(value) / factor:.15g}")

    @property
    def text(self) -> str:
        """The file as text."""
        return self.newline.join(line.text for line in self.lines) + (self.newline if self.final_newline else "")

    def write(self, path: str | Path) -> Path:
        """Write the file, whole or not at all.

        Raises WriteError if the place cannot be written.
        """
        return write_atomic(path, self.text.encode(self.encoding))

    # ---- checks ------------------------------------------------------------------------------------------------

    def _refuse_contradictions(self) -> None:
        first: dict[str, TirLine] = {}
        for line in self.lines:
            if not line.key or line.section in _DESCRIPTIVE or not isinstance(line.value, float):
                continue
            other = first.setdefault(line.key, line)
            if other.value != line.value:
                raise FormatError(
                    f"'{self.name}' gives {line.key} twice, {other.value:g} in line {other.number} and {line.value:g} "
                    f"in line {line.number}; expected one value: delete one of the lines"
                )
        self.units.check_plausible(self.numbers, self.name)


def read_tir(path: str | Path) -> TirFile:
    """Read a tire property file.

    Raises MissingFileError if the file does not exist or cannot be read, FormatError if a line cannot be read, with its
    number, and UnitError if [UNITS] names an unknown unit or mixes systems, or the numbers do not fit the units.
    """
    raw = read_bytes(path, "the tire file", "a .tir file: check the path")
    if b"\0" in raw:
        raise FormatError(f"'{path}' is a binary file; expected the text of a .tir file: choose another file")
    encoding = "utf-8-sig" if raw.startswith(b"\xef\xbb\xbf") else "utf-8"
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError:
        encoding = "latin-1"
        text = raw.decode(encoding)
    return parse_tir(text, name=str(path), encoding=encoding)


def parse_tir(text: str, *, name: str = "tir", encoding: str = "utf-8") -> TirFile:
    """Read the text of a tire property file; errors as in `read_tir`."""
    newline = "\r\n" if "\r\n" in text else "\n"
    raw = text.split(newline)
    final = raw[-1] == ""
    if final:
        raw.pop()
    lines: list[TirLine] = []
    section = ""
    for number, line in enumerate(raw, start=1):
        parsed = parse_line(line, number, section, name, above=lines[-1].comment if lines else "")
        section = parsed.section
        lines.append(parsed)
    _tell_wrapped(lines, name)
    if not any(line.key for line in lines):
        raise FormatError(
            f"'{name}' holds no 'KEY = value' line; expected a tire property file with sections such as [MODEL] and "
            "[VERTICAL]: choose another file"
        )
    return TirFile(lines=tuple(lines), name=name, newline=newline, encoding=encoding, final_newline=final)


def _tell_wrapped(lines: Sequence[TirLine], name: str) -> None:
    wrapped = [line for line in lines if line.wrapped]
    if wrapped:
        more = f" and {len(wrapped) - 1} more" if len(wrapped) > 1 else ""
        warnings.warn(
            f"line {wrapped[0].number} of '{name}'{more} is read as the rest of the comment above it: "
            f"{shown(wrapped[0].text.strip())}",
            ModelWarning,
            stacklevel=4,
        )
