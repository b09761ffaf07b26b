"""Grey box: free parameters of an ODE model from the error of its free run."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from slipangle.data.dataset import Dataset
from slipangle.errors import IdentifiabilityWarning, ParameterError
from slipangle.identify.excitation import require_identifiable
from slipangle.models.integrate import discretise
from slipangle.models.model import FitInfo, evaluate, roll_out
from slipangle.models.vehicles import OdeModel


@dataclass(frozen=True, kw_only=True)
class GreyBox:
    """Simulation-error fit by bounded Gauss-Newton with forward sensitivities.

    Minimises the squared free-run error of all outputs and experiments ([1]_ eq. 8-1), each output
    divided by its residual standard deviation. Bounds are the parameter set's ranges.

    Parameters
    ----------
    start : OdeModel
        Model with the start values; also says inputs, outputs, sample time and integrator.
    free : tuple of str
        Names of the parameters to estimate.
    free_initial_state : bool
        Estimate each experiment's initial state too, instead of reading it from its first sample.
    max_iterations : int
        Limit on Gauss-Newton steps.

    References
    ----------
    .. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023.
    .. [2] W. K. Newey, K. D. West, Econometrica 55, 1987: covariance under coloured residuals.
    """

    start: OdeModel
    free: tuple[str, ...]
    free_initial_state: bool = False
    max_iterations: int = 100

    def __post_init__(self) -> None:
        object.__setattr__(self, "free", (self.free,) if isinstance(self.free, str) else tuple(self.free))
        if not self.free:
            raise ParameterError("no parameter is free; expected at least one name, such as free=('C_f', 'C_r')")
        for name in self.free:
            self.start.params.si(name)

    def fit(self, data: Dataset) -> Any:
        """The model with estimated parameters, their covariance and warnings in ``fit_info``.

        Warns
        -----
        IdentifiabilityWarning
            With the names of parameters that the data do not determine.
        """
        began = time.perf_counter()
        problem = _Problem(self, data)
        solution, sigma = problem.solve(self.max_iterations)
        p = solution.x[: len(self.free)] * problem.scale[: len(self.free)]
        covariance, colour = problem.covariance(solution)
        notes = problem.warnings(p, covariance, solution)
        for note in notes:
            warnings.warn(note, IdentifiabilityWarning, stacklevel=2)
        metadata = [self.start.params.si(n) for n in self.free]
        info = FitInfo(
            names=self.free,
            values=p,
            covariance=covariance,
            noise_std=sigma,
            n_samples=problem.n_rows,
            units=tuple(m.unit for m in metadata),
            seconds=time.perf_counter() - began,
            method=f"free-run error, Gauss-Newton with forward sensitivities; {colour}",
            warnings=notes,
            train_name=data.name,
            train_span=(float(data.t[0]), float(data.t[-1])),
        )
        params = self.start.params.with_values(**dict(zip(self.free, map(float, p), strict=True)))
        return replace(self.start, params=params, fit_info=info)


class _Problem:
    """Residuals and their Jacobian over scaled parameters (and initial states) for one fit."""

    def __init__(self, settings: GreyBox, data: Dataset) -> None:
        self.model, self.free = settings.start, settings.free
        self.data = data.select(inputs=self.model.inputs, outputs=self.model.outputs)
        self.model.check(self.data)
        require_identifiable(self.data, len(self.free), scheduling=("v_x",))
        self.parts = self.data.experiments
        self.x0 = [np.asarray(self.model.initial_state(part.head(self.model.memory))) for part in self.parts]
        self.n_p, self.n_x = len(self.free), self.model.n_states
        self.n_x0 = self.n_x if settings.free_initial_state else 0
        self.n_rows = sum(part.n_samples - 1 for part in self.parts)
        self._bounds()
        self._build()
        self.sigma = np.std(self.data.y, axis=0)
        self._last: tuple[bytes, np.ndarray, np.ndarray] | None = None

    def _bounds(self) -> None:
        metadata = [self.model.params.si(n) for n in self.free]
        values = np.array([float(getattr(self.model.params, n)) for n in self.free])
        lower = np.array([m.lower for m in metadata])
        upper = np.array([m.upper for m in metadata])
        span = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
        scale = np.where(np.abs(values) > 1e-4 * span, np.abs(values), 0.05 * span)
        spread = np.maximum(np.abs(np.array(self.x0)).max(axis=0), 0.1)
        self.scale = np.concatenate([scale, np.tile(spread, len(self.parts) if self.n_x0 else 0)])
        free_x0 = np.concatenate(self.x0) if self.n_x0 else np.empty(0)
        self.start = np.concatenate([values, free_x0]) / self.scale
        wide = np.full(len(free_x0), np.inf)
        self.lower = np.concatenate([lower, -wide]) / self.scale
        self.upper = np.concatenate([upper, wide]) / self.scale
        inside = 1e-9 * (self.upper - self.lower)[: self.n_p]
        self.start[: self.n_p] = np.clip(self.start[: self.n_p], (self.lower[: self.n_p] + inside), None)
        self.start[: self.n_p] = np.clip(self.start[: self.n_p], None, (self.upper[: self.n_p] - inside))

    def _build(self) -> None:
        """Step of the state and of its sensitivity, and the outputs with theirs, as functions of [u; p]."""
        nx, nu, n_p, m = self.n_x, self.model.n_inputs, self.n_p, self.n_p + self.n_x0
        kind: Any = ca.MX if self.model.method == "radau" else ca.SX
        x, u, p = kind.sym("x", nx), kind.sym("u", nu), kind.sym("p", n_p)
        s = kind.sym("s", nx, m)

        def at(values: Any) -> OdeModel:
            named = {n: values[i] for i, n in enumerate(self.free)}
            return replace(self.model, params=self.model.params.with_values(**named), fit_info=None)

        step = discretise(
            lambda state, drive: at(drive[nu:]).derivative(state, drive[:nu]),
            self.model.dt,
            n_states=nx,
            n_inputs=nu + n_p,
            method=self.model.method,
            substeps=self.model.substeps,
        )
        x_next, y = step(x, ca.vertcat(u, p)), at(p).output(x, u)

        def sensitivity(value: Any) -> Any:
            of_p = ca.horzcat(ca.jacobian(value, p), kind.zeros(value.shape[0], self.n_x0))
            return ca.mtimes(ca.jacobian(value, x), s) + of_p

        state, drive = ca.vertcat(x, ca.vec(s)), ca.vertcat(u, p)
        self.step = ca.Function("step", [state, drive], [ca.densify(ca.vertcat(x_next, ca.vec(sensitivity(x_next))))])
        self.output = ca.Function("output", [state, drive], [ca.densify(ca.vertcat(y, ca.vec(sensitivity(y))))])

    def evaluate(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weighted residuals, shape (n_rows * n_outputs,), and their Jacobian over z."""
        key = z.tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1], self._last[2]
        value = z * self.scale
        p = value[: self.n_p]
        ny, m = self.model.n_outputs, self.n_p + self.n_x0
        errors, jacobians = [], []
        for i, part in enumerate(self.parts):
            columns = slice(self.n_p + i * self.n_x0, self.n_p + (i + 1) * self.n_x0)
            x0 = value[columns] if self.n_x0 else self.x0[i]
            s0 = np.zeros((self.n_x, m))
            s0[:, self.n_p :] = np.eye(self.n_x, self.n_x0)
            drive = np.hstack([part.u, np.broadcast_to(p, (part.n_samples, self.n_p))])
            states = roll_out(self.step, np.concatenate([x0, s0.T.ravel()]), drive[:-1])
            full = evaluate(self.output, states[1:], drive[1:])
            errors.append((full[:, :ny] - part.y[1:]) / self.sigma)
            local = full[:, ny:].reshape(-1, m, ny).transpose(0, 2, 1) / self.sigma[:, None]
            wide = np.zeros((len(local), ny, len(z)))
            wide[:, :, : self.n_p] = local[:, :, : self.n_p]
            wide[:, :, columns] = local[:, :, self.n_p :]
            jacobians.append(wide)
        error = np.nan_to_num(np.concatenate(errors).ravel(), nan=1e6, posinf=1e6, neginf=-1e6)
        with np.errstate(over="ignore", invalid="ignore"):  # a trial step may make the free run diverge
            jacobian = np.concatenate(jacobians).reshape(len(error), len(z)) * self.scale
        jacobian = np.nan_to_num(jacobian, nan=0.0, posinf=0.0, neginf=0.0)
        self._last = (key, np.clip(error, -1e6, 1e6), jacobian)
        return self._last[1], self._last[2]

    def solve(self, max_iterations: int) -> tuple[OptimizeResult, np.ndarray]:
        """Solve, weigh the outputs by their residuals, solve again."""
        z = self.start
        rounds = 1 if self.model.n_outputs == 1 else 3
        solution = None
        for _ in range(rounds):
            self._last = None
            jacobian: Any = lambda z: self.evaluate(z)[1]  # noqa: E731
            solution = least_squares(
                lambda z: self.evaluate(z)[0],
                z,
                jac=jacobian,
                bounds=(self.lower, self.upper),
                method="trf",
                xtol=1e-9,
                ftol=1e-11,
                gtol=1e-12,
                max_nfev=max_iterations,
            )
            z = solution.x
            self.sigma = np.maximum(
                self.sigma * np.std(solution.fun.reshape(-1, self.model.n_outputs), axis=0),
                1e-12 * np.maximum(1e-12, np.std(self.data.y, axis=0)),
            )
        if solution is None:
            raise AssertionError
        self._last = None
        error, jacobian = self.evaluate(solution.x)
        solution.fun, solution.jac = error, jacobian
        return solution, self.sigma

    def covariance(self, solution: OptimizeResult) -> tuple[np.ndarray, str]:
        """Covariance of the free parameters, allowing for coloured residuals when they are."""
        e, j = solution.fun, solution.jac
        dof = max(1, len(e) - len(solution.x))
        inverse = np.linalg.pinv(j.T @ j, rcond=1e-14, hermitian=True)
        ny = self.model.n_outputs
        per_sample = e.reshape(-1, ny)
        lag1 = np.array([_lag_one(per_sample[:, i]) for i in range(ny)])
        white = np.all(np.abs(lag1) < 3.3 / np.sqrt(len(per_sample)))
        if white:
            result, text = inverse * float(e @ e) / dof, "covariance for white residuals"
        else:
            scores = (e[:, None] * j).reshape(len(per_sample), ny, -1).sum(axis=1)
            rho = float(np.clip(np.abs(lag1).max(), 0, 0.999))
            alpha = 4 * rho**2 / ((1 - rho) ** 2 * (1 + rho) ** 2)
            width = int(min(1.1447 * (alpha * len(scores)) ** (1 / 3), len(scores) // 4)) + 1
            meat = scores.T @ scores
            for lag in range(1, width + 1):
                gamma = scores[lag:].T @ scores[:-lag]
                meat += (1 - lag / (width + 1)) * (gamma + gamma.T)
            result = inverse @ meat @ inverse * len(e) / dof
            text = f"covariance for coloured residuals (Newey-West, {width} lags)"
        scale = self.scale[: self.n_p]
        return result[: self.n_p, : self.n_p] * np.outer(scale, scale), text

    def warnings(self, p: np.ndarray, covariance: np.ndarray, solution: OptimizeResult) -> tuple[str, ...]:
        """Sentences that name parameters which the data do not determine."""
        said = []
        std = np.sqrt(np.maximum(np.diag(covariance), 0))
        metadata = [self.model.params.si(n) for n in self.free]
        size = np.maximum(np.abs(p), self.scale[: self.n_p] * (np.abs(p) < 0.02 * self.scale[: self.n_p]))
        for name, value, sd, ref, meta in zip(self.free, p, std, size, metadata, strict=True):
            if 1.96 * sd > 0.5 * ref:
                said.append(
                    f"the data do not determine {name}: {value:.4g} ± {1.96 * sd:.2g} {meta.unit} (95 %); expected "
                    "an interval below half the value: fix it, or add a manoeuvre that moves it"
                )
            if min(value - meta.lower, meta.upper - value) < 1e-6 * max(abs(meta.lower), abs(meta.upper)):
                said.append(
                    f"{name} ends at its bound, {value:.4g} {meta.unit}; expected an interior optimum: check units, "
                    "signs and the fixed parameters, or widen the range"
                )
        columns = solution.jac[:, : self.n_p]
        norms = np.linalg.norm(columns, axis=0)
        if (norms == 0).any():
            for name in np.array(self.free)[norms == 0]:
                said.append(f"the outputs do not depend on {name}; expected an influence: fix it")
        elif self.n_p > 1:
            _, s, vt = np.linalg.svd(columns / norms, full_matrices=False)
            if s[0] > 300 * s[-1]:
                group = [n for n, v in zip(self.free, vt[-1], strict=True) if abs(v) > 0.3]
                said.append(
                    f"{', '.join(group)} can hardly be told apart (condition number {s[0] / s[-1]:.0f}); expected "
                    "below 300: fix one of them, or add a manoeuvre that separates them"
                )
        if solution.status == 0:
            said.append("the fit stopped at its iteration limit; expected convergence: raise max_iterations")
        return tuple(said)


def _lag_one(e: np.ndarray) -> float:
    e = e - e.mean()
    power = float(e @ e)
    return float(e[1:] @ e[:-1]) / power if power > 0 else 0.0
