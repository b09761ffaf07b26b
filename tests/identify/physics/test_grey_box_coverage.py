"""Intervals of grey boxes hold the truth, whatever the colour of the noise: two models, one record and several."""

import warnings

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.data.dataset import join
from slipangle.errors import IdentifiabilityWarning
from slipangle.identify.physics.grey_box import GreyBox
from tests.identify.physics.test_grey_box import CASES, drive

NOISE = {
    "white": ([1.0], [1.0]),
    "AR(1) 0.5": ([1.0], [1.0, -0.5]),
    "AR(1) 0.9": ([1.0], [1.0, -0.9]),
    "mean of 20": (np.ones(20), [1.0]),
}


def noisy(data, kind, rng, size=0.05):
    """Noise of a colour on every output, the first sample too, from which the free run starts."""
    numerator, denominator = NOISE[kind]
    power = np.sqrt(np.sum(lfilter(numerator, denominator, np.eye(1, 500)[0]) ** 2))
    n = len(data)
    for output in data.outputs:
        noise = lfilter(numerator, denominator, rng.standard_normal(n + 400))[400:] / power
        data = data.with_channel(output, data[output] + size * np.std(data[output]) * noise)
    return data


@pytest.mark.parametrize(
    ("case", "n", "parts", "kind", "sets"),
    [
        ("bicycle", 300, 1, "AR(1) 0.9", 60),
        ("longitudinal", 250, 4, "AR(1) 0.9", 30),
        *(
            pytest.param(case, n, parts, kind, 150, marks=pytest.mark.slow)
            for case, n, parts in (("bicycle", 300, 1), ("bicycle", 150, 6), ("longitudinal", 250, 4))
            for kind in NOISE
        ),
        pytest.param("bicycle with v_y", 600, 1, "AR(1) 0.9", 60, marks=pytest.mark.slow),
    ],
)
def test_intervals_hold_whatever_the_colour(case, n, parts, kind, sets):
    """At least 93 % in the long run, less three standard deviations of the count, and about as wide as the scatter."""
    model, free = CASES[case]
    rng, off, std = np.random.default_rng(0), [], []
    true = np.array([model.value(name) for name in free])
    for seed in range(sets):
        data = join(*(noisy(drive(model, n=n, seed=seed * parts + i), kind, rng) for i in range(parts)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", IdentifiabilityWarning)
            info = GreyBox(start=model, free=free).fit(data).fit_info
        off.append(info.values - true)
        std.append(info.std)
    rates = np.mean(np.abs(off) <= 1.96 * np.array(std), axis=0)
    assert (rates >= 0.93 - 3 * np.sqrt(0.93 * 0.07 / sets)).all(), rates
    assert (np.median(std, axis=0) < 1.4 * np.std(off, axis=0)).all()
