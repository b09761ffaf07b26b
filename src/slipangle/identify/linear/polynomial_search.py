"""The search for a polynomial model: where its coefficients are, and the prediction-error criterion over them."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import linalg

from slipangle.data.dataset import Dataset
from slipangle.identify.linear.arx import per_input
from slipangle.identify.linear.estimator import channels
from slipangle.identify.linear.pem import PEM
from slipangle.identify.linear.poles import shrunk
from slipangle.identify.linear.prediction import PredictionCriterion
from slipangle.identify.linear.predictor import Point
from slipangle.models.black_box.polynomial import PolynomialModel, realise


class Layout:
    """Where each coefficient is in the vector: A, then B and F of each input, then C and D."""

    def __init__(self, settings: Any, data: Dataset) -> None:
        nu = len(data.inputs)
        self.na, self.nc, self.nd = settings.na, settings.nc, settings.nd
        self.nb, self.nf, self.nk = (per_input(getattr(settings, n), n, data) for n in ("nb", "nf", "nk"))
        self.count = self.na + sum(self.nb) + sum(self.nf) + self.nc + self.nd
        self.nu = nu

    def waiting(self, data: Dataset) -> tuple[Layout, Dataset]:
        """The same with delays of at least 1, for data in which inputs that act at once come one sample earlier."""
        ahead = [data.index(n) for n, k in zip(data.inputs, self.nk, strict=True) if k == 0]
        if not ahead:
            return self, data
        later = copy(self)
        later.nk = tuple(max(k, 1) for k in self.nk)
        pieces, starts, times = [], [], []
        for a, b, t0 in zip(data.starts, data.stops, data.start_times, strict=True):
            if b - a < 2:
                continue
            rows = np.array(data.values[a : b - 1])
            rows[:, ahead] = data.values[a + 1 : b, ahead]
            starts.append(sum(map(len, pieces)))
            times.append(t0)
            pieces.append(rows)
        return later, replace(data, values=np.vstack(pieces), starts=tuple(starts), start_times=tuple(times))

    def parts(self, theta: np.ndarray) -> dict[str, Any]:
        """The polynomials of a vector of coefficients."""
        pieces = np.split(theta, np.cumsum([self.na, *self.nb, *self.nf, self.nc, self.nd])[:-1])
        A, *both, C, D = pieces
        return {"A": A, "B": both[: self.nu], "F": both[self.nu :], "C": C, "D": D}

    def names(self, data: Dataset) -> tuple[str, ...]:
        """Such as ``a1``, ``b1[delta]``."""
        labels = [f"a{i + 1}" for i in range(self.na)]
        for letter, counts, first in (("b", self.nb, self.nk), ("f", self.nf, (1,) * self.nu)):
            for name, count, start in zip(data.inputs, counts, first, strict=True):
                labels += [f"{letter}{i + start}[{name}]" for i in range(count)]
        return (*labels, *(f"c{i + 1}" for i in range(self.nc)), *(f"d{i + 1}" for i in range(self.nd)))

    def model(self, theta: np.ndarray, data: Dataset, u0: np.ndarray, y0: float) -> PolynomialModel:
        """The model of a vector of coefficients, inputs and output at rest."""
        return PolynomialModel(**self.parts(theta), nk=self.nk, u_offset=u0, y_offset=y0, **channels(data))


class Structured(PredictionCriterion):
    """The prediction-error criterion over coefficients: the predictor is affine in them."""

    def __init__(self, settings: Any, layout: Layout, start: PolynomialModel, theta: np.ndarray, data: Dataset) -> None:
        self.layout, self.theta, self.polynomial = layout, theta, settings
        base = self._predictor(np.zeros(layout.count))
        columns = [
            np.concatenate([(v - w).ravel() for v, w in zip(self._predictor(unit), base, strict=True)])
            for unit in np.eye(layout.count)
        ]
        self.by_theta = np.array(columns).T.reshape(-1, layout.count)
        if settings.offset:
            wide: Any = linalg.block_diag(self.by_theta, np.ones((1, 1)))
            self.by_theta = wide
        super().__init__(
            PEM(start=start.realisation, offsets="output" if settings.offset else "none", direct=False), data
        )

    def _predictor(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        A, B, C, K = realise(nk=self.layout.nk, **self.layout.parts(theta))
        return A - K @ C, B, K

    def _matrices(self, direct: bool) -> tuple[str, ...]:
        return ("F", "G", "K")

    def _n_determined(self) -> int:
        return self.layout.count

    def _first(self, direct: bool) -> Point:
        start = self.settings.start
        F, G, K = self._predictor(self.theta)
        return Point(
            F=F,
            G=G,
            C=np.array(start.C),
            D=np.zeros((self.ny, self.nu)),
            K=K,
            u_offset=np.array(start.u_offset),
            y_offset=np.array(start.y_offset),
            x0=np.zeros((len(self.data.starts), self.n)),
        )

    def _moves(self, point: Point) -> np.ndarray:
        return self.by_theta

    def as_named(self, point: Point, moves: np.ndarray) -> np.ndarray:
        """Derivative of the coefficients by the moves, which are theirs."""
        return np.eye(moves.shape[1])

    def _descend(
        self, point: Point, max_iterations: int, tolerance: float, damping: float
    ) -> tuple[Point, tuple[str, ...]]:
        """Where the model has several parts, their initial states have the output's variance as their prior.

        Without one, where two parts have nearly the same pole, their initial states grow against each other to explain
        the first samples, and the search gets stuck there.
        """
        if self.layout.nd == 0 and not any(self.layout.nf):
            return super()._descend(point, max_iterations, tolerance, damping)
        rest = self.moments(self._with_initial_states(point))
        noise = np.sqrt(float(np.trace(self.root @ rest @ self.root.T)) / self.n_rows)
        self.x0_weight = np.full(self.n, noise / float(self.size[0]))
        return super()._descend(point, max_iterations, tolerance, damping)

    def moved(self, point: Point, theta: np.ndarray, x0: np.ndarray) -> Point:
        """The point after a step; infinite cost where the predictor is unstable or the poles leave the limit."""
        new = super().moved(point, theta, x0)
        limit = self.polynomial.max_radius
        A = new.F + new.K @ new.C
        if np.isfinite(A).all():
            past = limit is not None and shrunk(A, limit) is not A
            if past or shrunk(new.F, 1.0) is not new.F:  # roots of C and F, which the errors go through
                return replace(new, F=np.full_like(new.F, np.nan))
        return new

    def projected(self, point: Point) -> Point:
        """The point itself: the coefficients enter F and G or K together."""
        return point

    def theta_of(self, point: Point) -> np.ndarray:
        """Coefficients of a point."""
        now = np.concatenate([getattr(point, k).ravel() for k in ("F", "G", "K")])
        then = np.concatenate([getattr(self.point, k).ravel() for k in ("F", "G", "K")])
        count = self.layout.count
        return self.theta + np.linalg.lstsq(self.by_theta[: len(now), :count], now - then, rcond=None)[0]
