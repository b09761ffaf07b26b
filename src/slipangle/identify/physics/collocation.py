"""Grey box by collocation: for poor start values, unstable motions, and constraints on parameters and states."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.errors import ParameterError
from slipangle.fields import Count, Positive, Whole
from slipangle.identify.physics.grey_box import GreyBox, M, finish
from slipangle.identify.physics.simulation_error import MOST_ROUNDS, FreeRunProblem, Minimum
from slipangle.identify.physics.transcription import CollocationPoint, Constraint, Transcription

_HOW = "free-run error, Radau collocation and Ipopt"
_GROWTH = 100.0  # of a deviation within a piece of an unstable motion
_LONGEST = 500  # samples of such a piece


@dataclass(frozen=True, kw_only=True)
class Collocation(GreyBox[M]):
    """The simulation-error fit of `GreyBox`, with the states as unknowns beside the parameters.

    Every sample interval is a piece of its own, joined by equations (Radau IIA, three points an element [1]_), so the
    states start at what was measured instead of at what poor parameters make of it: fits that diverge in one long free
    run converge here. The result is the same minimum, with the same covariance.

    Parameters
    ----------
    start, free, per_experiment, free_initial_state, max_iterations
        As for `GreyBox`; the limit is on Ipopt's iterations.
    at_most_zero : sequence of callable
        Functions of the parameters that must not be positive; ``lambda p: p.C_f * p.l_f - p.C_r * p.l_r`` asks for
        understeer. With parameters per experiment they hold for each.
    zero : sequence of callable
        Functions of the parameters that must vanish.
    state_bounds : mapping
        Lowest and highest value by state, such as ``{"r": (-2.0, 2.0)}``; SI units.
    elements : int
        Collocation elements per sample; by default the substeps of a model integrated by "radau", else one for five
        of its largest explicit steps.
    tolerance : float
        Of Ipopt.

    Notes
    -----
    Without constraints, Gauss-Newton steps on the free run of the model's own integrator end the search. The covariance
    is that of the free run, projected on what active constraints leave free. Where a free run of the fitted model
    cannot follow the data because the motion is unstable, errors and derivatives are those along the collocated states,
    in pieces within which deviations grow a hundredfold at most, and a warning says so.

    References
    ----------
    .. [1] L. T. Biegler, Nonlinear Programming: Concepts, Algorithms, and Applications to Chemical Processes, SIAM,
       2010, ch. 10.
    """

    at_most_zero: Sequence[Constraint] = ()
    zero: Sequence[Constraint] = ()
    state_bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    elements: Whole = 0
    max_iterations: Count = 500
    tolerance: Positive = 1e-9

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("at_most_zero", "zero"):
            given = getattr(self, key)
            object.__setattr__(self, key, (given,) if callable(given) else tuple(given))
        ode = self.start.ode
        if ode.own_step:
            raise ParameterError(
                f"{type(ode).__name__} has a step of its own, which is more than its derivative; expected a model that "
                "is its derivative alone, such as SingleTrack: fit this one with GreyBox"
            )
        if self.elements == 0:
            least = ode.substeps if ode.method == "radau" else max(1, math.ceil(ode.dt / (5 * ode.max_step) - 1e-9))
            object.__setattr__(self, "elements", least)

    def fit(self, data: Dataset) -> M:
        """The model with estimated parameters, their covariance and warnings in ``fit_info``.

        Warns with IdentifiabilityWarning, with the names of parameters that the data do not determine.
        """
        require_dataset(data, "fit() got")
        began = time.perf_counter()
        problem = self.problem(data)
        wanted: Any = {name: getattr(self, name) for name in ("elements", "at_most_zero", "zero", "state_bounds")}
        program = Transcription(problem, **wanted)
        best, solved, said = self._solve(problem, program)
        kept = None
        if len(solved.active):
            _, s, vt = np.linalg.svd(solved.active)
            kept = vt[int((s > 1e-10 * s[0]).sum()) :].T
        return finish(problem, best, how=_HOW, began=began, kept=kept, more=said)

    def _solve(
        self, problem: FreeRunProblem, program: Transcription
    ) -> tuple[Minimum, CollocationPoint, tuple[str, ...]]:
        """Errors and derivatives at the solution, of the free run where it follows the states; and why not."""
        constrained = self.at_most_zero or self.zero or self.state_bounds
        best: Any = None
        for _ in range(MOST_ROUNDS):
            before, best = best, self._once(program, best)
            along = program.minimum(best)
            if not (constrained or problem.own_free_run_misses(along)):
                return problem.minimise(along.z, GreyBox.max_iterations), best, ()
            settled = best.converged and problem.weigh(along.error)
            steady = not problem.moving or (before is not None and np.allclose(best.z, before.z, rtol=1e-8))
            if (settled and steady) or not best.converged:
                break
        along = program.minimum(best)
        if not problem.own_free_run_misses(along):
            return problem.at(along.z, converged=best.converged), best, ()
        if not best.converged:
            said = "the collocation program has no solution yet; expected one: start nearer, or give state_bounds"
            return problem.at(along.z, converged=False), best, (said,)
        said = (
            "a free run of the fitted model does not follow the data because the motion is unstable; expected a stable "
            "one: the parameters hold, their intervals are those of short pieces; simulate in short pieces too"
        )
        return in_pieces(problem, best.states, along), best, (said,)

    def _once(self, program: Transcription, start: CollocationPoint | None) -> CollocationPoint:
        """One solution; with second derivatives where Gauss-Newton's matrix does not do."""
        solved = program.solve(start, self.max_iterations, self.tolerance)
        if solved.converged:
            return solved
        program.hessian = "exact"
        return program.solve(solved, self.max_iterations, self.tolerance)


def in_pieces(problem: FreeRunProblem, states: list[np.ndarray], along: Minimum) -> Minimum:
    """Derivatives of the errors along given states, in pieces within which deviations stay bounded.

    Each piece but an experiment's first starts anywhere: what its initial state can explain is taken out of the
    derivatives by parameters, so the information that links the pieces is not counted.
    """
    jacobian, at, ny = np.zeros_like(along.jacobian), 0, problem.model.n_outputs
    sigma, n_free = problem.sigma, len(problem.free)
    for i, x in enumerate(states):
        columns, p, n = problem.columns(i)[:n_free], problem.parameters(i, along.z), len(x)
        first, size = 0, np.maximum(np.abs(x).max(axis=0), 1e-6)
        while first < n - 1:
            slope = np.hstack([np.zeros((problem.n_x, n_free)), np.diag(size)])
            reach = problem.rows[i][first : first + _LONGEST]
            full = problem.run(x[first], slope, reach, p)[1:, :, 1:] / sigma[:, None]
            strength = np.linalg.norm(full[:, :, n_free:], axis=(1, 2))
            with np.errstate(invalid="ignore"):
                grown = np.flatnonzero(~(strength < _GROWTH * strength[0]))
            length = max(int(grown[0]) if len(grown) else len(full), min(4 * problem.n_x, len(full)))
            block = full[:length].reshape(length * ny, -1)
            by_p = block[:, :n_free] * problem.scale[columns]
            if first or problem.n_x0:
                q, _ = np.linalg.qr(block[:, n_free:])
                by_p -= q @ (q.T @ by_p)
            jacobian[np.ix_(np.arange(at, at + length * ny), columns)] = by_p
            at, first = at + length * ny, first + length
    return replace(along, jacobian=jacobian)
