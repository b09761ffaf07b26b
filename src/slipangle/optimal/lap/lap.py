"""`Lap`: the drive of a fastest lap, and what each parameter of the car is worth on it."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import integrate, interpolate

from slipangle.errors import ParameterError, shown
from slipangle.models.analysis.linearize import directions
from slipangle.models.model import Model
from slipangle.optimal.checks import is_number
from slipangle.optimal.lap.car import LapCar, rates, slip
from slipangle.optimal.lap.course import INNERMOST, Course
from slipangle.optimal.lap.program import N_STATES, scales, worth
from slipangle.optimal.solution import Status
from slipangle.paths.path import SPACING, Path
from slipangle.shown import Shown

_BEYOND = 16  # intervals of a closed lap past its ends, by which the line goes on over the start as anywhere
_FINE = 4  # points of the line in one of the path's
CALM = 0.03  # what smoothness costs over the lap time, from which on it is said
_AT = 1e-3  # of a bend's radius, from what bounds the offset in it
_YIELDS = 0.01  # of an interval's length cubed: what bends the line as much as the places are off


@dataclass(frozen=True, kw_only=True, eq=False)
class Lap(Shown):
    """A time-optimal lap; arrays have shape (n,), one value per point.

    Parameters
    ----------
    time : float
        Of the lap. [s]
    quasi_steady : float
        Of the line of least curvature at the speeds of the car's g-g-v diagram, where the solver started. [s]
    s, t : array
        Arc length of the track's line and time at the points. [m, s]
    X, Y, psi : array
        Place and heading of the car. [m, m, rad]
    n, chi : array
        Offset from the track's line, positive to the left, and heading against it. [m, rad]
    v_x, v_y, r, delta, F_x : array
        Speeds [m/s], yaw rate [rad/s], road-wheel angle [rad], longitudinal force of the tires [N].
    a_x, a_y : array
        Accelerations of the centre of gravity along and across the car. [m/s2]
    grip_f, grip_r : array
        Share of each axle's friction ellipse that is used. [-]
    rates : array, shape (n, 2)
        Of the road-wheel angle and the longitudinal force. [rad/s, N/s]
    cost : float
        What was minimised: the time and the cost of smoothness. [s]
    duals : dict
        Multipliers of the program's bounds and constraints, and its variables and parameters.
    free : bool
        Whether the track's edges bound the line, or the tolerance around a given one.
    weights : array, shape (3,)
        What smoothness costs: of squared yaw acceleration and rates of steering and force. [s/s per squared unit]
    ends : array
        Where the intervals of the program begin and end, two points in each. [m]
    status, iterations, seconds
        How the solver ended, its iterations, and the time of the cheap stages and of the solver. [-, -, (s, s)]
    car, track
        What was driven, and where.
    """

    time: float
    quasi_steady: float
    s: np.ndarray
    t: np.ndarray
    X: np.ndarray
    Y: np.ndarray
    psi: np.ndarray
    n: np.ndarray
    chi: np.ndarray
    v_x: np.ndarray
    v_y: np.ndarray
    r: np.ndarray
    delta: np.ndarray
    F_x: np.ndarray
    a_x: np.ndarray
    a_y: np.ndarray
    grip_f: np.ndarray
    grip_r: np.ndarray
    cost: float
    duals: dict[str, np.ndarray]
    free: bool
    weights: np.ndarray
    ends: np.ndarray
    rates: np.ndarray
    status: Status
    iterations: int
    seconds: tuple[float, float]
    car: LapCar
    track: Path

    def _words(self) -> str:
        calm = ", calm: it can be faster with less smoothness" if self.calm > CALM else ""
        entered = "" if self.track.closed else f", entered at {3.6 * self.v_start:.0f} km/h"
        mean = 3.6 * self.s[-1] / self.time
        return f"{self.track.name}, {self.time:.3f} s, {mean:.0f} km/h on average{entered}{calm}"

    @property
    def v_start(self) -> float:
        """Speed where the track begins. [m/s]"""
        if self.track.closed:
            return float(self.v_x[-1])
        return float(self.duals["x"][9 * len(self.s) + 2] * scales(self.car)[2])

    @property
    def calm(self) -> float:
        """What smoothness costs beside the lap time, over it: some percent make a lap as much slower. [-]"""
        return self.cost / self.time - 1.0

    @cached_property
    def path(self) -> Path:
        """The driven line with its speeds, for a controller to follow: its curvature is that of the drive.

        Between the program's intervals, whose length is the accuracy of its places, it passes them by centimetres.
        """
        spacing = SPACING * min(float(self.car.size), 1.0)
        how: Any = {"closed": self.track.closed, "spacing": spacing, "name": f"fastest lap of {self.track.name}"}
        line = Path.from_points(*_line(self, spacing).T, **how)
        at = line.project_all(self.X, self.Y)[:, 0]
        order = np.argsort(at % line.length) if line.closed else np.argsort(at)
        place = (at % line.length if line.closed else at)[order]
        speed = np.hypot(self.v_x, self.v_y)[order]
        return line.with_speed(np.interp(line.s, place, speed, period=line.length if line.closed else None))

    @cached_property
    def sensitivities(self) -> dict[str, float]:
        """Change of `cost` per unit of each parameter of the car, from the multipliers. [s per unit]

        Negative where more is faster. Smoothness counts at constant weight, so they are those of the lap time but for
        its share, see `calm`; a given line is kept to as closely as before.
        """
        return _sensitivities(self)

    @property
    def columns(self) -> np.ndarray:
        """States and rates, shape (n, 9), in the order of the program."""
        states = (self.n, self.chi, self.v_x, self.v_y, self.r, self.delta, self.F_x)
        return np.column_stack([*states, self.rates])

    def worth(self, name: str, change: float) -> float:
        """Change of the lap time [s], to first order, by a change of a parameter of the car in its own unit.

        Raises ParameterError if there is no such parameter, or the change is no finite number.
        """
        LapCar.si(name)
        if not is_number(change) or not math.isfinite(change):
            raise ParameterError(f"the change of '{name}' is {shown(change)}; expected a number in its own unit")
        return self.sensitivities.get(name, 0.0) * change

    def time_std(self, model: Model, *, known: Collection[str] = ()) -> float:
        """Standard deviation of the lap time by what the fit of a model leaves open of its car, to first order. [s]

        The lap's car is that of the model (`lap_car`), but for what is ``known`` otherwise. Infinite where the fit says
        nothing finite, NaN where the model is no fit or estimates nothing of a car. ParameterError if it is no model.
        """
        if not isinstance(model, Model):
            raise ParameterError(f"the model is {shown(model)}; expected the fitted Model of the lap's car")
        names = tuple(n for n in (model.fit_info.names if model.fit_info else ()) if n in self.sensitivities)
        names = tuple(n for n in names if n not in known)
        if not names:
            return math.nan
        root = directions(model, names)[1]
        return float(np.linalg.norm(root @ [self.sensitivities[n] for n in names])) if root.size else math.inf


def lap_of(
    car: LapCar,
    track: Path,
    along: Course,
    found: np.ndarray,
    times: np.ndarray,
    *,
    duals: dict[str, np.ndarray],
    **more: Any,
) -> Lap:
    """The lap of a solution: the program's variables, the durations of its intervals, its multipliers."""
    size, count = scales(car), len(along.s)
    columns = found[: 9 * count].reshape(count, 9) * size
    n, chi, v_x, v_y, r, delta, F_x = columns[:, :N_STATES].T
    motion = rates(v_x, v_y, r, delta, F_x, car)
    alphas = slip(v_x, v_y, r, delta, car)
    used = []
    for one, alpha in zip((motion.forces.front, motion.forces.rear), alphas, strict=True):
        used.append(one.ellipse * np.ones_like(alpha))
    ends = np.cumsum(times)
    pace = (1 - n * along.curvature) / (v_x * np.cos(chi) - v_y * np.sin(chi))
    t = np.empty(count)
    t[1::2] = ends
    t[0::2] = ends - times + np.diff(along.ends) * (5 * pace[0::2] - pace[1::2]) / 12
    return Lap(
        time=float(ends[-1]),
        s=along.s,
        t=t,
        X=along.X - n * np.sin(along.psi),
        Y=along.Y + n * np.cos(along.psi),
        psi=along.psi + chi,
        **dict(n=n, chi=chi, v_x=v_x, v_y=v_y, r=r, delta=delta, F_x=F_x),
        a_x=motion.v_x - v_y * r,
        a_y=motion.v_y + v_x * r,
        grip_f=used[0],
        grip_r=used[1],
        rates=columns[:, N_STATES:],
        ends=along.ends,
        duals=duals | {"x": found},
        car=car,
        track=track,
        **more,
    )


