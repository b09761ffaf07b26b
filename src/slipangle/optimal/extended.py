"""Models with more states and inputs, as problems that are put together from others need them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.models.model import Model, derived
from slipangle.models.ode import OdeModel
from slipangle.ops import Scalar, Vector, concatenate, stack


def before(name: str) -> str:
    """Name of the state that has an input as it was over the step before."""
    return f"@before {name}"


@dataclass(frozen=True, kw_only=True)
class Extension:
    """What is added to a model.

    Parameters
    ----------
    varied : tuple of str
        Parameters of the model that become inputs.
    constant : tuple of str
        Names of further states, which stay as they are.
    free : tuple of str
        Which of these are parameters of the model.
    span : float, optional
        Value of the constant ``duration`` at which steps are as long as the model's. [s]
    held : tuple of (str, str)
        An input of the model that is kept in a state of its own, and the input that is 1 while it is kept, else 0.
    before : tuple of str
        Inputs of an ODE whose value over the step before is a state of its own.
    """

    varied: tuple[str, ...] = ()
    constant: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    span: float | None = None
    held: tuple[tuple[str, str], ...] = ()
    before: tuple[str, ...] = ()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states that are added: constants, inputs that are held, then inputs of the step before."""
        return (*self.constant, *(f"{name}{when}" for name, when in self.held), *map(before, self.before))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs that are added: parameters, then when inputs are kept."""
        return (*self.varied, *dict.fromkeys(when for _, when in self.held))

    def of(self, model: Model, x: Vector, name: str) -> Scalar:
        """A constant by name."""
        return x[model.n_states + self.constant.index(name)]

    def values(self, model: Model, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Parameters of the model that are states or inputs, by name."""
        given: dict[str, Scalar] = {n: self.of(model, x, n) for n in self.free}
        given.update({n: u[model.n_inputs + i] for i, n in enumerate(self.varied)})
        return given

    def inside(self, model: Any, x: Vector, u: Vector) -> tuple[Any, Vector, Vector]:
        """The model with these values, its state and its inputs."""
        given = self.values(model, x, u)
        return model.with_values(**given) if given else model, x[: model.n_states], u[: model.n_inputs]

    def kept(self, model: Model, u: Vector) -> list[Scalar]:
        """How each held input changes the state that it is kept in, which begins with zero."""
        names = self.inputs
        return [u[model.inputs.index(n)] * u[model.n_inputs + names.index(when)] for n, when in self.held]


@dataclass(frozen=True, kw_only=True)
class ExtendedOde(OdeModel):
    """An ODE with an `Extension`."""

    base: OdeModel
    extension: Extension

    def __post_init__(self) -> None:
        object.__setattr__(self, "states", (*self.base.states, *self.extension.states))
        object.__setattr__(self, "inputs", (*self.base.inputs, *self.extension.inputs))

    @classmethod
    def of(cls, base: OdeModel, extension: Extension) -> ExtendedOde:
        """Around a model, integrated as that is."""
        taken = {name: getattr(base, name) for name in ("params", "dt", "outputs", "method", "substeps")}
        return cls(base=base, extension=extension, **taken)

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """That of the model, stretched where there is a clock, and what is held."""
        own, at, given = self.extension.inside(self.base, x, u)
        rate = own.derivative(at, given)
        extension, dt = self.extension, self.base.dt
        if extension.span is not None:
            rate = rate * (extension.of(self.base, x, "duration") / extension.span)
        more = [0.0 * x[0] for _ in extension.constant] + [v / dt for v in extension.kept(self.base, u)]
        more += [0.0 * x[0] for _ in extension.before]
        return concatenate([rate, stack(more)]) if more else rate

    def output(self, x: Vector, u: Vector) -> Vector:
        """Outputs of the model."""
        own, at, given = self.extension.inside(self.base, x, u)
        return own.output(at, given)

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Those of the model."""
        own, at, given = self.extension.inside(self.base, x, u)
        return own.signals(at, given)


@dataclass(frozen=True, kw_only=True)
class RatedOde(ExtendedOde):
    """One that remembers inputs of the step before, which no derivative does."""

    def step(self, x: Vector, u: Vector) -> Vector:
        """That of the equations; what is remembered is the input."""
        names = self.extension.before
        later = self._step(x, u)
        return concatenate([later[: self.n_states - len(names)], stack([u[self.base.inputs.index(n)] for n in names])])


@dataclass(frozen=True, kw_only=True, eq=False)
class ExtendedStep(Model):
    """A model of any kind with an `Extension` that changes no parameter of it and no time."""

    base: Model
    extension: Extension
    states = derived(lambda self: (*self.base.states, *self.extension.states))
    inputs = derived(lambda self: (*self.base.inputs, *self.extension.inputs))
    outputs = derived(lambda self: self.base.outputs)
    dt = derived(lambda self: self.base.dt)
    params = derived(lambda self: getattr(self.base, "params", None))

    def initial_state(self, data: Dataset) -> np.ndarray:
        """That of the model; what is added begins with zero."""
        return np.concatenate([self.base.initial_state(data), np.zeros(len(self.extension.states))])

    def step(self, x: Vector, u: Vector) -> Vector:
        """That of the model, and what is held."""
        n = self.base.n_states
        later = self.base.step(x[:n], u[: self.base.n_inputs])
        more = [x[n + i] for i in range(len(self.extension.constant))]
        places = range(n + len(more), self.n_states)
        more += [x[i] + v for i, v in zip(places, self.extension.kept(self.base, u), strict=True)]
        return concatenate([later, stack(more)]) if more else later

    def output(self, x: Vector, u: Vector) -> Vector:
        """Outputs of the model."""
        return self.base.output(x[: self.base.n_states], u[: self.base.n_inputs])


def extended(model: Model, extension: Extension) -> Model:
    """The model with what is added; see `Extension`."""
    if isinstance(model, OdeModel) and not model.own_step:
        return (RatedOde if extension.before else ExtendedOde).of(model, extension)
    return ExtendedStep(base=model, extension=extension)
