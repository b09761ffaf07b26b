"""Vehicle equations against `tests.oracles.vehicles`."""

from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.models.tires.simple import LinearTire
from slipangle.models.vehicles.banked import Banked
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from slipangle.models.vehicles.kinematic import Kinematic
from slipangle.models.vehicles.load_transfer import LoadTransfer
from slipangle.models.vehicles.longitudinal import DrivelineParams, Longitudinal, LongitudinalParams, PedalCar
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams
from slipangle.models.vehicles.parameters import BicycleParams
from slipangle.models.vehicles.quasi_steady import QuasiSteadySingleTrack
from slipangle.models.vehicles.saturating_bicycle import (
    RelaxingBicycle,
    SaturatingBicycle,
    SaturatingBicycleParams,
)
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.models.vehicles.steering import Steered
from tests.oracles import tires, vehicles
from tests.oracles.compare import agree, uniform

STEERED = dict(steering_gain=0.9, steering_offset=0.02)
CHASSIS = dict(mass=1310.0, inertia_z=1850.0, wheelbase=2.62, l_f=1.11)  # nothing symmetric about it
CAR = CHASSIS | dict(inertia_wheel_f=1.9, inertia_wheel_r=2.7, radius=0.31)
STATE = dict(v_y=(-4.0, 4.0), r=(-0.9, 0.9), delta=(-0.25, 0.25), v_x=(3.5, 45.0))
FAR = STATE | dict(delta=(-0.7, 0.7))


def rates(model, *signals):
    """The derivative as a function of every state and input, signals behind it."""
    n = model.n_states

    def ours(*z):
        x, u = np.array(z[:n], dtype=object), np.array(z[n:], dtype=object)
        if all(isinstance(v, np.ndarray) for v in z):
            x, u = np.array(z[:n]), np.array(z[n:])
        found = model.derivative(x, u)
        extra = model.signals(x, u)
        return [found[i] for i in range(n)] + [extra[name] for name in signals]

    return ours


def both(params, tire):
    """The tire pair of an oracle, from two curves or two stiffnesses."""

    def curves(front, s, alpha, load):
        x, y = params[0 if front else 1]
        return load * tires.magic(s, **x), load * tires.magic(alpha, **y)

    def linear(front, s, alpha, load):
        C_s, C_alpha = params[0 if front else 1]
        return C_s * s, C_alpha * alpha

    return {"curves": curves, "linear": linear}[tire]


def plain(tire):
    return [{k: getattr(c, k) for k in ("B", "C", "D", "E", "S_h", "S_v")} for c in (tire.longitudinal, tire.lateral)]


SOFT = dict(front=LinearTire(C_alpha=4.1e4, C_s=7e4), rear=LinearTire(C_alpha=6.3e4, C_s=9e4))
LINEAR = both([(7e4, 4.1e4), (9e4, 6.3e4)], "linear")
CURVED = both([plain(SOUSA_TABLE_6_2)] * 2, "curves")
TIRES = pytest.mark.parametrize(
    ("front", "rear", "tire"),
    [(SOFT["front"], SOFT["rear"], LINEAR), (SOUSA_TABLE_6_2, SOUSA_TABLE_6_2, CURVED)],
    ids=["linear", "Magic Formula"],
)


def test_kinematic():
    model = Kinematic(params=BicycleParams(**CHASSIS, **STEERED, C_f=1e5, C_r=1e5), dt=0.01)

    def oracle(X, Y, psi, delta, v_x):
        return [*vehicles.kinematic(CHASSIS, psi, v_x, vehicles.road_wheel(STEERED, delta)), 0 * X]

    def ours(*z):
        found = rates(model, "r")(*z)
        return [*found[:3], found[3] - found[2]]

    agree(ours, oracle, uniform(0, 200, (-9, 9), (-9, 9), (-4, 4), (-0.6, 0.6), (-5, 30)))


def test_bicycle():
    car = CHASSIS | dict(C_f=83e3, C_r=127e3)
    model = Bicycle(params=BicycleParams(**car, **STEERED), dt=0.01)

    def oracle(v_y, r, delta, v_x):
        found = vehicles.bicycle(car, v_y, r, vehicles.road_wheel(STEERED, delta), v_x)
        return [*found, found[0] + v_x * r]

    agree(rates(model, "a_y"), oracle, uniform(1, 300, *STATE.values()))


