"""A lap of the Norisring by a Driver with its defaults, at a tenth below what the car's tires can.

Two rear-driven cars of `benchmarks.foreign_cars.fleet` with brakes: a sports car, capable of 11.0 m/s2, at 10 m/s2, and
a formula car, capable of 13.2 m/s2, at 12 m/s2. Both as in `benchmarks/bench_driver_fleet.py`: identified from a log of
up to half their grip, steering 20 ms late and behind a lag of 50 ms, raw measurements. The line is the track's middle,
the profile the fastest that keeps to the lateral acceleration, 3 m/s2 of drive and 5 m/s2 of braking. That a plan must
keep to the slip angle at which the front axle's force peaks was seen on the sports car; the formula car was kept back.
Not every car does it: the fleet's small car, front-driven and capable of 11.3 m/s2, goes wide at 10 m/s2 (39 cm).
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np

sys.path.append(str(FilePath(__file__).parents[1]))  # a benchmark is found by its file, its test bed by its name

from benchmarks.bench_driver import BOUNDS, SEEDS
from benchmarks.bench_driver_fleet import FleetCar

from slipangle.control.speed.pedals import pedal_driver
from slipangle.data.public.registry import fetch
from slipangle.models.vehicles.driveline import Brakes
from slipangle.paths.path import Path
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.simulate.run import End

CARS = {"sports car": 10.0, "Formula": 12.0}  # m/s2
DRIVE, BRAKE = 3.0, 5.0  # m/s2
MOST = 4.0  # cm


class TrackCar(FleetCar):
    """A car of the fleet with brakes on all wheels."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        p = self.model.params
        braked = replace(p, brakes=Brakes(torque=9.0 * p.mass * p.radius))
        self.track_model, self.pedals = replace(self.model, params=braked), pedal_driver(braked)

    def lap(self, track: Path, a_y: float, pose: str, seed: int) -> float:
        """Lateral RMSE of one lap [cm]; infinite if it did not end."""
        _ = self.identified  # from its log, which it drives without brakes
        self.model, self.speed = self.track_model, self.pedals
        path = track.with_speed_limits(v_max=1.2 * self.plant.speeds[1], a_y=a_y, a_x=DRIVE, a_brake=BRAKE)
        run = self.drive(path, pose, seed)
        return 100.0 * run.rmse("y") if run.end is End.FINISHED else np.inf


def bench(progress: Progress, seeds: tuple[int, ...] = SEEDS) -> Reproduction:
    """Both cars, both qualities of the pose, every seed."""
    track = Path.from_csv(fetch("tracks", "Norisring.csv")["Norisring.csv"])
    records = []
    for i, (name, a_y) in enumerate(CARS.items()):
        car = TrackCar(name)
        for j, pose in enumerate(BOUNDS):
            progress((i + j / 2) / 2, f"{name}, {pose}")
            errors = [car.lap(track, a_y, pose, seed) for seed in seeds]
            note = f"{a_y:g} of {car.plant.most:.1f} m/s2, from {min(errors):.2f} to {max(errors):.2f}"
            what = f"RMSE of a lap, {pose}, median [cm]"
            records.append(Record.judged(name, what, None, float(np.median(errors)), at_most=MOST, note=note))
    return Reproduction.told(__doc__, records, more=f"Noise seeds {', '.join(map(str, seeds))}.")


if __name__ == "__main__":
    from slipangle.report.records import record_table

    outcome = bench(lambda share, what: print(f"{share:5.1%} {what}", file=sys.stderr))
    print(record_table(outcome.records, title=outcome.title).to_text())
