"""Intervals: how many independent samples their hits are worth, and how far their coverage may be from its level."""

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.identify.judge.intervals import Calibration, coverage_error, effective_samples
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM
from slipangle.reproduce.table_8_2 import coverage_record
from tests.identify.physics.test_grey_box import drive

RHO = 0.9


def coloured(rng, n):
    """First-order noise of unit variance, from its stationary distribution on."""
    e = rng.standard_normal(n) * np.sqrt(1 - RHO**2)
    e[0] /= np.sqrt(1 - RHO**2)
    return lfilter([1.0], [1.0, -RHO], e)


def test_effective_samples_of_noise_are_those_of_theory():
    rng = np.random.default_rng(0)
    assert effective_samples(rng.standard_normal(20000)) == pytest.approx(20000, rel=0.1)
    several = [effective_samples(coloured(rng, 20000)) for _ in range(20)]
    assert np.median(several) == pytest.approx(20000 * (1 - RHO) / (1 + RHO), rel=0.1)


@pytest.mark.parametrize("values", [np.ones(50), np.zeros(3), np.ones(1), np.arange(101) % 2])
def test_effective_samples_are_never_more_than_the_samples(values):
    assert effective_samples(values) == len(values)


def test_coverage_scatters_as_its_standard_error_says():
    """Widths calibrated on one coloured record, tried on another: 95 % of the coverages are within 1.96 errors."""
    rng, apart, errors = np.random.default_rng(1), [], []
    for _ in range(300):
        seen, new = np.abs(coloured(rng, 3000)), np.abs(coloured(rng, 4000))
        width = Calibration(scores=np.sort(seen)[:, None], floor=np.ones(1), share=0.0).width(0.9)[0]
        apart.append(np.mean(new <= width) - 0.9)
        errors.append(coverage_error(0.9, effective_samples(new <= width), effective_samples(seen <= width)))
    assert np.std(apart) == pytest.approx(np.mean(errors), rel=0.2)
    assert np.mean(np.abs(apart) <= 1.96 * np.array(errors)) == pytest.approx(0.95, abs=0.04)


@pytest.mark.parametrize(("larger", "holds"), [(1.0, True), (0.5, False), (2.0, False)])
def test_the_bound_of_the_coverage_refuses_intervals_of_the_wrong_width(larger, holds):
    model, rng = Bicycle(params=FERRARI_250LM, dt=0.05), np.random.default_rng(2)
    clean = drive(model, n=4000).select(outputs=("r",))
    seen, new = (clean.with_channel("r", clean["r"] + 0.01 * s * coloured(rng, 4000)) for s in (1.0, larger))
    found = coverage_record([(model, seen)], model, new)
    assert found.holds is holds
    assert "independent samples" in found.note
    low, high = map(float, found.bound.split(" to "))
    assert 100 - high == pytest.approx(low - 80, abs=0.2)
    assert 85 < low < 89
