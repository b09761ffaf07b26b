"""`Adapt`: a model and a session it was not fitted to; what the sensors of that session read differently."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Annotated, Any

import numpy as np
from scipy.special import stdtrit

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.errors import ModelWarning, ParameterError, SimulationError, TooShortError
from slipangle.fields import Checked, Count, Positive, Whole, Within
from slipangle.identify.averaging import SCALES, Average, averaged
from slipangle.identify.judge.intervals import effective_samples
from slipangle.identify.judge.misread import misread
from slipangle.models.model import FitInfo, Model
from slipangle.models.provenance import provenance
from slipangle.models.wrappers.hybrid import OffsetModel

_HALVINGS = 4  # of a step that does not lower the cost
_CLOSE = 1e-2  # over the prior's width, of a step that ends the search
_ASTRAY = 1e4  # over the scatter of an output, of errors that no sensor explains
_CHANGE = 0.02  # of a parameter of the car, by which the error's derivative is taken
_UNITS = {"gain": "-", "lag": "s"}


@dataclass(frozen=True, kw_only=True)
class Adapt(Checked):
    """Offset, gain and lag of inputs and biases of outputs, from the first seconds of a session, near the model's own.

    The mean over hypotheses of which of these kinds changed, each as much as it is likely given normal errors of the
    free run, as coloured as they are, and priors with heavy tails around what the model was fitted with: a short or
    poor session pulls little, a clear one as far as it shows. Before the data, that nothing changed is as likely as
    that something did. The model comes back unchanged if that nothing changed is still likelier after them, or if the
    corrections do not prove themselves: the seconds are cut into ``folds`` blocks of which each is predicted with the
    values that the others give, and the squared error has to fall by ``worth``, and beyond chance by a t-test of the
    blocks at ``level``; and what is read where an input is above its median, as in bends to the left, may not make the
    run worse where it is below, nor the other way round: a sensor reads alike in both, what a model lacks does not.

    Where a channel's sign is turned, or its unit another than in training, the model comes back unchanged too, and it
    is said which: no gain near 1 mends that.

    Given the training data too, that something changed has to be likelier also if the errors are as large, and last as
    long, as over those: half a minute at one speed may leave a steady error that is small for the model, and yet looks
    like an offset beside what little scatters around it.

    Intervals of the corrections bear that the car changed too, of models that know its parameters: they are as wide as
    its parameters, each ``car_prior`` open, leave the corrections, and reach to where these would be if they were
    estimated along. What a black box lacks of another car stands in no interval.

    Parameters
    ----------
    inputs, gains, lags : tuple of str
        Inputs whose reading at zero, scale and lag are estimated; the lag stands for a delay too.
    outputs : tuple of str, optional
        Outputs whose reading at zero is estimated; by default all.
    seconds : float
        How much of the session is used. [s]
    offset_prior, bias_prior : float
        Standard deviation of the prior over that of the input or output in these seconds; as likely is one thrice as
        wide, of gains and lags too. [-]
    gain_prior : float
        Standard deviation of the prior of a gain around 1. [-]
    lag_prior : float
        Standard deviation of the prior of a lag around 0. [s]
    car : tuple of str
        Parameters of the car that may have changed too, where the model has them; none says that it is the same.
    car_prior : float
        Standard deviation of their relative change. [-]
    folds : int
        Blocks of the test whether it helps; 0 trusts it.
    level : float
        Chance that the test passes where corrections neither help nor harm, blocks being independent. [-]
    worth : float
        Smallest relative reduction of the squared error over all blocks. [-]
    max_iterations : int
        Steps at most.
    """

    inputs: tuple[str, ...] = ("delta",)
    gains: tuple[str, ...] = ("delta",)
    lags: tuple[str, ...] = ("delta",)
    outputs: tuple[str, ...] | None = None
    seconds: Positive = 30.0
    offset_prior: Positive = 0.2
    bias_prior: Positive = 0.02
    gain_prior: Positive = 0.05
    lag_prior: Positive = 0.02
    car: tuple[str, ...] = ("mass", "inertia_z", "C_f", "C_r", "mu_f", "mu_r")
    car_prior: Positive = 0.1
    folds: Whole = 8
    level: Annotated[float, Within(0, 0.5, open="low", example="0.025")] = 0.025
    worth: Annotated[float, Within(0, 1, open="high", example="0.05")] = 0.05
    max_iterations: Count = 10

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.folds == 1:
            raise ParameterError("folds is 1; expected 0, or at least 2: one block leaves nothing to adapt to")

    def fit(self, model: Model, data: Dataset, train: Dataset | None = None) -> OffsetModel:
        """The model behind the sensors that explain the first ``seconds`` of the data best, or unchanged.

        ``train`` is what the model was fitted to: give it where there is, corrections then do harm less often. The
        model's ``fit_info`` has the corrections that were estimated, with their covariance; `OffsetModel.spread` what
        they and the doubt about them leave open, so intervals are wider than in the session of the training data.

        Raises TooShortError if the data are shorter, MissingColumnError if the model has no such channel or the
        training data lack one, SampleTimeError if their sample time is not the model's, and SimulationError if the
        model's free run over the session goes astray.

        Warns with ModelWarning if the corrections do not help: then all of them are zero.
        """
        require_dataset(data, "fit() got")
        began = time.perf_counter()
        n = round(self.seconds / data.dt)
        if data.n_samples < n or n <= model.memory + max(1, self.folds):
            raise TooShortError(
                f"'{data.name}' lasts {data.duration:.3g} s, offsets are read from {self.seconds:g} s; expected more: "
                "record longer or lower seconds"
            )
        session = _Session(self, model, data.rows(0, n))
        optimum = session.fit()
        found = optimum.average()
        theta = np.maximum(found.mean, session.least)
        usual = None if train is None else _Session(self, model, train).usual_weights()
        notes = self._doubts(session, optimum, found, usual)
        for said in notes:
            warnings.warn(said, ModelWarning, stacklevel=2)
        info = FitInfo(
            names=session.names,
            values=theta,
            covariance=found.covariance + session.by_the_car(optimum, found.mean),
            noise_std=np.std(optimum.at(theta), axis=0),
            n_samples=session.n,
            units=session.units,
            seconds=time.perf_counter() - began,
            method=f"free-run error over {self.seconds:g} s of another session, Gauss-Newton, then the mean over which "
            "kinds of corrections there are; covariance for coloured residuals, given the priors, also of the car",
            warnings=notes,
            **provenance(session.data, model.outputs),
        )
        kept = np.zeros_like(theta) if notes else theta
        away = theta - kept
        scatter = found.covariance + np.outer(away, away)
        return replace(session.sensors(kept), scatter=scatter, fit_info=info)

    def _doubts(
        self, session: _Session, optimum: _Optimum, average: Average, usual: np.ndarray | None
    ) -> tuple[str, ...]:
        """Why the corrections are not believed, given what errors weigh in the training data; empty if they are."""
        other = misread(session.model, session.data, session.run)
        if other:
            return (f"the model is left as it is: {other}",)
        if not self.folds:
            return ()
        each = zip(session.names, average.mean, session.units, strict=True)
        found = ", ".join(f"{n} {v:.3g} {u}" for n, v, u in each)
        if average.nothing > 0.5:
            return (
                f"the model is left as it is: given '{session.data.name}' the probability that no sensor reads "
                f"differently is {average.nothing:.2g} (else {found}, by the mean of all cases); expected at most 0.5",
            )
        blocks = np.array_split(np.arange(session.n), self.folds)
        if usual is not None:
            nothing = replace(optimum, weight=np.minimum(optimum.weight, usual)).average().nothing
            if nothing > 0.5:
                return (
                    "the model is left as it is: if its errors are as large and last as long as over what it was "
                    f"fitted to, the probability that no sensor of '{session.data.name}' reads differently is "
                    f"{nothing:.2g} (else {found}, by the mean of all cases); expected at most 0.5",
                )
        without, fall = self._predicted(session, optimum, blocks)
        alike = fall.sum() / without.sum() * without  # fall of blocks that fall by one share, however they are driven
        error = float(np.std(fall - alike, ddof=1)) * np.sqrt(self.folds)  # standard error of the sum over the blocks
        beyond = float(stdtrit(self.folds - 1, 1.0 - self.level))
        if fall.sum() < max(self.worth * without.sum(), beyond * error):
            return (
                f"the model is left as it is: on {self.folds} blocks of '{session.data.name}' that they were not read "
                f"from the corrections ({found}) changed the squared error by "
                f"{-100 * fall.sum() / without.sum():+.1f} % +- {100 * error / without.sum():.1f} %; expected a fall "
                f"by {100 * self.worth:g} % and by {beyond:.3g} times the scatter",
            )
        for name in dict.fromkeys((*self.inputs, *self.gains)):
            without, fall = self._predicted(session, optimum, session.halves(name))
            if np.any(fall < 0):
                rise = -100 * fall / np.maximum(without, np.finfo(float).tiny)
                here, there = ("below", "above") if rise[0] > rise[1] else ("above", "below")
                return (
                    f"the model is left as it is: corrections read where {name} of '{session.data.name}' is {there} "
                    f"its median changed the squared error by {max(rise):+.1f} % where it is {here}; "
                    f"expected none that is worse (all together {found}): give a session that turns both ways",
                )
        return ()

    @staticmethod
    def _predicted(session: _Session, optimum: _Optimum, parts: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Squared error of each part of the rows as it is, and what corrections read from all others take off."""
        before = optimum.at(np.zeros_like(optimum.theta))
        without = np.array([np.sum((before[rows] / session.size) ** 2) for rows in parts])
        return without, without - [np.sum((optimum.without(rows) / session.size) ** 2) for rows in parts]