def _line(lap: Lap, spacing: float) -> np.ndarray:
    """Points of the driven line, shape (n, 2). [m]

    The points inside the program's intervals are less exact than their ends, and a line through all of them bends to
    and fro. That of the course and its rate along the way, both states of the drive, bends as the car does, but drifts;
    a smoothing spline through what it is off at the ends takes that back.
    """
    slip, speed = np.arctan2(lap.v_y, lap.v_x), np.hypot(lap.v_x, lap.v_y)
    bend = (lap.a_y * np.cos(slip) - lap.a_x * np.sin(slip)) / speed**2
    pull = lap.a_x * np.cos(slip) + lap.a_y * np.sin(slip)
    table = np.column_stack([lap.t, np.unwrap(lap.psi + slip), lap.X, lap.Y, bend, speed, pull])
    if lap.track.closed:
        table = table[1::2]
        once = np.array([lap.time, 2 * np.pi * np.round((table[-1, 1] - table[0, 1]) / (2 * np.pi)), 0, 0, 0, 0, 0])
        few = min(_BEYOND, len(table))
        table = np.vstack([table[-few:] - once, table, table[:few] + once])
    else:
        few, table = 0, np.vstack([table[:1], table[1::2]])
    t, course, X, Y, bend, speed, pull = table.T
    way = interpolate.CubicHermiteSpline(t, speed, pull).antiderivative()(t)
    first, last = way[few], way[len(way) - max(few, 1)]
    step = (last - first) / max(round(_FINE * (last - first) / spacing), 2 * len(way))
    at = first + step * np.arange(-np.ceil((first - way[0]) / step), np.ceil((way[-1] - first) / step) + 1)
    toward = interpolate.CubicHermiteSpline(way, course, bend)(at)
    places = np.array([X[0], Y[0]]) + integrate.cumulative_trapezoid(
        np.column_stack([np.cos(toward), np.sin(toward)]), at, axis=0, initial=0.0
    )
    for k, given in enumerate((X, Y)):
        drift = given - np.interp(way, at, places[:, k])
        places[:, k] += interpolate.make_smoothing_spline(way, drift, lam=_YIELDS * np.mean(np.diff(way)) ** 3)(at)
    return places[(at > first - 0.5 * step) & (at < last + (-0.5 if few else 0.5) * step)]


