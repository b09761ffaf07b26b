"""Everything that a job may say, made from the records that read it: `tables`, and the same as text and Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

from slipangle.errors import ConfigError, nearest
from slipangle.report.meanings import meaning, summary
from slipangle.workflow.drive import (
    CONTROLLERS,
    ESTIMATORS,
    PLANTS,
    ControllerSettings,
    EstimatorSettings,
    PlantSettings,
)
from slipangle.workflow.entries import Entry, Made, entries_of
from slipangle.workflow.hints import bound, called, is_record, parts, words
from slipangle.workflow.kinds import FITS, KINDS, FitSettings, PhysicsEntries, as_physics
from slipangle.workflow.lap_settings import LapSettings
from slipangle.workflow.race_settings import RaceSettings
from slipangle.workflow.settings import ColumnSettings, DataSettings, ModelSettings, PublishedSettings, Settings


@dataclass(frozen=True, kw_only=True)
class Key:
    """One entry of a table, with its meaning in a line and the unit that its range is in."""

    entry: Entry
    meaning: str

    @property
    def name(self) -> str:
        """As it stands in a job."""
        return self.entry.name

    @property
    def takes(self) -> str:
        """What it may be, in words."""
        return words(self.entry.hint)

    @property
    def default(self) -> str:
        """As a job would say it; empty where it says nothing."""
        return "" if self.entry.needed else toml(self.entry.default)


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of a job: its place, such as ``[data]``, what it is, and its keys.

    ``kind`` is the value of the entry of that name that makes the keys valid, where they depend on it.
    """

    name: str
    place: str
    about: str
    keys: tuple[Key, ...]
    kind: str = ""


def tables() -> dict[str, Table]:
    """All tables of a job by name: "data", "model", "model.arx" and so on, those of installed packages too."""
    found = [_table(called(record), place, record) for record, place in _PLACES.items()]
    found += [table for kind, thing in KINDS.items() for table in _of_model(kind, thing)]
    for name, registry, skip in _KINDS:
        place = _PLACE.get(name, f"[{name}]")
        found += [_table(f"{name}.{k}", f'{place} with kind = "{k}"', t, skip, k) for k, t in registry.items()]
    named = {table.name: table for table in found}
    for table in found:
        for inner in (r for key in table.keys for r in records_in(key.entry.hint)):
            if inner not in KINDS.values():
                named.setdefault(called(inner), _table(called(inner), f"where it says {called(inner)}", inner))
    return named


def find(name: str) -> list[Table]:
    """The table of that name, with those inside it; of a kind by its own name too.

    Raises ConfigError if there is none; all near names are given.
    """
    known = tables()
    found = [t for n, t in known.items() if n == name or n.startswith(f"{name}.")]
    found = found or [t for n, t in known.items() if name in n.split(".")[1:]]
    if not found:
        raise ConfigError(f"a job has no table {name!r}; {nearest(name, known, every=True)}: use one of these names")
    return found


def records_in(hint: Any) -> Iterator[type]:
    """Records that a hint speaks of."""
    if is_record(hint):
        yield hint
    for inner in parts(hint)[1]:
        yield from records_in(bound(inner))


def _table(name: str, place: str, thing: Callable[..., Any], skip: int = 0, kind: str = "") -> Table:
    said = thing.of if isinstance(thing, Made) else thing
    keys = tuple(Key(entry=e, meaning=meaning(said, n)) for n, e in entries_of(thing, skip).items())
    return Table(name=name, place=place, about=summary(said), keys=keys, kind=kind)


def _of_model(kind: str, thing: Any) -> Iterator[Table]:
    """Keys of a kind of model, and parameters of one of physics."""
    name, place = f"model.{kind}", f'[[model]] with kind = "{kind}"'
    physics = as_physics(thing)
    if physics is None:
        yield _table(name, place, thing, kind=kind)
        return
    table = _table(name, place, PhysicsEntries, kind=kind)
    usual = {"free": physics.free}
    keys = (replace(k, entry=replace(k.entry, default=usual.get(k.name, k.entry.default))) for k in table.keys)
    yield replace(table, about=summary(physics.model), keys=tuple(keys))
    entries = entries_of(physics.parameters)
    inner = tuple(
        Key(entry=entries[n], meaning=f"{si.doc[0].upper()}{si.doc[1:]}. [{si.unit}]")
        for n, si in physics.parameters.metadata().items()
    )
    yield Table(name=f"{name}.car", place=f'car = {{ ... }} of kind = "{kind}"', about="Parameters.", keys=inner)


# ---- as text -------------------------------------------------------------------------------------------------------


def toml(value: Any) -> str:
    """A default as a job would say it; empty for none, or nothing in it."""
    if isinstance(value, str | tuple | Mapping) and not value:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(toml, value))}]"
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{k} = {toml(v)}' for k, v in value.items())} }}"
    if is_record(type(value)):
        own = {n: (getattr(value, n), e.default) for n, e in entries_of(type(value)).items()}
        kind = {"kind": called(type(value))} if type(value) in KINDS.values() else {}
        return toml(kind | {n: v for n, (v, usual) in own.items() if v != usual and v is not None})
    if isinstance(value, float):
        return f"{value:g}" if isfinite(value) else "unlimited"
    return "" if value is None else str(value)


def text(shown: list[Table]) -> str:
    """Tables for a terminal: a line for each key."""
    lines = []
    for table in shown:
        lines += [f"{table.name}: {table.place}", f"  {table.about}"]
        for key in table.keys:
            lines.append(f"  {key.name:18} {key.takes}{_otherwise(key)}")
            lines.append(f"  {'':18} {key.meaning}")
        lines.append("")
    return "\n".join(lines)


def _otherwise(key: Key) -> str:
    return "; required" if key.entry.needed else f"; default {key.default}" if key.default else "; optional"


def markdown(shown: list[Table]) -> str:
    """Tables as a page of the documentation."""
    lines = [_HEAD]
    for table in shown:
        lines += [f"## {table.name}", "", f"{_plain(table.place)} – {table.about}", ""]
        if table.keys:
            lines += ["| key | takes | default | meaning |", "|---|---|---|---|"]
        for key in table.keys:
            cells = (f"`{key.name}`", key.takes, "required" if key.entry.needed else key.default, key.meaning)
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def _plain(place: str) -> str:
    return f"`{place}`" if place.startswith("[") and "," not in place and " with" not in place else place


_KINDS = (("controller", CONTROLLERS, 2), ("estimator", ESTIMATORS, 1), ("plant", PLANTS, 0), ("fit", FITS, 0))
_PLACE = {"fit": "fit = { ... }"}
_PLACES = {
    Settings: "the file itself",
    DataSettings: "[data]",
    ColumnSettings: "[data.columns], an entry for each channel",
    ModelSettings: "[[model]], whatever its kind",
    PublishedSettings: "[model.published]",
    ControllerSettings: "[controller], whatever its kind",
    EstimatorSettings: "[estimator], whatever its kind",
    PlantSettings: "[plant], whatever its kind",
    LapSettings: "[lap]",
    RaceSettings: "[race]",
    FitSettings: "fit = { ... } of a physical model, whatever its kind",
}
_HEAD = """\
# Job reference

What `slipangle help job` prints, made from the records that read a job (`slipangle help job --markdown`).
`slipangle help job TABLE` prints one table; what an installed package adds is there too.

A job may begin with `#:schema slipangle-job.json`, a file that `slipangle help job --schema > slipangle-job.json`
writes: editors with TOML support (Taplo, Even Better TOML) then complete and check keys while you type.

A list of one entry may stand without brackets. Where a table has a default, entries that are not given keep theirs.
"""
