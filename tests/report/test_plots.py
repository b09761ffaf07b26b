"""Figures draw what they are given: extremes survive, gaps stay gaps, wrong input is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import plotly.graph_objects as go
import pytest

from slipangle.data.dataset import Channel
from slipangle.errors import ParameterError
from slipangle.models.model import ProfileInfo, Trajectory
from slipangle.report import (
    Body,
    Signal,
    Span,
    correlation,
    correlogram,
    forest,
    measured_vs_simulated,
    parameter_table,
    path_map,
    rainclouds,
    signals,
    solver_histogram,
    solver_time,
    track_map,
    trajectories,
)
from slipangle.report.style import axis_title, compact, largest, series_style, thin, with_gaps
from tests.report.example import YAW_RATE, fit_info


def trace(figure: go.Figure, name: str) -> go.Scatter:
    [found] = [t for t in figure.data if t.name == name]
    return found


# ---- thinning ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 5, 999, 1000, 1001, 4003, 77_777])
@pytest.mark.parametrize("limit", [10, 1000])
def test_thin_keeps_ends_and_extremes(n, limit):
    y = np.random.default_rng(n).standard_normal(n)
    rows = thin(y, limit)
    assert (np.diff(rows) > 0).all()
    assert rows[0] == 0
    assert rows[-1] == n - 1
    assert {int(y.argmin()), int(y.argmax())} <= set(rows.tolist())
    assert len(rows) <= max(limit, 4) + 4


def test_thin_keeps_holes():
    y = np.sin(np.arange(50_000) / 10)
    y[20_000:20_003] = np.nan
    y[:5] = np.nan
    rows = thin(y, 500)
    kept = y[rows]
    inner = (rows > 19_000) & (rows < 21_000)
    assert np.isnan(kept[inner]).any()
    assert np.isnan(kept[0])
    assert np.isfinite(kept[rows == 5]).all()
    assert (rows == 5).any()
    assert len(thin(np.full(9999, np.nan), 100)) <= 110


def test_thin_follows_the_line_within_a_bin():
    t = np.linspace(0, 1, 200_000)
    y = np.sin(40 * t) * np.exp(t)
    rows = thin(y, 2000)
    assert np.abs(np.interp(t, t[rows], y[rows]) - y).max() < 0.06 * np.ptp(y)


@pytest.mark.parametrize("n", [10, 4000, 4001, 30_001])
def test_largest_keeps_every_stretch_and_the_peak(n):
    value = np.random.default_rng(3).standard_normal(n)
    value[n // 2] = -50.0
    value[0] = np.nan
    rows = largest(value, 4000)
    assert len(rows) == min(n, 4000)
    assert n // 2 in rows
    assert (np.diff(rows) > 0).all()


def test_with_gaps_puts_a_hole_before_each_later_experiment():
    t, y = with_gaps(np.arange(6.0), np.arange(6.0), (0, 2, 4))
    assert np.isnan(y).nonzero()[0].tolist() == [2, 5]
    assert t.tolist() == [0, 1, 2, 2, 3, 4, 4, 5]


# ---- axis titles -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("channel", "kwargs", "expected"),
    [
        (Channel("r", "rad/s"), {}, "yaw rate r [rad/s]"),
        (Channel("a_y", "m/s2"), {"lines": 2}, "lateral acceleration<br>a_y [m/s²]"),
        (Channel("r", "rad/s"), {"prefix": "error of "}, "error of yaw rate r [rad/s]"),
        (Channel("<b>", "<i>"), {}, "&lt;b&gt; [&lt;i&gt;]"),
        (Channel("oil", "-"), {"lines": 2}, "oil [-]"),
    ],
)
def test_axis_title(channel, kwargs, expected):
    assert axis_title(channel, **kwargs) == expected


def test_eight_models_look_different():
    assert len({series_style(k) for k in range(8)}) == 8


# ---- figures -----------------------------------------------------------------------------------------------------


def test_error_panel_is_measured_minus_simulated_on_the_same_time_axis():
    t = np.arange(100.0)
    figure = measured_vs_simulated(t, np.sin(t), {"m": 0.5 * np.sin(t)}, channel=YAW_RATE)
    error = trace(figure, "error of m")
    assert error.yaxis == "y2"
    assert error.xaxis in (None, "x")
    np.testing.assert_allclose(error.y, 0.5 * np.sin(t), atol=1e-7)
    assert figure.layout.yaxis.domain[0] > figure.layout.yaxis2.domain[1]


@pytest.mark.parametrize("name", ["measured", "n", "first", "t"])
def test_any_model_name_may_be_used(name):
    figure = measured_vs_simulated(np.arange(9.0), np.zeros(9), {name: np.ones(9)}, channel=YAW_RATE)
    assert len(figure.data) == 3


def test_long_series_stay_light_and_keep_their_spikes():
    n = 300_000
    y = np.sin(np.arange(n) / 1000)
    spiky = y.copy()
    spiky[123_456] = 9.0
    figure = measured_vs_simulated(np.arange(n) * 0.01, y, {"m": spiky}, channel=YAW_RATE, points=3000)
    assert max(len(d.x) for d in figure.data) <= 3100
    assert np.max(trace(figure, "m").y) == 9.0
    assert np.min(trace(figure, "error of m").y) < -7.9
    assert len({tuple(d.x[:50]) for d in figure.data}) == 1


def trajectory(n: int = 50, **changes) -> Trajectory:
    y = np.linspace(0, 1, 2 * n).reshape(n, 2)
    fields = {
        "t": np.arange(n) * 0.1,
        "y": 0.9 * y,
        "measured": y,
        "predicted": np.arange(n) >= 4,
        "outputs": ("v_y", "r"),
        "starts": (0, 20),
    }
    return Trajectory(**{**fields, **changes})


def test_trajectories_hide_what_was_not_predicted_and_break_between_experiments():
    figure = trajectories({"m": trajectory()}, YAW_RATE)
    y = trace(figure, "m").y
    assert np.isnan(y[:4]).all()
    assert np.isfinite(y[4:20]).all()
    assert np.isnan(y[20])
    assert len(y) == 51
    with pytest.raises(ParameterError, match="has no output 'a_y'"):
        trajectories({"m": trajectory()}, Channel("a_y", "m/s2"))
    with pytest.raises(ParameterError, match="no model"):
        trajectories({}, YAW_RATE)
    with pytest.raises(ParameterError, match="'b' has 40 samples"):
        trajectories({"a": trajectory(), "b": trajectory(40)}, YAW_RATE)


def test_logs_that_all_begin_at_zero_are_not_drawn_over_each_other():
    """Each sample is drawn once, at a time that rises, a log's own steps kept; logs of one clock keep their times."""
    t, v = np.tile(0.1 * np.arange(20), 3), np.arange(60.0)
    starts = (0, 20, 40)
    over = measured_vs_simulated(t, v, {"m": v}, channel=YAW_RATE, starts=starts)
    panels = signals(t, [Signal(channel=Channel("delta", "rad"), values=v)], starts=starts)
    for figure in (over, panels):
        x, y = (np.asarray(a, dtype=float) for a in (figure.data[0].x, figure.data[0].y))
        seen = np.isfinite(y)
        assert y[seen] == pytest.approx(v)
        assert (~seen).sum() == 2
        assert (np.diff(x[seen]) > 0.099).all()
        assert np.diff(x[seen].reshape(3, 20), axis=1) == pytest.approx(0.1, rel=1e-4)
        assert figure.layout.xaxis.title.text == "time t [s], experiments one after another"
    clock = t + np.repeat([0.0, 100.0, 300.0], 20)
    figure = signals(clock, [Signal(channel=Channel("delta", "rad"), values=v)], starts=starts)
    assert np.asarray(figure.data[0].x)[-1] == pytest.approx(301.9)
    assert figure.layout.xaxis.title.text == "time t [s]"


