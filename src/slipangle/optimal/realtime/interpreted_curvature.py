"""The exact Hessian without a compiler: second derivatives node by node, and what they add to the condensed program."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slipangle.optimal.ocp import OCP
from slipangle.optimal.realtime.curvature import curvature_function, curvature_sweeps
from slipangle.optimal.realtime.interpreted_model import MOST_INSTRUCTIONS, bind, columns, inputs_of
from slipangle.optimal.realtime.parts import input_scale, repeated_steps

HELD = 1e-9  # distance from a bound, in units of half an input's range, that is none
LONGEST = 4  # most steps between two tries of all curvature, as in solver.c
STIFF = 1e3  # curvature lent to rows that are held, over the largest by an input


class Bent:
    """What curvature adds to Hessian and gradient by the scaled inputs, ``H`` and ``g``, and ``negative`` if there is.

    First all of it, then without negative eigenvalues node by node.
    """

    def __init__(self, M: np.ndarray, Z: np.ndarray) -> None:
        values, vectors = np.linalg.eigh(M)
        least = -1e-12 * np.abs(values).max(axis=1, keepdims=True)
        self.negative = bool((values < least).any())
        along = np.swapaxes(vectors, 1, 2) @ Z
        self._weighed = along.reshape(-1, Z.shape[2]), values.ravel()

    def added(self, *, everything: bool) -> tuple[np.ndarray, np.ndarray]:
        """To Hessian and gradient: all, or what is positive."""
        rows, values = self._weighed
        both = rows[:, :-1].T @ (rows * (values if everything else np.maximum(values, 0.0))[:, None])
        return both[:, :-1], both[:, -1]


class Curvature:
    """Second derivatives of the Lagrangian at all nodes of one problem.

    Raises
    ------
    ParameterError
        If the problem has no scalar code.
    """

    def __init__(self, ocp: OCP) -> None:
        self._nu, self._jumps, many = len(ocp.controls), list(ocp.jumps), ocp.horizon + 1
        steps = repeated_steps(ocp, derivatives=False)
        sweeps = curvature_sweeps(ocp) if steps is not None and steps.apart > MOST_INSTRUCTIONS else None
        function = columns(curvature_function(ocp) if sweeps is None else sweeps.whole(), many)
        self._scale = input_scale(ocp)
        self._in = inputs_of(function, many)
        self._call, self._out = bind(function, many, self._in)

    def at(self, given: tuple[np.ndarray, ...], of_x: np.ndarray, of_l: np.ndarray, of_e: np.ndarray) -> np.ndarray:
        """Matrices of all nodes, by states and scaled inputs.

        Parameters
        ----------
        given : tuple of array
            States, inputs, exogenous inputs and references of the nodes; rows of inputs without an end.
        of_x : array, shape (horizon + 1, n_states)
            Multipliers of the dynamics, those of where steps end in the row of the next node.
        of_l, of_e : array, shape (horizon + 1, n_limited) and (horizon + 1, n_tracked)
            Multipliers of limits, and errors times their weights.
        """
        after = np.vstack([of_x[1:], np.zeros((1, of_x.shape[1]))])
        after[self._jumps] = 0.0
        for rows, values in zip(self._in, (*given, after, of_l, of_e), strict=True):
            rows[: len(values)], rows[len(values) :] = values, values[-1]
        self._call()
        nz = of_x.shape[1] + self._nu
        units = np.concatenate([np.ones(of_x.shape[1]), self._scale])
        return self._out[0].reshape(-1, nz, nz) * units[:, None] * units

    def bent(self, M: np.ndarray, G: np.ndarray) -> Bent:
        """What they add, where states move by G, shape (horizon + 1, n_states, n + 1), with the inputs."""
        n, nu = len(G) - 1, self._nu
        own = np.zeros((n + 1, nu, G.shape[2]))
        for i in range(n + 1):
            first = min(i, n - 1) * nu
            own[i, :, first : first + nu] = np.eye(nu)
        return Bent(M, np.concatenate([G, own], axis=1))


def is_positive(H: np.ndarray) -> bool:
    """Whether a matrix has a Cholesky factor."""
    try:
        return bool(np.isfinite(np.linalg.cholesky(H)).all())
    except np.linalg.LinAlgError:
        return False


class Held(NamedTuple):
    """Rows by the scaled inputs that a step is to go all the way along, and how far."""

    rows: np.ndarray
    ways: np.ndarray

    def lend(self, H: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Hessian and gradient with curvature lent to these rows; None if that is not positive.

        Along steps that go all of these ways nothing changes, so that the program is convex where they leave it so.
        """
        if is_positive(H):
            return H, g
        stiff = STIFF * np.abs(np.diag(H)).max()
        H = H + stiff * self.rows.T @ self.rows
        return (H, g - stiff * self.rows.T @ self.ways) if is_positive(H) else None

    def kept_by(self, step: np.ndarray) -> bool:
        """Whether a step goes all of them all the way."""
        return bool((np.abs(self.rows @ step - self.ways) <= HELD * (1 + np.abs(self.ways))).all())


def held_rows(low: np.ndarray, high: np.ndarray, slope: np.ndarray, L: np.ndarray, way: np.ndarray) -> Held:
    """What holds at an iterate: inputs at a bound that the cost pushes against, and rows that are at their limit.

    Parameters
    ----------
    low, high, slope : array, shape (n,)
        Room of the scaled inputs, and the gradient of the Lagrangian by them.
    L, way : array, shape (n_held, n) and (n_held,)
        Rows that are at their limit, and what a step has to change them by.
    """
    at = np.flatnonzero(((high <= HELD) & (slope < 0)) | ((low >= -HELD) & (slope > 0)))
    room = np.where(high[at] <= HELD, high[at], low[at])
    sizes = np.maximum(np.linalg.norm(L, axis=1), 1e-300)
    return Held(np.vstack([np.eye(len(slope))[at], L / sizes[:, None]]), np.concatenate([room, way / sizes]))


class Tries:
    """When all curvature is tried: after whole steps; where that led nowhere, one step later, then two, then four."""

    def __init__(self) -> None:
        self.wanted = self.tried = self.good = False
        self._failed = self._rest = 0

    def choose(self, *, whole: bool, negative: bool) -> None:
        """For the next step, by the last one and by what there is."""
        if self.tried:
            self._failed = 0 if self.good and whole else self._failed + 1
            self._rest = LONGEST if self._failed > 2 else self._failed
        self.wanted = self.tried = self.good = False
        if whole:
            self.wanted, self._rest = self._rest <= 0 and negative, self._rest - 1
