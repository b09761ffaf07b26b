"""Twenty made cars from 1.5 kg to 40 t, their drives and the truth about them; drawn once, the same for everyone.

Seventeen are our dual-track car with parameters scaled by size, load and draw; three are the multi-body car of
commonroad-vehicle-models. Between the logged steering and the road wheels lie a pure delay, a first-order lag, a gain
and an offset that the user does not know; every channel has white noise.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np
from benchmarks.foreign_cars import multi_body
from benchmarks.foreign_cars.manoeuvres import Drive, H, planned
from benchmarks.foreign_cars.plants import LOGGED, TICK, PlantCar, Steering, driven_with, static_loads, stiffness
from scipy import signal

from slipangle.data.dataset import Dataset, join
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.models.vehicles.car import DualTrackParams
from slipangle.models.vehicles.catalogue import PASSENGER_TIRE
from slipangle.models.vehicles.driveline import Brakes, Driveline, Engine
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.parameters import GRAVITY

FLEET_SEED = 13
FULL_THROTTLE = 4.0  # m/s2 at the wheels, either way

# name: mass [kg], wheelbase [m], lowest and highest speed [m/s], height and track over wheelbase, roll per g [deg],
# share of the drive torque in front, tire stiffness and friction over the passenger tire's as they are drawn
_SIZES: dict[str, tuple[float, ...]] = {
    "1:10 car": (1.5, 0.257, 2.5, 6.0, 0.13, 0.75, 2.0, 0.5, 0.6, 1.0, 0.7, 1.1),
    "1:10 race car": (3.5, 0.325, 2.5, 7.0, 0.13, 0.75, 2.0, 0.0, 0.8, 1.3, 0.8, 1.2),
    "1:5 car": (12.0, 0.535, 3.5, 10.0, 0.14, 0.75, 2.5, 0.5, 0.7, 1.2, 0.7, 1.2),
    "kart": (165.0, 1.05, 5.0, 17.0, 0.22, 1.05, 1.0, 0.0, 0.9, 1.4, 1.0, 1.4),
    "Formula Student": (285.0, 1.55, 6.0, 22.0, 0.18, 0.77, 1.2, 0.0, 1.0, 1.5, 1.1, 1.5),
    "light quadricycle": (520.0, 1.7, 6.0, 16.0, 0.30, 0.72, 5.0, 0.0, 0.6, 0.9, 0.7, 0.9),
    "Formula": (760.0, 3.0, 12.0, 42.0, 0.10, 0.53, 0.8, 0.0, 1.1, 1.6, 1.2, 1.5),
    "sports car": (1280.0, 2.45, 8.0, 32.0, 0.19, 0.62, 2.5, 0.0, 0.9, 1.4, 1.0, 1.3),
    "small car": (1050.0, 2.45, 8.0, 27.0, 0.22, 0.59, 5.0, 1.0, 0.7, 1.1, 0.8, 1.1),
    "medium saloon": (1480.0, 2.7, 8.0, 30.0, 0.20, 0.57, 4.5, 1.0, 0.7, 1.2, 0.8, 1.1),
    "large saloon": (1950.0, 2.98, 8.0, 30.0, 0.19, 0.54, 4.0, 0.0, 0.8, 1.3, 0.9, 1.1),
    "SUV": (2350.0, 2.9, 8.0, 28.0, 0.25, 0.56, 5.0, 0.5, 0.7, 1.1, 0.8, 1.0),
    "van": (2700.0, 3.3, 8.0, 25.0, 0.25, 0.52, 6.0, 1.0, 0.6, 1.0, 0.8, 1.0),
    "light truck": (5600.0, 3.6, 7.0, 24.0, 0.27, 0.50, 5.0, 0.0, 0.6, 0.9, 0.7, 0.9),
    "bus": (14000.0, 6.0, 6.0, 23.0, 0.20, 0.36, 4.0, 0.0, 0.6, 0.9, 0.7, 0.85),
    "truck, 18 t": (18000.0, 4.9, 6.0, 23.0, 0.28, 0.43, 4.0, 0.0, 0.6, 0.9, 0.7, 0.8),
    "truck, 40 t": (40000.0, 6.6, 6.0, 23.0, 0.23, 0.36, 3.5, 0.0, 0.6, 0.8, 0.7, 0.75),
}
_MULTI_BODY = {
    "multi-body Ford Escort": (1, 8.0, 28.0),
    "multi-body BMW 320i": (2, 8.0, 30.0),
    "multi-body VW Vanagon": (3, 8.0, 24.0),
}
_AT_50_HZ = ("SUV", "bus", "truck, 40 t", "multi-body VW Vanagon")
NOISE_SEEDS = (0, 1, 2, 3, 4)


def cars() -> list[str]:
    """Names of the cars, the lightest first; those of commonroad-vehicle-models only where it is installed."""
    return [*_SIZES, *(_MULTI_BODY if multi_body.installed() else ())]


def missing() -> list[str]:
    """Names of the cars that cannot be driven here."""
    return [] if multi_body.installed() else list(_MULTI_BODY)


@dataclass(frozen=True, kw_only=True)
class Truth:
    """A car as it is; what its user knows are mass, wheelbase, l_f and roughly the steering ratio."""

    mass: float
    wheelbase: float
    l_f: float
    inertia_z: float
    C_f: float  # by the plant's own linearisation, mean of two speeds [N/rad]
    C_r: float
    spread: float  # largest relative difference of a stiffness between the two speeds [-]
    steering: Steering
    most: float  # largest lateral acceleration [m/s2]

    @property
    def values(self) -> dict[str, float]:
        """What a fit estimates, by its usual name."""
        s = self.steering
        tire = {"C_f": self.C_f, "C_r": self.C_r, "inertia_z": self.inertia_z}
        return tire | {"delay": s.delay, "lag": s.lag, "steering_gain": s.gain, "steering_offset": s.offset}


@dataclass(frozen=True, kw_only=True, eq=False)
class ForeignCar:
    """A car of the fleet: the truth about it and its logs."""

    name: str
    plant: PlantCar
    steering: Steering
    dt: float  # sample time of its log [s]
    noise: dict[str, float]  # standard deviation by channel; of v_x over its value [-]
    drives: tuple[tuple[Drive, ...], tuple[Drive, ...]] = field(repr=False)  # training and test

    @cached_property
    def truth(self) -> Truth:
        """What a fit should find."""
        p = self.plant
        found = stiffness(p)
        C_f, C_r = found.mean(axis=0)
        known = {n: getattr(p, n) for n in ("mass", "wheelbase", "l_f", "inertia_z", "most")}
        spread = float((np.ptp(found, axis=0) / found.mean(axis=0)).max())
        return Truth(C_f=float(C_f), C_r=float(C_r), spread=spread, steering=self.steering, **known)

    @cached_property
    def _clean(self) -> np.ndarray:
        """Channels of all drives without noise, shape (n_samples, n_drives, 4), each 10 ms."""
        return driven_with(self.plant, self.steering, [*self.drives[0], *self.drives[1]])

    def train(self, seed: int | None = 0) -> Dataset:
        """Gentle driving at four speeds, 12 experiments of 20 s; ``None`` leaves the noise out."""
        return self._log(0, seed)

    def test(self, seed: int | None = 0) -> Dataset:
        """Other manoeuvres and other speeds, up to 0.55 of the grip, 4 experiments of 20 s."""
        return self._log(1, seed)

    def _log(self, part: int, seed: int | None) -> Dataset:
        every, first = round(self.dt / (TICK * H)), part * len(self.drives[0])
        rng = np.random.default_rng([FLEET_SEED, zlib.crc32(self.name.encode()), part, seed or 0])
        logs = []
        for k, drive in enumerate(self.drives[part]):
            clean = dict(zip(LOGGED, self._clean[::every, first + k].T, strict=True))
            clean["delta"] = self.steering.logged(drive.wanted)[: len(self._clean) * TICK : TICK * every]
            noise = self.noise | {"v_x": self.noise["v_x"] * drive.v_x}
            seen = {n: c + (seed is not None) * noise[n] * rng.standard_normal(len(c)) for n, c in clean.items()}
            inputs, outputs = ({n: seen[n] for n in names} for names in (("delta", "v_x"), ("v_y", "r", "a_y")))
            units = {"delta": "rad", "v_x": "m/s", "v_y": "m/s", "r": "rad/s", "a_y": "m/s2"}
            logs.append(Dataset.from_arrays(inputs, outputs, self.dt, units=units, name=drive.name))
        return join(*logs, name=f"{self.name}, {('training', 'test')[part]}")


@cache
def make(name: str) -> ForeignCar:
    """A car by its name; it is driven once per process, when its logs are first asked for."""
    rng = np.random.default_rng([FLEET_SEED, zlib.crc32(name.encode())])
    plant = _multi_body_car(*_MULTI_BODY[name]) if name in _MULTI_BODY else _dual_track_car(rng, *_SIZES[name])
    steering = Steering(
        delay=rng.uniform(0.0, 0.06),
        lag=rng.uniform(0.0, 0.1),
        gain=rng.uniform(0.9, 1.1),
        offset=np.deg2rad(rng.uniform(-0.5, 0.5)),
        ratio=float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.05), np.log(20.0)))),
    )
    drives = planned(
        rng,
        wheelbase=plant.wheelbase,
        speeds=plant.speeds,
        most=plant.most,
        lateral=lambda wanted, v_x: _lateral(plant, steering, wanted, v_x),
    )
    noise = {
        "delta": np.deg2rad(rng.uniform(0.01, 0.05)),
        "v_x": 0.005,
        "r": np.deg2rad(rng.uniform(0.2, 0.5)) * plant.pace,
        "v_y": rng.uniform(0.03, 0.05) / plant.pace,
        "a_y": rng.uniform(0.05, 0.1),
    }
    dt = 0.02 if name in _AT_50_HZ else 0.01
    return ForeignCar(
        name=name, plant=plant, steering=steering, dt=dt, noise=noise, drives=(tuple(drives[0]), tuple(drives[1]))
    )


def _lateral(plant: PlantCar, steering: Steering, wanted: np.ndarray, v_x: float) -> np.ndarray:
    """Lateral acceleration of the linear bicycle, each 10 ms."""
    late = steering.road_wheel(wanted)[::TICK]
    b, a = signal.ss2tf(*signal.cont2discrete(plant.linear(v_x), H * TICK, "bilinear")[:4])
    return signal.lfilter(b[0], a, late)


# ---- our dual track -------------------------------------------------------------------------------------------------


def _tire(load: float, nominal: float, stiffness: float, friction: float, radius: float) -> MagicFormulaTire:
    """The passenger tire for another wheel load, with other stiffness and friction."""
    c: Any = PASSENGER_TIRE.coefficients
    scaled = {"PKY1": stiffness, "PKX1": stiffness, "PDY1": friction, "PDX1": friction}
    values = {name: factor * getattr(c, name) for name, factor in scaled.items()}
    return PASSENGER_TIRE.with_coefficients(FNOMIN=nominal * load, UNLOADED_RADIUS=radius, **values)


def axle_stiffness(tire: MagicFormulaTire, load: float) -> float:
    """Of two wheels at a load, at no slip. [N/rad]"""
    small = 1e-5
    return float(2 * tire.unlimited().forces(0.0, small, load).F_y / small)


def _dual_track_car(rng: np.random.Generator, *size: float) -> PlantCar:
    """A car of a size with everything else drawn; it understeers."""
    mass, L, slow, fast, height, track, roll, front, soft, stiff, slippery, grippy = size
    l_f, radius = L * rng.uniform(0.42, 0.58), 0.12 * L
    loads = static_loads(mass, L, l_f)
    nominal, stiffer, grip = rng.uniform(0.8, 1.4), rng.uniform(soft, stiff), rng.uniform(slippery, grippy)
    ends = {"f": (stiffer, grip), "r": (stiffer * rng.uniform(1.04, 1.25), grip * rng.uniform(1.02, 1.1))}
    tires = [_tire(load, nominal, *end, radius) for load, end in zip(loads, ends.values(), strict=True)]
    C_f, C_r = (axle_stiffness(tire, load) for tire, load in zip(tires, loads, strict=True))

    h, width = height * L, track * L
    inertia_x = mass * (0.3 * width) ** 2 + mass * h**2 * 0.2
    per_g = mass * GRAVITY * h / np.deg2rad(roll)  # N m/rad, besides what gravity tilts
    springs = np.array([0.55, 0.45]) * max(per_g + mass * GRAVITY * h, 24.0)
    total = inertia_x + mass * h**2
    damping = 2 * rng.uniform(0.3, 0.6) * np.sqrt((springs.sum() - mass * GRAVITY * h) * total)
    params = DualTrackParams(
        **dict(mass=mass, inertia_z=mass * l_f * (L - l_f) * rng.uniform(0.75, 1.15), wheelbase=L, l_f=l_f),
        **dict(height=h, track_f=width, track_r=width * rng.uniform(0.96, 1.02), radius=radius),
        **dict(inertia_wheel_f=0.02 * mass * radius**2, inertia_wheel_r=0.02 * mass * radius**2),
        **dict(relaxation_x=max(0.05 * L, 0.01), relaxation_y=L * rng.uniform(0.08, 0.15), rolling_resistance=0.01),
        **dict(roll_stiffness_f=springs[0], roll_stiffness_r=springs[1], inertia_x=inertia_x),
        **dict(roll_damping_f=0.5 * damping, roll_damping_r=0.5 * damping),
        **dict(
            inertia_y=0.2 * mass * L**2,
            pitch_stiffness=np.clip(3 * per_g, 10.0, 1e7),
            pitch_damping=min(2 * damping, 1e6),
        ),
        load_lag=max(0.02 * np.sqrt(L / 2.7), 0.002),
        brakes=Brakes(torque=0.0),
        driveline=Driveline(
            engine=Engine(speeds=(0.0,), torques=(FULL_THROTTLE * mass * radius / 4,)), final=4.0, front_share=front
        ),
    )
    model = DualTrack(params=params, tire_f=tires[0], tire_r=tires[1], dt=H, outputs=LOGGED)
    peaks = [
        float(tire.unlimited().forces(0.0, np.linspace(0.01, 0.5, 200), load).F_y.max()) / load
        for tire, load in zip(tires, loads, strict=True)
    ]
    return PlantCar(
        model=model,
        inputs=_pedals,
        **dict(mass=mass, wheelbase=L, l_f=l_f, inertia_z=float(params.inertia_z), speeds=(slow, fast)),
        most=GRAVITY * min(*peaks, 0.9 * width / (2 * h)),
        **dict(C_f=C_f, C_r=C_r),
    )


def _pedals(angles: np.ndarray, wanted_a_x: np.ndarray) -> np.ndarray:
    """Throttle for an acceleration; below zero it brakes."""
    return np.stack([angles, np.clip(wanted_a_x / FULL_THROTTLE, -1, 1), np.zeros_like(angles)], axis=-1)


# ---- commonroad's multi-body car ------------------------------------------------------------------------------------


def _multi_body_car(vehicle: int, slow: float, fast: float) -> PlantCar:
    p: Any = multi_body.parameters(vehicle)
    loads: Sequence[float] = static_loads(p.m, p.a + p.b, p.a)
    return PlantCar(
        model=multi_body.MultiBody(params=vehicle, dt=H, outputs=LOGGED),
        inputs=lambda angles, wanted_a_x: np.stack([angles, wanted_a_x], axis=-1),
        **dict(mass=p.m, wheelbase=p.a + p.b, l_f=p.a, inertia_z=p.I_z, speeds=(slow, fast)),
        most=0.85 * p.tire.p_dy1 * GRAVITY,
        **dict(C_f=-2 * p.tire.p_ky1 * loads[0], C_r=-2 * p.tire.p_ky1 * loads[1]),
    )
