"""`matplotlib_figure`: a figure of the toolbox as one of matplotlib, for papers and for what is added by hand."""

from __future__ import annotations

import itertools
import textwrap
from typing import Any, Literal

import numpy as np
import plotly.graph_objects as go

from slipangle.errors import ParameterError
from slipangle.extras import extra
from slipangle.report.paper_traces import colour, draw_annotation, draw_shape, draw_trace, plain, require_drawable
from slipangle.report.style import GRID, INK, SLATE

WIDTHS = {1: 88.0, 2: 181.0}  # mm, of one and of two columns of a journal's page
_INCH = 25.4  # mm
_PANEL = 30.0  # mm, of the height of each of several panels
_ROOM = 0.4  # heights of a letter that stay free around everything


def size_of(figure: go.Figure, columns: int, height: float | None, font: float) -> tuple[float, float]:
    """Width and height of a figure in a publication, by default high enough for all of its panels. [mm]

    Raises ParameterError if columns, height [mm] or font [pt] are none that a page has.
    """
    if columns not in WIDTHS:
        raise ParameterError(f"columns is {columns}; expected 1 or 2")
    wide = WIDTHS[columns]
    panels = len({getattr(t, "yaxis", None) for t in figure.data})
    usual = max(wide * (2 / 3 if columns == 1 else 1 / 2), _PANEL * panels)
    tall = usual if height is None else float(height)
    if height is None and tall > 1000:
        raise ParameterError(
            f"the figure has {panels} panels, {tall:g} mm in all at {_PANEL:g} mm each; expected at most 1000 mm: plot "
            "fewer channels, by their names, or give a height"
        )
    if not 10 <= tall <= 1000 or not 3 <= font <= 40:
        raise ParameterError(
            f"height is {tall:g} mm and font {font:g} pt; expected 10 to 1000 mm and 3 to 40 pt: check the units"
        )
    return wide, tall


def matplotlib_figure(
    figure: go.Figure, *, columns: Literal[1, 2] = 1, height: float | None = None, font: float = 8.0
) -> Any:
    """The same figure, drawn by matplotlib in a publication's size: a ``matplotlib.figure.Figure``.

    Its ``axes`` are there to be changed and drawn into; ``.savefig`` writes what matplotlib can. What only moves or
    answers the mouse is left out.

    Raises MissingExtraError without the extra ``plot``, ParameterError if the size is no page's or a figure that was
    made elsewhere has traces other than lines, markers, bars, boxes and heat maps.

    Parameters
    ----------
    figure : plotly figure
        Such as what ``.plot()`` of a result gives; it is not changed.
    columns : 1 or 2
        Width of 88 or 181 mm.
    height : float, optional
        By default two thirds of the width in one column, one half in two, more for three panels and up. [mm]
    font : float
        Size of the text. [pt]

    For example ``sa.matplotlib_figure(linear.bode("r", "delta").plot()).axes[0].axvline(2.0)``.
    """
    wide, tall = size_of(figure, columns, height, font)
    require_drawable(figure)
    module = extra("matplotlib.figure", "plot", "a figure by matplotlib")
    drawn = module.Figure(figsize=(wide / _INCH, tall / _INCH), dpi=200)
    extra("matplotlib.backends.backend_agg", "plot", "a figure by matplotlib").FigureCanvasAgg(drawn)
    layout = figure.layout
    places = _places(figure)
    axes = {pair: _new_axes(drawn, layout, pair, font) for pair in places}
    cycle = itertools.cycle(layout.template.layout.colorway or layout.colorway or [INK.light])
    handles: dict[str, tuple[Any, str]] = {}
    for trace in figure.data:
        pair = trace.xaxis or "x", trace.yaxis or "y"
        spare = INK.light if _own_colour(trace) else next(cycle)
        made = draw_trace(axes[pair], trace, figure, spare, drawn)
        named = trace.showlegend is not False and trace.name and made is not None
        if named and (trace.showlegend or layout.showlegend or len(tuple(figure.data)) > 1):
            handles.setdefault(trace.legendgroup or f"{trace.name} {trace.type}", (made, plain(trace.name)))
    for (x, y), own in axes.items():
        _dress(own, _axis(layout, x), _axis(layout, y), font)
    _label_lowest(axes, places)
    for shape in layout.shapes:
        draw_shape(axes, shape)
    for note in layout.annotations:
        draw_annotation(axes, note, font)
    if handles and layout.showlegend is not False:
        _legend(drawn, handles, font)
    _fit(drawn, axes, places, font)
    return drawn


