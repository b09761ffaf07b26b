"""The fastest lap of a benchmark's car on a track of the database."""

import pytest
from benchmarks.bench_lap import CAR, beside_line, plain

import slipangle as sa
from slipangle.paths.path import Path


@pytest.mark.slow
def test_a_plain_program_of_the_same_car_finds_the_same_lap(real_data):
    """Another discretisation from another start, written with CasADi's Opti."""
    track = Path.from_csv(real_data("tracks/tum/Norisring.csv"))
    lap = sa.fastest_lap(CAR, track, points=300)
    _, _, lap_time = plain(track, 300, lap)
    assert lap.time == pytest.approx(lap_time, rel=0.02)


@pytest.mark.slow
def test_the_line_of_the_database_is_beaten(real_data):
    track = Path.from_csv(real_data("tracks/tum/Norisring.csv"))
    assert beside_line("Norisring", track).holds
