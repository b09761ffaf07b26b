"""Neural tires: friction over slip by a small network, behind the `Tire` call. [1]_ secs. 4.3, 6.2.1, 6.3.1

.. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023.
.. [2] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.2 (similarity method).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal

import casadi as ca
import numpy as np

from slipangle.equal import Equal
from slipangle.errors import ParameterError
from slipangle.fields import Checked
from slipangle.models.black_box.networks import Network
from slipangle.models.model import FitInfo
from slipangle.models.tires.simple import KnownRange, Tire, TireForces
from slipangle.ops import Scalar, clip, fabs, is_symbolic, matmul, sqrt, stack, tanh, where

CurveInput = Literal["slip", "load", "camber"]
_AS_TANH = {"sigmoid": (0.5, 0.5, 0.5), "tanh": (1.0, 1.0, 0.0)}  # a, b, c in f(z) = b tanh(a z) + c


@dataclass(frozen=True, kw_only=True)
class NeuralCurve(Checked, Equal):
    """Friction coefficient over slip, and over load and camber where the network has those inputs.

    Raises ParameterError if inputs and network do not fit together.

    Parameters
    ----------
    network : Network
        One output, the friction coefficient; inputs as named, in SI units.
    inputs : tuple of {"slip", "load", "camber"}
        What each input of the network is: slip ratio [-] or slip angle [rad], load [N], camber [rad].
    outside : {"hold", "extrapolate"}
        Beyond the range that the network's input scaling maps to -1..1, which is that of its training data, the
        friction stays what it is at the border, or the network is evaluated all the same.
    fit_info : FitInfo, optional
        How the network was fitted.
    """

    slip_alone: ClassVar[bool] = False

    network: Network
    inputs: tuple[CurveInput, ...] = ("slip",)
    outside: Literal["hold", "extrapolate"] = "hold"
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.inputs[:1] != ("slip",) or len(set(self.inputs)) != len(self.inputs):
            raise ParameterError(f"the inputs are {self.inputs}; expected 'slip' first and each at most once")
        if self.network.n_inputs != len(self.inputs) or self.network.n_outputs != 1:
            raise ParameterError(
                f"the network has {self.network.n_inputs} inputs and {self.network.n_outputs} outputs; expected "
                f"{len(self.inputs)} inputs ({', '.join(self.inputs)}) and 1 output, the friction coefficient"
            )

    def __call__(self, slip: Scalar, load: Scalar = 0.0, camber: Scalar = 0.0) -> Scalar:
        """Friction coefficient at a slip ratio [-] or slip angle [rad], load [N] and camber [rad]."""
        given = {"slip": slip, "load": load, "camber": camber}
        x = stack([given[name] for name in self.inputs])
        if is_symbolic(x) and self._folded is not None:
            return self._few_operations(x)
        if self.outside == "hold":
            scaling = self.network.input_scaling
            low, high = scaling.offset - np.abs(scaling.factor), scaling.offset + np.abs(scaling.factor)
            shape = (-1,) if is_symbolic(x) else (-1,) + (1,) * (x.ndim - 1)
            x = clip(x, low.reshape(shape), high.reshape(shape))
        return self.network(x)[0]

    @cached_property
    def _folded(self) -> list[tuple[np.ndarray, np.ndarray]] | None:
        """Layers of a perceptron for `_few_operations`: all scaling, also that of the activation, inside the weights.

        None for other networks.
        """
        net = self.network.perceptron
        if net is None or net.skip is not None or net.activation not in _AS_TANH or self.outside != "hold":
            return None
        before, after, offset = _AS_TANH[net.activation]
        layers, last, scale = [], len(net.weights) - 1, net.output_scaling
        for k, (w, b) in enumerate(zip(net.weights, net.biases, strict=True)):
            if k > 0:
                w, b = after * w, b + offset * w.sum(axis=1)
            outer, shift = (scale.factor, scale.offset) if k == last else (np.full(len(b), before), 0.0)
            layers.append((w * outer[:, None], b * outer + shift))
        return layers

    def _few_operations(self, x: Any) -> Any:
        """The network's pass for symbols, clipping included, in a form that needs few operations, its slope too."""
        layers, scaling = self._folded or [], self.network.input_scaling
        z = (x - ca.DM(scaling.offset)) * ca.DM(1 / scaling.factor)
        z = ca.if_else(fabs(z) < 1.0, z, ca.copysign(1.0, z))
        for w, b in layers[:-1]:
            z = tanh(matmul(w, z) + ca.DM(b))
        w, b = layers[-1]
        return (matmul(w, z) + ca.DM(b))[0]

    def tire(self, lateral: NeuralCurve, combined: Literal["none", "ellipse"]) -> NeuralTire:
        """Tire of this curve along and another across."""
        return NeuralTire(longitudinal=self, lateral=lateral, combined=combined)

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest slip of the training data."""
        scaling = self.network.input_scaling
        offset, half = float(scaling.offset[0]), abs(float(scaling.factor[0]))
        return offset - half, offset + half

    @cached_property
    def slip_of_peak(self) -> float:
        """Slip at which friction peaks, mean of both sides, at the middle of load and camber."""
        slip = np.linspace(0.0, 1.0, 2001)[1:]
        rest = dict(zip(self.inputs[1:], self.network.input_scaling.offset[1:], strict=True))
        peaks = [abs(end) * slip[int(np.argmax(np.abs(self(slip * end, **rest))))] for end in self.range]
        return float(np.mean(peaks))


@dataclass(frozen=True, kw_only=True)
class NeuralTire(Checked, Tire):
    """Tire whose friction coefficients are networks.

    Parameters
    ----------
    longitudinal, lateral : NeuralCurve
        Friction coefficient over slip ratio and over slip angle.
    combined : {"none", "ellipse"}
        ``"none"``: the directions do not see each other, as in [1]_. ``"ellipse"``: both curves are evaluated at the
        common slip, counted in slips of peak friction, and share its direction ([2]_).
    """

    longitudinal: NeuralCurve
    lateral: NeuralCurve
    combined: Literal["none", "ellipse"] = "none"

    @property
    def known_range(self) -> KnownRange:
        """That of the training data."""
        along, across = (min(abs(v) for v in curve.range) for curve in (self.longitudinal, self.lateral))
        if "load" not in self.lateral.inputs:
            return KnownRange(along, across)
        k, scaling = self.lateral.inputs.index("load"), self.lateral.network.input_scaling
        middle, half = float(scaling.offset[k]), abs(float(scaling.factor[k]))
        return KnownRange(along, across, usual=(middle - 0.9 * half, middle + 0.9 * half))

    def forces(
        self, slip_ratio: Scalar, slip_angle: Scalar, load: Scalar, *, camber: Scalar = 0.0, friction: Scalar = 1.0
    ) -> TireForces:
        """Friction coefficients times load."""
        k_x, k_y = self.longitudinal, self.lateral
        if self.combined == "none":
            mu_x, mu_y = k_x(slip_ratio, load, camber), k_y(slip_angle, load, camber)
        else:
            a, b = slip_ratio / k_x.slip_of_peak, slip_angle / k_y.slip_of_peak
            rho = sqrt(a * a + b * b + 1e-16)
            mu_x = _shared(k_x, a, rho, load, camber)
            mu_y = _shared(k_y, b, rho, load, camber)
        return TireForces(friction * load * mu_x, friction * load * mu_y)


def _shared(curve: NeuralCurve, part: Scalar, rho: Scalar, load: Scalar, camber: Scalar) -> Scalar:
    """Friction at the common slip on the side of ``part``, times its share; the offset at zero slip stays whole."""
    side: Any = where(part < 0, -1.0, 1.0)
    offset = curve(0.0 * rho, load, camber)
    return offset + (curve(side * rho * curve.slip_of_peak, load, camber) - offset) * (fabs(part) / rho)
