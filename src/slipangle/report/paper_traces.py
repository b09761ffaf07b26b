"""Traces, shapes and notes of a Plotly figure as matplotlib draws them, and their texts and colours."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from slipangle.errors import ParameterError
from slipangle.extras import extra

POINT = 0.75  # points in a pixel of CSS
_DASHES = {"solid": "-", "dash": (0, (4, 2)), "dot": (0, (1, 1.5)), "dashdot": (0, (4, 1.5, 1, 1.5))}
_MARKERS = {"circle": "o", "square": "s", "diamond": "D", "cross": "P", "x": "X", "triangle-up": "^", "star": "*"}
_JOB = "a figure by matplotlib"


# ---- texts and colours ----------------------------------------------------------------------------------------------


def plain(text: Any) -> str:
    r"""Plotly's markup as text for matplotlib: line breaks, subscripts and superscripts kept, other tags dropped.

    >>> plain("F<sub>x</sub><br><b>5 &lt; 6</b>")
    'F$_{\\mathrm{x}}$\n5 < 6'
    """
    written = str(text).replace("$", r"\$")
    written = re.sub(r"<br\s*/?>", "\n", written)
    written = re.sub(
        r"<(sub|sup)>(.*?)</\1>", lambda m: f"${'_' if m[1] == 'sub' else '^'}{{\\mathrm{{{m[2]}}}}}$", written
    )
    return html.unescape(re.sub(r"</?[a-zA-Z][^>]*>", "", written))


def colour(said: Any, spare: str = "#16191d") -> tuple[str, float]:
    """A colour of CSS and how opaque it is, from ``#rrggbb``, ``rgb(...)`` and ``rgba(...)``.

    >>> colour("rgba(0,114,178,0.2)"), colour("#d55e00")
    (('#0072b2', 0.2), ('#d55e00', 1.0))
    """
    if not isinstance(said, str):
        return spare, 1.0
    found = re.fullmatch(r"rgba?\(([^)]*)\)", said.replace(" ", ""))
    if not found:
        return said, 1.0
    parts = [float(p) for p in found.group(1).split(",")]
    return "#" + "".join(f"{round(p):02x}" for p in parts[:3]), parts[3] if len(parts) > 3 else 1.0


def _rgba(said: Any, spare: str, opacity: float | None = None) -> tuple[float, float, float, float]:
    name, alpha = colour(said, spare)
    red, green, blue, own = extra("matplotlib.colors", "plot", _JOB).to_rgba(name)
    return red, green, blue, own * alpha * (1.0 if opacity is None else opacity)


def _ramp(stops: Any) -> Any:
    """A colour ramp of Plotly for matplotlib; a step where a place stands twice."""
    module = extra("matplotlib.colors", "plot", _JOB)
    listed = [(float(place), _rgba(said, "#000000")) for place, said in stops]
    return module.LinearSegmentedColormap.from_list("ramp", listed, N=512)


# ---- traces ---------------------------------------------------------------------------------------------------------


def require_drawable(figure: Any) -> None:
    """Raise ParameterError if a trace is of a kind that no figure of the toolbox has."""
    for trace in figure.data:
        if trace.type not in ("scatter", "bar", "box", "heatmap"):
            raise ParameterError(
                f"the figure has a trace of kind '{trace.type}'; expected scatter, bar, box or heatmap: save it with "
                'drawn_by="browser"'
            )


def draw_trace(own: Any, trace: Any, figure: Any, spare: str, drawn: Any) -> Any:
    """Draw one trace and return what a legend shows of it; None if there is nothing."""
    match trace.type:
        case "scatter":
            return _scatter(own, trace, spare, drawn)
        case "bar":
            return _bar(own, trace, figure, spare)
        case "box":
            return _box(own, trace)
        case "heatmap":
            steps = dict(shading="nearest", cmap=_ramp(trace.colorscale), vmin=trace.zmin, vmax=trace.zmax)
            own.pcolormesh(_numbers(trace.x), _numbers(trace.y), np.asarray(trace.z, float), rasterized=True, **steps)
            return None


def _numbers(values: Any) -> Any:
    """Numbers with NaN for gaps, or the texts of categories."""
    if values is None:
        return np.empty(0)
    listed = [np.nan if v is None else v for v in values]
    return listed if any(isinstance(v, str) for v in listed) else np.asarray(listed, dtype=float)


def _scatter(own: Any, trace: Any, spare: str, drawn: Any) -> Any:
    x, y = _numbers(trace.x), _numbers(trace.y)
    if len(x) == 0 and len(y):
        x = np.arange(len(y), dtype=float)
    mode = trace.mode or ("lines+markers" if len(y) < 20 else "lines")
    shade = _rgba(trace.line.color, spare, trace.opacity)
    handles = []
    if trace.fill == "toself":
        inside = _rgba(trace.fillcolor or trace.line.color, spare, trace.opacity)
        edge = (trace.line.width or 0.0) if "lines" in mode else 0.0
        for rows in _pieces(x, y):
            patch = own.fill(x[rows], y[rows], facecolor=inside, linewidth=edge * POINT, edgecolor=shade)
            handles = handles or patch
    elif "lines" in mode and trace.line.width != 0:
        steps = {"drawstyle": "steps-post"} if trace.line.shape == "hv" else {}
        width = POINT * (2.0 if trace.line.width is None else trace.line.width)
        dash = _DASHES.get(trace.line.dash or "solid", "-")
        handles = own.plot(x, y, color=shade, linewidth=width, linestyle=dash, **steps)
    if "markers" in mode:
        dots = _markers(own, trace, x, y, spare, drawn)
        handles = handles or [dots]
    if "text" in mode and trace.text is not None:
        for a, b, word in zip(x, y, trace.text, strict=False):
            own.annotate(plain(word), (a, b), fontsize=own.xaxis.get_tick_params()["labelsize"], ha="center")
    return handles[0] if handles else None


def _pieces(x: np.ndarray, y: np.ndarray) -> list[np.ndarray]:
    """Rows of each closed outline: NaN parts them."""
    good = np.isfinite(x) & np.isfinite(y)
    cuts = np.flatnonzero(~good)
    rows = np.split(np.arange(len(x)), cuts)
    return [r for r in (r[good[r]] for r in rows) if len(r) > 2]


def _markers(own: Any, trace: Any, x: Any, y: Any, spare: str, drawn: Any) -> Any:
    look = trace.marker
    sizes = np.asarray(6.0 if look.size is None else look.size, dtype=float) * POINT
    names = look.symbol if isinstance(look.symbol, str) else "circle"
    shape, hollow = _MARKERS.get(names.removesuffix("-open"), "o"), names.endswith("-open")
    edge = {"linewidths": POINT * (look.line.width or 0.0)}
    if look.line.color is not None and isinstance(look.line.color, str):
        edge["edgecolors"] = [_rgba(look.line.color, spare)]
    values = look.color
    common = {"s": sizes**2, "marker": shape, "rasterized": len(x) > 3000, "zorder": 2.5}
    if values is None or isinstance(values, str):
        shade = _rgba(values, spare, look.opacity)
        if hollow:
            return own.scatter(x, y, facecolors="none", **common, edgecolors=[shade], linewidths=0.8)
        return own.scatter(x, y, color=[shade], **common, **edge)
    if isinstance(values[0], str):
        return own.scatter(x, y, color=[_rgba(v, spare, look.opacity) for v in values], **common)
    ends = {"vmin": look.cmin, "vmax": look.cmax, "cmap": _ramp(look.colorscale)}
    made = own.scatter(x, y, c=np.asarray(values, dtype=float), **ends, **common, linewidths=0)
    if look.showscale is not False:
        bar = drawn.colorbar(made, cax=own.inset_axes((1.02, 0.0, 0.03, 1.0)))
        bar.outline.set_visible(False)
        size = own.xaxis.get_tick_params()["labelsize"]
        bar.ax.tick_params(labelsize=size, length=2)
        if look.colorbar.title.text:
            bar.set_label(plain(look.colorbar.title.text), fontsize=size)
    return made


def _bar(own: Any, trace: Any, figure: Any, spare: str) -> Any:
    """Bars; several traces of one axis stand beside each other unless they are stacked or laid over."""
    across = trace.orientation == "h"
    place, length = (_numbers(v) for v in ((trace.y, trace.x) if across else (trace.x, trace.y)))
    beside = [t for t in figure.data if t.type == "bar" and (t.xaxis, t.yaxis) == (trace.xaxis, trace.yaxis)]
    named = isinstance(place, list)
    spots = np.arange(len(place), dtype=float) if named else place
    gap = 1.0 if named or len(spots) < 2 else float(np.min(np.diff(np.unique(spots))))
    width = 0.8 * gap if trace.width is None else np.asarray(trace.width, dtype=float)
    if len(beside) > 1 and figure.layout.barmode in (None, "group"):
        width = width / len(beside)
        spots = spots + ([t is trace for t in beside].index(True) - (len(beside) - 1) / 2) * width
    shade = _rgba(trace.marker.color if isinstance(trace.marker.color, str) else None, spare, trace.opacity)
    style = {"color": [shade], "linewidth": 0.0}
    base = 0.0 if trace.base is None else np.asarray(trace.base, dtype=float)
    made = (
        own.barh(spots, length, width, left=base, **style) if across else own.bar(spots, length, width, base, **style)
    )
    if named:
        edge = own.yaxis if across else own.xaxis
        edge.set_ticks(np.arange(len(place)), [plain(p) for p in place])
    return made


def _box(own: Any, trace: Any) -> None:
    """Lying boxes whose quartiles and fences are given."""
    shade, width = colour(trace.line.color)[0], POINT * (trace.line.width or 2.0)
    keys = ("q1", "median", "q3", "lowerfence", "upperfence")
    for place, *numbers in zip(_numbers(trace.y), *(getattr(trace, k) for k in keys), strict=True):
        q1, middle, q3, low, high = map(float, numbers)
        half = (trace.width or 0.5) / 2
        own.fill_between([q1, q3], place - half, place + half, facecolor=_rgba(trace.fillcolor, shade), linewidth=0)
        for x, y in (
            ([low, q1], [place, place]), ([q3, high], [place, place]), ([middle, middle], [place - half, place + half]),
            ([q1, q3, q3, q1, q1], [place - half, place - half, place + half, place + half, place - half]),
        ):  # fmt: skip
            own.plot(x, y, color=shade, linewidth=width)


# ---- shapes and notes ------------------------------------------------------------------------------------------------


def _where(axes: Mapping[tuple[str, str], Any], xref: str | None, yref: str | None) -> tuple[Any, bool, bool]:
    """The axes that references speak of, and whether x and y are shares of them instead of data."""
    x, _, inside_x = (xref or "x").partition(" ")
    y, _, inside_y = (yref or "y").partition(" ")
    pairs = list(axes)
    fits = [p for p in pairs if (x == "paper" or p[0] == x) and (y == "paper" or p[1] == y)] or pairs
    return axes[fits[0]], bool(inside_x) or x == "paper", bool(inside_y) or y == "paper"


def _transform(own: Any, share_x: bool, share_y: bool) -> Any:
    module = extra("matplotlib.transforms", "plot", _JOB)
    return module.blended_transform_factory(
        own.transAxes if share_x else own.transData, own.transAxes if share_y else own.transData
    )


def draw_shape(axes: Mapping[tuple[str, str], Any], shape: Any) -> None:
    """A straight line or a rectangle; one that refers to the whole figure is drawn on every panel."""
    over_all = "paper" in (shape.xref, shape.yref)
    chosen: Sequence[Any] = list(axes.values()) if over_all else [_where(axes, shape.xref, shape.yref)[0]]
    _, share_x, share_y = _where(axes, shape.xref, shape.yref)
    patches = extra("matplotlib.patches", "plot", _JOB)
    lines = extra("matplotlib.lines", "plot", _JOB)
    below = {"zorder": 0.5 if shape.layer == "below" else 2.0, "clip_on": True}
    for own in chosen:
        limits = own.get_xlim(), own.get_ylim()
        place = {"transform": _transform(own, share_x, share_y), **below}
        width = POINT * (2.0 if shape.line.width is None else shape.line.width)
        if shape.type == "rect":
            corner, size = (shape.x0, shape.y0), (shape.x1 - shape.x0, shape.y1 - shape.y0)
            shade = _rgba(shape.fillcolor, "#ffffff", shape.opacity) if shape.fillcolor else "none"
            edge = colour(shape.line.color)[0] if shape.line.color and width else "none"
            own.add_patch(patches.Rectangle(corner, *size, facecolor=shade, edgecolor=edge, linewidth=width, **place))
        else:
            shade = _rgba(shape.line.color, "#16191d", shape.opacity)
            style = {
                "color": shade,
                "linewidth": width,
                "linestyle": _DASHES.get(shape.line.dash or "solid", "-"),
            }
            own.add_line(lines.Line2D([shape.x0, shape.x1], [shape.y0, shape.y1], **style, **place))
        if share_x:
            own.set_xlim(limits[0])
        if share_y:
            own.set_ylim(limits[1])


def draw_annotation(axes: Mapping[tuple[str, str], Any], note: Any, font: float) -> None:
    """A text at a place, moved by pixels."""
    if not note.text:
        return
    own, share_x, share_y = _where(axes, note.xref, note.yref)
    x, y = note.x, note.y
    if own.get_xscale() == "log" and not share_x:
        x = 10 ** float(x)
    if own.get_yscale() == "log" and not share_y:
        y = 10 ** float(y)
    across = {"left": "left", "right": "right"}.get(note.xanchor or "", "center")
    up = {"top": "top", "bottom": "bottom"}.get(note.yanchor or "", "center")
    moved = (POINT * (note.xshift or 0.0), POINT * (note.yshift or 0.0))
    place = _transform(own, share_x, share_y)
    if note.xref == "paper" and note.yref == "paper" and len(axes) > 1:
        place = own.figure.transFigure
    elif note.yref == "paper":
        place = _transform(max(axes.values(), key=lambda a: a.get_position().y1), share_x, True)
    style = {"fontsize": font, "color": colour(note.font.color)[0], "rotation": -(note.textangle or 0)}
    own.annotate(
        plain(note.text), (x, y), moved, xycoords=place, textcoords="offset points", ha=across, va=up,
        annotation_clip=False, **style,
    )  # fmt: skip
