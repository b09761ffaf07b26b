"""Subspace identification: a state space from projections of past and future, without iteration."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from scipy import linalg

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ExcitationError, ParameterError, TooShortError
from slipangle.fields import Count, Within
from slipangle.identify.excitation import require_identifiable
from slipangle.identify.linear.estimator import LinearEstimator, channels, described
from slipangle.identify.linear.lags import Windows, triangle
from slipangle.identify.linear.poles import grown, mirrored
from slipangle.identify.linear.predictor import LinearFit
from slipangle.identify.linear.scales import sizes
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.numerics.blas import one_blas_thread

Algorithm = Literal["n4sid", "moesp", "cva"]


@dataclass(frozen=True, kw_only=True)
class Subspace(LinearEstimator[StateSpaceModel]):
    """MOESP, N4SID or CVA, in one common frame.

    The data enter through one triangular factor of the windows of ``2 block_rows`` samples, found from lag products
    or, where those would lose digits, by a QR factorisation made block by block: memory does not depend on the
    length of the record. B, D, the initial states and the output offset then follow by linear least squares on the
    one-step-ahead error, K from the covariance of the projected states' residuals.

    Parameters
    ----------
    order : int, optional
        Number of states; by default chosen from the singular values (`suggest_order`).
    algorithm : {"cva", "moesp", "n4sid"}
        Weighting of the projection: canonical variates, orthogonal to future inputs, or none.
    block_rows : int, optional
        Past and future samples in a window; by default ``max(10, 2 order + 2)``, fewer for short records.
    direct : bool
        Estimate D; otherwise inputs act one sample later.
    offset : bool
        Estimate the outputs' level; for data whose mean was not removed.
    disturbance : bool
        Estimate K; otherwise all disturbance is noise on the outputs.

    Source: P. Van Overschee, B. De Moor, Subspace Identification for Linear Systems, 1996, ch. 4.
    """

    order: Count | None = None
    algorithm: Algorithm = "cva"
    block_rows: Annotated[int, Within(2)] | None = None
    direct: bool = False
    offset: bool = False
    disturbance: bool = True

    _what = "the state space"

    @one_blas_thread()
    def _fit(self, data: Dataset) -> StateSpaceModel:
        return self.of(self.projected(data), data)

    def projected(self, data: Dataset) -> ObliqueProjection:
        """The factorisation that models of any order up to this one are read from."""
        return project(data, algorithm=self.algorithm, block_rows=self.rows(data), offset=self.offset)

    def of(self, projection: ObliqueProjection, data: Dataset) -> StateSpaceModel:
        """Model of this order from a projection of the data."""
        began = time.perf_counter()
        fit, count = self._linear(projection, data)
        parts, told = fit.solve()
        strength = ", ".join(f"{s:.3g}" for s in projection.singular_values[: len(fit.A) + 3])
        info = described(
            data,
            began,
            **told,
            n_samples=data.n_samples,
            method=f"subspace ({self.algorithm}), {projection.block_rows} block rows, {projection.solver}, singular "
            f"values {strength}, ...; "
            + (f"{count} poles mirrored into the unit circle; " if count else "")
            + "B, D, x0 by least squares on the one-step-ahead error, covariance given A, C, K",
        )
        return StateSpaceModel(A=fit.A, C=fit.C, K=fit.K, **parts, **channels(data), fit_info=info)

    def left_out(
        self, projection: ObliqueProjection, groups: Sequence[Dataset]
    ) -> tuple[StateSpaceModel, list[StateSpaceModel]]:
        """The model from a projection of all groups of experiments, and with B, D and levels by all but each in turn.

        A, C and K are those of all.
        """
        data = join(*groups)
        fit, _ = self._linear(projection, data)
        same: Any = {"A": fit.A, "C": fit.C, "K": fit.K, **channels(data)}
        whole, *without = (StateSpaceModel(**parts, **same) for parts in fit.left_out(groups))
        return whole, without

    def _linear(self, projection: ObliqueProjection, data: Dataset) -> tuple[LinearFit, int]:
        """What is left to fit given A, C and K, and how many poles were mirrored."""
        order = self.order or suggest_order(projection.singular_values)
        A, C = projection.observability(order)
        K = projection.gain(order, A, C) if self.disturbance else np.zeros((order, len(C)))
        count = 0 if K.any() else int(grown(A, data.n_longest).sum())
        A = mirrored(A, data.n_longest) if count else A
        u, y = sizes(data)
        parts = {"A": A, "C": y[:, None] * C, "K": K / y, "sizes": (u, y)}
        return LinearFit(**parts, direct=self.direct, offset=self.offset, data=data), count

    def rows(self, data: Dataset) -> int:
        """Block rows used on these data."""
        nu, ny = len(data.inputs), len(data.outputs)
        require_identifiable(data, (self.order or 1) * (nu + ny))
        least = 2 if self.order is None else self.order // ny + 2
        if self.block_rows is not None:
            if self.order is not None and (self.block_rows - 1) * ny < self.order:
                raise ParameterError(
                    f"block_rows is {self.block_rows} for order {self.order} and {ny} outputs; expected at least "
                    f"{self.order // ny + 2}: raise block_rows or lower the order"
                )
            return self.block_rows
        wanted = 15 if self.order is None else max(10, 2 * self.order + 2)
        affordable = int((data.n_longest + 1) // (2 * (nu + ny) + 2))  # twice as many windows as rows
        return max(least, min(wanted, affordable))


@dataclass(frozen=True, kw_only=True)
class ObliqueProjection:
    """The oblique projection of future outputs on the past, compressed into small matrices.

    The columns of ``r`` have the inner products of the windows' entries, each over the standard deviation of its
    channel, so they stand for the signals in no units.
    """

    r: np.ndarray
    n_u: int
    n_y: int
    block_rows: int
    solver: str
    singular_values: np.ndarray
    left: np.ndarray
    oblique: np.ndarray

    def observability(self, order: int) -> tuple[np.ndarray, np.ndarray]:
        """A and C from the shift invariance of the extended observability matrix."""
        gamma = self._gamma(order)
        A: Any = np.linalg.lstsq(gamma[: -self.n_y], gamma[self.n_y :], rcond=None)[0]
        return A, gamma[: self.n_y].copy()

    def _gamma(self, order: int) -> np.ndarray:
        if order > len(self.singular_values) or order > (self.block_rows - 1) * self.n_y:
            raise ParameterError(
                f"the order is {order}; expected at most {(self.block_rows - 1) * self.n_y} with {self.block_rows} "
                "block rows: raise block_rows or lower the order"
            )
        return self.left[:, :order] * np.sqrt(self.singular_values[:order])

    @cached_property
    def _later(self) -> np.ndarray:
        """The same projection one sample later, of which every order's gain asks."""
        return _oblique(self.r, self.n_u, self.n_y, self.block_rows + 1)

    def gain(self, order: int, A: np.ndarray, C: np.ndarray) -> np.ndarray:
        """K from the residual covariance of the projected states, by the Riccati equation; zero where it fails."""
        s, gamma = self.block_rows, self._gamma(order)
        now = self.oblique @ np.linalg.pinv(gamma).T
        later = self._later @ np.linalg.pinv(gamma[: -self.n_y]).T
        present = self.r[:, s * (self.n_u + self.n_y) : (s + 1) * (self.n_u + self.n_y)]
        u, y = present[:, : self.n_u], present[:, self.n_u :]
        target = np.hstack([later, y]) - now @ np.vstack([A, C]).T
        residual = target - u @ np.linalg.lstsq(u, target, rcond=None)[0]
        noise = residual.T @ residual
        q, r, cross = noise[:order, :order], noise[order:, order:], noise[:order, order:]
        power = np.diag(y.T @ y)
        if np.any(np.diag(r) < 1e-14 * power):  # nothing is left to correct with
            return np.zeros((order, self.n_y))
        try:
            p = linalg.solve_discrete_are(A.T, C.T, q + 1e-12 * np.trace(q) * np.eye(order), r, s=cross)
            K = np.linalg.solve(C @ p @ C.T + r, (A @ p @ C.T + cross).T).T  # singular where one output is another
            stable = np.abs(np.linalg.eigvals(A - K @ C)).max() < 1
        except (linalg.LinAlgError, ValueError):
            return np.zeros((order, self.n_y))
        return K if stable else np.zeros((order, self.n_y))


