"""Where an axle's force peaks, and that a driver's plans keep to it."""

import copy
import math
import pickle

import numpy as np
import pytest

from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.default_drive import default_controller, driven_model
from slipangle.control.driver import Driver
from slipangle.control.front_slip import front_slip, grip_left, rear_slip
from slipangle.control.speed.driver import SpeedDriver
from slipangle.models.vehicles.aided import RearSteered
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams, axle_force
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.models.vehicles.saturating_bicycle import SaturatingBicycle, SaturatingBicycleParams
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Values
from slipangle.paths.path import Path
from slipangle.simulate.drive import drive
from slipangle.simulate.plant import Plant
from slipangle.simulate.sensors import Sensor, Sensors

CHASSIS = {"mass": 1200.0, "inertia_z": 1600.0, "wheelbase": 2.5, "l_f": 1.2, "C_f": 9e4, "C_r": 1.1e5}
CAR = SaturatingBicycleParams(**CHASSIS, mu_f=0.9, mu_r=1.1, steering_gain=0.5, steering_offset=0.02)
SLIPS = np.linspace(0.01, 0.5, 49001)


def late(car):
    return Delayed(Steered(car, steering_lag=0.05), delays={"delta": 0.02}, longest=0.04)


def test_the_peak_is_that_of_the_axle_force():
    p = CAR
    load = p.mass * GRAVITY * p.l_r / p.wheelbase
    force = p.mu_f * load * np.sin(p.shape * np.arctan(p.C_f * SLIPS / (p.shape * p.mu_f * load)))
    slip = front_slip(late(SaturatingBicycle(params=p, dt=0.02)))
    assert slip.peak == pytest.approx(SLIPS[force.argmax()], abs=2e-5)
    load = p.mass * GRAVITY * p.l_f / p.wheelbase
    force = p.mu_r * load * np.sin(p.shape * np.arctan(p.C_r * SLIPS / (p.shape * p.mu_r * load)))
    slip = rear_slip(late(SaturatingBicycle(params=p, dt=0.02)))
    assert slip.peak == pytest.approx(SLIPS[force.argmax()], abs=2e-5)
    load = p.mass * GRAVITY * p.l_r / p.wheelbase
    q = NonlinearBicycleParams(**CHASSIS, E_f=-2.0, friction_load=0.0, stiffness_load=0.0)
    curve = axle_force(SLIPS, load, load, 0.0, 0.0, q.C_f, q.mu_f, q.E_f, q)
    assert front_slip(NonlinearBicycle(params=q, dt=0.02)).peak == pytest.approx(SLIPS[curve.argmax()], rel=0.01)


def test_steered_rear_wheels_slip_by_their_angle_more():
    """They slip not at all where they point along their axle's way; the front ones are as they were."""
    model = OnGround(late(RearSteered(SaturatingBicycle(params=CAR, dt=0.02))))
    x, u = np.zeros(model.n_states), np.zeros(model.n_inputs)
    x[[model.states.index(n) for n in ("v_y", "r")]] = 0.4, 0.3
    u[[model.inputs.index(n) for n in ("v_x", "delta_r")]] = 20.0, (0.4 - CAR.l_r * 0.3) / 20.0
    assert rear_slip(model)(x, u, None) == pytest.approx(0.0, abs=1e-15)
    straight = OnGround(late(SaturatingBicycle(params=CAR, dt=0.02)))
    without = np.delete(u, model.inputs.index("delta_r"))
    assert rear_slip(straight)(x, without, None) == pytest.approx(-u[model.inputs.index("delta_r")])
    double = late(RearSteered(SaturatingBicycle(params=CAR, dt=0.02), gain_delta_r=2.0))
    u[double.inputs.index("delta_r")] *= 0.5
    assert rear_slip(double)(x, u, None) == pytest.approx(0.0, abs=1e-15)
    assert front_slip(model)(x, u, None) == pytest.approx(front_slip(straight)(x, without, None))


def test_wheels_that_are_turned_far_slip_by_the_angle_of_their_motion():
    x, u = [1.9, 0.9], [1.0, 4.0]
    slips = [front_slip(SaturatingBicycle(params=CAR, dt=0.02, small_angles=s))(x, u, None) for s in (True, False)]
    angle = math.atan((1.9 + CAR.l_f * 0.9) / 4.0)
    assert float(slips[1]) == pytest.approx(0.5 * (1.0 - 0.02) - angle, abs=1e-12)
    assert float(slips[0]) < float(slips[1]) - 0.05
    assert not front_slip(late(SaturatingBicycle(params=CAR, dt=0.02, small_angles=False))).small_angles


def test_what_has_no_peak_has_no_limit():
    linear = Bicycle(params=SOUSA_TABLE_7_2, dt=0.02)
    assert front_slip(late(linear)) is None
    assert rear_slip(late(linear)) is None
    assert not {"slip", "slip_r"} & {*default_controller(driven_model(late(linear), 0.02)).ocp.limits}
    flat = CAR.with_values(shape=1.0)
    assert front_slip(SaturatingBicycle(params=flat, dt=0.02)) is None


