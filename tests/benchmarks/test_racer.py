"""Ten laps of the benchmark of racing."""

import numpy as np
import pytest
from benchmarks.bench_racer import bench, plant

import slipangle as sa
from slipangle.codegen.compiler import compiler, sentence
from slipangle.simulate.race_car import fitted

pytestmark = [pytest.mark.slow, pytest.mark.skipif(compiler() is None, reason=sentence())]


def test_ten_laps_stay_on_the_track(real_data):
    real_data("tracks/tum/Norisring.csv")
    records = bench(lambda share, what: None, seeds=(0,)).records
    found = {record.quantity: record for record in records}
    assert found["laps"].holds
    assert found["least room between car and edges, m"].holds
    assert found["slowest lap over the optimum, %"].holds


def test_the_fitted_car_is_that_of_the_plant_s_bends():
    raw = sa.lap_car(plant(), power=7e4)
    car = fitted(raw, plant())
    assert 0.8 < car.C_f / raw.C_f < 0.95  # camber by roll and the flatter curve of the outer tire
    assert np.isclose(car.mu_r / raw.mu_r, 0.98, atol=0.02)
    assert 1.1 < car.mu_x < 1.15
