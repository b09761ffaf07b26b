"""Friction curves from (slip, friction) data: Magic Formula, radial basis functions, perceptrons.

Every fit starts from random points drawn inside its bounds, knows nothing of the solution and returns the best of
them; see `slipangle.numerics.multistart`. Bounds default to tables 6.3 and 6.7 of [1]_.

References
----------
.. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023, secs. 4.3, 6.2.1, 6.3.1.
"""

from __future__ import annotations

import abc
import time
import warnings
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Generic, Literal, TypeVar, final

import casadi as ca
import numpy as np

from slipangle.errors import IdentifiabilityWarning, ParameterError
from slipangle.fields import Checked, Count
from slipangle.identify.tires.curve_data import Beside, checked_samples
from slipangle.models.black_box.networks import MLP, RBF, Activation, Kernel, Network, Scaling
from slipangle.models.model import FitInfo, ProfileInfo
from slipangle.models.tires.neural import CurveInput, NeuralCurve
from slipangle.models.tires.simple import MagicCurve
from slipangle.numerics.multistart import (
    Effort,
    Optimum,
    Regression,
    covariance,
    draw,
    ipopt,
    multistart,
    profile_interval,
)

C = TypeVar("C", MagicCurve, NeuralCurve)
Solver = Literal["least squares", "ipopt"]
Range = tuple[float, float]

# Table 6.7; E_low there is -12 like the others.
SOUSA_TABLE_6_7 = (
    MagicCurve(B=-12.0, C=-12.0, D=-12.0, E=-12.0, S_h=-0.2, S_v=-1.0),
    MagicCurve(B=12.0, C=12.0, D=12.0, E=12.0, S_h=0.2, S_v=1.0),
)
_CURVE_NAMES = ("B", "C", "D", "E", "S_h", "S_v")


@dataclass(frozen=True, kw_only=True)
class CurveFit(Checked, abc.ABC, Generic[C]):
    """Settings that every fit of a friction curve shares; ``slip_alone`` as of the curve that it fits.

    Parameters
    ----------
    solver : {"least squares", "ipopt"}
        Trust-region least squares, or the interior-point solver of the thesis on the same problem.
    """

    slip_alone = False
    _least = 1  # parameters that the samples must outnumber
    solver: Solver = "least squares"
    effort: Effort = field(default_factory=Effort)
    seed: int = 0

    @final
    def fit(self, slip: np.ndarray, friction: np.ndarray, *, load: Beside = None, camber: Beside = None) -> C:
        """The best curve found, with its ``fit_info``.

        Raises ExcitationError, TooShortError, UnitError, NotFiniteError or ParameterError if the data cannot determine
        a curve.

        Warns with IdentifiabilityWarning, with the coefficients that the data do not determine.

        Parameters
        ----------
        slip : array, shape (n_samples,)
            Slip ratio [-] or slip angle [rad], of both signs.
        friction : array, shape (n_samples,)
            Force over load. [-]
        load : array, shape (n_samples,), optional
            Vertical load, which then is an input of the network; a Magic Formula curve depends on slip alone. [N]
        camber : array, shape (n_samples,), optional
            Inclination, likewise. [rad]
        """
        if self.slip_alone and not (load is None and camber is None):
            raise ParameterError(
                "a Magic Formula curve depends on slip alone; expected no load and no camber: fit one curve per load, "
                "a network with load as input, or Magic Formula 6.1"
            )
        began = time.perf_counter()
        samples, target, inputs = checked_samples(slip, friction, load, camber, n_parameters=self._least)
        curve: Any = self._fit(samples, target, inputs)
        for note in curve.fit_info.warnings:
            warnings.warn(note, IdentifiabilityWarning, stacklevel=2)
        return replace(curve, fit_info=replace(curve.fit_info, seconds=time.perf_counter() - began))

    @abc.abstractmethod
    def _fit(self, samples: np.ndarray, target: np.ndarray, inputs: tuple[CurveInput, ...]) -> C:
        """Curve with its ``fit_info`` from checked samples."""

    def _solve(self, problem: Regression, lower: np.ndarray, upper: np.ndarray, starts: np.ndarray) -> Optimum:
        run = multistart if self.solver == "least squares" else ipopt
        return run(problem, lower, upper, starts, self.effort)

    def _method(self, solution: Optimum) -> str:
        how = "trust-region reflective" if self.solver == "least squares" else "Ipopt"
        return (
            f"bounded least squares ({how}) from {len(solution.costs)} random starts, best cost reached by "
            f"{solution.hits}"
        )