def project(data: Dataset, *, algorithm: Algorithm, block_rows: int, offset: bool = False) -> ObliqueProjection:
    """Compress the record and project future outputs on the past along future inputs.

    With ``offset`` the channels' means are subtracted first; for the rest see `Subspace`.

    Source: P. Van Overschee, B. De Moor, Subspace Identification for Linear Systems, 1996, sec. 4.2.
    """
    nu, ny, s = len(data.inputs), len(data.outputs), block_rows
    names = (*data.inputs, *data.outputs)
    shift = np.array([data[n].mean() for n in names]) if offset else None
    windows = Windows(data=data, names=names, lags=2 * s, shift=shift)
    width = 2 * s * (nu + ny)
    if windows.count < width + 1:
        raise TooShortError(
            f"'{data.name}' gives {windows.count} windows of {2 * s} samples for {width} rows; expected more windows "
            "than rows: record longer, without gaps, or use fewer block_rows"
        )
    r, solver = _compress(windows, data)
    r = r / np.tile(np.concatenate(sizes(data)), 2 * s)
    oblique, (_, u_future, future) = _oblique(r, nu, ny, s), _split(r, nu, ny, s)
    target, weight = oblique, np.eye(s * ny)
    if algorithm != "n4sid":
        target = _without(oblique, u_future)
    if algorithm == "cva":
        free = _without(future, u_future)
        _, size, vector = np.linalg.svd(free, full_matrices=False)
        weight = (vector.T / np.maximum(size, 1e-8 * size[0])) @ vector
    _, singular, right = np.linalg.svd(target @ weight, full_matrices=False)
    return ObliqueProjection(
        r=r,
        n_u=nu,
        n_y=ny,
        left=np.linalg.solve(weight, right.T) if algorithm == "cva" else right.T,
        block_rows=s,
        solver=solver,
        singular_values=singular,
        oblique=oblique,
    )


