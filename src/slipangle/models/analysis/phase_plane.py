"""`phase_plane`: where a car with its steering held goes from any lateral velocity and yaw rate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

import numpy as np

from slipangle.errors import ParameterError
from slipangle.models.analysis.diagram import lateral_states
from slipangle.models.analysis.trim import STEERING, Motion
from slipangle.models.model import Model
from slipangle.units import read_in, speed_said

Kind = Literal["stable", "saddle", "unstable"]
_NEWTON, _ROUNDING = 40, 1e-9
_NEAR = 0.02  # of the plane's size, how close to an equilibrium counts as having come to it
_STEPS = 0.01  # s, of Runge-Kutta's steps at most
_TRACKS = 9  # trajectories along each axis that are kept


@dataclass(frozen=True)
class Equilibrium:
    """Where v_y [m/s] and r [rad/s] stay: "stable", a "saddle" (one direction away), or "unstable" (all away)."""

    v_y: float
    r: float
    kind: Kind


@dataclass(frozen=True, kw_only=True, eq=False)
class PhasePlane:
    """Lateral velocity against yaw rate at one speed and steering angle, see `phase_plane`.

    Parameters
    ----------
    v_x, delta : float
        Held speed [m/s] and steering angle [rad].
    v_y, r : array, shapes (n,), (m,)
        Axes of the grid. [m/s], [rad/s]
    v_y_dot, r_dot : array, shape (m, n)
        Rates at its points. [m/s2], [rad/s2]
    settles : array of bool, shape (m, n)
        Whether the car comes to the stable equilibrium from there: its region of attraction, cut by ``duration``.
    equilibria : tuple of Equilibrium
        All that were found inside the grid.
    tracks : array, shape (n_tracks, n_samples, 2)
        v_y and r over time from some points of the grid; NaN once outside of twice the grid.
    duration : float
        How long each was driven on. [s]
    """

    v_x: float
    delta: float
    v_y: np.ndarray
    r: np.ndarray
    v_y_dot: np.ndarray
    r_dot: np.ndarray
    settles: np.ndarray
    equilibria: tuple[Equilibrium, ...]
    tracks: np.ndarray
    duration: float
    name: str = "model"

    @property
    def share(self) -> float:
        """Share of the grid from which the car settles, 0 to 1. [-]"""
        return float(self.settles.mean())

    def table(self) -> Any:
        """The equilibria, a `slipangle.report.Table`."""
        return import_module("slipangle.report.stability").plane_table(self)  # a room above this one

    def plot(self) -> Any:
        """Trajectories, equilibria and the region from which the car settles; a Plotly figure."""
        return import_module("slipangle.report.stability").plane_figure(self)  # a room above this one

    def __repr__(self) -> str:
        count = {k: sum(e.kind == k for e in self.equilibria) for k in ("stable", "saddle", "unstable")}
        said = ", ".join(f"{n} {k}" for k, n in count.items() if n) or "no"
        turn, angle = read_in("delta", "rad")
        place = f"{speed_said(self.v_x)}, delta {turn * self.delta:.3g} {angle}"
        return f"<PhasePlane of '{self.name}' at {place}: {said} equilibria, settles from {100 * self.share:.0f} %>"

    def _repr_html_(self) -> str:
        return self.table()._repr_html_()


def phase_plane(
    model: Model,
    *,
    v_x: float,
    delta: float = 0.0,
    v_y_max: float | None = None,
    r_max: float | None = None,
    points: int = 31,
    duration: float = 5.0,
    inputs: Mapping[str, float] | None = None,
    name: str = "",
) -> PhasePlane:
    """Phase plane of lateral velocity and yaw rate with speed and steering held: equilibria and the stable region.

    Every point of a grid is driven on with Runge-Kutta's steps of at most 10 ms; it settles where it ends at the stable
    equilibrium. The boundary of that region is the stable manifold of the saddles. States besides v_y and r (a road
    wheel behind a lag, slip angles that build up) start where they are at rest at that v_y and r.

    Raises ParameterError if the model has no states v_y and r, or is no set of equations of motion.

    Parameters
    ----------
    model : Model
        Any with the states v_y and r and a steering input.
    v_x, delta : float
        Held speed [m/s] and steering angle [rad].
    v_y_max, r_max : float, optional
        Half width and height of the plane; by default a side slip angle of 25 degrees [m/s], and twice the yaw rate
        of a lateral acceleration of 9.81 m/s2 [rad/s].
    points : int
        Points of the grid along each axis, at least 5.
    duration : float
        How long each is driven on. [s]
    inputs, name
        See `linearize`.

    For example ``sa.phase_plane(car, v_x=20.0, delta=sa.deg(2)).plot()``.

    References
    ----------
    .. [1] S. Inagaki, I. Kushiro, M. Yamamoto, JSAE Review 16(2), 1995: vehicle stability by phase-plane analysis.
    .. [2] C. E. Beal, J. C. Gerdes, IEEE Trans. Control Systems Technology 21(4), 2013: the envelope inside it.
    """
    ground = model.off_ground
    steer = next((n for n in STEERING if n in ground.inputs), None)
    if not {"v_y", "r"} <= {*ground.states} or steer is None or getattr(ground, "own_step", True):
        raise ParameterError(
            f"the {type(ground).__name__} has states {', '.join(ground.states[:6])}; expected equations of motion with "
            "the states v_y and r and a steering input"
        )
    wide, high = v_y_max or np.tan(np.radians(25.0)) * v_x, r_max or 2 * 9.81 / v_x
    if not (v_x > 0 and np.isfinite([v_x, delta, wide, high]).all() and min(wide, high) > 0 and points >= 5):
        raise ParameterError(
            f"v_x is {v_x:g} m/s, v_y_max {wide:g} m/s, r_max {high:g} rad/s and points {points}; expected positive "
            "ones and at least 5 points"
        )
    motion = Motion(ground)
    trim = motion.trim(v_x, 0.0, inputs or {}, motion.values)
    field = _Field(motion, trim.x, trim.u, steer, delta)
    v_y, r = np.linspace(-wide, wide, points), np.linspace(-high, high, points)
    start = field.from_plane(*(a.ravel() for a in np.meshgrid(v_y, r)))
    rates = field(start)[[field.at_v_y, field.at_r]]
    size = np.array([wide, high])
    found = _equilibria(field, start[:, :: max(1, start.shape[1] // 60)], size)
    rest = [e for e in found if e.kind == "stable"]
    home = min(rest, key=lambda e: np.hypot(e.v_y / wide, e.r / high)) if rest else None
    ends, tracks = _driven(field, start, size, duration, points)
    settles = np.zeros(start.shape[1], dtype=bool)
    if home is not None:
        gap = np.abs(ends - np.array([[home.v_y], [home.r]]))
        settles = np.all(gap < _NEAR * size[:, None], axis=0)
    shape = points, points
    return PhasePlane(
        v_x=float(v_x),
        delta=float(delta),
        v_y=v_y,
        r=r,
        v_y_dot=rates[0].reshape(shape),
        r_dot=rates[1].reshape(shape),
        settles=np.asarray(settles.reshape(shape)),
        equilibria=tuple(found),
        tracks=tracks,
        duration=float(duration),
        name=name or type(ground).__name__,
    )


class _Field:
    """Rates of all states for many states at once, speed and steering held; columns are points."""

    def __init__(self, motion: Motion, x: np.ndarray, u: np.ndarray, steer: str, delta: float) -> None:
        model = motion.model
        self.motion, self.x = motion, x
        self.u = u.copy()
        self.u[model.inputs.index(steer)] = delta
        self.rows = lateral_states(motion)
        self.at_v_y, self.at_r = model.states.index("v_y"), model.states.index("r")
        self._held = np.ones(len(x), dtype=bool)
        self._held[self.rows] = False

    def from_plane(self, v_y: np.ndarray, r: np.ndarray) -> np.ndarray:
        """States with the other ones as they come to rest at each v_y and r."""
        start = np.repeat(self.x[:, None], len(v_y), axis=1)
        start[self.at_v_y], start[self.at_r] = v_y, r
        others = np.array([i for i in self.rows if i not in (self.at_v_y, self.at_r)], dtype=int)
        for column in start.T if len(others) else ():
            for _ in range(5):
                value, slope, *_ = self.motion.slopes(column, self.u, self.motion.values)
                column[others] -= np.linalg.lstsq(slope[np.ix_(others, others)], value[others], rcond=1e-12)[0]
        return start

    def __call__(self, x: np.ndarray) -> np.ndarray:
        found = self.motion.many(x, self.u)
        found[self._held] = 0.0
        return found

    def slopes(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        value, by_x, *_ = self.motion.slopes(x, self.u, self.motion.values)
        return value[self.rows], by_x[np.ix_(self.rows, self.rows)]


def _equilibria(field: _Field, starts: np.ndarray, size: np.ndarray) -> list[Equilibrium]:
    """What damped Newton steps from many points come to, inside the plane, each once, from v_y's left to its right."""
    found: list[Equilibrium] = []
    for start in starts.T:
        x = start.copy()
        value, slope = field.slopes(x)
        for _ in range(_NEWTON):
            step = np.linalg.lstsq(slope, -value, rcond=1e-12)[0]
            part = 1.0
            while part > 1e-3:
                trial = x.copy()
                trial[field.rows] += part * step
                after, bent = field.slopes(trial)
                if (np.isfinite(after).all() and np.linalg.norm(after) < np.linalg.norm(value)) or not value.any():
                    break
                part /= 2
            else:
                break
            x, value, slope = trial, after, bent
            if np.abs(value).max() < _ROUNDING:
                break
        at = np.array([x[field.at_v_y], x[field.at_r]])
        if np.abs(value).max() > 1e-6 or (np.abs(at) > size).any():
            continue
        if all((np.abs(at - [e.v_y, e.r]) > 1e-4 * size).any() for e in found):
            grows = int((np.linalg.eigvals(slope).real > 0).sum())
            kind: Kind = "stable" if not grows else "saddle" if grows == 1 else "unstable"
            found.append(Equilibrium(float(at[0]), float(at[1]), kind))
    return sorted(found, key=lambda e: (e.v_y, e.r))


