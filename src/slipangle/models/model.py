"""`Model`: what every identified model is, and `Trajectory`: what it predicts."""

# Long: the contract that all models keep is read as a whole.
from __future__ import annotations

import abc
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from itertools import combinations
from operator import attrgetter
from pathlib import Path
from typing import Any, ClassVar, NoReturn, final

import casadi as ca
import numpy as np

from slipangle.data.channels import STANDARD, Quantity
from slipangle.data.dataset import Dataset, require_dataset
from slipangle.equal import Equal
from slipangle.errors import ModelWarning, ParameterError, SimulationError, TooShortError
from slipangle.models.fast import FastPaths
from slipangle.models.plausible import astray
from slipangle.models.provenance import Fingerprint
from slipangle.models.region import Left, Region
from slipangle.numerics.critical import even, quantile
from slipangle.ops import Vector
from slipangle.shown import Brief, Shown


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One of several training runs, for a table that hides none of them."""

    seed: int  # of the start weights and of the order of the batches
    # smallest free-run error on the part of the training data held out for it: RMSE over the standard deviation of
    # the output [-]
    score: float
    epoch: int  # of the smallest error, whose weights are kept
    epochs: int  # trained
    seconds: float  # time of this run [s]
    curve: np.ndarray = field(repr=False)  # (n_checks, 2), epoch and free-run error at every check
    note: str = ""  # what went wrong, if anything


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """One of several orders that were compared, for a table that hides none of them."""

    orders: str  # in words
    n_parameters: int  # of all outputs
    # free-run error on stretches held out: RMSE over the standard deviation, mean over the outputs [-]
    error: float
    one_step_error: float  # the same one step ahead [-]
    aic: float  # Akaike's criterion, of outputs divided by their standard deviations; N ln det + 2 d
    bic: float  # Schwarz's, N ln det + d ln N
    fpe: float  # Akaike's final prediction error, det (1 + d / N) / (1 - d / N)
    stable: bool  # whether a free run over the longest experiment would stay


@dataclass(frozen=True, kw_only=True)
class FitInfo(Shown, Equal):
    """How a model was fitted: estimates, their covariance and what to be careful about.

    Parameters
    ----------
    names, units : tuple of str
        The parameters that were free, and the unit of each.
    values, covariance : array, shapes (n_free,), (n_free, n_free)
        Their estimates, SI units, and the covariance of those: with infinite entries where the data leave them open.
    noise_std : array, shape (n_outputs,)
        Standard deviation of the residuals on the training data.
    n_samples : int
        Residuals per output.
    seconds : float
        Time that the fit took. [s]
    method : str
        One line for the report: criterion, solver, covariance.
    warnings : tuple of str
        Sentences, such as the names of parameters that the data do not determine.
    corrections : tuple of str
        What was corrected on the way to the model and what that changed, in sentences.
    train_name, train_span : str, tuple of float
        Name of the training data, and its first and last time. [s]
    trials : tuple of Trial
        Every training run, for models that are trained from random starts.
    candidates : tuple of Candidate
        Every order that was compared, the chosen one first, where the estimator chose.
    fingerprint : Fingerprint or None
        By which samples of the training data are known again.
    loose : array, shape (n_free, n_loose), or None
        Directions in which estimates move together without moving any output, such as those of two that only act as a
        product; None for none.
    region : Region or None
        Where the training data lay, of models that learned from nothing else what they say there.
    known_covariance : array, shape (n_free, n_free), or None
        What is finite of the covariance where some are loose, see `std_of`.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    noise_std: np.ndarray
    n_samples: int
    units: tuple[str, ...] = ()
    seconds: float = 0.0
    method: str = ""
    warnings: tuple[str, ...] = ()
    train_name: str = ""
    train_span: tuple[float, float] = (0.0, 0.0)
    trials: tuple[Trial, ...] = ()
    candidates: tuple[Candidate, ...] = field(default=(), metadata={"may be missing in a file": True})
    fingerprint: Fingerprint | None = field(default=None, metadata={"may be missing in a file": True})
    corrections: tuple[str, ...] = field(default=(), metadata={"may be missing in a file": True})
    loose: np.ndarray | None = field(default=None, metadata={"may be missing in a file": True})
    region: Region | None = field(default=None, metadata={"may be missing in a file": True})
    known_covariance: np.ndarray | None = field(default=None, metadata={"may be missing in a file": True})

    def _words(self) -> str:
        rows = [
            f"{n} = {v:.4g} ± {(b - a) / 2:.2g}" if even(v, a, b) else f"{n} = {v:.4g} ({a:.4g} to {b:.4g})"
            for n, v, (a, b) in zip(self.names, self.values, self.interval(), strict=True)
        ]
        more = f" and {len(rows) - 6} more" if len(rows) > 6 else ""
        return f"{', '.join(rows[:6])}{more}; {len(self.warnings)} warnings"

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of each estimate, shape (n_free,), in its unit; infinite where the data leave it open."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def std_of(self, slope: Sequence[float] | np.ndarray) -> float:
        """Standard deviation of a quantity that is made of the estimates, to first order, in its unit.

        It is finite for what the data determine, even of estimates that are infinitely uncertain one by one: where
        k1 and k2 act as a product alone, that of ``[k2, k1]``.

        Parameters
        ----------
        slope : array, shape (n_free,)
            Derivatives of the quantity by the estimates, in its unit over theirs.

        Raises
        ------
        ParameterError
            If the derivatives are not as many as the estimates.
        """
        by = np.asarray(slope, dtype=float)
        if by.shape != (len(self.names),):
            raise ParameterError(f"the derivatives have the shape {by.shape}; expected one each of {self.names}")
        known = self.covariance
        if self.loose is not None and self.known_covariance is not None:
            reach, known = np.abs(by[:, None] * self.loose), self.known_covariance
            if np.any(np.abs(by @ self.loose) > 1e-6 * reach.max(axis=0)):  # else it is the rounding of zero
                return math.inf
        used = by != 0
        return float(np.sqrt(max(by[used] @ known[np.ix_(used, used)] @ by[used], 0.0)))

    def interval(self, level: float = 0.95) -> np.ndarray:
        """Confidence interval of each estimate, shape (n_free, 2), from the normal distribution.

        Raises ParameterError unless the level is between 0 and 1.
        """
        half = quantile(level) * self.std
        return np.column_stack([self.values - half, self.values + half])

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix of the estimates, shape (n_free, n_free)."""
        std = np.where(self.std > 0, self.std, 1.0)
        with np.errstate(invalid="ignore"):
            rho = self.covariance / np.outer(std, std)
        if self.loose is None:
            return rho
        far = self.loose @ self.loose.T
        lengths = np.sqrt(np.where(np.diag(far) > 0, np.diag(far), 1.0))
        return np.where(np.isinf(self.covariance), far / np.outer(lengths, lengths), rho)

    @property
    def condition(self) -> float:
        """How nearly the data confound some parameters with others: 1 if not at all, infinite if they do. [-]

        Condition number of the least-squares problem with columns of one length, so units do not matter; one over it is
        about the relative change of the outputs by the worst combination of parameters.
        """
        if not (np.isfinite(self.covariance).all() and (self.std > 0).all()):
            return float("inf")
        information = np.linalg.pinv(self.correlation, rcond=1e-15, hermitian=True)
        diagonal = np.diag(information)
        lengths = np.sqrt(np.maximum(diagonal, 1e-15 * diagonal.max()))  # of a singular matrix it may be rounding
        size = np.linalg.eigvalsh(information / np.outer(lengths, lengths))
        return float(np.sqrt(size[-1] / size[0])) if size[0] > 0 else float("inf")

    def correlated(self, least: float = 0.9) -> tuple[tuple[str, str, float], ...]:
        """Pairs of parameters whose estimates correlate by at least ``least`` [-] in size, the strongest first."""
        rho = self.correlation
        pairs = ((self.names[i], self.names[j], float(rho[i, j])) for i, j in combinations(range(len(self.names)), 2))
        return tuple(sorted((p for p in pairs if abs(p[2]) >= least), key=lambda pair: -abs(pair[2])))

    @property
    def confounding(self) -> str:
        """Condition number and strongest correlation in words; empty for a single parameter."""
        pairs = self.correlated(0.0)
        if not pairs:
            return ""
        a, b, rho = pairs[0]
        return f"condition number {self.condition:.3g}; the strongest correlation is {rho:.2f}, of {a} and {b}"


@dataclass(frozen=True, kw_only=True)
class ProfileInfo(FitInfo):
    """`FitInfo` with intervals at one level from the profile likelihood, which keeps its level on bent valleys."""

    limits: np.ndarray  # (n_free, 2), interval of each estimate
    level: float = 0.95  # their confidence level

    def interval(self, level: float = 0.95) -> np.ndarray:
        """Confidence interval of each estimate; by the profile at its own level, else from the covariance."""
        return self.limits if level == self.level else super().interval(level)


@dataclass(frozen=True, kw_only=True)
class Trajectory(Shown):
    """Predicted outputs beside what was measured.

    Parameters
    ----------
    t : array, shape (n_samples,)
        Time. [s]
    y, measured : array, shape (n_samples, n_outputs)
        Predicted and measured outputs; where `predicted` is false, y is the measured ones the model started from.
    predicted : array of bool, shape (n_samples,)
        Samples that the model predicted and on which it is judged.
    outputs : tuple of str
        Output names.
    kind : str
        ``"free run"`` or ``"k-step-ahead"``.
    starts : tuple of int
        First row of each experiment.
    astray : dict of str to str
        A sentence for each output whose prediction leaves any plausible range of the data.
    beyond : Left or None
        Which of the predicted samples lie outside of the data that a learned model was trained on, see `Model.region`.
    units : tuple of str
        Units of the outputs, as the data have them.
    """

    t: np.ndarray
    y: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    outputs: tuple[str, ...]
    kind: str = "free run"
    starts: tuple[int, ...] = field(default=(0,))
    astray: dict[str, str] = field(default_factory=dict)
    units: tuple[str, ...] = ()
    beyond: Left | None = None

    def _words(self) -> str:
        return f"{self.kind} of {', '.join(self.outputs)}, {int(self.predicted.sum())} samples predicted"

    @property
    def error(self) -> np.ndarray:
        """Measured minus predicted, shape (n_samples, n_outputs)."""
        return self.measured - self.y

    def channel(self, name: str) -> np.ndarray:
        """Predicted samples of one output."""
        return self.y[:, self.outputs.index(name)]

    def unit(self, name: str) -> str:
        """Unit of one output; of a run that names none that of the nomenclature, "-" for other names."""
        if self.units:
            return self.units[self.outputs.index(name)]
        return STANDARD[name].unit if name in STANDARD else "-"


def without_caches(thing: Any) -> dict[str, Any]:
    """Attributes of an object without the values of its cached properties, such as compiled functions."""
    kind = type(thing)
    return {k: v for k, v in vars(thing).items() if not isinstance(getattr(kind, k, None), cached_property)}


def derived(get: Callable[[Any], Any]) -> Any:
    """A property in place of an attribute that the base class declares: a wrapper's ``dt`` is that of what it wraps.

    What it is for others stands in the base class, so type checkers take the declaration there.
    """
    return property(get)


def taken(path: str) -> Any:
    """`derived` for an attribute of an attribute, such as ``"model.dt"``."""
    return derived(attrgetter(path))


class Model(FastPaths, Brief, Equal, abc.ABC):
    """A discrete-time state space: everything that can be identified, validated and controlled with.

    Subclasses are frozen and supply `initial_state`, `step` and `output`; the last two must work on
    numbers and on CasADi symbols (write them with `slipangle.ops`). The state ``x`` at a sample belongs
    to that sample: ``y[k] = output(x[k], u[k])`` and ``x[k+1] = step(x[k], u[k])``. A model that can take in
    measurements overrides `correct`; one that does something faster than by its step, what `FastPaths` asks.

    Attributes
    ----------
    dt : float
        Sample time. [s]
    inputs, outputs, states : tuple of str
        Names; their counts are the lengths of u, y and x.
    memory : int
        How many leading samples `initial_state` reads. A free run starts after them and never sees a
        measured output again.
    fit_info : FitInfo or None
        How the model was fitted, where it was.
    n_states, n_inputs, n_outputs : int
        Lengths of x, u and y.
    off_ground : Model
        The model without the position and heading that `OnGround` adds.
    alternatives : tuple of Model
        The models that this one is the mean of.
    region : Region or None
        Where the data lay that it learned from; None of physics and of straight lines, which go on beyond their data.
    affine : bool
        Whether step and output are straight lines in state and input.
    continuous : tuple or None
        F, shape (n, n), G and H, shape (n,), and the delay [s] of ``x' = F x + G u(t - delay)``, ``y = H x`` where
        that is what the samples are of, offsets apart.
    quantities : mapping of str to Quantity
        What its names mean that are no channels, or mean something else than a channel of that name.
    """

    dt: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    states: tuple[str, ...]
    memory: int = 1
    fit_info: FitInfo | None = None
    off_ground: Model = derived(lambda self: self)
    alternatives: tuple[Model, ...] = derived(lambda self: (self,))
    region: Region | None = derived(lambda self: None if self.fit_info is None else self.fit_info.region)
    n_states: int = derived(lambda self: len(self.states))
    n_inputs: int = derived(lambda self: len(self.inputs))
    n_outputs: int = derived(lambda self: len(self.outputs))
    told_by_poles: ClassVar[bool] = False  # better than by its coefficients, one by one
    affine: ClassVar[bool] = False
    continuous: tuple[np.ndarray, np.ndarray, np.ndarray, float] | None = derived(lambda self: None)
    quantities: Mapping[str, Quantity] = derived(lambda self: {})

    def __getstate__(self) -> dict[str, Any]:
        """What a copy needs, in this process or another: all but what was computed on the way."""
        return without_caches(self)

    @abc.abstractmethod
    def initial_state(self, data: Dataset) -> np.ndarray:
        """State at sample ``memory - 1``, from the first ``memory`` samples (``data`` holds no others)."""

    @abc.abstractmethod
    def step(self, x: Vector, u: Vector) -> Vector:
        """State one sample later, shape (n_states,), SI units."""

    @abc.abstractmethod
    def output(self, x: Vector, u: Vector) -> Vector:
        """Outputs at the same sample, shape (n_outputs,), SI units."""

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """State after measuring ``y`` at the same sample, shape (n_states,); by default nothing is corrected."""
        return x

    def with_estimates(self, values: np.ndarray) -> Model | None:
        """A copy with other values, shape (n_free,), of ``fit_info.names``, SI; None where they are no coefficients."""
        return None

    def straight(self, v_x: float, *, X: float = 0.0, Y: float = 0.0, psi: float = 0.0) -> np.ndarray:
        """State of straight driving at a speed [m/s] and pose [m, m, rad]; by default all other states are zero."""
        known = {"v_x": v_x, "v_x_s": v_x, "X": X, "Y": Y, "psi": psi}
        return np.array([known.get(name, 0.0) for name in self.states])

    def export(self, folder: str | Path, **settings: Any) -> Path:
        """Write the model as C that runs without Python; see `slipangle.export.export`, also for its settings.

        Raises WriteError if the folder is not empty or cannot be written.
        """
        return import_module("slipangle.export").export(self, folder, **settings)  # a room above this one

    def spread(self, data: Dataset) -> np.ndarray:
        """Standard deviation of the free runs of `alternatives`, shape (n_samples, n_outputs); zero for one alone."""
        if len(self.alternatives) == 1:
            return np.zeros((data.n_samples, self.n_outputs))
        return np.std([model.simulate(data).y for model in self.alternatives], axis=0, ddof=1)

    # ---- the loops are final -----------------------------------------------------------------------------------

    @cached_property
    def functions(self) -> tuple[ca.Function, ca.Function, ca.Function]:
        """`step`, `output` and `correct` as CasADi functions ``(x, u)``, ``(x, u)``, ``(x, u, y)``."""

        def build(kind: Any) -> tuple[ca.Function, ca.Function, ca.Function]:
            x, u, y = kind.sym("x", self.n_states), kind.sym("u", self.n_inputs), kind.sym("y", self.n_outputs)

            def function(name: str, *given: Any) -> ca.Function:
                return ca.Function(name, [*given], [ca.densify(getattr(self, name)(*given))])

            return function("step", x, u), function("output", x, u), function("correct", x, u, y)

        try:  # scalar expressions evaluate faster; models built on other CasADi functions may need matrices
            return build(ca.SX)
        except (RuntimeError, NotImplementedError):
            return build(ca.MX)

    def check(self, data: Dataset) -> None:
        """Raise unless the data have this model's sample time, inputs and outputs and enough samples.

        That is a SampleTimeError, MissingColumnError or TooShortError, with what to do about it.
        """
        require_dataset(data, "the model got")
        data.require_dt(self.dt)
        for name in (*self.inputs, *self.outputs):
            data.index(name)
        for a, b in zip(data.starts, data.stops, strict=True):
            if b - a <= self.memory:
                raise TooShortError(
                    f"an experiment of '{data.name}' has {b - a} samples, the model starts from "
                    f"{self.memory}; expected more: leave that experiment out or record longer"
                )

    @final
    def simulate(self, data: Dataset, *, start: Sequence[np.ndarray] | None = None) -> Trajectory:
        """Free run: from the first `memory` samples on, only the inputs are used.

        Raises ParameterError if there is not one start state of n_states numbers per experiment, SimulationError if the
        state leaves the finite numbers; warns with ModelWarning if an output leaves any plausible range of the data.
        These name the sample at which it does.

        Parameters
        ----------
        data : Dataset
            Inputs, and the first `memory` samples of the outputs; one free run per experiment.
        start : sequence of array, shape (n_states,) each, optional
            State of each experiment at its sample ``memory - 1``; by default what `initial_state` says.
        """
        return _announced(self._simulate(data, start))

    def _simulate(self, data: Dataset, start: Sequence[np.ndarray] | None = None) -> Trajectory:
        """`simulate` for those who look at what it says by themselves."""
        self.check(data)
        if start is not None and len(start) != len(data.starts):
            raise ParameterError(f"{len(start)} start states for {len(data.starts)} experiments; expected one for each")
        u, measured, m = data.columns(self.inputs), data.columns(self.outputs), self.memory
        y, mask = np.empty((data.n_samples, self.n_outputs)), np.ones(data.n_samples, dtype=bool)
        chosen = data.select(inputs=self.inputs, outputs=self.outputs)
        for i, (a, b) in enumerate(zip(data.starts, data.stops, strict=True)):
            alone = {"values": data.values[a : a + m], "starts": (0,), "start_times": (data.start_times[i],)}
            given = self.initial_state(replace(chosen, **alone)) if start is None else start[i]
            x0 = np.asarray(given, dtype=float)
            if x0.shape != (self.n_states,):
                raise ParameterError(
                    f"the start state of experiment {i} has the shape {x0.shape}; expected ({self.n_states},), one "
                    f"number for each state: give {', '.join(self.states[:12])}"
                )
            y[a : a + m], mask[a : a + m] = measured[a : a + m], False
            free = y[a + m : b]
            run = self.free_run(x0, u[a + m - 1 : b], free)
            if run is not free:
                free[:] = run
            with np.errstate(over="ignore", invalid="ignore"):
                if np.isfinite(free.sum()):  # one pass; a sum may overflow where no entry does
                    continue
            bad = ~np.isfinite(free).all(axis=1)
            if bad.any():
                self._diverged(data, a, m + int(np.argmax(bad)), free[np.argmax(bad)], "free run")
        return self._trajectory(data, y, measured, mask, "free run")

    def _diverged(self, data: Dataset, first: int, k: int, y: np.ndarray, what: str) -> NoReturn:
        """Say at which sample of the experiment from row ``first`` on, in which output and why."""
        gone = ~np.isfinite(y)
        names = ", ".join(f"'{name}'" for name, bad in zip(self.outputs, gone, strict=True) if bad)
        size = 0.0 if self.poles is None or not len(self.poles) else float(np.abs(self.poles).max())
        why = (
            f"it has a pole of modulus {size:.6g}, so it grows by that factor per sample"
            if size > 1
            else "its nonlinear feedback grows without bound from this start and these inputs"
        )
        where = "" if len(data.starts) == 1 else f" of the experiment from t = {data.t[first]:g} s"
        raise SimulationError(
            f"the {what} of {names} leaves the finite numbers at sample {k}{where} (t = {data.t[first + k]:g} s) of "
            f"'{data.name}': {why}; expected a stable model: fit with a stability constraint, other lags or on more "
            "data"
        )

    @final
    def predict(self, data: Dataset, steps: int = 1) -> Trajectory:
        """Prediction ``steps`` samples ahead of the last measured output used; 1 is one-step-ahead.

        Raises ParameterError if ``steps`` is no whole number from 1 on, TooShortError if no experiment is that long;
        else it raises and warns as `simulate` does.
        """
        return _announced(self._predict(data, steps))

    def _predict(self, data: Dataset, steps: int = 1) -> Trajectory:
        """`predict` for those who look at what it says by themselves."""
        if not isinstance(steps, int | np.integer) or isinstance(steps, bool) or steps < 1:
            raise ParameterError(f"steps is {steps!r}; expected a whole number of at least 1: 1 is one sample ahead")
        self.check(data)
        data = data.select(inputs=self.inputs, outputs=self.outputs)
        kind = "one-step-ahead" if steps == 1 else f"{steps}-step-ahead"
        pieces, mask, m = [], [], self.memory
        first = m + steps - 1
        if first >= data.n_longest:
            raise TooShortError(
                f"the longest experiment of '{data.name}' has {data.n_longest} samples, {kind} prediction begins at "
                f"sample {first}; expected more: record longer or predict fewer steps"
            )
        for i, part in enumerate(data.experiments):
            x0, u = np.asarray(self.initial_state(part.head(m)), dtype=float), part.u
            states = self.track(x0, u[m - 1 :], part.y[m - 1 :])
            for k in range(steps - 1):
                states = self.advance(states[:-1], u[m + k : m + k + len(states) - 1])
            predicted = self.outputs_at(states, u[first:])
            bad = ~np.isfinite(predicted).all(axis=1)
            if bad.any():
                k = int(np.argmax(bad))
                self._diverged(data, data.starts[i], first + k, predicted[k], f"{kind} prediction")
            pieces.append(np.vstack([part.y[:first], predicted]))
            mask.append(np.arange(part.n_samples) >= first)
        return self._trajectory(data, np.vstack(pieces), data.y, np.concatenate(mask), kind)

    def _trajectory(
        self, data: Dataset, y: np.ndarray, measured: np.ndarray, mask: np.ndarray, kind: str
    ) -> Trajectory:
        known = self.fit_info.fingerprint if self.fit_info is not None else None
        seen = (known.low, known.high) if known is not None and known.outputs == self.outputs else None
        what = kind if kind == "free run" else f"{kind} prediction"
        same: dict[str, Any] = {"t": data.t, "outputs": self.outputs, "starts": data.starts}
        said = astray(y, measured, seen=seen, what=what, **same)
        same["units"] = tuple(data.unit(name) for name in self.outputs)
        beyond = None
        if self.region is not None:
            fed = np.hstack([data.columns(self.inputs), y if kind == "free run" else measured])
            there = dict(zip((*self.inputs, *self.outputs), fed.T, strict=True))
            beyond = self.region.left(there, t=data.t, what=what, unit=data.unit)
        return Trajectory(y=y, measured=measured, predicted=mask, kind=kind, astray=said, beyond=beyond, **same)


def _announced(run: Trajectory) -> Trajectory:
    """The run, after a word to whoever asked for it on what left any plausible range, or what the model learned."""
    for sentence in (*run.astray.values(), *([run.beyond.sentence] if run.beyond is not None else [])):
        warnings.warn(sentence, ModelWarning, stacklevel=3)
    return run
