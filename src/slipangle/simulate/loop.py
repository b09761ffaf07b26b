"""`closed_loop`: a plant, a controller and a path."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from slipangle.control.controller import Controller
from slipangle.control.speed.driver import DriverState, SpeedDriver
from slipangle.errors import ParameterError, SampleTimeError
from slipangle.estimate.ekf import EKF
from slipangle.estimate.observed import Observed
from slipangle.models.fast import bind
from slipangle.optimal.solution import Plan, quick
from slipangle.optimal.terms import Values, require_names
from slipangle.paths.path import Path
from slipangle.simulate.plant import Plant, Simulation
from slipangle.simulate.run import End, Run

FAR = 20.0  # m from the path: the drive is over
JUDGED = ("X", "Y", "psi", "v_x")
STOPPING = 5.0  # m/s2, deceleration of a plant whose speed is an input


@runtime_checkable
class Starts(Protocol):
    """A controller that knows its model's state at the start, such as one with lags."""

    def start(self, measured: Mapping[str, float]) -> np.ndarray:
        """State from the channels measured now, shape (n_states,)."""
        ...


def closed_loop(
    plant: Plant,
    controller: Controller,
    path: Path,
    *,
    duration: float | None = None,
    driver: SpeedDriver | None = None,
    estimator: EKF | None = None,
    held: Values | None = None,
    x0: np.ndarray | None = None,
    width: float = 1.8,
    sample: float = 0.01,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Drive along a path.

    The plant runs at its own step, the controller at its own, the speed driver at ``sample``. The state of
    the controller's model is predicted with `Model.step` and corrected with the measurements by
    `Model.correct`, or by an estimator, which then says where the car is too; the preview starts at the measured
    speed, or, for a controller that tracks the speed as a state of its model, at the profile's. Inputs of the plant
    come, in this order, from the controller, from the driver, from ``held``, and ``v_x`` from the path's speed profile.

    Raises ParameterError if a measurement or an input has no source, or the path has no speed profile, and
    SampleTimeError if the sample times do not divide each other.

    Parameters
    ----------
    plant, controller, path
        The plant measures at least X, Y, psi, v_x and the outputs of the controller's model; the path has a speed
        profile.
    duration : float, optional
        When to stop at the latest [s]; by default at the end of an open path, after one lap of a closed one.
    driver : SpeedDriver, optional
        Holds the speed of a plant whose speed is a state, unless the controller does.
    estimator : EKF or MHE, optional
        Knows the state of the controller's model from channels that are noisy, slow, late or missing; its sample time
        may be shorter than the controller's. The outputs of the controller's model need not be measured then.
    held : Values, optional
        Constant inputs that nobody else sets: of the plant, and those of the controller's model that the plant does not
        measure.
    x0 : array, shape (n_states,), optional
        Where the plant starts; by default straight ahead at the path's start and speed.
    width, sample : float
        Vehicle width, for `Run.inside` [m]; time between samples of the result and steps of the driver [s].
    progress : callable, optional
        Called with the fraction of the path that is done.
    """
    loop = _Loop(plant, controller, path, driver, estimator, held or Values(), sample)
    limit = _time_limit(path) if duration is None else duration
    if not limit > 0:
        raise ParameterError(f"the duration is {limit} s; expected a positive time")
    X, Y, psi = path.start
    start = plant.straight(loop.speed(0.0), X=X, Y=Y, psi=psi) if x0 is None else np.asarray(x0, dtype=float)
    simulation = loop.begin(start)
    end = None
    while end is None:
        loop.plan(simulation)
        if progress is not None:
            progress(min(max(loop.s / path.length, 0.0), 1.0))
        for _ in range(loop.per_plan):
            end = loop.record(simulation, limit, stop_at_end=duration is None or not path.closed)
            if end is not None:
                break
            loop.drive(simulation)
    return loop.result(end, width)


def _time_limit(path: Path) -> float:
    """Three times what the profile takes, for a vehicle that lost its speed."""
    if path.v_x is None:
        raise ParameterError(f"'{path.name}' has no speed profile; expected one: use path.with_speed(20.0)")
    return 3.0 * float(np.sum(path.spacing / np.maximum(path.v_x[:-1], 0.5))) + 5.0


@dataclass
class _Loop:
    """State of the drive between steps."""

    plant: Plant
    controller: Controller
    path: Path
    driver: SpeedDriver | None
    estimator: EKF | None
    held: Values
    sample: float
    s: float = 0.0
    tick: int = 0
    x: np.ndarray = field(default_factory=lambda: np.empty(0))
    model_inputs: np.ndarray = field(default_factory=lambda: np.empty(0))
    command: np.ndarray = field(default_factory=lambda: np.empty(0))
    driving: DriverState = field(default_factory=DriverState)
    wanted: tuple[float, float] = (0.0, 0.0)  # speed [m/s] and acceleration [m/s2]
    plans: list[Plan] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    calls: dict[str, tuple[list[np.ndarray], np.ndarray, Callable[[], None]]] = field(default_factory=dict)
    rows: list[list[float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.path.v_x is None:
            _time_limit(self.path)
        if self.driver is not None and not math.isclose(self.driver.dt, self.sample):
            self.driver = replace(self.driver, dt=self.sample)
        self.per_sample = _ratio(self.sample, self.plant.dt, "the sample time of the run", "the plant's")
        self.per_plan = _ratio(self.controller.dt, self.sample, "the controller's step", "the sample time of the run")
        model, plant = self.controller.model, self.plant
        self.observed = None
        if self.estimator is not None:
            self.per_estimate = _ratio(self.estimator.dt, self.sample, "the estimator's step", "that of the run")
            self.observed = Observed(self.estimator, self.controller.model, (*plant.channels, *self.held))
        self.constant = {n: v for n, v in self.held.items() if n not in plant.channels}
        needed = dict.fromkeys(("X", "Y", "psi", *model.outputs) if self.observed is None else ())
        needed |= dict.fromkeys(self.controller.exogenous)
        told = (*plant.channels, *self.constant, "v_x")
        require_names(needed, told, "the controller", "use a plant that measures it, see OnGround")
        require_names(("v_x",), plant.channels, "the loop", "use a plant that measures its speed")
        require_names(self.controller.controls, plant.model.inputs, "the controller", "use a plant with this input")
        settable = (*plant.model.inputs, *self.controller.exogenous)
        require_names(self.held, settable, "held", "use an input of the plant or of the controller's model")
        shares = self.driver.inputs(0.0) if self.driver is not None else {}
        require_names(shares, plant.model.inputs, "the driver", "share its output over inputs of the plant")
        self.place = {name: j for j, name in enumerate(plant.model.inputs)}
        known = (*plant.model.states, *plant.model.inputs)
        self.judged = [known.index(n) if n in known else None for n in JUDGED]
        self.base = np.zeros(plant.model.n_inputs)
        for j, name in enumerate(plant.model.inputs):
            if name in self.controller.controls or name in shares or name == "v_x":
                continue
            if name not in self.held:
                raise ParameterError(
                    f"nobody sets the plant's input '{name}'; expected a source: give driver=SpeedDriver(...), or "
                    f"held=Values({name}=0.0)"
                )
            self.base[j] = self.held[name]

    # ---- one step ----------------------------------------------------------------------------------------------

    def speed(self, s: float) -> float:
        """Wanted speed: the path's, or zero when the controller wants to stop. [m/s]"""
        if self.plans and self.plans[-1].stopping:
            return 0.0
        return self.path.speed(s)

    def begin(self, x: np.ndarray) -> Simulation:
        """Start the plant and the controller's model."""
        inputs = self.base.copy()
        names = self.plant.model.inputs
        if "v_x" in names:
            inputs[names.index("v_x")] = self.speed(0.0)
        self.command = inputs
        simulation = self.plant.start(x, inputs)
        true = simulation.true()
        self.s = self.path.project(true["X"], true["Y"]).s
        if self.observed is not None:
            self.x = self.observed.begin(true)
        elif isinstance(self.controller, Starts):
            self.x = self.controller.start(true)
        else:
            self.x = np.array([true.get(n, 0.0) for n in self.controller.model.states])
        return simulation

    def plan(self, simulation: Simulation) -> None:
        """Measure, estimate the state of the controller's model, plan."""
        controller, measured = self.controller, self.measure(simulation)
        model = controller.model
        inputs = self.estimate(measured)
        v_x = measured["v_x"] if math.isfinite(measured["v_x"]) else self.speed(self.s)
        here = measured if self.observed is None else self.observed.pose
        if all(math.isfinite(here[n]) for n in ("X", "Y")):
            self.s = self.path.project(here["X"], here["Y"], self.s).s
        decides = "v_x" in model.states and "v_x" in controller.references  # the speed that it wants is the profile's
        preview = self.path.ahead(self.s, controller.times, v_x=None if decides else v_x)
        exogenous = {n: measured[n] for n in controller.exogenous if n not in ("v_x", "v_x_dot")}  # these are ahead
        plan = controller.plan(
            self.x, controller.reference(preview, **exogenous), self.plans[-1] if self.plans else None
        )
        for name, value in zip(controller.controls, plan.command, strict=True):
            inputs[model.inputs.index(name)] = value
        self.model_inputs = inputs
        if self.observed is not None:
            self.observed.hold(dict(zip(controller.controls, plan.command.tolist(), strict=True)))
        self.plans.append(plan)
        self.times.append(self.tick * self.sample)
        wanted = self.speed(self.s)  # until the next plan
        slope = 0.0 if self.driver is None else (self.speed(self.s + 0.5) - self.speed(self.s - 0.5)) * wanted
        self.wanted = wanted, slope

    def measure(self, simulation: Simulation) -> dict[str, float]:
        """What the plant measures now, and what is held of the controller's model."""
        return {**self.constant, **simulation.measure()}

    def estimate(self, measured: Mapping[str, float]) -> np.ndarray:
        """Bring ``x`` to now; inputs of the controller's model now, those that it decides as applied before."""
        controller, model = self.controller, self.controller.model
        now = dict(measured)
        if self.plans:
            now.update(zip(controller.controls, self.plans[-1].command.tolist(), strict=True))
        inputs = np.array([now[n] for n in model.inputs])
        missing = np.isnan(inputs)
        if missing.any():  # the last ones known: one NaN would stay in the state for ever
            first = [self.speed(self.s) if n == "v_x" else 0.0 for n in model.inputs]
            inputs[missing] = (self.model_inputs if self.plans else np.array(first))[missing]
        if self.observed is not None:
            self.x = self.observed.take(now)
            return inputs
        y = np.array([measured[n] for n in model.outputs])
        step, _, correct = model.functions
        if self.plans:
            self.x = self._called(step, self.x, self.model_inputs)
        if np.isfinite(y).all() and np.isfinite(inputs).all():
            self.x = self._called(correct, self.x, inputs, y)
        return inputs

    def _called(self, function: Any, *given: np.ndarray) -> np.ndarray:
        """A function of the controller's model, shape (n_states,)."""
        name = function.name()
        if name not in self.calls:
            arrays, out = [np.empty(len(a)) for a in given], np.empty(len(self.x))
            self.calls[name] = arrays, out, bind(function, arrays, out)
        arrays, out, call = self.calls[name]
        for array, values in zip(arrays, given, strict=True):
            array[:] = values
        call()
        return out.copy()

    def drive(self, simulation: Simulation) -> None:
        """Set the plant's inputs and advance it by one sample."""
        at, u = self.place, self.base.copy()
        wanted, slope = self.wanted
        if self.driver is not None:
            output, self.driving = self.driver.step(self.driving, wanted, simulation.measure()["v_x"], slope)
            for name, value in self.driver.inputs(output).items():
                u[at[name]] = value
        if "v_x" in at:
            j, most = at["v_x"], STOPPING * self.sample
            change = wanted - self.command[j]
            u[j] = self.command[j] + (max(change, -most) if self.plans[-1].stopping else change)
        for name, value in zip(self.controller.controls, self.plans[-1].command, strict=True):
            u[at[name]] = value
        self.command = u
        simulation.advance(u, self.per_sample)
        self.tick += 1
        if self.observed is not None and self.tick % self.per_plan and self.tick % self.per_estimate == 0:
            self.estimate(self.measure(simulation))

    def record(self, simulation: Simulation, limit: float, *, stop_at_end: bool) -> End | None:
        """Note the state of the plant; why the drive is over, if it is."""
        state = simulation.state
        if not math.isfinite(sum(state[: self.plant.model.n_states])):
            return End.NOT_FINITE
        known = simulation.true() if None in self.judged else {}
        X, Y, psi, v_x = (known[n] if j is None else state[j] for n, j in zip(JUDGED, self.judged, strict=True))
        foot = self.path.project(X, Y, self.rows[-1][1] if self.rows else self.s)
        e_psi = math.remainder(psi - foot.psi, 2 * math.pi)
        row = [self.tick * self.sample, foot.s, foot.e_y, e_psi, v_x]
        self.rows.append(row + state)
        if abs(foot.e_y) > FAR:
            return End.LEFT_PATH
        if stop_at_end and foot.s >= self.path.length:
            return End.FINISHED
        return End.TIME if row[0] >= limit - 1e-9 else None

    def result(self, end: End, width: float) -> Run:
        """The drive so far."""
        model = self.plant.model
        table = np.array(self.rows).reshape(len(self.rows), 5 + model.n_states + model.n_inputs)
        signals = dict(zip(("t", "s", "e_y", "e_psi", "v_x"), table.T, strict=False))
        line = self.path.at(signals["s"])
        return Run(
            **signals,
            states=table[:, 5 : 5 + model.n_states],
            inputs=table[:, 5 + model.n_states :],
            state_names=tuple(model.states),
            input_names=tuple(model.inputs),
            path=self.path,
            reference=np.column_stack([line.X, line.Y, line.psi, line.v_x]),
            t_plan=np.array(self.times),
            plans=tuple(quick(type(p), {**vars(p), "memory": None}) for p in self.plans),
            controls=tuple(self.controller.controls),
            end=end,
            width=width,
        )


def _ratio(long: float, short: float, what: str, other: str) -> int:
    ratio = round(long / short)
    if ratio < 1 or not math.isclose(ratio * short, long, rel_tol=1e-6):
        raise SampleTimeError(
            f"{what} is {long:g} s, {other} is {short:g} s; expected a whole multiple: choose another of the two"
        )
    return ratio
