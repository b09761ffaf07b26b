"""`LaggedModel`: models whose state is past outputs and past inputs."""

import abc
from typing import final

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.models.black_box.model import BlackBoxModel
from slipangle.models.model import derived
from slipangle.ops import Vector, concatenate


class LaggedModel(BlackBoxModel):
    """``y(k)`` from y(k-1), ..., y(k-na) and u(k-nk), ..., u(k-nk-nb+1); subclasses supply `newest`.

    With ``nk`` of at least 1 the state at sample k holds y(k), ..., y(k-na+1), then u(k-1), ..., u(k-nk-nb+2), newest
    first, all channels of one sample together. With ``nk = 0`` the output depends on the input at the same sample, so
    it cannot be in the state: that holds y(k-1), ..., y(k-na), u(k-1), ..., u(k-nb+1), then by how much the measured
    output differs from the model's, which is zero until `correct` is called.

    Attributes
    ----------
    na, nb, nk : int
        Past outputs and inputs used; samples from input to output.
    direct : bool
        Whether the output depends on the input at the same sample.
    """

    na: int
    nb: int
    nk: int
    direct: bool = derived(lambda self: self.nk == 0)
    memory: int = derived(lambda self: max(self.na, self.nb + self.nk - 1) + self.direct)
    _reach: int = derived(lambda self: self.nb + max(self.nk, 1) - 2)  # past inputs in the state
    _split: int = derived(lambda self: self.na * len(self.outputs))  # entries of the state that are outputs

    @abc.abstractmethod
    def newest(self, regressors: Vector) -> Vector:
        """Outputs from what `regressors` returns."""

    @derived
    def states(self) -> tuple[str, ...]:
        """Lagged outputs, then lagged inputs; with ``nk = 0`` then the output errors."""
        first = int(self.direct)
        past_y = [_lag(n, i + first) for i in range(self.na) for n in self.outputs]
        past_u = [_lag(n, i) for i in range(1, self._reach + 1) for n in self.inputs]
        return (*past_y, *past_u, *(f"e_{n}" for n in self.outputs if self.direct))

    def _past_inputs(self, x: Vector) -> Vector:
        return x[self._split : self._split + self._reach * len(self.inputs)]

    def regressors(self, x: Vector, u: Vector) -> Vector:
        """Lagged outputs, then the inputs used, newest first."""
        nu, first = len(self.inputs), max(self.nk - 1, 0)
        drives = concatenate([u, self._past_inputs(x)]) if self._reach else u
        return concatenate([x[: self._split], drives[first * nu : (first + self.nb) * nu]])

    @final
    def step(self, x: Vector, u: Vector) -> Vector:
        """Next outputs in front, lags shifted by one."""
        ny, nu, reach = len(self.outputs), len(self.inputs), self._reach
        newest = self.newest(self.regressors(x, u))
        parts = [newest + x[len(self.states) - ny :] if self.direct else newest]
        parts += [x[: self._split - ny]] if self.na > 1 else []
        if reach:
            parts += [u] + ([self._past_inputs(x)[: (reach - 1) * nu]] if reach > 1 else [])
        return concatenate([*parts, 0.0 * newest] if self.direct else parts)

    @final
    def output(self, x: Vector, u: Vector) -> Vector:
        """The outputs at the sample of the state."""
        return self.newest(self.regressors(x, u)) if self.direct else x[: len(self.outputs)]

    @final
    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """The outputs take their measured values."""
        ny, n = len(self.outputs), len(self.states)
        if self.direct:
            return concatenate([x[: n - ny], y - self.output(x, u)])
        return concatenate([y, x[ny:]]) if n > ny else 1.0 * y

    @final
    def initial_state(self, data: Dataset) -> np.ndarray:
        """Lags read from the first `memory` samples."""
        y, u = data.select(outputs=self.outputs).y, data.select(inputs=self.inputs).u
        last = self.memory - 1
        past = [y[last - i] for i in range(int(self.direct), self.na + self.direct)]
        x = np.concatenate([*past, *(u[last - i] for i in range(1, self._reach + 1))])
        if not self.direct:
            return x
        x = np.concatenate([x, np.zeros(len(self.outputs))])
        return np.asarray(self.correct(x, u[last], y[last]))

    def _histories(self, x0: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What a free run needs: past outputs and past inputs, oldest first, and the inputs that follow them.

        The output after the past ones is the one at the second row of ``u``, the first of which belongs to ``x0``;
        each uses inputs up to, and with, the one that follows.
        """
        x0 = np.asarray(x0, dtype=float)
        if self.direct:
            x0, u = np.asarray(self.step(x0, u[0])), u[1:]
        else:
            u = u[:-1]
        past_y = x0[: self._split].reshape(-1, len(self.outputs))[::-1]
        return past_y, self._past_inputs(x0).reshape(-1, len(self.inputs))[::-1], u


def _lag(name: str, lag: int) -> str:
    return f"{name}[k-{lag}]" if lag else f"{name}[k]"
