"""`Plant`: a model or a vehicle of any origin, run as the real one, with sensor noise, input delay and actuator lag."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from typing import Annotated, Any

import casadi as ca
import numpy as np

from slipangle.errors import ParameterError
from slipangle.fields import Checked, Within
from slipangle.models.fast import bind, evaluate
from slipangle.models.model import Model
from slipangle.optimal.terms import Values, require_names
from slipangle.simulate.foreign import Foreign, Held
from slipangle.simulate.sensors import Sensors, Stream


@dataclass(frozen=True)
class Plant(Checked):
    """The vehicle: any `Model`, run at its own sample time (usually a millisecond), or any `PlantProtocol`.

    Raises ParameterError if a name is not known, a number negative, or the vehicle is neither; it says what is missing.

    Parameters
    ----------
    model : Model or PlantProtocol
        Its states X, Y, psi (and v_x, as a state or input) are what a path controller needs; wrap a model
        that lacks them in ``OnGround``. Of anything else, what it measures stands where a model's states do; delay, lag
        and noise said here come on top of its own.
    noise : Values
        Standard deviation of white sensor noise by measured channel, SI units. Measured are all outputs,
        states and inputs of the model.
    delay : Values
        Dead time of inputs, rounded to the plant's sample time. [s]
    lag : Values
        Time constant of a first-order actuator before an input, after its delay. [s]
    sensors : Sensors
        Instruments of channels that are not simply true plus `noise`: sampling, delay, bias, quantisation, drop-outs.
    seed : int
        Of the noise; every channel has its own stream, so noise on one does not change another's.
    """

    model: Any
    _: KW_ONLY
    noise: Annotated[Values, Within(0)] = field(default_factory=Values)
    delay: Annotated[Values, Within(0)] = field(default_factory=Values)
    lag: Annotated[Values, Within(0)] = field(default_factory=Values)
    sensors: Sensors = field(default_factory=Sensors)
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.model, Model | Foreign):
            object.__setattr__(self, "model", Foreign(self.model))
        require_names(self.noise, self.channels, "noise", "use a state, output or input of the plant")
        require_names(self.sensors, self.channels, "sensors", "use a state, output or input of the plant")
        both = sorted(set(self.noise) & set(self.sensors))
        if both:
            raise ParameterError(f"noise and sensors both name {both}; expected one of them: put noise into the sensor")
        require_names(self.delay, self.model.inputs, "delay", "use an input of the plant")
        require_names(self.lag, self.model.inputs, "lag", "use an input of the plant")

    @property
    def dt(self) -> float:
        """Sample time. [s]"""
        return self.model.dt

    @property
    def channels(self) -> tuple[str, ...]:
        """Everything that is measured."""
        return tuple(dict.fromkeys((*self.model.states, *self.model.outputs, *self.model.inputs)))

    def straight(self, v_x: float, *, X: float = 0.0, Y: float = 0.0, psi: float = 0.0) -> np.ndarray:
        """State of straight driving at speed ``v_x`` [m/s] from a pose [m, m, rad]."""
        return np.asarray(self.model.straight(v_x, X=X, Y=Y, psi=psi), dtype=float)

    def start(self, x: np.ndarray, inputs: np.ndarray) -> Simulation:
        """A drive from state ``x``, with ``inputs`` held until now."""
        kind = ForeignSimulation if isinstance(self.model, Foreign) else Simulation
        return kind(self, np.asarray(x, dtype=float), np.asarray(inputs, dtype=float))

    @cached_property
    def _share(self) -> np.ndarray:
        """Share of the way to its command that each actuator moves in a step."""
        lag = np.array([self.lag.get(n, 0.0) for n in self.model.inputs])
        return np.where(lag > 0, -np.expm1(-self.dt / np.maximum(lag, 1e-12)), 1.0)

    @cached_property
    def _step(self) -> ca.Function:
        """``([x; a], u) -> [x; a]``, a being the actuators' positions."""
        model = self.model
        x, a, u = ca.MX.sym("x", model.n_states), ca.MX.sym("a", model.n_inputs), ca.MX.sym("u", model.n_inputs)
        moved = a + ca.DM(self._share) * (u - a)
        state = ca.vertcat(x, a)
        return ca.Function("plant", [state, u], [ca.densify(ca.vertcat(model.functions[0](x, moved), moved))])