def _own_colour(trace: Any) -> bool:
    """Whether a trace says its colour."""
    line, marker = getattr(trace, "line", None), getattr(trace, "marker", None)
    return trace.type == "heatmap" or any(part is not None and part.color is not None for part in (line, marker))


def _axis(layout: Any, name: str) -> Any:
    """Settings of an axis, such as ``x2``."""
    return layout[f"{name[0]}axis{name[1:]}"]


def _places(figure: go.Figure) -> dict[tuple[str, str], tuple[float, float, float, float]]:
    """Pairs of axes with something on them: left, bottom, width and height as shares of the figure's inside."""
    pairs = dict.fromkeys((t.xaxis or "x", t.yaxis or "y") for t in figure.data) or {("x", "y"): None}
    found = {}
    for x, y in pairs:
        across, up = (_axis(figure.layout, name).domain or (0.0, 1.0) for name in (x, y))
        found[x, y] = across[0], up[0], across[1] - across[0], up[1] - up[0]
    return found


def _new_axes(drawn: Any, layout: Any, pair: tuple[str, str], font: float) -> Any:
    """Empty axes in the look of the toolbox, with their scales."""
    own = drawn.add_axes((0.1, 0.1, 0.8, 0.8), label=" ".join(pair))
    for side in ("top", "right"):
        own.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        own.spines[side].set(color=SLATE.light, linewidth=0.6)
    own.grid(True, color=GRID.light, linewidth=0.5)
    own.set_axisbelow(True)
    own.tick_params(labelsize=font, color=SLATE.light, length=2.5, width=0.6, labelcolor=INK.light)
    for name, scale in zip(pair, (own.set_xscale, own.set_yscale), strict=True):
        if _axis(layout, name).type == "log":
            scale("log")
    return own


def _dress(own: Any, across: Any, up: Any, font: float) -> None:
    """Titles, ranges, ticks and proportions of axes that are drawn on."""
    for axis, edge, limits, label in (
        (across, own.xaxis, own.set_xlim, own.set_xlabel),
        (up, own.yaxis, own.set_ylim, own.set_ylabel),
    ):
        if axis.title.text:
            label(plain(axis.title.text), fontsize=font, color=INK.light, labelpad=3)
        if axis.range is not None:
            ends = [float(v) for v in axis.range]
            limits(*(10**v for v in ends) if axis.type == "log" else ends)
        elif axis.autorange == "reversed":
            edge.set_inverted(True)
        _ticks(axis, edge, font)
        if axis.visible is False:
            edge.set_visible(False)
            own.spines["bottom" if edge is own.xaxis else "left"].set_visible(False)
        elif axis.showticklabels is False:
            edge.set_tick_params(labelleft=False, labelbottom=False)
        if axis.showgrid is False:
            edge.grid(False)
        if axis.zeroline:
            (own.axvline if edge is own.xaxis else own.axhline)(0.0, color=colour(axis.zerolinecolor)[0], linewidth=0.6)
    if up.scaleanchor or across.scaleanchor:
        own.set_aspect("equal", adjustable="box" if "domain" in (across.constrain, up.constrain) else "datalim")


def _label_lowest(axes: dict[tuple[str, str], Any], places: Any) -> None:
    """Of panels above each other that share an axis only the lowest has its numbers and its title."""
    for (x, y), own in axes.items():
        if any(other == x and places[other, up][1] < places[x, y][1] for other, up in axes):
            own.xaxis.set_tick_params(which="both", labelbottom=False)
            own.set_xlabel("")


