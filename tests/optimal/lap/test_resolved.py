"""Measured lines: noise, folds and overlaps are named before a lap is looked for; sound tracks never are."""

import warnings

import numpy as np
import pytest
from benchmarks.bench_lap import random_track

import slipangle as sa
from slipangle.errors import ModelWarning, ParameterError
from slipangle.optimal.lap.resolved import require_resolved
from slipangle.paths.lane_change import double_lane_change
from tests.optimal.lap.cars import RACER, circuit, ring, straight


def measured(noise=0.0, beyond=0, aside=0.0, **how):
    """The circuit by points 2.8 m apart with noise, the first ones once more at the end, so much beside. [m]"""
    track, rng = circuit(), np.random.default_rng(0)
    s = np.arange(0.0, track.length - 1.4, 2.8)
    first, again = track.at(s), track.at(s[:beyond] + 1.0)
    X, Y = (
        np.concatenate([first.X, again.X - aside * np.sin(again.psi)]),
        np.concatenate([first.Y, again.Y + aside * np.cos(again.psi)]),
    )
    X, Y = (c + noise * rng.normal(size=len(c)) for c in (X, Y))
    return sa.Path.from_points(X, Y, closed=True, right=5.0, left=5.0, name="measured", **how)


def hairpins(radius, half=4.0):
    """Two straights of 120 m, joined by half circles."""
    t, b = np.arange(0.0, 120.0, 3.0), np.linspace(-np.pi / 2, np.pi / 2, max(round(np.pi * radius / 3.0), 8) + 1)[1:]
    X = np.concatenate([t, 120.0 + radius * np.cos(b), 120.0 - t[1:], -radius * np.cos(b[:-1])])
    Y = np.concatenate([0 * t - radius, radius * np.sin(b), 0 * t[1:] + radius, -radius * np.sin(b[:-1])])
    return sa.Path.from_points(X, Y, closed=True, smoothing=0.1, right=half, left=half)


def eight(size=1.0):
    a = np.linspace(0, 2 * np.pi, 240)[:-1]
    return sa.Path.from_points(90 * size * np.sin(a), 45 * size * np.sin(2 * a), closed=True)


@pytest.mark.parametrize("noise", [0.1, 0.2])
def test_noise_is_named_and_smoothing_takes_it_out(noise):
    with pytest.warns(ModelWarning, match=r"turns to and fro by .* m after its start, .* smoothing="):
        require_resolved(measured(noise), RACER.size)
    smooth = sa.fastest_lap(RACER, measured(noise, smoothing=noise), points=80)
    assert smooth.time == pytest.approx(sa.fastest_lap(RACER, circuit(), points=80).time, rel=0.01)


