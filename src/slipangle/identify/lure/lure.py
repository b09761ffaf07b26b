"""Lur'e systems: a linear state space bent by a few static curves, fitted to its free run.

Such a fit has many minima, and valleys so flat that the last bit of a sum decides how far a descent gets in them. So
the starts are many and do not depend on the basis in which the linear model came, a ridge gives the valleys a bottom,
and the search ends only once starts from different places meet in the best minimum.
"""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, replace
from typing import Annotated, Any

import casadi as ca
import numpy as np

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.errors import IdentifiabilityWarning, ParameterError, SlipangleError
from slipangle.fields import Checked, Count, Within
from slipangle.identify.excitation import require_identifiable
from slipangle.identify.linear.estimator import channels, described
from slipangle.identify.linear.poles import shrunk
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.lure.starts import Branches, drawn, unit_states
from slipangle.identify.physics.free_run import FreeRun, FreeRunFit
from slipangle.models.black_box.lure import Curve, LureModel, bend, far_out
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.model import Model
from slipangle.models.region import Region
from slipangle.numerics.blas import one_blas_thread

_PARTS = ("A", "B", "C", "D", "W", "V", "E")
_SAME = 0.005  # relative difference of two objectives up to which two descents met in one minimum
_SHARE = 0.3  # of a branch's best effect at first order, with which its fit begins: bends are not of first order
_WEAK, _FIRST = 0.1, 40  # share of the linear model's variance that weighs the ridge at first, and steps so
_AT_LEAST = 3  # descents to the end
_ROUNDS = 6  # of weighing the ridge by the error and solving again
_SETTLED = 0.01  # relative change of the error's variance that ends this


@dataclass(frozen=True, kw_only=True)
class Lure(Checked):
    """Free-run fit of a `LureModel` from the best linear model and the most promising of many random branches.

    Parameters
    ----------
    linear : StateSpace or StateSpaceModel
        How to fit the linear start, or the start itself.
    branches : int
        Static curves in the feedback.
    curve : {"hardening", "saturation"}
        Their shape.
    ridge : float
        Weight of the squared parameters, A to D from those of the linear start, each in its natural unit (states and
        inputs in their standard deviations), against squared errors in their standard deviation: a parameter one
        unit off costs as much as ``ridge`` samples that are off by their standard deviation.
    max_radius : float
        Limit on the spectral radius of the dynamics far from rest: below 1 every bounded input gives a bounded free
        run, see `LureModel`. [-]
    starts : int
        Random branches that are compared at first order; fewer on long records.
    carried : int
        Of these, how many are fitted for a few steps; then, in the order of what these gave, to the end, until two
        of at least three met in the best minimum. Twice as many again follow where they do not.
    seed : int
        Of the random branches.
    memory : int
        Samples from which the model's free run reads its initial state.
    max_iterations : int
        Steps of one fit at most.
    """

    linear: StateSpace | StateSpaceModel
    branches: Count = 1
    curve: Curve = "hardening"
    starts: Count = 500
    carried: Count = 8
    seed: int = 0
    ridge: Annotated[float, Within(0, 1e300, example="300")] = 300.0
    max_radius: Annotated[float, Within(0, open="low", example="0.9999")] = 0.9999
    memory: int = 20
    max_iterations: int = 200

    def fit(self, data: Dataset) -> LureModel:
        """The model with the least free-run error on ``data`` and ridge; what the starts gave is in ``fit_info``.

        Warns with IdentifiabilityWarning if the best fit stopped at its limit of steps, or no two starts met in the
        best minimum.
        """
        require_dataset(data, "fit() got")
        began = time.perf_counter()
        with one_blas_thread():
            start = self.linear if isinstance(self.linear, Model) else self.linear.fit(data)
            problem = _Problem(self, start, data)
            best, costs = problem.search()
        met = int(np.sum(costs <= costs[0] + _SAME * problem.n_rows))
        notes: tuple[str, ...] = ()
        if not best.converged:
            notes += (
                f"the fit stopped at its limit of {self.max_iterations} steps; expected convergence: raise "
                "max_iterations or the ridge",
            )
        if met < 2:
            notes += (
                f"one of {len(costs)} starts reached the best minimum; expected two: raise carried or the ridge, so "
                "that the result does not hang on chance",
            )
        for note in notes:
            warnings.warn(note, IdentifiabilityWarning, stacklevel=2)
        info = described(
            data,
            began,
            names=problem.names,
            values=best.p,
            covariance=best.covariance,
            noise_std=best.rmse,
            n_samples=data.n_samples,
            region=Region.of(data),
            method="free-run error and ridge, Levenberg-Marquardt with forward sensitivities; "
            f"{met} of {len(costs)} starts met in the minimum kept",
            warnings=notes,
        )
        return replace(problem.model(best.p), fit_info=info)


