"""Where the search for a Lur'e system begins: branches that explain what the linear model leaves over."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.identify.linear.predictor import Bank
from slipangle.models.black_box.lure import Curve, bend
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.numerics.linear_response import LTI

_WORK = 30_000_000  # responses that the comparison of the draws may cost
_AHEAD = 100  # samples over which a state's effect on the outputs is summed
_REACH = (0.7, 5.0)  # standard deviations of what a branch sees, between which it is drawn


class Branches(NamedTuple):
    """W, V and E, see `LureModel`, and the share of the squared error that they explain at first order."""

    W: np.ndarray
    V: np.ndarray
    E: np.ndarray
    share: float


def drawn(
    start: StateSpaceModel, x0: np.ndarray, data: Dataset, *, curve: Curve, branches: int, count: int, seed: int
) -> list[Branches]:
    """Random branches, those first that explain most of the linear model's free-run error.

    What the branches see of the linear model's states is drawn; where they act then follows by linear least squares,
    beside first-order changes of the linear model itself. A draw costs ``order`` filtered signals, a thousandth of a
    descent.

    ``start`` is in the basis of `unit_states`, ``x0``, shape (n_experiments, order), are its initial states; of
    ``count`` draws, long records get fewer.
    """
    n, nu = start.order, start.n_inputs
    u0, y0 = np.array(start.u_offset), np.array(start.y_offset)
    size = np.maximum(np.std(data.y, axis=0), 1e-300)
    parts = [(part.u - u0, part.y - y0) for part in data.experiments]
    see = LTI(A=start.A, B=start.B, C=np.eye(n), D=np.zeros((n, nu)))
    states = [see.respond(x, u)[0] for x, (u, _) in zip(x0, parts, strict=True)]
    clear = _Clear(start, parts, states, size)
    rng = np.random.default_rng(seed)
    count = max(40, min(count, _WORK // (clear.rows * n * branches)))
    u_size = np.maximum(np.std(data.u, axis=0), 1e-300)
    draws = []
    batch = max(1, min(50, 4_000_000 // (clear.rows * n * branches)))
    for first in range(0, count, batch):
        shape = (min(batch, count - first), branches)
        W = rng.standard_normal((*shape, n))
        W *= np.exp(rng.uniform(np.log(_REACH[0]), np.log(_REACH[1]), shape))[..., None] / np.linalg.norm(
            W, axis=2, keepdims=True
        )
        V = 0.3 * rng.standard_normal((*shape, nu)) / u_size
        rows = [
            bend(curve, x @ W.reshape(-1, n).T + u @ V.reshape(-1, nu).T)
            for x, (u, _) in zip(states, parts, strict=True)
        ]
        responses = clear.of(rows)  # (rows, order, signal)
        for i in range(shape[0]):
            r = responses[:, :, i * branches : (i + 1) * branches].reshape(len(responses), -1)
            gram = r.T @ r
            by = np.linalg.solve(gram + 1e-6 * np.trace(gram) * np.eye(len(gram)), r.T @ clear.error)
            left = float(np.sum((clear.error - r @ by) ** 2) / max(np.sum(clear.error**2), 1e-300))
            draws.append(Branches(W[i], V[i], by.reshape(n, branches), 1 - left))
    return sorted(draws, key=lambda b: -b.share)


class _Clear:
    """Signals filtered by the linear model, cleared of what its own parameters and initial states could explain."""

    def __init__(
        self,
        start: StateSpaceModel,
        parts: list[tuple[np.ndarray, np.ndarray]],
        states: list[np.ndarray],
        size: np.ndarray,
    ) -> None:
        self.start, self.size = start, size
        self.rows = sum(y.size for _, y in parts)
        self.local, own, errors = [], [], []
        for x, (u, y) in zip(states, parts, strict=True):
            free = self._respond(np.hstack([x, u]))  # (samples * outputs, order, signals + 1)
            self.local.append(_range(free[:, :, -1]))
            straight = np.einsum("ki,oj->kjoi", np.hstack([x, u]), np.diag(1 / size))
            of_model = np.hstack([free[:, :, :-1].reshape(len(free), -1), straight.reshape(len(free), -1)])
            error = ((y - x @ np.array(start.C).T - u @ np.array(start.D).T) / size).reshape(-1, 1)
            own.append(_without(of_model, self.local[-1]))
            errors.append(_without(error, self.local[-1]))
        self.shared = _range(np.vstack(own))
        self.error = _without(np.vstack(errors), self.shared)[:, 0]

    def _respond(self, signals: np.ndarray) -> np.ndarray:
        """Outputs' responses, in their standard deviations, shape (samples * outputs, order, signals + 1)."""
        responses = Bank(np.array(self.start.A), np.array(self.start.C), signals.shape[1]).respond(signals)
        responses = responses / self.size[:, None, None]
        return responses.reshape(-1, *responses.shape[2:])

    def of(self, signals: list[np.ndarray]) -> np.ndarray:
        """Of the signals of each experiment: shape (all samples * outputs, order, signals)."""
        cleared = []
        for rows, local in zip(signals, self.local, strict=True):
            responses = self._respond(rows)[:, :, :-1]
            cleared.append(_without(responses.reshape(len(responses), -1), local))
        return _without(np.vstack(cleared), self.shared).reshape(self.rows, self.start.order, -1)


def _range(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis of what the columns span."""
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left, size, _ = np.linalg.svd(columns / scale, full_matrices=False)
    return left[:, size > 1e-8 * size[0]]


def _without(columns: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Part of the columns orthogonal to an orthonormal basis."""
    return columns - basis @ (basis.T @ columns)


def unit_states(start: StateSpaceModel, data: Dataset) -> tuple[StateSpaceModel, np.ndarray]:
    """The start in a basis that its behaviour fixes, and the initial states there.

    The states of its free run have unit covariance, come in the order of what they do to the outputs within the next
    samples, and see or are seen with a positive sign. Any basis of the same model leads here: where signs and turns
    were left to rounding, every processor would search from other starts.
    """
    n, u0 = start.order, np.array(start.u_offset)
    x0 = np.zeros((len(data.starts), n)) if start.x0 is None or len(start.x0) != len(data.starts) else start.x0
    see = LTI(A=start.A, B=start.B, C=np.eye(n), D=np.zeros((n, start.n_inputs)))
    states = np.vstack([see.respond(x, part.u - u0)[0] for x, part in zip(x0, data.experiments, strict=True)])
    value, vector = np.linalg.eigh(states.T @ states / len(states))
    T: Any = (vector / np.sqrt(np.maximum(value, 1e-12 * value[-1]))).T
    white = start.transformed(T)
    size, seen = np.maximum(np.std(data.y, axis=0), 1e-300), np.zeros((n, n))
    row = np.array(white.C) / size[:, None]
    for _ in range(_AHEAD):
        seen += row.T @ row
        row = row @ white.A
    turn: Any = np.linalg.eigh(seen)[1][:, ::-1].T
    turned = white.transformed(turn)
    u_size = np.std(data.u, axis=0)
    weights = np.vstack([np.array(turned.C) / size[:, None], (np.array(turned.B) * u_size).T])
    largest = np.take_along_axis(weights, np.argmax(np.abs(weights), axis=0)[None], axis=0)[0]
    signs: Any = np.diag(np.where(largest < 0, -1.0, 1.0))
    whole = signs @ turn @ T
    return start.transformed(whole), x0 @ whole.T
