"""Output-error and Box-Jenkins models of unstable systems: a predictor that is stable, by a disturbance that fits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import SlipangleError
from slipangle.identify.linear.polynomial_search import Layout, Structured
from slipangle.identify.linear.polynomial_start import long_arx
from slipangle.identify.linear.predictor import Point
from slipangle.identify.stability import SETTLED
from slipangle.models.black_box.polynomial import one

_SURE = 10.0  # logarithm of the likelihood, twice, by which an unstable model must be better
_STEP = 1e-6  # of a coefficient, for derivatives


class Unstable(Structured):
    """The criterion of an output-error or Box-Jenkins model whose F has roots outside the unit circle.

    The predictor of ``y = B / F u + C / D e`` has the roots of F. With F = F_s F_u, whose second factor has those
    outside, and F_m, that factor with its roots mirrored into the circle, the model
    ``y = B / (F_s F_u) u + F_m / F_u C / D e`` has a stable predictor [1]_; as ``F_m / F_u`` passes all frequencies
    alike, its e is another white noise of the same kind. As a `Polynomial` it has A = F_u, F = F_s and F_m C in
    place of C. Several inputs share F_u: a mode that a controller holds is one of the whole system.

    References
    ----------
    .. [1] U. Forssell, L. Ljung, Identification of unstable systems using output error and Box-Jenkins model
       structures, IEEE Transactions on Automatic Control 45, 2000.
    """

    def _whole(self, theta: np.ndarray) -> np.ndarray:
        """All coefficients, of those that are free: C is without the mirrored factor there."""
        a, middle, c, d, level = self._pieces(theta, self.layout.nc - self.layout.na)
        return np.concatenate([a, middle, np.convolve(_mirrored(a), one(c))[1:], d, level])

    def _free(self, whole: np.ndarray) -> np.ndarray:
        a, middle, c, d, level = self._pieces(whole, self.layout.nc)
        return np.concatenate([a, middle, np.polydiv(one(c), _mirrored(a))[0][1:], d, level])

    def _pieces(self, values: np.ndarray, nc: int) -> list[np.ndarray]:
        layout = self.layout
        edges = np.cumsum([layout.na, sum(layout.nb) + sum(layout.nf), nc, layout.nd])
        return np.split(values, edges)

    def _now(self, point: Point) -> np.ndarray:
        """All coefficients and the level."""
        level = point.y_offset if self.polynomial.offset else np.zeros(0)
        return np.concatenate([self.theta_of(point), level])

    def _slopes(self, point: Point) -> np.ndarray:
        """Derivative of all coefficients by those that are free."""
        theta = self._free(self._now(point))
        steps = _STEP * np.maximum(np.abs(theta), 0.1)
        up, down = (np.array([self._whole(theta + by) for by in sign * np.diag(steps)]).T for sign in (1, -1))
        return (up - down) / (2 * steps)

    def _moves(self, point: Point) -> np.ndarray:
        return self.by_theta @ self._slopes(point)

    def as_named(self, point: Point, moves: np.ndarray) -> np.ndarray:
        """Derivative of all coefficients by those that are free."""
        return self._slopes(point)

    def _n_determined(self) -> int:
        return self.layout.count - self.layout.na

    def moved(self, point: Point, theta: np.ndarray, x0: np.ndarray) -> Point:
        """The point after a step, with the mirrored factor that belongs to its new F."""
        now = self._now(point)
        step = np.linalg.lstsq(self._moves(point), theta, rcond=None)[0]
        return super().moved(point, self.by_theta @ (self._whole(self._free(now) + step) - now), x0)


def better_unstable(
    settings: Any, layout: Layout, stable: tuple[Structured, Point], data: Dataset, u0: np.ndarray, y0: float
) -> tuple[Structured, Point, Any, tuple[str, ...]] | None:
    """The criterion, its minimum, settings and notes of a model with poles outside the unit circle, where it is better.

    ``stable`` are criterion and minimum of the model that has none there. None where a long ARX model has none either,
    where that is no better, and where the settings limit the poles or ask for another structure.
    """
    if settings.max_radius is not None or settings.na or not all(layout.nf):
        return None
    try:
        start = _start(settings, layout, data, u0, y0)
    except SlipangleError:
        return None
    if start is None:
        return None
    wide, theta = start
    theirs = Layout(wide, data)
    problem = Unstable(wide, theirs, theirs.model(theta, data, u0, y0), theta, data)
    try:
        point, notes = problem.solve(settings.max_iterations)
    except (SlipangleError, np.linalg.LinAlgError, ValueError):
        return None
    before, after = (float(p.moments(at)[0, 0]) for p, at in (stable, (problem, point)))
    if not before > after * np.exp(_SURE / problem.n_rows):
        return None
    return problem, point, wide, notes


def _start(settings: Any, layout: Layout, data: Dataset, u0: np.ndarray, y0: float) -> tuple[Any, np.ndarray] | None:
    """Settings with the unstable part of F as A, and coefficients, from an ARMAX model; None where that is stable."""
    order = max(layout.nf)
    long = long_arx(data, u0, y0, settings, max(*layout.nb, order, settings.nc, settings.nd), max(layout.nk))
    if _largest(long.A[:, 0, 0]) <= SETTLED:
        return None
    given = {"nb": layout.nb, "nk": layout.nk}
    shared = replace(settings, na=order, nf=0, nc=order, nd=0, **given)._fit(data)
    roots = np.array(sorted(np.roots(one(shared.A)), key=abs, reverse=True))
    n = int(np.sum(np.abs(roots) > SETTLED))
    if not 0 < n <= min(layout.nf):
        return None
    wide = replace(settings, na=n, nf=tuple(k - n for k in layout.nf), nc=settings.nc + n, **given)
    outside, inside = np.poly(roots[:n]).real, [np.atleast_1d(np.poly(roots[n:k])).real[1:] for k in layout.nf]
    C = np.concatenate([_mirrored(outside[1:])[1:], np.zeros(settings.nc)])
    return wide, np.concatenate([outside[1:], *shared.B, *inside, C, np.zeros(settings.nd)])


def _largest(coefficients: np.ndarray) -> float:
    """Modulus of the largest root of a polynomial without its leading 1."""
    return float(np.abs(np.roots(one(coefficients))).max(initial=0.0))


def _mirrored(coefficients: np.ndarray) -> np.ndarray:
    """The polynomial, its leading 1 included, with the roots outside the unit circle mirrored into it."""
    roots = np.roots(one(coefficients)).astype(complex)
    outside = np.abs(roots) > 1
    roots[outside] = 1 / roots[outside].conj()
    return np.atleast_1d(np.poly(roots)).real
