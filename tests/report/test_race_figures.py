"""Figures of chapter 8 and of a search: they draw the numbers that the functions behind them give."""

import numpy as np
import pytest

from slipangle.data.dataset import Channel
from slipangle.data.race import Corner
from slipangle.errors import ParameterError
from slipangle.identify.search.search import SearchResult, TrialResult
from slipangle.report.race import error_by_level, error_by_phase, share_map
from slipangle.report.search import parallel_coordinates, search_table, search_verdict

RATE = Channel("r", "rad/s")
CORNERS = (Corner(start=2, stop=8, apex=5, left=True),)


def test_bars_are_the_rmse_of_each_phase():
    error = np.array([0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 2.0, 3.0, np.nan, 0.0])
    figure = error_by_phase({"a": error, "b": 2 * error}, CORNERS, channel=RATE)
    assert [bar.name for bar in figure.data] == ["a", "b"]
    assert list(figure.data[0].x) == ["straight", "entry", "middle", "exit"]
    a, b = (np.array(bar.y, dtype=float) for bar in figure.data)
    assert a[0] == 0
    assert a[1] == pytest.approx(1.0)
    assert b == pytest.approx(2 * a)
    assert figure.layout.yaxis.title.text == "RMSE of r [rad/s]"
    with pytest.raises(ParameterError, match="no model"):
        error_by_phase({}, CORNERS, channel=RATE)


def test_lines_are_the_rmse_of_each_level():
    level = np.array([0.5, -0.5, 1.5, -1.5, 1.7])
    error = np.array([1.0, 1.0, 3.0, 3.0, np.nan])
    edges = np.array([0.0, 1.0, 2.0])
    figure = error_by_level({"a": error}, level, edges, channel=RATE, sorted_by=Channel("a_y", "m/s2"))
    assert list(figure.data[0].x) == [0.5, 1.5]
    assert list(figure.data[0].y) == pytest.approx([1.0, 3.0])
    assert figure.layout.xaxis.title.text == "size of the lateral acceleration [m/s²]"


def test_share_is_a_map_in_percent():
    t = np.linspace(0, 6, 50)
    share = np.where(t < 1, np.nan, 10 * t)
    figure = share_map(np.cos(t), np.sin(t), share)
    dots = figure.data[1]
    assert max(dots.marker.color) == pytest.approx(60.0)
    assert len(dots.x) == np.isfinite(share).sum()
    assert dots.marker.colorbar.title.text == "share of the discrepancy [%]"


def trial(number, score, failure="", **settings):
    return TrialResult(number=number, settings=settings, score=score, seconds=1.0, failure=failure)


RESULT = SearchResult(
    trials=(
        trial(0, 0.3, na=2, rate=1e-4, act="elu"),
        trial(1, 0.1, na=8, rate=1e-2, act="tanh"),
        trial(2, float("inf"), "ValueError: no", na=5, rate=1e-3, act="elu"),
        trial(3, float("inf"), "given up at step 1: 0.5, where", na=5, rate=1e-3, act="elu"),
        trial(4, 9.0, na=5, rate=1e-3, act="elu"),
    )
)


def test_parallel_coordinates_have_a_line_per_score_the_best_on_top():
    figure = parallel_coordinates(RESULT)
    assert [line.name for line in figure.data] == ["trial 4", "trial 0", "trial 1"]
    best, worst = figure.data[-1], figure.data[0]
    assert list(best.y) == pytest.approx([1.0, 1.0, 1.0, 0.0])
    assert worst.y[-1] == 1.0
    assert list(figure.data[1].y)[:3] == pytest.approx([0.0, 0.0, 0.0])
    assert worst.y[1] == pytest.approx(0.5)  # the rate's axis is logarithmic
    texts = [a.text for a in figure.layout.annotations]
    assert {"<b>na</b>", "<b>score</b>", "elu", "tanh"} <= set(texts)
    with pytest.raises(ParameterError, match="none of 2 trials"):
        parallel_coordinates(SearchResult(trials=RESULT.trials[2:4]))


def test_search_table_has_reasons_and_counts():
    table = search_table(RESULT, command="slipangle search job.toml")
    assert [row.cells[0] for row in table.rows][:3] == [1, 0, 4]
    assert table.rows[0].tone == "good"
    assert {row.note: row.tone for row in table.rows if row.note} == {
        "ValueError: no": "poor",
        "given up at step 1: 0.5, where": None,
    }
    assert table.caption.startswith("5 trials, 1 given up on the way, 1 failed.")
    assert "4 more are in the journal" in search_table(RESULT, rows=1).caption
    assert "0.1000" in table.to_text()


@pytest.mark.parametrize(
    ("linear", "tone", "says"),
    [
        (None, "fair", "The next best trial has"),
        (0.2, "good", "50 % less than a linear model"),
        (0.102, "fair", "only 2.0 % more"),
        (0.09, "poor", "errs less: take that"),
    ],
)
def test_a_search_is_judged_beside_a_linear_model(linear, tone, says):
    verdict = search_verdict(RESULT, linear)
    assert (verdict.tone, verdict.sentence.count("Trial 1 errs least")) == (tone, 1)
    assert says in verdict.sentence
    assert "a fit of 90.0 %" in verdict.sentence
