"""A lap of the Norisring by a Driver with its defaults, near the limit of five cars' tires.

Three cars of `benchmarks.foreign_cars.fleet` with brakes (a sports and a formula car, rear-driven, and a small one,
front-driven), the multi-body BMW 320i of commonroad-vehicle-models and the thesis' car of chapter 7. All are identified
from a log of up to half their grip, their steering is 20 ms late and behind a lag of 50 ms, the Driver has raw
measurements. The line is the track's middle, the profile the fastest that keeps to a lateral acceleration, 3 m/s2 of
drive and 5 m/s2 of braking.

How near: beside every result stands what the car holds in a bend at 20 m/s while the steering angle rises slowly, its
speed held. By the friction of their tires at rest the first three can 11.0, 13.2 and 11.3 m/s2, of which they are asked
for 10, 12 and 10; as load moves to the outer wheels and the tires drive as well, they hold less in a steady bend. The
other two, whose tires have less, are asked for 10/11 of what they hold.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cached_property
from pathlib import Path as FilePath

import numpy as np

sys.path.append(str(FilePath(__file__).parents[1]))  # a benchmark is found by its file, its test bed by its name

from benchmarks.bench_driver import BOUNDS, SEEDS, Car
from benchmarks.bench_driver_fleet import FleetCar
from benchmarks.foreign_cars import multi_body

from slipangle.control.speed.driver import DriverState, SpeedDriver
from slipangle.control.speed.pedals import pedal_driver
from slipangle.data.public.registry import fetch
from slipangle.models.model import Model
from slipangle.models.vehicles.driveline import Brakes
from slipangle.optimal.terms import Values
from slipangle.paths.path import Path
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import End, Run

BMW, THESIS = "multi-body BMW 320i", "thesis' car"
CARS = {"sports car": 10.0, "Formula": 12.0, "small car": 10.0, BMW: None, THESIS: None}  # m/s2; None: by what it holds
SHARE = 10.0 / 11.0
DRIVE, BRAKE = 3.0, 5.0  # m/s2
MOST = 4.0  # cm
BEND, STEADY = 20.0, 0.3  # m/s in the bend, and how far from it the speed may be


class TrackCar(FleetCar):
    """A car of the fleet with brakes on all wheels."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.wheelbase, self.fastest = self.plant.wheelbase, 1.2 * self.plant.speeds[1]
        shares = Values(wanted_a_x=1.0)
        self.track_model: Model = self.model
        if "throttle" in self.model.inputs:
            p = self.model.params
            braked = replace(p, brakes=Brakes(torque=9.0 * p.mass * p.radius))
            self.track_model, self.law = replace(self.model, params=braked), pedal_driver(braked)
        else:
            self.law = SpeedDriver(kp=(2.0,), ki=(1.0,), limits=(-8.0, 3.0), feedforward=1.0, drive=shares)

    def along(self, path: Path, pose: str, seed: int) -> Run:
        """One drive with a Driver of defaults."""
        _ = self.identified  # from its log, which it drives without brakes
        self.model, self.speed = self.track_model, self.law
        return self.drive(path, pose, seed)


class ThesisCar(Car):
    """The thesis' car, as in `benchmarks/bench_driver.py`."""

    def __init__(self) -> None:
        super().__init__("dual track")
        self.wheelbase, self.fastest = self.known["wheelbase"], 40.0
        self.track_model, self.law = self.model, self.speed

    @cached_property
    def found(self) -> Model:
        """The model that its log gives."""
        return self.identified()

    def along(self, path: Path, pose: str, seed: int) -> Run:
        """One drive with a Driver of defaults."""
        return self.drive(self.found, pose, seed, path=path)


def held(car: TrackCar | ThesisCar) -> float:
    """Largest lateral acceleration in a bend at a speed that is held, the angle rising until that fails. [m/s2]"""
    plant, law, driven, most = Plant(car.track_model), replace(car.law, dt=0.01), DriverState(), 0.0
    names, v_y = plant.model.inputs, 0.0
    simulation = plant.start(plant.straight(BEND), np.zeros(len(names)))
    for k in range(4000):
        true = simulation.true()
        if not abs(true["v_x"] - BEND) < STEADY:
            break
        most, v_y = max(most, true["r"] * true["v_x"] + (true["v_y"] - v_y) / 0.01), true["v_y"]
        output, driven = law.step(driven, BEND, true["v_x"])
        given = {**law.inputs(output), "delta": 30.0 * car.wheelbase / BEND**2 * k / 4000}
        simulation.advance(np.array([given.get(n, 0.0) for n in names]), round(0.01 / plant.dt))
    return most


def bench(progress: Progress, seeds: tuple[int, ...] = SEEDS) -> Reproduction:
    """All cars, both qualities of the pose, every seed."""
    track = Path.from_csv(fetch("tracks", "Norisring.csv")["Norisring.csv"])
    records, names = [], [n for n in CARS if n != BMW or multi_body.installed()]
    for i, name in enumerate(names):
        car = ThesisCar() if name == THESIS else TrackCar(name)
        most = held(car)
        a_y = CARS[name] or SHARE * most
        path = track.with_speed_limits(v_max=car.fastest, a_y=a_y, a_x=DRIVE, a_brake=BRAKE)
        for j, pose in enumerate(BOUNDS):
            errors = []
            for k, seed in enumerate(seeds):
                progress((i + (j + k / len(seeds)) / 2) / len(names), f"{name}, {pose}, seed {seed}")
                run = car.along(path, pose, seed)
                errors.append(100.0 * run.rmse("y") if run.end is End.FINISHED else np.inf)
            note = f"at {a_y:.2f} m/s2, holds {most:.2f}; from {min(errors):.2f} to {max(errors):.2f}"
            what = f"RMSE of a lap, {pose}, median [cm]"
            records.append(Record.judged(name, what, None, float(np.median(errors)), at_most=MOST, note=note))
    return Reproduction.told(__doc__, records, more=f"Noise seeds {', '.join(map(str, seeds))}.")


if __name__ == "__main__":
    from slipangle.report.records import record_table

    outcome = bench(lambda share, what: print(f"{share:5.1%} {what}", file=sys.stderr))
    print(record_table(outcome.records, title=outcome.title).to_text())
