"""`OdeModel`: a model from a state derivative, whose named parameters a fit may vary."""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Integral
from typing import Any, ClassVar, Self

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError, nearest, shown
from slipangle.models.fast import Steps
from slipangle.models.model import FitInfo, Model, derived
from slipangle.numerics.integrate import Method, Step, discretise
from slipangle.ops import Scalar, Vector, stack
from slipangle.units import SI


class Parametrised:
    """Mixin of models with named parameters: what fits ask for. `GreyBox`, `EKF` and `Collocation` fit these.

    `with_values` takes symbols too. Where the step is no more than an integrator over `OdeModel.derivative`
    (`OdeModel.own_step` is false), derivatives by parameters are those of the derivative, in compiled code; of any
    other step they are differences, in compiled code where `OdeModel.steps_with` has some.

    A wrapper that changes what drives the ODE overrides `ode`, `drive_rows` and `drive`, and `si`, `value` and
    `with_values` for parameters of its own.
    """

    params: Any
    fit_info: Any
    ode: OdeModel = derived(lambda self: self)  # without what is wrapped around it

    def si(self, name: str) -> SI:
        """Unit, meaning and range of one parameter.

        Raises ParameterError if there is no such parameter; the nearest names are given.
        """
        return self.params.si(name)

    def value(self, name: str) -> float:
        """Value of one parameter, SI units."""
        self.si(name)
        return float(getattr(self.params, name))

    def with_values(self, **values: Any) -> Self:
        """A copy with some parameters replaced (numbers or symbols); it is no fit any more, so has no `fit_info`."""
        return replace(self, params=self.params.with_values(**values), fit_info=None)  # type: ignore[type-var]

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Every parameter."""
        return tuple(self.params.metadata())

    @abc.abstractmethod
    def resampled(self, dt: float, *, substeps: int = 0, outputs: tuple[str, ...] = ()) -> Self:
        """The same equations of motion at another sample time [s], as a controller wants them of an identified model.

        ``substeps`` are at least so many (see `OdeModel`); other outputs where some are named.
        """

    def drive_rows(self, data: Dataset) -> np.ndarray:
        """What drives the ODE, one row per sample from sample ``memory - 1`` on; `drive` makes its inputs of a row."""
        return data.u

    def drive(self, row: Vector) -> Vector:
        """Inputs of the ODE, shape (n_inputs,), from one row of `drive_rows`."""
        return row

    def for_experiment(self, index: int) -> Self:
        """The model with the parameters that were fitted for one experiment of the training data, counted from 0.

        Raises ParameterError if no parameter was fitted per experiment, or there was no such experiment.
        """
        info = self.fit_info
        fitted = {} if info is None else dict(zip(info.names, map(float, info.values), strict=True))
        tag = f"[{index}]"
        own = {name.removesuffix(tag): value for name, value in fitted.items() if name.endswith(tag)}
        if not own:
            several = [n for n in fitted if n.endswith("]")]
            raise ParameterError(
                f"the model has no parameters of experiment {index}; expected one of {several or 'none'}: fit with "
                "per_experiment=(...), and count experiments from 0"
            )
        return replace(self.with_values(**own), fit_info=info)  # type: ignore[type-var]


@dataclass(frozen=True, kw_only=True)
class OdeModel(Parametrised, Model):
    """A `Model` from a state derivative; subclasses name states and inputs and supply `derivative`.

    Parameters
    ----------
    dt : float
        Sample time. [s]
    outputs : tuple of str
        Which states (or other signals of `signals`) are the outputs.
    method, substeps
        Integrator, see `slipangle.numerics.integrate`; by default enough explicit steps to keep each at or
        below `max_step`, or one step of Radau IIA.

    Raises ParameterError if the sample time is not positive, substeps are no whole number, or an output is not known.
    """

    max_step: ClassVar[float] = 0.01
    own_step: ClassVar[bool] = False  # more than the integrator over `derivative`; set where a class has a `step`
    several_minima: ClassVar[bool] = False  # of its free-run error over its parameters; a fit then tries many starts

    params: Any
    dt: float
    outputs: tuple[str, ...] = ()
    method: Method = "rk4"
    substeps: int = 0
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        own = vars(cls)
        if "own_step" not in own and ("step" in own or "_step" in own):
            cls.own_step = True

    def __post_init__(self) -> None:
        if not self.dt > 0:
            raise ParameterError(f"the sample time is {self.dt} s; expected a positive number")
        if isinstance(self.substeps, bool) or not isinstance(self.substeps, Integral) or self.substeps < 0:
            raise ParameterError(
                f"substeps is {shown(self.substeps)}; expected a whole number of at least 1, or 0 for as many as it "
                "takes: leave it out"
            )
        object.__setattr__(self, "outputs", tuple(self.outputs) or self.states)
        if self.substeps == 0:
            explicit = max(1, math.ceil(self.dt / self.max_step - 1e-9))
            object.__setattr__(self, "substeps", 1 if self.method == "radau" else explicit)
        if {*self.outputs} <= {*self.states}:
            return
        zeros = np.zeros(self.n_states), np.zeros(self.n_inputs)
        known = {*self.states, *self.signals(*zeros)}
        for name in self.outputs:
            if name not in known:
                raise ParameterError(
                    f"{type(self).__name__} has no output '{name}'; {nearest(name, known)}: use one of these names"
                )

    def resampled(self, dt: float, *, substeps: int = 0, outputs: tuple[str, ...] = ()) -> Self:
        """The same equations of motion at another sample time [s]; see `Parametrised.resampled`."""
        other = replace(self, dt=dt, substeps=0, outputs=outputs or self.outputs)
        return replace(other, substeps=max(substeps, other.substeps))

    @abc.abstractmethod
    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Time derivative of the state, shape (n_states,), SI units per second."""

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Signals besides the states that can be outputs, by name."""
        return {}

    @cached_property
    def _step(self) -> Step:
        return discretise(
            self.derivative,
            self.dt,
            n_states=self.n_states,
            n_inputs=self.n_inputs,
            method=self.method,
            substeps=self.substeps,
        )

    def steps_with(self, names: tuple[str, ...]) -> Steps | None:
        """Compiled steps whose inputs are followed by values of these parameters; None where there are none.

        Asked for by fits of a model that has a step of its own, see `own_step`.
        """
        return None

    def step(self, x: Vector, u: Vector) -> Vector:
        """State one sample later, inputs held."""
        return self._step(x, u)

    def output(self, x: Vector, u: Vector) -> Vector:
        """The chosen outputs, with their sensors' biases."""
        values = {name: x[i] for i, name in enumerate(self.states)}
        if not set(self.outputs) <= values.keys():
            values |= self.signals(x, u)
        return stack([values[name] + self._bias(name) for name in self.outputs])

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """States that are outputs take their measured values, without the sensors' biases."""
        measured = {name: y[i] - self._bias(name) for i, name in enumerate(self.outputs)}
        return stack([measured.get(name, x[i]) for i, name in enumerate(self.states)])

    def initial_state(self, data: Dataset) -> np.ndarray:
        """First sample of the channels that are states; states that were not measured start at zero."""
        return np.array([self._start(name, data) for name in self.states])

    def _start(self, name: str, data: Dataset) -> float:
        return float(data[name][0]) - self._bias(name) if name in data else 0.0

    def _bias(self, name: str) -> Scalar:
        """What the sensor of a channel reads where the signal is zero: the parameter ``bias_NAME``, if any."""
        return getattr(self.params, f"bias_{name}", 0.0)
