"""`PlantProtocol`: what a vehicle of any origin needs to be driven here; `PlantFunctions` makes one of functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from slipangle.errors import NotFiniteError, ParameterError, SimulationError, shown
from slipangle.shown import Brief

Channels = Mapping[str, float]
KNOWN = ("X", "Y", "psi", "v_x")  # what `reset` is told
LONGEST_BLIND = 2.0  # s without a position after which nobody can say where the vehicle is


@runtime_checkable
class PlantProtocol(Protocol):
    """A vehicle, a simulator or a test rig: anything with a rate, names, `reset` and `step`.

    Channels are SI and ISO 8855 as everywhere here (docs/nomenclature.md); whatever the other side calls them, the
    names say what they are: a closed loop needs the outputs X, Y, psi and v_x, and the inputs that somebody sets.

    Attributes
    ----------
    dt : float
        Time that one `step` takes. [s]
    inputs, outputs : tuple of str
        Names of the commands, and of the measurements.
    """

    dt: float
    inputs: Sequence[str]
    outputs: Sequence[str]

    def reset(self, start: Channels) -> Channels:
        """Go to a pose, straight ahead at a speed: X, Y [m], psi [rad], v_x [m/s]; return every measurement there."""
        ...

    def step(self, commands: Channels) -> Channels:
        """Hold all commands for ``dt``; return what is measured then: a channel left out, None or NaN is missing."""
        ...


@dataclass(frozen=True, kw_only=True)
class PlantFunctions(Brief):
    """A `PlantProtocol` of plain functions.

    Parameters
    ----------
    step, reset : callable
        See `PlantProtocol`.
    dt : float
        Time that one step takes. [s]
    inputs, outputs : sequence of str
        Names of commands and measurements.

    >>> car = {"X": 0.0, "Y": 0.0, "psi": 0.0, "v_x": 0.0}
    >>> def step(commands):
    ...     car["X"] += 0.01 * car["v_x"]
    ...     return car
    >>> def reset(start):
    ...     car.update(start)
    ...     return car
    >>> plant = PlantFunctions(step=step, reset=reset, dt=0.01, inputs=("delta",), outputs=("X", "Y", "psi", "v_x"))
    >>> require_plant(plant)
    """

    step: Callable[[Channels], Channels]
    reset: Callable[[Channels], Channels]
    dt: float
    inputs: Sequence[str]
    outputs: Sequence[str]


def require_plant(thing: Any) -> None:
    """Raise unless a thing is a `PlantProtocol`.

    Raises ParameterError that says what it lacks.
    """
    kind = thing.__name__ if isinstance(thing, type) else type(thing).__name__
    if isinstance(thing, type):
        raise ParameterError(f"the plant is the class {kind[:60]}; expected an object of it: write {kind[:60]}(...)")
    lacking = [n for n in ("dt", "inputs", "outputs") if not hasattr(thing, n)]
    lacking += [f"{n}()" for n in ("reset", "step") if not callable(getattr(thing, n, None))]
    if lacking:
        what = (
            f"the function {getattr(thing, '__name__', kind)[:60]}" if len(lacking) == 5 and callable(thing) else kind
        )
        raise ParameterError(
            f"the plant is {what[:80]}, which lacks {', '.join(lacking)}; expected a Model, or dt [s], names of inputs "
            "and outputs, reset(start) and step(commands): add these, or say them in PlantFunctions(...)"
        )
    if not (isinstance(thing.dt, int | float) and 0 < thing.dt < math.inf):
        raise ParameterError(f"dt of the plant {kind[:60]} is {shown(thing.dt)}; expected the seconds of one step")
    for what in ("inputs", "outputs"):
        names = getattr(thing, what)
        good = isinstance(names, list | tuple) and len(names) > 0 and all(isinstance(n, str) and n for n in names)
        if not good or len(set(names)) < len(names):
            raise ParameterError(
                f"{what} of the plant {kind[:60]} are {shown(names)}; expected a tuple of different names"
            )


class Foreign:
    """A `PlantProtocol` with the names that a plant's model has: its measurements stand where states do."""

    steps = None

    def __init__(self, system: PlantProtocol) -> None:
        require_plant(system)
        self.system, self.dt = system, float(system.dt)
        self.inputs, self.states = tuple(system.inputs), tuple(system.outputs)
        self.outputs = self.states
        self.n_inputs, self.n_states = len(self.inputs), len(self.states)

    def __repr__(self) -> str:
        return f"Foreign({type(self.system).__name__})"

    def straight(self, v_x: float, *, X: float = 0.0, Y: float = 0.0, psi: float = 0.0) -> np.ndarray:
        """Measurements of straight driving, as far as they are known; the others are zero."""
        known = {"v_x": v_x, "X": X, "Y": Y, "psi": psi}
        return np.array([known.get(name, 0.0) for name in self.states])

    def reset(self, x: np.ndarray) -> np.ndarray:
        """Measurements after a reset to a pose, shape (n_states,).

        Raises NotFiniteError if one is missing, SimulationError if the other side fails.
        """
        start = {n: float(v) for n, v in zip(self.states, x, strict=True) if n in KNOWN}
        values = self._asked("reset", start)
        missing = [n for n, v in zip(self.states, values, strict=True) if not math.isfinite(v)]
        if missing:
            raise NotFiniteError(
                f"the plant {self._name} answers reset without a number for {shown(missing)}; expected every output "
                "once, so that there is something to hold while it is missing later"
            )
        return values

    def step(self, commands: np.ndarray) -> np.ndarray:
        """Measurements one step later, shape (n_states,); NaN where one is missing. Raises as `reset`."""
        return self._asked("step", dict(zip(self.inputs, commands.tolist(), strict=True)))

    @property
    def _name(self) -> str:
        return type(self.system).__name__[:60]

    def _asked(self, what: str, given: Channels) -> np.ndarray:
        try:
            answer = getattr(self.system, what)(given)
        except Exception as error:  # of code that is not ours
            raise SimulationError(
                f"the plant {self._name} failed in {what}(): {type(error).__name__}: {str(error)[:200]}; expected the "
                "measurements: correct it there"
            ) from error
        if not isinstance(answer, Mapping):
            raise ParameterError(
                f"{what}() of the plant {self._name} returned {shown(answer)}; expected a dict of measurements by name"
            )
        try:
            got = (answer.get(name) for name in self.states)
            return np.array([math.nan if value is None else float(value) for value in got])
        except (TypeError, ValueError):
            raise ParameterError(
                f"{what}() of the plant {self._name} returned {shown(dict(answer))}; expected a number, None or NaN "
                f"for each of {shown(list(self.states))}"
            ) from None


class Held:
    """Measurements of a foreign plant, of which the last one known is held while one is missing."""

    def __init__(self, plant: Foreign, first: np.ndarray) -> None:
        self.plant, self.values = plant, first
        self.missing: tuple[str, ...] = ()
        self._blind = 0

    def step(self, commands: np.ndarray) -> np.ndarray:
        """Measurements one step later, NaN where missing; `values` hold the last ones known."""
        seen = self.plant.step(commands)
        gone = np.isnan(seen)
        self.missing = tuple(n for n, bad in zip(self.plant.states, gone, strict=True) if bad)
        self.values = np.where(gone, self.values, seen)
        self._blind = self._blind + 1 if {"X", "Y"} & set(self.missing) else 0
        if self._blind * self.plant.dt > LONGEST_BLIND:
            self.values = np.full_like(self.values, math.nan)
        return seen
