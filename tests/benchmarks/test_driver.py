"""A Driver with its defaults, built from what a log of the car gives, on a dual track that is not its model."""

import pytest
from benchmarks.bench_driver import BOUNDS, Car, beside_the_law
from benchmarks.bench_driver_fleet import FleetCar
from benchmarks.bench_driver_lap import BRAKE, CARS, DRIVE, MOST, TrackCar

from slipangle.codegen.compiler import compiler, sentence
from slipangle.paths.path import Path
from slipangle.simulate.run import End


@pytest.mark.slow
@pytest.mark.skipif(compiler() is None, reason=sentence())
def test_iso_3888_at_24_m_per_s_from_raw_measurements():
    """One seed of the benchmark: true pose at 100 Hz, and a pose at 10 Hz that is 100 ms late."""
    car = Car("dual track")
    model = car.identified()
    for pose, bound in BOUNDS.items():
        assert car.error(model, pose, 0) < bound
    assert all(record.holds for record in beside_the_law("dual track", car, model))


@pytest.mark.slow
@pytest.mark.skipif(compiler() is None, reason=sentence())
@pytest.mark.parametrize("name", ["1:10 car", "truck, 40 t"])
def test_a_lane_change_of_a_car_of_another_size(name):
    """One seed of the benchmark on its lightest and its heaviest car."""
    car = FleetCar(name)
    for pose, bound in BOUNDS.items():
        assert car.error(pose, 0) < bound


@pytest.mark.slow
@pytest.mark.skipif(compiler() is None, reason=sentence())
def test_a_lap_of_the_norisring(real_data):
    """One seed of the benchmark, the late pose."""
    track = Path.from_csv(real_data("tracks/tum/Norisring.csv"))
    car = TrackCar("sports car")
    path = track.with_speed_limits(v_max=car.fastest, a_y=CARS["sports car"], a_x=DRIVE, a_brake=BRAKE)
    run = car.along(path, "late pose", 0)
    assert run.end is End.FINISHED
    assert 100.0 * run.rmse("y") < MOST