@dataclass(frozen=True, kw_only=True)
class MagicCurveFit(CurveFit[MagicCurve]):
    """Fit of the six coefficients of one Magic Formula curve. [1]_ eqs. 3-16, 3-17

    ``B`` and ``C`` of the result are not negative where the bounds allow it: turning both signs changes nothing.

    Parameters
    ----------
    lower, upper : MagicCurve
        Bounds, by default those of `SOUSA_TABLE_6_7` with B up to 100 per rad or unit slip and E down to -50.
    level : float, optional
        Confidence level of the intervals by profile likelihood: B, C and E trade off against each other along a bent
        valley, on which intervals from the covariance alone miss their level. None leaves them out.

    >>> slip = np.linspace(-0.2, 0.2, 81)
    >>> curve = MagicCurveFit().fit(slip, MagicCurve(B=12.0, C=1.6, D=1.1, E=0.3)(slip))
    >>> bool(abs(curve.D - 1.1) < 1e-6)
    True
    """

    slip_alone, _least = True, 6
    lower: MagicCurve = field(default=replace(SOUSA_TABLE_6_7[0], B=-100.0, E=-50.0))
    upper: MagicCurve = field(default=replace(SOUSA_TABLE_6_7[1], B=100.0))
    level: float | None = 0.95

    def _fit(self, samples: np.ndarray, target: np.ndarray, inputs: tuple[CurveInput, ...]) -> MagicCurve:
        problem = magic_regression(samples, target)
        lower, upper = (np.array([getattr(c, n) for n in _CURVE_NAMES]) for c in (self.lower, self.upper))
        if not np.all(lower < upper):
            name = _CURVE_NAMES[int(np.argmin(lower < upper))]
            raise ParameterError(f"the lower bound of {name} is not below its upper bound; expected lower < upper")
        low = lower.copy()
        low[:2] = np.where((lower[:2] < 0) & (upper[:2] > 0), 0.0, lower[:2])  # the other copies are the same curve
        starts = draw(low, upper, self.effort.starts, np.random.default_rng(self.seed), share=0.9)
        solution = _canonical(self._solve(problem, lower, upper, starts), lower, upper)
        settings: dict[str, Any] = {
            "names": _CURVE_NAMES,
            "values": solution.theta,
            "covariance": covariance(solution),
            "noise_std": np.array([np.std(solution.residual)]),
            "n_samples": len(samples),
            "units": ("-",) * 6,
        }
        info, how = FitInfo(**settings), "intervals from the covariance for white residuals"
        if self.level is not None:
            limits = [profile_interval(problem, solution, lower, upper, k, level=self.level) for k in range(6)]
            info = ProfileInfo(**settings, limits=np.array(limits), level=self.level)
            how = f"{100 * self.level:g} % intervals by profile likelihood"
        notes = _magic_warnings(info, lower, upper, converged=solution.converged)
        info = replace(info, method=f"{self._method(solution)}; {how}", warnings=notes)
        estimates: dict[str, Any] = dict(zip(_CURVE_NAMES, map(float, solution.theta), strict=True))
        return MagicCurve(**estimates, fit_info=info)


def magic_regression(samples: np.ndarray, target: np.ndarray) -> Regression:
    """Residuals of a Magic Formula curve over its six coefficients; samples and target of shape (n_samples, 1)."""
    x, theta = ca.SX.sym("x"), ca.SX.sym("theta", 6)
    symbols: dict[str, Any] = {name: theta[i] for i, name in enumerate(_CURVE_NAMES)}
    return Regression(MagicCurve(**symbols)(x), x, theta, samples=samples, target=target)


@dataclass(frozen=True, kw_only=True)
class NetworkCurveFit(CurveFit[NeuralCurve]):
    """Fit of a network to a friction curve; `RBFCurveFit` and `MLPCurveFit` say which.

    Inputs are scaled to -1..1 over the data; the output is the friction coefficient itself.
    """

    @abc.abstractmethod
    def network(self, scaling: Scaling) -> Network:
        """Any network of the architecture."""

    @abc.abstractmethod
    def bounds(self, network: Network) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bound of each parameter."""

    @property
    @abc.abstractmethod
    def label(self) -> str:
        """Such as ``"RBF {3}"``."""

    def n_parameters(self, n_inputs: int = 1) -> int:
        """Weights of the network."""
        return self.network(Scaling.none(n_inputs)).n_parameters

    def _fit(self, samples: np.ndarray, target: np.ndarray, inputs: tuple[CurveInput, ...]) -> NeuralCurve:
        network = self.network(Scaling.between(samples.min(axis=0), samples.max(axis=0)))
        lower, upper = self.bounds(network)
        x, theta = ca.SX.sym("x", len(inputs)), ca.SX.sym("theta", network.n_parameters)
        problem = Regression(network.with_parameters(theta)(x), x, theta, samples=samples, target=target)
        starts = draw(lower, upper, self.effort.starts, np.random.default_rng(self.seed))
        solution = self._solve(problem, lower, upper, starts)
        info = FitInfo(
            names=(),
            values=np.empty(0),
            covariance=np.empty((0, 0)),
            noise_std=np.array([np.sqrt(np.mean(solution.residual**2))]),
            n_samples=len(samples),
            method=f"{self.label}, {self._method(solution)}",
        )
        return NeuralCurve(network=network.with_parameters(solution.theta), inputs=inputs, fit_info=info)


@dataclass(frozen=True, kw_only=True)
class RBFCurveFit(NetworkCurveFit):
    """Radial basis functions: centres, widths and weights are free. [1]_ eqs. 4-15 to 4-19"""

    neurons: Count
    kernel: Kernel = "multiquadric"
    centre: Range = (-1.0, 1.0)  # bounds in scaled coordinates, those of table 6.3
    width: Range = (0.01, 7.0)
    weight: Range = (-80.0, 80.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        _rising(centre=self.centre, width=self.width, weight=self.weight)

    def network(self, scaling: Scaling) -> RBF:
        """Any network of the architecture."""
        n = self.neurons
        return RBF(
            centres=np.zeros((n, len(scaling.offset))),
            widths=np.ones(n),
            weights=np.ones((1, n)),
            kernel=self.kernel,
            input_scaling=scaling,
        )

    def bounds(self, network: Network) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bound of each parameter."""
        counts = (self.neurons * network.n_inputs, self.neurons, self.neurons)
        pairs = np.repeat(np.array([self.centre, self.width, self.weight]), counts, axis=0)
        return pairs[:, 0], pairs[:, 1]

    @property
    def label(self) -> str:
        """Such as ``"RBF {3}"``."""
        return f"RBF {{{self.neurons}}}"


