"""One look for every figure: palette, axis titles, thinning of long series."""

from __future__ import annotations

import html
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go

from slipangle.data.dataset import Channel
from slipangle.errors import ParameterError

FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'


_APART = 0.01  # of all that is drawn, between experiments that stand one after another


@dataclass(frozen=True)
class Colour:
    """One colour on light and on dark ground, as ``#rrggbb``."""

    light: str
    dark: str

    def faded(self, alpha: float) -> str:
        """The light colour with transparency, as CSS ``rgba()``."""
        return f"rgba({_components(self.light)},{alpha:g})"


# Hues after Okabe and Ito (2008), darkened or lightened until each has a contrast of at least 3.4 to its ground;
# told apart under protanopia, deuteranopia and tritanopia (simulated after Machado et al., 2009).
INK = Colour("#16191d", "#e9ecef")
SLATE = Colour("#66707c", "#98a2ae")
GRID = Colour("#e3e6ea", "#2c3238")
GROUND = Colour("#ffffff", "#14171a")
BLUE = Colour("#0072b2", "#56b4e9")
VERMILION = Colour("#d55e00", "#f0803c")
GREEN = Colour("#009e73", "#2fc79a")
PURPLE = Colour("#b8409f", "#ff8ad8")
LOW = Colour("#b9c1ca", "#4b545e")  # small errors recede into the ground
MIDDLE = Colour("#e0a100", "#b98300")
HIGH = Colour("#c4480a", "#f58442")
EXTREME = Colour("#6d1500", "#ffe6c4")

SERIES = (BLUE, VERMILION, GREEN, PURPLE)
DASHES = ("solid", "dash", "dot", "dashdot")
RISING = ((0.0, LOW), (0.35, MIDDLE), (0.7, HIGH), (1.0, EXTREME))
SIGNED = ((0.0, BLUE), (0.5, LOW), (1.0, HIGH))
_ALL = (INK, SLATE, GRID, GROUND, *SERIES, LOW, MIDDLE, HIGH, EXTREME)

QUANTITIES: Mapping[str, str] = {
    "t": "time",
    "delta": "steering angle",
    "delta_sw": "steering-wheel angle",
    "v_x": "longitudinal velocity",
    "v_y": "lateral velocity",
    "r": "yaw rate",
    "beta": "side slip angle",
    "a_x": "longitudinal acceleration",
    "a_y": "lateral acceleration",
    "omega_f": "front wheel spin",
    "omega_r": "rear wheel spin",
    "psi": "heading",
    "e_y": "lateral error",
    "e_psi": "heading error",
    "e_course": "course error",
    "e_v": "speed error",
    "r_dot": "yaw acceleration",
    "T_f": "front drive torque",
    "T_r": "rear drive torque",
    "pedal": "pedal",
}
_POWERS = str.maketrans("23", "²³")


def _components(colour: str) -> str:
    return ",".join(str(int(colour[k : k + 2], 16)) for k in (1, 3, 5))


def dark_map() -> dict[str, str]:
    """Replacements that turn a figure's JSON from light to dark ground."""
    pairs = {c.light: c.dark for c in _ALL}
    pairs |= {f"rgba({_components(c.light)},": f"rgba({_components(c.dark)}," for c in _ALL}
    return pairs


