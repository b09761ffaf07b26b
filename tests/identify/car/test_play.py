"""Play of the steering is told from delay and lag, with its width; of a steering without any there is none."""

import re

import numpy as np
import pytest

from slipangle.data.dataset import join
from slipangle.identify.car.corrections import corrections
from slipangle.identify.car.play import in_words, taken_up
from slipangle.identify.car.stretches import stretches
from slipangle.identify.car.structures import STIFF, corrected, first_guess, fit
from tests.identify.car.test_identify_car import KNOWN, log
from tests.identify.car.test_identify_car import drives as of_car

WIDTH = np.deg2rad(1.0)


def drives(outputs):
    return of_car((10.0, 16.0, 22.0), outputs=outputs, seconds=16.0)


def logged_before(data, width):
    """The log of a hand that steers through play as far as the wheels of ``data`` go: half of it ahead, either way."""
    parts = []
    for part in data.experiments:
        delta = part["delta"]
        side = np.sign(np.gradient(np.convolve(np.pad(delta, 3, "edge"), np.ones(7) / 7, "valid")))
        parts.append(delta + 0.5 * width * side)
    return data.with_channel("delta", np.concatenate(parts), "rad")


def fitted(data):
    """A car with delay, lag and gain of its steering."""
    cut = stretches(data, KNOWN["wheelbase"]).all
    linear = fit(first_guess(**KNOWN, dt=data.dt, outputs=data.outputs, gain=1.0), (*STIFF, "steering_offset"), cut)
    late, gain = corrections(cut, KNOWN["wheelbase"], None)[:2]
    return corrected(corrected(linear, late, cut), gain, cut), cut


@pytest.mark.parametrize("outputs", [("r",), pytest.param(("v_y", "r"), marks=pytest.mark.slow)])
def test_its_width_is_found_and_said(outputs):
    (said,) = in_words(*fitted(logged_before(drives(outputs), WIDTH)))
    found = re.search(r"the steering has play: delta goes back by ([\d.]+) deg before the wheels follow", said)
    assert np.deg2rad(float(found[1])) == pytest.approx(WIDTH, rel=0.2)


@pytest.mark.parametrize("outputs", [("r",), ("v_y", "r")])
def test_a_late_steering_has_none(outputs):
    assert in_words(*fitted(drives(outputs))) == []


def test_wheels_stay_until_play_is_taken_up_and_across_a_cut():
    data = log(16.0, 0, outputs=("r",), seconds=4.0)
    n = data.n_samples
    angle = 0.1 * np.sin(2 * np.pi * np.arange(n) / 200.0)
    data = data.with_channel("delta", angle, "rad")
    found = taken_up(data, 0.04)["delta"]
    assert found[60:140] == pytest.approx(np.minimum(0.08, angle[60:140] + 0.02), abs=1e-3)
    cut = join(data.rows(n // 2, n), data.rows(0, n // 2)).with_channel("recording", np.zeros(n), "-")
    assert taken_up(cut, 0.04)["delta"] == pytest.approx(np.roll(found, -(n // 2)), abs=1e-12)
