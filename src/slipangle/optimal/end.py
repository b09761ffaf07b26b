"""What the end of the horizon is worth: a full matrix over errors, and the one of the LQR that goes on from there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy import linalg

from slipangle.errors import ParameterError
from slipangle.optimal.arrays import short
from slipangle.optimal.terms import require_names
from slipangle.shown import Brief

ERROR_OF = {"X": "e_x", "Y": "e_y", "psi": "e_psi"}


@dataclass(frozen=True, eq=False)
class TerminalCost(Brief):
    """Cost of the end, ``e^T P e``: a weight between every two errors.

    Parameters
    ----------
    names : tuple of str
        Of the errors: states and outputs relative to what is wanted of them, path errors, terms, and decided inputs,
        those of the last stage, relative to zero.
    matrix : array, shape (n_names, n_names)
        P, symmetric and positive semidefinite.

    Raises
    ------
    ParameterError
        If names repeat, or P has another shape or is none such.

    Examples
    --------
    >>> TerminalCost(("p", "v"), [[2.0, 1.0], [1.0, 3.0]])
    TerminalCost(names=('p', 'v'), matrix=array 2 x 2)
    """

    names: tuple[str, ...]
    matrix: np.ndarray

    def __post_init__(self) -> None:
        names = (self.names,) if isinstance(self.names, str) else tuple(self.names)
        n = len(names)
        if len(set(names)) < n or not n:
            raise ParameterError(f"the terminal cost names {list(names)}; expected each error once, and at least one")
        try:
            P = np.array(self.matrix, dtype=float)
        except (TypeError, ValueError):
            P = np.full((n, n), np.nan)
        if P.shape != (n, n) or not np.isfinite(P).all():
            raise ParameterError(
                f"the terminal matrix is {short(self.matrix)}; expected finite numbers of shape ({n}, {n}): "
                f"{list(names)}"
            )
        size = np.abs(P).max()
        if np.abs(P - P.T).max() > 1e-9 * size or np.linalg.eigvalsh(P).min() < -1e-9 * size:
            raise ParameterError(
                "the terminal matrix is not symmetric and positive semidefinite; expected one that is: an LQR's, or a "
                "Hessian's positive part"
            )
        P.flags.writeable = False
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "matrix", P)

    @property
    def rows(self) -> np.ndarray:
        """F with F^T F = P: rows over the errors, each a squared term, shape (rank, n_names)."""
        left, rows = 0.5 * (self.matrix + self.matrix.T), []
        least = 1e-12 * np.diag(left)
        for j in range(len(left)):
            if left[j, j] > least[j]:
                row = left[j] / np.sqrt(left[j, j])
                row[:j] = 0.0
                rows.append(row)
                left = left - np.outer(row, row)
        return np.array(rows).reshape(-1, len(least))


def lqr(problem: Any, **at: float) -> TerminalCost:
    """Cost of all that follows the horizon, if the linear-quadratic regulator goes on without end or limits.

    Dynamics and tracked quantities are linearised at a steady state; Q, R and S count as they do within the horizon.
    Where S or an output counts an input, the last one is among the errors.

    Parameters
    ----------
    problem : OCP or MPC
        The problem that it becomes the ``terminal`` of.
    **at : float
        The steady state by name: states, inputs, parameters; zero where not named. SI units.

    Raises
    ------
    ParameterError
        If a name is not known, or no regulator brings what Q counts to zero.

    Notes
    -----
    Of a problem that tracks path errors, X, Y and psi are counted as ``e_x``, ``e_y`` and ``e_psi``. States on which no
    tracked quantity depends have no part in it.
    """
    ocp = getattr(problem, "ocp", problem)
    if not ocp.Q:
        raise ParameterError("the problem has no weights in Q; expected some, which a regulator brings to zero: set Q")
    places = (ocp.model.states, ocp.controls, ocp.exogenous)
    require_names(at, [n for names in places for n in names], "lqr()", "use a state, an input or a parameter")
    usual = {**ocp.presumed, **at}
    x, u, w = (np.array([usual.get(n, 0.0) for n in names], dtype=float) for names in places)
    A, B, E, D = _linear(ocp, x, u, w)
    q, _, r, s = ocp.weights
    E, D = (np.sqrt(q)[:, None] * part for part in (E, D))
    seen = (E != 0).any(axis=0)
    for _ in ocp.model.states:
        seen = seen | (A[seen] != 0).any(axis=0)
    states: list[str] = [n for n, used in zip(ocp.model.states, seen, strict=True) if used]
    A, B, E = A[np.ix_(seen, seen)], B[seen], E[:, seen]
    Q, R, N = E.T @ E, D.T @ D + np.diag(r + s), E.T @ D
    before = bool(s.any())
    if before:
        n, m = B.shape
        A, B = np.block([[A, np.zeros((n, m))], [np.zeros((m, n + m))]]), np.vstack([B, np.eye(m)])
        Q, N = np.block([[Q, np.zeros((n, m))], [np.zeros((m, n)), np.diag(s)]]), np.vstack([N, -np.diag(s)])
    try:
        P = linalg.solve_discrete_are(A, B, Q, R, s=N)
        radius = np.abs(np.linalg.eigvals(A - B @ np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A + N.T))).max()
    except (linalg.LinAlgError, ValueError):
        P, radius = np.zeros_like(Q), np.inf
    if not radius < 1:
        said = ", ".join(f"{k} = {v:g}" for k, v in at.items()) or "all zero"
        raise ParameterError(
            f"no regulator of {list(ocp.controls)} brings {list(ocp.Q)} to zero at {said}; expected a steady state "
            "where one does, with weights on the inputs or their changes: name it in lqr(...), or set R or S"
        )
    if set(ERROR_OF.values()) & {*ocp.Q}:
        states = [ERROR_OF.get(n, n) for n in states]
    return TerminalCost((*states, *(ocp.controls if before else ())), 0.5 * (P + P.T))


def _linear(ocp: Any, x: np.ndarray, u: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, ...]:
    """Derivatives of the next state, and of the errors, by state and decided input."""
    sx, su = ca.MX.sym("x", len(x)), ca.MX.sym("u", len(u))
    known: Mapping[str, float] = dict(zip(ocp.model.states, x, strict=True))
    p = np.array([known.get(n, 0.0) for n in ocp.references], dtype=float)
    later, error = ocp.dynamics(sx, su, w), ocp.stage(sx, su, w, p)[0]
    jacobians = [ca.jacobian(v, z) for v in (later, error) for z in (sx, su)]
    return tuple(np.asarray(j.full()) for j in ca.Function("j", [sx, su], jacobians)(x, u))
