"""A car of a sixteenth of all lengths and its forces to the same scale drives as the full one, four times as quickly.

Under the same gravity, lengths that shrink by k leave every ratio of forces as it is where masses shrink by k^3 and
times by the root of k (W. Froude's law of similarity). No number of lap, filter or plan may say how large a car is.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.racing.learning import Learned
from slipangle.control.racing.planner import Planner
from slipangle.control.racing.sectors import Sectors
from slipangle.control.racing.sensing import Sensing, usual_noise
from slipangle.models.tires.simple import MagicCurve, SimpleMagicFormula
from slipangle.models.vehicles.on_tires import dual_track_on
from slipangle.models.vehicles.parameters import BicycleParams
from slipangle.optimal.lap.car import USUAL
from slipangle.optimal.lap.fastest_lap import weights_of
from tests.optimal.lap.cars import circuit

pytestmark = pytest.mark.skipif(compiler() is None, reason=sentence())
TIRE = SimpleMagicFormula(
    longitudinal=MagicCurve(B=12.0, C=1.6, D=1.0, E=0.0), lateral=MagicCurve(B=9.0, C=1.4, D=1.0, E=0.0)
)
K, TIME = 1.0 / 16.0, 1.0 / 4.0
FULL = {
    **dict(mass=1200.0, inertia_z=1500.0, wheelbase=USUAL, l_f=1.3, C_f=1.1e5, C_r=1.4e5, mu_f=1.0, mu_r=1.05),
    **dict(power=9e4, drive_force=5e3, brake_force=1.5e4, drag=0.7, width=1.8, brake_rear=0.4),
    **dict(delta_rate=1.0, force_rate=8.0),
}
POWER = {
    **dict.fromkeys(("mass", "C_f", "C_r", "drive_force", "brake_force"), 3.0),
    **{"wheelbase": 1.0, "l_f": 1.0, "width": 1.0, "drag": 2.0, "inertia_z": 5.0, "power": 3.5},
    **dict.fromkeys(("delta_rate", "force_rate"), -0.5),
}
LAP = ("n", "chi", "v_x", "v_y", "r", "delta", "F_x")


def states(k):
    """Of a lap, over those of the full car's."""
    return np.array([k, 1.0, k**0.5, k**0.5, k**-0.5, 1.0, k**3])


@cache
def car(k):
    return sa.LapCar(**{name: value * k ** POWER.get(name, 0.0) for name, value in FULL.items()})


@cache
def track(k):
    full = circuit()
    edges = {side: k * getattr(full, side) for side in ("left", "right")}
    return sa.Path.from_points(k * full.X, k * full.Y, closed=True, name="circuit", spacing=0.25 * k, **edges)


@cache
def lap(k):
    return sa.fastest_lap(car(k), track(k), smoothness=1.0)


@cache
def alike(k):
    """The full car's lap, in the small one's size."""
    full, time = lap(1.0), k**0.5
    columns = {name: scale * getattr(full, name) for name, scale in zip(LAP, states(k), strict=True)}
    columns["weights"] = weights_of(car(k), 1.0)
    return replace(full, car=car(k), track=track(k), s=k * full.s, t=time * full.t, time=time * full.time, **columns)


def test_a_lap_of_the_small_car_is_that_of_the_full_one():
    """Within what the optimum is flat by."""
    full, small = lap(1.0), lap(K)
    assert len(small.s) == len(full.s)
    assert small.ends / K == pytest.approx(full.ends, abs=1e-3)
    assert small.quasi_steady == pytest.approx(TIME * full.quasi_steady, rel=1e-5)
    assert small.cost == pytest.approx(TIME * full.cost, rel=1e-4)
    assert small.time == pytest.approx(TIME * full.time, rel=2e-4)
    assert len(small.path.s) == pytest.approx(len(full.path.s), rel=0.01)


def test_a_plan_of_the_small_car_is_that_of_the_full_one():
    """From beside the line, turned and pushed, with lags of the pedals and of the steering."""
    found = {}
    for k, time in ((1.0, 1.0), (K, TIME)):
        lags = {"lag": 0.1 * time, "brake_lag": 0.15 * time}
        full = car(k).drive_force
        pedals = sa.Pedals(
            speeds=np.array([0.0, 80.0]), full=np.full(2, full), closed=np.zeros(2), brake=np.full(2, full), **lags
        )
        planner = Planner(car(k), track(k), pedals, dt=0.05 * time, horizon=20, steering_lag=0.03 * time)
        planner.follow(alike(k), 0.5 * car(k).width + 0.2 * k)
        x = planner.at(np.array([100.0 * k]))[0]
        x[:4] += np.array([0.5 * k, 0.02, -1.0 * time, 0.1 * time])
        pushed = {"d_v_x": 0.3, "d_r": 0.2 / k}
        found[k] = planner.plan(x, 100.0 * k, 0.95, lambda s, v, full=full: np.full(len(v), full), pushed, None)
    full, small = found[1.0], found[K]
    assert small.status.solved
    assert small.u[:, 0] * TIME == pytest.approx(full.u[:, 0], abs=1e-4 * car(1.0).delta_rate)
    assert small.u[:, 1] * TIME / K**3 == pytest.approx(full.u[:, 1], abs=1e-4 * 8.0 * car(1.0).weight)
    assert small.x[:, :7] / states(K) == pytest.approx(full.x[:, :7], rel=1e-4, abs=1e-4)


