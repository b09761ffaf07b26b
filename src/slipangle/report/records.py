"""Reproduced numbers beside the published ones, and the table of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from slipangle.report.tables import Heading, Row, Table, published


@dataclass(frozen=True)
class Record:
    """One reproduced number beside the thesis' own, and whether it is as good as asked.

    ``row`` is table and row of the thesis, ``quantity`` has its unit, ``thesis`` is the published value (None where
    there is none); ``bound`` says in words what must hold, ``holds`` is None where nothing is asked, and ``note`` says
    what differs from the thesis' conditions.
    """

    row: str
    quantity: str
    thesis: float | str | None
    here: float | str
    bound: str = ""
    holds: bool | None = None
    note: str = ""

    @classmethod
    def judged(
        cls,
        row: str,
        quantity: str,
        thesis: float | str | None,
        here: float,
        *,
        at_most: float | None = None,
        at_least: float | None = None,
        digits: int = 6,
        note: str = "",
    ) -> Record:
        """The record of a number that must not exceed a bound, or must reach one; without either nothing is asked.

        ``digits`` are those of the bound as it is shown.
        """
        bound, holds = "", None
        if at_most is not None:
            bound, holds = f"<= {at_most:.{digits}g}", bool(here <= at_most)
        elif at_least is not None:
            bound, holds = f">= {at_least:.{digits}g}", bool(here >= at_least)
        return cls(row, quantity, thesis, float(here), bound, holds, note)

    def to_dict(self) -> dict[str, Any]:
        """The record in types that JSON knows; NaN and infinity become None."""
        return {f.name: _plain(getattr(self, f.name)) for f in fields(self)}


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def record_table(records: Sequence[Record], *, title: str = "Reproduced results", command: str = "") -> Table:
    """Records as a table; a row whose bound does not hold is marked poor."""
    return Table(
        title=title,
        columns=(
            *(Heading(name, words=True) for name in ("row", "quantity")),
            *map(Heading, ("thesis", "here", "bound", "holds")),
        ),
        rows=tuple(
            Row(
                (r.row, r.quantity, published(r.thesis), r.here, r.bound, r.holds),
                tone=None if r.holds is None else "good" if r.holds else "poor",
                note=r.note,
            )
            for r in records
        ),
        command=command,
    )
