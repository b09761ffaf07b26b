"""Hybrids: a model plus a network that predicts its error; a model behind the sensors of another session."""

import math
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Annotated, Any, Protocol, Self, runtime_checkable

import numpy as np
import scipy

from slipangle.data.dataset import Dataset
from slipangle.errors import MissingColumnError, ParameterError, nearest
from slipangle.fields import Checked, Within
from slipangle.models.black_box.narx import NARXModel
from slipangle.models.model import FitInfo, Model, derived, taken
from slipangle.models.region import Region
from slipangle.models.wrappers.wrapper import Wrapper
from slipangle.ops import Scalar, Vector, concatenate, stack


@runtime_checkable
class Corrected(Protocol):
    """A model whose prediction is corrected by a share that can be shown, and is off where the gain is 0."""

    @property
    def gain(self) -> float:
        """How much of the correction counts, 0 to 1."""
        ...

    def share(self, data: Dataset) -> np.ndarray:
        """See `HybridModel.share`."""
        ...


@dataclass(frozen=True, kw_only=True)
class HybridModel(Checked, Model):
    """``y(k) = y_m(k) + g F[y_e(k-1), ..., u(k-1), ...]``, where F feeds back its own prediction only.

    The base model runs free on the inputs; no measurement enters it after the start. Measuring the output moves the
    discrepancy alone: ``y_e = (y - y_m) / g``. Raises ParameterError if outputs or sample times differ, or the gain is
    outside 0 to 1.

    Parameters
    ----------
    base : Model
        The vehicle model ``y_m``.
    discrepancy : NARXModel
        F, with the base model's outputs, in their units; its inputs may be others than the base model's.
    gain : float
        Share ``g`` of the discrepancy that is added, 0 to 1; 0 switches it off. [-]

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eq. 8-2.
    """

    base: Model
    discrepancy: NARXModel
    gain: Annotated[float, Within(0, 1)] = 1.0
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    dt = taken("base.dt")
    outputs = taken("base.outputs")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.base.outputs != self.discrepancy.outputs:
            raise ParameterError(
                f"the discrepancy has the outputs {self.discrepancy.outputs}, the base model {self.base.outputs}; "
                "expected the same, in the same order"
            )
        if not np.isclose(self.base.dt, self.discrepancy.dt, rtol=1e-6):
            raise ParameterError(
                f"the discrepancy works at {self.discrepancy.dt:g} s, the base model at {self.base.dt:g} s; expected "
                "the same: fit both to the same data"
            )

    @derived
    def inputs(self) -> tuple[str, ...]:
        """The base model's, then those that only the discrepancy takes."""
        return (*self.base.inputs, *(n for n in self.discrepancy.inputs if n not in self.base.inputs))

    @derived
    def states(self) -> tuple[str, ...]:
        """The base model's states, then the discrepancy's; a base state that is an output is marked as uncorrected."""
        own = (f"base {n}" if n in self.outputs else n for n in self.base.states)
        return (*own, *(f"discrepancy {n}" for n in self.discrepancy.states))

    @derived
    def memory(self) -> int:
        """Samples a free run starts from; the base model's where the discrepancy is off."""
        return max(self.base.memory, self.discrepancy.memory) if self.gain > 0 else self.base.memory

    def _parts(self, x: Vector, u: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        """State and input of the base model, state and input of the discrepancy."""
        n = self.base.n_states
        places = [self.inputs.index(name) for name in self.discrepancy.inputs]
        return x[:n], u[: self.base.n_inputs], x[n:], stack([u[i] for i in places])

    def step(self, x: Vector, u: Vector) -> Vector:
        """Both a sample further, apart from each other; a discrepancy that is off rests."""
        base, drive, lags, drive_e = self._parts(x, u)
        if self.gain == 0:
            return concatenate([self.base.step(base, drive), 1.0 * lags])
        return concatenate([self.base.step(base, drive), self.discrepancy.step(lags, drive_e)])

    def output(self, x: Vector, u: Vector) -> Vector:
        """Base model plus discrepancy."""
        base, drive, lags, drive_e = self._parts(x, u)
        if self.gain == 0:
            return self.base.output(base, drive)
        return self.base.output(base, drive) + self.gain * self.discrepancy.output(lags, drive_e)

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """What the base model leaves is the measured discrepancy; with that off, the base model's own correction."""
        base, drive, lags, drive_e = self._parts(x, u)
        if self.gain == 0:
            return concatenate([self.base.correct(base, drive, y), 1.0 * lags])
        left = (y - self.base.output(base, drive)) / self.gain
        return concatenate([base, self.discrepancy.correct(lags, drive_e, left)])

    def initial_state(self, data: Dataset) -> np.ndarray:
        """The base model run to the last sample; lags of the discrepancy are what it left unexplained on the way."""
        x, base = run_up(self.base, data)
        if self.gain == 0:
            return np.concatenate([x, np.zeros(self.discrepancy.n_states)])
        error = (data.select(outputs=self.outputs).y - base) / self.gain
        left = data.select(inputs=self.discrepancy.inputs)
        for i, name in enumerate(self.outputs):
            left = left.with_channel(name, error[:, i]) if name not in left.inputs else left
        lags = self.discrepancy.initial_state(left.rows(left.n_samples - self.discrepancy.memory, left.n_samples))
        return np.concatenate([x, lags])

    def contribution(self, data: Dataset) -> np.ndarray:
        """What the discrepancy adds in a free run, shape (n_samples, n_outputs); zero at the samples it starts from.

        Figures 8.6 and 8.9 of the source show its share along the track.
        """
        run, base = self.simulate(data), self.base.simulate(data)
        return np.where(run.predicted[:, None], run.y - base.y, 0.0)

    def share(self, data: Dataset) -> np.ndarray:
        """Share of the discrepancy along a free run, shape (n_samples, n_outputs), 0 to 100. [%]

        ``|g F| / (|y_m| + |g F|)``: 50 where both are as large; NaN at the samples that the run starts from.
        """
        run, base = self.simulate(data), self.base.simulate(data)
        added = np.abs(run.y - base.y)
        total = np.abs(base.y) + added
        share = np.divide(100.0 * added, total, out=np.zeros_like(added), where=total > 0)
        return np.where(run.predicted[:, None], share, np.nan)


def run_up(model: Model, data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """State at the last sample of ``data``, and outputs of the run from its first `memory` samples.

    Outputs at the samples that the run starts from are the measured ones.
    """
    u, y = data.select(inputs=model.inputs).u, data.select(outputs=model.outputs).y.copy()
    x = np.asarray(model.initial_state(data.head(model.memory)), dtype=float)
    for k in range(model.memory, data.n_samples):
        x = np.asarray(model.step(x, u[k - 1]), dtype=float).ravel()
        y[k] = np.asarray(model.output(x, u[k]), dtype=float).ravel()
    return x, y


# ---- another session -----------------------------------------------------------------------------------------------


_NEW: Any = {"may be missing in a file": True}


def lag_weights(lag: float) -> tuple[float, float, float, float]:
    """Weights of a first-order lag, which is given over the sample time [-]: of an input, the two before, the result.

    ``w(k) = a u(k) + b u(k-1) + c u(k-2) + d w(k-1)`` is the lag's response at the samples to the parabola through
    three of them. So it neither adds nor takes gain at the frequencies of a driver, where the mean of the response to
    a held input, which is that to straight lines, takes a share of (omega dt)^2 / 12. A lead is the same without what
    is left of the past, so it is smooth at no lag, where the input comes back.

    >>> lag_weights(0.0)
    (1.0, 0.0, 0.0, 0.0)
    """
    left = math.exp(-1.0 / lag) if lag > 0 else 0.0
    line = 1.0 - lag * (1.0 - left)  # response at the end of a sample to a slope that begins with it
    bend = 0.5 * (1.0 - (1.0 + 2.0 * lag) * line)  # to half of tau (tau - 1)
    return line + bend, 1.0 - left - line - 2.0 * bend, bend, left


@dataclass(frozen=True, kw_only=True)
class OffsetModel(Wrapper):
    """A model behind the sensors of another session: it sees ``lag(gain (u - u_0))``; its outputs read ``y + y_0``.

    Raises MissingColumnError if the model has no such channel, and ParameterError if a correction is no finite number
    or a lead too long.

    Parameters
    ----------
    inputs_at_zero, outputs_at_zero : mapping of str to float
        What a sensor reads where the model means zero, by channel, SI units.
    gains : mapping of str to float
        Scale of inputs: what the model means over what the sensor reads beyond its zero. [-]
    lags : mapping of str to float
        Lag of inputs behind what the model was fitted with, of first order; negative ones, of at most a third of a
        sample, lead. Each has two states: what the past leaves of the lagged input, and the input before. [s]
    scatter : array, shape (n_corrections, n_corrections), optional
        Covariance of offsets, gains, lags and output offsets, in this order, by which `spread` grows.
    """

    model: Model
    inputs_at_zero: dict[str, float] = field(default_factory=dict)
    outputs_at_zero: dict[str, float] = field(default_factory=dict)
    gains: dict[str, float] = field(default_factory=dict, metadata=_NEW)
    lags: dict[str, float] = field(default_factory=dict, metadata=_NEW)
    scatter: np.ndarray | None = field(default=None, repr=False, compare=False, metadata=_NEW)
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    @derived
    def states(self) -> tuple[str, ...]:
        """The model's states, then for each input that lags what is left of its past, and the one before."""
        past = (f"{name} {part}" for name in self.lags for part in ("left", "before"))
        return (*self.model.states, *past)

    def __post_init__(self) -> None:
        inputs = {**self.inputs_at_zero, **self.gains, **self.lags}
        for given, known in ((inputs, self.model.inputs), (self.outputs_at_zero, self.model.outputs)):
            for name in given:
                if name not in known:
                    raise MissingColumnError(
                        f"the model has no channel '{name}' to correct; {nearest(name, known)}: use one of these names"
                    )
        for table in (self.inputs_at_zero, self.outputs_at_zero, self.gains, self.lags):
            for name, value in table.items():
                if not (isinstance(value, Real) and math.isfinite(value)):
                    raise ParameterError(f"the correction of '{name}' is {str(value)[:40]!r}; expected a finite number")
        for name, lag in self.lags.items():
            if not lag >= -0.34 * self.dt:
                raise ParameterError(
                    f"the lag of '{name}' is {lag:g} s; expected at least {-self.dt / 3:.3g} s, a third of a sample"
                )

    @derived
    def region(self) -> Region | None:
        """Where the model's training data would lie if these sensors had read them."""
        inside, zeros = self.model.region, {**self.inputs_at_zero, **self.outputs_at_zero}
        return inside.behind(self.gains, zeros) if inside and min(self.gains.values(), default=1.0) > 0 else None

    def _meant(self, u: Vector) -> list[Scalar]:
        """Inputs as the sensors' zeros and gains correct them, before any lag."""
        zeros, gains = self.inputs_at_zero, self.gains
        return [gains.get(name, 1.0) * (u[i] - zeros.get(name, 0.0)) for i, name in enumerate(self.inputs)]

    def _drive(self, x: Vector, u: Vector) -> Vector:
        """What the model means by the inputs over a sample, given the state with the past of lagging ones."""
        seen, n = self._meant(u), self.model.n_states
        for j, name in enumerate(self.lags):
            i = self.inputs.index(name)
            seen[i] = lag_weights(self.lags[name] / self.dt)[0] * seen[i] + x[n + 2 * j]
        return stack(seen)

    def _later(self, x: Vector, u: Vector) -> Vector:
        """The past of lagging inputs one sample later."""
        seen, drive, n = self._meant(u), self._drive(x, u), self.model.n_states
        later = []
        for j, name in enumerate(self.lags):
            i = self.inputs.index(name)
            _, one, two, left = lag_weights(self.lags[name] / self.dt)
            later += [left * drive[i] + one * seen[i] + two * x[n + 2 * j + 1], 1.0 * seen[i]]
        return stack(later)

    def _level(self, y: Vector, sign: float) -> Vector:
        return stack([y[i] + sign * self.outputs_at_zero.get(n, 0.0) for i, n in enumerate(self.outputs)])

    def step(self, x: Vector, u: Vector) -> Vector:
        """State one sample later."""
        nxt = self.model.step(x[: self.model.n_states], self._drive(x, u))
        if not self.lags:
            return nxt
        return concatenate([nxt, self._later(x, u)])

    def output(self, x: Vector, u: Vector) -> Vector:
        """What the sensors read."""
        return self._level(self.model.output(x[: self.model.n_states], self._drive(x, u)), 1.0)

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """The model's, with the sensors' readings."""
        n = self.model.n_states
        better = self.model.correct(x[:n], self._drive(x, u), self._level(y, -1.0))
        return concatenate([better, x[n:]]) if self.lags else better

    def initial_state(self, data: Dataset) -> np.ndarray:
        """The model's, from corrected channels, and the past of inputs that lag."""
        last, past, seen = self.memory - 1, [], self.behind(data)
        for name, lag in self.lags.items():
            meant = self._corrected(name, data)
            past += [seen[name][last] - lag_weights(lag / self.dt)[0] * meant[last], meant[max(last - 1, 0)]]
        return np.concatenate([np.asarray(self.model.initial_state(seen), dtype=float), past])

    def behind(self, data: Dataset) -> Dataset:
        """The data as the model means them: channels corrected, lags from rest at the start of each experiment."""
        seen = data
        for name in dict.fromkeys((*self.inputs_at_zero, *self.gains, *self.lags)):
            values = self._corrected(name, data)
            if self.lags.get(name, 0.0):
                *taps, left = lag_weights(self.lags[name] / self.dt)
                rest = np.array([1.0 - taps[0], taps[2]])
                parts = [values[a:b] for a, b in zip(data.starts, data.stops, strict=True)]
                runs = (scipy.signal.lfilter(taps, [1, -left], part, zi=rest * part[0])[0] for part in parts)
                values = np.concatenate(list(runs))
            seen = seen.with_channel(name, values, data.unit(name))
        for name, value in self.outputs_at_zero.items():
            seen = seen.with_channel(name, data[name] - value, data.unit(name))
        return seen

    def _corrected(self, name: str, data: Dataset) -> np.ndarray:
        """An input as its zero and gain correct it."""
        return self.gains.get(name, 1.0) * (data[name] - self.inputs_at_zero.get(name, 0.0))

    def spread(self, data: Dataset) -> np.ndarray:
        """Standard deviation of the free run, shape (n_samples, n_outputs): of the model's, and by the corrections."""
        variance = self.model.spread(self.behind(data)) ** 2
        if self.scatter is None:
            return np.sqrt(variance)
        here = self._read(data)
        size, directions = np.linalg.eigh(self.scatter)
        for move in (directions * np.sqrt(np.maximum(size, 0.0))).T:
            variance = variance + (self._moved(move)._read(data) - here) ** 2
        return np.sqrt(variance)

    def _read(self, data: Dataset) -> np.ndarray:
        """Outputs of the free run, by the model alone: what it is compiled to stays the same."""
        return self.model.simulate(self.behind(data)).y + [self.outputs_at_zero.get(n, 0.0) for n in self.outputs]

    def _moved(self, by: np.ndarray) -> Self:
        """With corrections changed by a vector in the order of `scatter`."""
        left, given = iter(map(float, by)), {}
        for name in ("inputs_at_zero", "gains", "lags", "outputs_at_zero"):
            given[name] = {key: value + next(left) for key, value in getattr(self, name).items()}
        least = -self.dt / 3
        given["lags"] = {key: max(value, least) for key, value in given["lags"].items()}
        return replace(self, **given, scatter=None)
