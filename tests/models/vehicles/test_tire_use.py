"""Tire forces used against those available."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ParameterError
from slipangle.models.tires.on_road import OnRoad
from slipangle.models.tires.simple import LinearTire, MagicCurve, SimpleMagicFormula
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1

CURVES = {
    "longitudinal": MagicCurve(B=20.0, C=1.65, D=1.1, E=-0.5),
    "lateral": MagicCurve(B=10.0, C=1.3, D=0.9, E=-0.5),
}
TIRE = SimpleMagicFormula(**CURVES, combined="ellipse")


def car(tire=TIRE):
    return sa.SingleTrack(params=SOUSA_TABLE_6_1, dt=0.001, tire_f=tire, tire_r=tire)


def states(rng, n):
    v = rng.uniform(8, 40, n)
    spin = v / SOUSA_TABLE_6_1.radius
    wild = [
        rng.normal(0, 3, n),
        rng.normal(0, 0.8, n),
        spin * rng.uniform(0.6, 1.3, n),
        spin * rng.uniform(0.6, 1.3, n),
    ]
    return np.array([v, *wild, *np.zeros((3, n))])


def test_nothing_goes_beyond_the_circle_and_slides_reach_it():
    rng = np.random.default_rng(1)
    x, u = states(rng, 2000), np.array([rng.normal(0, 0.2, 2000), *np.zeros((2, 2000))])
    used = np.array(car().tire_use(x, u))
    sizes = np.hypot(used[[0, 2]], used[[1, 3]])
    assert sizes.max() <= 1 + 1e-9
    assert sizes.max() > 0.999


def test_they_push_the_car_as_its_own_equations_say():
    """Times what is available, the shares are the forces of the derivative: at no steering they add up."""
    rng = np.random.default_rng(2)
    model, p = car(), SOUSA_TABLE_6_1
    for column in states(rng, 20).T:
        used = model.tire_use(column, np.zeros(3))
        rate = np.asarray(model.derivative(column, np.zeros(3)))
        across = 2 * 0.9 * (used[1] * p.load_f + used[3] * p.load_r)
        along = 2 * 1.1 * (used[0] * p.load_f + used[2] * p.load_r)
        assert rate[1] + column[0] * column[2] == pytest.approx(across / p.mass, rel=1e-9)
        assert rate[0] - column[1] * column[2] == pytest.approx(along / p.mass, rel=1e-9, abs=1e-9)


def test_a_road_of_less_friction_has_less_to_give():
    road = OnRoad(TIRE, 0.4)
    assert road.peak_friction == pytest.approx((0.44, 0.36))
    assert road.forces(0.0, 0.05, 4000.0, friction=0.5).F_y == pytest.approx(0.2 * TIRE.forces(0.0, 0.05, 4000.0).F_y)
    rng = np.random.default_rng(3)
    x, u = states(rng, 50), np.zeros((3, 50))
    assert np.array(car(road).tire_use(x, u)) == pytest.approx(np.array(car().tire_use(x, u)))


def test_only_tires_with_a_peak_tell():
    assert car().tells_tire_use
    assert car(OnRoad(TIRE, 0.5)).tells_tire_use
    linear = car(OnRoad(LinearTire(C_alpha=5e4, C_s=1e5), 0.5))
    assert not linear.tells_tire_use
    with pytest.raises(ParameterError, match="does not say what it has to give"):
        linear.tire_use(linear.straight(20.0), np.zeros(3))


def test_a_laden_car_on_another_road():
    other = car().varied(friction=0.5, mass=1.2)
    assert other.params.mass == pytest.approx(1.2 * SOUSA_TABLE_6_1.mass)
    assert other.params.inertia_z == pytest.approx(1.2 * SOUSA_TABLE_6_1.inertia_z)
    assert other.tire_f.peak_friction == pytest.approx((0.55, 0.45))
