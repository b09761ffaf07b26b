"""`SpeedDriver`: holds the speed with drive and brake, as a driver would, while another controller steers."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, Self

from slipangle.errors import ParameterError
from slipangle.fields import Checked, NotNegative, Positive
from slipangle.optimal.terms import Values, coerce

FASTEST = 1e3  # m/s and m/s2, beyond which a speed or acceleration is a fault
MOST = 1e12  # of the integral part, likewise
STANDSTILL = 0.5  # m/s, speed below which braking fades out
BRAKED = 0.3  # share of the braking that stays at the limit of grip: on the ellipse it costs 5 % of the side force


class DriverState(NamedTuple):
    """Integral part and last output, in the driver's output unit."""

    integral: float = 0.0
    output: float = 0.0


@dataclass(frozen=True, kw_only=True)
class SpeedDriver(Checked):
    """PI controller of speed with gains scheduled over speed and anti-windup by back-calculation.

    The output is a torque [N m] or a normalised pedal [-], whichever the gains and limits are in;
    `inputs` shares it out over a vehicle's inputs.

    Braking fades out below 0.5 m/s.

    Parameters
    ----------
    kp : tuple of float
        Proportional gain at each of `speeds`. [output per m/s]
    ki : tuple of float
        Integral gain at each of `speeds`. [output per m]
    limits : tuple of float
        Smallest (braking) and largest (driving) output. [output: N m or -]
    speeds : tuple of float
        Where the gains hold, rising; linear in between, constant beyond. [m/s]
    feedforward : float
        Output per wanted acceleration. [output per m/s2]
    dt : float
        Sample time. [s]
    drive, brake : Values
        Share of a positive, of a negative output that each input gets; `brake` defaults to `drive`.

    Raises
    ------
    ParameterError
        If the tables do not match, speeds do not rise, a gain is negative or the limits do not contain zero.
    """

    kp: tuple[NotNegative, ...]
    ki: tuple[NotNegative, ...]
    limits: tuple[float, float]
    speeds: tuple[float, ...] = (0.0,)
    feedforward: float = 0.0
    dt: Positive = 0.01
    drive: Values = field(default_factory=lambda: Values(T_f=1.0, T_r=0.0))
    brake: Values | None = None

    def __post_init__(self) -> None:
        coerce(self, Values, "drive", *(("brake",) if self.brake is not None else ()))
        super().__post_init__()
        if not len(self.kp) == len(self.ki) == len(self.speeds) >= 1:
            raise ParameterError(
                f"the schedule has {len(self.speeds)} speeds, {len(self.kp)} kp and {len(self.ki)} ki; expected "
                "as many of each"
            )
        if any(b <= a for a, b in zip(self.speeds, self.speeds[1:], strict=False)):
            raise ParameterError(f"the schedule's speeds are {self.speeds}; expected rising ones")
        if not self.limits[0] <= 0 <= self.limits[1]:
            raise ParameterError(f"the driver's limits are {self.limits}; expected (lowest <= 0, highest >= 0)")

    @classmethod
    def for_car(
        cls,
        *,
        mass: float,
        radius: float,
        limits: tuple[float, float],
        bandwidth: float = 2.0,
        damping: float = 1.0,
        dt: float = 0.01,
        drive: Values | None = None,
        brake: Values | None = None,
    ) -> Self:
        """Gains that place the poles of ``mass radius v' = torque``.

        Parameters
        ----------
        mass, radius : float
            Of the car [kg] and its wheels [m].
        limits : tuple of float
            Largest brake torque (negative) and drive torque. [N m]
        bandwidth, damping : float
            Natural frequency [rad/s] and damping ratio of the speed error.
        dt : float
            Sample time. [s]
        drive, brake : Values, optional
            Shares; by default all on the front axle.
        """
        inertia = mass * radius
        return cls(
            kp=(2 * damping * bandwidth * inertia,),
            ki=(bandwidth**2 * inertia,),
            limits=limits,
            feedforward=inertia,
            dt=dt,
            drive=drive if drive is not None else Values(T_f=1.0, T_r=0.0),
            brake=brake,
        )

    def step(
        self, state: DriverState, wanted: float, v_x: float, a_x: float = 0.0, *, grip: float = 1.0
    ) -> tuple[float, DriverState]:
        """Output for one sample, and the state for the next.

        Parameters
        ----------
        state : DriverState
            ``DriverState()`` at first.
        wanted, v_x : float
            Wanted and measured speed [m/s]; while either is no number or beyond 1000 m/s, the last output is held.
        a_x : float
            Wanted acceleration, for the feedforward. [m/s2]
        grip : float
            What the tires leave for driving and braking, from 0 to 1: the largest output is that share of its limit,
            the smallest one at least 0.3 of its, so that a car can always be stopped. [-]
        """
        state = self._sound(state)
        if not (abs(wanted) <= FASTEST and abs(v_x) <= FASTEST and abs(a_x) <= FASTEST):
            return state.output, state
        kp, ki = self.kp[0], self.ki[0]
        if len(self.speeds) > 1:
            kp, ki = _between(self.speeds, self.kp, v_x), _between(self.speeds, self.ki, v_x)
        error = wanted - v_x
        free = kp * error + state.integral + self.feedforward * a_x
        rolling = min(max(v_x / STANDSTILL, 0.0), 1.0)  # brakes stop the car, they do not push it back
        most = min(max(grip, 0.0), 1.0)
        output = min(max(free, self.limits[0] * rolling * max(most, BRAKED)), self.limits[1] * most)
        back = ki / kp if kp > 0 else 1.0  # 1/s: the integral follows the limit within kp / ki
        integral = state.integral + self.dt * (ki * error + back * (output - free))
        return output, DriverState(integral, output)

    def _sound(self, state: DriverState) -> DriverState:
        """The state, or what is left of it where it is no number: an output within limits, no integral part."""
        low, high = self.limits
        if low <= state.output <= high and abs(state.integral) <= MOST:
            return state
        output = min(max(state.output, low), high) if math.isfinite(state.output) else 0.0
        return DriverState(state.integral if abs(state.integral) <= MOST else 0.0, output)

    def inputs(self, output: float) -> dict[str, float]:
        """The output shared out over the vehicle's inputs, by name."""
        return {name: output * (drive if output >= 0 else brake) for name, drive, brake in self._shares}

    @cached_property
    def _shares(self) -> tuple[tuple[str, float, float], ...]:
        """Each input's share of a positive and of a negative output."""
        brake = self.drive if self.brake is None else self.brake
        names = dict.fromkeys((*self.drive, *brake))
        return tuple((name, self.drive.get(name, 0.0), brake.get(name, 0.0)) for name in names)


def _between(speeds: Sequence[float], gains: Sequence[float], v_x: float) -> float:
    """Linear between the speeds, constant beyond."""
    i = bisect_right(speeds, v_x)
    if i == 0 or i == len(speeds):
        return gains[min(i, len(speeds) - 1)]
    slope = (gains[i] - gains[i - 1]) / (speeds[i] - speeds[i - 1])
    return slope * (v_x - speeds[i - 1]) + gains[i - 1]