def test_longitudinal():
    car = dict(mass=1310.0, k_e=6100.0, k_d=55.0, k_r=0.014)
    model = Longitudinal(params=LongitudinalParams(**car), dt=0.01)
    agree(rates(model), lambda v, p: [vehicles.longitudinal(car, v, p)], uniform(2, 200, (-2, 60), (-1, 1)))


def test_pedal_car():
    car = dict(mass=1310.0, k_e=6100.0, k_b=2.1e-3, power=1.6e5, drag=0.7, k_d=11.0, k_r=0.014, engine_brake=17.0)
    car |= dict(grip=1.1, scrub=0.6, lag=0.23, grade=0.04)
    model = PedalCar(params=DrivelineParams(**car), dt=0.01)

    def oracle(v, throttle, brake, wanted_throttle, wanted_brake, delta):
        rate = vehicles.driveline(car, v, throttle, brake, delta)
        return [rate, (wanted_throttle - throttle) / car["lag"], (wanted_brake - brake) / car["lag"]]

    pedals = ((0, 1), (0, 9e6))
    agree(rates(model), oracle, uniform(3, 300, (-1, 60), *pedals, *pedals, (-0.3, 0.3)))


LIMIT = CHASSIS | dict(
    C_f=83e3, C_r=127e3, mu_f=1.02, mu_r=1.17, shape=1.36, E_f=-0.6, E_r=-1.4, friction_load=0.18, stiffness_load=0.31,
    transfer_x=0.21, transfer_f=0.19, transfer_r=0.12, drive_rear=0.63, brake_rear=0.34, drag=0.52,
)  # fmt: skip


def test_nonlinear_bicycle():
    late = dict(steering_lag=0.07, compliance=3e-6, bias_r=0.013)
    params = NonlinearBicycleParams(**LIMIT, **STEERED, **late)
    assert len(LIMIT | STEERED | late) + 2 == len(fields(params))  # nothing stays at a default that hides it
    model = NonlinearBicycle(params=params, dt=0.01)

    def oracle(v_y, r, delta_w, delta, v_x, v_x_dot):
        v_y_dot, r_dot, F_yf = vehicles.nonlinear_bicycle(LIMIT, v_y, r, delta_w, v_x, v_x_dot)
        lag = (
            vehicles.road_wheel(STEERED, delta) - late["compliance"] * F_yf - delta_w
        )  # force to the left turns it back
        return [v_y_dot, r_dot, lag / late["steering_lag"], v_y_dot + v_x * r]

    points = uniform(
        4, 400, STATE["v_y"], STATE["r"], (-0.25, 0.25), *(STATE[k] for k in ("delta", "v_x")), (-9.0, 7.0)
    )
    agree(rates(model, "a_y"), oracle, points)
    reading = model.output(points[0, :3], points[0, 3:])
    assert reading[0] == pytest.approx(points[0, 1] + late["bias_r"], rel=1e-15)


def test_bicycles_below_their_lowest_speed():
    """Slip angles are those at the lowest speed: at a tenth of it the side force is that of the same motion there."""
    car = LIMIT | {"drag": 0.0}
    L, l_f, m = car["wheelbase"], car["l_f"], car["mass"]
    rates = (car["C_f"] + car["C_r"]) / m + (car["C_f"] * l_f**2 + car["C_r"] * (L - l_f) ** 2) / car["inertia_z"]
    lowest = max(0.4 * L, rates / 400)
    model = NonlinearBicycle(params=NonlinearBicycleParams(**car), dt=0.01)
    linear = Bicycle(params=BicycleParams(**CHASSIS, C_f=car["C_f"], C_r=car["C_r"]), dt=0.01)
    x = np.array([0.1, 0.2, 0.05])
    slow, limit = (model.derivative(x, np.array([0.05, v, 0.5])) for v in (0.1 * lowest, lowest))
    assert slow == pytest.approx(limit, rel=1e-12)
    slow, limit = (linear.derivative(x[:2], np.array([0.05, v])) for v in (0.1 * lowest, lowest))
    assert slow[1] == pytest.approx(limit[1], rel=1e-12)
    assert slow[0] - limit[0] == pytest.approx(0.9 * lowest * x[1], rel=1e-9)  # the frame turns at the true speed
    assert linear.derivative(x[:2], np.array([0.05, 1.1 * lowest]))[1] != pytest.approx(limit[1])


