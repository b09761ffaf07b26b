"""`Trials`: what came of one controller on many cars that differ from its model."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from slipangle.shown import Shown
from slipangle.simulate.loop import FAR

ENOUGH = 0.97  # share of the cars inside their lanes that makes a controller good
FAIR = 0.8  # below this it is poor
COLUMNS = ("inside", "margin", "e_y", "finished", "fallbacks")


@dataclass(frozen=True, kw_only=True, eq=False)
class Trials(Shown):
    """Cars with their changes and what came of them; one row per car in all arrays.

    Parameters
    ----------
    names : tuple of str
        The changes: columns of `changes`, shape (n, n_names), see `Spread`.
    results : array, shape (n, 5)
        Whether it stayed in its lanes (0 or 1), least distance of its side to an edge, negative beyond [m], largest
        distance from the path [m], whether it reached the end (0 or 1), commands that came from an older plan.
    seconds : array, shape (n_plans,)
        Wall time of plans; empty where it was not kept. [s]
    without : tuple of str
        Inputs of the controller's model that the cars have not, such as steered rear wheels, and measured as zero.
    """

    names: tuple[str, ...]
    changes: np.ndarray
    results: np.ndarray
    seconds: np.ndarray = field(default_factory=lambda: np.empty(0))
    without: tuple[str, ...] = ()

    def _words(self) -> str:
        inside = int(self.column("inside").sum())
        return f"{inside} of {len(self)} cars stay inside; they differ by {', '.join(self.names)}"

    @property
    def lacking(self) -> str:
        """A sentence on what the cars have not, or nothing."""
        return f"They have no {' and no '.join(self.without)}: these stayed zero." if self.without else ""

    def __len__(self) -> int:
        return len(self.results)

    def column(self, name: str) -> np.ndarray:
        """One of the results, or of the changes, shape (n,)."""
        if name in COLUMNS:
            return self.results[:, COLUMNS.index(name)]
        return self.changes[:, self.names.index(name)]

    @property
    def share(self) -> float:
        """Share of the cars that stayed in their lanes."""
        return float(self.column("inside").mean())

    @property
    def good(self) -> bool:
        """Whether that is enough."""
        return self.share >= ENOUGH

    @property
    def word(self) -> Literal["good", "fair", "poor"]:
        """The verdict, in one word."""
        return "good" if self.good else "fair" if self.share >= FAIR else "poor"

    @property
    def worst(self) -> int:
        """Row of the car with the least margin; of those, that farthest from the path."""
        return int(np.lexsort((-self.column("e_y"), self.column("margin")))[0])

    def metrics(self) -> dict[str, Any]:
        """Numbers for machines; the changes of the worst car."""
        row = self.worst
        drawn = dict(zip(self.names, self.changes[row].tolist(), strict=True))
        return {
            "cars": len(self),
            "share_inside": self.share,
            "worst": {"number": row, "changes": drawn} | dict(zip(COLUMNS, self.results[row].tolist(), strict=True)),
            "influence": self.influence,
            "without": list(self.without),
        }

    @property
    def influence(self) -> dict[str, float]:
        """How much of the margin's variance goes with each change, the largest first; of ranks, up and down apart. [-]

        The share that a straight line through the ranks of the change, or of its size, explains, the larger of the two.
        """
        y = _ranks(np.maximum(self.column("margin"), -FAR))
        shares = {}
        for j, name in enumerate(self.names):
            x = self.changes[:, j]
            shares[name] = max(_correlation(_ranks(kind), y) ** 2 for kind in (x, np.abs(x)))
        return dict(sorted(shares.items(), key=lambda item: -item[1]))


def _ranks(x: np.ndarray) -> np.ndarray:
    return np.unique(x, return_inverse=True)[1].astype(float)


def _correlation(x: np.ndarray, y: np.ndarray) -> float:
    x, y = x - x.mean(), y - y.mean()
    size = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / size if size > 0 else 0.0
