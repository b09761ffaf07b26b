"""The shape of the tire curves: from hard driving it has a value; what they leave open is in the intervals."""

import pytest

from slipangle.identify.car.identify_car import identify_car
from tests.identify.car.test_identify_car import KNOWN, TRUE, drives

PEAKY = TRUE | dict(shape=1.8)
FOUND = ("C_f", "C_r", "inertia_z", "mu_f", "mu_r")


def within(car, true, names):
    for name in names:
        low, high = car.interval(name)
        assert low <= true[name] <= high, name


def test_hard_driving_tells_it():
    car = identify_car(drives(amplitude=0.2, true=PEAKY), **KNOWN)
    within(car, PEAKY, (*FOUND, "shape"))
    assert car.interval("shape")[0] > 1.4
    assert car.model.value("mu_f") == pytest.approx(0.9, rel=0.03)
    assert any("shape of the tire curves" in said for said in car.sentences)


def test_where_it_does_not_show_friction_is_as_unsure_as_it():
    """A fit with the usual shape has a tenth more friction than these tires."""
    car = identify_car(drives(amplitude=0.16, true=PEAKY), **KNOWN)
    assert "shape" not in car.model.fit_info.names
    assert car.model.value("mu_f") > 1.05 * PEAKY["mu_f"]
    within(car, PEAKY, FOUND)


def test_tires_that_yield_as_a_brush_are_in_the_intervals():
    """A Magic Formula fits them as well, with a smaller slope at no slip, which no log shows."""
    true = TRUE | dict(brush=1.0)
    car = identify_car(drives(amplitude=0.12, true=true), **KNOWN)
    assert car.model.value("C_f") < 0.96 * TRUE["C_f"]
    assert car.model.value("brush") == 0.0
    within(car, true, ("C_f", "C_r", "inertia_z"))
