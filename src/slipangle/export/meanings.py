"""What a name means to who has no more than a header or a description: its unit, what it is, and its sign."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from slipangle.data.channels import INNER, STANDARD, Quantity
from slipangle.export.names import comment
from slipangle.models.model import Model
from slipangle.models.ode import Parametrised

_PLACES = ((r"\d+: ", "member"), ("base ", "base"), ("discrepancy ", "discrepancy"))
_PAST = re.compile(r"(?P<name>.+?)(?:\[k(?:-(?P<lag>\d+))?\]|\(k-(?P<late>\d+)\))$")
_BEHIND = re.compile(r"(?P<name>.+)_lagged$")
_PUSHED = re.compile(r"d_(?P<name>.+)$")
_RATES = {"m/s": "m/s2", "rad/s": "rad/s2", "m": "m/s", "rad": "rad/s"}


def known(name: str, own: Mapping[str, Quantity]) -> Quantity | None:
    """Unit and meaning of a channel or a state; None where nothing is known.

    Parameters
    ----------
    name : str
        As the model has it: ``r``, ``delta_w``, ``r[k-1]``, ``delta(k-2)``, ``0: base v_y``.
    own : mapping of str to Quantity
        What the model's own names mean, `Model.quantities`.
    """
    for start, place in _PLACES:
        found = re.match(start, name)
        if found and (inner := known(name[found.end() :], own)):
            of = f"of member {found[0][:-2]}" if place == "member" else f"of the {place}"
            return replace(inner, doc=f"{inner.doc}, {of}")
    said = own.get(name) or STANDARD.get(name) or INNER.get(name)
    return said or _derived(name, own)


def _derived(name: str, own: Mapping[str, Quantity]) -> Quantity | None:
    """Of a past value, of what is behind a lag, of a lag, and of a rate that pushes a state."""
    if (past := _PAST.match(name)) and (now := known(past["name"], own)):
        samples = int(past["lag"] or past["late"] or 0)
        when = f", {samples} sample{'s' * (samples > 1)} before" if samples else ""
        return replace(now, doc=f"{now.doc}{when}")
    if (behind := _BEHIND.match(name)) and (before := known(behind["name"], own)):
        return replace(before, doc=f"{before.doc}, behind a lag")
    if name.startswith("lag_") and known(name.removeprefix("lag_"), own):
        return Quantity("s", f"time constant of the lag of {name.removeprefix('lag_')}")
    if (pushed := _PUSHED.match(name)) and (of := known(pushed["name"], own)) and of.unit in _RATES:
        return Quantity(_RATES[of.unit], f"rate by which {pushed['name']} changes more than the model says")
    return None


def parameters(model: Model) -> dict[str, Quantity]:
    """What the parameters of a model mean, by name."""
    inner = model.off_ground
    if not isinstance(inner, Parametrised):
        return {}
    return {n: Quantity(said.unit, said.doc) for n in inner.parameter_names for said in [inner.si(n)]}


def meaning(name: str, own: Mapping[str, Quantity]) -> str:
    """What `known` says, for a comment of C."""
    said = known(name, own)
    return f"{comment(name)}: {comment(said.doc)} [{said.unit}]" if said else comment(name)
