"""Chapter 6 and example 5: the pieces do what they say, and one row of each kind meets its bound."""

import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_2, SOUSA_TABLE_6_8
from slipangle.optimal.realtime import RealTime
from slipangle.paths.lane_change import double_lane_change, lane_changes
from slipangle.reproduce import example_5, find, names
from slipangle.reproduce._chapter_6 import FRONT_DRIVE, REAR_DRIVE, drive
from slipangle.reproduce._cvodes import ByCvodes
from slipangle.reproduce._tires_6 import look_up_tire
from slipangle.reproduce.plants.pendulum import PendulumParams, pendulum

needs_compiler = pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())


def test_helpers_are_no_experiments():
    assert {"table-6.5", "table-6.6", "table-6.11", "table-6.12", "table-6.13", "example-5"} <= set(names())
    assert not [n for n in names() if n.startswith("-")]


def test_pendulum_solves_the_printed_equations():
    p = PendulumParams()
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, F = rng.standard_normal(4), 100 * rng.standard_normal()
        _, _, a, alpha = pendulum(x, F, p)
        _, theta, v, omega = x
        ml = p.mass * p.length
        first = (p.mass_cart + p.mass) * a - ml * np.cos(theta) * alpha + p.friction * v
        assert first + ml * np.sin(theta) * omega**2 == pytest.approx(F, abs=1e-9)
        second = -ml * np.cos(theta) * a + (p.inertia + ml * p.length) * alpha + p.friction_pivot * omega
        assert second == pytest.approx(ml * p.gravity * np.sin(theta), abs=1e-9)


def test_a_free_pendulum_keeps_its_energy_and_hangs_stably():
    p = PendulumParams(friction=0.0, friction_pivot=0.0)

    def energy(x):
        ml = p.mass * p.length
        moving = 0.5 * (p.mass_cart + p.mass) * x[2] ** 2 - ml * np.cos(x[1]) * x[2] * x[3]
        return moving + 0.5 * (p.inertia + ml * p.length) * x[3] ** 2 + ml * p.gravity * np.cos(x[1])

    x, h = np.array([0.0, 2.0, 0.3, -0.5]), 1e-4
    slope = (energy(x + h * pendulum(x, 0.0, p)) - energy(x - h * pendulum(x, 0.0, p))) / (2 * h)
    assert slope == pytest.approx(0.0, abs=1e-4)
    assert pendulum(np.array([0.0, np.pi + 0.1, 0.0, 0.0]), 0.0, p)[3] < 0  # back to hanging
    assert pendulum(np.array([0.0, 0.1, 0.0, 0.0]), 0.0, p)[3] > 0  # upright it falls


def test_look_up_tire_is_the_curve_it_was_made_from():
    table = look_up_tire()
    for s, alpha in ((0.033, 0.02), (-0.1, -0.11), (0.15, 0.2)):
        ours, theirs = table.forces(s, alpha, 700.0), SOUSA_TABLE_6_8.forces(s, alpha, 700.0)
        assert ours.F_x == pytest.approx(theirs.F_x, abs=2.0)
        assert ours.F_y == pytest.approx(theirs.F_y, abs=2.0)
    held = SOUSA_TABLE_6_8.forces(0.21, np.deg2rad(13.0), 700.0)
    assert table.forces(0.5, 1.0, 700.0).F_y == pytest.approx(held.F_y)
    assert table.forces(0.5, 1.0, 700.0).F_x == pytest.approx(held.F_x)


def test_cvodes_agrees_with_radau():
    model = FRONT_DRIVE.model(SOUSA_TABLE_6_2)
    x = model.straight(20.0)
    x[2] = 0.1
    u = np.array([0.02, 800.0, 0.0])
    assert ByCvodes(model).step(x, u) == pytest.approx(model.step(x, u), rel=1e-4, abs=2e-4)


@needs_compiler
@pytest.mark.parametrize(
    ("car", "tire", "path", "rmse", "largest"),
    [
        (FRONT_DRIVE, SOUSA_TABLE_6_2, double_lane_change(20.0, blend=12.0), 0.2029, 0.3959),
        pytest.param(
            *(REAR_DRIVE, SOUSA_TABLE_6_8, lane_changes(25.0, change=50.0), 0.2654, 0.7317), marks=pytest.mark.slow
        ),
    ],
    ids=["table 6.5", "table 6.12"],
)
def test_a_row_is_better_than_printed(car, tire, path, rmse, largest):
    model = car.model(tire)
    fast = drive(ByCvodes(model), car.controller(model, 5, RealTime()), car, path)
    slow = drive(ByCvodes(model), car.controller(model, 5, RealTime(iterations=0)), car, path)
    assert fast.rmse <= rmse
    assert fast.largest <= largest
    assert fast.rmse <= 1.1 * slow.rmse
    assert fast.v_x[-1] == pytest.approx(car.speed, abs=0.05)
    assert all(p.age == 0 for p in fast.plans)


@needs_compiler
def test_example_5_stands_up():
    states, forces, _, plans = example_5.swing_up(example_5.controller(RealTime(), end=100.0))
    assert np.abs(forces).max() <= 800
    assert np.abs(states[60:, 1]).max() < np.deg2rad(5)
    assert np.abs(states[-1]).max() < 1e-2
    assert all(p.age == 0 for p in plans)


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("name", ["example-5", "table-6.5", "table-6.6", "table-6.11", "table-6.12", "table-6.13"])
def test_whole_tables_hold(name):
    assert find(name).reproduce(lambda share, what: None).holds
