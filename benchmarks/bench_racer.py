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

import numpy as np

from slipangle.control.racing.pedals import Pedals
from slipangle.control.racing.racer import Racer
from slipangle.control.racing.sensing import NOISE
from slipangle.data.public.registry import fetch
from slipangle.models.vehicles.catalogue import BMW_320I, PASSENGER_TIRE
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.optimal.lap.cars import lap_car
from slipangle.optimal.terms import Values
from slipangle.paths.path import Path
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.simulate.plant import Plant
from slipangle.simulate.race import race
from slipangle.simulate.race_car import on_road, optimum, race_car, with_gears

FRICTION, SEEDS, LAPS, MOST = 0.95, (0, 1), 10, 1.5  # -, -, -, %
POINTS, MARGIN = 800, 0.25  # of laps; m between car and edges in plans
GUESS = {"power": 8.5e4, "drive_force": 4e3}  # W, N of the lap of calibration: more than there is
SHARE, GRIP_STD = 0.96, 0.03
BENDS = (12.0, 15.0, 18.0, 21.0, 25.0, 30.0, 38.0)  # m/s


def bench(progress: Progress, seeds: tuple[int, ...] = SEEDS, laps: int = LAPS) -> Reproduction:
    """The plant's best lap car, its optimum, and ten laps for every seed."""
    track = Path.from_csv(fetch("tracks", "Norisring.csv")["Norisring.csv"])
    progress(0.0, "the lap car that fits the plant best")
    car = race_car(plant(), track, margin=MARGIN, points=POINTS, bends=BENDS, **GUESS)
    without_gears, raw = (optimum(one, track, FRICTION, POINTS) for one in (car, lap_car(plant())))
    fastest = with_gears(without_gears, BMW_320I, POINTS).time
    note = (
        f"with {car.power / 1e3:.1f} kW, at most {car.drive_force:.0f} N, in every gear: {without_gears.time:.3f} s; "
        f"lap_car(plant) as it is: {raw.time:.3f} s"
    )
    records = [Record.judged("optimum", "s, best fitting car, true friction", None, fastest, note=note)]
    for i, seed in enumerate(seeds):
        progress((1 + i) / (1 + len(seeds)), f"{laps} laps, seed {seed}")
        racer = Racer(car, track, Pedals.of(BMW_320I), share=SHARE, grip_std=GRIP_STD, margin=MARGIN)
        found = race(racer, Plant(on_road(plant(), FRICTION), noise=Values(**NOISE), seed=seed), laps)
        times, said = found.times, f"first plan {racer.first.time:.2f} s, {found.run.fallbacks} fallbacks"
        note = f"{', '.join(f'{t:.2f}' for t in times)} s; {said}"
        over = [100.0 * (t / fastest - 1.0) for t in times]
        name = f"seed {seed}"
        records += [
            Record.judged(name, "laps", None, len(times), at_least=laps),
            Record.judged(name, "slowest lap over the optimum, %", None, max(over), at_most=MOST, note=note),
            Record.judged(name, "mean of the laps over the optimum, %", None, float(np.mean(over)), at_most=MOST),
            Record.judged(
                name, "least room between car and edges, m", None, float(found.room[found.judged].min()), at_least=0.0
            ),
        ]
    return Reproduction.told(__doc__, records, more=f"Noise seeds {', '.join(map(str, seeds))}.")


def plant() -> DualTrack:
    """The car on a road of friction 1."""
    return DualTrack(params=BMW_320I, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001)


if __name__ == "__main__":
    from slipangle.report.records import record_table

    outcome = bench(lambda share, what: print(f"{share:5.1%} {what}", file=sys.stderr))
    print(record_table(outcome.records, title=outcome.title).to_text())
