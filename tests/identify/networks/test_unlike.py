"""Stretches unlike the others: those that a made log hides, whole, once each."""

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.identify.networks.unlike import split_unlike

FAST = (100, 600, 1700)


def log(n=2000, dt=0.05, name="log"):
    """A weave at 20 m/s with three fast stretches of 100 samples each, and a harsh one."""
    t = np.arange(n) * dt
    v_x, r = np.full(n, 20.0), 0.1 * np.sin(t)
    for a in FAST:
        v_x[a : a + 100] = 35.0
    r[1200:1300] *= 1.5
    return Dataset.from_arrays({"v_x": v_x, "row": np.arange(float(n))}, {"r": r}, dt, name=name)


def described(data):
    return np.column_stack([data["v_x"], data["v_x"] * data["r"]])


def test_a_kind_of_manoeuvre_is_held_out_whole():
    data = log()
    seen, unseen = split_unlike(data, described(data), 100)
    assert {k for a in FAST for k in range(a, a + 100)} <= set(unseen["row"].astype(int))
    assert seen["v_x"].max() == 20.0
    assert sorted([*seen["row"], *unseen["row"]]) == list(range(2000))
    assert unseen.n_samples == 500
    for part in (*seen.experiments, *unseen.experiments):
        assert np.all(np.diff(part["row"]) == 1)
        assert part.n_samples >= 100
        assert part.t[0] == data.t[int(part["row"][0])]


def test_one_odd_stretch_makes_no_kind():
    data = log()
    r = data["r"].copy()
    r[1200:1300] *= 4.0  # much further from the others than the fast ones
    _, unseen = split_unlike(data, described(data.with_channel("r", r, "rad/s")), 100)
    assert {k for a in FAST for k in range(a, a + 100)} <= set(unseen["row"].astype(int))


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
