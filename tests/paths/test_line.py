"""The compiled line against NumPy: the same feet, places and looks ahead on random lines, also where they meet.

The NumPy functions are what runs without a compiler, and are tested on exact shapes in `test_path`.
"""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from slipangle.codegen.compiler import compiler
from slipangle.control.followers.followers import Stanley
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Values
from slipangle.paths.lane_change import double_lane_change
from slipangle.paths.path import Path
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler")


def wanderer(rng):
    turns = np.cumsum(rng.normal(0, 0.25, 40))
    return Path.from_points(*np.cumsum(8 * np.array([np.cos(turns), np.sin(turns)]), axis=1))


def ring(rng):
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    radius = 60 + 15 * np.sin(3 * angle + rng.uniform(0, 6))
    return Path.from_points(radius * np.cos(angle), radius * np.sin(angle), closed=True, left=4.0)


def eight(rng):
    """Crosses itself."""
    t = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    return Path.from_points(80 * np.sin(t), rng.uniform(20, 40) * np.sin(2 * t), closed=True, right=3.0, left=5.0)


def hairpins(rng):
    """Runs back 3 to 5 m beside itself."""
    gap = rng.uniform(3, 5)
    x, y = [], []
    for k in range(4):
        along = np.linspace(0, 50, 15)
        x += list(along if k % 2 == 0 else along[::-1])
        y += list(np.full(15, k * gap))
    return Path.from_points(np.array(x), np.array(y))


def spiral(rng):
    angle = np.linspace(0, 6 * np.pi, 90)
    radius = 10 + rng.uniform(0.6, 1.0) * angle
    return Path.from_points(radius * np.cos(angle), radius * np.sin(angle))


def marked(rng):
    return double_lane_change(float(rng.uniform(10, 30)), width=1.8)


MAKERS = (wanderer, ring, eight, hairpins, spiral, marked)
EVERY = pytest.mark.parametrize("make", MAKERS, ids=lambda m: m.__name__)


def pair(make, seed):
    """A path, compiled and in NumPy."""
    rng = np.random.default_rng(seed)
    path = make(rng)
    speed = rng.choice([0, 1]) * np.linspace(5, 25, len(path.s)) + 5
    path = path.with_speed(speed[::-1] if seed % 2 else speed)
    plain = replace(path)
    vars(plain)["line"] = None
    assert path.line is not None
    return path, plain, rng


@EVERY
@pytest.mark.parametrize("seed", range(4))
def test_feet(make, seed):
    path, plain, rng = pair(make, seed)
    for _ in range(60):
        at = rng.uniform(-20, path.length + 20)
        p = plain.at(at)
        X, Y = rng.normal([p.X[0], p.Y[0]], rng.choice([0.1, 2.0, 10.0]))
        near = at + rng.normal(0, 3) + (rng.integers(-2, 3) * path.length if path.closed else 0.0)
        for start in (None, near):
            assert path.project(X, Y, start) == pytest.approx(plain.project(X, Y, start), abs=1e-9)
        window = float(rng.choice([1.0, 40.0, 3 * path.length]))
        assert path.project(X, Y, near, window=window) == pytest.approx(
            plain.project(X, Y, near, window=window), abs=1e-9
        )


@EVERY
@pytest.mark.parametrize("start", [None, 5.0])
def test_feet_of_a_drive(make, start):
    path, plain, rng = pair(make, 7)
    s = np.linspace(0, path.length * (2.3 if path.closed else 1.05), 150)
    line = plain.at(s)
    aside = np.cumsum(rng.normal(0, 0.05, len(s)))
    X, Y = line.X - aside * np.sin(line.psi), line.Y + aside * np.cos(line.psi)
    assert path.project_all(X, Y, start) == pytest.approx(plain.project_all(X, Y, start), abs=1e-9)
    assert np.array_equal(path.inside(X, Y, 1.8), plain.inside(X, Y, 1.8))


@EVERY
def test_places(make):
    path, plain, rng = pair(make, 3)
    s = np.concatenate([rng.uniform(-2 * path.length, 3 * path.length, 200), path.s[::17], [0.0, path.length]])
    for name in ("s", "X", "Y", "psi", "curvature", "v_x", "right", "left"):
        assert getattr(path.at(s), name) == pytest.approx(getattr(plain.at(s), name), abs=1e-9)
    bare, simple = (replace(p, v_x=None, right=None, left=None) for p in (path, plain))
    vars(simple)["line"] = None
    for name in ("v_x", "right", "left"):
        assert np.array_equal(getattr(bare.at(s), name), getattr(simple.at(s), name), equal_nan=True)


@EVERY
def test_looks_ahead(make):
    path, plain, rng = pair(make, 5)
    for v_x in (None, 0.0, 14.0, -30.0):
        for times in (0.05 * np.arange(21), np.array([0, 0.05, 0.1, 0.3, 0.9])):
            s = rng.uniform(-10, path.length)
            ours, theirs = path.ahead(s, times, v_x=v_x), plain.ahead(s, times, v_x=v_x)
            for name in ("s", "X", "Y", "psi", "curvature", "v_x", "right", "left", "t"):
                assert getattr(ours, name) == pytest.approx(getattr(theirs, name), abs=1e-9)
    bare, simple = (replace(p, v_x=None) for p in (path, plain))
    vars(simple)["line"] = None
    assert bare.ahead(3.0, 20, 0.05, v_x=9.0).psi == pytest.approx(simple.ahead(3.0, 20, 0.05, v_x=9.0).psi, abs=1e-9)


def test_a_drive_has_the_same_numbers():
    path = double_lane_change(15.0)
    plain = replace(path)
    vars(plain)["line"] = None
    plant = Plant(OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.005)), delay=Values(delta=0.02), noise=Values(X=0.01))
    ours, theirs = (closed_loop(plant, Stanley(params=SOUSA_TABLE_7_2), p) for p in (path, plain))
    for name in ("t", "e_y", "e_psi", "s", "states", "commands"):
        assert getattr(ours, name) == pytest.approx(getattr(theirs, name), abs=1e-9)
    assert ours.inside == theirs.inside


def test_places_that_are_none_are_nan_and_copies_are_whole():
    path = double_lane_change(15.0)
    assert np.isnan(path.at(np.array([np.nan])).X).all()
    assert np.isnan(path.at(np.array([np.inf])).X).all()
    again = pickle.loads(pickle.dumps(path))
    assert again.project(40.0, 1.0) == path.project(40.0, 1.0)
