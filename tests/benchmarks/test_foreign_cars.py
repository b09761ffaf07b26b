"""The test bed of foreign cars: what it says about its cars is so, and its competitor finds what it should."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from benchmarks.foreign_cars import fleet, judge, scipy_fit
from benchmarks.foreign_cars.manoeuvres import H
from benchmarks.foreign_cars.mistakes import MISTAKES
from benchmarks.foreign_cars.plants import Steering, static_loads, stiffness, top_speed_stable

from slipangle.data.dataset import Dataset, join

KNOWN = scipy_fit.Known(mass=1500.0, wheelbase=2.7, l_f=1.2)
CAR = {
    **dict(C_f=9e4, C_r=1.1e5, inertia_z=2400.0, mu_f=0.9, mu_r=1.0, steering_gain=1.04, steering_offset=0.004),
    **dict(delay=0.035, lag=0.06, sensor_x=-0.15),
}


def a_log(v_x, seed, seconds=8.0, dt=0.02):
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds / dt)) * dt
    f = np.geomspace(0.2, 2.0, 12)[:, None]
    delta = 0.012 * np.sin(2 * np.pi * (f * t + rng.random((12, 1)))).sum(axis=0) * 12 / v_x
    zeros = {"v_y": np.zeros(len(t)), "r": np.zeros(len(t))}
    return Dataset.from_arrays({"delta": delta, "v_x": np.full(len(t), v_x)}, zeros, dt)


def test_the_competitor_finds_the_car_that_it_simulates():
    data = join(a_log(10.0, 0), a_log(18.0, 1), a_log(26.0, 2))
    true = scipy_fit.ScipyFit(known=KNOWN, outputs=("v_y", "r"), values=CAR, std={}, cost=0.0)
    y = true.simulate(data)
    data = data.with_channel("v_y", y[:, 0]).with_channel("r", y[:, 1])
    found = scipy_fit.fit(data, KNOWN, sensor_free=True)
    assert found.values == pytest.approx(CAR, rel=1e-3, abs=1e-5)
    np.testing.assert_allclose(found.simulate(data), y, atol=1e-4)


def test_experiments_of_other_lengths_change_nothing():
    long, short = a_log(15.0, 0), a_log(15.0, 1, seconds=3.0)
    car = scipy_fit.ScipyFit(known=KNOWN, outputs=("v_y", "r"), values=CAR, std={}, cost=0.0)
    both = car.simulate(join(long, short))
    np.testing.assert_allclose(both[len(long) :], car.simulate(short), atol=1e-12)


def test_a_ramp_comes_late_by_delay_and_lag():
    steering = Steering(delay=0.03, lag=0.08, gain=0.95, offset=0.01, ratio=-14.0)
    t = H * np.arange(3000)
    wheel = steering.road_wheel(0.1 * t)
    assert t[-1] + 0.5 * H - wheel[-1] / 0.1 == pytest.approx(0.11, abs=1e-9)
    assert steering.gain * (steering.logged(0.2 * t) - steering.offset) == pytest.approx(0.2 * t)


def test_the_fleet_is_twenty_stable_cars_from_1_5_kg_to_40_t():
    names = fleet.cars()
    assert len(names) + len(fleet.missing()) == 20
    made = [fleet.make(name) for name in names]
    assert {min(c.plant.mass for c in made), max(c.plant.mass for c in made)} == {1.5, 40e3}
    for car in made:
        assert top_speed_stable(car.plant), car.name
        assert 0 <= car.steering.delay <= 0.06
        assert 0 <= car.steering.lag <= 0.1
        assert len(car.drives[0]) == 12
        assert len(car.drives[1]) == 4


@pytest.mark.slow
@pytest.mark.parametrize("name", ["1:10 car", "medium saloon", "truck, 40 t"])
def test_stiffness_of_a_car_is_that_of_its_tires_where_they_have_no_trail_and_roll_freely(name):
    car = fleet.make(name).plant
    tires = [tire.with_coefficients(QDZ1=0.0) for tire in (car.model.tire_f, car.model.tire_r)]
    params = replace(car.model.params, rolling_resistance=0.0)
    bare = replace(car, model=replace(car.model, params=params, tire_f=tires[0], tire_r=tires[1]))
    loads = static_loads(car.mass, car.wheelbase, car.l_f)
    wanted = [fleet.axle_stiffness(tire, load) for tire, load in zip(tires, loads, strict=True)]
    np.testing.assert_allclose(stiffness(bare), [wanted, wanted], rtol=1e-3)


@pytest.mark.slow
def test_a_log_is_the_same_again_and_differs_by_noise_alone():
    car = fleet.make("Formula Student")
    assert np.array_equal(car.train(1).values, car.train(1).values)
    clean, noisy = car.test(None), car.test(2)
    for name in ("v_y", "r", "a_y", "delta"):
        assert (noisy[name] - clean[name]).std() == pytest.approx(car.noise[name], rel=0.05)
    assert np.abs(car.train(None)["a_y"]).max() <= 0.42 * car.plant.most
    assert np.abs(clean["a_y"]).max() <= 0.58 * car.plant.most
    assert car.truth.spread < 0.01


@pytest.mark.slow
def test_the_multi_body_car_drives_as_its_package_says():
    dynamics = pytest.importorskip("vehiclemodels.vehicle_dynamics_mb")
    from benchmarks.foreign_cars.multi_body import MultiBody, parameters

    car = MultiBody(params=2, dt=0.001, outputs=("v_x", "v_y", "r", "a_y"))
    x = car.straight(20.0) * (1 + 0.01 * np.random.default_rng(0).standard_normal(29))
    x[[5, 6, 10]] = 0.1, 0.02, 0.3
    for wanted in (0.4, -0.6):
        steered = x.copy()
        steered[2] = 0.03
        theirs = dynamics.vehicle_dynamics_mb(steered.tolist(), [0.0, wanted], parameters(2))
        ours = ca.evalf(car.derivative(ca.SX(x), ca.SX([0.03, wanted]))).full()
        np.testing.assert_allclose(ours.ravel(), theirs, rtol=1e-10, atol=1e-9)


def test_each_mistake_changes_the_log_or_what_is_known():
    data = join(a_log(15.0, 0), a_log(20.0, 1))
    rng = np.random.default_rng(3)
    for name in ("v_y", "r", "a_y"):
        data = data.with_channel(name, rng.standard_normal(len(data)))
    assert len(MISTAKES) == 14
    for mistake in MISTAKES:
        wrong, known = mistake.data(data), mistake.known(KNOWN)
        same = wrong.dt == data.dt and np.array_equal(wrong.values, data.values)
        assert same == (known != KNOWN), mistake.name
        assert not mistake.named(("all is well",))


def test_fit_of_a_free_run_leaves_the_start_out():
    data = join(a_log(15.0, 0), a_log(20.0, 1))
    r = np.sin(0.1 * np.arange(len(data)))
    data, y = data.with_channel("r", r), r.copy()
    for a in data.starts:
        y[a : a + 20] = 9.0
    assert judge.free_run_fits(data, ("r",), y[:, None])["r"] == pytest.approx(100.0)
    assert judge.free_run_fits(data, ("r",), np.zeros_like(y)[:, None])["r"] == pytest.approx(0.0, abs=1.0)
