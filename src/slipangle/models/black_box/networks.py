"""Small neural networks: multilayer perceptron and radial basis functions, forward pass only.

Weights are NumPy arrays and the scaling lives inside, so a network takes and gives SI values. The pass runs on
numbers, CasADi symbols and JAX tracers. A vector lies along the first axis, so an array of shape ``(n_inputs,
n_samples)`` is a whole batch.

.. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023, sec. 4.3.
.. [2] R. L. Hardy, Multiquadric equations of topography and other irregular surfaces, J. Geophys. Res. 76, 1971.
.. [3] X. Glorot, Y. Bengio, Understanding the difficulty of training deep feedforward neural networks, 2010.
"""

# Long: both kinds of network share scaling, parameters as one vector, and passes.
from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import prod
from typing import Any, Literal, Self, get_args

import casadi as ca
import numpy as np

from slipangle.codegen.network import Activation
from slipangle.equal import Equal
from slipangle.errors import NotFiniteError, ParameterError, require_known
from slipangle.ops import Scalar, Vector, exp, is_symbolic, log, matmul, minimum, sqrt, tanh, where

Kernel = Literal["gaussian", "cubic", "thin plate", "multiquadric"]

_TINY = 1e-30  # keeps roots and logarithms differentiable at a centre; far below rounding


def activate(z: Scalar, activation: Activation) -> Scalar:
    """Activation of a hidden layer of the weighted sum ``z`` of its inputs, elementwise.

    "sigmoid" is ``1 / (1 + exp(-z))``, "tanh" ``tanh(z)``, "elu" ``z`` above and ``exp(z) - 1`` below zero.

    >>> float(activate(0.0, "sigmoid")), float(activate(2.0, "elu"))
    (0.5, 2.0)
    """
    if activation == "sigmoid":
        return 0.5 + 0.5 * tanh(0.5 * z)
    if activation == "tanh":
        return tanh(z)
    return where(z > 0, z, exp(minimum(z, 0.0)) - 1)


def radial(square: Scalar, width: Any, kernel: Kernel) -> Scalar:
    """Radial basis function of the squared distance to the centre. [1]_ eqs. 4-16 to 4-19, [2]_

    With the squared distance ``l^2`` and the width ``sigma`` the kernels are "gaussian" ``exp(-l^2 / sigma^2)``, which
    eq. 4-16 prints without the minus sign, "cubic" ``l^3``, "thin plate" ``l^2 / sigma log(l / sigma)`` and
    "multiquadric" ``sqrt(l^2 + sigma^2)``.

    >>> float(radial(9.0, 4.0, "multiquadric")), float(radial(4.0, 1.0, "cubic"))
    (5.0, 8.0)
    """
    if kernel == "gaussian":
        return exp(-square / (width * width))
    if kernel == "cubic":
        return square * sqrt(square + _TINY)
    if kernel == "thin plate":
        return square / (2 * width) * log((square + _TINY) / (width * width))
    return sqrt(square + width * width)


def mlp_pass(
    x: Vector, weights: Sequence[Any], biases: Sequence[Any], activation: Activation, skip: Any = None
) -> Vector:
    """Output of a perceptron with linear output layer, in scaled coordinates. [1]_ eq. 4-20

    Inputs, shape (n_inputs,) or (n_inputs, n_samples), are scaled; each layer has weights, shape (n_out, n_in), and
    biases, shape (n_out,): numbers, symbols or tracers. ``skip``, shape (n_outputs, n_inputs), leads past the layers.
    """
    given, last = x, len(weights) - 1
    for k, (w, b) in enumerate(zip(weights, biases, strict=True)):
        z = matmul(w, x)
        z = z + _column(b, z)
        x = z if k == last else activate(z, activation)
    return x if skip is None else x + matmul(skip, given)


def rbf_pass(x: Vector, centres: Any, widths: Any, weights: Any, kernel: Kernel) -> Vector:
    """Output of a radial basis function network, in scaled coordinates. [1]_ eq. 4-15

    Inputs, shape (n_inputs,) or (n_inputs, n_samples), are scaled; centres ``c`` have shape (n_neurons, n_inputs),
    widths ``sigma`` (n_neurons,), output weights ``W`` (n_outputs, n_neurons); for the kernels see `radial`.
    """
    square: Any = 0.0
    for j in range(centres.shape[1]):
        distance = x[j] - _column(centres[:, j], x[j], below=True)
        square = square + distance * distance
    return matmul(weights, radial(square, _column(widths, square), kernel))


def _column(values: Any, like: Any, *, below: bool = False) -> Any:
    """A vector laid along the first axis of ``like``, or of what comes above its axes when ``below``."""
    if is_symbolic(values, like):
        return values if is_symbolic(values) else ca.DM(np.asarray(values, dtype=float))
    extra = np.ndim(like) - (0 if below else 1)
    return values.reshape((-1,) + (1,) * extra)


