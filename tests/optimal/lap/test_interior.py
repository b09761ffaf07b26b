"""The interior point along the track: against Ipopt on the same program, finite differences and a dense solve."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.optimal.lap import solve as solvers
from slipangle.optimal.lap.collocated import Collocated, compiled
from slipangle.optimal.lap.interior import InteriorPoint
from slipangle.optimal.lap.program import STATES
from slipangle.optimal.lap.recursion import Steps
from tests.optimal.lap.cars import RACER, SALOON, circuit, point_like, straight

pytestmark = pytest.mark.skipif(compiled() is None, reason="no compiler")


def both(monkeypatch, car, track, **how):
    """A lap by the interior point, and the same by Ipopt."""
    ours = sa.fastest_lap(car, track, tolerance=1e-8, **how)
    with monkeypatch.context() as patch:
        patch.setattr(solvers, "compiled", lambda: None)
        return ours, sa.fastest_lap(car, track, tolerance=1e-8, **how)


@pytest.mark.parametrize(
    ("track", "how"),
    [
        (circuit(), {"points": 100}),
        (circuit(mirrored=True, width=3.0), {"points": 60, "smoothness": 0.1}),
        (circuit(), {"points": 60, "line": "given"}),
        (straight(), {"points": 60}),
        (straight(), {"points": 60, "v_start": 20.0}),
    ],
    ids=["closed", "narrow", "given line", "open", "open from a speed"],
)
def test_ipopt_finds_the_same_lap(monkeypatch, track, how):
    ours, theirs = both(monkeypatch, RACER, track, **how)
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-7)
    assert ours.time == pytest.approx(theirs.time, rel=1e-5)
    for name in STATES:
        mine, other = getattr(ours, name), getattr(theirs, name)
        assert np.abs(mine - other).max() < 1e-2 * max(np.abs(other).max(), 0.01), name
    worth = theirs.sensitivities
    for name, value in ours.sensitivities.items():
        size = getattr(RACER, name)
        assert value * size == pytest.approx(worth[name] * size, rel=1e-2, abs=2e-4), name


def test_where_the_interior_point_loses_its_way_ipopt_looks(monkeypatch):
    ours = sa.fastest_lap(RACER, circuit(), points=60)
    monkeypatch.setattr(solvers, "along_the_track", lambda *given: None)
    assert sa.fastest_lap(RACER, circuit(), points=60).cost == pytest.approx(ours.cost, rel=1e-6)


def problem(monkeypatch, track, **how):
    """The program in numbers of a short lap, and a place in it."""
    made = []
    monkeypatch.setattr(solvers, "Collocated", lambda *given: made.append(Collocated(*given)) or made[-1])
    sa.fastest_lap(point_like(mu=1.3, power=1e5, drag=0.5), track, points=36, **how)
    rng = np.random.default_rng(1)
    program = made[0]
    w = 0.1 * rng.normal(size=program.size)
    program.parts(w)[0][:, 2] = rng.uniform(0.5, 1.0, program.n)
    return program, w, rng


@pytest.mark.parametrize("track", [circuit(), straight()], ids=["closed", "open"])
def test_slopes_are_those_of_differences(monkeypatch, track):
    program, w, rng = problem(monkeypatch, track)
    lam, mu = rng.normal(size=(program.N, 14)), rng.normal(size=(program.n, 7))

    def lagrangian(w):
        at = program(w)
        return at.cost + np.sum(lam * at.gap) + np.sum(mu * at.limit)

    def slope(w):
        return program.slopes(w, program(w), lam, mu).lagrangian

    way, h = rng.normal(size=program.size), 1e-6
    here = program.slopes(w, program(w), lam, mu)
    assert here.lagrangian @ way == pytest.approx(
        (lagrangian(w + h * way) - lagrangian(w - h * way)) / (2 * h), rel=1e-5
    )
    cost = (program(w + h * way).cost - program(w - h * way).cost) / (2 * h)
    assert here.cost @ way == pytest.approx(cost, rel=1e-5)
    Z, R, _, _ = program.parts((slope(w + h * way) - slope(w - h * way)) / (2 * h))
    d_Z, d_R, _, _ = program.parts(way)
    bent = np.einsum("nij,nj->ni", here.H, np.concatenate([d_Z.reshape(program.N, 14), d_R], axis=1))
    assert bent[:, :14] == pytest.approx(Z.reshape(program.N, 14), abs=1e-5 * np.abs(bent).max())
    assert bent[:, 14:] == pytest.approx(R, abs=1e-5 * np.abs(bent).max())


@pytest.mark.parametrize("track", [circuit(), straight()], ids=["closed", "open"])
def test_a_step_meets_the_conditions_of_its_quadratic_program(monkeypatch, track):
    """Gaps close to first order, and the quadratic's slope is that of the multipliers."""
    program, w, rng = problem(monkeypatch, track)
    at, none = program(w), (np.zeros((program.N, 14)), np.zeros((program.n, 7)))
    slopes = program.slopes(w, at, *none)
    half = rng.normal(size=(program.N, 16, 16))
    slopes = slopes._replace(H=half @ half.transpose(0, 2, 1))
    sigma, push = rng.uniform(0.5, 2.0, program.size), rng.normal(size=program.size)
    steps = Steps(program, np.zeros(program.opened, dtype=bool))
    assert steps.factor(slopes, sigma, 0.3)
    d, lam, mu = steps.solve(push, at.gap, at.limit)
    h = 1e-6
    ahead, behind = program(w + h * d), program(w - h * d)
    assert (ahead.gap - behind.gap) / (2 * h) == pytest.approx(-at.gap, abs=1e-6 * max(1.0, np.abs(d).max()))
    assert (ahead.limit - behind.limit) / (2 * h) == pytest.approx(-at.limit, abs=1e-6 * max(1.0, np.abs(d).max()))
    d_Z, d_R, d_first, d_S = program.parts(d)
    bent = np.einsum("nij,nj->ni", slopes.H, np.concatenate([d_Z.reshape(program.N, 14), d_R], axis=1))
    bent = np.concatenate([bent[:, :14].ravel(), bent[:, 14:].ravel(), 0 * d_first, 0 * d_S.ravel()])
    shift = np.full(program.size, 0.3)
    program.parts(shift)[3][:] = 0.0
    through = program.slopes(w, at, lam, mu).lagrangian - program.slopes(w, at, *none).lagrangian
    left = bent + (sigma + shift) * d + push + through
    assert left == pytest.approx(0.0, abs=1e-7 * max(1.0, np.abs(lam).max(), np.abs(d).max()))


