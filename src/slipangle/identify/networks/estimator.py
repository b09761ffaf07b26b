"""`NetworkEstimator`: settings that all networks trained on windows share, and their way from data to a model."""

from __future__ import annotations

import abc
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Generic, NamedTuple, Self, TypeVar

import numpy as np

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.errors import IdentifiabilityWarning, ModelWarning, SlipangleError, TooShortError
from slipangle.fields import Checked, Count, Seed
from slipangle.identify.excitation import require_identifiable, require_independent
from slipangle.identify.networks.lag_form import in_scaled
from slipangle.identify.networks.problem import Precision, Stage, TrainingProblem
from slipangle.identify.networks.training import IDLE, Holdout, Progress, Trained, require_jax, train
from slipangle.identify.networks.windows import in_units, scaled, window_starts
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.black_box.model import NetworkModel
from slipangle.models.black_box.networks import Activation, Scaling
from slipangle.models.model import Candidate, FitInfo
from slipangle.models.provenance import provenance
from slipangle.models.region import Region

M = TypeVar("M", bound=NetworkModel)
LINEAR = (
    "no network beat the linear model that training started from by its free run over the held-out part without losing "
    "to it over the rest, so the model is that linear one"
)
Again = Callable[[TrainingProblem, Any, tuple[Stage, ...]], Any]
"""Trains something beside what is found already: problem, start and stages to its parameters."""


class Settled(NamedTuple):
    """How open orders were chosen: in words, all that were compared, and a linear model to start from that came out."""

    said: str = ""
    candidates: tuple[Candidate, ...] = ()
    linear: ARXModel | None = None


