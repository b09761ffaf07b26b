"""The fastest lap of a benchmark's car on a track of the database."""

import numpy as np
import pytest
from benchmarks.bench_lap import CAR, N_STATES, beside_line, finely, plain

import slipangle as sa
from slipangle.optimal.lap.car import forces
from slipangle.paths.path import Path


@pytest.mark.slow
def test_a_plain_program_of_the_same_car_finds_the_same_lap(real_data):
    """Another discretisation from another start, written with CasADi's Opti."""
    track = Path.from_csv(real_data("tracks/tum/Norisring.csv"))
    lap = sa.fastest_lap(CAR, track, points=300)
    assert lap.time == pytest.approx(plain(track, 300, lap).time, rel=0.02)


def test_intervals_driven_finely_add_up_to_the_lap():
    """A straight at a speed that the car holds: its time, no jump, no excess."""
    X = np.linspace(0.0, 200.0, 50)
    track = Path.from_points(X, 0 * X, right=5.0, left=5.0)
    force = forces(0.0, 0.0, 0.0, 0.0, 30.0, CAR).resistance
    state = np.zeros(N_STATES + 2)
    state[2], state[6] = 30.0, force
    driven = finely(track, np.linspace(0.0, 150.0, 31), np.tile(state, (31, 1)))
    assert driven.time == pytest.approx(5.0, rel=1e-6)
    assert driven.jump < 1e-9
    assert driven.excess == 0
    off = np.tile(state, (31, 1))
    off[7:, 0] = 0.25
    assert finely(track, np.linspace(0.0, 150.0, 31), off).jump == pytest.approx(0.25)


@pytest.mark.slow
def test_the_line_of_the_database_is_beaten(real_data):
    track = Path.from_csv(real_data("tracks/tum/Norisring.csv"))
    assert beside_line("Norisring", track).holds
