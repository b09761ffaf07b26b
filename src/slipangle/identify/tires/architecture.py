"""`ArchitectureSearch`: the smallest network that follows a friction curve about as well as the best one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np

from slipangle.errors import ParameterError
from slipangle.fields import Checked, Within
from slipangle.identify.tires.curve_data import Beside, checked_samples
from slipangle.identify.tires.curves import NetworkCurveFit
from slipangle.models.tires.neural import NeuralCurve


class Candidate(NamedTuple):
    """One architecture of a search: its settings, size and error on samples that it was not fitted to."""

    fit: NetworkCurveFit
    n_parameters: int
    rmse: float


class ArchitectureResult(NamedTuple):
    """Curve of the chosen architecture, fitted to all samples, its candidate, and all of them by size."""

    curve: NeuralCurve
    chosen: Candidate
    candidates: tuple[Candidate, ...]


@dataclass(frozen=True, kw_only=True)
class ArchitectureSearch(Checked):
    """The smallest network whose error is within a tolerance of the best.

    The error is measured by cross-validation: each fold of every ``folds``-th sample is predicted by a network fitted
    to the others.
    """

    candidates: tuple[NetworkCurveFit, ...]
    tolerance: float = 0.02  # how much larger than the best the error may be, as a share of it
    enough: float = 0.0  # an error that is good enough however small the best is [-]
    folds: Annotated[int, Within(2)] = 4  # parts of the data that take turns

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.candidates:
            raise ParameterError("there is no candidate; expected at least one, such as MLPCurveFit(hidden=(2, 2))")

    def fit(
        self, slip: np.ndarray, friction: np.ndarray, *, load: Beside = None, camber: Beside = None
    ) -> ArchitectureResult:
        """Choose and fit; arguments and exceptions as for `NetworkCurveFit.fit`."""
        samples, _, inputs = checked_samples(slip, friction, load, camber, n_parameters=2 * self.folds)
        friction = np.asarray(friction, dtype=float)
        # folds from the samples in the order of slip, so that each covers the whole curve
        rank = np.argsort(np.argsort(samples[:, 0], kind="stable"), kind="stable")
        scored = []
        for candidate in self.candidates:
            error = np.empty(len(friction))
            for k in range(self.folds):
                out = rank % self.folds == k
                parts = dict(zip(inputs[1:], samples[~out, 1:].T, strict=True))
                curve = candidate.fit(samples[~out, 0], friction[~out], **parts)
                curve = replace(curve, outside="extrapolate")
                where = dict(zip(inputs[1:], samples[out, 1:].T, strict=True))
                error[out] = friction[out] - curve(samples[out, 0], **where)
            scored.append(Candidate(candidate, candidate.n_parameters(len(inputs)), float(np.sqrt(np.mean(error**2)))))
        limit = max(min(c.rmse for c in scored) * (1 + self.tolerance), self.enough)
        ordered = tuple(sorted(scored, key=lambda c: (c.n_parameters, c.rmse)))
        chosen = next(c for c in ordered if c.rmse <= limit)
        return ArchitectureResult(chosen.fit.fit(slip, friction, load=load, camber=camber), chosen, ordered)