def _draws(rng: np.random.Generator) -> Iterator[float]:
    """Standard normal numbers, one after another."""
    while True:
        yield from rng.standard_normal(256).tolist()


class Simulation:
    """A drive of a ``plant``: state, actuators and delayed commands, advanced in place.

    Raises ParameterError if the shapes of the first state and inputs are not (n_states,) and (n_inputs,), or if one of
    their numbers is not finite.
    """

    def __init__(self, plant: Plant, x: np.ndarray, inputs: np.ndarray) -> None:
        model = plant.model
        if x.shape != (model.n_states,) or inputs.shape != (model.n_inputs,):
            raise ParameterError(
                f"the plant starts from x of shape {x.shape} and inputs of shape {inputs.shape}; expected "
                f"({model.n_states},) for {list(model.states)} and ({model.n_inputs},) for {list(model.inputs)}"
            )
        for name, value in zip((*model.states, *model.inputs), (*x, *inputs), strict=True):
            if not math.isfinite(value):
                raise ParameterError(f"the plant starts from {name} = {value}; expected a finite number: give it one")
        self._plant = plant
        self._state = np.concatenate([self._begin(x), inputs])
        self._delay = [round(plant.delay.get(n, 0.0) / plant.dt) for n in model.inputs]
        self._lags = [(j, float(share)) for j, share in enumerate(plant._share) if share < 1.0]
        self._names = (*model.states, *model.inputs)
        self._computed = not set(model.outputs) <= set(model.states)  # outputs that are no states
        self._computed |= len(set(self._names)) < len(self._names)
        self._true: dict[str, float] | None = None  # every channel now, once somebody asked
        self._past = np.tile(inputs, (max(self._delay, default=0), 1))
        self._many: dict[int, tuple[Callable[[], None], np.ndarray, np.ndarray, np.ndarray]] = {}
        self._output: Callable[[], None] | None = None
        names = sorted(plant.channels)
        self._noise = [
            (n, std, _draws(np.random.default_rng([plant.seed, names.index(n)])))
            for n, std in plant.noise.items()
            if std > 0
        ]
        self._tick = 0
        self._streams: dict[str, Stream] = {}
        first = self.true() if plant.sensors else {}
        for name, sensor in plant.sensors.items():
            rng = np.random.default_rng([plant.seed, names.index(name)])
            self._streams[name] = Stream(sensor, plant.dt, rng, first[name])
            self._streams[name].feed(0, np.array([first[name]]))

    @property
    def x(self) -> np.ndarray:
        """State now, shape (n_states,)."""
        return self._state[: self._plant.model.n_states]

    @property
    def state(self) -> list[float]:
        """State and inputs now."""
        return self._state.tolist()

    @property
    def inputs(self) -> np.ndarray:
        """Inputs that act on the vehicle now, after delay and lag, shape (n_inputs,)."""
        return self._state[self._plant.model.n_states :]

    def advance(self, command: np.ndarray, steps: int) -> None:
        """Hold a command, shape (n_inputs,), for some steps of the plant."""
        first, held = len(self._past), np.asarray(command, dtype=float)
        table = np.empty((steps, len(held)))
        table[:] = held
        if first:
            commands = np.concatenate([self._past, table])
            for j, d in enumerate(self._delay):
                if d:
                    table[:, j] = commands[first - d : first - d + steps, j]
            self._past = commands[steps:]
        states = self._run(table)
        self._true = None
        self._sense(states)
        self._state = states[-1].copy()
        self._tick += steps

    def _begin(self, x: np.ndarray) -> np.ndarray:
        """State that the drive begins with."""
        return x

    def _lagged(self, table: np.ndarray) -> np.ndarray:
        """Where the actuators are after each step, in place of the commands that have reached them."""
        for j, share in self._lags:
            now, moved = float(self.inputs[j]), []
            for wanted in table[:, j].tolist():
                now += share * (wanted - now)
                moved.append(now)
            table[:, j] = moved
        return table

    def _run(self, table: np.ndarray) -> np.ndarray:
        """States and inputs after each step, shape (steps, n_states + n_inputs), from commands without their delay.

        Where no sensor looks, those after the last step may be all, shape (1, n_states + n_inputs).
        """
        kernel, steps = self._plant.model.steps, len(table)
        if kernel is not None:
            table = self._lagged(table)
            states, first = kernel.run(self.x, table), 1 if self._streams else steps  # without sensors the last will do
            return np.concatenate([states[first:], table[first - 1 :]], axis=1)
        if steps not in self._many:
            now, commands, after = np.empty_like(self._state), np.empty_like(table), np.empty((steps, len(self._state)))
            many = self._plant._step.mapaccum("many", steps, {"base": 4})
            self._many[steps] = bind(many, [now, commands], after), now, commands, after
        call, now, commands, after = self._many[steps]
        now[:], commands[:] = self._state, table
        call()
        return after.copy()

    def _sense(self, states: np.ndarray) -> None:
        """Let the sensors sample the steps after now, shape (steps, n_states + n_inputs)."""
        if not self._streams:
            return
        model = self._plant.model
        known = (*model.states, *model.inputs)
        wanted = [n for n in self._streams if n not in model.states and n in model.outputs]
        y = evaluate(model.functions[1], *np.hsplit(states, [model.n_states])) if wanted else np.empty((0, 0))
        for name, stream in self._streams.items():
            column = y[:, model.outputs.index(name)] if name in wanted else states[:, known.index(name)]
            stream.feed(self._tick + 1, column)

    def true(self) -> dict[str, float]:
        """Every channel now, without noise, by name."""
        if self._true is None:
            now = self._state.tolist()
            if self._computed:
                model = self._plant.model
                values = dict(zip(model.inputs, now[model.n_states :], strict=True))
                values.update(zip(model.outputs, self._outputs(), strict=True))
                values.update(zip(model.states, now[: model.n_states], strict=True))
            else:
                values = dict(zip(self._names, now, strict=True))
            self._true = values
        return self._true.copy()

    def _outputs(self) -> list[float]:
        """Outputs of the model now."""
        if self._output is None:
            model = self._plant.model
            self._arguments = np.empty(model.n_states), np.empty(model.n_inputs), np.empty(model.n_outputs)
            self._output = bind(model.functions[1], self._arguments[:2], self._arguments[2])
        self._arguments[0][:], self._arguments[1][:] = self.x, self.inputs
        self._output()
        return self._arguments[2].tolist()

    def measure(self) -> dict[str, float]:
        """Every channel now as the sensors see it, by name; each call draws new noise, sensors keep their sample."""
        values = self.true()
        for name, stream in self._streams.items():
            values[name] = stream.read(self._tick)
        for name, std, draws in self._noise:
            values[name] += std * next(draws)
        return values