def test_raincloud_shows_quartiles_and_extremes():
    rng = np.random.default_rng(0)
    e = rng.standard_normal(5000)
    e[77] = 12.0
    figure = rainclouds({"m": np.append(e, np.nan)}, channel=YAW_RATE, points=100)
    cloud, box, rain = figure.data
    np.testing.assert_allclose([box.q1[0], box.median[0], box.q3[0]], np.percentile(e, [25, 50, 75]))
    assert box.upperfence[0] <= box.q3[0] + 1.5 * (box.q3[0] - box.q1[0])
    assert np.max(rain.x) == 12.0
    assert np.min(rain.x) == pytest.approx(e.min())
    assert len(rain.x) <= 100
    assert np.min(cloud.y) > box.y[0] > np.max(rain.y)
    assert f"RMSE {np.sqrt(np.mean(e**2)):.3g} rad/s" in figure.layout.annotations[0].text


def test_raincloud_is_reproducible_and_bears_limit_cases():
    e = np.random.default_rng(0).standard_normal(2000)
    a, b = (rainclouds({"m": e}, channel=YAW_RATE, seed=4) for _ in range(2))
    assert a == b
    assert len(rainclouds({"exact": np.zeros(30), "one": np.ones(1)}, channel=YAW_RATE).data) == 4  # no clouds
    with pytest.raises(ParameterError, match="no finite sample"):
        rainclouds({"m": np.full(3, np.nan)}, channel=YAW_RATE)