class _Problem:
    """One data set, one linear start."""

    def __init__(self, settings: Lure, start: StateSpaceModel, data: Dataset) -> None:
        start.check(data)
        chosen = data.select(inputs=start.inputs, outputs=start.outputs)
        self.settings, self.data = settings, chosen
        self.start, self.x0 = unit_states(start, chosen)
        n, nu, ny, h = start.order, start.n_inputs, start.n_outputs, settings.branches
        self.shapes = {"A": (n, n), "B": (n, nu), "C": (ny, n), "D": (ny, nu), "W": (h, n), "V": (h, nu), "E": (n, h)}
        self.u_offset = np.array(start.u_offset)
        n_parameters = sum(int(np.prod(s)) for s in self.shapes.values())
        require_identifiable(chosen, n_parameters // ny)
        self.size = np.maximum(np.std(chosen.y, axis=0), 1e-300)
        self.n_rows = chosen.n_samples * ny
        self.mean, self.unit = self._ridge()

        def unpack(p: Any) -> dict[str, Any]:
            parts, at = {}, 0
            for key, (rows, columns) in self.shapes.items():
                parts[key] = ca.reshape(p[at : at + rows * columns], columns, rows).T
                at += rows * columns
            return parts

        def step(x: Any, u: Any, p: Any) -> Any:
            m = unpack(p)
            bent = bend(settings.curve, m["W"] @ x + m["V"] @ u)
            return m["A"] @ x + m["B"] @ u + m["E"] @ bent

        def output(x: Any, u: Any, p: Any) -> Any:
            m = unpack(p)
            return m["C"] @ x + m["D"] @ u

        self.free_run = FreeRun(
            step,
            output,
            n_states=n,
            n_parameters=n_parameters,
            records=[(part.u - self.u_offset, part.y - np.array(start.y_offset)) for part in chosen.experiments],
            error=self.size,
            free_x0=tuple(range(n)),
            inside=self._inside,
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters, row by row of each matrix."""
        return tuple(f"{key}[{i},{j}]" for key, shape in self.shapes.items() for i, j in np.ndindex(shape))

    def _ridge(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the ridge pulls the parameters, and their natural units."""
        u, y = np.maximum(np.std(self.data.u, axis=0), 1e-300), self.size[:, None]
        units = {"A": 1.0, "B": 1 / u, "C": y, "D": y / u, "W": 1.0, "V": 1 / u, "E": 1.0}
        mean = [np.ravel(getattr(self.start, k)) if k in "ABCD" else np.zeros(np.prod(self.shapes[k])) for k in _PARTS]
        return np.concatenate(mean), np.concatenate([np.broadcast_to(units[k], self.shapes[k]).ravel() for k in _PARTS])

    def search(self) -> tuple[FreeRunFit, np.ndarray]:
        """The best fit, and the objectives that the starts reached, rising."""
        settings = self.settings
        how: Any = {"count": settings.starts, "seed": settings.seed}
        branches = drawn(self.start, self.x0, self.data, curve=settings.curve, branches=settings.branches, **how)
        fits: list[tuple[float, FreeRunFit]] = []
        for batch in range(3):
            begun = []
            for branch in branches[batch * settings.carried : (batch + 1) * settings.carried]:
                try:
                    begun.append(self._begin(branch))
                except SlipangleError:
                    continue
            for _, first in sorted(begun, key=lambda b: b[0]):
                fits = sorted([*fits, self._finish(first)], key=lambda f: f[0])
                if len(fits) >= _AT_LEAST and fits[1][0] - fits[0][0] < _SAME * self.n_rows:
                    return fits[0][1], np.array([f[0] for f in fits])
        if not fits:
            raise ParameterError(
                f"no start gave a finite free run within max_radius = {settings.max_radius:g}; expected one: use a "
                "stable linear start, such as StateSpace(max_radius=0.999)"
            )
        return fits[0][1], np.array([f[0] for f in fits])

    def _begin(self, branches: Branches) -> tuple[float, FreeRunFit]:
        """Objective and fit after a few steps from given branches.

        The ridge is weak at first: weighed by the linear model's error it would pull branches to nothing before they
        have found their place. They start with a share of what they do at best to first order.
        """
        extra = np.concatenate([np.ravel(part) for part in (branches.W, branches.V, _SHARE * branches.E)])
        p = self._inside(np.concatenate([self.mean[: len(self.mean) - len(extra)], extra]))
        self._weigh(_WEAK * self._variance(self.mean, self.x0))
        fit = self.free_run.fit(p, self.x0, max_iterations=_FIRST)
        return self._objective(fit), fit

    def _finish(self, fit: FreeRunFit) -> tuple[float, FreeRunFit]:
        """Objective and fit at the minimum: the variance of the error weighs the ridge, so both are found in turn."""
        variance = self._variance(fit.p, fit.x0)
        for _ in range(_ROUNDS):
            self._weigh(variance)
            fit = self.free_run.fit(fit.p, fit.x0, max_iterations=self.settings.max_iterations)
            before, variance = variance, self._variance(fit.p, fit.x0)
            if abs(variance - before) < _SETTLED * before:
                break
        return self._objective(fit), fit

    def _objective(self, fit: FreeRunFit) -> float:
        """Twice the negative logarithm of the posterior, for white normal errors of unknown variance."""
        pull = self.settings.ridge * np.sum(((fit.p - self.mean) / self.unit) ** 2)
        return float(self.n_rows * np.log(self._variance(fit.p, fit.x0)) + pull)

    def _variance(self, p: np.ndarray, x0: np.ndarray) -> float:
        """Mean squared error, in the outputs' variances; the smallest that still says anything on exact data."""
        squares = [np.sum(((y - self.free_run.run(p, x, u)) / self.size) ** 2) for x, (u, y) in self._records(x0)]
        return max(float(np.sum(squares)) / self.n_rows, 1e-12)

    def _records(self, x0: np.ndarray) -> Any:
        return zip(x0, self.free_run.records, strict=True)

    def _weigh(self, variance: float) -> None:
        if self.settings.ridge > 0:
            self.free_run.prior = (self.mean, self.unit / np.sqrt(self.settings.ridge * variance))

    def _inside(self, p: np.ndarray) -> np.ndarray:
        """Parameters whose dynamics far from rest have their poles within ``max_radius``; A gives way."""
        parts = self._parts(p)
        far = far_out(self.settings.curve, parts["A"], parts["E"], parts["W"])
        moved = p.copy()
        moved[: far.size] += (shrunk(far, self.settings.max_radius) - far).ravel()
        return moved

    def model(self, p: np.ndarray) -> LureModel:
        """The model of given parameters."""
        parts: dict[str, Any] = self._parts(p)
        parts |= {"u_offset": self.u_offset, "y_offset": np.array(self.start.y_offset)}
        return LureModel(**parts, curve=self.settings.curve, memory=self.settings.memory, **channels(self.data))

    def _parts(self, p: np.ndarray) -> dict[str, np.ndarray]:
        """The matrices in the parameters."""
        ends = np.cumsum([int(np.prod(shape)) for shape in self.shapes.values()])
        return {k: v.reshape(self.shapes[k]) for k, v in zip(self.shapes, np.split(p, ends[:-1]), strict=True)}
