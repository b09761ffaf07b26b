"""`Racer`: drives a car round a track as fast as its tires allow, and faster as it learns what they hold."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path as FilePath
from typing import Any, Literal

import numpy as np

from slipangle.control.commands import HINDERED, STAY, UNSURE, Commands, require_time
from slipangle.control.racing.actuators import Actuators
from slipangle.control.racing.learning import Learned
from slipangle.control.racing.pedals import Pedals
from slipangle.control.racing.planner import Planner
from slipangle.control.racing.sectors import Sectors
from slipangle.control.racing.sensing import Sensing
from slipangle.errors import ParameterError, SolverError, shown
from slipangle.optimal.lap.car import LapCar
from slipangle.optimal.lap.course import course
from slipangle.optimal.lap.fastest_lap import fastest_lap, weights_of
from slipangle.optimal.lap.lap import Lap, require_lap_of
from slipangle.optimal.solution import Plan
from slipangle.paths.path import Path
from slipangle.shown import Brief

ALONG = 0.98  # of the longitudinal friction that a lap is planned with: no wheel locks for a wrong brake
DRIVEN, SHAKEN = 1.0, 0.25  # smoothness of laps that are to be driven, and below which plans along one may be lost
HOPED = 1.05  # of power and drive force: speeds that full throttle does not reach, a plan does not want
CHANGED = 0.02  # of grip, from which a new lap is planned; less than that is left to its sectors
BOLD = 0.985  # of the grip that is sure, which no corner is tried beyond
SPIN = 0.03  # by which driven wheels turn faster than they roll, where gears are told by the speed of the car
SETTLING = 0.3  # s of a car of usual size, over which accelerations that the model does not explain are smoothed
MARGIN, SAMPLE, DT = 0.15, 0.01, 0.05  # m, s, s of a car of usual size: kept from edges, between samples and plans
FINEST = 0.001  # s, that sample times are multiples of
NO_FORCE = 1e-4  # of the weight
SPINS, SHORT = 0.5, 0.8  # of what driven axles hold, from which full throttle may spin a wheel, and of that force then
STOP = 0.3  # of the weight, with which a car brakes that has no plan, or does not know where it is
CREEPING = 1.2  # times the slowest speed of a plan: no faster, it is braked to a standstill without one


def _multiple(wanted: float, of: float) -> float:
    """The multiple nearest to a time, at least one. [s]"""
    return max(round(wanted / of), 1) * of


class Racer(Brief):
    """Drives a fastest lap at the limit from noisy sensors, and plans a faster one after every lap.

    Inside, at every ``dt``, a model predictive controller over arc length (`slipangle.control.racing.planner.Planner`)
    decides steering and longitudinal force by the equations and limits of the lap's own car: slip angles, friction
    ellipses, drive and edges. A filter estimates the state, what the equations leave out, and the road's friction;
    what full throttle gives is learned by place. Where the car crosses the start line, every corner is tried a little
    faster within the grip that is sure by then (`slipangle.control.racing.learning.Learned`), and goes back to what was
    quickest or, where the car came near an edge, slower and further from it (`slipangle.control.racing.sectors`).
    Where the grip differs by more than 2 % from that of the lap, a new one is planned, which takes as long as a
    `fastest_lap`, a second or more: a car that cannot wait for it says ``between="sectors"``. That racer has C, see
    `export`.

    No glitch of a sensor is believed (`slipangle.control.racing.sensing.Sensing`): a value that no car reads is as good
    as missing, one that is far from what the filter expects is an outlier, and the rest counts. The filter goes on
    without them; the drive begins when a second pose agrees with the first. Where the position has become uncertain by
    more than 1 m for a full car, the racer brakes along its line by speed and yaw rate, until a pose is there again.

    It is a driver for `slipangle.simulate.drive.drive`, from a rolling start on the track.

    Parameters
    ----------
    car : LapCar
        As believed, such as ``sa.lap_car(model)``; the friction may be wrong by about ``grip_std``.
    track : Path
        Closed, with its edges.
    pedals : Pedals
        What throttle and brake do, such as ``Pedals.of(params)`` of a dual track.
    lap : Lap, optional
        The first lap to drive; by default the fastest for the grip that is sure, with ``smoothness=1``. Those after it
        are planned like it. One with less than a quarter of that is warned of.
    share : float
        Of the grip that is sure, which laps are planned with. [-]
    grip_std : float
        Standard deviation of the tires' friction over the believed one, at the start. [-]
    margin : float, optional
        Kept free between the car's side and the edges by plans; by default 0.15 m for a full car, in proportion to the
        wheelbase. [m]
    noise : mapping of str to float
        Standard deviation of X, Y, psi, v_x, r, a_x, a_y as measured, SI units; where not given 0.05 m, 0.005 rad,
        0.05 m/s, 0.005 rad/s, 0.2 m/s2 for a full car, for others as goes with their size.
    gate : float, optional
        Standard deviations from its prediction [-] beyond which a value is an outlier, as of `EKF`: of sound values one
        in 5e8 is. None believes all.
    patience : int
        After so many outliers of a channel in a row on one side it is believed, as of `EKF`.
    steering_lag : float
        Time constant of the steering, from the angle that is asked for to that of the road wheels, such as
        ``params.steering.lag`` of a dual track; up to 0.02 s it counts as none. [s]
    steering_delay : float
        Dead time of the steering before that, rounded to ``sample``: plans begin where the car will be by then, and
        pedals wait for as long. [s]
    sample, dt : float, optional
        Between calls of `step`, and between plans, a multiple of it; by default about 0.01 s and 0.05 s for a full car,
        for others as the root of the wheelbase. [s]
    horizon : int
        Plans ahead, each ``dt`` long.
    between : bool or str
        What changes at the start line: ``"sectors"``, how fast each corner is taken, which takes no time; True, where
        the grip differs too much for that, the lap too; False, nothing before a call of `learn`.

    Attributes
    ----------
    first, lap : Lap
        What the drive begins with, and what is driven now.
    learned : Learned
        What is known by now.
    sectors : Sectors
        How fast each corner is taken by now.
    sensing : Sensing
        The filter, and in its ``outliers`` how many values of each channel were not believed.

    Raises
    ------
    ParameterError
        If the track is open or has no edges, or a number is out of range.
    SolverError
        If there is no first lap.
    """

    controls = ("delta", "throttle", "brake")
    _lists = ("car", "track", "pedals", "share", "grip_std", "margin", "sample", "between")

    def __init__(
        self,
        car: LapCar,
        track: Path,
        pedals: Pedals,
        *,
        lap: Lap | None = None,
        share: float = 0.92,
        grip_std: float = 0.05,
        margin: float | None = None,
        noise: Mapping[str, float] | None = None,
        gate: float | None = 6.0,
        patience: int = 25,
        steering_lag: float = 0.0,
        steering_delay: float = 0.0,
        sample: float | None = None,
        dt: float | None = None,
        horizon: int = 40,
        between: bool | Literal["sectors"] = True,
    ) -> None:
        if not track.closed:
            raise ParameterError(f"'{track.name}' is open; expected a closed track to race on")
        late = ("steering_lag", steering_lag, 0.0, 1.0), ("steering_delay", steering_delay, 0.0, 0.5)
        for name, value, low, high in (("share", share, 0.3, 1.0), ("grip_std", grip_std, 0.0, 0.5), *late):
            if not low <= value <= high:
                raise ParameterError(f"{name} is {value:g}; expected {low:g} to {high:g}")
        if not (isinstance(between, bool) or between == "sectors"):
            raise ParameterError(f'between is {shown(between)}; expected True, False or "sectors"')
        size = float(car.size)
        margin = MARGIN * size if margin is None else margin
        if not all(value is None or 0.0 < value < math.inf for value in (sample, dt)):
            raise ParameterError(f"sample is {sample} s, dt {dt} s; expected times above zero, such as 0.01 and 0.05")
        sample = _multiple(SAMPLE * math.sqrt(size), FINEST) if sample is None else sample
        dt = _multiple(DT * math.sqrt(size), sample) if dt is None else dt
        if lap is not None:
            require_lap_of(track, lap, "the first lap")
            _warn_shaken(lap)
            course(track, lap.ends, room=0.5 * car.width + margin, tolerance=None)  # whether the car fits
        self._every, self._settling = round(dt / sample), SETTLING * math.sqrt(size)
        if self._every < 1 or not math.isclose(self._every * sample, dt, rel_tol=1e-6):
            raise ParameterError(f"dt is {dt:g} s, the sample time {sample:g} s; expected a whole multiple")
        if not isinstance(pedals, Pedals):
            raise ParameterError(f"pedals is {shown(pedals)}; expected Pedals: say Pedals.of(car)")
        self.car, self.track, self.pedals = car, track, pedals
        self._spins = SPINS * _held(car)
        self.share, self.grip_std, self.margin, self.sample, self.between = share, grip_std, margin, sample, between
        self._planner = Planner(car, track, pedals, dt=dt, horizon=horizon, steering_lag=steering_lag)
        self._late = {"delay": steering_delay, "lag": self._planner.lag}
        self.sensing = Sensing(car, grip_std=grip_std, noise=noise or {}, gate=gate, patience=patience, sample=sample)
        self.learned = Learned(track.length, grip_std, size)
        if lap is None:
            lap = self._plan_lap(self._sure(), None)
        self.first = lap
        self.reset()

    @property
    def path(self) -> Path:
        """The track with the lap's speeds."""
        lap, length = self.lap, self.track.length
        return self.track.with_speed(np.interp(self.track.s, lap.s, lap.v_x, period=length))

    def reset(self) -> None:
        """Forget the drive so far, and what was learned; the next call of `step` begins another."""
        self.learned = Learned(self.track.length, self.grip_std, float(self.car.size))
        self._follow(self.first)
        self.sensing.reset()
        self._plan: Plan | None = None
        self._tick, self._now, self._turns, self._s, self._begun = -1, 0.0, 0, math.nan, math.nan
        self._actuators = Actuators(self.car, self.pedals, sample=self.sample, **self._late)
        self._gear = 1
        self._beyond = {"d_v_x": 0.0, "d_r": 0.0}

    def export(self, folder: str | FilePath, **settings: Any) -> FilePath:
        """Write the racer as C that runs without Python; see `slipangle.export.export`, also for its settings.

        It begins as after `reset`, on the first lap. Raises ParameterError unless ``between`` leaves the lap as it is,
        WriteError if the folder is not empty or cannot be written.
        """
        return import_module("slipangle.export").export(self, folder, **settings)  # a room above this one

    def learn(self, *, plan: bool = True) -> None:
        """Say how the next lap is driven by what is known by now.

        Corners are tried faster or slower one by one; where the grip differs too much for that and ``plan`` says so, a
        new lap is planned like the one before. If there is none, that is driven on.
        """
        self.learned.end_lap()
        car, now = self._sure(), self.lap.car
        asked = BOLD * self.learned.sure * self.car.mu_f / now.mu_f
        self.sectors.end_lap(0.5 * (asked - 1.0))
        if plan and abs(car.mu_f / now.mu_f - 1.0) > CHANGED:
            with suppress(SolverError):
                self._follow(self._plan_lap(car, self.lap))
        self.learned.begin_lap()

    def _follow(self, lap: Lap) -> None:
        self.lap, self.sectors = lap, Sectors(lap, self.margin)
        self._planner.follow(lap, 0.5 * self.car.width + self.margin, self.sectors)

    def _plan_lap(self, car: LapCar, before: Lap | None) -> Lap:
        """The fastest lap of a car, slow enough where the gearbox has to shift down."""
        lap = before or fastest_lap(car, self.track, margin=self.margin, smoothness=DRIVEN)
        box = self.pedals.gearbox
        slow = np.full(len(lap.s), np.inf) if box is None else box.slow_enough(lap.v_x)
        if before is None and np.all(lap.v_x <= slow):
            return lap
        any_force = np.full(len(lap.s), np.inf)
        return fastest_lap(car, self.track, margin=self.margin, like=lap, allowed=lambda s: (any_force, slow))

    def _sure(self) -> LapCar:
        """The car for a lap."""
        sure = self.learned.car(self.car, self.share)
        return replace(sure, mu_x=ALONG * sure.mu_x, power=HOPED * sure.power, drive_force=HOPED * sure.drive_force)

    # ---- one step ----------------------------------------------------------------------------------------------

    def step(self, measurements: Mapping[str, float], t: float) -> Commands:
        """Take in what was measured and say what to do.

        Raises ParameterError if the time is not finite, beyond 1e10 s, or goes back; no measurement is an error. The
        next call is then as if there had been none.

        Parameters
        ----------
        measurements : mapping of str to float
            X, Y, psi, v_x, r, a_x, a_y, SI units; missing ones and NaN are not measured now.
        t : float
            Time of the call, ``sample`` after the one before: each call is one sample of the filter, however long it
            took. [s]

        Returns
        -------
        Commands
            Steering angle of the road wheels [rad], throttle and brake. [0 to 1]
        """
        self._now = require_time(t, None if self._tick < 0 else self._now)
        self._tick += 1
        acting = self._actuators
        if not self.sensing.take(measurements, {"delta": acting.steered, "F_x": acting.force}, self._now):
            self._plan = None
            return self._waiting()
        x, (grip, grip_std) = self.sensing.known.state, self.sensing.grip
        s, e_y, heading = self.track.project(float(x[0]), float(x[1]), None if math.isnan(self._s) else self._s)
        spin = SPIN if acting.driving > 0.0 else 0.0
        self._s, self._gear = s, int(self._gears((1.0 + spin) * x[3:4])[0])
        for name, value in zip(self._beyond, x[6:8].tolist(), strict=True):
            self._beyond[name] += self.sample / self._settling * (value - self._beyond[name])
        lost = self.sensing.lost
        self.sectors.see(s, self._now, math.inf if lost else self._beside(s, e_y))
        self._count_laps(s)
        if self._plan is None or self._tick % self._every == 0:
            chi, here = math.remainder(float(x[2]) - heading, 2 * math.pi), self.learned.here(grip)
            delta, F = acting.heard
            state = np.array([e_y, chi, x[3], x[4], x[5], acting.steered, acting.force, F, delta])
            state, then = self._planner.ahead(state, s, acting.coming, self.sample, here, self._beyond)
            self._plan = self._planner.plan(
                state, then, here, self._most, self._beyond, self._plan, brake=STOP if lost else None
            )
        stopping = self._plan.stopping or (lost and float(x[3]) <= CREEPING * self._planner.slowest)
        values = self._act(self._plan, x, (grip, grip_std), stopping)
        return Commands(
            values=values,
            wanted_v_x=0.0 if lost or self._plan.stopping else float(self._planner.at(np.array([s]))[0, 2]),
            plan=self._plan,
            message=UNSURE[0] if lost else self._plan.message,
            s=s,
            e_y=e_y,
            state=x,
            state_std=self.sensing.known.state_std,
            age=self.sensing.age(self._now),
            restarts=self.sensing.restarts,
        )

    def _count_laps(self, s: float) -> None:
        length = self.track.length
        if math.isnan(self._begun):
            self._begun, self._turns = s, math.floor(s / length)
        turns = math.floor(s / length)
        if turns > self._turns and s - self._begun > 0.5 * length and self.between:
            self.learn(plan=self.between is True)
        self._turns = max(turns, self._turns)

    def _beside(self, s: float, e_y: float) -> float:
        """Room between the car's side and the nearer edge. [m]"""
        lane = self.track.at(np.array([s]))
        return float(min(lane.left[0] - e_y, lane.right[0] + e_y)) - 0.5 * self.car.width

    def _gears(self, v_x: np.ndarray) -> np.ndarray:
        """Gears at speeds that follow each other, shape (n,), from the one that the car is in on. [m/s]"""
        box = self.pedals.gearbox
        return np.ones(len(v_x), dtype=int) if box is None else box.along(v_x, self._gear)

    def _most(self, s: np.ndarray, v_x: np.ndarray) -> np.ndarray:
        """Force at full throttle at places ahead [m] and the speeds there, shape (n,). [m/s]"""
        return self.learned.most(s, self.pedals.most(v_x, self._gears(v_x)))

    def _act(self, plan: Plan, x: np.ndarray, grip: tuple[float, float], stopping: bool) -> dict[str, float]:
        """Commands of a sample, and what the car does with them.

        A wheel that spins, inside a bend and behind it, takes force away. Learned as the engine's, that would open the
        throttle further there on every lap, so it does not count.
        """
        car, dt, acting, v_x = self.car, self.sample, self._actuators, float(x[3])
        turn, rise = (float(v) for v in plan.command)
        if stopping:
            turn = 0.0
            rise = min(max((-STOP * car.weight - acting.asked[1]) / dt, -car.force_rate * car.weight), 0.0)
        believed = float(self.pedals.most(v_x, self._gear))
        most = float(self.learned.most(self._s, believed))
        throttle, brake = acting.ask(turn, rise, v_x, most, self._gear)
        force = acting.force + car.mass * float(x[6])
        share = force / max(believed, NO_FORCE * car.weight)
        spinning = believed > self._spins and share < SHORT
        self.learned.see(self._s, share, 0.0 if spinning else throttle, grip, dt)
        return {"delta": acting.asked[0], "throttle": throttle, "brake": brake}

    def _waiting(self) -> Commands:
        """Before the first pose."""
        nothing = np.zeros(self.sensing.filter.model.n_states)
        values = {"delta": self._actuators.asked[0], "throttle": 0.0, "brake": 0.0}
        message = f"{HINDERED[3]}, {STAY}"
        more: dict[str, Any] = {"state": nothing, "state_std": np.full_like(nothing, np.inf)}
        return Commands(values=values, wanted_v_x=0.0, message=message, restarts=self.sensing.restarts, **more)


def _held(car: LapCar) -> float:
    """Driving force that the axles hold, each with its share, at the loads of a car at rest. [N]"""
    axles = (1.0 - car.drive_rear, car.mu_f * car.l_r), (car.drive_rear, car.mu_r * car.l_f)
    return float(min(car.mu_x * car.weight / car.wheelbase * holds / share for share, holds in axles if share > 0.0))


def _warn_shaken(lap: Lap) -> None:
    """Warn of a lap whose rates cost so little that it leaves the planner nothing to correct with."""
    smoothness = float(np.min(lap.weights / weights_of(lap.car, 1.0)))
    if smoothness < SHAKEN:
        warnings.warn(
            f"the first lap was planned with a smoothness of {smoothness:.2g} and leaves nothing to correct with; "
            f"expected {DRIVEN:g} for a lap that is to be driven: sa.fastest_lap(..., smoothness={DRIVEN:g})",
            stacklevel=3,
        )
