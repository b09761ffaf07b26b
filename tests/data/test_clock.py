"""Time stamps to a grid: any rate, any gaps, any rounding."""

import numpy as np
import pytest

from slipangle import errors
from slipangle.data.clock import find_grid


@pytest.mark.parametrize("rate", [1.0, 7.0, 20.0, 29.97, 60.0, 100.0, 1000.0])
@pytest.mark.parametrize("decimals", [3, 6, 15])
@pytest.mark.parametrize("start", [0.0, 149.99, 1.7e9])
@pytest.mark.parametrize("seed", [0, 1])
def test_grids_with_gaps_are_recovered(rate, decimals, start, seed):
    if decimals == 3 and rate > 60:
        decimals = 4
    rng = np.random.default_rng(seed)
    lengths = rng.integers(20, 200, size=4)
    pauses = np.array([0.0, *(rng.uniform(2.0, 30.0, 3) / rate)])
    begins = start + np.cumsum(np.concatenate([[0], lengths[:-1] / rate])) + np.cumsum(pauses)
    t = np.round(np.concatenate([b + np.arange(n) / rate for b, n in zip(begins, lengths, strict=True)]), decimals)
    grid = find_grid(t)
    edges = np.concatenate([[0], np.cumsum(lengths)])
    assert grid.pieces == tuple(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    assert grid.dt == pytest.approx(1 / rate, rel=2e-4)
    assert grid.exact
    values, starts = grid.onto(t, np.arange(len(t))[:, None])
    np.testing.assert_array_equal(values[:, 0], np.arange(len(t)))
    assert starts == tuple(edges[:-1].tolist())


@pytest.mark.parametrize(("rate", "dt"), [(100.0, 0.01), (20.0, 0.05), (60.0, 1 / 60), (25.0, 0.04)])
def test_round_rates_come_out_round(rate, dt):
    t = np.round(np.arange(400) / rate, 3) + 3.0
    assert find_grid(t).dt == dt


@pytest.mark.parametrize("first", [0.01, 0.02, 0.1])
@pytest.mark.parametrize("second", [0.005, 0.02, 0.05])
@pytest.mark.parametrize("n", [8, 100])
def test_two_rates_are_never_mixed(first, second, n):
    t = np.concatenate([first * np.arange(100), 100 * first + second * np.arange(n)])
    if first == second:
        assert find_grid(t).dt == first
        return
    with pytest.raises(errors.TimeError, match=r"(sample 99|sample 100|sample 101) .*from|changes its sample time"):
        find_grid(t)


def test_a_single_dropped_sample_is_a_gap_not_a_rate():
    t = np.delete(0.01 * np.arange(200), [20, 21, 90, 150])
    grid = find_grid(t)
    assert [b - a for a, b in grid.pieces] == [20, 68, 59, 49]
    assert grid.dt == 0.01


def test_short_pieces_are_dropped_aloud():
    t = np.delete(0.01 * np.arange(100), [50, 52])
    grid = find_grid(t, shortest=5)
    assert grid.pieces == ((0, 50), (51, 98))
    assert any("1 stretches too short to use were dropped, 1 samples" in n for n in grid.notes)
