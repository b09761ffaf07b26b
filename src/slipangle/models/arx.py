"""ARX models: linear difference equations with any number of inputs and outputs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.models.model import FitInfo, Model
from slipangle.ops import Vector, concatenate, matmul


@dataclass(frozen=True, kw_only=True)
class ARXModel(Model):
    """``y(k) = -A_1 y(k-1) - ... - A_na y(k-na) + B_1 u(k-nk) + ... + B_nb u(k-nk-nb+1) + c``. [1]_ eq. 4-5.

    The state holds the lags: y(k), ..., y(k-na+1), then u(k-1), ..., newest first.

    Parameters
    ----------
    A : array, shape (na, n_outputs, n_outputs)
        Coefficients of past outputs, with the sign of ``A(z) = 1 + a_1 z^-1 + ...``.
    B : array, shape (nb, n_outputs, n_inputs)
        Coefficients of past inputs.
    c : array, shape (n_outputs,)
        Constant; zero unless it was asked for.
    nk : int
        Samples from input to output, at least 1.
    dt : float
        Sample time. [s]
    inputs, outputs : tuple of str
        Channel names.

    References
    ----------
    .. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023 (its eqs. 4-1, 4-2 print G, H and na, nb swapped).
    """

    A: np.ndarray
    B: np.ndarray
    dt: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    c: np.ndarray | None = None
    nk: int = 1
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        ny, nu = len(self.outputs), len(self.inputs)
        A, B = np.asarray(self.A, dtype=float), np.asarray(self.B, dtype=float)
        c = np.zeros(ny) if self.c is None else np.asarray(self.c, dtype=float).reshape(ny)
        if A.ndim == 1:
            A = A[:, None, None]
        if B.ndim == 1:
            B = B[:, None, None]
        if A.shape[1:] != (ny, ny) or B.shape[1:] != (ny, nu) or len(A) < 1 or len(B) < 1:
            raise ParameterError(
                f"A has shape {A.shape} and B {B.shape}; expected (na, {ny}, {ny}) and (nb, {ny}, {nu}) for "
                f"{ny} outputs and {nu} inputs: one matrix per lag, newest first"
            )
        if self.nk < 1:
            raise ParameterError(f"nk is {self.nk}; expected at least 1 sample from input to output")
        for key, value in (("A", A), ("B", B), ("c", c)):
            value.setflags(write=False)
            object.__setattr__(self, key, value)

    @property
    def na(self) -> int:
        """Past outputs used."""
        return len(self.A)

    @property
    def nb(self) -> int:
        """Past inputs used."""
        return len(self.B)

    @property
    def memory(self) -> int:  # type: ignore[override]
        """Samples a free run starts from."""
        return max(self.na, self.nb + self.nk - 1)

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """Lagged outputs, then lagged inputs."""
        past_y = [_lag(n, i) for i in range(self.na) for n in self.outputs]
        past_u = [_lag(n, i) for i in range(1, self.nb + self.nk - 1) for n in self.inputs]
        return (*past_y, *past_u)

    @property
    def _weights(self) -> tuple[np.ndarray, np.ndarray]:
        """Row blocks that give y(k+1) from the state and from u(k)."""
        ny, nu = len(self.outputs), len(self.inputs)
        wide = np.zeros((ny, nu * (self.nb + self.nk - 1)))  # over u(k), u(k-1), ...
        for j in range(self.nb):
            first = (self.nk - 1 + j) * nu
            wide[:, first : first + nu] = self.B[j]
        return np.hstack([*(-self.A), wide[:, nu:]]), wide[:, :nu]

    def step(self, x: Vector, u: Vector) -> Vector:
        """Next outputs in front, lags shifted by one."""
        ny, nu = len(self.outputs), len(self.inputs)
        of_state, of_input = self._weights
        newest = matmul(of_state, x) + matmul(of_input, u)
        if self.c is not None and self.c.any():
            newest = (newest.T + self.c).T if isinstance(newest, np.ndarray) else newest + self.c
        split = ny * self.na
        n = len(self.states)
        parts = [newest] + ([x[: split - ny]] if self.na > 1 else [])
        if n > split:
            parts += [u] + ([x[split : n - nu]] if n - nu > split else [])
        return concatenate(parts)

    def output(self, x: Vector, u: Vector) -> Vector:
        """The newest outputs."""
        return x[: len(self.outputs)]

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """The newest outputs take their measured values."""
        return concatenate([y, x[len(self.outputs) :]]) if len(self.states) > len(self.outputs) else 1.0 * y

    def initial_state(self, data: Dataset) -> np.ndarray:
        """Lags read from the first `memory` samples."""
        y, u = data.select(outputs=self.outputs).y, data.select(inputs=self.inputs).u
        last = self.memory - 1
        past_y = [y[last - i] for i in range(self.na)]
        past_u = [u[last - i] for i in range(1, self.nb + self.nk - 1)]
        return np.concatenate([*past_y, *past_u]) if past_u else np.concatenate(past_y)

    def _free_run(self, x0: np.ndarray, u: np.ndarray) -> np.ndarray:
        """One output: digital filters (transposed direct form) whose states are set from the lags in ``x0``."""
        if len(self.outputs) > 1 or len(u) < 64:
            return super()._free_run(x0, u)
        na, nu, reach = self.na, len(self.inputs), self.nb + self.nk - 1
        denominator = np.concatenate([[1.0], self.A[:, 0, 0]])
        past_u = x0[na:].reshape(reach - 1, nu)  # newest first
        drive = u[:-1, 0]
        taps, still = self._taps(0), np.zeros(max(na, reach - 1))  # what lagged signals will still add to y
        still[:na] = [-denominator[i + 1 :] @ x0[: na - i] for i in range(na)]
        constant = 0.0 if self.c is None else float(self.c[0])
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable model; `simulate` says where
            if nu > 1 or constant:
                drive = np.full(len(u) - 1, constant)
                for j in range(nu):
                    start = np.array([self._taps(j)[i + 1 :] @ past_u[: reach - 1 - i, j] for i in range(reach - 1)])
                    drive += (
                        lfilter(self._taps(j), 1.0, u[:-1, j], zi=start)[0] if reach > 1 else self._taps(j) * u[:-1, j]
                    )
                taps, still = np.ones(1), still[:na]
            else:
                still[: reach - 1] += [taps[i + 1 :] @ past_u[: reach - 1 - i, 0] for i in range(reach - 1)]
            return lfilter(taps, denominator, drive, zi=still)[0][:, None]

    def _driven(self, j: int, past: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Weighted sum of the present and past samples of one input; ``past`` holds those before ``u``."""
        taps = self._taps(j)
        if len(taps) == 1:
            return taps[0] * u
        start = np.array([taps[i + 1 :] @ past[: len(past) - i] for i in range(len(past))])
        return lfilter(taps, 1.0, u, zi=start)[0]

    def _taps(self, j: int) -> np.ndarray:
        """Weights of u_j(k), u_j(k-1), ... in y(k+1), one output."""
        return np.concatenate([np.zeros(self.nk - 1), self.B[:, 0, j]])

    @property
    def poles(self) -> np.ndarray:
        """Eigenvalues of the output recursion."""
        ny = len(self.outputs)
        companion = np.eye(ny * self.na, k=-ny)
        companion[:ny] = np.hstack(list(-self.A))
        return np.linalg.eigvals(companion)


def _lag(name: str, lag: int) -> str:
    return f"{name}[k-{lag}]" if lag else f"{name}[k]"
