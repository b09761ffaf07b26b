"""The dual track's derivative against `tests.oracles.dual_track`, with every part of the car switched on."""

from dataclasses import asdict, dataclass, replace

import numpy as np
import pytest

from slipangle.models.tires.simple import Tire, TireForces
from slipangle.models.vehicles.catalogue import SOUSA_CAR_7
from slipangle.models.vehicles.driveline import Brakes, Differential, Driveline, Engine, Steering
from slipangle.models.vehicles.dual_track.dual_track import STATES, DualTrack
from slipangle.models.vehicles.road import Road
from slipangle.ops import tanh
from tests.oracles import dual_track
from tests.oracles.compare import agree, uniform

CAR = replace(
    SOUSA_CAR_7,
    **dict(track_f=1.52, track_r=1.44, inertia_wheel_f=2.1, inertia_wheel_r=2.9, relaxation_x=0.21, relaxation_y=0.47),
    **dict(
        camber_f=-0.02, camber_r=-0.03, camber_roll_f=0.6, camber_roll_r=0.3, mass_unsprung_f=90, mass_unsprung_r=120
    ),
    **dict(downforce_f=0.9, downforce_r=1.4, roll_damping_f=3.1e3, roll_damping_r=2.2e3, load_lag=0.03),
    steering=Steering(limit=0.4, rate=1.1, lag=0.06, ackermann=0.7, compliance=2e-5, compliance_lag=0.02, trail=0.03),
    brakes=Brakes(torque=9000.0, bias=0.62, lag=0.07),
    driveline=Driveline(
        engine=Engine(drag=25.0, drag_slope=0.06, inertia=0.23, lag=0.12),
        ratios=(3.6, 2.1, 1.4, 1.0),
        front_share=0.37,
        front=Differential(preload=20.0, locking=0.1, slip_speed=1.5),
        rear=Differential(locking=0.3, viscosity=8.0),
        centre=Differential(preload=50.0, viscosity=3.0),
    ),
)
ROAD = Road(
    distance=(0.0, 20.0, 60.0, 100.0),
    left=(1.0, 0.6, 0.9, 0.7),
    right=(0.8, 1.0, 0.5, 0.9),
    grade=(0.0, 0.06, -0.03, 0.02),
    bank=(0.05, -0.04, 0.0, 0.08),
)
SMOOTH = dict(zip(("places", "left", "right", "grade", "bank"), (ROAD.distance, ROAD.left, ROAD.right, ROAD.grade,
              ROAD.bank), strict=True))  # fmt: skip


def forces(slip, alpha, load, camber, friction, tanh=np.tanh):
    """A tire that sees everything: F_x, F_y, M_z."""
    grip = friction * load
    F_y = grip * tanh(9.0 * alpha) + 0.8 * load * camber
    return grip * tanh(14.0 * slip), F_y, -0.03 * F_y + 0.01 * load * camber


@dataclass(frozen=True)
class Seen(Tire):
    """The same behind the toolbox's call."""

    def forces(self, slip_ratio, slip_angle, load, *, camber=0.0, friction=1.0):
        F_x, F_y, M_z = forces(slip_ratio, slip_angle, load, camber, friction, tanh)
        return TireForces(F_x, F_y, M_z=M_z)


RANGES = {
    **dict(v_x=(4.0, 45.0), v_y=(-3, 3), r=(-0.8, 0.8), X=(-9, 9), Y=(-9, 9), psi=(-6, 6), distance=(-5, 110)),
    **dict(phi=(-0.05, 0.05), phi_rate=(-0.3, 0.3), theta=(-0.04, 0.04), theta_rate=(-0.2, 0.2)),
    **dict(a_x_lag=(-6, 6), a_y_lag=(-6, 6), delta_w=(-0.3, 0.3), delta_c=(-0.01, 0.01)),
    **dict(T_e=(-80, 300), T_bf=(0, 4000), T_br=(0, 2500), gear=(0.51, 4.49)),
    **{f"omega_{w}": (2.0, 130.0) for w in dual_track.WHEELS},
    **{f"slip_{w}": (-0.3, 0.3) for w in dual_track.WHEELS},
    **{f"side_{w}": (-0.4, 0.4) for w in dual_track.WHEELS},
    **dict(delta=(-0.5, 0.5), throttle=(-0.5, 1.0), brake=(0.0, 1.0), delta_r=(-0.2, 0.2), M_z=(-4e3, 4e3)),
}
INPUTS = ("delta", "throttle", "brake")
NAMES = (*STATES, *INPUTS)
SIGNALS = ("a_x", "a_y", "F_z_fl", "F_z_fr", "F_z_rl", "F_z_rr")


def samples(seed, n, *more, **changed):
    ranges = RANGES | changed
    points = uniform(seed, n, *(ranges[name] for name in (*NAMES, *more)))
    points[:, NAMES.index("gear")] = np.round(points[:, NAMES.index("gear")])
    return points


