"""Optima of the prediction-error criterion without each of several groups of experiments, from that over all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.identify.linear.prediction import PredictionCriterion
from slipangle.identify.linear.predictor import Point, Triangles
from slipangle.numerics.least_squares import Factors, LevenbergMarquardt

_NEAR = 1e-4  # damping of the first step: the way is short
_LEAST = 1e-4  # share of the cost, promised, for which no step is taken
_STEPS = 3  # at most, of all entries together
_MANY = 0.02  # parameters over rows, from which on some have not forgotten the group, in flat valleys
_MORE = 20  # steps at most, which flat valleys do not stop


def left_out(
    problem: PredictionCriterion, point: Point, groups: Sequence[Dataset], *, tolerance: float, far: bool
) -> list[Point]:
    """Points at the least cost over all groups but each in turn, from the ``point`` at the least over all.

    The data of the problem are the groups, joined in this order. The optimum of all is near those without a group, and
    what it knows of that group, the way there takes off again: one Gauss-Newton step, whose linearisation serves all
    groups. Where the cost does not fall as that promised, but for a share ``tolerance``, more follow; ``far`` follows
    flat valleys to their ends.

    Raises TooShortError or ExcitationError if what is left without a group does not determine all that is free.
    """
    moves, ends = problem._moves(point), np.cumsum([len(group.starts) for group in groups])
    states = np.split(point.x0, ends[:-1])
    each = []
    for group, x0 in zip(groups, states, strict=True):
        part = problem.over(group)
        part.level_weight = problem.level_weight / np.sqrt(max(1, len(groups) - 1))
        each.append(part.linearise(replace(point, x0=x0), moves)[0])
    found, work = [], problem.work
    most = work.most
    for k in range(len(groups)):
        kept = [i for i in range(len(groups)) if i != k]
        rest = problem.over(join(*(groups[i] for i in kept)))
        rest.enough(rest.data)
        start = replace(point, x0=np.concatenate([states[i] for i in kept]))
        first, *others = (each[i] for i in kept)
        work.most = work.done + (most - work.done) / (len(groups) - k)  # its share of what is left
        found.append(_descended(rest, start, first.joined(*others), moves, tolerance, far))
    work.most = most
    return found


def _descended(
    problem: PredictionCriterion, start: Point, work: Triangles, moves: np.ndarray, tolerance: float, far: bool
) -> Point:
    """The point at the least cost, from one whose linearisation along the moves is known."""

    def linearise(point: Point) -> Factors:
        there, by = (work, moves) if point is start else problem.linearise(point)
        d = by.shape[1]
        return there.shared[:d, :d], there.shared[:d, d], (there, by)

    def move(point: Point, context: tuple[Triangles, np.ndarray], eta: np.ndarray) -> Point:
        there, by = context
        return problem.moved(point, by @ eta, there.solve_locals(eta))

    search = LevenbergMarquardt(cost=problem.cost, linearise=linearise, move=move, damping=_NEAR)
    point, now = start, problem.cost(start)
    for _ in range(_STEPS):
        step = search.step(point, now, least=_LEAST * now)
        if step is None:
            break
        missed, point, now = step.promised - (now - step.cost), step.point, step.cost
        if missed < tolerance * now or problem.work.used_up:
            break
    if not far or problem.work.used_up or moves.shape[1] < _MANY * problem.n_rows:
        return point
    return problem._descend(point, _MORE, tolerance, 1e-3)[0]
