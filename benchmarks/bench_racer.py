"""Ten laps of the Norisring by a Racer in the loop, on a dual track whose road holds 5 % less than it believes.

The plant is the catalogue's BMW 320i at a millisecond, friction 0.95 under every wheel, with its engine, gearbox,
brakes without anti-lock, relaxing tires and rolling body. The racer sees X, Y, psi, v_x, r, a_x and a_y with noise of
0.05 m, 0.05 m, 0.005 rad, 0.05 m/s, 0.005 rad/s and 0.2 m/s2, and knows nothing else.

The optimum it is measured by is the fastest lap, with `smoothness=1` and no margins, of the `LapCar` that fits this
plant best, at the true friction and with the force that the engine has in the gear that its gearbox is in. Grip and
front stiffness are fitted to bends of slowly rising angle at seven speeds on friction 1, the friction along the tires
is that of their files. The gearbox shifts down late and leaves the car in too high a gear behind slow corners, so gears
follow from the speeds of the lap and the lap from its gears, until they agree; where it pays, the lap is slow enough
to shift down. The racer's own car has one power and one force instead, those of a lap of calibration. Beside it stands
the lap of that car, whose power does not know the gears, and that of `sa.lap_car(plant)` as it is, with 90 kW and no
more friction along the tires than across. Never off the track means that the car's width stays between the edges. All
times are of the true motion, cut at the start line.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq, least_squares

from slipangle.control.racing.gearbox import Gearbox
from slipangle.control.racing.pedals import Pedals
from slipangle.control.racing.racer import ALONG, NOISE, Racer
from slipangle.data.dataset import Channel, Dataset
from slipangle.data.public.registry import fetch
from slipangle.models.vehicles.catalogue import BMW_320I, PASSENGER_TIRE
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.on_tires import peak_friction
from slipangle.models.vehicles.road import Road
from slipangle.optimal.lap.car import LapCar, rates
from slipangle.optimal.lap.cars import lap_car
from slipangle.optimal.lap.driven import driven_laps
from slipangle.optimal.lap.fastest_lap import fastest_lap
from slipangle.optimal.lap.lap import Lap
from slipangle.optimal.terms import Values
from slipangle.paths.path import Path
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.simulate.drive import drive
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import Run

SEEN = tuple(NOISE)
OUTPUTS = ("v_x", "v_y", "r", "X", "Y", "psi", "a_x", "a_y")
FRICTION, SEEDS, LAPS, MOST = 0.95, (0, 1), 10, 1.5  # -, -, -, %
POINTS, MARGIN = 800, 0.25  # of laps; m between car and edges in plans
GUESS = {"power": 8.5e4, "drive_force": 4e3}  # W, N of the lap of calibration: more than there is
SHARE, GRIP_STD = 0.96, 0.03
BENDS = (12.0, 15.0, 18.0, 21.0, 25.0, 30.0, 38.0)  # m/s


def bench(progress: Progress, seeds: tuple[int, ...] = SEEDS, laps: int = LAPS) -> Reproduction:
    """The plant's best lap car, its optimum, and ten laps for every seed."""
    track = Path.from_csv(fetch("tracks", "Norisring.csv")["Norisring.csv"])
    progress(0.0, "the lap car that fits the plant best")
    car = with_drive(fitted(lap_car(plant(1.0), **GUESS)), track)
    without_gears, raw = optimum(car, track), optimum(lap_car(plant(1.0)), track)
    fastest = with_gears(without_gears).time
    note = (
        f"with {car.power / 1e3:.1f} kW, at most {car.drive_force:.0f} N, in every gear: {without_gears.time:.3f} s; "
        f"lap_car(plant) as it is: {raw.time:.3f} s"
    )
    records = [Record.judged("optimum", "s, best fitting car, true friction", None, fastest, note=note)]
    for i, seed in enumerate(seeds):
        progress((1 + i) / (1 + len(seeds)), f"{laps} laps, seed {seed}")
        racer = Racer(car, track, Pedals.of(BMW_320I), share=SHARE, grip_std=GRIP_STD, margin=MARGIN)
        run, times = raced(racer, FRICTION, laps, seed)
        note = (
            ", ".join(f"{t:.2f}" for t in times) + f" s; first plan {racer.first.time:.2f} s, {run.fallbacks} fallbacks"
        )
        over = [100.0 * (t / fastest - 1.0) for t in times]
        name = f"seed {seed}"
        records += [
            Record.judged(name, "laps", None, len(times), at_least=laps),
            Record.judged(name, "slowest lap over the optimum, %", None, max(over), at_most=MOST, note=note),
            Record.judged(name, "mean of the laps over the optimum, %", None, float(np.mean(over)), at_most=MOST),
            Record.judged(name, "least room between car and edges, m", None, room(run, track), at_least=0.0),
        ]
    return Reproduction.told(__doc__, records, more=f"Noise seeds {', '.join(map(str, seeds))}.")


