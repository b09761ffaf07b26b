"""The program of a lap by a primal-dual interior point of its own.

The algorithm is that of Ipopt [1]_ without its restoration phase: a filter line search with second-order corrections,
the barrier falling in stages, the Hessian shifted where it is not convex along the equations. Its steps follow the
track, see `slipangle.optimal.lap.recursion`, where Ipopt factors a general sparse matrix.

.. [1] A. Waechter, L. T. Biegler, Math. Program. 106, 2006, 25-57; numbers in brackets are its equations.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from slipangle.optimal.lap.collocated import At, Collocated, Slopes
from slipangle.optimal.lap.recursion import Steps

_SHIFTS = (1e-4, 1e10)  # first and largest shift of the Hessian
_FREE = 1e100  # room where there is no bound


class Found(NamedTuple):
    """Where an interior point ended: variables, multipliers of equations, limits and bounds, cost, iterations.

    ``left`` is the largest scaled error of the optimality conditions.
    """

    w: np.ndarray
    lam: np.ndarray
    mu: np.ndarray
    bounds: np.ndarray
    cost: float
    iterations: int
    left: float


class _Now(NamedTuple):
    """Variables, multipliers of equations and limits, of lower and upper bounds, and the program there."""

    w: np.ndarray
    lam: np.ndarray
    mus: np.ndarray
    below: np.ndarray
    above: np.ndarray
    at: At


class _Merit(NamedTuple):
    """Before a step: violation, barrier, and the barrier's slope along it."""

    theta: float
    phi: float
    slope: float


@dataclass(eq=False)
class _Filter:
    """Violations and barriers that a step must beat; ``least`` and ``most`` of violations that it looks at."""

    least: float
    most: float
    kept: list[tuple[float, float]] = field(default_factory=list)

    def takes(self, alpha: float, before: _Merit, theta: float, phi: float) -> str:
        """How a trial is acceptable: by the barrier's fall ("armijo") or to the filter; else empty. (18) to (20)"""
        if not (np.isfinite(theta) and np.isfinite(phi)) or theta > self.most:
            return ""
        if any(theta >= t and phi >= p for t, p in self.kept):
            return ""
        fallen = phi - before.phi - 10 * np.finfo(float).eps * abs(before.phi)
        if self._is_descent(before, alpha):
            return "armijo" if fallen <= 1e-8 * alpha * before.slope else ""
        enough = theta <= (1 - 1e-5) * before.theta or fallen <= -1e-8 * before.theta
        return "filter" if enough else ""

    def _is_descent(self, before: _Merit, alpha: float) -> bool:
        steep = before.slope < 0 and alpha * (-before.slope) ** 2.3 > before.theta**1.1
        return before.theta <= self.least and steep

    def shortest(self, before: _Merit) -> float:
        """Step length below which none will be acceptable. (23)"""
        if before.slope >= 0:
            return 1e-5
        length = min(1e-5, 1e-8 * before.theta / -before.slope)
        if before.theta <= self.least:
            length = min(length, before.theta**1.1 / (-before.slope) ** 2.3)
        return length

    def keep(self, before: _Merit) -> None:
        """Let no later step come back here. (22)"""
        self.kept.append(((1 - 1e-5) * before.theta, before.phi - 1e-8 * before.theta))


