"""Models of one line, fitted to the same data as the model that is judged: what it has to be better than."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from slipangle.data.dataset import Dataset

_BENDS = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, -0.25, -0.5)  # K v_x^2 at the highest speed, smallest first
_LAGS = 24  # time constants that are tried, from half a sample to a tenth of the longest experiment
_FINE = 13  # time constants that are tried between the neighbours of the best of them, twice
_LEAST = 1e-6  # share of its error that a larger constant has to take off
_SPEED_POWER = {"r": 1, "v_y": 1, "a_y": 2, "beta": 0}  # outputs of a car in steady state: delta times v_x to the ...

Regressors = Callable[[Dataset], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Baseline:
    """A simple model of one output: its regressors, through a first-order lag where it has one, times coefficients."""

    name: str
    regressors: Regressors
    coefficients: np.ndarray  # (n_regressors,)
    lag: float = 0.0  # time constant [s]
    error: float = 0.0  # sum of squares over the training data

    def simulate(self, data: Dataset, measured: np.ndarray | None = None) -> np.ndarray:
        """The output from the inputs alone, shape (n_samples,), in its unit.

        Each experiment begins in steady state, or from the first sample of the ``measured`` output, where that is given
        and the model has a state.
        """
        y = lagged(self.regressors(data), data, self.lag) @ self.coefficients
        return y if measured is None else y + _fading(measured - y, data, self.lag)


def baselines(data: Dataset, output: str) -> tuple[Baseline, ...]:
    """Simple models of one output, fitted to ``data`` by least squares on their free run.

    The first is the mean. Then, of a car whose inputs have delta and v_x and whose output is r, v_y, a_y or beta:
    ``kinematic`` (r = v_x (g delta + d), the gain and offset free, and alike for the others), ``quasi-steady`` (with
    the understeer gradient: over 1 + K v_x^2, and for v_y and beta the shift with v_x^2 above it), and
    ``linear with lag``, the same through a first-order lag. Of any other output: ``static``, linear in the inputs, and
    ``linear with lag``.

    Source of the steady states: T. D. Gillespie, Fundamentals of Vehicle Dynamics, 1992, ch. 6.
    """
    y = data[output]
    found = [_fitted("mean", lambda d: np.ones((d.n_samples, 1)), data, y)]
    steady = [_fitted(name, regressors, data, y) for name, regressors in _steady(data, output)]
    kept = [_least([b for b in steady if b.name == name], y) for name in dict.fromkeys(b.name for b in steady)]
    longest = data.n_longest * data.dt
    times = np.geomspace(0.5 * data.dt, max(0.1 * longest, data.dt), _LAGS)
    table = kept[-1].regressors(data)

    def slow(lag: float) -> Baseline:
        return _fitted("linear with lag", kept[-1].regressors, data, y, lag, table)

    best, step = _least([slow(float(lag)) for lag in times], y), times[1] / times[0]
    for _ in range(2):
        fine = np.geomspace(best.lag / step, best.lag * step, _FINE)
        best, step = _least([best, *(slow(float(lag)) for lag in fine)], y), fine[1] / fine[0]
    return (*found, *kept, best)


def _steady(data: Dataset, output: str) -> Iterator[tuple[str, Regressors]]:
    """Names and regressors of what has no dynamics, the simplest first; of one name, the best is taken."""
    if output not in _SPEED_POWER or not {"delta", "v_x"} <= set(data.inputs):
        inputs = data.inputs
        yield "static", lambda d: np.column_stack([*(d[n] for n in inputs), np.ones(d.n_samples)])
        return
    power, sideways = _SPEED_POWER[output], output in ("v_y", "beta")
    fastest = float(np.abs(data["v_x"]).max())

    def car(d: Dataset, K: float, shift: bool) -> np.ndarray:
        v_x = d["v_x"]
        bent = np.maximum(1.0 + K * v_x**2, 0.1)  # beyond a critical speed that the training data do not reach
        columns = np.column_stack([d["delta"], np.ones(d.n_samples)]) * (v_x**power / bent)[:, None]
        return np.hstack([columns, columns * (v_x**2)[:, None]]) if shift else columns

    yield "kinematic", lambda d: car(d, 0.0, False)
    for bend in _BENDS:
        K = bend / max(fastest, 1e-9) ** 2
        yield "quasi-steady", lambda d, K=K: car(d, K, sideways)


def _fitted(
    name: str,
    regressors: Regressors,
    data: Dataset,
    y: np.ndarray,
    lag: float = 0.0,
    table: np.ndarray | None = None,
) -> Baseline:
    """By least squares; ``table`` is what the regressors give, where that is known."""
    moved = lagged(regressors(data) if table is None else table, data, lag)
    moved, y = moved - _fading(moved, data, lag), y - _fading(y, data, lag)
    size = np.sqrt(np.mean(moved**2, axis=0))
    size[size == 0] = 1.0
    scaled = moved / size
    coefficients = np.linalg.lstsq(scaled.T @ scaled, scaled.T @ y, rcond=1e-12)[0]
    error = float(np.sum((y - scaled @ coefficients) ** 2))
    return Baseline(name=name, regressors=regressors, coefficients=coefficients / size, lag=lag, error=error)


def _fading(x: np.ndarray, data: Dataset, lag: float) -> np.ndarray:
    """What a first-order lag keeps of the first sample of each experiment, of the shape of ``x``."""
    kept = np.zeros_like(x)
    for a, b in zip(data.starts, data.stops, strict=True) if lag > 0 else ():
        kept[a:b] = np.multiply.outer(np.exp(-data.dt / lag * np.arange(b - a)), x[a])
    return kept


def _least(candidates: list[Baseline], y: np.ndarray) -> Baseline:
    """The one with the least error on the training data, the first of those that differ by rounding."""
    enough = min(b.error for b in candidates) + _LEAST * float(np.sum((y - y.mean()) ** 2))
    return next(b for b in candidates if b.error <= enough)


def lagged(table: np.ndarray, data: Dataset, lag: float) -> np.ndarray:
    """Columns, shape (n_samples, n), through a first-order lag [s], each experiment from the steady state at its start.

    An input is held over its sample, so the lag shows from the next one on.
    """
    if lag <= 0:
        return table
    keep = np.exp(-data.dt / lag)
    parts = []
    for a, b in zip(data.starts, data.stops, strict=True):
        rows = np.ascontiguousarray(table[a:b].T)
        filtered, _ = scipy.signal.lfilter([0.0, 1 - keep], [1.0, -keep], rows, zi=rows[:, :1])
        parts.append(filtered.T)
    return np.concatenate(parts)
