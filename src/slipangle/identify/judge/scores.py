"""How far a trajectory is from what was measured, output by output."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from slipangle.identify.judge import metrics
from slipangle.models.model import Trajectory


@dataclass(frozen=True, kw_only=True)
class Score:
    """Metrics of one output over the predicted samples; see `slipangle.identify.judge.metrics`."""

    rmse: float
    r2: float
    fit: float
    vaf: float

    @classmethod
    def of(cls, measured: np.ndarray, predicted: np.ndarray) -> Score:
        """Metrics of the samples of one output, shape (n,) each, in its unit."""
        return cls(**{f.name: float(getattr(metrics, f.name)(measured, predicted)) for f in fields(cls)})


def score(trajectory: Trajectory, output: str) -> Score:
    """Metrics of one output over the samples that were predicted."""
    i = trajectory.outputs.index(output)
    return Score.of(trajectory.measured[trajectory.predicted, i], trajectory.y[trajectory.predicted, i])
