"""NARX models: a network of past outputs and inputs."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from slipangle.codegen.compiler import library
from slipangle.codegen.expression import preamble
from slipangle.codegen.network import emit_forward, packed
from slipangle.errors import ParameterError
from slipangle.fields import Count
from slipangle.models.black_box.lagged import LaggedModel
from slipangle.models.black_box.model import NetworkModel
from slipangle.models.black_box.networks import Network
from slipangle.models.parameters import require_few_lags
from slipangle.ops import Vector


@dataclass(frozen=True, kw_only=True)
class NARXModel(NetworkModel, LaggedModel):
    """``y(k) = F[y(k-1), ..., y(k-na), u(k-nk), ..., u(k-nk-nb+1)]`` with a network F.

    The network takes the lags newest first, all channels of one lag together, outputs before inputs; so does the state,
    see `slipangle.models.black_box.lagged.LaggedModel`. Raises ParameterError if an order is below 1 or the network
    does not fit the lags.

    Parameters
    ----------
    network : Network
        F, in SI units; ``na`` times the outputs plus ``nb`` times the inputs in, the outputs out.
    na, nb : int
        Past outputs and past inputs used; at least 1.
    nk : int
        Samples from input to output, at least 1.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eq. 4-14.
    """

    network: Network
    na: Count
    nb: Count
    nk: Count = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        require_few_lags(max(self.na, self.nb + self.nk - 1), "the NARX model")
        ny, nu = len(self.outputs), len(self.inputs)
        lags = f"{self.na} lags of {ny} outputs and {self.nb} lags of {nu} inputs"
        self._require_network("network", (self.na * ny + self.nb * nu, ny), lags)

    def __repr__(self) -> str:
        return (
            f"NARXModel(na={self.na}, nb={self.nb}, nk={self.nk}, dt={self.dt:g}, inputs={self.inputs}, "
            f"outputs={self.outputs}, {type(self.network).__name__} of {self.network.n_parameters} weights)"
        )

    def newest(self, regressors: Vector) -> Vector:
        """Outputs from the lags."""
        return self.network(regressors)

    def free_run(self, x0: np.ndarray, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Outputs at every row of ``u`` after the first, in compiled C where there is a compiler."""
        run, weights = self._compiled
        if run is None:
            return super().free_run(x0, u, out)
        past_y, past_u, _ = self._histories(x0, u)
        drive, n = np.ascontiguousarray(np.vstack([past_u, u]), dtype=float), len(u) - 1
        y = np.empty((self.na + n, len(self.outputs)))
        y[: self.na] = past_y
        run(weights.ctypes.data, drive.ctypes.data, n, y.ctypes.data)
        return y[self.na :]

    def track(self, x0: np.ndarray, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """States given the outputs of the rows before, shape (n_samples, n_states): all lags are measured."""
        past_y, past_u, _ = self._histories(x0, u)
        past_y, past_u = np.vstack([past_y, y[1:]]), np.vstack([past_u, u])
        n, back = len(u), self._reach
        columns = [past_y[self.na - 1 - i :][:n] for i in range(self.na)]
        columns += [past_u[back - i :][:n] for i in range(1, back + 1)]
        return self.advance(np.hstack(columns)[:-1], u[:-1])

    @cached_property
    def _compiled(self) -> tuple[Any, np.ndarray]:
        """The compiled loop, or None, and the weights it reads."""
        net = self.network.perceptron
        loaded = None if net is None else library(self.source(), name="narx")
        if net is None or loaded is None:
            return None, np.empty(0)
        return loaded.free_run, packed(*net.layers, net.straight)

    def source(self) -> str:
        """C of ``free_run(w, u, n, y)``; see `slipangle.codegen.network`.

        ``u`` starts ``nb + nk - 2`` rows before the sample of the initial state, ``y`` with ``na`` past outputs,
        oldest first; ``n`` outputs are appended.
        """
        net = self.network.perceptron
        if net is None:
            raise ParameterError(f"the network is of type {type(self.network).__name__}; expected an MLP for C source")
        na, nb, ny, nu = self.na, self.nb, len(self.outputs), len(self.inputs)
        return f"""\
{preamble("v4")}
{emit_forward((net.n_inputs, *net.hidden, net.n_outputs), net.activation, straight=net.skip is not None)}
void free_run(const double *w, const double *u, long n, double *y)
{{
    double z[{net.n_inputs}];
    for (long k = 0; k < n; k++) {{
        const double *past_y = y + (k + {na}) * {ny}, *past_u = u + (k + {nb}) * {nu};
        for (int i = 0; i < {na}; i++)
            for (int j = 0; j < {ny}; j++) z[i * {ny} + j] = past_y[j - (i + 1) * {ny}];
        for (int i = 0; i < {nb}; i++)
            for (int j = 0; j < {nu}; j++) z[{na * ny} + i * {nu} + j] = past_u[j - (i + 1) * {nu}];
        forward(w, z, y + (k + {na}) * {ny});
    }}
}}
"""
