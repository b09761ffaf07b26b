"""`pedal_driver`: a `SpeedDriver` for throttle and brake of a dual-track car, its gains scheduled over speed."""

from __future__ import annotations

import numpy as np

from slipangle.control.speed.driver import SpeedDriver
from slipangle.errors import ParameterError
from slipangle.models.vehicles.car import DualTrackParams
from slipangle.optimal.terms import Values


def drive_force(car: DualTrackParams, v_x: float) -> float:
    """Force at full throttle in the gear of a speed. [N]"""
    return engine_force(car, 1.0, v_x, car.driveline.gear_at(v_x / car.radius))


def engine_force(car: DualTrackParams, throttle: float, v_x: float, gear: int) -> float:
    """Force of the engine on the road at a throttle, 0 to 1, a speed [m/s] and a gear, 1 being the first. [N]"""
    line = car.driveline
    ratio = line.ratios[gear - 1] * line.final / car.radius
    return float(line.engine.torque(throttle, abs(v_x) * ratio)) * ratio


def moving_mass(car: DualTrackParams, v_x: float, gear: int | None = None) -> float:
    """Mass with everything that turns along, in a gear, 1 being the first, by default that of a speed. [kg]"""
    line = car.driveline
    ratio = line.ratios[(gear or line.gear_at(v_x / car.radius)) - 1] * line.final
    turning = car.inertia_wheel_f + car.inertia_wheel_r + line.engine.inertia * ratio * ratio
    return float(car.mass + turning / car.radius**2)


def tire_force(car: DualTrackParams, throttle: float, v_x: float, gear: int) -> float:
    """`engine_force` less what the turning masses take, so that it over the mass is an acceleration. [N]"""
    return engine_force(car, throttle, v_x, gear) * car.mass / moving_mass(car, v_x, gear)


def pedal_driver(
    car: DualTrackParams,
    *,
    bandwidth: float = 1.0,
    damping: float = 1.0,
    dt: float = 0.01,
    speeds: tuple[float, ...] = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0),
) -> SpeedDriver:
    """Scheduled PI controller of speed with normalised throttle and brake.

    At each speed the gains place the poles of ``mass v' = force pedal``, with the mass and full-throttle force of
    that speed's gear. Braking is scaled to the same force, up to the full brake pedal.

    Parameters
    ----------
    car : DualTrackParams
        The car.
    bandwidth, damping : float
        Natural frequency [rad/s] and damping ratio of the speed error.
    dt : float
        Sample time. [s]
    speeds : tuple of float
        Where the gains are computed, rising. [m/s]

    Raises
    ------
    ParameterError
        If the car has no engine torque or no brakes.

    >>> from slipangle.models.vehicles.catalogue import SOUSA_CAR_7
    >>> driver = pedal_driver(SOUSA_CAR_7)
    >>> driver.inputs(0.5)["throttle"], driver.inputs(-0.5)["brake"] > 0
    (0.5, True)
    """
    force = np.array([drive_force(car, v) for v in speeds])
    stop = float(car.brakes.torque / car.radius)
    if not (force.max() > 0 and stop > 0):
        raise ParameterError(
            f"the car's full throttle gives {force.max():g} N, its brakes {stop:g} N; expected both positive: give it "
            "an engine and brakes"
        )
    force = np.maximum(force, 0.2 * force.max())  # beyond the engine's last speed too
    gain = np.array([moving_mass(car, v) for v in speeds]) / force
    share = float(np.median(force)) / stop
    return SpeedDriver(
        kp=tuple((2 * damping * bandwidth * gain).tolist()),
        ki=tuple((bandwidth**2 * gain).tolist()),
        speeds=tuple(speeds),
        limits=(-1.0 / share, 1.0),
        feedforward=float(np.median(gain)),
        dt=dt,
        drive=Values(throttle=1.0, brake=0.0),
        brake=Values(throttle=0.0, brake=-share),
    )
