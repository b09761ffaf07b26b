"""Channels that follow from others, and rows that a condition keeps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from slipangle import units
from slipangle.data.channels import STANDARD
from slipangle.data.expression import Expression
from slipangle.data.readers.column import Column
from slipangle.data.readers.tables import DATE, ChannelTable, find_column
from slipangle.errors import FormatError, MissingColumnError, ParameterError, UnitError, nearest, shown

Picked = dict[str, tuple[np.ndarray, str]]  # SI values, shape (n,), and their unit, by channel


def derive(table: ChannelTable, chosen: Mapping[str, Column], picked: Picked, t: np.ndarray | None) -> Picked:
    """All channels in the order of ``chosen``: those read, and those that an expression of others gives.

    Raises MissingColumnError, FormatError or UnitError if an expression names no channel, needs itself, or takes a
    column of a unit that is not known.
    """
    waiting = {name: Expression(str(c.derive)) for name, c in chosen.items() if c.derive}
    while waiting:
        ready = [n for n, e in waiting.items() if not any(m in waiting for m in e.names if m != n or m not in picked)]
        ready = [n for n in ready if n not in waiting[n].names or n not in chosen]
        if not ready:
            raise FormatError(
                f"the derived channels {', '.join(waiting)} need each other or themselves; expected each to follow "
                "from what is read: name a column of the file in quotes where it is meant"
            )
        for name in ready:
            values, column = _evaluated(table, waiting.pop(name), picked, t, f"channel '{name}'"), chosen[name]
            standard = STANDARD.get(name)
            unit = column.unit or (standard.unit if standard else "-")
            what = f"channel '{name}' of {table.name}"
            si = column.converted(values, unit, standard.unit if standard else None, what)
            picked[name] = (si, units.si_unit(unit))
    return {name: picked[name] for name in chosen}


def keep(table: ChannelTable, condition: str, picked: Picked, t: np.ndarray | None) -> tuple[np.ndarray, str]:
    """Rows for which a condition holds (bool), and a note.

    Raises ParameterError if it holds for none or is no condition, UnitError if a column's unit is not known.
    """
    expression = Expression(condition)
    rows = _evaluated(table, expression, picked, t, "the filter")
    if rows.dtype != bool:
        raise ParameterError(
            f"the filter {shown(condition)} is no condition; expected one such as 'v_x > 5 and t < 60'"
        )
    if not rows.any():
        sizes = {n: picked[n][0] for n in expression.names if n in picked}
        ranges = [
            f"{n} from {np.nanmin(x):.4g} to {np.nanmax(x):.4g}" for n, x in sizes.items() if np.isfinite(x).any()
        ]
        said = f" ({', '.join(ranges)}, SI units)" if ranges else ""
        raise ParameterError(
            f"the filter {shown(condition)} keeps no row of {table.name}{said}; expected some: change it"
        )
    return rows, f"the filter {shown(condition)} keeps {int(rows.sum())} of {len(rows)} rows"


def _evaluated(
    table: ChannelTable, expression: Expression, picked: Picked, t: np.ndarray | None, what: str
) -> np.ndarray:
    rows = len(next(iter(picked.values()))[0]) if picked else len(table.numbers(0))
    values: dict[str, np.ndarray] = {}
    for name in expression.names:
        if name in picked:
            values[name] = picked[name][0]
        elif name == "t" and t is not None:
            values[name] = t
        else:
            values[name] = _column_si(table, name, picked, what, expression.text)
    return np.broadcast_to(expression(values), (rows,)).copy()


def _column_si(table: ChannelTable, name: str, picked: Picked, what: str, text: str) -> np.ndarray:
    """A column of the file in SI units where its heading says one, else as it is."""
    try:
        i = find_column(table, name, what)
    except MissingColumnError:
        known = [*picked, *(h.name for h in table.headers)]
        raise MissingColumnError(
            f"{what} follows from {shown(text)}, but {table.name} has no channel or column {shown(name)}; "
            f"{nearest(name, known)}: correct the name"
        ) from None
    header = table.headers[i]
    if not header.unit or header.unit == DATE:
        return table.numbers(i)
    if not units.known(header.unit):
        raise UnitError(
            f"{what} follows from {shown(text)}, where column '{header.name}' of {table.name} is in {header.unit!r}, "
            f"which is no unit that is known; {nearest(header.unit, units.names())}: convert it as a channel of its "
            f"own, such as Column('{header.name}', '-', scale=0.001), and derive from that"
        )
    return units.to_si(table.numbers(i), header.unit)
