"""Time stamps to a grid: any rate, any gaps, any rounding."""

import numpy as np
import pytest

from slipangle import errors
from slipangle.data.clock import find_grid, lost


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


@pytest.mark.parametrize("rate", [60.0, 80.0, 90.0, 100.0, 125.0, 127.0])
@pytest.mark.parametrize("start", [33000.0, 50000.0, 70000.0])
def test_stamps_of_single_precision_are_on_the_even_clock_that_they_were_rounded_from(rate, start):
    even = start + np.arange(3000) / rate  # seconds of the day, 0.0039 or 0.0078 s apart in single precision
    for t in (even.astype("f4").astype(float), np.round(even.astype("f4").astype(float), 4)):
        grid = find_grid(t)
        assert grid.dt == pytest.approx(1 / rate, rel=1e-9)
        assert grid.pieces == ((0, 3000),)
        assert grid.exact
        assert "rounded to 0.00" in grid.notes[0]
        assert f"an even clock of {1 / rate:.4g} s" in grid.notes[0]
        assert len(lost(t)) == 0
        assert find_grid(t, dt=1 / rate).pieces == ((0, 3000),)


@pytest.mark.parametrize("rate", [66.667, 80.0, 90.0])
def test_stamps_with_too_few_decimals_are_on_the_even_clock_that_they_were_rounded_from(rate):
    t = np.round(np.arange(3000) / rate, 2)
    grid = find_grid(t)
    assert (grid.pieces, grid.exact) == (((0, 3000),), True)
    assert grid.dt == pytest.approx(1 / rate, rel=1e-4)
    assert len(lost(t)) == 0


@pytest.mark.parametrize("rounded", [np.floor, np.round, np.ceil])
@pytest.mark.parametrize(("unit", "dt"), [(1.0, 0.1), (0.1, 0.02), (0.01, 0.008), (1.0, 0.013)])
@pytest.mark.parametrize("start", [0.0, 1.7e9 + 0.37])
def test_stamps_that_repeat_from_row_to_row_are_read_by_the_sample_time_that_is_given(unit, dt, start, rounded):
    t = unit * rounded((start + dt * np.arange(3000)) / unit)
    with pytest.raises(errors.TimeError, match=rf"too coarse for its rows; .* such as dt={dt}"):
        find_grid(t)
    grid = find_grid(t, dt=dt)
    assert (grid.dt, grid.pieces, grid.exact) == (dt, ((0, 3000),), True)
    assert "the rows are taken to come every" in grid.notes[0]
    with pytest.raises(errors.SampleTimeError, match=r"from row to row on average; .* as dt says, which strays"):
        find_grid(t, dt=1.02 * dt)
    held = np.delete(t, slice(1000, 1000 + int(3 * unit / dt)))  # rows are missing: even ones would be put elsewhere
    with pytest.raises(errors.SampleTimeError, match="split the log where rows are missing"):
        find_grid(held, dt=dt)


def test_a_row_written_twice_is_no_coarse_stamp():
    t = 0.01 * np.arange(3000)
    with pytest.raises(errors.TimeError, match=r"repeats at sample 11: 0\.1 s"):
        find_grid(np.insert(t, 10, t[10]), dt=0.01)


def test_a_gap_in_stamps_of_single_precision_stays_one():
    even = 70000 + 0.01 * np.r_[0:1000, 1200:3000]
    grid = find_grid(even.astype("f4").astype(float))
    assert (grid.dt, grid.pieces) == (0.01, ((0, 1000), (1000, 2800)))


def test_stamps_of_single_precision_that_lie_on_no_even_clock_are_refused():
    rng = np.random.default_rng(0)
    even = 70000 + 0.01 * np.delete(np.arange(3000), rng.choice(3000, 60, replace=False))
    with pytest.raises(errors.TimeError, match="mixes sample times"):
        find_grid(even.astype("f4").astype(float))


def test_samples_lost_at_random_are_not_taken_for_rounding():
    rng = np.random.default_rng(0)
    t = 0.01 * np.flatnonzero(rng.random(3000) > 0.12)
    grid = find_grid(t)
    assert grid.dt == 0.01
    assert len(grid.pieces) > 200
