"""`Pedals`: throttle and brake for a force of the tires along the car."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from slipangle.control.racing.gearbox import Gearbox
from slipangle.control.speed.pedals import moving_mass, tire_force
from slipangle.errors import ParameterError
from slipangle.fields import Checked, Within
from slipangle.models.vehicles.car import DualTrackParams
from slipangle.optimal.lap.car import size_of

WHEELS = 0.06  # s, until wheels of a car of usual size, in a bend, have the slip that their force needs
_SPEEDS = np.arange(0.0, 121.0, 1.0)  # m/s, of that car
NONE = 1e-4  # of full brakes, force that is none


@dataclass(frozen=True, kw_only=True, eq=False)
class Pedals(Checked):
    """What throttle and brake do at rising speeds; where a gear is not given, it is the lowest that the engine turns.

    Parameters
    ----------
    speeds : array, shape (n,)
        Beyond the first and last, their values hold. [m/s]
    full, closed : array, shape (n,) or (n_gears, n)
        Force of the tires at full and at closed throttle, the latter zero or below; in each gear where there are
        several. [N]
    brake : array, shape (n,) or (n_gears, n)
        Force of the tires at full brake pedal, positive. [N]
    lag, brake_lag : float
        Time constants of the engine, and of the brakes with the wheels, which have to slow down before they brake. [s]
    gearbox : Gearbox, optional
        Where the gears change by themselves, as in `slipangle.control.racing.gearbox`.

    Raises
    ------
    ParameterError
        If speeds do not rise, full throttle drives less than closed throttle, or there are forces in gears that the
        gearbox does not have.
    """

    speeds: np.ndarray
    full: np.ndarray
    closed: np.ndarray
    brake: np.ndarray
    lag: Annotated[float, Within(0, unit="s", open="high")] = 0.0
    brake_lag: Annotated[float, Within(0, unit="s", open="high")] = 0.0
    gearbox: Gearbox | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        shapes = {np.shape(v)[-1] for v in (self.speeds, self.full, self.closed, self.brake)}
        if len(shapes) > 1 or not (np.diff(self.speeds) > 0).all():
            raise ParameterError(
                f"the pedals' arrays have {sorted(shapes)} values; expected one of each at speeds that rise"
            )
        if not (np.all(np.asarray(self.full) >= self.closed) and np.all(np.asarray(self.brake) > 0)):
            raise ParameterError(
                "full throttle drives less than closed throttle, or the brake does not brake; expected forces of the "
                "tires along the car: brake positive, closed zero or below"
            )
        rows = {len(np.atleast_2d(v)) for v in (self.full, self.closed, self.brake)}
        gears = 1 if self.gearbox is None else len(self.gearbox.up) + 1
        if rows not in ({1}, {gears}):
            raise ParameterError(
                f"the pedals have forces of {sorted(rows)} gears, the gearbox has {gears}; expected one row of each "
                "force, or one for every gear"
            )

    @classmethod
    def of(cls, car: DualTrackParams) -> Pedals:
        """Of a dual track's engine, gears and brakes.

        What turns with the wheels takes its share of the force, so that forces divided by the mass are accelerations.
        ``car`` has the parameters of a dual track.
        """
        gears, root = range(1, len(car.driveline.ratios) + 1), size_of(car) ** 0.5
        speeds = root * _SPEEDS
        share = np.array([[car.mass / moving_mass(car, v, gear) for v in speeds] for gear in gears])
        full, closed = (
            np.array([[tire_force(car, throttle, v, gear) for v in speeds] for gear in gears])
            for throttle in (1.0, 0.0)
        )
        return cls(
            speeds=speeds,
            full=np.maximum(full, 0.0),
            closed=np.minimum(closed, 0.0),
            brake=float(car.brakes.torque / car.radius) * share,
            lag=float(car.driveline.engine.lag),
            brake_lag=float(car.brakes.lag) + WHEELS * root,
            gearbox=Gearbox.of(car),
        )

    def most(self, v_x: float | np.ndarray, gear: int | np.ndarray | None = None) -> np.ndarray:
        """Force at full throttle at speeds [m/s], each in its ``gear``, 1 being the first. [N]"""
        return self._force(self.full, v_x, gear)

    def pressed(self, F_x: float, v_x: float, most: float, gear: int | None = None) -> tuple[float, float]:
        """Throttle and brake, 0 to 1, for a force ``F_x`` [N] at a speed [m/s] where full throttle gives ``most`` [N].

        ``gear`` is the one that the car is in, 1 being the first. While braking the throttle stays where the engine
        neither drives nor drags, so that the brakes alone share the force between the axles.
        """
        closed, full = (float(self._force(table, v_x, gear)) for table in (self.closed, self.brake))
        throttle = (max(F_x, 0.0) - closed) / max(most - closed, NONE * full)
        brake = -F_x / full if F_x < 0 else 0.0
        return min(max(throttle, 0.0), 1.0), min(brake, 1.0)

    def forces(
        self, throttle: float, brake: float, v_x: float, most: float, gear: int | None = None
    ) -> tuple[float, float]:
        """Forces along the car that engine and brakes settle to at ``throttle`` and ``brake``, 0 to 1. [N]

        Full throttle gives ``most`` [N] at that speed ``v_x`` [m/s] in that ``gear``, 1 being the first.
        """
        closed = float(self._force(self.closed, v_x, gear))
        return throttle * (most - closed) + closed, -brake * float(self._force(self.brake, v_x, gear))

    def _force(self, table: np.ndarray, v_x: float | np.ndarray, gear: int | np.ndarray | None) -> np.ndarray:
        """A force at speeds [m/s] in gears. [N]"""
        rows, box = np.atleast_2d(table), self.gearbox
        if len(rows) == 1 or box is None:
            return np.asarray(np.interp(v_x, self.speeds, rows[0]))
        if gear is None:
            gear = 1 + np.searchsorted(box.up, v_x)
        in_gears = np.array([np.interp(v_x, self.speeds, row) for row in rows])
        return np.take_along_axis(in_gears, np.expand_dims(np.asarray(gear) - 1, 0), axis=0)[0]
