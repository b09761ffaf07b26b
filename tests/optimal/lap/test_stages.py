"""The cheap stages of a fastest lap, against closed forms and plain searches."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize, sparse

from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.optimal.lap.car import axle
from slipangle.optimal.lap.envelope import Envelope, envelope
from slipangle.optimal.lap.line import box_qp, differences, minimum_curvature
from slipangle.optimal.lap.profile import speed_profile
from tests.optimal.lap.cars import RACER, point_like


def test_envelope_of_a_balanced_car_is_the_friction_ellipse():
    """Without load transfer, air or load sensitivity: a circle of mu g, up to the share of it that is used."""
    car = point_like(mu=1.2)
    limits = envelope(car, 60.0)
    most = 1.2 * GRAVITY
    assert limits.a_y == pytest.approx(most, rel=2e-3)
    assert limits.brake[:, 0] == pytest.approx(0.98 * most, rel=1e-3)
    middle = (limits.share > 0.3) & (limits.share < 0.95)
    circle = most * np.sqrt(1 - limits.share[middle] ** 2)
    assert limits.brake[0, middle] == pytest.approx(circle, rel=0.03)


@pytest.mark.parametrize("even", [0.0, 1.0])
def test_tires_of_an_axle_share_its_force_by_grip_or_evenly(even):
    """Two tires by hand: each has its own load, its own part of the force, and what its ellipse leaves to the side."""
    car, static, transfer, F_x, alpha = replace(RACER, even=even), 6000.0, 1500.0, -2000.0, 0.05
    loads = 0.5 * static + np.array([transfer, -transfer])
    rise = loads / (0.5 * static) - 1
    peaks = car.mu_f * loads * (1 - car.friction_load * rise)
    stiffness = 0.5 * car.C_f * (1 + rise * (1 - car.stiffness_load))
    used = (np.array([0.5, 0.5]) if even else peaks / peaks.sum()) * F_x / peaks
    lateral = peaks * np.sin(car.shape * np.arctan(stiffness / (car.shape * peaks) * alpha))
    got = axle(alpha, static, transfer, static, F_x, car.C_f, car.mu_f, 0.0, car)
    assert got.F_y == pytest.approx(np.sum(lateral * np.sqrt(1 - used**2)), rel=2e-3)
    assert got.use == pytest.approx(used[1], rel=1e-4)  # of the inner tire, which has the least left
    assert got.peak == pytest.approx(peaks.sum(), rel=1e-4)
    of_each = np.hypot(used, lateral * np.sqrt(1 - used**2) / peaks)
    assert got.ellipse == pytest.approx(of_each.max(), rel=1e-3)


def test_evenly_shared_force_costs_braking_in_a_bend_alone():
    shared, even = envelope(RACER, 40.0), envelope(replace(RACER, even=1.0), 40.0)
    assert even.brake[:, 0] == pytest.approx(shared.brake[:, 0], rel=0.01)
    bend = (shared.share > 0.5) & (shared.share < 0.9)
    assert np.all(even.brake[:, bend] < 0.95 * shared.brake[:, bend])


def test_drive_is_bounded_by_power_and_drag():
    car = point_like(mu=1.2, power=1e5, drag=0.5)
    limits = envelope(car, 60.0)
    fast = limits.v > 20.0
    wanted = (1e5 / limits.v - 0.5 * limits.v**2) / car.mass
    assert limits.drive[fast, 0] == pytest.approx(wanted[fast], abs=1e-3)


def plain(a=5.0, a_y=10.0, v_max=60.0):
    """Constant accelerations on a friction ellipse."""
    v, share = np.linspace(3.0, v_max, 20), np.sin(np.linspace(0, np.pi / 2, 12))
    table = np.tile(a * np.sqrt(1 - share**2), (20, 1))
    return Envelope(v=v, a_y=np.full(20, a_y), share=share, drive=table, brake=table)


def test_profile_of_a_corner_between_straights():
    """Down to sqrt(a_y R) at the corner, v^2 changing by 2 a along the straights."""
    step, corner = np.full(400, 1.0), np.zeros(401)
    corner[200] = 1 / 40.0
    v = speed_profile(corner, step, plain(), closed=False)
    apex = np.sqrt(10.0 * 40.0)
    away = np.abs(np.arange(401) - 200.0)
    wanted = np.minimum(60.0, np.sqrt(apex**2 + 2 * 5.0 * np.maximum(away - 1, 0)))  # none at the apex itself
    assert v == pytest.approx(wanted, rel=1e-3)


def test_profile_of_a_closed_line_does_not_depend_on_where_it_begins():
    bend = 0.01 + 0.02 * np.sin(np.linspace(0, 6 * np.pi, 301)[:-1]) ** 2
    step = np.full(300, 2.0)
    v = speed_profile(bend, step, plain(), closed=True)
    moved = speed_profile(np.roll(bend, 77), step, plain(), closed=True)
    assert moved == pytest.approx(np.roll(v, 77), rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_box_qp_agrees_with_bounded_least_squares(seed):
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(30, 12)), rng.normal(size=30)
    low, high = -rng.uniform(0.01, 0.3, 12), rng.uniform(0.01, 0.3, 12)
    wanted = optimize.lsq_linear(A, b, (low, high), tol=1e-12).x
    assert box_qp(sparse.csc_matrix(A.T @ A), -A.T @ b, low, high) == pytest.approx(wanted, abs=1e-5)


def test_box_qp_of_a_problem_in_millimetres_is_that_in_metres():
    """To what sums round off: where the search ends does not hang on the unit."""
    rng = np.random.default_rng(7)
    A, b = rng.normal(size=(30, 12)), rng.normal(size=30)
    low, high = -rng.uniform(0.01, 0.3, 12), rng.uniform(0.01, 0.3, 12)
    H, g = sparse.csc_matrix(A.T @ A), -A.T @ b
    metres = box_qp(H, g, low, high)
    assert 1e-3 * box_qp(H / 1e6, g / 1e3, 1e3 * low, 1e3 * high) == pytest.approx(metres, rel=1e-12)


def test_differences_are_exact_for_parabolas_on_uneven_steps():
    s = np.array([0.0, 1.0, 1.5, 3.0, 4.2, 5.0])
    D1, D2 = differences(np.diff(s), closed=False)
    assert (D2 @ s**2)[1:-1] == pytest.approx(2.0)
    assert (D1 @ s**2)[1:-1] == pytest.approx(2 * s[1:-1])


def test_least_curvature_of_a_ring_is_its_outer_edge():
    """A circle between 46 and 54 m: of all rings the largest bends least."""
    angle = np.linspace(0, 2 * np.pi, 121)[:-1]
    X, Y = 50 * np.cos(angle), 50 * np.sin(angle)
    step = np.full(120, 2 * 50 * np.sin(np.pi / 120))
    n, chi, bend = minimum_curvature(X, Y, angle + np.pi / 2, step, np.full(120, -4.0), np.full(120, 4.0), closed=True)
    assert n == pytest.approx(-4.0, abs=1e-3)
    assert chi == pytest.approx(0.0, abs=1e-6)
    assert bend == pytest.approx(1 / 54.0, rel=2e-3)


@pytest.mark.parametrize("power", [500.0, 5e3])
def test_around_a_closed_line_no_speed_is_beyond_what_the_engine_reaches(power):
    """Of a circle that any car takes, the only speed is the one at which drag takes all of the power."""
    car = replace(point_like(mu=1.2, power=power, drag=0.7), rolling_resistance=0.0)
    v = speed_profile(np.full(300, 0.01), np.full(300, 2.0), envelope(car, 60.0), closed=True)
    assert v == pytest.approx((power / 0.7) ** (1 / 3), rel=0.06)
