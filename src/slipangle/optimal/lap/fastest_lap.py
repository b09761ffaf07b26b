"""`fastest_lap`: the time-optimal lap of a car on a track, from cheap stages to the transient model."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from slipangle.errors import ModelWarning, ParameterError, SolverError, require_known, shown
from slipangle.optimal.checks import is_number
from slipangle.optimal.lap.car import LapCar
from slipangle.optimal.lap.cars import lap_car
from slipangle.optimal.lap.course import Course, course, spread
from slipangle.optimal.lap.envelope import Envelope, envelope
from slipangle.optimal.lap.lap import Lap, lap_of, require_lap_of
from slipangle.optimal.lap.line import minimum_curvature
from slipangle.optimal.lap.profile import speed_profile
from slipangle.optimal.lap.program import N_STATES, scales
from slipangle.optimal.lap.resolved import require_resolved
from slipangle.optimal.lap.solve import Problem, solve
from slipangle.optimal.solution import Status
from slipangle.paths.path import Path

_SPACING = 5.0  # m, between points, by default, for a car of usual size
_FASTEST = 120.0  # m/s, up to which a car of usual size is taken to be quasi-steady
_FEWEST, _MOST = 360, 6000  # points
# Of the tightest radius, that is the spacing where less; no less than this share of the usual one.
_OF_RADIUS, _FINEST = 0.3, 0.25
_COARSE = 2.0  # times as far apart, a lap may be off by a percent and more
_SHORTEST = 10.0, 2.0  # wheelbases, of a closed and an open track
_TOLERANCE = 0.05  # m, of a given line, for a car of usual size and larger ones
_CALM = 0.95  # of the quasi-steady speed, at which the transient lap starts
_SMOOTH = (1.4, 0.1, 0.16)  # of yaw acceleration and of the rates of steering and force, see `weights_of`


def fastest_lap(
    car: Any,
    track: Path,
    *,
    line: Literal["free", "given"] = "free",
    points: int | None = None,
    smoothness: float = 0.3,
    margin: float = 0.0,
    v_max: float = 120.0,
    v_start: float | None = None,
    like: Lap | None = None,
    allowed: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None,
    tolerance: float = 1e-6,
    iterations: int = 500,
) -> Lap:
    """Time-optimal lap of a car's transient model, between the edges of a track or along a given line.

    First the line of least curvature, then its quasi-steady speeds under the car's g-g-v diagram; from there an
    interior point solves for seven states (offset and heading against the track's line, v_x, v_y, r, steering angle and
    longitudinal force) whose steering and force have limited rates. Tires, loads, power, brakes and edges bound the
    lap; the slip angles stay where more of them gives more force. What is minimised is the lap time and, so that the
    car is not shaken for hundredths of a second, a small cost of yaw acceleration and of the rates; `Lap.time` is the
    time alone.

    Parameters
    ----------
    car : LapCar, or a model of a car whose power is known
        See `slipangle.optimal.lap.cars.lap_car`.
    track : Path
        With its edges; closed, or open from start to end.
    line : {"free", "given"}
        Whether the line is found too, or the track's own line is driven, to within 5 cm, of a small car as goes with
        its size.
    points : int, optional
        Collocation points, by default one every 1.94 wheelbases, 5 m for a full car, or every 0.3 of the tightest
        radius where that is less, and 360 at least. They are denser where the car is slow. Farther apart than 0.6 of
        the tightest radius they are warned of.
    smoothness : float
        Weight of yaw acceleration and rates. A lap of a race track at 0.3, the default, is 0.1 % slower than at 0.1,
        and one at 1, for a lap that is to be driven, 0.2 to 0.3 %; near 0 the optimum is no longer well defined. [-]
    margin : float
        Kept free between the car's side and the edges. [m]
    v_max : float
        Largest speed. [m/s]
    v_start : float, optional
        Speed at the start of an open track; free by default. [m/s]
    like : Lap, optional
        A lap of this track whose points, weights of smoothness and drive to start from, so that the two differ by the
        car alone; ``points`` and ``smoothness`` are then its own.
    allowed : callable, optional
        Of arc lengths of the track's line, shape (n,) [m]: the largest driving force and the largest speed there, both
        positive and of shape (n,) [N, m/s], within the car's power and force and ``v_max``. So a gearbox has its say.
    tolerance, iterations
        Of the solver: of its optimality conditions, scaled [-], and how often it may try.

    Returns
    -------
    Lap
        The lap, whose `Lap.sensitivities` say what each parameter is worth.

    Raises
    ------
    ParameterError
        If the car does not fit between the edges, the track has none, its line is noisy, folds back or overlaps past
        its start, or a setting is out of range.
    SolverError
        If no optimum was found; the sentence says how the solver ended.
    """
    began = time.perf_counter()
    vehicle = lap_car(car)
    _check(track, line, points, smoothness, margin, v_max, v_start, like, tolerance, iterations)
    _require_length(track, vehicle)
    require_resolved(track, vehicle.size)
    count = _points(track, _SPACING * vehicle.size, points)
    room = 0.5 * vehicle.width + margin
    edges: dict[str, Any] = {
        "room": room,
        "tolerance": _TOLERANCE * min(vehicle.size, 1.0) if line == "given" else None,
    }
    steady = envelope(vehicle, min(v_max, _FASTEST * vehicle.size**0.5))
    _require_drive(track, vehicle, steady)
    ends = _ends(track, count // 2, edges, steady, v_start) if like is None else like.ends
    along = course(track, ends, **edges)
    line_of, bend, v = _quasi_steady(along, steady, v_start)
    guess = _guess(vehicle, along, line_of, bend, _CALM * v) if like is None else like.columns
    weights = weights_of(vehicle, smoothness) if like is None else like.weights
    ready = time.perf_counter()
    problem = Problem(
        car=vehicle, along=along, weights=weights, bounds=_bounds(vehicle, along, v_max, v_start, allowed)
    )
    solved = solve(problem, guess, iterations=iterations, tolerance=tolerance)
    if not solved.status.solved:
        said = _said(solved.status, v_start, float(v[0]), _too_tight(vehicle, along, bend))
        raise SolverError(f"no fastest lap of '{track.name}' was found in {solved.iterations} iterations: {said}")
    return lap_of(
        vehicle,
        track,
        along,
        solved.variables,
        solved.times,
        duals=solved.duals,
        quasi_steady=_duration(along, line_of[0], v),
        cost=solved.cost,
        free=line == "free",
        weights=weights,
        status=solved.status,
        iterations=solved.iterations,
        seconds=(ready - began, time.perf_counter() - ready),
    )


def _ends(track: Path, intervals: int, edges: dict[str, Any], steady: Envelope, v_start: float | None) -> np.ndarray:
    """Where the intervals end: closer where the car is slow."""
    even = course(track, np.linspace(0.0, track.length, intervals + 1), **edges)
    return spread(even.s, _quasi_steady(even, steady, v_start)[2], track.length, intervals)


def weights_of(car: LapCar, smoothness: float) -> np.ndarray:
    """Weights of squared yaw acceleration, steering rate and rate of force: costs in s per s, per squared SI unit.

    In proportion to the yaw acceleration that a quarter of the weight at half the wheelbase makes, and to the rates.
    """
    yaw = car.weight * car.wheelbase / (4 * car.inertia_z)
    return smoothness * np.array(_SMOOTH) / np.array([yaw, car.delta_rate, car.force_rate * car.weight]) ** 2


def _too_tight(car: LapCar, along: Course, bend: np.ndarray) -> str:
    """What the tightest bend of the line of least curvature asks of the steering, where that is more than it has."""
    tightest = int(np.argmax(np.abs(bend)))
    asked = math.atan(car.wheelbase * abs(float(bend[tightest])))
    if asked <= car.delta_max:
        return ""
    return (
        f"the steering turns the wheels by {car.delta_max:.3g} rad at most, and rolling round the bend at "
        f"{along.s[tightest]:.0f} m takes {asked:.3g} rad on the line of least curvature; expected a larger "
        "delta_max, a shorter wheelbase or a wider track there"
    )


def _said(status: Status, v_start: float | None, slowed: float, too_tight: str) -> str:
    if v_start is not None and v_start > slowed:
        return f"v_start is {v_start:g} m/s, {slowed:.3g} could brake for what follows; expected a lower one"
    if too_tight:
        return too_tight
    if status is Status.ITERATION_LIMIT:
        return "the iteration limit was reached; allow more iterations, or another number of points"
    if status is Status.INFEASIBLE:
        return "no drive keeps every limit; check the track's tightest corner against the steering's limit"
    return f"{status.value}"


def _check(
    track: Path,
    line: str,
    points: int | None,
    smoothness: float,
    margin: float,
    v_max: float,
    v_start: float | None,
    like: Lap | None,
    tolerance: float,
    iterations: int,
) -> None:
    if not isinstance(track, Path):
        raise ParameterError(f"the track is a {type(track).__name__}; expected a Path: sa.Path.from_file(...)")
    require_known(line, ("free", "given"), "line")
    for name, count, low, high in (
        ("points", 20 if points is None else points, 20, _MOST),
        ("iterations", iterations, 1, 100_000),
    ):
        if not (isinstance(count, int | np.integer) and low <= count <= high):
            raise ParameterError(f"{name} is {shown(count)}; expected a whole number from {low} to {high}")
    for name, value, low, high in (
        ("tolerance", tolerance, 1e-10, 1e-2),
        ("smoothness", smoothness, 1e-3, 100.0),
        ("margin", margin, 0.0, 10.0),
        ("v_max", v_max, 1.0, 200.0),
        ("v_start", v_max if v_start is None else v_start, 0.5, v_max),
    ):
        if not (is_number(value) and low <= value <= high):
            raise ParameterError(f"{name} is {shown(value)}; expected {low:g} to {high:g}")
    if like is not None:
        require_lap_of(track, like, "the lap to be like")
    if v_start is not None and track.closed:
        raise ParameterError(f"v_start is given but '{track.name}' is closed; expected an open track, or no v_start")


def _points(track: Path, spacing: float, given: int | None) -> int:
    """Points as given, else one every ``spacing`` [m] or closer, as the tightest bend over that length asks for."""
    s = np.arange(0.0, track.length, 0.25 * spacing)
    turned = np.abs(track.at(s + 0.5 * spacing).psi - track.at(s - 0.5 * spacing).psi)
    radius = spacing / max(float(turned.max()), 1e-9)
    close = max(_OF_RADIUS * radius, _FINEST * spacing)
    usual = min(max(math.ceil(track.length / min(spacing, close)), _FEWEST), _MOST)
    if given is not None and track.length > given * _COARSE * close:
        warnings.warn(
            f"{given} points of '{track.name}' are one every {track.length / given:.3g} m, and its tightest bend has a "
            f"radius of {radius:.3g} m: the lap time may be off by percents; expected {usual} points, the default",
            ModelWarning,
            stacklevel=3,
        )
    return usual if given is None else given


def _require_drive(track: Path, car: LapCar, steady: Envelope) -> None:
    """Raise ParameterError if the car stands still on a closed track: its power is less than resistances take."""
    slow, pull = float(steady.v[0]), float(steady.drive[0, 0])
    if track.closed and pull <= 0.0:
        raise ParameterError(
            f"the car's power is {car.power:.3g} W and its drive_force {car.drive_force:.3g} N, and at {slow:.2g} m/s "
            f"air and road take {float(car.resistance(slow)):.3g} N: it stands still; expected more power, in W: "
            "check its unit"
        )


def _require_length(track: Path, car: LapCar) -> None:
    """Raise ParameterError if the track is too short for its car, as one in kilometres or degrees is."""
    least = _SHORTEST[0 if track.closed else 1] * car.wheelbase
    if track.length < least:
        raise ParameterError(
            f"'{track.name}' is {track.length:.3g} m long; expected {least:.2g} m at least for a car of "
            f"{car.wheelbase:.3g} m between its axles: give the track in metres, not in kilometres, and "
            "head latitude and longitude lat, lon"
        )


def _quasi_steady(
    along: Course, steady: Envelope, v_start: float | None
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
    """Offset and heading of the line of least curvature, its curvature, and its quasi-steady speeds."""
    n, chi, bend = minimum_curvature(
        along.X, along.Y, along.psi, along.step, along.low, along.high, closed=along.closed
    )
    v = speed_profile(bend, _lengths(along, n), steady, closed=along.closed, v_start=v_start)
    return (n, chi), bend, v


def _lengths(along: Course, n: np.ndarray) -> np.ndarray:
    x, y = along.X - n * np.sin(along.psi), along.Y + n * np.cos(along.psi)
    if along.closed:
        x, y = np.append(x, x[0]), np.append(y, y[0])
    return np.hypot(np.diff(x), np.diff(y))


def _duration(along: Course, n: np.ndarray, v: np.ndarray) -> float:
    """Time along a line. [s]"""
    mean = 0.5 * (v + np.roll(v, -1)) if along.closed else 0.5 * (v[1:] + v[:-1])
    ahead = 0.0 if along.closed else (along.s[0] - along.ends[0]) / v[0]  # of the first point
    return float(np.sum(_lengths(along, n) / mean) + ahead)


def _guess(
    car: LapCar, along: Course, line_of: tuple[np.ndarray, np.ndarray], bend: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """States and input rates, shape (n, 9), of quasi-steady cornering along a line."""
    n, chi = line_of
    length = _lengths(along, n)
    ahead = np.roll(v, -1) if along.closed else np.append(v[1:], v[-1])
    a_x = (ahead**2 - v**2) / (2 * (length if along.closed else np.append(length, length[-1])))
    side = car.mass * v * v * bend / car.wheelbase
    front, rear = (np.clip(side * arm / C, -0.08, 0.08) for arm, C in ((car.l_r, car.C_f), (car.l_f, car.C_r)))
    beta = car.l_r * bend - rear
    delta = np.clip(car.wheelbase * bend + front - rear, -0.9 * car.delta_max, 0.9 * car.delta_max)
    F_x = car.mass * a_x + car.drag * v * v
    nothing = np.zeros_like(v)
    return np.column_stack([n, chi - beta, v, v * beta, v * bend, delta, F_x, nothing, nothing])


def _bounds(
    car: LapCar,
    along: Course,
    v_max: float,
    v_start: float | None,
    allowed: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the variables, scaled."""
    size, n = scales(car), len(along.s)
    lowest = 0.02 * size[2]
    upper = np.full((n, N_STATES + 2), np.inf)
    upper[:, 1], upper[:, 2], upper[:, 5] = 1.3, v_max, car.delta_max
    upper[:, 7], upper[:, 8] = car.delta_rate, car.force_rate * car.weight
    lower = -upper
    lower[:, 0], upper[:, 0], lower[:, 2] = along.low, along.high, lowest
    if allowed is not None:
        if not callable(allowed):
            raise ParameterError(f"allowed is {shown(allowed)}; expected a function of arc lengths, or none")
        given = allowed(along.s)
        if not (isinstance(given, tuple | list) and len(given) == 2):
            raise ParameterError(f"allowed gives {shown(given)}; expected the largest forces and the largest speeds")
        force, speed = (np.asarray(v, dtype=float) for v in given)
        if force.shape != (n,) or speed.shape != (n,) or not (np.all(force > 0) and np.all(speed > 2.0 * lowest)):
            raise ParameterError(
                f"allowed gives forces of shape {force.shape} and speeds of shape {speed.shape}; expected ({n},) both, "
                f"forces above zero and speeds above {2.0 * lowest:.2g} m/s"
            )
        upper[:, 6], upper[:, 2] = force, np.minimum(speed, v_max)
    lower, upper = lower / size, upper / size
    if along.closed:
        return lower.ravel(), upper.ravel()
    first = [side[0, :N_STATES].copy() for side in (lower, upper)]
    if v_start is not None:
        first[0][2] = first[1][2] = v_start / size[2]
    return np.append(lower.ravel(), first[0]), np.append(upper.ravel(), first[1])
