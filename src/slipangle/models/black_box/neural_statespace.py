"""Neural state space: networks for transition and output, and an encoder that reads the state from past samples."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from slipangle.codegen.compiler import library
from slipangle.codegen.expression import preamble
from slipangle.codegen.network import aligned, emit_forward, packed
from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.fields import Count
from slipangle.models.black_box.model import NetworkModel, numbered
from slipangle.models.black_box.networks import Network
from slipangle.models.model import derived
from slipangle.ops import Vector, concatenate, matmul


@dataclass(frozen=True, kw_only=True)
class NeuralStateSpaceModel(NetworkModel):
    """``x(k+1) = x(k) + f(x(k), u(k))``, ``y(k) = h(x(k))`` with networks f and h.

    The state has no unit and no meaning of its own. A free run starts from what the encoder makes of the first
    `lags` samples; a measurement moves the state by ``gain`` times its innovation.

    Raises ParameterError if the networks do not fit together.

    Parameters
    ----------
    transition : Network
        f: state, then inputs in SI units, to the change of the state.
    emission : Network
        h: state, with ``feedthrough`` also inputs in SI units, to outputs in SI units.
    encoder : Network
        ``y(k), ..., y(k-lags+1), u(k-1), ..., u(k-lags+1)``, newest first, all channels of one lag together, to the
        state at k.
    lags : int
        Samples that the encoder reads, at least 1.
    feedthrough : bool
        Whether the outputs depend on the inputs of the same sample.
    gain : array, shape (n_states, n_outputs), optional
        Innovation gain; by default zero, so that measurements after the start are not used.

    Source: G. Beintema, R. Toth, M. Schoukens, Nonlinear state-space identification using deep encoder networks, Proc.
    3rd Conference on Learning for Dynamics and Control, 2021.
    """

    transition: Network
    emission: Network
    encoder: Network
    lags: Count
    feedthrough: bool = False
    gain: np.ndarray = field(default=None)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        super().__post_init__()
        n, ny, nu = self.transition.n_outputs, len(self.outputs), len(self.inputs)
        wanted = {
            "transition": (n + nu, n),
            "emission": (n + nu if self.feedthrough else n, ny),
            "encoder": (self.lags * ny + (self.lags - 1) * nu, n),
        }
        for name, sizes in wanted.items():
            self._require_network(name, sizes, f"{n} states, {nu} inputs, {ny} outputs and {self.lags} lags")
        self._freeze({"gain": (n, ny)}, f"{n} states and {ny} outputs")

    def __repr__(self) -> str:
        weights = sum(net.n_parameters for net in (self.transition, self.emission, self.encoder))
        return (
            f"NeuralStateSpaceModel({self.n_states} states, lags={self.lags}, dt={self.dt:g}, inputs={self.inputs}, "
            f"outputs={self.outputs}, {weights} weights)"
        )

    memory = derived(lambda self: self.lags)
    states = derived(lambda self: numbered(self.transition.n_outputs))

    def step(self, x: Vector, u: Vector) -> Vector:
        """State one sample later."""
        return x + self.transition(concatenate([x, u]))

    def output(self, x: Vector, u: Vector) -> Vector:
        """Outputs at the same sample."""
        return self.emission(concatenate([x, u]) if self.feedthrough else x)

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """The state moved by the gain times measured minus expected outputs."""
        return x + matmul(self.gain, y - self.output(x, u)) if self.gain.any() else x

    def initial_state(self, data: Dataset) -> np.ndarray:
        """What the encoder makes of the first `lags` samples: the state at the last of them."""
        y, u = data.select(outputs=self.outputs).y, data.select(inputs=self.inputs).u
        last = self.lags - 1
        past = [y[last - i] for i in range(self.lags)] + [u[last - i] for i in range(1, self.lags)]
        return self.encoder(np.concatenate(past))

    def free_run(self, x0: np.ndarray, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Outputs at every row of ``u`` after the first, in compiled C where there is a compiler."""
        run, weights, second = self._compiled
        if run is None:
            return super().free_run(x0, u, out)
        x, drive = np.array(x0, dtype=float), np.ascontiguousarray(u, dtype=float)
        y, start = np.empty((len(u) - 1, len(self.outputs))), weights.ctypes.data
        run(start, start + second, x.ctypes.data, drive.ctypes.data, len(y), y.ctypes.data)
        return y

    @cached_property
    def _compiled(self) -> tuple[Any, np.ndarray, int]:
        """The compiled loop, or None; the weights of f and h; where those of h start, in bytes."""
        f, h = self.transition.perceptron, self.emission.perceptron
        loaded = None if f is None or h is None else library(self.source(), name="neural_statespace")
        if f is None or h is None or loaded is None:
            return None, np.empty(0), 0
        of_f, of_h = (packed(*net.layers, net.straight) for net in (f, h))
        return loaded.free_run, aligned(np.concatenate([of_f, of_h])), of_f.nbytes

    def source(self) -> str:
        """C of ``free_run(weights of f, weights of h, x, u, n, y)``; ``u`` starts at the sample of ``x``."""
        f, h = self.transition.perceptron, self.emission.perceptron
        if f is None or h is None:
            raise ParameterError("the networks are not all of type MLP; expected that for C source")
        n, nu, ny = self.n_states, self.n_inputs, self.n_outputs
        transition, emission = (
            emit_forward((m.n_inputs, *m.hidden, m.n_outputs), m.activation, name=name, straight=m.skip is not None)
            for m, name in ((f, "transition"), (h, "emission"))
        )
        return f"""\
{preamble("v4")}
{transition}
{emission}
void free_run(const double *wf, const double *wh, double *x, const double *u, long n, double *y)
{{
    double z[{n + nu}], change[{n}];
    for (long k = 0; k < n; k++) {{
        for (int i = 0; i < {n}; i++) z[i] = x[i];
        for (int i = 0; i < {nu}; i++) z[{n} + i] = u[k * {nu} + i];
        transition(wf, z, change);
        for (int i = 0; i < {n}; i++) z[i] = x[i] += change[i];
        for (int i = 0; i < {nu}; i++) z[{n} + i] = u[(k + 1) * {nu} + i];
        emission(wh, z, y + k * {ny});
    }}
}}
"""
