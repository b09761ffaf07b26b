"""Structures of a car, each with a correction more than another, fitted to a log, and whether that helps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import least_squares as trust_region

from slipangle.data.dataset import Dataset
from slipangle.data.recordings import recordings
from slipangle.identify.car.corrections import Correction
from slipangle.identify.physics.grey_box import nominal
from slipangle.identify.physics.simulation_error import FreeRunProblem
from slipangle.models.ode import OdeModel
from slipangle.models.vehicles.aided import RearSteered, TorqueVectored
from slipangle.models.vehicles.banked import Banked
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.models.vehicles.saturating_bicycle import SaturatingBicycle, SaturatingBicycleParams
from slipangle.models.wrappers.delayed import Delayed

SLOWEST = 1.0  # wheelbases a second: slower, steering and speed sensors say little
ELSEWHERE = 0.05  # wheelbases, standard deviation of the centre of gravity about where it was said to be
ADDED: dict[str, Callable[[Any], OdeModel]] = {"delta_r": RearSteered, "M_z": TorqueVectored, "bank": Banked}
"""Inputs that a car may have beside its steering and speed, and what makes one with them, from the inside out."""
STIFF = ("C_f", "C_r", "inertia_z")
_LINEAR = 8.0  # peak friction at which an axle is as good as linear
_LONGEST = 0.3  # s, of a steering delay
AIDS_LATE = {"delta_r": 0.01, "M_z": 0.02}  # s, that these act after they are logged, where a search begins
_ITERATIONS, _FLAT = 60, 1e-7  # of a fit, and the relative gain of its last step
_AS_GIVEN = 1e-4  # of the width for the mass, for the recording whose mass was given
_WINGS = 0.005  # standard deviation of an axle's downforce per speed squared, over mass per wheelbase
_BELOW = 0.15  # standard deviation of how far the rear's friction may lie below the front's
_ALIKE = 0.05  # standard deviation of how far the relaxation lengths of both axles differ, over the wheelbase
_WORTH = 0.05  # fall of the squared held-out error that is worth a correction by itself
AS_GOOD = 0.02  # rise of the squared error by which another structure may be worse and still be believed by half
_HARM = 0.01  # rise of the squared held-out error that a correction may bring
_LIKELY = 0.84  # standard errors by which what is constant has to help on held-out stretches: four to one
_SETTLES = 1.0  # s, until an initial state that was guessed is forgotten
_ROUNDS, _NEARLY = 4, (0.05, 0.2, np.inf)  # of weighing outputs and prior; moves of both, and of z, that end them
_LAST_ROUNDS, _STILL = 30, (1e-3, 1e-3, 1e-3)  # the same of a last fit; z moves by standard deviations
_COLOUR = 400  # lags of the residuals' autocorrelation


Prior = Mapping[str, tuple[float, float, bool]]
"""What is known of parameters by name: centre, standard deviation, and whether that is a share of the centre."""
Pull = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""From scaled unknowns to residuals that draw these to what is known, shape (n,), and their derivatives."""


