"""A Driver with its defaults on cars from 1.5 kg to 40 t that nothing of it was tuned on.

Nineteen cars of `benchmarks.foreign_cars.fleet`: our dual track scaled by size, load and draw, and two multi-body cars
of commonroad-vehicle-models. Between command and road wheels lie 20 ms of delay and 50 ms of lag that nobody tells.
`identify_car` sees six drives of 20 s over the car's speeds, up to half of its grip (multisine steering, v_y and r with
noise); a `Driver` is built from what it found, the path, a speed law, and how noisy and late its sensors are; it sees
r, v_x, X, Y, psi alone. Double lane change of ISO 3888-1, every length times the car's wheelbase over 2.7 m, at the
speed at which the line asks for 0.7 of the lateral acceleration that the car is capable of, or at its highest. Errors
are over that same size, bounds those of a road car. True pose: every 10 ms, without noise; late pose: every 100 ms,
100 ms late, with noise of 2 cm (times the size) and 1 mrad. Noise of r 0.002 rad/s, of v_x 0.02 m/s for a road car, by
Froude's rule for others. Weights and noise of the Driver's defaults were chosen on two other cars, see
`benchmarks/bench_driver.py`, and on bicycles that differ from their model: all of these are test cars.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cached_property
from pathlib import Path as FilePath

import numpy as np

sys.path.append(str(FilePath(__file__).parents[1]))  # a benchmark is found by its file, its test bed by its name

from benchmarks.bench_driver import BOUNDS, NOISE, POSE, SEEDS, STEERING
from benchmarks.foreign_cars.fleet import FULL_THROTTLE, cars, make

from slipangle.control.driver import Driver
from slipangle.control.speed.driver import SpeedDriver
from slipangle.data.dataset import join
from slipangle.identify.car.identify_car import identify_car
from slipangle.models.model import Model
from slipangle.optimal.terms import Values
from slipangle.paths.lane_change import double_lane_change
from slipangle.paths.path import Path
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.simulate.drive import drive
from slipangle.simulate.manoeuvres import Manoeuvre, record
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import End, Run
from slipangle.simulate.sensors import Sensor, Sensors

TUNED_ON = "multi-body BMW 320i"  # in bench_driver, so not here
USUAL, WIDTH = 2.7, 1.8  # m, wheelbase and width of the car that the standard is for
LOG, MANOEUVRE = 0.5, 0.7  # of the car's grip


class FleetCar:
    """A car of the fleet with a steering of ours, what holds its speed, and what is known of it."""

    def __init__(self, name: str) -> None:
        self.name, self.plant = name, make(name).plant
        self.model, self.size, pace = self.plant.model, self.plant.wheelbase / USUAL, self.plant.pace
        share = Values(throttle=1 / FULL_THROTTLE, brake=0.0)
        if "throttle" not in self.model.inputs:
            share = Values(wanted_a_x=1.0)
        self.speed = SpeedDriver(
            kp=(1.2 * pace,), ki=(0.4 * pace**2,), limits=(-3.0, 3.0), feedforward=1.0, drive=share, brake=share
        )
        self.known = {"mass": self.plant.mass, "wheelbase": self.plant.wheelbase, "l_f": self.plant.l_f}
        scale = {"r": 1 / np.sqrt(self.size), "X": self.size, "Y": self.size, "psi": 1.0}
        self.noise = {n: std * scale.get(n, np.sqrt(self.size)) for n, std in NOISE.items()}

    @cached_property
    def identified(self) -> Model:
        """The model that its log gives, at 50 Hz."""
        logs, (low, high), n = [], self.plant.speeds, 2001
        for i, share in enumerate((0.25, 0.45, 0.65, 0.85, 0.75, 0.55)):
            t, rng, v = 0.01 * np.arange(n), np.random.default_rng(10 + i), low + share * (high - low)
            delta = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) / (1 + f) for f in np.arange(0.1, 3.0, 0.1))
            A, B, C, D = self.plant.linear(v)
            peak = (LOG, 0.6 * LOG)[i % 2] * self.plant.most / (D - C @ np.linalg.solve(A, B)).item()
            delta = delta * peak / np.abs(delta).max() * np.minimum(t / 2, 1)
            noise = Values({name: self.noise[name] for name in ("v_y", "r", "v_x")})
            plant = Plant(self.model, noise=noise, seed=i, **STEERING)
            log = record(plant, Manoeuvre(delta=delta, v_x=np.full(n, v)), self.speed, channels=("v_y", "r", "v_x"))
            logs.append(log.with_channel("delta", delta, "rad"))  # as commanded
        data = join(*logs).select(inputs=("delta", "v_x"), outputs=("v_y", "r")).resample(0.02)
        return identify_car(data, **self.known).model

    def lane_change(self) -> Path:
        """ISO 3888-1 for a car of this size."""
        path, k = double_lane_change(1.0, width=WIDTH), self.size
        lengths = {name: k * getattr(path, name) for name in ("s", "X", "Y", "right", "left")}
        path = replace(path, **lengths, curvature=path.curvature / k)
        fastest = np.sqrt(MANOEUVRE * self.plant.most / np.abs(path.curvature).max())
        return path.with_speed(min(float(fastest), self.plant.speeds[1]))

    def drive(self, path: Path, pose: str, seed: int) -> Run:
        """One drive with a Driver of defaults."""
        late = {n: Sensor(noise=self.noise[n], interval=0.1, delay=0.1) for n in POSE}
        sensors = {n: Sensor(noise=self.noise[n], interval=0.01) for n in ("r", "v_x")}
        told = {n: self.noise[n] for n in ("r", *POSE)}
        if pose == "late pose":
            sensors |= late
        else:
            told |= {"X": 0.1 * told["X"], "Y": 0.1 * told["Y"], "psi": 0.5 * told["psi"]}
        driver = Driver(
            self.identified,
            path,
            speed=self.speed,
            noise=told,
            late=dict.fromkeys(POSE, 0.1) if pose == "late pose" else {},
        )
        plant = Plant(self.model, sensors=Sensors(**sensors), seed=seed, **STEERING)
        return drive(plant, driver, channels=("r", "v_x", *POSE), width=WIDTH * self.size)

    def error(self, pose: str, seed: int) -> float:
        """Lateral RMSE of a lane change over the car's size [cm]; infinite if it left the lane or did not arrive."""
        run = self.drive(self.lane_change(), pose, seed)
        return 100.0 * run.rmse("y") / self.size if run.end is End.FINISHED and run.inside else np.inf


def bench(progress: Progress, seeds: tuple[int, ...] = SEEDS) -> Reproduction:
    """Identify every car, drive it with every seed."""
    names = [name for name in cars() if name != TUNED_ON]
    records = []
    for i, name in enumerate(names):
        progress(i / len(names), f"identifying the {name}")
        car = FleetCar(name)
        v_x = car.lane_change().speed(0.0)
        for j, (pose, bound) in enumerate(BOUNDS.items()):
            progress((i + (1 + j) / 3) / len(names), f"{name}, {pose}")
            errors = [car.error(pose, seed) for seed in seeds]
            note = f"{v_x:.1f} m/s, from {min(errors):.2f} to {max(errors):.2f}"
            what = f"RMSE over size, {pose}, median [cm]"
            records.append(Record.judged(name, what, None, float(np.median(errors)), at_most=bound, note=note))
    return Reproduction.told(__doc__, records, more=f"Noise seeds {', '.join(map(str, seeds))}.")


if __name__ == "__main__":
    from slipangle.report.records import record_table

    outcome = bench(lambda share, what: print(f"{share:5.1%} {what}", file=sys.stderr))
    print(record_table(outcome.records, title=outcome.title).to_text())