def suggest_order(singular_values: np.ndarray) -> int:
    """The order after which the singular values drop most, on a logarithmic scale above rounding.

    Candidates end where a value falls below the middle (geometric mean) of the largest and the smallest.
    """
    s = np.maximum(singular_values, singular_values[0] * 1e-13)
    log = np.log(s)
    above = int(np.sum(log > 0.5 * (log[0] + log[-1])))
    drops = log[:-1] - log[1:]
    return int(np.argmax(drops[: max(1, above)])) + 1


def _compress(windows: Windows, data: Dataset) -> tuple[np.ndarray, str]:
    """A small matrix whose columns have the inner products of the windows' entries, less their means if shifted."""
    gram, sums = windows.gram()
    centred = windows.shift is not None
    if centred:  # a constant is one more input
        gram -= np.outer(sums, sums) / windows.count
    scale = np.sqrt(np.maximum(np.diag(gram), 0.0))
    scale[scale == 0] = 1.0
    scaled = gram / np.outer(scale, scale)
    size = np.linalg.eigvalsh(scaled)
    nu, nc = len(data.inputs), len(windows.names)
    if size[0] > 1e-10 * size[-1]:
        r, solver = linalg.cholesky(scaled), "lag products"
    else:
        wide = np.concatenate([[1.0], scale]) if centred else scale
        r = triangle(windows, range(len(scale)), constant=centred, scale=wide)
        r, solver = r[int(centred) :, int(centred) :], "blocked QR"
    inputs = [k * nc + j for k in range(windows.lags) for j in range(nu)]
    _require_excitation(r[:, inputs], data, windows.lags)
    return r * scale, solver


def _require_excitation(u: np.ndarray, data: Dataset, lags: int) -> None:
    """Raise where the inputs' lags depend on each other: they must excite as many frequencies as there are lags."""
    factors: Any = linalg.qr(u, mode="r", pivoting=True)
    size, pivot = np.abs(np.diag(factors[0])), factors[1]
    rank = int(np.sum(size > 1e-10 * size[0]))
    if rank < u.shape[1]:
        nu = len(data.inputs)
        at_fault = sorted({data.inputs[j % nu] for j in pivot[rank:]})
        raise ExcitationError(
            f"{lags} lags of {nu} inputs of '{data.name}' have rank {rank}: those of {', '.join(at_fault)} depend on "
            f"the others; expected rank {lags * nu}: use fewer block_rows, drop a collinear input, or record richer "
            "excitation"
        )


def _split(r: np.ndarray, nu: int, ny: int, split: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All of the samples before ``split`` in a window, inputs from there on, outputs from there on."""
    past, rest = np.split(r, [split * (nu + ny)], axis=1)
    future = rest.reshape(len(r), -1, nu + ny)
    return past, future[:, :, :nu].reshape(len(r), -1), future[:, :, nu:].reshape(len(r), -1)


def _oblique(r: np.ndarray, nu: int, ny: int, split: int) -> np.ndarray:
    """Part of the outputs from ``split`` on that the samples before it explain, beside the inputs from ``split`` on."""
    past, u, y = _split(r, nu, ny, split)
    clean = _without(past, u)
    weights = np.linalg.lstsq(clean, _without(y, u), rcond=1e-12)[0]
    return past @ weights


def _without(columns: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Part of the columns orthogonal to the others."""
    q: Any = np.linalg.qr(others)[0]
    return columns - q @ (q.T @ columns)