@dataclass(frozen=True, kw_only=True)
class NetworkEstimator(Checked, abc.ABC, Generic[M]):
    """How a network is trained on windows.

    The last part of the training data is held out: its free-run error decides when to stop and which seed wins.
    Test data are never seen.

    Parameters
    ----------
    hidden : tuple of int
        Neurons of each hidden layer; empty for an affine map.
    activation : {"sigmoid", "tanh", "elu"}
        Of the neurons.
    stages : tuple of Stage
        How far ahead the loss looks and for how long.
    holdout : float
        Share of the training data held out; 0 trains on all and judges on the same.
    seeds : tuple of int
        One training run each; ``fit_info.trials`` keeps every result.
    linear_start : bool
        Give the network a linear path beside its hidden layers, and start as the linear model of the same lags or
        states, fitted to what is not held out. Where no network beats it by its free run over the held-out part and is
        no worse over the rest, the model returned is that linear one, and a warning says so. Otherwise training starts
        from random weights.
    precision : {"single", "double"}
        Of the training. Single is faster and as good unless the free-run error falls below 1e-4 of the output.
    """

    hidden: tuple[Count, ...]
    activation: Activation
    stages: tuple[Stage, ...]
    holdout: Holdout = 0.15
    seeds: tuple[Seed, ...] = (0,)
    linear_start: bool = True
    precision: Precision = "single"

    _what: ClassVar[str]  # is fitted
    _memory: ClassVar[Any]  # samples that a free run starts from

    @abc.abstractmethod
    def settled(self, data: Dataset) -> tuple[Self, Settled]:
        """These settings with every order a number, and how they were chosen."""

    @abc.abstractmethod
    def _n_seen(self, ny: int, nu: int) -> int:
        """Samples that one prediction depends on."""

    @abc.abstractmethod
    def _problem(self) -> TrainingProblem:
        """What is trained."""

    @abc.abstractmethod
    def _linear(self, data: Dataset, held: Dataset, *known: ARXModel) -> Any:
        """The linear model to start from, scaled, as `_initial` takes it; of several the best over ``held``.

        One that is ``known`` came with the orders.
        """

    @abc.abstractmethod
    def _initial(self, seed: int, ny: int, nu: int, linear: Any) -> Any:
        """Random weights, past which the linear model acts alone where there is one."""

    @abc.abstractmethod
    def _model(self, params: Any, scaling_u: Scaling, scaling_y: Scaling, again: Again, channels: Any) -> M:
        """The model of trained parameters."""

    def fit(self, data: Dataset, *, progress: Progress | None = None) -> M:
        """Model of all outputs from all inputs of ``data``; windows never cross the border of an experiment.

        Raises ExcitationError or TooShortError if an input or output is constant, or no experiment holds the lags and a
        window.

        Warns with ModelWarning if a training run diverged or never improved, and the model may be the linear one; the
        best weights are kept.

        Parameters
        ----------
        progress : callable, optional
            Told the share done and what is being done.
        """
        require_dataset(data, "fit() got")
        began = time.perf_counter()
        require_jax(f"fitting {self._what}")
        settings, chosen = self.settled(data)
        model = settings._fit(data, began, progress, chosen.linear)
        if not chosen.candidates:
            return model
        info: Any = model.fit_info
        return replace(
            model, fit_info=replace(info, candidates=chosen.candidates, method=f"{chosen.said}; {info.method}")
        )

    def _fit(self, data: Dataset, began: float, progress: Progress | None, known: ARXModel | None = None) -> M:
        """The model of settled orders, from a known linear model or a better one that is found."""
        ny, nu = len(data.outputs), len(data.inputs)
        require_identifiable(data, self._n_seen(ny, nu))
        require_independent(data)
        inner, held = self.cut(data)
        scaling_u, scaling_y = Scaling.standard(inner.u), Scaling.standard(inner.y)
        arrays, problem = scaled(inner, scaling_u, scaling_y, held), self._problem()

        def starts(horizon: int) -> np.ndarray:
            return window_starts(inner, self._memory, horizon)

        def again(problem: TrainingProblem, start: Any, stages: tuple[Stage, ...]) -> Any:
            settings: Any = {"stages": stages, "seeds": (trained.best.seed,), "precision": self.precision}
            return train(problem, lambda seed: start, (arrays, trained.params), starts, **settings).params

        both = in_units(inner, scaling_u, scaling_y), in_units(held, scaling_u, scaling_y)
        given = () if known is None else (in_scaled(known, scaling_u, scaling_y),)
        linear, without = self._started(*both, *given) if self.linear_start else (None, "")
        settings: Any = {"stages": self.stages, "seeds": self.seeds, "precision": self.precision}
        settings |= {"guarded": linear is not None and self.holdout > 0}  # else the score is of the training data
        settings |= {"idle": LINEAR if linear is not None else IDLE, "progress": progress}
        trained = train(problem, lambda seed: self._initial(seed, ny, nu, linear), arrays, starts, **settings)
        if without:
            trained = replace(trained, warnings=(without, *trained.warnings))
        for note in trained.warnings:
            warnings.warn(note, ModelWarning, stacklevel=3)
        channels = {"dt": data.dt, "inputs": data.inputs, "outputs": data.outputs}
        model = self._model(trained.params, scaling_u, scaling_y, again, channels)
        return replace(model, fit_info=self._info(trained, model, data, began))

    def _started(self, data: Dataset, held: Dataset, *known: ARXModel) -> tuple[Any, str]:
        """The linear model, or why there is none."""
        try:
            with warnings.catch_warnings():
                for kind in (ModelWarning, IdentifiabilityWarning):  # of a model that is only to begin with
                    warnings.simplefilter("ignore", kind)
                return self._linear(data, held, *known), ""
        except SlipangleError as error:
            return None, f"training starts from random weights, as there is no linear model to start from: {error}"

    def cut(self, data: Dataset) -> tuple[Dataset, Dataset]:
        """Training data without their last part, and that part; both the whole where nothing is held out.

        Raises TooShortError if that part has no experiment long enough for a free run.
        """
        inner, held = (data, data) if self.holdout == 0 else data.split(1 - self.holdout)
        if all(part.n_samples <= self._memory for part in held.experiments):
            raise TooShortError(
                f"the {held.n_samples} samples held out of '{data.name}' have no experiment longer than the "
                f"{self._memory} samples that a free run starts from; expected more: hold out a larger share or record "
                "longer"
            )
        return inner, held

    def _info(self, trained: Trained, model: M, data: Dataset, began: float) -> FitInfo:
        """How the network was trained; it has no covariance."""
        one, best = model.predict(data), trained.best
        residual = one.error[one.predicted]
        ahead = ", then ".join(f"{s.horizon}" for s in self.stages) + " step" + "s" * (self.stages[-1].horizon > 1)
        where = f"the last {100 * self.holdout:g} % of the training data" if self.holdout else "the training data"
        return FitInfo(
            names=(),
            values=np.empty(0),
            covariance=np.empty((0, 0)),
            noise_std=np.std(residual, axis=0),
            n_samples=len(residual),
            seconds=time.perf_counter() - began,
            method=(
                f"Adam on windows of {ahead} in {self.precision} precision; free run on {where} chose epoch "
                f"{best.epoch} of {best.epochs} and seed {best.seed} of {len(trained.trials)}"
            ),
            warnings=trained.warnings,
            **provenance(data),
            region=Region.of(data),
            trials=trained.trials,
        )
