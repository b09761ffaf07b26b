"""Free runs side by side: what counts, what fills up, what is thrown off."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.identify.judge.initial import restarted
from slipangle.identify.networks.runs import side_by_side


def record(n):
    return Dataset.from_arrays({"u": np.arange(1.0, n + 1)}, {"y": np.arange(1.0, n + 1) ** 2}, 0.05)


@pytest.mark.parametrize("lead", [0, 4])
def test_every_sample_after_the_first_lead_counts_once(lead):
    data, memory = record(57), 3
    runs = side_by_side(restarted(data, 0.5, memory + lead), memory, np.array([2.0]), lead=lead)
    counts = runs.weight[:, :, 0] > 0
    assert np.array_equal(runs.y[counts][:, 0], data["y"][memory + lead :])
    assert runs.n_counting == 57 - memory - lead
    assert set(runs.weight.ravel()) == {0.0, 2.0}


def test_shorter_runs_are_filled_up_with_their_last_input():
    runs = side_by_side(join(record(8), record(5)), 2, np.array([1.0]))
    assert runs.u[1, :, 0].tolist() == [2, 3, 4, 5, 5, 5, 5]
    assert runs.weight[1, :, 0].tolist() == [1, 1, 1, 0, 0, 0]
    assert [head.n_samples for head in runs.heads] == [2, 2]


def test_starts_are_thrown_off_within_bounds_and_only_where_runs_may_settle():
    data, away = restarted(record(400), 0.5, 3), np.array([2.0, 0.5, 0.0])
    thrown = side_by_side(data, 1, np.ones(1), lead=2, away=away).away
    assert np.all(np.abs(thrown) <= away)
    assert np.all(np.abs(thrown).max(axis=0) >= 0.9 * away)
    assert thrown == pytest.approx(side_by_side(data, 1, np.ones(1), lead=2, away=away).away)
    assert not side_by_side(data, 1, np.ones(1), away=away).away.any()
