"""The demo needs no download: a built-in car is driven, logged with sensor noise, and the main job runs on that log.

The car is the single track of L. C. Sousa's thesis, table 6.1, on the Magic Formula tires of table 6.2, with
wheel spin, at one millisecond; the job sees its noisy log only.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from slipangle import Plant, SingleTrack, SpeedDriver, Values
from slipangle.control.speed.driver import DriverState
from slipangle.data.signals import excitation as excite
from slipangle.files import write_atomic
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from slipangle.units import from_si

LOG_DT = 0.01  # s
NOISE = Values(v_x=0.03, v_y=0.03, r=0.004, a_y=0.15, X=0.05, Y=0.05, psi=0.002)

# channel in the log: (heading, unit)
COLUMNS = {
    "delta": ("steer", "deg"),
    "v_x": ("speed", "km/h"),
    "v_y": ("lateral speed", "m/s"),
    "r": ("yaw rate", "deg/s"),
    "a_y": ("lateral acceleration", "g"),
    "X": ("east", "m"),
    "Y": ("north", "m"),
    "psi": ("heading", "deg"),
}

_SETTINGS = """\
# The main job on the demo's own log. Run it again with:  slipangle run demo.toml
title = "Demo: a built-in car, from log to controller"
subtitle = "A 2500 kg front-drive car with saturating tires (thesis, tables 6.1, 6.2), {seconds:.0f} s of test drive"
out = "."

[data]
file = "drive_log.csv"
inputs = ["delta", "v_x"]
outputs = ["v_y", "r"]
rate = 50.0      # Hz
hold = "mean"    # steering moves between samples: drive the models with its mean, not with its last value
train = 0.7

[data.columns]   # channel = where it is in the file; units are converted at the door
{columns}

[[model]]
name = "car"
kind = "car"            # stiffness, yaw inertia, steering and sensors, as far as the log tells
mass = 2500             # known of the car, as it was driven
wheelbase = 2.7
l_f = 1.35

[[model]]
name = "ARX(4, 4)"
kind = "arx"
na = 4
nb = 4
offset = true

[controller]
kind = "driver"         # estimator, predictive controller and speed law in one, from measurements to commands
model = "car"
manoeuvre = "iso3888-1"
v_x = 20.0
dt = 0.02
width = 1.8

[plant]
catalogue = "sousa-table-6.1"
seed = 1
"""


def drive_log(
    *, seconds: float = 150.0, seed: int = 0, progress: Callable[[float], None] = lambda share: None
) -> tuple[np.ndarray, np.ndarray]:
    """Drive the built-in car for some seconds through excitation manoeuvres, with sensor noise.

    Returns
    -------
    t, table : array, shape (n,), (n, 8)
        Time [s], and what the sensors saw, SI units, columns as in `COLUMNS`.
    """
    car = SingleTrack(
        params=SOUSA_TABLE_6_1, dt=0.001, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2, outputs=("v_y", "r", "a_y")
    )
    plant = Plant(car, noise=NOISE, seed=seed)
    n = round(seconds / LOG_DT)
    t = np.arange(n) * LOG_DT
    steer, speed = np.append(_steering(n, seed), 0.0), 19.0 + 4.0 * np.sin(2 * np.pi * t / 55.0)
    p = SOUSA_TABLE_6_1
    driver = SpeedDriver.for_car(mass=p.mass, radius=p.radius, limits=(-8000.0, 4000.0), dt=LOG_DT)
    held, moving = DriverState(), (np.arange(10) + 0.5) / 10
    sensor = 0.0003 * np.random.default_rng([seed, 1]).standard_normal(n)  # rad, of the logged steering angle
    simulation = plant.start(car.straight(float(speed[0])), np.zeros(3))
    table = np.empty((n, len(COLUMNS)))
    for k in range(n):
        seen = simulation.measure()
        table[k] = [steer[k] + sensor[k] if name == "delta" else seen[name] for name in COLUMNS]
        torque, held = driver.step(held, float(speed[k]), seen["v_x"])
        for share in moving:  # the driver's hands do not wait for the log
            simulation.advance(np.array([(1 - share) * steer[k] + share * steer[k + 1], torque, 0.0]), 1)
        if k % 500 == 0:
            progress(k / n)
    return t, table


def _steering(n: int, seed: int) -> np.ndarray:
    """Road-wheel angle of the test drive: swept sine, multisines, steps, sine with dwell. [rad]"""
    part = n // 6
    rest = n - 5 * part
    pieces = [
        excite.swept_sine(part, LOG_DT, f_start=0.1, f_stop=2.0, amplitude=0.02),
        excite.multisine(part, LOG_DT, f_min=0.05, f_max=2.0, amplitude=0.035),
        excite.staircase(part, LOG_DT, levels=[0.0, 0.015, -0.015, 0.03, -0.03, 0.0], rise=0.3),
        excite.multisine(part, LOG_DT, f_min=0.05, f_max=1.0, amplitude=0.03, phases="random", seed=seed),
        excite.multisine(part, LOG_DT, f_min=0.05, f_max=2.0, amplitude=0.03, phases="random", seed=seed + 1),
        np.resize(excite.sine_with_dwell(800, LOG_DT, amplitude=0.04), rest),
    ]
    return np.concatenate([_fade(p) for p in pieces])


def _fade(signal: np.ndarray, samples: int = 50) -> np.ndarray:
    """The signal eased to zero at both ends, so that pieces join without a jump."""
    ramp = np.minimum(1.0, np.arange(len(signal)) / samples)
    return signal * ramp * ramp[::-1]


def prepare_demo(folder: str | Path, *, progress: Callable[[float], None] = lambda share: None) -> Path:
    """Write the log and the job's settings into a folder, and return the settings file.

    Raises WriteError if the folder cannot be written.
    """
    t, table = drive_log(progress=progress)
    headings = ["time [s]"] + [f"{heading} [{unit}]" for heading, unit in COLUMNS.values()]
    units = [unit for _, unit in COLUMNS.values()]
    converted = np.column_stack([from_si(table[:, j], unit) for j, unit in enumerate(units)])
    rows = [",".join([f"{now:.2f}", *(f"{value:.6g}" for value in row)]) for now, row in zip(t, converted, strict=True)]
    write_atomic(Path(folder) / "drive_log.csv", "\n".join([",".join(headings), *rows]) + "\n")
    columns = "\n".join(f'{name} = {{ column = "{h}", unit = "{u}" }}' for name, (h, u) in COLUMNS.items())
    text = _SETTINGS.format(seconds=t[-1] + LOG_DT, columns=columns)
    return write_atomic(Path(folder) / "demo.toml", text)
