"""What breaks a controller: the map of the cars that it was tried on, shares by each change, the worst cars."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from slipangle.errors import ParameterError
from slipangle.report.style import BLUE, INK, SLATE, VERMILION, compact, template, unit_title
from slipangle.report.tables import Cell, Heading, Row, Table
from slipangle.simulate.trials import ENOUGH, Trials

CHANGES = {  # in words, unit shown, factor from SI
    "stiffness_f": ("front stiffness", "%", 100.0),
    "stiffness_r": ("rear stiffness", "%", 100.0),
    "friction": ("friction", "%", 100.0),
    "mass": ("mass", "%", 100.0),
    "delay": ("steering delay", "ms", 1000.0),
    "lag": ("steering lag", "ms", 1000.0),
    "noise": ("sensor noise", "%", 100.0),
    "crosswind": ("crosswind over mass", "m/s2", 1.0),
}
BINS = 8


def breaking_map(trials: Trials, *, points: int = 6000) -> go.Figure:
    """Every car over the two changes that go with the margin most: inside its lanes blue, outside vermilion.

    At most so many ``points``, the worst among them. Raises ParameterError if there is no car.
    """
    if not len(trials):
        raise ParameterError("there is no car to draw; expected at least one")
    across, up = list(trials.influence)[:2]
    inside = trials.column("inside") > 0
    order = np.argsort(trials.column("margin"), kind="stable")[:points][::-1]
    figure = go.Figure()
    figure.update_layout(template=template(), height=520, hovermode="closest")
    for kept, colour, name, size in ((True, BLUE, "inside its lanes", 5.0), (False, VERMILION, "outside", 7.0)):
        rows = order[inside[order] == kept]
        x, y = (CHANGES[n][2] * trials.column(n)[rows] for n in (across, up))
        figure.add_scatter(
            x=compact(x),
            y=compact(y),
            mode="markers",
            name=name,
            marker={"color": colour.faded(0.55 if kept else 0.8), "size": size, "symbol": "circle" if kept else "x"},
            customdata=np.column_stack([rows, np.round(trials.column("margin")[rows], 2)]).tolist(),
            hovertemplate="car %{customdata[0]}: margin %{customdata[1]} m<extra></extra>",
        )
    titles = (unit_title(CHANGES[n][0], CHANGES[n][1]) for n in (across, up))
    return figure.update_layout(
        xaxis_title=next(titles), yaxis_title=next(titles), showlegend=True, legend={"orientation": "h", "y": 1.06}
    )


def shares_by_change(trials: Trials) -> go.Figure:
    """Share inside the lanes over each change, in eight equal parts of its range, with 95 % bands of the counts."""
    if not len(trials):
        raise ParameterError("there is no car to draw; expected at least one")
    names = list(trials.influence)
    figure = make_subplots(rows=2, cols=4, shared_yaxes=True, horizontal_spacing=0.04, vertical_spacing=0.24)
    inside = trials.column("inside")
    for k, name in enumerate(names):
        x = CHANGES[name][2] * trials.column(name)
        edges = np.linspace(x.min(), x.max(), BINS + 1)
        part = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, BINS - 1)
        count = np.bincount(part, minlength=BINS)
        good = np.bincount(part, weights=inside, minlength=BINS)
        some = count > 0
        low, high = _wilson(good[some], count[some])
        middle = 0.5 * (edges[1:] + edges[:-1])[some]
        place: dict[str, Any] = {"row": k // 4 + 1, "col": k % 4 + 1}
        band = np.concatenate([middle, middle[::-1]]), 100 * np.concatenate([high, low[::-1]])
        figure.add_scatter(
            x=band[0],
            y=band[1],
            mode="lines",
            fill="toself",
            line={"width": 0},
            fillcolor=BLUE.faded(0.18),
            hoverinfo="skip",
            **place,
        )
        figure.add_scatter(
            x=middle,
            y=100 * good[some] / count[some],
            mode="lines+markers",
            line={"color": BLUE.light, "width": 2},
            hovertemplate="%{y:.1f} % inside<extra></extra>",
            **place,
        )
        figure.add_hline(y=100 * ENOUGH, line={"color": SLATE.light, "width": 1, "dash": "dot"}, **place)
        figure.update_xaxes(title={"text": unit_title(*CHANGES[name][:2]), "font": {"color": INK.light}}, **place)
    figure.update_layout(template=template(), height=480, showlegend=False, meta={"columns": 4})
    figure.update_xaxes(nticks=4, tickangle=0)
    figure.update_yaxes(range=[0, 104])
    return figure.update_yaxes(title="inside [%]", col=1)


def _wilson(good: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Interval of a share at 95 %: E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209-212."""
    z, p = 1.959964, good / count
    middle = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = z * np.sqrt(p * (1 - p) / count + z * z / (4 * count**2)) / (1 + z * z / count)
    return middle - half, middle + half


def worst_cars(trials: Trials, *, rows: int = 12, command: str = "") -> Table:
    """The cars with the least margin, and what was changed of them."""
    order = np.lexsort((-trials.column("e_y"), trials.column("margin")))[:rows]
    made = []
    for row in order:
        changes: list[Cell] = [CHANGES[n][2] * float(trials.column(n)[row]) for n in trials.names]
        outside = not trials.column("inside")[row]
        values: list[Cell] = [int(row), float(trials.column("margin")[row]), *changes]
        made.append(Row(tuple(values), tone="poor" if outside else None))
    headings = (Heading(CHANGES[n][0], CHANGES[n][1], digits=3) for n in trials.names)
    return Table(
        title="The worst cars",
        columns=(Heading("car"), Heading("margin to the edge", "m", digits=3), *headings),
        rows=tuple(made),
        caption="Changes from the identified car; a negative margin is outside the lane.",
        command=command,
    )