def test_a_slalom_is_driven_whatever_is_said_of_it():
    """Cones 8 m apart, as Formula Student has them, passed at 1.5 m."""
    x = np.arange(0.0, 120.0, 1.0)
    slalom = sa.Path.from_points(x, 1.5 * np.sin(np.pi * x / 8.0), right=1.5, left=1.5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        require_resolved(slalom, 0.7)


@pytest.mark.parametrize("aside", [0.0, 0.3, 1.5, 2.5])
@pytest.mark.parametrize("beyond", [1, 3, 10, 40])
def test_points_past_the_start_are_named(beyond, aside):
    """Within 30 m of the start or at the end of what overlaps."""
    with pytest.raises(ParameterError, match=r"comes past its start again|folds back|to and fro") as said:
        sa.fastest_lap(RACER, measured(beyond=beyond, aside=aside))
    assert "overlap" in str(said.value)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("aside", [0.0, 2.0])
def test_a_recording_of_several_laps_is_named(seed, aside):
    """As a logger begins and ends it anywhere, lap after lap up to ``aside`` beside the line, with noise of GPS."""
    track, rng = circuit(), np.random.default_rng(seed)
    s = np.arange(37.0, 37.0 + 2.7 * track.length, 1.5)
    at, n = track.at(s), np.interp(s, 37.0 + 100.0 * np.arange(17), aside * rng.uniform(-1, 1, 17))
    X, Y = at.X - n * np.sin(at.psi), at.Y + n * np.cos(at.psi)
    X, Y = (c + 0.5 * rng.normal(size=len(s)) for c in (X, Y))
    half = {"smoothing": 0.5, "right": 5.0, "left": 5.0}
    with pytest.warns(ModelWarning, match=r"goes along itself again from 5[4-8]\d m on, over \d+% of its length"):
        require_resolved(sa.Path.from_points(X, Y, **half), 1.0)
    with pytest.raises(ParameterError, match=r"comes past its start again|goes along itself again"):
        require_resolved(sa.Path.from_points(X, Y, closed=True, **half), 1.0)


def test_a_line_that_crosses_or_nears_itself_is_no_recording():
    a, right = np.linspace(0, 2 * np.pi, 400)[:-1], {"right": 3.0, "left": 3.0}
    require_resolved(sa.Path.from_points(32 * np.sin(a), 20 * np.sin(2 * a), closed=True, **right), 1.0)
    spiral = np.linspace(2 * np.pi, 8 * np.pi, 800)  # 6.3 m from turn to turn
    require_resolved(sa.Path.from_points(spiral * np.cos(spiral), spiral * np.sin(spiral), **right), 1.0)
    x = np.concatenate([np.linspace(0, 100, 50), 100 + 4 * np.sin(a[:200:8][1:]), np.linspace(100, 0, 50)])
    y = np.concatenate([np.zeros(50), 4 - 4 * np.cos(a[:200:8][1:]), np.full(50, 8.0)])
    require_resolved(sa.Path.from_points(x, y, **right), 1.0)


def test_bends_between_the_samples_are_named():
    x = np.array([0.0, 50.0, 100.0, 100.5, 100.5, 50.0, 0.0])
    spike = sa.Path.from_points(x, np.array([0.0, 0.0, 0.0, 0.3, 0.6, 0.9, 1.2]), smoothing=0.0, right=3.0, left=3.0)
    with pytest.raises(ParameterError, match=r"folds back|to and fro"):
        sa.fastest_lap(RACER, spike)


def test_sound_tracks_are_not_called_noisy():
    rng = np.random.default_rng(0)
    random = [random_track(rng) for _ in range(50)]
    for track in (*random, circuit(), ring(), straight(), eight(), *map(hairpins, (4.0, 6.0, 9.0, 15.0))):
        for size in (0.4, 1.0, 2.1):
            require_resolved(track, size)
    require_resolved(eight(0.1), 0.1)
    require_resolved(double_lane_change(v_x=20.0), 1.0)


@pytest.mark.parametrize("name", ["Budapest", "Monza", "Norisring", "Silverstone", "Spielberg"])
def test_race_tracks_are_not_called_noisy(name, real_data):
    require_resolved(sa.Path.from_file(real_data(f"tracks/tum/{name}.csv")), 1.0)


def test_a_track_in_kilometres_is_named():
    track = circuit()
    small = sa.Path.from_points(track.X[::20] / 1000, track.Y[::20] / 1000, closed=True, right=5.0, left=5.0)
    with pytest.raises(ParameterError, match=r"0\.56\d? m long; expected 27 m at least .* not in kilometres"):
        sa.fastest_lap(RACER, small)


@pytest.mark.parametrize(("radius", "within"), [(4.0, 1e-3), (9.0, 1e-3)])
def test_tight_hairpins_have_the_points_that_they_need(radius, within):
    lap = sa.fastest_lap(RACER, hairpins(radius))
    fine = sa.fastest_lap(RACER, hairpins(radius), points=4 * len(lap.s))
    assert lap.time == pytest.approx(fine.time, rel=within)


def test_points_too_far_apart_for_a_bend_are_named():
    """Hairpins of 9 m, half of 297 m a lap: 40 points are one every 7.4 m, 60 one every 5 m."""
    track = hairpins(9.0)
    said = r"40 points of 'path' are one every 7\.\d* m, .* radius of 8\.\d* m: .*360 points"
    with pytest.warns(ModelWarning, match=said):
        sa.fastest_lap(RACER, track, points=40)
    sa.fastest_lap(RACER, track, points=60)