@dataclass(frozen=True, kw_only=True)
class _Optimum:
    """Error and its derivatives at some corrections, and what they weigh."""

    theta: np.ndarray  # (n_corrections,)
    error: np.ndarray  # (n, n_outputs)
    jacobian: np.ndarray  # (n_corrections, n, n_outputs)
    weight: np.ndarray  # (n_outputs,), of a squared error
    width: np.ndarray  # (n_corrections,), of the prior
    kinds: tuple[str, ...]  # of each correction

    def at(self, theta: np.ndarray) -> np.ndarray:
        """Errors at other corrections, to first order."""
        return self.error + np.einsum("anm,a->nm", self.jacobian, theta - self.theta)

    def cost(self, theta: np.ndarray, error: np.ndarray) -> float:
        """Twice the negative logarithm of the posterior with the widest priors, but for a constant."""
        return float(np.sum(self.weight * error**2) + np.sum((theta / self._widest) ** 2))

    @property
    def _widest(self) -> np.ndarray:
        return max(SCALES) * self.width

    def move(self) -> np.ndarray:
        """Gauss-Newton step of the cost."""
        j, precision = self.jacobian, self._widest**-2.0
        hessian = np.einsum("anm,bnm,m->ab", j, j, self.weight) + np.diag(precision)
        gradient = np.einsum("anm,nm,m->a", j, self.error, self.weight) + precision * self.theta
        return -np.linalg.solve(hessian, gradient)

    def average(self, seen: np.ndarray | slice = slice(None)) -> Average:
        """Corrections by the rows ``seen``."""
        j, error = self.jacobian[:, seen], self.at(np.zeros_like(self.theta))[seen]
        information = np.einsum("anm,bnm,m->ab", j, j, self.weight)
        return averaged(information, -np.einsum("anm,nm,m->a", j, error, self.weight), self.width, self.kinds)

    def without(self, rows: np.ndarray) -> np.ndarray:
        """Errors at the rows with the corrections that all other rows give, if there are some."""
        seen = np.ones(len(self.error), dtype=bool)
        seen[rows] = False
        return self.at(self.average(seen).given_some)[rows]


