"""Discrepancy models: a NARX network of what a vehicle model leaves unexplained; offsets of another session."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.errors import TooShortError
from slipangle.fields import Checked, Whole, Within
from slipangle.identify.networks.narx import NARX
from slipangle.identify.networks.narx_free_run import FreeRunNARX
from slipangle.identify.networks.problem import Stage
from slipangle.identify.networks.training import Progress, require_jax
from slipangle.models.model import Model
from slipangle.models.provenance import provenance
from slipangle.models.wrappers.hybrid import HybridModel, OffsetModel

DISCREPANCY = NARX(
    na=5,
    nb=5,
    hidden=(30, 30),
    stages=(Stage(horizon=1, epochs=200), Stage(horizon=40, epochs=400, learning_rate=3e-3)),
    linear_start=False,
)


@dataclass(frozen=True, kw_only=True)
class Hybrid(Checked):
    """Estimator of a `HybridModel`: the base model's free-run error, learned by a NARX network.

    The base model stays as it is. Whether the discrepancy helps is decided on parts of the training data that its
    network has not seen: in each of ``folds`` stretches, cut from the second half of the training data, a network
    trained on all that comes before has to lower the free-run error, and by ``worth`` of it over all stretches;
    otherwise the discrepancy is switched off (gain 0).

    Parameters
    ----------
    base : Model
        The identified vehicle model.
    inputs : tuple of str, optional
        Inputs of the discrepancy; by default the base model's.
    folds : int
        Stretches on which the discrepancy has to prove itself; 0 trusts it unseen.
    worth : float
        Smallest relative reduction of the RMSE over all stretches.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eq. 8-2.
    """

    base: Model
    discrepancy: NARX | FreeRunNARX = field(default_factory=lambda: DISCREPANCY)
    inputs: tuple[str, ...] | None = None
    folds: Whole = 1
    worth: Annotated[float, Within(0, 1, open="high", example="0.02")] = 0.02

    def fit(self, data: Dataset, *, progress: Progress | None = None) -> HybridModel:
        """Base model plus trained discrepancy, which is off where it did not help.

        Raises SampleTimeError, MissingColumnError or TooShortError if the data do not suit the base model or the
        network's lags.
        """
        require_jax("fitting a hybrid model")
        began = time.perf_counter()
        left = self.remainder(data)
        inputs = self.inputs or self.base.inputs
        notes: tuple[str, ...] = ()
        gain = 1.0
        if self.folds:
            before, after = self._proof(left, inputs)
            reduction = 1 - np.sqrt(np.sum(after**2) / np.sum(before**2))
            if np.any(after >= before) or reduction < self.worth:
                gain = 0.0
                notes = (
                    f"the discrepancy is off: on unseen stretches of the training data it changed the RMSE by "
                    f"{-100 * reduction:+.1f} % (worst stretch {100 * np.max(after / before - 1):+.1f} %); expected "
                    f"at least {-100 * self.worth:.0f} % and none worse",
                )
        network = self.discrepancy.fit(left.select(inputs=inputs), progress=progress)
        model = HybridModel(base=self.base, discrepancy=network, gain=gain)
        info: Any = network.fit_info
        run = model.simulate(data)
        return replace(
            model,
            fit_info=replace(
                info,
                noise_std=np.std(run.error[run.predicted], axis=0),
                method=f"discrepancy of {type(self.base).__name__}: {info.method}",
                warnings=(*info.warnings, *notes),
                seconds=time.perf_counter() - began,
                **provenance(data, self.base.outputs),
            ),
        )

    def remainder(self, data: Dataset) -> Dataset:
        """The data with every output replaced by what the base model's free run leaves of it."""
        run = self.base.simulate(data)
        left = data.select(outputs=self.base.outputs)
        for i, name in enumerate(self.base.outputs):
            left = left.with_channel(name, run.error[:, i], data.unit(name))
        m = self.base.memory
        if m == 1:
            return left
        return _without_heads(left, m - 1)  # the samples a run starts from have no error

    def _proof(self, left: Dataset, inputs: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """RMSE of each unseen stretch without and with the discrepancy."""
        edges = np.linspace(0.5 if self.folds > 1 else 0.75, 1.0, self.folds + 1)
        rows = np.round(edges * left.n_samples).astype(int)
        chosen = left.select(inputs=inputs)
        before, after = [], []
        for a, b in pairwise(rows.tolist()):
            network = self.discrepancy.fit(chosen.rows(0, a))
            run = network.simulate(chosen.rows(a, b))
            measured, error = run.measured[run.predicted], run.error[run.predicted]
            size = np.std(chosen.y, axis=0)
            before.append(np.sqrt(np.mean((measured / size) ** 2)))
            after.append(np.sqrt(np.mean((error / size) ** 2)))
        return np.array(before), np.array(after)


def _without_heads(data: Dataset, n: int) -> Dataset:
    """Every experiment without its first ``n`` samples; short ones are left out."""
    parts = [p.rows(n, p.n_samples) for p in data.experiments if p.n_samples > n + 1]
    if not parts:
        raise TooShortError(
            f"no experiment of '{data.name}' is longer than the {n} samples a free run starts from; record longer"
        )
    return join(*parts, name=data.name)


# ---- another session -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Adapt:
    """Sensor offsets of a session from its first seconds, by Gauss-Newton on the free run."""

    inputs: tuple[str, ...] = ("delta",)  # inputs whose reading at zero is estimated, such as the steering angle
    outputs: tuple[str, ...] = ()  # outputs whose reading at zero is estimated
    seconds: float = 30.0  # how much of the session is used [s]
    max_iterations: int = 6

    def fit(self, model: Model, data: Dataset) -> OffsetModel:
        """The model behind the offsets that explain the first ``seconds`` of the data best.

        Raises TooShortError if the data are shorter, and MissingColumnError if the model has no such channel.
        """
        n = round(self.seconds / data.dt)
        if data.n_samples < n or n <= model.memory + 1:
            raise TooShortError(
                f"'{data.name}' lasts {data.duration:.3g} s, offsets are read from {self.seconds:g} s; expected more: "
                "record longer or lower seconds"
            )
        first = data.rows(0, n)
        names = (*self.inputs, *self.outputs)
        size = np.array([max(1e-4, 0.02 * float(np.std(first[name]))) for name in names])
        values = np.zeros(len(names))
        for _ in range(self.max_iterations):
            error = self._error(model, first, values)
            shifted = [self._error(model, first, values + size * unit) for unit in np.eye(len(names))]
            jacobian = np.column_stack([(e - error) / s for e, s in zip(shifted, size, strict=True)])
            move = np.linalg.lstsq(jacobian, -error, rcond=1e-10)[0]
            values = values + move
            if np.all(np.abs(move) < 1e-3 * size):
                break
        return self._shifted(model, values)

    def _shifted(self, model: Model, values: np.ndarray) -> OffsetModel:
        k = len(self.inputs)
        return OffsetModel(
            model=model,
            inputs_at_zero=dict(zip(self.inputs, map(float, values[:k]), strict=True)),
            outputs_at_zero=dict(zip(self.outputs, map(float, values[k:]), strict=True)),
            fit_info=model.fit_info,
        )

    def _error(self, model: Model, data: Dataset, values: np.ndarray) -> np.ndarray:
        run = self._shifted(model, values).simulate(data)
        return run.error[run.predicted].ravel()