@dataclass(frozen=True, kw_only=True)
class Scaling(Equal):
    """Affine map between SI values ``x`` and network coordinates ``z = (x - offset) / factor``.

    Raises ParameterError, NotFiniteError if lengths differ, a factor is zero or a number is not finite.

    Parameters
    ----------
    offset, factor : array, shape (n,)
        Per channel, in the channel's unit; factors are not zero.

    >>> Scaling.between([-10.0], [30.0]).apply(np.array([0.0, 30.0])[None])
    array([[-0.5,  1. ]])
    """

    offset: np.ndarray
    factor: np.ndarray

    def __post_init__(self) -> None:
        for key in ("offset", "factor"):
            object.__setattr__(self, key, _frozen(getattr(self, key), f"scaling {key}", 1))
        if self.offset.shape != self.factor.shape:
            counts = f"{len(self.offset)} offsets and {len(self.factor)} factors"
            raise ParameterError(f"the scaling has {counts}; expected one of each per channel")
        if np.any(self.factor == 0):
            zero = f"scaling factor {int(np.argmin(np.abs(self.factor)))} is 0"
            raise ParameterError(f"{zero}; expected another number: leave out a channel that is constant")

    @classmethod
    def none(cls, n: int) -> Self:
        """No change of ``n`` channels."""
        return cls(offset=np.zeros(n), factor=np.ones(n))

    @classmethod
    def between(cls, lower: Sequence[float] | np.ndarray, upper: Sequence[float] | np.ndarray) -> Self:
        """Map ``lower`` to -1 and ``upper`` to 1."""
        low, high = np.atleast_1d(np.asarray(lower, dtype=float)), np.atleast_1d(np.asarray(upper, dtype=float))
        return cls(offset=(low + high) / 2, factor=(high - low) / 2)

    @classmethod
    def standard(cls, values: np.ndarray) -> Self:
        """Map samples, shape (n_samples, n), to zero mean and unit variance; a constant channel is only centred."""
        values = np.asarray(values, dtype=float)
        deviation = values.std(axis=0)
        return cls(offset=values.mean(axis=0), factor=np.where(deviation > 0, deviation, 1.0))

    def apply(self, x: Vector) -> Vector:
        """Network coordinates of SI values, channels along the first axis."""
        return (x - _column(self.offset, x)) / _column(self.factor, x)

    def undo(self, z: Vector) -> Vector:
        """SI values of network coordinates; inverse of `apply`."""
        return z * _column(self.factor, z) + _column(self.offset, z)


@dataclass(frozen=True, kw_only=True)
class Network(Equal, abc.ABC):
    """A static map from inputs to outputs: `MLP` or `RBF`, called with SI values.

    Its numbers are also one vector, `parameters`, so that a fit can move them all. Subclasses give the number of inputs
    and outputs to `_set_scaling`.

    Parameters
    ----------
    input_scaling, output_scaling : Scaling, optional
        Between SI values and the network; by default none.
    """

    input_scaling: Scaling = field(default=None)  # type: ignore[assignment]
    output_scaling: Scaling = field(default=None)  # type: ignore[assignment]

    @abc.abstractmethod
    def pass_scaled(self, z: Vector) -> Vector:
        """Scaled outputs of scaled inputs."""

    @property
    @abc.abstractmethod
    def arrays(self) -> tuple[np.ndarray, ...]:
        """What `parameters` is made of, in that order."""

    @abc.abstractmethod
    def with_parameters(self, theta: Any) -> Self:
        """The same architecture with other weights (numbers, or one CasADi column), in the order of `parameters`."""

    def __call__(self, x: Vector) -> Vector:
        """Outputs of inputs, both in SI units: numbers, a CasADi column, or a JAX array.

        From shape (n_inputs,) or (n_inputs, n_samples, ...) to (n_outputs,) or (n_outputs, n_samples, ...). Raises
        ParameterError if the first axis is not as long as there are inputs.
        """
        if x.shape[0] != self.n_inputs:
            raise ParameterError(
                f"the network got {x.shape[0]} inputs along the first axis; expected {self.n_inputs}: samples belong "
                "along the second"
            )
        if len(x.shape) > 2 and not is_symbolic(x):
            return self(x.reshape(x.shape[0], -1)).reshape(self.n_outputs, *x.shape[1:])
        return self.output_scaling.undo(self.pass_scaled(self.input_scaling.apply(x)))

    @property
    def perceptron(self) -> MLP | None:
        """The network where it is one of layers, for code that is faster for those."""
        return None

    @property
    def n_inputs(self) -> int:
        """Length of the input vector."""
        return len(self.input_scaling.offset)

    @property
    def n_outputs(self) -> int:
        """Length of the output vector."""
        return len(self.output_scaling.offset)

    @property
    def parameters(self) -> np.ndarray:
        """Every weight as one vector, row by row, shape (n_parameters,)."""
        return np.concatenate([array.ravel() for array in self.arrays])

    @property
    def n_parameters(self) -> int:
        """Length of `parameters`."""
        return len(self.parameters)

    def _set_scaling(self, n_inputs: int, n_outputs: int) -> None:
        for name, n in (("input_scaling", n_inputs), ("output_scaling", n_outputs)):
            given = getattr(self, name)
            if given is None:
                object.__setattr__(self, name, Scaling.none(n))
            elif len(given.offset) != n:
                raise ParameterError(f"{name} has {len(given.offset)} channels; expected {n}, as many as the network")

    def _unravel(self, theta: Any) -> list[Any]:
        """One vector cut into arrays like `arrays`, row by row; a CasADi column gives CasADi matrices."""
        shapes = [array.shape for array in self.arrays]
        total = sum(prod(s) for s in shapes)
        if theta.shape[0] != total:
            raise ParameterError(f"{theta.shape[0]} parameters; expected {total}, one per weight of the network")
        parts, at = [], 0
        for shape in shapes:
            piece = theta[at : at + prod(shape)]
            at += prod(shape)
            if is_symbolic(theta):
                parts.append(ca.reshape(piece, shape[1], shape[0]).T if len(shape) == 2 else piece)
            else:
                parts.append(piece.reshape(shape))
        return parts


