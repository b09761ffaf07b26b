"""What a search found: parallel coordinates of its trials, the table of results."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go

from slipangle.errors import ParameterError
from slipangle.identify.search import SearchResult, columns
from slipangle.report.style import BLUE, INK, MIDDLE, SLATE, colourscale, new_figure
from slipangle.report.tables import Cell, Column, Row, Table

__all__ = ["parallel_coordinates", "search_table"]

_MARGIN = 1.5  # decades or more between best and worst: the score's axis is logarithmic
_COLOURS = ((0.0, BLUE), (0.5, MIDDLE), (1.0, SLATE))


def parallel_coordinates(result: SearchResult, *, score: str = "score") -> go.Figure:
    """One line per trial through its settings to its score; the best ones blue.

    Drag along an axis to keep only the trials inside. Trials without a score are left out. Scores beyond three times
    the median are drawn at that value, so that a few bad trials do not hide how the good ones differ.

    Parameters
    ----------
    result : SearchResult
        At least one trial with a score.
    score : str
        What the score is, for its axis.

    Raises
    ------
    ParameterError
        If no trial has a score.
    """
    good = [trial for trial in result.trials if not trial.failure]
    if not good:
        raise ParameterError(f"none of {len(result.trials)} trials has a score; expected at least one to draw")
    scores = np.array([trial.score for trial in good])
    most = 3.0 * float(np.median(scores))
    shown = np.minimum(scores, most) if most > 0 else scores
    dimensions = [_axis(name, [trial.settings[name] for trial in good]) for name in good[0].settings]
    cut = f", at most {most:.3g}" if (scores > most).any() and most > 0 else ""
    dimensions.append({"label": f"{score}{cut}", "values": shown, "tickformat": ".3~g"})
    figure = new_figure(420, margin={"l": 70, "r": 60, "t": 60, "b": 30})
    order = np.argsort(-shown)  # the best are drawn last, on top
    for dimension in dimensions:
        dimension["values"] = np.asarray(dimension["values"], dtype=float)[order].round(12).tolist()
    figure.add_parcoords(
        dimensions=dimensions,
        line={"color": shown[order].tolist(), "colorscale": colourscale(_COLOURS), "showscale": False},
        labelfont={"color": INK.light, "size": 14},
        tickfont={"color": INK.light, "size": 12},
        rangefont={"color": SLATE.light, "size": 11},
        unselected={"line": {"color": SLATE.light, "opacity": 0.08}},
    )
    return figure


def _axis(name: str, values: list[Any]) -> dict[str, Any]:
    """An axis: words as ticks, whole numbers as such, wide ranges on a logarithmic scale."""
    if any(isinstance(v, str) for v in values):
        words = sorted(set(map(str, values)))
        places = list(range(len(words)))
        return {"label": name, "values": [words.index(str(v)) for v in values], "tickvals": places, "ticktext": words}
    numbers = np.array(values, dtype=float)
    if all(isinstance(v, int) for v in values):
        return {"label": name, "values": numbers, "tickformat": "d"}
    if numbers.min() > 0 and np.log10(numbers.max() / numbers.min()) >= _MARGIN:
        decades = np.log10(numbers)
        ticks = np.linspace(decades.min(), decades.max(), 5)
        text = [f"{10**t:.2g}" for t in ticks]
        return {"label": name, "values": decades, "tickvals": ticks.tolist(), "ticktext": text}
    return {"label": name, "values": numbers, "tickformat": ".3~g"}


def search_table(result: SearchResult, *, rows: int | None = None, command: str = "") -> Table:
    """Every trial, the best first; trials that failed or were given up last, with their reason.

    Parameters
    ----------
    result : SearchResult
        At least one trial.
    rows : int, optional
        At most this many rows.
    command : str
        What reproduces it.
    """
    names, cells = columns(result)
    shown = cells if rows is None else cells[:rows]
    trials = {trial.number: trial for trial in result.trials}
    made = []
    for k, (number, *settings, score, seconds, failure) in enumerate(shown):
        trial = trials[int(number)]
        tone: Any = "good" if k == 0 and not failure else "poor" if failure and not trial.pruned else None
        values: list[Cell] = [int(number), *settings, None if failure else score, seconds]
        made.append(Row(tuple(values), tone=tone, note=str(failure)))
    left = len(cells) - len(shown)
    counts = f"{len(result.trials)} trials, {len(result.pruned)} given up on the way, {len(result.failed)} failed."
    return Table(
        title="Trials, the best first",
        columns=(
            Column("trial"),
            *(Column(name, digits=3, words=_is_text(cells, k + 1)) for k, name in enumerate(names[1:-3])),
            Column("score"),
            Column("time", "s", digits=3),
        ),
        rows=tuple(made),
        caption=counts + (f" {left} more are in the journal." if left else ""),
        command=command,
    )


def _is_text(cells: Any, column: int) -> bool:
    return any(isinstance(row[column], str) for row in cells)
