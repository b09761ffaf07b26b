"""Figures that set a model's output beside the measured one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
import scipy

from slipangle.data.dataset import Channel
from slipangle.errors import ParameterError, nearest
from slipangle.models.model import Trajectory
from slipangle.report.style import (
    INK,
    SLATE,
    EqualScale,
    axes,
    axis_title,
    compact,
    dots,
    escape,
    line,
    new_figure,
    nice_step,
    on_one_axis,
    pretty_unit,
    same_length,
    series_style,
    thin,
    with_gaps,
    wrap,
)


def measured_vs_simulated(
    t: np.ndarray,
    measured: np.ndarray,
    simulated: Mapping[str, np.ndarray],
    *,
    channel: Channel,
    starts: Sequence[int] = (0,),
    points: int = 4000,
) -> go.Figure:
    """Measured and simulated output over time, with the error below on the same time axis.

    Raises ParameterError if the lengths differ or there is no model.

    Parameters
    ----------
    t, measured : array, shape (n,)
        Time [s] and measured output, in the channel's unit.
    simulated : mapping of str to array, shape (n,)
        Output of each model; NaN where the model did not predict.
    channel : Channel
        Which output, and its unit.
    starts : sequence of int
        First row of each experiment; no line joins two of them.
    points : int
        About how many points each line keeps: of a longer series the lowest and highest sample of each bin.
    """
    t, measured = np.asarray(t, dtype=float), np.asarray(measured, dtype=float)
    same_length("t", len(t), measured=measured)
    same_length("t", len(t), **simulated)
    _at_least_one(simulated)
    t, title = on_one_axis(t, starts)
    x, y = with_gaps(t, measured, starts)
    models = [(escape(name), with_gaps(t, np.asarray(v, dtype=float), starts)[1]) for name, v in simulated.items()]
    rows = np.arange(len(x))
    if len(x) > points:  # the same rows for every line, so that hovering compares like with like
        share = max(points // (2 * len(models) + 1), 200)
        lines = [y, *(v for _, v in models), *(y - v for _, v in models)]
        rows = np.unique(np.concatenate([thin(v, share) for v in lines]))
    x, y = x[rows], y[rows]
    figure = new_figure(520, hovermode="x unified")
    line(figure, x, y, INK, name="measured")
    for index, (name, values) in enumerate(models):
        colour, dash = series_style(index)
        error, below = y - values[rows], {"showlegend": False, "yaxis": "y2"}
        line(figure, x, values[rows], colour, 1.3, dash=dash, name=name, legendgroup=name)
        line(figure, x, error, colour, 1.3, dash=dash, name=f"error of {name}", legendgroup=name, **below)
    figure.update_traces(hoverinfo=None, hovertemplate="%{y:.4g}")
    below = {"title": {"text": f"error<br>[{escape(pretty_unit(channel.unit))}]"}, "domain": [0.0, 0.3]}
    below |= {"zeroline": True, "zerolinecolor": SLATE.light}
    across, upright = {"anchor": "y2", "hoverformat": ".2f"}, {"domain": [0.36, 1.0]}
    return axes(figure, title, axis_title(channel, lines=2), xaxis=across, yaxis=upright, yaxis2=below)


def trajectories(models: Mapping[str, Trajectory], channel: Channel, *, points: int = 4000) -> go.Figure:
    """`measured_vs_simulated` for one output of several models on the same data.

    Raises ParameterError if the trajectories do not hold that output or are not of the same samples.
    """
    _at_least_one(models)
    first = next(iter(models.values()))
    for name, trajectory in models.items():
        if channel.name not in trajectory.outputs:
            raise ParameterError(
                f"the trajectory of '{name}' has no output '{channel.name}'; "
                f"{nearest(channel.name, trajectory.outputs)}"
            )
    column = first.outputs.index(channel.name)
    return measured_vs_simulated(
        first.t,
        first.measured[:, column],
        {name: np.where(tr.predicted, tr.channel(channel.name), np.nan) for name, tr in models.items()},
        channel=channel,
        starts=first.starts,
        points=points,
    )


def rainclouds(errors: Mapping[str, np.ndarray], *, channel: Channel, points: int = 300, seed: int = 0) -> go.Figure:
    """Raincloud of each model's error: density above, quartile box, single samples below.

    ``errors`` are measured minus simulated, in the channel's unit; NaN is left out, lengths may differ. At most so many
    ``points`` are drawn as rain, the two extremes always among them; ``seed`` is that of the draw and the jitter. A
    ParameterError says that there is no model, or that one has no finite error.

    Source: M. Allen et al., Raincloud plots: a multi-platform tool for robust data visualization, Wellcome Open
    Research 4:63, 2019.
    """
    _at_least_one(errors)
    rng = np.random.default_rng(seed)
    figure = new_figure(80 + 160 * len(errors), showlegend=False)
    for index, (name, values) in enumerate(errors.items()):
        e = np.asarray(values, dtype=float)
        e = e[np.isfinite(e)]
        if len(e) == 0:
            raise ParameterError(
                f"the errors of '{name}' hold no finite sample; expected some: simulate the model first"
            )
        row = float(len(errors) - 1 - index)
        _raincloud(figure, e, row, index, name, points, rng)
        gap = ", " if len(name) <= 22 else "<br>"
        rmse = f"RMSE {np.sqrt(np.mean(e**2)):#.3g} {escape(pretty_unit(channel.unit))}"
        where = {"x": 0, "y": row + 0.43, "xref": "x domain", "xanchor": "left", "yanchor": "bottom", "align": "left"}
        figure.add_annotation(text=f"<b>{wrap(name, 44)}</b>{gap}{rmse}", showarrow=False, **where)
    title = {"text": axis_title(channel, prefix="error of ")}
    hidden = {"visible": False, "range": [-0.4, len(errors) - 0.28], "fixedrange": True}
    zero = {"title": title, "zeroline": True, "zerolinecolor": SLATE.light}
    return figure.update_layout(xaxis=zero, yaxis=hidden, hovermode="closest")


def _raincloud(
    figure: go.Figure, e: np.ndarray, row: float, index: int, name: str, points: int, rng: np.random.Generator
) -> None:
    colour, dash = series_style(index)
    label = escape(name)
    if np.ptp(e) > 0:
        grid = np.linspace(e.min(), e.max(), 256)
        sample = e if len(e) <= 20_000 else rng.choice(e, 20_000, replace=False)
        density = scipy.stats.gaussian_kde(sample)(grid)
        cloud = row + 0.1 + 0.32 * density / density.max()
        outline = compact(np.concatenate([grid, grid[::-1]])), np.concatenate([cloud, np.full(len(grid), row + 0.1)])
        filled = {"fill": "toself", "fillcolor": colour.faded(0.35), "name": label}
        line(figure, *outline, colour, 1, dash=dash, **filled)
    q1, median, q3 = np.percentile(e, [25, 50, 75])
    reach = 1.5 * (q3 - q1)
    inside = e[(e >= q1 - reach) & (e <= q3 + reach)]
    whiskers = {"lowerfence": [inside.min()], "upperfence": [inside.max()]}
    look = {"width": 0.13, "line": {"color": colour.light, "width": 1.6}, "fillcolor": colour.faded(0.15)}
    box = {"q1": [q1], "median": [median], "q3": [q3], "boxpoints": False, **whiskers, **look}
    figure.add_box(y=[row], orientation="h", name=label, **box)
    drawn = e
    if len(e) > points:
        middle = rng.choice(len(e), points - 2, replace=False)
        drawn = e[np.unique(np.concatenate([middle, [int(e.argmin()), int(e.argmax())]]))]
    height = row - 0.19 + rng.uniform(-0.07, 0.07, len(drawn))
    hover = "%{x:.4g}<extra>" + label + "</extra>"
    dots(figure, compact(drawn), height, colour.faded(0.5), hover=hover, name=label)


def correlation(
    measured: np.ndarray,
    simulated: np.ndarray,
    *,
    channel: Channel,
    limits: tuple[float, float] | None = None,
    index: int = 0,
    points: int = 2500,
) -> go.Figure:
    """Simulated over measured output with the identity line and R2; axes of equal scale.

    Raises ParameterError if the lengths differ or fewer than two samples are finite.

    Parameters
    ----------
    measured, simulated : array, shape (n,)
        In the channel's unit; samples with NaN are left out.
    limits : tuple of float, optional
        Lowest and highest value of both axes, to set several models side by side; by default from the data.
    index, points : int
        Colour of the model, as in the other figures; about how many samples are drawn, evenly chosen. R2 is of all.
    """
    y, y_hat = np.asarray(measured, dtype=float), np.asarray(simulated, dtype=float)
    same_length("measured", len(y), simulated=y_hat)
    good = np.isfinite(y) & np.isfinite(y_hat)
    y, y_hat = y[good], y_hat[good]
    if len(y) < 2:
        raise ParameterError(f"{len(y)} samples are finite; expected at least 2: simulate the model on the data first")
    spread = float(np.sum((y - y.mean()) ** 2))
    r2 = 1.0 - float(np.sum((y - y_hat) ** 2)) / spread if spread > 0 else float("nan")
    low, high = limits or (float(min(y.min(), y_hat.min())), float(max(y.max(), y_hat.max())))
    pad = 0.04 * (high - low) or 1.0
    ends = [low - pad, high + pad]
    rows = np.arange(0, len(y), max(1, -(-len(y) // points)))
    colour, _ = series_style(index)
    figure = new_figure(420, showlegend=False, hovermode="closest", meta=EqualScale(ratio=1.0, frame=60).meta)
    hover = "measured %{x:.4g}<br>simulated %{y:.4g}<extra></extra>"
    dots(figure, compact(y[rows]), y_hat[rows], colour.faded(0.4), hover=hover)
    line(figure, ends, ends, INK, 1.2, dash="dash")
    where = {"x": 0.03, "y": 0.98, "xref": "x domain", "yref": "y domain", "xanchor": "left", "yanchor": "top"}
    figure.add_annotation(text=f"R² = {r2:.4f}", showarrow=False, font={"size": 15}, **where)
    axis = {"range": ends, "dtick": nice_step(ends[1] - ends[0]), "constrain": "domain"}
    x, y = axis_title(channel, prefix="measured "), axis_title(channel, lines=2, prefix="simulated ")
    return axes(figure, x, y, xaxis=axis, yaxis={**axis, "scaleanchor": "x"})


def _at_least_one(models: Mapping[str, object]) -> None:
    if not models:
        raise ParameterError("there is no model to draw; got an empty mapping, expected name -> values: add one")
