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
    assert len(ends) >= 1  # an end that is reached in fewer than three bends is not told


def test_a_steering_that_is_held_at_its_largest_angle_is_not_cut_off():
    """As in bends of one radius, of a rack that turns the wheels more there: r asks for more as soon as it is held."""
    t = np.arange(4500) * DT
    bend = np.clip(4.0 * np.sin(2 * np.pi * t / 9.0), -1.0, 1.0) * (np.sin(2 * np.pi * t / 18.0) > 0)
    delta = 0.03 * bend + 0.012 * np.sin(2.3 * t) * (bend == 0)
    turned = delta + 0.7 * np.sign(delta) * np.maximum(np.abs(delta) - 0.02, 0.0)
    r = 17.0 / LENGTH / 1.4 * np.interp(t - 0.1, t, turned)
    noise = np.random.default_rng(2).standard_normal((2, len(t)))
    inputs = {"delta": delta + 3e-5 * noise[0], "v_x": np.full(len(t), 17.0)}
    data = Dataset.from_arrays(inputs, {"r": r + 0.001 * noise[1]}, DT)
    assert doubts(data, wheelbase=LENGTH) == ()