def _driven(
    field: _Field, start: np.ndarray, size: np.ndarray, duration: float, points: int
) -> tuple[np.ndarray, np.ndarray]:
    """Where every point ends, shape (2, n), NaN for those that left; and the way of some, shape (n_tracks, n, 2)."""
    longest = min(_STEPS, getattr(field.motion.model, "max_step", _STEPS))
    count = max(2, int(np.ceil(duration / longest)))
    h, every = duration / count, max(1, count // 200)
    grid = np.arange(points * points).reshape(points, points)
    picked = np.unique(np.linspace(0, points - 1, _TRACKS).round().astype(int))
    kept = grid[np.ix_(picked, picked)].ravel()
    x, plane, track = start.copy(), [field.at_v_y, field.at_r], []
    live = np.ones(x.shape[1], dtype=bool)
    for k in range(count):
        if k % every == 0:
            track.append(np.where(live[kept], x[plane][:, kept], np.nan).T)
        now = x[:, live]
        a = field(now)
        b = field(now + 0.5 * h * a)
        c = field(now + 0.5 * h * b)
        d = field(now + h * c)
        x[:, live] = now + h / 6 * (a + 2 * b + 2 * c + d)
        away = ~np.isfinite(x).all(axis=0) | (np.abs(x[plane]) > 2 * size[:, None]).any(axis=0)
        live &= ~away
        if not live.any():
            break
    ends = np.where(live, x[plane], np.nan)
    return ends, np.stack(track, axis=1)
