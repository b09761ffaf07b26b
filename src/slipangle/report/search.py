"""What a search found: parallel coordinates of its trials, the table of results."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go

from slipangle.errors import ParameterError
from slipangle.identify.search.search import SearchResult, columns
from slipangle.report.page import Number, Verdict
from slipangle.report.style import BLUE, INK, MIDDLE, SLATE, compact, escape, new_figure, nice_step
from slipangle.report.tables import Cell, Heading, Row, Table, Tone

CLEARLY = 0.05  # share of its error by which a network should be better than a linear model
_WIDE = 1.5  # decades between lowest and highest, above which an axis is logarithmic


def parallel_coordinates(result: SearchResult, *, score: str = "score") -> go.Figure:
    """One line per trial through its settings to its score; the best ones blue.

    Trials without a score are left out. Scores beyond three times the median are drawn at that value, so that a few bad
    trials do not hide how the good ones differ.

    ``score`` says what the score is, for its axis. One trial at least must have one (ParameterError).
    """
    good = sorted((t for t in result.trials if not t.failure), key=lambda t: (-t.score, -t.number))
    if not good:
        raise ParameterError(f"none of {len(result.trials)} trials has a score; expected at least one to draw")
    scores = np.array([trial.score for trial in good])
    shown = np.minimum(scores, 3.0 * float(np.median(scores)))
    axes = [_axis(name, [trial.settings[name] for trial in good]) for name in good[0].settings]
    axes.append(_axis(score, shown.tolist()))
    figure = new_figure(460, showlegend=False, hovermode="closest", margin={"l": 40, "r": 40, "t": 96, "b": 16})
    for k, trial in enumerate(good):  # the best last, on top
        rank = (len(good) - 1 - k) / max(len(good) - 1, 1)
        colour = BLUE if rank <= 0.1 else MIDDLE if rank <= 0.5 else SLATE
        settings = ", ".join(f"{n} {v:.3g}" if isinstance(v, float) else f"{n} {v}" for n, v in trial.settings.items())
        figure.add_scatter(
            x=list(range(len(axes))),
            y=compact(np.array([axis.places[k] for axis in axes])),
            mode="lines",
            line={"color": colour.faded(0.9 if rank <= 0.1 else 0.5), "width": 2.4 if rank <= 0.1 else 1.2},
            hovertemplate=f"trial {trial.number}: {score} {trial.score:.4g}<br>{escape(settings)}<extra></extra>",
            name=f"trial {trial.number}",
        )
    for i, axis in enumerate(axes):
        figure.add_shape(type="line", x0=i, x1=i, y0=0, y1=1, line={"color": INK.light, "width": 1})
        title = (
            escape(axis.name).replace("_", " ").replace(" ", "<br>", 1)
        )  # in turns at two heights: a phone is narrow
        figure.add_annotation(text=f"<b>{title}</b>", x=i, y=1.0, yshift=28 + 34 * (i % 2), showarrow=False)
        for place, text in axis.ticks:
            figure.add_annotation(text=escape(text), x=i, y=place, xshift=-4, xanchor="right", showarrow=False)
    hidden = {"visible": False, "fixedrange": True}
    across = {**hidden, "range": [-0.35, len(axes) - 0.75]}
    return figure.update_layout(xaxis=across, yaxis={**hidden, "range": [-0.04, 1.06]})


@dataclass(frozen=True)
class _Axis:
    """Where each trial crosses, 0 to 1, and what is written where."""

    name: str
    places: list[float]
    ticks: list[tuple[float, str]]


def _axis(name: str, values: list[Any]) -> _Axis:
    """Words as ticks, whole numbers as such, wide ranges on a logarithmic scale."""
    if any(isinstance(v, str) for v in values):
        words = sorted(set(map(str, values)))
        step = 1 / max(len(words) - 1, 1)
        ticks = [(k * step, word) for k, word in enumerate(words)]
        return _Axis(name, [words.index(str(v)) * step for v in values], ticks)
    numbers = np.array(values, dtype=float)
    low, high = float(numbers.min()), float(numbers.max())
    if high == low:
        return _Axis(name, [0.5] * len(values), [(0.5, f"{low:.4g}")])
    if low > 0 and np.log10(high / low) >= _WIDE:
        share = np.log(numbers / low) / np.log(high / low)
        ticks = [(t, f"{low * (high / low) ** t:.2g}") for t in (0.0, 0.25, 0.5, 0.75, 1.0)]
        return _Axis(name, share.tolist(), ticks)
    if all(isinstance(v, int) for v in values):
        step = max(1, int(nice_step(high - low, 6)))
        marks: list[float] = [float(m) for m in range(int(low), int(high) + 1, step)]
    else:
        step = nice_step(high - low, 5)
        marks = [m * step for m in range(int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9)) + 1)]
    return _Axis(
        name, ((numbers - low) / (high - low)).tolist(), [((m - low) / (high - low), f"{m:.4g}") for m in marks]
    )


def search_verdict(result: SearchResult, linear: float | None = None) -> Verdict:
    """The best trial in a sentence, beside the score of a linear model on the same stretches where that is known."""
    best = result.best
    others = sorted(t.score for t in result.trials if not t.failure and t.number != best.number)
    settings = ", ".join(f"{n} {v:.3g}" if isinstance(v, float) else f"{n} {v}" for n, v in best.settings.items())
    said = f"Trial {best.number} errs least in free runs over what follows its training: {best.score:.3g} of what the "
    said += f"outputs vary by, a fit of {100 * (1 - best.score):.1f} % ({settings})."
    tone: Tone = "fair"  # beside nothing it is not known how good it is
    numbers = [Number(label="free-run error of the best", value=best.score, unit="-", digits=3)]
    if linear is not None:
        ahead = 1 - best.score / linear
        tone = "good" if ahead > CLEARLY else "fair" if ahead > 0 else "poor"
        said += {
            "good": f" That is {100 * ahead:.0f} % less than a linear model, ARX with orders of its own choice.",
            "fair": f" A linear model, ARX with orders of its own choice, has only {100 * ahead:.1f} % more.",
            "poor": " A linear model, ARX with orders of its own choice, errs less: take that, or search longer.",
        }[tone]
        numbers.append(Number(label="of a linear model", value=linear, unit="-", digits=3))
    said += f" The next best trial has {others[0]:.3g}." if others else ""
    return Verdict(title="The best", sentence=said, tone=tone, numbers=tuple(numbers))


def search_table(result: SearchResult, *, rows: int | None = None, command: str = "") -> Table:
    """Every trial, the best first; trials that failed or were given up last, with their reason.

    At most so many ``rows``; ``command`` is what reproduces it.
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
            Heading("trial"),
            *(Heading(name, digits=3, words=_is_text(cells, k + 1)) for k, name in enumerate(names[1:-3])),
            Heading("score", "-"),
            Heading("time", "s", digits=3),
        ),
        rows=tuple(made),
        caption=counts + (f" {left} more are in the journal." if left else ""),
        command=command,
    )


def _is_text(cells: Any, column: int) -> bool:
    return any(isinstance(row[column], str) for row in cells)
