"""The shape of the tire curves: from hard driving it has a value; what they leave open is in the intervals."""

import pytest

from slipangle.identify.car.corrections import corrections
from slipangle.identify.car.effects import others_as_good
from slipangle.identify.car.identify_car import identify_car
from slipangle.identify.car.structures import STIFF, first_guess, fit
from slipangle.identify.car.uncertainty import hull
from tests.identify.car.test_identify_car import KNOWN, TRUE, drives

AT_ONCE = dict(delay=0.0, lag=1e-6, gain=1.0, offset=0.0)
PEAKY = TRUE | dict(shape=1.8)
FOUND = ("C_f", "C_r", "inertia_z", "mu_f", "mu_r")


def within(car, true, names):
    for name in names:
        low, high = car.interval(name)
        assert low <= true[name] <= high, name


def test_hard_driving_tells_it():
    car = identify_car(drives(amplitude=0.2, true=PEAKY, seconds=12.0), **KNOWN)
    within(car, PEAKY, (*FOUND, "shape"))
    assert car.interval("shape")[0] > 1.4
    assert car.model.value("mu_f") == pytest.approx(0.9, rel=0.03)
    assert any("shape of the tire curves" in said for said in car.sentences)


def saturating(data):
    """The fit of a bicycle whose tires have the usual shape."""
    guess = first_guess(**KNOWN, dt=data.dt, outputs=data.outputs, gain=1.0).with_values(mu_f=0.8, mu_r=0.8)
    return fit(guess, (*STIFF, "steering_offset", "mu_f", "mu_r"), data)


def test_where_it_does_not_show_another_one_is_in_the_intervals():
    """A fit with the usual shape has a tenth more friction than these tires."""
    data = drives(amplitude=0.16, true=PEAKY, steering=AT_ONCE)
    found = saturating(data)
    assert found.values["mu_f"] > 1.05 * PEAKY["mu_f"]
    (shape,) = (c for c in corrections(data, KNOWN["wheelbase"], None) if c.free == ("shape",))
    others = [(other, share) for other, share in others_as_good(found, [shape], data) if "shape" in other.free]
    *_, limits, _ = hull(found.names, found, others)
    low, high = limits[found.names.index("mu_f")]
    assert low <= PEAKY["mu_f"] <= high


@pytest.mark.slow
def test_where_it_does_not_show_friction_is_as_unsure_as_it():
    car = identify_car(drives(amplitude=0.16, true=PEAKY), **KNOWN)
    assert "shape" not in car.model.fit_info.names
    assert car.model.value("mu_f") > 1.05 * PEAKY["mu_f"]
    within(car, PEAKY, FOUND)


def test_tires_that_yield_as_a_brush_are_in_the_intervals():
    """A Magic Formula fits them about as well, with a smaller slope at no slip, which no log shows."""
    true = TRUE | dict(brush=1.0)
    data = drives(amplitude=0.12, true=true, steering=AT_ONCE)
    found = saturating(data)
    (brushed, share), *_ = others_as_good(found, [], data)
    assert share > 0.4
    for name in ("C_f", "C_r"):
        assert found.values[name] < 0.97 * true[name]
        assert brushed.values[name] == pytest.approx(true[name], rel=0.02)
    *_, limits, _ = hull(found.names, found, [(brushed, share)])
    assert all(high > true[name] for name, (_, high) in zip(found.names, limits, strict=True) if name in ("C_f", "C_r"))