def test_correlation_states_r2_of_all_samples():
    rng = np.random.default_rng(2)
    y = rng.standard_normal(9000)
    y_hat = y + 0.3 * rng.standard_normal(9000)
    y_hat[:10] = np.nan
    r2 = 1 - np.sum((y - y_hat)[10:] ** 2) / np.sum((y[10:] - y[10:].mean()) ** 2)
    figure = correlation(y, y_hat, channel=YAW_RATE)
    assert figure.layout.annotations[0].text == f"R² = {r2:.4f}"
    assert len(figure.data[0].x) <= 2500
    assert figure.layout.yaxis.scaleanchor == "x"
    assert figure.layout.xaxis.range == figure.layout.yaxis.range
    wide = correlation(y, y_hat, channel=YAW_RATE, limits=(-9.0, 9.0))
    assert wide.layout.xaxis.range[0] < -9
    with pytest.raises(ParameterError, match="at least 2"):
        correlation(y[:3], np.full(3, np.nan), channel=YAW_RATE)


def test_correlogram_marks_what_leaves_the_band_but_not_lag_zero_of_white_noise():
    values = np.array([1.0, 0.05, -0.3, 0.02])
    figure = correlogram(np.arange(4), values, band=0.1, label="autocorrelation", dt=0.05)
    outside = trace(figure, "outside")
    np.testing.assert_allclose(outside.x, [0.1])
    assert figure.layout.xaxis.title.text == "lag [s]"
    white = correlogram(np.arange(4), np.array([1.0, 0.05, 0.01, 0.02]), band=0.1, label="a")
    assert "outside" not in [t.name for t in white.data]
    low, high = white.layout.yaxis.range
    assert low < -0.1
    assert high >= 1.0


def test_forest_places_intervals_and_references_relative_to_the_estimate():
    info = fit_info(weak=False)
    figure = forest(info, references={"C_f": 1.02 * info.values[0], "unknown": 3.0})
    segments = [t for t in figure.data if t.mode == "lines"]
    widths = [float(max(s.x)) for s in segments]
    np.testing.assert_allclose(widths, 1.959964 * 100 * info.std / np.abs(info.values), rtol=1e-5)
    np.testing.assert_allclose(trace(figure, "reference").x, [2.0])
    assert not figure.layout.annotations


def test_forest_draws_intervals_with_unequal_sides_as_they_are():
    info = fit_info(weak=False)
    half = 1.96 * info.std
    limits = np.column_stack([info.values - half, info.values + 1.5 * half])
    limits[0] = info.values[0] * np.array([-3.0, 1.5])
    profiled = ProfileInfo(**vars(info), limits=limits)
    figure = forest(profiled)
    lines = [t for t in figure.data if t.mode == "lines"]
    for k in range(1, len(info.names)):
        wanted = 100 * (limits[k] - info.values[k]) / abs(info.values[k])
        np.testing.assert_allclose(lines[k].x, wanted, rtol=1e-5)
    [note] = figure.layout.annotations
    assert note.text == "-400 to +50 %"
    [arrow] = [t for t in figure.data if t.mode == "markers" and "triangle" in str(t.marker.symbol)]
    assert list(arrow.marker.symbol) == ["triangle-left"]


