"""Free-run error of any model written as symbols, with forward sensitivities: the fit behind nonlinear black boxes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from slipangle.identify.linear.predictor import Triangles, reduce_rows
from slipangle.identify.physics.forward import of_map
from slipangle.numerics.least_squares import Factors, LeastSquaresResult, LevenbergMarquardt

Function = Callable[[Any, Any, Any], Any]  # (x, u, p)


@dataclass(frozen=True, kw_only=True)
class FreeRunPoint:
    """Parameters, and the state at the first sample of each experiment."""

    p: np.ndarray
    x0: np.ndarray


@dataclass(frozen=True, kw_only=True)
class FreeRunFit:
    """Outcome of `FreeRun.fit`."""

    p: np.ndarray  # (n_parameters,)
    x0: np.ndarray  # (n_experiments, n_states), states at the experiments' first samples
    rmse: np.ndarray  # (n_outputs,), free-run error on the training data, in the outputs' units
    covariance: np.ndarray  # (n_parameters, n_parameters), given white residuals and the prior
    converged: bool
    steps: int


class FreeRun:
    """Squared free-run error of ``x(k+1) = step(x, u, p)``, ``y = output(x, u, p)`` and its derivatives.

    ``step`` and ``output`` are symbol-safe. Records are inputs and outputs of each experiment, shapes (n, n_inputs) and
    (n, n_outputs); ``error``, shape (n_outputs,), is a typical error of each output, by which it is divided. Initial
    values of the states ``free_x0`` are estimated for each experiment, the others stay as given. The prior has mean and
    standard deviation of each parameter, infinite where nothing is known; ``inside`` gives the nearest parameters that
    are allowed, such as those of a stable model.
    """

    def __init__(
        self,
        step: Function,
        output: Function,
        *,
        n_states: int,
        n_parameters: int,
        records: list[tuple[np.ndarray, np.ndarray]],
        error: np.ndarray,
        free_x0: tuple[int, ...] = (),
        prior: tuple[np.ndarray, np.ndarray] | None = None,
        inside: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> None:
        self.inside = inside or (lambda p: p)
        self.records, self.error, self.prior, self.free_x0 = records, np.asarray(error, dtype=float), prior, free_x0
        self.nx, self.np = n_states, n_parameters
        nu, self.ny = records[0][0].shape[1], records[0][1].shape[1]
        self.n_rows = sum(len(u) for u, _ in records) * self.ny
        symbols = ca.SX.sym("x", self.nx), ca.SX.sym("u", nu), ca.SX.sym("p", self.np)
        self._forward = of_map(symbols, step(*symbols), output(*symbols))
        self._first_slope = np.zeros((self.nx, self.np + len(self.free_x0)))  # of the first state
        self._first_slope[list(self.free_x0), self.np :] = np.eye(len(self.free_x0))

    def run(self, p: np.ndarray, x0: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Outputs, shape (n, n_outputs)."""
        return self._forward(x0, self._first_slope[:, :0], u, p)[:, :, 0]

    def sensitive(self, p: np.ndarray, x0: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs and their derivatives, shape (n, n_outputs, n_parameters + n_free)."""
        full = self._forward(x0, self._first_slope, u, p)
        return full[:, :, 0], full[:, :, 1:]

    def cost(self, point: FreeRunPoint) -> float:
        """Weighted squared error, with the prior's share; infinite where the free run is."""
        total = 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            for x0, (u, y) in zip(point.x0, self.records, strict=True):
                total += float(np.sum(((y - self.run(point.p, x0, u)) / self.error) ** 2))
        total += float(np.sum(self._prior(point)[1] ** 2))
        return total if np.isfinite(total) else np.inf

    def _prior(self, point: FreeRunPoint) -> tuple[np.ndarray, np.ndarray]:
        """Derivative and errors of the rows that the prior adds."""
        if self.prior is None:
            return np.zeros((0, self.np)), np.zeros(0)
        mean, std = self.prior
        return np.diag(1 / std), (mean - point.p) / std

    def linearise(self, point: FreeRunPoint) -> Triangles:
        """Triangles of [x0, p | error]."""
        m = self.np + len(self.free_x0)
        work = Triangles(len(self.free_x0), self.np)
        for x0, (u, y) in zip(point.x0, self.records, strict=True):
            seen, slopes = self.sensitive(point.p, x0, u)
            local, error = slopes / self.error[:, None], (y - seen) / self.error
            rows = np.concatenate([local[:, :, self.np :], local[:, :, : self.np], error[:, :, None]], axis=2)
            work.add(rows.reshape(-1, m + 1))
            work.close()
        by_p, pull = self._prior(point)
        if len(pull):
            work.shared = reduce_rows(np.vstack([work.shared, np.column_stack([by_p, pull])]))
        return work

    def fit(self, p: np.ndarray, x0: np.ndarray, *, max_iterations: int = 60) -> FreeRunFit:
        """Levenberg-Marquardt from given parameters and initial states."""

        def linearise(point: FreeRunPoint) -> Factors:
            work = self.linearise(point)
            return work.shared[: self.np, : self.np], work.shared[: self.np, self.np], work

        def move(point: FreeRunPoint, work: Any, eta: np.ndarray) -> FreeRunPoint:
            moved = point.x0.copy()
            if self.free_x0:
                moved[:, list(self.free_x0)] += work.solve_locals(eta)
            return FreeRunPoint(p=self.inside(point.p + eta), x0=moved)

        start = FreeRunPoint(p=np.array(p, dtype=float), x0=np.array(x0, dtype=float).reshape(len(self.records), -1))
        search = LevenbergMarquardt(cost=self.cost, linearise=linearise, move=move)
        return self._report(search.minimise(start, max_iterations=max_iterations))

    def _report(self, result: LeastSquaresResult) -> FreeRunFit:
        point = result.point
        r = self.linearise(point).shared[: self.np, : self.np]
        norms = np.maximum(np.linalg.norm(r, axis=0), 1e-300)
        spread = np.linalg.pinv(r / norms, rcond=1e-10) / norms[:, None]
        squares = np.zeros(self.ny)
        for x0, (u, y) in zip(point.x0, self.records, strict=True):
            squares += np.sum((y - self.run(point.p, x0, u)) ** 2, axis=0)
        variance = result.cost / max(1, self.n_rows - self.np)
        return FreeRunFit(
            p=point.p,
            x0=point.x0,
            rmse=np.sqrt(squares * self.ny / self.n_rows),
            covariance=spread @ spread.T * variance,
            converged=result.converged,
            steps=result.steps,
        )
