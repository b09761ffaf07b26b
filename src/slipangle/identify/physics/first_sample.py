"""What the noise of the samples that free runs start from does to estimates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slipangle.errors import SlipangleError
from slipangle.identify.physics.simulation_error import FreeRunProblem, Minimum

_AT_BOUND = 1e-5  # scaled distance to a bound up to which a parameter ends there
_STEP = 1e-3  # of a channel at the first sample, over its standard deviation


@dataclass(frozen=True, kw_only=True)
class StartNoise:
    """Noise of the first samples, apart from that of all others."""

    error: np.ndarray  # (n_rows * n_outputs,), weighted errors without what such noise explains of them
    pull: np.ndarray  # (n, n_sources), gradient of half the cost by one standard deviation of each source
    explained: int  # degrees of freedom of the errors that this took


def start_noise(problem: FreeRunProblem, found: Minimum, jacobian: np.ndarray) -> StartNoise:
    """Errors and sources of a solution whose initial states are read from measured, noisy samples.

    The noise of a first sample lasts as long as the transient that it starts, in all errors alike: left among them it
    passes for their colour and size, and still not for what it does to estimates, which fit it. The Jacobian, shape
    (n_rows * n_outputs, n), has the derivatives along directions in which the unknowns can move.
    """
    nothing = StartNoise(error=found.error, pull=np.zeros((jacobian.shape[1], 0)), explained=0)
    if problem.n_x0 or found.diverged or problem.own_free_run_misses(found):
        return nothing
    names = _sources(problem, found.z)
    if not names:
        return nothing
    n, ny = len(names), problem.model.n_outputs
    with np.errstate(over="ignore", invalid="ignore"):
        slopes = [problem.by_first_sample(i, found.z, names) for i in range(problem.n_e)]
        transients = [_transient(problem, found.z, i, slope) for i, slope in enumerate(slopes)]
    ends = np.cumsum([len(t) for t in transients])[:-1]
    if len(found.error) <= len(found.z) + n * problem.n_e or not all(np.isfinite(t).all() for t in transients):
        return nothing
    errors, jacobians = np.split(found.error, ends), np.split(jacobian, ends)
    bases = [_basis(t) for t in transients]
    left = [_without(q, np.column_stack([j, e])) for q, j, e in zip(bases, jacobians, errors, strict=True)]
    moved = np.concatenate(left)
    slopes_left, rest = moved[:, :-1], moved[:, -1]
    if len(found.z) == jacobian.shape[1]:  # what ends at its bound stays there without such noise too
        slopes_left = slopes_left[:, (found.z > problem.lower + _AT_BOUND) & (found.z < problem.upper - _AT_BOUND)]
    cleaned = rest - slopes_left @ np.linalg.lstsq(slopes_left, rest, rcond=1e-12)[0]
    dof = len(cleaned) - jacobian.shape[1] - sum(q.shape[1] for q in bases)
    power = np.mean(cleaned.reshape(-1, ny) ** 2, axis=0) * len(cleaned) / max(1, dof)
    noise = dict(zip(problem.model.outputs, np.sqrt(power) * found.sigma, strict=True))
    noise |= _noise_beside(problem, found.z, slopes, [name for name in names if name not in noise])
    size = np.array([noise.get(name, 0.0) for name in names])
    pulls = [j.T @ (t * size) for j, t in zip(jacobians, transients, strict=True)]
    return StartNoise(error=cleaned, pull=np.hstack(pulls), explained=sum(q.shape[1] for q in bases))


def _sources(problem: FreeRunProblem, z: np.ndarray) -> list[str]:
    """Measured channels that the state at a first sample is read from."""
    names = [c.name for c in problem.data.channels if c.name not in problem.data.inputs]
    slopes = [problem.by_first_sample(i, z, names) for i in range(min(3, problem.n_e))]
    return [name for k, name in enumerate(names) if any(slope[:, k].any() for slope in slopes)]


def _transient(problem: FreeRunProblem, z: np.ndarray, i: int, slope: np.ndarray) -> np.ndarray:
    """Change of an experiment's weighted errors by each source, shape (n_rows * n_outputs, n_sources)."""
    by_p = np.zeros((problem.n_x, len(problem.free)))
    x0 = problem.initial(i, z)[0]
    full = problem.run(x0, np.hstack([by_p, slope]), problem.rows[i], problem.parameters(i, z))
    response = full[1:, :, 1 + len(problem.free) :] / problem.sigma[:, None]
    return response.reshape(-1, slope.shape[1])


def _basis(columns: np.ndarray) -> np.ndarray:
    """Orthonormal columns that span these."""
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return u[:, s > 1e-10 * max(s.max(initial=0.0), 1e-300)]


def _without(basis: np.ndarray, columns: np.ndarray) -> np.ndarray:
    return columns - basis @ (basis.T @ columns)


def _noise_beside(
    problem: FreeRunProblem, z: np.ndarray, slopes: Sequence[np.ndarray], names: list[str]
) -> dict[str, float]:
    """Standard deviation, SI units, of the noise of states that are logged, yet no outputs of the fit."""
    names = [name for name in names if name in problem.model.ode.states]
    if not names:
        return {}
    squares, count = np.zeros(len(names)), 0
    shown: dict[int, Any] = {}  # experiments of one recording share it, and what it is compiled to
    for i, (part, slope) in enumerate(zip(problem.parts, slopes, strict=True)):
        varied = problem.with_parameters(i, z)
        try:
            ode = shown.setdefault(id(varied), replace(varied.ode, outputs=tuple(names)))
            u = np.array([np.asarray(varied.drive(row), dtype=float).ravel() for row in problem.rows[i]])
            x0 = problem.initial(i, z)[0]
            here = ode.free_run(x0, u)
            moves = [ode.free_run(x0 + _STEP * by, u) - here for by in slope.T]
        except (SlipangleError, TypeError, ValueError, RuntimeError, NotImplementedError):
            return {}
        seen = part.columns(tuple(names))[len(part) - len(here) :]
        for k in range(len(names)):
            basis = _basis(np.column_stack([m[:, k] for m in moves]))
            squares[k] += np.sum(_without(basis, (seen - here)[:, k]) ** 2)
        count += max(1, len(here) - len(slope.T))
    fine = np.isfinite(squares)
    return {n: float(np.sqrt(s / count)) for n, s, known in zip(names, squares, fine, strict=True) if known}
