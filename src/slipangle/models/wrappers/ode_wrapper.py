"""`OdeWrapper`: an ODE around another one, such as a car behind its steering or on a banked road."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError, nearest
from slipangle.models.ode import OdeModel
from slipangle.numerics.integrate import Method
from slipangle.ops import Scalar, Vector, concatenate
from slipangle.units import SI

_STABLE = 0.4  # shortest lag over an explicit integrator's step


@dataclass(frozen=True)
class OdeWrapper(OdeModel):
    """What an ODE around another one takes over: a subclass adds states, inputs or parameters of its own.

    It names the added states and inputs, which follow those of ``model``, and its own parameters, which are fields,
    and says by `inside` what drives the ODE in it.
    """

    model: OdeModel
    params: Any = field(init=False, repr=False, compare=False)
    dt: float = field(init=False, repr=False, compare=False)
    outputs: tuple[str, ...] = field(init=False, repr=False, compare=False)
    method: Method = field(init=False, repr=False, compare=False)
    substeps: int = field(init=False, repr=False, compare=False)

    added_states: ClassVar[tuple[str, ...]] = ()
    added_inputs: ClassVar[tuple[str, ...]] = ()
    own: ClassVar[dict[str, str]] = {}  # meaning of each own parameter

    def __post_init__(self) -> None:
        for name in ("params", "dt", "outputs", "method", "substeps"):
            object.__setattr__(self, name, getattr(self.model, name))
        object.__setattr__(self, "states", (*self.model.states, *self.added_states))
        object.__setattr__(self, "inputs", (*self.model.inputs, *self.added_inputs))

    def following(self, lag: Scalar, dt: float) -> int:
        """Substeps of a sample [s] that follow a lag. [s]"""
        return 1 if self.model.method == "radau" else math.ceil(_STABLE * dt / lag - 1e-9)

    @property
    def shortest_lag(self) -> float:
        """That the integrator follows; an implicit one follows any. [s]"""
        return 0.0 if self.model.method == "radau" else _STABLE * self.model.dt / self.model.substeps

    def resampled(self, dt: float, *, substeps: int = 0, outputs: tuple[str, ...] = ()) -> Self:
        """The same at another sample time [s]."""
        return replace(self, model=self.model.resampled(dt, substeps=substeps, outputs=outputs))

    @property
    def small_angles(self) -> bool:
        """Whether the car inside takes its steering angles for small."""
        return getattr(self.model, "small_angles", True)

    def inside(self, x: Vector, u: Vector) -> tuple[Vector, Vector]:
        """State and inputs of the ODE inside, shapes (n_states,), (n_inputs,)."""
        return x[: self.model.n_states], u[: self.model.n_inputs]

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Those of the ODE inside."""
        return self.model.signals(*self.inside(x, u))

    def output(self, x: Vector, u: Vector) -> Vector:
        """Outputs of the ODE inside."""
        return self.model.output(*self.inside(x, u))

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """The correction of the ODE inside."""
        corrected = self.model.correct(*self.inside(x, u), y)
        return concatenate([corrected, x[self.model.n_states :]]) if self.added_states else corrected

    def initial_state(self, data: Dataset) -> np.ndarray:
        """That of the ODE inside."""
        return np.asarray(self.model.initial_state(data), dtype=float)

    @property
    def memory(self) -> int:  # type: ignore[override]
        """That of the ODE inside."""
        return self.model.memory

    @property
    def several_minima(self) -> bool:  # type: ignore[override]
        """Whether fits of the ODE inside have several."""
        return self.model.several_minima

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Parameters of the ODE inside, then the own ones."""
        return (*self.model.parameter_names, *self.own)

    def range_of(self, name: str) -> SI:
        """Unit, meaning and range of an own parameter."""
        raise NotImplementedError

    def si(self, name: str) -> SI:
        """Unit, meaning and range of one parameter."""
        if name in self.own:
            return self.range_of(name)
        if name in self.model.parameter_names:
            return self.model.si(name)
        raise ParameterError(
            f"{type(self).__name__} around {type(self.model).__name__} has no parameter '{name}'; "
            f"{nearest(name, self.parameter_names)}: use one of these names"
        )

    def value(self, name: str) -> float:
        """Value of one parameter, SI units."""
        return float(getattr(self, name)) if name in self.own else self.model.value(name)

    def with_values(self, **values: Any) -> Self:
        """A copy with some parameters replaced (numbers or symbols)."""
        own = {n: v for n, v in values.items() if n in self.own}
        rest = {n: v for n, v in values.items() if n not in self.own}
        return replace(self, model=self.model.with_values(**rest), fit_info=None, **own)
