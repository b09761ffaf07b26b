"""Nonlinear least squares: Levenberg-Marquardt on triangular factors, with priors, bounds and robust losses.

`LevenbergMarquardt` works on points of any kind (a vector, a state space, parameters with initial states) of which it
only asks the cost, a linearisation and how to move; `least_squares` is the same for a vector, its errors and their
Jacobian. [1]_, [2]_

References
----------
.. [1] D. W. Marquardt, An algorithm for least-squares estimation of nonlinear parameters, J. SIAM 11, 1963: damping
   relative to the columns of the Jacobian.
.. [2] H. B. Nielsen, Damping parameter in Marquardt's method, IMM-REP-1999-05, DTU: how the damping moves.
.. [3] M. Hintermüller, K. Ito, K. Kunisch, The primal-dual active set strategy as a semismooth Newton method,
   SIAM J. Optim. 13, 2002.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy import linalg

TRIALS = 14  # dampings tried before a point is called a minimum
LEAST = 1e-12  # damping
_EXCHANGES = 30  # of unknowns on their bounds within one step
_UNSEEN = 1e-8  # singular value, relative to the largest, of directions that the errors do not show: they stay

Factors = tuple[np.ndarray, np.ndarray, Any]  # r, e and what `move` wants to know
Loss = Literal["squares", "huber", "cauchy"]


class LeastSquaresResult(NamedTuple):
    """The last point, its cost, whether it is a minimum, and how many steps led there."""

    point: Any
    cost: float
    converged: bool
    steps: int


class Step(NamedTuple):
    """A step that lowered the cost: where to, the cost there, and the fall that the linearisation promised."""

    point: Any
    cost: float
    promised: float


@dataclass(kw_only=True)
class LevenbergMarquardt:
    """Minimise a sum of squares over points of any kind, in one go or step by step.

    The damping is relative to the squared column norms of the linearisation and is kept from step to step.
    """

    cost: Callable[[Any], float]  # sum of squared errors at a point; infinite or NaN where it does not exist
    # ``(r, e, context)`` of a point: moving by ``eta`` changes the errors so that their squared norm is ``|e - r
    # eta|^2`` plus a constant; shapes (m, d), (m,). `triangle` and `cholesky` make such factors
    linearise: Callable[[Any], Factors]
    move: Callable[[Any, Any, np.ndarray], Any]  # the point moved by ``eta``, given the context of its linearisation
    # smallest and largest ``eta`` that bounds leave at a point, shapes (d,); by default any
    room: Callable[[Any], tuple[np.ndarray, np.ndarray]] | None = None
    damping: float = 1e-3  # of the first step; `LEAST` where the problem is linear or nearly so
    # move the damping by fixed factors, whatever the linearisation promised: a gentler way down for networks, which
    # follow their training data too closely before they fit them best
    steady: bool = False
    # asked before each step of `minimise`: whether to stop there, short of the minimum
    enough: Callable[[], bool] | None = None
    _growth: float = field(default=2.0, init=False)

    def __post_init__(self) -> None:
        self._growth = 4.0 if self.steady else 2.0

    def step(self, point: Any, now: float, *, least: float = 0.0) -> Step | None:
        """One step from a point whose cost is ``now``; None where none lowers it or promises more than ``least``."""
        r, e, context = self.linearise(point)
        norms = np.linalg.norm(r, axis=0)
        scale = np.maximum(norms, 1e-12 * max(norms.max(initial=0.0), 1e-300))
        linear = _Linear(r / scale, e)
        bounds = None if self.room is None else tuple(end * scale for end in self.room(point))
        for _ in range(TRIALS):
            eta = linear.solve(self.damping) if bounds is None else linear.bounded(self.damping, *bounds)
            promised = float(e @ e - np.sum((e - linear.r @ eta) ** 2))
            if promised < least:
                return None
            trial = self.move(point, context, eta / scale)
            after = self.cost(trial)
            if after < now:
                self._relax((now - after) / max(promised, 1e-300))
                return Step(trial, after, promised)
            self.damping, self._growth = self.damping * self._growth, self._growth * (1 if self.steady else 2)
        return None

    def _relax(self, gain: float) -> None:
        """Less damping after a step that fell by ``gain`` of what it promised."""
        share = 1 / 3 if self.steady else max(1 / 3, 1 - (2 * min(gain, 1.0) - 1) ** 3)
        self.damping, self._growth = max(self.damping * share, LEAST), 4.0 if self.steady else 2.0

    def minimise(
        self, point: Any, *, max_iterations: int, tolerance: float = 1e-10, creep: float = 1e-5
    ) -> LeastSquaresResult:
        """Steps until the cost falls by less than ``tolerance`` of itself, or by less than ``creep`` in ten steps."""
        now = self.cost(point)
        costs = [now]
        for steps in range(max_iterations):
            if self.enough is not None and self.enough():
                return LeastSquaresResult(point, now, False, steps)
            step = self.step(point, now, least=0.1 * tolerance * now)
            if step is None:
                return LeastSquaresResult(point, now, True, steps)
            flat = now - step.cost < tolerance * now and step.promised < 10 * tolerance * now
            point, now = step.point, step.cost
            costs.append(now)
            if flat or (len(costs) > 10 and costs[-11] - now < creep * now):
                return LeastSquaresResult(point, now, True, steps + 1)
        return LeastSquaresResult(point, now, False, max_iterations)


class _Linear:
    """The damped linear problem ``min |e - r eta|^2 + damping |eta|^2``, r with columns of length one."""

    def __init__(self, r: np.ndarray, e: np.ndarray) -> None:
        self.r, self.e = r, e
        left, self.size, self.right = np.linalg.svd(r, full_matrices=False)
        self.seen = self.size > _UNSEEN * self.size.max(initial=0.0)
        self.pull = left.T @ e

    def solve(self, damping: float) -> np.ndarray:
        gain = np.divide(self.size, self.size**2 + damping, out=np.zeros_like(self.size), where=self.seen)
        return self.right.T @ (gain * self.pull)

    def bounded(self, damping: float, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """The step within bounds, by exchange of what stands on them. [3]_"""
        eta = self.solve(damping)
        low, high = eta < lower, eta > upper
        for _ in range(_EXCHANGES):
            held = low | high
            if not held.any():
                return eta
            eta = np.where(low, lower, np.where(high, upper, 0.0))
            if not held.all():
                rest = _Linear(self.r[:, ~held], self.e - self.r[:, held] @ eta[held])
                eta[~held] = rest.solve(damping)
            slope = self.r.T @ (self.r @ eta - self.e) + damping * eta
            before = low, high
            low = (low & (slope >= 0)) | (~held & (eta < lower))
            high = (high & (slope <= 0)) | (~held & (eta > upper))
            if np.array_equal(before, (low, high)):
                break
        return np.clip(eta, lower, upper)


def triangle(jacobian: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors of errors that move by ``jacobian @ eta``: all that a step asks for, in d + 1 rows at most."""
    both = np.column_stack([-jacobian, error])
    if len(both) > both.shape[1]:
        both = np.asarray(np.linalg.qr(both, mode="r"))
    return both[:, :-1], both[:, -1]