def first_guess(
    *,
    mass: float,
    wheelbase: float,
    l_f: float,
    dt: float,
    outputs: tuple[str, ...],
    gain: float,
    added: Iterable[str] = (),
    small_angles: bool = True,
) -> Delayed:
    """A car of ordinary tires for its size, its wheels where the steering is; ``added`` are inputs of `ADDED`."""
    load = GRAVITY * mass / wheelbase
    l_r = wheelbase - l_f
    car: OdeModel = SaturatingBicycle(
        params=SaturatingBicycleParams(
            **dict(mass=mass, wheelbase=wheelbase, l_f=l_f, inertia_z=mass * l_f * l_r),
            **dict(C_f=10.0 * load * l_r, C_r=12.0 * load * l_f, steering_gain=gain, mu_f=_LINEAR, mu_r=_LINEAR),
        ),
        dt=dt,
        outputs=outputs,
        small_angles=small_angles,
    )
    for name, around in ADDED.items():
        car = around(car) if name in added else car
    delays = {"delta": 0.0, **{name: late for name, late in AIDS_LATE.items() if name in added}}
    return Delayed(car, delays=delays, longest=_LONGEST)


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """A structure fitted to data: its free parameters, and errors and derivatives where that ended."""

    model: Any
    free: tuple[str, ...]  # with one value
    own: tuple[str, ...]  # with a value for each recording
    problem: FreeRunProblem
    z: np.ndarray  # (n_names,), the parameters over the problem's scales
    error: np.ndarray  # (n, n_outputs), of the free run over `sigma`, the settling of every stretch left out
    jacobian: np.ndarray  # (n, n_outputs, n_names), its derivatives by z
    stretch: np.ndarray  # (n,), to which stretch a row belongs
    sigma: np.ndarray  # (n_outputs,), standard deviation of the outputs' errors, SI units
    thinning: float  # samples per independent one
    pull: np.ndarray  # (n, n_names), rows that draw `z` to what is ordinary, as hard as `thinning` allows
    settled: bool  # whether weights and parameters all but stayed where they were in the last round

    @property
    def values(self) -> dict[str, float]:
        """Values of the free parameters, SI units; ``steering_offset[1]`` is that of the second recording."""
        found = np.clip(self.z * self.problem.scale, *self.problem.ranges)
        shared = {name: self.model.value(name) for name in self.free}
        return dict(zip(self.names, map(float, found), strict=True)) | shared

    @property
    def names(self) -> tuple[str, ...]:
        """Of `values`."""
        return self.problem.names

    def model_of(self, recording: int) -> Any:
        """The model with the parameters of a recording; for one that was not fitted to, their means."""
        if not self.own or recording not in self.problem.recordings:
            return self.model
        return self.model.with_values(**{name: self.values[f"{name}[{recording}]"] for name in self.own})


Others = list[tuple[Fitted, float]]  # that explain a log about as well, and how far each counts


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A correction that was tried: what it did to the held-out error and to the parameters."""

    correction: str
    kept: bool
    error: np.ndarray  # (n_outputs,), RMS of the free run over the held-out stretches
    change: float  # mean change of the logarithm of the squared held-out error [-]
    values: Mapping[str, float] = field(repr=False)


def fit(
    model: Any,
    free: tuple[str, ...],
    data: Dataset,
    before: Fitted | None = None,
    *,
    own: tuple[str, ...] = (),
    prior: Prior | None = None,
    last: bool = False,
) -> Fitted:
    """Free-run fit from where the model stands, drawn to `ordinary` values as far as the data do not tell.

    ``before`` is an earlier fit, from which the outputs' errors and their colour are known, and the values of ``own``
    parameters, one for each recording; ``prior`` takes the place of what is ordinary. A ``last`` fit goes on until
    neither weights nor parameters move: in one valley it ends at one place, wherever it began.
    """
    problem = FreeRunProblem(model, free, own, data, False, recordings(data))
    problem.sigma, thinning = (problem.sigma, 1.0) if before is None else (before.sigma, before.thinning)
    ny, lengths = model.n_outputs, [len(y) - 1 for y in problem.measured]
    kept = np.concatenate([np.arange(n) >= settling(n, data.dt) for n in lengths])
    rows, stretch = np.repeat(kept, ny), np.repeat(np.arange(len(lengths)), lengths)[kept]
    prior = ordinary(model, (*free, *own)) if prior is None else prior
    found = {} if before is None else before.values
    at = [found.get(name, model.value(base)) for name, base in zip(problem.names, problem.base_names, strict=True)]
    z = np.where([name in free for name in problem.names], problem.start, np.array(at) / problem.scale)
    z, settled = np.clip(z, problem.lower, problem.upper), False
    rounds, still = (_LAST_ROUNDS, _STILL) if last else (_ROUNDS, _NEARLY)
    for _ in range(rounds):
        z, step = _search(problem, rows, _pull(prior, problem, thinning), z)
        error, known = problem.evaluate(z)[0][rows].reshape(-1, ny), (problem.sigma, thinning)
        sigma, thinning = problem.sigma * np.std(error, axis=0), _thinning(error, stretch)
        problem.divide_by(np.maximum(sigma, 1e-12 * np.std(data.columns(model.outputs), axis=0)))
        moved = np.abs(np.log(problem.sigma / known[0])).max(), abs(np.log(thinning / known[1])), step / thinning**0.5
        settled = bool(np.less(moved, still).all())
        if settled:
            break
    error, jacobian = problem.evaluate(z)
    values = np.clip(z * problem.scale, *problem.ranges)
    return Fitted(
        model=model.with_values(**_for_all(problem, values)),
        free=free,
        own=own,
        problem=problem,
        z=z,
        error=error[rows].reshape(-1, ny),
        jacobian=jacobian[rows].reshape(-1, ny, problem.n_p),
        stretch=stretch,
        sigma=problem.sigma,
        thinning=thinning,
        pull=_pull(prior, problem, thinning)(z)[1],
        settled=settled,
    )


def _search(problem: FreeRunProblem, rows: np.ndarray, pull: Pull, z: np.ndarray) -> tuple[np.ndarray, float]:
    """Scaled unknowns of least squares under these weights, and their move in standard deviations of white errors."""
    error, slope = (lambda z, k=k: np.concatenate([problem.evaluate(z)[k][rows], pull(z)[k]]) for k in (0, 1))
    how: Any = {"jac": slope, "bounds": (problem.lower, problem.upper), "max_nfev": _ITERATIONS}
    solution = trust_region(error, z, xtol=1e-9, ftol=_FLAT, gtol=1e-12, **how)
    return solution.x, float(np.linalg.norm(solution.jac @ (solution.x - z)))


def _for_all(problem: FreeRunProblem, values: np.ndarray) -> dict[str, float]:
    """One value per parameter: the mean over recordings, but the mass as it was given, which is the first's."""
    of, first = nominal(problem, values), problem.base_names.index("mass") if "mass" in problem.own else None
    return of if first is None else of | {"mass": float(values[first])}


