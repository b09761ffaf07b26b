"""A smooth line through noisy points: a spline with a penalty, as strong as the points' error asks for.

How strong is found by the unbiased estimate of the error that the line has at the points, for a known standard
deviation [1]_: what is off at the points alone, as other splines are cut to, follows slow noise or rounds bends off.

.. [1] G. Wahba, Spline Models for Observational Data, SIAM, 1990, sec. 4.7; the spline of P. H. C. Eilers, B. D. Marx,
   Statistical Science 11, 1996, 89-121, of degree 5 with differences of third order, its trace by random probes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import interpolate, optimize, sparse
from scipy.sparse.linalg import splu

_DEGREE, _ORDER = 5, 3
_MOST, _FEWEST = 3000, 12  # pieces of a line
_FINE = 0.1  # share of the steps between points that are shorter than a piece
_POWERS = np.arange(-4.0, 9.0)  # of ten, penalties
_STRONG = 4.0  # from which on longer pieces do
_PROBES, _SAMPLES = 16, 20
_LEFT = 0.5  # of the points' extent, at least


def smooth_line(points: np.ndarray, deviation: float, *, closed: bool) -> tuple[interpolate.BSpline, np.ndarray]:
    """Line through points, shape (n, 2) [m], over about its arc length, and where on it they are, shape (n,). [m]

    ``deviation`` is the points' standard deviation about the true line, along each axis [m]; where they themselves
    ask for more, by generalised cross-validation, it is more. The last point of a closed line is its first again.

    Raises ValueError if nothing is left of the line.
    """
    u = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    line = _fitted(points, u, deviation, closed)
    fine = np.linspace(0.0, u[-1], _SAMPLES * len(u) + 1)  # noise makes chords longer: count along the line found
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line(fine), axis=0).T))])
    u = np.interp(u, fine, arc)
    line = _fitted(points, u, deviation, closed)
    if np.ptp(line(u), axis=0).max() < _LEFT * np.ptp(points, axis=0).max():
        raise ValueError("the line shrinks")
    return line, u


def _fitted(points: np.ndarray, u: np.ndarray, deviation: float, closed: bool) -> interpolate.BSpline:
    pieces = int(np.clip(np.ceil(u[-1] / np.quantile(np.diff(u), _FINE)), _FEWEST, _MOST))
    while True:
        line = _Penalised(points, u, pieces, closed)
        guesses = line.guesses(deviation)
        if guesses.max() <= _STRONG or pieces <= _FEWEST:
            return line.of(line.best(deviation, guesses))
        pieces = max(pieces // 2, _FEWEST)


class _Penalised:
    """Lines of a number of pieces through points, by the power of ten of their penalty."""

    def __init__(self, points: np.ndarray, u: np.ndarray, pieces: int, closed: bool) -> None:
        rows = slice(0, len(u) - 1 if closed else len(u))
        t = u[-1] / pieces * np.arange(-_DEGREE, pieces + _DEGREE + 1)
        t[_DEGREE], t[-_DEGREE - 1] = 0.0, u[-1]
        n = pieces + _DEGREE
        own = np.arange(n) % pieces if closed else np.arange(n)  # coefficients of a closed line return
        self.t, self.wrap = t, sparse.csr_matrix((np.ones(n), (np.arange(n), own)))
        self.B = interpolate.BSpline.design_matrix(u[rows], t, _DEGREE).tocsr() @ self.wrap
        D = _differences(pieces if closed else n, closed)
        self.G, self.P = sparse.csc_matrix(self.B.T @ self.B), sparse.csc_matrix(D.T @ D)
        self.centre = points[rows].mean(axis=0)
        self.given = points[rows] - self.centre
        self.probes = np.random.default_rng(0).choice([-1.0, 1.0], size=(len(self.given), _PROBES))
        self.right = self.B.T @ np.column_stack([self.given, self.probes])

    def coefficients(self, power: float) -> np.ndarray:
        return splu(self.G + 10.0**power * self.P).solve(self.right)

    def errors(self, power: float, deviation: float) -> tuple[float, float]:
        """Estimates of the line's error at the points: of a known deviation, and by cross-validation."""
        there = self.B @ self.coefficients(power)
        freedom = float(np.sum(self.probes * there[:, 2:])) / _PROBES
        off = float(np.sum((self.given - there[:, :2]) ** 2))
        return off + 4.0 * deviation**2 * freedom, off / max(1.0 - freedom / len(self.given), 1e-9) ** 2

    def guesses(self, deviation: float) -> np.ndarray:
        """Whole powers at which each estimate is least."""
        found = np.array([self.errors(power, deviation) for power in _POWERS])
        return _POWERS[np.argmin(found, axis=0)]

    def best(self, deviation: float, guesses: np.ndarray) -> float:
        """The larger of the powers at which the estimates are least."""
        found = []
        for k, guess in enumerate(guesses):
            near: Any = {"bounds": (guess - 1.0, guess + 1.0), "method": "bounded", "options": {"xatol": 1e-3}}
            least: Any = optimize.minimize_scalar(lambda p, k=k: self.errors(p, deviation)[k], **near)
            found.append(float(least.x))
        return max(found)

    def of(self, power: float) -> interpolate.BSpline:
        return interpolate.BSpline(self.t, self.wrap @ self.coefficients(power)[:, :2] + self.centre, _DEGREE)


def _differences(n: int, closed: bool) -> sparse.csr_matrix:
    """Differences of third order of coefficients, around if closed."""
    found = sparse.csr_matrix(sparse.identity(n))
    for _ in range(_ORDER):
        rows = n if closed else n - 1
        i, one = np.arange(rows), np.ones(rows)
        columns = np.concatenate([i, (i + 1) % n])
        step = sparse.csr_matrix((np.concatenate([-one, one]), (np.concatenate([i, i]), columns)), shape=(rows, n))
        found, n = sparse.csr_matrix(step @ found), rows
    return found
