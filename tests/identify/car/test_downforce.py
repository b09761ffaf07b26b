"""Downforce of a car from a log of it, by equations of its own, and what is said where there is none."""

import re
from dataclasses import replace

import numpy as np
import pytest

from slipangle.identify.car.corrections import DOWNFORCE, corrections, friction_used
from slipangle.identify.car.effects import extrapolated, told, wings
from slipangle.identify.car.identify_car import identify_car
from slipangle.identify.car.structures import STIFF, first_guess, fit
from tests.identify.car.test_identify_car import DT, KNOWN, OUTPUTS, TRUE, drives, log

WINGED = TRUE | dict(downforce_f=3.0, downforce_r=5.0)


def test_it_is_found_with_the_stiffness_at_rest():
    """At 26 m/s it is a third of the front's load; taken for none, it made the car quicker and stiffer."""
    found = identify_car(drives(true=WINGED), **KNOWN)
    for name in ("C_f", "C_r", "inertia_z", "downforce_f", "downforce_r"):
        low, high = found.interval(name)
        assert low <= WINGED[name] <= high, name
    assert found.interval("downforce_r")[0] > 0
    said = next(s for s in found.sentences if s.startswith("stiffness and grip grow with speed"))
    fastest = max(drives()["v_x"])
    ratio = re.search(r"at 26 m/s they are ([0-9.]+) and", said)
    front = 1 + found.model.value("downforce_f") * fastest**2 / (1300 * 9.81 * 1.4 / 2.6)
    assert float(ratio[1]) == pytest.approx(front, abs=0.006)


@pytest.mark.parametrize(("front", "rear", "wings"), [(3.0, 5.0, True), (0.0, 0.0, False), (-3.0, -4.0, False)])
def test_only_what_wings_would_do_is_told(front, rear, wings):
    """Neither the little that noise makes of none nor lift that takes a third of a load."""
    guess = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0).with_values(mu_f=0.9, mu_r=1.0)
    at_once = dict(delay=0.0, lag=0.002, gain=1.0, offset=0.0)
    data = drives(true=TRUE | dict(downforce_f=front, downforce_r=rear), steering=at_once)
    final = fit(guess, (*STIFF, *DOWNFORCE), data)
    assert final.values["downforce_r"] == pytest.approx(rear, abs=1.0)  # the angle is held between samples
    assert (told(final, DOWNFORCE) > 1) == wings


def test_values_at_rest_are_as_unsure_as_the_way_there_from_slow_driving():
    guess = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0)
    final = fit(guess, STIFF, drives())
    assert extrapolated(final) == {}
    winged = replace(final, free=(*STIFF, *DOWNFORCE), model=final.model.with_values(downforce_f=2.0, downforce_r=-1.0))
    front, rear = 2.0 * 10.0**2 / (1300 * 9.81 * 1.4 / 2.6), 1.0 * 10.0**2 / (1300 * 9.81 * 1.2 / 2.6)
    assert extrapolated(winged) == pytest.approx({"C_f": front, "mu_f": front, "C_r": rear, "mu_r": rear})


def test_it_is_tried_only_where_speeds_differ():
    free = {name for correction in corrections(drives(), 2.6, None) for name in correction.free}
    assert "downforce_f" in free
    alike = drives().with_channel("v_x", 20.0 + 0.1 * drives()["v_x"], "m/s")
    assert "downforce_f" not in {name for correction in corrections(alike, 2.6, None) for name in correction.free}


def test_friction_beyond_tires_is_said_to_need_wings_and_with_downforce_it_is_that_of_the_load():
    guess = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0)
    fast = log(40.0, 0, noise=0.0).hold_mean()
    final = fit(guess, STIFF, fast)
    assert wings(final, np.zeros((3, 2)), 1.2) == []
    assert "if the car has wings" in wings(final, np.zeros((3, 2)), 1.3)[0]
    used = np.quantile(np.abs(fast["v_x"] * fast["r"]), 0.999) / 9.81
    assert friction_used(fast) == pytest.approx(used, rel=1e-12)
    winged = final.model.with_values(downforce_f=1.0, downforce_r=3.0).ode.params
    assert friction_used(fast, winged) == pytest.approx(used / (1 + 4.0 * 40.0**2 / (1300 * 9.81)), rel=1e-9)