def oracle(p, *more):
    def found(*z):
        named = dict(zip((*NAMES, *more), z, strict=True))
        rates = dual_track.rates(p, forces, SMOOTH, named, named)
        return [rates[name] for name in (*STATES, *SIGNALS)]

    return found


def ours(car):
    def found(*z):
        x, u = z[: len(STATES)], z[len(STATES) :]
        rates, extra = car.derivative(x, u), car.signals(x, u)
        return [rates[i] for i in range(len(STATES))] + [extra[name] for name in SIGNALS]

    return found


@pytest.mark.parametrize("speed", [(4.0, 45.0), (0.3, 2.4)], ids=["driving", "creeping"])
def test_every_rate_of_the_dual_track(speed):
    car = DualTrack(params=CAR, tire_f=Seen(), tire_r=Seen(), road=ROAD, dt=0.001)
    wheel = (0.5, 7.0) if speed[1] < 3 else (2.0, 130.0)
    points = samples(0, 300, v_x=speed, **{f"omega_{w}": wheel for w in dual_track.WHEELS})
    agree(ours(car), oracle(asdict(CAR)), points, tol=1e-9)


@pytest.mark.parametrize("more", [("delta_r", "M_z"), ("delta_r",), ("M_z",)])
def test_steered_rear_wheels_and_torque_vectoring_of_the_dual_track(more):
    aids = {"rear_steered": "delta_r" in more, "torque_vectored": "M_z" in more}
    car = DualTrack(params=CAR, tire_f=Seen(), tire_r=Seen(), road=ROAD, dt=0.001, **aids)
    assert car.inputs == (*INPUTS, *more)
    agree(ours(car), oracle(asdict(CAR), *more), samples(1, 300, *more), tol=1e-9)


def test_loads_carry_the_car():
    """They sum to weight and downforce, and the axles' shares are those of the lever arms at rest."""
    car = DualTrack(params=replace(CAR, downforce_f=0.0, downforce_r=0.0), tire_f=Seen(), tire_r=Seen(), dt=0.001)
    x = car.straight(20.0)
    load = np.array(car.loads(x))
    assert load.sum() == pytest.approx(CAR.mass * 9.81, rel=1e-12)
    assert (load[0] + load[1]) * CAR.l_f == pytest.approx((load[2] + load[3]) * (3.0 - CAR.l_f), rel=1e-12)
    x[STATES.index("phi")] = 0.03  # right side down
    x[STATES.index("theta")] = 0.02  # nose down
    leaning = np.array(car.loads(x))
    assert leaning[1] - leaning[0] == pytest.approx(2 * CAR.roll_stiffness_f * 0.03 / CAR.track_f, rel=1e-12)
    assert leaning[3] - leaning[2] == pytest.approx(2 * CAR.roll_stiffness_r * 0.03 / CAR.track_r, rel=1e-12)
    moved = CAR.pitch_stiffness * 0.02 / CAR.wheelbase
    assert leaning[:2].sum() - load[:2].sum() == pytest.approx(moved, rel=1e-9)


def test_the_compiled_step_is_runge_kutta_on_the_same_rates():
    """One millisecond of the C kernel, or of the virtual machine, against the textbook scheme on the oracle."""
    car = DualTrack(params=CAR, tire_f=Seen(), tire_r=Seen(), road=ROAD, dt=0.001)
    f = oracle(asdict(CAR))
    points = samples(2, 20, gear=(2.0, 2.0), **{f"slip_{w}": (-0.05, 0.05) for w in dual_track.WHEELS},
                     **{f"omega_{w}": (60.0, 70.0) for w in dual_track.WHEELS}, v_x=(19.0, 23.0))  # fmt: skip
    x, u = points[:, : len(STATES)].T, points[:, len(STATES) :].T
    h = 0.001

    def rate(x):
        return np.array([np.broadcast_to(v, x.shape[1]) for v in f(*x, *u)])[: len(STATES)]

    k1 = rate(x)
    k2 = rate(x + h / 2 * k1)
    k3 = rate(x + h / 2 * k2)
    k4 = rate(x + h * k3)
    wanted = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    gear = STATES.index("gear")
    found = np.column_stack([car.step(x[:, k], u[:, k]) for k in range(x.shape[1])])
    keep = [i for i in range(len(STATES)) if i != gear]  # the gearbox shifts between steps
    scale = np.maximum(np.abs(wanted[keep]).max(axis=1, keepdims=True), 1e-9)
    assert np.abs((found - wanted)[keep] / scale).max() < 1e-9
    if car.kernel is not None:
        compiled = np.column_stack([car.kernel.run(x[:, k], u[:, k][None])[1] for k in range(x.shape[1])])
        assert np.abs((compiled - wanted)[keep] / scale).max() < 1e-9
