"""The line of least curvature between the edges of a track: a quadratic program, linearised anew a few times.

.. [1] A. Heilmeier et al., Minimum curvature trajectory planning and control for an autonomous race car, Vehicle System
   Dynamics 58, 2020, sec. 3; here with finite differences, and linearised in the length of the line too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

_ROUNDS = 8
_STILL = 1e-3  # of the room across the track, a change that ends the search
_ENOUGH = 1e-13  # of the interior point's complementarity, over its first


def differences(step: np.ndarray, *, closed: bool) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """First and second derivative at the samples, from ``step``, shape (n,) if closed, (n - 1,) if open. [m]

    An open line's ends take the derivatives next to them, the second zero.
    """
    n = len(step) if closed else len(step) + 1
    i = np.arange(n) if closed else np.arange(1, n - 1)
    back, ahead = step[(i - 1) % n], step[i]
    left, right, both = (i - 1) % n, (i + 1) % n, back + ahead
    rows, columns = np.concatenate([i, i, i]), np.concatenate([left, i, right])
    first = np.concatenate([-ahead / (back * both), (ahead - back) / (back * ahead), back / (ahead * both)])
    second = np.concatenate([2 / (back * both), -2 / (back * ahead), 2 / (ahead * both)])
    if not closed:
        ends = np.array([0, 0, n - 1, n - 1])
        rows1, columns1 = np.concatenate([rows, ends]), np.concatenate([columns, [0, 1, n - 2, n - 1]])
        slopes = [-1 / step[0], 1 / step[0], -1 / step[-1], 1 / step[-1]]
        one = sparse.csr_matrix((np.concatenate([first, slopes]), (rows1, columns1)), shape=(n, n))
    else:
        one = sparse.csr_matrix((first, (rows, columns)), shape=(n, n))
    return one, sparse.csr_matrix((second, (rows, columns)), shape=(n, n))


def minimum_curvature(
    X: np.ndarray, Y: np.ndarray, psi: np.ndarray, step: np.ndarray, low: np.ndarray, high: np.ndarray, *, closed: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offset from a reference line [m], heading against it [rad] and curvature [1/m] of the line of least curvature.

    Parameters
    ----------
    X, Y, psi : array, shape (n,)
        The reference line. [m, m, rad]
    step : array, shape (n,) if closed, else (n - 1,)
        Between the samples. [m]
    low, high : array, shape (n,)
        Bounds of the offset, positive to the left. [m]
    """
    D1, D2 = differences(step, closed=closed)
    nx, ny = -np.sin(psi), np.cos(psi)
    weight = 0.5 * (step + np.roll(step, 1)) if closed else np.gradient(np.concatenate([[0.0], np.cumsum(step)]))

    def bending(x: np.ndarray, y: np.ndarray) -> float:
        x1, y1 = D1 @ x, D1 @ y
        speed = np.hypot(x1, y1)
        return float(weight @ ((x1 * (D2 @ y) - y1 * (D2 @ x)) ** 2 / speed**5))

    n = 0.5 * (low + high)
    nx1, nx2, ny1, ny2 = (D @ sparse.diags(v) for v in (nx, ny) for D in (D1, D2))
    for _ in range(_ROUNDS):
        x1, y1, x2, y2 = (D @ v for D in (D1, D2) for v in (X + n * nx, Y + n * ny))
        speed = np.hypot(x1, y1)
        over = speed**2.5
        value = (x1 * y2 - y1 * x2) / over  # its square, over the samples, is that of the curvature over the length
        slope = [
            sparse.diags(y2 / over - 2.5 * value * x1 / speed**2) @ nx1,
            sparse.diags(-x2 / over - 2.5 * value * y1 / speed**2) @ ny1,
            sparse.diags(x1 / over) @ ny2,
            sparse.diags(-y1 / over) @ nx2,
        ]
        E = slope[0] + slope[1] + slope[2] + slope[3]
        W = sparse.diags(weight)
        H = E.T @ W @ E + 1e-12 * sparse.eye(len(n))
        change = box_qp(sparse.csc_matrix(H), E.T @ (W @ (value - E @ n)), low, high) - n
        share = _best_share(lambda m: bending(X + m * nx, Y + m * ny), n, change)
        n = n + share * change
        if share * np.abs(change).max() < _STILL * float(np.mean(high - low)):
            break
    x, y = X + n * nx, Y + n * ny
    x1, y1 = D1 @ x, D1 @ y
    heading = np.arctan2(y1, x1) - psi
    heading = (heading + np.pi) % (2 * np.pi) - np.pi
    return n, heading, (x1 * (D2 @ y) - y1 * (D2 @ x)) / np.hypot(x1, y1) ** 3


def _best_share(cost: Callable[[np.ndarray], float], n: np.ndarray, change: np.ndarray) -> float:
    """Share of a change that lowers a cost, halved until it does; zero if none of them does."""
    share, now = 1.0, cost(n)
    while share > 0.01:
        if cost(n + share * change) < now:
            return share
        share *= 0.5
    return 0.0


def box_qp(H: sparse.csc_matrix, g: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Least ``0.5 x'H x + g'x`` within ``low < high``, by a primal-dual interior point with Mehrotra's corrector.

    ``H`` is positive definite and sparse. The bounds are kept strictly.
    """
    unit = float(np.mean(high - low))  # of x: where the search ends does not hang on what x is counted in
    H, g, low, high = unit * unit * H, unit * g, low / unit, high / unit
    x = 0.5 * (low + high)
    size = max(float(np.abs(g).max()), float(abs(H).max()), 1e-300)
    H, g = H / size, g / size
    a, b = np.ones_like(x), np.ones_like(x)  # multipliers of the bounds
    room = high - low
    first = 1.0
    for _ in range(60):
        s, t = x - low, high - x
        mu = float(s @ a + t @ b) / (2 * len(x))
        residual = H @ x + g - a + b
        if mu < _ENOUGH * first and np.abs(residual).max() < 1e-9:
            break
        solve = splu(sparse.csc_matrix(H + sparse.diags(a / s + b / t))).solve

        dx, da, db = _newton(solve, residual, (s, t, a, b), (0.0, 0.0, 0.0))
        k = min(_reach(s, dx), _reach(t, -dx), _reach(a, da), _reach(b, db))
        after = float((s + k * dx) @ (a + k * da) + (t - k * dx) @ (b + k * db)) / (2 * len(x))
        dx, da, db = _newton(solve, residual, (s, t, a, b), (mu * (after / mu) ** 3, dx * da, -dx * db))
        k = 0.995 * min(_reach(s, dx), _reach(t, -dx), _reach(a, da), _reach(b, db))
        x, a, b = x + k * dx, a + k * da, b + k * db
    return unit * np.clip(x, low + 1e-9 * room, high - 1e-9 * room)


def _newton(
    solve: Any, residual: np.ndarray, at: tuple[np.ndarray, ...], aim: tuple[Any, Any, Any]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Step of x and of the multipliers towards products of ``aim[0]``, which differ by ``aim[1:]`` from linear ones."""
    s, t, a, b = at
    ra, rb = (aim[0] - aim[1]) / s - a, (aim[0] - aim[2]) / t - b
    dx = solve(-residual + ra - rb)
    return dx, ra - a / s * dx, rb + b / t * dx


def _reach(value: np.ndarray, change: np.ndarray) -> float:
    """Longest step, at most 1, that keeps values positive."""
    falling = change < 0
    return min(1.0, float(np.min(-value[falling] / change[falling]))) if falling.any() else 1.0
