"""Engine, gearbox, differentials, brakes and steering: what a dual-track car has around its wheels.

Wheels are numbered 0 to 3: front left, front right, rear left, rear right.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated

from slipangle.errors import ParameterError
from slipangle.models.parameters import ParameterSet
from slipangle.models.vehicles.road import check_table, table
from slipangle.ops import Scalar, clip, fabs, maximum, sign, sqrt, tan, tanh, where
from slipangle.units import SI


@dataclass(frozen=True, kw_only=True)
class Engine(ParameterSet):
    """Torque over speed at full throttle, drag at closed throttle; linear in throttle between them.

    Parameters
    ----------
    speeds, torques : tuple of float
        Full-throttle torque [N m] at rising engine speeds [rad/s]; linear between, constant beyond.

    The others are single numbers with unit and meaning on the field.
    """

    speeds: tuple[float, ...] = (0.0, 100.0, 400.0, 600.0, 680.0)
    torques: tuple[float, ...] = (180.0, 220.0, 230.0, 180.0, 0.0)
    drag: Annotated[float, SI("N m", "drag torque at closed throttle, when turning", 0.0, 1e4)] = 0.0
    drag_slope: Annotated[float, SI("N m s/rad", "drag torque with speed", 0.0, 100.0)] = 0.0
    idle: Annotated[float, SI("rad/s", "speed below which drag fades out", 1.0, 500.0)] = 80.0
    inertia: Annotated[float, SI("kg m2", "moment of inertia, engine and gearbox", 0.0, 100.0)] = 0.0
    lag: Annotated[float, SI("s", "time constant of torque; 0: none", 0.0, 5.0)] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_table("the engine's full-throttle torque", self.speeds, self.torques)

    def torque(self, throttle: Scalar, speed: Scalar) -> Scalar:
        """Torque [N m] that the engine settles to at its speed [rad/s], negative when the car rolls backwards.

        A ``throttle`` of -1 to 1; below zero the car drives backwards.
        """
        throttle = clip(throttle, -1.0, 1.0)
        full = table(fabs(speed), self.speeds, self.torques)
        drag = (self.drag + self.drag_slope * fabs(speed)) * clip(speed / self.idle, -1.0, 1.0)
        return throttle * full - (1.0 - fabs(throttle)) * drag


@dataclass(frozen=True, kw_only=True)
class Differential(ParameterSet):
    """Open by default; locking moves torque from the faster to the slower side."""

    preload: Annotated[float, SI("N m", "locking torque without load", 0.0, 1e5)] = 0.0
    locking: Annotated[float, SI("-", "locking torque over drive torque", 0.0, 1.0)] = 0.0
    viscosity: Annotated[float, SI("N m s/rad", "locking torque over speed difference", 0.0, 1e4)] = 0.0
    slip_speed: Annotated[float, SI("rad/s", "speed difference at which the clutches slide", 0.05, 50.0)] = 2.0

    @property
    def open(self) -> bool:
        """Whether it never locks."""
        return not (self.preload or self.locking or self.viscosity)

    def transfer(self, difference: Scalar, drive: Scalar) -> Scalar:
        """Torque taken from the first and given to the second side [N m], half of the locking torque.

        ``difference`` is the speed of the first minus that of the second side [rad/s], ``drive`` the torque through
        the differential [N m].
        """
        if self.open:
            return 0.0
        clutch = (self.preload + self.locking * fabs(drive)) * tanh(difference / self.slip_speed)
        return 0.5 * (clutch + self.viscosity * difference)


@dataclass(frozen=True, kw_only=True)
class Driveline(ParameterSet):
    """Engine, gearbox without a clutch, differentials.

    The gear is a state: one up when the engine turns faster than `shift_up`, one down below `shift_down`, at once and
    without losing torque. Below walking pace the engine turns slower than a real one idles; its torque there is that
    of the map's first point, as of a slipping clutch.

    Parameters
    ----------
    ratios : tuple of float
        Engine speed over propeller speed, first gear first.
    front, rear, centre : Differential
        Differentials; the centre one between the axles counts for all-wheel drive only.

    The others are single numbers with unit and meaning on the field.
    """

    engine: Engine = field(default_factory=Engine)
    ratios: tuple[float, ...] = (1.0,)
    final: Annotated[float, SI("-", "propeller speed over axle speed", 0.1, 50.0)] = 4.0
    shift_up: Annotated[float, SI("rad/s", "engine speed of shifting up", 1.0, 5000.0)] = 600.0
    shift_down: Annotated[float, SI("rad/s", "engine speed of shifting down", 0.0, 5000.0)] = 200.0
    front_share: Annotated[float, SI("-", "torque to the front axle; 1: front drive, 0: rear drive", 0.0, 1.0)] = 1.0
    front: Differential = field(default_factory=Differential)
    rear: Differential = field(default_factory=Differential)
    centre: Differential = field(default_factory=Differential)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.ratios or any(not b < a for a, b in pairwise(self.ratios)):
            raise ParameterError(f"the gear ratios are {self.ratios}; expected at least one, falling from the first")
        steps = [a / b for a, b in pairwise(self.ratios)]
        if steps and self.shift_up < max(steps) * self.shift_down * 1.02:
            raise ParameterError(
                f"shifting up at {self.shift_up:g} rad/s lands below the shift-down speed of {self.shift_down:g} "
                f"rad/s, since a gear step is {max(steps):.3g}; expected no hunting: lower shift_down below "
                f"{self.shift_up / max(steps) / 1.02:.4g} rad/s"
            )

    @property
    def shares(self) -> tuple[float, float, float, float]:
        """Share of the propeller torque that each wheel gets from open differentials; they sum to 1."""
        k = self.front_share
        return (0.5 * k, 0.5 * k, 0.5 * (1.0 - k), 0.5 * (1.0 - k))

    def ratio(self, gear: Scalar) -> Scalar:
        """Engine speed over axle speed in a gear, 1 being the first."""
        chosen = self.ratios[0]
        for k in range(1, len(self.ratios)):
            chosen = where(gear > k + 0.5, self.ratios[k], chosen)
        return chosen * self.final

    def engine_speed(self, spins: Sequence[Scalar], gear: Scalar) -> Scalar:
        """Engine speed from the spins of the four wheels. [rad/s]"""
        return self.ratio(gear) * sum(a * w for a, w in zip(self.shares, spins, strict=True) if a)

    def next_gear(self, gear: Scalar, speed: Scalar) -> Scalar:
        """Gear of the next sample, from the engine speed. [rad/s]"""
        size, most = fabs(speed), float(len(self.ratios))
        if most == 1.0:
            return gear
        up = where(size > self.shift_up, 1.0, 0.0)
        down = where(size < self.shift_down, 1.0, 0.0)
        return clip(gear + up - down, 1.0, most)

    def gear_at(self, axle_speed: float) -> int:
        """Lowest gear in which the engine stays below `shift_up` at an axle speed. [rad/s]"""
        for k, ratio in enumerate(self.ratios):
            if abs(axle_speed) * ratio * self.final <= self.shift_up:
                return k + 1
        return len(self.ratios)

    def wheel_torques(self, spins: Sequence[Scalar], engine_torque: Scalar, gear: Scalar) -> list[Scalar]:
        """Drive torque on each wheel without the engine's inertia. [N m]"""
        axle = self.ratio(gear) * engine_torque
        torques: list[Scalar] = [a * axle for a in self.shares]
        middle = self.centre.transfer(0.5 * (spins[0] + spins[1]) - 0.5 * (spins[2] + spins[3]), axle)
        for pair, differential, side, share in (
            ((0, 1), self.front, -0.5, self.front_share),
            ((2, 3), self.rear, 0.5, 1.0 - self.front_share),
        ):
            a, b = pair
            torque = differential.transfer(spins[a] - spins[b], share * axle)
            torques[a], torques[b] = torques[a] - torque, torques[b] + torque
            if 0.0 < self.front_share < 1.0 and not self.centre.open:
                torques[a], torques[b] = torques[a] + side * middle, torques[b] + side * middle
        return torques

    def spin_rates(self, torques: Sequence[Scalar], freedom: Sequence[Scalar], gear: Scalar) -> list[Scalar]:
        """Angular accelerations of the wheels, which the engine's inertia couples. [rad/s2]

        With torque shares a, diagonal inertias D and the engine's inertia J seen through the ratio, the wheels obey
        ``(D + J a a^T) spin' = torque``, solved by the Sherman-Morrison formula. ``freedom`` is the inverse of each
        wheel's inertia, 0 for a locked wheel. [1/(kg m2)]
        """
        rates = [t * f for t, f in zip(torques, freedom, strict=True)]
        if not self.engine.inertia:
            return rates
        ratio = self.ratio(gear)
        inertia = self.engine.inertia * ratio * ratio
        coupled = [(i, a) for i, a in enumerate(self.shares) if a]
        pull = inertia * sum(a * rates[i] for i, a in coupled)
        pull = pull / (1.0 + inertia * sum(a * a * freedom[i] for i, a in coupled))
        for i, a in coupled:
            rates[i] = rates[i] - a * freedom[i] * pull
        return rates


