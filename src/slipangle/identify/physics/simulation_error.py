"""The error of a free run as a function of parameters, and its derivatives: the least-squares problem of a grey box."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares as trust_region

from slipangle.data.dataset import Dataset
from slipangle.errors import ModelWarning, ParameterError
from slipangle.identify.excitation import require_identifiable
from slipangle.identify.physics.forward import forward
from slipangle.models.ode import Parametrised
from slipangle.numerics.least_squares import LeastSquaresResult, least_squares

MOST_ROUNDS = 12  # of weighing the outputs by their errors and solving again
_SETTLED = 1e-6  # relative change of the weights that ends this
_FOLLOWS = 0.05  # difference of free run and given states over the error, both RMS, up to which they are the same
_STEEPEST = 1e100  # derivative of a free run about to diverge, whose square is still a number
_KEPT = 64  # models with values that states at first samples were read with
_WORST = 1e6  # error in standard deviations that a diverging free run counts


@dataclass(frozen=True, kw_only=True)
class Minimum:
    """Where a fit ended."""

    z: np.ndarray  # (n_z,), scaled unknowns
    error: np.ndarray  # (n_rows * n_outputs,), weighted errors, simulated minus measured
    jacobian: np.ndarray  # (n_rows * n_outputs, n_z), their derivatives
    sigma: np.ndarray  # (n_outputs,), standard deviation of each output's error, by which it was divided
    converged: bool  # whether it ended before its limit on iterations

    @property
    def diverged(self) -> bool:
        """Whether the free run is not finite or all but infinite somewhere."""
        return bool((np.abs(self.error) >= _WORST).any())


class FreeRunProblem:
    """Weighted free-run errors and their Jacobian over scaled unknowns.

    The unknowns are the shared parameters, then each parameter per recording (all recordings of the first, all of
    the next), then the experiments' initial states where those are free.

    ``shared`` and ``own`` name the free parameters with one value for all experiments, and with one for each recording;
    ``recordings`` numbers the recording that each experiment is of, by default each of one of its own. Initial states
    are read from the first samples unless they are free.
    """

    def __init__(
        self,
        model: Any,
        shared: tuple[str, ...],
        own: tuple[str, ...],
        data: Dataset,
        free_initial_state: bool,
        recordings: Sequence[int] | None = None,
    ) -> None:
        self.model, self.shared, self.own = model, shared, own
        self.free = (*shared, *own)
        self.data = data.select(inputs=model.inputs, outputs=model.outputs)
        model.check(self.data)
        self.parts = self.data.experiments
        self.n_e, self.n_x = len(self.parts), model.ode.n_states
        of = list(range(self.n_e)) if recordings is None else list(recordings)
        self.recordings = sorted(set(of))
        self._group = [self.recordings.index(k) for k in of]
        self.n_p = len(shared) + len(own) * len(self.recordings)
        require_identifiable(self.data, self.n_p, scheduling=("v_x",))
        self.n_x0 = self.n_x if free_initial_state else 0
        self._varied: dict[tuple[float, ...], Any] = {}  # the experiments of a recording have the same
        first = model.memory - 1
        self.rows = [model.drive_rows(part) for part in self.parts]
        self.measured = [part.y[first:] for part in self.parts]
        self.heads = [part.rows(first, first + 1) for part in self.parts]
        self.n_rows = sum(len(y) - 1 for y in self.measured)
        self.run = forward(model, self.free)
        self._scales()
        self.sigma = np.std(self.data.y, axis=0)
        self._last: tuple[bytes, np.ndarray, np.ndarray] | None = None

    # ---- unknowns ----------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters: ``mass[0]`` is that of the first recording."""
        return (*self.shared, *(f"{n}[{i}]" for n in self.own for i in self.recordings))

    @property
    def base_names(self) -> tuple[str, ...]:
        """The same without the recording."""
        return (*self.shared, *(n for n in self.own for _ in self.recordings))

    def _scales(self) -> None:
        metadata = [self.model.si(n) for n in self.base_names]
        values = np.array([self.model.value(n) for n in self.base_names])
        lower = np.array([m.lower for m in metadata])
        upper = np.array([m.upper for m in metadata])
        self.ranges = np.array([lower, upper])  # exactly: scaled there and back, a bound may round to just outside
        span = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
        positive = (lower > 0) | (lower == 0) & (values > 1e-6 * span)  # what a fit left at zero has no scale
        own = (np.abs(values) > 1e-4 * span) | positive
        scale = np.where(own, np.abs(values), 0.05 * span)
        start = np.array([self.model.value(n) for n in self.free])
        x0 = np.array([self._read_state(i, start) for i in range(self.n_e)])
        spread = np.maximum(np.abs(x0).max(axis=0), 0.1)
        free_x0 = x0.ravel() if self.n_x0 else np.empty(0)
        self.scale = np.concatenate([scale, np.tile(spread, self.n_e if self.n_x0 else 0)])
        wide = np.full(len(free_x0), np.inf)
        self.lower = np.concatenate([lower, -wide]) / self.scale
        self.upper = np.concatenate([upper, wide]) / self.scale
        width = self.upper - self.lower  # in units of the start, which a wide range of small cars must not move
        inside = 1e-9 * np.where(np.isfinite(width), np.minimum(width, 100.0), 0.0)
        self.start = np.clip(np.concatenate([values, free_x0]) / self.scale, self.lower + inside, self.upper - inside)
        self.fixed_x0 = x0
        self.moving = [] if self.n_x0 else self._parameters_of_the_start(start)

    def _parameters_of_the_start(self, start: np.ndarray) -> list[int]:
        """Free parameters on which the state at the first sample depends, such as a steering offset or a sensor's."""
        names = []
        for j, name in enumerate(self.free):
            meta = self.model.si(name)
            for target in (start[j] * 1.01 + 1e-3, start[j] * 0.99 - 1e-3):
                moved = start.copy()
                moved[j] = np.clip(target, meta.lower, meta.upper)
                if moved[j] != start[j] and any(
                    not np.array_equal(self._read_state(i, moved), self.fixed_x0[i]) for i in range(min(3, self.n_e))
                ):
                    names.append(j)
                    break
        return names

    def _read_state(self, i: int, p: np.ndarray) -> np.ndarray:
        return np.asarray(self._with(tuple(map(float, p))).ode.initial_state(self.heads[i]), dtype=float)

    def _with(self, values: tuple[float, ...]) -> Any:
        """The model with these values of the free parameters, one of the last few where it is there already."""
        varied = self._varied.get(values)
        if varied is None:
            if len(self._varied) >= _KEPT:
                self._varied.clear()
            with warnings.catch_warnings():  # of what is only tried; the model that a fit ends with says so itself
                warnings.simplefilter("ignore", ModelWarning)
                varied = self.model.with_values(**dict(zip(self.free, values, strict=True)))
            self._varied[values] = varied
        return varied

    def columns(self, i: int) -> np.ndarray:
        """Places in z of the free parameters and, where free, the initial state of experiment ``i``."""
        k = len(self.shared)
        own = [k + j * len(self.recordings) + self._group[i] for j in range(len(self.own))]
        x0 = self.n_p + i * self.n_x0 + np.arange(self.n_x0)
        return np.concatenate([np.arange(k), own, x0]).astype(int)

    def parameters(self, i: int, z: np.ndarray) -> np.ndarray:
        """Values of the free parameters in experiment ``i``, in their order, SI units."""
        places = self.columns(i)[: len(self.free)]
        return np.clip(z[places] * self.scale[places], *self.ranges[:, places])

    def first_state(self, i: int, z: np.ndarray) -> np.ndarray:
        """State at the first sample of experiment ``i``, shape (n_x,)."""
        if self.n_x0:
            places = self.columns(i)[len(self.free) :]
            return z[places] * self.scale[places]
        return self._read_state(i, self.parameters(i, z)) if self.moving else self.fixed_x0[i]

    def initial(self, i: int, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same, and its derivatives by `columns`."""
        slope = np.zeros((self.n_x, len(self.free) + self.n_x0))
        if self.n_x0:
            slope[:, len(self.free) :] = np.eye(self.n_x)
            return self.first_state(i, z), slope
        p = self.parameters(i, z)
        for j in self.moving:
            meta, h = self.model.si(self.free[j]), 1e-5 * max(abs(p[j]), 1e-2)
            ends = [float(np.clip(p[j] + s * h, meta.lower, meta.upper)) for s in (-1, 1)]
            states = [self._read_state(i, np.concatenate([p[:j], [end], p[j + 1 :]])) for end in ends]
            slope[:, j] = (states[1] - states[0]) / (ends[1] - ends[0])
        return self.first_state(i, z), slope

    def with_parameters(self, i: int, z: np.ndarray) -> Any:
        """The model of experiment ``i``."""
        return self._with(tuple(map(float, self.parameters(i, z))))

    def by_first_sample(self, i: int, z: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Derivatives of the state at the first sample of experiment ``i`` by channels there, shape (n_x, n_names)."""
        ode, head = self.with_parameters(i, z).ode, self.heads[i]
        slopes = np.zeros((self.n_x, len(names)))
        for k, name in enumerate(names):
            here = head[name]
            h = 1e-4 * max(float(np.std(self.data[name])), 1e-6 * float(np.abs(here[0])), 1e-9)
            ends = [np.asarray(ode.initial_state(head.with_channel(name, here + d))) for d in (h, -h)]
            slopes[:, k] = (ends[0] - ends[1]) / (2 * h)
        return slopes

    # ---- errors ------------------------------------------------------------------------------------------------

    def simulate(self, i: int, z: np.ndarray) -> np.ndarray:
        """Outputs of experiment ``i`` and their derivatives by `columns`, shape (n, n_outputs, 1 + n_columns)."""
        return self.run(*self._run_of(i, z))

    def _run_of(self, i: int, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        return (*self.initial(i, z), self.rows[i], self.parameters(i, z))

    def cost(self, z: np.ndarray) -> float:
        """Sum of squared weighted errors, without derivatives; a free run that diverges counts as `_WORST`."""
        total = 0.0
        for part in self.errors(z, self.rows):
            error = np.nan_to_num(part, nan=_WORST, posinf=_WORST, neginf=-_WORST)
            total += float(np.sum(np.clip(error, -_WORST, _WORST) ** 2))
        return total

    def errors(self, z: np.ndarray, rows: Sequence[np.ndarray]) -> Iterator[np.ndarray]:
        """Weighted errors of each experiment in turn, shape (n, n_outputs), driven by ``rows``, without derivatives."""
        for i, y in enumerate(self.measured):
            x0, none = self.first_state(i, z), np.zeros((self.n_x, 0))
            with np.errstate(over="ignore", invalid="ignore"):
                yield (self.run(x0, none, rows[i], self.parameters(i, z))[1:, :, 0] - y[1:]) / self.sigma

    def evaluate(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weighted errors, shape (n_rows * n_outputs,), and their Jacobian over z."""
        key = z.tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1], self._last[2]
        ny = self.model.n_outputs
        error, jacobian = np.empty(self.n_rows * ny), np.zeros((self.n_rows * ny, len(z)))
        at = 0
        with np.errstate(over="ignore", invalid="ignore"):  # a trial step may make the free run diverge
            runs = self.run.many([self._run_of(i, z) for i in range(self.n_e)])
            for i, (run, y) in enumerate(zip(runs, self.measured, strict=True)):
                full = run[1:] / self.sigma[:, None]
                rows = slice(at, at + len(full) * ny)
                error[rows] = (full[:, :, 0] - y[1:] / self.sigma).ravel()
                jacobian[rows, self.columns(i)] = full[:, :, 1:].reshape(len(full) * ny, -1)
                at = rows.stop
            jacobian *= self.scale
        error = np.clip(np.nan_to_num(error, nan=_WORST, posinf=_WORST, neginf=-_WORST), -_WORST, _WORST)
        lost = np.abs(error) == _WORST
        if lost.any() or not (np.abs(jacobian) < _STEEPEST).all():
            jacobian = np.clip(np.nan_to_num(jacobian, nan=0.0, posinf=0.0, neginf=0.0), -_STEEPEST, _STEEPEST)
        self._last = (key, error, jacobian)
        return error, jacobian

    def divide_by(self, sigma: np.ndarray) -> None:
        """Divide each output's errors by its entry of ``sigma``, SI units, from now on."""
        self.sigma, self._last = np.asarray(sigma, dtype=float), None

    def weigh(self, error: np.ndarray) -> bool:
        """Divide each output by the standard deviation of its errors from now on; whether that changes nothing."""
        spread = np.std(error.reshape(-1, self.model.n_outputs), axis=0)
        least = 1e-12 * np.maximum(1e-12, np.std(self.data.y, axis=0))
        before, self.sigma = self.sigma, np.maximum(self.sigma * spread, least)
        self._last = None
        share = self.sigma / before
        even = np.ptp(share) <= _SETTLED * share.max()  # a common factor moves no minimum
        return bool(even or (self.sigma <= 1e3 * _SETTLED * np.std(self.data.y, axis=0)).all())

    def search(self, z: np.ndarray, max_iterations: int, *, tolerance: float = 1e-10) -> LeastSquaresResult:
        """Levenberg-Marquardt steps within the bounds under the present weights."""
        limits: Any = {"bounds": (self.lower, self.upper), "max_iterations": max_iterations, "tolerance": tolerance}
        error, jacobian = (lambda z, k=k: self.evaluate(z)[k] for k in (0, 1))
        return least_squares(z, errors=error, jacobian=jacobian, cost=self.cost, **limits)

    def minimise(self, z: np.ndarray, max_iterations: int, *, tolerance: float = 1e-11) -> Minimum:
        """Gauss-Newton in a trust region with bounds; outputs weighed by their errors, then solved again.

        A step that lowers the squared error by less than ``tolerance`` of it is the last. The trust region, shaped
        by the distance to the bounds, stays in the valley that a step cut off at a bound leaves: a bicycle whose
        steering gain is free too would lose all its stiffness.
        """
        converged = False
        error, jacobian = (lambda z, k=k: self.evaluate(z)[k] for k in (0, 1))
        how: Any = {"jac": jacobian, "bounds": (self.lower, self.upper), "method": "trf", "max_nfev": max_iterations}
        how |= {"xtol": 1e-9, "ftol": tolerance, "gtol": 1e-12}
        for _ in range(MOST_ROUNDS):
            solution = trust_region(error, z, **how)
            z, converged = solution.x, solution.status != 0
            if self.weigh(solution.fun):
                break
        return self.at(z, converged=converged)

    def own_free_run_misses(self, along: Minimum) -> bool:
        """Whether one free run errs otherwise than states found by other means, because it leaves them."""
        gap = np.mean((self.evaluate(along.z)[0] - along.error) ** 2)
        return bool(gap > _FOLLOWS**2 * max(float(np.mean(along.error**2)), 1e-6))

    def at(self, z: np.ndarray, *, converged: bool = True) -> Minimum:
        """Errors and derivatives at z under the present weights."""
        self._last = None
        error, jacobian = self.evaluate(z)
        return Minimum(z=z, error=error, jacobian=jacobian, sigma=self.sigma, converged=converged)


def check_names(model: Any, shared: tuple[str, ...], own: tuple[str, ...]) -> None:
    """Raise unless there are free parameters and every one is known and named once."""
    if not isinstance(model, Parametrised):
        raise ParameterError(
            f"the start model is {type(model).__name__}; expected an ODE with parameters, such as Bicycle, Ode "
            "or Delayed: other models have estimators of their own"
        )
    if not (*shared, *own):
        raise ParameterError("no parameter is free; expected at least one name, such as free=('C_f', 'C_r')")
    for name in (*shared, *own):
        model.si(name)
    twice = sorted({n for n in (*shared, *own) if (*shared, *own).count(n) > 1})
    if twice:
        raise ParameterError(
            f"{', '.join(twice)} is named twice in free and per_experiment; expected once: one value for all "
            "experiments (free), or one for each (per_experiment)"
        )
