"""`BlackBoxModel`: what all models from data alone have; `NetworkModel`: what those of networks have besides."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from slipangle.codegen.compiler import compiler, sentence
from slipangle.errors import ModelWarning, ParameterError
from slipangle.fields import Checked
from slipangle.models.black_box.networks import Network
from slipangle.models.model import FitInfo, Model
from slipangle.ops import Vector

_BLOCK = 4096  # samples per matrix product; keeps the layers in the cache
_LONG = 200_000  # samples from which running without compiled code is worth a word


@dataclass(frozen=True, kw_only=True)
class BlackBoxModel(Checked, Model):
    """A model from data alone; its sample time, channel names and fit are as of every `Model`."""

    dt: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    def _freeze(self, shapes: Mapping[str, tuple[int, ...]], sizes: str) -> None:
        """Make read-only arrays of fields, zeros of those not given; raise where one is not of its shape."""
        for key, shape in shapes.items():
            given = getattr(self, key)
            value = np.zeros(shape) if given is None else np.array(given, dtype=float)
            if value.shape != shape:
                raise ParameterError(f"{key} has shape {value.shape}; expected {shape} for {sizes}")
            value.setflags(write=False)
            object.__setattr__(self, key, value)


def numbered(count: int) -> tuple[str, ...]:
    """Names of states without a meaning: ``x0``, ``x1``, ..."""
    return tuple(f"x{i}" for i in range(count))


def shifted(vector: Vector, by: np.ndarray) -> Vector:
    """A vector, or a batch of them side by side, plus a constant."""
    if not by.any():
        return vector
    return (vector.T + by).T if isinstance(vector, np.ndarray) else vector + by


class NetworkModel(BlackBoxModel):
    """A black box made of networks; the free run of perceptrons is compiled."""

    def _require_network(self, name: str, sizes: tuple[int, int], counts: str) -> None:
        """Raise unless the network of that name has so many inputs and outputs."""
        network: Network = getattr(self, name)
        if (network.n_inputs, network.n_outputs) != sizes:
            what = "network" if name == "network" else f"{name} network"
            raise ParameterError(
                f"the {what} has {network.n_inputs} inputs and {network.n_outputs} outputs; expected {sizes[0]} and "
                f"{sizes[1]} for {counts}"
            )

    def free_run(self, x0: np.ndarray, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Outputs at every row of ``u`` after the first, for want of compiled code."""
        if len(u) > _LONG and not compiler():
            warnings.warn(f"{len(u)} samples: {sentence()}", ModelWarning, stacklevel=4)
        return super().free_run(x0, u, out)

    def advance(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """One step from many states at once, as matrix products."""
        blocks = range(0, len(x), _BLOCK)
        steps = [self.step(x[i : i + _BLOCK].T, u[i : i + _BLOCK].T).T for i in blocks]
        return np.vstack([np.empty((0, len(self.states))), *steps])
