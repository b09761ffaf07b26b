"""Stretches unlike the others: those that a made log hides, whole, once each."""

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.identify.networks.unlike import split_unlike


def log(n=2000, dt=0.05, name="log"):
    """A weave at 20 m/s with one fast and one harsh stretch of 100 samples each."""
    t = np.arange(n) * dt
    v_x, r = np.full(n, 20.0), 0.1 * np.sin(t)
    v_x[600:700] = 35.0
    r[1200:1300] *= 4.0
    return Dataset.from_arrays({"v_x": v_x, "row": np.arange(float(n))}, {"r": r}, dt, name=name)


def described(data):
    return np.column_stack([data["v_x"], data["v_x"] * data["r"]])


def test_the_fast_and_the_harsh_stretch_are_held_out():
    data = log()
    seen, unseen = split_unlike(data, described(data), 100)
    assert set(range(600, 700)) | set(range(1200, 1300)) <= set(unseen["row"].astype(int))
    assert sorted([*seen["row"], *unseen["row"]]) == list(range(2000))
    assert unseen.n_samples == 500
    for part in (*seen.experiments, *unseen.experiments):
        assert np.all(np.diff(part["row"]) == 1)
        assert part.n_samples >= 100
        assert part.t[0] == data.t[int(part["row"][0])]


def test_experiments_stay_apart_and_short_ones_whole():
    first, second = log(2000), log(150)
    data = join(first, second)
    seen, unseen = split_unlike(data, described(data), 100)
    assert seen.n_samples + unseen.n_samples == 2150
    for part in (*seen.experiments, *unseen.experiments):
        assert np.all(np.diff(part["row"]) == 1)


def test_data_too_short_to_tell_manoeuvres_apart_lose_their_last_quarter():
    data = log(160)
    seen, unseen = split_unlike(data, described(data), 100)
    assert (seen.n_samples, unseen["row"][0]) == (120, 120)