AXLES = dict(C_f=83e3, C_r=127e3, mu_f=0.93, mu_r=1.12, shape=1.36)
SATURATING = CHASSIS | AXLES | dict(downforce_f=1.7, downforce_r=-0.6)
SENSORS = dict(bias_r=0.013, bias_v_y=-0.11, bias_a_y=0.23, lever_v_y=-0.31, lever_a_y=0.43, gain_a_y=1.07)
SENSORS |= dict(gain_v_y=1.13, turn_v_y=0.021)


@pytest.mark.parametrize("small", [True, False])
@pytest.mark.parametrize(
    ("half", "gain", "brush"), [(0.0, 1.0, 0.0), (0.71, 0.93, 0.0), (0.71, 0.93, 0.6), (0.0, 1.0, 1.0)]
)
def test_saturating_bicycle(half, gain, brush, small):
    unused = dict(relaxation_f=0.4, relaxation_r=0.6)
    params = SaturatingBicycleParams(**SATURATING, **STEERED, **SENSORS, **unused, cross_slope=0.06)
    params = replace(params, locked_half_track=half, gain_v_x=gain, load_shift=0.04, brush=brush, along_f=-0.2)
    assert len(SATURATING | STEERED | SENSORS | unused) + 6 == len(fields(params))
    loads = {"locked_half_track": half, "brush": brush, "forward": 0.04 * CHASSIS["mass"] * vehicles.G}
    model = SaturatingBicycle(params=params, dt=0.01, outputs=("v_y", "r", "a_y"), small_angles=small)

    def oracle(v_y, r, delta, logged):
        v_x = gain * logged
        turned = vehicles.road_wheel(STEERED, delta)
        along = -0.2 * CHASSIS["mass"] * vehicles.G
        slip = vehicles.small_slip(CHASSIS, v_y, r, turned, v_x)
        braked = {"across_f": along * turned}
        if not small:
            slip = vehicles.wheel_slip(v_x, v_y + CHASSIS["l_f"] * r, turned), slip[1]
            braked = {"across_f": along * np.sin(turned), "turned": turned}
        found = vehicles.saturating_bicycle(SATURATING | loads | braked, v_y, r, *slip, v_x)
        read = [1.13 * (v_y - 0.31 * r) + 0.021 * v_x - 0.11, r + 0.013, 1.07 * (found[2] + 0.43 * found[1]) + 0.23]
        return [found[0] - vehicles.G * np.sin(0.06), found[1], *read]  # an accelerometer feels no gravity

    def ours(*z):
        seen = model.output(z[:2], z[2:])
        return [*rates(model)(*z), *(seen[i] for i in range(3))]

    agree(ours, oracle, uniform(5, 300, *(STATE if small else FAR).values()))


def test_lift_leaves_an_axle_a_tenth_of_its_load():
    """Where it would take all of it, the axle would push the wrong way."""
    lifted = SaturatingBicycleParams(**(SATURATING | dict(downforce_f=0.0, downforce_r=-5.0)))
    static = CHASSIS["mass"] * vehicles.G * CHASSIS["l_f"] / CHASSIS["wheelbase"]
    slipping = np.array([0.7, 0.0])
    for fast, tenth in ((1.1 * np.sqrt(static / 5.0), 0.1), (0.5 * np.sqrt(static / 5.0), 0.75)):
        F_yf, F_yr = axle_forces(SaturatingBicycle(params=lifted, dt=0.01), slipping, fast)
        rest = replace(lifted, downforce_r=0.0)
        at_rest = axle_forces(SaturatingBicycle(params=rest, dt=0.01), slipping, fast)
        assert (F_yf, F_yr) == pytest.approx((at_rest[0], tenth * at_rest[1]), rel=1e-12)


