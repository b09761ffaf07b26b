"""The car that a racer believes in: the `LapCar` that drives like a given dual track, and that one's fastest lap."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import brentq, least_squares

from slipangle.control.racing.gearbox import Gearbox
from slipangle.control.racing.pedals import Pedals
from slipangle.control.racing.racer import ALONG, DRIVEN, Racer
from slipangle.control.speed.pedals import tire_force
from slipangle.errors import SimulationError, SolverError
from slipangle.models.vehicles.car import DualTrackParams
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.on_tires import peak_friction, peak_friction_along
from slipangle.optimal.lap.car import LapCar, rates, size_of
from slipangle.optimal.lap.cars import lap_car
from slipangle.optimal.lap.fastest_lap import fastest_lap
from slipangle.optimal.lap.lap import Lap
from slipangle.paths.path import Path
from slipangle.simulate.plant import Plant
from slipangle.simulate.race import race
from slipangle.simulate.run import End

OUTPUTS = ("v_x", "v_y", "r", "X", "Y", "psi", "a_x", "a_y")  # of a plant that is raced
# Lengths, times and speeds are those of a car of usual size.
BENDS = (12.0, 15.0, 18.0, 21.0, 25.0, 30.0, 38.0)  # m/s
QUICK, TURN = 15.0, (0.012, 0.006)  # m/s, and the rate of the angle below and above it [rad/s]
CRAWL = 6.0  # m/s, no bend any more
PUSH = 0.25  # m/s, by which the speed of a bend is aimed too high, as a pedal in proportion ends below
HARD = 0.47  # of the weight, beyond which no force along the car is believed in a bend
MARGIN = 0.25  # m, kept free on the lap that tells what full throttle gives
SHARE = 0.9  # of the grip, on the lap that tells what full throttle gives
PRESSED, SETTLED = 0.99, 0.4  # throttle that is full, and for how long before its force counts [s]
FEWEST = 50  # samples of full throttle


def race_car(
    plant: DualTrack,
    track: Path,
    *,
    margin: float | None = None,
    points: int | None = None,
    bends: tuple[float, ...] | None = None,
    **values: float,
) -> LapCar:
    """The car of a lap that drives like a dual track, with the drive that it gets on a track.

    Stiffness and friction are fitted to bends of slowly rising angle, see `fitted`; power and largest force do the same
    work at full throttle as the plant on a careful lap without noise.

    Parameters
    ----------
    plant : DualTrack
        On a road of the friction that the car is to believe.
    track : Path
        Closed, with its edges.
    margin : float, optional
        Kept free beside the car on that lap; by default 0.25 m for a full car, in proportion to the wheelbase. [m]
    points : int, optional
        Of that lap's plan, see `fastest_lap`.
    bends : tuple of float, optional
        Speeds of the bends; by default 12 to 38 m/s for a full car, as the root of the wheelbase. [m/s]
    **values : float
        Parameters of `LapCar` that the lap is to be planned with; by default power and force are those of the engine in
        the gears of a dual track, which is more than there is at the wheels.

    Raises
    ------
    SolverError
        If there is no lap.
    SimulationError
        If the plant has no compiled code, or leaves the track on its lap.
    """
    pedals = Pedals.of(plant.params)
    full = pedals.most(pedals.speeds)
    engine = {"power": float(np.max(full * pedals.speeds)), "drive_force": float(full.max())}
    car = fitted(lap_car(plant, **{**engine, **values}), plant, bends)
    return _with_drive(car, plant, track, MARGIN * float(car.size) if margin is None else margin, points)


def on_road(plant: DualTrack, friction: float) -> DualTrack:
    """The plant as it is raced: its outputs are what a racer sees, its road holds ``friction`` times as much. [-]"""
    a, b, c, d = plant.road.friction
    road = replace(plant.road, friction=(friction * a, friction * b, friction * c, friction * d))
    return replace(plant, outputs=OUTPUTS, road=road)


def fitted(car: LapCar, plant: DualTrack, bends: tuple[float, ...] | None = None) -> LapCar:
    """The car with stiffness and friction that explain slow bends of a plant up to the limit, by least squares.

    Friction along its tires over that across is that of the plant's tires at the mean static load. ``bends`` are the
    speeds, see `race_car`. [m/s]
    """
    speeds = np.array(BENDS) * car.size**0.5 if bends is None else np.array(bends)
    angle, v_x, v_y, r, a_x, _, v_y_dot, r_dot = np.vstack([_bend(plant, v) for v in speeds.tolist()]).T
    most = HARD * car.weight
    force = np.clip(car.mass * a_x + car.drag * v_x**2, -most, most)
    names = ("C_f", "C_r", "mu_f", "mu_r")
    start = np.array([getattr(car, name) for name in names])

    def missed(share: np.ndarray) -> np.ndarray:
        motion = rates(v_x, v_y, r, angle, force, car.with_values(**dict(zip(names, share * start, strict=True))))
        return np.concatenate([motion.v_y - v_y_dot, 0.5 * car.wheelbase * (motion.r - r_dot)])

    found = least_squares(missed, np.ones(4), bounds=(0.3, 2.0)).x
    load = 0.25 * car.weight
    tires = (plant.tire_f, plant.tire_r)
    along = float(np.mean([peak_friction_along(tire, load) / peak_friction(tire, load) for tire in tires]))
    values = {n: float(v) for n, v in zip(names, found * start, strict=True)}
    return car.with_values(**values, mu_x=along)


def _bend(plant: DualTrack, v: float) -> np.ndarray:
    """Steady cornering up to the largest lateral acceleration, the angle rising slowly, speed held.

    Columns are angle, v_x, v_y, r, a_x, a_y and the rates of v_y and r.
    """
    dt, kernel, root = 0.01, plant.kernel, size_of(plant.params) ** 0.5
    if kernel is None:
        raise SimulationError("no C compiler is found; expected one for a plant of a millisecond: pip install ziglang")
    x, rows = plant.straight(v), []
    at = [plant.states.index(n) for n in ("v_x", "v_y", "r", "a_x_lag", "a_y_lag")]
    turn = TURN[int(v > QUICK * root)] / root
    for k in range(round(28.0 * root / dt)):
        angle, pedal = k * dt * turn, float(np.clip((v - x[0]) / root + PUSH, -1.0, 1.0))
        u = np.array([[angle, max(pedal, 0.0), max(-0.1 * pedal, 0.0)]])
        x = kernel.run(x, u, hold=round(dt / plant.dt))[-1]
        rows.append([angle, *x[at]])
        if abs(x[at[1]] / x[at[0]]) > 0.4 or x[0] < CRAWL * root:
            break
    table = np.array(rows)
    table = table[: int(np.argmax(table[:, 5])) + 1 : 4]
    return np.column_stack([table, np.gradient(table[:, 2], 4 * dt), np.gradient(table[:, 3], 4 * dt)])[2:-2]


def _with_drive(car: LapCar, plant: DualTrack, track: Path, margin: float, points: int | None) -> LapCar:
    """The car that does the same work at full throttle as the plant did on a lap.

    Its largest force is what the plant reached for a fiftieth of that time, its power follows. Where the throttle is
    hardly ever full, neither bounds a lap, and both stay.
    """
    sure = replace(car, mu_f=SHARE * car.mu_f, mu_r=SHARE * car.mu_r, mu_x=ALONG * car.mu_x)
    lap = fastest_lap(sure, track, points=points, margin=margin, smoothness=DRIVEN)
    known: Any = {"steering_lag": plant.params.steering.lag, "margin": margin, "between": False}
    racer = Racer(car, track, Pedals.of(plant.params), lap=lap, **known)
    run = race(racer, Plant(on_road(plant, 1.0)), 1).run
    if run.end in (End.LEFT_PATH, End.NOT_FINITE):
        raise SimulationError(
            f"the plant does not come round '{track.name}' on {SHARE:.0%} of its grip, {run.end.value}; expected a "
            "car that a racer can drive: check the plant, or take a wider track"
        )
    count = max(round(SETTLED * float(car.size) ** 0.5 / racer.sample), 1)
    held = np.convolve(run["throttle"] > PRESSED, np.ones(count), "full")[: len(run.t)] > count - 0.5
    if held.sum() < FEWEST:
        return car
    pull = np.gradient(run.v_x, run.t) - run["v_y"] * run["r"]
    force = car.mass * pull + car.resistance(run.v_x)
    v, force = run.v_x[held], force[held]
    most = float(np.quantile(force, 0.98))

    def more(power: float) -> float:
        return float(np.sum(np.minimum(most * v, power) - force * v))

    enough = most * float(v.max())
    power: Any = brentq(more, 0.01 * enough, enough) if more(0.01 * enough) < 0.0 < more(enough) else enough
    return replace(car, drive_force=most, power=float(power))


def optimum(car: LapCar, track: Path, friction: float = 1.0, points: int | None = None) -> Lap:
    """The fastest lap without margins at ``friction`` [-] times the car's own, with one power in every gear.

    It is as calm as those that racers plan.
    """
    there = replace(car, mu_f=friction * car.mu_f, mu_r=friction * car.mu_r)
    return fastest_lap(there, track, points=points, smoothness=DRIVEN)


def with_gears(lap: Lap, params: DualTrackParams, points: int | None = None) -> Lap:
    """The fastest lap like one of a single power, with the force of a dual track's engine in the gears of its speeds.

    Gears follow from the speeds of the lap and the lap from its gears, until they agree; raises SolverError if they do
    not within eight laps.
    """
    box, free = Gearbox.of(params), replace(lap.car, power=1e6, drive_force=1e5)
    for _ in range(8):
        slow = box.slow_enough(lap.v_x)
        gears = box.gears(np.minimum(lap.v_x, slow))
        most = np.array([tire_force(params, 1.0, v, gear) for v, gear in zip(lap.v_x, gears, strict=True)])
        lap = fastest_lap(free, lap.track, points=points, like=lap, allowed=lambda s, of=(most, slow): of)
        if np.mean(box.gears(lap.v_x) != gears) < 0.01:
            return lap
    raise SolverError("no lap was found that fits its own gears; expected one within eight")