def _sensitivities(lap: Lap) -> dict[str, float]:
    """Of the cost to every parameter: through the equations and, for those that bound a variable, through its bound."""
    car, duals, count = lap.car, lap.duals, len(lap.s)
    slope = worth(count // 2, lap.track.closed)(duals["x"], duals["p"], duals["lam_g"])
    found = dict(zip(LapCar.felt(), np.asarray(slope).ravel(), strict=True))
    size, dual = scales(car), np.abs(duals["lam_x"])
    bound = dual[: 9 * count].reshape(count, 9) / size
    first = dual[9 * count :] / size[: len(dual) - 9 * count]  # of an open track, else none
    curvature = duals["p"][-(count + count // 2) : -(count // 2)]
    at_edge = bound[lap.n * curvature < INNERMOST - _AT, 0]  # elsewhere the bend's radius bounds the offset
    found["width"] += 0.5 * (at_edge.sum() + first[:1].sum()) if lap.free else 0.0
    found["delta_max"] -= bound[:, 5].sum() + first[5:6].sum()
    found["delta_rate"] -= bound[:, 7].sum()
    found["force_rate"] -= bound[:, 8].sum() * car.weight
    found["mass"] -= bound[:, 8].sum() * car.force_rate * car.weight / car.mass
    return {name: float(value) for name, value in found.items()}


def require_lap_of(track: Path, lap: Any, what: str) -> None:
    """Raise ParameterError unless this is a lap of a track, told by its length; ``what`` says which lap it is to be."""
    if not isinstance(lap, Lap):
        raise ParameterError(f"{what} is {shown(lap)}; expected a Lap of '{track.name}': sa.fastest_lap(car, track)")
    if lap.track.closed != track.closed or abs(lap.track.length - track.length) > 1e-6 * track.length:
        raise ParameterError(
            f"{what} is one of '{lap.track.name}', {lap.track.length:.5g} m; expected one of '{track.name}', "
            f"{track.length:.5g} m"
        )