def axle_forces(model, x, v_x):
    """Front and rear force from the rates of v_y and r alone, the steering straight. [N]"""
    p, rates = CHASSIS, model.derivative(x, np.array([0.0, v_x]))
    both, turn = p["mass"] * (rates[0] + v_x * x[1]), p["inertia_z"] * rates[1]
    front = ((p["wheelbase"] - p["l_f"]) * both + turn) / p["wheelbase"]
    return front, both - front


def test_a_car_with_downforce_at_one_speed_is_one_without():
    params, u = SaturatingBicycleParams(**SATURATING), np.array([0.06, 37.0])
    there = params.at_speed(37.0)
    assert (there.downforce_f, there.downforce_r) == (0.0, 0.0)
    without = {n: v for n, v in SATURATING.items() if not n.startswith("downforce")}
    carried = 1.0 + 1.7 * 37.0**2 / (1310.0 * vehicles.G * (2.62 - 1.11) / 2.62)
    assert there.C_f == pytest.approx(carried * without["C_f"], rel=1e-12)
    assert there.mu_f == pytest.approx(carried * without["mu_f"], rel=1e-12)
    x = np.array([-0.8, 0.3])
    one, other = (SaturatingBicycle(params=p, dt=0.01).derivative(x, u) for p in (params, there))
    assert one == pytest.approx(other, rel=1e-12)


def test_a_run_of_a_car_with_downforce_begins_in_steady_cornering():
    """Its rear slips by what the force of the bend asks of the stiffness at that speed."""
    model = SaturatingBicycle(params=SaturatingBicycleParams(**SATURATING), dt=0.01)
    v, r, p = 40.0, 0.05, SATURATING
    static = p["mass"] * vehicles.G * p["l_f"] / p["wheelbase"]
    carried = static - 0.6 * v**2
    force = p["mass"] * v * r * p["l_f"] / p["wheelbase"]
    slip = force / (p["C_r"] * carried / static)
    first = Dataset.from_arrays({"delta": [0.0, 0.0], "v_x": [v, v]}, {"r": [r, r]}, 0.01)
    assert model.initial_state(first) == pytest.approx([(p["wheelbase"] - p["l_f"]) * r - v * slip, r], rel=1e-12)


LOCKED = {n: v for n, v in SATURATING.items() if not n.startswith("downforce")} | dict(locked_half_track=0.71)


def test_a_run_of_a_car_with_a_locked_axle_begins_in_steady_cornering():
    """At small slip its rates are none there, with the steering that holds it."""
    model = SaturatingBicycle(params=SaturatingBicycleParams(**LOCKED), dt=0.01)
    v, r = 25.0, 1e-4
    v_y = model.initial_state(Dataset.from_arrays({"delta": [0.0, 0.0], "v_x": [v, v]}, {"r": [r, r]}, 0.01))[0]

    def rates_at(delta):
        return vehicles.saturating_bicycle(LOCKED, v_y, r, *vehicles.small_slip(LOCKED, v_y, r, delta, v), v)[:2]

    at_rest = np.array(rates_at(0.0))
    per_angle = (np.array(rates_at(1e-5)) - at_rest) / 1e-5
    delta = -at_rest[1] / per_angle[1]
    assert rates_at(delta) == pytest.approx([0.0, 0.0], abs=1e-6 * v * r)


@pytest.mark.parametrize("v", [8.0, 33.0])
def test_a_car_with_a_locked_axle_has_one_without_that_turns_alike_in_steady_bends(v):
    """The steering that its oracle needs for a little yaw rate is that of the other's linear bicycle."""
    other, r = SaturatingBicycleParams(**LOCKED, steering_gain=0.8).unlocked(), 1e-4

    def residual(z):
        slip = vehicles.small_slip(LOCKED, z[0], r, 0.8 * z[1], v)
        return vehicles.saturating_bicycle(LOCKED, z[0], r, *slip, v)[:2]

    columns = np.array([residual(e) for e in 1e-5 * np.eye(2)]).T - np.array(residual([0.0, 0.0]))[:, None]
    delta = np.linalg.solve(columns / 1e-5, -np.array(residual([0.0, 0.0])))[1]
    L, l_f = other.wheelbase, other.l_f
    understeer = other.mass / L * ((L - l_f) / other.C_f - l_f / other.C_r)
    assert other.locked_half_track == 0.0
    assert delta == pytest.approx((L / v + understeer * v) * r / other.steering_gain, rel=1e-4)
    assert replace(other, steering_gain=1.0).unlocked() == replace(other, steering_gain=1.0)


