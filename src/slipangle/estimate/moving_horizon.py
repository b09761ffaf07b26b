"""`MHE`: a moving horizon estimator: the last samples as one optimal control problem, solved again at every sample."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, TypeVar

import numpy as np

from slipangle.errors import ParameterError, SimulationError
from slipangle.estimate.ekf import EKF
from slipangle.estimate.filter import Scales
from slipangle.estimate.measurements import Row
from slipangle.estimate.recursive import RecursiveVehicle
from slipangle.estimate.window import Window, factor
from slipangle.fields import Count
from slipangle.models.model import Model, without_caches
from slipangle.optimal.engine import Backend, Engine, Start
from slipangle.optimal.named import backend_of, require_solver
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, coerce, require_names

M = TypeVar("M", bound=Model)


@dataclass(frozen=True, kw_only=True)
class MHE(EKF[M]):
    """Moving horizon estimator for the states of any model, and for some of its parameters. [1]_, [2]_ sec. 4.3

    At every sample it finds the states over the last ``horizon`` steps that fit best, in the sense of least squares
    weighted by the noise, to what was measured in that time, to the model, and to what was known before; by the solvers
    of the predictive controllers. What leaves the window stays known as an estimate with a covariance: that of a
    Kalman filter along the states found. On a linear model it is the Kalman filter, however long the horizon. It
    differs where a model is nonlinear, since samples are looked at again in the light of later ones, and where limits
    hold.

    Measurements are taken in as by `EKF`, and it stands wherever that does, in exported C too (`export`).

    Raises ParameterError as `EKF` does, or if an output is later than the horizon is long, or a limit is on no state.

    Parameters
    ----------
    horizon : int
        Steps of the model over which it looks back.
    limits : Limits
        Ranges of states, kept in the whole window; the covariance does not know of them.
    solver : {"realtime", "ipopt"} or Backend
        As of `slipangle.control.mpc.MPC`.

    The others are those of `EKF`.

    References
    ----------
    .. [1] C. V. Rao, J. B. Rawlings, D. Q. Mayne, Constrained state estimation for nonlinear discrete-time systems,
       IEEE Trans. Automatic Control 48(2), 2003, 246-258.
    .. [2] J. B. Rawlings, D. Q. Mayne, M. M. Diehl, Model Predictive Control: Theory, Computation, and Design, 2nd ed.,
       2017: the prior by filtering.
    """

    horizon: Count = 10
    limits: Limits = field(default_factory=Limits)
    solver: Literal["realtime", "ipopt"] | Backend = "realtime"

    def __post_init__(self) -> None:
        coerce(self, Limits, "limits")
        super().__post_init__()
        require_names(self.limits, self.start.states, "limits", "use a state of the model")
        for name, late in self.late.items():
            if round(late / self.dt) > self.horizon:
                raise ParameterError(
                    f"'{name}' is {late:g} s late and the horizon {self.horizon * self.dt:g} s long; expected a "
                    f"horizon of at least {round(late / self.dt)} steps"
                )
        require_solver(self.solver)

    def __getstate__(self) -> dict[str, Any]:
        """What a copy needs: the settings, nothing compiled."""
        return without_caches(self)

    @cached_property
    def window(self) -> Window:
        """The problem of one window."""
        return Window(self, Scales(self))

    @cached_property
    def engine(self) -> Engine:
        """The solver built for it."""
        return backend_of(self.solver).build(self.window.ocp, None)

    def begin(self, measured: Mapping[str, float]) -> MovingHorizon:
        """An estimator before its first sample, where channels by name say what the state is about."""
        tracker = MovingHorizon(self)
        tracker.begin(measured)
        return tracker

    def start_at(self, x0: np.ndarray | None = None) -> MovingHorizon:
        """An estimator before its first sample; ``x0``, shape (n_states,), is the state expected there, or zero."""
        tracker = MovingHorizon(self)
        tracker.restart(x0)
        return tracker


class MovingHorizon(RecursiveVehicle):
    """A vehicle whose states and parameters are estimated over a moving window; made by `MHE.start_at`.

    Whether an output is an outlier, and its innovation, are told by the prediction from the estimate before, or, of a
    late one, by the states found so far at its own sample. A window that has no solution counts in `failures`; the
    state is then that of the filter through the window.
    """

    way = "moving horizon estimator; covariance for the noise that it was given"

    def __init__(self, settings: MHE[Any]) -> None:
        self._window = settings.window
        self._before_window: tuple[np.ndarray, np.ndarray] = (np.empty(0), np.empty((0, 0)))
        self._priors: list[np.ndarray] = []
        self.failures, self.status = 0, Status.SOLVED
        super().__init__(settings)
        self._steps = np.array(self._late.steps)

    def restart(self, x0: np.ndarray | None = None) -> None:
        """See `RecursiveVehicle.restart`."""
        super().restart(x0)
        self._samples: deque[Row] = deque()
        self._found = np.empty((0, self._window.n))

    @property
    def smoothed(self) -> np.ndarray:
        """States at each sample in the window, the last one now, shape (n_samples, n_states)."""
        return self._found[:, : self._nx].copy()

    def _estimate(self) -> None:
        """The window with the newest sample, instead of a filter's step."""
        late = (self._steps > 0) & self._finite_y
        self._seen[self._steps > 0] = 0.0
        kept = self._before_window, list(self._samples), self._found, self._priors
        if not self._samples:
            self._before_window = self._z.copy(), self._P.copy()
        self._run()  # predicts, judges outliers, and is a first guess
        self._require_finite()
        now = (self._z, self._P, self._before, self._u, self._y, self._taken, self._gate, self._dt)
        self._samples.append(Row(*(array.copy() for array in now)))
        self._found = np.vstack([self._found, self._z_new])
        if len(self._samples) > self.settings.horizon + 1:
            self._leave()
        placed = self._place(late)
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is looked for below
                self._solve()
            self._require_finite()
        except SimulationError:
            for row, i in placed:
                row.seen[i] = 0.0
            self._before_window, samples, self._found, self._priors = kept
            self._samples = deque(samples)
            raise

    def _leave(self) -> None:
        """Take the oldest sample out of the window; what it said stays in the estimate before."""
        row, after = self._samples.popleft(), self._samples[0]
        look = self._looked(self._found[:1], [row, after])
        mean, P = self._corrected(*self._before_window, self._found[0], row, look, 0)
        later, F = look[0][0], look[1][0]
        self._before_window = later + F @ (mean - self._found[0]), F @ P @ F.T + np.diag(self._window.wander**2)
        self._found, self._priors = self._found[1:], self._priors[1:]

    def _place(self, late: np.ndarray) -> list[tuple[Row, int]]:
        """Put late outputs where they belong, those that are no outliers; which were placed."""
        placed: list[tuple[Row, int]] = []
        self._taken[late] = 0.0
        for i in np.flatnonzero(late):
            back = int(self._steps[i])
            if back >= len(self._samples):
                continue
            row = self._samples[-1 - back]
            _, _, told, H = self._looked(self._found[-1 - back : len(self._found) - back], [row, row])
            self._error[i] = self._y[i] - told[0, i]
            h, P = H[0, i], self._priors[len(self._samples) - 1 - back]
            self._variance[i] = h @ P @ h + self._window.noise[i] ** 2
            if abs(self._error[i]) <= np.sqrt(self._gate[i] * self._variance[i]):
                row.y[i], row.seen[i], self._taken[i] = self._y[i], 1.0, 1.0
                placed.append((row, int(i)))
        return placed

    def _solve(self) -> None:
        """States over the window, and the covariance of the last."""
        window, rows = self._window, list(self._samples)
        mean, P = self._before_window
        start = self._guessed(window.start((mean, factor(P)), rows, self._found), factor(P))
        try:
            solution = self.settings.engine.solve(start)
            self.status, states = solution.status, np.array(solution.x[-len(rows) :])
        except Exception:  # a solver from outside may stop with any
            self.status, states = Status.FAILED, np.full_like(self._found, np.nan)
        if self.status.solved and np.isfinite(states).all():
            self._found = states
        else:
            self.failures += 1
            self._found = self._filtered(rows)[0]
        _, self._priors, self._P_new[:] = self._filtered(rows)
        self._z_new[:] = self._found[-1]

    def _guessed(self, start: Start, L: np.ndarray) -> Start:
        """The start with inputs that lead along its states, as far as they can."""
        window, first = self._window, self._window.arrival
        x, w = start.guess_x, start.guess_u
        v, off = np.zeros(window.n), x[first] - start.x
        for j in range(window.n):
            if L[j, j] > 0:
                v[j] = (off[j] - L[j, :j] @ v[:j]) / L[j, j]
        w[:first].flat[: window.n] = v
        for k in range(first):
            used = (k + 1) * window.width
            x[k + 1] = start.x + L[:, :used] @ v[:used]
        n = len(self._samples)
        if n > 1 and len(window.shaken):
            off = self._found[1:] - self._looked(self._found, list(self._samples))[0][:-1]
            w[len(w) - n + 1 :, : len(window.shaken)] = off[:, window.shaken] / window.wander[window.shaken]
        return start

    def _looked(self, z: np.ndarray, rows: list[Row]) -> tuple[np.ndarray, ...]:
        """What the model says at each of ``z``: the state later, its derivative, outputs, their derivative."""
        window, count = self._window, len(z)
        n, nu = window.n, window.model.n_inputs
        whole = self.settings.horizon + 1  # as many as the window has at most
        look, size = (window.look_once, 1) if count == 1 else (window.look_along, whole)
        columns = np.zeros((size, n + 2 * nu))
        columns[:, :n], columns[:, n : n + nu], columns[:, n + nu :] = z[0], rows[0].u, rows[0].u
        columns[:count, :n] = z
        for k in range(count):
            ahead = rows[k + 1].before if k + 1 < len(rows) else rows[k].u
            columns[k, n : n + nu], columns[k, n + nu :] = ahead, rows[k].u
        told = look(columns[:, :n].T, columns[:, n : n + nu].T, columns[:, n + nu :].T)
        later, F, y, H = (np.asarray(m.full()) for m in told)
        F, H = (m.reshape(len(m), len(columns), n).transpose(1, 0, 2) for m in (F, H))
        return later.T[:count], F[:count], y.T[:count], H[:count]

    def _corrected(
        self, mean: np.ndarray, P: np.ndarray, at: np.ndarray, row: Row, look: tuple[np.ndarray, ...], k: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """An estimate and its covariance after a sample, with the model linearised ``at`` a state."""
        seen = np.flatnonzero(row.seen > 0)
        if not len(seen):
            return mean, P
        H, R = look[3][k][seen], np.diag(self._window.noise[seen] ** 2)
        error = row.y[seen] - look[2][k][seen] - H @ (mean - at)
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        keep = np.eye(len(P)) - K @ H
        return mean + K @ error, keep @ P @ keep.T + K @ R @ K.T

    def _filtered(self, rows: list[Row]) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
        """Kalman filter through the window, linearised at the states found.

        Estimates at each sample, shape (n_rows, n), their covariances before each was taken in, and the last after.
        """
        look = self._looked(self._found, rows)
        mean, P = self._before_window
        means, priors = [], []
        for k, row in enumerate(rows):
            if k:
                step = look[0][k - 1] + look[1][k - 1] @ (mean - self._found[k - 1])
                F = look[1][k - 1]
                mean, P = step, F @ P @ F.T + np.diag(self._window.wander**2)
            priors.append(P)
            mean, P = self._corrected(mean, P, self._found[k], row, look, k)
            means.append(mean)
        return np.array(means), priors, 0.5 * (P + P.T)