def test_a_hessian_that_bends_down_is_refused(monkeypatch):
    program, w, _ = problem(monkeypatch, circuit())
    slopes = program.slopes(w, program(w), np.zeros((program.N, 14)), np.zeros((program.n, 7)))
    down = slopes._replace(H=-np.tile(np.eye(16), (program.N, 1, 1)))
    steps = Steps(program, np.zeros(0, dtype=bool))
    assert not steps.factor(down, np.full(program.size, 1e-3), 0.0)
    assert steps.factor(down, np.full(program.size, 1e-3), 2.0)


def test_what_one_barrier_loses_another_finds(monkeypatch):
    ours = sa.fastest_lap(RACER, circuit(), points=60)
    run, barriers = InteriorPoint.run, []

    def lost_at_first(self, start, mu, most):
        barriers.append(mu)
        return None if len(barriers) == 1 else run(self, start, mu, most)

    monkeypatch.setattr(InteriorPoint, "run", lost_at_first)
    monkeypatch.setattr(solvers, "by_ipopt", None)
    assert sa.fastest_lap(RACER, circuit(), points=60).cost == pytest.approx(ours.cost, rel=1e-6)
    assert len(set(barriers)) == 2


@pytest.mark.parametrize("points", [500, 790, 800, 1000])
def test_a_race_track_is_solved_on_meshes_that_hardly_differ(monkeypatch, real_data, points):
    """A saloon whose hairpins at the limit need 200 iterations or Ipopt from a barrier that begins at 0.01."""
    monkeypatch.setattr(solvers, "by_ipopt", None)
    track = sa.Path.from_csv(real_data("tracks/tum/Norisring.csv"))
    lap = sa.fastest_lap(SALOON, track, points=points)
    assert lap.time == pytest.approx(73.64, rel=2e-3)
