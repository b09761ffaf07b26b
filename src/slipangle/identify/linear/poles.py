"""Eigenvalues of a linear fit's matrices, and the same matrices with those that are too large back inside a circle."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import linalg


def modulus(A: np.ndarray) -> float:
    """Of the largest eigenvalue; infinite where an entry is not finite."""
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)) if np.isfinite(A).all() else np.inf


def shrunk(A: np.ndarray, radius: float) -> np.ndarray:
    """A with the eigenvalues beyond the radius moved onto it along their direction; the others stay."""
    if not radius < modulus(A) < np.inf:
        return A  # what is not finite is refused by its cost
    factors: Any = linalg.schur(A, output="complex")
    T, Z = factors
    moduli = np.abs(np.diag(T))
    diagonal = np.diag(T) * np.minimum(1.0, radius / np.maximum(moduli, 1e-300))
    T[np.diag_indices(len(T))] = diagonal
    return np.real(Z @ T @ Z.conj().T)


def grown(A: np.ndarray, steps: int) -> np.ndarray:
    """Which eigenvalues leave nothing of the other modes' effects to double precision after so many steps."""
    size = np.abs(np.linalg.eigvals(A))
    return steps * np.log(np.maximum(size, 1.0)) > -0.5 * np.log(np.finfo(float).eps)


def mirrored(A: np.ndarray, steps: int) -> np.ndarray:
    """A with those eigenvalues inside the unit circle: modes that no free run of a log has, of a too high order."""
    values, vectors = np.linalg.eig(A)
    large = grown(A, steps)
    values[large] = 1 / values[large].conj()
    return np.linalg.solve(vectors.T, (vectors * values).T).T.real
