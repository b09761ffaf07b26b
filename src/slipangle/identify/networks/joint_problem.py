"""Free runs of physics with a network inside as a least-squares problem, and the steps that solve it."""

from __future__ import annotations

import time
import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ModelWarning
from slipangle.identify.networks.runs import PaddedRuns, side_by_side
from slipangle.models.black_box.networks import MLP, Scaling
from slipangle.models.model import FitInfo, Trial
from slipangle.models.provenance import provenance
from slipangle.models.region import Region
from slipangle.models.vehicles.neural_bicycle import NeuralBicycle, TireNetworkBicycle
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle
from slipangle.numerics.least_squares import Factors, LevenbergMarquardt, cholesky

_REACH = 5.0, 2.4  # size of the network's outputs, of the second over the wheelbase [m/s2]
_LEAST_LAG = 0.02  # the step integrates a faster steering lag inaccurately [s]
_EASY = 0.25  # share of the steps over which starts come to be thrown off as far as set
_PATIENCE = 5  # steps without progress in a row after which a fit ends
_MARGIN = 1.2  # how far beyond the training data the state may go
_UNBOUND = 1e6  # m/s and rad/s, of a state that nothing learned drives


class JointProblem:
    """The least-squares problem of a `Joint`, whose settings it takes, compiled once for all seeds."""

    def __init__(
        self, settings: Any, start: NonlinearBicycle, inner: Dataset, held: Dataset | None, *, lead: int
    ) -> None:
        from slipangle.identify.networks.unrolled import Unrolled

        self.settings, self.physics, self.inner, self.held, self.share = settings, start, inner, held, 1.0
        self.n_judged = len(start.outputs)
        s, outputs = settings, inner.outputs
        lag = max(start.params.steering_lag, _LEAST_LAG)
        params: Any = start.params.with_values(steering_lag=lag)
        size = np.std(self.inner.y, axis=0)
        most_v_y, most_r = self._bounds()
        self.template = self.kind(
            params=params,
            dt=start.dt,
            outputs=outputs,
            substeps=max(1, round(start.dt / 0.025)),
            memory=start.memory,
            network=self.network(0),
            most_v_y=most_v_y,
            most_r=most_r,
        )
        self.scale = np.array([_unit(params, name) for name in s.free])
        self.unrolled = Unrolled(self.template, s.free, self.scale, size)
        self.weights = np.where(np.arange(len(outputs)) < self.n_judged, 1.0, s.also_weight) / size
        memory, most = start.memory, np.array([most_v_y, most_r, 0.0]) / _MARGIN
        self.fitted = side_by_side(self.inner, memory, self.weights, lead=lead, away=s.thrown_off * most)
        self.judge = self.fitted if self.held is None else side_by_side(self.held, memory, self.weights)
        centre = self.unrolled.pack(self.network(0))
        n, ny = len(s.free), len(outputs)
        self.lower, self.upper = np.full(len(centre), -np.inf), np.full(len(centre), np.inf)
        for i, name in enumerate(s.free):
            least = _LEAST_LAG if name == "steering_lag" else params.si(name).lower
            self.lower[i], self.upper[i] = least / self.scale[i], params.si(name).upper / self.scale[i]
        self.precision = np.concatenate(
            [np.full(n, s.parameter_prior), np.full(len(centre) - n - ny, s.weight_prior), np.full(ny, 1e-6)]
        )
        self.precision[len(centre) - ny : len(centre) - ny + self.n_judged] = 1e6  # judged outputs have no free offset
        self.centre = np.concatenate([centre[:n], np.zeros(len(centre) - n)])

    def _bounds(self) -> tuple[float, float]:
        """Bounds of the state: from what was measured, else from the physics' own free run."""
        data, names = self.inner, ("v_y", "r")
        missing = [name for name in names if name not in data]
        if missing:
            for name in missing:
                data = data.with_channel(name, np.zeros(data.n_samples))
            run = replace(self.physics, outputs=names).simulate(data.select(outputs=names))
            for name in missing:
                data = data.with_channel(name, run.y[:, names.index(name)])
        return _MARGIN * float(np.abs(data["v_y"]).max()), _MARGIN * float(np.abs(data["r"]).max())

    @property
    def kind(self) -> type[NeuralBicycle]:
        """Class of the model."""
        return TireNetworkBicycle if self.settings.corrects == "tires" else NeuralBicycle

    def network(self, seed: int) -> MLP:
        """Random hidden layers, no output."""
        s, data = self.settings, self.inner
        size = [_REACH[0], _REACH[1] / float(self.physics.params.wheelbase)]
        size = size if s.corrects == "derivative" else [1.0] * self.kind.network_outputs[0]
        v_y = data["v_y"] if "v_y" in data else np.array([-1.5, 1.5])
        factor = [float(np.std(v_y)) + 0.1, float(np.std(data["r"])), float(np.std(data["delta"]))]
        offset = [0.0, 0.0, 0.0, 0.0, float(np.mean(data["v_x"])), 0.0]
        factor += [factor[2], float(np.std(data["v_x"])) + 0.1, float(np.std(data["v_x_dot"])) + 0.1]
        net = MLP.random(
            (6, *s.hidden, len(size)),
            activation=s.activation,
            seed=seed,
            input_scaling=Scaling(offset=np.array(offset), factor=np.array(factor)),
            output_scaling=Scaling(offset=np.zeros(len(size)), factor=np.array(size)),
        )
        return replace(net, weights=(*net.weights[:-1], 0.0 * net.weights[-1]))

    # ---- free runs as a least-squares problem ------------------------------------------------------------------

    def starts(self, theta: np.ndarray, runs: PaddedRuns) -> np.ndarray:
        """States that the runs start from, thrown off by as much as the fit has come to."""
        return self.unrolled.starts(theta, runs.heads, self.physics.outputs) + self.share * runs.away

    def error(self, theta: np.ndarray, runs: PaddedRuns) -> np.ndarray:
        """Weighted errors of every output, shape (n_runs, n, n_outputs), 0 where a sample does not count."""
        y = self.unrolled.outputs(theta, self.starts(theta, runs), runs.u)
        return (np.asarray(y) - runs.y) * runs.weight

    def judged(self, theta: np.ndarray) -> float:
        """RMSE of the model's outputs over their standard deviation, free runs."""
        runs, k = self.judge, self.n_judged
        counts = runs.weight[:, :, 0] > 0
        size = np.std(runs.y[counts][:, :k], axis=0) * self.weights[:k]
        return float(np.sqrt(np.mean((self.error(theta, runs)[counts][:, :k] / size) ** 2)))

    def cost(self, theta: np.ndarray) -> float:
        """Mean squared weighted error and priors."""
        e = self.error(theta, self.fitted)
        return float(np.sum(e * e)) / self.fitted.n_counting + float(self.precision @ (theta - self.centre) ** 2)

    def linearised(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix and half the gradient, per sample."""
        runs = self.fitted
        y, j = self.unrolled.derivatives(theta, self.starts(theta, runs), runs.u)
        e = ((np.asarray(y) - runs.y) * runs.weight).ravel()
        j = (np.asarray(j) * runs.weight[..., None]).reshape(-1, len(theta))
        hessian, gradient = j.T @ j / runs.n_counting, j.T @ e / runs.n_counting
        return hessian + np.diag(self.precision), gradient + self.precision * (theta - self.centre)

    def search(self) -> LevenbergMarquardt:
        """Steps within the bounds of the parameters."""

        def linearise(theta: np.ndarray) -> Factors:
            hessian, gradient = self.linearised(theta)
            if not (np.all(np.isfinite(hessian)) and np.all(np.isfinite(gradient))):
                hessian, gradient = np.eye(len(theta)), np.zeros(len(theta))  # no way down is known from here
            return *cholesky(hessian, gradient), None

        return LevenbergMarquardt(
            cost=self.cost,
            linearise=linearise,
            move=lambda theta, _, eta: np.clip(theta + eta, self.lower, self.upper),
            room=lambda theta: (self.lower - theta, self.upper - theta),
            steady=True,
        )

    def run(self, seed: int, data: Dataset, spent: float, told: Any) -> NeuralBicycle:
        """Levenberg-Marquardt from one seed."""
        began, s = time.perf_counter(), self.settings
        theta = self.unrolled.pack(self.network(seed))
        self.share, search = 1.0, self.search()
        cost = self.cost(theta)
        best, score = theta, self.judged(theta)
        curve, epoch, k, flat = [(0, score)], 0, 0, 0
        for k in range(1, s.max_iterations + 1):
            share = min(1.0, (k - 1) / (_EASY * s.max_iterations))
            if share != self.share:
                self.share, flat = share, 0
                cost = self.cost(theta)
            step = search.step(theta, cost)
            if step is None and share < 1.0:
                search = self.search()
                continue
            if step is None:
                break
            theta, now = step.point, self.judged(step.point)
            curve.append((k, now))
            told(k / s.max_iterations, now)
            if now < score or self.held is None:
                best, score, epoch = theta, now, k
            flat = flat + 1 if cost - step.cost < 1e-5 * cost else 0
            cost = step.cost
            if flat == _PATIENCE:
                break
        model = self.unrolled.unpack(best, self.physics.outputs)
        note = "" if epoch else "never improved on the physics it started from"
        if note:
            warnings.warn(
                f"seed {seed}: {note}; expected a smaller error: other seeds or priors", ModelWarning, stacklevel=4
            )
        seconds = spent + time.perf_counter() - began
        trial = Trial(seed=seed, score=score, epoch=epoch, epochs=k, seconds=seconds, curve=np.array(curve), note=note)
        return replace(model, fit_info=self._info(best, data, trial))

    def alone(self, tried: NeuralBicycle, doubt: str) -> NeuralBicycle:
        """The physics of the start with a network of zeros, in place of one that was tried."""
        start, net = self.physics, self.network(0)
        model = replace(
            self.template,
            params=start.params,
            outputs=start.outputs,
            substeps=start.substeps,
            network=net.with_parameters(0.0 * net.parameters),
            most_v_y=_UNBOUND,
            most_r=_UNBOUND,
        )
        info: Any = tried.fit_info
        if start.fit_info is not None:
            info = replace(start.fit_info, trials=info.trials)
        else:
            nothing = {"names": (), "units": (), "values": np.zeros(0), "covariance": np.zeros((0, 0))}
            info = replace(info, **nothing, region=None, method="the physics as it was given")
        (trial,) = info.trials
        return replace(
            model, fit_info=replace(info, warnings=(*info.warnings, doubt), trials=(replace(trial, note=doubt),))
        )

    def _info(self, theta: np.ndarray, data: Dataset, trial: Trial) -> FitInfo:
        s, n = self.settings, len(self.settings.free)
        hessian, _ = self.linearised(theta)
        e = self.error(theta, self.fitted)[self.fitted.weight[:, :, 0] > 0]
        sigma2 = float(np.mean(e[:, : self.n_judged] ** 2))
        posterior = np.linalg.inv(hessian)[:n, :n] * sigma2 / len(e)
        noise = np.std(e[:, : self.n_judged] / self.weights[: self.n_judged], axis=0)
        along = [name for name in self.inner.outputs[self.n_judged :]]
        return FitInfo(
            names=s.free,
            values=theta[:n] * self.scale,
            covariance=posterior * np.outer(self.scale, self.scale),
            noise_std=noise,
            n_samples=len(e),
            units=tuple(self.template.params.si(name).unit for name in s.free),
            seconds=trial.seconds,
            method=f"free-run error{' with ' + ', '.join(along) if along else ''}, Levenberg-Marquardt over "
            f"{len(theta)} parameters and weights, ridge priors; covariance for white residuals, given the priors",
            warnings=self.physics.fit_info.warnings if self.physics.fit_info is not None and s.start is None else (),
            **provenance(data),
            region=Region.of(data, (*self.template.inputs, *self.physics.outputs)),
            trials=(trial,),
        )


def _unit(params: Any, name: str) -> float:
    """Scale of a parameter: its value, or a share of its range where that is nearly zero."""
    meta, value = params.si(name), abs(float(getattr(params, name)))
    own = meta.lower > 0 or value > 1e-2 * (meta.upper - meta.lower) or value > 0.1
    return value if own else 0.05 * (meta.upper - meta.lower)