def test_a_locked_axle_keeps_a_slow_car_within_its_steps():
    """The speed below which slip is softened grows with its damping."""
    wide = LOCKED | dict(locked_half_track=3.0, inertia_z=500.0)
    L, l_f, m = wide["wheelbase"], wide["l_f"], wide["mass"]
    turn = wide["C_f"] * l_f**2 + wide["C_r"] * ((L - l_f) ** 2 + 9.0)
    lowest = ((wide["C_f"] + wide["C_r"]) / m + turn / wide["inertia_z"]) / 400
    model = SaturatingBicycle(params=SaturatingBicycleParams(**wide), dt=0.01)
    x = np.array([0.1, 0.2])
    slow, limit, fast = (model.derivative(x, np.array([0.05, v])) for v in (0.1 * lowest, lowest, 1.1 * lowest))
    assert slow == pytest.approx(limit, rel=1e-12)
    assert fast[1] != pytest.approx(limit[1])


def test_relaxing_bicycle():
    params = SaturatingBicycleParams(**SATURATING, **STEERED, relaxation_f=0.4, relaxation_r=0.6)
    model = RelaxingBicycle(params=params, dt=0.01)

    def oracle(v_y, r, alpha_f, alpha_r, delta, v_x):
        slip = vehicles.small_slip(CHASSIS, v_y, r, vehicles.road_wheel(STEERED, delta), v_x)
        late = [np.hypot(length / v_x, 0.005) for length in (0.4, 0.6)]
        found = vehicles.saturating_bicycle(SATURATING, v_y, r, alpha_f, alpha_r, v_x)
        return [*found[:2], (slip[0] - alpha_f) / late[0], (slip[1] - alpha_r) / late[1]]

    slips = (-0.2, 0.2), (-0.2, 0.2)
    points = uniform(6, 300, STATE["v_y"], STATE["r"], *slips, STATE["delta"], STATE["v_x"])
    agree(rates(model), oracle, points)


@pytest.mark.parametrize("steered", [False, True])
def test_load_transfer(steered):
    """What braking moves forward balances the moment of the car's inertia about the ground, height above it.

    Three tenths of what drives the car and six of what slows it act on the front axle.
    """
    params = SaturatingBicycleParams(**SATURATING, **STEERED)
    of = dict(height=0.52, load_lag=0.07, drive_rear=0.7, brake_rear=0.4)
    car = SaturatingBicycle(params=replace(params, gain_v_x=0.93), dt=0.01, outputs=("a_y",))
    model = LoadTransfer(Steered(car, steering_lag=0.08), **of) if steered else LoadTransfer(car, **of)

    def oracle(v_y, r, *rest):
        *delta_s, v_x_s, delta, logged = rest
        rate, v_x = (logged - v_x_s) / 0.07, 0.93 * logged
        a_x = 0.93 * rate - v_y * r
        turned = vehicles.road_wheel(STEERED, delta_s[0] if steered else delta)
        slip = vehicles.small_slip(CHASSIS, v_y, r, turned, v_x)
        F_x = CHASSIS["mass"] * a_x
        along_f = np.where(F_x > 0, 0.3 * F_x, 0.6 * F_x)
        pushed = {"forward": -F_x * 0.52 / CHASSIS["wheelbase"], "along_f": along_f, "along_r": F_x - along_f}
        static = CHASSIS["mass"] * vehicles.G * (CHASSIS["wheelbase"] - CHASSIS["l_f"]) / CHASSIS["wheelbase"]
        carried = static + SATURATING["downforce_f"] * v_x**2 + pushed["forward"]
        most = 1.1 * np.sqrt(1.0 - 0.2**2) * SATURATING["mu_f"] * carried  # which leaves the least across
        pushed["across_f"] = np.clip(along_f, -most, most) * turned
        found = vehicles.saturating_bicycle(SATURATING | pushed, v_y, r, *slip, v_x)
        turning = [(delta - delta_s[0]) / 0.08] if steered else []
        return [*found[:2], *turning, rate, found[2]]

    fast = (20.0, 21.0)  # the speed and what it was, so that the car brakes and drives off as hard as cars may
    states = (STATE["v_y"], STATE["r"], *((STATE["delta"],) if steered else ()), fast)
    agree(rates(model, "a_y"), oracle, uniform(9, 300, *states, STATE["delta"], fast))