def plant(friction: float) -> DualTrack:
    """The car on a road."""
    road = Road(friction=(friction, friction, friction, friction))
    return DualTrack(
        params=BMW_320I, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001, outputs=OUTPUTS, road=road
    )


def optimum(car: LapCar, track: Path) -> Lap:
    """The fastest lap at the true friction."""
    return fastest_lap(replace(car, mu_f=FRICTION * car.mu_f, mu_r=FRICTION * car.mu_r), track, points=POINTS)


def with_gears(lap: Lap) -> Lap:
    """The fastest lap like one of a single power, with the force of the engine in the gears of its own speeds."""
    box, free = Gearbox.of(BMW_320I), replace(lap.car, power=1e6, drive_force=1e5)
    for _ in range(8):
        slow = box.slow_enough(lap.v_x)
        gears = box.gears(np.minimum(lap.v_x, slow))
        most = np.array([engine_force(*at) for at in zip(gears, lap.v_x, strict=True)])
        lap = fastest_lap(free, lap.track, points=POINTS, like=lap, allowed=lambda s, of=(most, slow): of)
        if np.mean(box.gears(lap.v_x) != gears) < 0.01:
            return lap
    raise SystemExit("no lap was found that fits its own gears; expected one within eight")


def engine_force(gear: int, v_x: float) -> float:
    """Force of the tires at full throttle in a gear at a speed [m/s], less what the turning masses take. [N]"""
    car, line = BMW_320I, BMW_320I.driveline
    ratio = line.ratios[gear - 1] * line.final / car.radius
    turning = (car.inertia_wheel_f + car.inertia_wheel_r) / car.radius**2 + line.engine.inertia * ratio**2
    return float(line.engine.torque(1.0, v_x * ratio)) * ratio * car.mass / (car.mass + turning)


def first(car: LapCar, track: Path, share: float) -> Lap:
    """A lap for a share of the grip."""
    sure = replace(car, mu_f=share * car.mu_f, mu_r=share * car.mu_r, mu_x=ALONG * car.mu_x)
    return fastest_lap(sure, track, points=POINTS, margin=MARGIN)


def fitted(car: LapCar) -> LapCar:
    """The car with stiffness and friction that explain slow bends up to the limit, in the sense of least squares.

    Friction along its tires over that across is that of the tire at the mean static load.
    """
    rows = np.vstack([bend(v) for v in BENDS])
    angle, v_x, v_y, r, a_x, _, v_y_dot, r_dot = rows.T
    force = np.clip(car.mass * a_x + car.drag * v_x**2, -5e3, 5e3)
    names = ("C_f", "C_r", "mu_f", "mu_r")
    start = np.array([getattr(car, name) for name in names])

    def missed(share: np.ndarray) -> np.ndarray:
        motion = rates(v_x, v_y, r, angle, force, car.with_values(**dict(zip(names, share * start, strict=True))))
        return np.concatenate([motion.v_y - v_y_dot, 1.3 * (motion.r - r_dot)])  # 1.3 m: half the wheelbase

    found = least_squares(missed, np.ones(4), bounds=(0.3, 2.0)).x
    load = 0.25 * car.weight
    along = -min(float(PASSENGER_TIRE.forces(-slip, 0.0, load).F_x) for slip in np.linspace(0.01, 0.4, 100))
    values = {n: float(v) for n, v in zip(names, found * start, strict=True)}
    return car.with_values(**values, mu_x=along / load / peak_friction(PASSENGER_TIRE, load))