def test_the_slip_is_that_of_the_motion_and_survives_copies():
    """By hand, at 20 m/s: the axle goes 0.0775 rad to the left, the wheels point 0.5 (0.1 - 0.02) rad there."""
    model = driven_model(late(SaturatingBicycle(params=CAR, dt=0.02)), 0.02)
    x, u = np.zeros(model.n_states), np.zeros(model.n_inputs)
    x[[model.states.index(n) for n in ("v_y", "r", "delta_s")]] = 1.19, 0.3, 0.1
    u[model.inputs.index("v_x")] = 20.0
    slip = front_slip(model)
    expected = 0.5 * (0.1 - 0.02) - (1.19 + 1.2 * 0.3) / 20.0
    assert float(slip(x, u, None)) == pytest.approx(expected)
    rear = rear_slip(model)
    assert float(rear(x, u, None)) == pytest.approx(-(1.19 - 1.3 * 0.3) / 20.0)
    assert pickle.loads(pickle.dumps(rear)) == rear != slip
    plain = front_slip(SaturatingBicycle(params=CAR, dt=0.02))
    assert float(plain([1.19, 0.3], [0.1, 20.0], None)) == pytest.approx(expected)
    assert pickle.loads(pickle.dumps(slip)) == slip == copy.deepcopy(slip)


def test_an_axle_leaves_the_rest_of_its_friction_ellipse():
    """At slip angles found by hand for shares of the peak force, whichever axle has less left."""
    car = CAR.with_values(steering_gain=1.0, steering_offset=0.0)
    model = SaturatingBicycle(params=car, dt=0.02)
    left = grip_left(model)

    def at(share, axle):
        load = car.mass * GRAVITY * (car.l_r if axle == "f" else car.l_f) / car.wheelbase
        most = getattr(car, f"mu_{axle}") * load
        return np.tan(np.arcsin(share) / car.shape) * car.shape * most / getattr(car, f"C_{axle}")

    for share in (0.0, 0.6, -0.8, 0.96):
        rest = np.sqrt(1 - share**2)
        assert float(left([0.0, 0.0], [at(share, "f"), 20.0])) == pytest.approx(rest, abs=1e-9)
        assert float(left([-20.0 * at(share, "r"), 0.0], [-at(share, "r"), 20.0])) == pytest.approx(rest, abs=1e-9)
    assert float(left([-20.0 * at(0.6, "r"), 0.0], [at(0.8, "f") - at(0.6, "r"), 20.0])) == pytest.approx(0.6)
    assert float(left([0.0, 0.0], [1.1 * front_slip(model).peak, 20.0])) == 0.0
    assert grip_left(late(Bicycle(params=SOUSA_TABLE_7_2, dt=0.02))) is None


@pytest.mark.slow
@pytest.mark.skipif(compiler() is None, reason=sentence())
def test_a_bend_too_fast_is_driven_wide_and_left_again():
    """Front tires that can 8.8 m/s2, a quarter circle that asks for 9.3: they slip to their peak, not past it."""
    params = CAR.with_values(steering_gain=1.0, steering_offset=0.0)
    angle, radius = np.linspace(0.0, 0.5 * np.pi, 41)[1:-1], 20.0
    X = np.concatenate([np.linspace(-60, 0, 31), radius * np.sin(angle), np.full(41, radius)])
    Y = np.concatenate([np.zeros(31), radius * (1 - np.cos(angle)), radius + np.linspace(0, 80, 41)])
    path = Path.from_points(X, Y, smoothing=0.05).with_speed(np.sqrt(9.3 * radius))
    car = OnGround(SaturatingBicycle(params=params, dt=0.001))
    slower = Sensors(v_x=Sensor(bias=-0.5))  # so that the speed law always wants more drive
    plant = Plant(car, delay=Values(delta=0.02), lag=Values(delta=0.05), sensors=slower)
    law, driven = SpeedDriver.for_car(mass=params.mass, radius=0.3, limits=(-3000.0, 1000.0)), []
    driver = Driver(late(SaturatingBicycle(params=params, dt=0.02)), path, speed=law, noise={"r": 0.002})
    run = drive(plant, driver, watch=lambda t, said: driven.append(said["T_f"]))
    v_y, r = (run.states[:, run.state_names.index(n)] for n in ("v_y", "r"))
    delta = run.inputs[:, run.input_names.index("delta")]
    peak = front_slip(SaturatingBicycle(params=params, dt=0.02)).peak
    assert np.abs(delta - (v_y + params.l_f * r) / run.v_x).max() < peak
    assert 0.2 < np.abs(run.e_y).max() < 5.0
    assert np.abs(run.e_y[-50:]).max() < 0.05
    assert np.min(driven[200:]) < 20.0  # of 1000 N m: hardly any drive while the axle has hardly anything left
    assert driven[150] > 800.0
    assert driven[-1] > 800.0