def cholesky(matrix: np.ndarray, gradient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors of a Gauss-Newton matrix and half the gradient, where priors keep the matrix far from singular.

    Cheaper than `triangle` for many samples and hundreds of unknowns.
    """
    ridge = 1e-12 * max(float(np.trace(matrix)) / len(matrix), 1e-300)
    factor: Any = linalg.cholesky(matrix + ridge * np.eye(len(matrix)), check_finite=False)
    return factor, -linalg.solve_triangular(factor, gradient, trans=1, check_finite=False)


def least_squares(
    start: np.ndarray,
    *,
    errors: Callable[[np.ndarray], np.ndarray],
    jacobian: Callable[[np.ndarray], np.ndarray],
    cost: Callable[[np.ndarray], float] | None = None,
    bounds: tuple[np.ndarray, np.ndarray] | None = None,
    prior: tuple[np.ndarray, np.ndarray] | None = None,
    loss: Loss = "squares",
    max_iterations: int = 100,
    tolerance: float = 1e-10,
    creep: float = 0.0,
) -> LeastSquaresResult:
    """Vector with the least sum of squared errors.

    Parameters
    ----------
    start : array, shape (n,)
        Where to begin; clipped to the bounds.
    errors, jacobian : callable
        Errors of a vector, shape (m,), and their derivatives, shape (m, n).
    cost : callable, optional
        Sum of squared errors, where it costs less than the errors.
    bounds : (array, array), optional
        Smallest and largest values, shape (n,).
    prior : (array, array), optional
        Mean and standard deviation of each unknown, infinite where nothing is known beforehand.
    loss : {"squares", "huber", "cauchy"}
        What an error beyond one counts: its square, twice its size less one, or the logarithm of one and its square.
    tolerance, creep : float
        See `LevenbergMarquardt.minimise`.

    >>> x = np.linspace(0, 1, 20)
    >>> fit = least_squares(np.zeros(1), errors=lambda p: np.exp(p * x) - np.exp(2 * x),
    ...     jacobian=lambda p: (x * np.exp(p * x))[:, None])
    >>> fit.converged, round(float(fit.point[0]), 6)
    (True, 2.0)
    """

    def prior_errors(z: np.ndarray) -> np.ndarray:
        return np.zeros(0) if prior is None else (z - prior[0]) / prior[1]

    def total(z: np.ndarray) -> float:
        own = cost(z) if cost is not None else np.sum(_counts(errors(z), loss))
        return float(own + np.sum(prior_errors(z) ** 2))

    def linearise(z: np.ndarray) -> Factors:
        e, j = errors(z), jacobian(z)
        if loss != "squares":
            root = np.sqrt(_slope(e, loss))
            e, j = root * e, root[:, None] * j
        if prior is not None:
            e, j = np.concatenate([e, prior_errors(z)]), np.vstack([j, np.diag(1 / prior[1])])
        return *triangle(j, e), None

    def move(z: np.ndarray, _: Any, eta: np.ndarray) -> np.ndarray:
        return z + eta if bounds is None else np.clip(z + eta, *bounds)

    room = None if bounds is None else lambda z: (bounds[0] - z, bounds[1] - z)
    begin = np.array(start, dtype=float) if bounds is None else np.clip(start, *bounds)
    search = LevenbergMarquardt(cost=total, linearise=linearise, move=move, room=room)
    return search.minimise(begin, max_iterations=max_iterations, tolerance=tolerance, creep=creep)


def _counts(e: np.ndarray, loss: Loss) -> np.ndarray:
    """What each error adds to the cost."""
    if loss == "squares":
        return e**2
    size = np.abs(e)
    return np.log1p(size**2) if loss == "cauchy" else np.where(size <= 1, size**2, 2 * size - 1)


def _slope(e: np.ndarray, loss: Loss) -> np.ndarray:
    """Derivative of `_counts` by the squared error: the weight of a row."""
    return 1 / (1 + e**2) if loss == "cauchy" else 1 / np.maximum(np.abs(e), 1.0)