def settling(n: int, dt: float) -> int:
    """Samples at the head of a stretch of ``n`` in which what was not measured settles: they do not count."""
    return min(round(_SETTLES / dt), n // 4)


def ordinary(model: Any, free: tuple[str, ...]) -> Prior:
    """What is known of any car on tires, by parameter: centre, standard deviation, and whether a share of the centre.

    Yaw inertia is near mass l_f l_r, stiffness near twelve loads per radian, friction near one, a tire relaxes within a
    share of the wheelbase; weak enough for a log that tells anything to overrule. Its mass is a fifth more or less with
    another load.
    """
    p = model.ode.params
    front, rear = (GRAVITY * p.mass * arm / p.wheelbase for arm in (p.l_r, p.l_f))
    known = {
        "inertia_z": (p.mass * p.l_f * p.l_r, 0.3, True),
        "C_f": (12.0 * front, 0.7, True),
        "C_r": (12.0 * rear, 0.7, True),
        "mu_f": (1.0, 0.2, True),
        "mu_r": (1.0, 0.2, True),
        "shape": (1.4, 0.2, False),
        "downforce_f": (0.0, _WINGS * p.mass / p.wheelbase, False),
        "downforce_r": (0.0, _WINGS * p.mass / p.wheelbase, False),
        "load_lag": (0.05, 0.05, False),
        "drive_rear": (0.5, 0.5, False),
        "brake_rear": (0.4, 0.3, False),
        "height": (0.2 * p.wheelbase, 0.1 * p.wheelbase, False),
        "locked_half_track": (0.0, 0.3 * p.wheelbase, False),
        "relaxation_f": (0.1 * p.wheelbase, 0.15 * p.wheelbase, False),
        "relaxation_r": (0.1 * p.wheelbase, 0.15 * p.wheelbase, False),
        "lever_v_y": (0.0, 0.1 * p.wheelbase, False),
        "gain_v_y": (1.0, 0.1, False),
        "turn_v_y": (0.0, 0.02, False),
        "lever_a_y": (0.0, 0.1 * p.wheelbase, False),
        "gain_a_y": (1.0, 0.1, False),
        "gain_v_x": (1.0, 0.05, False),
        "l_f": (p.l_f, ELSEWHERE * p.wheelbase, False),
        "gain_M_z": (1.0, 0.2, False),
        "gain_delta_r": (1.0, 0.2, False),
        **{f"delay_{name}": (late, 0.02, False) for name, late in AIDS_LATE.items()},
        "delay_delta": (0.0, 0.1, False),
        "steering_lag": (0.0, 0.1, False),
        "bias_r": (0.0, 0.03, False),
        "bias_a_y": (0.0, 0.3, False),
        "cross_slope": (0.0, 0.02, False),
        "steering_offset": (0.0, 0.02, False),
        "mass": (p.mass, 0.2, True),
    }
    return {name: known[name] for name in free if name in known}


def _pull(prior: Prior, problem: FreeRunProblem, thinning: float) -> Pull:
    """What draws scaled unknowns to the prior, if samples are coloured.

    Tires of one car relax over like lengths: where the log does not tell one from the other, their difference would
    stand in for yaw inertia. The rear's friction is held from falling below the front's, and free above: a car whose
    rear slides long before its front is not built, one whose front slides first is the rule. The mass of the first
    recording is the one that was given: motion tells but the ratios of masses.
    """
    widths, centres = np.full(problem.n_p, np.inf), np.zeros(problem.n_p)
    for i, name in enumerate(problem.base_names):
        if name in prior:
            centre, spread, relative = prior[name]
            widths[i], centres[i] = spread * centre if relative else spread, centre
    if "mass" in problem.own:
        widths[problem.base_names.index("mass")] *= _AS_GIVEN
    weight = np.sqrt(thinning) / widths
    rows, aim = np.diag(weight * problem.scale), weight * centres
    if {"relaxation_f", "relaxation_r"} <= set(problem.free):
        alike = _difference(problem, "relaxation_f", "relaxation_r", _ALIKE * problem.model.value("wheelbase"))
        rows, aim = np.vstack([rows, np.sqrt(thinning) * alike]), np.append(aim, 0.0)
    if not {"mu_f", "mu_r"} <= set(problem.free):
        return lambda z: (rows @ z - aim, rows)
    between = _difference(problem, "mu_f", "mu_r", _BELOW)

    def pull(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        below = float(between @ z)  # 0 far above, itself far below, and smooth in between as an interval's end must be
        held, slope = 0.5 * (below + np.hypot(below, 1.0)), 0.5 * (1.0 + below / np.hypot(below, 1.0))
        held, slope = np.sqrt(thinning) * held, np.sqrt(thinning) * slope
        return np.append(rows @ z - aim, held), np.vstack([rows, slope * between])

    return pull


def _difference(problem: FreeRunProblem, one: str, other: str, width: float) -> np.ndarray:
    """What a parameter less another is, in widths, of scaled unknowns. (n_names,)"""
    row = np.zeros(problem.n_p)
    for name, sign in ((one, 1.0), (other, -1.0)):
        at = problem.free.index(name)
        row[at] = sign * problem.scale[at] / width
    return row


def _thinning(error: np.ndarray, stretch: np.ndarray) -> float:
    """Samples per independent one: one plus twice the sum of the residuals' autocorrelation, the largest output's."""
    most = 1.0
    for column in error.T:
        rho = np.zeros(_COLOUR)
        for k in range(int(stretch[-1]) + 1):
            e = column[stretch == k]
            for lag in range(min(_COLOUR, len(e))):
                rho[lag] += float(e[lag:] @ e[: len(e) - lag])
        rho /= max(rho[0], 1e-300)
        end = int(np.argmax(rho <= 0)) or len(rho)
        most = max(most, 1.0 + 2.0 * float(rho[1:end].sum()))
    return most


def corrected(before: Fitted, by: Correction, data: Dataset) -> Fitted:
    """The structure with one correction more, fitted from where it stood; without what it does instead, if as good."""
    own = (*before.own, *by.own)
    free = tuple(dict.fromkeys(n for n in (*before.free, *by.free) if n not in own))
    model = by.around(before.model)

    def best(model: Any, free: tuple[str, ...]) -> Fitted:
        tried = [fit(model.with_values(**start), free, data, before, own=own) for start in by.starts]
        return min(tried, key=fit_error)

    found, idle = best(model, free), [n for n in by.instead if n in free]
    if not idle:
        return found
    alone = best(model.with_values(**{n: by.instead[n] for n in idle}), tuple(n for n in free if n not in idle))
    return alone if as_good(alone, found) else found


def as_good(alone: Fitted, found: Fitted) -> bool:
    """Whether a structure with fewer parameters fits about as well."""
    return 2.0 * (fit_error(alone) - fit_error(found)) < AS_GOOD * len(found.sigma)


def fit_error(fitted: Fitted) -> float:
    """Logarithm of the free-run errors, their sum over the outputs."""
    return float(np.log(fitted.sigma).sum())


def errors(fitted: Fitted, data: Dataset) -> np.ndarray:
    """Mean squared free-run error of every experiment, shape (n_experiments, n_outputs); infinite where it diverges."""
    with np.errstate(over="ignore", invalid="ignore"):
        squares = [np.mean((run - y) ** 2, axis=0) for run, y in free_runs(fitted, data)]
    return np.nan_to_num(np.array(squares), nan=np.inf, posinf=np.inf)


def free_runs(fitted: Fitted, data: Dataset) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Free run over each experiment, and what was measured, each of shape (n, n_outputs), their settling left out."""
    for part, recording in zip(data.experiments, recordings(data), strict=True):
        model, first = fitted.model_of(recording), fitted.model.memory - 1
        x0 = np.asarray(model.ode.initial_state(part.rows(first, first + 1)), dtype=float)
        values = np.array([model.value(name) for name in fitted.problem.free])
        run = fitted.problem.run(x0, np.empty((len(x0), 0)), model.drive_rows(part), values)[1:, :, 0]
        settled = settling(len(run), part.dt)
        yield run[settled:], part.columns(model.outputs)[first + 1 :][settled:]


def change(before: np.ndarray, after: np.ndarray) -> tuple[float, float]:
    """Mean change of the logarithm of the error over experiments and outputs, and its standard error."""
    with np.errstate(divide="ignore", invalid="ignore"):
        each = np.nan_to_num(np.log(after / before), nan=0.0, posinf=50.0, neginf=-50.0).mean(axis=1)
    n = len(each)
    return float(each.mean()), float(each.std(ddof=1) / np.sqrt(n)) if n > 1 else 0.0


def helps(before: Fitted, after: Fitted, held_before: np.ndarray, held_after: np.ndarray, by: Correction) -> bool:
    """Whether a correction is worth its parameters on the data of the fit, and does no harm on held-out ones.

    Worth by the Bayesian information criterion with as many samples as are independent; where a poor structure colours
    its errors so much that few are, also by what it brings on nearly every held-out stretch. What every car has need
    not earn its parameters, whose usual values are known; what is the same all the time has to help all the time, or
    else it stands in for something that is not.
    """
    moved, scatter = change(held_before, held_after)
    together = float(np.log(held_after.mean(axis=0) / held_before.mean(axis=0)).mean())
    no_harm = max(moved, together) < max(_HARM, (2.0 if by.ordinary else 1.0) * scatter)
    everywhere = bool((held_after <= held_before).all())
    if by.constant and not (everywhere or moved < -_LIKELY * scatter):
        return False
    gain = worth(before, after, 0 if by.ordinary else len(after.names) - len(before.names))
    return bool((gain > 0 and no_harm) or (moved < -max(_WORTH, 2.0 * scatter) and together < 0))


def worth(before: Fitted, after: Fitted, more: int) -> float:
    """Fall of the Bayesian information criterion with ``more`` parameters, of as many samples as are independent."""
    independent = len(after.error) / after.thinning
    return -2.0 * independent * float(np.log(after.sigma / before.sigma).sum()) - more * float(np.log(independent))
