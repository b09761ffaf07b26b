"""Brush and Dugoff tires: limit cases, grip, symmetry, symbols."""

import casadi as ca
import numpy as np
import pytest

from slipangle.errors import ParameterError
from slipangle.models.tires.physical import BrushTire, DugoffTire, tread_slip
from slipangle.models.tires.simple import practical_slip, slip_ratio

BRUSH = BrushTire(C_alpha=60e3, C_s=90e3, mu=0.9, half_length=0.06)
DUGOFF = DugoffTire(C_alpha=60e3, C_s=90e3, mu=0.9)
EVERY = pytest.mark.parametrize("tire", [BRUSH, DUGOFF], ids=["brush", "Dugoff"])
LOAD = 4000.0


def test_slip_definitions_from_speeds():
    v, R = 20.0, 0.3
    for omega_r in (5.0, 15.0, 20.0, 22.0, 60.0):
        s = (omega_r - v) / max(v, omega_r)
        assert slip_ratio(v, omega_r / R, R, v_low=1e-6) == pytest.approx(s, abs=1e-6)
        assert practical_slip(s) == pytest.approx((omega_r - v) / v, rel=1e-12)
        sigma_x, sigma_y = tread_slip(s, 0.1)
        assert sigma_x == pytest.approx((omega_r - v) / omega_r, rel=1e-12)
        assert sigma_y == pytest.approx(np.tan(0.1) * v / omega_r, rel=1e-12)
    assert np.isfinite([practical_slip(1.0), *tread_slip(-1.0, 0.5), *tread_slip(1.0, 0.5)]).all()


@EVERY
def test_slopes_at_the_origin_are_the_stiffnesses(tire):
    h = 1e-6
    assert (tire.forces(h, 0.0, LOAD).F_x - tire.forces(-h, 0.0, LOAD).F_x) / (2 * h) == pytest.approx(90e3, rel=1e-3)
    assert (tire.forces(0.0, h, LOAD).F_y - tire.forces(0.0, -h, LOAD).F_y) / (2 * h) == pytest.approx(60e3, rel=1e-3)


@EVERY
@pytest.mark.parametrize("friction", [1.0, 0.3])
def test_the_resultant_stays_on_the_friction_circle(tire, friction):
    s, a = (m.ravel() for m in np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1.5, 1.5, 41)))
    found = tire.forces(s, a, LOAD, friction=friction)
    size = np.hypot(found.F_x, found.F_y)
    assert np.max(size) <= 0.9 * friction * LOAD * (1 + 1e-9)
    assert np.max(size) > 0.98 * 0.9 * friction * LOAD
    assert (found.F_x * s >= 0).all()
    assert (found.F_y * a >= 0).all()


def test_brush_slides_as_a_whole_from_the_slip_that_theory_gives():
    angle = np.arctan(3 * 0.9 * LOAD / 60e3)
    assert BRUSH.forces(0.0, 1.001 * angle, LOAD).F_y == pytest.approx(0.9 * LOAD, rel=1e-12)
    assert BRUSH.forces(0.0, 0.9 * angle, LOAD).F_y < 0.9999 * 0.9 * LOAD
    assert BRUSH.forces(0.0, 1.001 * angle, LOAD).M_z == 0.0
    small = BRUSH.forces(0.0, 1e-4, LOAD)
    assert -small.M_z / small.F_y == pytest.approx(0.06 / 3, rel=1e-2)  # a third of the half length


def test_dugoff_leaves_the_line_at_half_the_grip():
    angle = np.arctan(0.5 * 0.9 * LOAD / 60e3)
    below, above = DUGOFF.forces(0.0, 0.999 * angle, LOAD), DUGOFF.forces(0.0, 1.2 * angle, LOAD)
    assert below.F_y == pytest.approx(60e3 * np.tan(0.999 * angle), rel=1e-9)
    assert above.F_y < 60e3 * np.tan(1.2 * angle) * 0.99


@EVERY
def test_left_and_right_are_alike_and_no_load_gives_no_force(tire):
    s, a = (m.ravel() for m in np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-0.5, 0.5, 9)))
    one, other = tire.forces(s, a, LOAD), tire.forces(s, -a, LOAD)
    np.testing.assert_array_equal(one.F_y, -other.F_y)
    np.testing.assert_array_equal(one.F_x, other.F_x)
    np.testing.assert_array_equal(one.M_z, -np.asarray(other.M_z))
    none = tire.forces(s, a, 0.0)
    np.testing.assert_allclose(np.hypot(none.F_x, none.F_y), 0.0, atol=1e-9)


@EVERY
def test_symbols_equal_numbers_and_derivatives_are_right(tire):
    rng = np.random.default_rng(0)
    x = ca.SX.sym("x", 3)
    forces = ca.vertcat(*tire.forces(x[0], x[1], x[2]))
    value, jacobian = ca.Function("f", [x], [forces]), ca.Function("j", [x], [ca.jacobian(forces, x)])
    for point in rng.uniform([-0.4, -0.4, 1000], [0.4, 0.4, 8000], (50, 3)):
        numeric = np.array([float(v) for v in tire.forces(*point)])
        np.testing.assert_allclose(np.asarray(value(point)).ravel(), numeric, rtol=1e-12, atol=1e-9)
        for i, h in enumerate((1e-6, 1e-6, 1e-2)):
            step = np.eye(3)[i] * h
            slope = np.asarray(value(point + step) - value(point - step)).ravel() / (2 * h)
            np.testing.assert_allclose(np.asarray(jacobian(point))[:, i], slope, rtol=1e-4, atol=1e-3 / h * 1e-3)


def test_parameters_have_ranges():
    with pytest.raises(ParameterError, match=r"BrushTire\.mu .* is 0; expected 0\.01 to 5"):
        BrushTire(C_alpha=60e3, C_s=90e3, mu=0.0)
