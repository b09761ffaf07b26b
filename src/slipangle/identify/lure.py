"""Lur'e systems: a linear state space bent by a few static curves, fitted to its free run."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import IdentifiabilityWarning, ParameterError, SlipangleError
from slipangle.identify.excitation import require_identifiable
from slipangle.identify.freerun import FreeRun, FreeRunFit
from slipangle.identify.statespace import StateSpace
from slipangle.identify.threads import one_blas_thread
from slipangle.models.lti import LTI
from slipangle.models.lure import Curve, LureModel, bend
from slipangle.models.model import FitInfo
from slipangle.models.provenance import provenance
from slipangle.models.statespace import StateSpaceModel

_PARTS = ("A", "B", "C", "D", "W", "V", "E")


@dataclass(frozen=True, kw_only=True)
class Lure:
    """Free-run fit of a `LureModel` from the best linear model and random branches.

    Parameters
    ----------
    linear : StateSpace or StateSpaceModel
        How to fit the linear start, or the start itself.
    branches : int
        Static curves in the feedback.
    curve : {"hardening", "saturation"}
        Their shape.
    seeds : tuple of int
        One fit per seed, which draws what the branches see at first; the best free run on the training data is kept.
    memory : int
        Samples from which the model's free run reads its initial state.
    max_iterations : int
        Limit on steps per seed.
    """

    linear: StateSpace | StateSpaceModel
    branches: int = 1
    curve: Curve = "hardening"
    seeds: tuple[int, ...] = (0, 1, 2)
    memory: int = 20
    max_iterations: int = 80

    def __post_init__(self) -> None:
        if self.branches < 1 or not self.seeds:
            raise ParameterError(f"{self.branches} branches and {len(self.seeds)} seeds; expected at least one of each")

    def fit(self, data: Dataset) -> LureModel:
        """The model with the smallest free-run error on ``data`` among all seeds; each one's is in ``fit_info``.

        Warns
        -----
        IdentifiabilityWarning
            If the best fit stopped at its limit of steps.
        """
        began = time.perf_counter()
        with one_blas_thread():
            start = self.linear if isinstance(self.linear, StateSpaceModel) else self.linear.fit(data)
            problem = _Problem(self, start, data)
            found = []
            for seed in self.seeds:
                try:
                    found.append((seed, problem.fit(seed)))
                except SlipangleError:
                    continue
        if not found:
            raise ParameterError(
                f"no seed of {list(self.seeds)} gave a finite free run; expected one: use a stable start or more seeds"
            )
        seed, best = min(found, key=lambda f: float(np.sum((f[1].rmse / problem.size) ** 2)))
        notes: tuple[str, ...] = ()
        if not best.converged:
            notes = (
                f"the fit stopped at its limit of {self.max_iterations} steps; expected convergence: raise "
                "max_iterations",
            )
            warnings.warn(notes[0], IdentifiabilityWarning, stacklevel=2)
        each = ", ".join(f"seed {s}: {f.rmse[0]:.4g}" for s, f in found)
        info = FitInfo(
            names=problem.names,
            values=best.p,
            covariance=best.covariance,
            noise_std=best.rmse,
            n_samples=data.n_samples,
            units=("-",) * len(best.p),
            seconds=time.perf_counter() - began,
            method=f"free-run error, Levenberg-Marquardt with forward sensitivities; training RMSE {each}; kept {seed}",
            warnings=notes,
            **provenance(data),
        )
        return replace(problem.model(best.p), fit_info=info)


class _Problem:
    """One data set, one linear start; a seed draws the branches."""

    def __init__(self, settings: Lure, start: StateSpaceModel, data: Dataset) -> None:
        start.check(data)
        chosen = data.select(inputs=start.inputs, outputs=start.outputs)
        self.settings, self.data = settings, chosen
        self.start, self.x0 = _unit_states(start, chosen)
        n, nu, ny, h = start.order, start.n_inputs, start.n_outputs, settings.branches
        self.shapes = {"A": (n, n), "B": (n, nu), "C": (ny, n), "D": (ny, nu), "W": (h, n), "V": (h, nu), "E": (n, h)}
        self.u_offset = np.array(start.u_offset)
        n_parameters = sum(int(np.prod(s)) for s in self.shapes.values())
        require_identifiable(chosen, n_parameters // ny)
        self.size = np.maximum(np.std(chosen.y, axis=0), 1e-300)

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
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters, row by row of each matrix."""
        return tuple(f"{key}[{i},{j}]" for key, shape in self.shapes.items() for i, j in np.ndindex(shape))

    def fit(self, seed: int) -> FreeRunFit:
        """Fit from the linear model with random branches that do next to nothing at first."""
        rng = np.random.default_rng(seed)
        n, h = self.shapes["E"]
        first = {key: np.array(getattr(self.start, key)) for key in ("A", "B", "C", "D")}
        first["W"] = 1.5 * rng.standard_normal((h, n)) / np.sqrt(n)
        first["V"] = 0.1 * rng.standard_normal(self.shapes["V"]) / np.maximum(np.std(self.data.u, axis=0), 1e-300)
        first["E"] = 1e-4 * rng.standard_normal((n, h))
        p = np.concatenate([first[key].ravel() for key in _PARTS])
        return self.free_run.fit(p, self.x0, max_iterations=self.settings.max_iterations)

    def model(self, p: np.ndarray) -> LureModel:
        """The model of given parameters."""
        parts, at = {}, 0
        for key, shape in self.shapes.items():
            count = int(np.prod(shape))
            parts[key] = p[at : at + count].reshape(shape)
            at += count
        return LureModel(
            **parts,
            u_offset=self.u_offset,
            y_offset=np.array(self.start.y_offset),
            curve=self.settings.curve,
            memory=self.settings.memory,
            dt=self.data.dt,
            inputs=self.start.inputs,
            outputs=self.start.outputs,
        )


def _unit_states(start: StateSpaceModel, data: Dataset) -> tuple[StateSpaceModel, np.ndarray]:
    """The start in a basis in which its free run's states have unit covariance, and the initial states there."""
    n = start.order
    x0 = np.zeros((len(data.starts), n)) if start.x0 is None or len(start.x0) != len(data.starts) else start.x0
    see = LTI(A=start.A, B=start.B, C=np.eye(n), D=np.zeros((n, start.n_inputs)))
    u0 = np.array(start.u_offset)
    states = np.vstack([see.respond(x, part.u - u0)[0] for x, part in zip(x0, data.experiments, strict=True)])
    value, vector = np.linalg.eigh(states.T @ states / len(states))
    T = (vector / np.sqrt(np.maximum(value, 1e-12 * value[-1]))).T
    return start.transformed(T), x0 @ T.T
