"""NARX networks by Gauss-Newton on the whole free run, from weights that Adam found."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.errors import ModelWarning
from slipangle.fields import Checked, Count, Positive
from slipangle.identify.networks.estimator import LINEAR
from slipangle.identify.networks.narx import NARX
from slipangle.identify.networks.training import Progress, require_jax
from slipangle.models.black_box.narx import NARXModel
from slipangle.models.black_box.networks import Scaling
from slipangle.models.model import Trial
from slipangle.numerics.least_squares import LevenbergMarquardt, cholesky


@dataclass(frozen=True, kw_only=True)
class FreeRunNARX(Checked):
    """Levenberg-Marquardt on the free-run error of a NARX network, with a ridge prior on its weights.

    For networks of up to a few hundred weights. The derivatives of the whole free run are exact, so a few dozen steps
    do what thousands of epochs on short windows do not. A network that starts from a linear model (see `NARX`) is
    fitted to what ``start`` does not hold out, its linear path drawn to where Adam left it instead of to zero, and kept
    at the step whose free run over the held-out part is best; others are fitted to all of the data.

    Parameters
    ----------
    start : NARX
        Lags, architecture, seeds and the training that the weights start from.
    weight_prior : float
        Precision of the prior per sample and per unit of scaled weight, relative to the mean squared error that the
        weights start from.
    max_iterations : int
        Steps at most.
    """

    start: NARX
    weight_prior: Positive = 6e-3
    max_iterations: Count = 50

    def fit(self, data: Dataset, *, progress: Progress | None = None) -> NARXModel:
        """The model of the seed whose free run over the training data has the smallest error.

        Raises ExcitationError or TooShortError as `NARX.fit`.

        Warns with ModelWarning as it does, unless these steps found a better model than the linear one.
        """
        require_dataset(data, "fit() got")
        require_jax("fitting a NARX network")
        from slipangle.identify.networks import adam

        began = time.perf_counter()
        models: list[NARXModel] = []
        start, chosen = self.start.settled(data)
        inner, held = start.cut(data) if start.linear_start else (data, None)
        for i, seed in enumerate(start.seeds):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ModelWarning)  # of what the free-run fit may mend
                first = replace(start, seeds=(seed,))._fit(data, time.perf_counter(), None, chosen.linear)
            with adam.precision("double"):
                models.append(_Polish(self, first, inner, held).run(seed, data))
            if progress is not None:
                progress((i + 1) / len(start.seeds), f"free-run fit, seed {i + 1} of {len(start.seeds)}")
        trials = tuple(t for m in models if m.fit_info for t in m.fit_info.trials)
        for note in (n for m in models if m.fit_info for n in m.fit_info.warnings):
            warnings.warn(note, ModelWarning, stacklevel=2)
        best: Any = min(models, key=lambda m: m.fit_info.trials[0].score if m.fit_info else np.inf)
        found: Any = {"trials": trials, "seconds": time.perf_counter() - began, "candidates": chosen.candidates}
        if chosen.said:
            found["method"] = f"{chosen.said}; {best.fit_info.method}"
        return replace(best, fit_info=replace(best.fit_info, **found))


class _Polish:
    """The free run of one model as a least-squares problem in scaled coordinates."""

    def __init__(self, settings: FreeRunNARX, model: NARXModel, data: Dataset, held: Dataset | None) -> None:
        from slipangle.identify.networks.unrolled import unrolled_lags

        net: Any = model.network.perceptron
        self.settings, self.model, self.net, self.prior = settings, model, net, 0.0
        self.unrolled = unrolled_lags(net)
        self.pieces = self._pieces(data)
        self.rows = sum(len(y) for _, _, y in self.pieces)
        self.held = None if held is None else self._pieces(held)
        self.pull = np.zeros(net.n_parameters)  # where the prior is
        if net.skip is not None:
            self.pull[-net.skip.size :] = net.skip.ravel()

    def _pieces(self, data: Dataset) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Past outputs, inputs and outputs of the free run over each experiment, scaled."""
        ny, nu, na = len(self.model.outputs), len(self.model.inputs), self.model.na
        lags: Scaling = self.net.input_scaling
        scaling_y, split = self.net.output_scaling, na * ny
        scaling_u = Scaling(offset=lags.offset[split : split + nu], factor=lags.factor[split : split + nu])
        pieces = []
        m, nk, nb = self.model.memory, self.model.nk, self.model.nb
        for part in data.select(inputs=self.model.inputs, outputs=self.model.outputs).experiments:
            if part.n_samples <= m:
                continue
            u, y = scaling_u.apply(part.u.T).T, scaling_y.apply(part.y.T).T
            past = np.concatenate([y[m - i] for i in range(1, na + 1)])
            n = part.n_samples
            drives = np.hstack([u[m - j : n - j] for j in range(nk, nk + nb)])
            pieces.append((past, drives, y[m:]))
        return pieces

    def _error(self, theta: np.ndarray, pieces: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> float:
        """Mean squared free-run error; infinite or no number where a run grows beyond all bounds."""
        with np.errstate(over="ignore", invalid="ignore"):
            errors = [np.asarray(self.unrolled.run(theta, past, drives)) - y for past, drives, y in pieces]
            return sum(float(np.sum(e * e)) for e in errors) / sum(len(y) for _, _, y in pieces)

    def cost(self, theta: np.ndarray) -> float:
        """Mean squared free-run error and prior."""
        off = theta - self.pull
        return self._error(theta, self.pieces) + self.prior * float(off @ off)

    def linearised(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix and half the gradient."""
        n = len(theta)
        matrix, gradient = np.zeros((n, n)), np.zeros(n)
        for past, drives, y in self.pieces:
            predicted, jacobian = self.unrolled.derivatives(theta, past, drives)
            e = (np.asarray(predicted) - y).ravel()
            j = np.asarray(jacobian).reshape(-1, n)
            matrix += j.T @ j
            gradient += j.T @ e
        return matrix / self.rows + self.prior * np.eye(n), gradient / self.rows + self.prior * (theta - self.pull)

    def run(self, seed: int, data: Dataset) -> NARXModel:
        """Steps until nothing improves; the model with its trial, and its residuals on all of the data."""
        began = time.perf_counter()
        theta = self.net.parameters
        start = self.cost(theta)
        if not np.isfinite(start):
            return self.model
        self.prior = self.settings.weight_prior * start
        cost = self.cost(theta)
        search = LevenbergMarquardt(
            cost=self.cost,
            linearise=lambda theta: (*cholesky(*self.linearised(theta)), None),
            move=lambda theta, _, eta: theta + eta,
            damping=1e-2,
            steady=True,
        )
        best, score = theta, np.sqrt(cost if self.held is None else self._error(theta, self.held))
        curve, at = [(0, score)], 0
        for k in range(1, self.settings.max_iterations + 1):
            step = search.step(theta, cost)
            if step is None:
                break
            flat = cost - step.cost < 1e-5 * cost
            theta, cost = step.point, step.cost
            now = np.sqrt(cost if self.held is None else self._error(theta, self.held))
            curve.append((k, now))
            if self.held is None or now < score:
                best, score, at = theta, now, k
            if flat:
                break
        model = replace(self.model, network=self.net.with_parameters(best))
        info: Any = self.model.fit_info
        trial = Trial(
            seed=seed,
            score=float(score),
            epoch=at,
            epochs=len(curve) - 1,
            seconds=info.seconds + time.perf_counter() - began,
            curve=np.array(curve, dtype=float),
        )
        one = model.predict(data)
        method = f"free-run error, Levenberg-Marquardt with ridge prior, step {at}; start: {info.method}"
        noise = np.std(one.error[one.predicted], axis=0)
        notes = tuple(n for n in info.warnings if not (at and n.endswith(LINEAR)))
        found = {"trials": (trial,), "method": method, "noise_std": noise, "warnings": notes}
        return replace(model, fit_info=replace(info, **found))