def series_style(index: int) -> tuple[Colour, str]:
    """Colour and dash of the ``index``-th model: four hues, then the same hues dashed."""
    return SERIES[index % len(SERIES)], DASHES[index // len(SERIES) % len(DASHES)]


def pretty_unit(unit: str) -> str:
    """A unit with its exponents raised.

    >>> pretty_unit("kg m2"), pretty_unit("-")
    ('kg m²', '-')
    """
    return unit.translate(_POWERS)


def axis_title(channel: Channel, *, lines: int = 1, prefix: str = "") -> str:
    """Quantity, name and unit of a channel as an axis title, safe for plotly's markup.

    Known names of `docs/nomenclature.md` are spelled out; 2 ``lines`` break the title before the name, for low panels;
    ``prefix`` is put before the quantity, such as ``"error of "``.

    >>> axis_title(Channel("r", "rad/s"))
    'yaw rate r [rad/s]'
    """
    long = QUANTITIES.get(channel.name, "")
    gap = "<br>" if lines == 2 and (long or prefix) else " "
    words = f"{prefix}{long}".strip()
    return f"{words}{gap if words else ''}{escape(channel.name)} [{escape(pretty_unit(channel.unit))}]"


def unit_title(words: str, unit: str) -> str:
    """Free words and a unit as an axis title."""
    return f"{escape(words)} [{escape(pretty_unit(unit))}]"


def escape(text: str) -> str:
    """Text without markup, for plotly's labels."""
    return html.escape(str(text), quote=False)


def template() -> go.layout.Template:
    """The look of every figure, on light ground; `dark_map` turns it dark."""
    lines = {"gridcolor": GRID.light, "zerolinecolor": GRID.light, "linecolor": SLATE.light, "tickcolor": SLATE.light}
    shape = {"ticks": "outside", "ticklen": 4, "showline": True, "automargin": True}
    axis = {**lines, **shape, "title": {"standoff": 8, "font": {"size": 13}}}
    place = {"orientation": "h", "x": 0, "xanchor": "left", "y": 1.02, "yanchor": "bottom"}
    clear = GROUND.faded(0)
    text = {"family": FONT, "size": 13, "color": INK.light}
    layout = go.Layout(
        font=text,
        colorway=[c.light for c in SERIES],
        paper_bgcolor=GROUND.light,
        plot_bgcolor=GROUND.light,
        xaxis=axis,
        yaxis=axis,
        margin={"l": 64, "r": 16, "t": 12, "b": 48},
        legend={**place, "bgcolor": clear, "font": {"size": 13}},
        hoverlabel={"bgcolor": GROUND.light, "bordercolor": SLATE.light, "font": text},
        modebar={"bgcolor": clear, "color": SLATE.light, "activecolor": INK.light, "orientation": "h"},
    )
    return go.layout.Template(layout=layout)


@dataclass(frozen=True)
class EqualScale:
    """What the page needs to size a figure with equal axes: height over width of its content, height of the rest."""

    ratio: float
    frame: float

    @property
    def meta(self) -> dict[str, float]:
        """As it stands in the figure's layout."""
        return {"ratio": round(self.ratio, 4), "frame": self.frame}

    def height(self, width: float = 820.0) -> int:
        """Height of the figure at a width of the content. [px]"""
        return int(np.clip(self.ratio * width + self.frame, 240, 640))


def new_figure(height: int, **layout: Any) -> go.Figure:
    """An empty figure in the common look. [height in px]"""
    figure = go.Figure()
    figure.update_layout(template=template(), height=height, **layout)
    return figure


def axes(
    figure: go.Figure,
    x: str,
    y: str,
    *,
    xaxis: Mapping[str, Any] | None = None,
    yaxis: Mapping[str, Any] | None = None,
    **layout: Any,
) -> go.Figure:
    """The figure with titles on its axes, what else is to be known of each, and of the figure."""
    titled = {"xaxis": {"title": {"text": x}, **(xaxis or {})}, "yaxis": {"title": {"text": y}, **(yaxis or {})}}
    return figure.update_layout(**titled, **layout)


def lighter(x: Any) -> Any:
    """Abscissae in single precision where that moves none by a thousandth of their spacing; else as they are."""
    if not isinstance(x, np.ndarray) or x.dtype != np.float64 or len(x) < 50:
        return x
    light = x.astype(np.float32)
    good = np.isfinite(x)
    if not good.any() or np.abs(light[good] - x[good]).max() > 1e-3 * np.ptp(x[good]) / len(x):
        return x
    return light


def line(
    figure: go.Figure, x: Any, y: Any, colour: Colour, width: float = 1.6, *, dash: str = "solid", **more: Any
) -> None:
    """A line; without ``hovertemplate`` nothing is said about it."""
    silent = {} if "hovertemplate" in more else {"hoverinfo": "skip"}
    style = {"color": colour.light, "width": width, "dash": dash}
    figure.add_scatter(x=lighter(x), y=compact(y), mode="lines", line=style, **silent, **more)


def dots(figure: go.Figure, x: Any, y: Any, colour: Any, size: float = 4, *, hover: str = "", **more: Any) -> None:
    """Markers in a colour or with colours of their own; what is said about each, if anything."""
    marker = {"color": colour.light if isinstance(colour, Colour) else colour, "size": size, **more.pop("marker", {})}
    said = {"hovertemplate": hover} if hover else {"hoverinfo": "skip"}
    figure.add_scatter(x=lighter(x), y=compact(y), mode="markers", marker=marker, **said, **more)


def nice_step(span: float, count: int = 5) -> float:
    """A distance of 1, 2 or 5 times a power of ten that divides ``span`` into about ``count`` parts.

    >>> nice_step(0.93), nice_step(1200.0)
    (0.2, 200.0)
    """
    raw = span / count
    power = 10.0 ** np.floor(np.log10(raw))
    return float(min((1.0, 2.0, 5.0, 10.0), key=lambda m: abs(np.log(m * power / raw))) * power)


def same_length(first: str, n: int, /, **others: Sequence[float] | np.ndarray) -> None:
    """Raise a ParameterError with both names and lengths unless every array has ``n`` rows."""
    for name, values in others.items():
        if len(values) != n:
            raise ParameterError(
                f"'{name}' has {len(values)} samples, '{first}' has {n}; expected as many: take both "
                "from the same record"
            )


def thin(y: np.ndarray, limit: int = 4000) -> np.ndarray:
    """Rising rows that draw the same line with at most about ``limit`` points: each bin's lowest and highest sample.

    NaN marks a gap, whose ends are kept, as are the first and the last row.

    >>> peak = np.zeros(100_000)
    >>> peak[54_321] = 1.0
    >>> rows = thin(peak, 1000)
    >>> 54_321 in rows, len(rows) <= 1002
    (True, True)
    """
    y = np.asarray(y, dtype=float)
    n = len(y)
    if n <= max(limit, 4):
        return np.arange(n)
    width = -(-2 * n // limit)
    count = n // width
    body = y[: count * width].reshape(count, width)
    hole = np.isnan(body)
    offset = np.arange(count) * width
    rows = [
        [0, n - 1],
        offset + np.where(hole, np.inf, body).argmin(axis=1),
        offset + np.where(hole, -np.inf, body).argmax(axis=1),
    ]
    tail = y[count * width :]
    if len(tail) and not np.isnan(tail).all():
        rows += [[count * width + int(np.nanargmin(tail)), count * width + int(np.nanargmax(tail))]]
    edges = np.flatnonzero(np.diff(np.isnan(y).astype(int)) != 0)
    if len(edges) <= limit // 4:
        rows += [edges, edges + 1]
    return np.unique(np.concatenate([np.asarray(r, dtype=int) for r in rows]))


def largest(value: np.ndarray, limit: int = 4000) -> np.ndarray:
    """At most ``limit`` rows: of each stretch the one with the largest absolute value."""
    n = len(value)
    if n <= limit:
        return np.arange(n)
    edges = np.linspace(0, n, limit + 1).astype(int)
    size = np.nan_to_num(np.abs(value), nan=-1.0)
    return np.array([a + int(np.argmax(size[a:b])) for a, b in itertools.pairwise(edges)])


def on_one_axis(t: np.ndarray, starts: Sequence[int]) -> tuple[np.ndarray, str]:
    """Times to draw experiments at, and the title of their axis.

    They are their own where each experiment begins after the one before. Where they do not, as of logs that all begin
    at 0 s and would lie over each other, they stand one after another.

    >>> on_one_axis(np.array([0.0, 1.0, 0.0, 1.0]), (0, 2))[0].tolist(), on_one_axis(np.arange(4.0), (0, 2))[1]
    ([0.0, 1.0, 2.0, 3.0], 'time t [s]')
    """
    t, title = np.array(t, dtype=float), "time t [s]"
    cuts = [s for s in starts if 0 < s < len(t)]
    if all(t[cut] > t[cut - 1] for cut in cuts):
        return t, title
    pieces = list(itertools.pairwise([0, *cuts, len(t)]))
    apart = max(_APART * sum(t[b - 1] - t[a] for a, b in pieces), np.min(np.diff(t), where=np.diff(t) > 0, initial=1.0))
    for a, b in pieces[1:]:
        t[a:b] += t[a - 1] + apart - t[a]
    return t, f"{title}, experiments one after another"


def with_gaps(t: np.ndarray, y: np.ndarray, starts: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """The series with a NaN before each experiment but the first, so that no line joins two of them."""
    cuts = [s for s in starts if 0 < s < len(t)]
    if not cuts:
        return np.asarray(t, dtype=float), np.asarray(y, dtype=float)
    return np.insert(t.astype(float), cuts, t[cuts]), np.insert(y.astype(float), cuts, np.nan)


def compact(values: np.ndarray) -> np.ndarray:
    """Ordinates in single precision, half the page's weight, where that moves none by a ten-thousandth of their range.

    Else they are as they were, such as places some thousand kilometres from their origin.
    """
    values = np.asarray(values, dtype=float)
    with np.errstate(over="ignore"):
        light = values.astype(np.float32)
    good = np.isfinite(values)
    reach = float(np.ptp(values[good])) if good.any() else 0.0
    return values if reach > 0 and np.abs(light[good] - values[good]).max() > 1e-4 * reach else light


def colourscale(stops: Sequence[tuple[float, Colour]]) -> list[list[object]]:
    """A colour ramp as plotly wants it."""
    return [[position, colour.light] for position, colour in stops]


def wrap(text: str, width: int = 16) -> str:
    """Words broken into lines of about ``width`` characters, safe for plotly's markup."""
    lines: list[str] = []
    line = ""
    for word in str(text).split():
        if line and len(line) + 1 + len(word) > width:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}".strip()
    return "<br>".join(escape(part) for part in (*lines, line))
