"""Bounded nonlinear least squares from many starts, with exact derivatives from the symbolic expression.

`Regression` is one expression ``y(x, theta)`` with its samples; `multistart` finds theta by the trust-region
reflective method ([1]_) from random starts, of which the promising ones are carried on: on friction curves, whose
valleys are bent and lead to bounds, it reaches the best minimum from more starts than
`slipangle.numerics.least_squares`; `ipopt` solves the same
problem with the interior-point method of the thesis ([2]_, [3]_).

References
----------
.. [1] M. A. Branch, T. F. Coleman, Y. Li, A subspace, interior, and conjugate gradient method for large-scale
   bound-constrained minimization problems, SIAM J. Sci. Comput. 21, 1999.
.. [2] A. Wächter, L. T. Biegler, Math. Program. 106, 2006.
.. [3] L. C. Sousa, PhD thesis, PUC-Rio, 2023, sec. 4.3.2 and 6.2.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy
from scipy.optimize import least_squares

from slipangle.errors import NotFiniteError
from slipangle.fields import Checked, Count
from slipangle.numerics.blas import one_blas_thread

_CLIP = 1e8  # residuals beyond this are as bad as any


class Optimum(NamedTuple):
    """Best point found.

    theta, shape (n_parameters,); residual, shape (n_samples * n_outputs,), weighted; jacobian of the residual;
    cost, sum of squared residuals; costs of all starts as far as they were carried, rising; how often the best was
    reached within 0.1 % of its cost; whether the best run converged within its budget; where each start came to, in the
    order of the costs, shape (n_starts, n_parameters).
    """

    theta: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    cost: float
    costs: np.ndarray
    hits: int
    converged: bool
    ends: np.ndarray


class Regression:
    """Residuals ``weight * (y(x_k, theta) - target_k)`` of all samples and their Jacobian over theta.

    ``y``, ``x`` and ``theta`` are columns of symbols: outputs and inputs of one sample, and the parameters. Samples
    have shape (n_samples, n_inputs), targets (n_samples, n_outputs); weights, one over the standard deviation of the
    noise, are broadcast to the targets, and 0 leaves a sample out.
    """

    def __init__(
        self,
        y: ca.SX,
        x: ca.SX,
        theta: ca.SX,
        *,
        samples: np.ndarray,
        target: np.ndarray,
        weight: np.ndarray | float = 1.0,
    ) -> None:
        samples, target = np.asarray(samples, dtype=float), np.asarray(target, dtype=float)
        for name, values in (("inputs", samples), ("measurements", target)):
            if not np.isfinite(values).all():
                row = int(np.argmin(np.isfinite(values).all(axis=1)))
                raise NotFiniteError(
                    f"the {name} hold NaN or infinity, first in sample {row}; expected finite numbers: leave those "
                    "samples out"
                )
        self.y, self.x, self.theta = y, x, theta
        self.samples, self.target = samples, target
        self.weight = np.broadcast_to(np.asarray(weight, dtype=float), target.shape)
        self.n, self.m = target.shape
        self.p = int(theta.shape[0])
        jacobian = ca.densify(ca.jacobian(y, theta))
        rows = ca.vertcat(ca.densify(y), ca.vec(jacobian.T))  # outputs, then one gradient per output
        function = ca.Function("regression", [x, theta], [rows], {"cse": True})
        self._map = function.map(self.n)
        self._theta = np.empty((self.n, self.p))
        self._x = np.ascontiguousarray(samples)
        self._out = np.empty((self.n, self.m * (1 + self.p)))
        buffer: Any
        buffer, self._run = self._map.buffer()
        for i, array in enumerate((self._x, self._theta)):
            buffer.set_arg(i, array.data)
        buffer.set_res(0, self._out.data)
        self._buffer = buffer  # must outlive the calls
        self._at: bytes | None = None
        self._compressed_at: bytes | None = None
        self._compressed: tuple[np.ndarray, np.ndarray] = np.empty(0), np.empty((0, self.p))

    def _evaluate(self, theta: np.ndarray) -> None:
        key = theta.tobytes()
        if key != self._at:
            self._theta[:] = theta
            self._run()
            self._at = key

    def residual(self, theta: np.ndarray) -> np.ndarray:
        """Weighted residuals, shape (n_samples * n_outputs,)."""
        self._evaluate(theta)
        error = (self._out[:, : self.m] - self.target) * self.weight
        return np.clip(np.nan_to_num(error.ravel(), nan=_CLIP, posinf=_CLIP, neginf=-_CLIP), -_CLIP, _CLIP)

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        """Jacobian of `residual`, shape (n_samples * n_outputs, n_parameters)."""
        self._evaluate(theta)
        rows = self._out[:, self.m :].reshape(self.n, self.m, self.p) * self.weight[:, :, None]
        return np.nan_to_num(rows.reshape(self.n * self.m, self.p), nan=0.0, posinf=0.0, neginf=0.0)

    def compressed(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual and Jacobian turned by Q', shapes (k,) and (k, n_parameters) with k = n_parameters + 1 at most.

        Same cost, gradient and Gauss-Newton matrix as the full ones: all that a least-squares step asks for.
        """
        if theta.tobytes() != self._compressed_at:
            both = np.column_stack([self.jacobian(theta), self.residual(theta)])
            if len(both) > 2 * self.p:
                both = np.asarray(np.linalg.qr(both, mode="r"))
            self._compressed = both[:, -1].copy(), both[:, :-1].copy()
            self._compressed_at = theta.tobytes()
        return self._compressed

    def prediction(self, theta: np.ndarray) -> np.ndarray:
        """Model outputs, shape (n_samples, n_outputs)."""
        self._evaluate(theta)
        return self._out[:, : self.m].copy()