class InteriorPoint:
    """The search; `run` gives the optimum, or None where it is lost: another start, or a restoration, has to help.

    ``iterations`` counts those of all runs.
    """

    def __init__(self, program: Collocated, low: np.ndarray, high: np.ndarray, tolerance: float) -> None:
        self.program, self.tolerance = program, tolerance
        self.iterations = 0
        first = program.cuts[2]
        fixed = np.zeros(program.size, dtype=bool)
        fixed[first] = high[first] - low[first] < 1e-12
        self.fixed = fixed
        self.low, self.high = np.where(fixed, -np.inf, low), np.where(fixed, np.inf, high)
        self.has_low, self.has_high = np.isfinite(self.low), np.isfinite(self.high)
        self.said = low
        self.steps = Steps(program, fixed[first])

    # ---- the barrier -------------------------------------------------------------------------------------------

    def _rooms(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.where(self.has_low, w - self.low, _FREE), np.where(self.has_high, self.high - w, _FREE)

    def _barrier(self, at: At, w: np.ndarray, mu: float) -> float:
        a, b = self._rooms(w)
        with np.errstate(divide="ignore"):  # on a bound, where no step ends
            return at.cost - mu * float(np.log(a[self.has_low]).sum() + np.log(b[self.has_high]).sum())

    @staticmethod
    def _violation(at: At) -> float:
        return float(np.abs(at.gap).sum() + np.abs(at.limit).sum())

    def _pushed(self, w: np.ndarray) -> np.ndarray:
        """A start that keeps off the bounds. (3.35)"""
        width = np.where(self.has_low & self.has_high, self.high - self.low, np.inf)
        below = np.minimum(1e-2 * np.maximum(1.0, np.abs(self.low)), 1e-2 * width)
        above = np.minimum(1e-2 * np.maximum(1.0, np.abs(self.high)), 1e-2 * width)
        w = np.where(self.has_low, np.maximum(w, self.low + np.where(self.has_low, below, 0.0)), w)
        w = np.where(self.has_high, np.minimum(w, self.high - np.where(self.has_high, above, 0.0)), w)
        return np.where(self.fixed, self.said, w)

    def _error(self, slopes: Slopes, now: _Now, mu: float) -> float:
        """Largest scaled error of the conditions of a barrier. (5)"""
        a, b = self._rooms(now.w)
        dual = slopes.lagrangian - now.below + now.above
        dual[self.fixed] = 0.0
        total = now.below.sum() + now.above.sum()
        count = self.has_low.sum() + self.has_high.sum()
        whole = np.abs(now.lam).sum() + np.abs(now.mus).sum() + total
        s_d = max(100.0, whole / (count + now.lam.size + now.mus.size)) / 100.0
        s_c = max(100.0, total / count) / 100.0
        slack = max(
            np.abs(a * now.below - mu)[self.has_low].max(),
            np.abs(b * now.above - mu)[self.has_high].max(),
        )
        gap = max(np.abs(now.at.gap).max(), np.abs(now.at.limit).max())
        return max(float(np.abs(dual).max()) / s_d, float(slack) / s_c, float(gap))

    # ---- the search --------------------------------------------------------------------------------------------

    def run(self, start: np.ndarray, mu: float, most: int) -> Found | None:
        """From a start, whose slacks are found here, with a first weight of the barrier and at most so many steps."""
        now = self._begun(start)
        if now is None:
            return None
        shifted, floor = 0.0, self.tolerance / 10
        size = max(1.0, self._violation(now.at))
        filtered = _Filter(least=1e-4 * size, most=1e4 * size)
        for iteration in range(most + 1):
            slopes = self.program.slopes(now.w, now.at, now.lam, now.mus)
            left = self._error(slopes, now, 0.0)
            if left <= self.tolerance or iteration == most:
                return Found(now.w, now.lam, now.mus, now.above - now.below, now.at.cost, iteration, left)
            while mu > floor and self._error(slopes, now, mu) <= 10 * mu:  # (7)
                mu = max(floor, min(0.2 * mu, mu**1.5))
                filtered.kept.clear()
            a, b = self._rooms(now.w)
            shift = self._factored(slopes, now.below / a + now.above / b, shifted)
            if shift is None:
                return None
            shifted = shift or shifted
            self.iterations += 1
            moved = self._moved(now, slopes, mu, filtered)
            if moved is None:
                return None
            now = moved
        return None

    def _begun(self, start: np.ndarray) -> _Now | None:
        """The start, off its bounds, with the multipliers of least squares. (36)"""
        program = self.program
        w = self._pushed(start)
        program.parts(w)[3][:] += program(w).limit
        w = self._pushed(w)
        at, lam, mus = program(w), np.zeros((program.N, 14)), np.zeros((program.n, 7))
        below, above = self.has_low.astype(float), self.has_high.astype(float)
        plain = program.slopes(w, at, lam, mus)
        if not self.steps.factor(plain._replace(H=np.zeros_like(plain.H)), np.ones(program.size), 0.0):
            return None
        _, found, limits = self.steps.solve(plain.cost - below + above, 0 * at.gap, 0 * at.limit)
        if max(np.abs(found).max(), np.abs(limits).max()) <= 1e3:
            lam, mus = found, limits
        return _Now(w, lam, mus, below, above, at)

    def _factored(self, slopes: Slopes, sigma: np.ndarray, last: float) -> float | None:
        """The shift with which the Hessian is convex along the equations; None if there is none. Algorithm IC"""
        shift = 0.0
        while not self.steps.factor(slopes, sigma, shift):
            if shift == 0.0:
                shift = max(1e-20, last / 3) if last else _SHIFTS[0]
            else:
                shift *= 8.0 if last else 100.0
            if not shift < _SHIFTS[1]:
                return None
        return shift

    def _moved(self, now: _Now, slopes: Slopes, mu: float, filtered: _Filter) -> _Now | None:
        """After a step, as long as bounds and filter allow; None where only a restoration would help."""
        w, at = now.w, now.at
        a, b = self._rooms(w)
        push = slopes.cost - mu / a + mu / b
        d, lam, mus = self.steps.solve(push, at.gap, at.limit)
        if not np.isfinite(d).all():
            return None
        tau = max(0.99, 1 - mu)
        before = _Merit(self._violation(at), self._barrier(at, w, mu), float(push @ d))
        longest = alpha = self._longest(w, d, tau)
        shortest = 0.05 * filtered.shortest(before)
        while True:
            trial = w + alpha * d
            new = self.program(trial)
            theta, phi = self._violation(new), self._barrier(new, trial, mu)
            taken = filtered.takes(alpha, before, theta, phi)
            if not taken and alpha == longest and theta >= before.theta:
                better = self._corrected(now, (alpha, new, theta), (push, tau, mu), before, filtered)
                if better is not None:
                    trial, new, lam, mus, taken = better
            if taken:
                break
            alpha *= 0.5
            if alpha < shortest:
                return None
        if taken == "filter":
            filtered.keep(before)
        change = (-now.below + (mu - now.below * d) / a, -now.above + (mu + now.above * d) / b)
        reach = min(_reach(now.below, change[0], tau), _reach(now.above, change[1], tau))
        a, b = self._rooms(trial)
        below, above = (
            np.clip(z + reach * dz, mu / (1e10 * room), 1e10 * mu / room)  # (16)
            for z, dz, room in ((now.below, change[0], a), (now.above, change[1], b))
        )
        lam, mus = now.lam + alpha * (lam - now.lam), now.mus + alpha * (mus - now.mus)
        return _Now(trial, lam, mus, below, above, new)

    def _corrected(
        self,
        now: _Now,
        tried: tuple[float, At, float],
        how: tuple[np.ndarray, float, float],
        before: _Merit,
        filtered: _Filter,
    ) -> tuple[np.ndarray, At, np.ndarray, np.ndarray, str] | None:
        """Second-order corrections of a step that grew the violation. (27)"""
        (alpha, new, theta), (push, tau, mu) = tried, how
        gap, limit = alpha * now.at.gap + new.gap, alpha * now.at.limit + new.limit
        last = theta
        for k in range(4):
            if k and theta > 0.99 * last:
                return None
            last = theta
            d, lam, mus = self.steps.solve(push, gap, limit)
            share = self._longest(now.w, d, tau)
            trial = now.w + share * d
            new = self.program(trial)
            theta = self._violation(new)
            taken = filtered.takes(alpha, before, theta, self._barrier(new, trial, mu))
            if taken:
                return trial, new, lam, mus, taken
            gap, limit = share * gap + new.gap, share * limit + new.limit
        return None

    def _longest(self, w: np.ndarray, d: np.ndarray, tau: float) -> float:
        """Longest step that keeps a share of the room to the bounds. (15)"""
        a, b = self._rooms(w)
        return min(_reach(a, d, tau), _reach(b, -d, tau))


def _reach(value: np.ndarray, change: np.ndarray, tau: float) -> float:
    falling = change < 0
    return min(1.0, float(np.min(-tau * value[falling] / change[falling]))) if falling.any() else 1.0
