"""The last samples of a drive as an optimal control problem: what a moving horizon estimator solves at every sample."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from slipangle.codegen.derivatives import jacobians
from slipangle.data.dataset import Dataset
from slipangle.estimate.filter import Scales, moved, moving, repeated_steps, told
from slipangle.estimate.measurements import Row
from slipangle.models.model import Model
from slipangle.models.repeated import Repeated, as_one, followed
from slipangle.ops import Vector, concatenate, stack
from slipangle.optimal.engine import Start
from slipangle.optimal.ocp import OCP, Reference
from slipangle.optimal.terms import Limits, Weights


class Window(Model):
    """A model whose inputs to be found are how its state wanders off it, and whose outputs are weighted residuals.

    State z as in `slipangle.estimate.filter.filter_step`. With the horizon N and as many wandering states m as settings
    give, the stages are: first as many as it takes to bring in the estimate before the window by its n numbers,
    ``z + L v``, m of them at a time; then one for each step. Exogenous inputs say which, see `rows`.

    Parameters
    ----------
    settings : MHE
        The estimator.
    scales : Scales
        Of its parameters.
    """

    def __init__(self, settings: Any, scales: Scales) -> None:
        # Long: names and sizes of everything that the problem is made of.
        model, biased = settings.start, tuple(settings.bias_std)
        self.settings, self.model, self.dt, self._scales = settings, model, float(model.dt), scales
        self.states = (*model.states, *(f"parameter {n}" for n in settings.free), *(f"bias of {n}" for n in biased))
        wander = [settings.process_std.get(n, 0.0) for n in model.states]
        wander += [settings.walk_std.get(n, 0.0) for n in settings.free]
        wander += [settings.bias_walk.get(n, 0.0) for n in biased]
        self.wander = np.array(wander) * np.sqrt(self.dt)
        self.n, self.nx, self.nq = len(self.states), model.n_states, len(settings.free)
        self.shaken = np.flatnonzero(self.wander > 0)
        self.width = max(len(self.shaken), 1)
        self.arrival = -(-self.n // self.width)  # stages that bring in the estimate before
        self.horizon = int(settings.horizon)
        self.noise = np.array([settings.noise(name) for name in model.outputs])
        self.found = tuple(f"w{j}" for j in range(self.width))
        given = [*(f"{n} ahead" for n in model.inputs), *(f"{n} now" for n in model.inputs)]
        given += [*(f"{n} measured" for n in model.outputs), *(f"{n} weight" for n in model.outputs), "moves", "inside"]
        self.given = (*given, *(f"M{i},{j}" for i in range(self.n) for j in range(self.width)))
        self.inputs = (*self.found, *self.given)
        free = zip(settings.free, scales.lower.tolist(), scales.upper.tolist(), strict=True)
        bounds = {**dict(settings.limits), **{f"parameter {n}": (a, b) for n, a, b in free}}
        self.bounds = {n: (a, b) for n, (a, b) in bounds.items() if np.isfinite([a, b]).any()}
        self.residuals = tuple(f"residual of {n}" for n in model.outputs)
        self.outputs = (*self.residuals, *(f"limited {n}" for n in self.bounds))
        self._kind, self._step, _ = moving(model, settings.free, scales)
        self._told = told(settings, scales)

    def initial_state(self, data: Dataset) -> np.ndarray:
        """Not asked for: the estimate before the window is the state at the start."""
        return np.zeros(self.n)

    def step(self, x: Vector, u: Vector) -> Vector:
        """See the class."""
        q, m = x[self.nx : self.nx + self.nq], self.width
        later = self._step(x[: self.nx], q, u[m : m + self.model.n_inputs])
        return self._pushed(x, u, concatenate([later, 1.0 * x[self.nx :]]))

    def repeated(self, x: Any, u: Any, *, given: Sequence[Any], by: Sequence[Any]) -> Repeated | None:
        """The step with one of the model's many explicit ones, see `slipangle.models.repeated.repeated`."""
        step = repeated_steps(self.settings, self._scales, derivatives=bool(by))
        if step is None:
            return None
        symbol = ca.SX.sym("later", self.n)
        pushed = ca.vertcat(self._pushed(x, u, symbol))
        slopes = jacobians([pushed], [*by, symbol]) if by else []

        def then(later: Any, *F: Any) -> list[Any]:
            pairs = zip(slopes, by, strict=False)
            made = [s + ca.mtimes(slopes[-1], ca.mtimes(F[0], ca.jacobian(x, b))) for s, b in pairs]
            return ca.substitute([ca.densify(pushed), *made], [symbol], [later])

        return followed(step, given, [x, u[self.width : self.width + self.model.n_inputs]], then)

    def _pushed(self, x: Vector, u: Vector, later: Any) -> Any:
        """Where it moves to, from a state on the model."""
        nu, ny, m = self.model.n_inputs, self.model.n_outputs, self.width
        w, given = u[:m], u[m:]
        moves, M = given[2 * nu + 2 * ny], given[2 * nu + 2 * ny + 2 :]
        pushed = [sum((M[i * m + j] * w[j] for j in range(m)), 0.0) for i in range(self.n)]
        return stack([moves * later[i] + (1.0 - moves) * x[i] + pushed[i] for i in range(self.n)])

    def output(self, x: Vector, u: Vector) -> Vector:
        """See the class."""
        nu, ny, m = self.model.n_inputs, self.model.n_outputs, self.width
        given = u[m:]
        y, weight, inside = (
            given[2 * nu : 2 * nu + ny],
            given[2 * nu + ny : 2 * nu + 2 * ny],
            given[2 * nu + 2 * ny + 1],
        )
        expected = self._told(x, given[nu : 2 * nu])[0]
        limited = []
        for name, (low, high) in self.bounds.items():
            middle = 0.5 * (low + high) if np.isfinite([low, high]).all() else low if np.isfinite(low) else high
            limited.append(middle + inside * (x[self.states.index(name)] - middle))
        return stack([*(weight[i] * (y[i] - expected[i]) for i in range(ny)), *limited])

    # ---- the problem -------------------------------------------------------------------------------------------

    @cached_property
    def ocp(self) -> OCP:
        """Least squares over the window: what wanders, what was measured, and the estimate before."""
        limits = {f"limited {name}": pair for name, pair in self.bounds.items()}
        return OCP(
            self,
            horizon=self.arrival + self.horizon,
            controls=self.found,
            Q=Weights(dict.fromkeys(self.residuals, 1.0)),
            R=Weights(dict.fromkeys(self.found, 1.0)),
            limits=Limits(limits),
        )

    @cached_property
    def look(self) -> Repeated | ca.Function:
        """``(z, inputs ahead, inputs now) -> z later, its derivative, outputs, their derivative`` for each sample."""
        nu = self.model.n_inputs
        z, ahead, now = self._kind.sym("z", self.n), self._kind.sym("ahead", nu), self._kind.sym("now", nu)
        step = moved(self.settings, self._scales)
        return followed(step, [z, ahead, now], [z, ahead], lambda *r: list(map(ca.densify, [*r, *self._told(z, now)])))

    @cached_property
    def look_once(self) -> ca.Function:
        """`look`, to be called."""
        return as_one(self.look)

    @cached_property
    def look_along(self) -> ca.Function:
        """`look` at each sample of a whole window, a column each; derivatives side by side."""
        return self.look_once.map(self.horizon + 1)

    def start(self, before: tuple[np.ndarray, np.ndarray], rows: Sequence[Row], guess: np.ndarray) -> Start:
        """What the solver starts from.

        Parameters
        ----------
        before : tuple of array, shapes (n,), (n, n)
            Estimate before the window and a factor L of its covariance, lower triangular.
        rows : sequence of Row
            Samples in the window, at most ``horizon + 1``.
        guess : array, shape (n_rows, n)
            Of z at each of them.
        """
        N, nu, ny, m = self.horizon, self.model.n_inputs, self.model.n_outputs, self.width
        mean, L = before
        given = np.zeros((self.arrival + N + 1, len(self.given)))
        M = given[:, 2 * nu + 2 * ny + 2 :].reshape(len(given), self.n, m)
        for k in range(self.arrival):
            part = L[:, k * m : (k + 1) * m]
            M[k, :, : part.shape[1]] = part
        first = len(given) - len(rows)  # samples before the first are not there: nothing moves
        given[:, :nu], given[:, nu : 2 * nu] = rows[0].u, rows[0].u
        for k, row in enumerate(rows):
            at = given[first + k]
            at[nu : 2 * nu], at[2 * nu : 2 * nu + ny] = row.u, row.y
            at[2 * nu + ny : 2 * nu + 2 * ny] = row.seen / self.noise
            at[2 * nu + 2 * ny + 1] = 1.0
            at[:nu] = rows[k + 1].before if k + 1 < len(rows) else row.u
        moving_ones = slice(first, len(given) - 1)
        given[moving_ones, 2 * nu + 2 * ny] = 1.0
        for j, i in enumerate(self.shaken):
            M[moving_ones, i, j] = self.wander[i]
        x = np.vstack([np.tile(mean, (self.arrival, 1)), np.tile(guess[0], (first - self.arrival, 1)), guess])
        w = np.zeros((self.arrival + N, m))
        reference = Reference(tracked=np.zeros((len(given), len(self.residuals))), exogenous=given)
        return Start(x=mean, applied=np.zeros(m), reference=reference, guess_u=w, guess_x=x)


def factor(P: np.ndarray) -> np.ndarray:
    """Lower triangular L with ``L L' = P`` of a symmetric matrix without negative eigenvalues; P may be singular.

    >>> factor(np.array([[4.0, 2.0], [2.0, 1.0]]))
    array([[2., 0.],
           [1., 0.]])
    """
    n = len(P)
    L, rest = np.zeros((n, n)), np.array(P, dtype=float)
    for j in range(n):
        pivot = rest[j, j]
        if pivot > 1e-14 * P[j, j] and pivot > 0:
            L[j:, j] = rest[j:, j] / np.sqrt(pivot)
            rest[j:, j:] -= np.outer(L[j:, j], L[j:, j])
    return L