def test_a_filter_of_the_small_car_sees_what_that_of_the_full_one_sees():
    """The same drive on a road that holds a tenth less, with the same noise over what is usual."""
    channels = {"X": K, "Y": K, "psi": 1.0, "v_x": K**0.5, "r": K**-0.5, "a_x": 1.0, "a_y": 1.0}
    rng = np.random.default_rng(2)
    t, errors = 0.01 * np.arange(400), rng.standard_normal((400, 7))
    r = 0.3 * np.sin(t)
    psi = 0.3 * (1.0 - np.cos(t))
    true = np.column_stack([20.0 * t, 3.0 * t**2, psi, np.full(400, 20.0), r, np.zeros(400), 20.0 * r])
    ends = []
    for k, time in ((1.0, 1.0), (K, TIME)):
        sensing = Sensing(car(k), grip_std=0.05, noise={}, gate=None, patience=25, sample=0.01 * time)
        noisy = true * np.array(list(channels.values())) ** (k != 1.0) + errors * list(usual_noise(k).values())
        for i, row in enumerate(noisy):
            wheels = {"delta": 0.05 * np.sin(t[i]), "F_x": 500.0 * k**3}
            sensing.take(dict(zip(channels, row.tolist(), strict=True)), wheels, 0.01 * time * i)
        ends.append((sensing.known.state, *sensing.grip))
    (full, grip, std), (small, small_grip, small_std) = ends
    scale = np.array([K, K, 1.0, K**0.5, K**0.5, K**-0.5, 1.0, 1.0 / K])
    assert small / scale == pytest.approx(full, rel=1e-3, abs=1e-3)
    assert (small_grip, small_std) == pytest.approx((grip, std), rel=1e-3)


def test_corners_of_the_small_car_are_those_of_the_full_one():
    full, small = Sectors(alike(1.0), 0.3), Sectors(alike(K), 0.3 * K)
    assert len(full.ends) > 2
    assert small.ends / K == pytest.approx(full.ends, abs=1e-6)
    full.faster[:], small.faster[:] = (np.linspace(0.0, 0.01, len(full.ends)) for _ in range(2))
    places = np.linspace(0.0, full.length, 200)
    assert small.speed(K * places) == pytest.approx(full.speed(places), abs=1e-9)


def test_what_is_learned_of_full_throttle_is_shared_over_as_many_wheelbases():
    full, small = Learned(500.0, 0.05), Learned(500.0 * K, 0.05, K)
    for learned, k, time in ((full, 1.0, 1.0), (small, K, TIME)):
        for i in range(100):
            learned.see(30.0 * k, 0.6, 1.0, (1.0, 0.02), 0.01 * time)
            assert (learned.most(30.0 * k, 1.0) < 1.0) == (i >= 29)


def test_a_racer_keeps_distances_and_times_in_proportion():
    """By default; what is given is kept."""
    full, small = (sa.Racer(car(k), track(k), sa.Pedals.of(on(k)), lap=alike(k), share=0.9) for k in (1.0, K))
    assert (full.margin, full.sample) == (0.15, 0.01)
    assert (small.margin, small.sample) == (0.15 * K, 0.002)  # whole milliseconds
    assert small.pedals.brake_lag == pytest.approx(TIME * full.pedals.brake_lag)
    assert small.pedals.speeds == pytest.approx(TIME * full.pedals.speeds)


def on(k):
    """A dual track around the car, on tires that know nothing of their size."""
    known = {name: getattr(car(k), name) for name in ("mass", "inertia_z", "wheelbase", "l_f", "C_f", "C_r")}
    return dual_track_on(BicycleParams(**known), TIRE)


def test_a_dual_track_around_a_car_relaxes_over_a_share_of_its_length():
    assert on(1.0).relaxation_y == pytest.approx(0.49, abs=0.01)  # m, of a car of usual size
    for name in ("relaxation_x", "relaxation_y", "radius", "height", "track_f"):
        assert getattr(on(K), name) == pytest.approx(K * getattr(on(1.0), name))
