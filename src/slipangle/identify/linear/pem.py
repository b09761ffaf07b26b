"""Prediction-error refinement of a state space: Gauss-Newton with exact derivatives in local coordinates."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ParameterError
from slipangle.fields import Positive, Radius, Whole
from slipangle.identify.linear.estimator import described
from slipangle.identify.linear.left_out import left_out
from slipangle.identify.linear.poles import modulus
from slipangle.identify.linear.prediction import PredictionCriterion
from slipangle.identify.linear.prediction_covariance import covariance
from slipangle.identify.linear.predictor import Point, Work
from slipangle.identify.linear.scales import ScaledEstimator, Scales, weighed
from slipangle.identify.stability import SETTLED, noted
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.plausible import tenfold
from slipangle.numerics.blas import one_blas_thread

Focus = Literal["prediction", "simulation"]
Offsets = Literal["none", "output", "input", "both"]
_EDGE = 1e-6  # distance from a circle of an eigenvalue that is held on it
_WITHOUT = 2  # linearisations, whose work is left for the models without each group
_NEAR = 1e-6  # damping of the first step where the start is all but the minimum


@dataclass(frozen=True, kw_only=True)
class PEM(ScaledEstimator):
    """Levenberg-Marquardt on the one-step-ahead or the free-run error of a state space. [1]_ ch. 7.

    All of A, B, C, D, K is free. Changes of the state's basis, which change nothing outside, are kept out of every
    step: it moves orthogonally to them ([2]_, data-driven local coordinates). The derivatives are exact and the
    normal equations are never formed. Initial states of all experiments are estimated along.

    Where an unstable predictor would have the least one-step error, as over many experiments of few samples, the
    eigenvalues of A - K C are held at the modulus from which an error fades tenfold over the longest one, and the fit
    says so: only stable predictors are models ([1]_ sec. 4.5).

    Parameters
    ----------
    start : StateSpaceModel
        Where to start, usually from `Subspace`; D and K that are zero there stay zero unless asked for.
    focus : {"prediction", "simulation"}
        One-step-ahead error with K free, or free-run error with K = 0.
    offsets : {"none", "output", "input", "both"}
        Which levels at rest to estimate. "input" is what an integrator needs.
    direct : bool, optional
        Estimate D; by default where the start has one.
    weights : {"residual", "output"} or tuple of float
        How errors of several outputs are weighed: by the covariance of their residuals (maximum likelihood), each by
        the standard deviation of its signal, or each by the error given here, in the outputs' units.
    max_radius : float, optional
        Largest modulus of the poles, such as 1 for a stable model; by default not limited.
    max_iterations : int
        Steps at most.

    References
    ----------
    .. [1] L. Ljung, System Identification, 2nd ed., 1999.
    .. [2] T. McKelvey, A. Helmersson, T. Ribarits, Automatica 40, 2004.
    """

    start: StateSpaceModel
    focus: Focus = "prediction"
    offsets: Offsets = "none"
    direct: bool | None = None
    weights: Literal["residual", "output"] | tuple[Positive, ...] = "residual"
    max_radius: Radius | None = None
    max_iterations: Whole = 100

    _what = "the state space"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.weights, str) and len(self.weights) != self.start.n_outputs:
            raise ParameterError(
                f"weights are {self.weights}; expected {self.start.n_outputs} positive numbers, the typical error of "
                f"each of {', '.join(self.start.outputs)}"
            )

    @property
    def _has_constant(self) -> bool:
        return self.offsets != "none" or bool(np.any(self.start.y_offset) or np.any(self.start.u_offset))

    def _within(self, scales: Scales) -> PEM:
        return replace(self, start=scales.there(self.start), weights=weighed(self.weights, scales))

    @one_blas_thread()
    def _scaled_fit(self, data: Dataset) -> StateSpaceModel:
        began = time.perf_counter()
        problem = PredictionCriterion(self, data)
        point, notes = self._solved(problem)
        spread, sigma, said = covariance(problem, point)
        names, values = problem.named(point)
        error = "one-step-ahead" if self.focus == "prediction" else "free-run"
        info = described(
            data,
            began,
            names=names,
            values=values,
            covariance=spread,
            noise_std=sigma,
            n_samples=data.n_samples,
            method=f"{error} error, Levenberg-Marquardt with exact derivatives in data-driven local coordinates; "
            f"{said}, zero along changes of the state's basis",
            warnings=notes,
        )
        model = replace(self._of(point), fit_info=info)
        return noted(model, _memory_said(problem, point)) if self.focus == "prediction" else model

    @one_blas_thread()
    def refined(self, data: Dataset, tolerance: float, work: Work | None = None) -> StateSpaceModel:
        """The model of `fit` so far that a step would lower the squared error by less than a share; no intervals.

        ``work`` counts what that took, and ends it where it reaches its most.
        """
        point = self._roughly(PredictionCriterion(self, data, work), tolerance)
        return replace(self._of(point), fit_info=None)

    @one_blas_thread()
    def refined_without(
        self, groups: Sequence[Dataset], tolerance: float, far: bool, work: Work
    ) -> tuple[StateSpaceModel, list[StateSpaceModel], float]:
        """`refined` over all groups of experiments, and over all but each of them in turn; ``far`` as in `left_out`.

        Last comes the work that the first of them took. Unless they go ``far``, the others together take no more.
        """
        problem, most, before = PredictionCriterion(self, join(*groups), work), work.most, work.done
        work.most -= _WITHOUT * problem.step_work
        point = self._roughly(problem, tolerance)
        took = work.done - before
        work.most = most if far else min(most, work.done + max(took, _WITHOUT * problem.step_work))
        parts = left_out(problem, point, groups, tolerance=tolerance, far=far)
        whole, *without = (replace(self._of(p), fit_info=None) for p in (point, *parts))
        return whole, without, took

    @one_blas_thread()
    def finished(self, data: Dataset, work: Work | None = None) -> StateSpaceModel:
        """The model of `fit` from a start that is all but there; no intervals. ``work`` as in `refined`."""
        point, _ = self._solved(PredictionCriterion(self, data, work), _NEAR)
        return replace(self._of(point), fit_info=None)

    def _solved(self, problem: PredictionCriterion, damping: float = 1e-3) -> tuple[Point, tuple[str, ...]]:
        """The minimum and notes; one whose predictor is unstable is looked for again with that held."""
        weights = problem.root
        point, notes = problem.solve(self.max_iterations, damping=damping)
        if not (problem.prediction and self.max_iterations) or modulus(point.F) <= SETTLED:
            return point, notes
        problem.root, problem.radius = weights, _forgetting(problem.data)
        return problem.solve(self.max_iterations, damping=damping)

    def _roughly(self, problem: PredictionCriterion, tolerance: float) -> Point:
        """The same to a tolerance; predictors are stable on the way there too."""
        if not problem.prediction:
            return problem.solve(self.max_iterations, tolerance, rough=True)[0]
        problem.radius = 1.0
        point, _ = problem.solve(self.max_iterations, tolerance, rough=True)
        if modulus(point.F) < 1 - _EDGE:
            return point
        problem.point, problem.radius = point, _forgetting(problem.data)
        return problem.solve(self.max_iterations, tolerance, rough=True)[0]

    def _of(self, point: Point) -> StateSpaceModel:
        parts = {key: getattr(point, key) for key in ("C", "D", "K", "u_offset", "y_offset", "x0")}
        return replace(self.start, A=point.F + point.K @ point.C, B=point.G + point.K @ point.D, **parts)


def _forgetting(data: Dataset) -> float:
    """Modulus of an eigenvalue whose effect fades tenfold over the longest experiment."""
    return 0.1 ** (1 / data.n_longest)


def _memory_said(problem: PredictionCriterion, point: Point) -> str:
    """A sentence where errors of the one-step prediction grow, or are held from it; else empty."""
    size = modulus(point.F)
    if size > SETTLED:
        grown = f"so an error of its one-step prediction grows tenfold every {tenfold(size):.3g} samples"
        what = f"the predictor is unstable: A - K C has an eigenvalue of modulus {size:.6g}, {grown}"
    elif size > problem.radius * (1 - _EDGE):
        what = (
            "an unstable predictor follows these data best: the eigenvalues of A - K C were held at a modulus of "
            f"{size:.6g}, where an error fades tenfold over the longest experiment"
        )
    else:
        return ""
    return (
        f"{what}; expected them within the unit circle, where experiments that outlast the predictor's memory put "
        "them: record longer ones, lower the order, or use focus='simulation'"
    )
