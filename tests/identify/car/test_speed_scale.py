"""A speed that is logged too large or too small: said, and counted in the intervals."""

import re

import pytest

from slipangle.identify.car.corrections import SPEED
from slipangle.identify.car.effects import told
from slipangle.identify.car.identify_car import identify_car
from slipangle.identify.car.structures import STIFF, first_guess, fit
from tests.identify.car.test_identify_car import DT, KNOWN, OUTPUTS, TRUE, drives


def scaled(gain, **how):
    """Drives whose true speed is ``gain`` times the logged one."""
    data = drives(**how)
    return data.with_channel("v_x", data["v_x"] / gain, "m/s")


@pytest.mark.parametrize(("gain", "word"), [(0.94, "large"), pytest.param(1.07, "small", marks=pytest.mark.slow)])
def test_it_is_said_with_its_scale_and_intervals_hold(gain, word):
    """Wheels of another radius: stiffness is off by as much or twice as much, beside an interval of a few percent."""
    found = identify_car(scaled(gain, seconds=16.0), **KNOWN)
    (said,) = (s for s in found.sentences if s.startswith("v_x is logged"))
    assert f" % too {word}, or r is too {word} (a gyro's scale), as the motion across tells" in said
    assert float(re.search(r"a scale of ([0-9.]+)", said)[1]) == pytest.approx(gain, abs=0.02)
    assert said in found.model.fit_info.warnings
    for name in STIFF:
        low, high = found.interval(name)
        assert low <= TRUE[name] <= high, name
    assert found.model.value("gain_v_x") == 1.0  # the log is to be mended, not the model


@pytest.mark.parametrize(("gain", "wrong"), [(0.93, True), (1.0, False)])
def test_only_what_is_more_than_a_few_percent_is_told(gain, wrong):
    guess = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0).with_values(mu_f=0.9, mu_r=1.0)
    at_once = dict(delay=0.0, lag=0.002, gain=1.0, offset=0.0)
    final = fit(guess, (*STIFF, *SPEED), scaled(gain, steering=at_once))
    assert final.values["gain_v_x"] == pytest.approx(gain, abs=0.02)  # the angle is held between samples
    assert (told(final, SPEED) > 1) == wrong