class _Session:
    """The first seconds as a regularised least-squares problem in the corrections."""

    def __init__(self, settings: Adapt, model: Model, data: Dataset) -> None:
        s, self.settings, self.model = settings, settings, model
        biased = model.outputs if s.outputs is None else s.outputs
        self.kinds: tuple[tuple[str, Sequence[str]], ...] = (
            *(("offset", s.inputs), ("gain", s.gains), ("lag", s.lags), ("bias", biased)),
        )
        self.names = tuple(f"{kind}_{name}" for kind, channels in self.kinds for name in channels)
        self.sensors(np.zeros(len(self.names)))  # raises if the model lacks a channel
        self.data = data.select(inputs=model.inputs, outputs=model.outputs)
        self.units = tuple(_UNITS.get(kind) or data.unit(name) for kind, names in self.kinds for name in names)
        sd = {name: max(float(np.std(data[name])), 1e-9) for name in (*model.inputs, *model.outputs)}
        widths = {
            "offset": lambda name: s.offset_prior * sd[name],
            "gain": lambda name: s.gain_prior,
            "lag": lambda name: s.lag_prior,
            "bias": lambda name: s.bias_prior * sd[name],
        }
        self.width = np.array([widths[kind](name) for kind, channels in self.kinds for name in channels])
        self.size = np.array([sd[name] for name in model.outputs])
        self.least = np.array([-model.dt / 3 if n.startswith("lag_") else -np.inf for n in self.names])
        self.run = model.simulate(self.data)
        self.predicted = self.run.predicted
        self.n = int(self.predicted.sum())

    def halves(self, name: str) -> list[np.ndarray]:
        """Predicted rows where an input is in the lower half of its samples, and where in the upper."""
        return np.array_split(np.argsort(self.data[name][self.predicted], kind="stable"), 2)

    def sensors(self, theta: np.ndarray) -> OffsetModel:
        """The model behind these corrections; gains are relative to 1."""
        left, given = iter(map(float, theta)), {}
        for kind, channels in self.kinds:
            given[kind] = {name: next(left) + (kind == "gain") for name in channels}
        return OffsetModel(
            model=self.model,
            inputs_at_zero=given["offset"],
            gains=given["gain"],
            lags=given["lag"],
            outputs_at_zero=given["bias"],
        )

    def error(self, theta: np.ndarray, model: Model | None = None) -> np.ndarray:
        """Free-run error at the predicted samples, shape (n, n_outputs); infinite where the run breaks down.

        Of the model, or of another one behind the same sensors.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModelWarning)
            try:
                return (model or self.model).simulate(self.sensors(theta).behind(self.data)).error[self.predicted]
            except SimulationError:
                return np.full((self.n, self.model.n_outputs), np.inf)

    def usual_weights(self) -> np.ndarray:
        """Information of a sample by the errors of the model as it is, shape (n_outputs,)."""
        return self._weights(self.error(np.zeros(len(self.names))))

    def fit(self) -> _Optimum:
        """Most probable corrections given all rows, whatever kinds they are of."""
        theta = np.zeros(len(self.names))
        error = self.error(theta)
        self._check(error)
        for _ in range(self.settings.max_iterations):
            optimum = self.at(theta, error)
            move = optimum.move()
            before = optimum.cost(theta, error)
            for halving in range(_HALVINGS):
                trial = np.maximum(theta + 0.5**halving * move, self.least)
                then = self.error(trial)
                if optimum.cost(trial, then) < before:
                    break
            else:
                return optimum
            done = np.all(np.abs(trial - theta) < _CLOSE * self.width)
            theta, error = trial, then
            if done:
                break
        return self.at(theta, error)

    def by_the_car(self, optimum: _Optimum, mean: np.ndarray) -> np.ndarray:
        """What another car leaves open of the corrections, over their covariance for this one, shape (n, n).

        Its parameters estimated along make them uncertain, and move them by what the session shows of another car.
        """
        others = [model for name in self.settings.car if (model := scaled(self.model, name, 1 - _CHANGE)) is not None]
        error, n = self.error(optimum.theta), len(mean)
        moves = [(error - self.error(optimum.theta, other)) / _CHANGE for other in others]
        moves = [move for move in moves if np.all(np.isfinite(move))]
        if not moves:
            return np.zeros((n, n))
        j = np.concatenate([optimum.jacobian, moves])
        width = np.append(max(SCALES) * self.width, np.full(len(moves), self.settings.car_prior))
        hessian = np.einsum("anm,bnm,m->ab", j, j, optimum.weight) + np.diag(width**-2.0)
        pull = -np.einsum("anm,nm,m->a", j, optimum.at(np.zeros(n)), optimum.weight)
        along, alone = np.linalg.inv(hessian), np.linalg.inv(hessian[:n, :n])
        moved = (along @ pull)[:n] - mean
        return along[:n, :n] - alone + np.outer(moved, moved)

    def _check(self, error: np.ndarray) -> None:
        """Nothing can be read from a run that goes astray."""
        largest = np.max(np.abs(error), axis=0)
        astray = ~(largest < np.where(self.size > 1e-9, _ASTRAY * self.size, np.inf))
        if astray.any():
            j = int(np.argmax(astray))
            other = misread(self.model, self.data, self.run)
            raise SimulationError(
                f"the model's free run over the first {self.settings.seconds:g} s of '{self.data.name}' goes astray: "
                f"{self.model.outputs[j]} is off by {largest[j]:.2g} where it scatters by {self.size[j]:.2g}; expected "
                "a run that corrections can explain: adapt a model that is stable at these speeds"
                f"{other and '; '}{other}"
            )

    def at(self, theta: np.ndarray, error: np.ndarray) -> _Optimum:
        """The problem, linear around some corrections."""
        step = 0.02 * self.width
        jacobian = np.stack([(self.error(theta + d) - error) / s for d, s in zip(np.diag(step), step, strict=True)])
        kinds = tuple(kind for kind, channels in self.kinds for _ in channels)
        weight = self._weights(error)
        return _Optimum(theta=theta, error=error, jacobian=jacobian, weight=weight, width=self.width, kinds=kinds)

    def _weights(self, error: np.ndarray) -> np.ndarray:
        """Information of a sample, per output: over its variance, and as far as it is independent of those before."""
        variance = np.maximum(np.mean(error**2, axis=0), (1e-6 * self.size) ** 2)
        return np.array([effective_samples(e) for e in error.T]) / len(error) / variance


def scaled(model: Model, name: str, by: float) -> Model | None:
    """The model, whatever stands around the physics in it, with one parameter scaled; None if there is none."""
    if name in getattr(model, "parameter_names", ()):
        physics: Any = model
        return physics.with_values(**{name: by * physics.value(name)})
    changed = {}
    for part in fields(model) if is_dataclass(model) else ():
        value = getattr(model, part.name)
        several = isinstance(value, tuple) and any(isinstance(v, Model) for v in value)
        new = [scaled(v, name, by) if isinstance(v, Model) else None for v in (value if several else (value,))]
        if all(v is not None for v in new):
            changed[part.name] = tuple(new) if several else new[0]
    return replace(model, **changed) if changed else None  # type: ignore[type-var]