@dataclass(frozen=True, kw_only=True)
class MLPCurveFit(NetworkCurveFit):
    """Perceptron with linear output. [1]_ eq. 4-20

    Parameters
    ----------
    hidden : tuple of int
        Neurons of each hidden layer.
    activation : {"sigmoid", "tanh", "elu"}
        Of the hidden layers. By default the hyperbolic tangent: with weights within table 6.3's bounds and inputs
        in -1..1 the logistic sigmoid is too flat for a tire (its RMSE on table 6.4's longitudinal curve stays
        above 0.35 for {1 1}), whereas the tangent gives the printed {1 1 1} to every digit.
    weight, bias : tuple of float
        Bounds in scaled coordinates; table 6.3 by default.
    """

    hidden: tuple[Count, ...]
    activation: Activation = "tanh"
    weight: Range = (-4.0, 4.0)
    bias: Range = (-4.0, 4.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.hidden:
            raise ParameterError("hidden is (); expected at least one layer, each with a neuron or more")
        _rising(weight=self.weight, bias=self.bias)

    def network(self, scaling: Scaling) -> MLP:
        """Any network of the architecture."""
        sizes = (len(scaling.offset), *self.hidden, 1)
        return MLP.random(sizes, activation=self.activation, input_scaling=scaling)

    def bounds(self, network: Network) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bound of each parameter."""
        sizes = (network.n_inputs, *self.hidden, 1)
        pairs = [
            pair for n_in, n_out in pairwise(sizes) for pair in [self.weight] * (n_in * n_out) + [self.bias] * n_out
        ]
        lower, upper = np.array(pairs).T
        return lower, upper

    @property
    def label(self) -> str:
        """Such as ``"MLP {2 2}"``."""
        return f"MLP {{{' '.join(map(str, self.hidden))}}}"


def _rising(**ranges: Range) -> None:
    for name, (low, high) in ranges.items():
        if not low < high:
            raise ParameterError(f"the bounds of {name} are {low:g} and {high:g}; expected the lower one first")


def _canonical(solution: Optimum, lower: np.ndarray, upper: np.ndarray) -> Optimum:
    """The same curve with B and C not negative, where the bounds hold that copy."""
    theta, sign = solution.theta, np.ones(6)
    if theta[0] < 0:  # B and C, or B and D
        sign[[0, 1 if theta[1] < 0 else 2]] = -1.0
    elif theta[1] < 0:
        sign[[1, 2]] = -1.0
    if np.any(sign * theta < lower) or np.any(sign * theta > upper):
        return solution
    return solution._replace(theta=sign * theta, jacobian=solution.jacobian * sign)


def _magic_warnings(info: FitInfo, lower: np.ndarray, upper: np.ndarray, *, converged: bool) -> tuple[str, ...]:
    said = []
    for k, (name, value, ends) in enumerate(zip(info.names, info.values, info.interval(), strict=True)):
        span = upper[k] - lower[k]
        size = max(abs(value), 0.1 * span if name in ("E", "S_h", "S_v") else 0.0)
        if not ends[1] - ends[0] <= 2 * size:
            said.append(
                f"the data do not determine {name}: {value:.4g}, 95 % interval {ends[0]:.4g} to {ends[1]:.4g}; "
                "expected a narrower one: sweep further beyond the peak, or narrow the bounds"
            )
        elif min(value - lower[k], upper[k] - value) < 1e-4 * span:
            said.append(
                f"{name} ends at its bound, {value:.4g}; expected an interior optimum: widen the bounds, or check "
                "units and signs"
            )
    if not converged:
        said.append("the fit stopped at its budget; expected convergence: raise effort.finish")
    return tuple(said)
