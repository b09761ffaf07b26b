"""ARX models with poles known to be at 1, such as from steering to lateral position."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset, join, require_dataset
from slipangle.errors import ParameterError, TooShortError
from slipangle.fields import Checked, Count, Whole
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.lags import same_for_all
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.provenance import provenance


@dataclass(frozen=True, kw_only=True)
class IntegratedARX(Checked):
    """Least-squares ARX of the differenced output, turned back: ``(1 - z^-1)^order A(z) y = B(z) u``.

    A lateral position integrates twice: whatever speed and heading it has at the start go on for ever. Plain least
    squares puts those poles near 1, and a free run drifts away; here they are 1.

    Raises ParameterError if there are fewer lags than known poles.

    Parameters
    ----------
    na : int
        Past outputs used, the differences included: at least ``order``.
    nb, nk : int
        As for `ARX`.
    order : int
        How many poles are at 1.
    """

    na: Count
    nb: Count
    nk: Whole = 1
    order: Count = 2

    def __post_init__(self) -> None:
        same_for_all(self, "nb", "nk")
        super().__post_init__()
        if self.na < self.order:
            raise ParameterError(
                f"na is {self.na} with {self.order} poles at 1; expected at least as many lags as poles: raise na"
            )

    def fit(self, data: Dataset) -> ARXModel:
        """Model of one output; experiments are never joined.

        Raises ParameterError if there are several outputs, and TooShortError or ExcitationError as `ARX.fit`.
        """
        require_dataset(data, "fit() got")
        if len(data.outputs) != 1:
            raise ParameterError(f"the data have outputs {list(data.outputs)}; expected one: select it")
        name, free = data.outputs[0], self.na - self.order
        parts = []
        for part in data.experiments:
            if part.n_samples <= self.order + 1:
                raise TooShortError(
                    f"an experiment of '{data.name}' has {part.n_samples} samples; expected more than the "
                    f"{self.order + 1} that differencing takes: leave it out"
                )
            rest = part.rows(self.order, part.n_samples)
            parts.append((np.diff(part[name], n=self.order), rest))
        a, B, info = self._differences(parts, name, free)
        if info is not None:  # the differences are no samples of the log
            info = replace(info, **provenance(data))
        A = np.convolve(np.poly(np.ones(self.order)), np.concatenate([[1.0], a]))[1:]
        return ARXModel(A=A, B=B, nk=self.nk, dt=data.dt, inputs=data.inputs, outputs=data.outputs, fit_info=info)

    def _differences(self, parts: list, name: str, free: int) -> tuple[np.ndarray, np.ndarray, Any]:
        """Coefficients of the differenced output."""
        pieces = [rest.with_channel(name, values) for values, rest in parts]
        joined = pieces[0] if len(pieces) == 1 else join(*pieces)
        if free:
            model = ARX(na=free, nb=self.nb, nk=self.nk).fit(joined)
            return model.A[:, 0, 0], model.B, model.fit_info
        rows, targets = [], []
        reach = self.nb + self.nk - 1
        for piece in pieces:
            y, u = piece[name], piece.select(outputs=(name,)).u
            rows += [np.hstack([u[k - self.nk - j] for j in range(self.nb)]) for k in range(reach, len(y))]
            targets += [y[k] for k in range(reach, len(y))]
        slopes, *_ = np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)
        return np.zeros(0), slopes.reshape(self.nb, 1, -1), None
