"""`SideSlipSensor`: lateral velocity from steering, speed, yaw rate and acceleration, learned where it is known."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError, TooShortError
from slipangle.fields import Checked, Count, Positive
from slipangle.models.fast import bind
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.ops import atan2, fabs, maximum

CHANNELS = ("delta", "v_x", "r", "a_y")
SLOWEST = 1.25  # wheelbases a second, below which slip angles are mostly noise
SPACING, TURNING, GAINING = 0.05, 0.1, 0.2  # s: between lags; over which yaw rate, and speed, are differentiated
BEYOND = 0.1  # of the range learned in: how far beyond it the sensor still answers
PER_REGRESSOR = 10  # samples at least


@dataclass(frozen=True, kw_only=True)
class SideSlipSensor(Checked):
    """Settings of a virtual sensor of lateral velocity, for a car without a sensor of it. [1]_

    The rear axle moves sideways by what the yaw rate asks of it and by its slip angle, and that angle goes with the
    lateral force over load, ``u = (a_y - l_r r_dot) / g``: powers of it for the tires, products with the longitudinal
    acceleration for the load that moves and the force that drives, with the speed for what lift and roll change. With
    the same of the front axle, steering and yaw rate, and with u, steering and yaw rate some time ago, they are the
    regressors of a linear least-squares problem, whose solution `fit` finds from a log in which ``v_y`` was measured.

    Parameters
    ----------
    wheelbase, l_f : float
        Of the car; centre of gravity to front axle. [m]
    memory : float
        How long ago the oldest sample was that counts. [s]
    ridge : float
        Penalty per sample on the squares of coefficients, of regressors of size one; relative to the squares of errors.
    folds : int
        Stretches of the log, each predicted by a fit on the others: their errors are what the sensor says of its own.

    References
    ----------
    .. [1] M. Milanese, C. Novara, K. Hsu, K. Poolla, The filter design from data problem: direct virtual sensors,
       Automatica 45(10), 2009, 2350-2357.
    """

    wheelbase: Positive
    l_f: Positive
    memory: Positive = 0.3
    ridge: Positive = 1e-4
    folds: Count = 5

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.l_f < self.wheelbase:
            raise ParameterError(f"l_f is {self.l_f:g} m; expected less than the wheelbase of {self.wheelbase:g} m")
        if self.folds < 2:
            raise ParameterError(f"folds is {self.folds}; expected at least 2, so that each is predicted by others")

    def fit(self, data: Dataset) -> LearnedSideSlip:
        """The sensor that the channels delta, v_x, r, a_y and the measured v_y of a log teach.

        Raises MissingColumnError if one of these is missing, TooShortError if the log is too short for the regressors.
        """
        parts = [(p.columns(CHANNELS), p["v_y"]) for p in data.experiments]
        look = _Look(self, data.dt)
        rows = [look.regressors(table) for table, _ in parts]
        inside = [np.arange(len(X)) + look.first for X in rows]
        X = np.vstack(rows)
        fast = np.concatenate([t[i, 1] > look.slowest for (t, _), i in zip(parts, inside, strict=True)])
        slip = np.concatenate([np.arctan2(v[i], t[i, 1]) for (t, v), i in zip(parts, inside, strict=True)])
        known = fast & np.isfinite(X).all(axis=1) & np.isfinite(slip)
        least = PER_REGRESSOR * X.shape[1] * self.folds // (self.folds - 1)
        if known.sum() < least:
            raise TooShortError(
                f"'{data.name}' has {known.sum()} samples faster than {look.slowest:.2g} m/s with all channels; "
                f"expected at least {least}: record longer"
            )
        target = slip - look.turning(np.vstack([t[i] for (t, _), i in zip(parts, inside, strict=True)]))
        held_out, at = np.full(len(X), np.nan), np.flatnonzero(known)
        for part in np.array_split(at, self.folds):
            others = np.setdiff1d(at, part)
            held_out[part] = _told(X[part], *self._solved(X[others], target[others]))
        errors = (held_out - target)[known]
        seen, i = np.full(data.n_samples, np.nan), 0
        for a, (table, _), places in zip(data.starts, parts, inside, strict=True):
            angle = held_out[i : i + len(places)] + look.turning(table[places])
            seen[a + places] = np.tan(angle) * table[places, 1]
            i += len(places)
        span = np.column_stack([X[known][:, look.limited].min(axis=0), X[known][:, look.limited].max(axis=0)])
        span += BEYOND * np.ptp(span, axis=1)[:, None] * [-1.0, 1.0]
        coefficients, centre = self._solved(X[known], target[known])
        return LearnedSideSlip(
            settings=self,
            dt=data.dt,
            coefficients=coefficients,
            centre=centre,
            span=span,
            std=float(np.sqrt(np.mean(errors**2))),
            held_out=seen,
        )

    def _solved(self, X: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of regressors and of one, and the regressors' means: ridge regression in units of spread."""
        mean, spread = X.mean(axis=0), X.std(axis=0)
        spread[spread == 0.0] = 1.0
        A = (X - mean) / spread
        gram = A.T @ A + self.ridge * len(A) * np.eye(A.shape[1])
        return np.append(np.linalg.solve(gram, A.T @ (y - y.mean())) / spread, y.mean()), mean