@dataclass(frozen=True, kw_only=True)
class Effort(Checked):
    """How much a fit may cost."""

    starts: Count = 16
    screen: Count = 40  # evaluations that every start gets before the promising ones are chosen
    carried: Count = 4  # starts that go on after the screening
    polish: Count = 200  # evaluations that each of these gets
    finish: Count = 600  # further evaluations for the best of them
    # relative change of the cost, of the step and of the gradient below which a run has converged
    tolerance: float = 1e-10


def draw(lower: np.ndarray, upper: np.ndarray, n: int, rng: np.random.Generator, *, share: float = 0.5) -> np.ndarray:
    """Starts drawn uniformly from the middle ``share`` of the bounds, shape (n, n_parameters)."""
    middle, half = (upper + lower) / 2, (upper - lower) / 2
    return middle + share * half * rng.uniform(-1, 1, (n, len(lower)))


def multistart(
    problem: Regression, lower: np.ndarray, upper: np.ndarray, starts: np.ndarray, effort: Effort
) -> Optimum:
    """Best of several bounded least-squares runs.

    Every start runs for a while, the best few go on, the very best is finished: most starts show early that they
    lead nowhere.
    """
    residual, jacobian = (lambda z, k=k: problem.compressed(z)[k] for k in (0, 1))
    how: Any = {"jac": jacobian, "bounds": (lower, upper), "method": "trf"}
    how |= dict.fromkeys(("xtol", "ftol", "gtol"), effort.tolerance)

    def run(theta: np.ndarray, budget: int) -> Any:
        return least_squares(residual, _inside(theta, lower, upper), max_nfev=budget, **how)

    with one_blas_thread():
        pool = sorted((run(theta, effort.screen) for theta in starts), key=lambda r: r.cost)
        head, tail = pool[: effort.carried], pool[effort.carried :]
        head = sorted((r if r.status > 0 else run(r.x, effort.polish) for r in head), key=lambda r: r.cost)
        best = head[0]
        if best.status <= 0:
            best = min((best, run(best.x, effort.finish)), key=lambda r: r.cost)
    ends = sorted((best, *head[1:], *tail), key=lambda r: r.cost)
    costs, points = np.array([2 * r.cost for r in ends]), np.array([r.x for r in ends])
    return _solution(problem, points, costs, converged=best.status > 0)


def _solution(problem: Regression, ends: np.ndarray, costs: np.ndarray, *, converged: bool) -> Optimum:
    """The solution that the first of the costs belongs to."""
    cost, theta = float(costs[0]), ends[0]
    return Optimum(
        theta=theta,
        residual=problem.residual(theta),
        jacobian=problem.jacobian(theta),
        cost=cost,
        costs=costs,
        hits=int(np.sum(costs <= cost * 1.001 + 1e-12)),
        converged=bool(converged),
        ends=ends,
    )


def ipopt(problem: Regression, lower: np.ndarray, upper: np.ndarray, starts: np.ndarray, effort: Effort) -> Optimum:
    """The same problem by Ipopt with exact Hessian, from every start; parameters as for `multistart`.

    The thesis' solver; slower than `multistart`, since it does not use that the cost is a sum of squares.
    """
    x, theta = ca.MX.sym("x", problem.x.shape[0]), ca.MX.sym("theta", problem.p)
    model = ca.Function("model", [problem.x, problem.theta], [problem.y])
    mapped = ca.Function("one", [x, theta], [model(x, theta)]).map(problem.n)
    all_theta = ca.MX.sym("theta", problem.p)
    outputs = mapped(ca.DM(problem.samples.T), ca.repmat(all_theta, 1, problem.n))
    error = (outputs - ca.DM(problem.target.T)) * ca.DM(problem.weight.T)
    quiet = {"print_level": 0, "sb": "yes", "max_iter": effort.polish, "tol": 1e-8}
    options = {"ipopt": quiet, "print_time": False, "error_on_fail": False}
    solver = ca.nlpsol("fit", "ipopt", {"x": all_theta, "f": ca.sumsqr(error)}, options)
    optima = []
    for start in starts:
        result = solver(x0=_inside(start, lower, upper), lbx=lower, ubx=upper)
        point = np.clip(np.asarray(result["x"]).ravel(), lower, upper)
        residual = problem.residual(point)
        optima.append((float(residual @ residual), point, bool(solver.stats()["success"])))
    optima.sort(key=lambda item: item[0])
    costs, points = np.array([cost for cost, _, _ in optima]), np.array([point for _, point, _ in optima])
    return _solution(problem, points, costs, converged=optima[0][2])