class ForeignSimulation(Simulation):
    """A drive of a plant that is no model: its measurements are its state, the last known one while one is missing."""

    def _begin(self, x: np.ndarray) -> np.ndarray:
        model = self._plant.model
        self._held = Held(model, model.reset(x))
        return self._held.values

    def _run(self, table: np.ndarray) -> np.ndarray:
        table = self._lagged(table)
        seen = np.array([self._held.step(row) for row in table])
        return np.hstack([seen, table])

    def advance(self, command: np.ndarray, steps: int) -> None:
        """Hold a command for some steps of the plant.

        Raises SimulationError or ParameterError if the plant fails or answers with something else than numbers.
        """
        super().advance(command, steps)
        self._state[: len(self._held.values)] = self._held.values

    def _sense(self, states: np.ndarray) -> None:
        for name, stream in self._streams.items():
            known = (*self._plant.model.states, *self._plant.model.inputs)
            stream.feed(self._tick + 1, states[:, known.index(name)])

    def true(self) -> dict[str, float]:
        """What it measured last, and its inputs, by name."""
        model, now = self._plant.model, self._state.tolist()
        values = dict(zip(model.inputs, now[model.n_states :], strict=True))
        return values | dict(zip(model.states, now[: model.n_states], strict=True))

    def measure(self) -> dict[str, float]:
        """Every channel now, as `Simulation.measure`; NaN where the plant measured nothing."""
        values = super().measure()
        return values | dict.fromkeys((n for n in self._held.missing if n not in self._streams), math.nan)
