"""`Pedals`: throttle and brake for a force of the tires along the car."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from slipangle.control.racing.gearbox import Gearbox
from slipangle.control.speed.pedals import drive_force, moving_mass
from slipangle.errors import ParameterError
from slipangle.fields import Checked, Within
from slipangle.models.vehicles.car import DualTrackParams

_SPEEDS = np.arange(0.0, 121.0, 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pedals(Checked):
    """What throttle and brake do at rising speeds; arrays have shape (n,).

    Parameters
    ----------
    speeds : array
        Beyond the first and last, their values hold. [m/s]
    full, closed : array
        Force of the tires at full and at closed throttle, the latter zero or below. [N]
    brake : array
        Force of the tires at full brake pedal, positive. [N]
    lag : float
        Time constant of the engine. [s]
    gearbox : Gearbox, optional
        Where the gears change by themselves, as in `slipangle.control.racing.gearbox`.

    Raises
    ------
    ParameterError
        If speeds do not rise, or full throttle drives less than closed throttle.
    """

    speeds: np.ndarray
    full: np.ndarray
    closed: np.ndarray
    brake: np.ndarray
    lag: Annotated[float, Within(0, unit="s", open="high")] = 0.0
    gearbox: Gearbox | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        shapes = {len(np.atleast_1d(v)) for v in (self.speeds, self.full, self.closed, self.brake)}
        if len(shapes) > 1 or not (np.diff(self.speeds) > 0).all():
            raise ParameterError(
                f"the pedals' arrays have {sorted(shapes)} values; expected one of each at speeds that rise"
            )
        if not (np.all(np.asarray(self.full) >= self.closed) and np.all(np.asarray(self.brake) > 0)):
            raise ParameterError(
                "full throttle drives less than closed throttle, or the brake does not brake; expected forces of the "
                "tires along the car: brake positive, closed zero or below"
            )

    @classmethod
    def of(cls, car: DualTrackParams) -> Pedals:
        """Of a dual track's engine, gears and brakes, each speed in the lowest gear that the engine can turn.

        What turns with the wheels takes its share of the force, so that forces divided by the mass are accelerations.
        ``car`` has the parameters of a dual track.
        """
        share = np.array([car.mass / moving_mass(car, v) for v in _SPEEDS])
        return cls(
            speeds=_SPEEDS,
            full=np.maximum(np.array([drive_force(car, v) for v in _SPEEDS]), 0.0) * share,
            closed=np.array([min(_closed(car, v), 0.0) for v in _SPEEDS]) * share,
            brake=float(car.brakes.torque / car.radius) * share,
            lag=float(car.driveline.engine.lag),
            gearbox=Gearbox.of(car),
        )

    def most(self, v_x: float | np.ndarray) -> np.ndarray:
        """Force at full throttle. [N]"""
        return np.asarray(np.interp(v_x, self.speeds, self.full))

    def pressed(self, F_x: float, v_x: float, most: float) -> tuple[float, float]:
        """Throttle and brake, 0 to 1, for a force ``F_x`` [N] at a speed [m/s] where full throttle gives ``most`` [N].

        While braking the throttle stays where the engine neither drives nor drags, so that the brakes alone share the
        force between the axles.
        """
        closed = float(np.interp(v_x, self.speeds, self.closed))
        span = max(most - closed, 1.0)
        throttle = (max(F_x, 0.0) - closed) / span
        brake = -F_x / float(np.interp(v_x, self.speeds, self.brake)) if F_x < 0 else 0.0
        return min(max(throttle, 0.0), 1.0), min(brake, 1.0)

    def force(self, throttle: float, brake: float, v_x: float, most: float) -> float:
        """Force of the tires along the car that ``throttle`` and ``brake``, 0 to 1, settle to. [N]

        Full throttle gives ``most`` [N] at that speed ``v_x`` [m/s].
        """
        closed = float(np.interp(v_x, self.speeds, self.closed))
        return throttle * (most - closed) + closed - brake * float(np.interp(v_x, self.speeds, self.brake))


def _closed(car: DualTrackParams, v_x: float) -> float:
    """Force at closed throttle in the gear of a speed. [N]"""
    line = car.driveline
    axle = v_x / car.radius
    ratio = line.ratios[line.gear_at(axle) - 1] * line.final
    return float(line.engine.torque(0.0, axle * ratio)) * ratio / car.radius
