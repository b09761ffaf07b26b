"""`try_on`: one controller on many cars that differ from its model, side by side; `Trials` is what came of it.

The nominal car is the identified bicycle as a dual track with saturating tires; how far others are from it says a
`Spread`. Whatever the number of cars in hand, each one's draw, noise and drive are the same: results are equal for
equal seeds, wherever they were computed.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slipangle.control.controller import Controller
from slipangle.control.driver import Driver
from slipangle.errors import ParameterError, SampleTimeError
from slipangle.models.fast import bind, evaluate
from slipangle.models.vehicles.parameters import BicycleParams
from slipangle.optimal.terms import Values, require_names
from slipangle.paths.path import Path
from slipangle.simulate.compiled import Crew
from slipangle.simulate.loop import FAR, Starts
from slipangle.simulate.perturbed import Fleet, Spread
from slipangle.simulate.run import SIDE
from slipangle.simulate.trials import COLUMNS, Trials

STEP = 0.001  # s, of the plant
EVERY = 10  # steps between samples of the record
AHEAD = ("v_x_dot",)  # what the path says of the time to come; until now it is zero, as nobody measures it
UNMOVED = ("delta_r", "M_z", "bank")  # inputs of a model that these cars have not, which they measure as zero


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """What is tried: a controller on a path, and the car around which others are drawn.

    Raises ParameterError if the controller needs what these cars do not measure, SampleTimeError if its step is no
    multiple of 10 ms.

    Parameters
    ----------
    controller, path : Controller or Driver, Path
        As of `closed_loop`; the path has a speed profile. A `Driver` on this path estimates from noisy measurements of
        X, Y, psi, v_x and its model's outputs, new at each of its steps.
    bicycle, friction
        The car as identified, and the friction coefficient at which its tires saturate.
    spread : Spread
        How far the others are from it.
    noise, delay, lag
        Standard deviation of the sensors' white noise by channel; dead time and time constant of the steering [s] as
        they are known.
    width : float
        Of the vehicle. [m]
    seed : int
        Of the draws and of the noise.
    built : AnyDriver, optional
        The same driver compiled, as `slipangle.export.load` loads it: it drives then, with the same results, several
        times as fast.
    """

    controller: Controller | Driver
    path: Path
    bicycle: BicycleParams
    friction: float = 1.0
    spread: Spread = field(default_factory=Spread)
    noise: Values = field(default_factory=Values)
    delay: float = 0.0
    lag: float = 0.0
    width: float = 1.8
    seed: int = 0
    built: Any = None

    def __post_init__(self) -> None:
        if self.built is not None and self.built.controls[0] != getattr(self.controller, "steering", None):
            raise ParameterError("the built driver is not the trial's; expected the driver of `controller`, built")
        model, controls = self.planner.model, tuple(self.planner.controls)
        seen = ("X", "Y", "psi", "v_x", "v_y", "r", "a_y")
        if controls != ("delta",):
            raise ParameterError(f"the controller decides {list(controls)}; expected delta alone: the speed is held")
        known = (*seen, *UNMOVED, *AHEAD)
        require_names((*model.outputs, *self.planner.exogenous), known, "the controller", "use what is measured")
        require_names(model.inputs, ("delta", "v_x", *UNMOVED, *AHEAD), "the controller's model", "use these inputs")
        require_names(self.noise, seen, "noise", "use what is measured")
        if self.path.v_x is None:
            raise ParameterError(f"'{self.path.name}' has no speed profile; expected one: use path.with_speed(20.0)")
        per_plan = self.planner.dt / (STEP * EVERY)
        if round(per_plan) < 1 or abs(per_plan - round(per_plan)) > 1e-6:
            raise SampleTimeError(f"the controller's step is {self.planner.dt:g} s; expected a multiple of 0.01 s")

    @property
    def without(self) -> tuple[str, ...]:
        """What the controller knows and these cars have not."""
        return tuple(n for n in UNMOVED if n in (*self.planner.model.inputs, *self.planner.exogenous))

    @property
    def planner(self) -> Any:
        """The controller, or that of a driver."""
        return self.controller.controller if isinstance(self.controller, Driver) else self.controller

    @property
    def steps(self) -> int:
        """Steps of the controller after which a car that has not reached the end of the path never will."""
        return int(np.ceil((1.3 * np.sum(self.path.spacing / _speeds(self.path.v_x)[:-1]) + 1.0) / self.planner.dt))

    def drivers(self, n: int) -> list[Driver]:
        """As many drivers as there are cars, each at its start; none where the controller is told the state."""
        made = [copy.copy(self.controller) for _ in range(n) if isinstance(self.controller, Driver)]
        for each in made:
            each.reset()
        return made


def _speeds(v_x: Any) -> np.ndarray:
    """Speeds along a path with a profile, none so near to rest that its end is never reached. [m/s]"""
    return np.maximum(v_x, min(0.5, 0.1 * float(np.max(v_x))) or 0.5)


def try_on(
    trial: Trial,
    numbers: Sequence[int],
    *,
    changes: np.ndarray | None = None,
    progress: Callable[[float], None] | None = None,
) -> Trials:
    """Drive the cars of these numbers side by side.

    Raises ConfigError without a compiler, ParameterError if the cars cannot be computed, see `Fleet`.

    Parameters
    ----------
    trial : Trial
        Controller, path and car.
    numbers : sequence of int
        Which cars; a number says what is drawn.
    changes : array, shape (n, 8), optional
        The changes in place of those that are drawn; the noise stays that of the numbers.
    progress : callable, optional
        Told the share of the time that is over.
    """
    drawn = trial.spread.draw(numbers, trial.seed) if changes is None else np.asarray(changes, dtype=float)
    race, steps = _Race(trial, list(numbers), drawn), trial.steps
    for k in range(steps):
        race.advance(k)
        if progress is not None:
            progress((k + 1) / steps)
        if race.over.all():
            break
    known = {"names": trial.spread.names, "without": trial.without}
    return Trials(**known, changes=drawn, results=race.results(), seconds=np.array(race.seconds))


def cause(trial: Trial, trials: Trials, numbers: Sequence[int], row: int) -> tuple[str, float]:
    """Which change alone, taken back to nominal, helps a car most, and by how much its margin grows then. [m]"""
    table = np.tile(trials.changes[row], (len(trials.names), 1))
    np.fill_diagonal(table, 0.0)
    again = try_on(trial, [numbers[row]] * len(table), changes=table)
    gain = np.minimum(again.column("margin"), FAR) - max(float(trials.column("margin")[row]), -FAR)
    best = int(np.argmax(gain))
    return trials.names[best], float(gain[best])


class _Race:
    """Cars and, for each, what its controller knows."""

    def __init__(self, trial: Trial, numbers: list[int], changes: np.ndarray) -> None:
        self.trial, self.controller, self.path = trial, trial.planner, trial.path
        self.fleet = Fleet(bicycle=trial.bicycle, friction=trial.friction, changes=changes)
        n, path, model = len(numbers), trial.path, trial.planner.model
        self.per_plan = round(self.controller.dt / STEP)
        self.x = self.fleet.straight(float(_speeds(path.v_x)[0]), *path.start)
        at = self.fleet.states.index
        self.pose = [at(name) for name in ("X", "Y", "psi", "v_x")]
        column = {name: changes[:, trial.spread.names.index(name)] for name in ("delay", "lag", "noise")}
        self.late = np.round((trial.delay + column["delay"]) / STEP).astype(int)
        lag = trial.lag + column["lag"]
        self.share = np.where(lag > 0, -np.expm1(-STEP / np.maximum(lag, 1e-9)), 1.0)
        self.actuator, self.past = np.zeros(n), np.zeros((int(self.late.max(initial=0)), n))
        still = (*trial.without, *(name for name in AHEAD if name in model.inputs))
        self.seen = tuple(dict.fromkeys(("X", "Y", "psi", "v_x", *model.outputs, *still)))
        self.given = {name: 0.0 for name in trial.without if name in self.controller.exogenous}
        self.a_y = np.zeros(n)  # m/s2, in the plant's last step
        self.noise = np.array([trial.noise.get(n, 0.0) for n in self.seen]) * (1 + column["noise"])[:, None]
        self.rngs = [np.random.default_rng([trial.seed, k, 1]) for k in numbers]
        self.known = np.tile(self._first(), (n, 1))
        self.inputs, self.s = np.zeros((n, model.n_inputs)), np.zeros(n)
        self.plans: list[Any] = [None] * n
        self.drivers = trial.drivers(n) if trial.built is None else []
        self.crew = None if trial.built is None else Crew(trial.built, n, self.seen)
        self.over, self.fallbacks = np.zeros(n, dtype=bool), np.zeros(n, dtype=int)
        self.record: list[np.ndarray] = [self.x[None][:, :, self.pose]]
        self.seconds: list[float] = []

    def _first(self) -> np.ndarray:
        true = dict(zip(self.fleet.states, self.x[0].tolist(), strict=True)) | {"delta": 0.0}
        if isinstance(self.controller, Starts):
            return np.asarray(self.controller.start(true))
        return np.array([true.get(name, 0.0) for name in self.controller.model.states])

    def advance(self, k: int) -> None:
        """Measure, plan and drive for one step of the controller."""
        with np.errstate(all="ignore"):
            draws = np.array([rng.standard_normal(len(self.seen)) for rng in self.rngs])
            now = dict(zip(self.fleet.states, self.x.T, strict=True)) | {"a_y": self.a_y}
            true = np.stack([now.get(name, np.zeros(len(self.x))) for name in self.seen], axis=1)
            measured = true + self.noise * draws
            if self.crew is not None:
                command = self._steered(k, *self.crew.step(k * self.controller.dt, measured, ~self.over))
            elif self.drivers:
                command = np.array([self._driven(i, k, measured[i]) for i in range(len(self.x))])
            else:
                self._estimate(k, measured)
                command = np.array([self._plan(i, measured[i]) for i in range(len(self.x))])
            self.inputs[:, list(self.controller.model.inputs).index("delta")] = command
            wanted = np.array([self.path.speed(s) for s in self.s])
            states = self.fleet.advance(self.x, self._acting(command), wanted)
            self.a_y = self._sideways(states)
        self.x = states[-1]
        self.record.append(states[EVERY - 1 :: EVERY, :, self.pose])
        off = ~np.isfinite(self.x).all(axis=1)
        self.x[off] = 0.0  # a car that left the finite numbers is over
        self.record[-1][:, off] = np.nan
        self.over |= off

    def _sideways(self, states: np.ndarray) -> np.ndarray:
        """Lateral acceleration of every car in the last step, shape (n,), of states (rows, n, n_states). [m/s2]"""
        v_y, v_x, r = (states[-2:, :, self.fleet.states.index(name)] for name in ("v_y", "v_x", "r"))
        return np.nan_to_num((v_y[1] - v_y[0]) / STEP + (v_x[1] * r[1]))

    def _estimate(self, k: int, measured: np.ndarray) -> None:
        """Bring what the controllers know of their models' states to now, as `closed_loop` does."""
        model = self.controller.model
        step, _, correct = model.functions
        if k:
            self.known = evaluate(step, self.known, self.inputs)
        for j, name in enumerate(model.inputs):
            if name != "delta":
                self.inputs[:, j] = measured[:, self.seen.index(name)]
        y = measured[:, [self.seen.index(name) for name in model.outputs]]
        arguments = [np.ascontiguousarray(a) for a in (self.known, self.inputs, y)]
        out = np.empty_like(self.known)
        bind(correct.map(len(y)), arguments, out)()
        self.known = out

    def _plan(self, i: int, measured: np.ndarray) -> float:
        """Steering angle of one car. [rad]"""
        before, controller = self.plans[i], self.controller
        if self.over[i]:
            return 0.0
        X, Y, _, v_x = measured[:4]
        self.s[i] = self.path.project(float(X), float(Y), float(self.s[i])).s
        if self.s[i] >= self.path.length or abs(float(self.x[i, self.pose[1]])) > 1e6:
            self.over[i] = True
        preview = self.path.ahead(float(self.s[i]), controller.times, v_x=float(v_x))
        plan = self.plans[i] = controller.plan(self.known[i], controller.reference(preview, **self.given), before)
        self.fallbacks[i] += plan.age > 0
        if before is not None:
            self.seconds.append(plan.seconds)
        return float(plan.command[0])

    def _driven(self, i: int, k: int, measured: np.ndarray) -> float:
        """Steering angle of one car by its driver. [rad]"""
        if self.over[i]:
            return 0.0
        said = self.drivers[i].step(dict(zip(self.seen, measured.tolist(), strict=True)), k * self.controller.dt)
        self.s[i] = said.s
        if said.s >= self.path.length or abs(float(self.x[i, self.pose[1]])) > 1e6:
            self.over[i] = True
        self.fallbacks[i] += said.fallback
        if k and said.plan is not None:
            self.seconds.append(said.plan.seconds)
        return float(said["delta"])

    def _steered(self, k: int, said: np.ndarray, seconds: np.ndarray) -> np.ndarray:
        """Steering angles that compiled drivers want, shape (n,). [rad]"""
        drives = ~self.over
        self.s[drives] = said["s"][drives]
        self.fallbacks[drives] += (said["planned"][drives] == 0) | (said["plan_age"][drives] > 0)
        if k:
            self.seconds.extend(seconds[drives & (said["planned"] != 0)].tolist())
        self.over |= (self.s >= self.path.length) | (np.abs(self.x[:, self.pose[1]]) > 1e6)
        return np.where(drives, said["value"][:, 0], 0.0)

    def _acting(self, command: np.ndarray) -> np.ndarray:
        """Steering angles at every millisecond, after delay and lag, shape (rows, n). [rad]"""
        rows, first = self.per_plan, len(self.past)
        commands = np.vstack([self.past, np.tile(command, (rows, 1))])
        when = first - self.late + np.arange(rows)[:, None]
        table = np.take_along_axis(commands, when, axis=0)
        for row in table:
            row[:] = self.actuator = self.actuator + self.share * (row - self.actuator)
        self.past = commands[rows:]
        return table

    def results(self) -> np.ndarray:
        """Rows of `Trials.results`."""
        track = np.concatenate(self.record).transpose(1, 0, 2)
        rows = []
        half, length = 0.5 * self.trial.width, self.path.length
        for i, drive in enumerate(track):
            whole = np.isfinite(drive).all(axis=1)
            drive = drive[: len(drive) if whole.all() else int(np.argmin(whole))]
            feet = self.path.project_all(drive[:, 0], drive[:, 1], 0.0)
            done = feet[:, 0] >= length
            last = int(np.argmax(done)) + 1 if done.any() else len(feet)
            lane, e_y = self.path.at(feet[:last, 0]), feet[:last, 1]
            left, right = (lane.left, lane.right) if lane.marked else (half + SIDE, half + SIDE)
            margin = min(float(np.min(left - e_y)), float(np.min(right + e_y))) - half
            finished = bool(done.any()) and np.abs(e_y).max() <= FAR
            rows.append([finished and margin >= 0, margin, np.abs(e_y).max(), finished, self.fallbacks[i]])
        return np.array(rows, dtype=float).reshape(len(rows), len(COLUMNS))
