"""ARMAX, output-error and Box-Jenkins models by prediction error."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.fields import Count, Radius, Whole
from slipangle.identify.excitation import require_identifiable
from slipangle.identify.linear.colour import shared_colour_said
from slipangle.identify.linear.estimator import LinearEstimator, described
from slipangle.identify.linear.polynomial_search import Layout, Structured
from slipangle.identify.linear.polynomial_start import first_guess
from slipangle.identify.linear.polynomial_unstable import better_unstable
from slipangle.identify.linear.prediction_covariance import covariance
from slipangle.identify.stability import held, noted
from slipangle.models.black_box.polynomial import PolynomialModel
from slipangle.numerics.blas import one_blas_thread

_SPLIT = "; F has roots outside the unit circle, which are those of A here, and mirrored those of C too"
_MORE = "give more coefficients (nc, na), or use OutputError, BoxJenkins or StateSpace"


@dataclass(frozen=True, kw_only=True)
class Polynomial(LinearEstimator[PolynomialModel]):
    """``A(z) y = sum_i B_i(z) / F_i(z) u_i + C(z) / D(z) e`` by the one-step-ahead error.

    Starts from a long ARX model, then Levenberg-Marquardt with exact derivatives; the initial state of every
    experiment is estimated along ([1]_). One output, any number of inputs.

    Parameters
    ----------
    na, nc, nd : int
        Coefficients of A, C, D after the leading 1.
    nb, nf : int or tuple of int
        Coefficients of each input's B and F.
    nk : int or tuple of int
        Samples from each input to the output; 0 where the output depends on the input at the same sample.
    offset : bool
        Estimate the output's level at the inputs' means; for data whose means were not removed.
    max_radius : float, optional
        Largest modulus of the poles of system and disturbance, such as 1 for a stable model.
    max_iterations : int
        Steps at most.

    With F and without A and ``max_radius``, roots of F outside the unit circle, as of an unstable system under control,
    are looked for where a long ARX model has one: they are those of the model's A then, and mirrored those of C, which
    makes the predictor stable ([2]_). All inputs share them.

    References
    ----------
    .. [1] L. Ljung, System Identification, 2nd ed., 1999, ch. 4, 7.
    .. [2] U. Forssell, L. Ljung, Identification of unstable systems using output error and Box-Jenkins model
       structures, IEEE Transactions on Automatic Control 45, 2000.
    """

    na: Whole = 0
    nb: Count | tuple[Count, ...] = 1
    nc: Whole = 0
    nd: Whole = 0
    nf: Whole | tuple[Whole, ...] = 0
    nk: Whole | tuple[Whole, ...] = 1
    offset: bool = False
    max_radius: Radius | None = None
    max_iterations: Whole = 100

    _what = "the polynomial model"

    def _remarks(self, model: PolynomialModel, data: Dataset) -> tuple[str, ...]:
        return shared_colour_said(model, data, _MORE) if len(model.A) else ()

    @one_blas_thread()
    def _fit(self, data: Dataset) -> PolynomialModel:
        began = time.perf_counter()
        if len(data.outputs) != 1:
            raise ParameterError(
                f"'{data.name}' has the outputs {', '.join(data.outputs) or 'none'}; expected one: fit one at a time "
                "with data.select(outputs=[...]), or use ARX or StateSpace"
            )
        layout = Layout(self, data)
        if any(layout.nf) and (self.max_radius or 0.0) > 1:
            raise ParameterError(
                f"max_radius is {self.max_radius:g}; expected at most 1 with an F, as the free-run error of an "
                "unstable system says nothing: leave it out, or take ARX or ARMAX"
            )
        require_identifiable(data, layout.count)
        u0 = np.array([data[n].mean() for n in data.inputs]) if self.offset else np.zeros(len(data.inputs))
        y0 = float(data[data.outputs[0]].mean()) if self.offset else 0.0
        later, led = layout.waiting(data)
        theta = first_guess(self, later.nb, later.nf, later.nk, led, u0, y0)
        problem = Structured(self, later, later.model(theta, led, u0, y0), theta, led)
        point, notes = problem.solve(self.max_iterations)
        within = self
        if found := better_unstable(self, later, (problem, point), led, u0, y0):
            problem, point, within, notes = found
            layout = Layout(replace(within, nk=self.nk), data)
        coefficients = problem.theta_of(point)
        spread, sigma, said = covariance(problem, point)
        names = layout.names(data) + ((f"y_offset[{data.outputs[0]}]",) if self.offset else ())
        info = described(
            data,
            began,
            names=names,
            values=np.concatenate([coefficients, point.y_offset]) if self.offset else coefficients,
            covariance=spread,
            noise_std=sigma,
            n_samples=led.n_samples,
            method=f"one-step-ahead error, Levenberg-Marquardt with exact derivatives from a long ARX model; {said}"
            + _SPLIT * (within is not self),
            warnings=notes,
        )
        model = replace(layout.model(coefficients, data, u0, float(point.y_offset[0])), fit_info=info)
        if within is not self:
            return model
        return noted(model, held(model.poles, 1.0 if any(layout.nf) and self.max_radius is None else self.max_radius))


@dataclass(frozen=True, kw_only=True)
class _Special(LinearEstimator[PolynomialModel]):
    """A `Polynomial` by its own name.

    Parameters
    ----------
    nb : int or tuple of int
        Coefficients of each input's B.
    nk : int or tuple of int
        Samples from each input to the output; 0 where the output depends on the input at the same sample.
    offset : bool
        Estimate the output's level at the inputs' means; for data whose means were not removed.
    max_radius : float, optional
        Largest modulus of the poles of system and disturbance, such as 1 for a stable model.
    """

    nb: Count | tuple[Count, ...] = 2
    nk: Whole | tuple[Whole, ...] = 1
    offset: bool = False
    max_radius: Radius | None = None

    _what = "the polynomial model"

    def _fit(self, data: Dataset) -> PolynomialModel:
        return Polynomial(**vars(self))._fit(data)

    def _remarks(self, model: PolynomialModel, data: Dataset) -> tuple[str, ...]:
        return Polynomial(**vars(self))._remarks(model, data)


@dataclass(frozen=True, kw_only=True)
class ARMAX(_Special):
    """``A(z) y = sum_i B_i(z) u_i + C(z) e``: the disturbance shares the system's poles. See `Polynomial`.

    Parameters
    ----------
    na, nc : int
        Coefficients of A, C after the leading 1.
    """

    na: Whole = 2
    nc: Whole = 1


@dataclass(frozen=True, kw_only=True)
class OutputError(_Special):
    """``y = sum_i B_i(z) / F_i(z) u_i + e``: the free-run error is minimised. See `Polynomial`.

    Parameters
    ----------
    nf : int or tuple of int
        Coefficients of each input's F after the leading 1.
    """

    nf: Whole | tuple[Whole, ...] = 2


@dataclass(frozen=True, kw_only=True)
class BoxJenkins(_Special):
    """``y = sum_i B_i(z) / F_i(z) u_i + C(z) / D(z) e``: system and disturbance apart. See `Polynomial`.

    Parameters
    ----------
    nc, nd : int
        Coefficients of C, D after the leading 1.
    nf : int or tuple of int
        Coefficients of each input's F after the leading 1.
    """

    nc: Whole = 1
    nd: Whole = 1
    nf: Whole | tuple[Whole, ...] = 2
