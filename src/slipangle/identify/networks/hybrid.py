"""Discrepancy models: a NARX network of what a vehicle model leaves unexplained."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from slipangle.data.dataset import Dataset, join, require_dataset
from slipangle.errors import TooShortError
from slipangle.fields import Whole, Within
from slipangle.identify.networks.narx import NARX
from slipangle.identify.networks.narx_free_run import FreeRunNARX
from slipangle.identify.networks.presets import SOUSA_TABLE_8_2
from slipangle.identify.networks.training import Progress, require_jax
from slipangle.identify.networks.unlike import Proof, proved
from slipangle.identify.physics.at_the_limit import KnownCar
from slipangle.models.model import Model
from slipangle.models.provenance import provenance
from slipangle.models.region import Region
from slipangle.models.wrappers.hybrid import HybridModel

_LAGS = 5  # reckoned with where a network chooses them itself


@dataclass(frozen=True, kw_only=True)
class Hybrid(KnownCar):
    """Estimator of a `HybridModel`: the base model's free-run error, learned by a NARX network.

    The base model stays as it is. Whether the discrepancy helps is decided on parts of the training data that its
    network has not seen. The first are the manoeuvres most unlike the others in speed and lateral acceleration (in all
    inputs and outputs, where there is no v_x or r): a network trained on the rest has to lower the free-run error
    there. Each further fold is a stretch of the second half, a network trained on all before it. Where one does not, or
    all together lower it by less than ``worth``, the discrepancy is switched off (gain 0).

    ``Hybrid(mass=982, wheelbase=2.4, l_f=1.35).fit(data)`` is all it takes; data then need delta, v_x, v_x_dot and r.

    Parameters
    ----------
    base : Model, optional
        The identified vehicle model; by default a nonlinear bicycle, fitted to the same data from mass, wheelbase and
        l_f (see `KnownCar.bicycle`).
    discrepancy : NARX or FreeRunNARX
        The network's settings; by default those that table 8.2 is reproduced with.
    inputs : tuple of str, optional
        Inputs of the discrepancy; by default the base model's, and the channel delta_v_x where the data have it.
    folds : int
        Parts of the training data on which the discrepancy has to prove itself; 0 trusts it unseen.
    worth : float
        Smallest relative reduction of the RMSE over all parts. [-]

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eq. 8-2.
    """

    base: Model | None = None
    discrepancy: NARX | FreeRunNARX = SOUSA_TABLE_8_2
    inputs: tuple[str, ...] | None = None
    folds: Whole = 1
    worth: Annotated[float, Within(0, 1, open="high", example="0.02")] = 0.02

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_known(self.base, "base")

    def fit(self, data: Dataset, *, progress: Progress | None = None) -> HybridModel:
        """Base model plus trained discrepancy, which is off where it did not help.

        Raises SampleTimeError, MissingColumnError or TooShortError if the data do not suit the base model or the
        network's lags.
        """
        require_dataset(data, "fit() got")
        require_jax("fitting a hybrid model")
        began = time.perf_counter()
        base = self.bicycle(data) if self.base is None else self.base
        left = remainder(base, data)
        more = ("delta_v_x",) if "delta_v_x" in data and "delta_v_x" not in base.inputs else ()
        inputs = self.inputs or (*base.inputs, *more)
        notes = () if self.base is not None or base.fit_info is None else base.fit_info.warnings
        gain = 1.0
        if self.folds:
            doubt = self._proof(left, inputs, _manoeuvre(base, data)).doubt(self.worth)
            if doubt:
                gain, notes = 0.0, (*notes, f"the discrepancy is off: {doubt}: the base model is better alone")
        network = self.discrepancy.fit(left.select(inputs=inputs), progress=progress)
        model = HybridModel(base=base, discrepancy=network, gain=gain)
        info: Any = network.fit_info
        run = model.simulate(data)
        return replace(
            model,
            fit_info=replace(
                info,
                noise_std=np.std(run.error[run.predicted], axis=0),
                method=f"discrepancy of {type(base).__name__}: {info.method}",
                warnings=(*info.warnings, *notes),
                seconds=time.perf_counter() - began,
                **provenance(data, base.outputs),
                region=Region.of(data, (*model.inputs, *model.outputs)) if gain else base.region,
            ),
        )

    def _proof(self, left: Dataset, inputs: Sequence[str], signals: np.ndarray) -> Proof:
        """Of the discrepancy, beside none, over parts of the remainder that its network has not seen."""
        chosen = left.select(inputs=inputs)
        network = self.discrepancy if isinstance(self.discrepancy, NARX) else self.discrepancy.start
        na, nb, nk = (n if isinstance(n, int) else _LAGS for n in (network.na, network.nb, network.nk))
        shortest = 4 * max(na, nb + nk) + 2 * max(stage.horizon for stage in network.stages)
        size = np.std(chosen.y, axis=0)

        def errors(seen: Dataset, unseen: Dataset) -> tuple[np.ndarray, np.ndarray]:
            run = self.discrepancy.fit(seen)._simulate(unseen)  # which is unlike what it learned from
            return run.measured[run.predicted] / size, run.error[run.predicted] / size

        return proved(chosen, signals, shortest, self.folds, errors)


def remainder(base: Model, data: Dataset) -> Dataset:
    """The data with every output replaced by what the base model's free run leaves of it."""
    run = base.simulate(data)
    left = data.select(outputs=base.outputs)
    for i, name in enumerate(base.outputs):
        left = left.with_channel(name, run.error[:, i], data.unit(name))
    m = base.memory
    return left if m == 1 else _without_heads(left, m - 1)  # the samples a run starts from have no error


def _manoeuvre(base: Model, data: Dataset) -> np.ndarray:
    """What tells manoeuvres apart, at the samples of the remainder: measured, not what is left of it."""
    seen = data if base.memory == 1 else _without_heads(data, base.memory - 1)
    if "v_x" in seen and "r" in seen:
        return np.column_stack([seen["v_x"], seen["v_x"] * seen["r"]])
    return np.column_stack([seen[name] for name in (*base.inputs, *base.outputs)])


def _without_heads(data: Dataset, n: int) -> Dataset:
    """Every experiment without its first ``n`` samples; short ones are left out."""
    parts = [p.rows(n, p.n_samples) for p in data.experiments if p.n_samples > n + 1]
    if not parts:
        raise TooShortError(
            f"no experiment of '{data.name}' is longer than the {n} samples a free run starts from; record longer"
        )
    return join(*parts, name=data.name)
