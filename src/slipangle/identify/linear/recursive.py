"""ARX models estimated one sample at a time: recursive least squares with forgetting that does not wind up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import NotFiniteError, ParameterError, SimulationError, nearest, shown
from slipangle.fields import Count, Whole, Within
from slipangle.identify.excitation import require_identifiable, require_independent
from slipangle.identify.linear.estimator import LinearEstimator
from slipangle.identify.linear.lags import same_for_all
from slipangle.identify.linear.recursive_code import LARGEST, Recursion
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.model import FitInfo
from slipangle.models.provenance import provenance

Forget = Literal["directional", "everywhere"]


@dataclass(frozen=True, kw_only=True)
class RLS(LinearEstimator[ARXModel]):
    """Recursive least squares for an ARX model. [1]_ sec. 11.2.

    `start` or `follow` gives a `RecursiveARX` that takes one sample at a time; `fit` runs through a whole record
    and warns of coefficients that are still about as uncertain as at the start.

    Old data are forgotten by a factor per sample. Plain exponential forgetting winds up: while the car drives straight,
    information is lost and none comes in, the covariance grows exponentially, and the next bend throws the estimate
    off. Three things prevent that: information is forgotten along the present regressors only ([2]_), so what is not
    excited is kept; a sample that says next to nothing, because its prediction is much surer than in steady tracking,
    is left out (sensor noise on a straight road); and the covariance never passes that of the start ([3]_).

    Parameters
    ----------
    na, nb : int
        Past outputs and past inputs used, at least 1.
    nk : int
        Samples from input to output; 0 where the output depends on the input at the same sample.
    offset : bool
        Estimate a constant too.
    forgetting : float
        Weight of a sample per sample of age, above 0 and at most 1; 1 forgets nothing and gives batch least squares.
        Data older than ``1 / (1 - forgetting)`` samples matter little.
    forget : {"directional", "everywhere"}
        Along the present regressors: a sample multiplies the variance of its own prediction by ``forgetting`` to the
        power of minus the number of regressors, so that evenly excited data are forgotten as fast as by the other way:
        all directions alike, a sample multiplies the covariance by ``1 / forgetting``.
    threshold : float
        A sample whose prediction has less than this share of the variance in steady tracking is left out; 0 for none.
        That variance is the number of regressors times ``1 - forgetting`` times the noise's.
    prior : float or sequence of float
        Variance of the coefficients at the start, in units of the noise variance, one or one per regressor; large
        where nothing is known. The sum of the variances divided by it never passes the number of regressors.

    References
    ----------
    .. [1] L. Ljung, System Identification, 2nd ed., 1999.
    .. [2] R. Kulhavy, Automatica 23, 1987, pp. 589-600: restricted exponential forgetting.
    .. [3] S. Bittanti, P. Bolzern, M. Campi, Automatica 26, 1990, pp. 929-932: why [2]_ needs a bound.
    """

    na: Count
    nb: Count
    nk: Whole = 1
    offset: bool = False
    forgetting: Annotated[float, Within(0, 1, open="low", example="0.99")] = 0.99
    forget: Forget = "directional"
    threshold: Annotated[float, Within(0, example="0.05")] = 0.05
    prior: float | Sequence[float] = 1e12

    _what = "the recursive ARX model"

    def __post_init__(self) -> None:
        same_for_all(self, "nb", "nk")
        super().__post_init__()
        prior = np.atleast_1d(np.asarray(self.prior, dtype=float))
        if prior.ndim != 1 or not (np.isfinite(prior).all() and (prior > 0).all()):
            raise ParameterError(f"prior is {self.prior}; expected positive variances, such as 1e12 for nothing known")

    def start(self, *, inputs: Sequence[str], outputs: Sequence[str], dt: float) -> RecursiveARX:
        """An estimate of zero that is as uncertain as `prior` says.

        ``inputs`` and ``outputs`` are channel names, ``dt`` is the sample time. [s] Raises ParameterError if there is
        none of them, or the sample time is not positive.
        """
        inputs = (inputs,) if isinstance(inputs, str) else tuple(inputs)
        outputs = (outputs,) if isinstance(outputs, str) else tuple(outputs)
        if not inputs or not outputs:
            raise ParameterError(
                f"inputs are {list(inputs)} and outputs {list(outputs)}; expected at least one name of each"
            )
        if not dt > 0:
            raise ParameterError(f"the sample time is {dt} s; expected a positive number")
        return RecursiveARX(self, inputs, outputs, float(dt))

    def follow(self, model: ARXModel) -> RecursiveARX:
        """An estimate that starts at a model, as uncertain as its ``fit_info`` says, else as `prior` says.

        Raises ParameterError if the model has other lags.
        """
        wanted, got = (self.na, self.nb, self.nk), (model.na, model.nb, model.nk)
        constant = bool(np.any(model.c))
        if wanted != got or (constant and not self.offset):
            raise ParameterError(
                f"the model has na, nb, nk = {got}{' and a constant' if constant else ''}; expected "
                f"{wanted}{' and' if self.offset else ' without'} a constant: make RLS with the model's lags"
            )
        tracker = self.start(inputs=model.inputs, outputs=model.outputs, dt=model.dt)
        tracker._take(model)
        return tracker

    def _fit(self, data: Dataset) -> ARXModel:
        require_identifiable(data, self.na * len(data.outputs) + self.nb * len(data.inputs) + self.offset)
        require_independent(data)
        estimate = self.start(inputs=data.inputs, outputs=data.outputs, dt=data.dt)
        estimate.run(data)
        model = estimate.model()
        return replace(model, fit_info=replace(model.fit_info, **provenance(data)))  # type: ignore[type-var]


@dataclass(frozen=True, kw_only=True)
class RecursiveRun:
    """How the estimate went over a record."""

    t: np.ndarray  # (n_samples,), time [s]
    theta: np.ndarray  # (n_samples, n_coefficients), coefficients after each sample, in the order of `names`
    # (n_samples, n_outputs), measured minus predicted output, before the sample changed the estimate; zero while the
    # lags fill
    error: np.ndarray
    names: tuple[str, ...]  # the coefficients; those of past outputs have the sign of the equation solved for y

    def parameter(self, name: str) -> np.ndarray:
        """One coefficient over time, shape (n_samples,).

        Raises ParameterError if there is none of this name.
        """
        if name not in self.names:
            raise ParameterError(f"there is no coefficient '{name}'; {nearest(name, self.names)}: use one of these")
        return self.theta[:, self.names.index(name)]


class RecursiveARX:
    """An ARX estimate that takes one sample at a time; made by `RLS.start` or `RLS.follow`.

    ``settings`` are those of the `RLS`. Raises ParameterError if these do not fit the channels.

    `update` allocates nothing: C, or CasADi's virtual machine without a compiler, works on arrays that are made here.
    """

    def __init__(self, settings: RLS, inputs: tuple[str, ...], outputs: tuple[str, ...], dt: float) -> None:
        self.settings, self.inputs, self.outputs, self.dt = settings, inputs, outputs, dt
        s, ny, nu = settings, len(outputs), len(inputs)
        past_y = [i * ny + o for i in range(s.na) for o in range(ny)]
        past_u = [s.na * ny + j * nu + i for j in range(s.nk, s.nk + s.nb) for i in range(nu)]
        reach = s.nb + s.nk  # present input included
        pick = past_y + past_u + ([s.na * ny + reach * nu] if s.offset else [])
        prior = np.asarray(s.prior, dtype=float)
        if prior.ndim and len(prior) not in (1, len(pick)):
            raise ParameterError(
                f"prior has {len(prior)} variances; expected one, or {len(pick)}: one per regressor "
                f"({', '.join(self._labels[:4])}, ...)"
            )
        self._recursion = Recursion(
            tuple(pick),
            np.broadcast_to(prior, len(pick)),
            (ny, nu, s.na, reach),
            memory=max(s.na, reach - 1),
            forgetting=s.forgetting,
            threshold=s.threshold * len(pick) * (1.0 - s.forgetting),
            directional=s.forget == "directional",
        )
        self._y, self._u, self._advance = self._recursion.y, self._recursion.u, self._recursion.advance
        self._error, self._single = self._recursion.error, ny == nu == 1

    def update(self, y: float | np.ndarray, u: float | np.ndarray) -> np.ndarray:
        """Take in the outputs and inputs measured at one sample.

        Raises ParameterError if there are not as many numbers as channels, NotFiniteError if one is not finite, and
        SimulationError if one is so large that the estimate would leave the finite numbers: it is as before in each
        case, and after the last the lags fill anew. Call `restart` if samples are missing.

        Parameters
        ----------
        y, u : float or array, shapes (n_outputs,), (n_inputs,)
            In the order of `outputs` and `inputs`.

        Returns
        -------
        array, shape (n_outputs,)
            Measured minus predicted output, before this sample changed the estimate; zero while the lags fill. The
            same array at every call: copy what is to be kept.
        """
        if not self._single:
            self._check(y, u)
        try:
            self._y[...] = y
            self._u[...] = u
        except (ValueError, TypeError):
            self._check(y, u)
            raise ParameterError(
                f"the sample holds y = {shown(y)}, u = {shown(u)}; expected numbers: one for each of "
                f"{', '.join((*self.outputs, *self.inputs))}"
            ) from None
        if code := self._advance():
            self._refuse(code, y, u)
        return self._error

    def _refuse(self, code: int, y: float | np.ndarray, u: float | np.ndarray, which: str = "the sample") -> None:
        holds = f"{which} holds y = {np.array(y).tolist()}, u = {np.array(u).tolist()}"
        if code == 1:
            raise NotFiniteError(f"{holds}; expected finite numbers: leave the sample out and call restart()")
        raise SimulationError(
            f"{holds}, which takes the estimate out of the finite numbers; expected measurements, at most {LARGEST:g} "
            "each: leave the sample out; the estimate is as before, and the lags fill anew"
        )

    def _check(self, y: float | np.ndarray, u: float | np.ndarray) -> None:
        for value, names, what in ((y, self.outputs, "outputs"), (u, self.inputs, "inputs")):
            if np.size(value) != len(names):
                raise ParameterError(f"a sample has {np.size(value)} {what}; expected {len(names)}: {', '.join(names)}")

    def restart(self) -> None:
        """Forget the lags but not the estimate: after a gap the next samples fill the lags first."""
        self._recursion.arrays["filled"][:] = 0

    def run(self, data: Dataset) -> RecursiveRun:
        """Take in all samples of a record, one experiment after the other, and say how the estimate went.

        Raises SampleTimeError or MissingColumnError if the data have another sample time or other channels, and
        SimulationError at a sample that `update` refuses; those before it have been taken in.
        """
        data.require_dt(self.dt)
        for name in (*self.inputs, *self.outputs):
            data.index(name)
        chosen = data.select(inputs=self.inputs, outputs=self.outputs)
        parts = []
        for part in chosen.experiments:
            self.restart()
            parts.append(self._recursion.advance_many(part.y, part.u))
            if (k := len(parts[-1][0])) < part.n_samples:
                at = sum(len(errors) for errors, _ in parts)
                self._refuse(2, part.y[k], part.u[k], f"sample {at} of '{data.name}'")
        error, theta = (np.concatenate(rows) for rows in zip(*parts, strict=True))
        return RecursiveRun(t=data.t, theta=theta, error=error, names=self.names)

    # ---- what is known now -------------------------------------------------------------------------------------

    @property
    def n_outputs(self) -> int:
        """How many outputs there are."""
        return len(self.outputs)

    @property
    def n_samples(self) -> int:
        """Samples that the estimate has learned from."""
        return int(self._recursion.arrays["updates"][0])

    @property
    def memory(self) -> int:
        """Samples that fill the lags before the first is learned from."""
        return self._recursion.memory

    @property
    def _labels(self) -> tuple[str, ...]:
        s = self.settings
        past_y = [f"{o}(k-{i})" for i in range(1, s.na + 1) for o in self.outputs]
        past_u = [f"{n}(k-{j})" if j else f"{n}(k)" for j in range(s.nk, s.nk + s.nb) for n in self.inputs]
        return (*past_y, *past_u, *(("1",) if s.offset else ()))

    @property
    def names(self) -> tuple[str, ...]:
        """The coefficients, all of one output before those of the next."""
        return tuple(f"{o}: {label}" if self.n_outputs > 1 else label for o in self.outputs for label in self._labels)

    @property
    def theta(self) -> np.ndarray:
        """Coefficients, shape (n_coefficients,), in the order of `names`; a copy."""
        return self._recursion.theta.flatten()

    @property
    def noise_covariance(self) -> np.ndarray:
        """Covariance of the outputs' one-step-ahead errors, shape (n_outputs, n_outputs), over the same memory."""
        return self._recursion.noise.copy()

    @property
    def gram_inverse(self) -> np.ndarray:
        """Inverse of the weighted information, shape (n, n) for n regressors.

        Without forgetting it is the covariance of one output's coefficients in units of its noise variance.
        """
        return self._recursion.covariance

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of `theta`, given white errors and coefficients that stay; shape (n_coefficients, n_coefficients).

        With forgetting it is less than `gram_inverse` times the noise's, about half of it where data are evenly
        excited: samples count by their weight, the errors in them by its square.
        """
        return np.kron(self.noise_covariance, self._recursion.scatter)

    def model(self) -> ARXModel:
        """The present estimate as a model, with its covariance."""
        s, ny, nu = self.settings, self.n_outputs, len(self.inputs)
        theta = self._recursion.theta.copy()
        split = s.na * ny
        info = FitInfo(
            names=self.names,
            values=theta.ravel(),
            covariance=self.covariance,
            noise_std=np.sqrt(np.diag(self.noise_covariance)),
            n_samples=self.n_samples,
            units=("-",) * theta.size,
            method=f"recursive least squares, forgetting {s.forgetting:g}; covariance for white residuals",
            warnings=self._undetermined(),
        )
        return ARXModel(
            A=-theta[:, :split].reshape(ny, s.na, ny).transpose(1, 0, 2),
            B=theta[:, split : split + s.nb * nu].reshape(ny, s.nb, nu).transpose(1, 0, 2),
            c=theta[:, -1] if s.offset else np.zeros(ny),
            nk=s.nk,
            dt=self.dt,
            inputs=self.inputs,
            outputs=self.outputs,
            fit_info=info,
        )

    def _undetermined(self) -> tuple[str, ...]:
        """A sentence that names the coefficients whose variance has hardly shrunk."""
        share = np.diag(self.gram_inverse) / self._recursion.prior
        open_ = [label for label, left in zip(self._labels, share, strict=True) if left > 1e-3]
        if not open_:
            return ()
        return (
            f"the samples so far do not determine the coefficients of {', '.join(open_)}: they are about as uncertain "
            "as at the start; expected richer excitation, fewer lags, or a smaller prior",
        )

    def _take(self, model: ARXModel) -> None:
        """Start at a model."""
        ny, theta = self.n_outputs, self._recursion.theta
        parts = [-model.A.transpose(1, 0, 2).reshape(ny, -1), model.B.transpose(1, 0, 2).reshape(ny, -1)]
        theta[:] = np.hstack([*parts, model.c[:, None]] if self.settings.offset else parts)
        info, n = model.fit_info, len(self._labels)
        if info is None or info.covariance.shape != (theta.size, theta.size) or not info.noise_std[0] > 0:
            return
        self._recursion.covariance = info.covariance[:n, :n] / info.noise_std[0] ** 2
        self._recursion.noise[:] = np.diag(info.noise_std**2)
        memory = info.n_samples - n
        s = self.settings
        self._recursion.arrays["weight"][:] = min(memory, 1 / (1 - s.forgetting)) if s.forgetting < 1 else memory