def bend(v: float) -> np.ndarray:
    """Steady cornering on friction 1 up to the largest lateral acceleration, the angle rising slowly, speed held.

    Columns are angle, v_x, v_y, r, a_x, a_y and the rates of v_y and r.
    """
    car, dt = plant(1.0), 0.01
    kernel = car.kernel
    if kernel is None:
        raise SystemExit("no C compiler is found; expected one for a plant of a millisecond: pip install ziglang")
    x, rows = car.straight(v), []
    at = [car.states.index(n) for n in ("v_x", "v_y", "r", "a_x_lag", "a_y_lag")]
    for k in range(2800):
        angle, pedal = k * dt * (0.006 if v > 15 else 0.012), float(np.clip(v - x[0] + 0.25, -1.0, 1.0))
        u = np.array([[angle, max(pedal, 0.0), max(-0.1 * pedal, 0.0)]])
        x = kernel.run(x, u, hold=10)[-1]
        rows.append([angle, *x[at]])
        if abs(x[at[1]] / x[at[0]]) > 0.4 or x[0] < 6.0:
            break
    table = np.array(rows)
    table = table[: int(np.argmax(table[:, 5])) + 1 : 4]
    return np.column_stack([table, np.gradient(table[:, 2], 4 * dt), np.gradient(table[:, 3], 4 * dt)])[2:-2]


def with_drive(car: LapCar, track: Path) -> LapCar:
    """The car that does the same work at full throttle as the plant did on a lap on friction 1.

    Its largest force is what the plant reached for a fiftieth of that time, its power follows.
    """
    racer = Racer(car, track, Pedals.of(BMW_320I), lap=first(car, track, 0.9), margin=MARGIN, between=False)
    run, _ = raced(racer, 1.0, 1, None)
    held = np.convolve(run["throttle"] > 0.99, np.ones(40), "full")[: len(run.t)] > 39.5  # for 0.4 s
    pull = np.gradient(run.v_x, run.t) - run["v_y"] * run["r"]
    force = car.mass * pull + car.drag * run.v_x**2 + car.rolling_resistance * car.weight
    v, force = run.v_x[held], force[held]
    most = float(np.quantile(force, 0.98))
    power = brentq(lambda P: float(np.sum(np.minimum(most * v, P) - force * v)), 1e4, 1e6)
    return replace(car, drive_force=most, power=float(power))


def raced(racer: Racer, friction: float, laps: int, seed: int | None) -> tuple[Run, list[float]]:
    """The drive from just before the start line, and the times of its laps; without a seed there is no noise."""
    noise = Values() if seed is None else Values(**NOISE)
    car = Plant(plant(friction), noise=noise, seed=seed or 0)
    lap = racer.lap
    X, Y, psi, v = (float(column[-3]) for column in (lap.X, lap.Y, lap.psi, lap.v_x))
    x0 = car.straight(0.98 * v, X=X, Y=Y, psi=psi)
    duration = (laps + 0.2) * 1.04 * lap.time
    run = drive(car, racer, duration=duration, channels=SEEN, x0=x0, width=racer.car.width)
    places = np.column_stack([run["X"], run["Y"], run["v_x"]])
    log = Dataset(values=places, channels=(Channel("X", "m"), Channel("Y", "m"), Channel("v_x", "m/s")), dt=0.01)
    return run, [driven.time for driven in driven_laps(log, racer.track)][:laps]


def room(run: Run, track: Path) -> float:
    """Least distance between the car's side and an edge. [m]"""
    lane, half = track.at(run.s), 0.5 * run.width
    return float(min((lane.left - run.e_y).min(), (lane.right + run.e_y).min()) - half)


if __name__ == "__main__":
    from slipangle.report.records import record_table

    outcome = bench(lambda share, what: print(f"{share:5.1%} {what}", file=sys.stderr))
    print(record_table(outcome.records, title=outcome.title).to_text())
