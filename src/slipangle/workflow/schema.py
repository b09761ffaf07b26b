"""A JSON schema (draft 7) of job files, for editors that check and complete TOML; from the records that read them."""

from __future__ import annotations

import typing
from collections.abc import Mapping
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal

from slipangle.fields import Within
from slipangle.optimal.terms import Limits
from slipangle.units import SI
from slipangle.workflow.hints import bound, called, expressible, is_log, is_model, is_named, is_record, parts
from slipangle.workflow.kinds import AROUND
from slipangle.workflow.reference import Key, Table, tables

_SIMPLE = {float: "number", int: "integer", str: "string", bool: "boolean"}
_SETTINGS = ("job", "data", "column", "published", "plant")  # tables without a kind
_KINDS = ("model", "controller", "estimator", "plant", "fit")  # tables whose kind says which keys they have


def job_schema() -> dict[str, Any]:
    """The schema, as `json.dumps` takes it."""
    known = tables()
    parted = {name: _of_kinds(name, known) for name in _KINDS}
    alone = {n: _object(t) for n, t in known.items() if "." not in n}
    inner = {t.kind: _object(t) for t in known.values() if t.name == f"model.{t.kind}"}
    definitions = inner | alone | parted
    job = definitions.pop("job")
    head = {"$schema": "http://json-schema.org/draft-07/schema#", "title": "slipangle job"}
    return head | job | {"definitions": definitions}


def _of_kinds(name: str, known: Mapping[str, Table]) -> dict[str, Any]:
    """A table whose keys depend on its kind: one of several."""
    common = known[name]
    options = []
    for table in known.values():
        if not (table.kind and table.name == f"{name}.{table.kind}"):
            continue
        cars = known.get(f"{table.name}.car")
        own = _object(table, common.keys)
        own["properties"]["kind"] = {"const": table.kind, "description": table.about}
        if cars is not None:
            own["properties"]["car"] = _object(cars) | {"required": []}
            del own["properties"]["car"]["properties"]["kind"]
            own["properties"]["car"]["properties"] |= {n: {"type": "number"} for n in AROUND}
        usual = next(k for k in common.keys if k.name == "kind").entry.default
        if usual != table.kind:
            own["required"] = [*dict.fromkeys((*own["required"], "kind"))]
        options.append(own)
    if name == "plant":
        plain = _object(common)
        del plain["properties"]["kind"]
        options.append(plain)
    return {"oneOf": options}


def _object(table: Table, more: tuple[Key, ...] = ()) -> dict[str, Any]:
    """A table: no other keys, each with its meaning and range."""
    keys = (*more, *table.keys)
    kind = {} if table.name in _SETTINGS else {"kind": {"const": table.name.rpartition(".")[2]}}
    return {
        "type": "object",
        "description": table.about,
        "properties": kind | {k.name: _of(k.entry.hint) | {"description": _said(k)} for k in keys},
        "required": [k.name for k in keys if k.entry.needed],
        "additionalProperties": False,
    }


def _said(key: Key) -> str:
    default = f" Default: {key.default}." if key.default else ""
    return f"{key.meaning} Takes {key.takes}.{default}"


def _of(hint: Any) -> dict[str, Any]:
    """What one entry may be."""
    hint = bound(hint)
    kind, inside = parts(hint)
    if hint in _SIMPLE:
        return {"type": _SIMPLE[hint]}
    if kind is Annotated:
        spans = [s for s in inside[1:] if isinstance(s, Within | SI)]
        return _of(inside[0]) | (_range(spans[0]) if spans and inside[0] in (int, float) else {})
    if kind is Literal:
        return {"enum": list(inside)}
    if kind is typing.Union:
        return {"anyOf": [_of(o) for o in inside if expressible(o)]}
    if kind is tuple:
        return {"anyOf": [_of(inside[0]), {"type": "array", "items": _of(inside[0]), "maxItems": 64}]}
    if kind is dict:
        return {"type": "object", "additionalProperties": _of(inside[1])}
    if is_named(hint):
        pair = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
        either = {"anyOf": [{"type": "number"}, pair]} if issubclass(hint, Limits) else {"type": "number"}
        return {"type": "object", "additionalProperties": either}
    if is_model(hint) or hint is Path:
        return {"type": "string"}
    if is_log(hint):
        return _of(tuple[str, ...])
    if is_record(hint):
        table = {"$ref": f"#/definitions/{called(hint)}"}
        return {"anyOf": [{"type": "string"}, table]} if hasattr(hint, "from_text") else table
    return {}


def _range(span: Within | SI) -> dict[str, float]:
    if isinstance(span, SI):
        span = Within(span.lower, span.upper)
    low = "exclusiveMinimum" if span.open in ("low", "both") else "minimum"
    high = "exclusiveMaximum" if span.open in ("high", "both") else "maximum"
    return ({low: span.low} if span.low > -inf else {}) | ({high: span.high} if span.high < inf else {})