def test_a_speed_that_jumps_turns_no_car_over():
    """Wheels that lock and a receiver that loses its place show such: a fifth of the grip stays across."""
    params = SaturatingBicycleParams(**SATURATING)
    model = LoadTransfer(SaturatingBicycle(params=params, dt=0.01), height=0.5, load_lag=0.05, brake_rear=0.4)
    weak = {name: 0.2 * getattr(params, name) for name in ("C_f", "C_r", "mu_f", "mu_r")}
    carried = replace(params, load_shift=0.45).load_ratios(20.0)[0] * params.l_r / params.wheelbase
    braked = -1.1 * np.sqrt(1.0 - 0.2**2) * params.mu_f * carried
    held = SaturatingBicycle(params=replace(params, load_shift=0.45, along_f=braked, **weak), dt=0.01)
    x, u = np.array([0.1, 0.2]), np.array([0.05, 20.0])
    jumped = model.derivative(np.array([*x, 40.0]), u)
    assert jumped[:2] == pytest.approx(held.derivative(x, u), rel=1e-12)
    assert jumped[2] == pytest.approx(-20.0 / 0.05)


def test_bank():
    """The left edge higher, the car is pulled to the right; its accelerometer reads the tires' force all the same."""
    car = CHASSIS | dict(C_f=83e3, C_r=127e3)
    model = Banked(Bicycle(params=BicycleParams(**car, **STEERED), dt=0.01, outputs=("a_y",)))

    def oracle(v_y, r, delta, v_x, bank):
        found = vehicles.bicycle(car, v_y, r, vehicles.road_wheel(STEERED, delta), v_x)
        return [found[0] - vehicles.G * np.sin(bank), found[1], found[0] + v_x * r]

    agree(rates(model, "a_y"), oracle, uniform(8, 300, *STATE.values(), (-0.2, 0.2)))


def test_steering():
    """The road wheels follow by a first-order lag, no faster than the rate; the car is driven by where they are."""
    car = Bicycle(params=BicycleParams(**CHASSIS, **STEERED, C_f=83e3, C_r=127e3), dt=0.01, outputs=("a_y",))
    model = Steered(car, steering_lag=0.08, steering_rate=0.9)

    def oracle(v_y, r, delta_s, delta, v_x):
        turning = np.clip((delta - delta_s) / 0.08, -0.9, 0.9)
        found = vehicles.bicycle(
            CHASSIS | dict(C_f=83e3, C_r=127e3), v_y, r, vehicles.road_wheel(STEERED, delta_s), v_x
        )
        return [*found, turning, found[0] + v_x * r]

    points = uniform(7, 300, STATE["v_y"], STATE["r"], STATE["delta"], STATE["delta"], STATE["v_x"])
    agree(rates(model, "a_y"), oracle, points)


def driven(car, tire, slip):
    def oracle(*z):
        steered = [vehicles.road_wheel(STEERED, z[8]), *z[9:]]
        return vehicles.single_track(car, tire, slip, z[:8], steered)

    return oracle


@TIRES
def test_single_track_with_its_accelerations_and_slip_angles(front, rear, tire):
    params = SOUSA_TABLE_6_1.with_values(**CAR, **STEERED)
    model = SingleTrack(params=params, dt=0.001, tire_f=front, tire_r=rear)
    wheels = (10.0, 150.0)
    points = uniform(5, 500, (2.0, 45.0), (-4, 4), (-0.9, 0.9), wheels, wheels, (-50, 50), (-50, 50), (-6, 6),
                     (-0.4, 0.4), (-900, 900), (-900, 900))  # fmt: skip
    ours = rates(model, "a_x", "a_y", "alpha_f", "alpha_r")
    soft = partial(tires.soft_slip, low=0.2 * CAR["wheelbase"])
    agree(ours, driven(CAR, tire, soft), points)
    agree(ours, driven(CAR, tire, tires.sharp_slip), points, tol=5e-4)  # the slip that the thesis prints