@dataclass(frozen=True, kw_only=True)
class MLP(Network):
    """Multilayer perceptron with linear output layer. [1]_ eq. 4-20

    Raises ParameterError, NotFiniteError if the layers do not fit together or a number is not finite.

    Parameters
    ----------
    weights : sequence of array, shape (n_out, n_in) each
        One matrix per layer, the hidden ones first.
    biases : sequence of array, shape (n_out,) each
        One vector per layer.
    skip : array, shape (n_outputs, n_inputs), optional
        A linear path past the hidden layers, added to their output; in scaled coordinates as they are.

    >>> net = MLP.random((1, 2, 2, 1), activation="sigmoid", seed=0)
    >>> net.n_parameters, net.hidden, net(np.zeros((1, 5))).shape
    (13, (2, 2), (1, 5))
    """

    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    activation: Activation = "sigmoid"
    skip: np.ndarray | None = field(default=None, metadata={"may be missing in a file": True})

    def __post_init__(self) -> None:
        require_known(self.activation, get_args(Activation), "activation")
        weights = tuple(_frozen(w, f"weights of layer {k}", 2) for k, w in enumerate(self.weights))
        biases = tuple(_frozen(b, f"biases of layer {k}", 1) for k, b in enumerate(self.biases))
        if not weights or len(weights) != len(biases):
            counts = f"{len(weights)} weight matrices and {len(biases)} bias vectors"
            raise ParameterError(f"{counts}; expected one per layer")
        for k, (w, b) in enumerate(zip(weights, biases, strict=True)):
            columns = weights[k - 1].shape[0] if k else w.shape[1]
            if w.shape != (b.shape[0], columns):
                raise ParameterError(
                    f"the weights of layer {k} have shape {tuple(w.shape)}; expected {(b.shape[0], columns)}: rows as "
                    "many as biases, columns as many as the layer before has neurons"
                )
        object.__setattr__(self, "weights", weights)
        object.__setattr__(self, "biases", biases)
        if self.skip is not None:
            skip, wanted = _frozen(self.skip, "skip weights", 2), (weights[-1].shape[0], weights[0].shape[1])
            if skip.shape != wanted:
                raise ParameterError(
                    f"the skip weights have shape {tuple(skip.shape)}; expected {wanted}, outputs by inputs"
                )
            object.__setattr__(self, "skip", skip)
        self._set_scaling(weights[0].shape[1], weights[-1].shape[0])

    @property
    def perceptron(self) -> Self:
        """The network itself."""
        return self

    @property
    def layers(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Weights and biases with the scaling folded in: from SI values to SI values, beside `straight`."""
        weights, biases = [np.array(w) for w in self.weights], [np.array(b) for b in self.biases]
        scale_in, scale_out = self.input_scaling, self.output_scaling
        weights[0] = weights[0] / scale_in.factor
        biases[0] = biases[0] - weights[0] @ scale_in.offset
        weights[-1] = weights[-1] * scale_out.factor[:, None]
        biases[-1] = biases[-1] * scale_out.factor + scale_out.offset
        if self.straight is not None:
            biases[-1] = biases[-1] - self.straight @ scale_in.offset
        return weights, biases

    @property
    def straight(self) -> np.ndarray | None:
        """The linear path past the layers, from SI values to SI values, shape (n_outputs, n_inputs); or None."""
        return (
            None if self.skip is None else self.skip * self.output_scaling.factor[:, None] / self.input_scaling.factor
        )

    @classmethod
    def random(
        cls, sizes: Sequence[int], *, activation: Activation = "sigmoid", seed: int = 0, **scalings: Any
    ) -> Self:
        """Random weights, uniform after [3]_, zero biases.

        ``sizes`` are inputs, neurons of each hidden layer, outputs; ``scalings`` are as for the class.
        """
        if len(sizes) < 2 or min(sizes) < 1:
            raise ParameterError(f"the layer sizes are {tuple(sizes)}; expected at least inputs and outputs, each >= 1")
        rng = np.random.default_rng(seed)
        weights = [rng.uniform(-1, 1, (b, a)) * np.sqrt(6 / (a + b)) for a, b in pairwise(sizes)]
        biases = tuple(np.zeros(b) for b in sizes[1:])
        return cls(weights=tuple(weights), biases=biases, activation=activation, **scalings)

    def pass_scaled(self, z: Vector) -> Vector:
        """Scaled outputs of scaled inputs; see `mlp_pass`."""
        return mlp_pass(z, self.weights, self.biases, self.activation, self.skip)

    @property
    def hidden(self) -> tuple[int, ...]:
        """Neurons of each hidden layer."""
        return tuple(w.shape[0] for w in self.weights[:-1])

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """Weights, then biases, layer after layer; the linear path last."""
        own = tuple(a for pair in zip(self.weights, self.biases, strict=True) for a in pair)
        return own if self.skip is None else (*own, self.skip)

    def with_parameters(self, theta: Any) -> Self:
        """The same architecture with other weights and biases."""
        weights, biases, skip = self.unravel(theta)
        return replace(self, weights=weights, biases=biases, skip=skip)

    def unravel(self, theta: Any) -> tuple[tuple[Any, ...], tuple[Any, ...], Any]:
        """Weights, biases and linear path (or None), as they are, from a vector like `parameters`; JAX arrays too."""
        parts, n = self._unravel(theta), 2 * len(self.weights)
        return tuple(parts[0:n:2]), tuple(parts[1:n:2]), None if self.skip is None else parts[n]


@dataclass(frozen=True, kw_only=True)
class RBF(Network):
    """Radial basis function network without bias. [1]_ eq. 4-15

    Raises ParameterError, NotFiniteError if the shapes do not fit together or a number is not finite.

    Parameters
    ----------
    centres : array, shape (n_neurons, n_inputs)
        Centres ``c``, in scaled coordinates.
    widths : array, shape (n_neurons,)
        Widths ``sigma``, in scaled coordinates.
    weights : array, shape (n_outputs, n_neurons)
        Output weights ``W``.

    >>> net = RBF(centres=[[0.0]], widths=[4.0], weights=[[2.0]])
    >>> net(np.array([[0.0, 3.0]]))
    array([[ 8., 10.]])
    """

    centres: np.ndarray
    widths: np.ndarray
    weights: np.ndarray
    kernel: Kernel = "multiquadric"

    def __post_init__(self) -> None:
        require_known(self.kernel, get_args(Kernel), "kernel")
        for key, dimensions in (("centres", 2), ("widths", 1), ("weights", 2)):
            object.__setattr__(self, key, _frozen(getattr(self, key), key, dimensions))
        n = self.centres.shape[0]
        if self.widths.shape[0] != n or self.weights.shape[1] != n:
            counts = f"{n} centres, {self.widths.shape[0]} widths and weights for {self.weights.shape[1]} neurons"
            raise ParameterError(f"{counts}; expected as many of each")
        if not is_symbolic(self.widths) and np.any(self.widths <= 0):
            raise ParameterError(f"a width is {float(self.widths.min()):g}; expected positive widths")
        self._set_scaling(self.centres.shape[1], self.weights.shape[0])

    def pass_scaled(self, z: Vector) -> Vector:
        """Scaled outputs of scaled inputs; see `rbf_pass`."""
        return rbf_pass(z, self.centres, self.widths, self.weights, self.kernel)

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """Centres, widths, weights."""
        return self.centres, self.widths, self.weights

    def with_parameters(self, theta: Any) -> Self:
        """The same architecture with other centres, widths and weights."""
        centres, widths, weights = self._unravel(theta)
        return replace(self, centres=centres, widths=widths, weights=weights)


def _frozen(value: Any, what: str, dimensions: int) -> Any:
    """A read-only float copy of the given number of dimensions; CasADi expressions pass."""
    if is_symbolic(value):
        return value
    array = np.array(value, dtype=float)
    if array.ndim != dimensions:
        raise ParameterError(f"the {what} have {array.ndim} dimensions; expected {dimensions}")
    if not np.isfinite(array).all():
        raise NotFiniteError(f"the {what} hold NaN or infinity; expected finite numbers: the fit diverged")
    array.setflags(write=False)
    return array
