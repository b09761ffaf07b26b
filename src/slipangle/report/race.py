"""Where on the track a model errs: by corner phase, by lateral acceleration, and where a discrepancy works."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from slipangle.data.dataset import Channel
from slipangle.data.race import PHASES, Corner, rmse_by_level, rmse_by_phase
from slipangle.errors import ParameterError
from slipangle.report.maps import track_map
from slipangle.report.style import compact, escape, new_figure, pretty_unit, series_style


def error_by_phase(errors: Mapping[str, np.ndarray], corners: tuple[Corner, ...], *, channel: Channel) -> go.Figure:
    """RMSE of each model on straights and in corner entries, middles and exits, as bars side by side.

    Errors, shape (n_samples,), are measured minus simulated, in the channel's unit; NaN is left out. Corners are those
    of `slipangle.data.race.corners`, of the same samples. There must be a model (ParameterError).
    """
    figure = _frame(errors, channel)
    for k, (name, error) in enumerate(errors.items()):
        by = rmse_by_phase(np.asarray(error, dtype=float), corners)
        colour, _ = series_style(k)
        figure.add_bar(
            x=list(PHASES),
            y=compact(np.array([by[p] for p in PHASES])),
            name=escape(name),
            marker={"color": colour.light},
            hovertemplate="%{x}: %{y:.3g}<extra>" + escape(name) + "</extra>",
        )
    return figure.update_layout(barmode="group", xaxis={"title": {"text": "phase of the corner"}})


def error_by_level(
    errors: Mapping[str, np.ndarray], level: np.ndarray, edges: np.ndarray, *, channel: Channel, sorted_by: Channel
) -> go.Figure:
    """RMSE of each model over what the samples are sorted by, such as the size of the lateral acceleration.

    Errors are as in `error_by_phase`; the size of ``level``, shape (n_samples,), counts; ``edges`` are the rising ends
    of the bins, shape (n_bins + 1,).
    """
    figure = _frame(errors, channel)
    middle = 0.5 * (edges[1:] + edges[:-1])
    for k, (name, error) in enumerate(errors.items()):
        error = np.asarray(error, dtype=float)
        known = np.isfinite(error)
        colour, dash = series_style(k)
        figure.add_scatter(
            x=compact(middle),
            y=compact(rmse_by_level(error[known], np.asarray(level)[known], edges)),
            mode="lines+markers",
            name=escape(name),
            line={"color": colour.light, "width": 2, "dash": dash},
            hovertemplate="%{x:.3g}: %{y:.3g}<extra>" + escape(name) + "</extra>",
        )
    words = {"a_y": "size of the lateral acceleration"}.get(sorted_by.name, f"size of {sorted_by.name}")
    return figure.update_layout(xaxis={"title": {"text": f"{words} [{pretty_unit(sorted_by.unit)}]"}})


def share_map(X: np.ndarray, Y: np.ndarray, share: np.ndarray, *, starts: Sequence[int] = (0,)) -> go.Figure:
    """The track coloured by the share of a hybrid's output that its discrepancy makes [%]; NaN is a thin line.

    It is one column of `slipangle.models.wrappers.hybrid.HybridModel.share`; for the others see `track_map`.
    """
    return track_map(X, Y, share, channel=Channel("share", "%"), label="share of the discrepancy", starts=starts)


def _frame(errors: Mapping[str, np.ndarray], channel: Channel) -> go.Figure:
    if not errors:
        raise ParameterError("there is no model; expected the errors of at least one")
    figure = new_figure(340, hovermode="closest")
    title = f"RMSE of {escape(channel.name)} [{escape(pretty_unit(channel.unit))}]"
    return figure.update_layout(yaxis={"title": {"text": title}, "rangemode": "tozero"})
