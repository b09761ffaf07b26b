"""Grey box: free parameters of an ODE model from the error of its free run."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, replace
from typing import Annotated, Any, Generic, TypeVar

import numpy as np

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.errors import IdentifiabilityWarning, SlipangleError
from slipangle.fields import Checked, Count, Within
from slipangle.identify.physics.advise import better_sentences
from slipangle.identify.physics.between_samples import between_samples, hold_said
from slipangle.identify.physics.first_sample import start_noise
from slipangle.identify.physics.simulation_error import FreeRunProblem, Minimum, check_names
from slipangle.identify.physics.starts import STARTS, best_start
from slipangle.identify.stability import breakdown_said
from slipangle.models.model import FitInfo
from slipangle.models.ode import Parametrised
from slipangle.models.provenance import provenance
from slipangle.numerics import covariance as uncertainty
from slipangle.numerics.blas import one_blas_thread

_FLAT = 1e-6  # relative gain of a step that ends a search from many starts: its valleys are long and flat
_HOW = "free-run error, Gauss-Newton with forward sensitivities"


M = TypeVar("M", bound=Parametrised)
"""What is fitted, and what a fit returns."""


@dataclass(frozen=True, kw_only=True)
class GreyBox(Checked, Generic[M]):
    """Simulation-error fit by bounded Gauss-Newton with forward sensitivities.

    Minimises the squared free-run error of all outputs and experiments ([1]_ eq. 8-1), each output
    divided by its residual standard deviation. Bounds are the parameter set's ranges. Where the free run from poor
    start values goes astray, or parameters obey constraints, use `slipangle.identify.physics.collocation.Collocation`.

    Parameters
    ----------
    start : OdeModel or Delayed
        Model with the start values; also says inputs, outputs, sample time and integrator.
    free : tuple of str
        Names of the parameters to estimate, one value for all experiments.
    per_experiment : tuple of str
        Names of further parameters to estimate, one value for each experiment, such as ``"steering_offset"`` or
        ``"mass"``. They are ``steering_offset[0]`` and so on in `fit_info`; the model of one experiment is
        ``fit(...).for_experiment(i)``. The model that `fit` returns has their means, for recordings that are not
        among the training data.
    free_initial_state : bool
        Estimate each experiment's initial state too, instead of reading it from its first sample, whose noise the
        intervals count.
    max_iterations : int
        Steps of one fit at most.
    starts : int, optional
        From how many places the minimum is looked for, the given one included: see
        `slipangle.identify.physics.starts`. By default 32 for models known to have several minima
        (`OdeModel.several_minima`), such as the nonlinear bicycle, else 1.
    seed : int
        Of these places.

    A log does not say how its inputs move between the samples, and the model holds them. So intervals take in inputs
    that go on in straight lines, as far as the outputs do not tell which it is, and a warning says so where they
    tell lines. `Dataset.hold_mean` and `Dataset.hold_sample` say it of the data.

    References
    ----------
    .. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023.
    """

    start: M
    free: tuple[str, ...] = ()
    per_experiment: tuple[str, ...] = ()
    free_initial_state: bool = False
    max_iterations: Count = 100
    starts: Annotated[int, Within(1, example=str(STARTS))] | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_names(self.start, self.free, self.per_experiment)

    def fit(self, data: Dataset) -> M:
        """The model with estimated parameters, their covariance and warnings in ``fit_info``.

        Raises ExcitationError, TooShortError or SimulationError if the data cannot tell, or the numbers broke down.

        Warns with IdentifiabilityWarning, with the names of parameters that the data do not determine, and what to
        drive so that they are (see `slipangle.identify.physics.advise`).
        """
        require_dataset(data, "fit() got")
        began = time.perf_counter()
        starts = self.starts or (STARTS if self.start.ode.several_minima else 1)
        with breakdown_said("the grey box", data):
            if starts == 1:
                problem = self.problem(data)
                return finish(problem, problem.minimise(problem.start, self.max_iterations), how=_HOW, began=began)
            with one_blas_thread():  # many small factorisations
                problem = self.problem(data)
                best = best_start(problem, starts, self.seed)
                optimum = problem.minimise(best, self.max_iterations, tolerance=_FLAT)
                return finish(problem, optimum, how=f"{_HOW}, best of {starts} starts", began=began)

    def problem(self, data: Dataset) -> FreeRunProblem:
        """The least-squares problem that `fit` solves."""
        return FreeRunProblem(self.start, self.free, self.per_experiment, data, self.free_initial_state)


def finish(
    problem: FreeRunProblem,
    found: Minimum,
    *,
    how: str,
    began: float,
    kept: np.ndarray | None = None,
    more: tuple[str, ...] = (),
) -> Any:
    """The fitted model of a solution, with its `FitInfo`; warns of what the data do not determine.

    ``how`` names criterion and solver, ``began`` is ``time.perf_counter()`` at the start, ``kept``, shape (n_z,
    n_directions), the directions in which active constraints let the unknowns move, ``more`` are further warnings.
    """
    n_p, scale = problem.n_p, problem.scale[: problem.n_p]
    known, loose, colour = _uncertainty(problem, found, kept)
    moved = between_samples(problem, found, known / np.outer(scale, scale)) if kept is None and not loose.size else None
    before = np.sqrt(np.maximum(np.diag(known), 0))
    if moved:  # the second moment about the values
        known = known + moved.chance * np.outer(moved.shift * scale, moved.shift * scale)
    spread = uncertainty.unlimited(known, loose)
    values = found.z[:n_p] * scale
    metadata = [problem.model.si(n) for n in problem.base_names]
    for bound in problem.ranges:
        values = np.where(np.abs(values - bound) < 1e-9 * scale, bound, values)  # interior methods stop just short
    values = np.clip(values, *problem.ranges)
    std = np.sqrt(np.maximum(np.diag(spread), 0))
    said = _notes(problem, found, values, std, advised=problem.run.compiled and kept is None)
    said += [*more, *(hold_said(moved, problem, values, before) if moved else ())]
    if found.diverged:
        said.append(
            "the free run of the fitted model leaves the finite numbers on its own training data; expected one that "
            "follows them: start nearer, free fewer parameters, or use Collocation"
        )
    if not found.converged:
        said.append("the fit stopped at its iteration limit; expected convergence: raise max_iterations")
    info = FitInfo(
        names=problem.names,
        values=values,
        covariance=spread,
        noise_std=found.sigma,
        n_samples=problem.n_rows,
        units=tuple(m.unit for m in metadata),
        seconds=time.perf_counter() - began,
        method=f"{how}; {colour}",
        warnings=tuple(said),
        loose=loose if loose.size else None,
        known_covariance=known if loose.size else None,
        **provenance(problem.data),
    )
    for sentence in info.warnings:
        warnings.warn(sentence, IdentifiabilityWarning, stacklevel=3)
    return replace(problem.model.with_values(**nominal(problem, values)), fit_info=info)


def _uncertainty(
    problem: FreeRunProblem, found: Minimum, kept: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, str]:
    """Covariance of what the data determine of the parameters, SI units, the directions they leave open, and how."""
    n_p, scale = problem.n_p, problem.scale[: problem.n_p]
    jacobian = found.jacobian if kept is None else found.jacobian @ kept
    loose = np.zeros((jacobian.shape[1], 0))
    try:
        rows = [len(y) - 1 for y in problem.measured]
        start = start_noise(problem, found, jacobian)
        spread, colour = uncertainty.covariance(start.error, jacobian, problem.model.n_outputs, lengths=rows)
        dof = len(found.error) - jacobian.shape[1]
        moves = uncertainty.inverse_information(jacobian) @ start.pull
        spread = spread * dof / max(1, dof - start.explained) + moves @ moves.T
        loose = uncertainty.loose_directions(jacobian)
    except (np.linalg.LinAlgError, ArithmeticError):
        spread, colour = np.full((jacobian.shape[1],) * 2, np.inf), "no covariance, as the derivatives overflow"
    if kept is not None:
        spread, loose = kept @ spread @ kept.T, kept @ loose
    loose = loose[:n_p] * scale[:, None]
    return spread[:n_p, :n_p] * np.outer(scale, scale), loose[:, loose.any(axis=0)], colour


def _notes(problem: FreeRunProblem, found: Minimum, values: np.ndarray, std: np.ndarray, advised: bool) -> list[str]:
    """What the data do not determine. No advice, and no check, is worth losing a finished fit for."""
    n_p = problem.n_p
    metadata = [problem.model.si(n) for n in problem.base_names]
    better = {}
    try:
        better = better_sentences(problem, found, values, std) if advised else {}
    except (SlipangleError, np.linalg.LinAlgError, ArithmeticError):
        pass  # the sentences then say what is missing, not what to drive
    scale, slopes = problem.scale[:n_p], found.jacobian[:, :n_p]
    try:
        return uncertainty.notes(problem.names, values, std, scale, metadata, slopes, better)
    except (np.linalg.LinAlgError, ArithmeticError):
        return ["which parameters the data determine cannot be told, as the derivatives overflow; expected finite ones"]


def nominal(problem: FreeRunProblem, values: np.ndarray) -> dict[str, float]:
    """One value per free parameter: means over the experiments for those that differ between them."""
    base = np.array(problem.base_names)
    return {name: float(np.mean(values[base == name])) for name in problem.free}
