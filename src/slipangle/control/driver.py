"""`Driver`: from measurements to commands: an estimator, a controller, a path and a speed law in one object."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from slipangle.control.commands import HINDERED, STAY, UNSURE, Commands, require_time
from slipangle.control.default_drive import (
    DOUBTED,
    TRUSTED,
    UNKNOWN,
    default_controller,
    default_estimator,
    driven_model,
    less_trusting,
    require_told,
    size_of,
)
from slipangle.control.front_slip import grip_left
from slipangle.control.mpc import MPC
from slipangle.control.speed.driver import DriverState, SpeedDriver
from slipangle.control.targets import SteadyStates
from slipangle.control.watch import BESIDE, LOST, UNCERTAIN, Watch
from slipangle.errors import ParameterError, SimulationError
from slipangle.estimate.ekf import EKF
from slipangle.models.model import Model
from slipangle.models.wrappers.on_ground import POSE
from slipangle.optimal.checks import NUMBER, Plausible
from slipangle.optimal.solution import Plan
from slipangle.optimal.terms import require_names
from slipangle.paths.path import Path
from slipangle.paths.preview import Projection
from slipangle.shown import Brief

# For a road car; lengths scale with the wheelbase, speeds with its root.
SLOWEST = 1.5  # m/s, below which a lateral model does not describe the car
LONGEST_GAP = 1.0  # s between two calls, after which the estimator starts anew
JUMP, MOST = 2.0, 30.0  # m/s and m/s2 by which a measured speed may change at once and over time


class Driver(Brief):
    """Drives a car along a path from what its sensors say, complete when constructed.

    `step` takes measurements by name at any rate and at any time, some of them missing, slow or late, and returns
    commands. Inside, at every multiple of ``dt``, an estimator (`slipangle.estimate.ekf.EKF`) finds the state of the
    identified model and what pushes the car off it (`Disturbed`), and a controller plans on that same model: delay and
    lag of the steering are states of it, so they are compensated, a steering that answers later than was identified is
    noticed in the first bend (`Lagging`), and wind, bank, a wrong stiffness or a steering offset leave no steady error.
    A controller that does not count the course (``e_course``) is given headings at which the car, pushed as it is,
    moves along the path (`SteadyStates`). Defaults follow from the model alone, see `slipangle.control.default_drive`;
    the default controller trusts the model as far as it foretells what is measured (`less_trusting` there).

    The speed law gives up drive and brake where an axle of the identified model needs its force to the side
    (`slipangle.control.front_slip.grip_left`), so that a bend that is too fast is not lost under power.

    Slower than 1.5 m/s (times the root of the car's size: wheelbase over 2.7 m), which lateral models do not describe,
    the wheels stay where they are.

    Parameters
    ----------
    model : Model
        Lateral dynamics as identified, such as ``identify_car(...).model``; its inputs are the steering, the speed
        ``v_x`` and others that are measured.
    path : Path
        With a speed profile.
    speed : SpeedDriver, optional
        Holds the path's speed by its inputs; without one `Commands.wanted_v_x` is for whoever does.
    controller : Controller, optional
        By default an MPC on the estimator's model.
    estimator : EKF or MHE, optional
        Its model is the controller's. By default one for `noise` and `late`.
    noise : mapping of str to float
        Standard deviation of measured outputs, as of `EKF`, X, Y and psi among them, SI units.
    late : mapping of str to float
        How long after its instant an output arrives. [s]
    dt : float
        Time between plans [s]; a model that is no ODE brings its own.

    Raises
    ------
    ParameterError
        If the path has no speed profile, the models of controller and estimator are not the same, or the controller
        decides more than the steering or asks for parameters over its horizon.
    """

    _lists = ("path", "controller", "estimator", "speed", "dt")

    def __init__(
        self,
        model: Model,
        path: Path,
        *,
        speed: SpeedDriver | None = None,
        controller: Any = None,
        estimator: Any = None,
        noise: Mapping[str, float] | None = None,
        late: Mapping[str, float] | None = None,
        dt: float = 0.02,
    ) -> None:
        if path.v_x is None:
            raise ParameterError(f"'{path.name}' has no speed profile; expected one: use path.with_speed(20.0)")
        if estimator is not None:
            whole = estimator.model
        else:
            whole = controller.model if controller is not None else driven_model(model, dt)
        self.path, self.dt = path, float(whole.dt)
        self.estimator = estimator or default_estimator(whole, noise or {}, late or {})
        self.controller = controller or default_controller(whole, fastest=float(np.max(path.v_x)))
        if self.controller.model.states != whole.states or not math.isclose(self.controller.dt, self.dt):
            raise ParameterError(
                f"the controller plans every {self.controller.dt:g} s on {self.controller.model.n_states} states, the "
                f"estimator knows {whole.n_states} every {self.dt:g} s; expected the same model in both"
            )
        require_names(POSE, whole.states, "the driver", "use a model on the ground")
        require_told(self.controller)
        size = size_of(whole)
        self._slowest, self._jump, self._lost = SLOWEST * math.sqrt(size), JUMP * math.sqrt(size), UNCERTAIN * size
        self._size = size
        self.speed = None if speed is None else replace(speed, dt=self.dt)
        self.steering = self.controller.controls[0]
        self._targets = SteadyStates(whole, self.steering)
        counted = self.controller.ocp.tracked if isinstance(self.controller, MPC) else ()
        self._turns = "psi" in self.controller.references and not self.controller.steady and "e_course" not in counted
        self._default = controller is None
        self._trusts = self._default and isinstance(self.estimator, EKF)
        self._grip_left = None if speed is None else grip_left(whole, self.steering)
        self._model: Any = whole
        self._motion = [whole.states.index(name) for name in POSE]
        names = tuple(dict.fromkeys((*POSE, "v_x", *whole.outputs, *whole.inputs)))
        self._ranges = Plausible(names).by_name
        self._whole = Plausible(whole.states)
        self._steps = {name: round(self.estimator.late.get(name, 0.0) / self.dt) for name in whole.outputs}
        self.reset()

    @property
    def controls(self) -> tuple[str, ...]:
        """Names of its commands, the steering first."""
        law = {} if self.speed is None else self.speed.inputs(0.0)
        return tuple(dict.fromkeys((*self.controller.controls, *law)))

    def reset(self) -> None:
        """Forget the drive so far; the next call of `step` begins another."""
        self._tracker: Any = None
        self._t0, self._tick, self._now = 0.0, -1, 0.0
        self._raw: dict[str, float] = {}  # what each channel read last
        self._pending: dict[str, float] = {}  # outputs measured since the last sample of the estimator
        self._inputs = dict.fromkeys(self._model.inputs, 0.0)
        self._v_x, self._v_at, self._jumps = math.nan, 0.0, 0
        self._s, self._restarts = math.nan, 0
        self._seen: dict[str, float] = {}
        self._plan: Plan | None = None
        self._driving = DriverState()
        self._steered = 0.0
        self._last: Commands | None = None
        self._surprise = UNKNOWN
        self._watch = Watch(self.path, self._size, self._lost)

    def with_parts(self, *, speed: SpeedDriver | None = None, estimator: Any = None) -> Driver:
        """A driver at its start with this speed law, or none, and this estimator, by default the same one.

        Its controller stays, and how far that trusts the model.

        Raises ParameterError if the estimator's model is not the controller's.
        """
        parts = {"controller": self.controller, "estimator": estimator or self.estimator, "dt": self.dt}
        made = Driver(self.controller.model, self.path, speed=speed, **parts)
        made._trusts = self._default and isinstance(made.estimator, EKF)
        made._default = self._default
        return made

    def export(self, folder: str | FilePath, **settings: Any) -> FilePath:
        """Write the driver as C that runs without Python; see `slipangle.export.export`, also for its settings.

        Raises ParameterError if a part of it has no C, WriteError if the folder is not empty or cannot be written.
        """
        return import_module("slipangle.export").export(self, folder, **settings)  # a room above this one

    # ---- one step ----------------------------------------------------------------------------------------------

    def step(self, measurements: Mapping[str, float], t: float) -> Commands:
        """Take in what was measured and say what to do.

        Raises ParameterError if the time is not finite, beyond 1e10 s, or goes back; no measurement is an error.

        Parameters
        ----------
        measurements : mapping of str to float
            Channels that are new at this call, SI units: X, Y, psi, v_x, and outputs and inputs of the model. Missing
            ones, NaN, and what reads exactly as before are not new.
        t : float
            Time of the call. [s]

        Returns
        -------
        Commands
            Those of the last plan, if no new one is due.
        """
        t = require_time(t, None if self._last is None else self._now)
        if self._last is None:
            self._t0 = t
        self._now = t
        due = math.floor((t - self._t0) / self.dt + 0.25)
        self._gather(measurements, t, max(due, self._tick + (due == self._tick)))
        if due == self._tick and self._last is not None:
            return self._last
        behind = due - self._tick
        self._tick = due
        self._last = self._decide(self._observe(behind))
        return self._last

    def _gather(self, measurements: Mapping[str, float], t: float, tick: int) -> None:
        """Note new values; a pose is moved to the estimator's sample that it will count for."""
        for name, value in measurements.items():
            value = math.nan if value is None else float(value)
            same = self._raw.get(name) == value
            if not same and not self._believed(name, value, t):
                continue
            self._watch.note(name, t)
            if same:
                continue
            self._raw[name] = value
            if name == "v_x":
                self._v_x, self._v_at = value, t
            if name in self._inputs and name not in self.controller.controls:
                self._inputs[name] = value
            if name in self._model.outputs:
                at = self._t0 + (tick - self._steps[name]) * self.dt
                off = at - (t - self.estimator.late.get(name, 0.0))
                self._pending[name] = value + off * self._rate(name)

    def _believed(self, name: str, value: float, t: float) -> bool:
        """Whether a value is in the range of its channel; a speed also whether a car can have changed it so much."""
        low, high = self._ranges.get(name, (-NUMBER, NUMBER))
        if not low <= value <= high:
            return False
        if name != "v_x" or math.isnan(self._v_x):
            return True
        jump = abs(value - self._v_x) > self._jump + MOST * (t - self._v_at)
        self._jumps = self._jumps + 1 if jump else 0
        return not jump or self._jumps > self.estimator.patience

    def _rate(self, name: str) -> float:
        """How fast a part of the pose changes now; of other channels it is not known. [per s]"""
        if name not in POSE or self._tracker is None:
            return 0.0
        x = self._tracker.state
        later = np.asarray(self._model.functions[0](x, self._tracker.inputs).full()).ravel()
        i = self._model.states.index(name)
        return float(later[i] - x[i]) / self.dt

    def _observe(self, behind: int) -> str:
        """Bring the estimate to now, ``behind`` samples after the last; what hinders, empty if nothing does."""
        moving, begun = self._v_x if self._watch.speed_known(self._now) else math.nan, set[str]()
        here = (self._raw["X"], self._raw["Y"]) if {"X", "Y"} <= self._pending.keys() else None
        self._watch.move(self._now, self._v_x, behind * self.dt, here)
        heading = self._raw["psi"] if "psi" in self._pending else None
        self._watch.turn(self._now, self._raw.get("r", math.nan), behind * self.dt, heading)
        if self._tracker is not None and math.isnan(moving):
            moving = self._v_x  # it goes on with what it knows, and should stop
        if not moving >= self._slowest:
            self._tracker, self._plan = None, None
            self._pending.clear()
            if here:
                self._watch.see(self._now)
            return HINDERED[1] if math.isnan(moving) else HINDERED[2]
        if self._tracker is None or behind * self.dt > LONGEST_GAP:
            if not self._watch.pose_known(self._now):
                return HINDERED[3]
            self._begin()
            behind, begun = 1, self._pending.keys() & self.estimator.begun.keys()
        tracker: Any = self._tracker
        given = {**self._inputs, self.steering: self._steered}
        try:
            for _ in range(behind - 1):
                tracker.take(given)
            tracker.take({**given, **self._pending})
            if not self._whole.holds(tracker.state):
                raise SimulationError(f"the estimate is {tracker.state.tolist()[:4]}; expected plausible numbers")
        except SimulationError:
            self._restarts += 1
            self._begin()
            tracker = self._tracker
            tracker.take(given)
        for name, good in zip(self._model.outputs, tracker.taken, strict=True):
            if good or name in begun:
                self._seen[name] = self._now
        if self._seen.get("X") == self._seen.get("Y") == self._now:
            self._watch.see(self._now)
        if self._trusts and not math.isnan(surprise := tracker.surprise):
            self._surprise += self.dt / TRUSTED * (min(surprise, DOUBTED) - self._surprise)
        self._pending.clear()
        return ""

    def _begin(self) -> None:
        """Start the estimator where the last measurements say the car is."""
        self._tracker = self.estimator.begin({**self._raw, self.steering: self._steered})
        self._plan, self._s = None, math.nan

    def _decide(self, hindered: str) -> Commands:
        """Commands from the estimate now."""
        if hindered or self._tracker is None:
            return self._waiting(hindered)
        x, std = self._tracker.state, self._tracker.state_std
        X, Y, psi = (float(x[i]) for i in self._motion)
        foot = self._project(X, Y)
        plan = self._plan = self._planned(x)
        self._steered = float(plan.command[0])
        self._tracker.hold(dict(zip(self.controller.controls, plan.command.tolist(), strict=True)))
        at = foot.s, foot.e_y, math.remainder(psi - foot.psi, 2 * math.pi)
        reason = self._watch.reason(self._now, max(std[i] for i in self._motion[:2]), at)
        wanted = 0.0 if plan.stopping or 0 < reason < BESIDE else self.path.speed(self._s)
        message = UNSURE[reason - LOST] if reason else plan.message
        return self._commands(wanted, self._s, foot.e_y, (x, std), message)

    def _waiting(self, hindered: str) -> Commands:
        """Commands of a car that stands, creeps or does not know how it moves: by what was measured last."""
        place, reason = [self._raw.get(n, math.nan) for n in POSE], LOST
        if all(map(math.isfinite, place[:2])):
            foot = self._project(*place[:2])
            off = 0.0 if self._watch.pose_known(self._now) else math.inf
            at = foot.s, foot.e_y, math.remainder(place[2] - foot.psi, 2 * math.pi) if math.isfinite(place[2]) else 0.0
            reason = self._watch.reason(self._now, off, at)
        s = self._s if math.isfinite(self._s) else 0.0
        wanted = 0.0 if 0 < reason < BESIDE else self.path.speed(s)
        nothing = np.zeros(self._model.n_states)
        message = UNSURE[reason - LOST] if reason and hindered == HINDERED[2] else f"{hindered}, {STAY}"
        return self._commands(wanted, s, 0.0, (nothing, np.full_like(nothing, np.inf)), message)

    def _project(self, X: float, Y: float) -> Projection:
        """Find the place on the path."""
        near = self._s if math.isfinite(self._s) else None
        foot = self.path.project(float(X), float(Y), near)
        self._s = foot.s
        return foot

    def _planned(self, x: np.ndarray) -> Plan:
        preview = self.path.ahead(self._s, self.controller.times, v_x=self._v_x)
        ahead = {"v_x": preview.v_x, "v_x_dot": preview.v_x_dot(self.controller.times)}
        given = {n: ahead.get(n, self._inputs[n]) for n in self.controller.exogenous}
        reference = self.controller.reference(preview, **given)
        if self._turns:
            measured = [self._inputs[self._model.inputs[i]] for i in self._targets.measured]
            d = np.concatenate([x[list(self._targets.disturbances)], measured])
            v_y, _ = self._targets(self._v_x, preview.r, d)
            tracked = np.array(reference.tracked, dtype=float)
            slips = zip(v_y.tolist(), np.maximum(preview.v_x, self._slowest).tolist(), strict=True)
            tracked[:, self.controller.references.index("psi")] -= [math.atan2(a, b) for a, b in slips]
            reference = replace(reference, tracked=tracked)
        if self._trusts:
            reference = less_trusting(self.controller, reference, self._surprise)
        return self.controller.plan(x, reference, self._plan, applied=np.array([self._steered]))

    def _grip(self) -> float:
        """What the tires leave for driving and braking where the car is now; all of it where nothing is known. [-]"""
        if self._grip_left is None or self._tracker is None:
            return 1.0
        u = [{**self._inputs, self.steering: self._steered}[n] for n in self._model.inputs]
        return float(self._grip_left(self._tracker.state, u))

    def _commands(
        self, wanted: float, s: float, e_y: float, known: tuple[np.ndarray, np.ndarray], message: str
    ) -> Commands:
        values = {self.steering: self._steered}
        if self._plan is not None:
            values |= dict(zip(self.controller.controls, self._plan.command.tolist(), strict=True))
        if self.speed is not None:
            slope = (self.path.speed(s + 0.5) - self.path.speed(s - 0.5)) * wanted
            moving = abs(self._v_x) if wanted == 0 else self._v_x  # brakes stop a car that rolls back, too
            output, self._driving = self.speed.step(self._driving, wanted, moving, slope, grip=self._grip())
            values |= {n: v for n, v in self.speed.inputs(output).items() if n not in values}
        return Commands(
            values=values,
            wanted_v_x=wanted,
            plan=self._plan,
            message=message,
            s=s,
            e_y=e_y,
            state=known[0],
            state_std=known[1],
            age={name: self._now - at for name, at in self._seen.items()},
            restarts=self._restarts,
        )