@dataclass(frozen=True, kw_only=True)
class Brakes(ParameterSet):
    """Hydraulic brakes: pedal to torque on both axles, with a lag."""

    torque: Annotated[float, SI("N m", "brake torque on all wheels together at full pedal", 0.0, 1e6)] = 8000.0
    bias: Annotated[float, SI("-", "share of the front axle", 0.0, 1.0)] = 0.6
    lag: Annotated[float, SI("s", "time constant of pressure; 0: none", 0.0, 2.0)] = 0.0

    def axles(self, pedal: Scalar) -> tuple[Scalar, Scalar]:
        """Torque on the front and on the rear axle that a pedal of 0 to 1 settles to. [N m]"""
        total = self.torque * clip(pedal, 0.0, 1.0)
        return self.bias * total, (1.0 - self.bias) * total


@dataclass(frozen=True, kw_only=True)
class Steering(ParameterSet):
    """From the commanded to the two road-wheel angles: limit, rate, lag, compliance, Ackermann."""

    limit: Annotated[float, SI("rad", "largest road-wheel angle", 0.01, 1.5)] = 0.7
    rate: Annotated[float, SI("rad/s", "largest rate, with a lag only; 0: none", 0.0, 100.0)] = 0.0
    lag: Annotated[float, SI("s", "time constant of the actuator; 0: none", 0.0, 2.0)] = 0.0
    ackermann: Annotated[float, SI("-", "1: wheels turn about one point; 0: parallel", -1.0, 2.0)] = 0.0
    compliance: Annotated[float, SI("rad/(N m)", "turn per kingpin moment of both wheels", 0.0, 1e-2)] = 0.0
    compliance_lag: Annotated[float, SI("s", "time constant of the compliance", 1e-3, 1.0)] = 0.01
    trail: Annotated[float, SI("m", "mechanical trail", -0.2, 0.2)] = 0.0

    def rate_of(self, angle: Scalar, command: Scalar) -> Scalar:
        """Rate of the road-wheel angle towards the command. [rad/s]"""
        if not self.lag:
            return 0.0 * angle
        wanted = (clip(command, -self.limit, self.limit) - angle) / self.lag
        return clip(wanted, -self.rate, self.rate) if self.rate else wanted

    def wheels(self, delta: Scalar, track: Scalar, wheelbase: Scalar) -> tuple[tuple[Scalar, Scalar], ...]:
        """Cosine and sine of the left and of the right road-wheel angle; cot(delta) is the mean of both cotangents."""
        slope = tan(delta)
        torques = []
        for side in (1.0, -1.0):
            t = slope / (1.0 - (side * 0.5 * self.ackermann) * track / wheelbase * slope) if self.ackermann else slope
            cosine = 1.0 / sqrt(1.0 + t * t)
            torques.append((cosine, t * cosine))
            if not self.ackermann:
                return torques[0], torques[0]
        return tuple(torques)


# ---- friction that opposes spin ------------------------------------------------------------------------------------


def friction_torque(direction: Scalar, other: Scalar, most: Scalar) -> tuple[Scalar, Scalar]:
    """Coulomb friction of brakes and rolling on a wheel: the torque [N m], and 1 where it holds the wheel, else 0.

    ``direction`` is the sign of the spin at the start of the step, ``other`` all other torque on the wheel [N m], and
    ``most`` the largest friction torque [N m].
    """
    turning = fabs(direction) > 0.5
    torque = where(turning, -direction * most, -clip(other, -most, most))
    held = where(turning, 0.0, where(fabs(other) > most, 0.0, 1.0))
    return torque, held


def stopped(before: Scalar, after: Scalar, change: Scalar) -> Scalar:
    """Spin after a step in which friction may have pushed past zero: then it is taken back, to zero at most.

    ``change`` is what friction alone changes in the step. [rad/s]
    """
    crossed = before * after < 0.0
    return where(crossed, sign(after) * maximum(fabs(after) - 2.0 * change, 0.0), after)