@pytest.mark.parametrize("spread", [4.0, np.inf, np.nan])
def test_forest_says_how_wide_an_interval_is_that_does_not_fit(spread):
    info = fit_info(weak=False)
    covariance = info.covariance.copy()
    covariance[0, 0] = (spread * info.values[0]) ** 2
    figure = forest(dataclasses.replace(info, covariance=covariance))
    [note] = figure.layout.annotations
    assert note.text == ("±784 %" if spread == 4.0 else "unbounded")
    assert np.isfinite(figure.layout.xaxis.range).all()


def test_forest_and_table_say_the_ends_of_an_interval_around_nothing():
    """No share of 0 is: an estimate at its bound has its interval in its own unit, on the side on which it lies."""
    info = fit_info(weak=False)
    names, units = ("C_f", "downforce_f", "steering_offset"), ("N/rad", "kg/m", "rad")
    limits = np.array([[0.9, 1.1], [0.0, 0.2], [-0.01, 0.01]])
    changed = {"names": names, "units": units, "values": np.array([1.0, 0.0, 1e-9]), "covariance": 0.01 * np.eye(3)}
    profiled = ProfileInfo(**{**vars(info), **changed}, limits=limits)
    figure = forest(profiled)
    assert [note.text for note in figure.layout.annotations] == ["0 to 0.20 kg/m", "-0.57 to 0.57 deg"]
    spans = [np.asarray(t.x) for t in figure.data if t.mode == "lines"]
    assert spans[0] == pytest.approx([-10.0, 10.0])
    assert (spans[1][0], spans[1][1] > 10) == (0.0, True)
    assert spans[2][0] == -spans[2][1]
    rows = [row[2:] for row in parameter_table(profiled).texts()]
    assert rows[1:] == [["0", "0", "0.20", "n/a"], ["0", "-0.57", "0.57", "n/a"]]


def test_signals_stack_on_one_time_axis_with_limits_inside_the_range():
    t = np.arange(0, 5, 0.05)
    figure = signals(
        t,
        [
            Signal(channel=Channel("delta", "rad"), values=0.02 * np.sin(t), lower=-0.3, upper=0.3, held=True),
            Signal(channel=Channel("v_x", "m/s"), values=20 + t, reference=np.full(len(t), 22.0)),
        ],
        spans=(Span(start=0, end=3, label="training"),),
    )
    assert figure.layout.xaxis.anchor == "y2"
    assert figure.layout.yaxis.domain[0] > figure.layout.yaxis2.domain[1]
    assert figure.layout.yaxis.range[0] < -0.3
    assert figure.layout.yaxis.range[1] > 0.3
    assert trace(figure, "delta").line.shape == "hv"
    assert {a.text for a in figure.layout.annotations} == {"limit 0.3", "limit -0.3", "training"}
    with pytest.raises(ParameterError, match="'delta' has 3 samples"):
        signals(t, [Signal(channel=Channel("delta", "rad"), values=np.zeros(3))])
    with pytest.raises(ParameterError, match="no signal"):
        signals(t, [])


def test_track_map_has_equal_axes_and_a_colour_bar_with_unit():
    phase = np.linspace(0, 2 * np.pi, 9000)
    error = 0.01 * np.sin(7 * phase)
    error[4321] = -0.5
    figure = track_map(300 * np.cos(phase), 200 * np.sin(phase), error, channel=YAW_RATE)
    dots = figure.data[1]
    assert figure.layout.yaxis.scaleanchor == "x"
    assert dots.marker.colorbar.title.text == "absolute error of yaw rate r [rad/s]"
    assert np.max(dots.marker.color) == pytest.approx(0.5)
    assert len(dots.x) <= 4000
    signed = track_map(phase, phase, error, channel=YAW_RATE, signed=True).data[1]
    assert (signed.marker.cmin, signed.marker.cmax) == (-0.5, 0.5)
    with pytest.raises(ParameterError, match="no value is finite"):
        track_map(phase, phase, np.full(9000, np.nan), channel=YAW_RATE)


