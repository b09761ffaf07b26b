"""Grip against temperature and wear: what was put into the data comes out, whatever the load."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.data.readers.ttc import from_channels
from slipangle.errors import ParameterError
from slipangle.report.tire_grip import distance, grip, grip_figure
from slipangle.report.tires import tire_page
from tests.rig import TIRE, UNITS, channels

RUN = from_channels(channels(), UNITS, name="rig")


def changed(temperature=None, lost=0.0):
    """Grip falls by 1 % per 4 degC above 60, and evenly by ``lost`` over the run."""
    n = RUN.n_samples
    heat = np.full(n, 60.0) if temperature is None else temperature
    factor = (1 - (heat - 60.0) / 400.0) * np.linspace(1.0, 1.0 - lost, n)
    return replace(RUN, F_y=RUN.F_y * factor, temperature=heat, time=0.01 * np.arange(n))


def test_grip_over_temperature():
    heat = np.random.default_rng(0).uniform(40, 100, RUN.n_samples)
    found = grip(TIRE, changed(heat), "temperature")
    assert found.median == pytest.approx(1 - (found.at - 60) / 400, abs=0.01)
    assert np.all((found.low < found.median) & (found.median < found.high))
    assert found.at[0] < 50 < 90 < found.at[-1]


def test_grip_over_distance():
    data = changed(lost=0.1)
    rolled = distance(data)
    assert rolled[-1] == pytest.approx(0.01 * (data.n_samples - 1) * 40 / 3.6, rel=1e-3)
    found = grip(TIRE, data, "distance")
    assert found.median == pytest.approx(1 - 0.1 * found.at * 1e3 / rolled[-1], abs=0.015)


def test_time_that_was_cut_does_not_count():
    data = changed()
    kept = data.rows(np.r_[0:1000, 3000 : data.n_samples])
    assert distance(kept)[-1] == pytest.approx(distance(data)[-1] * (len(kept) - 2) / (data.n_samples - 1), rel=1e-2)


def test_the_figure_and_the_page_have_it():
    data = changed(np.random.default_rng(0).uniform(40, 100, RUN.n_samples))
    figure = grip_figure(TIRE, data, "temperature")
    found = grip(TIRE, data, "temperature")
    median = next(t for t in figure.data if t.name == "median" and t.mode == "lines")
    assert np.asarray(median.y) == pytest.approx(found.median)
    html = tire_page(TIRE, title="tire", data=data).to_html()
    assert "Grip over tread temperature" in html
    assert "Grip over distance rolled" in html
    assert (
        "Grip over tread temperature" not in tire_page(TIRE, title="t", data=replace(data, temperature=None)).to_html()
    )


def test_what_is_missing_is_named():
    with pytest.raises(ParameterError, match="'rig' holds no temperature"):
        grip(TIRE, replace(RUN, temperature=None), "temperature")
    with pytest.raises(ParameterError, match="'rig' holds no time and speed"):
        grip(TIRE, replace(RUN, time=None), "distance")
    with pytest.raises(ParameterError, match="samples near the limit of friction"):
        grip(TIRE, changed().rows(slice(0, 60)), "distance")