class _Look:
    """How rows of `CHANNELS` become regressors."""

    limited = np.array([0, 4, 10, 11, 12])  # u, a_x, 1 / v_x, r, delta: what the sensor must have learned the like of

    def __init__(self, settings: SideSlipSensor, dt: float) -> None:
        self.l_f, self.l_r, self.dt = settings.l_f, settings.wheelbase - settings.l_f, dt
        self.slowest = SLOWEST * settings.wheelbase
        self.spacing, self.turn, self.gain = (max(round(s / dt), 1) for s in (SPACING, TURNING, GAINING))
        self.lags = max(round(settings.memory / (self.spacing * dt)), 1)
        self.first = max(self.lags * self.spacing + self.turn, self.gain)  # sample that is the first to be answered

    def turning(self, rows: np.ndarray) -> np.ndarray:
        """Slip angle of the centre of gravity where the rear axle has none, shape (n,). [rad]"""
        return self.turned(rows.T)

    def turned(self, row: Any) -> Any:
        """The same of the channels of a sample. [rad]"""
        return atan2(self.l_r * row[2], maximum(row[1], self.slowest))

    def regressors(self, table: np.ndarray) -> np.ndarray:
        """Of samples from `first` on, shape (n - first, n_regressors)."""
        n, first = len(table), self.first
        if n <= first:
            return np.empty((0, 18 + 4 * self.lags))
        return np.column_stack(self.at_last([table[k : n - first + k].T for k in range(first + 1)]))

    def at_last(self, table: Any) -> list[Any]:
        """Regressors of the last of ``first + 1`` samples; table[k] are channels of sample k, numbers or symbols."""
        v_x, sooner = table[self.first][1], table[self.first - self.gain][1]
        a_x = (v_x - sooner) / (self.gain * self.dt * GRAVITY)
        past = [self._forces(table, k * self.spacing) for k in range(1, self.lags + 1)]
        return _columns(self._forces(table, 0), a_x, self._pace(v_x), [(a, r, d) for a, _, r, d in past])

    def _forces(self, table: Any, steps: int) -> tuple[Any, ...]:
        """Rear and front lateral force over load, yaw rate and steering so many samples ago."""
        (delta, _, r, a_y), sooner = table[self.first - steps], table[self.first - steps - self.turn][2]
        r_dot = (r - sooner) / (self.turn * self.dt)
        return (a_y - self.l_r * r_dot) / GRAVITY, (a_y + self.l_f * r_dot) / GRAVITY, r, delta

    def _pace(self, v_x: Any) -> Any:
        return maximum(v_x, self.slowest) / 30.0

    def must_be_known(self, table: Any) -> tuple[list[Any], list[int]]:
        """What of ``first + 1`` samples must be like what was learned, and which of `limited` each is.

        An implausible sample is looked for in all of them: as long as one is there, it may enter the regressors.
        """
        regressors = self.at_last(table)
        values, which = [regressors[i] for i in self.limited], list(range(len(self.limited)))
        for steps in range(1, self.first + 1):
            delta, v_x, r, _ = table[self.first - steps]
            values += [1.0 / self._pace(v_x), r, delta]
            which += [2, 3, 4]
            if steps <= self.lags * self.spacing:
                values.append(self._forces(table, steps)[0])
                which.append(0)
        return values, which


def _columns(now: Sequence[Any], a_x: Any, w: Any, before: Sequence[Sequence[Any]]) -> list[Any]:
    """Regressors of rear and front force over load, yaw rate, steering, acceleration, speed; and of samples before."""
    u, f, r, delta = now
    columns = [u, u**2, u**3, u**5, a_x, u * a_x, u**3 * a_x, u * a_x**2, u * w, u * w**2, 1.0 / w]
    columns += [r, delta, r / w, f, f**3, u * fabs(u), f * w]
    for rear, yaw_rate, steering in before:
        columns += [rear, rear**3, yaw_rate, steering]
    return columns


def _told(X: np.ndarray, coefficients: np.ndarray, centre: np.ndarray) -> np.ndarray:
    return (X - centre) @ coefficients[:-1] + coefficients[-1]