def covariance(solution: Optimum) -> np.ndarray:
    """Covariance of the parameters for white residuals: variance of the residuals times inverse of J'J.

    Directions in which the residual does not move get a huge variance, not a small one.
    """
    j, e = solution.jacobian, solution.residual
    free = max(1, int(np.count_nonzero(np.abs(j).sum(axis=1) + np.abs(e))) - j.shape[1])
    scale = np.linalg.norm(j, axis=0)
    scale = np.where(scale > 0, scale, 1e-60)
    _, s, vt = np.linalg.svd(j / scale, full_matrices=False)
    s = np.maximum(s, 1e-14 * max(1.0, float(s[0])))
    root = vt.T / s
    return (root @ root.T) * (float(e @ e) / free) / np.outer(scale, scale)


def _inside(theta: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The point moved off its bounds a little, which an interior method needs."""
    margin = 1e-6 * (upper - lower)
    return np.clip(theta, lower + margin, upper - margin)


def fixed_cost(
    problem: Regression, start: np.ndarray, lower: np.ndarray, upper: np.ndarray, index: int, value: float
) -> tuple[float, np.ndarray]:
    """Least cost with one parameter held at a value, from a start near the optimum; and where it is reached."""
    rest = np.arange(problem.p) != index
    point = start.copy()
    point[index] = value

    def whole(z: np.ndarray) -> np.ndarray:
        full = point.copy()
        full[rest] = z
        return full

    with one_blas_thread():
        result = least_squares(
            lambda z: problem.compressed(whole(z))[0],
            _inside(start[rest], lower[rest], upper[rest]),
            jac=lambda z: problem.compressed(whole(z))[1][:, rest],  # type: ignore[arg-type]
            bounds=(lower[rest], upper[rest]),
            method="trf",
            x_scale="jac",
            max_nfev=60,
        )
    return 2 * float(result.cost), whole(result.x)


def profile_interval(
    problem: Regression, solution: Optimum, lower: np.ndarray, upper: np.ndarray, index: int, *, level: float = 0.95
) -> tuple[float, float]:
    """Interval of one parameter by profile likelihood: where the cost of the best fit around it rises too far.

    Unlike the covariance it follows the curvature of the problem, so it keeps its level where parameters trade off
    against each other along a bent valley. An end that the bounds cut off is the bound.

    Source: D. M. Bates, D. G. Watts, Nonlinear Regression Analysis and Its Applications, 1988, sec. 6.1.
    """
    freedom = max(1, problem.n * problem.m - problem.p)
    variance = max(solution.cost / freedom, 1e-300)
    limit = float(scipy.stats.t.ppf(0.5 + level / 2, freedom))
    spread = float(np.sqrt(max(covariance(solution)[index, index], 0.0)))
    best = float(solution.theta[index])

    def along(distance: float, side: float, start: np.ndarray) -> tuple[float, np.ndarray]:
        cost, point = fixed_cost(problem, start, lower, upper, index, best + side * distance)
        return float(np.sqrt(max(cost - solution.cost, 0.0) / variance)), point

    ends = []
    for side, bound in ((-1.0, float(lower[index])), (1.0, float(upper[index]))):
        reach = abs(bound - best)
        step = min(limit * max(spread, 1e-9 * max(1.0, abs(best))), 0.25 * reach)
        # distances from the estimate and statistics there; each refit starts from the last point inside
        inner, outer, point = (0.0, 0.0), None, solution.theta
        for _ in range(60):
            distance = inner[0] + step if outer is None else _between(inner, outer, limit)
            distance = min(distance, reach)
            statistic, optimum = along(distance, side, point)
            if abs(statistic - limit) < 0.01 * limit:
                inner = (distance, statistic)
                break
            if statistic > limit:
                outer = (distance, statistic)
            else:
                step = 2 * step if statistic - inner[1] < 0.25 * limit else step
                inner, point = (distance, statistic), optimum
                if distance >= reach:
                    break
            if outer is not None and outer[0] - inner[0] < 1e-4 * outer[0]:
                break
        ends.append(best + side * inner[0])
    return ends[0], ends[1]


def _between(inner: tuple[float, float], outer: tuple[float, float], limit: float) -> float:
    """Where a straight line through two points reaches the limit, kept off both."""
    share = (limit - inner[1]) / (outer[1] - inner[1])
    return inner[0] + float(np.clip(share, 0.1, 0.9)) * (outer[0] - inner[0])
