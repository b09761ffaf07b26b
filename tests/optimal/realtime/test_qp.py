"""The compiled quadratic program: optimality on its own terms, against DAQP, with trouble on purpose."""

import daqp
import numpy as np
import pytest
from scipy.optimize import linprog

from slipangle.codegen import compiler as compiled
from tests.optimal.realtime.qps import INFEASIBLE, SOLVED, Solver, draw, residual

pytestmark = pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())


def infeasible(problem):
    """Whether a linear program finds no point within the hard rows, and by how much the best one misses them."""
    _, g, A, lo, hi, plain, _ = problem
    n, hard = len(g), ~np.isfinite(plain)
    C = np.vstack([np.eye(n), A])[hard]
    G, b = np.vstack([C, -C]), np.r_[hi[hard], -lo[hard]]
    finite = np.isfinite(b)
    cost = np.r_[np.zeros(n), 1.0]
    found = linprog(
        cost,
        A_ub=np.c_[G[finite], -np.ones(finite.sum())],
        b_ub=b[finite],
        bounds=[(None, None)] * n + [(0, None)],
    )
    return found.fun


def check(seeds, *, soft=True):
    """Every answer is optimal to 1e-8 or reported; returns how many were reported as what."""
    solve = Solver()
    counts = {}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        problem = draw(rng, soft=soft)
        status, u, lam, kkt = solve(problem)
        counts[status] = counts.get(status, 0) + 1
        if status == SOLVED:
            assert kkt <= 1e-8, seed
            assert residual(problem, u, lam) <= 1e-8, seed
        elif status == INFEASIBLE:
            assert infeasible(problem) > 1e-9, seed
    return counts


def test_random_problems_are_solved_or_reported_and_none_is_wrong():
    counts = check(range(600))
    assert counts[SOLVED] >= 550
    assert counts[INFEASIBLE] >= 3
    assert counts[SOLVED] + counts[INFEASIBLE] >= 0.999 * 600


def test_a_gradient_of_zero_is_no_trouble():
    """Then every force comes from the limits, and sizes are those of H u and of the multipliers."""
    solve, solved = Solver(), 0
    for seed in range(200):
        H, g, *limits = draw(np.random.default_rng([seed, 11]), kind=("plain", "box", "tight", "equal")[seed % 4])
        problem = H, 0 * g, *limits
        status, u, lam, kkt = solve(problem)
        assert status in (SOLVED, INFEASIBLE), seed
        if status == SOLVED:
            solved += np.abs(lam).max() > 0
            assert max(kkt, residual(problem, u, lam)) <= 1e-8, seed
        else:
            assert infeasible(problem) > 1e-9, seed
    assert solved >= 100


@pytest.mark.slow
def test_a_hundred_thousand_random_problems():
    counts = check(range(100_000))
    assert counts[SOLVED] > 97_000
    assert counts[SOLVED] + counts[INFEASIBLE] >= 99_950


@pytest.mark.parametrize("seed", [6532, 12010, 24375, 33904, 48031, 73247, 87458, 96038])
def test_ties_and_limits_that_touch(seed):
    """Feasible by their draw: a tie among rows, or limits that meet in one point, is no reason to call them empty.

    Nor is the last bit of their numbers, which is another one on every processor.
    """
    H, g, A, *limits = draw(np.random.default_rng(seed))
    rng = np.random.default_rng([seed, 1])
    solve = Solver()
    for bits in [0.0] + 40 * [np.finfo(float).eps]:
        near = [x * (1 + bits * rng.integers(-1, 2, x.shape)) for x in (H, g, A)]
        problem = (0.5 * (near[0] + near[0].T), *near[1:], *limits)
        status, u, lam, kkt = solve(problem)
        assert status != INFEASIBLE
        if status == SOLVED:
            assert max(kkt, residual(problem, u, lam)) <= 1e-8
        assert status == SOLVED or seed == 87458  # that one is reported as unsolved


@pytest.mark.parametrize("kind", ["plain", "degenerate", "ill", "tight", "box", "equal"])
def test_same_as_daqp(kind):
    solve = Solver()
    compared = 0
    for seed in range(40):
        problem = draw(np.random.default_rng([seed, 7]), soft=False, kind=kind)
        H, g, A, lo, hi, _, _ = problem
        status, u, _, _ = solve(problem)
        big = [np.clip(b, -1e30, 1e30) for b in (hi, lo)]
        theirs, _, flag, _ = daqp.solve(
            H, g.copy(), A.copy() if len(A) else np.zeros((0, len(g))), *big, primal_tol=1e-10, dual_tol=1e-12
        )
        if status == SOLVED and flag == 1:
            compared += 1
            gap = 0.5 * u @ H @ u + g @ u - (0.5 * theirs @ H @ theirs + g @ theirs)
            assert abs(gap) <= 1e-7 * (1 + abs(g @ u)), seed
    assert compared >= 25


def test_a_warm_start_changes_no_answer():
    cold, warm = Solver(), Solver()
    rng = np.random.default_rng(3)
    for seed in range(60):
        problem = draw(np.random.default_rng(seed), kind="plain")
        H, g, A, lo, hi, plain, square = problem
        warm(problem)
        for _ in range(4):
            g = g + 0.3 * rng.standard_normal(len(g)) * np.abs(g).mean()
            moved = (H, g, A, lo, hi, plain, square)
            first, second = cold(moved), warm(moved, warm=True)
            assert first[0] == second[0]
            if first[0] == SOLVED:
                assert second[1] == pytest.approx(first[1], abs=1e-7 * (1 + np.abs(first[1]).max()))


def test_nan_and_indefinite_problems_are_reported():
    solve = Solver()
    H, g, A, lo, hi, plain, square = draw(np.random.default_rng(0), kind="plain")
    n = len(g)
    for bad in (
        (H, np.full(n, np.nan), A, lo, hi, plain, square),
        (H * np.nan, g, A, lo, hi, plain, square),
        (-H, g, A, lo, hi, plain, square),
        (np.zeros((n, n)), g, A, lo, hi, plain, square),
    ):
        assert solve(bad)[0] != SOLVED
