"""ARX models: linear difference equations with any number of inputs and outputs."""

import re
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
import scipy

from slipangle.errors import ParameterError
from slipangle.models.black_box import arx_code
from slipangle.models.black_box.lagged import LaggedModel
from slipangle.models.black_box.model import shifted
from slipangle.models.model import derived
from slipangle.models.parameters import require_few_lags
from slipangle.ops import Vector, matmul

_LAGGED = re.compile(r"(.+)\(k(?:-(\d+))?\)")
_LONG = 50_000  # samples from which compiling is worth it


@dataclass(frozen=True, kw_only=True)
class ARXModel(LaggedModel):
    """``y(k) = -A_1 y(k-1) - ... - A_na y(k-na) + B_1 u(k-nk) + ... + B_nb u(k-nk-nb+1) + c``.

    The state holds the lags, see `slipangle.models.black_box.lagged.LaggedModel`.

    Parameters
    ----------
    A : array, shape (na, n_outputs, n_outputs)
        Coefficients of past outputs, with the sign of ``A(z) = 1 + a_1 z^-1 + ...``.
    B : array, shape (nb, n_outputs, n_inputs)
        Coefficients of past inputs.
    c : array, shape (n_outputs,)
        Constant; zero unless it was asked for.
    nk : int
        Samples from input to output; 0 where the output depends on the input at the same sample.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eq. 4-5 (its eqs. 4-1, 4-2 print G, H and na, nb swapped).
    """

    told_by_poles = True
    affine = True
    A: np.ndarray
    B: np.ndarray
    c: np.ndarray = field(default=None)  # type: ignore[assignment]
    nk: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        ny, nu = len(self.outputs), len(self.inputs)
        A, B = np.asarray(self.A, dtype=float), np.asarray(self.B, dtype=float)
        c = np.zeros(ny) if self.c is None else np.asarray(self.c, dtype=float).reshape(ny)
        A, B = (value[:, None, None] if value.ndim == 1 else value for value in (A, B))
        if A.shape[1:] != (ny, ny) or B.shape[1:] != (ny, nu) or len(A) < 1 or len(B) < 1:
            raise ParameterError(
                f"A has shape {A.shape} and B {B.shape}; expected (na, {ny}, {ny}) and (nb, {ny}, {nu}) for "
                f"{ny} outputs and {nu} inputs: one matrix per lag, newest first"
            )
        if self.nk < 0:
            raise ParameterError(f"nk is {self.nk}; expected 0 or more samples from input to output")
        require_few_lags(max(len(A), len(B) + self.nk - 1), "the ARX model")
        vars(self).update(A=A, B=B, c=c)
        self._freeze({"A": A.shape, "B": B.shape, "c": c.shape}, "an ARX model")

    na = derived(lambda self: len(self.A))
    nb = derived(lambda self: len(self.B))

    @cached_property
    def _weights(self) -> np.ndarray:
        """Of the regressors."""
        return np.hstack([*(-self.A), *self.B])

    def newest(self, regressors: Vector) -> Vector:
        """Outputs from the lags."""
        return shifted(matmul(self._weights, regressors), self.c)

    @property
    def _taps(self) -> np.ndarray:
        """Coefficients of the present and past inputs of a free run, shape (n_outputs, n_inputs, n_taps)."""
        wait = np.zeros((max(self.nk - 1, 0), *self.B.shape[1:]))
        return np.concatenate([wait, self.B]).transpose(1, 2, 0)

    def free_run(self, x0: np.ndarray, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """In C where there is a compiler; else digital filters for one output, CasADi for several.

        The filters are in transposed direct form; their states are set from the lags in ``x0``.
        """
        if len(u) >= _LONG:
            past_y, past_u, drive = self._histories(x0, u)
            y = np.empty((len(u) - 1, len(self.outputs))) if out is None else out
            if arx_code.free_run(self.A.transpose(1, 0, 2), self._taps, self.c, (past_y, past_u), drive, y):
                return y
        if len(self.outputs) > 1 or len(u) < 64:
            return super().free_run(x0, u, out)
        past_y, past_u, drive = self._histories(x0, u)
        past_y, past_u = past_y[::-1, 0], past_u[::-1]  # newest first
        denominator = np.concatenate([[1.0], self.A[:, 0, 0]])
        still = np.array([-denominator[i + 1 :] @ past_y[: self.na - i] for i in range(self.na)])
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable model; `simulate` says where
            driven = sum(_filtered(taps, past_u[:, j], drive[:, j]) for j, taps in enumerate(self._taps[0]))
            return np.asarray(scipy.signal.lfilter([1.0], denominator, driven + self.c[0], zi=still)[0])[:, None]

    def with_estimates(self, values: np.ndarray) -> Self | None:
        """Coefficients by the regressors that the fit names; None without a fit that names them all."""
        info, ny = self.fit_info, len(self.outputs)
        if info is None or not info.names or len(info.names) % ny:
            return None
        A, B, c = self.A.copy(), self.B.copy(), self.c.copy()
        count = len(info.names) // ny
        for k, (name, value) in enumerate(zip(info.names, values, strict=True)):
            row = k // count
            label = name.removeprefix(f"{self.outputs[row]}: ") if ny > 1 else name
            lagged = _LAGGED.fullmatch(label)
            if label == "1":
                c[row] = value
            elif lagged and lagged[1] in self.inputs:
                B[int(lagged[2] or 0) - self.nk, row, self.inputs.index(lagged[1])] = value
            elif lagged and lagged[1] in self.outputs:
                A[int(lagged[2]) - 1, row, self.outputs.index(lagged[1])] = -value
            else:
                return None
        return replace(self, A=A, B=B, c=c, fit_info=replace(info, values=np.array(values, dtype=float)))

    @property
    def poles(self) -> np.ndarray:
        """Eigenvalues of the output recursion."""
        ny = len(self.outputs)
        companion = np.eye(ny * self.na, k=-ny)
        companion[:ny] = np.hstack(list(-self.A))
        return np.linalg.eigvals(companion)


def _filtered(taps: np.ndarray, past: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Weighted sum of the present and past samples of one input; ``past`` holds those before ``u``, newest first."""
    if len(taps) == 1:
        return taps[0] * u
    start = np.array([taps[i + 1 :] @ past[: len(past) - i] for i in range(len(past))])
    return np.asarray(scipy.signal.lfilter(taps, 1.0, u, zi=start)[0])