@dataclass(frozen=True, kw_only=True, eq=False)
class LearnedSideSlip:
    """A virtual sensor of lateral velocity; made by `SideSlipSensor.fit`.

    Parameters
    ----------
    settings : SideSlipSensor
        What it was made by.
    dt : float
        Sample time. [s]
    coefficients, centre : array, shapes (n_regressors + 1,), (n_regressors,)
        Of the regressors, the last of one; and what is taken off the regressors. [rad per regressor's unit]
    span : array, shape (n, 2)
        Where it has learned; outside it says nothing.
    std : float
        Standard deviation of its side slip angle, by stretches of the log that it was not fitted on. [rad]
    held_out : array, shape (n_samples,)
        What it says of the log that it was made from, each stretch by a fit on the others, so that a filter's settings
        can be chosen there; NaN where nothing. [m/s]
    """

    settings: SideSlipSensor
    dt: float
    coefficients: np.ndarray = field(repr=False)
    centre: np.ndarray = field(repr=False)
    span: np.ndarray = field(repr=False)
    std: float
    held_out: np.ndarray = field(repr=False)

    @cached_property
    def look(self) -> _Look:
        """How rows of channels become regressors."""
        return _Look(self.settings, self.dt)

    @cached_property
    def _said(self) -> tuple[ca.Function, list[int]]:
        look, channels = self.look, len(CHANNELS)
        samples = ca.SX.sym("samples", (look.first + 1) * channels)
        rows = [[samples[k * channels + i] for i in range(channels)] for k in range(look.first + 1)]
        off = ca.vertcat(*look.at_last(rows)) - ca.DM(self.centre)
        angle = ca.dot(ca.DM(self.coefficients[:-1]), off) + float(self.coefficients[-1]) + look.turned(rows[-1])
        values, which = look.must_be_known(rows)
        told = ca.vertcat(angle, ca.tan(angle) * rows[-1][1])
        return ca.Function("say", [samples], [told, ca.vertcat(*values)]), which

    @property
    def say(self) -> ca.Function:
        """``(samples, oldest first) -> (side slip angle and lateral velocity, what must be between limits)``."""
        return self._said[0]

    @property
    def limits(self) -> np.ndarray:
        """Between which the second result of `say` must be for the first to be said, shape (n, 2)."""
        return self.span[self._said[1]]

    def __call__(self, data: Dataset) -> np.ndarray:
        """Lateral velocity of each sample, shape (n_samples,). [m/s]

        NaN at the first samples of an experiment, where the car is slower than 1.25 wheelbases a second, and as long as
        a sample that it remembers lacks a channel, or has a force, speed, acceleration, yaw rate or steering outside
        those it has learned in.

        Raises SampleTimeError or MissingColumnError if the data have another sample time or lack a channel.
        """
        data.require_dt(self.dt, "the sensor")
        parts = [self._of(part.columns(CHANNELS)) for part in data.experiments]
        return np.concatenate(parts)

    def _of(self, table: np.ndarray) -> np.ndarray:
        look, v_y = self.look, np.full(len(table), np.nan)
        n = len(table) - look.first
        if n > 0:
            samples = np.ascontiguousarray(np.hstack([table[k : n + k] for k in range(look.first + 1)]))
            told, seen = np.empty((n, 2)), np.empty((n, len(self.limits)))
            bind(self.say if n == 1 else self.say.map(n), [samples], told, seen)()
            low, high = self.limits.T
            inside = ((seen >= low) & (seen <= high)).all(axis=1) & np.isfinite(told[:, 0])
            inside &= table[look.first :, 1] > look.slowest
            v_y[look.first :][inside] = told[inside, 1]
        return v_y

    def export(self, folder: str | Path, **settings: Any) -> Path:
        """Write the sensor as C that runs without Python; see `slipangle.export.export`, also for its ``settings``.

        Raises ParameterError if the name cannot be one, WriteError if the folder is not empty or cannot be written.
        """
        return import_module("slipangle.export").export(self, folder, **settings)

    def begin(self) -> SideSlipStream:
        """The sensor at work, one sample at a time."""
        return SideSlipStream(self)


class SideSlipStream:
    """A `LearnedSideSlip`, ``sensor``, at work: what it says is a measurement ``v_y`` for an `EKF` or `MHE`."""

    def __init__(self, sensor: LearnedSideSlip) -> None:
        self._sensor = sensor
        self._rows: deque[list[float]] = deque(maxlen=sensor.look.first + 1)

    def take(self, measured: Mapping[str, float]) -> float:
        """Lateral velocity now [m/s] from channels by name; NaN where the sensor says nothing, see its call."""
        self._rows.append([float(measured.get(name, np.nan)) for name in CHANNELS])
        return float(self._sensor._of(np.array(self._rows))[-1])
