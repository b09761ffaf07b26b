"""Where a free-run fit with several minima starts: many places tried on a part of the data, the best carried on."""

from __future__ import annotations

import numpy as np

from slipangle.errors import SlipangleError
from slipangle.identify.physics.simulation_error import FreeRunProblem

STARTS = 32  # tried by default where a model is known to have several minima
_ROUNDS = ((4, 4), (2, 6))  # how many random ones are carried on, and Levenberg-Marquardt steps of each
_FINAL = 14  # steps on all data
_COARSE = 1500  # samples of a long recording on which starts are tried
_FACTOR = 2.0  # by which a positive parameter is multiplied or divided at most
_SHARE = 0.1  # of its range that another parameter moves at most


def best_start(problem: FreeRunProblem, starts: int, seed: int) -> np.ndarray:
    """Scaled unknowns from which the fit goes on to the best minimum found.

    Random starts lie around the given one: positive parameters up to a factor of 2 from it, others up to a tenth of
    their range. Free runs of all of them are compared on a part of the data; the best four make 4 Levenberg-Marquardt
    steps there, the best two of these 6 more. On all data 14 steps lead on from the given start, and from the best
    random one where that is better by then. It never returns a start that is worse than the given one.

    ``starts`` counts the given one.
    """
    part = _part(problem)
    tried = sorted(draw(problem, starts - 1, seed), key=part.cost)
    for carried, steps in _ROUNDS:
        tried = sorted((part.search(z, steps).point for z in tried[:carried]), key=part.cost)
    minima = min([problem.start, problem.search(problem.start, _FINAL).point], key=problem.cost)
    other = min([minima, *tried], key=problem.cost)
    return minima if other is minima else problem.search(other, _FINAL).point


def draw(problem: FreeRunProblem, n: int, seed: int) -> np.ndarray:
    """Random starts around the given one, shape (n, n_z); initial states stay where they are."""
    share = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, problem.n_p))
    lower, upper, start = (v[: problem.n_p] for v in (problem.lower, problem.upper, problem.start))
    span = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
    positive = (lower >= 0) & (start > 1e-3 * span)
    positive |= (lower > 0) & (start > 0)
    moved = np.where(positive, start * _FACTOR**share, start + _SHARE * span * share)
    inside = 1e-6 * span
    points = np.tile(problem.start, (n, 1))
    points[:, : problem.n_p] = np.clip(moved, lower + inside, upper - inside)
    return points


def _part(problem: FreeRunProblem) -> FreeRunProblem:
    """The problem on the first samples of a single long recording, else the problem itself."""
    data = problem.data
    if problem.n_x0 or problem.n_e != 1 or data.n_samples < 2 * _COARSE:
        return problem
    try:
        return FreeRunProblem(problem.model, problem.shared, problem.own, data.rows(0, _COARSE), False)
    except SlipangleError:  # too quiet to tell starts apart
        return problem
