"""`RecursiveVehicle`: an extended Kalman filter at work, one sample at a time."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.headings import TURN
from slipangle.errors import NotFiniteError, ParameterError, SimulationError
from slipangle.estimate.filter import Scales, filter_step, fitted, parametrised, varied
from slipangle.estimate.filter_run import FilterRun
from slipangle.estimate.measurements import Gates, Intake, Late, Row, by_name, headings, plain_name
from slipangle.models.fast import bind
from slipangle.models.model import FitInfo
from slipangle.models.repeated import as_one
from slipangle.optimal.terms import require_names


class RecursiveVehicle:
    """A vehicle whose states and parameters are estimated one sample at a time; made by `EKF.start_at`.

    ``settings`` are those of the `EKF`.

    `update` allocates nothing unless outputs are late: prediction, derivatives and correction are one CasADi function
    on arrays made here.
    """

    way = "extended Kalman filter; covariance for the noise that it was given"

    def __init__(self, settings: Any) -> None:
        model, nx, nq = settings.start, settings.start.n_states, len(settings.free)
        self.settings, self._nx, self._nq, self._n = settings, nx, nq, nx + nq + len(settings.bias_std)
        self._scales = Scales(settings)
        n, ny, nu = self._n, model.n_outputs, model.n_inputs
        self._z, self._P = np.zeros(n), np.zeros((n, n))
        self._z_new, self._P_new = np.zeros(n), np.zeros((n, n))
        self._u, self._before, self._y, self._seen = np.zeros(nu), np.zeros(nu), np.zeros(ny), np.zeros(ny)
        self._dt, self._error, self._variance, self._taken = np.zeros(1), np.zeros(ny), np.zeros(ny), np.zeros(ny)
        self._finite_y, self._finite_u = np.zeros(ny, dtype=bool), np.zeros(nu, dtype=bool)
        self._finite_z, self._finite_P = np.zeros(n, dtype=bool), np.zeros((n, n), dtype=bool)
        self._gates = Gates(ny, settings.gate, settings.patience)
        self._gate = self._gates.squares
        arguments = [self._z, self._P, self._before, self._u, self._y, self._seen, self._gate, self._dt]
        results = self._z_new, self._P_new, self._error, self._variance, self._taken
        self._run = bind(as_one(filter_step(settings, self._scales)), arguments, *results)
        steps = [round(settings.late.get(name, 0.0) / model.dt) for name in model.outputs]
        self._late = Late(tuple(steps))
        self._rows: deque[Row] = deque(maxlen=self._late.deepest + 1)
        self._intake = Intake(model.outputs, model.inputs)
        self._headings = [(i, a) for i, a in enumerate(headings(model)) if a >= 0]
        self._P[nx:, nx:] = np.diag([*self._scales.prior, *settings.bias_std.values()]) ** 2
        self.n_samples = 0
        self.restart()

    def restart(self, x0: np.ndarray | None = None) -> None:
        """Forget the state but not the parameters and offsets: for a new experiment or after a gap.

        ``x0``, shape (n_states,), is the state expected at the next sample; by default zero. Raises ParameterError if
        it is not as many finite numbers.
        """
        nx, s = self._nx, self.settings
        x0 = np.zeros(nx) if x0 is None else np.asarray(x0, dtype=float)
        if x0.shape != (nx,) or not np.isfinite(x0).all():
            raise ParameterError(f"x0 is {x0.tolist()}; expected {nx} finite numbers: {', '.join(s.start.states)}")
        self._z[:nx] = x0
        self._P[:nx], self._P[:, :nx] = 0.0, 0.0
        self._P[np.arange(nx), np.arange(nx)] = np.square([self._state_std(name) for name in s.start.states])
        self._dt[0] = 0.0  # the first sample corrects only
        self._rows.clear()

    def _state_std(self, name: str) -> float:
        """Of one state at the start, see `EKF`."""
        s, plain = self.settings, plain_name(name)
        if name in s.state_std:
            return s.state_std[name]
        if plain != name and plain in s.start.inputs:
            return 0.0
        return s.noise(plain) if plain in s.start.outputs else 1.0

    def begin(self, measured: Mapping[str, float]) -> None:
        """Restart where channels by name say what the state is about, see `slipangle.estimate.measurements.by_name`."""
        self.restart(by_name(self.settings.start, measured))
        self._intake.restart(measured, self.settings.begun)

    def take(self, measured: Mapping[str, float]) -> np.ndarray:
        """`update` with channels by name, as a loop has them; the state then, shape (n_states,).

        An output that is missing, not finite, or exactly what it was before (an instrument that holds its sample) is
        not measured now, as is one that `begin` began a state at; an input that is missing or not finite stays.
        """
        self.update(*self._intake(measured))
        return self.state

    def hold(self, inputs: Mapping[str, float]) -> None:
        """Inputs by name that act from the last sample on, where they were decided after it was taken in."""
        for name, value in inputs.items():
            if name in self._intake.inputs and np.isfinite(value):
                j = self._intake.inputs.index(name)
                self._before[j] = self._intake.u[j] = value

    def update(self, y: float | np.ndarray, u: float | np.ndarray) -> np.ndarray:
        """Take in what was measured at one sample.

        Raises ParameterError if there are not as many numbers as channels, NotFiniteError if an input is not finite,
        and SimulationError if the estimate left the finite numbers. After the last two the filter is as before.

        Parameters
        ----------
        y : float or array, shape (n_outputs,)
            In the order of the model's outputs; NaN for what was not measured at this sample. One that is late
            (`EKF.late`) arrives now and belongs to a sample before.
        u : float or array, shape (n_inputs,)
            Inputs at the same sample, in the order of the model's inputs.

        Returns
        -------
        array, shape (n_outputs,)
            Measured minus predicted output, before this sample was taken in; 0 where not measured. The same array at
            every call: copy what is to be kept.
        """
        self._put(y, self._y, "outputs")
        self._put(u, self._u, "inputs")
        if not np.isfinite(self._u, out=self._finite_u).all():
            raise NotFiniteError(
                f"the sample holds u = {self._u.tolist()}; expected finite numbers: leave the sample out and call "
                "restart() with the state expected next"
            )
        np.isfinite(self._y, out=self._finite_y)
        self._seen[:] = self._finite_y
        for i, a in self._headings:  # instruments say them from -180 to 180 degrees or 0 to 360
            if self._finite_y[i] and self._dt[0] > 0:
                self._y[i] += TURN * math.floor((self._z[a] - self._y[i]) / TURN + 0.5)
        if not self._finite_y.all():
            self._y[~self._finite_y] = 0.0
        self._estimate()
        self._z[:] = self._z_new
        self._P[:] = self._P_new
        self._before[:] = self._u
        self._dt[0] = self.settings.start.dt
        self.n_samples += 1
        if self.settings.gate is not None:
            self._gates.judge(self._finite_y, self._error, self._variance, self._taken)
        return self._error

    def _estimate(self) -> None:
        """State and covariance with the newest sample."""
        if self._late.deepest:
            self._again()
        else:
            self._run()
            self._require_finite()

    def _require_finite(self, whether: bool | None = None) -> None:
        if not (self._stays_finite() if whether is None else whether):
            raise SimulationError(
                f"the filter leaves the finite numbers at its sample {self.n_samples}; expected a model that follows "
                "the data: check units and signs, or give smaller prior_std"
            )

    def _stays_finite(self) -> bool:
        finite = np.isfinite(self._z_new, out=self._finite_z), np.isfinite(self._P_new, out=self._finite_P)
        return bool(finite[0].all() and finite[1].all())

    def _again(self) -> None:
        """Take in late outputs where they belong, and what came since once more; error and variance are by output."""
        y, steps = np.where(self._finite_y, self._y, np.nan), np.array(self._late.steps)
        self._seen[steps > 0] = 0.0
        self._rows.append(Row(*(array.copy() for array in self._now)))
        rows, told = self._rows, np.zeros((3, len(y)))
        back = self._late.place(rows, y)
        gate, first = self._gate.copy(), len(rows) - 1 - back
        for k in range(first, len(rows)):
            fresh = (steps == len(rows) - 1 - k) & self._finite_y
            rows[k].gate[fresh] = gate[fresh]
            self._run_row(k)
            told[:, fresh] = np.array([self._error, self._variance, self._taken])[:, fresh]
        self._gate[:] = gate
        finite = self._stays_finite()
        if not finite:
            self._undo(y, first)
        self._require_finite(finite)
        self._error[:], self._taken[:] = told[0], told[2]
        np.copyto(self._variance, told[1], where=self._finite_y)

    @property
    def _now(self) -> tuple[np.ndarray, ...]:
        """What a `Row` keeps."""
        return self._z, self._P, self._before, self._u, self._y, self._seen, self._gate, self._dt

    def _run_row(self, k: int) -> None:
        """Take in a sample that was kept, and begin the one after it with what comes out."""
        for into, value in zip(self._now, self._rows[k], strict=True):
            into[:] = value
        self._run()
        if k + 1 < len(self._rows):
            self._rows[k + 1].z[:], self._rows[k + 1].P[:] = self._z_new, self._P_new

    def _undo(self, y: np.ndarray, first: int) -> None:
        """Forget the newest sample, and what of it belonged to samples before, from the ``first`` on."""
        gate, newest = self._gate.copy(), self._rows[-1]
        for i, steps in enumerate(self._late.steps):
            if steps and np.isfinite(y[i]) and steps < len(self._rows):
                self._rows[-1 - steps].seen[i] = 0.0
        for k in range(first, len(self._rows) - 1):
            self._run_row(k)
        self._z[:], self._P[:], self._before[:], self._dt[:] = newest.z, newest.P, newest.before, newest.dt
        self._gate[:] = gate
        self._rows.pop()

    def _put(self, value: float | np.ndarray, into: np.ndarray, what: str) -> None:
        if np.size(value) != len(into):
            names = self.settings.start.outputs if what == "outputs" else self.settings.start.inputs
            raise ParameterError(f"a sample has {np.size(value)} {what}; expected {len(into)}: {', '.join(names)}")
        into[:] = value

    def run(self, data: Dataset, *, measured: Mapping[str, np.ndarray] | None = None) -> FilterRun:
        """Take in all samples of a record, one experiment after the other, each from its own initial state.

        Raises SampleTimeError or MissingColumnError if the data have another sample time or lack a channel,
        ParameterError if ``measured`` does not fit, and SimulationError if the filter diverged.

        Parameters
        ----------
        data : Dataset
            Inputs and outputs.
        measured : mapping of str to array, shape (n_samples,), optional
            Outputs that are taken from here and not from the data; NaN where not measured.
        """
        model = self.settings.start
        data.require_dt(model.dt)
        rows = self._rows_of(data, measured or {})
        n, nx, nq, ny, begun = data.n_samples, self._nx, self._nq, model.n_outputs, self.settings.begun
        states, parameters, errors = np.empty((2, n, nx)), np.empty((2, n, nq)), np.empty((2, n, ny))
        taken, biases = np.zeros((n, ny), dtype=bool), np.empty((2, n, self._n - nx - nq))
        for part, start in zip(data.experiments, data.starts, strict=True):
            u = part.columns(model.inputs)
            self.restart(x0 := model.initial_state(part.head(model.memory)))
            used = [
                i for i, name in enumerate(model.outputs) if rows[start, i] == x0[begun.get(name, 0)] and name in begun
            ]
            rows[start, used] = np.nan  # the state began there
            for k in range(part.n_samples):
                errors[0, start + k] = self.update(rows[start + k], u[k])
                errors[1, start + k] = np.sqrt(self._variance)
                states[0, start + k], states[1, start + k] = self.state, self.state_std
                parameters[0, start + k], parameters[1, start + k] = self.parameters, self.parameters_std
                biases[0, start + k], biases[1, start + k] = self.biases, self.biases_std
                taken[start + k] = self._taken > 0
            taken[start, used] = True
        (x, x_std), (p, p_std), (e, e_std) = states, parameters, errors
        free, outputs, biased = self.settings.free, model.outputs, tuple(self.settings.bias_std)
        run = FilterRun(data.t, model.states, x, x_std, free, p, p_std, outputs, e, e_std)
        return replace(run, taken=taken, biased=biased, biases=biases[0], biases_std=biases[1])

    def _rows_of(self, data: Dataset, measured: Mapping[str, np.ndarray]) -> np.ndarray:
        """Outputs at every sample, shape (n_samples, n_outputs); see `run` for what is raised."""
        model, n = self.settings.start, data.n_samples
        require_names(measured, model.outputs, "measured", "use an output of the model")
        columns = []
        for name in model.outputs:
            column = np.asarray(measured[name] if name in measured else data[name], dtype=float)
            if column.shape != (n,):
                raise ParameterError(
                    f"measured['{name}'] has the shape {column.shape}, the data {n} samples; expected one number for "
                    "each: NaN where there is none"
                )
            columns.append(column)
        for name in model.inputs:
            data.index(name)
        return np.column_stack(columns) if columns else np.empty((n, 0))

    # ---- what is known now -------------------------------------------------------------------------------------

    @property
    def state(self) -> np.ndarray:
        """Estimated states, shape (n_states,), in the order of the model's, SI units."""
        return self._z[: self._nx].copy()

    @property
    def state_std(self) -> np.ndarray:
        """Their standard deviations, shape (n_states,)."""
        return np.sqrt(np.diag(self._P)[: self._nx])

    @property
    def inputs(self) -> np.ndarray:
        """Inputs that act from the last sample on, shape (n_inputs,)."""
        return self._before.copy()

    @property
    def state_covariance(self) -> np.ndarray:
        """Their covariance, shape (n_states, n_states)."""
        return self._P[: self._nx, : self._nx].copy()

    @property
    def innovation(self) -> tuple[np.ndarray, np.ndarray]:
        """Measured minus predicted outputs of the last sample, and their standard deviations, shape (n_outputs,) each.

        NaN where an output was not measured.
        """
        seen = self._finite_y
        return np.where(seen, self._error, np.nan), np.where(seen, np.sqrt(self._variance), np.nan)

    @property
    def surprise(self) -> float:
        """Mean of the squared innovations over their variances, of what the last sample took in. [-]

        One where the model is right; NaN where nothing was taken in.
        """
        squares, count = 0.0, 0
        for error, variance, taken in zip(self._error.tolist(), self._variance.tolist(), self.taken, strict=True):
            if taken:
                squares, count = squares + error * error / variance, count + 1
        return squares / count if count else math.nan

    @property
    def taken(self) -> np.ndarray:
        """Which outputs of the last sample were measured and are no outliers, shape (n_outputs,), bool."""
        return self._finite_y & (self._taken > 0)

    @property
    def n_outliers(self) -> np.ndarray:
        """How many values of each output were outliers and not taken in so far, shape (n_outputs,), int."""
        return self._gates.counts.copy()

    @property
    def biases(self) -> np.ndarray:
        """Estimated offsets of the sensors, in the order and units of ``bias_std``."""
        return self._z[self._nx + self._nq :].copy()

    @property
    def biases_std(self) -> np.ndarray:
        """Their standard deviations, one for each bias."""
        return np.sqrt(np.diag(self._P)[self._nx + self._nq :])

    @property
    def parameters(self) -> np.ndarray:
        """Estimated parameters, SI units, in the order of ``free``."""
        return np.asarray(self._scales.values(self._z[self._nx : self._nx + self._nq]), dtype=float)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the parameters, to first order, shape (n_free, n_free)."""
        own = slice(self._nx, self._nx + self._nq)
        slope = self._scales.slopes(self._z[own])
        return self._P[own, own] * np.outer(slope, slope)

    @property
    def parameters_std(self) -> np.ndarray:
        """Standard deviations of the parameters, shape (n_free,)."""
        return np.sqrt(np.diag(self.covariance))

    def model(self, **more: Any) -> Any:
        """The vehicle with the present estimates, their covariance in its ``fit_info``, which takes ``more`` fields."""
        s = self.settings
        values = self.parameters
        info = FitInfo(
            names=s.free,
            values=values,
            covariance=self.covariance,
            noise_std=np.array([s.noise(name) for name in s.start.outputs]),
            n_samples=self.n_samples,
            units=tuple(parametrised(s.start).si(name).unit for name in s.free),
            method=self.way,
            **more,
        )
        model = varied(s.start, dict(zip(s.free, map(float, values), strict=True)))
        return fitted(model, info)
