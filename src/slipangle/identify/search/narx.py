"""What a search of NARX networks tries and how it judges: lags, layers, neurons; free runs on later stretches."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ModelWarning, SimulationError
from slipangle.identify.judge.intervals import stretches
from slipangle.identify.linear.arx import ARX
from slipangle.identify.networks.narx import NARX
from slipangle.identify.networks.problem import Stage
from slipangle.identify.search.pool import Report, Value
from slipangle.identify.search.search import Choice, Range
from slipangle.models.provenance import content

STAGES = (Stage(horizon=1, epochs=150, learning_rate=3e-3), Stage(horizon=40, epochs=150, learning_rate=3e-3))
THESIS: Mapping[str, Range | Choice] = {
    "na": Range(low=5, high=10),
    "nb": Range(low=5, high=10),
    "layers": Range(low=2, high=10),
    "neurons": Range(low=30, high=50),
}
"""Lags, layers and neurons searched by L. C. Sousa, PhD thesis, PUC-Rio, 2023, sec. 8.3."""
WIDER: Mapping[str, Range | Choice] = {
    "na": Range(low=1, high=10),
    "nb": Range(low=1, high=10),
    "layers": Range(low=1, high=10),
    "neurons": Range(low=4, high=64, log=True),
    "activation": Choice(values=("elu", "tanh")),
    "learning_rate": Range(low=3e-4, high=1e-2, log=True),
}
"""Small networks, another activation and the learning rate as well."""


@dataclass(frozen=True, kw_only=True)
class NarxObjective:
    """Free-run error of a NARX network on stretches that follow what it was trained on.

    In each fold a network is trained on the data up to one share and runs free over the stretch up to the next. The
    score is the RMSE over the standard deviation of the measured output, mean over outputs, root mean square over
    folds; after each fold what is known so far is reported, so that a bad trial ends early.

    Raises ParameterError if the shares are not at least two, rising, above 0 and at most 1.
    """

    data: Dataset  # training data; test data have no place here
    stages: tuple[Stage, ...] = STAGES  # training; ``learning_rate`` among the settings replaces theirs
    shares: tuple[float, ...] = (0.6, 0.8, 1.0)  # ends of the folds, rising to at most 1

    def __post_init__(self) -> None:
        stretches(self.data, self.shares)

    @property
    def signature(self) -> str:
        """What the scores are of: the data and the training."""
        return repr((content(self.data), self.stages, self.shares))

    def estimator(self, settings: Mapping[str, Value], seed: int) -> NARX:
        """The network of a trial: ``na``, ``nb``, ``layers``, ``neurons`` and, if searched, the others."""
        stages = self.stages
        if "learning_rate" in settings:
            stages = tuple(replace(s, learning_rate=float(settings["learning_rate"])) for s in stages)
        return NARX(
            na=int(settings["na"]),
            nb=int(settings["nb"]),
            hidden=(int(settings["neurons"]),) * int(settings["layers"]),
            activation="tanh" if settings.get("activation") == "tanh" else "elu",
            stages=stages,
            holdout=0.0,
            seeds=(seed,),
            linear_start=False,
        )

    def __call__(self, settings: Mapping[str, Value], seed: int, report: Report) -> float:
        """Score of a trial; see the class."""
        return self._score(self.estimator(settings, seed), report)

    def linear(self) -> float:
        """Score of an ARX model with orders of its own choice, on the same stretches."""
        return self._score(ARX(), lambda score: None)

    def _score(self, estimator: NARX | ARX, report: Report) -> float:
        errors: list[float] = []
        for early, next_ in stretches(self.data, self.shares):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ModelWarning)
                model = estimator.fit(early)
            try:
                run = model._simulate(next_)  # a score says enough
            except SimulationError as error:
                raise SimulationError(f"fold {len(errors) + 1}: {error}") from None
            size = np.std(run.measured[run.predicted], axis=0)
            errors.append(float(np.mean(np.sqrt(np.mean(run.error[run.predicted] ** 2, axis=0)) / size)))
            report(float(np.sqrt(np.mean(np.square(errors)))))
        return float(np.sqrt(np.mean(np.square(errors))))
