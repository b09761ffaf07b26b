"""Cars with steered rear wheels and with a yaw moment against `tests.oracles.vehicles`."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.models.vehicles.aided import RearSteered, TorqueVectored
from slipangle.models.vehicles.banked import Banked
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.kinematic import Kinematic
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams
from slipangle.models.vehicles.parameters import BicycleParams
from slipangle.models.vehicles.saturating_bicycle import RelaxingBicycle, SaturatingBicycle, SaturatingBicycleParams
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from tests.oracles import vehicles
from tests.oracles.compare import agree, uniform
from tests.oracles.test_vehicles import CHASSIS, SATURATING, STATE, STEERED, rates

REAR, MOMENT = (-0.15, 0.15), (-3e3, 3e3)
LINEAR = CHASSIS | dict(C_f=83e3, C_r=127e3)
SENSORS = dict(bias_r=0.013, bias_v_y=-0.11, lever_v_y=-0.31, lever_a_y=0.43, gain_a_y=1.07)


def rear_slip(car, v_y, r, delta, delta_r, v_x):
    """Slip angles of both axles where both are steered: what the wheel points at less where its axle goes."""
    l_r = car["wheelbase"] - car["l_f"]
    return delta - (v_y + car["l_f"] * r) / v_x, delta_r - (v_y - l_r * r) / v_x


def rates_and_outputs(model):
    """Of two states and three outputs."""

    def ours(*z):
        seen = model.output(z[:2], z[2:])
        return [*rates(model)(*z), *(seen[i] for i in range(3))]

    return ours


def test_a_linear_bicycle_with_steered_rear_wheels():
    model = RearSteered(Bicycle(params=BicycleParams(**LINEAR, **STEERED), dt=0.01, outputs=("v_y", "r", "a_y")))

    def oracle(v_y, r, delta, v_x, delta_r):
        v_y_dot, r_dot = vehicles.bicycle(LINEAR, v_y, r, vehicles.road_wheel(STEERED, delta), v_x)
        v_y_dot = v_y_dot + LINEAR["C_r"] / LINEAR["mass"] * delta_r
        r_dot = r_dot - LINEAR["C_r"] * (LINEAR["wheelbase"] - LINEAR["l_f"]) / LINEAR["inertia_z"] * delta_r
        return [v_y_dot, r_dot, v_y_dot + v_x * r]

    assert model.inputs == ("delta", "v_x", "delta_r")
    agree(rates(model, "a_y"), oracle, uniform(11, 300, *STATE.values(), REAR))


def test_a_saturating_bicycle_with_steered_rear_wheels_and_its_sensors():
    params = SaturatingBicycleParams(**SATURATING, **STEERED, **SENSORS)
    car = SaturatingBicycle(params=params, dt=0.01, outputs=("v_y", "r", "a_y"))
    model = RearSteered(car, gain_delta_r=1.13)

    def oracle(v_y, r, delta, v_x, delta_r):
        slip = rear_slip(CHASSIS, v_y, r, vehicles.road_wheel(STEERED, delta), 1.13 * delta_r, v_x)
        v_y_dot, r_dot, a_y = vehicles.saturating_bicycle(SATURATING, v_y, r, *slip, v_x)
        read = [v_y - 0.31 * r - 0.11, r + 0.013, 1.07 * (a_y + 0.43 * r_dot)]
        return [v_y_dot, r_dot, *read]

    agree(rates_and_outputs(model), oracle, uniform(12, 300, *STATE.values(), REAR))


def test_tires_that_relax_follow_the_slip_of_steered_rear_wheels():
    params = SaturatingBicycleParams(**SATURATING, **STEERED, relaxation_f=0.4, relaxation_r=0.6)
    model = RearSteered(RelaxingBicycle(params=params, dt=0.01))

    def oracle(v_y, r, alpha_f, alpha_r, delta, v_x, delta_r):
        slip = rear_slip(CHASSIS, v_y, r, vehicles.road_wheel(STEERED, delta), delta_r, v_x)
        late = [np.hypot(length / v_x, 0.005) for length in (0.4, 0.6)]
        found = vehicles.saturating_bicycle(SATURATING, v_y, r, alpha_f, alpha_r, v_x)
        return [*found[:2], (slip[0] - alpha_f) / late[0], (slip[1] - alpha_r) / late[1]]

    slips = (-0.2, 0.2), (-0.2, 0.2)
    points = uniform(13, 300, STATE["v_y"], STATE["r"], *slips, STATE["delta"], STATE["v_x"], REAR)
    agree(rates(model), oracle, points)


def test_a_yaw_moment_turns_the_car_and_is_felt_by_a_sensor_ahead():
    params = SaturatingBicycleParams(**SATURATING, **STEERED, **SENSORS)
    car = RearSteered(SaturatingBicycle(params=params, dt=0.01, outputs=("r", "a_y", "v_y")))
    model = Banked(TorqueVectored(car, gain_M_z=0.87))

    def oracle(v_y, r, delta, v_x, delta_r, M_z, bank):
        slip = rear_slip(CHASSIS, v_y, r, vehicles.road_wheel(STEERED, delta), delta_r, v_x)
        v_y_dot, r_dot, a_y = vehicles.saturating_bicycle(SATURATING, v_y, r, *slip, v_x)
        r_dot = r_dot + 0.87 * M_z / CHASSIS["inertia_z"]
        read = [r + 0.013, 1.07 * (a_y + 0.43 * r_dot), v_y - 0.31 * r - 0.11]
        return [v_y_dot - vehicles.G * np.sin(bank), r_dot, *read]

    assert model.inputs == ("delta", "v_x", "delta_r", "M_z", "bank")
    agree(rates_and_outputs(model), oracle, uniform(14, 300, *STATE.values(), REAR, MOMENT, (-0.2, 0.2)))


def test_a_late_steering_is_that_of_the_front_wheels_alone():
    """Behind a lag of the front wheels the rear ones are where they are told to be."""
    car = RearSteered(Bicycle(params=BicycleParams(**LINEAR), dt=0.01))
    model = Delayed(Steered(TorqueVectored(car), steering_lag=0.1), delays={"delta": 0.02})
    x, u = np.array([0.3, 0.1, 0.04]), np.array([0.1, 20.0, 0.03, 500.0])
    now = model.ode.derivative(x, u)
    front = vehicles.bicycle(LINEAR, 0.3, 0.1, 0.04, 20.0)
    l_r = LINEAR["wheelbase"] - LINEAR["l_f"]
    turn = front[1] + (500.0 - l_r * LINEAR["C_r"] * 0.03) / LINEAR["inertia_z"]
    assert now == pytest.approx([front[0] + LINEAR["C_r"] * 0.03 / LINEAR["mass"], turn, 0.6], rel=1e-12)


@pytest.mark.parametrize("kind", [SaturatingBicycle, RelaxingBicycle])
@pytest.mark.parametrize("measured", [False, True])
def test_a_run_begins_where_the_car_is_on_its_rear_wheels(kind, measured):
    """In a steady bend at little slip nothing changes from there; a v_y that was measured is taken."""
    sensor = dict(lever_v_y=-0.3, gain_v_y=1.2, turn_v_y=0.02)
    params = SaturatingBicycleParams(**SATURATING, **STEERED, **sensor, relaxation_f=0.4, relaxation_r=0.6)
    model = RearSteered(kind(params=params, dt=0.01))
    v, delta_r = 24.0, 2e-3

    def residual(z):
        slip = rear_slip(SATURATING, z[0], z[1], z[2], delta_r, v)
        return np.array(vehicles.saturating_bicycle(SATURATING, z[0], z[1], *slip, v)[:2])

    r, at = 3e-3, np.array([0.0, 3e-3, 0.0])
    for _ in range(5):  # Newton in v_y and the angle of the front wheels
        slope = np.array([(residual(at + e) - residual(at)) / 1e-6 for e in 1e-6 * np.eye(3)[[0, 2]]]).T
        at[[0, 2]] -= np.linalg.solve(slope, residual(at))
    angle = at[2] / STEERED["steering_gain"] + STEERED["steering_offset"]
    given = {"delta": [angle] * 2, "v_x": [v] * 2, "delta_r": [delta_r] * 2}
    v_y = {"v_y": [1.2 * (at[0] - 0.3 * r) + 0.02 * v] * 2} if measured else {}
    x = model.initial_state(Dataset.from_arrays(given, {"r": [r] * 2, **v_y}, 0.01))
    slip = rear_slip(SATURATING, at[0], r, at[2], delta_r, v)
    assert x == pytest.approx([at[0], r, *slip][: len(x)], abs=1e-6)


def test_what_is_no_such_car_is_said():
    limit = NonlinearBicycleParams(**LINEAR, mu_f=1.0, mu_r=1.0, steering_lag=0.1)
    with pytest.raises(ParameterError, match=r"is a NonlinearBicycle; expected a Bicycle, a SaturatingBicycle"):
        RearSteered(NonlinearBicycle(params=limit, dt=0.01))
    TorqueVectored(NonlinearBicycle(params=limit, dt=0.01))
    with pytest.raises(ParameterError, match="the torque-vectored car is a Kinematic; expected one with a state 'r'"):
        TorqueVectored(Kinematic(params=BicycleParams(**LINEAR), dt=0.01))
    car = Bicycle(params=BicycleParams(**LINEAR), dt=0.01)
    with pytest.raises(ParameterError, match="TorqueVectored; expected one with a state 'r'"):
        TorqueVectored(TorqueVectored(car))
    with pytest.raises(ParameterError, match="gain_M_z is 7; expected -5 to 5"):
        TorqueVectored(car, gain_M_z=7.0)