def test_track_map_of_a_standing_car():
    figure = track_map(np.zeros(5), np.zeros(5), np.zeros(5), channel=YAW_RATE)
    assert len(figure.data) == 2


def test_outlines_of_the_vehicle_are_rectangles_of_its_size():
    t = np.linspace(0, 1, 300)
    X, Y = 40 * np.sin(t), 40 * (1 - np.cos(t))
    figure = path_map(X, Y, t, body=Body(front=2.0, rear=1.0, width=1.6), outlines=5)
    box = trace(figure, "vehicle")
    corners = np.column_stack([box.x, box.y]).reshape(-1, 6, 2)
    assert len(corners) == 5
    assert np.isnan(corners[:, 5]).all()
    side = np.linalg.norm(np.diff(corners[:, :5], axis=1), axis=2)
    np.testing.assert_allclose(side, np.tile([1.6, 3.0, 1.6, 3.0], (5, 1)), rtol=1e-4)
    front = corners[:, :2].mean(axis=1) - corners[:, 2:4].mean(axis=1)
    heading = np.arctan2(front[:, 1], front[:, 0])
    np.testing.assert_allclose(heading, np.linspace(0, 1, 5), atol=0.01)
    assert figure.layout.yaxis.scaleanchor == "x"  # not elongated


def test_a_map_far_from_its_origin_is_as_fine_as_one_near_it():
    """A swerve in metres of a map projection, 5 300 km north, whose neighbours differ by millimetres."""
    s = np.linspace(0, 200, 400)
    swerve = 1.75 * (1 - np.cos(s * np.pi / 100))
    for north in (0.0, 5.3e6):
        for figure in (
            path_map(s + 6.9e5, swerve + north, 0 * s),
            track_map(s + 6.9e5, swerve + north, s, channel=YAW_RATE),
        ):
            y = np.asarray(figure.data[-1].y, dtype=float) - north
            assert y == pytest.approx(swerve, abs=1e-3)
    assert compact(np.linspace(0, 1, 9)).dtype == compact(np.full(3, 0.1)).dtype == np.float32


def test_long_courses_say_that_they_are_stretched():
    X = np.linspace(0, 125, 200)
    figure = path_map(X, np.zeros(200), np.zeros(200), left=np.array([[0, 2], [125, 2]]), right=np.array([[0, -2.0]]))
    assert "stretched" in figure.layout.yaxis.title.text
    assert figure.layout.yaxis.scaleanchor is None
    assert sum(bool(t.showlegend) for t in figure.data if t.name == "lane boundary") == 1


def test_solver_time_marks_failures_and_deadline():
    seconds = np.full(50, 2e-3)
    failed = np.zeros(50, dtype=bool)
    failed[7] = True
    figure = solver_time(seconds, deadline=0.05, failed=failed)
    assert trace(figure, "not solved (1)").x.tolist() == [7]
    assert list(trace(figure, "deadline 50 ms").y) == [50, 50]
    low, high = figure.layout.yaxis.range
    assert 10**low < 2 < 50 < 10**high
    with pytest.raises(ParameterError, match="'failed' has 3"):
        solver_time(seconds, deadline=0.05, failed=failed[:3])


@pytest.mark.parametrize("seconds", [np.full(10, 1e-3), np.geomspace(1e-6, 3, 500), np.array([0.02])])
def test_solver_histogram_counts_every_step(seconds):
    figure = solver_histogram(seconds, deadline=0.05)
    assert np.sum(figure.data[0].y) == len(seconds)
    assert 2 <= len(figure.layout.xaxis.tickvals) <= 9
    with pytest.raises(ParameterError, match="no solver time"):
        solver_histogram(np.zeros(3), deadline=0.1)
