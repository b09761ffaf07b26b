"""`LinearEstimator`: how a linear model's fit speaks of what it found."""

from __future__ import annotations

import abc
import math
import time
from typing import Any, ClassVar, Generic, TypeVar

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.fields import Checked
from slipangle.identify.excitation import nearly_dependent, require_independent
from slipangle.identify.linear.levels import level_said
from slipangle.identify.stability import announced, breakdown_said, judged, noted
from slipangle.models.model import FitInfo, Model
from slipangle.models.provenance import provenance

M = TypeVar("M", bound=Model)
_CONSTANTS = (("offset", "True"), ("offsets", "'output'"))  # settings by which an estimator takes levels in
_ROUNDING = 1e-14  # of an input's variance: what rounding leaves of one that is a combination of others


class LinearEstimator(Checked, abc.ABC, Generic[M]):
    """Settings whose ``fit`` returns a linear model."""

    _what: ClassVar[str]  # is fitted

    def fit(self, data: Dataset) -> M:
        """Model of all outputs from all inputs of ``data``; experiments are never joined.

        Raises ExcitationError or TooShortError if the data cannot tell, with the regressors, inputs or counts at fault,
        ParameterError if the settings do not suit the data, or no order could be fitted, and SimulationError if the fit
        diverged.

        Warns with IdentifiabilityWarning if two inputs correlate by 0.99 or more, the data have a level that the
        settings leave no place for, or the fit stopped at its limit of steps, and ModelWarning if a free run of the
        model would blow up, or the poles had to be held back.
        """
        require_dataset(data, "fit() got")
        with breakdown_said(self._what, data):
            offset = self._has_constant
            require_independent(data, offset=offset, least=_ROUNDING)
            model = noted(judged(self._fit(data), data), *nearly_dependent(data, offset=offset))
            fix = next((f"{n}={v}" for n, v in _CONSTANTS if hasattr(self, n)), "")
            model = model if offset or not fix else noted(model, level_said(data, fix))
            return noted(announced(model), *self._remarks(model, data))

    @property
    def _has_constant(self) -> bool:
        """Whether the model has levels at rest."""
        return bool(getattr(self, "offset", getattr(self, "offsets", "none") != "none"))

    def _remarks(self, model: M, data: Dataset) -> tuple[str, ...]:
        """What else the fit says, in the model's ``fit_info`` only, as it is this estimator's way."""
        return ()

    @abc.abstractmethod
    def _fit(self, data: Dataset) -> M:
        """`fit` without a word about what it found."""


def described(data: Dataset, began: float, **found: Any) -> FitInfo:
    """How a model without units of its own was fitted to the data, ``began`` being the time at the start."""
    seconds, units = time.perf_counter() - began, ("-",) * len(found["names"])
    return FitInfo(units=units, seconds=seconds, **provenance(data), **found)


def channels(data: Dataset) -> Any:
    """Sample time and names that a model has of its data."""
    return {"dt": data.dt, "inputs": data.inputs, "outputs": data.outputs}


def criteria(log_det: float, d: int, n: float) -> dict[str, float]:
    """AIC, BIC and FPE of d parameters and n residuals, from the logarithm of the determinant of their covariance."""
    fpe = math.exp(min(log_det, 700.0)) * (1 + d / n) / max(1 - d / n, 1e-12)
    return {"aic": n * log_det + 2 * d, "bic": n * log_det + d * math.log(n), "fpe": fpe}
