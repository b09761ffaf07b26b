"""Reproduced numbers beside the published ones, and the table of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from slipangle.report.tables import Heading, Row, Table, published


@dataclass(frozen=True, kw_only=True)
class Record:
    """One reproduced number beside the thesis' own, and whether it is as good as asked.

    Parameters
    ----------
    row : str
        Table and row of the thesis, such as ``"table 8.2, M1"``.
    quantity : str
        What was measured, with its unit.
    thesis : float or str or None
        The published value; None where there is none.
    here : float or str
        The value found here.
    bound : str
        What must hold, in words, such as ``">= 79"``.
    holds : bool or None
        Whether it does; None where nothing is asked.
    note : str
        What differs from the thesis' conditions.
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
        cls, *, here: float, at_most: float | None = None, at_least: float | None = None, digits: int = 6, **rest: Any
    ) -> Record:
        """The record of a number that must not exceed a bound, or must reach one; without either nothing is asked.

        ``digits`` are those of the bound as it is shown; the rest is that of the record.
        """
        if at_most is not None:
            rest |= {"bound": f"<= {at_most:.{digits}g}", "holds": bool(here <= at_most)}
        elif at_least is not None:
            rest |= {"bound": f">= {at_least:.{digits}g}", "holds": bool(here >= at_least)}
        return cls(here=float(here), **rest)

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
            Heading("row", words=True),
            Heading("quantity", words=True),
            Heading("thesis"),
            Heading("here"),
            Heading("bound"),
            Heading("holds"),
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
