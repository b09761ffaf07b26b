"""ARX by least squares."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from slipangle.data.dataset import Dataset
from slipangle.errors import ExcitationError, ParameterError, TooShortError
from slipangle.fields import Count, Whole
from slipangle.identify.excitation import require_identifiable, require_independent
from slipangle.identify.linear.colour import colour_said
from slipangle.identify.linear.estimator import LinearEstimator, channels, described
from slipangle.identify.linear.lags import PerInput, Windows, triangle
from slipangle.identify.linear.orders import Chosen, choose
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.linear.statespace_unstable import stable_by_free_runs
from slipangle.identify.stability import noted
from slipangle.models.black_box.arx import ARXModel

_APART = 1e-3  # share of an input's RMS that the others do not make up, below which their effects are one
_TRIED = 10  # orders that are fitted to all data where the better ones depend on each other
_STATES = 4  # of a model one step ahead that is asked whether a system is unstable: too few hang on rounding


@dataclass(frozen=True, kw_only=True)
class ARX(LinearEstimator[ARXModel]):
    """Least-squares ARX estimator.

    The Gram matrix of the regressors is built from lag products, one per lag difference, with the products at both
    ends of each experiment taken off exactly; where it is ill-conditioned, or the residual is too small for it, a
    QR factorisation made block by block takes over. Neither stores the regressors.

    Parameters
    ----------
    na : int or "chosen"
        Past outputs used, at least 1.
    nb : int, tuple of int or "chosen"
        Coefficients of every input, or of each, at least 1.
    nk : int, tuple of int or "chosen"
        Samples from every input, or from each, to the outputs; 0 where they depend on the input at the same sample.
        Orders that are not given are chosen by free run over stretches held out in turn: up to 10 lags, delays of up to
        about 100 samples, 0 only where the data tell of it and the inputs do not answer the outputs, see
        `slipangle.identify.linear.delays.first_effects`; the model's ``fit_info.candidates`` are all that were
        compared. Of an unstable system, held by a controller, free runs make a stable model, which is said.
    offset : bool
        Estimate a constant too; for data whose mean was not removed.

    Where the one-step-ahead residual is coloured, the coefficients are biased, and ``fit_info.warnings`` says so.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eqs. 4-5 to 4-9.
    """

    na: Count | Chosen = "chosen"
    nb: Count | tuple[Count, ...] | Chosen = "chosen"
    nk: Whole | tuple[Whole, ...] | Chosen | None = None
    offset: bool = False

    _what = "the ARX model"

    def __post_init__(self) -> None:
        if self.nk is None:
            object.__setattr__(self, "nk", "chosen" if "chosen" in (self.na, self.nb) else 1)
        super().__post_init__()

    def _fit(self, data: Dataset) -> ARXModel:
        return self._of_orders(data) if "chosen" not in (self.na, self.nb, self.nk) else self._chosen(data)

    def _chosen(self, data: Dataset) -> ARXModel:
        """The fit of the orders that did best; where all data cannot tell its regressors apart, of the next ones."""
        began = time.perf_counter()
        require_identifiable(data, len(data.outputs) + len(data.inputs) + self.offset)
        require_independent(data)  # else the choice would share one effect among lags of several inputs
        given: Any = {n: per_input(v, n, data) if isinstance(v, int | tuple) else v for n, v in self._per_input}
        choice = choose(data, na=self.na, offset=self.offset, direct=True, **given)
        refused: ExcitationError | None = None
        for orders, _ in choice.ranked[:_TRIED]:
            try:
                model = replace(self, na=orders.na, nb=orders.nb, nk=orders.nk)._of_orders(data)
            except ExcitationError as error:
                refused = refused or error
                continue
            info: Any = model.fit_info
            method, seconds = f"{choice.said(orders)}; {info.method}", time.perf_counter() - began
            model = replace(model, fit_info=replace(info, candidates=choice.candidates, method=method, seconds=seconds))
            return noted(model, unstable_said(model.poles, data, self.offset))
        raise refused or ParameterError("no orders were compared")

    def _remarks(self, model: ARXModel, data: Dataset) -> tuple[str, ...]:
        return colour_said(model, data)

    @property
    def _per_input(self) -> tuple[tuple[str, Any], ...]:
        return (("nb", self.nb), ("nk", self.nk))

    def _of_orders(self, data: Dataset) -> ARXModel:
        began, na = time.perf_counter(), int(self.na)
        ny, nu = len(data.outputs), len(data.inputs)
        used = self._used(data)
        require_identifiable(data, na * ny + len(used) + self.offset)
        regression = _Regression(self, data, used)
        labels = self._labels(data, used)
        theta, inverse, sigma, solver = regression.solve(labels)
        if self.offset:  # the signals were shifted by their means
            theta[-1] = regression.constant(theta)
        info = described(
            data,
            began,
            names=tuple(f"{o}: {label}" if ny > 1 else label for o in data.outputs for label in labels),
            values=theta.T.ravel(),
            covariance=np.kron(sigma, regression.unshifted(inverse)),
            noise_std=np.sqrt(np.diag(sigma)),
            n_samples=regression.count,
            method=f"least squares on the one-step-ahead error, {solver}; covariance for white residuals",
            warnings=regression.confused(theta, np.outer(np.diag(inverse), np.diag(sigma))),
        )
        A = -theta[: na * ny].T.reshape(ny, na, ny).transpose(1, 0, 2)
        first, last = used[0][0], used[-1][0]
        B = np.zeros((last - first + 1, ny, nu))
        for (lag, i), row in zip(used, theta[na * ny :], strict=False):
            B[lag - first, :, i] = row
        return ARXModel(
            A=A, B=B, c=theta[-1] if self.offset else np.zeros(ny), nk=first, **channels(data), fit_info=info
        )

    def _used(self, data: Dataset) -> list[tuple[int, int]]:
        """Lag and number of every input that is a regressor, smallest lag first."""
        counts, delays = (per_input(getattr(self, name), name, data) for name in ("nb", "nk"))
        wanted = int(self.na) * len(data.outputs) + sum(counts)
        if max(wanted, *(n + k for n, k in zip(counts, delays, strict=True)), 0) > data.n_samples:
            raise TooShortError(
                f"'{data.name}' has {data.n_samples} samples for {wanted} parameters per output and delays up to "
                f"{max(delays)}; expected more samples than either: record longer or choose fewer lags"
            )
        lags = [(lag, i) for i, (n, k) in enumerate(zip(counts, delays, strict=True)) for lag in range(k, k + n)]
        return sorted(lags)

    def _labels(self, data: Dataset, used: list[tuple[int, int]]) -> list[str]:
        past_y = [f"{o}(k-{i})" for i in range(1, int(self.na) + 1) for o in data.outputs]
        past_u = [f"{data.inputs[i]}(k-{lag})" if lag else f"{data.inputs[i]}(k)" for lag, i in used]
        return past_y + past_u + (["1"] if self.offset else [])


def per_input(value: PerInput, name: str, data: Dataset) -> tuple[int, ...]:
    """One number for each input of the data.

    Raises ParameterError if there is another count of numbers than of inputs.

    ``name`` says what it is, for the sentence.
    """
    given = (value,) * len(data.inputs) if isinstance(value, int) else tuple(value)
    if len(given) != len(data.inputs):
        raise ParameterError(
            f"{name} has {len(given)} entries for the inputs {', '.join(data.inputs)}; expected one number, or one per "
            "input"
        )
    return given


class _Regression:
    """Normal equations of one fit, or the triangular factor where those would lose digits."""

    def __init__(self, settings: ARX, data: Dataset, used: list[tuple[int, int]]) -> None:
        na = int(settings.na)
        self.na, self.offset, self.data, self.used = na, settings.offset, data, used
        self.gram = np.empty((0, 0))  # of the regressors scaled to one length, then the targets; made by `solve`
        self.ny = len(data.outputs)
        names = tuple(dict.fromkeys((*data.outputs, *data.inputs)))
        # in file order where possible: contiguous columns are read without gathering
        names = tuple(sorted(names, key=data.index))
        m, nc = max(na, used[-1][0]), len(names)
        self.shift = np.array([data[n].mean() for n in names]) if settings.offset else None
        self.windows = Windows(data=data, names=names, lags=m + 1, shift=self.shift)
        self.count = self.windows.count
        if self.count == 0:
            raise TooShortError(
                f"no experiment of '{data.name}' is longer than the {m} samples that the lags reach back; expected a "
                "longer one: record without gaps or choose fewer lags"
            )
        y, u = [names.index(n) for n in data.outputs], [names.index(n) for n in data.inputs]
        self.columns = [(m - i) * nc + c for i in range(1, na + 1) for c in y]
        self.columns += [(m - lag) * nc + u[i] for lag, i in used]
        self.targets = [m * nc + c for c in y]
        self.y_mean = self.shift[y] if self.shift is not None else np.zeros(self.ny)
        self.u_mean = np.zeros(len(used)) if self.shift is None else self.shift[[u[i] for _, i in used]]
        self.n_regressors = len(self.columns) + self.offset
        if self.count <= self.n_regressors:
            raise TooShortError(
                f"'{data.name}' gives {self.count} equations for {self.n_regressors} parameters per output; expected "
                "more equations than parameters: record longer or choose fewer lags"
            )

    def solve(self, labels: list[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
        """Coefficients (n_regressors, ny), inverse of the Gram matrix, residual covariance, how they were found."""
        gram = self._gram()
        scale = np.sqrt(np.diag(gram))
        scale[scale == 0] = 1.0
        self.gram = gram / np.outer(scale, scale)
        theta = self._from_gram(self.gram, scale)
        if theta is not None:
            return (*theta, "Gram matrix of lag products")
        return (*self._from_triangle(scale, labels), "blocked QR")

    def confused(self, theta: np.ndarray, variance: np.ndarray) -> tuple[str, ...]:
        """A sentence for each input that the others nearly make up, where none of its coefficients is determined.

        Coefficients and their variances have shape (n_regressors, n_outputs).
        """
        first = self.na * self.ny
        of = np.array([i for _, i in self.used])
        said = []
        for i, name in enumerate(self.data.inputs):
            own = first + np.flatnonzero(of == i)
            others = [*(first + np.flatnonzero(of != i)), *([self.n_regressors - 1] if self.offset else [])]
            if not len(own) or len(others) == self.offset:
                continue
            if np.any(1.96 * np.sqrt(variance[own]) < 0.5 * np.abs(theta[own])):
                continue
            known = self.gram[np.ix_(others, others)]
            share = self.gram[own[0], others] @ np.linalg.lstsq(known, self.gram[own[0], others], rcond=1e-14)[0]
            left = float(np.sqrt(max(1.0 - share, 0.0)))
            if left < _APART:
                rest = ", ".join(n for j, n in enumerate(self.data.inputs) if j != i)
                k = own[0]
                said.append(
                    f"the data do not tell the effect of {name} from that of {rest}: all but {left:.1g} of it is a "
                    f"combination of them, so its first coefficient is {theta[k, 0]:.3g} ± "
                    f"{1.96 * np.sqrt(variance[k, 0]):.2g} (95 %); expected inputs that move apart: leave one out, or "
                    "record richer excitation"
                )
        return tuple(said)

    def _gram(self) -> np.ndarray:
        """Of regressors, constant last, then targets."""
        products, sums = self.windows.gram()
        pick = self.columns + self.targets
        gram = products[np.ix_(pick, pick)]
        if self.offset:
            at, p = sums[pick], len(self.columns)
            gram = np.insert(np.insert(gram, p, at, axis=0), p, np.insert(at, p, self.count), axis=1)
        return gram

    def _from_gram(self, gram: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Solution by Cholesky, or None where it would have fewer than about seven digits."""
        p = self.n_regressors
        values = np.linalg.eigvalsh(gram[:p, :p])
        if values[0] < 1e-8 * values[-1]:
            return None
        factor = linalg.cho_factor(gram[:p, :p])
        theta = linalg.cho_solve(factor, gram[:p, p:])
        unexplained = gram[p:, p:] - gram[p:, :p] @ theta
        if np.any(np.diag(unexplained) < 1e-9):
            return None
        sigma = unexplained * np.outer(scale[p:], scale[p:]) / (self.count - p)
        inverse = linalg.cho_solve(factor, np.eye(p)) / np.outer(scale[:p], scale[:p])
        return theta * scale[p:] / scale[:p, None], inverse, (sigma + sigma.T) / 2

    def _from_triangle(self, scale: np.ndarray, labels: list[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Solution by an R-only QR; a rank below the number of regressors is refused, with their names."""
        p = self.n_regressors
        order = [p - 1, *range(p - 1)] if self.offset else list(range(p))  # the constant comes first there
        wide = scale[[*order, *range(p, p + self.ny)]]
        r = triangle(self.windows, self.columns + self.targets, constant=self.offset, scale=wide)
        r11, r12, r22 = r[:p, :p], r[:p, p:], r[p:, p:]
        factors: Any = linalg.qr(r11, pivoting=True)
        q, rr, pivot = factors
        size = np.abs(np.diag(rr))
        rank = int(np.sum(size > 100 * np.finfo(float).eps * np.sqrt(self.count) * size[0])) if size[0] > 0 else 0
        if rank < p:
            raise ExcitationError(
                f"{p} regressors of '{self.data.name}' have rank {rank}: "
                f"{', '.join(labels[order[j]] for j in pivot[rank:])} depend on the others; expected independent "
                "ones: choose fewer lags, drop an input, or record richer excitation"
            )
        solved = linalg.solve_triangular(rr, np.hstack([q.T @ r12, np.eye(p)]))
        theta, root = np.empty((p, self.ny)), np.empty((p, p))
        theta[pivot], root[pivot] = solved[:, : self.ny], solved[:, self.ny :]
        back = np.argsort(order)
        theta, root = (theta / wide[:p, None])[back] * scale[p:], (root / wide[:p, None])[back]
        sigma = r22.T @ r22 * np.outer(scale[p:], scale[p:]) / (self.count - p)
        return theta, root @ root.T, sigma

    def constant(self, theta: np.ndarray) -> np.ndarray:
        """The constant for signals whose means were not subtracted."""
        return theta[-1] + self.y_mean - self._means @ theta[:-1]

    def unshifted(self, inverse: np.ndarray) -> np.ndarray:
        """The inverse Gram matrix for signals whose means were not subtracted."""
        if not self.offset:
            return inverse
        back = np.eye(self.n_regressors)
        back[-1, :-1] = -self._means
        return back @ inverse @ back.T

    @property
    def _means(self) -> np.ndarray:
        return np.concatenate([np.tile(self.y_mean, self.na), self.u_mean])


def unstable_said(poles: np.ndarray, data: Dataset, offset: bool) -> str:
    """Sentence where orders were chosen by free runs, and stable ones, over data of an unstable system; else empty.

    ``poles`` are those of the model, which has constants if ``offset``.
    """
    asked = StateSpace(order=_STATES, offsets="both" if offset else "none")
    return stable_by_free_runs(asked, poles, data)
