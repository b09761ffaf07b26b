"""Who finds the optimum of a lap: the interior point along the track where there is a compiler, or else Ipopt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from slipangle.optimal.ipopt import _STATUS
from slipangle.optimal.lap.car import LapCar
from slipangle.optimal.lap.collocated import Collocated, Lapped, compiled
from slipangle.optimal.lap.course import Course
from slipangle.optimal.lap.interior import InteriorPoint
from slipangle.optimal.lap.program import (
    BARRIERS,
    N_STATES,
    constraint_bounds,
    limits,
    program,
    scales,
    solver,
    without_peak,
)
from slipangle.optimal.solution import Status


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """A car on a course, the weights of smoothness, see `Lap`, and the scaled variables' lower and upper bounds."""

    car: LapCar
    along: Course
    weights: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]

    @property
    def parameters(self) -> list[np.ndarray]:
        """Those of the program: the car's, sizes, axles without a peak, weights, curvature, lengths of intervals."""
        car, along, size = self.car, self.along, scales(self.car)
        felt = np.array([getattr(car, name) for name in LapCar.felt()], dtype=float)
        rated = self.weights * np.array([1.0, size[7] ** 2, size[8] ** 2])
        return [felt, size, np.array(without_peak(car)), rated, along.curvature, np.diff(along.ends)]


class Solved(NamedTuple):
    """The program's variables, durations of its intervals [s], multipliers and parameters, least cost [s], its end."""

    variables: np.ndarray
    times: np.ndarray
    duals: dict[str, np.ndarray]
    cost: float
    status: Status
    iterations: int


def solve(problem: Problem, guess: np.ndarray, *, iterations: int, tolerance: float) -> Solved:
    """The program from a guess of its columns, shape (n, 9), in SI units.

    Where the interior point along the track loses its way from each of `BARRIERS`, and where there is no compiler,
    Ipopt starts from the guess.
    """
    along = problem.along
    scaled = guess / scales(problem.car)
    start = scaled.ravel() if along.closed else np.append(scaled.ravel(), scaled[0, :N_STATES])
    start = np.clip(start, *problem.bounds)
    code = compiled()
    found = None if code is None else along_the_track(problem, start, code, iterations, tolerance)
    return found or by_ipopt(problem, start, iterations, tolerance)


def along_the_track(problem: Problem, start: np.ndarray, code: Any, iterations: int, tolerance: float) -> Solved | None:
    """By `InteriorPoint`; None where no start ends within its share of the iterations.

    A large barrier holds the car away from its limits, where the lap is ill-defined; a small one begins near them.
    """
    felt, size, flags, weights, k, h = problem.parameters
    lapped = Lapped(
        rest=np.concatenate([felt, size, flags]),
        weights=weights,
        per_second=size[N_STATES:] / size[5:N_STATES],
        k=np.ascontiguousarray(k),
        h=h,
        closed=problem.along.closed,
    )
    collocated = Collocated(lapped, code)
    n, N = collocated.n, collocated.N
    low, high = (
        np.concatenate([_by_interval(side, n), np.tile(bound, n)])
        for side, bound in zip(problem.bounds, limits(), strict=True)
    )
    begin = np.concatenate([_by_interval(start, n), np.zeros(7 * n)])
    search = InteriorPoint(collocated, low, high, tolerance)
    ends = (search.run(begin, barrier, max(1, int(share * iterations))) for barrier, share in BARRIERS.items())
    found = next((end for end in ends if end is not None and end.left <= tolerance), None)
    if found is None:
        return None
    Z, R, first, _ = collocated.parts(found.w)
    bound_Z, bound_R, bound_first, _ = collocated.parts(found.bounds)
    columns, bounds = np.zeros((2, n, N_STATES + 2))
    columns[:, :N_STATES], columns[0::2, N_STATES:], columns[1::2, N_STATES:] = Z, R, R
    bounds[:, :N_STATES], bounds[0::2, N_STATES:] = bound_Z, bound_R
    mu = found.mu.reshape(N, 14)
    duals = {
        "lam_x": np.append(bounds.ravel(), bound_first),
        "lam_g": np.concatenate([found.lam, np.zeros((N, 2)), mu], axis=1).ravel(),
        "p": np.concatenate(problem.parameters),
    }
    variables = np.append(columns.ravel(), first)
    return Solved(variables, collocated(found.w).passed, duals, found.cost, Status.SOLVED, search.iterations)


def _by_interval(values: np.ndarray, n: int) -> np.ndarray:
    """Variables of the program as points, rates and first state."""
    columns = values[: 9 * n].reshape(n, 9)
    return np.concatenate([columns[:, :N_STATES].ravel(), columns[0::2, N_STATES:].ravel(), values[9 * n :]])


def by_ipopt(problem: Problem, start: np.ndarray, iterations: int, tolerance: float) -> Solved:
    """By Ipopt."""
    along, bounds = problem.along, problem.bounds
    intervals = len(along.ends) - 1
    parameters = np.concatenate(problem.parameters)
    low, high = constraint_bounds(intervals)
    search = solver(intervals, along.closed, iterations, tolerance)
    solution = search(x0=start, p=parameters, lbx=bounds[0], ubx=bounds[1], lbg=low, ubg=high)
    status = _STATUS.get(str(search.stats()["return_status"]), Status.FAILED)
    found = np.asarray(solution["x"]).ravel()
    if status.solved and not np.isfinite(found).all():
        status = Status.FAILED
    times = np.asarray(program(intervals, along.closed).times(found, parameters)).ravel()
    duals = {name: np.asarray(solution[name]).ravel() for name in ("lam_x", "lam_g")}
    duals["p"] = parameters
    return Solved(found, times, duals, float(solution["f"]), status, int(search.stats()["iter_count"]))
