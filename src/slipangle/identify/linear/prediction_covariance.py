"""How uncertain the estimates of a prediction-error fit are, whatever the colour of its residuals."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slipangle.identify.linear.prediction import PredictionCriterion
from slipangle.identify.linear.predictor import Point, Triangles
from slipangle.numerics.covariance import autoregression, bandwidth, coloured, long_run, middle_of_autoregression

_WHITE = "covariance for white residuals"


def covariance(problem: PredictionCriterion, point: Point) -> tuple[np.ndarray, np.ndarray, str]:
    """Covariance of the free entries as named, standard deviations of the residuals, and a few words on how.

    Free-run residuals may be coloured however the model is: their autoregression is estimated along. Those of
    predictions are white if the model is right; where they are not, the sandwich of Newey and West allows for it.
    """
    work, moves = problem.linearise(point)
    d = moves.shape[1]
    r = work.shared[:d, :d]
    norms = np.maximum(np.linalg.norm(r, axis=0), 1e-300)
    pinv = np.linalg.pinv(r / norms, rcond=1e-12) / norms[:, None]
    moments = problem.moments(point)
    dof = max(1, problem.n_rows - d - sum(map(len, work.locals)))
    variance = float(np.trace(problem.root @ moments @ problem.root.T)) / dof
    spread = problem.as_named(point, moves) @ pinv
    middle, said = _middle(problem, point, work, moves)
    if middle is None:
        spread = spread * np.sqrt(variance)
        found = spread @ spread.T
    else:
        wide = spread @ pinv.T
        found = wide @ middle @ wide.T * (problem.n_rows / dof)
    return found, np.sqrt(np.diag(moments) / (dof / problem.ny)), said


def _middle(
    problem: PredictionCriterion, point: Point, work: Triangles, moves: np.ndarray
) -> tuple[np.ndarray | None, str]:
    """Covariance of the gradient by the moves, None for that of white residuals; and a few words on how."""
    errors: list[list[np.ndarray]] = []
    for error, first in problem.errors(point):
        errors += [[]] if first else []
        errors[-1].append(error @ problem.root.T)
    pieces = [np.concatenate(parts) for parts in errors]
    if np.any(point.K):
        lags = bandwidth(np.concatenate(pieces))
        if not lags:
            return None, _WHITE
        scores = [np.einsum("kyi,ky->ki", j, e) for j, e in _stretches(problem, point, work, moves)]
        return long_run(np.concatenate(scores), lags), coloured(lags)
    coefficients, driving = autoregression(pieces)
    if problem.ny == 1 and not len(coefficients):
        return None, _WHITE
    middle = np.zeros((moves.shape[1],) * 2)
    for jacobian, _ in _stretches(problem, point, work, moves):
        middle += middle_of_autoregression(jacobian, coefficients, driving)
    return middle, f"covariance for residuals that are an autoregression of order {len(coefficients)}"


def _stretches(
    problem: PredictionCriterion, point: Point, work: Triangles, moves: np.ndarray, size: int = 1 << 15
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Derivatives by the moves, with the initial states following, and weighted errors; never two experiments."""
    k, experiment, held = problem.n, -1, list[tuple[np.ndarray, np.ndarray]]()
    by_x0 = [np.linalg.lstsq(t[:, :k], t[:, k:-1], rcond=1e-12)[0] for t in work.locals]

    def joined() -> tuple[np.ndarray, np.ndarray]:
        both = np.concatenate([j for j, _ in held]), np.concatenate([e for _, e in held])
        held.clear()
        return both

    for first, local, shared, error in problem.rows(point, moves):
        if held and (first or sum(len(e) for _, e in held) >= size):
            yield joined()
        experiment += first
        held.append((shared - local @ by_x0[experiment], error))
    yield joined()
