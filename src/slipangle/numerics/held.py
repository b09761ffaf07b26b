"""Linear systems in continuous time at their samples, inputs held between them and perhaps late: exact."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import linalg


class Late(NamedTuple):
    """States one sample later: from states, from the input ``whole + 1`` and ``whole`` samples ago."""

    A: np.ndarray  # (n, n)
    older: np.ndarray  # (n,)
    newer: np.ndarray  # (n,)
    whole: int


def held(A: np.ndarray, B: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Discrete matrices of ``x' = A x + B u``, shapes (n, n), (n, n_inputs), inputs held over ``h`` seconds."""
    n, nu = B.shape
    whole: Any = linalg.expm(np.block([[A, B], [np.zeros((nu, n + nu))]]) * h)
    return whole[:n, :n], whole[:n, n:]


def late(A: np.ndarray, B: np.ndarray, delay: float, h: float) -> Late:
    """The same for one input, ``B`` of shape (n,), that acts ``delay`` seconds late, of any part of a sample."""
    whole = int(np.floor(delay / h + 1e-12))
    part = min(max(delay - whole * h, 0.0), h)
    (A_late, B_late), (A_rest, B_rest) = (held(A, B[:, None], t) for t in (part, h - part))
    return Late(A_rest @ A_late, A_rest @ B_late[:, 0], B_rest[:, 0], whole)