def _ticks(axis: Any, edge: Any, font: float) -> None:
    """Where numbers stand on an axis, and how they are written."""
    ticker = extra("matplotlib.ticker", "plot", "a figure by matplotlib")
    if axis.tickvals is not None:
        values = [float(v) for v in axis.tickvals]
        edge.set_major_locator(ticker.FixedLocator(values))
        if axis.ticktext is not None:
            edge.set_major_formatter(ticker.FixedFormatter([plain(t) for t in axis.ticktext]))
            edge.set_minor_formatter(ticker.NullFormatter())
    elif isinstance(axis.dtick, int | float) and axis.type != "log":
        edge.set_major_locator(ticker.MultipleLocator(float(axis.dtick), offset=float(axis.tick0 or 0.0)))
    elif axis.type == "log":
        low, high = sorted(edge.get_view_interval())
        edge.set_major_formatter(ticker.FormatStrFormatter("%g"))
        edge.set_minor_locator(ticker.LogLocator(subs=(2.0, 5.0) if high < 30 * low else "auto"))
        edge.set_minor_formatter(ticker.FormatStrFormatter("%g") if high < 30 * low else ticker.NullFormatter())
        edge.set_tick_params(which="minor", labelsize=font, length=1.5, width=0.6, color=SLATE.light)
    elif edge.get_major_locator().__class__.__name__ == "AutoLocator":
        edge.set_major_locator(ticker.MaxNLocator(nbins=axis.nticks or 5, steps=[1, 2, 2.5, 5, 10]))


def _legend(drawn: Any, handles: dict[str, tuple[Any, str]], font: float) -> None:
    """One line, or as many as are needed, above all axes."""
    marks, texts = zip(*handles.values(), strict=True)
    style = {"frameon": False, "fontsize": font, "handlelength": 1.6, "columnspacing": 1.2, "borderaxespad": 0.0}
    for count in range(len(texts), 0, -1):
        made = drawn.legend(marks, texts, loc="upper left", ncols=count, **style)
        if made.get_window_extent().width <= drawn.bbox.width or count == 1:
            return
        made.remove()


def _fit(drawn: Any, axes: Any, places: Any, font: float) -> None:
    """Place the axes so that all that is written around them is inside the figure and as little as possible is left."""
    size = np.array([drawn.get_figwidth(), drawn.get_figheight()]) * 72  # pt
    room = _ROOM * font / size
    top = 0.0
    if drawn.legends:
        top = drawn.legends[0].get_window_extent().height / drawn.bbox.height
    low, high = np.array([0.12, 0.15]), np.array([0.97, 0.97 - top])
    for turn in range(5):
        for pair, own in axes.items():
            left, bottom, width, height = places[pair]
            inside = high - low
            own.set_position((*(low + inside * [left, bottom]), *(inside * [width, height])))
        if turn == 1:
            for own in axes.values():
                _wrap(own)
        boxes = [own.get_tightbbox() for own in drawn.axes]
        boxes = [b for b in boxes if b is not None]
        least = np.min([[b.x0, b.y0] for b in boxes], axis=0) / [drawn.bbox.width, drawn.bbox.height]
        most = np.max([[b.x1, b.y1] for b in boxes], axis=0) / [drawn.bbox.width, drawn.bbox.height]
        low = np.clip(low + room - least, 0.0, 0.6)
        high = np.clip(high + (1 - room - [0.0, top]) - most, low + 0.1, 1.0)
        if drawn.legends:
            free = 1.0 - drawn.legends[0].get_window_extent().width / drawn.bbox.width
            drawn.legends[0].set_bbox_to_anchor((max(min(low[0], free), 0.0), 1.0 - room[1] / 2))


def _wrap(own: Any) -> None:
    """The title beside a panel in more lines, where it is longer than the panel is high."""
    label = own.yaxis.label
    share = own.get_window_extent().height / max(label.get_window_extent().height, 1.0)
    if share < 1:
        longest = max(map(len, label.get_text().split("\n")))
        words = " ".join(label.get_text().split())
        label.set_text("\n".join(textwrap.wrap(words, max(int(share * longest), 6), break_long_words=False)))
