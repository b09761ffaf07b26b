"""A steering sensor that is cut off at an end of its range is named, one that is held at its largest angle is not."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.data.quality.plausible import doubts
from tests.data.quality.test_lateness import DT, LENGTH, driven, log


@pytest.mark.parametrize("noise", [0.0, 5e-4])
@pytest.mark.parametrize("share", [0.5, 0.7])
def test_a_steering_that_is_cut_off_is_named(noise, share):
    def cut(delta):
        end = share * np.quantile(np.abs(delta), 0.995)
        return np.clip(delta, -end, end) + noise * np.random.default_rng(5).standard_normal(len(delta))

    said = doubts(log(("r",), 1, delta=cut), wheelbase=LENGTH)
    ends = [float(s.split(" deg, where r asks for ")[0].removeprefix("delta goes no further than ")) for s in said]
    end = np.rad2deg(share * np.quantile(np.abs(driven(1)["delta"]), 0.995))
    assert [abs(one) for one in ends] == pytest.approx([end] * len(ends), rel=0.05)
    assert len(ends) == (2 if share < 0.6 else 1)  # the right-hand end is reached in fewer than three bends then


def test_a_steering_that_is_held_at_its_largest_angle_is_not_cut_off():
    """As in steps of one size: r rises behind each, and rests with it."""
    t = np.arange(4500) * DT
    delta = 0.03 * np.sign(np.sin(2 * np.pi * t / 6.0)) * (np.sin(2 * np.pi * t / 3.0) > 0)
    r = np.empty(len(t))
    state = 0.0
    for k, angle in enumerate(delta):
        state += (17.0 * angle / LENGTH / 1.4 - state) * DT / 0.2
        r[k] = state + 0.003 * np.sin(97.0 * k)
    data = Dataset.from_arrays({"delta": delta, "v_x": np.full(len(t), 17.0)}, {"r": r}, DT)
    assert doubts(data, wheelbase=LENGTH) == ()