def test_single_track_in_reverse_is_slowed_sideways():
    """Rolling backwards, side forces still oppose the sideways velocity of each axle, in the wheel's own plane."""
    model = SingleTrack(
        params=SOUSA_TABLE_6_1.with_values(**CAR), dt=0.001, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2
    )
    for v_x, v_y, r, delta in uniform(6, 200, (-8, -1), (-0.6, 0.6), (-0.4, 0.4), (-0.3, 0.3)):
        rolling_f, across_f = vehicles.turned(-delta, v_x, v_y + CAR["l_f"] * r)
        across_r = v_y - (CAR["wheelbase"] - CAR["l_f"]) * r
        x = np.array([v_x, v_y, r, rolling_f / CAR["radius"], v_x / CAR["radius"], 0, 0, 0])
        found = model.signals(x, np.array([delta, 0.0, 0.0]))
        assert found["alpha_f"] == pytest.approx(-np.arctan2(across_f, -rolling_f), abs=0.02)
        assert found["alpha_r"] == pytest.approx(-np.arctan2(across_r, -v_x), abs=1e-12)


@TIRES
def test_quasi_steady_wheels(front, rear, tire):
    params = SOUSA_TABLE_6_1.with_values(**CAR, **STEERED)
    model = QuasiSteadySingleTrack(params=params, dt=0.1, tire_f=front, tire_r=rear, grip=0.8)

    def oracle(*z):
        return vehicles.quasi_steady(CAR, tire, 0.8, z[:6], [vehicles.road_wheel(STEERED, z[6]), *z[7:]])

    points = uniform(7, 400, (2.0, 45.0), (-4, 4), (-0.9, 0.9), (-50, 50), (-50, 50), (-6, 6), (-0.4, 0.4),
                     (-3000, 3000), (-3000, 3000))  # fmt: skip
    agree(rates(model), oracle, points)


# ---- limit cases ----------------------------------------------------------------------------------------------------


def test_a_coasting_single_track_keeps_its_energy_but_for_what_tires_take():
    """Power balance: d/dt of the kinetic energy is torque times spin minus what slip takes, which is never negative."""
    model = SingleTrack(
        params=SOUSA_TABLE_6_1.with_values(**CAR), dt=0.001, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2
    )
    for z in uniform(
        8, 300, (2, 45), (-4, 4), (-0.9, 0.9), (10, 150), (10, 150), (-0.4, 0.4), (-900, 900), (-900, 900)
    ):
        x, u = np.array([*z[:5], 0, 0, 0]), z[5:]
        rate = model.derivative(x, u)
        inertia = [CAR[k] for k in ("mass", "mass", "inertia_z", "inertia_wheel_f", "inertia_wheel_r")]
        gained = sum(i * v * a for i, v, a in zip(inertia, x, rate[:5], strict=False))
        assert gained <= u[1] * x[3] + u[2] * x[4]


def test_units_of_the_catalogue():
    """Tables 6.1 and 6.2 are printed per axle of two wheels, per percent and per degree, as forces at 50/50 load."""
    load = 2500 * 9.81 / 4
    assert SOUSA_TABLE_6_1.load_f == pytest.approx(load, rel=1e-12)
    s, degrees = np.linspace(-100, 100, 41), np.linspace(-20, 20, 41)
    F_x = tires.magic(s, 0.208, 1.65, 6213.4, 0.604)
    F_y = tires.magic(degrees, 0.154, 1.3, 5367.9, -1.464)
    found = SOUSA_TABLE_6_2.forces(s / 100, np.deg2rad(degrees), load)
    np.testing.assert_allclose(found.F_x, F_x, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(found.F_y, F_y, rtol=1e-12, atol=1e-9)
